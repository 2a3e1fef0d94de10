"""Moduli other than those stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..mesh import UPPER
from ..problem import Problem
from ..space import Parameter
from .door import effect


@effect(
    stage="material",
    parameters=[
        Parameter(
            "common",
            unit="1",
            lower=0.5,
            upper=1.4,
            scale="log",
            off=1.0,
            prior="log-normal",
            source="a bulge test reduced with a closed form whose coefficient is too "
            "low states E up to 1.67 times too high; one mix of Sylgard 184 cured at "
            "25 to 200 degC has 1.32 to 2.97 MPa: Johnston et al. 2014, J. Micromech. "
            "Microeng. 24 035017",
        ),
        Parameter(
            "ratio",
            unit="1",
            lower=0.6,
            upper=1.6,
            scale="log",
            off=1.0,
            prior="log-normal",
            source="E = 20 MPa over the mixing ratio: Wang, Volinsky and Gallant 2014, "
            "J. Appl. Polym. Sci. 131 41050; two mixes weighed and cured apart differ "
            "from their nominal ratio by tens of percent",
        ),
    ],
)
def modulus_bias(problem: Problem, common: float, ratio: float) -> Problem:
    """Young's moduli of the layers times f_u = f sqrt(r) and f_l = f / sqrt(r).

    f = common, r = ratio.  Poisson's ratio stays, so shear and bulk modulus follow.
    With f alone the device at a pressure p does what the stated one does at p/f.
    """
    share = common * np.where(
        problem.mesh.layer == UPPER, np.sqrt(ratio), 1 / np.sqrt(ratio)
    )
    return replace(
        problem,
        shear_modulus=problem.shear_modulus * share,
        bulk_modulus=problem.bulk_modulus * share,
    )
