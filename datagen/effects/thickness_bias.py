"""Layers thicker or thinner than stated, evenly or along the strip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..problem import Problem
from ..space import Parameter
from .door import effect

CAST = (
    "spin-coated or cast PDMS films of about 100 um: bench practice, several percent "
    "from film to film and from the middle of a wafer to its edge"
)


@effect(
    stage="geometry",
    parameters=[
        Parameter("upper", "1", -0.1, 0.1, off=0.0, prior="normal", source=CAST),
        Parameter("lower", "1", -0.1, 0.1, off=0.0, prior="normal", source=CAST),
        Parameter("gradient", "1", -0.1, 0.1, off=0.0, prior="normal", source=CAST),
    ],
)
def thickness_bias(
    problem: Problem, upper: float, lower: float, gradient: float
) -> Problem:
    """Membrane thickness t_k (1 + b_k + g x/L) of layer k.

    b_u = upper, b_l = lower, at the clamp; g = gradient: the difference between tip and
    clamp over the nominal thickness.  The cavity's height stays.  A gradient across the
    strip turns it sideways, which the half model does not show.  The effect moves
    nodes, with the same topology.
    """
    design = problem.design
    x, _, z = problem.mesh.nodes.T
    slope = gradient * x / design.length
    floor, roof = design.lower_thickness, design.lower_thickness + design.cavity_height
    nodes = problem.nodes.copy()
    nodes[:, 2] += np.minimum(z, floor) * (lower + slope)
    nodes[:, 2] += np.maximum(z - roof, 0.0) * (upper + slope)
    return replace(problem, nodes=nodes)
