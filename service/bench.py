"""Requests in bench units to the project's types: designs, pressures, effects.

The command line and the HTTP interface read the same request in two shapes; what a
value means and which values are allowed is decided here, once for both.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from datagen.device import CASES, LIMITS, Design, named_device
from datagen.errors import InputError
from datagen.units import DESIGN, PRESSURE, Bench, design_to_bench

DEFAULTS: dict[str, float] = {"wall_mm": 0.2, "divisions_x": 1, "divisions_y": 1}
"""Columns that a full design may leave out."""

DEVICES = ("S1", *(f"D8-{m}x{n}" for m in (1, 2, 4, 6) for n in (1, 2)))
"""Named devices that are offered to choose from; any other D8-MxN is taken too."""

MAX_STEPS = 1000
"""Load steps that one request may ask for."""

PRESSURE_RANGE = (-100.0, 10_000.0)
"""kPa.  Full vacuum, and far past the limit pressure of the stiffest design."""


class Words(str):
    """What an error shows in place of a value, as it is and without quotes."""

    def __repr__(self) -> str:
        return str(self)


MISSING = Words("(missing)")


def rounded(value: float) -> float:
    """A bound in bench units without the digits that unit conversion leaves."""
    return float(f"{value:.12g}")


def bounds(column: Bench) -> tuple[float, float]:
    """Lowest and highest value of a design column, in its bench unit."""
    parameter = LIMITS[column.field]
    return (
        rounded(column.from_si(parameter.lower)),
        rounded(column.from_si(parameter.upper)),
    )


def allowed(column: Bench) -> str:
    """What a design column may hold, in words."""
    lower, upper = bounds(column)
    whole = "whole " if LIMITS[column.field].scale == "integer" else ""
    return f"a {whole}number from {lower:g} to {upper:g} {column.unit}".rstrip()


def design_from_bench(
    values: Mapping[str, Any], device: str | None = None, case: int = 1
) -> Design:
    """Design from bench columns, alone or on top of a named device.

    Parameters
    ----------
    values : mapping
        Bench columns (``upper_thickness_um``) and their values.
    device : str, optional
        ``S1`` or ``D8-MxN``: the values replace those of this device.  Without it
        every column is needed, except for those in `DEFAULTS`.
    case : int
        Material case of the named device, 1 to 4.

    Raises
    ------
    InputError
        When a column is unknown or missing, or a value is not allowed.
    """
    for name, value in values.items():
        if name not in DESIGN:
            raise InputError("design", name, ", ".join(DESIGN))
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError(name, value, allowed(DESIGN[name]), DESIGN[name].unit)
    given = {DESIGN[name].field: DESIGN[name].to_si(v) for name, v in values.items()}
    if device is not None:
        return named_device(device, case).with_values(**given)
    for name, column in DESIGN.items():
        if column.field in given:
            continue
        if name not in DEFAULTS:
            raise InputError(name, MISSING, allowed(column))
        given[column.field] = column.to_si(DEFAULTS[name])
    return Design(**given)  # type: ignore[arg-type]  # Design checks divisions itself


def design_columns(design: Design) -> dict[str, float]:
    """A design as bench columns, without the digits that unit conversion leaves."""
    columns = design_to_bench(design.to_dict())
    return {k: v if isinstance(v, int) else rounded(v) for k, v in columns.items()}


def pressure_words() -> str:
    """Which pressures are allowed, in words."""
    low, high = PRESSURE_RANGE
    return f"a number from {low:g} to {high:g} {PRESSURE.unit}"


def count_words() -> str:
    """How many load steps are allowed, in words."""
    return f"1 to {MAX_STEPS} numbers"


def pressures_from_bench(values: Sequence[Any]) -> np.ndarray:
    """Load steps in kPa to Pa.

    Parameters
    ----------
    values : sequence of float, kPa

    Returns
    -------
    (s,) array, Pa

    Raises
    ------
    InputError
        When the list is empty or too long, or a number is not allowed.
    """
    if not 1 <= len(values) <= MAX_STEPS:
        raise InputError(PRESSURE.name, Words(f"{len(values)} numbers"), count_words())
    low, high = PRESSURE_RANGE
    for i, value in enumerate(values):
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not (number and low <= value <= high):
            raise InputError(
                f"{PRESSURE.name}[{i}]",
                value,
                pressure_words(),
                PRESSURE.unit,
            )
    return np.asarray(values, dtype=float) * PRESSURE.factor


def parse_number(text: str) -> float | str:
    """A number where the text is one, else the text, for the check that refuses it."""
    try:
        return float(text)
    except ValueError:
        return text


def parse_settings(settings: Iterable[str]) -> dict[str, Any]:
    """``name=value`` texts to bench columns; ``upper_thickness`` means the bench unit.

    Raises
    ------
    InputError
        When a text has no ``=``, or the name is unknown or given twice.
    """
    by_field = {column.field: name for name, column in DESIGN.items()}
    out: dict[str, Any] = {}
    for text in settings:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals:
            raise InputError("--set", text, "name=value, as in upper_thickness_um=80")
        column = by_field.get(name, name)
        if column not in DESIGN:
            raise InputError("--set", name, ", ".join(DESIGN))
        if column in out:
            raise InputError("--set", name, "each column at most once")
        out[column] = parse_number(value)
    return out


def parse_pressures(text: str) -> list[float | str]:
    """``0,10,20`` to a list, kPa."""
    return [parse_number(part.strip()) for part in text.split(",")]


def parse_effects(texts: Iterable[str]) -> dict[str, dict[str, float]]:
    """``name:param=value,...`` texts to parameters by effect, in the effect's units.

    Raises
    ------
    InputError
        When a text has another shape, a value is not a finite number, or an effect
        or parameter is given twice.
    """
    shape = "name:parameter=value,..., as in self_weight:density=1000"
    out: dict[str, dict[str, float]] = {}
    for text in texts:
        name, colon, rest = (part.strip() for part in text.partition(":"))
        if not name or name in out or bool(colon) != bool(rest):
            raise InputError("--effect", text, f"{shape}; each effect at most once")
        out[name] = {}
        for item in filter(None, rest.split(",")):
            parameter, equals, value = (part.strip() for part in item.partition("="))
            if not equals or not parameter or parameter in out[name]:
                raise InputError("--effect", text, shape)
            number = parse_number(value)
            if not isinstance(number, float) or not math.isfinite(number):
                raise InputError(f"{name}.{parameter}", number, "a finite number")
            out[name][parameter] = number
    return out


def check_acting(effects: Mapping[str, Mapping[str, float]]) -> None:
    """Refuse effects that were named and left at their off values.

    Raises
    ------
    InputError
        When an effect has no parameter.
    """
    for name, values in effects.items():
        if not values:
            raise InputError(
                "--effect",
                name,
                f"{name}:parameter=value, without which it changes nothing (`pba "
                f"effects show {name}` lists its parameters), or --sensitivities",
            )


def check_case(case: Any) -> int:
    """The material case as a whole number.

    Raises
    ------
    InputError
        When it is none of the published cases.
    """
    if isinstance(case, bool) or case not in CASES:
        raise InputError("case", case, "1, 2, 3 or 4")
    return int(case)


def plain(value: Any) -> Any:
    """Data for JSON: NumPy numbers and arrays as Python's, no NaN, text for the rest.

    JSON has no NaN and no infinity; null stands for both.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if isinstance(value, (int, str, bool, type(None))) else str(value)
