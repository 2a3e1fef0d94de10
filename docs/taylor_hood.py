"""Taylor-Hood elements: the product's nodes, a pressure that is continuous in a layer.

Displacements on the 27 nodes of each hexahedron, the pressure trilinear between its
corners and one field in each layer (across the interface of two materials it jumps):

    sum over points of
        w [What(F) + (1 - a) (p (J - 1) - p^2/(2 K)) + a K/2 (J - 1)^2]  -  pressure V,

stationary in both.  The local share a is the product's, and is there for the same
reason: without it single points collapse where walls are bent sharply.  Nothing is
projected and nothing condensed; they share laws, quadrature and the cavity's volume
with the product's, and neither its pressure nor its tangent nor its path.  Each answer
is found by Newton's method from nodes nearby, that of the product's element at the same
pressure.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from datagen import elements as el
from datagen.cavity import add_load_stiffness, face_tensor
from datagen.equilibrium import Equilibrium, Workspace
from datagen.linear import Solver, SuperLU
from datagen.mesh import reference
from datagen.pardiso import Pardiso, mkl_library
from datagen.problem import Body

Array = np.ndarray

CLOSE, MOST = 1e-5, 12
"""Newton's last correction of a node, over the thinnest wall, of which the square is
left; and how many there may be."""

SIGNS = np.zeros((3, 3, 3))
SIGNS[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
SIGNS[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = -1.0


class TaylorHood:
    """Equilibria of one body without memory, growth, supports or weight.

    Parameters
    ----------
    problem : Body
    """

    def __init__(self, problem: Body) -> None:
        self.problem = problem
        self._known = Equilibrium(problem, Workspace())
        mesh, ref = problem.mesh, reference()
        self._data = el.element_data(problem.nodes, mesh.cells)
        i, j, k = np.indices((3, 3, 3)).reshape(3, -1)
        corners = np.flatnonzero((i % 2 == 0) & (j % 2 == 0) & (k % 2 == 0))
        # Trilinear shape functions (27, 8) at the points, corners in lattice order.
        sides = np.stack([1 - ref.point, ref.point], axis=2)  # (27, direction, side)
        self._shape = np.einsum(
            "qi,qj,qk->qijk", sides[:, 0], sides[:, 1], sides[:, 2]
        ).reshape(27, 8)
        own = mesh.cells[:, corners] + len(mesh.nodes) * mesh.layer[:, None]
        _, numbers = np.unique(own, return_inverse=True)
        self._vertex = numbers.reshape(own.shape)
        self._size = int(numbers.max()) + 1
        weight = self._data.weight / problem.bulk_modulus[:, None]
        self._joint = 1 - problem.local_share
        self._local = problem.local_share * problem.bulk_modulus[:, None]
        self._soft = self._joint * np.einsum(
            "eq,qa,qb->eab", weight, self._shape, self._shape
        )
        self._order()

    @property
    def unknowns(self) -> int:
        """Displacements and pressures."""
        return self._known.unknowns + self._size

    def _order(self) -> None:
        """Where each entry of the elements' matrices goes in the upper triangle."""
        pattern, cells = self._known.pattern, self.problem.mesh.cells
        held = pattern.number[cells].reshape(len(cells), 81)
        self._unknown = np.hstack([held, self._known.unknowns + self._vertex])
        total = self._known.unknowns + self._size
        row, column = np.broadcast_arrays(
            self._unknown[:, :, None], self._unknown[:, None, :]
        )
        self._chosen = (row >= 0) & (row <= column)
        key = row[self._chosen] * total + column[self._chosen]
        known, self._place = np.unique(key, return_inverse=True)
        self._indices = known % total
        self._indptr = np.searchsorted(known, total * np.arange(total + 1))
        rows = np.repeat(np.arange(self._known.unknowns), np.diff(pattern.indptr))
        self._of_load = np.searchsorted(known, rows * total + pattern.indices)
        self._diagonal = np.searchsorted(known, (total + 1) * np.arange(total))
        # In double precision: nothing here would find what single precision spoils.
        exact = SuperLU if mkl_library() is None else Pardiso
        self._solver: Solver = exact(self._indptr, self._indices)

    def equilibrium(self, x: Array, pressure: float) -> Array:
        """Deformed nodes (n, 3), m, at a cavity pressure, Pa, from some nearby.

        Raises
        ------
        ArithmeticError
            When Newton's method does not get there.
        """
        own = self._expected(x)
        for _ in range(MOST):
            values, residual = self._assemble(x, own, pressure)
            scale = 1 / np.sqrt(np.abs(values[self._diagonal]))
            rows = np.repeat(np.arange(len(scale)), np.diff(self._indptr))
            self._solver.factorise(values * scale[rows] * scale[self._indices])
            change = -scale * self._solver.solve(scale * residual)
            moved, more = self.split(change)
            share = self._possible(x, moved)
            x, own = x + share * moved, own + share * more
            if share == 1.0 and np.abs(moved).max() < CLOSE * self.problem.thin:
                return x
        raise ArithmeticError(f"at {pressure:g} Pa after {MOST} iterations")

    def _possible(self, x: Array, moved: Array) -> float:
        """How much of a correction leaves every element as it should be: 1, 1/2, ..."""
        share = 1.0
        while not self._deformed(x + share * moved)[2].min() > 0:
            share /= 2
        return share

    def _deformed(self, x: Array) -> tuple[Array, Array, Array]:
        """F (e, 27, 3, 3), cof F and det F at the points."""
        mesh, ref, data = self.problem.mesh, reference(), self._data
        f = el.deformation(x, mesh.cells, ref.gradient, data.inverse)
        f = f.reshape(-1, 27, 3, 3)
        det = np.linalg.det(f)
        cof = det[..., None, None] * np.linalg.inv(f).swapaxes(2, 3)
        return f, cof, det

    def _expected(self, x: Array) -> Array:
        """(m,) Pa.  K (J - 1) of some nodes, averaged around each vertex."""
        _, _, det = self._deformed(x)
        share = self._data.weight[..., None] * self._shape
        stiff = self.problem.bulk_modulus[:, None] * (det - 1)
        total, volume = (
            np.bincount(self._vertex.ravel(), part.sum(axis=1).ravel())
            for part in (share * stiff[..., None], share)
        )
        found: Array = total / volume
        return found

    def _assemble(self, x: Array, own: Array, pressure: float) -> tuple[Array, Array]:
        """Values of the upper triangle, and the residual, N and m3."""
        mesh, data, ref = self.problem.mesh, self._data, reference()
        f, cof, det = self._deformed(x)
        count = len(f)
        shape = self._joint * self._shape
        inside = own[self._vertex] @ shape.T + self._local * (det - 1)  # (e, 27) Pa
        stress, slope, _ = self._known.respond(f.reshape(-1, 9), 1.0, True)
        stress = stress.reshape(f.shape) + inside[..., None, None] * cof
        slope = slope.reshape(count, 27, 3, 3, 3, 3)
        turned = np.einsum("ikm,jln,eqmn->eqijkl", SIGNS, SIGNS, f, optimize=True)
        slope = slope + inside[..., None, None, None, None] * turned
        of_volume = self._local[..., None, None, None, None] * cof[..., None, None]
        slope += of_volume * cof[..., None, None, :, :]
        matrix = np.zeros((count, 27, 9, 27))  # node, directions, node
        mixed, force = np.zeros((count, 81, 8)), np.zeros((count, 27, 3))
        for q in range(27):
            inverse = data.inverse[:, q].reshape(-1, 3, 3)
            gradient = ref.gradient[q] @ inverse  # (e, 27, 3) 1/m
            lifted = data.weight[:, q, None, None] * gradient
            # (e, J, (i, k, L)): the first side's direction leads.
            first = slope[:, q].transpose(0, 2, 1, 3, 4).reshape(count, 3, 27)
            half = (lifted @ first).reshape(count, 27 * 9, 3)
            matrix += (half @ gradient.swapaxes(1, 2)).reshape(matrix.shape)
            force += lifted @ stress[:, q].swapaxes(1, 2)
            dilation = (lifted @ cof[:, q].swapaxes(1, 2)).reshape(count, 81)
            mixed += dilation[..., None] * shape[q]
        whole = np.empty((count, 89, 89))
        whole[:, :81, :81] = (
            matrix.reshape(count, 27, 3, 3, 27)
            .transpose(0, 1, 2, 4, 3)
            .reshape(count, 81, 81)
        )
        whole[:, :81, 81:], whole[:, 81:, :81] = mixed, mixed.swapaxes(1, 2)
        whole[:, 81:, 81:] = -self._soft
        values = np.bincount(self._place, whole[self._chosen])
        pattern = self._known.pattern
        load = np.zeros(len(pattern.indices))
        faces, tensor = mesh.cavity_faces, face_tensor()
        add_load_stiffness(load, pattern.of_faces, x, faces, tensor, pressure)
        values[self._of_load] += load
        lack: Array = (data.weight * (det - 1)) @ shape
        lack -= np.einsum("eab,eb->ea", self._soft, own[self._vertex])
        rows = np.hstack([force.reshape(count, 81), lack])
        free = self._unknown >= 0
        residual: Array = np.bincount(self._unknown[free], rows[free])
        outer = self._known.kinematics(x).gradient
        residual[: self._known.unknowns] -= pressure * self._known.restrict(outer)
        return values, residual

    def linearised(
        self, x: Array, own: Array, pressure: float
    ) -> tuple[csr_matrix, Array]:
        """Upper triangle of the tangent, and the residual (k,), for checks of both.

        x : (n, 3) array, m; own : (m,) array, Pa, the pressure field's unknowns.
        """
        values, residual = self._assemble(x, own, pressure)
        return csr_matrix((values, self._indices, self._indptr)), residual

    def split(self, unknowns: Array) -> tuple[Array, Array]:
        """Displacements (n, 3), m, and pressures (m,), Pa, of k unknowns."""
        count = self._known.unknowns
        return self._known.extend(unknowns[:count]), unknowns[count:]
