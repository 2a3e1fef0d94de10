"""Chains of limited length: stiffening at large stretch, after Gent."""

from __future__ import annotations

from dataclasses import replace

from ..materials import Gent, with_energy
from ..problem import Problem
from ..space import Parameter
from .door import effect


@effect(
    stage="material",
    parameters=[
        Parameter(
            "inverse_limit",
            unit="1",
            lower=0.0,
            upper=0.5,
            off=0.0,
            prior="half-normal",
            source="the law: Gent 1996, Rubber Chem. Technol. 69, 59-61; 1/Jm fitted "
            "to tensile curves: 0.094 for the PDMS RTV615, 0.012 for Treloar's natural "
            "rubber (1944); 0.5 leaves a largest stretch of 1.8",
        )
    ],
)
def strain_stiffening(problem: Problem, inverse_limit: float) -> Problem:
    """Gent's strain energy in both layers: What = -mu Jm/2 ln(1 - (I1bar - 3)/Jm).

    inverse_limit = 1/Jm; 0 is the neo-Hookean law.  mu stays the shear modulus at
    small strain, so nothing changes at low pressure; at Jm the chains are straight.
    """
    lower, upper = problem.laws
    energy = Gent(inverse_limit)
    return replace(
        problem, laws=(with_energy(lower, energy), with_energy(upper, energy))
    )
