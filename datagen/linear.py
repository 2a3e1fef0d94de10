"""Sparse symmetric systems: one symbolic analysis a topology, many factorisations.

MKL PARDISO where its wheel is installed (in single precision, see `deflated`), SuperLU
of scipy elsewhere, with the same answers.  A matrix is the upper triangle in compressed
rows.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy.sparse import csr_matrix, triu
from scipy.sparse.linalg import splu

from .deflated import Deflated
from .errors import InputError
from .pardiso import Pardiso, mkl_library

Array = np.ndarray


class Solver(Protocol):
    """Factorises matrices of one pattern."""

    negative: int
    """Number of negative eigenvalues of the last matrix."""

    def factorise(self, data: Array) -> None:
        """Factorise the matrix with these upper-triangle values.

        Raises
        ------
        ArithmeticError
            When the matrix is singular.
        """
        ...

    def solve(self, rhs: Array) -> Array:
        """Solve for one or several right-hand sides, (n,) or (n, k).

        To a few thousandths, and by a symmetric operator: for iterations that know
        their own residual.
        """
        ...


class SuperLU:
    """SuperLU of scipy on the full matrix, for machines without MKL.

    With symmetric (diagonal) pivoting U's diagonal is that of LDL, and its signs are
    those of the eigenvalues.
    """

    def __init__(self, indptr: Array, indices: Array) -> None:
        self._indptr, self._indices = indptr, indices
        self._size = len(indptr) - 1
        self.negative = 0

    def factorise(self, data: Array) -> None:
        shape = (self._size, self._size)
        upper = csr_matrix((data, self._indices, self._indptr), shape=shape)
        full = (upper + triu(upper, 1).T).tocsc()
        try:
            self._factor = splu(
                full,
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except RuntimeError as error:
            raise ArithmeticError(str(error)) from error
        self.negative = int((self._factor.U.diagonal() < 0).sum())

    def solve(self, rhs: Array) -> Array:
        return np.asarray(self._factor.solve(rhs))


BACKENDS = ("pardiso", "superlu")

SMALL = 1000
"""Unknowns below which single precision saves nothing."""


def make_solver(
    backend: str, indptr: Array, indices: Array, threads: int = 1
) -> Solver:
    """A solver of the named backend for one pattern.

    Raises
    ------
    InputError
        When the backend is unknown.
    """
    if backend not in BACKENDS:
        raise InputError("backend", backend, ", ".join(BACKENDS))
    if backend == "superlu":
        return SuperLU(indptr, indices)
    if len(indptr) <= SMALL:
        return Pardiso(indptr, indices, threads)
    return Deflated(indptr, indices, threads)


def default_backend() -> str:
    """``pardiso`` where MKL is installed, else ``superlu``."""
    return "superlu" if mkl_library() is None else "pardiso"
