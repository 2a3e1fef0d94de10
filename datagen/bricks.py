"""Meshes of mapped bricks: specimens that are not strips, for the same solver.

A brick is a grid of 27-node hexahedra in parameters (r, s, t) put into space by a
smooth right-handed map; every node, also those inside an element, lies where the map
puts it.  Bricks are merged where their nodes coincide.

The follower pressure has a potential only if its faces close the cavity together with
planes through the origin and edges that do not move (see `mesh.Mesh`).  A cavity that
ends in a symmetry plane elsewhere is closed there by a `fan` of flat faces.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from .mesh import LOWER, Mesh, face_nodes

Array = np.ndarray

Map = Callable[[Array, Array, Array], tuple[Array, Array, Array]]
"""Parameters r, s, t, each (n,), to coordinates x, y, z, each (n,), m."""

_EDGES = np.array([[0, 1, 2], [2, 5, 8], [8, 7, 6], [6, 3, 0]])
"""Nodes of a face's edges, in the sense of rotation of its normal reversed."""


@dataclass(frozen=True)
class Brick:
    """Nodes and elements of one brick or of several merged ones.

    nodes : (n, 3) array, m.
    cells : (e, 27) array of int; lattice order.
    centre : (e, 3) array; parameters of the elements' centres.
    sides : dict of (axis, side) to (f, 9) array of int; the faces where parameter
        `axis` is least (side 0) or largest (side 1); their normals point inwards.
    """

    nodes: Array
    cells: Array
    centre: Array
    sides: dict[tuple[int, int], Array]


def brick(r: Array, s: Array, t: Array, place: Map | None = None) -> Brick:
    """Grid of elements between grid lines, mapped into space.

    Parameters
    ----------
    r, s, t : (k + 1,) array
        Increasing grid lines of k elements in each parameter.
    place : callable, optional
        The map; parameters are coordinates in metres where it is not given.
    """
    lines = (r, s, t)
    fine = [np.interp(np.arange(2 * len(g) - 1) / 2, range(len(g)), g) for g in lines]
    shape = [len(g) for g in fine]
    grid = [g.ravel() for g in np.meshgrid(*fine, indexing="ij")]
    nodes = np.stack(place(*grid) if place else grid, axis=1)
    number = np.arange(len(nodes)).reshape(shape)
    cells = np.stack(
        [
            number[i : i + 3, j : j + 3, k : k + 3].ravel()
            for i in range(0, shape[0] - 2, 2)
            for j in range(0, shape[1] - 2, 2)
            for k in range(0, shape[2] - 2, 2)
        ]
    )
    middle = np.meshgrid(*((g[1:] + g[:-1]) / 2 for g in lines), indexing="ij")
    index = np.indices([len(g) - 1 for g in lines]).reshape(3, -1)
    sides = {}
    for axis in range(3):
        for side in (0, 1):
            last = len(lines[axis]) - 2
            at = index[axis] == (last if side else 0)
            sides[axis, side] = cells[at][:, face_nodes(axis, side)]
    centre = np.stack([m.ravel() for m in middle], axis=1)
    return Brick(nodes, cells, centre, sides)


def merge(bricks: Sequence[Brick], tolerance: float) -> Brick:
    """One brick of several, whose nodes closer than `tolerance` (m) become one."""
    nodes = np.concatenate([part.nodes for part in bricks])
    start = np.cumsum([0, *(len(part.nodes) for part in bricks)])
    first = np.arange(len(nodes))
    pairs = cKDTree(nodes).query_pairs(tolerance, output_type="ndarray")
    np.minimum.at(first, pairs.max(axis=1), pairs.min(axis=1))
    kept, number = np.unique(first, return_inverse=True)
    return Brick(
        nodes=nodes[kept],
        cells=np.concatenate(
            [number[part.cells + at] for part, at in zip(bricks, start, strict=False)]
        ),
        centre=np.concatenate([part.centre for part in bricks]),
        sides={
            key: np.concatenate(
                [
                    number[part.sides[key] + at]
                    for part, at in zip(bricks, start, strict=False)
                ]
            )
            for key in bricks[0].sides
        },
    )


def rim(faces: Array, member: Array) -> Array:
    """Edges (k, 3) of faces (f, 9) whose nodes are all members (n,) of a set.

    The faces are to the left of their edges, seen against their normals.
    """
    edges = faces[:, _EDGES].reshape(-1, 3)
    chosen: Array = edges[member[edges].all(axis=1)]
    return chosen


def fan(edges: Array, apex: int) -> Array:
    """Faces (k, 9) from edges (k, 3) of a rim to one node, which must be held.

    All nodes of a face but those of its edge are the apex, so the faces are flat where
    the rim is plane, meet along straight lines, and their cone volume is that of the
    plane figure inside the rim, however the rim moves in its plane.  Faces of a rim
    found by `rim` have their normals to the outside of what those faces bound.
    """
    return np.concatenate([edges[:, ::-1], np.full((len(edges), 6), apex)], axis=1)


def closed(part: Brick, cavity: Array, layer: Array | None = None) -> Mesh:
    """Mesh of a brick around a cavity with the faces (f, 9); they may be none."""
    return Mesh(
        nodes=part.nodes,
        cells=part.cells,
        layer=np.full(len(part.cells), LOWER) if layer is None else layer,
        cavity_faces=cavity,
        gap=np.zeros((0, 2), dtype=np.int64),
        gap_wall=np.zeros(0, dtype=np.int64),
    )
