"""How far an answer is from that of a much finer mesh, estimated from a coarser one.

The path is solved again on a coarser mesh (`levels.COARSER`), at the pressures of
its load steps.  With v the values, w those of the coarser mesh, the estimate is

    e(s) = k (max_{t <= s} |v(t) - w(t)|  +  c S(s))

for every output.  The maximum runs over the load steps up to s, because a difference
may change its sign on the way; the second term is there because two meshes may agree by
accident.  S is the largest amount of w, over all points of the coarser path up to s,
whatever the load steps are; of tip and angle, which are small where the layers'
bendings cancel, what drives their errors (`scale_of`).  k and c are calibrated for each
level and output against the fine mesh, on designs drawn at random from the default
design space (``make mesh-error``): k is the conformal quantile (Lei, G'Sell, Rinaldo,
Tibshirani and Wasserman 2018, J. Am. Stat. Assoc. 113, 1094) over designs of the
largest ratio of true error and bracket on a path, so that at a new design the bound
holds at all its load steps with the stated probability.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import astuple, dataclass
from functools import lru_cache
from pathlib import Path as FilePath

import numpy as np

from .continuation import PathFollower
from .control import StepFailed
from .device import Design
from .equilibrium import Workspace
from .errors import FileError
from .journey import gauge
from .levels import COARSER, LEVELS
from .observe import Instruments
from .problem import Problem
from .response import CONVERGED, OUTPUT_NAMES, Path, Response

Array = np.ndarray

FACTORS = FilePath(__file__).with_name("mesh_error.json")
"""Written by ``make mesh-error``."""

PAST_LIMIT = 1.25
"""Of a limit pressure: how far the coarser mesh looks for its own."""


def scale_of(largest: Array, design: Design) -> Array:
    """S of the estimate.

    Tip and angle err by what the edges of all balloons, as hinges, err in their turn.
    That goes with the inflation, both ways, and the number of balloons, once more along
    the strip, as shorter ones have fewer elements each: of powers of the design's
    numbers and lengths these tell best what tip and angle miss on random designs.

    Parameters
    ----------
    largest : (s, m) array, SI
        Largest amount on the coarser path up to each load step.
    design : Design

    Returns
    -------
    (s, m) array, SI
    """
    scale = np.array(largest, dtype=float)
    column = OUTPUT_NAMES.index
    blown = largest[:, [column("inflation"), column("inflation_lower")]].sum(axis=1)
    moved = blown * design.divisions_x**2 * design.divisions_y
    scale[:, column("tip_deflection")] = moved
    scale[:, column("bending_angle")] = moved / design.length
    return scale


def bracket(values: Array, coarse: Array, scale: Array, floor: Array) -> Array:
    """The estimate over its factor k.

    Parameters
    ----------
    values, coarse : (s, m) arrays, SI
        On the level's own mesh and on the coarser one; no NaN.
    scale : (s, m) array, SI
        See `scale_of`.
    floor : (m,) array
        c.

    Returns
    -------
    (s, m) array, SI; never smaller than at the step before.
    """
    difference = np.maximum.accumulate(np.abs(values - coarse), axis=0)
    found: Array = difference + floor * scale
    return found


@dataclass(frozen=True)
class Factors:
    """Calibrated numbers of one mesh level.

    Parameters
    ----------
    factor, floor : (m,) arrays
        k and c of every output, in the order of `OUTPUT_NAMES`.
    limit_factor, limit_floor : float
        The same for the limit pressure.
    """

    factor: Array
    floor: Array
    limit_factor: float
    limit_floor: float

    def bound(self, values: Array, coarse: Array, scale: Array) -> Array:
        """The estimate along one path, (s, m), SI; arguments as of `bracket`."""
        bound: Array = self.factor * bracket(values, coarse, scale, self.floor)
        return bound

    def limit_bound(self, limit: float, coarse: float) -> float:
        """The estimate for a limit pressure, Pa; NaN where there is none."""
        return self.limit_factor * (abs(limit - coarse) + self.limit_floor * limit)


def calibrated_meshes(level: str) -> tuple[list[float], list[float]]:
    """What the factors of a level belong to: its own mesh and the coarser one."""
    return list(astuple(LEVELS[level])[1:]), list(astuple(COARSER[level])[1:])


@lru_cache(maxsize=1)
def _calibration() -> Mapping[str, Factors]:
    """Factors by level.

    Raises
    ------
    FileError
        When the file is missing, damaged, or belongs to other meshes.
    """
    try:
        levels = json.loads(FACTORS.read_text())["levels"]
        found = {}
        for name in LEVELS:
            entry = levels[name]
            if (entry["mesh"], entry["coarser"]) != calibrated_meshes(name):
                raise FileError(FACTORS, f"is of another {name} mesh: make mesh-error")
            pairs = np.array([entry["outputs"][output] for output in OUTPUT_NAMES])
            limit = entry["limit_pressure"]
            found[name] = Factors(pairs[:, 0], pairs[:, 1], limit[0], limit[1])
    except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
        words = f"is not a calibration ({error}): make mesh-error"
        raise FileError(FACTORS, words) from error
    return found


def calibrated_on() -> int:
    """Random designs that the factors were calibrated on."""
    return int(json.loads(FACTORS.read_text())["designs"])


def factors(level: str) -> Factors:
    """The calibrated numbers of a mesh level, see `_calibration`."""
    return _calibration()[level]


@dataclass(frozen=True)
class Comparison:
    """A path on the coarser mesh, at the load steps of the answer.

    Parameters
    ----------
    coarse : (s, m) array, SI
        Its outputs.
    largest : (s, m) array, SI
        Their largest amount up to each load step.
    end : float, Pa
        The limit pressure, or where the path ended without one.
    """

    coarse: Array
    largest: Array
    end: float


def follow(
    problem: Problem,
    targets: Array,
    time: Array | None = None,
    workspace: Workspace | None = None,
) -> Comparison:
    """Follow a problem of the coarser mesh through gauge pressures, Pa.

    Where it ends before, its last values are held: all that changes from there on in
    the answer then counts as error.  A path that fails at rest has zeros.
    """
    shape = (len(targets), len(OUTPUT_NAMES))
    coarse, largest = np.full(shape, np.nan), np.zeros(shape)
    end = 0.0
    try:
        follower = PathFollower(problem, workspace)
        outcome = follower.run(targets, time, keep_all=True)
        instruments = Instruments(problem)
        for step, point in outcome.points:
            values = instruments.read(point.x, point.volume - follower.first_volume)
            pressure = gauge(problem, point.pressure)
            largest[step:] = np.maximum(largest[step:], np.abs(values))
            # Of the points on the way to a load step the last one is there.
            if np.isclose(pressure, targets[step], rtol=1e-9, atol=1e-6):
                coarse[step] = values
        end = gauge(problem, (follower.limit or follower.point).pressure)
    except StepFailed:  # at rest: there is nothing to compare with
        pass
    for late in np.flatnonzero(np.isnan(coarse).any(axis=1)):
        coarse[late] = coarse[late - 1] if late else 0.0
    return Comparison(coarse, largest, end)


def _targets(path: Path, response: Response) -> tuple[Array, Array, int]:
    """Where the coarser mesh is to go, and how many load steps that is.

    Returns
    -------
    pressure : (t,) array, Pa
        Of the load steps before a limit point; then past it, where there is one.
    time : (t,) array, s
    steps : int
    """
    pressure, limit = response.pressure[0], float(response.limit_pressure[0])
    reached = response.status[0] == CONVERGED
    if np.isfinite(limit):
        reached = reached & (pressure < limit)
    steps = int(np.cumprod(reached).sum())
    asked = np.append(0.0, path.pressure)
    time = np.arange(len(asked), dtype=float)
    if path.time is not None:
        time = np.append(min(0.0, path.time[0] - 1.0), path.time)
    explored = not np.array_equal(pressure, path.pressure)
    # An explored path rises evenly between the load steps that it was asked for.
    when = np.interp(pressure, asked, time) if explored else time[1:]
    targets, when = pressure[:steps], when[:steps]
    if limit > 0:
        beyond = PAST_LIMIT * limit
        turn = int(np.argmax(asked >= limit)) if explored else steps + 1
        pace = (time[turn] - time[turn - 1]) / (asked[turn] - asked[turn - 1])
        targets = np.append(targets, beyond)
        when = np.append(when, time[turn - 1] + pace * (beyond - asked[turn - 1]))
    return targets, when, steps


def estimate(
    problem: Problem,
    path: Path,
    response: Response,
    level: str,
    workspace: Workspace | None = None,
) -> tuple[Array, Array]:
    """Bounds of the discretisation error of one response.

    Parameters
    ----------
    problem : Problem
        That of the response, on the coarser mesh.
    path : Path
        What the response was asked for.
    response : Response
        Of one device.
    level : str
        Mesh level of the response.
    workspace : Workspace, optional
        For problems of the coarser mesh.

    Returns
    -------
    mesh_error : (1, s, m) array, SI
        NaN where there is no value, and from a limit point on: the pressure names no
        state there.  Where the coarser path ends before, its last value is held, and
        all that changes from there on counts; such steps lie within the error of the
        limit pressure, where the factors were not calibrated.
    limit_pressure_error : (1,) array, Pa
        NaN where no limit point was met.  A coarser path that does not turn counts
        with the pressure at which it ended.

    Raises
    ------
    FileError
        When the calibration is not there.
    """
    known = factors(level)
    targets, time, steps = _targets(path, response)
    error = np.full(response.values.shape, np.nan)
    if not len(targets):  # nothing was reached
        return error, np.full(1, np.nan)
    other = follow(problem, targets, time, workspace)
    scale = scale_of(other.largest[:steps], problem.design)
    error[0, :steps] = known.bound(
        response.values[0, :steps], other.coarse[:steps], scale
    )
    limit = known.limit_bound(float(response.limit_pressure[0]), other.end)
    return error, np.array([limit])
