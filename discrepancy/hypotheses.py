"""Hypotheses about devices: nothing is missing, something is, or named effects act."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .calibration import FIELDS, Calibrations
from .emulator import Emulator
from .prior import Prior
from .target import Prediction

Array = np.ndarray


@dataclass(frozen=True)
class Null:
    """Nothing is missing: the baseline and calibrations.

    With `common` shapes: an effect that has no name here.
    """

    name: str
    prediction: Prediction
    common: tuple[Array, ...] = ()
    priors: tuple[Prior, ...] = ()

    def predict(self, t: Array) -> Prediction:
        return self.prediction

    def bends(self, t: Array) -> Array:
        return np.zeros((0, *self.prediction.columns.shape))

    def many(self, t: Array) -> Array:
        return np.repeat(self.prediction.values[None, :], len(t), axis=0)


@dataclass(frozen=True)
class Present:
    """One or more effects act, with unknown sizes.

    Parameters
    ----------
    name : str
        Names of the effects, joined by ``+``.
    effects : tuple of str
    priors : tuple of k Prior
        Their parameters are named ``effect.parameter``.
    curves, fields : Emulator
        Of the readings, and of their derivatives by `FIELDS`.
    shift : (n,) array
        What the model's mesh adds to the curves.
    calibrations : Calibrations
    reach : (k, 2) array
        Coordinates beyond which a path is known to end before its readings: an effect
        of that size is refuted, and its values are NaN.
    """

    name: str
    effects: tuple[str, ...]
    priors: tuple[Prior, ...]
    curves: Emulator
    fields: Emulator
    shift: Array
    calibrations: Calibrations
    reach: Array
    common: tuple[Array, ...] = ()

    @property
    def nodes(self) -> Array:
        """(m, k) coordinates that were solved."""
        return self.curves.nodes

    def predict(self, t: Array) -> Prediction:
        values, slopes = self.curves.at(t)
        values = values + self.shift
        values[self._lost(t)] = np.nan
        fields = self.fields.many(t[None, :])[0].reshape(-1, len(FIELDS))
        return Prediction(values, slopes, self.calibrations.columns(values, fields))

    def bends(self, t: Array) -> Array:
        slopes = self.curves.at(t)[1]
        fields = self.fields.at(t)[1].reshape(len(slopes), len(FIELDS), len(t))
        bends = [
            self.calibrations.columns(slopes[:, i], fields[:, :, i])
            for i in range(len(t))
        ]
        return np.stack(bends)

    def many(self, t: Array) -> Array:
        values: Array = self.curves.many(t) + self.shift
        values[self._lost(t)] = np.nan
        return values

    def _lost(self, t: Array) -> Array:
        """Whether coordinates (..., k) are beyond `reach`."""
        beyond: Array = (t < self.reach[:, 0]) | (t > self.reach[:, 1])
        return np.asarray(beyond.any(axis=-1))
