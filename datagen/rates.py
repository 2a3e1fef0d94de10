"""Derivatives of the residual at one deformed state, in any direction, without a step.

Along a movement dx of the deformed and dX of the undeformed nodes, with M = dx/dxi,
J = dX/dxi, F = M J^-1 Fg^-1 and the weights w:

    dF = (dM - F Fg dJ) J^-1 Fg^-1,    dw = w tr(J^-1 dJ),
    dP = A : dF + dp cof F + p dcof F,

and dp follows from the projection of J on the pressure basis, whose mass matrix moves
with the weights.  Differences of residuals lose here what makes slender strips slender:
rounding of positions alone is a force that bends one by a thousandth of what is sought.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from . import elements as el
from . import surfaces
from .drawn import drawn_rates, fields_last, line_tables
from .equilibrium import Equilibrium

Array = np.ndarray


class Linearised:
    """The residual of one problem to first order at a deformed state.

    Parameters
    ----------
    equations : Equilibrium
    x : (n, 3) array, m
        Deformed nodes.
    pressure : float, Pa
        In the cavities.
    dt : float, s
        Duration of the step that led there.

    Raises
    ------
    InvertedElement
    """

    def __init__(
        self, equations: Equilibrium, x: Array, pressure: float, dt: float
    ) -> None:
        self.equations, self.x, self.pressure = equations, x, pressure
        problem = equations.problem
        self.known = equations.kinematics(x)
        f = self.known.f
        data = equations.data
        stress, tangent, _ = equations.respond(f, dt, True)
        self.force, held = equations.internal_force(f, stress)
        if problem.gas is not None:
            held = held - pressure * problem.gas[:, None]
        self._total, self._plain = f, data.inverse
        if problem.growth is not None or problem.swellings:
            plain = el.element_data(problem.nodes, problem.mesh.cells).inverse
            self._plain = plain
            self._total = el.deformation(
                x, problem.mesh.cells, equations.gradient, plain
            )
        self._moduli = _pull_back(
            f,
            stress,
            tangent,
            held,
            problem.bulk_modulus,
            problem.local_share,
            data.inverse,
            data.weight,
            data.basis,
            data.mass_inverse,
        )
        none = np.zeros(x.shape)
        self._skins = [
            (skin.faces, skin.respond(problem.nodes, x, none, True))
            for skin in problem.skins
        ]

    def times(self, vectors: Array) -> Array:
        """The tangent times vectors (k, c) of unknowns."""
        eq = self.equations
        fields = np.stack([eq.extend(vector) for vector in vectors.T])
        rates = self._element_rates(fields)
        rates -= self.pressure * eq.faces_gradient_rates(self.x, fields)
        products = np.empty_like(vectors)
        for c, (v, rate) in enumerate(zip(fields, rates, strict=True)):
            for faces, matrices in (*eq.spring_matrices(), *self._skins):
                surfaces.add_matrix_force(rate, v, faces, matrices)
            products[:, c] = eq.restrict(rate)
        return products

    def moved(self, dx: Array, undeformed: Array) -> Array:
        """Rates (c, k) of the elements and the load along dx and dX (c, n, 3)."""
        eq, data = self.equations, self.equations.data
        elements = drawn_rates(
            fields_last(dx),
            fields_last(undeformed),
            self._total,
            *self._moduli,
            eq.problem.bulk_modulus,
            eq.problem.local_share,
            eq.problem.mesh.cells,
            line_tables(),
            self._plain,
            data.weight,
            data.basis,
            data.mass_inverse,
        )
        loads = self.pressure * eq.faces_gradient_rates(self.x, dx)
        return np.stack(
            [eq.restrict(elements[..., c] - load) for c, load in enumerate(loads)]
        )

    def _element_rates(self, dx: Array) -> Array:
        """Rates (c, n, 3) of the elements' nodal forces along dx (c, n, 3)."""
        eq, data = self.equations, self.equations.data
        moduli, dilation, _, _ = self._moduli
        rates: Array = _force_rates(
            dx,
            moduli,
            dilation,
            eq.problem.bulk_modulus,
            eq.problem.local_share,
            eq.problem.mesh.cells,
            eq.gradient,
            data.weight,
            data.basis,
            data.mass_inverse,
        )
        return rates


@njit(cache=True, fastmath=True)
def nodal_deformation(nodes: Array, x: Array, cells: Array, gradient: Array) -> Array:
    """Deformation gradient at the nodes, the mean of the elements around each.

    Parameters
    ----------
    nodes, x : (n, 3) arrays, m
        Undeformed and deformed.
    cells : (e, 27) array of int
    gradient : (27, 27, 3) array
        `Reference.node_gradient`.

    Returns
    -------
    (n, 3, 3) array
    """
    out = np.zeros((nodes.shape[0], 3, 3))
    count = np.zeros(nodes.shape[0])
    flat = el.flattened(gradient)
    old, new = np.empty((3, 81)), np.empty((3, 81))
    j, c = np.empty(9), np.empty(9)
    for e in range(cells.shape[0]):
        old[:] = 0.0
        new[:] = 0.0
        for a in range(27):
            node = cells[e, a]
            for i in range(3):
                before, after = nodes[node, i], x[node, i]
                for k in range(81):
                    old[i, k] += before * flat[a, k]
                    new[i, k] += after * flat[a, k]
        for q in range(27):
            for i in range(3):
                for k in range(3):
                    j[3 * i + k] = old[i, 3 * q + k]
            det = el.cofactor(j, c)
            node = cells[e, q]
            count[node] += 1
            for i in range(3):
                for n in range(3):
                    for k in range(3):
                        out[node, i, n] += new[i, 3 * q + k] * c[3 * n + k] / det
    return out / count.reshape(-1, 1, 1)


@njit(cache=True, fastmath=True)
def _pull_back(
    f: Array,
    stress: Array,
    tangent: Array,
    held: Array,
    bulk: Array,
    local: float,
    inverse: Array,
    weight: Array,
    basis: Array,
    mass_inverse: Array,
) -> tuple[Array, Array, Array, Array]:
    """What forces and their rates are made of in an element's own coordinates.

    Parameters
    ----------
    f, stress : (27 e, 9) arrays; tangent : (27 e, 81) array; held : (e, 27) array
        See `Linearised`.
    bulk, local, inverse, weight, basis, mass_inverse
        As in `elements.internal_force`.

    Returns
    -------
    moduli : (27 e, 81) array, N m
        w dP/dF with both of its reference sides on J^-1 Fg^-1: times dM it is the rate
        of the forces s at a constant pressure.
    dilation : (27 e, 9) array, 1/m
        dJ/dM.
    force : (27 e, 9) array, N m
        s, see `elements.internal_force`.
    off : (e, 27) array
        What the projection of J - 1 leaves of it.
    """
    elements = weight.shape[0]
    moduli = np.empty((27 * elements, 81))
    dilation, force = np.empty((27 * elements, 9)), np.empty((27 * elements, 9))
    off = np.empty((elements, 27))
    cof, half = np.empty(9), np.empty((9, 9))
    rhs = np.empty(4)
    for e in range(elements):
        rhs[:] = 0.0
        for q in range(27):
            point = 27 * e + q
            det = el.cofactor(f[point], cof)
            off[e, q] = det - 1.0
            inv, w, a = inverse[e, q], weight[e, q], tangent[point]
            for i in range(4):
                rhs[i] += w * basis[q, i] * (det - 1.0)
            over = w * held[e, q] / det
            stiff = over + w * local * bulk[e]
            for i in range(3):
                for k in range(3):
                    r = 3 * i + k
                    for j in range(3):
                        # dP/dF plus the pressure times d2J/dF2, see add_stiffness
                        c0 = c1 = c2 = 0.0
                        c0 = (
                            w * a[9 * r + 3 * j]
                            + stiff * cof[r] * cof[3 * j]
                            - over * cof[3 * i] * cof[3 * j + k]
                        )
                        c1 = (
                            w * a[9 * r + 3 * j + 1]
                            + stiff * cof[r] * cof[3 * j + 1]
                            - over * cof[3 * i + 1] * cof[3 * j + k]
                        )
                        c2 = (
                            w * a[9 * r + 3 * j + 2]
                            + stiff * cof[r] * cof[3 * j + 2]
                            - over * cof[3 * i + 2] * cof[3 * j + k]
                        )
                        for n in range(3):
                            half[r, 3 * j + n] = (
                                c0 * inv[3 * n]
                                + c1 * inv[3 * n + 1]
                                + c2 * inv[3 * n + 2]
                            )
            for i in range(3):
                for k in range(3):
                    i0, i1, i2 = inv[3 * k], inv[3 * k + 1], inv[3 * k + 2]
                    r = 3 * i + k
                    for n in range(9):
                        moduli[point, 9 * r + n] = (
                            i0 * half[3 * i, n]
                            + i1 * half[3 * i + 1, n]
                            + i2 * half[3 * i + 2, n]
                        )
                    dilation[point, r] = (
                        cof[3 * i] * i0 + cof[3 * i + 1] * i1 + cof[3 * i + 2] * i2
                    )
                    t = stress[point]
                    force[point, r] = w * (
                        t[3 * i] * i0
                        + t[3 * i + 1] * i1
                        + t[3 * i + 2] * i2
                        + held[e, q] * dilation[point, r]
                    )
        for i in range(4):
            theta = 0.0
            for n in range(4):
                theta += mass_inverse[e, i, n] * rhs[n]
            for q in range(27):
                off[e, q] -= basis[q, i] * theta
    return moduli, dilation, force, off


@njit(cache=True, fastmath=True)
def _force_rates(
    dx: Array,
    moduli: Array,
    dilation: Array,
    bulk: Array,
    local: float,
    cells: Array,
    gradient: Array,
    weight: Array,
    basis: Array,
    mass_inverse: Array,
) -> Array:
    """Derivatives (c, n, 3) of the elements' nodal forces along deformed nodes.

    Parameters
    ----------
    dx : (c, n, 3) array
        Movements of the nodes.
    moduli, dilation
        See `_pull_back`.
    bulk, local, cells, gradient, weight, basis, mass_inverse
        As in `elements.internal_force`.
    """
    flat = el.flattened(gradient)
    out = np.zeros(dx.shape)
    m, s = np.zeros((3, 81)), np.empty((3, 81))
    rhs, theta = np.empty(4), np.empty(4)
    d = np.empty((27, 9))
    for e in range(cells.shape[0]):
        for c in range(dx.shape[0]):
            m[:] = 0.0
            for a in range(27):
                node = cells[e, a]
                for i in range(3):
                    v = dx[c, node, i]
                    for k in range(81):
                        m[i, k] += v * flat[a, k]
            rhs[:] = 0.0
            for q in range(27):
                g = d[q]
                for i in range(3):
                    for k in range(3):
                        g[3 * i + k] = m[i, 3 * q + k]
                change = 0.0
                h = dilation[27 * e + q]
                for r in range(9):
                    change += h[r] * g[r]
                w = weight[e, q] * change
                for i in range(4):
                    rhs[i] += w * basis[q, i]
            for i in range(4):
                theta[i] = 0.0
                for n in range(4):
                    theta[i] += mass_inverse[e, i, n] * rhs[n]
            for q in range(27):
                rate = 0.0
                for i in range(4):
                    rate += basis[q, i] * theta[i]
                rate *= weight[e, q] * bulk[e] * (1.0 - local)
                point = 27 * e + q
                b, g, h = moduli[point], d[q], dilation[point]
                for i in range(3):
                    for k in range(3):
                        r = 3 * i + k
                        value = rate * h[r]
                        for n in range(9):
                            value += b[9 * r + n] * g[n]
                        s[i, 3 * q + k] = value
            for a in range(27):
                f0 = f1 = f2 = 0.0
                for k in range(81):
                    f0 += s[0, k] * flat[a, k]
                    f1 += s[1, k] * flat[a, k]
                    f2 += s[2, k] * flat[a, k]
                node = cells[e, a]
                out[c, node, 0] += f0
                out[c, node, 1] += f1
                out[c, node, 2] += f2
    return out
