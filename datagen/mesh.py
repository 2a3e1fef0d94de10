"""Structured mesh of 27-node hexahedra of a divided strip, half-symmetric in y.

scikit-fem provides the tensor-product mesh, the numbering of the degrees of freedom
and the quadrature.  Each element's nodes are then put into lattice order (x slowest,
z fastest), so that element arithmetic sees every element in the same position.

Grid lines are graded geometrically towards the edges of the balloons, where the
membranes bend sharply and the re-entrant edges are singular.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq
from skfem import Basis, ElementHex2, ElementQuad2, MeshHex
from skfem.quadrature import get_quadrature

from .device import Design
from .errors import InputError
from .levels import MeshLevel

Array = np.ndarray

LOWER, UPPER = 0, 1
"""Layer of an element: the lower material (spacer included) and the upper one."""

STEEPEST = 2.5
"""Largest ratio of neighbouring elements over a balloon.

An inflated roof bends everywhere, not at its edges alone: with a steeper grading long
thin elements in the middle fold in a way that no membrane does, and the path is lost.
"""


def graded(
    start: float, stop: float, count: int, first: float, steepest: float = np.inf
) -> Array:
    """Grid lines from `start`, growing geometrically away from it.

    Parameters
    ----------
    start, stop : float, m
        `stop` may be the smaller: lines then grow downwards from `start`.
    count : int
        Number of elements.
    first : float, m
        Wanted size of the element at `start`; equal elements where that is smaller.
    steepest : float
        Largest ratio of neighbours; the first element is larger where it must be.

    Returns
    -------
    (count + 1,) array, m, from `start` to `stop`.
    """
    length = abs(stop - start)
    first = max(first, length / float(np.sum(steepest ** np.arange(count))))
    if count == 1 or first >= length / count:
        return np.linspace(start, stop, count + 1)

    def excess(ratio: float) -> float:
        return first * float(np.sum(ratio ** np.arange(count))) - length

    ratio = brentq(excess, 1.0, (length / first) ** (1 / (count - 1)) + 1e-9)
    lines = np.concatenate([[0.0], np.cumsum(first * ratio ** np.arange(count))])
    sign = 1.0 if stop > start else -1.0
    grid: Array = start + sign * lines * (length / lines[-1])
    return grid


def graded_both(
    start: float, stop: float, count: int, first: float, last: float
) -> Array:
    """Grid lines that grow geometrically, alike, away from both ends.

    Parameters
    ----------
    start, stop : float, m
        `stop` is the larger.
    count : int
        Number of elements.
    first, last : float, m
        Wanted sizes of the elements at `start` and `stop`; all elements are equal where
        those are larger.

    Returns
    -------
    (count + 1,) array, m
    """
    length = stop - start
    place = np.arange(count)

    def sizes(ratio: float) -> Array:
        found: Array = np.minimum(first * ratio**place, last * ratio ** place[::-1])
        return found

    if count == 1 or sizes(1.0).sum() >= length:
        return np.linspace(start, stop, count + 1)
    ratio = length / min(first, last)
    if count > 2:  # two elements are the end ones, in proportion
        ratio = brentq(lambda r: sizes(r).sum() - length, 1.0, ratio)
    lines = np.concatenate([[0.0], np.cumsum(sizes(ratio))])
    grid: Array = start + lines * (length / lines[-1])
    return grid


def _join(*pieces: Array) -> Array:
    """Increasing grid lines from pieces that share their end points."""
    ordered = [piece if piece[-1] > piece[0] else piece[::-1] for piece in pieces]
    return np.concatenate([ordered[0], *(piece[1:] for piece in ordered[1:])])


def _between(left: float, right: float, half: int, first: float) -> Array:
    """Grid lines graded towards both ends, `half` elements on each side."""
    middle = (left + right) / 2
    return _join(
        graded(left, middle, half, first, STEEPEST),
        graded(right, middle, half, first, STEEPEST),
    )


def grid_lines(design: Design, level: MeshLevel) -> tuple[Array, Array, Array]:
    """Grid lines along x, y (half, from the mid-plane) and z, m."""
    thin = min(design.upper_thickness, design.lower_thickness)
    divided = design.divisions_x * design.divisions_y > 1
    edge = thin * (level.edge_divided if divided else 1.0)
    edge_x, edge_y = level.edge_x * edge, level.edge_y * edge
    bx, by = design.balloons_x(), design.balloons_y()
    along = level.along(design.divisions_x)
    across = level.across(design.divisions_y)

    edge_root = level.edge_root * thin
    if edge_root:
        x = [graded_both(0.0, bx[0][0], level.root, edge_root, edge_x)]
    else:
        x = [graded(bx[0][0], 0.0, level.root, edge_x)]
    for i, (left, right) in enumerate(bx):
        x.append(_between(left, right, along, edge_x))
        if i + 1 < len(bx):
            x.append(np.linspace(right, bx[i + 1][0], level.wall + 1))
    x.append(graded(bx[-1][1], design.length, level.tip, edge_x))

    y: list[Array] = []
    if by[0][0] > 0:  # an even division has half a wall at the mid-plane
        y.append(np.linspace(0.0, by[0][0], (level.wall + 1) // 2 + 1))
    for j, (left, right) in enumerate(by):
        if left == 0.0:
            y.append(graded(right, 0.0, across, edge_y, STEEPEST))
        else:
            y.append(_between(left, right, across, edge_y))
        if j + 1 < len(by):
            y.append(np.linspace(right, by[j + 1][0], level.wall + 1))
    y.append(graded(by[-1][1], design.width / 2, level.rim, edge_y))

    floor = design.lower_thickness
    roof = floor + design.cavity_height
    share = level.edge_z / level.membrane
    z = _join(
        graded(floor, 0.0, level.membrane, share * floor),
        np.linspace(floor, roof, level.spacer + 1),
        graded(roof, design.thickness, level.membrane, share * design.upper_thickness),
    )
    return _join(*x), _join(*y), z


@dataclass(frozen=True)
class Reference:
    """Shape functions of the 27-node hexahedron at its 3 x 3 x 3 Gauss points.

    shape : (27, 27) array, point by node; gradient : (27, 27, 3) array, point by
    node by direction, on the unit cube; weight : (27,) array; point : (27, 3) array.
    The same on a face (9 nodes, 3 x 3 points): face_shape (9, 9), face_gradient
    (9, 9, 2), face_weight (9,).  node_gradient : (27, 27, 3) array, as `gradient`, at
    the nodes.
    """

    shape: Array
    gradient: Array
    weight: Array
    point: Array
    face_shape: Array
    face_gradient: Array
    face_weight: Array
    node_gradient: Array


def _lattice(locations: Array) -> Array:
    """Order of nodes that sorts their locations with the first axis slowest."""
    keys = tuple(np.round(locations[:, axis], 9) for axis in range(locations.shape[1]))
    return np.lexsort(keys[::-1])


@lru_cache(maxsize=1)
def reference() -> Reference:
    """The reference element, from scikit-fem's basis and quadrature."""
    tables = []
    for element in (ElementHex2(), ElementQuad2()):
        order = _lattice(element.doflocs)
        points, weights = get_quadrature(element, 5)
        values = [element.lbasis(points, int(i)) for i in order]
        shape = np.stack([value for value, _ in values], axis=1)
        gradient = np.stack([slope.T for _, slope in values], axis=1)
        tables.append((shape, np.ascontiguousarray(gradient), weights, points.T))
    (shape, gradient, weight, point), (fshape, fgradient, fweight, _) = tables
    element = ElementHex2()
    order = _lattice(element.doflocs)
    slopes = [element.lbasis(element.doflocs[order].T, int(i))[1].T for i in order]
    return Reference(
        shape,
        gradient,
        weight,
        point,
        fshape,
        fgradient,
        fweight,
        node_gradient=np.stack(slopes, axis=1),
    )


@dataclass(frozen=True)
class Mesh:
    """What the solver needs to know of any body of two layers around cavities.

    Parameters
    ----------
    nodes : (n, 3) array, m
        Undeformed node positions.
    cells : (e, 27) array of int
        Node numbers in lattice order (x slowest, z fastest).
    layer : (e,) array of int
        `LOWER` or `UPPER`.
    cavity_faces : (f, 9) array of int
        Faces of the cavity walls; x_xi cross x_eta points out of the cavity.  They
        enclose the cavity together with planes through the origin and with edges that
        do not move; a follower pressure then has a potential.
    gap : (g, 2) array of int
        Pairs of floor and roof nodes that face each other.
    gap_wall : (g,) array of int
        For each pair the pair on the outer wall at the same x, which keeps apart.
    """

    nodes: Array
    cells: Array
    layer: Array
    cavity_faces: Array
    gap: Array
    gap_wall: Array

    def touching(self, x: Array) -> bool:
        """True when a roof node has gone through the floor node under it.

        Parameters
        ----------
        x : (n, 3) array, m
            Deformed nodes.
        """
        across = x[self.gap[:, 1]] - x[self.gap[:, 0]]
        side = across[self.gap_wall]
        through = np.sum(across * side, axis=1) <= 0
        # Far apart they may well stand at an angle: a wall that a large balloon turns.
        near = np.linalg.norm(across, axis=1) <= np.linalg.norm(side, axis=1)
        return bool((through & near).any())


@dataclass(frozen=True)
class StripMesh(Mesh):
    """Nodes, elements and named parts of the half strip.

    Parameters
    ----------
    nodes, cells, layer, cavity_faces, gap, gap_wall
        See `Mesh`.
    balloon : (f,) array of int
        Number of the balloon each face belongs to.
    root : (r,) array of int
        Nodes of the clamped face x = 0.
    mid_plane : (k,) array of int
        Nodes of the symmetry plane y = 0.
    lines : dict of str to (2 c + 1,) array of int
        Rows of nodes along x: ``bottom`` (y = 0, z = 0), ``rim`` (the strip's side,
        z = 0), and ``roof_middle``, ``roof_edge``, ``floor_middle``, ``floor_edge`` on
        the outer surfaces over the middle and the outer edge of the balloon nearest
        y = 0.
    tip : (3,) array of int
        Nodes of the element edge at x = L, y = 0 that spans mid-thickness.
    tip_weights : (3,) array
        Their shape functions at mid-thickness.
    level : MeshLevel
    place : (n, 3) array of int
        Number of each node along x, y and z.
    """

    balloon: Array
    root: Array
    mid_plane: Array
    lines: dict[str, Array]
    tip: Array
    tip_weights: Array
    level: MeshLevel
    place: Array

    def of(self, design: Design) -> StripMesh:
        """The same mesh on a design with as many balloons, other lengths.

        Raises
        ------
        InputError
            When the design has other divisions.
        """
        lines = [_with_middles(g) for g in grid_lines(design, self.level)]
        if [len(g) for g in lines] != (self.place.max(axis=0) + 1).tolist():
            divisions = (design.divisions_x, design.divisions_y)
            raise InputError("divisions", divisions, "those of the mesh")
        nodes = np.stack([g[self.place[:, i]] for i, g in enumerate(lines)], axis=1)
        tip, weights = _tip(self.place, lines[2], design.thickness / 2)
        return replace(self, nodes=nodes, tip=tip, tip_weights=weights)


def _with_middles(lines: Array) -> Array:
    """Grid lines and the middles between them, in order: where nodes lie."""
    ordered: Array = np.sort(np.concatenate([lines, (lines[1:] + lines[:-1]) / 2]))
    return ordered


def _tip(place: Array, z: Array, height: float) -> tuple[Array, Array]:
    """Nodes (3,) around a height at x = L, y = 0, and their shape functions there.

    Parameters
    ----------
    place : (n, 3) array of int
        See `StripMesh`.
    z : (2 c + 1,) array, m
        Heights of the nodes of c elements.
    height : float, m
    """
    ends = z[::2]
    k = min(int(np.searchsorted(ends, height, side="right")) - 1, len(ends) - 2)
    t = (height - ends[k]) / (ends[k + 1] - ends[k])
    last = place[:, 0].max()
    edge = np.flatnonzero((place[:, 0] == last) & (place[:, 1] == 0))
    column = edge[np.argsort(place[edge, 2])]
    weights = np.array([(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)])
    return column[2 * k : 2 * k + 3], weights


_FACE_AXES = {0: (1, 2), 1: (2, 0), 2: (0, 1)}


def face_nodes(axis: int, side: int) -> Array:
    """Lattice numbers of one face, ordered so that its normal points inwards.

    Inwards is into the solid element, which is out of the cavity on its other side.
    """
    lattice = np.arange(27).reshape(3, 3, 3)
    face = np.take(lattice, 2 * side, axis=axis)  # remaining axes keep their order
    first, second = _FACE_AXES[axis]
    if first > second:
        face = face.T  # now (first, second), whose cross product is +axis
    if side == 1:  # the solid lies on the minus side of its plus face
        face = face.T
    flat: Array = face.reshape(-1)
    return flat


def _inside(centres: Array, intervals: Sequence[tuple[float, float]]) -> Array:
    """Number of the interval that holds each centre, -1 for none."""
    found = np.full(centres.shape, -1)
    for i, (left, right) in enumerate(intervals):
        found[(centres > left) & (centres < right)] = i
    return found


def build_mesh(design: Design, level: MeshLevel) -> StripMesh:
    """Mesh of the half strip y >= 0 of one design.

    Parameters
    ----------
    design : Design
    level : MeshLevel

    Returns
    -------
    StripMesh
    """
    x, y, z = grid_lines(design, level)
    centre_x, centre_y, centre_z = ((g[1:] + g[:-1]) / 2 for g in (x, y, z))
    floor = design.lower_thickness
    roof = floor + design.cavity_height
    in_x = _inside(centre_x, design.balloons_x())
    in_y = _inside(centre_y, design.balloons_y())
    in_z = _inside(centre_z, [(floor, roof)])
    void = (
        (in_x >= 0)[:, None, None]
        & (in_y >= 0)[None, :, None]
        & (in_z >= 0)[None, None]
    )
    number = np.where(
        void, (in_x[:, None] * (in_y.max() + 1) + in_y[None, :])[:, :, None], -1
    )

    box = MeshHex.init_tensor(x, y, z)
    centres = box.p[:, box.t].mean(axis=1)
    index = tuple(
        np.searchsorted(g, c) - 1 for g, c in zip((x, y, z), centres, strict=True)
    )
    solid = box.restrict(np.nonzero(~void[index])[0])
    basis = Basis(solid, ElementHex2(), intorder=0)
    nodes = np.ascontiguousarray(basis.doflocs.T)
    unordered = basis.element_dofs.T

    # Rank each element's nodes by position: lattice order, x slowest.
    scale = np.array([len(g) for g in (x, y, z)]) * 4
    fine = [_with_middles(g) for g in (x, y, z)]
    rank = [
        np.searchsorted(f, nodes[:, axis] - 1e-9 * (f[-1] - f[0]))
        for axis, f in enumerate(fine)
    ]
    key = (rank[0] * scale[1] + rank[1]) * scale[2] + rank[2]
    order = np.argsort(key[unordered], axis=1)
    cells = np.ascontiguousarray(np.take_along_axis(unordered, order, axis=1))
    node_at = dict(zip(key.tolist(), range(len(nodes)), strict=True))

    cell_index = np.stack([rank[axis][cells[:, 0]] // 2 for axis in range(3)], axis=1)
    faces, balloons = [], []
    for axis in range(3):
        for side in (0, 1):
            beside = cell_index.copy()
            beside[:, axis] += 1 if side else -1
            ok = (beside[:, axis] >= 0) & (beside[:, axis] < void.shape[axis])
            hit = np.full(len(cells), -1)
            hit[ok] = number[tuple(beside[ok].T)]
            chosen = np.nonzero(hit >= 0)[0]
            faces.append(cells[chosen][:, face_nodes(axis, side)])
            balloons.append(hit[chosen])

    def row(y_value: float, z_value: float) -> Array:
        j = int(np.argmin(np.abs(fine[1] - y_value)))
        k = int(np.argmin(np.abs(fine[2] - z_value)))
        keys = (np.arange(len(fine[0])) * scale[1] + j) * scale[2] + k
        return np.array([node_at[int(i)] for i in keys])

    first = design.balloons_y()[0]
    middle = 0.0 if first[0] == 0.0 else (first[0] + first[1]) / 2
    lines = {
        "bottom": row(0.0, 0.0),
        "rim": row(design.width / 2, 0.0),
        "roof_middle": row(middle, design.thickness),
        "roof_edge": row(first[1], design.thickness),
        "floor_middle": row(middle, 0.0),
        "floor_edge": row(first[1], 0.0),
    }

    place = np.stack(rank, axis=1)
    # To the last bit where `StripMesh.of` puts them.
    nodes = np.stack([g[place[:, i]] for i, g in enumerate(fine)], axis=1)
    tip, tip_weights = _tip(place, fine[2], design.thickness / 2)

    wet = np.unique(np.concatenate(faces))
    at_floor = rank[2] == 2 * level.membrane
    at_roof = rank[2] == 2 * (level.membrane + level.spacer)
    under = {(int(rank[0][n]), int(rank[1][n])): int(n) for n in wet[at_floor[wet]]}
    gap = np.array(
        [
            (under[spot], int(n))
            for n in wet[at_roof[wet]]
            if (spot := (int(rank[0][n]), int(rank[1][n]))) in under
        ]
    )
    at_x, at_y = rank[0][gap[:, 0]], rank[1][gap[:, 0]]
    outermost = {int(at_x[i]): int(i) for i in np.argsort(at_y, kind="stable")}
    return StripMesh(
        nodes=nodes,
        cells=cells,
        layer=np.where(cell_index[:, 2] >= level.membrane + level.spacer, UPPER, LOWER),
        cavity_faces=np.concatenate(faces),
        balloon=np.concatenate(balloons),
        gap=gap,
        gap_wall=np.array([outermost[int(i)] for i in at_x]),
        root=np.nonzero(rank[0] == 0)[0],
        mid_plane=np.nonzero(rank[1] == 0)[0],
        lines=lines,
        tip=tip,
        tip_weights=tip_weights,
        level=level,
        place=place,
    )
