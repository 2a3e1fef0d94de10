"""Dependence of the strain energy on the second invariant."""

from __future__ import annotations

from dataclasses import replace

from ..materials import MooneyRivlin, with_energy
from ..problem import Problem
from ..space import Parameter
from .door import effect


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
            source="the law: Mooney 1940, J. Appl. Phys. 11, 582-592; C2/C1 = 0.15 "
            "fitted to the silicone of Meunier et al. 2008, Polym. Test. 27, 765-777",
        )
    ],
)
def mooney(problem: Problem, second: float) -> Problem:
    """Mooney-Rivlin energy in both layers: What = C1 (I1bar - 3) + C2 (I2bar - 3).

    second = C2/C1.  The shear modulus at small strain stays mu = 2 (C1 + C2), that is
    C1 = mu/2 / (1 + second): a change of shape, not of modulus.  Regions stretched in
    two directions are stiffer than in the baseline, those stretched in one softer.
    """
    lower, upper = problem.laws
    energy = MooneyRivlin.of_ratio(second)
    return replace(
        problem, laws=(with_energy(lower, energy), with_energy(upper, energy))
    )
