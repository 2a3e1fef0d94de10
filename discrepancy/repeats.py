"""Noise from repeated runs: what the same device reads at the same pressures again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .columns import NUMBERS
from .measurement import JITTER, Curve, Measurements

Array = np.ndarray

ENOUGH = 6
"""Degrees of freedom from which on an estimate is taken for the noise, and not for a
guess of it: its own standard deviation is then 30 % or less."""

LINE = 4
"""Shared load steps from which on runs may differ by a line, not by an offset alone."""

SAME = 1e-6
"""Relative distance within which two loads are the same."""


@dataclass(frozen=True)
class Repeats:
    """Pooled standard deviation of repeated readings of one quantity.

    Parameters
    ----------
    std : float, SI
    degrees : int
        Degrees of freedom behind it.
    devices : tuple of str
        That were measured repeatedly.
    """

    std: float
    degrees: int
    devices: tuple[str, ...]


def noise_from_repeats(measurements: Measurements) -> dict[tuple[str, str], Repeats]:
    """Independent noise of each quantity, from runs of one device at the same loads.

    From the runs (m, s) of a device at shared loads the mean of the runs is taken off,
    and of each run its own line in the load (an offset where fewer than `LINE` loads
    are shared): a camera set up anew, a first cycle that differs from the second and
    other errors of a whole run are no noise of a reading.  The pooled variance is
    the sum of squares over (m - 1)(s - 2) degrees of freedom.

    Parameters
    ----------
    measurements : Measurements

    Returns
    -------
    dict of (specimen, quantity) to Repeats
        Quantities that were never repeated are not in it, nor those that scatter by
        less than rounding to their last digit does.
    """
    squares: dict[tuple[str, str], float] = {}
    degrees: dict[tuple[str, str], int] = {}
    devices: dict[tuple[str, str], dict[str, None]] = {}
    grid: dict[tuple[str, str], float] = {}
    for runs in _repeated(measurements):
        first = runs[0]
        names = dict.fromkeys(name for curve in runs for name in curve.outputs)
        branches = sorted({str(one) for curve in runs for one in curve.branch})
        for name in names:
            for branch in branches:
                load, values = _shared(runs, name, branch)
                runs_there, steps = values.shape
                order = 2 if steps >= LINE else 1
                free = (runs_there - 1) * (steps - order)
                if not steps or free < 1 or np.ptp(load) == 0:
                    continue
                lack = values - values.mean(axis=0)
                line = np.vander(load / np.abs(load).max(), order)
                lack = lack.T - line @ np.linalg.lstsq(line, lack.T, rcond=None)[0]
                key = (first.specimen, name)
                squares[key] = squares.get(key, 0.0) + float((lack**2).sum())
                grid[key] = max(grid.get(key, 0.0), _last_digit(values, name))
                degrees[key] = degrees.get(key, 0) + free
                devices.setdefault(key, {})[first.device] = None
    return {
        key: Repeats(math.sqrt(squares[key] / free), free, tuple(devices[key]))
        for key, free in degrees.items()
        # What scatters by less than its last digit was rounded away, or copied.
        if squares[key] > free * grid[key] ** 2 / 12
    }


def at_rest_alone(
    measurements: Measurements, cells: Sequence[tuple[int, int, int]]
) -> tuple[tuple[str, str], ...]:
    """Specimens and quantities that are read at rest alone, without a stated noise.

    Nothing tells theirs: it is guessed from what a quantity is under load, and a
    baseline at rest is zero, from which any number would lie far away.  At rest is what
    is below `JITTER` of the largest load of such specimens.

    Parameters
    ----------
    measurements : Measurements
    cells : sequence of (curve, step, column)
        The readings.
    """
    largest: dict[str, float] = {}
    for curve in measurements.curves:
        top = max(largest.get(curve.specimen, 0.0), float(np.abs(curve.reach).max()))
        largest[curve.specimen] = top
    told: dict[tuple[str, str], bool] = {}
    for c, s, m in cells:
        curve = measurements.curves[c]
        kind = (curve.specimen, curve.outputs[m])
        heard = abs(curve.reach[s]) > JITTER * largest[curve.specimen]
        told[kind] = told.get(kind, False) or heard or np.isfinite(curve.std[s, m])
    return tuple(kind for kind, heard in told.items() if not heard)


def _repeated(measurements: Measurements) -> list[list[Curve]]:
    """Curves of one device and orientation, where there are at least two."""
    found: dict[tuple[str, float], list[Curve]] = {}
    for curve in measurements.curves:
        found.setdefault((curve.device, curve.orientation), []).append(curve)
    return [runs for runs in found.values() if len(runs) > 1]


def _shared(runs: list[Curve], name: str, branch: str) -> tuple[Array, Array]:
    """Loads (s,) that all runs with a quantity have on a branch, and values (m, s).

    Runs that lack the quantity or the branch are passed over.
    """
    rows: list[dict[float, float]] = []
    for curve in runs:
        if name not in curve.outputs:
            continue
        values = curve.output(name)
        there = np.flatnonzero((curve.branch == branch) & np.isfinite(values))
        row = {_rounded(float(curve.load[i])): float(values[i]) for i in there}
        if row:
            rows.append(row)
    if len(rows) < 2:
        return np.zeros(0), np.zeros((0, 0))
    loads = sorted(set.intersection(*(set(row) for row in rows)))
    return np.array(loads), np.array([[row[p] for p in loads] for row in rows])


def _last_digit(values: Array, name: str) -> float:
    """Largest power of ten, of the bench unit or SI, that all values are multiples of.

    SI.  Files are written in one of the two, as a rule.

    Parameters
    ----------
    values : (m, s) array, SI
    name : str
        The quantity.
    """
    unit = NUMBERS[name].bench.factor
    return max(_power_of_ten(values), unit * _power_of_ten(values / unit))


def _power_of_ten(values: Array) -> float:
    """The largest that values are multiples of; at least 1e-9 of the largest one."""
    largest = float(np.abs(values).max())
    if largest == 0:
        return 0.0
    place = math.floor(math.log10(largest))
    for digits in range(9):
        step: float = 10.0 ** (place - digits)
        if np.abs(values / step - np.round(values / step)).max() < 1e-6:
            return step
    return largest * 1e-9


def _rounded(load: float) -> float:
    """A load without the digits below `SAME`, so that equal ones are equal."""
    if load == 0:
        return 0.0
    digits = -math.floor(math.log10(abs(load) * SAME))
    return round(load, digits)
