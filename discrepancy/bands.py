"""What the readings leave open in a hypothesis, as bands around its predictions."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from .evidence import Fit
from .noise import Frame

Array = np.ndarray

MARGIN = 1.6448536269514722
"""Standard deviations to each side that hold 90 % of a normal density."""

DRAWS = 400


def calibrated_band(one: Fit, seed: int = 0, draws: int = DRAWS) -> tuple[Array, Array]:
    """Central 90 % interval of a hypothesis's predictions, calibrations inferred.

    For each of many parameters t from the posterior, calibrations z follow it exactly:
    with A their columns and C the covariance of noise and smooth errors,

        z | t, y  ~  N( M^-1 A^T C^-1 (y - f(t)), M^-1 ),   M = I + A^T C^-1 A,

    and f(t) + A z is one prediction.  Noise and smooth errors are not in it.

    Parameters
    ----------
    one : Fit
        With samples of its posterior; without them its best fit stands for all.
    seed, draws : int

    Returns
    -------
    low, high : (n,) arrays, SI
    """
    rng = np.random.default_rng(seed)
    t = np.repeat(one.t[None, :], draws, axis=0)
    if one.samples.shape[1]:
        share = one.weights / one.weights.sum()
        t = one.samples[rng.choice(len(share), draws, p=share)]
    values = one.hypothesis.many(t)
    covariance = one.covariance
    frame = Frame(one.readings.subset(one.keep))
    r = frame.turn @ (one.readings.value[None, :] - values)[:, one.keep].T
    weighted = covariance.columns / covariance.diagonal[:, None]
    middle = np.eye(weighted.shape[1]) + covariance.columns.T @ weighted
    factor = cholesky(middle, lower=True)
    spread = solve_triangular(
        factor, rng.standard_normal((len(middle), draws)), trans="T", lower=True
    )
    calibrations = covariance.coefficients(r) + spread
    predicted = values + (_columns(one) @ calibrations).T
    low, high = np.percentile(predicted, [5.0, 95.0], axis=0)
    return low, high


def _columns(one: Fit) -> Array:
    """(n, r + m) changes of all readings by calibrations and unknown shapes."""
    common = one.amplitude("common")
    shapes = [
        common[g] * shape
        for g, shape in zip(sorted(common), one.hypothesis.common, strict=True)
    ]
    columns: Array = np.concatenate(
        [one.hypothesis.predict(one.t).columns, *shapes], axis=1
    )
    return columns
