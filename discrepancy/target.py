"""The posterior of one hypothesis, and where it is highest.

Over the coordinates of the parameters and the logarithms of the errors' amplitudes;
calibrations and unknown shapes, which enter linearly, are integrated out.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np

from .noise import Covariance, Frame
from .prior import NORMAL, Prior

Array = np.ndarray

SETTLED = 2e-4
"""Fall of -2 log density in a step of `Target.optimum`, after which it ends."""

STEPS, FIRM, LOST, BENT = 60, 1e-4, 1e6, 0.1
"""Its steps at most, their least damping, the damping at which it gives up, and the
part of the prior's information by which an observed one has to be positive."""

REACH = 7.0
"""Widths of their priors within which log amplitudes are sought."""


class Prediction(NamedTuple):
    """What a hypothesis says of n readings at one point.

    values : (n,) array.
    slopes : (n, k) array; by the coordinates of its parameters.
    columns : (n, r) array; change by one standard deviation of each calibration.
    """

    values: Array
    slopes: Array
    columns: Array


class Seen(NamedTuple):
    """A prediction beside the readings, turned into the frame of their errors.

    residual : (n,) array.
    slopes : (n, k) array; of the residual, by the coordinates.
    columns : (n, r) array; change by one standard deviation of each calibration.
    """

    residual: Array
    slopes: Array
    columns: Array


class Hypothesis(Protocol):
    """A statement about the readings.

    `common` holds shapes of an unknown effect, (n, m) for each group of readings; empty
    for hypotheses that say what the effect is.
    """

    @property
    def name(self) -> str: ...

    @property
    def priors(self) -> tuple[Prior, ...]: ...

    @property
    def common(self) -> tuple[Array, ...]: ...

    def predict(self, t: Array) -> Prediction:
        """Prediction at coordinates (k,)."""
        ...

    def many(self, t: Array) -> Array:
        """(m, n) values at coordinates (m, k)."""
        ...

    def bends(self, t: Array) -> Array:
        """(k, n, r) derivatives of the columns by the coordinates, at (k,) of them."""
        ...


def kept_shapes(hypothesis: Hypothesis, keep: Array) -> tuple[Array, ...]:
    """Shapes of an unknown effect for the groups that have readings among those kept.

    A group can be of one device alone, and that device be held out.
    """
    return tuple(shape for shape in hypothesis.common if shape[keep].any())


class Target:
    """Log posterior of one hypothesis over coordinates and amplitudes."""

    def __init__(self, frame: Frame, keep: Array, hypothesis: Hypothesis) -> None:
        self.frame, self.hypothesis = frame, hypothesis
        self._keep = keep
        self.hyper = frame.hyper(bool(hypothesis.common))
        self._common = tuple(
            frame.turn @ s[keep] for s in kept_shapes(hypothesis, keep)
        )
        self._y = frame.readings.value
        self.priors = hypothesis.priors
        self.lower = np.array([p.bounds[0] for p in self.priors])
        self.upper = np.array([p.bounds[1] for p in self.priors])
        reach: Array | None = getattr(hypothesis, "reach", None)
        if reach is not None:  # beyond it there is nothing to see
            self.lower = np.maximum(self.lower, reach[:, 0])
            self.upper = np.minimum(self.upper, reach[:, 1])
        self.pull = np.array([float(p.density == NORMAL) for p in self.priors])

    def look(self, t: Array) -> Seen:
        """What the hypothesis says at coordinates (k,), beside the readings."""
        at = self.hypothesis.predict(t)
        turn, keep = self.frame.turn, self._keep
        return Seen(
            turn @ (self._y - at.values[keep]),
            -(turn @ at.slopes[keep]),
            turn @ at.columns[keep],
        )

    def covariance(self, eta: Array, columns: Array) -> Covariance:
        return Covariance(self.frame, self.hyper, eta, columns, self._common)

    def log_prior(self, t: Array) -> Array:
        """(m,) log prior densities of coordinates (m, k)."""
        total = np.zeros(len(t))
        for i, prior in enumerate(self.priors):
            total = total + prior.log_density(t[:, i])
        return total

    def best_of(self, t: Array, eta: Array) -> Array:
        """The coordinates (k,) among (m, k) that fit best at given amplitudes."""
        costs = []
        for one in t:
            r, _, columns = self.look(one)
            form = self.covariance(eta, columns).quadratic(r[:, None])[0]
            costs.append(float(form + self.pull @ one**2))
        best: Array = t[int(np.nanargmin(costs))]
        return best

    def optimum(
        self, t: Array, eta: Array, fixed: bool = False
    ) -> tuple[Array, Array, float]:
        """Best coordinates and log amplitudes from a start, within their bounds.

        Damped Newton steps of both at once, coordinates as Gauss and Newton take them;
        where the observed information of the amplitudes is not positive, with the
        average one, and without that between amplitudes and coordinates.

        Parameters
        ----------
        t, eta : (k,), (h,) arrays
            To start from.
        fixed : bool
            Whether the amplitudes are kept.

        Returns
        -------
        t, eta, and -2 log density there.
        """
        k, hyper = len(t), self.hyper
        margin = REACH * hyper.width
        lower = np.concatenate([self.lower, hyper.centre - margin])
        upper = np.concatenate([self.upper, hyper.centre + margin])
        pull = np.concatenate([self.pull, hyper.width**-2])
        middle = np.concatenate([np.zeros(k), hyper.centre])
        count = k if fixed else k + len(eta)

        def cost(covariance: Covariance, r: Array, x: Array) -> float:
            return float(-2 * covariance.log_density(r) + pull @ (x - middle) ** 2)

        x, seen = np.concatenate([t, eta]), self.look(t)
        covariance = self.covariance(eta, seen.columns)
        now = cost(covariance, seen.residual, x)
        taken, damping = True, FIRM
        for _ in range(STEPS if count else 0):
            if taken:
                gradient, normal = self._newton(covariance, seen, x[:k])
                gradient += pull * (x - middle)
                normal = normal[:count, :count]
            matrix = normal + damping * np.diag(np.diag(normal))
            ahead = _newton_step(x, gradient, matrix, lower, upper)
            there = self.look(ahead[:k]) if k else seen
            trial = self.covariance(ahead[k:], there.columns)
            then = cost(trial, there.residual, ahead)
            taken = then <= now
            if taken:
                gain, damping = now - then, max(damping / 5, FIRM)
                x, seen, covariance, now = ahead, there, trial, then
            else:
                # What it promised; bounds that were met may have turned it uphill.
                gain = float(np.abs((x - ahead) * gradient).sum())
                damping *= 8
            if gain < SETTLED or damping > LOST:
                break
        top = hyper.log_prior(hyper.centre)  # which `cost` leaves out
        return x[:k], x[k:], now - 2 * top

    def _newton(
        self, covariance: Covariance, seen: Seen, t: Array
    ) -> tuple[Array, Array]:
        """Gradient (k + h,) of half the misfit, priors aside, and a positive matrix.

        The matrix has the priors' curvature in it.
        """
        r, slopes, columns = seen
        k, about = slopes.shape[1], covariance.information(r)
        size = np.zeros(k)  # derivatives of half the log determinant
        if k and columns.shape[1]:
            turn, bends = self.frame.turn, self.hypothesis.bends(t)[:, self._keep]
            found = covariance.coefficients(r)[: columns.shape[1]]
            slopes = slopes - turn @ (bends @ found).T
            size = (turn.T @ covariance.solve(columns) * bends).sum(axis=(1, 2))
        gradient = np.concatenate([slopes.T @ covariance.solve(r) + size, -about.slope])
        # Where the readings say nothing of a direction, its range does.
        span = np.maximum(self.upper - self.lower, 1e-9)
        prior = np.concatenate([self.pull + span**-2, self.hyper.width**-2])
        matrix, least = np.diag(prior), BENT * prior
        matrix[:k, :k] += slopes.T @ covariance.solve(slopes)
        safe = matrix.copy()
        safe[k:, k:] += about.average
        matrix[k:, k:] += about.observed
        matrix[:k, k:] = -slopes.T @ covariance.solve(about.pulled.T)
        matrix[k:, :k] = matrix[:k, k:].T
        positive = np.linalg.eigvalsh(matrix - np.diag(least))[0] > 0
        return gradient, matrix if positive else safe

    def curvature(self, eta: Array, r: Array, columns: Array) -> float:
        """Log of the integral of exp over the amplitudes around their best values."""
        hyper = self.hyper
        h = len(hyper.names)
        if not h:
            return 0.0
        matrix = self.covariance(eta, columns).information(r).observed
        matrix = matrix + np.diag(1 / hyper.width**2)
        values = np.maximum(np.linalg.eigvalsh(matrix), 1e-3 / hyper.width.max() ** 2)
        volume = 0.5 * h * math.log(2 * math.pi) - 0.5 * float(np.log(values).sum())
        return hyper.log_prior(eta) + volume


def _newton_step(
    x: Array, gradient: Array, matrix: Array, lower: Array, upper: Array
) -> Array:
    """Where a Newton step ends that follows the bounds it meets.

    Parameters
    ----------
    x, gradient, lower, upper : (n,) arrays
    matrix : (m, m) array
        Positive; of the first m numbers, the others stay.
    """
    m, step, ahead = len(matrix), np.zeros(len(x)), x.copy()
    out = ((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0))
    free = ~out[:m]
    while free.any():
        f = np.flatnonzero(free)
        pull = gradient[f] + matrix[f] @ (step[:m] * ~free)
        step[f] = -np.linalg.solve(matrix[np.ix_(f, f)], pull)
        ahead[:m] = np.clip((x + step)[:m], lower[:m], upper[:m])
        met = f[ahead[f] != (x + step)[f]]
        if not len(met):
            break
        step[met] = (ahead - x)[met]
        free[met] = False
    return ahead
