"""A temperature other than that at which the moduli were measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..problem import Problem
from ..space import Parameter
from .door import effect

STIFFENING = 1.2e-3
"""Relative change of Young's modulus a kelvin, of a filled PDMS.  Sources differ: an
ideal rubber has 1/T0, 3.4e-3 at 20 degC (Treloar, The Physics of Rubber Elasticity,
1975), an unfilled PDMS 4.4e-3 (Loetters et al. 1997, Microsyst. Technol. 3, 64-67).  A
change of temperature that is found from stiffness alone is as uncertain as that."""

EXPANSION = 3.0e-4
"""Thermal stretch a kelvin: Kuo in Polymer Data Handbook (Mark, ed., Oxford 1999) and
the data sheet of Sylgard 184 have 3.0e-4 to 3.4e-4 1/K."""


@effect(
    stage="initial strain",
    parameters=[
        Parameter(
            "change",
            unit="K",
            lower=-30.0,
            upper=60.0,
            off=0.0,
            prior="normal",
            source="from a cold room to a stage warmed to 80 degC, with moduli stated "
            "at 20 degC; PDMS is rubbery over all of it",
        )
    ],
)
def temperature(problem: Problem, change: float) -> Problem:
    """Stiffer and larger when warmer: E = E0 (1 + a dT), Fg = (1 + b dT) I.

    dT = change = T - T0, a = 1.2e-3 1/K, b = 3e-4 1/K, F = Fe Fg.  Poisson's ratio
    stays.  Both layers expand alike; the clamp holds its face as it was.
    """
    stiffer = 1 + STIFFENING * change
    growth = (
        np.tile(np.eye(3), (len(problem.mesh.cells), 1, 1))
        if problem.growth is None
        else problem.growth
    )
    return replace(
        problem,
        shear_modulus=problem.shear_modulus * stiffer,
        bulk_modulus=problem.bulk_modulus * stiffer,
        growth=growth * (1 + EXPANSION * change),
    )
