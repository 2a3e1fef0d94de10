"""What acts on faces of elements besides pressure: elastic supports and thin skins.

Both are fields of a problem, and cost nothing where a problem has none.  Faces are nine
nodes each; entries of their matrices run over (direction, node), node fastest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from .mesh import reference

Array = np.ndarray


@dataclass(frozen=True)
class Springs:
    """Elastic support of some faces (Winkler): t = -(kn n(x)n + kt (I - n(x)n)) u.

    n is the undeformed normal; t is per undeformed area.

    Parameters
    ----------
    faces : (f, 9) array of int
    normal, tangential : float, Pa/m
        kn and kt, at least 0.
    """

    faces: Array
    normal: float
    tangential: float

    def matrices(self, nodes: Array) -> Array:
        """Stiffness (f, 27, 27), N/m, on undeformed nodes (n, 3)."""
        ref = reference()
        return _spring_matrices(
            nodes,
            self.faces,
            ref.face_shape,
            ref.face_gradient,
            ref.face_weight,
            self.normal,
            self.tangential,
        )


@njit(cache=True)
def _spring_matrices(
    nodes: Array,
    faces: Array,
    shape: Array,
    slope: Array,
    weight: Array,
    normal: float,
    tangential: float,
) -> Array:
    """Consistent matrices: integral of N_a N_b (kn n n + kt (I - n n)) dA."""
    out = np.zeros((len(faces), 27, 27))
    for face in range(len(faces)):
        for q in range(9):
            one, two = np.zeros(3), np.zeros(3)
            for a in range(9):
                one += slope[q, a, 0] * nodes[faces[face, a]]
                two += slope[q, a, 1] * nodes[faces[face, a]]
            across = np.cross(one, two)
            area = np.sqrt(np.sum(across**2))
            n = across / area
            for i in range(3):
                for j in range(3):
                    k = (normal - tangential) * n[i] * n[j]
                    if i == j:
                        k += tangential
                    k *= weight[q] * area
                    for a in range(9):
                        for b in range(9):
                            out[face, 9 * i + a, 9 * j + b] += (
                                k * shape[q, a] * shape[q, b]
                            )
    return out


@njit(cache=True)
def add_matrix_force(force: Array, u: Array, faces: Array, matrices: Array) -> None:
    """Add K u of every face to nodal forces (n, 3), N, in place; u (n, 3) in m."""
    for face in range(len(faces)):
        for r in range(27):
            total = 0.0
            for s in range(27):
                total += matrices[face, r, s] * u[faces[face, s % 9], s // 9]
            force[faces[face, r % 9], r // 9] += total


@njit(cache=True)
def add_matrices(data: Array, position: Array, matrices: Array) -> None:
    """Add matrices (f, 27, 27) of faces to the values of a sparse upper triangle.

    position : (f, 27 * 28 / 2) array of int; where each entry goes, -1 for nowhere.
    """
    for face in range(len(matrices)):
        entry = 0
        for r in range(27):
            for s in range(r, 27):
                where = position[face, entry]
                if where >= 0:
                    data[where] += matrices[face, r, s]
                entry += 1


@dataclass(frozen=True)
class Skin:
    """Stiff layer of no thickness on some faces: a neo-Hookean membrane.

    W = (k/6) (tr C + 1/det C - 3) per undeformed area, with the surface's own
    Cauchy-Green tensor C and k = E h of an incompressible skin (Holzapfel 2000,
    Nonlinear Solid Mechanics, section 6.5, in plane stress).

    Parameters
    ----------
    faces : (f, 9) array of int
    stiffness : float, N/m
        k, at least 0.
    """

    faces: Array
    stiffness: float

    def energy(self, nodes: Array, x: Array) -> float:
        """Of undeformed and deformed nodes (n, 3), J."""
        ref = reference()
        slope, weight = ref.face_gradient, ref.face_weight
        first, second = (
            np.einsum("qad,fai->fqdi", slope, of[self.faces]) for of in (nodes, x)
        )
        old = np.einsum("fqdi,fqei->fqde", first, first)
        new = np.einsum("fqdi,fqei->fqde", second, second)
        ratio = np.linalg.det(new) / np.linalg.det(old)
        trace = np.einsum("fqde,fqde->fq", np.linalg.inv(old), new)
        area = weight * np.sqrt(np.linalg.det(old))
        total = np.sum(area * (trace + 1 / ratio - 3))
        return float(self.stiffness / 6 * total)

    def respond(self, nodes: Array, x: Array, force: Array, tangent: bool) -> Array:
        """Add its forces to `force` (n, 3), N; return its matrices (f, 27, 27), N/m.

        An array without matrices where the tangent is not wanted.
        """
        ref = reference()
        matrices = np.zeros((len(self.faces) if tangent else 0, 27, 27))
        _skin(
            force,
            matrices,
            nodes,
            x,
            self.faces,
            ref.face_gradient,
            ref.face_weight,
            self.stiffness,
        )
        return matrices


@njit(cache=True, fastmath=True)
def _metric(at: Array, face: Array, slope: Array, base: Array, inverse: Array) -> float:
    """Base vectors (2, 3) of a face at a point, inverse metric (2, 2); det metric."""
    base[:] = 0.0
    for a in range(9):
        for i in range(3):
            base[0, i] += slope[a, 0] * at[face[a], i]
            base[1, i] += slope[a, 1] * at[face[a], i]
    g00 = g01 = g11 = 0.0
    for i in range(3):
        g00 += base[0, i] * base[0, i]
        g01 += base[0, i] * base[1, i]
        g11 += base[1, i] * base[1, i]
    det = g00 * g11 - g01 * g01
    inverse[0, 0], inverse[1, 1] = g11 / det, g00 / det
    inverse[0, 1] = inverse[1, 0] = -g01 / det
    return float(det)


@njit(cache=True, fastmath=True)
def _skin(
    force: Array,
    matrices: Array,
    nodes: Array,
    x: Array,
    faces: Array,
    gradient: Array,
    weight: Array,
    stiffness: float,
) -> None:
    """Forces and matrices of a skin.

    With metrics G of the undeformed and g of the deformed face, upper indices for the
    inverse, and c = det G / det g:
    S^ab = (k/3) (G^ab - c g^ab), force of a node = S^ab N,a g_b,
    D^abcd = 2 dS^ab/dg_cd = (k/3) c (g^ac g^bd + g^ad g^bc + 2 g^ab g^cd).
    """
    old, new = np.empty((2, 3)), np.empty((2, 3))
    up, low = np.empty((2, 2)), np.empty((2, 2))
    s = np.empty((2, 2))
    d = np.empty((2, 2, 2, 2))
    b, e = np.empty((2, 2, 27)), np.empty((2, 2, 27))
    for f in range(len(faces)):
        face = faces[f]
        for q in range(9):
            n = gradient[q]
            before = _metric(nodes, face, n, old, up)
            after = _metric(x, face, n, new, low)
            c = before / after
            k = stiffness / 3 * weight[q] * np.sqrt(before)
            for i in range(2):
                for j in range(2):
                    s[i, j] = k * (up[i, j] - c * low[i, j])
            for a in range(9):
                for i in range(2):
                    share = s[i, 0] * n[a, 0] + s[i, 1] * n[a, 1]
                    for m in range(3):
                        force[face[a], m] += share * new[i, m]
            if not len(matrices):
                continue
            for i in range(2):
                for j in range(2):
                    for m in range(2):
                        for o in range(2):
                            d[i, j, m, o] = (
                                k
                                * c
                                * (
                                    low[i, m] * low[j, o]
                                    + low[i, o] * low[j, m]
                                    + 2 * low[i, j] * low[m, o]
                                )
                            )
                    for r in range(27):
                        b[i, j, r] = n[r % 9, i] * new[j, r // 9]
            for i in range(2):
                for j in range(2):
                    for r in range(27):
                        e[i, j, r] = 0.0
                        for m in range(2):
                            for o in range(2):
                                e[i, j, r] += d[i, j, m, o] * b[m, o, r]
            block = matrices[f]
            for r in range(27):
                for t in range(27):
                    total = 0.0
                    for i in range(2):
                        for j in range(2):
                            total += b[i, j, r] * e[i, j, t]
                            if r // 9 == t // 9:
                                total += n[r % 9, i] * s[i, j] * n[t % 9, j]
                    block[r, t] += total
