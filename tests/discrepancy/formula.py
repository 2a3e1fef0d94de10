"""Hypotheses given as formulas: any function of a few parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from discrepancy.prior import Prior
from discrepancy.target import Prediction

Array = np.ndarray

STEP = 1e-5
"""Of the coordinates, for central differences."""


@dataclass(frozen=True)
class Formula:
    """A hypothesis by a formula, for bodies of readings without finite elements.

    Parameters
    ----------
    name : str
    priors : tuple of k Prior
    function : callable
        Values (n,) of the k parameters, SI, as positional arguments.
    columns : (n, r) array, optional
        Change by one standard deviation of each calibration.
    scale : float
        Standard deviation of a factor of all values, one more calibration above 0.
    """

    name: str
    priors: tuple[Prior, ...]
    function: Callable[..., Array]
    columns: Array | None = None
    common: tuple[Array, ...] = ()
    scale: float = 0.0

    def _at(self, t: Array) -> Array:
        values = [p.value(float(x)) for p, x in zip(self.priors, t, strict=True)]
        return np.asarray(self.function(*values), dtype=float)

    def predict(self, t: Array) -> Prediction:
        """Values, central differences and the constant calibrations."""
        values = self._at(t)
        slopes = np.empty((len(values), len(t)))
        for i, prior in enumerate(self.priors):
            lower, upper = prior.bounds
            ahead, behind = t.copy(), t.copy()
            ahead[i] = min(t[i] + STEP, upper)
            behind[i] = max(t[i] - STEP, lower)
            rise = self._at(ahead) - self._at(behind)
            slopes[:, i] = rise / (ahead[i] - behind[i])
        columns = np.zeros((len(values), 0)) if self.columns is None else self.columns
        if self.scale:
            columns = np.column_stack([columns, self.scale * values])
        return Prediction(values, slopes, columns)

    def bends(self, t: Array) -> Array:
        at = self.predict(t)
        bends = np.zeros((len(t), *at.columns.shape))
        if self.scale:
            bends[:, :, -1] = self.scale * at.slopes.T
        return bends

    def many(self, t: Array) -> Array:
        return np.stack([self._at(one) for one in t])
