"""The brittle skin that an oxygen plasma leaves where the layers are bonded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..mesh import LOWER, UPPER, face_nodes
from ..problem import Array, Problem
from ..space import Parameter
from ..surfaces import Skin
from .door import effect


def bond_faces(problem: Problem) -> Array:
    """Faces (f, 9) where spacer and upper layer are bonded, seen from above."""
    mesh = problem.mesh
    below = np.zeros(len(mesh.nodes), dtype=bool)
    below[mesh.cells[mesh.layer == LOWER]] = True
    bottom = mesh.cells[mesh.layer == UPPER][:, face_nodes(2, 0)]
    bonded: Array = bottom[below[bottom].all(axis=1)]
    return bonded


@effect(
    stage="material",
    parameters=[
        Parameter(
            "stiffness",
            unit="N/m",
            lower=0.0,
            upper=50.0,
            off=0.0,
            prior="half-normal",
            source="silica-like skin of some 10 nm and 1.5 GPa: Befahy et al. 2010, "
            "Langmuir 26, 3372; thicker skins after long exposure: Bowden et al. 1999, "
            "Appl. Phys. Lett. 75, 2557",
        )
    ],
)
def plasma_skin(problem: Problem, stiffness: float) -> Problem:
    """Membrane energy on the walls of the cavities and in the plane of the bond.

    W = (k/6) (tr C + 1/det C - 3) per undeformed area, with the surface's Cauchy-Green
    tensor C and the stiffness k = E h of an incompressible skin; one skin of that
    stiffness on every wall and one in the bond.  It does not crack, and it is free of
    stress in the shape without initial strain.
    """
    faces = np.concatenate([problem.mesh.cavity_faces, bond_faces(problem)])
    return replace(problem, skins=(*problem.skins, Skin(faces, stiffness)))
