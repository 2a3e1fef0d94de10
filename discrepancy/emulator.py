"""Curves between the solved ones: interpolation of values and slopes.

A few solves with their derivatives carry a hypothesis through its whole range.  Values
and slopes at nodes are interpolated with a Gaussian kernel that is wide against the
range, which is close to the polynomial through all of them (gradient-enhanced kriging,
Morris, Mitchell and Ylvisaker 1993); departures from the first node are interpolated,
so that nothing is added where nothing was solved.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

Array = np.ndarray

WIDTH = 1.5
"""Length of the kernel over the range of a coordinate."""

NUGGET = 1e-9
"""Relative variance on the diagonal: solver tolerance, and a bound on rounding."""


@dataclass(frozen=True)
class Emulator:
    """Interpolates n numbers over k coordinates.

    Parameters
    ----------
    nodes : (m, k) array
        Coordinates; the first node is where the effect vanishes.
    values : (m, n) array
    slopes : (m, n, k) array
        By the coordinates; NaN (all n) where a slope was not computed.
    span : (k,) array
        Range of each coordinate.
    """

    nodes: Array
    values: Array
    slopes: Array
    span: Array
    _known: Array = field(init=False, repr=False)
    _weights: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        m, k = self.nodes.shape
        known = np.isfinite(self.slopes).all(axis=1)  # (m, k)
        which = np.flatnonzero(known.T.reshape(-1))
        matrix = self._kernel(self.nodes, self.nodes)
        take = np.concatenate([np.arange(m), m + which])
        matrix = matrix[np.ix_(take, take)]
        scale = np.sqrt(np.diag(matrix))
        data = np.concatenate(
            [
                self.values - self.values[0],
                self.slopes.transpose(2, 0, 1).reshape(k * m, -1)[which],
            ]
        )
        unit = matrix / scale[:, None] / scale[None, :]
        unit[np.diag_indices(len(unit))] += NUGGET
        solved = np.linalg.solve(unit, data / scale[:, None]) / scale[:, None]
        object.__setattr__(self, "_known", take)
        object.__setattr__(self, "_weights", solved)

    def _kernel(self, a: Array, b: Array, slopes: bool = True) -> Array:
        """Covariances of values and slopes at a with those at b.

        Returns
        -------
        (p (1 + k), q (1 + k)) array; values first, then slopes by each coordinate;
        (p, q (1 + k)) where no slopes at a are wanted.
        """
        length = WIDTH * self.span
        k = len(length)
        d = (a[:, None, :] - b[None, :, :]) / length
        base = np.exp(-0.5 * (d**2).sum(axis=2))
        p, q = base.shape
        whole = np.empty(((1 + k) * p if slopes else p, (1 + k) * q))
        whole[:p, :q] = base
        for j in range(k):
            whole[:p, (1 + j) * q : (2 + j) * q] = base * d[:, :, j] / length[j]
        for i in range(k if slopes else 0):
            rows = slice((1 + i) * p, (2 + i) * p)
            whole[rows, :q] = -base * d[:, :, i] / length[i]
            for j in range(k):
                cross = (i == j) - d[:, :, i] * d[:, :, j]
                columns = slice((1 + j) * q, (2 + j) * q)
                whole[rows, columns] = base * cross / (length[i] * length[j])
        return whole

    def many(self, t: Array) -> Array:
        """(p, n) values at coordinates (p, k)."""
        rows = self._kernel(t, self.nodes, slopes=False)[:, self._known]
        values: Array = self.values[0] + rows @ self._weights
        return values

    def slope(self, t: Array) -> Array:
        """(n, k) slopes at coordinates (k,)."""
        rows = self._kernel(t[None, :], self.nodes)[1:, self._known]
        slopes: Array = (rows @ self._weights).T
        return slopes

    def changes(self) -> Array:
        """(n,) largest changes that are known: at nodes, or by the first one's slopes
        over the whole range."""
        solved = np.abs(self.values - self.values[0]).max(axis=0)
        ahead = (np.abs(np.nan_to_num(self.slopes[0])) * self.span).max(axis=1)
        changes: Array = np.maximum(solved, ahead)
        return changes
