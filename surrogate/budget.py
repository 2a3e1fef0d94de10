"""How many paths a time budget allows: one is timed first.

Seconds differ from machine to machine; how the kinds of paths compare does not.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

from datagen.errors import InputError
from datagen.pool import Pool, solve_tasks
from datagen.worker import Solve

from .increment import TEST_PATHS, PairTask

FEWEST_PATHS = 16
"""Enough to see whether the equivalent device explains an effect."""

MOST_PATHS = 400
"""What a time budget is turned into at most."""

SOLVING_SHARE = 0.6
"""Of a time budget; the rest is for timing a path, for those that take longer than the
median, and for training."""

TESTED_TIME, SLOPE_TIME = 2.3, 0.45
"""Of the time of a pair on the coarser mesh: a test path on the base's mesh, and a path
at off with its derivatives."""

SLOPES_PER_PATH = 2
"""Paths at off for each of an increment, where no slopes are shipped."""


def one_path(
    tasks: Sequence[PairTask], pool: Pool, workers: int, solve: Solve
) -> float:
    """Seconds of a path of the mean size, as the increment will be.

    Of paths of about the median size, one for each worker at a time: on one machine
    they slow each other down.
    """

    def size(task: PairTask) -> float:
        # Unknowns grow with balloons, and steps of the follower with load steps.
        x, y = (task.variables.index(f"divisions_{axis}") for axis in "xy")
        return task.inputs[x] * task.inputs[y] * max(len(task.before), 1)

    ordered = sorted([t for t in tasks if t.coarser] or tasks, key=size)
    middle = ordered[len(ordered) // 2 :] + ordered[: len(ordered) // 2]
    chosen = [middle[i % len(middle)] for i in range(workers)]
    mean, timed = (
        sum(size(task) for task in some) / len(some) for some in (ordered, chosen)
    )
    # Their first load steps alone, before the clock: workers have to start.
    short = [replace(task, pressure=task.pressure[:1]) for task in chosen]
    try:
        solve_tasks(short, pool, solve, lambda task, row: None)
        began = time.perf_counter()
        solve_tasks(chosen, pool, solve, lambda task, row: None)
        return (time.perf_counter() - began) * mean / timed
    finally:
        pool.close(now=True)


def affordable(
    minutes: float,
    seconds: float,
    workers: int,
    coarser: bool = True,
    slopes: bool = False,
) -> int:
    """Number of paths that a time budget allows.

    Parameters
    ----------
    minutes : float
    seconds : float
        Of a pair on the coarser mesh, or of a path where there is none.
    workers : int
    coarser : bool
        Whether there is one.
    slopes : bool
        Whether slopes are solved, too.
    """
    tested, slope = (TESTED_TIME, SLOPE_TIME) if coarser else (1.0, 2 * SLOPE_TIME)
    seconds *= 1 - TEST_PATHS + TEST_PATHS * tested + SLOPES_PER_PATH * slope * slopes
    fits = int(SOLVING_SHARE * 60 * minutes * workers / max(seconds, 1e-3))
    if fits < FEWEST_PATHS:
        needed = FEWEST_PATHS * seconds / (SOLVING_SHARE * 60 * workers)
        raise InputError(
            "minutes",
            minutes,
            f"at least {needed:.1f}: a path takes {seconds:.0f} s, and {FEWEST_PATHS} "
            "are needed",
            "min",
        )
    return min(fits, MOST_PATHS)
