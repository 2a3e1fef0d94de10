"""MKL PARDISO by ctypes, where a wheel of it is installed."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache
from importlib import metadata
from pathlib import Path

import numpy as np

Array = np.ndarray

_MKL_CBWR_AUTO = 2
"""MKL's conditional numerical reproducibility, with the best code for the machine."""


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
        _check_finite(data)
        self._data = np.ascontiguousarray(data, dtype=self._dtype)
        self._call(22)
        self.negative = int(self._settings[22])

    def solve(self, rhs: Array) -> Array:
        _check_finite(rhs)
        return self._call(33, rhs)

    def __del__(self) -> None:
        handle = getattr(self, "_handle", None)
        if handle is not None and handle.any() and not sys.is_finalizing():
            with suppress(ArithmeticError):
                self._call(-1)


def _check_finite(values: Array) -> None:
    """PARDISO writes past its own memory where a number is none."""
    if not np.isfinite(values).all():
        raise ArithmeticError("PARDISO is given what is not finite")
