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
from .study import Study
from .weighing import nearest

Array = np.ndarray

HYPOTHESES = 3
"""Of a tie, those that a proposal is judged by."""

TENSILE_NOISE = 0.02
"""Of a tensile test, share of the stress at twice the length."""

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


def proposals(study: Study, names: Sequence[str]) -> Iterator[tuple[str, Curve]]:
    """Measurements that a lab can make with what it has, in words and as curves."""
    curve = _telling(study, names)
    if isinstance(curve.design, Design):
        yield from _of_device(study, curve, curve.design)
        for layer, modulus in curve.layers.items():
            yield _strip(study, curve, layer, modulus)
        yield _membrane(study, curve, curve.design)
    elif isinstance(curve.design, Bulge):
        yield _further(study, curve)
        yield _strip(study, curve, curve.design.layer, curve.design.modulus)
    else:
        yield from _of_strip(study, curve, curve.design)


def _again(study: Study, curve: Curve, load: Array, **other: object) -> Curve:
    """A curve like one that was measured, at other load steps; not read yet."""
    load = np.asarray(load, dtype=float)
    shape = (len(load), len(curve.outputs))
    settings: dict[str, object] = {
        "load": load,
        "time": None,
        "branch": np.full(len(load), LOADING),
        "values": np.ones(shape),
        "std": np.tile(np.nanmedian(_noise(study, curve), axis=0), (len(load), 1)),
        "run": 1 + max(c.run for c in study.measurements.curves),
    }
    return replace(curve, **(settings | other))  # type: ignore[arg-type]


def _shown(load: Array) -> str:
    return ", ".join(f"{p / 1e3:.3g}" for p in load)


def _further(study: Study, curve: Curve) -> tuple[str, Curve]:
    """Higher pressures on a device or membrane."""
    high = float(np.abs(curve.load).max()) * np.array([1.2, 1.4, 1.6])
    words = f"measure {curve.device} further, at {_shown(high)} kPa"
    return words, _again(study, curve, high)


def _of_device(
    study: Study, curve: Curve, design: Design
) -> Iterator[tuple[str, Curve]]:
    """More readings of a device, and of devices like it."""
    yield _further(study, curve)
    low = float(np.abs(curve.load).max()) * np.array([0.02, 0.04, 0.08])
    yield (
        f"measure {curve.device} more finely, at {_shown(low)} kPa",
        _again(study, curve, low),
    )
    load = np.unique(np.abs(curve.load))
    yield (
        f"turn {curve.device} over (orientation_deg 180) and measure it again",
        _again(study, curve, load, orientation=np.pi - curve.orientation),
    )
    both = np.concatenate([load, load[-2::-1]])
    branch = np.repeat([LOADING, UNLOADING], [len(load), len(both) - len(load)])
    time = 10.0 * np.arange(1, len(both) + 1)
    yield (
        f"measure {curve.device} up and down again, 10 s a step (branch, time_s)",
        _again(study, curve, both, branch=branch, time=time),
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
            _again(study, curve, load, device=name, design=other),
        )


def _strip(study: Study, curve: Curve, layer: str, modulus: float) -> tuple[str, Curve]:
    """A strip of a layer's batch, pulled to twice its length."""
    stretch = np.linspace(1.1, 2.0, 10)
    stress = TENSILE_NOISE * modulus / 3 * 1.75
    words = f"pull a strip of the {layer} layer's batch ({modulus / 1e6:.3g} MPa) to "
    return words + "twice its length", _again(
        study,
        curve,
        stretch,
        device=f"strip of the {layer} layer",
        design=Tensile(modulus, layer=layer),
        orientation=0.0,
        outputs=("stress",),
        values=np.ones((len(stretch), 1)),
        std=np.full((len(stretch), 1), stress),
    )


def _membrane(study: Study, curve: Curve, design: Design) -> tuple[str, Curve]:
    """A membrane like a device's upper layer over the published hole."""
    load = np.unique(np.abs(curve.load))
    hole = Bulge(*HOLE, design.upper_thickness, design.upper_modulus)
    words = "inflate a membrane of the upper layer over a hole of "
    return words + f"{1e3 * HOLE[0]:g} x {1e3 * HOLE[1]:g} mm", _again(
        study,
        curve,
        load,
        device="membrane of the upper layer",
        design=hole,
        orientation=0.0,
        outputs=("inflation",),
        values=np.ones((len(load), 1)),
        std=np.full((len(load), 1), float(np.nanmin(_noise(study, curve)))),
    )


def _of_strip(
    study: Study, curve: Curve, strip: Tensile
) -> Iterator[tuple[str, Curve]]:
    """Strips pulled further, and in other ways."""
    top = float(curve.load.max())
    high = 1 + (top - 1) * np.array([1.15, 1.3, 1.5])
    shown = ", ".join(f"{stretch:.3g}" for stretch in high)
    yield (
        f"pull {curve.device} further, to stretches {shown}",
        _again(study, curve, high),
    )
    stretch = np.linspace(1 + (top - 1) / 8, top, 8)
    for mode in MODES:
        if mode != strip.mode:
            name = f"{curve.device}, {mode}"
            yield (
                f"test the material of {curve.device} in {mode} tension, to a stretch "
                f"of {top:.3g}",
                _again(
                    study, curve, stretch, device=name, design=replace(strip, mode=mode)
                ),
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


def _noise(study: Study, curve: Curve) -> Array:
    """(s, m) noise of a curve's readings as the study takes it."""
    noise = np.full(curve.values.shape, np.nan)
    for i, (c, s, m) in enumerate(study.cells):
        if study.measurements.curves[c] is curve:
            noise[s, m] = study.readings.noise[i]
    return noise


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
    for words, curve in proposals(study, [one.name for one in chosen]):
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
        fits = carried(more, [one.fit for one in chosen])
        if fits is None:
            continue
        then, between = separation(fits)
        found.append(Proposal(words, curve, now, then, between))
    return sorted(found, key=lambda one: -one.then)


def carried(study: Study, fits: Sequence[Fit]) -> list[Fit] | None:
    """The same fits in a study with one curve more; None where it is not reached."""
    solved = study.solve(
        [(one.hypothesis.effects, one.t) for one in fits],  # type: ignore[attr-defined]
        "proposals",
    )
    carried = []
    readings = study.readings
    if len(np.unique(readings.device)) < len(study.measurements.devices):
        return None  # the new curve is past the end of the path
    # What is not read yet has the size that the baseline gives it.
    new = readings.curve >= 1000 * (len(study.measurements.curves) - 1)
    scale = readings.scale.copy()
    for curve in np.unique(readings.curve[new]):
        at = readings.curve == curve
        scale[at] = np.abs(study.base[at]).max()
    readings = replace(readings, scale=scale)
    for one, node in zip(fits, solved, strict=True):
        present = study.present(one.hypothesis.effects)  # type: ignore[attr-defined]
        if node is None or not isinstance(present, Present):
            return None
        keep = np.ones(len(readings.value), dtype=bool)
        carried.append(replace(one, hypothesis=present, readings=readings, keep=keep))
    return carried
