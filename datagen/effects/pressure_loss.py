"""A cavity that sees less, or more, than the gauge in the supply."""

from __future__ import annotations

from dataclasses import replace

from ..problem import Problem
from ..space import Parameter
from .door import effect


@effect(
    stage="load",
    parameters=[
        Parameter(
            "gain",
            unit="1",
            lower=0.85,
            upper=1.05,
            off=1.0,
            prior="normal",
            source="laminar loss in the feed of a leaking cavity, proportional to the "
            "pressure (Bruus 2008, Theoretical Microfluidics, ch. 4); above 1 an error "
            "of the gauge's span, EN 837-1:1996",
        )
    ],
)
def pressure_loss(problem: Problem, gain: float) -> Problem:
    """Cavity pressure = gain times gauge pressure + offset.

    Gain 1 - R q of a leak q per pascal behind a feed of resistance R.  Without another
    stress scale in the problem this is the same as moduli divided by the gain.
    """
    return replace(problem, pressure_gain=problem.pressure_gain * gain)
