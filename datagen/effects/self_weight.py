"""Self weight of the strip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..problem import Problem
from ..space import Parameter
from .door import effect

GRAVITY = 9.80665
"""Standard acceleration of free fall, m/s2."""


@effect(
    stage="body force",
    parameters=[
        Parameter(
            "density",
            unit="kg/m3",
            lower=0.0,
            upper=1100.0,
            off=0.0,
            prior="uniform",
            source="PDMS 965..1030 kg/m3: Sylgard 184 data sheet, filled grades above",
        ),
        Parameter(
            "orientation",
            unit="rad",
            lower=0.0,
            upper=float(np.pi),
            off=0.0,
            prior="uniform",
            source="bench set-up: 0 for gravity along -z, pi for turned over",
        ),
    ],
)
def self_weight(problem: Problem, density: float, orientation: float) -> Problem:
    """Body force rho0 g per undeformed volume.

    f = rho0 g (0, 0, -cos(orientation)).  The part across the strip is left out, as
    the half model is symmetric about y = 0; it bends the strip sideways only.
    """
    down = -GRAVITY * float(np.cos(orientation))
    return replace(
        problem,
        density=np.full(len(problem.mesh.cells), density),
        gravity=np.array([0.0, 0.0, down]),
    )
