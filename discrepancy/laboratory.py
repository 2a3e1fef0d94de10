"""A laboratory drawn from random numbers: devices, errors, what devices go through."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre
from scipy.special import ndtr, ndtri

from datagen.device import CASES, MATERIALS, MM, UM, Design
from datagen.levels import LEVELS, MeshLevel
from datagen.response import Path

Array = np.ndarray

LEGENDRE = np.array([1.0, 1.0, 0.7, 0.5, 0.3])
"""Standard deviations of the coefficients of a smooth error, before normalisation."""

FARTHEST = 2.5
"""Standard deviations past which no nuisance is drawn: parts so far off are sorted
out."""

REST = 60.0
"""s.  A device lies vented between two runs."""


MESHES: dict[str, MeshLevel] = {
    "draft": replace(LEVELS["draft"], name="draft-sealed", balloon_x=5, edge_x=0.7),
    "standard": replace(
        LEVELS["standard"],
        name="standard-sealed",
        balloon_x=7,
        balloon_y=5,
        rim=3,
        edge_x=0.6,
        edge_y=0.7,
        edge_z=1.0,
    ),
    "fine": replace(LEVELS["fine"], name="fine-sealed", edge_x=0.35, edge_y=0.35),
}
"""Meshes of the truth: those of the ranker, graded otherwise."""


def within(rng: np.random.Generator, size: int | None = None) -> Array:
    """Standard normal numbers, none past `FARTHEST`."""
    tail = ndtr(-FARTHEST)
    drawn: Array = ndtri(tail + (1 - 2 * tail) * rng.random(size))
    return drawn


def draw_devices(rng: np.random.Generator, count: int) -> dict[str, Design]:
    """Stated designs that one laboratory could have made in a month.

    One mask maker, one spinner, two batches of PDMS in the four published cases; every
    fourth device or so is divided.
    """
    cases = [list(CASES)[i % len(CASES)] for i in range(count)]
    rng.shuffle(cases)
    cavity = float(rng.integers(60, 91)) * UM
    designs = {}
    for i, case in enumerate(cases):
        upper, lower = (MATERIALS[mix] for mix in CASES[case])
        divided = rng.random() < 0.25
        nx = int(rng.integers(2, 5)) if divided else 1
        length = float(rng.integers(40, 71) if divided else rng.integers(30, 61))
        designs[f"D{i + 1}"] = Design.from_sample(
            {
                "balloon_length": length * 0.1 * MM,
                "divisions_x": nx,
                "divisions_y": 1,
                "wall": 0.2 * MM,
                "balloon_start": float(rng.integers(8, 16)) * 0.1 * MM,
                "tip_margin": 1.25 * MM,
                "balloon_width": float(rng.integers(16, 29)) * 0.05 * MM,
                "rim": 0.5 * MM,
                "cavity_height": cavity,
                "upper_thickness": float(rng.integers(70, 131)) * UM,
                "lower_thickness": float(rng.integers(110, 171)) * UM,
                "upper_modulus": upper,
                "lower_modulus": lower,
            }
        )
    return designs


def smooth_error(rng: np.random.Generator, place: Array) -> Array:
    """One draw of a smooth error of size 1 at places (s,) from 0 to 1.

    A Legendre series with normal coefficients, whose mean square over the range is
    sum c_k^2 / (2 k + 1), 1 in expectation.  Where places come back, half of the
    variance is that of another series over the whole way.
    """
    way = np.abs(np.diff(place, prepend=0.0)).cumsum()
    if way[-1] <= place.max() + 1e-9:
        return _series(rng, place)
    both = _series(rng, place) + _series(rng, way / way[-1])
    error: Array = both / math.sqrt(2)
    return error


def _series(rng: np.random.Generator, place: Array) -> Array:
    degree = np.arange(len(LEGENDRE))
    norm = math.sqrt(float((LEGENDRE**2 / (2 * degree + 1)).sum()))
    drawn = LEGENDRE * rng.standard_normal(len(LEGENDRE)) / norm
    error: Array = legendre.legval(2 * place - 1, drawn)
    return error


@dataclass(frozen=True)
class Programme:
    """What every device is put through, run after run.

    Parameters
    ----------
    load : (s,) array, Pa
        Measured load steps of one run.
    runs : int
    hold : float, s
        Duration of a load step.
    """

    load: Array
    runs: int
    hold: float

    @cached_property
    def time(self) -> Array:
        """(runs, s) array, s, of the measured load steps; the clock is never reset."""
        run = self.hold * np.arange(1, len(self.load) + 1)
        time: Array = run + np.arange(self.runs)[:, None] * (run[-1] + REST)
        return time

    def path(self, between: Array | None = None) -> tuple[Path, Array]:
        """Load path through all runs, and where the (runs, s) measured steps are in it.

        Parameters
        ----------
        between : (runs, s) array, optional
            Parts of each step at which the truth has a load step of its own.
        """
        load, time, measured = [], [], []
        at, clock = 0.0, 0.0
        for run in range(self.runs):
            if run:  # vented as fast as loaded, and left so
                step = min(self.hold, REST / 3)
                load += [0.0, 0.0]
                time += [clock + step, float(self.time[run, 0]) - step]
                at, clock = 0.0, time[-1]
            for s, wanted in enumerate(self.load):
                end = float(self.time[run, s])
                if between is not None:
                    part = float(between[run, s])
                    load.append(at + part * (float(wanted) - at))
                    time.append(clock + part * (end - clock))
                measured.append(len(load))
                load.append(float(wanted))
                time.append(end)
                at, clock = float(wanted), end
        where = np.array(measured).reshape(self.runs, -1)
        return Path(np.array(load), np.array(time)), where


def programme(
    top: float, pressures: int, unloading: bool, runs: int, hold: float
) -> Programme:
    """Even load steps up to a pressure, round numbers where there is room for them."""
    up = np.linspace(0.0, top, pressures + 1)[1:]
    digit = 10.0 ** math.floor(math.log10(top / pressures / 4))
    up = np.round(up / digit) * digit
    load = np.concatenate([up, up[-2::-1]]) if unloading else up
    return Programme(load, runs, hold)
