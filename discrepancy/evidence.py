"""Evidence of hypotheses, and what the readings say of their parameters.

A hypothesis predicts every reading from a few parameters; calibrations enter linearly
and are integrated out exactly, so that physics cannot hide in them and they cannot
pass for physics.  The evidence is

    Z = int p(t) p(eta) N(y - f(t); C(eta)) dt deta

over the parameters' coordinates t, by importance sampling around the best fit within
the bounds (right at the edge of a range, where Laplace's method is not), by nested
sampling where that has too few effective samples, and over the amplitudes eta by
Laplace's method, which their priors make harmless.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import gammaln, logsumexp

from .noise import Covariance, Frame, Hyper, Readings
from .target import Hypothesis, Target, kept_shapes

Array = np.ndarray

SAMPLES, DEFENSIVE, TAIL = 2000, 0.15, 4.0
"""Importance samples, share drawn from the prior, degrees of freedom of the rest."""

ENOUGH, LIVE, CALLS = 60.0, 400, 40000
"""Effective samples below which nested sampling decides, its live points a dimension,
and its predictions at most."""


@dataclass(frozen=True)
class Fit:
    """A hypothesis conditioned on readings.

    Parameters
    ----------
    hypothesis : Hypothesis
    readings : Readings
    keep : (n,) array of bool
        Readings that were used.
    t : (k,) array
        Coordinates of the best fit.
    eta : (h,) array
        Log amplitudes there, named in `hyper`.
    hyper : Hyper
    covariance : Covariance
    misfit : float
        -2 log posterior density of the best fit, up to a constant that hypotheses of
        one set of readings share; its difference is a chi-square.
    log_evidence : float
        NaN where it was not asked for.
    samples, weights : (m, k), (m,) arrays
        Of the posterior, coordinates; weights sum to one.
    effective : float
        Effective number of samples.
    """

    hypothesis: Hypothesis
    readings: Readings
    keep: Array
    t: Array
    eta: Array
    hyper: Hyper
    covariance: Covariance
    misfit: float
    log_evidence: float = math.nan
    samples: Array = field(default_factory=lambda: np.zeros((0, 0)))
    weights: Array = field(default_factory=lambda: np.zeros(0))
    effective: float = math.nan

    def amplitude(self, kind: str) -> dict[int, float]:
        """Amplitudes of one kind (``noise``, ``smooth``, ``common``) by group."""
        return {
            int(name.split()[1]): float(np.exp(value))
            for name, value in zip(self.hyper.names, self.eta, strict=True)
            if name.split()[0] == kind
        }

    @property
    def noise(self) -> Array:
        """(n,) standard deviation of independent errors, inferred where not stated."""
        factor = self.amplitude("noise")
        of_reading = [factor.get(int(g), 1.0) for g in self.readings.group]
        inferred = self.readings.noise * np.array(of_reading)
        noise: Array = np.where(self.readings.stated, self.readings.noise, inferred)
        return noise

    def values(self) -> Array:
        """(m, k) samples as values of the parameters, SI."""
        columns = [
            prior.value(self.samples[:, i])
            for i, prior in enumerate(self.hypothesis.priors)
        ]
        return np.stack(columns, axis=1) if columns else self.samples

    def mean(self) -> Array:
        """(k,) posterior means of the parameters, SI."""
        mean: Array = self.weights @ self.values()
        return mean

    def std(self) -> Array:
        """(k,) posterior standard deviations, SI."""
        values = self.values()
        spread: Array = np.sqrt(self.weights @ (values - self.weights @ values) ** 2)
        return spread

    def interval(self, coverage: float = 0.9) -> Array:
        """(k, 2) central posterior intervals of the parameters, SI."""
        values = self.values()
        ends = []
        for column in values.T:
            order = np.argsort(column)
            mass = np.cumsum(self.weights[order]) - self.weights[order] / 2
            wanted = [(1 - coverage) / 2, (1 + coverage) / 2]
            ends.append(np.interp(wanted, mass, column[order]))
        return np.array(ends).reshape(-1, 2)

    def predict(self) -> Array:
        """(n,) predictions of all readings, kept or not, calibrated on those kept."""
        at = self.hypothesis.predict(self.t)
        frame = Frame(self.readings.subset(self.keep))
        r = frame.turn @ (self.readings.value - at.values)[self.keep]
        found = self.covariance.coefficients(r)
        common = self.amplitude("common")
        shapes = [
            common[g] * s
            for g, s in zip(
                common, kept_shapes(self.hypothesis, self.keep), strict=True
            )
        ]
        columns = np.concatenate([at.columns, *shapes], axis=1)
        prediction: Array = at.values + columns @ found
        return prediction


def fit(
    readings: Readings,
    hypothesis: Hypothesis,
    *,
    keep: Array | None = None,
    frame: Frame | None = None,
    starts: Sequence[Array] = (),
    eta: Array | None = None,
    fixed: bool = False,
    evidence: bool = True,
    nested: bool = False,
    seed: int = 0,
) -> Fit:
    """Condition a hypothesis on readings.

    Parameters
    ----------
    readings : Readings
    hypothesis : Hypothesis
        Predicts all of them.
    keep : (n,) array of bool, optional
        Readings to use; all by default.
    frame : Frame, optional
        Of the kept readings, where it is at hand.
    starts : sequence of (k,) arrays
        Coordinates to start from, besides off and the best ones that were solved.
    eta : (h,) array, optional
        Log amplitudes to start from; the centres of their priors otherwise, and where
        both kinds of errors are inferred smooth ones above it, too.
    fixed : bool
        Whether those amplitudes are kept.
    evidence : bool
        Whether to integrate, or only to find the best fit.
    nested : bool
        Whether nested sampling takes over where too few samples are effective.
    seed : int
        Of the samples.

    Returns
    -------
    Fit
    """
    keep = np.ones(len(readings.value), dtype=bool) if keep is None else keep
    frame = frame or Frame(readings.subset(keep))
    target = Target(frame, keep, hypothesis)
    begins = [target.hyper.centre if eta is None else eta]
    kinds = {name.split()[0] for name in target.hyper.names}
    if eta is None and not fixed and kinds >= {"noise", "smooth"}:
        begins.append(target.hyper.raised())
    off = np.array([prior.off for prior in hypothesis.priors])
    nodes = getattr(hypothesis, "nodes", None)
    if nodes is not None and len(nodes) > 1:  # the best that was solved, off aside
        starts = [*starts, target.best_of(nodes[1:], begins[0])]
    inside = (np.clip(t, target.lower, target.upper) for t in (off, *starts))
    once = {tuple(t): t for t in inside}  # the best of the solved ones may be off
    found = [target.optimum(t, begin, fixed) for t in once.values() for begin in begins]
    t, eta, misfit = min(found, key=lambda one: np.nan_to_num(one[2], nan=math.inf))
    for _ in range(3):
        best = _conclude(target, readings, keep, hypothesis, t, eta, misfit)
        if not evidence:
            return best
        best, top = _integrate(target, best, seed)
        if top is None:
            break
        # A sample better than the best fit: there is another optimum.
        again = target.optimum(top, eta, fixed)
        if again[2] > misfit - 1e-2:
            break
        t, eta, misfit = again
    if nested and best.effective < ENOUGH and len(t):
        best = _nested(target, best, seed)
    return best


def _conclude(
    target: Target,
    readings: Readings,
    keep: Array,
    hypothesis: Hypothesis,
    t: Array,
    eta: Array,
    misfit: float,
) -> Fit:
    columns = target.look(t)[2]
    return Fit(
        hypothesis=hypothesis,
        readings=readings,
        keep=keep,
        t=t,
        eta=eta,
        hyper=target.hyper,
        covariance=target.covariance(eta, columns),
        misfit=misfit,
    )


def _log_likelihood(target: Target, best: Fit, t: Array) -> Array:
    """(m,) log densities of the readings at coordinates (m, k), amplitudes fixed."""
    values = best.hypothesis.many(t)[:, best.keep]
    r = target.frame.turn @ (target.frame.readings.value[None, :] - values).T
    covariance = best.covariance
    constant = covariance.log_determinant + r.shape[0] * math.log(2 * math.pi)
    logs = -0.5 * (covariance.quadratic(r) + constant)
    return np.where(np.isfinite(logs), logs, -np.inf)


def _outer(target: Target, best: Fit) -> float:
    """What amplitudes and turning add to the log evidence."""
    r, _, columns = target.look(best.t)
    return target.curvature(best.eta, r, columns) + target.frame.log_volume


def _integrate(target: Target, best: Fit, seed: int) -> tuple[Fit, Array | None]:
    """Importance sampling over the coordinates: Student around the fit, and prior.

    Returns
    -------
    Fit, and a sample that is better than the best fit where there is one.
    """
    k = len(best.t)
    outer = _outer(target, best)
    if k == 0:
        r = target.look(best.t)[0]
        value = best.covariance.log_density(r) + outer
        done = replace(
            best,
            log_evidence=value,
            samples=np.zeros((1, 0)),
            weights=np.ones(1),
            effective=math.inf,
        )
        return done, None
    rng = np.random.default_rng(seed)
    slopes = target.look(best.t)[1]
    normal = slopes.T @ best.covariance.solve(slopes) + np.diag(target.pull)
    # Where the readings say nothing of a direction, its range does.
    width = target.upper - target.lower
    normal = normal + np.diag(1.0 / width**2)
    half = 1.2 * np.linalg.inv(np.linalg.cholesky((normal + normal.T) / 2)).T
    count = int(SAMPLES * DEFENSIVE)
    u = rng.random((count, k))
    broad = np.stack(
        [prior.sample(u[:, i]) for i, prior in enumerate(target.priors)], axis=1
    )
    near = rng.standard_normal((SAMPLES - count, k))
    near /= np.sqrt(rng.chisquare(TAIL, SAMPLES - count) / TAIL)[:, None]
    t = np.concatenate([broad, best.t + near @ half.T])
    inside = ((t >= target.lower) & (t <= target.upper)).all(axis=1)
    prior = np.full(SAMPLES, -np.inf)
    prior[inside] = target.log_prior(t[inside])
    z = np.linalg.solve(half, (t - best.t).T)
    student = (
        gammaln((TAIL + k) / 2)
        - gammaln(TAIL / 2)
        - 0.5 * k * math.log(TAIL * math.pi)
        - float(np.log(np.abs(np.diag(half))).sum())
        - 0.5 * (TAIL + k) * np.log1p((z**2).sum(axis=0) / TAIL)
    )
    mixture = np.logaddexp(
        math.log(DEFENSIVE) + prior, math.log(1 - DEFENSIVE) + student
    )
    logs = np.full(SAMPLES, -np.inf)
    logs[inside] = prior[inside] + _log_likelihood(target, best, t[inside])
    at_best = _log_likelihood(target, best, best.t[None, :])
    at_best = at_best + target.log_prior(best.t[None, :])
    top = int(np.argmax(logs))
    better = t[top] if logs[top] > at_best[0] + 0.5 else None
    logs[inside] -= mixture[inside]
    total = float(logsumexp(logs))
    weights = np.exp(logs - total)
    used = weights > 0
    done = replace(
        best,
        log_evidence=total - math.log(SAMPLES) + outer,
        samples=t[used],
        weights=weights[used],
        effective=float(1 / (weights**2).sum()),
    )
    return done, better


def _nested(target: Target, best: Fit, seed: int) -> Fit:
    """Nested sampling over the coordinates (Skilling 2006; Speagle 2020)."""
    from dynesty import NestedSampler

    k = len(best.t)

    def transform(u: Array) -> Array:
        return np.array(
            [float(prior.sample(u[i])) for i, prior in enumerate(target.priors)]
        )

    def likelihood(t: Array) -> float:
        return max(float(_log_likelihood(target, best, t[None, :])[0]), -1e300)

    sampler = NestedSampler(
        likelihood, transform, k, nlive=LIVE * k, rstate=np.random.default_rng(seed)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of narrow bounds, harmless
        sampler.run_nested(print_progress=False, dlogz=0.05, maxcall=CALLS)
    result = sampler.results
    weights = np.exp(result.logwt - result.logz[-1])
    weights /= weights.sum()
    return replace(
        best,
        log_evidence=float(result.logz[-1]) + _outer(target, best),
        samples=result.samples,
        weights=weights,
        effective=float(1 / (weights**2).sum()),
    )
