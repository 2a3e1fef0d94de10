"""A factorisation in single precision that is right where single precision is not.

It takes less time than one in double precision.  A slender strip's stiffness spans ten
orders of magnitude, single precision resolves seven: the factorised matrix B differs
from A by rounding, and B^-1 is wrong along the few softest modes (bending of the whole
strip), where that difference is not small beside A, and right to a thousandth
elsewhere.  The soft modes are found by one step of iteration with the error I - B^-1 A
on a few random vectors, and are solved for in double precision; what is left goes to B:
the balanced deflation of Mandel (1993), in the form of Nabben and Vuik (2004), as a
symmetric operator.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from .pardiso import Pardiso

Array = np.ndarray

MODES = 4
"""Soft modes that are solved for in double precision."""

MILD = 0.1
"""Error along the mildest of the modes found below which these are all that need it."""

STEPS = 3
"""Steps of iteration before single precision is given up for a matrix."""


@njit(cache=True, fastmath=True)
def _scaled(data: Array, indptr: Array, indices: Array, scale: Array) -> Array:
    """Values of D A D in single precision, D the diagonal matrix of `scale`."""
    out = np.empty(len(data), np.float32)
    for row in range(len(scale)):
        for k in range(indptr[row], indptr[row + 1]):
            out[k] = data[k] * scale[row] * scale[indices[k]]
    return out


@njit(cache=True, fastmath=True)
def _times(
    data: Array, indptr: Array, indices: Array, scale: Array, vectors: Array
) -> Array:
    """D A D times vectors (n, 4), of the upper triangle of A.

    Written out: three times as fast as a loop over the vectors.
    """
    count = len(scale)
    inner, out = np.empty((count, 4)), np.zeros((count, 4))
    for row in range(count):
        for c in range(4):
            inner[row, c] = scale[row] * vectors[row, c]
    for row in range(count):
        first = indptr[row]  # the diagonal
        v = data[first]
        x0, x1, x2, x3 = inner[row, 0], inner[row, 1], inner[row, 2], inner[row, 3]
        y0, y1, y2, y3 = v * x0, v * x1, v * x2, v * x3
        for k in range(first + 1, indptr[row + 1]):
            v, column = data[k], indices[k]
            y0 += v * inner[column, 0]
            y1 += v * inner[column, 1]
            y2 += v * inner[column, 2]
            y3 += v * inner[column, 3]
            out[column, 0] += v * x0
            out[column, 1] += v * x1
            out[column, 2] += v * x2
            out[column, 3] += v * x3
        out[row, 0] += y0
        out[row, 1] += y1
        out[row, 2] += y2
        out[row, 3] += y3
    for row in range(count):
        for c in range(4):
            out[row, c] *= scale[row]
    return out


class Deflated:
    """PARDISO in single precision, the modes that it spoils in double.

    Parameters
    ----------
    indptr, indices, threads
        As of `Pardiso`.
    """

    def __init__(self, indptr: Array, indices: Array, threads: int = 1) -> None:
        self._indptr, self._indices, self._threads = indptr, indices, threads
        self._single = Pardiso(indptr, indices, threads, np.float32)
        self._double: Pardiso | None = None  # made when it is needed
        # The same every time: what a path gives does not depend on those before.
        shape = (len(indptr) - 1, MODES)
        self._start = np.random.default_rng(0).standard_normal(shape)
        self._exact = False
        self.negative = 0

    def factorise(self, data: Array) -> None:
        diagonal = np.abs(data[self._indptr[:-1]])
        self._scale = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        matrix = (data, self._indptr, self._indices, self._scale)
        self._single.factorise(_scaled(*matrix))
        modes = self._start
        for _ in range(STEPS):
            error = modes - self._nearly(_times(*matrix, modes))
            modes, sizes = np.linalg.qr(error)
            self._exact = not np.abs(np.diag(sizes)).min() < MILD
            if not self._exact:
                break
        if self._exact:
            self._factorise_double(data)
            return
        lifted = _times(*matrix, modes)
        self._values, turn = np.linalg.eigh(modes.T @ lifted)
        if not np.abs(self._values).min() > 0:
            raise ArithmeticError("the matrix is singular")
        self._modes, self._lifted = modes @ turn, lifted @ turn
        self.negative = int((self._values < 0).sum())
        if self._single.negative:
            # A and B agree on the complement of the modes, and both split there.
            of_b = self._lifted.T @ self._nearly(self._lifted)
            spoilt = int((np.linalg.eigvalsh((of_b + of_b.T) / 2) < 0).sum())
            self.negative += self._single.negative - spoilt

    def _factorise_double(self, data: Array) -> None:
        if self._double is None:
            self._double = Pardiso(self._indptr, self._indices, self._threads)
        self._double.factorise(data)
        self.negative = self._double.negative

    def _nearly(self, rhs: Array) -> Array:
        """B^-1 times vectors (n, k)."""
        size = np.abs(rhs).max(axis=0)
        size[size == 0] = 1.0  # single precision ends at 1e-38
        found: Array = self._single.solve(rhs / size) * size  # and goes on in double
        return found

    def solve(self, rhs: Array) -> Array:
        if self._exact:
            assert self._double is not None
            return self._double.solve(rhs)
        lack = rhs.reshape(len(rhs), -1) * self._scale[:, None]
        share = (self._modes.T @ lack) / self._values[:, None]
        found = self._nearly(lack - self._lifted @ share)
        share -= (self._lifted.T @ found) / self._values[:, None]
        found += self._modes @ share
        found *= self._scale[:, None]
        answer: Array = found.reshape(rhs.shape)
        return answer
