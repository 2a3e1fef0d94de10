"""Both layers swell in what they lie in, or shrink as it leaves them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..problem import Problem
from ..space import Parameter
from .door import effect


@dataclass(frozen=True)
class Uptake:
    """Linear strain (1 - exp(-t / time)) strain of a body immersed at t = 0."""

    strain: float
    time: float

    def __call__(self, t: float) -> float:
        return float(-self.strain * np.expm1(-max(t, 0.0) / self.time))


@effect(
    stage="initial strain",
    parameters=[
        Parameter(
            "strain",
            unit="1",
            lower=0.0,
            upper=0.05,
            off=0.0,
            prior="half-normal",
            source="PDMS in polar solvents swells by 0..5 % in length: Lee, Park and "
            "Whitesides 2003, Anal. Chem. 75, 6544",
        ),
        Parameter(
            "time",
            unit="s",
            lower=60.0,
            upper=36000.0,
            scale="log",
            off=3600.0,
            prior="log-uniform",
            source="diffusion h^2/D through 0.1..1 mm of PDMS at 1e-9..1e-10 m2/s; "
            "up to 10 h of a bench run",
        ),
    ],
)
def swelling(problem: Problem, strain: float, time: float) -> Problem:
    """Fg = (1 + eps(t)) I in both layers, eps(t) = strain (1 - exp(-t / time)).

    t is the load path's own time; the body is as large at a load step as it is at the
    end of that step.  Without strain the time means nothing; its off value is a matter
    of form.
    """
    if strain == 0:
        return problem
    return replace(problem, swellings=(*problem.swellings, Uptake(strain, time)))
