"""A grip that yields."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..mesh import face_nodes
from ..problem import Problem
from ..space import Parameter
from ..surfaces import Springs
from .door import effect


@effect(
    stage="boundary",
    parameters=[
        Parameter(
            "compliance",
            unit="m/Pa",
            lower=0.0,
            upper=1e-7,
            off=0.0,
            prior="half-normal",
            source="elastic support of a cantilever's root: O'Donnell 1960, J. Appl. "
            "Mech. 27, 461; up to 1 mm of a soft pad of 10 kPa",
        )
    ],
)
def clamp_compliance(problem: Problem, compliance: float) -> Problem:
    """Grip yields in proportion to its traction: t = -u / compliance.

    On the root face x = 0, across it and along it alike; without compliance the face
    is held.  The pressure in a closed cavity puts no force and no moment on the grip:
    weightless strips only lose the grip's hold on their section, while weight turns
    and lowers the whole strip.
    """
    mesh = problem.mesh
    at_root = np.zeros(len(mesh.nodes), dtype=bool)
    at_root[mesh.root] = True
    ends = mesh.cells[:, face_nodes(0, 0)]
    fixed = problem.fixed.copy()
    fixed[mesh.root] = False
    fixed[mesh.mid_plane, 1] = True
    grip = Springs(ends[at_root[ends].all(axis=1)], 1 / compliance, 1 / compliance)
    return replace(problem, fixed=fixed, springs=(*problem.springs, grip))
