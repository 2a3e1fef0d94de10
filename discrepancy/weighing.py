"""Hypotheses side by side: probabilities, and how far apart they are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from .evidence import ENOUGH, Fit, fit
from .noise import Frame, Readings
from .target import Hypothesis, Target

Array = np.ndarray


def nearest(
    truth: Fit, hypothesis: Hypothesis, starts: Sequence[Array] = ()
) -> tuple[Array, Array]:
    """How near a hypothesis comes to what another one predicts, errors aside.

    Parameters
    ----------
    truth : Fit
        Its best fit is taken for true; its amplitudes are kept.
    hypothesis : Hypothesis
        Of the same readings.
    starts : sequence of (k,) arrays
        Coordinates to start from, besides off.

    Returns
    -------
    t : (k,) array
        Coordinates that come nearest, calibrations and priors paid for.
    lack : (n,) array
        What is left, turned and divided by the errors' Cholesky factor: its square sum
        is the chi-square by which such readings would tell the two apart.
    """
    keep = truth.keep
    values = truth.hypothesis.predict(truth.t).values
    readings = replace(truth.readings, value=values)
    frame = Frame(readings.subset(keep))
    target = Target(frame, keep, hypothesis)
    eta = target.hyper.aligned(truth.hyper.names, truth.eta)
    off = np.array([prior.off for prior in hypothesis.priors])
    best, cost = off, math.inf
    for start in (off, *starts):
        start = np.clip(start, target.lower, target.upper)
        t, _, value = target.optimum(start, eta, fixed=True)
        if value < cost:
            best, cost = t, value
    r, _, columns = target.look(best)
    covariance = target.covariance(eta, columns)
    dense = np.diag(covariance.diagonal) + covariance.columns @ covariance.columns.T
    lack: Array = np.linalg.solve(np.linalg.cholesky(dense), r)
    return best, lack


HOPELESS = 12.0
"""Log evidence behind the best at which more solves or a better integral would change
nothing."""


def weigh(
    readings: Readings, hypotheses: Sequence[Hypothesis], seed: int = 0
) -> list[Fit]:
    """Condition hypotheses on the same readings; integrals that matter are sound."""
    frame = Frame(readings)
    fits = [fit(readings, one, frame=frame, seed=seed) for one in hypotheses]
    return sound(readings, fits, seed)


def sound(readings: Readings, fits: Sequence[Fit], seed: int = 0) -> list[Fit]:
    """The fits, by nested sampling where that could change which of them is best."""
    best = max((one.log_evidence for one in fits), default=0.0)
    return [
        fit(readings, one.hypothesis, starts=[one.t], nested=True, seed=seed)
        if one.effective < ENOUGH and one.log_evidence > best - HOPELESS
        else one
        for one in fits
    ]


def probabilities(log_evidence: Array, log_prior: Array) -> Array:
    """Posterior probabilities (h,) of hypotheses, by Bayes' rule."""
    logs = log_evidence + log_prior
    shares: Array = np.exp(logs - logsumexp(logs))
    return shares
