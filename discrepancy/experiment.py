"""What to measure next: the test that is expected to split a tie best.

Each proposal is added to the measurements as a curve that is still to be read.  With
the hypotheses at their best fits, the chi-square by which readings would tell them
apart is computed with and without it; parameters and calibrations may move as far as
all readings, those to come included, allow.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from datagen.device import Design
from datagen.errors import InputError
from datagen.specimens import MODES, Bulge, Tensile

from .evidence import Fit
from .hypotheses import Present
from .judging import Ranking
from .measurement import LOADING, UNLOADING, Curve, Measurements
from .noise import Readings
from .study import Study
from .weighing import nearest

Array = np.ndarray

HYPOTHESES = 3
"""Of a tie, those that a proposal is judged by."""

TENSILE_NOISE = 0.02
"""Of a tensile test, share of the stress at twice the length."""

BULGE_NOISE = 5e-6
"""m.  Of a membrane's inflation, where no length was measured on the devices."""

SIDEWAYS = 0.2
"""Cosine of an orientation below which turning over changes next to nothing."""

UNKNOWN = 1e3
"""Noise, in sizes of a curve, of readings that are to tell nothing."""

HOLE = (8e-3, 2e-3)
"""Sides of the published bulge specimen's hole, m."""


@dataclass(frozen=True)
class Proposal:
    """A measurement that could be made next.

    Parameters
    ----------
    words : str
        What to do, in one sentence.
    curve : Curve
        Device or specimen and load steps; its values are not read yet.
    now, then : float
        Smallest chi-square between two of the tied hypotheses, by the readings at hand
        and with these.
    between : (str, str)
        The two that stay nearest then.
    """

    words: str
    curve: Curve
    now: float
    then: float
    between: tuple[str, str]

    @property
    def probability(self) -> float:
        """That the right one of the nearest two will fit better."""
        return float(ndtr(np.sqrt(max(self.then, 0.0)) / 2))


@dataclass(frozen=True)
class _Like:
    """A curve that was measured, and what is known of its readings.

    Parameters
    ----------
    curve : Curve
    noise : (m,) array, SI
        Of each quantity; NaN where no reading counts.
    run : int
        The next one, of all curves.
    """

    curve: Curve
    noise: Array
    run: int


def proposals(
    study: Study, names: Sequence[str], noise: Array
) -> Iterator[tuple[str, Curve]]:
    """Measurements that a lab can make with what it has, in words and as curves.

    Parameters
    ----------
    study : Study
    names : sequence of str
        Hypotheses that are to be told apart, or whose sizes are.
    noise : (n,) array, SI
        Of the study's readings, as a fit takes it.
    """
    curve = _telling(study, names)
    of_curve = np.full(curve.values.shape, np.nan)
    for (c, s, m), std in zip(study.cells, noise, strict=True):
        if study.measurements.curves[c] is curve:
            of_curve[s, m] = std
    known = [one[np.isfinite(one)] for one in of_curve.T]
    own = [float(np.median(one)) if len(one) else np.nan for one in known]
    run = 1 + max(c.run for c in study.measurements.curves)
    like = _Like(curve, np.array(own), run)
    if isinstance(curve.design, Design):
        yield from _of_device(like, curve.design)
        for layer, modulus in curve.layers.items():
            yield _strip(like, layer, modulus)
        yield _membrane(like, curve.design)
    elif isinstance(curve.design, Bulge):
        yield _further(like)
        yield _strip(like, curve.design.layer, curve.design.modulus)
    else:
        yield from _of_strip(like, curve.design)


def _again(like: _Like, load: Array, **other: object) -> Curve:
    """A curve like one that was measured, at other load steps; not read yet."""
    curve = like.curve
    load = np.asarray(load, dtype=float)
    shape = (len(load), len(curve.outputs))
    settings: dict[str, object] = {
        "load": load,
        "time": None,
        "branch": np.full(len(load), LOADING),
        "values": np.ones(shape),
        "std": np.tile(like.noise, (len(load), 1)),
        "run": like.run,
    }
    return replace(curve, **(settings | other))  # type: ignore[arg-type]


def _shown(load: Array) -> str:
    return ", ".join(f"{p / 1e3:.3g}" for p in load)


def _top(curve: Curve) -> float:
    """The load furthest from rest: below 0 in a test under vacuum alone."""
    return float(curve.load[int(np.argmax(np.abs(curve.load)))])


def _further(like: _Like) -> tuple[str, Curve]:
    """Higher pressures on a device or membrane."""
    high = _top(like.curve) * np.array([1.2, 1.4, 1.6])
    words = f"measure {like.curve.device} further, at {_shown(high)} kPa"
    return words, _again(like, high)


def _of_device(like: _Like, design: Design) -> Iterator[tuple[str, Curve]]:
    """More readings of a device, and of devices like it."""
    curve = like.curve
    yield _further(like)
    low = _top(curve) * np.array([0.02, 0.04, 0.08])
    yield (
        f"measure {curve.device} more finely, at {_shown(low)} kPa",
        _again(like, low),
    )
    load = np.unique(np.abs(curve.load)) * (1 if _top(curve) > 0 else -1)
    over = np.pi - curve.orientation
    if abs(np.cos(over)) > SIDEWAYS:
        yield (
            f"turn {curve.device} over (orientation_deg {np.degrees(over):.3g}) and "
            "measure it again",
            _again(like, load, orientation=over),
        )
    both = np.concatenate([load, load[-2::-1]])
    branch = np.repeat([LOADING, UNLOADING], [len(load), len(both) - len(load)])
    time = 10.0 * np.arange(1, len(both) + 1)
    yield (
        f"measure {curve.device} up and down again, 10 s a step (branch, time_s)",
        _again(like, both, branch=branch, time=time),
    )
    for field, factor, words in (
        ("upper_thickness", 0.65, "a thinner upper layer"),
        ("balloon_width", 1.4, "a wider balloon"),
        ("balloon_length", 0.6, "a shorter balloon"),
    ):
        try:
            other = _changed(design, field, factor)
        except InputError:
            continue
        bench = {"upper_thickness": (1e6, "um")}.get(field, (1e3, "mm"))
        value = f"{getattr(other, field) * bench[0]:.3g} {bench[1]}"
        name = f"{curve.device}, {words}"
        yield (
            f"make and measure a device like {curve.device} with {words}, {value}",
            _again(like, load, device=name, design=other),
        )


def _strip(like: _Like, layer: str, modulus: float) -> tuple[str, Curve]:
    """A strip of a layer's batch, pulled to twice its length."""
    stretch = np.linspace(1.1, 2.0, 10)
    stress = TENSILE_NOISE * modulus / 3 * 1.75
    words = f"pull a strip of the {layer} layer's batch ({modulus / 1e6:.3g} MPa) to "
    return words + "twice its length", _again(
        like,
        stretch,
        device=f"strip of the {layer} layer",
        design=Tensile(modulus, layer=layer),
        orientation=0.0,
        outputs=("stress",),
        values=np.ones((len(stretch), 1)),
        std=np.full((len(stretch), 1), stress),
    )


def _membrane(like: _Like, design: Design) -> tuple[str, Curve]:
    """A membrane like a device's upper layer over the published hole."""
    load = np.unique(np.abs(like.curve.load))
    measured = dict(zip(like.curve.outputs, like.noise, strict=True))
    lengths = [
        measured[name]
        for name in ("inflation", "inflation_lower", "tip_deflection")
        if np.isfinite(measured.get(name, np.nan))
    ]
    hole = Bulge(*HOLE, design.upper_thickness, design.upper_modulus)
    words = "inflate a membrane of the upper layer over a hole of "
    return words + f"{1e3 * HOLE[0]:g} x {1e3 * HOLE[1]:g} mm", _again(
        like,
        load,
        device="membrane of the upper layer",
        design=hole,
        orientation=0.0,
        outputs=("inflation",),
        values=np.ones((len(load), 1)),
        std=np.full((len(load), 1), lengths[0] if lengths else BULGE_NOISE),
    )


def _of_strip(like: _Like, strip: Tensile) -> Iterator[tuple[str, Curve]]:
    """Strips pulled further, and in other ways."""
    curve = like.curve
    top = float(curve.load.max())
    high = 1 + (top - 1) * np.array([1.15, 1.3, 1.5])
    shown = ", ".join(f"{stretch:.3g}" for stretch in high)
    yield (
        f"pull {curve.device} further, to stretches {shown}",
        _again(like, high),
    )
    stretch = np.linspace(1 + (top - 1) / 8, top, 8)
    for mode in MODES:
        if mode != strip.mode:
            name = f"{curve.device}, {mode}"
            yield (
                f"test the material of {curve.device} in {mode} tension, to a stretch "
                f"of {top:.3g}",
                _again(like, stretch, device=name, design=replace(strip, mode=mode)),
            )


def _changed(design: Design, field: str, factor: float) -> Design:
    """A design with one field changed and the margins around the balloons kept."""
    change = getattr(design, field) * (factor - 1)
    values = {field: getattr(design, field) + change}
    if field == "balloon_width":
        values["width"] = design.width + change
    if field == "balloon_length":
        values["length"] = design.length + change
    return design.with_values(**values)


def _telling(study: Study, names: Sequence[str]) -> Curve:
    """The device on which the hypotheses differ most by their solved curves.

    A specimen where there is no device.
    """
    readings = study.readings
    spread = np.zeros(len(readings.value))
    for name in names:
        present = study.present(name.split("+"))
        if present is not None:
            change = present.curves.changes() / readings.noise
            spread = np.maximum(spread, change)
    curves = study.measurements.curves
    score = {
        c: spread[[i for i, cell in enumerate(study.cells) if cell[0] == c]].max()
        for c in {cell[0] for cell in study.cells}
    }
    devices = [c for c in score if isinstance(curves[c].design, Design)]
    return curves[max(devices or score, key=lambda c: score[c])]


def separation(fits: Sequence[Fit]) -> tuple[float, tuple[str, str]]:
    """Smallest chi-square between two hypotheses, and which two."""
    found = []
    for a, b in itertools.combinations(fits, 2):
        both = [
            float((nearest(one, other.hypothesis, [other.t])[1] ** 2).sum())
            for one, other in ((a, b), (b, a))
        ]
        found.append((min(both), (a.hypothesis.name, b.hypothesis.name)))
    return min(found)


def next_measurement(study: Study, ranking: Ranking) -> list[Proposal]:
    """Proposals that could split what the ranking leaves together, best first.

    Empty where nothing is left to be split.
    """
    named = [one for one in ranking.candidates if one.effects and not one.unnamed]
    chosen = [one for one in named if one.name in ranking.effects][:HYPOTHESES]
    if len(chosen) == 1:  # against the one that comes next
        chosen += [one for one in named if one.name != chosen[0].name][:1]
    if len(chosen) < 2:
        return []
    now = separation([one.fit for one in chosen])[0]
    found = []
    noise = chosen[0].fit.noise
    for words, curve in proposals(study, [one.name for one in chosen], noise):
        curves = (*study.measurements.curves, curve)
        try:
            more = Study(
                Measurements(curves, tolerances=study.measurements.tolerances),
                study.solver,
                level=study.fast,
                fast=study.fast,
                effects=sorted({name for one in chosen for name in one.effects}),
                effects_dir=study.folder,
            )
        except InputError:
            continue
        fits = carried(study, more, [one.fit for one in chosen])
        if fits is None:
            continue
        then, between = separation(fits)
        found.append(Proposal(words, curve, now, then, between))
    return sorted(found, key=lambda one: -one.then)


def carried(study: Study, more: Study, fits: Sequence[Fit]) -> list[Fit] | None:
    """Fits of a study in one with a curve more; None where that is not reached."""
    solved = more.solve(
        [(one.hypothesis.effects, one.t) for one in fits],  # type: ignore[attr-defined]
        "proposals",
    )
    new = np.array([c == len(study.measurements.curves) for c, _, _ in more.cells])
    if not new.any():
        return None
    carried = []
    readings = _joined(study, more, new)
    for one, node in zip(fits, solved, strict=True):
        present = more.present(one.hypothesis.effects)  # type: ignore[attr-defined]
        if node is None or not isinstance(present, Present):
            return None
        keep = np.ones(len(readings.value), dtype=bool)
        carried.append(replace(one, hypothesis=present, readings=readings, keep=keep))
    return carried


def _joined(study: Study, more: Study, new: Array) -> Readings:
    """Readings of a study with a curve more, the old ones with the errors they had.

    The values of the new ones are not known: they have the size that the baseline
    gives them, and must not say anything of how the others err.
    """
    readings = more.readings
    noise, scale = readings.noise.copy(), readings.scale.copy()
    for curve in np.unique(readings.curve):
        at = readings.curve == curve
        scale[at] = np.abs(more.base[at]).max()
    before = {cell: i for i, cell in enumerate(study.cells)}
    for i in np.flatnonzero(~new):
        j = before.get(more.cells[i])
        if j is None:  # reached on this mesh alone, and not among the readings
            noise[i] = UNKNOWN * scale[i]
            continue
        noise[i] = study.readings.noise[j]
        scale[i] = study.readings.scale[j]
    was = dict(zip(study.readings.curve, study.readings.stated, strict=True))
    stated = np.array([was.get(curve, True) for curve in readings.curve])
    return replace(readings, noise=noise, scale=scale, stated=stated)
