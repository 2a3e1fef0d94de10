"""Bench units and SI: the one table of names with a unit in them.

Inside the project everything is SI.  Files, the command line, HTTP and the page use
bench units, and the unit is part of the name (``upper_thickness_um``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Bench:
    """One bench name: its SI field, its unit as text, and SI per bench unit."""

    name: str
    field: str
    unit: str
    factor: float

    def to_si(self, value: float) -> float:
        return value * self.factor

    def from_si(self, value: Any) -> Any:
        return value / self.factor


def _table(*rows: tuple[str, str, float]) -> dict[str, Bench]:
    return {
        (f"{field}_{unit}" if unit else field): Bench(
            f"{field}_{unit}" if unit else field, field, unit, factor
        )
        for field, unit, factor in rows
    }


DESIGN = _table(
    ("length", "mm", 1e-3),
    ("width", "mm", 1e-3),
    ("balloon_length", "mm", 1e-3),
    ("balloon_width", "mm", 1e-3),
    ("balloon_start", "mm", 1e-3),
    ("wall", "mm", 1e-3),
    ("divisions_x", "", 1),
    ("divisions_y", "", 1),
    ("cavity_height", "um", 1e-6),
    ("upper_thickness", "um", 1e-6),
    ("lower_thickness", "um", 1e-6),
    ("upper_modulus", "MPa", 1e6),
    ("lower_modulus", "MPa", 1e6),
)
"""Design columns of the contract, by bench name."""

QUANTITY = _table(
    ("tip_deflection", "mm", 1e-3),
    ("bending_angle", "deg", math.pi / 180),
    ("inflation", "mm", 1e-3),
    ("inflation_lower", "mm", 1e-3),
    ("cavity_volume", "uL", 1e-9),
)
"""Measured and predicted quantities of the contract, by bench name."""

PRESSURE = Bench("pressure_kPa", "pressure", "kPa", 1e3)

BY_FIELD = {bench.field: bench for bench in (*DESIGN.values(), *QUANTITY.values())}
"""The same rows by SI field name."""


def bench_name(field: str) -> str:
    """Bench name of an SI field: ``length`` gives ``length_mm``."""
    return BY_FIELD[field].name


def design_to_bench(values: Mapping[str, float]) -> dict[str, float]:
    """SI design fields to bench columns; integers stay integers."""
    out: dict[str, float] = {}
    for field, value in values.items():
        bench = BY_FIELD[field]
        out[bench.name] = value if bench.factor == 1 else float(bench.from_si(value))
    return out
