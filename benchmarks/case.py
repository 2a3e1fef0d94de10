"""The benchmark's problem, for peers and for reading their answers.

S1, case 1, the contract's law, half symmetric, a follower pressure on all walls of the
cavity.  Peers get the very grid lines of our own mesh.
"""

from __future__ import annotations

import math

import numpy as np

from datagen.device import named_device
from datagen.levels import MeshLevel, mesh_level
from datagen.observe import Instruments
from datagen.problem import Problem, baseline
from datagen.response import OUTPUT_NAMES

from .exchange import EDGES, FACE_EDGES, FACES, Question

Array = np.ndarray

PRESSURES = np.arange(5, 61, 5) * 1e3
"""Pa."""

FINEST = MeshLevel("finest", 12, 9, 7, 5, 6, 4, 4, 4, 0.15, 0.15, 0.5, 0.15)
"""Finer than any mesh that users are offered."""

COARSE = MeshLevel("coarse", 4, 3, 2, 1, 2, 1, 2, 1, 1.0, 1.0, 1.0, 2.0)
"""The draft mesh with two elements through each membrane and two across the rim.

A rim of one twenty-node element with 2 x 2 x 2 points does not hold: on the draft mesh
FElupe and CalculiX lose the path near 30 kPa.
"""

MEDIUM = MeshLevel("medium", 7, 5, 4, 3, 3, 1, 2, 2, 0.5, 0.5, 0.8, 0.5)
"""Between the standard mesh and the fine one, so that accuracies can be matched."""

EXTRA_LEVELS = {level.name: level for level in (COARSE, MEDIUM, FINEST)}

_CORNERS = np.array(
    [
        (0, 0, 0),
        (2, 0, 0),
        (2, 2, 0),
        (0, 2, 0),
        (0, 0, 2),
        (2, 0, 2),
        (2, 2, 2),
        (0, 2, 2),
    ]
)


def _lattice(places: Array) -> Array:
    """Numbers in lattice order (x slowest) of places 0, 1, 2 along each axis."""
    numbers: Array = places @ np.array([9, 3, 1])
    return numbers


_MIDDLES = np.array([(_CORNERS[a] + _CORNERS[b]) // 2 for a, b in EDGES])
TWENTY = _lattice(np.concatenate([_CORNERS, _MIDDLES]))
"""Where each of the twenty nodes stands among the lattice's twenty-seven."""

FACE_CENTRES = _lattice(np.array([_CORNERS[list(face)].sum(0) // 4 for face in FACES]))
CENTRE = 13


def level_of(name: str) -> MeshLevel:
    """A mesh level by name, the benchmark's own among them."""
    return EXTRA_LEVELS.get(name) or mesh_level(name)


def problem_of(name: str) -> Problem:
    """The benchmark's problem on one mesh."""
    return baseline(named_device("S1", 1), level_of(name))


def kept_nodes(problem: Problem) -> Array:
    """(k,) array of int; nodes on edges and corners of elements, ascending."""
    return np.unique(problem.mesh.cells[:, TWENTY])


def ask(problem: Problem, pressure: Array = PRESSURES) -> Question:
    """The problem on twenty-node elements of the same grid."""
    mesh = problem.mesh
    kept = kept_nodes(problem)
    centres = mesh.cells[:, FACE_CENTRES]
    return Question(
        nodes=problem.nodes[kept],
        cells=np.searchsorted(kept, mesh.cells[:, TWENTY]),
        shear=problem.shear_modulus,
        bulk=problem.bulk_modulus,
        fixed=problem.fixed[kept],
        wet=np.isin(centres, mesh.cavity_faces[:, 4]),
        pressure=pressure,
    )


def lift(problem: Problem, displacement: Array) -> Array:
    """Displacements of twenty-node elements at all twenty-seven nodes.

    Parameters
    ----------
    problem : Problem
    displacement : (k, 3) array, m
        At `kept_nodes`.

    Returns
    -------
    (n, 3) array, m; middles of faces and elements by the serendipity functions.
    """
    cells = problem.mesh.cells
    full: Array = np.zeros(problem.nodes.shape)
    full[kept_nodes(problem)] = displacement
    known = full[cells[:, TWENTY]]
    for corners, edges, centre in zip(FACES, FACE_EDGES, FACE_CENTRES, strict=True):
        full[cells[:, centre]] = (
            known[:, list(edges)].sum(1) / 2 - known[:, list(corners)].sum(1) / 4
        )
    full[cells[:, CENTRE]] = known[:, 8:].sum(1) / 4 - known[:, :8].sum(1) / 4
    return full


def read(problem: Problem, displacement: Array) -> tuple[Array, Array]:
    """Tip deflection and inflation, by the code that reads our own answers.

    Parameters
    ----------
    problem : Problem
    displacement : (s, n, 3) or (s, k, 3) array, m
        At all nodes, or at `kept_nodes` alone.

    Returns
    -------
    tip, inflation : (s,) arrays, m
    """
    instruments = Instruments(problem)
    whole = displacement.shape[1] == len(problem.nodes)
    rows = []
    for u in displacement:
        moved = problem.nodes + (u if whole else lift(problem, u))
        values = instruments.read(moved, math.nan)
        rows.append(
            [values[OUTPUT_NAMES.index(n)] for n in ("tip_deflection", "inflation")]
        )
    tip, inflation = np.array(rows).T
    return tip, inflation
