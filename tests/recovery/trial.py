"""Trials of the ranking: readings made with a known effect, without new solves.

The devices of a lab are solved once with every effect at a few sizes.  A trial draws an
effect, its size, calibrations, smooth errors and noise, makes readings from the
interpolated curves, and ranks them by the whole search, whose solves are answered from
the same curves (`rehearsal`): thousands of trials cost no finite elements.  What
interpolation and meshes add is tested elsewhere, by sets of `pba challenge` that are
solved on other meshes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from datagen.device import Design
from datagen.effects import catalogue
from datagen.specimens import Tensile
from discrepancy.hypotheses import Present
from discrepancy.judging import Ranking
from discrepancy.laboratory import smooth_error
from discrepancy.measurement import Curve, Measurements
from discrepancy.noise import Readings
from discrepancy.rank import Search
from discrepancy.solves import Solver
from discrepancy.study import Study

from .rehearsal import Rehearsal

Array = np.ndarray

QUANTITIES = ("tip_deflection", "inflation")

PULLED = 0.005
"""Independent noise of a strip's stress, share of the stress at the last stretch."""

PULL = 1.0
"""Between a strip's readings, s."""


@dataclass(frozen=True)
class Kind:
    """Devices that a lab makes in a week: two batches, varied sizes.

    Parameters
    ----------
    moduli : (2,) tuple, Pa
    upper, lower : (2,) tuples, m
        Ranges of the layers' thickness.
    width : (2,) tuple, m
        Range of the balloon's width.
    pressure : float, Pa
        The last of seven even load steps.
    unloading : bool
        Whether paths come back, by six steps.
    seconds : float, optional
        Between the readings of a device; without it no reading has a time.
    stretch : float
        To which a strip of each batch is pulled by eight even steps, and back by seven;
        1 for no strips.
    without : tuple of str
        Effects that are no candidates: their paths take too long.
    """

    moduli: tuple[float, float]
    upper: tuple[float, float]
    lower: tuple[float, float]
    width: tuple[float, float]
    pressure: float
    unloading: bool
    seconds: float | None = None
    stretch: float = 1.0
    without: tuple[str, ...] = ()


SOFT = Kind(
    moduli=(1.4e6, 1.0e6),
    upper=(70e-6, 110e-6),
    lower=(140e-6, 220e-6),
    width=(1.4e-3, 2.0e-3),
    pressure=25e3,
    unloading=True,
    seconds=10.0,
)

KINDS = {
    # Small strains: geometry, supports and moduli show.
    "stiff": Kind(
        moduli=(4.5e6, 2.5e6),
        upper=(75e-6, 130e-6),
        lower=(110e-6, 170e-6),
        width=(0.8e-3, 1.3e-3),
        pressure=70e3,
        unloading=False,
    ),
    # Large strains and back again: laws, histories and the supply show.
    "soft": replace(SOFT, without=("viscoelasticity",)),
    # Slowly, and with strips of both batches pulled to tell the moduli: laws at large
    # strain show, what comes with time, and what is not the material's.
    "strips": replace(SOFT, unloading=False, seconds=60.0, stretch=2.4),
}


def devices_of(kind: Kind, count: int) -> list[Design]:
    """The first `count` devices of a lab."""
    rng = np.random.default_rng(20)
    a, b = kind.moduli
    designs = []
    for i in range(count):
        upper, lower = ((b, a), (a, b), (a, a), (b, b))[i % 4]
        designs.append(
            Design.from_sample(
                {
                    "balloon_length": 1e-3 * rng.uniform(3.0, 6.0),
                    "divisions_x": 2 if i in (4, 9) else 1,
                    "divisions_y": 1,
                    "wall": 0.2e-3,
                    "balloon_start": 1e-3 * rng.uniform(0.8, 1.5),
                    "tip_margin": 1.25e-3,
                    "balloon_width": 1e-3 * rng.uniform(*1e3 * np.array(kind.width)),
                    "rim": 0.5e-3,
                    "cavity_height": 75e-6,
                    "upper_thickness": _whole(rng.uniform(*1e6 * np.array(kind.upper))),
                    "lower_thickness": _whole(rng.uniform(*1e6 * np.array(kind.lower))),
                    "upper_modulus": upper,
                    "lower_modulus": lower,
                }
            )
        )
    return designs


def _whole(micrometres: float) -> float:
    return 1e-6 * round(micrometres)


def empty(design: Design, name: str, kind: Kind) -> Curve:
    """A curve of a device without readings: load steps, and noise to be set."""
    pressure = np.linspace(kind.pressure / 7, kind.pressure, 7)
    branch = ["loading"] * len(pressure)
    if kind.unloading:
        pressure = np.concatenate([pressure, pressure[-2::-1]])
        branch += ["unloading"] * (len(pressure) - len(branch))
    steps = len(pressure)
    return Curve(
        device=name,
        run=1,
        orientation=0.0,
        design=design,
        load=pressure,
        time=None if kind.seconds is None else _times(steps, kind.seconds),
        branch=np.array(branch),
        outputs=QUANTITIES,
        values=np.ones((steps, len(QUANTITIES))),
        std=np.full((steps, len(QUANTITIES)), 1e-6),
    )


def strips(kind: Kind) -> list[Curve]:
    """Curves without readings of a strip of each batch, pulled and let back."""
    if kind.stretch == 1.0:
        return []
    stretch = np.linspace(1.0, kind.stretch, 9)[1:]
    branch = ["loading"] * 8 + ["unloading"] * 7
    stretch = np.concatenate([stretch, stretch[-2::-1]])
    shape = (len(stretch), 1)
    return [
        Curve(
            device=f"strip of {modulus / 1e6:g} MPa",
            run=1,
            orientation=0.0,
            design=Tensile(modulus),
            load=stretch,
            time=_times(len(stretch), PULL),
            branch=np.array(branch),
            outputs=("stress",),
            values=np.ones(shape),
            std=np.full(
                shape, PULLED * modulus / 3 * (kind.stretch - kind.stretch**-2)
            ),
        )
        for modulus in kind.moduli
    ]


def _times(steps: int, apart: float) -> Array:
    return apart * np.arange(1, steps + 1)


@dataclass
class Lab:
    """A study of devices whose curves are known with every effect.

    Parameters
    ----------
    solver : Solver
    devices : int
    kind : str
        Of `KINDS`.
    effects : sequence of str, optional
    """

    solver: Solver
    devices: int = 10
    kind: str = "stiff"
    effects: Sequence[str] | None = None

    @cached_property
    def study(self) -> Study:
        kind = KINDS[self.kind]
        curves = tuple(
            empty(design, f"D{i + 1}", kind)
            for i, design in enumerate(devices_of(kind, self.devices))
        )
        return Study(
            Measurements((*curves, *strips(kind))),
            self.solver,
            level="draft",
            fast="draft",
            effects=self.effects or [n for n in catalogue() if n not in kind.without],
        )

    def solve(self) -> None:
        """Solve every effect at sizes over its range, as far as paths go."""
        study = self.study
        names = [n for n in study.effects if not study.blind(n)]
        study.tangents(names)
        wanted = [((n,), t) for n in names for t in self.sizes(n)]
        study.solve(wanted, "recovery")

    def sizes(self, name: str) -> list[Array]:
        """Coordinates along each parameter, both ways, and corners of them."""
        priors = self.study.priors((name,))
        off = np.array([p.off for p in priors])
        way = (self.study.first(name)[0] - off) * np.sqrt(len(off))
        first = [off + axis for axis in np.diag(way)]
        found = list(first)
        for k, (prior, step) in enumerate(zip(priors, way, strict=True)):
            lower, upper = prior.bounds
            for factor in (2.0, -1.0, -2.0):
                x = off.copy()
                x[k] = off[k] + factor * step
                if lower - 1e-9 <= x[k] <= upper + 1e-9:
                    found.append(x)
        if len(priors) > 1:
            found.append(off + sum((t - off for t in first), np.zeros_like(off)) * 0.7)
        return found

    def present(self, name: str) -> Present | None:
        return self.study.present((name,))


@dataclass(frozen=True)
class Truth:
    """What was planted: effects with coordinates; empty for nothing."""

    effects: dict[str, Array]
    moved: float  # largest change of a reading, over its `doubt`


def readings_of(
    lab: Lab,
    truth: dict[str, Array],
    *,
    noise: float,
    smooth: float,
    seed: int,
    extra: Array | None = None,
) -> tuple[Readings, Truth]:
    """Readings of all devices with some effects on.

    Parameters
    ----------
    truth : dict of effect to coordinates
    noise : float, m
        Standard deviation of the independent noise of tip and inflation; strips keep
        theirs.
    smooth : float
        Smooth errors, share of each curve's maximum.
    seed : int
    extra : (n,) array, optional
        Change by an effect that has no name.
    """
    rng = np.random.default_rng(seed)
    study = lab.study
    base = study.null().prediction
    values, columns = base.values, base.columns
    if truth:  # together, as the solves of several effects are answered, too
        names = sorted(truth)
        present = study.present(names)
        assert present is not None
        values, _, columns = present.predict(np.concatenate([truth[n] for n in names]))
    if extra is not None:
        values = values + extra
    r = study.readings
    scale = np.empty(len(values))
    for curve in np.unique(r.curve):
        scale[r.curve == curve] = np.abs(values[r.curve == curve]).max()
    std = independent(lab, noise)
    moved = float(doubt(lab, noise, smooth).times(values - base.values).max())
    y = values + columns @ rng.normal(size=columns.shape[1])
    for curve in np.unique(r.curve):
        at = r.curve == curve
        y[at] += smooth * scale[at] * smooth_error(rng, r.place[at])
    y += std * rng.normal(size=len(y))
    found = np.empty(len(values))
    for g in np.unique(r.group):
        at = r.group == g
        for curve in np.unique(r.curve[at]):
            found[r.curve == curve] = np.abs(y[r.curve == curve]).max()
        found[at] = np.maximum(found[at], 0.2 * np.median(found[at]))
    made = replace(r, value=y, noise=std, scale=found)
    return made, Truth(truth, moved)


def of_devices(lab: Lab) -> Array:
    """(n,) of bool: which readings are not a strip's."""
    curves = lab.study.measurements.curves
    return np.array(
        [isinstance(curves[c].design, Design) for c, _, _ in lab.study.cells]
    )


def independent(lab: Lab, noise: float) -> Array:
    """(n,) independent noise of every reading, `noise` that of the devices, m."""
    return np.where(of_devices(lab), noise, lab.study.readings.noise)


@dataclass(frozen=True)
class Doubt:
    """What an effect has to stand out from: noise, smooth errors and tolerances.

    Those of moduli, thicknesses and camera; a strip tells of a device's moduli.

    Parameters
    ----------
    std : (n,) array
        Of each reading where nothing is missing, given the others of strips.
    follow : (n, k) array
        What the k readings of strips make expect of each; 0 of itself.
    strip : (n,) array of bool
    """

    std: Array
    follow: Array
    strip: Array

    def times(self, change: Array) -> Array:
        """(..., n) sizes of changes (..., n) of the readings, over `std`."""
        expected = change[..., self.strip] @ self.follow.T
        found: Array = np.abs(change - expected) / self.std
        return found


def doubt(lab: Lab, noise: float, smooth: float) -> Doubt:
    """What effects have to stand out from in a lab with such errors."""
    study = lab.study
    base = study.null().prediction
    r, columns = study.readings, base.columns
    top = np.array([np.abs(base.values[r.curve == c]).max() for c in r.curve])
    own, drift = independent(lab, noise), smooth * top
    strip = ~of_devices(lab)
    # As if smooth errors were the same all along a strip: it tells the least then.
    same = r.curve[strip][:, None] == r.curve[strip]
    errors = np.diag(own[strip] ** 2) + same * np.outer(drift[strip], drift[strip])
    told = columns[strip]
    precise = np.linalg.inv(told @ told.T + errors)
    share = told.T @ precise  # of r calibrations, by what strips read
    left = np.eye(columns.shape[1]) - share @ told
    tolerances = np.einsum("nr,rs,ns->n", columns, left, columns)
    std, follow = np.sqrt(own**2 + drift**2 + tolerances), columns @ share
    # Of a strip's own reading: its mean and deviation given the others.
    std[strip] = 1 / np.sqrt(np.diag(precise))
    follow[strip] = np.eye(strip.sum()) - precise / np.diag(precise)[:, None]
    return Doubt(std, follow, strip)


def size_for(
    lab: Lab, name: str, wanted: float, noise: float, smooth: float, seed: int
) -> Array:
    """Coordinates of an effect that move some reading by a multiple of its `doubt`.

    A random direction of its parameters from off; at most to the end of the range.
    """
    rng = np.random.default_rng(seed)
    present = lab.present(name)
    assert present is not None
    study = lab.study
    lower = np.array([p.bounds[0] for p in present.priors])
    upper = np.array([p.bounds[1] for p in present.priors])
    off = np.array([p.off for p in present.priors])
    # Not further than what was solved.
    lower = np.maximum(lower, present.nodes.min(axis=0))
    upper = np.minimum(upper, present.nodes.max(axis=0))
    shares = rng.uniform(0.3, 1.0, len(off))
    way = (shares / shares.max()) * np.where(
        (upper - off > 1e-9) & ((rng.random(len(off)) < 0.5) | (off - lower < 1e-9)),
        upper - off,
        lower - off,
    )
    base = study.base
    own = doubt(lab, noise, smooth)

    def moved(share: float) -> float:
        change = present.many((off + share * way)[None, :])[0] - base
        return float(own.times(change).max())

    low, high = 0.0, 1.0
    if moved(1.0) < wanted:
        return off + way
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if moved(middle) < wanted else (low, middle)
    return off + high * way


def rank(lab: Lab, readings: Readings) -> tuple[Ranking, int]:
    """Rank readings, with the lab's curves in place of solves, and how many of them."""
    study = Rehearsal.of(lab.study, readings)
    return Search(study, details=False).run(), study.asked


def unnamed_changes(
    lab: Lab,
) -> dict[str, Callable[[float, float, float], Array]]:
    """Changes of the devices' readings by effects that the catalogue has not.

    Each is a function of the wanted size, noise and smooth errors: (n,) array.
    """
    study = lab.study
    r, base = study.readings, study.base
    designs = [study.measurements.curves[c].design for c, _, _ in study.cells]
    device = of_devices(lab)
    upper, width = (
        np.array([getattr(design, name, 1.0) for design in designs])
        for name in ("upper_thickness", "balloon_width")
    )
    tip = np.array([study.kinds[g][1] == "tip_deflection" for g in r.group], dtype=bool)
    top = np.array([np.abs(base[r.curve == c]).max() for c in r.curve])
    shapes = {
        # The supply line leaks more the higher the pressure.
        "leak": -base * r.place**2 * np.where(tip, 0.3, 1.0),
        # A skin that weakens thin layers more than thick ones, at large strain.
        "thin_layers": top * (95e-6 / upper) ** 2 * np.maximum(r.place - 0.3, 0.0),
        # The rim lifts where balloons are wide, and turns the tip.
        "lifted_rim": top * (width / 1e-3) ** 3 * np.where(tip, -1.0, 0.2) * r.place,
    }

    def scaled(shape: Array) -> Callable[[float, float, float], Array]:
        def change(size: float, noise: float, smooth: float) -> Array:
            felt = np.where(device, shape, 0.0)
            largest = doubt(lab, noise, smooth).times(felt).max()
            found: Array = felt * size / largest
            return found

        return change

    return {name: scaled(shape) for name, shape in shapes.items()}
