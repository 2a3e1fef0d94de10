"""A gauge that is not at zero when the cavity is."""

from __future__ import annotations

from dataclasses import replace

from ..problem import Problem
from ..space import Parameter
from .door import effect


@effect(
    stage="load",
    parameters=[
        Parameter(
            "offset",
            unit="Pa",
            lower=-2e3,
            upper=2e3,
            off=0.0,
            prior="normal",
            source="1 % of a span of 200 kPa: accuracy class 1 of EN 837-1:1996",
        )
    ],
)
def pressure_offset(problem: Problem, offset: float) -> Problem:
    """Cavity pressure = gain times gauge pressure + offset.

    The path starts at zero gauge pressure, where the offset acts already.
    """
    return replace(problem, pressure_offset=problem.pressure_offset + offset)
