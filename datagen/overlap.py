"""Whether neighbouring balloons have grown into each other, which no force resists.

The outer surface of the strip is a net of node rows along x and across y.  Two balloons
that meet push the row over the wall between them into a loop: seen along the wall, the
row crosses itself.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from .mesh import StripMesh

Array = np.ndarray


def overlapping(mesh: StripMesh, x: Array) -> bool:
    """True where roofs or floors of neighbouring balloons overlap.

    Parameters
    ----------
    mesh : StripMesh
    x : (n, 3) array, m
        Deformed nodes of the half model; its mirror image is looked at, too.
    """
    return any(_loops(x[surface]) for surface in _surfaces(mesh))


def _surfaces(mesh: StripMesh) -> list[Array]:
    """Nodes of the upper and the lower face of the strip, (along x, across y)."""
    place, shape = mesh.place, mesh.place.max(axis=0) + 1
    found = []
    for level in (0, shape[2] - 1):
        nodes = np.flatnonzero(place[:, 2] == level)
        surface = np.empty(shape[:2], dtype=int)
        surface[place[nodes, 0], place[nodes, 1]] = nodes
        found.append(surface)
    return found


def _loops(surface: Array) -> bool:
    """Whether a row of a surface (nx, ny, 3) crosses itself."""
    along = (surface[:, j, [0, 2]] for j in range(surface.shape[1]))
    if any(_crosses(row) for row in along):
        return True
    # Across the strip, in planes that turn with it: y, and the height over the edge.
    edge = surface[:, -1, [0, 2]]
    tangent = np.gradient(edge, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    height = np.einsum("ijk,ik->ij", surface[:, :, [0, 2]] - edge[:, None], normal)
    half = np.stack([surface[:, :, 1], height], axis=2)
    whole = np.concatenate([half[:, :0:-1] * np.array([-1.0, 1.0]), half], axis=1)
    return any(_crosses(row) for row in whole)


@njit(cache=True)
def _crosses(row: Array) -> bool:
    """Whether two segments of a polyline (k, 2) cross that do not share a point."""
    for i in range(len(row) - 3):
        ax, ay = row[i, 0], row[i, 1]
        bx, by = row[i + 1, 0], row[i + 1, 1]
        for j in range(i + 2, len(row) - 1):
            cx, cy = row[j, 0], row[j, 1]
            dx, dy = row[j + 1, 0], row[j + 1, 1]
            if max(ax, bx) < min(cx, dx) or max(cx, dx) < min(ax, bx):
                continue
            if max(ay, by) < min(cy, dy) or max(cy, dy) < min(ay, by):
                continue
            c = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
            d = (bx - ax) * (dy - ay) - (by - ay) * (dx - ax)
            a = (dx - cx) * (ay - cy) - (dy - cy) * (ax - cx)
            b = (dx - cx) * (by - cy) - (dy - cy) * (bx - cx)
            if c * d < 0 and a * b < 0:
                return True
    return False
