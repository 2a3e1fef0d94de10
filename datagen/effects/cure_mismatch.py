"""Different shrinkage of the two layers on curing or cooling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..mesh import UPPER
from ..problem import Problem
from ..space import Parameter
from .door import effect


@effect(
    stage="initial strain",
    parameters=[
        Parameter(
            "difference",
            unit="1",
            lower=-0.01,
            upper=0.01,
            off=0.0,
            prior="normal",
            source="linear cure shrinkage of PDMS 0.5..2 %: Madsen et al. 2014, "
            "J. Micromech. Microeng. 24 127002; two layers differ by a part of it",
        )
    ],
)
def cure_mismatch(problem: Problem, difference: float) -> Problem:
    """Growth of the upper layer relative to the lower one: F = Fe Fg.

    Fg = (1 + difference) I in the upper layer, I in the lower; W = Jg W(Fe).
    A negative difference (the upper layer shrank more) bends the strip up.
    """
    growth = (
        np.tile(np.eye(3), (len(problem.mesh.cells), 1, 1))
        if problem.growth is None
        else problem.growth.copy()
    )
    growth[problem.mesh.layer == UPPER] *= 1.0 + difference
    return replace(problem, growth=growth)
