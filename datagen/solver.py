"""From a problem and its load path to a response."""

from __future__ import annotations

import time
from dataclasses import asdict

import numpy as np

from .continuation import Options, Outcome, PathFollower, StepFailed, gauge
from .equilibrium import Workspace
from .observe import observe
from .problem import Problem
from .response import CONVERGED, OUTPUT_NAMES, Path, Response


def solve(
    problem: Problem,
    path: Path,
    workspace: Workspace | None = None,
    options: Options | None = None,
    explore: bool = False,
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

    Returns
    -------
    Response
        Of one device.  A path that cannot go on keeps what it has; `path_status` and
        `message` say where it stopped and why.
    """
    began = time.perf_counter()
    try:
        follower = PathFollower(problem, workspace, options)
        outcome = follower.run(path.pressure, path.time, explore)
    except StepFailed as failure:  # at rest, before the first load step
        outcome = Outcome().end(failure.status, f"{failure.detail}, at rest")
        return _respond(problem, path.pressure, outcome)
    pressure = path.pressure
    if explore:
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
    limit = np.nan
    if follower.limit is not None:
        limit = gauge(problem, follower.limit.pressure)
    return _respond(problem, pressure, outcome, limit, follower.first_volume, info)


def _respond(
    problem: Problem,
    pressure: np.ndarray,
    outcome: Outcome,
    limit: float = np.nan,
    first_volume: float = 0.0,
    info: dict[str, object] | None = None,
) -> Response:
    """Response of one path; steps without a point carry the path's status."""
    steps = len(pressure)
    values = np.full((1, steps, len(OUTPUT_NAMES)), np.nan)
    states = np.full((1, steps), outcome.status, dtype="U16")
    for i, point in outcome.points:
        values[0, i] = observe(problem, point.x, point.volume - first_volume)
        states[0, i] = CONVERGED
    return Response(
        outputs=OUTPUT_NAMES,
        pressure=np.asarray(pressure, dtype=float)[None],
        values=values,
        std=np.where(np.isfinite(values), 0.0, np.nan),
        status=states,
        path_status=(outcome.status,),
        limit_pressure=np.array([limit]),
        message=(outcome.message,),
        info=info or {},
    )
