"""Conjugate gradients with a factorisation that is not that of the matrix."""

from __future__ import annotations

import numpy as np
import pytest

from datagen.tangent import solve_tangent

Array = np.ndarray


class Nearby:
    """Solves with a matrix near the one that is sought."""

    negative = 0

    def __init__(self, matrix: Array) -> None:
        self.matrix, self.solved = matrix, 0

    def factorise(self, data: Array) -> None:
        raise AssertionError("no factorisation is asked for")

    def solve(self, rhs: Array) -> Array:
        self.solved += 1
        solution: Array = np.linalg.solve(self.matrix, rhs)
        return solution


@pytest.fixture
def system() -> tuple[Array, Nearby, Array]:
    rng = np.random.default_rng(1)
    basis = np.linalg.qr(rng.standard_normal((30, 30)))[0]
    stiffness = np.geomspace(1, 1e6, 30)
    matrix, near = (
        basis @ np.diag(values) @ basis.T
        for values in (stiffness, stiffness * rng.uniform(0.7, 1.4, 30))
    )
    return matrix, Nearby(near), rng.standard_normal((30, 4))


def test_every_column_is_found(system: tuple[Array, Nearby, Array]) -> None:
    matrix, near, rhs = system
    found, there = solve_tangent(lambda v: matrix @ v, near, rhs, 1e-9, 40)
    assert there.all()
    wanted = np.linalg.solve(matrix, rhs)
    assert np.abs(found - wanted).max() < 1e-7 * np.abs(wanted).max()


def test_a_good_guess_spares_iterations(system: tuple[Array, Nearby, Array]) -> None:
    matrix, near, rhs = system
    wanted = np.linalg.solve(matrix, rhs)
    solve_tangent(lambda v: matrix @ v, near, rhs, 1e-6, 40)
    without, near.solved = near.solved, 0
    found, there = solve_tangent(
        lambda v: matrix @ v, near, rhs, 1e-6, 40, wanted * (1 + 1e-9)
    )
    assert there.all()
    assert near.solved < without
    assert np.abs(found - wanted).max() < 1e-6 * np.abs(wanted).max()


def test_columns_end_where_they_are_said_to_be_enough(
    system: tuple[Array, Nearby, Array],
) -> None:
    """What is added last is still added; the other columns go on to the tolerance."""
    matrix, near, rhs = system
    seen: list[int] = []

    def enough(found: Array, aim: Array, columns: Array) -> Array:
        assert found.shape == aim.shape == (30, len(columns))
        seen.append(len(columns))
        ended: Array = columns == 2
        return ended

    guess = np.zeros_like(rhs)
    found, there = solve_tangent(
        lambda v: matrix @ v, near, rhs, 1e-9, 40, guess, enough
    )
    assert there.all()
    assert seen[:2] == [4, 3]
    wanted = np.linalg.solve(matrix, rhs)
    error = np.abs(found - wanted).max(axis=0) / np.abs(wanted).max(axis=0)
    assert (error[[0, 1, 3]] < 1e-7).all()
    assert 1e-3 < error[2] < 0.5


def test_what_is_not_found_is_said(system: tuple[Array, Nearby, Array]) -> None:
    matrix, near, rhs = system
    _, there = solve_tangent(lambda v: matrix @ v, near, rhs, 1e-12, 1)
    assert not there.any()


def test_nothing_sought_is_nothing(system: tuple[Array, Nearby, Array]) -> None:
    matrix, near, rhs = system
    rhs[:, 1] = 0.0
    found, there = solve_tangent(lambda v: matrix @ v, near, rhs, 1e-9, 40)
    assert there.all()
    assert not found[:, 1].any()
