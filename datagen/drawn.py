"""Forces to first order along moved nodes, of many fields at once by sum factorisation.

Shape functions of the 27-node hexahedron are products of three functions of one
coordinate.  Gradients at its 27 points are thus three sums of three terms each in place
of one of 27 (Orszag 1980, J. Comput. Phys. 37, 70), and the loops over the fields run
innermost, as long as the processor likes them.  For a few fields the plain sums of
`rates.py` are faster.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from .mesh import reference

Array = np.ndarray

LANES = 4
"""The number of fields is padded to a multiple of it: doubles in a register."""


def line_tables() -> Array:
    """Functions of one coordinate and their slopes at its Gauss points, (2, 3, 3).

    First axis functions and slopes, then point by node.
    """
    t = reference().point[:3, 1][:, None]  # the second coordinate runs fastest
    nodes = np.array([0.0, 0.5, 1.0])
    values, slopes = np.ones((3, 3)), np.zeros((3, 3))
    for a in range(3):
        b, c = np.delete(nodes, a)
        scale = (nodes[a] - b) * (nodes[a] - c)
        values[:, a] = ((t - b) * (t - c) / scale)[:, 0]
        slopes[:, a] = ((2 * t - b - c) / scale)[:, 0]
    return np.stack([values, slopes])


def fields_last(fields: Array) -> Array:
    """Fields (c, n, 3) as (n, 3, c'), c' the next multiple of `LANES`; zeros added."""
    count, nodes, _ = fields.shape
    found = np.zeros((nodes, 3, -(-count // LANES) * LANES))
    found[..., :count] = fields.transpose(1, 2, 0)
    return found


@njit(cache=True, fastmath=True)
def gradients(u: Array, line: Array, work: Array, out: Array) -> None:
    """Gradients at the points of one element.

    Parameters
    ----------
    u : (27, 3 c) array
        At the nodes in lattice order; three components of c fields, the fields fastest.
    line : (2, 3, 3) array
        See `line_tables`.
    work : (5, 27, 3 c) array
        Is written over.
    out : (27, 9, c) array
        At the points in the order of the reference element, component by direction.
    """
    n, d = line[0], line[1]
    width, fields = u.shape[1], out.shape[2]
    along, slope, one, two, three = work[0], work[1], work[2], work[3], work[4]
    for row in range(9):
        first = 3 * row
        for k in range(3):
            n0, n1, n2 = n[k, 0], n[k, 1], n[k, 2]
            d0, d1, d2 = d[k, 0], d[k, 1], d[k, 2]
            for w in range(width):
                v0, v1, v2 = u[first, w], u[first + 1, w], u[first + 2, w]
                along[first + k, w] = n0 * v0 + n1 * v1 + n2 * v2
                slope[first + k, w] = d0 * v0 + d1 * v1 + d2 * v2
    for layer in range(3):
        for k in range(3):
            first = 9 * layer + k
            for j in range(3):
                here = first + 3 * j
                n0, n1, n2 = n[j, 0], n[j, 1], n[j, 2]
                d0, d1, d2 = d[j, 0], d[j, 1], d[j, 2]
                for w in range(width):
                    v0 = along[first, w]
                    v1 = along[first + 3, w]
                    v2 = along[first + 6, w]
                    one[here, w] = n0 * v0 + n1 * v1 + n2 * v2
                    two[here, w] = d0 * v0 + d1 * v1 + d2 * v2
                    three[here, w] = (
                        n0 * slope[first, w]
                        + n1 * slope[first + 3, w]
                        + n2 * slope[first + 6, w]
                    )
    for k in range(3):
        for j in range(3):
            r = 3 * j + k
            for i in range(3):
                point = 9 * k + 3 * i + j
                n0, n1, n2 = n[i, 0], n[i, 1], n[i, 2]
                d0, d1, d2 = d[i, 0], d[i, 1], d[i, 2]
                for m in range(3):
                    for c in range(fields):
                        w = m * fields + c
                        out[point, 3 * m, c] = (
                            d0 * one[r, w] + d1 * one[r + 9, w] + d2 * one[r + 18, w]
                        )
                        out[point, 3 * m + 1, c] = (
                            n0 * two[r, w] + n1 * two[r + 9, w] + n2 * two[r + 18, w]
                        )
                        out[point, 3 * m + 2, c] = (
                            n0 * three[r, w]
                            + n1 * three[r + 9, w]
                            + n2 * three[r + 18, w]
                        )


@njit(cache=True, fastmath=True)
def collected(s: Array, line: Array, work: Array, out: Array) -> None:
    """What `gradients` does, transposed: forces (27, 3 c) of s (27, 9, c)."""
    n, d = line[0], line[1]
    width, fields = out.shape[1], s.shape[2]
    along, slope, one, two, three = work[0], work[1], work[2], work[3], work[4]
    for k in range(3):
        for j in range(3):
            p = 9 * k + j
            for layer in range(3):
                r = 9 * layer + 3 * j + k
                n0, n1, n2 = n[0, layer], n[1, layer], n[2, layer]
                d0, d1, d2 = d[0, layer], d[1, layer], d[2, layer]
                for m in range(3):
                    x, y, z = 3 * m, 3 * m + 1, 3 * m + 2
                    for c in range(fields):
                        w = m * fields + c
                        one[r, w] = (
                            d0 * s[p, x, c] + d1 * s[p + 3, x, c] + d2 * s[p + 6, x, c]
                        )
                        two[r, w] = (
                            n0 * s[p, y, c] + n1 * s[p + 3, y, c] + n2 * s[p + 6, y, c]
                        )
                        three[r, w] = (
                            n0 * s[p, z, c] + n1 * s[p + 3, z, c] + n2 * s[p + 6, z, c]
                        )
    for layer in range(3):
        for k in range(3):
            r = 9 * layer + k
            for j in range(3):
                n0, n1, n2 = n[0, j], n[1, j], n[2, j]
                d0, d1, d2 = d[0, j], d[1, j], d[2, j]
                for w in range(width):
                    along[r + 3 * j, w] = (
                        n0 * one[r, w]
                        + n1 * one[r + 3, w]
                        + n2 * one[r + 6, w]
                        + d0 * two[r, w]
                        + d1 * two[r + 3, w]
                        + d2 * two[r + 6, w]
                    )
                    slope[r + 3 * j, w] = (
                        n0 * three[r, w] + n1 * three[r + 3, w] + n2 * three[r + 6, w]
                    )
    for row in range(9):
        p = 3 * row
        for k in range(3):
            n0, n1, n2 = n[0, k], n[1, k], n[2, k]
            d0, d1, d2 = d[0, k], d[1, k], d[2, k]
            for w in range(width):
                out[p + k, w] = (
                    n0 * along[p, w]
                    + n1 * along[p + 1, w]
                    + n2 * along[p + 2, w]
                    + d0 * slope[p, w]
                    + d1 * slope[p + 1, w]
                    + d2 * slope[p + 2, w]
                )


@njit(cache=True, fastmath=True)
def drawn_rates(
    dx: Array,
    undeformed: Array,
    total: Array,
    moduli: Array,
    dilation: Array,
    force: Array,
    off: Array,
    bulk: Array,
    local: float,
    cells: Array,
    line: Array,
    plain: Array,
    weight: Array,
    basis: Array,
    mass_inverse: Array,
) -> Array:
    """Derivatives (n, 3, c) of the elements' nodal forces; see `rates.py`.

    Parameters
    ----------
    dx, undeformed : (n, 3, c) arrays
        Movements of deformed and of undeformed nodes.
    total : (27 e, 9) array
        F Fg.
    moduli, dilation, force, off
        See `_pull_back` in `rates.py`.
    bulk, local, cells, weight, basis, mass_inverse
        As in `elements.internal_force`.
    line : (2, 3, 3) array
        See `line_tables`.
    plain : (e, 27, 9) array, 1/m
        J^-1.
    """
    fields = dx.shape[2]
    out = np.zeros(dx.shape)
    u, work = np.empty((27, 3 * fields)), np.empty((5, 27, 3 * fields))
    d, turn, s = (
        np.empty((27, 9, fields)),
        np.empty((27, 9, fields)),
        np.empty((27, 9, fields)),
    )
    dw, rhs, theta = (
        np.empty((27, fields)),
        np.empty((4, fields)),
        np.empty((4, fields)),
    )
    for e in range(cells.shape[0]):
        for a in range(27):
            node = cells[e, a]
            for i in range(3):
                for c in range(fields):
                    u[a, i * fields + c] = undeformed[node, i, c]
        gradients(u, line, work, turn)
        for a in range(27):
            node = cells[e, a]
            for i in range(3):
                for c in range(fields):
                    u[a, i * fields + c] = dx[node, i, c]
        gradients(u, line, work, d)
        rhs[:] = 0.0
        for q in range(27):
            point = 27 * e + q
            g, j, t, inv, h = d[q], turn[q], total[point], plain[e, q], dilation[point]
            for n in range(3):
                for k in range(3):
                    t0, t1, t2 = t[3 * k], t[3 * k + 1], t[3 * k + 2]
                    for c in range(fields):
                        g[3 * k + n, c] -= (
                            t0 * j[n, c] + t1 * j[3 + n, c] + t2 * j[6 + n, c]
                        )
            for n in range(3):
                for c in range(fields):
                    j0, j1, j2 = j[n, c], j[3 + n, c], j[6 + n, c]
                    j[n, c] = inv[0] * j0 + inv[1] * j1 + inv[2] * j2
                    j[3 + n, c] = inv[3] * j0 + inv[4] * j1 + inv[5] * j2
                    j[6 + n, c] = inv[6] * j0 + inv[7] * j1 + inv[8] * j2
            h0, h1, h2, h3, h4 = h[0], h[1], h[2], h[3], h[4]
            h5, h6, h7, h8 = h[5], h[6], h[7], h[8]
            w, left = weight[e, q], off[e, q]
            b0, b1, b2, b3 = basis[q, 0], basis[q, 1], basis[q, 2], basis[q, 3]
            for c in range(fields):
                dw[q, c] = j[0, c] + j[4, c] + j[8, c]
                change = w * (
                    h0 * g[0, c]
                    + h1 * g[1, c]
                    + h2 * g[2, c]
                    + h3 * g[3, c]
                    + h4 * g[4, c]
                    + h5 * g[5, c]
                    + h6 * g[6, c]
                    + h7 * g[7, c]
                    + h8 * g[8, c]
                    + dw[q, c] * left
                )
                rhs[0, c] += b0 * change
                rhs[1, c] += b1 * change
                rhs[2, c] += b2 * change
                rhs[3, c] += b3 * change
        for i in range(4):
            a0, a1 = mass_inverse[e, i, 0], mass_inverse[e, i, 1]
            a2, a3 = mass_inverse[e, i, 2], mass_inverse[e, i, 3]
            for c in range(fields):
                theta[i, c] = (
                    a0 * rhs[0, c] + a1 * rhs[1, c] + a2 * rhs[2, c] + a3 * rhs[3, c]
                )
        for q in range(27):
            point = 27 * e + q
            g, u_q, s_q = d[q], turn[q], s[q]
            b, h, p = moduli[point], dilation[point], force[point]
            stiff = weight[e, q] * bulk[e] * (1.0 - local)
            b0, b1 = stiff * basis[q, 0], stiff * basis[q, 1]
            b2, b3 = stiff * basis[q, 2], stiff * basis[q, 3]
            for i in range(3):
                p0, p1, p2 = p[3 * i], p[3 * i + 1], p[3 * i + 2]
                for k in range(3):
                    r = 3 * i + k
                    h_r, p_r = h[r], p[r]
                    m0, m1, m2 = b[9 * r], b[9 * r + 1], b[9 * r + 2]
                    m3, m4, m5 = b[9 * r + 3], b[9 * r + 4], b[9 * r + 5]
                    m6, m7, m8 = b[9 * r + 6], b[9 * r + 7], b[9 * r + 8]
                    for c in range(fields):
                        rate = (
                            b0 * theta[0, c]
                            + b1 * theta[1, c]
                            + b2 * theta[2, c]
                            + b3 * theta[3, c]
                        )
                        s_q[r, c] = (
                            h_r * rate
                            + m0 * g[0, c]
                            + m1 * g[1, c]
                            + m2 * g[2, c]
                            + m3 * g[3, c]
                            + m4 * g[4, c]
                            + m5 * g[5, c]
                            + m6 * g[6, c]
                            + m7 * g[7, c]
                            + m8 * g[8, c]
                            + p_r * dw[q, c]
                            - p0 * u_q[3 * k, c]
                            - p1 * u_q[3 * k + 1, c]
                            - p2 * u_q[3 * k + 2, c]
                        )
        collected(s, line, work, u)
        for a in range(27):
            node = cells[e, a]
            for i in range(3):
                for c in range(fields):
                    out[node, i, c] += u[a, i * fields + c]
    return out
