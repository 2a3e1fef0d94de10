"""Draw a mesh of 27-node hexahedra as a shaded picture.

An orthographic z-buffer: hidden surfaces come out right where sorting faces by depth,
as plotting packages do, fails on a strip much longer than it is thick.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

Array = np.ndarray


@dataclass(frozen=True)
class Patches:
    """Biquadratic faces to draw.

    Parameters
    ----------
    points : (f, 9, 3) array, m
        Nodes of each face, first direction slowest.
    colours : (f, 9, 3) array
        Red, green and blue of each node, 0 to 1.
    """

    points: Array
    colours: Array


def boundary_faces(cells: Array) -> tuple[Array, Array]:
    """Faces that belong to one element alone.

    Parameters
    ----------
    cells : (e, 27) array of int
        Nodes of each element in lattice order, x slowest.

    Returns
    -------
    faces : (f, 9) array of int, nodes in lattice order on the face.
    owners : (f,) array of int, the element of each face.
    """
    lattice = np.arange(27).reshape(3, 3, 3)
    sides = [
        np.take(lattice, side, axis).ravel() for axis in range(3) for side in (0, 2)
    ]
    faces = np.concatenate([cells[:, side] for side in sides])
    middle = faces[:, 4]  # a face's middle node belongs to no other face
    _, first, count = np.unique(middle, return_index=True, return_counts=True)
    alone = first[count == 1]
    return faces[alone], alone % len(cells)


def _quadratic(t: Array) -> Array:
    """(3, k) shape functions of the 3-node line at t in 0..1."""
    return np.stack([(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)])


def triangles(
    patches: Patches, cuts: int = 4
) -> tuple[Array, Array, Array, Array, Array]:
    """Cut every face into `cuts` x `cuts` x 2 triangles.

    Returns
    -------
    points (v, 3), normals (v, 3), colours (v, 3), edge (v, 2), corners (t, 3).
    `edge` is the place on the face, -1 to 1 in both directions.
    """
    t = np.linspace(0, 1, cuts + 1)
    shape = _quadratic(t)
    slope = np.stack([4 * t - 3, 4 - 8 * t, 4 * t - 1])

    def spread(first: Array, second: Array, values: Array) -> Array:
        grid = values.reshape(-1, 3, 3, 3)
        return np.einsum("ai,bj,fabc->fijc", first, second, grid).reshape(-1, 3)

    points = spread(shape, shape, patches.points)
    normals = np.cross(
        spread(slope, shape, patches.points), spread(shape, slope, patches.points)
    )
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    colours = spread(shape, shape, patches.colours)
    place = np.stack(np.meshgrid(2 * t - 1, 2 * t - 1, indexing="ij"), -1).reshape(
        -1, 2
    )
    edge = np.tile(place, (len(patches.points), 1))

    node = np.arange((cuts + 1) ** 2).reshape(cuts + 1, cuts + 1)
    a, b, c, d = (
        part.ravel()
        for part in (node[:-1, :-1], node[1:, :-1], node[1:, 1:], node[:-1, 1:])
    )
    one = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    start = np.arange(len(patches.points)) * (cuts + 1) ** 2
    return points, normals, colours, edge, (start[:, None, None] + one).reshape(-1, 3)


@njit(cache=True)
def _rasterise(
    screen: Array, corners: Array, height: int, width: int
) -> tuple[Array, Array, Array]:
    """Nearest triangle of every pixel, -1 for none, and its barycentric weights."""
    depth = np.full((height, width), np.inf)
    nearest = np.full((height, width), -1)
    weights = np.zeros((height, width, 3))
    for k in range(corners.shape[0]):
        p, q, r = screen[corners[k, 0]], screen[corners[k, 1]], screen[corners[k, 2]]
        area = (q[0] - p[0]) * (r[1] - p[1]) - (r[0] - p[0]) * (q[1] - p[1])
        if abs(area) < 1e-12:
            continue
        left = max(int(np.floor(min(p[0], q[0], r[0]))), 0)
        right = min(int(np.ceil(max(p[0], q[0], r[0]))) + 1, width)
        top = max(int(np.floor(min(p[1], q[1], r[1]))), 0)
        bottom = min(int(np.ceil(max(p[1], q[1], r[1]))) + 1, height)
        for i in range(top, bottom):
            for j in range(left, right):
                x, y = j + 0.5, i + 0.5
                wq = ((x - p[0]) * (r[1] - p[1]) - (r[0] - p[0]) * (y - p[1])) / area
                wr = ((q[0] - p[0]) * (y - p[1]) - (x - p[0]) * (q[1] - p[1])) / area
                wp = 1.0 - wq - wr
                if wp < 0 or wq < 0 or wr < 0:
                    continue
                here = wp * p[2] + wq * q[2] + wr * r[2]
                if here < depth[i, j]:
                    depth[i, j] = here
                    nearest[i, j] = k
                    weights[i, j, 0], weights[i, j, 1], weights[i, j, 2] = wp, wq, wr
    return nearest, weights


def _slope(screen: Array, values: Array) -> Array:
    """Length of the gradient over the screen of values that are linear on triangles.

    screen : (t, 3, 2) array, values : (t, 3, k) array; returns (t, k), per pixel.
    """
    (ax, ay), (bx, by) = ((screen[:, i] - screen[:, 0]).T[..., None] for i in (1, 2))
    da, db = (values[:, i] - values[:, 0] for i in (1, 2))
    return np.hypot(da * by - db * ay, db * ax - da * bx) / np.abs(ax * by - bx * ay)


@dataclass(frozen=True)
class Camera:
    """Orthographic view: where the eye stands, as angles round the z axis.

    azimuth, elevation : float, degrees
        Direction from the body to the eye: azimuth from +x towards +y.
    """

    azimuth: float = -68.0
    elevation: float = 24.0

    def axes(self) -> Array:
        """(3, 3) array: rows right, up, and towards the eye."""
        a, e = np.radians([self.azimuth, self.elevation])
        eye = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        right = np.array([-np.sin(a), np.cos(a), 0.0])
        return np.stack([right, np.cross(eye, right), eye])


def render(
    patches: Patches,
    camera: Camera,
    width: int = 1400,
    margin: float = 0.03,
    line: float = 0.35,
    oversample: int = 3,
) -> Array:
    """Picture of the faces on a transparent ground.

    Parameters
    ----------
    patches : Patches
    camera : Camera
    width : int
        Pixels; the height follows from the body.
    margin : float
        Free border as a share of the width.
    line : float
        How dark the element edges are drawn, 0 to 1.
    oversample : int
        Pixels computed a side for each pixel of the picture.

    Returns
    -------
    (height, width, 4) array, red, green, blue and opacity, 0 to 1.
    """
    points, normals, colours, edge, corners = triangles(patches)
    view = points @ camera.axes().T
    low, high = view.min(axis=0), view.max(axis=0)
    scale = width * (1 - 2 * margin) / (high[0] - low[0])
    height = int(np.ceil((high[1] - low[1]) * scale + 2 * margin * width))
    border = margin * width
    screen = np.empty_like(view)
    screen[:, 0] = (view[:, 0] - low[0]) * scale + border
    screen[:, 1] = (high[1] - view[:, 1]) * scale + border
    screen[:, :2] *= oversample
    screen[:, 2] = -view[:, 2]

    nearest, weights = _rasterise(
        screen, corners, height * oversample, width * oversample
    )
    seen = nearest >= 0
    corner, weight = corners[nearest[seen]], weights[seen][:, :, None]

    normal = (normals[corner] * weight).sum(axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    axes = camera.axes()
    normal *= np.sign(normal @ axes[2])[:, None]  # both sides of a face are lit
    lamp = axes[2] + 0.6 * axes[1] - 0.3 * axes[0]
    lamp /= np.linalg.norm(lamp)
    light = 0.45 + 0.6 * np.clip(normal @ lamp, 0, 1)

    # Distance from the nearest edge of the face, in pixels of the picture.
    place = (edge[corner] * weight).sum(axis=1)
    away = (1 - np.abs(place)) / _slope(screen[corner][..., :2], edge[corner])
    away = away.min(axis=1) / oversample
    ink = line * np.clip(1.0 - away, 0, 1)

    fine = np.zeros((*seen.shape, 4))
    rgb = (colours[corner] * weight).sum(axis=1) * light[:, None]
    fine[seen, :3] = np.clip(rgb, 0, 1) * (1 - ink[:, None])
    fine[seen, 3] = 1
    blocks = fine.reshape(height, oversample, width, oversample, 4).mean(axis=(1, 3))
    opacity = np.maximum(blocks[..., 3:], 1e-9)
    blocks[..., :3] /= opacity  # colours were averaged with the empty ground
    return np.clip(blocks, 0, 1)
