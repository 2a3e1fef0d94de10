"""Element arithmetic: derivatives, patch test, follower load, linear solvers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_matrix, triu

from datagen.device import named_device
from datagen.elements import element_data
from datagen.equilibrium import Equilibrium, InvertedElement, Workspace
from datagen.linear import BACKENDS, NotDefinite, mkl_library
from datagen.mesh import mesh_level
from datagen.problem import Problem, baseline

Array = np.ndarray


@pytest.fixture(scope="module")
def problem() -> Problem:
    return baseline(named_device("S1"), mesh_level("draft"))


@pytest.fixture(scope="module")
def equations(problem: Problem) -> Equilibrium:
    return Equilibrium(problem, Workspace())


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


@pytest.mark.skipif(mkl_library() is None, reason="no MKL wheel on this machine")
def test_both_solvers_give_the_same_answer(
    problem: Problem, equations: Equilibrium
) -> None:
    ev = equations.evaluate(problem.nodes, 0.0, tangent=True)
    assert ev.tangent is not None
    answers = []
    for name in ("pardiso", "superlu"):
        for definite in (True, False):
            pattern = equations.pattern
            solver = BACKENDS[name](pattern.indptr, pattern.indices, definite)
            solver.factorise(ev.tangent)
            assert solver.negative == 0
            answers.append(solver.solve(ev.volume_gradient))
    scale = np.abs(answers[0]).max()
    for answer in answers[1:]:
        assert np.abs(answer - answers[0]).max() < 1e-8 * scale


@pytest.mark.parametrize("name", sorted(BACKENDS))
def test_indefinite_matrices_are_told_and_counted(name: str) -> None:
    if name == "pardiso" and mkl_library() is None:
        pytest.skip("no MKL wheel on this machine")
    matrix = np.array([[2.0, 1.0, 0.0], [1.0, -3.0, 1.0], [0.0, 1.0, 2.0]])
    upper = csr_matrix(np.triu(matrix))
    data, indptr, indices = upper.data, upper.indptr, upper.indices
    with pytest.raises(NotDefinite):
        BACKENDS[name](indptr, indices, True).factorise(data)
    solver = BACKENDS[name](indptr, indices, False)
    solver.factorise(data)
    assert solver.negative == 1
    rhs = np.array([1.0, 2.0, 3.0])
    assert np.allclose(matrix @ solver.solve(rhs), rhs)
    both = solver.solve(np.stack([rhs, 2 * rhs], axis=1))
    assert np.allclose(both[:, 1], 2 * both[:, 0])
