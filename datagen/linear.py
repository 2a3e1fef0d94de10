"""Sparse symmetric systems: one symbolic analysis a topology, many factorisations.

MKL PARDISO where its wheel is installed (in single precision, see `deflated`), SuperLU
of scipy elsewhere, with the same answers.  A matrix is the upper triangle in compressed
rows.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Protocol

import numpy as np
from scipy.sparse import csr_matrix, triu
from scipy.sparse.linalg import splu

from .errors import InputError

Array = np.ndarray


_MKL_CBWR_AUTO = 2
"""MKL's conditional numerical reproducibility, with the best code for the machine."""


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


def _candidates() -> Iterator[str]:
    """Where an installed `mkl` wheel keeps its runtime library."""
    pattern = {"win32": "mkl_rt*.dll"}.get(sys.platform, "libmkl_rt.so*")
    with suppress(metadata.PackageNotFoundError):
        for file in metadata.files("mkl") or ():
            if file.match(pattern):
                yield str(Path(str(file.locate())).resolve())


@lru_cache(maxsize=1)
def mkl_library() -> ctypes.CDLL | None:
    """MKL's runtime library, or None where no wheel of it is installed."""
    for candidate in _candidates():
        with suppress(OSError):
            library = ctypes.CDLL(candidate)
            # The same bits in every run, wherever the arrays happen to lie: a resumed
            # dataset equals an uninterrupted one.
            library.MKL_CBWR_Set(_MKL_CBWR_AUTO)
            return library
    return None


class Pardiso:
    """MKL PARDISO's LDL on the upper triangle.

    Parameters
    ----------
    indptr, indices : arrays of int
        Pattern of the upper triangle, sorted, every diagonal entry present.
    threads : int
        Of MKL, in this thread.
    dtype : type
        In which it calculates: double or single precision.
    """

    def __init__(
        self,
        indptr: Array,
        indices: Array,
        threads: int = 1,
        dtype: type = np.float64,
    ) -> None:
        library = mkl_library()
        if library is None:
            raise OSError("no MKL runtime library is installed")
        self._mkl = library
        self._mkl.MKL_Set_Num_Threads_Local(threads)
        self._indptr = np.ascontiguousarray(indptr, dtype=np.int32)
        self._indices = np.ascontiguousarray(indices, dtype=np.int32)
        self._size = len(indptr) - 1
        self._dtype = dtype
        self._handle = np.zeros(64, dtype=np.int64)
        self._settings = np.zeros(64, dtype=np.int32)
        self._settings[0] = 1  # no defaults: all settings are here
        self._settings[1] = 2  # nested dissection (METIS)
        # Slender strips have condition numbers of 1e10: a pivot must not be perturbed
        # before it is lost in rounding.
        self._settings[9] = 14
        # No scaling or matching by values, settings 10 and 12: a tangent past a limit
        # point has a few negative pivots and is else definite; one analysis serves all.
        self._settings[20] = 1  # Bunch-Kaufman pivots
        self._settings[27] = int(dtype == np.float32)
        self._settings[34] = 1  # indices from 0
        self._data: Array = np.zeros(len(indices), dtype)
        self.negative = 0
        self._call(11)

    def _call(self, phase: int, rhs: Array | None = None) -> Array:
        columns = 1 if rhs is None or rhs.ndim == 1 else rhs.shape[1]
        b: Array = (
            np.zeros(1, self._dtype)
            if rhs is None
            else np.array(rhs, dtype=self._dtype, order="F")
        )
        x = np.zeros_like(b, order="F")
        error = ctypes.c_int(0)

        def pointer(array: Array) -> ctypes.c_void_p:
            return array.ctypes.data_as(ctypes.c_void_p)

        def integer(value: int) -> object:
            return ctypes.byref(ctypes.c_int(value))

        self._mkl.pardiso(
            pointer(self._handle),
            integer(1),
            integer(1),
            integer(-2),
            integer(phase),
            integer(self._size),
            pointer(self._data),
            pointer(self._indptr),
            pointer(self._indices),
            None,
            integer(columns),
            pointer(self._settings),
            integer(0),
            pointer(b),
            pointer(x),
            ctypes.byref(error),
        )
        if error.value:
            raise ArithmeticError(f"PARDISO failed with error {error.value}")
        return x

    def factorise(self, data: Array) -> None:
        self._data = np.ascontiguousarray(data, dtype=self._dtype)
        self._call(22)
        self.negative = int(self._settings[22])

    def solve(self, rhs: Array) -> Array:
        return self._call(33, rhs)

    def __del__(self) -> None:
        handle = getattr(self, "_handle", None)
        if handle is not None and handle.any() and not sys.is_finalizing():
            with suppress(ArithmeticError):
                self._call(-1)


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
    from .deflated import Deflated  # it uses `Pardiso`

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
