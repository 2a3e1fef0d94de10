"""Linear systems with the tangent at an equilibrium, whose factorisation is not exact.

The corrector leaves the factorisation of a tangent near the equilibrium.  It is the
preconditioner of conjugate gradients; products with the tangent itself need no matrix.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .linear import Solver

Array = np.ndarray


def solve_tangent(
    product: Callable[[Array], Array],
    solver: Solver,
    rhs: Array,
    tolerance: float,
    iterations: int,
    guess: Array | None = None,
    enough: Callable[[Array, Array, Array], Array] | None = None,
) -> tuple[Array, Array]:
    """Solve K u = r for several right-hand sides at once.

    Parameters
    ----------
    product : callable
        K times vectors (k, c), which are solutions or directions to them.
    solver : Solver
        Holds a factorised matrix near K.
    rhs : (k, c) array
    tolerance : float
        Of each column: the last preconditioned residual over the largest component.
    iterations : int
    guess : (k, c) array, optional
    enough : callable, optional
        Of columns u (k, j), what is about to be added to them and their numbers (j,):
        which of them need not be better (j,), whatever the tolerance says.

    Returns
    -------
    u : (k, c) array
    found : (c,) array of bool
        Which columns are within the tolerance, or enough.
    """
    u = np.zeros_like(rhs) if guess is None else guess.copy()
    lack = rhs.copy() if guess is None else rhs - product(guess)
    aim = solver.solve(lack)
    last, before = aim, np.ones(rhs.shape[1])
    scale = np.abs(u + aim).max(axis=0)
    left = np.arange(rhs.shape[1])  # columns that are not yet found
    for iteration in range(iterations):
        size = np.abs(aim).max(axis=0)
        close = size <= tolerance * scale[left]
        if guess is None and not iteration:
            close = size == 0  # the first aim is all of the answer
        elif enough is not None:
            close |= enough(u[:, left], aim, left)
        u[:, left[close]] += aim[:, close]
        left, lack, aim = left[~close], lack[:, ~close], aim[:, ~close]
        last, before = last[:, ~close], before[~close]
        if not len(left):
            break
        weight = np.einsum("kc,kc->c", lack, aim)
        last = aim + weight / before * last if iteration else aim
        before = weight
        ahead = product(last)
        share = weight / np.einsum("kc,kc->c", last, ahead)
        u[:, left] += share * last
        lack = lack - share * ahead
        aim = solver.solve(lack)
    found = np.ones(rhs.shape[1], dtype=bool)
    found[left] = False
    return u, found
