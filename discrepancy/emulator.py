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

    def _kernel(self, a: Array, b: Array) -> Array:
        """Covariances of values and slopes at a with those at b.

        Returns
        -------
        (p (1 + k), q (1 + k)) array; values first, then slopes by each coordinate.
        """
        length = WIDTH * self.span
        k = len(length)
        d = (a[:, None, :] - b[None, :, :]) / length
        base = np.exp(-0.5 * (d**2).sum(axis=2))
        blocks = [[base] + [base * d[:, :, j] / length[j] for j in range(k)]]
        for i in range(k):
            row = [-base * d[:, :, i] / length[i]]
            for j in range(k):
                cross = (i == j) - d[:, :, i] * d[:, :, j]
                row.append(base * cross / (length[i] * length[j]))
            blocks.append(row)
        return np.block(blocks)

    def many(self, t: Array) -> Array:
        """(p, n) values at coordinates (p, k)."""
        p = len(t)
        rows = self._kernel(t, self.nodes)[:p, self._known]
        values: Array = self.values[0] + rows @ self._weights
        return values

    def slope(self, t: Array) -> Array:
        """(n, k) slopes at coordinates (k,)."""
        rows = self._kernel(t[None, :], self.nodes)[1:, self._known]
        slopes: Array = (rows @ self._weights).T
        return slopes

    def distance(self, t: Array) -> float:
        """From coordinates (k,) to the nearest node, in ranges."""
        return float(np.abs((self.nodes - t) / self.span).max(axis=1).min())
