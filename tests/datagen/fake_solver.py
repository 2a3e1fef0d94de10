"""Stand-ins for the finite elements: fast, deterministic, and able to misbehave.

Top-level functions, so that worker processes find them by name.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from datagen.response import OUTPUT_NAMES
from datagen.worker import Row, Task, step_codes

VERSION = "fake-1"


class Here(Executor):
    """Runs a task where it is submitted; counts them."""

    def __init__(self) -> None:
        self.rows: list[int] = []

    def submit(self, function: Callable[..., Any], *args: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.rows.append(args[-1].row)
        try:
            future.set_result(function(*args))
        except ArithmeticError as error:
            future.set_exception(error)
        return future


def solve_fake(task: Task) -> Row:
    """A path of pseudo-random length and values that the design alone decides."""
    seed = np.frombuffer(np.array(task.inputs).tobytes(), dtype=np.uint32)
    random = np.random.default_rng(seed)
    steps = int(random.integers(3, 9))
    pressure = task.max_pressure * np.arange(1, steps + 1) / steps
    values = random.standard_normal((steps, len(OUTPUT_NAMES))) * 1e-4
    slopes = random.standard_normal((steps, len(OUTPUT_NAMES), 2))
    slopes[-1] = np.nan  # as at a limit point
    ending = ("completed", "limit_point", "inverted_element")[task.row % 3]
    return Row(
        row=task.row,
        outputs=OUTPUT_NAMES,
        pressure=pressure,
        values=values,
        status=step_codes(["converged"] * steps),
        path_status=ending,
        limit_pressure=float(pressure[-1]) if ending == "limit_point" else np.nan,
        message="" if ending == "completed" else f"stopped at step {steps}: Ω < 0",
        parameters=("wall", "upper_modulus") if task.sensitivities else (),
        jacobian=slopes if task.sensitivities else None,
    )


def solve_slowly(task: Task) -> Row:
    """The same, in a few milliseconds that differ from row to row."""
    time.sleep(0.002 + 0.001 * (task.row % 5))
    return solve_fake(task)


def solve_with_bug(task: Task) -> Row:
    """Row 3 has a bug."""
    if task.row == 3:
        raise ZeroDivisionError("radius of row three")
    return solve_slowly(task)


def solve_the_next(task: Task) -> Row:
    """The answer of another row."""
    return solve_fake(replace(task, row=task.row + 1))


def solve_only_bugs(task: Task) -> Row:
    raise ZeroDivisionError(f"radius of row {task.row}")


def solve_unfinished(task: Task) -> Row:
    """A converged step without a value, which no solver may return."""
    row = solve_fake(task)
    row.values[0, 0] = np.nan
    return Row.from_dict(row.to_dict())


def solve_or_die_once(task: Task) -> Row:
    """Row 3 takes its process down the first time; `level` names a folder for it."""
    mark = Path(task.level, "died")
    if task.row == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return solve_slowly(task)


def solve_or_die(task: Task) -> Row:
    """Row 3 always takes its process down."""
    if task.row == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return solve_slowly(task)


def solve_and_say_threads(task: Task) -> Row:
    """The number of BLAS threads as the first value."""
    from threadpoolctl import threadpool_info

    threads = [pool["num_threads"] for pool in threadpool_info()]
    row = solve_fake(task)
    row.values[0, 0] = max(threads, default=0)
    return row


def solve_for_ever(task: Task) -> Row:
    """Rows from 4 on never end."""
    if task.row >= 4:
        time.sleep(3600)
    return solve_fake(task)
