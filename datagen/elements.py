"""Batched arithmetic of the 27-node hexahedron with a discontinuous pressure.

Three-field form of Simo, Taylor and Pister (1985) with dilatation and pressure linear
in each element and condensed there: the volumetric energy is the integral of
U(Jt), where Jt is the element-wise L2 projection of J = det F on (1, xi, eta, zeta).
The displacements stay the only unknowns and the tangent stays symmetric.  A small share
of the energy, `LOCAL_SHARE`, is taken at J itself, against spurious collapse.

An initial strain F = Fe Fg enters by taking the grown shape as reference: gradients are
multiplied by Fg^-1 and volumes by det Fg, so the arithmetic sees Fe alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from .mesh import reference

Array = np.ndarray

LOCAL_SHARE = 0.02
"""Share a of the volumetric energy (1 - a) U(Jt) + a U(J) that is not projected.

The isochoric energy does not feel J, so nothing but the projection resists a change of
volume that is neither constant nor linear in an element.  At large strain such modes
collapse in flat elements beside the balloons' edges: J fell to 0.58 on S1 at 60 kPa on
a fine mesh, and paths of thin roofs were lost.  With a = 0.02 (half a shear modulus at
nu = 0.48) the cases seen then were cured, and the answer on the standard mesh moves by
less than its own error; on refinement the share makes no difference.
"""

LOCAL_SHEAR = 0.5
"""Largest a K over the shear modulus.  More locks: no element can follow J point by
point, so at K/mu of a thousand a constant share makes coarse meshes too stiff."""


def local_share(shear: Array, bulk: Array) -> float:
    """`LOCAL_SHARE`, or less for a body stiffer in volume than at nu = 0.48.

    Parameters
    ----------
    shear, bulk : (e,) array, Pa
    """
    return min(LOCAL_SHARE, float((LOCAL_SHEAR * shear / bulk).min()))


@dataclass(frozen=True)
class ElementData:
    """What the kernels need of the undeformed elements.

    inverse : (e, 27, 9) array, 1/m; d xi / d X times Fg^-1, row-major.
    weight : (e, 27) array, m3; quadrature weight times volume, times det Fg.
    basis : (27, 4) array; the pressure basis 1, xi, eta, zeta (centred).
    mass_inverse : (e, 4, 4) array, 1/m3; inverse of the basis's mass matrix.
    """

    inverse: Array
    weight: Array
    basis: Array
    mass_inverse: Array


def element_data(
    nodes: Array, cells: Array, growth: Array | None = None
) -> ElementData:
    """Gradients and weights of isoparametric elements.

    Parameters
    ----------
    nodes : (n, 3) array, m
    cells : (e, 27) array of int
    growth : (e, 3, 3) array, optional
        Initial strain Fg of each element; identity where it is not given.

    Raises
    ------
    ValueError
        When an undeformed element is inverted.
    """
    ref = reference()
    basis = np.concatenate([np.ones((27, 1)), ref.point - 0.5], axis=1)
    inverse, weight, mass = _reference_shape(
        nodes, cells, ref.gradient, ref.weight, basis
    )
    if not (weight > 0).all():
        raise ValueError(f"element {int(np.argmin(weight.min(axis=1)))} is inverted")
    if growth is not None:
        change = np.linalg.det(growth)
        inverse = inverse.reshape(-1, 27, 3, 3) @ np.linalg.inv(growth)[:, None]
        inverse = np.ascontiguousarray(inverse.reshape(-1, 27, 9))
        weight = weight * change[:, None]
        mass = mass * change[:, None, None]
    return ElementData(inverse, weight, basis, np.linalg.inv(mass))


@njit(cache=True)
def _reference_shape(
    nodes: Array, cells: Array, gradient: Array, point_weight: Array, basis: Array
) -> tuple[Array, Array, Array]:
    """Inverse Jacobians (e, 27, 9), weights (e, 27) and mass matrices (e, 4, 4)."""
    elements = cells.shape[0]
    inverse = np.empty((elements, 27, 9))
    weight = np.empty((elements, 27))
    mass = np.zeros((elements, 4, 4))
    j, c, xe = np.empty(9), np.empty(9), np.empty((27, 3))
    for e in range(elements):
        for a in range(27):
            for i in range(3):
                xe[a, i] = nodes[cells[e, a], i]
        for q in range(27):
            j[:] = 0.0
            for a in range(27):
                for i in range(3):
                    for k in range(3):
                        j[3 * i + k] += xe[a, i] * gradient[q, a, k]
            det = cofactor(j, c)
            for i in range(3):
                for k in range(3):
                    inverse[e, q, 3 * i + k] = c[3 * k + i] / det
            w = point_weight[q] * det
            weight[e, q] = w
            for m in range(4):
                for n in range(4):
                    mass[e, m, n] += w * basis[q, m] * basis[q, n]
    return inverse, weight, mass


@njit(cache=True, fastmath=True)
def deformation(x: Array, cells: Array, gradient: Array, inverse: Array) -> Array:
    """Elastic deformation gradient at every quadrature point.

    Parameters
    ----------
    x : (n, 3) array, m
        Deformed node positions.
    cells : (e, 27) array of int
    gradient : (27, 27, 3) array
        Of the reference element.
    inverse : (e, 27, 9) array, 1/m

    Returns
    -------
    (27 e, 9) array
    """
    elements = cells.shape[0]
    f = np.empty((elements * 27, 9))
    flat = flattened(gradient)
    m = np.empty((3, 81))
    for e in range(elements):
        m[:] = 0.0
        for a in range(27):
            node = cells[e, a]
            x0, x1, x2 = x[node, 0], x[node, 1], x[node, 2]
            for k in range(81):
                m[0, k] += x0 * flat[a, k]
                m[1, k] += x1 * flat[a, k]
                m[2, k] += x2 * flat[a, k]
        for q in range(27):
            d = inverse[e, q]
            out = f[27 * e + q]
            for i in range(3):
                m0, m1, m2 = m[i, 3 * q], m[i, 3 * q + 1], m[i, 3 * q + 2]
                for j in range(3):
                    out[3 * i + j] = m0 * d[j] + m1 * d[3 + j] + m2 * d[6 + j]
    return f


@njit(cache=True)
def flattened(gradient: Array) -> Array:
    """Gradients (27, 27, 3), point by node by direction, as (27, 81), node by rest.

    What a node adds at all points is then one row: the loops over it are as long as
    the processor likes them.
    """
    flat = np.empty((27, 81))
    for q in range(27):
        for a in range(27):
            for j in range(3):
                flat[a, 3 * q + j] = gradient[q, a, j]
    return flat


@njit(cache=True, fastmath=True)
def cofactor(a: Array, c: Array) -> Any:
    """Cofactor matrix of `a` (9,) into `c`, and the determinant."""
    c[0] = a[4] * a[8] - a[5] * a[7]
    c[1] = a[5] * a[6] - a[3] * a[8]
    c[2] = a[3] * a[7] - a[4] * a[6]
    c[3] = a[2] * a[7] - a[1] * a[8]
    c[4] = a[0] * a[8] - a[2] * a[6]
    c[5] = a[1] * a[6] - a[0] * a[7]
    c[6] = a[1] * a[5] - a[2] * a[4]
    c[7] = a[2] * a[3] - a[0] * a[5]
    c[8] = a[0] * a[4] - a[1] * a[3]
    return a[0] * c[0] + a[1] * c[1] + a[2] * c[2]


@njit(cache=True, fastmath=True)
def smallest_determinant(f: Array) -> tuple[float, int]:
    """Smallest det F of (n, 9) gradients and the point that has it."""
    c = np.empty(9)
    least, where = np.inf, 0
    for q in range(f.shape[0]):
        det = cofactor(f[q], c)
        if not det >= least:  # also true of NaN
            least, where = det, q
    return least, where


@njit(cache=True, fastmath=True)
def internal_force(
    f: Array,
    stress: Array,
    bulk: Array,
    local: float,
    nodes: int,
    cells: Array,
    gradient: Array,
    inverse: Array,
    weight: Array,
    basis: Array,
    mass_inverse: Array,
) -> tuple[Array, Array]:
    """Nodal forces of the stress, and the element pressure fields.

    Parameters
    ----------
    f, stress : (27 e, 9) array
        Deformation gradient and isochoric stress (Pa) at every point.
    bulk : (e,) array, Pa
    local : float
        `LOCAL_SHARE`.
    nodes : int
        Number of nodes.
    cells, gradient, inverse, weight, basis, mass_inverse
        See `ElementData`.

    Returns
    -------
    force : (nodes, 3) array, N
    pressure : (e, 27) array, Pa
        dU/dJ at the points, projected and local share together; positive in tension.
    """
    elements = cells.shape[0]
    force = np.zeros((nodes, 3))
    pressure = np.empty((elements, 27))
    cof, dets = np.empty((27, 9)), np.empty(27)
    rhs, theta = np.empty(4), np.empty(4)
    flat = flattened(gradient)
    s = np.empty((3, 81))
    for e in range(elements):
        rhs[:] = 0.0
        for q in range(27):
            dets[q] = cofactor(f[27 * e + q], cof[q])
            for i in range(4):
                rhs[i] += weight[e, q] * basis[q, i] * (dets[q] - 1.0)
        for i in range(4):
            theta[i] = 0.0
            for j in range(4):
                theta[i] += mass_inverse[e, i, j] * rhs[j]
        for q in range(27):
            p = 0.0
            for i in range(4):
                p += basis[q, i] * theta[i]
            p = bulk[e] * ((1.0 - local) * p + local * (dets[q] - 1.0))
            pressure[e, q] = p
            t = stress[27 * e + q]
            d = inverse[e, q]
            w = weight[e, q]
            # s = w P D^T, so that the force is s times the reference gradient
            for i in range(3):
                p0 = w * (t[3 * i] + p * cof[q, 3 * i])
                p1 = w * (t[3 * i + 1] + p * cof[q, 3 * i + 1])
                p2 = w * (t[3 * i + 2] + p * cof[q, 3 * i + 2])
                for j in range(3):
                    s[i, 3 * q + j] = (
                        p0 * d[3 * j] + p1 * d[3 * j + 1] + p2 * d[3 * j + 2]
                    )
        for a in range(27):
            f0 = f1 = f2 = 0.0
            for k in range(81):
                f0 += s[0, k] * flat[a, k]
                f1 += s[1, k] * flat[a, k]
                f2 += s[2, k] * flat[a, k]
            node = cells[e, a]
            force[node, 0] += f0
            force[node, 1] += f1
            force[node, 2] += f2
    return force, pressure


@njit(cache=True, fastmath=True)
def second_stress(f: Array, stress: Array, pressure: Array) -> Array:
    """Second Piola-Kirchhoff stress S = F^-1 P, isochoric and volumetric together.

    Parameters
    ----------
    f, stress : (27 e, 9) array
        Deformation gradient and isochoric stress (Pa).
    pressure : (e, 27) array, Pa

    Returns
    -------
    (27 e, 6) array, Pa; 11, 22, 33, 12, 13, 23.
    """
    out = np.empty((f.shape[0], 6))
    cof = np.empty(9)
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    for q in range(f.shape[0]):
        det = cofactor(f[q], cof)
        p = pressure[q // 27, q % 27]
        for entry in range(6):
            j, k = pairs[entry]
            total = 0.0
            for i in range(3):
                total += cof[3 * i + j] * (stress[q, 3 * i + k] + p * cof[3 * i + k])
            out[q, entry] = total / det
    return out


@njit(cache=True, fastmath=True)
def replace_stress(tangent: Array, change: Array) -> None:
    """Let another stress make the geometric part of a tangent, in place.

    Parameters
    ----------
    tangent : (27 e, 81) array, Pa
    change : (27 e, 6) array, Pa
        The wanted second Piola-Kirchhoff stress minus the one at hand.
    """
    for q in range(tangent.shape[0]):
        c = change[q]
        t = tangent[q]
        for i in range(3):
            o = 30 * i
            t[o] += c[0]
            t[o + 10] += c[1]
            t[o + 20] += c[2]
            t[o + 1] += c[3]
            t[o + 9] += c[3]
            t[o + 2] += c[4]
            t[o + 18] += c[4]
            t[o + 11] += c[5]
            t[o + 19] += c[5]


@njit(cache=True, fastmath=True)
def _combine(
    c: Array, at: int, g0: Array, g1: Array, g2: Array, out: Array, place: int
) -> None:
    """Write c[at] g0 + c[at + 1] g1 + c[at + 2] g2 into out[place : place + 27]."""
    c0, c1, c2 = c[at], c[at + 1], c[at + 2]
    for n in range(27):
        out[place + n] = c0 * g0[n] + c1 * g1[n] + c2 * g2[n]


@njit(cache=True, fastmath=True)
def add_stiffness(
    data: Array,
    position: Array,
    f: Array,
    tangent: Array,
    pressure: Array,
    bulk: Array,
    local: float,
    gradient: Array,
    inverse: Array,
    weight: Array,
    basis: Array,
    mass_inverse: Array,
) -> None:
    """Add every element's tangent to the values of a sparse upper triangle.

    Parameters
    ----------
    data : (nnz,) array, N/m
        Added to in place.
    position : (e, 81 * 82 / 2) array of int
        Where each entry of the element's upper triangle goes, -1 for nowhere; rows
        and columns run over (direction, node) with the node fastest.
    f : (27 e, 9) array
    tangent : (27 e, 81) array, Pa
    pressure : (e, 27) array, Pa
    bulk : (e,) array, Pa
    local : float
        `LOCAL_SHARE`.
    gradient, inverse, weight, basis, mass_inverse
        See `ElementData`.
    """
    elements = weight.shape[0]
    g = np.empty((81, 27))  # gradients; rows (point, direction)
    last = np.empty((81, 81))  # what the gradients are multiplied with, i <= k
    middle, first = np.empty((81, 54)), np.empty((81, 27))
    with_last, with_middle = np.empty((27, 81)), np.empty((27, 54))
    with_first = np.empty((27, 27))
    row, held = np.empty(81), np.empty((4, 81))
    cof, b = np.empty(9), np.empty(81)
    moment = np.empty((4, 81))
    c = np.empty((9, 9))
    for e in range(elements):
        moment[:] = 0.0
        for q in range(27):
            d = inverse[e, q]
            for a in range(27):
                r0, r1, r2 = gradient[q, a, 0], gradient[q, a, 1], gradient[q, a, 2]
                for j in range(3):
                    g[3 * q + j, a] = r0 * d[j] + r1 * d[3 + j] + r2 * d[6 + j]
            point = 27 * e + q
            det = cofactor(f[point], cof)
            w = weight[e, q]
            # dP/dF plus the pressure times d2J/dF2 = (cof cof - swapped) / J
            factor = pressure[e, q] / det
            stiff = factor + local * bulk[e]
            for i in range(3):
                for j in range(3):
                    r = 3 * i + j
                    for k in range(3):
                        for m in range(3):
                            s = 3 * k + m
                            c[r, s] = w * (
                                tangent[point, 9 * r + s]
                                + stiff * cof[r] * cof[s]
                                - factor * cof[3 * i + m] * cof[3 * k + j]
                            )
            g0, g1, g2 = g[3 * q], g[3 * q + 1], g[3 * q + 2]
            for i in range(3):
                for a in range(27):
                    b[27 * i + a] = (
                        cof[3 * i] * g0[a]
                        + cof[3 * i + 1] * g1[a]
                        + cof[3 * i + 2] * g2[a]
                    )
            for m in range(4):
                weighted = w * basis[q, m]
                for r in range(81):
                    moment[m, r] += weighted * b[r]
            # Rows (point, J) of sum over L of c[iJ, kL] g[L, b], for i <= k.
            for j in range(3):
                r = 3 * q + j
                _combine(c[j], 0, g0, g1, g2, first[r], 0)
                for i in range(2):
                    _combine(c[3 * i + j], 3, g0, g1, g2, middle[r], 27 * i)
                for i in range(3):
                    _combine(c[3 * i + j], 6, g0, g1, g2, last[r], 27 * i)
        # One product each for the columns of a direction k: sums over all points.
        np.dot(g.T, first, with_first)
        np.dot(g.T, middle, with_middle)
        np.dot(g.T, last, with_last)
        # Condensed pressure: B^T M^-1 (K M) M^-1 B with a constant bulk modulus.
        for m in range(4):
            for r in range(81):
                held[m, r] = 0.0
            for n in range(4):
                h = (1.0 - local) * bulk[e] * mass_inverse[e, m, n]
                for r in range(81):
                    held[m, r] += h * moment[n, r]
        entry = 0
        for i in range(3):
            for a in range(27):
                r = 27 * i + a
                for n in range(27):
                    row[54 + n] = with_last[a, 27 * i + n]
                if i <= 1:
                    for n in range(27):
                        row[27 + n] = with_middle[a, 27 * i + n]
                if i == 0:
                    for n in range(27):
                        row[n] = with_first[a, n]
                m0, m1, m2, m3 = moment[0, r], moment[1, r], moment[2, r], moment[3, r]
                for s in range(27 * i, 81):
                    row[s] += (
                        m0 * held[0, s]
                        + m1 * held[1, s]
                        + m2 * held[2, s]
                        + m3 * held[3, s]
                    )
                for s in range(r, 81):
                    where = position[e, entry]
                    if where >= 0:
                        data[where] += row[s]
                    entry += 1
