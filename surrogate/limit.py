"""The limit pressure of a design, learned from paths most of which never met it.

A path that reached the highest pressure of its dataset says only that its limit lies
above: such a design is censored on the right, and enters with the probability of that
(the Tobit likelihood; Tobin, Econometrica 26, 1958).  Networks learn the logarithm of
the limit pressure over the closed-form scale `Prepared.limit_scale`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .features import Prepared
from .network import FitSettings, Progress, Rows, Stack, fit

if TYPE_CHECKING:
    import torch

Array = np.ndarray

FEWEST_LIMITS = 12
"""With fewer limit points in a dataset nothing is learned about them."""

SETTINGS = FitSettings(
    hidden=(16,), steps=1000, batch=256, rate=4e-3, decay=3.0, check_every=25
)


@dataclass(frozen=True)
class Limit:
    """Predicted limit pressures.

    Parameters
    ----------
    pressure : (n,) array, Pa
        Median.
    std : (n,) array
        Standard deviation of its logarithm: noise and disagreement of the members.
    """

    pressure: Array
    std: Array

    def quantile(self, deviations: float) -> Array:
        """(n,) Pa, so many standard deviations from the median."""
        value: Array = self.pressure * np.exp(deviations * self.std)
        return value


@dataclass(frozen=True)
class LimitModel:
    """Ensemble for the limit pressure; without a stack, the closed-form scale.

    Parameters
    ----------
    stack : Stack or None
        Two answers a member: log(limit/scale) and the logarithm of its deviation.
    shift : float
        Added to the first answer: the mean over the limit points seen.
    """

    stack: Stack | None
    shift: float = 0.0

    def __call__(self, prepared: Prepared, members: Array | None = None) -> Limit:
        """Limit pressure of each design.

        Parameters
        ----------
        prepared : Prepared
            n designs.
        members : (r, n) int array, optional
            Members asked about each design; all of them where it is not given.
        """
        if self.stack is None:
            return Limit(prepared.limit_scale, np.full(len(prepared), np.inf))
        answers = self.stack(prepared.inputs)
        if members is not None:
            answers = answers[members, np.arange(len(prepared))]
        mean, noise = answers[..., 0], np.exp(_log_noise(answers[..., 1], np.tanh))
        variance = mean.var(axis=0) + (noise**2).mean(axis=0)
        middle = prepared.limit_scale * np.exp(self.shift + mean.mean(axis=0))
        return Limit(middle, np.sqrt(variance))


def _log_noise(value: Any, tanh: Callable[[Any], Any]) -> Any:
    """Logarithm of the deviation, held between 0.2 % and 60 %.

    Smooth, so that no member is stuck at a bound; for arrays and for tensors.
    """
    return -3.4 + 2.9 * tanh(value / 2.9)


def tobit_loss(
    answers: torch.Tensor, target: torch.Tensor, censored: torch.Tensor
) -> torch.Tensor:
    """Negative log-likelihood of limit points, and of limits that lie higher.

    Parameters
    ----------
    answers : (..., 2) tensor
        Mean, and unbounded logarithm of the standard deviation.
    target : (...) tensor
        Logarithm of the limit, or of the highest pressure reached without one.
    censored : (...) bool tensor
    """
    import torch

    log_noise = _log_noise(answers[..., 1], torch.tanh)
    z = (target - answers[..., 0]) * torch.exp(-log_noise)
    met = 0.5 * z**2 + log_noise
    return torch.where(censored, -torch.special.log_ndtr(-z), met)


def fit_limit(
    views: Sequence[Prepared],
    limit_pressure: Array,
    reached: Array,
    held_out: Array,
    seed: int,
    settings: FitSettings = SETTINGS,
    progress: Progress | None = None,
) -> tuple[LimitModel, dict[str, Any]]:
    """Learn the limit pressure.

    Parameters
    ----------
    views : sequence of Prepared
        n designs, once or in several views that have the same limit pressure.
    limit_pressure : (n,) array, Pa
        NaN where the path met no limit point.
    reached : (n,) array, Pa
        Highest pressure at which each path is in equilibrium.
    held_out : (M, n) bool array
        Designs that each member must not see.
    seed : int
    """
    import torch

    met = np.isfinite(limit_pressure)
    if met.sum() < FEWEST_LIMITS:
        return LimitModel(None), {"limit_points": int(met.sum())}
    known = np.where(met, limit_pressure, reached)
    # Views of a design stand one after another: together they are one design.
    log_ratio = np.log(
        known[:, None] / np.stack([v.limit_scale for v in views], axis=1)
    )
    shift = float(log_ratio[met].mean())
    target = torch.tensor((log_ratio - shift).ravel(), dtype=torch.float32)
    censored = torch.tensor(np.repeat(~met, len(views)))

    def loss(answers: torch.Tensor, picked: torch.Tensor) -> torch.Tensor:
        return tobit_loss(answers, target[picked], censored[picked])

    each = len(views)
    rows = Rows(each * np.arange(len(met)), np.full(len(met), each), held_out)
    x = np.stack([view.inputs for view in views], axis=1).reshape(each * len(met), -1)
    stack, report = fit(x, rows, 2, loss, settings, seed, "limit pressure", progress)
    return LimitModel(stack, shift), report | {"limit_points": int(met.sum())}
