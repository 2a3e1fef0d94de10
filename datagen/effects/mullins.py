"""Softening by the largest stretch so far (Mullins 1948)."""

from __future__ import annotations

from dataclasses import replace

from ..errors import EffectError
from ..history import Mullins, Stored
from ..materials import Law
from ..problem import Problem
from ..space import Parameter
from .door import effect

_SOURCE = (
    "silica-filled PDMS: Hanson et al. 2005, Polymer 46, 10989; law and size of its "
    "numbers: Ogden and Roxburgh 1999, Proc. R. Soc. Lond. A 455, 2861"
)


@effect(
    stage="material",
    parameters=[
        Parameter(
            "softening",
            unit="1",
            lower=0.0,
            upper=0.8,
            off=0.0,
            prior="half-normal",
            source=_SOURCE,
        ),
        Parameter(
            "scale",
            unit="1",
            lower=0.05,
            upper=1.0,
            scale="log",
            off=0.5,
            prior="log-uniform",
            source=_SOURCE,
        ),
    ],
)
def mullins(problem: Problem, softening: float, scale: float) -> Problem:
    """P = eta P0 with eta = 1 - softening erf((Wm - W) / (scale mu)).

    W is the stored energy of a point, Wm the largest it has had.  The first loading is
    that of the law without it, unloading and reloading are softer, whatever the rate.
    Without softening the scale means nothing; its off value is a matter of form.
    """
    if softening == 0:
        return problem

    def softer(law: Law) -> Law:
        if not isinstance(law, Stored):
            raise EffectError(f"mullins: {type(law).__name__} has no stored energy")
        return Mullins(law, softening, scale)

    lower, upper = (softer(law) for law in problem.laws)
    return replace(problem, laws=(lower, upper))
