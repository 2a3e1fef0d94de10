"""The answer to "what does this device do at these pressures", and who gives it.

The surrogate answers inside its trained range, the finite elements everywhere else.
Command line, HTTP interface and jobs give the same `Answer`, in bench units.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Any, Protocol

import numpy as np

from datagen.device import Design
from datagen.response import Forward, Path, Response
from datagen.units import BY_FIELD, PRESSURE

from .bench import design_columns, rounded

COVERAGE = 0.9
"""Share of finite-element results that the interval of an answer is built to hold."""


class RangeCheck(Protocol):
    """Whether a request is inside the trained range, and why not."""

    @property
    def in_range(self) -> bool: ...

    @property
    def reasons(self) -> tuple[str, ...]: ...

    @property
    def notes(self) -> tuple[str, ...]: ...


class Prediction(Protocol):
    """Central values and the ends of their intervals, (n, s, m) arrays, SI."""

    @property
    def response(self) -> Response: ...

    @property
    def low(self) -> np.ndarray: ...

    @property
    def high(self) -> np.ndarray: ...


class Predictor(Protocol):
    """What the service needs of a surrogate; `surrogate.ensemble.Ensemble` is one."""

    @property
    def version(self) -> str: ...

    @property
    def description(self) -> Mapping[str, Any]: ...

    def predict(
        self, designs: Sequence[Design], paths: Sequence[Path], coverage: float = ...
    ) -> Prediction: ...

    def check(self, design: Design, pressure: np.ndarray) -> RangeCheck: ...


def load_model(folder: FilePath | None) -> Predictor:
    """The ensemble in a folder, or the reference model that the package ships.

    Raises
    ------
    FileError
        When the folder or one of its files is missing or corrupt.
    """
    from surrogate.ensemble import Ensemble, reference_model

    return reference_model() if folder is None else Ensemble.load(folder)


@dataclass(frozen=True)
class Answer:
    """One design along one path, with intervals and where they come from.

    Parameters
    ----------
    design : Design
    pressure : (s,) array, Pa
    outputs : tuple of m str
        SI names of the quantities.
    value, low, high : (s, m) array, SI
        NaN where the path ended before the load step.  The interval of the finite
        elements is the value and its `mesh_error` on both sides; `versions` adds what
        the measurements of adopted effects left open.
    source : str
        ``surrogate`` or ``fem``.
    in_range : bool
        Whether the surrogate was trained for this design and these pressures.
    reasons : tuple of str
        Why not; empty inside the range.
    notes : tuple of str
        What else is worth knowing, as where the members of the ensemble disagree.
    model_version : str
    status, message : str
        How the path ended, and where and why it stopped before its last load step.
    limit_pressure : float, Pa
        NaN where it was not met.
    info : mapping
        What the finite elements add: ``unknowns``, ``seconds``, and
        ``mesh_error_seconds``, which come on top.
    parameters : tuple of k str
        Names of what `jacobian` differentiates by.
    jacobian : (s, m, k) array, SI, or None
    mesh_error : (s, m) array, SI, or None
        Bound of the discretisation error of the finite elements, see
        `datagen.mesh_error`; NaN where there is none.
    limit_pressure_error : float, Pa
        The same of the limit pressure.
    self_contact_pressure : float, Pa
        Where neighbouring balloons met; NaN where they did not.
    effects : tuple of str
        Adopted effects that the model which answered has in it.
    """

    design: Design
    pressure: np.ndarray
    outputs: tuple[str, ...]
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    source: str
    in_range: bool
    reasons: tuple[str, ...]
    notes: tuple[str, ...]
    model_version: str
    status: str = "completed"
    message: str = ""
    limit_pressure: float = math.nan
    info: Mapping[str, Any] = field(default_factory=dict)
    parameters: tuple[str, ...] = ()
    jacobian: np.ndarray | None = None
    mesh_error: np.ndarray | None = None
    limit_pressure_error: float = math.nan
    self_contact_pressure: float = math.nan
    effects: tuple[str, ...] = ()

    def _columns(self) -> dict[str, tuple[list[float | None], ...]]:
        """Value, low and high by bench name, in bench units."""
        return {
            BY_FIELD[name].name: tuple(
                numbers(array[:, i] / BY_FIELD[name].factor)
                for array in (self.value, self.low, self.high)
            )
            for i, name in enumerate(self.outputs)
        }

    def _end(self) -> dict[str, Any]:
        """How the path ended, and what it took."""
        ends = (
            self.limit_pressure,
            self.limit_pressure_error,
            self.self_contact_pressure,
        )
        limit, error, met = numbers(np.array(ends) / PRESSURE.factor)
        return {
            "status": self.status,
            "message": self.message,
            "limit_pressure_kPa": limit,
            "limit_pressure_error_kPa": error,
            "self_contact_pressure_kPa": met,
            "mesh_error": self._mesh_error(),
            "unknowns": self.info.get("unknowns"),
            "seconds": self.info.get("seconds"),
            "mesh_error_seconds": self.info.get("mesh_error_seconds"),
            "model_version": self.model_version,
            "design": design_columns(self.design),
        }

    def _mesh_error(self) -> dict[str, list[float | None]] | None:
        """Bounds by bench name, in bench units."""
        if self.mesh_error is None:
            return None
        return {
            BY_FIELD[name].name: numbers(self.mesh_error[:, i] / BY_FIELD[name].factor)
            for i, name in enumerate(self.outputs)
        }

    def _origin(self) -> dict[str, Any]:
        """Who answers, and why not the surrogate."""
        return {
            "source": self.source,
            "in_range": self.in_range,
            "reasons": list(self.reasons),
            "notes": list(self.notes),
            "effects": list(self.effects),
        }

    def to_dict(self) -> dict[str, Any]:
        """The body of ``/v1/predict``: each quantity as value, low and high lists."""
        quantities = {
            name: dict(zip(("value", "low", "high"), columns, strict=True))
            for name, columns in self._columns().items()
        }
        pressure = {"pressure_kPa": _kilopascal(self.pressure)}
        return pressure | quantities | self._origin() | self._end()

    def to_columns(self) -> dict[str, Any]:
        """The JSON of ``pba predict``: flat lists, ``_low`` and ``_high`` beside."""
        return self._lists(interval=True) | self._origin() | self._end()

    def to_solution(self) -> dict[str, Any]:
        """The JSON of ``pba solve``, where nobody asked the surrogate."""
        return self._lists(interval=False) | self._end() | self._sensitivities()

    def _sensitivities(self) -> dict[str, Any]:
        """Derivatives by quantity and parameter, in bench unit a bench unit."""
        if self.jacobian is None:
            return {}
        found: dict[str, dict[str, list[float | None]]] = {}
        for i, output in enumerate(self.outputs):
            quantity = BY_FIELD[output]
            columns = found.setdefault(quantity.name, {})
            for k, name in enumerate(self.parameters):
                by = BY_FIELD.get(name)  # an effect's parameter stays in its own unit
                factor = (by.factor if by else 1.0) / quantity.factor
                columns[by.name if by else name] = numbers(
                    self.jacobian[:, i, k] * factor
                )
        return {"sensitivities": found}

    def _lists(self, interval: bool) -> dict[str, Any]:
        lists: dict[str, Any] = {"pressure_kPa": _kilopascal(self.pressure)}
        for name, (value, low, high) in self._columns().items():
            lists[name] = value
            if interval:
                lists |= {f"{name}_low": low, f"{name}_high": high}
        return lists


def _kilopascal(pressure: np.ndarray) -> list[float]:
    return [rounded(p) for p in pressure / PRESSURE.factor]


def numbers(values: np.ndarray) -> list[float | None]:
    """A list for JSON, which has no NaN: None stands for a step not reached."""
    return [float(v) if math.isfinite(v) else None for v in values]


def surrogate_answer(
    model: Predictor, design: Design, pressure: np.ndarray, check: RangeCheck
) -> Answer:
    """What the surrogate predicts, with its calibrated interval.

    Parameters
    ----------
    model : Predictor
    design : Design
    pressure : (s,) array, Pa
    check : RangeCheck
        What `model` says of this request.
    """
    prediction = model.predict([design], [Path(pressure)], coverage=COVERAGE)
    response = prediction.response
    return Answer(
        design,
        pressure,
        response.outputs,
        response.values[0],
        prediction.low[0],
        prediction.high[0],
        "surrogate",
        check.in_range,
        tuple(check.reasons),
        tuple(check.notes),
        model.version,
        response.path_status[0],
        response.message[0],
        float(response.limit_pressure[0]),
    )


def fem_answer(
    model: Forward,
    version: str,
    design: Design,
    pressure: np.ndarray,
    in_range: bool = True,
    reasons: Sequence[str] = (),
    sensitivities: bool | Sequence[str] = False,
    beyond: bool = False,
    mesh_error: bool = True,
) -> Answer:
    """What the finite elements compute, with a bound of its discretisation error.

    Parameters
    ----------
    model : Forward
        The finite-element model.
    version : str
        What made the numbers.
    design : Design
    pressure : (s,) array, Pa
    in_range, reasons
        What the surrogate said of this request.
    sensitivities : bool or sequence of str
        Differentiate, too, by all or by those named; `model` must know how, as
        `datagen.model.Model` does.  Not by name where `beyond` is asked for.
    beyond : bool
        At the solver's own steps, too, and on past a limit point where the path turns
        before.
    mesh_error : bool
        Bound the discretisation error; without it the interval has no width.
    """
    start = time.perf_counter()
    options = {"sensitivities": sensitivities, "mesh_error": mesh_error}
    wanted = {name: asked for name, asked in options.items() if asked}
    if beyond:
        response = model.explore(design, pressure, beyond=True, **wanted)  # type: ignore[attr-defined]
        pressure = response.pressure[0]
    else:
        response = model([design], [Path(pressure)], **wanted)
    value = response.values[0]
    error = None if response.mesh_error is None else response.mesh_error[0]
    half = 0.0 if error is None else error
    limits = response.limit_pressure_error
    meetings = response.self_contact_pressure
    met = math.nan if meetings is None else float(meetings[0])
    info = {"seconds": time.perf_counter() - start} | response.info
    return Answer(
        design,
        pressure,
        response.outputs,
        value,
        value - half,
        value + half,
        "fem",
        in_range,
        tuple(reasons),
        _notes_on(met),
        version,
        response.path_status[0],
        response.message[0],
        float(response.limit_pressure[0]),
        info,
        response.parameters,
        None if response.jacobian is None else response.jacobian[0],
        error,
        math.nan if limits is None else float(limits[0]),
        met,
    )


def _notes_on(met: float) -> tuple[str, ...]:
    """What is to be said of balloons that met at a pressure, Pa; NaN: they did not."""
    if math.isnan(met):
        return ()
    return (
        f"Neighbouring balloons meet at {met / PRESSURE.factor:.3g} kPa. The model "
        "does not resist that: beyond, they grow into each other.",
    )
