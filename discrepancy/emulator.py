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

    def _near(self, a: Array, b: Array) -> tuple[Array, Array]:
        """Covariances (p, q) of values at a with those at b, and (p, q, k) distances
        by which those with slopes at b differ from them."""
        length = WIDTH * self.span
        apart = (a[:, None, :] - b[None, :, :]) / length
        return np.exp(-0.5 * (apart**2).sum(axis=2)), apart / length

    def _kernel(self, a: Array, b: Array) -> Array:
        """Covariances of values and slopes at a with those at b.

        Returns
        -------
        (p (1 + k), q (1 + k)) array; values first, then slopes by each coordinate.
        """
        base, apart = self._near(a, b)
        (p, q), k = base.shape, len(self.span)
        whole = np.empty((1 + k, p, 1 + k, q))
        turned = (base[..., None] * apart).transpose(2, 0, 1)
        whole[0, :, 0] = base
        whole[0, :, 1:] = turned.transpose(1, 0, 2)
        whole[1:, :, 0] = -turned
        own = np.diag((WIDTH * self.span) ** -2)
        cross = own - apart[..., None] * apart[:, :, None]
        whole[1:, :, 1:] = (base[..., None, None] * cross).transpose(2, 0, 3, 1)
        return whole.reshape((1 + k) * p, (1 + k) * q)

    def many(self, t: Array) -> Array:
        """(p, n) values at coordinates (p, k)."""
        rows, apart = self._near(t, self.nodes)
        if len(self._known) > len(self.nodes):  # slopes, too
            turned = (rows[..., None] * apart).transpose(0, 2, 1)
            rows = np.concatenate([rows, turned.reshape(len(t), -1)], axis=1)
            rows = rows[:, self._known]
        values: Array = self.values[0] + rows @ self._weights
        return values

    def at(self, t: Array) -> tuple[Array, Array]:
        """(n,) values and (n, k) slopes at coordinates (k,)."""
        rows = self._kernel(t[None, :], self.nodes)[:, self._known]
        found = rows @ self._weights
        return self.values[0] + found[0], found[1:].T

    def changes(self) -> Array:
        """(n,) largest changes that are known: at nodes, or by the first one's slopes
        over the whole range."""
        solved = np.abs(self.values - self.values[0]).max(axis=0)
        ahead = (np.abs(np.nan_to_num(self.slopes[0])) * self.span).max(axis=1)
        changes: Array = np.maximum(solved, ahead)
        return changes
