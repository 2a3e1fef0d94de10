"""The types that travel: load paths, responses, and the protocol of a forward model.

One :class:`Response` serves the finite-element model (standard deviation zero), the
surrogate ensemble (its spread) and a measurement (its noise).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from .errors import InputError

if TYPE_CHECKING:
    from .device import Design
    from .space import Space

Array = np.ndarray


@dataclass(frozen=True)
class Output:
    """One predicted quantity: SI name, SI unit, and what it is in words."""

    name: str
    unit: str
    long_name: str


OUTPUTS: tuple[Output, ...] = (
    Output("tip_deflection", "m", "u_z at x = L, y = 0, mid-thickness"),
    Output("bending_angle", "rad", "rotation about y of the strip beyond the balloons"),
    Output("inflation", "m", "rise of the roof over the edge of the balloon"),
    Output(
        "inflation_lower", "m", "descent of the floor under the edge of the balloon"
    ),
    Output("cavity_volume", "m3", "change of the total cavity volume"),
)
OUTPUT_NAMES = tuple(output.name for output in OUTPUTS)

CONVERGED = "converged"
"""Step status of an equilibrium that was found; any other status says why not."""

PATH_STATUS: dict[str, str] = {
    "completed": "every load step was reached",
    "limit_point": "the equilibrium path turns or loses its stability: a balloon grows "
    "without bound",
    "inverted_element": "an element turned inside out and smaller steps did not help",
    "step_too_small": "Newton's method failed down to the smallest load step",
    "step_limit": "the path needed more steps than allowed",
    "contact": "roof and floor touch, which this model does not resist",
}
"""Every status a path can end with, and what it means."""


@dataclass(frozen=True)
class Path:
    """Load steps in the order in which they are applied.

    Parameters
    ----------
    pressure : (s,) array, Pa
        Gauge pressure at each load step.
    time : (s,) array, s, optional
        Time of each load step, for laws with history; strictly increasing.
        One second a step where it is not given.
    """

    pressure: Array
    time: Array | None = None

    def __post_init__(self) -> None:
        pressure = np.atleast_1d(np.asarray(self.pressure, dtype=float))
        if pressure.ndim != 1 or pressure.size == 0:
            raise InputError(
                "pressure", pressure.shape, "a list of one or more numbers"
            )
        if not np.isfinite(pressure).all():
            bad = float(pressure[~np.isfinite(pressure)][0])
            raise InputError("pressure", bad, "finite numbers", "Pa")
        object.__setattr__(self, "pressure", pressure)
        if self.time is not None:
            time = np.asarray(self.time, dtype=float)
            rising = np.isfinite(time).all() and (np.diff(time) > 0).all()
            if time.shape != pressure.shape or not rising:
                words = "one finite, strictly increasing time a load step"
                raise InputError("time", list(time), words, "s")
            object.__setattr__(self, "time", time)


@dataclass(frozen=True)
class Response:
    """What a set of devices does along its load paths.

    Parameters
    ----------
    outputs : tuple of str
        Names of the m quantities, in the order of the last axis of `values`.
    pressure : (n, s) array, Pa
        Gauge pressure of each load step; NaN pads paths with fewer steps.
    values : (n, s, m) array, SI
        NaN where a step was not reached.
    std : (n, s, m) array, SI
        Standard deviation: 0 for FEM, spread of an ensemble, noise of a measurement.
    status : (n, s) array of str
        ``converged``, or the reason why the step has no value.
    path_status : tuple of n str
        A key of `PATH_STATUS` for each path.
    limit_pressure : (n,) array, Pa
        Pressure at which the equilibrium path turns; NaN where it was not met.
    message : tuple of n str
        Where a path stopped and why, in words; empty where it was completed.
    info : dict
        What the producer wants to add (``unknowns``, ``seconds``, ...).
    parameters : tuple of k str
        Names of what `jacobian` differentiates by.
    jacobian : (n, s, m, k) array, SI, or None
        Derivatives of the values at fixed gauge pressure; NaN where there is no value.
    mesh_error : (n, s, m) array, SI, or None
        Bound of the discretisation error of every value, see `mesh_error`; NaN where
        there is no value, and from a limit point on.
    limit_pressure_error : (n,) array, Pa, or None
        The same of the limit pressure; NaN where it was not met.
    self_contact_pressure : (n,) array, Pa, or None
        Where roofs or floors of neighbouring balloons first met, which nothing in the
        model resists; NaN where they did not, None where nobody looked.
    """

    outputs: tuple[str, ...]
    pressure: Array
    values: Array
    std: Array
    status: Array
    path_status: tuple[str, ...]
    limit_pressure: Array
    message: tuple[str, ...]
    info: dict[str, Any] = field(default_factory=dict)
    parameters: tuple[str, ...] = ()
    jacobian: Array | None = None
    mesh_error: Array | None = None
    limit_pressure_error: Array | None = None
    self_contact_pressure: Array | None = None

    def __post_init__(self) -> None:
        n, s = self.pressure.shape
        m = len(self.outputs)
        if self.values.shape != (n, s, m) or self.std.shape != (n, s, m):
            raise InputError("values", self.values.shape, f"shape {(n, s, m)}")
        if self.status.shape != (n, s) or len(self.path_status) != n:
            raise InputError("status", self.status.shape, f"shape {(n, s)}")
        wanted = (n, s, m, len(self.parameters))
        if self.jacobian is not None and self.jacobian.shape != wanted:
            raise InputError("jacobian", self.jacobian.shape, f"shape {wanted}")
        if self.mesh_error is not None and self.mesh_error.shape != (n, s, m):
            raise InputError("mesh_error", self.mesh_error.shape, f"shape {(n, s, m)}")
        limit = self.limit_pressure_error
        if limit is not None and limit.shape != (n,):
            raise InputError("limit_pressure_error", limit.shape, f"shape {(n,)}")
        met = self.self_contact_pressure
        if met is not None and met.shape != (n,):
            raise InputError("self_contact_pressure", met.shape, f"shape {(n,)}")

    def output(self, name: str) -> Array:
        """(n, s) array of one quantity, SI."""
        return self.values[:, :, self.outputs.index(name)]


class Forward(Protocol):
    """A model of the device: the FEM `Model` and the surrogate `Ensemble` are two."""

    @property
    def space(self) -> Space: ...

    @property
    def outputs(self) -> tuple[str, ...]: ...

    def __call__(self, designs: Sequence[Design], paths: Sequence[Path]) -> Response:
        """Predict each design along its own path."""
        ...
