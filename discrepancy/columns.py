"""Columns of a measurement file: their units, what is allowed, what was meant.

Bench units end here: everything past this file is SI.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from datagen.device import LIMITS
from datagen.units import DESIGN, PRESSURE, QUANTITY, Bench

DEG = math.pi / 180

UNITS: dict[str, dict[str, float]] = {
    "length": {"um": 1e-6, "mm": 1e-3, "m": 1.0, "cm": 1e-2, "nm": 1e-9},
    "pressure": {
        "Pa": 1.0,
        "kPa": 1e3,
        "MPa": 1e6,
        "GPa": 1e9,
        "hPa": 1e2,
        "mbar": 1e2,
        "bar": 1e5,
        "psi": 6894.757293168361,
    },
    "angle": {"deg": DEG, "rad": 1.0, "mrad": 1e-3},
    "volume": {"uL": 1e-9, "mL": 1e-6, "mm3": 1e-9, "cm3": 1e-6, "nL": 1e-12},
    "time": {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0},
    "number": {"": 1.0},
}
"""SI per unit, by kind; within a kind in the order in which a slip is looked for."""

_SPELLINGS = {"µ": "u", "μ": "u", "°": "deg", "³": "3"}


@dataclass(frozen=True)
class Column:
    """One column of numbers.

    Parameters
    ----------
    bench : Bench
        Its name, its SI field, its unit and SI per unit.
    kind : str
        A key of `UNITS`.
    lower, upper : float, SI
        What is allowed.
    whole : bool
        Whole numbers only.
    """

    bench: Bench
    kind: str
    lower: float
    upper: float
    whole: bool = False

    @property
    def name(self) -> str:
        return self.bench.name

    @property
    def field(self) -> str:
        return self.bench.field

    @property
    def unit(self) -> str:
        return self.bench.unit


def _kind(unit: str) -> str:
    return next(kind for kind, units in UNITS.items() if unit in units)


def _of(bench: Bench, lower: float, upper: float, whole: bool = False) -> Column:
    return Column(bench, _kind(bench.unit), lower, upper, whole)


def _column(field: str, unit: str, lower: float, upper: float) -> Column:
    name = f"{field}_{unit}" if unit else field
    return _of(Bench(name, field, unit, UNITS[_kind(unit)][unit]), lower, upper)


_DESIGN = {
    bench.field: _of(
        bench,
        LIMITS[bench.field].lower,
        LIMITS[bench.field].upper,
        LIMITS[bench.field].scale == "integer",
    )
    for bench in DESIGN.values()
}

_MEASURED_RANGE = {
    "tip_deflection": 60e-3,
    "bending_angle": 1080 * DEG,
    "inflation": 60e-3,
    "inflation_lower": 60e-3,
    "cavity_volume": 1e-4,
    "stress": 500e6,
}
"""Largest size of a reading, SI; what the design allows is narrower."""

_QUANTITY = {
    bench.field: _of(bench, -_MEASURED_RANGE[field], _MEASURED_RANGE[field])
    for field, bench in (
        *((bench.field, bench) for bench in QUANTITY.values()),
        ("stress", Bench("stress_MPa", "stress", "MPa", 1e6)),
    )
}

_STD = {
    f"{field}_std": _column(f"{field}_std", one.unit, 0.0, one.upper)
    for field, one in _QUANTITY.items()
}

_CONDITION = {
    one.field: one
    for one in (
        _of(PRESSURE, -101.325e3, 1e6),
        _column("stretch", "", 0.1, 20.0),
        _column("time", "s", -1e10, 1e10),
        _column("orientation", "deg", -360 * DEG, 360 * DEG),
        Column(Bench("run", "run", "", 1.0), "number", 1, 1e6, whole=True),
    )
}

NUMBERS: dict[str, Column] = _DESIGN | _CONDITION | _QUANTITY | _STD
"""Every column of numbers, by SI field."""

DESIGN_NAMES = tuple(_DESIGN)
QUANTITY_NAMES = tuple(_QUANTITY)

TEXTS = ("device", "specimen", "branch", "mode")
"""Columns of words."""


def column_of(header: str) -> tuple[str, float] | None:
    """Field and SI per unit of a column's heading; None where it is no column of ours.

    A heading may have its unit in brackets, a micro sign and blanks, and any case.

    Raises
    ------
    ValueError
        When the field is ours and the unit is not one of its kind; says what is.
    """
    text = header.strip()
    for sign, plain in _SPELLINGS.items():
        text = text.replace(sign, plain)
    text = re.sub(r"[\s\[\](){}/]+", "_", text).strip("_")
    text = re.sub(r"_(sd|stdev|stddev|sigma)(?=_|$)", "_std", text, flags=re.I)
    lower = text.lower()
    if lower in TEXTS:
        return lower, 1.0
    for field in sorted(NUMBERS, key=len, reverse=True):
        column = NUMBERS[field]
        # The unit ends the name, also of a std: inflation_std_mm, inflation_mm_std.
        given = None
        if lower == field:
            given = ""
        elif lower.startswith(field + "_"):
            given = text[len(field) + 1 :]
        elif field.endswith("_std") and lower.endswith("_std"):
            base = field.removesuffix("_std")
            if lower.startswith(base + "_"):
                given = text[len(base) + 1 : -len("_std")]
        if given is None:
            continue
        units = UNITS[column.kind]
        if given in units:
            return field, units[given]
        alike = [unit for unit in units if unit.lower() == given.lower()]
        if alike:
            return field, units[alike[0]]
        if given == "%" or (column.unit and (given == "" or _is_unit(given))):
            # Another word is another column: pressure_ref, inflation_raw.
            raise ValueError(
                f"column {header.strip()!r}: "
                f"{f'unit {given!r}' if given else 'no unit'} is not allowed; allowed: "
                f"{column.name}"
                + (
                    f", or another unit of {column.kind} ({', '.join(units)})"
                    if column.unit
                    else ""
                )
            )
    return None


LEAST_MEANT = 1e-4
"""Of the largest value allowed: a unit that leaves less was hardly meant."""


def _is_unit(text: str) -> bool:
    """True for a unit of any kind."""
    return any(
        text.lower() == unit.lower() for units in UNITS.values() for unit in units
    )


def refusal(
    field: str,
    value: float,
    lower: float,
    upper: float,
    why: str = "",
    *,
    hint: bool = True,
) -> str | None:
    """Why a value is not allowed, in words; None where it is.

    Parameters
    ----------
    field : str
        Of `NUMBERS`.
    value, lower, upper : float, SI
    why : str
        Where the limits come from, for the message.
    hint : bool
        Whether to say what unit the value was probably meant in.
    """
    column = NUMBERS[field]
    slack = 1e-9 * max(abs(lower), abs(upper))
    inside = lower - slack <= value <= upper + slack
    if inside and not (column.whole and value != round(value)):
        return None
    scale = column.bench.factor
    shown = value / scale
    kind = "a whole number" if column.whole else "a number"
    text = (
        f"{column.name}: {shown:.10g} {column.unit}".rstrip()
        + f" is not allowed; allowed: {kind} from {lower / scale:.6g} to "
        + f"{upper / scale:.6g} {column.unit}".rstrip()
        + (f" ({why})" if why else "")
    )
    for unit, factor in UNITS[column.kind].items() if hint else ():
        meant = shown * factor
        likely = lower <= meant <= upper and abs(meant) >= LEAST_MEANT * upper
        if unit != column.unit and not inside and likely:
            return (
                f"{text}; probably meant in {unit}: {shown:.10g} {unit} is "
                f"{meant / scale:.6g} {column.unit}"
            )
    if field == "stretch" and -0.99 < value < lower:
        return f"{text}; probably meant as strain: stretch is 1 + strain"
    return text
