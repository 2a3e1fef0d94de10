"""The ladder: how far the error on devices that were left out falls, rung by rung.

A rung's error is the root mean square of residuals over the noise, each device judged
by a fit that did not see it.  Devices are what is drawn anew, not readings: readings of
one device share its thicknesses and its camera.  A rung is compared with the one before
device by device, so that what makes a device hard for both does not blur the step.

Intervals are the jackknife's with Student's quantile, of the error's logarithm: with a
few devices a bootstrap is far too narrow.  How often they hold is in docs/adopt.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from datagen.errors import InputError

from .heldout import TAIL

Array = np.ndarray

BASELINE, RECALIBRATED, FLOOR = "baseline", "recalibrated", "noise floor"
"""Names of the rungs that have no effect of their own."""

JACKKNIFE, NONE = "jackknife", "none"


@dataclass(frozen=True)
class Rung:
    """One model and its error on devices that were left out of its fit.

    Parameters
    ----------
    name : str
        ``baseline``, ``recalibrated``, ``+ EFFECT``, ``noise floor``.
    effects : tuple of str
        That act in it.
    heldout_error : float
        Root mean square of held-out residuals over the noise; NaN with one device.
    low, high : float
        90 % interval over devices; of the floor, where the error of a right model lies
        in 90 % of sets of such devices.
    ratio, ratio_low, ratio_high : float
        Of the error to that of the rung before, with its interval; NaN where there is
        none to compare with.
    log_bayes : float
        Log Bayes factor against the rung before: below 0 the readings are more probable
        without what this rung adds.  NaN where nothing was integrated.

    Raises
    ------
    InputError
        When an error is negative or an interval does not hold it.
    """

    name: str
    effects: tuple[str, ...]
    heldout_error: float
    low: float
    high: float
    ratio: float = math.nan
    ratio_low: float = math.nan
    ratio_high: float = math.nan
    log_bayes: float = math.nan

    def __post_init__(self) -> None:
        if not self.name:
            raise InputError("rung", self.name, "a name")
        for name in ("heldout_error", "ratio"):
            value = getattr(self, name)
            if value < 0 or math.isinf(value):
                raise InputError(name, value, "a number of at least 0")
        if self.low > self.high:
            raise InputError("low", self.low, f"at most {self.high:g}")

    @property
    def helps(self) -> bool:
        """True where the error is clearly below that of the rung before."""
        return self.ratio_high < 1


@dataclass(frozen=True)
class Judged:
    """Held-out residuals of the models of a ladder, by device.

    Parameters
    ----------
    squares : (m, d) array
        Sums of squared residuals of each model and device.
    counts : (d,) array
        Readings of each device.
    """

    squares: Array
    counts: Array

    @classmethod
    def of(cls, residuals: Sequence[Array], device: Array) -> Judged:
        """From residuals (n,) of each model, and the device (n,) of each reading."""
        devices = np.unique(device)
        squares = [[(r[device == d] ** 2).sum() for d in devices] for r in residuals]
        counts = [int((device == d).sum()) for d in devices]
        return cls(np.array(squares), np.array(counts, dtype=float))

    @property
    def method(self) -> str:
        """How intervals are made: `JACKKNIFE`, or `NONE` with one device."""
        return JACKKNIFE if len(self.counts) > 1 else NONE

    def error(self, model: int) -> tuple[float, float, float]:
        """Root mean square of a model's residuals, and its 90 % interval."""
        return self._interval(lambda weights: self._log(model, weights))

    def ratio(self, model: int, before: int) -> tuple[float, float, float]:
        """Of two models' errors, and its 90 % interval; paired by device."""
        return self._interval(
            lambda weights: self._log(model, weights) - self._log(before, weights)
        )

    def _log(self, model: int, weights: Array) -> Array:
        """(b,) logarithms of the error with devices weighted by (b, d) weights."""
        mean: Array = (weights @ self.squares[model]) / (weights @ self.counts)
        logs: Array = 0.5 * np.log(np.maximum(mean, np.finfo(float).tiny))
        return logs

    def _interval(self, log: Callable[[Array], Array]) -> tuple[float, float, float]:
        """A positive statistic and its interval, from its logarithm (Tukey 1958).

        The logarithm is nearer to normal than the error, and the error stays above 0.
        """
        devices = len(self.counts)
        whole = float(log(np.ones((1, devices)))[0])
        if self.method == NONE:
            return math.exp(whole), math.nan, math.nan
        without = log(1.0 - np.eye(devices))
        pseudo = devices * whole - (devices - 1) * without
        half = float(stdtrit(devices - 1, 1 - TAIL) * pseudo.std(ddof=1))
        half = min(half / math.sqrt(devices), 50.0)  # what exp can hold
        return math.exp(whole), math.exp(whole - half), math.exp(whole + half)


def ladder(
    models: Sequence[tuple[str, tuple[str, ...], Array, float]],
    device: Array,
    floor: float,
    floor_ends: tuple[float, float],
) -> tuple[tuple[Rung, ...], str]:
    """Rungs from held-out residuals, the noise floor last.

    Parameters
    ----------
    models : sequence of (name, effects, (n,) residuals, log evidence)
        Residuals over one noise, which is the same for all; an evidence that was not
        integrated is NaN.
    device : (n,) array of int
    floor : float
    floor_ends : (float, float)

    Returns
    -------
    rungs : tuple of Rung
    method : str
        How their intervals were made.
    """
    judged = Judged.of([model[2] for model in models], device)
    rungs = []
    for i, (name, effects, _, evidence) in enumerate(models):
        ratio = judged.ratio(i, i - 1) if i else (math.nan,) * 3
        bayes = evidence - models[i - 1][3] if i else math.nan
        rungs.append(Rung(name, effects, *judged.error(i), *ratio, bayes))
    last = models[-1][1]
    rungs.append(Rung(FLOOR, last, floor, *floor_ends))
    return tuple(rungs), judged.method
