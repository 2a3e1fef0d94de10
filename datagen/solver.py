"""From a problem and its load path to a response."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from .chart import Point
from .continuation import PathFollower
from .control import Options, Outcome, StepFailed
from .equilibrium import Workspace
from .journey import gauge
from .observe import Instruments
from .problem import Problem
from .response import CONVERGED, OUTPUT_NAMES, Path, Response
from .sensitivity import Direction

FAR_TURN = np.radians(120)
"""Bending angle at which a path past its limit point ends, rad."""


def solve(
    problem: Problem,
    path: Path,
    workspace: Workspace | None = None,
    options: Options | None = None,
    explore: bool = False,
    directions: Sequence[Direction] = (),
    beyond: bool = False,
) -> Response:
    """Follow one problem along its load steps.

    Parameters
    ----------
    problem : Problem
    path : Path
        Gauge pressures in the order in which they are applied.
    workspace : Workspace, optional
        Keeps patterns and analyses between problems of one topology.
    options : Options, optional
    explore : bool
        Keep every equilibrium on the way to the last pressure, at the follower's
        own steps, and the limit point where there is one.
    directions : sequence of Direction, optional
        Parameters by which every value is differentiated, see `Sensitivity`.
    beyond : bool
        Explore past a limit point, too, until the strip has turned by `FAR_TURN`.

    Returns
    -------
    Response
        Of one device.  A path that cannot go on keeps what it has; `path_status` and
        `message` say where it stopped and why.
    """
    began = time.perf_counter()
    names = tuple(direction.name for direction in directions)
    try:
        follower = PathFollower(problem, workspace, options, directions)
        instruments = Instruments(problem)

        def far_enough(point: Point) -> bool:
            change = point.volume - follower.first_volume
            angle = instruments.read(point.x, change)[
                OUTPUT_NAMES.index("bending_angle")
            ]
            return bool(abs(angle) >= FAR_TURN)

        outcome = follower.run(
            path.pressure, path.time, explore, far_enough if beyond else None
        )
    except StepFailed as failure:  # at rest, before the first load step
        outcome = Outcome().end(failure.status, f"{failure.detail}, at rest")
        return _respond(problem, path.pressure, outcome, names=names)
    pressure = path.pressure
    if explore or beyond:
        pressure = np.array(
            [gauge(problem, point.pressure) for _, point in outcome.points]
        )
        if outcome.status == "completed":
            pressure[-1] = path.pressure[-1]
        outcome.points = [(i, point) for i, (_, point) in enumerate(outcome.points)]
    info = {
        "unknowns": follower.equations.unknowns,
        "seconds": time.perf_counter() - began,
        **asdict(follower.counters),
    }
    limit = met = np.nan
    if follower.limit is not None:
        limit = gauge(problem, follower.limit.pressure)
    if follower.self_contact is not None:
        met = gauge(problem, follower.self_contact)
    rest = follower.first_volume
    return _respond(problem, pressure, outcome, limit, met, rest, info, names)


def _respond(
    problem: Problem,
    pressure: np.ndarray,
    outcome: Outcome,
    limit: float = np.nan,
    met: float = np.nan,
    first_volume: float = 0.0,
    info: dict[str, object] | None = None,
    names: tuple[str, ...] = (),
) -> Response:
    """Response of one path; steps without a point carry the path's status."""
    steps = len(pressure)
    values = np.full((1, steps, len(OUTPUT_NAMES)), np.nan)
    slopes = np.full((1, steps, len(OUTPUT_NAMES), len(names)), np.nan)
    states = np.full((1, steps), outcome.status, dtype="U16")
    instruments = Instruments(problem)
    for i, point in outcome.points:
        values[0, i] = instruments.read(point.x, point.volume - first_volume)
        states[0, i] = CONVERGED
        if point.jacobian is not None:
            slopes[0, i] = point.jacobian
    return Response(
        outputs=OUTPUT_NAMES,
        pressure=np.asarray(pressure, dtype=float)[None],
        values=values,
        std=np.where(np.isfinite(values), 0.0, np.nan),
        status=states,
        path_status=(outcome.status,),
        limit_pressure=np.array([limit]),
        self_contact_pressure=np.array([met]),
        message=(outcome.message,),
        parameters=names,
        jacobian=slopes if names else None,
        info=info or {},
    )
