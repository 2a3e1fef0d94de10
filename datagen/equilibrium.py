"""Residual and tangent of one problem, assembled on one sparse pattern.

A `Pattern` depends on the mesh's topology and the held displacements alone, so it is
made once and shared by every design with the same divisions.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.sparse import csr_matrix

from . import elements as el
from . import surfaces
from .cavity import add_load_stiffness, cavity, cavity_rates, face_tensor
from .gas import gas_volume
from .linear import Solver, default_backend, make_solver
from .mesh import LOWER, UPPER, reference
from .problem import Body

Array = np.ndarray


class InvertedElement(ArithmeticError):
    """det F fell to zero or below somewhere; `element` says where."""

    def __init__(self, element: int) -> None:
        self.element = element
        super().__init__(f"element {element} is inverted")


def _neighbours(cells: Array, nodes: int) -> tuple[Array, Array]:
    """Sorted node neighbours (itself included) in compressed rows."""
    start = np.arange(0, cells.size + 1, cells.shape[1])
    ones = np.ones(cells.size, dtype=np.int32)
    holds = csr_matrix((ones, cells.ravel(), start), shape=(len(cells), nodes))
    meets = (holds.T @ holds).tocsr()
    meets.sort_indices()
    return meets.indptr.astype(np.int64), meets.indices.astype(np.int64)


@njit(cache=True)
def _triangle(
    indptr: Array, indices: Array, number: Array, free: int
) -> tuple[Array, Array]:
    """Upper triangle over free unknowns from node neighbours.

    number : (n, 3) array; unknown of each displacement, -1 where held; increasing
    with (node, direction), so that rows come out sorted.
    """
    rows = np.zeros(free + 1, np.int64)
    for sweep in range(2):
        if sweep == 1:
            rows = np.cumsum(rows)
            columns = np.empty(rows[free], np.int32)
        for a in range(number.shape[0]):
            for i in range(3):
                r = number[a, i]
                if r < 0:
                    continue
                fill = 0
                for k in range(indptr[a], indptr[a + 1]):
                    for j in range(3):
                        s = number[indices[k], j]
                        if s >= r:
                            if sweep == 1:
                                columns[rows[r] + fill] = s
                            fill += 1
                if sweep == 0:
                    rows[r + 1] = fill
    return rows, columns


@njit(cache=True)
def _positions(groups: Array, number: Array, indptr: Array, columns: Array) -> Array:
    """Where the entries of each group's upper triangle stand in the values.

    groups : (g, k) array of nodes; entries run over (direction, node), node fastest.
    """
    k = groups.shape[1]
    size = 3 * k
    out = np.empty((groups.shape[0], size * (size + 1) // 2), np.int32)
    for g in range(groups.shape[0]):
        entry = 0
        for r in range(size):
            row = number[groups[g, r % k], r // k]
            for s in range(r, size):
                column = number[groups[g, s % k], s // k]
                if row < 0 or column < 0:
                    out[g, entry] = -1
                else:
                    low, high = min(row, column), max(row, column)
                    first = indptr[low]
                    out[g, entry] = first + np.searchsorted(
                        columns[first : indptr[low + 1]], high
                    )
                entry += 1
    return out


@dataclass(frozen=True)
class Pattern:
    """Sparse upper triangle of a topology, and where each entry goes.

    number : (n, 3) array of int; unknown of each displacement, -1 where held.
    free : (k,) array of int; place of each unknown among all 3 n displacements.
    indptr, indices : compressed rows of the upper triangle.
    of_cells, of_faces : positions, see `elements.add_stiffness`.
    """

    number: Array
    free: Array
    indptr: Array
    indices: Array
    of_cells: Array
    of_faces: Array

    def of_more(self, faces: Array) -> Array:
        """Positions for faces (f, 9) of elements that bear no pressure."""
        where: Array = _positions(faces, self.number, self.indptr, self.indices)
        return where


def make_pattern(cells: Array, faces: Array, fixed: Array) -> Pattern:
    """Pattern of elements and cavity faces with some displacements held."""
    number = np.full(fixed.shape, -1, dtype=np.int64)
    number[~fixed] = np.arange(int((~fixed).sum()))
    indptr, indices = _neighbours(cells, len(fixed))
    rows, columns = _triangle(indptr, indices, number, int(number.max()) + 1)
    return Pattern(
        number=number,
        free=np.flatnonzero(~fixed),
        indptr=rows,
        indices=columns,
        of_cells=_positions(cells, number, rows, columns),
        of_faces=_positions(faces, number, rows, columns),
    )


class Workspace:
    """Patterns and symbolic analyses, kept for the topologies used last.

    Parameters
    ----------
    backend : str, optional
        Of `linear.BACKENDS`; the fastest there is where it is not given.
    threads : int
        Of the linear solver.
    size : int
        Number of topologies kept.
    """

    def __init__(
        self, backend: str | None = None, threads: int = 1, size: int = 2
    ) -> None:
        self.backend = backend or default_backend()
        self.threads, self.size = threads, size
        self._kept: OrderedDict[bytes, tuple[Pattern, list[Solver]]] = OrderedDict()

    def pattern(self, problem: Body) -> Pattern:
        """The problem's pattern."""
        return self._of(problem)[0]

    def _of(self, problem: Body) -> tuple[Pattern, list[Solver]]:
        """The problem's pattern, and its solver once there is one."""
        cells, faces = problem.mesh.cells, problem.mesh.cavity_faces
        key = cells.tobytes() + faces.tobytes() + np.packbits(problem.fixed).tobytes()
        if key not in self._kept:
            self._kept[key] = (make_pattern(cells, faces, problem.fixed), [])
        self._kept.move_to_end(key)
        while len(self._kept) > self.size:
            self._kept.popitem(last=False)
        return self._kept[key]

    def solver(self, problem: Body) -> Solver:
        """A solver for the problem's pattern, analysed once."""
        pattern, made = self._of(problem)
        if not made:
            made.append(
                make_solver(self.backend, pattern.indptr, pattern.indices, self.threads)
            )
        return made[0]


class Evaluation(NamedTuple):
    """One evaluation of the equilibrium equations; k unknowns.

    residual : (k,) array, N; internal minus external forces.
    volume : float, m3; of the cavities in the half model.
    volume_gradient : (k,) array, m2; dV/dx.
    tangent : (nnz,) array, N/m, or None where it was not asked for.
    history : per layer, (points, h) array at the end of the step.
    """

    residual: Array
    volume: float
    volume_gradient: Array
    tangent: Array | None
    history: tuple[Array, ...]


class Kinematics(NamedTuple):
    """What nodes alone decide of an evaluation.

    f : (27 e, 9) array; elastic deformation gradients, all with positive determinants.
    volume : float, m3.  gradient : (n, 3) array, m2; see `Evaluation`.
    """

    f: Array
    volume: float
    gradient: Array


class Equilibrium:
    """Equilibrium equations of one problem.

    Parameters
    ----------
    problem : Body
    workspace : Workspace
    like : Equilibrium, optional
        Of a problem that this one may share its undeformed elements with.
    """

    def __init__(
        self, problem: Body, workspace: Workspace, like: Equilibrium | None = None
    ) -> None:
        self._like = like
        self.data: el.ElementData
        self.problem, self.workspace = problem, workspace
        mesh = problem.mesh
        self.pattern = workspace.pattern(problem)
        self.unknowns = len(self.pattern.free)
        self._tensor = face_tensor()
        self.gradient = reference().gradient
        self._points = [np.repeat(mesh.layer == layer, 27) for layer in (LOWER, UPPER)]
        self._mu = np.repeat(problem.shear_modulus, 27)
        self.history: tuple[Array, ...] = tuple(
            np.zeros((int(points.sum()), law.history_size))
            for points, law in zip(self._points, problem.laws, strict=True)
        )
        of_more = self.pattern.of_more
        self._springs = [
            (one.faces, one.matrices(problem.nodes), of_more(one.faces))
            for one in problem.springs
        ]
        gas = np.zeros(0) if problem.gas is None else problem.gas
        self._filled = np.nonzero(gas)[0]
        self._gas = gas[self._filled]
        self._skins = [(one, of_more(one.faces)) for one in problem.skins]
        self._one_law = problem.laws[0] == problem.laws[1] and not any(
            law.history_size for law in problem.laws
        )
        self._size = self._swollen(0.0)
        self.set_share(1.0)

    def _swollen(self, time: float) -> float:
        """Stretch by swelling at a time, s."""
        return float(np.prod([1.0 + one(time) for one in self.problem.swellings]))

    @property
    def size(self) -> float:
        """Stretch by swelling at the time that was set last."""
        return self._size

    def set_time(self, time: float) -> float:
        """Let the body be swollen as it is at a time, s; how much larger it has got."""
        old, self._size = self._size, self._swollen(time)
        if self._size != old:
            self.set_share(1.0)
        return self._size / old

    def set_share(self, share: float) -> None:
        """Let this share of growth and weight act; the way to a start at rest."""
        problem, mesh = self.problem, self.problem.mesh
        growth = None
        if problem.growth is not None:
            unit = np.eye(3)
            growth = unit + share * (problem.growth - unit)
        if problem.swellings:
            same = np.tile(np.eye(3), (len(mesh.cells), 1, 1))
            growth = self._size * (same if growth is None else growth)
        if self._like is not None and self.strains_as(self._like.problem):
            self.data = self._like.data
        else:
            self.data = el.element_data(problem.nodes, mesh.cells, growth)
        body = np.zeros(problem.nodes.shape)
        if problem.density.any() and problem.gravity.any():
            # Mass is that of the stress-free shape, whatever grows later.
            weight = el.element_data(problem.nodes, mesh.cells).weight
            mass = (weight * problem.density[:, None]) @ reference().shape
            for i in range(3):
                np.add.at(body[:, i], mesh.cells, share * mass * problem.gravity[i])
        if problem.forces is not None:
            body += share * problem.forces
        self._body = self.restrict(body)

    def strains_as(self, other: Body) -> bool:
        """Whether nodes make the same elastic strains here as in another problem."""
        mine = self.problem
        return (
            mine.nodes is other.nodes
            and mine.growth is other.growth
            and not (mine.swellings or other.swellings)
            and mine.gas is other.gas
        )

    def kinematics(self, x: Array) -> Kinematics:
        """What deformed nodes x (n, 3), m, alone decide.

        Raises
        ------
        InvertedElement
            When det F is zero or below at some quadrature point.
        """
        f = el.deformation(x, self.problem.mesh.cells, self.gradient, self.data.inverse)
        least, where = el.smallest_determinant(f)
        if not least > 0:
            raise InvertedElement(where // 27)
        return Kinematics(f, *self._cavities(x))

    def restrict(self, field: Array) -> Array:
        """Unknowns (k,) of a nodal field (n, 3)."""
        unknowns: Array = field.ravel()[self.pattern.free]
        return unknowns

    def extend(self, unknowns: Array) -> Array:
        """Nodal field (n, 3) of unknowns (k,), zero where held."""
        field = np.zeros(self.problem.nodes.shape)
        field.ravel()[self.pattern.free] = unknowns
        return field

    def respond(
        self, f: Array, dt: float, tangent: bool
    ) -> tuple[Array, Array, tuple[Array, ...]]:
        """Isochoric stress, its tangent and the history of `LawResult`, at all points.

        Parameters
        ----------
        f : (27 e, 9) array
            Deformation gradients.
        dt : float, s
        tangent : bool
            Whether the tangent is wanted.
        """
        laws = self.problem.laws
        if self._one_law:
            result = laws[0].respond(f, self._mu, np.zeros((len(f), 0)), dt, tangent)
            return result.stress, result.tangent, self.history
        stress = np.empty((len(f), 9))
        slope = np.empty((len(f) if tangent else 0, 81))
        history = []
        for points, law, old in zip(self._points, laws, self.history, strict=True):
            result = law.respond(f[points], self._mu[points], old, dt, tangent)
            stress[points] = result.stress
            if tangent:
                slope[points] = result.tangent
            history.append(result.history)
        return stress, slope, tuple(history)

    def evaluate(
        self,
        x: Array,
        pressure: float,
        dt: float = 1.0,
        tangent: bool = False,
        expected: Array | None = None,
        known: Kinematics | None = None,
    ) -> Evaluation:
        """Residual, and the tangent where it is wanted.

        Parameters
        ----------
        x : (n, 3) array, m
            Deformed node positions.
        pressure : float, Pa
            In the cavities.
        dt : float, s
            Duration of the step, for laws with history.
        expected : (27 e, 6) array, Pa, optional
            Second Piola-Kirchhoff stress that makes the tangent's geometric part in
            place of the stress at `x`.
        known : Kinematics, optional
            At `x`.

        Raises
        ------
        InvertedElement
            When det F is zero or below at some quadrature point.
        """
        mesh = self.problem.mesh
        f, volume, gradient = known or self.kinematics(x)
        stress, slope, history = self.respond(f, dt, tangent)
        force, element_pressure = self.internal_force(f, stress)
        stiff = self.add_surfaces(x, force, tangent)
        normal = self.restrict(gradient)
        residual = self.restrict(force) - pressure * normal - self._body
        values = None
        if tangent:
            if expected is not None:
                at_hand = el.second_stress(f, stress, element_pressure)
                el.replace_stress(slope, expected - at_hand)
            element_pressure[self._filled] -= pressure * self._gas[:, None]
            values = np.zeros(len(self.pattern.indices))
            el.add_stiffness(
                values,
                self.pattern.of_cells,
                f,
                slope,
                element_pressure,
                self.problem.bulk_modulus,
                self.problem.local_share,
                *self._arrays(),
            )
            add_load_stiffness(
                values,
                self.pattern.of_faces,
                x,
                mesh.cavity_faces,
                self._tensor,
                pressure,
            )
            for _, matrices, spots in self._springs:
                surfaces.add_matrices(values, spots, matrices)
            for matrices, (_, spots) in zip(stiff, self._skins, strict=True):
                surfaces.add_matrices(values, spots, matrices)
        return Evaluation(residual, volume, normal, values, history)

    def _arrays(self) -> tuple[Array, ...]:
        """What the kernels need of the undeformed elements, in their order."""
        data = self.data
        return (
            self.gradient,
            data.inverse,
            data.weight,
            data.basis,
            data.mass_inverse,
        )

    def internal_force(self, f: Array, stress: Array) -> tuple[Array, Array]:
        """Nodal forces of the elements (n, 3), N, and their pressure (e, 27), Pa.

        Parameters
        ----------
        f, stress : (27 e, 9) arrays
            Deformation gradients and isochoric stress, Pa.
        """
        problem = self.problem
        force: tuple[Array, Array] = el.internal_force(
            f,
            stress,
            problem.bulk_modulus,
            problem.local_share,
            len(problem.nodes),
            problem.mesh.cells,
            *self._arrays(),
        )
        return force

    def add_surfaces(self, x: Array, force: Array, tangent: bool) -> list[Array]:
        """Add the forces of springs and skins to `force` (n, 3), N; skins' matrices."""
        nodes = self.problem.nodes
        for faces, matrices in self.spring_matrices():
            surfaces.add_matrix_force(force, x - nodes, faces, matrices)
        return [one.respond(nodes, x, force, tangent) for one, _ in self._skins]

    @property
    def has_outer_forces(self) -> bool:
        """Whether springs, skins or weight act."""
        return bool(self._springs or self._skins or self._body.any())

    def outer_forces(self, x: Array) -> Array:
        """What springs, skins and weight add to the residual, (n, 3) N."""
        force = self.extend(-self._body)
        self.add_surfaces(x, force, False)
        return force

    def spring_matrices(self) -> list[tuple[Array, Array]]:
        """Faces (f, 9) of the elastic supports, and their matrices (f, 27, 27), N/m."""
        return [(faces, matrices) for faces, matrices, _ in self._springs]

    def faces_gradient_rates(self, x: Array, dx: Array) -> Array:
        """Derivatives (c, n, 3) of dV/dx along dx (c, n, 3), V inside the faces."""
        faces = self.problem.mesh.cavity_faces
        rates: Array = cavity_rates(x, dx, faces, self._tensor)
        return rates

    def volume(self, x: Array) -> float:
        """Volume of the cavities in the half model, m3."""
        return self._cavities(x)[0]

    def _cavities(self, x: Array) -> tuple[float, Array]:
        """Volume under pressure, m3, and its gradient (n, 3), m2."""
        mesh, data, filled = self.problem.mesh, self.data, self._filled
        volume, gradient = cavity(x, mesh.cavity_faces, self._tensor)
        if len(filled):
            f = el.deformation(
                x, mesh.cells[filled], self.gradient, data.inverse[filled]
            )
            more, slope = gas_volume(
                f,
                filled,
                self._gas,
                len(x),
                mesh.cells,
                self.gradient,
                data.inverse,
                data.weight,
            )
            volume, gradient = volume + more, gradient + slope
        return volume, gradient

    def stress(self, x: Array, dt: float = 1.0) -> Array:
        """Second Piola-Kirchhoff stress (27 e, 6), Pa, at the quadrature points."""
        cells, inverse = self.problem.mesh.cells, self.data.inverse
        f = el.deformation(x, cells, self.gradient, inverse)
        isochoric = self.respond(f, dt, False)[0]
        return el.second_stress(f, isochoric, self.internal_force(f, isochoric)[1])

    def where(self, element: int) -> str:
        """Place of an element in words, for messages."""
        layer = "upper" if self.problem.mesh.layer[element] == UPPER else "lower"
        x, y, z = 1e3 * self.problem.nodes[self.problem.mesh.cells[element]].mean(
            axis=0
        )
        return f"in the {layer} layer at x = {x:.3g}, y = {y:.3g}, z = {z:.3g} mm"
