"""The channel that feeds the first balloon inflates, too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..mesh import LOWER
from ..problem import Array, Problem
from ..space import Parameter
from .door import effect

LEFT = 1e-5
"""Least share of its stiffness that an emptied element keeps, so that nodes inside the
channel stay where the walls lead them."""


def emptied(problem: Problem, width: float) -> Array:
    """Share (e,) of each element that a channel of some width, m, takes away."""
    mesh, design = problem.mesh, problem.design
    corner, opposite = mesh.nodes[mesh.cells[:, 0]], mesh.nodes[mesh.cells[:, -1]]
    middle = (corner + opposite) / 2
    ahead = middle[:, 0] < design.balloon_start
    spacer = (mesh.layer == LOWER) & (middle[:, 2] > design.lower_thickness)
    low, high = corner[:, 1], opposite[:, 1]
    within = np.clip((width / 2 - low) / (high - low), 0.0, 1.0)
    share: Array = np.where(ahead & spacer, within, 0.0)
    return share


@effect(
    stage="load",
    parameters=[
        Parameter(
            "width",
            unit="m",
            lower=0.0,
            upper=0.5e-3,
            off=0.0,
            prior="half-normal",
            source="the published FEM puts the pressure on the walls of channel and "
            "cavity, its width is not published; half the balloon's width of 1 mm at "
            "most (conference paper on longitudinally divided balloons)",
        )
    ],
)
def air_channel(problem: Problem, width: float) -> Problem:
    """Gas of the cavity's pressure in the spacer from the clamp to the first balloon.

    The channel is as high as the spacer, |y| < width / 2, closed at the clamp.  An
    element of which it takes the share c keeps 1 - c of its shear modulus and weight
    and K (1 - c) / (1 + 3 K c / (4 mu)) of its bulk modulus, as a solid with holes has
    (Hashin and Shtrikman 1963, J. Mech. Phys. Solids 11, 127, upper bound): else the
    nearly incompressible rest would keep the gas from the walls.  The gas has the
    potential -p c int J dV: exact where the channel's sides are mesh lines, and
    continuous in the width.  Its volume is part of the cavity's.  Where an even number
    of balloons lie side by side the channel ends at the wall between them, unless it
    is wider than that.
    """
    gone = emptied(problem, width)
    left = np.maximum(1.0 - gone, LEFT)
    shear, bulk = problem.shear_modulus, problem.bulk_modulus
    before = 0.0 if problem.gas is None else problem.gas
    return replace(
        problem,
        shear_modulus=shear * left,
        bulk_modulus=bulk * left / (1.0 + 0.75 * bulk / shear * gone),
        density=problem.density * (1.0 - gone),
        gas=np.maximum(before, gone),
    )
