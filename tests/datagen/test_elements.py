"""Element arithmetic: derivatives, patch test, follower load, linear solvers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_matrix, diags, triu
from scipy.sparse.linalg import eigsh

from datagen.cavity import cavity, cavity_rates, face_tensor
from datagen.deflated import Deflated
from datagen.device import named_device
from datagen.elements import LOCAL_SHARE, element_data, local_share
from datagen.equilibrium import Equilibrium, InvertedElement, Workspace
from datagen.levels import mesh_level
from datagen.linear import BACKENDS, SuperLU, make_solver
from datagen.pardiso import Pardiso, mkl_library
from datagen.problem import Problem, baseline

Array = np.ndarray


@pytest.fixture(scope="module")
def problem() -> Problem:
    return baseline(named_device("S1"), mesh_level("draft"))


@pytest.fixture(scope="module")
def equations(problem: Problem) -> Equilibrium:
    return Equilibrium(problem, Workspace())


def test_the_local_share_is_at_most_half_a_shear_modulus(problem: Problem) -> None:
    """And that of devices is the constant, to the last bit."""
    assert problem.local_share == LOCAL_SHARE
    shear, bulk = np.array([2.0, 2.0]), np.array([50.0, 2000.0])
    assert local_share(shear[:1], bulk[:1]) == LOCAL_SHARE
    assert local_share(shear, bulk) == 0.5 / 1000


def full(equations: Equilibrium, data: Array) -> csr_matrix:
    pattern = equations.pattern
    n = equations.unknowns
    upper = csr_matrix((data, pattern.indices, pattern.indptr), shape=(n, n))
    return (upper + triu(upper, 1).T).tocsr()


def test_tangent_is_the_derivative_of_the_residual(
    problem: Problem, equations: Equilibrium
) -> None:
    rng = np.random.default_rng(1)
    x = problem.nodes + equations.extend(1e-6 * rng.normal(size=equations.unknowns))
    ev = equations.evaluate(x, 2e4, tangent=True)
    assert ev.tangent is not None
    direction = rng.normal(size=equations.unknowns)
    h = 1e-9 * equations.extend(direction)
    ahead, behind = equations.evaluate(x + h, 2e4), equations.evaluate(x - h, 2e4)
    slope = (ahead.residual - behind.residual) / 2e-9
    product = full(equations, ev.tangent) @ direction
    assert np.abs(slope - product).max() < 1e-7 * np.abs(slope).max()
    swept = (ahead.volume - behind.volume) / 2e-9
    assert swept == pytest.approx(ev.volume_gradient @ direction, rel=1e-7)


def test_patch_of_distorted_elements_carries_any_uniform_stretch(
    problem: Problem,
) -> None:
    """Inner nodes of a distorted mesh are in balance under x = F X, rotated."""
    mesh = problem.mesh
    rng = np.random.default_rng(2)
    angle = 1.1
    turn = np.array(
        [
            [np.cos(angle), 0, -np.sin(angle)],
            [0, 1, 0],
            [np.sin(angle), 0, np.cos(angle)],
        ]
    )
    stretch = turn @ np.array([[1.3, 0.1, 0.0], [0.0, 0.9, 0.2], [0.1, 0.0, 0.95]])
    low, high = problem.nodes.min(axis=0), problem.nodes.max(axis=0)
    inner = ((problem.nodes > low + 1e-9) & (problem.nodes < high - 1e-9)).all(axis=1)
    inner[np.unique(mesh.cavity_faces)] = False
    nodes = problem.nodes.copy()
    nodes[inner] += 2e-6 * rng.uniform(-1, 1, size=(int(inner.sum()), 3))
    one = np.full(len(mesh.cells), 1e6)
    from dataclasses import replace

    uniform = replace(problem, nodes=nodes, shear_modulus=one, bulk_modulus=10 * one)
    equations = Equilibrium(uniform, Workspace())
    ev = equations.evaluate(nodes @ stretch.T, 0.0)
    nodal = np.abs(equations.extend(ev.residual))
    assert inner.sum() > 100
    assert nodal[inner].max() < 1e-10 * nodal.max()


def test_rates_of_the_volume_gradient_are_its_derivatives(
    problem: Problem, equations: Equilibrium
) -> None:
    """V is cubic, so central differences of its gradient are exact for any step."""
    rng = np.random.default_rng(4)
    x = problem.nodes + 1e-4 * rng.standard_normal(problem.nodes.shape)
    moves = 1e-4 * rng.standard_normal((2, *x.shape))
    faces, tensor = problem.mesh.cavity_faces, face_tensor()
    rates = cavity_rates(x, moves, faces, tensor)
    for rate, move in zip(rates, moves, strict=True):
        ahead, behind = (cavity(x + s * move, faces, tensor)[1] for s in (1, -1))
        wanted = (ahead - behind) / 2
        assert np.abs(rate - wanted).max() < 1e-12 * np.abs(ahead).max()


def test_rigid_motion_costs_nothing(problem: Problem, equations: Equilibrium) -> None:
    turn = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    moved = problem.nodes @ turn.T + np.array([1e-3, 0.0, -2e-3])
    still = equations.evaluate(moved, 0.0)
    loaded = equations.evaluate(moved, 1e5)
    assert np.abs(still.residual).max() < 1e-9 * np.abs(loaded.residual).max()
    assert still.volume == pytest.approx(equations.evaluate(problem.nodes, 0.0).volume)


def test_growth_alone_stores_no_energy_when_it_is_free(problem: Problem) -> None:
    from dataclasses import replace

    grown = np.tile(1.01 * np.eye(3), (len(problem.mesh.cells), 1, 1))
    equations = Equilibrium(replace(problem, growth=grown), Workspace())
    at_rest = equations.evaluate(1.01 * problem.nodes, 0.0)
    held = equations.evaluate(problem.nodes, 0.0)
    assert np.abs(at_rest.residual).max() < 1e-9 * np.abs(held.residual).max()


def test_inverted_elements_are_named(problem: Problem, equations: Equilibrium) -> None:
    x = problem.nodes.copy()
    cell = problem.mesh.cells[7]
    x[cell[13]] = x[cell[0]] - (x[cell[26]] - x[cell[0]])
    with pytest.raises(InvertedElement) as caught:
        equations.evaluate(x, 0.0)
    assert (
        caught.value.element in np.nonzero((problem.mesh.cells == cell[13]).any(1))[0]
    )
    assert "layer at x =" in equations.where(caught.value.element)


def test_inverted_reference_is_refused(problem: Problem) -> None:
    nodes = problem.nodes.copy()
    nodes[:, 2] *= -1
    with pytest.raises(ValueError, match="inverted"):
        element_data(nodes, problem.mesh.cells)


needs_mkl = pytest.mark.skipif(
    mkl_library() is None, reason="no MKL wheel on this machine"
)


@needs_mkl
def test_both_solvers_give_the_same_answer(
    problem: Problem, equations: Equilibrium
) -> None:
    ev = equations.evaluate(problem.nodes, 0.0, tangent=True)
    assert ev.tangent is not None
    answers = []
    for kind in (Pardiso, SuperLU):
        solver = kind(equations.pattern.indptr, equations.pattern.indices)
        solver.factorise(ev.tangent)
        assert solver.negative == 0
        answers.append(solver.solve(ev.volume_gradient))
    scale = np.abs(answers[0]).max()
    assert np.abs(answers[1] - answers[0]).max() < 1e-8 * scale


@pytest.fixture(scope="module")
def tangent(problem: Problem, equations: Equilibrium) -> Array:
    values = equations.evaluate(problem.nodes, 0.0, tangent=True).tangent
    assert values is not None
    return values


def energy_error(matrix: csr_matrix, found: Array, right: Array) -> float:
    error = found - right
    return float(np.sqrt((error @ matrix @ error) / (right @ matrix @ right)))


@needs_mkl
def test_single_precision_is_mended_where_it_is_wrong(
    equations: Equilibrium, tangent: Array
) -> None:
    """The tip moves by bending of the whole strip: the softest mode there is."""
    pattern, matrix = equations.pattern, full(equations, tangent)
    exact = Pardiso(pattern.indptr, pattern.indices)
    deflated = Deflated(pattern.indptr, pattern.indices)
    exact.factorise(tangent)
    deflated.factorise(tangent)
    rhs = np.random.default_rng(3).standard_normal((equations.unknowns, 3))
    right, found = exact.solve(rhs), deflated.solve(rhs)
    for column in range(3):
        error = energy_error(matrix, found[:, column], right[:, column])
        assert error < 5e-3
        # Balanced against the bare factorisation in single precision.
        bare = Pardiso(pattern.indptr, pattern.indices, dtype=np.float32)
        scale = matrix.diagonal() ** -0.5
        rows = np.repeat(np.arange(len(scale)), np.diff(pattern.indptr))
        bare.factorise(tangent * scale[rows] * scale[pattern.indices])
        plain = scale * bare.solve(scale * rhs[:, column])
        assert energy_error(matrix, plain, right[:, column]) > 5 * error
    one = deflated.solve(rhs[:, 0])
    assert one.shape == rhs[:, 0].shape
    assert np.allclose(one, found[:, 0], rtol=1e-3, atol=1e-4 * np.abs(one).max())
    # Conjugate gradients need a symmetric operator.
    a, b = rhs[:, 1] @ found[:, 2], rhs[:, 2] @ found[:, 1]
    size = np.linalg.norm(rhs[:, 1]) * np.linalg.norm(found[:, 2])
    assert abs(a - b) < 1e-5 * size


@needs_mkl
@pytest.mark.parametrize("wanted", [1, 2, 7])
def test_negative_eigenvalues_are_counted_in_single_precision(
    equations: Equilibrium, tangent: Array, wanted: int
) -> None:
    """Soft ones, which are deflated, and others, which are not."""
    pattern = equations.pattern
    scale = full(equations, tangent).diagonal() ** -0.5
    rows = np.repeat(np.arange(len(scale)), np.diff(pattern.indptr))
    scaled = tangent * scale[rows] * scale[pattern.indices]
    matrix = full(equations, scaled)
    lowest = np.sort(eigsh(matrix, 8, sigma=0.0, return_eigenvectors=False))
    shifted = scaled.copy()
    shifted[pattern.indptr[:-1]] -= lowest[wanted - 1 : wanted + 1].mean()
    counts = []
    for kind in (Pardiso, Deflated):
        solver = kind(pattern.indptr, pattern.indices)
        solver.factorise(shifted)
        counts.append(solver.negative)
    assert counts == [wanted, wanted]


@pytest.mark.parametrize("name", BACKENDS)
def test_indefinite_matrices_are_counted(name: str) -> None:
    if name == "pardiso" and mkl_library() is None:
        pytest.skip("no MKL wheel on this machine")
    matrix = np.array([[2.0, 1.0, 0.0], [1.0, -3.0, 1.0], [0.0, 1.0, 2.0]])
    upper = csr_matrix(np.triu(matrix))
    data, indptr, indices = upper.data, upper.indptr, upper.indices
    solver = make_solver(name, indptr, indices)
    solver.factorise(data)
    assert solver.negative == 1
    rhs = np.array([1.0, 2.0, 3.0])
    assert np.allclose(matrix @ solver.solve(rhs), rhs)
    both = solver.solve(np.stack([rhs, 2 * rhs], axis=1))
    assert np.allclose(both[:, 1], 2 * both[:, 0])


@needs_mkl
@pytest.mark.parametrize("size", [100, 200, 2000])
def test_single_precision_is_left_where_too_many_modes_are_soft(size: int) -> None:
    """A clamped beam of finite differences: its eigenvalues grow as k^4 / size^4."""
    second = diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(size, size))
    matrix = csr_matrix(second @ second)
    upper = csr_matrix(triu(matrix))
    upper.sort_indices()
    rhs = np.random.default_rng(0).standard_normal(size)
    answers = []
    for kind in (Pardiso, Deflated):
        solver = kind(upper.indptr, upper.indices)
        solver.factorise(upper.data)
        assert solver.negative == 0
        answers.append(solver.solve(rhs))
    assert energy_error(matrix, answers[1], answers[0]) < 1e-2
    assert np.array_equal(*answers) == (size == 2000)
