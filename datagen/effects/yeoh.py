"""Stiffening at large stretch as a polynomial, after Yeoh."""

from __future__ import annotations

from dataclasses import replace

from ..materials import Yeoh, with_energy
from ..problem import Problem
from ..space import Parameter
from .door import effect

SOURCE = "the law: Yeoh 1993, Rubber Chem. Technol. 66, 754-771; fitted to the "


@effect(
    stage="material",
    parameters=[
        Parameter(
            "second",
            unit="1",
            lower=0.0,
            upper=0.3,
            off=0.0,
            prior="half-normal",
            source=SOURCE + "tensile curve of the PDMS RTV615: C2/C1 = 0.085",
        ),
        Parameter(
            "third",
            unit="1",
            lower=0.0,
            upper=0.03,
            off=0.0,
            prior="half-normal",
            source=SOURCE + "tensile curve of the PDMS RTV615: C3/C1 = 0.0058",
        ),
    ],
)
def yeoh(problem: Problem, second: float, third: float) -> Problem:
    """Yeoh's strain energy in both layers: What = C1 (x + second x^2 + third x^3).

    x = I1bar - 3, second = C2/C1, third = C3/C1, 2 C1 = mu.  mu stays the shear modulus
    at small strain, so nothing changes at low pressure.
    """
    below, above = problem.laws
    energy = Yeoh(second, third)
    return replace(
        problem, laws=(with_energy(below, energy), with_energy(above, energy))
    )
