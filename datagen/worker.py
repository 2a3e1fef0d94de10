"""What runs in a worker: one design in, one finished path out.

Only names and numbers cross the border between processes: a :class:`Task` says which
model and which design, a :class:`Row` brings back the path.  This module is imported by
every worker and stays light: numpy alone until the first path is solved.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import InputError
from .response import CONVERGED, PATH_STATUS, Response

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

Array = np.ndarray

NO_STEP = "no_step"
"""Step status of the padding after the last load step of a path."""

STEP_STATUS = (CONVERGED, NO_STEP, *(key for key in PATH_STATUS if key != "completed"))
"""Step statuses; the place in this tuple is the code in `Dataset.status`."""

PROPER_ENDS = ("completed", "limit_point")
"""Path statuses of paths that went as far as they can; any other one failed."""

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Task:
    """One row of a dataset to be solved.

    Parameters
    ----------
    row : int
        Place in the dataset.
    variables : tuple of d str
        Names of the inputs; a parameter of an effect is ``effect.parameter``.
    inputs : tuple of d float, SI
    effects : tuple of str
        Active effects, by name.
    level : str
        Mesh level.
    max_pressure : float, Pa
    sensitivities : bool
        Whether the outputs are differentiated, too.
    """

    row: int
    variables: tuple[str, ...]
    inputs: tuple[float, ...]
    effects: tuple[str, ...]
    level: str
    max_pressure: float
    sensitivities: bool = False

    def split(self) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
        """The design's variables, and the parameters of each effect, SI."""
        return split_inputs(self.variables, self.inputs, self.effects)


def split_inputs(
    variables: tuple[str, ...],
    inputs: tuple[float, ...] | Array,
    effects: tuple[str, ...],
) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Sort inputs into design variables and ``{effect: {parameter: value}}``, SI."""
    design: dict[str, float] = {}
    parameters: dict[str, dict[str, float]] = {effect: {} for effect in effects}
    for name, value in zip(variables, inputs, strict=True):
        effect, dot, parameter = name.rpartition(".")
        if dot:
            parameters[effect][parameter] = float(value)
        else:
            design[name] = float(value)
    return design, parameters


@dataclass(frozen=True, eq=False)
class Row:
    """One finished path.

    Parameters
    ----------
    row : int
        Place in the dataset.
    outputs : tuple of m str
    pressure : (s,) array, Pa
    values : (s, m) array, SI
    status : (s,) int8 array
        Places in `STEP_STATUS`.
    path_status : str
        A key of `PATH_STATUS`.
    limit_pressure : float, Pa
        NaN where no limit point was met.
    message : str
    parameters : tuple of k str
        What the outputs are differentiated by; empty where they are not.
    jacobian : (s, m, k) array, SI, or None

    Raises
    ------
    InputError
        When shapes do not fit, a status is unknown, or a converged step has no value.
    """

    row: int
    outputs: tuple[str, ...]
    pressure: Array
    values: Array
    status: Array
    path_status: str
    limit_pressure: float
    message: str
    parameters: tuple[str, ...] = ()
    jacobian: Array | None = None

    def __post_init__(self) -> None:
        steps = self.pressure.shape[0] if self.pressure.ndim == 1 else -1
        if self.values.shape != (steps, len(self.outputs)):
            raise InputError(
                "values", self.values.shape, f"shape {(steps, len(self.outputs))}"
            )
        wanted = (*self.values.shape, len(self.parameters))
        if self.jacobian is not None and self.jacobian.shape != wanted:
            raise InputError("jacobian", self.jacobian.shape, f"shape {wanted}")
        if self.status.shape != (steps,):
            raise InputError("status", self.status.shape, f"shape {(steps,)}")
        if self.path_status not in PATH_STATUS:
            raise InputError("path_status", self.path_status, ", ".join(PATH_STATUS))
        converged = self.status == 0
        if (converged[1:] & ~converged[:-1]).any():
            raise InputError("status", "mixed", "converged steps before any other")
        known = np.isfinite(self.pressure) & np.isfinite(self.values).all(axis=1)
        if (converged & ~known).any():
            step = int(np.flatnonzero(converged & ~known)[0])
            raise InputError("values", f"step {step}", "finite in every converged step")

    @classmethod
    def from_response(cls, row: int, response: Response) -> Row:
        """Row from the response of one path; trailing padding is dropped."""
        if len(response.path_status) != 1:
            raise InputError("response", len(response.path_status), "a single path")
        given = np.flatnonzero(np.isfinite(response.pressure[0]))
        steps = int(given[-1]) + 1 if given.size else 0
        return cls(
            row=row,
            outputs=tuple(response.outputs),
            pressure=np.array(response.pressure[0, :steps], dtype=float),
            values=np.array(response.values[0, :steps], dtype=float),
            status=step_codes([str(name) for name in response.status[0, :steps]]),
            path_status=str(response.path_status[0]),
            limit_pressure=float(response.limit_pressure[0]),
            message=str(response.message[0]),
            parameters=response.parameters,
            jacobian=None
            if response.jacobian is None
            else response.jacobian[0, :steps],
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and text, exact through JSON."""
        slopes = {}
        if self.jacobian is not None:
            slopes = {
                "parameters": list(self.parameters),
                "jacobian": self.jacobian.tolist(),
            }
        return slopes | {
            "row": self.row,
            "outputs": list(self.outputs),
            "pressure": self.pressure.tolist(),
            "values": self.values.tolist(),
            "status": [STEP_STATUS[code] for code in self.status],
            "path_status": self.path_status,
            "limit_pressure": self.limit_pressure,
            "message": self.message,
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Row:
        """Inverse of `to_dict`; KeyError, ValueError, TypeError on anything else."""
        outputs = tuple(map(str, data["outputs"]))
        pressure = np.asarray(data["pressure"], dtype=float)
        values = np.asarray(data["values"], dtype=float)
        parameters = tuple(map(str, data.get("parameters", ())))
        jacobian = None
        if parameters:
            jacobian = np.asarray(data["jacobian"], dtype=float)
            jacobian = jacobian.reshape(len(pressure), len(outputs), len(parameters))
        return cls(
            row=int(data["row"]),
            outputs=outputs,
            pressure=pressure,
            values=values.reshape(len(pressure), len(outputs)),
            status=step_codes(data["status"]),
            path_status=str(data["path_status"]),
            limit_pressure=float(data["limit_pressure"]),
            message=str(data["message"]),
            parameters=parameters,
            jacobian=jacobian,
        )


def step_codes(names: list[str]) -> Array:
    """(s,) int8 array of the places of `names` in `STEP_STATUS`."""
    for name in names:
        if name not in STEP_STATUS:
            raise InputError("status", name, ", ".join(STEP_STATUS))
    return np.array([STEP_STATUS.index(name) for name in names], dtype=np.int8)


Solve = Callable[[Task], Row]
"""A top-level function, so that workers find it by its name."""


def solve_row(task: Task) -> Row:
    """Solve one design with the finite elements, up to its highest pressure."""
    from .device import Design
    from .model import Model

    design, parameters = task.split()
    model = Model(effects=task.effects, level=task.level, parameters=parameters)
    response = model.explore(
        Design.from_sample(design), task.max_pressure, task.sensitivities
    )
    return Row.from_response(task.row, response)


def run_task(solve: Solve, task: Task) -> Row:
    """Run `solve` on one thread.

    The order of a threaded sum depends on the number of threads, and so do the last
    bits of the result; on one thread a row is the same wherever it is solved.
    """
    from threadpoolctl import threadpool_limits

    for name in THREAD_VARIABLES:  # for libraries that are loaded from here on
        os.environ.setdefault(name, "1")
    with threadpool_limits(limits=1):  # for those that are here already
        return solve(task)


def start_worker(alive: Connection) -> None:
    """Prepare a worker process of ours.

    `alive` is the reading end of a pipe whose writing end only the parent holds.  It
    closes when the parent stops the workers or dies, ``kill -9`` included; without it
    the workers of a killed parent would wait for work for ever.
    """
    for name in THREAD_VARIABLES:
        os.environ[name] = "1"
    threading.Thread(target=_leave_with_parent, args=(alive,), daemon=True).start()


def _leave_with_parent(alive: Connection) -> None:
    alive.poll(None)  # returns when the pipe is closed: nothing is ever sent
    os._exit(1)
