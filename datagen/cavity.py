"""The follower pressure on the faces of a cavity.

The cavity is closed (its open side lies in the symmetry plane, where u_y = 0), so the
pressure has the potential -p V; V is cubic in the node positions, and its first and
second derivatives are exact.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit

from .mesh import Reference, reference

Array = np.ndarray


@lru_cache(maxsize=1)
def face_tensor() -> Array:
    """(9, 9, 9) array S, totally antisymmetric, with V = sum S_abc x_a . (x_b x x_c).

    V is the volume of the cone from the origin to a nine-node face; summed over a
    closed surface it is the volume inside.  dV/dx_a = 3 sum S_abc (x_b x x_c).
    """
    ref: Reference = reference()
    shape, slope = ref.face_shape, ref.face_gradient
    raw = np.einsum(
        "q,qa,qb,qc->abc", ref.face_weight / 3, shape, slope[..., 0], slope[..., 1]
    )
    even = raw + raw.transpose(1, 2, 0) + raw.transpose(2, 0, 1)
    odd = raw.transpose(0, 2, 1) + raw.transpose(1, 0, 2) + raw.transpose(2, 1, 0)
    return np.ascontiguousarray((even - odd) / 6)


@njit(cache=True, fastmath=True)
def cavity(x: Array, faces: Array, tensor: Array) -> tuple[float, Array]:
    """Volume inside faces and its gradient by the node positions.

    Parameters
    ----------
    x : (n, 3) array, m
    faces : (f, 9) array of int
        Oriented out of the cavity.
    tensor : (9, 9, 9) array
        `face_tensor`.

    Returns
    -------
    volume : float, m3
    gradient : (n, 3) array, m2
        Times the pressure: the nodal forces of the follower load.
    """
    gradient = np.zeros(x.shape)
    volume = 0.0
    xe = np.empty((9, 3))
    m = np.empty((9, 3))
    for face in range(faces.shape[0]):
        for a in range(9):
            for i in range(3):
                xe[a, i] = x[faces[face, a], i]
        for a in range(9):
            v0 = v1 = v2 = 0.0
            for b in range(9):
                m[b, 0] = m[b, 1] = m[b, 2] = 0.0
                for c in range(9):
                    t = tensor[a, b, c]
                    m[b, 0] += t * xe[c, 0]
                    m[b, 1] += t * xe[c, 1]
                    m[b, 2] += t * xe[c, 2]
                v0 += xe[b, 1] * m[b, 2] - xe[b, 2] * m[b, 1]
                v1 += xe[b, 2] * m[b, 0] - xe[b, 0] * m[b, 2]
                v2 += xe[b, 0] * m[b, 1] - xe[b, 1] * m[b, 0]
            node = faces[face, a]
            gradient[node, 0] += 3 * v0
            gradient[node, 1] += 3 * v1
            gradient[node, 2] += 3 * v2
            volume += xe[a, 0] * v0 + xe[a, 1] * v1 + xe[a, 2] * v2
    return volume, gradient


@njit(cache=True, fastmath=True)
def cavity_rates(x: Array, dx: Array, faces: Array, tensor: Array) -> Array:
    """Derivatives of the volume's gradient along movements of the nodes.

    Parameters
    ----------
    x : (n, 3) array, m
    dx : (c, n, 3) array
    faces, tensor
        As in `cavity`.

    Returns
    -------
    (c, n, 3) array, m times the unit of `dx`
    """
    out = np.zeros(dx.shape)
    m = np.empty((9, 3))
    for face in range(faces.shape[0]):
        for a in range(9):
            for b in range(9):
                m[b, 0] = m[b, 1] = m[b, 2] = 0.0
                for c in range(9):
                    t, node = tensor[a, b, c], faces[face, c]
                    m[b, 0] += t * x[node, 0]
                    m[b, 1] += t * x[node, 1]
                    m[b, 2] += t * x[node, 2]
            for k in range(dx.shape[0]):
                v0 = v1 = v2 = 0.0
                for b in range(9):
                    d = dx[k, faces[face, b]]
                    v0 += d[1] * m[b, 2] - d[2] * m[b, 1]
                    v1 += d[2] * m[b, 0] - d[0] * m[b, 2]
                    v2 += d[0] * m[b, 1] - d[1] * m[b, 0]
                node = faces[face, a]
                out[k, node, 0] += 6 * v0
                out[k, node, 1] += 6 * v1
                out[k, node, 2] += 6 * v2
    return out


@njit(cache=True, fastmath=True)
def add_load_stiffness(
    data: Array, position: Array, x: Array, faces: Array, tensor: Array, pressure: float
) -> None:
    """Add -p d2V/dx2 of every face to the values of a sparse upper triangle.

    d2V/dx_ai dx_bj = 6 sum_c S_abc eps_ijk x_ck.

    Parameters
    ----------
    data : (nnz,) array, N/m
        Added to in place.
    position : (f, 27 * 28 / 2) array of int
        As in `elements.add_stiffness`, over (direction, node) with the node fastest.
    x, faces, tensor
        As in `cavity`.
    pressure : float, Pa
    """
    v = np.empty(3)
    for face in range(faces.shape[0]):
        entry = 0
        for r in range(27):
            i, a = r // 9, r % 9
            for s in range(r, 27):
                j, b = s // 9, s % 9
                where = position[face, entry]
                entry += 1
                if where < 0 or i == j:
                    continue
                k = 3 - i - j
                total = 0.0
                for c in range(9):
                    total += tensor[a, b, c] * x[faces[face, c], k]
                sign = 1.0 if (j - i) % 3 == 1 else -1.0
                v[k] = total
                data[where] -= 6 * pressure * sign * total
