"""Prediction intervals that cover what they say, on designs that were not seen.

A half width is the product of two parts.  The first is a scale s(point), large where
the members disagree, where large terms cancel and near the limit pressure.  The second
is a quantile of |error|/s over designs that the answering members had not seen
(cross-conformal; Vovk, Ann. Math. Artif. Intell. 74, 2015).  Points along one path go
wrong together, so designs are the independent units: with F_i the empirical
distribution of the scores of design i, the quantile q is the least with

    sum_i F_i(q) / (n + 1) >= coverage,

the hierarchical conformal rule (Lee, Barber and Willett, arXiv 2306.06342), which
covers the asked share of points on average over designs, for any finite n.  What the
mean of all members gains over those that had not seen a design is then taken off
(`averaging_factor`), as far as it is known: measured coverage stays a little above.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.stats import norm

from datagen.errors import InputError

Array = np.ndarray

COVERAGES = np.round(np.arange(0.50, 0.9901, 0.005), 3)
"""Coverages at which quantiles are stored; between them they are interpolated."""

ONE_SIGMA = float(norm.cdf(1) - norm.cdf(-1))
"""Coverage of one standard deviation either side of a normal distribution's mean."""


@dataclass(frozen=True)
class Spread:
    """What an interval's scale is made of.

    Parameters
    ----------
    disagreement : (..., m) array, SI
        Standard deviation over the members.
    size : (..., m) array, SI
        Root sum of squares of an output's terms before they cancel.
    nearness : (..., 1) array
        Pressure over the predicted limit pressure, held at 1.
    """

    disagreement: Array
    size: Array
    nearness: Array

    @classmethod
    def joined(cls, parts: Sequence[Spread]) -> Spread:
        """Several groups of points as one."""
        if len(parts) == 1:
            return parts[0]
        return cls(
            np.concatenate([part.disagreement for part in parts]),
            np.concatenate([part.size for part in parts]),
            np.concatenate([part.nearness for part in parts]),
        )

    def __getitem__(self, chosen: Any) -> Spread:
        """Those points alone."""
        return Spread(
            self.disagreement[chosen], self.size[chosen], self.nearness[chosen]
        )

    def output(self, place: int) -> Spread:
        """That output alone; m = 1."""
        own = slice(place, place + 1)
        return Spread(self.disagreement[..., own], self.size[..., own], self.nearness)


@dataclass(frozen=True)
class Calibration:
    """Scales and quantiles of each output.

    Parameters
    ----------
    shape : (m, 3) array
        Per output: exponent of the disagreement (0 to 1), its floor as a share of the
        size, and growth towards the limit pressure.
    quantiles : (m, c) array
        Quantiles of the scores at `coverages`.
    coverages : (c,) array
    designs : int
        Number of designs that the quantiles rest on.
    """

    shape: Array
    quantiles: Array
    coverages: Array
    designs: int

    def scale(self, spread: Spread) -> Array:
        """(..., m) scale of the error, SI."""
        return scale(spread, self.shape)

    def quantile(self, coverage: float) -> Array:
        """(m,) half width over scale of intervals with that coverage.

        Raises
        ------
        InputError
            When `coverage` is not one that the calibration designs can support.
        """
        top = float(self.coverages[-1])
        if not self.coverages[0] <= coverage <= top:
            allowed = f"{self.coverages[0]:g} to {top:g}"
            if top < COVERAGES[-1]:
                allowed += f" ({self.designs} calibration designs support no more)"
            raise InputError("coverage", coverage, allowed)
        return np.array(
            [np.interp(coverage, self.coverages, own) for own in self.quantiles]
        )


def scale(spread: Spread, shape: Array) -> Array:
    """Scale of the error: size (disagreement^2/size^2 + floor^2)^(e/2) exp(g r^4).

    `shape` is an (m, 3) array of e, floor and g.
    """
    exponent, floor, growth = shape.T
    # Zero at zero pressure, where both are zero.
    size = np.maximum(spread.size, np.finfo(float).tiny)
    ratio = (spread.disagreement / size) ** 2 + floor**2
    value: Array = spread.size * ratio ** (exponent / 2)
    value *= np.exp(growth * spread.nearness**4)
    return value


def calibrate(
    errors: Array, spread: Spread, design: Array, members: int
) -> Calibration:
    """Fit the scale of each output, then take the quantiles of the scores.

    Parameters
    ----------
    errors : (r, N, m) array, SI
        Error at each point of the r members that had not seen the design.
    spread : Spread of (N, m) arrays
        From the same members.
    design : (N,) int array
        Which design a point belongs to.
    members : int
        How many members answer in use.

    Raises
    ------
    InputError
        When there are too few designs for the lowest coverage.
    """
    _, index, counts = np.unique(design, return_inverse=True, return_counts=True)
    n = len(counts)
    weight = 1 / counts[index]
    levels = COVERAGES[: np.searchsorted(COVERAGES, n / (n + 1), side="right")]
    if not len(levels):
        raise InputError("designs", n, "at least 2 to calibrate on")
    outputs = range(errors.shape[2])
    size = np.abs(errors.mean(axis=0))
    shape = np.stack([fit_shape(size[:, o], spread.output(o), weight) for o in outputs])
    scores = errors / scale(spread, shape)
    quantiles = [
        design_quantiles(np.abs(scores[..., o].mean(axis=0)), weight, n, levels)
        * averaging_factor(scores[..., o], weight, n, members)
        for o in outputs
    ]
    return Calibration(shape, np.stack(quantiles), levels, n)


def calibrate_beside(
    known: tuple[Calibration, Spread],
    own: tuple[Calibration, Spread],
    errors: Array,
    design: Array,
    members: int,
) -> Calibration:
    """Quantiles of one part of an answer, where the other part's are known.

    The half width of the whole answer is the root of the sum of squares of both parts'.
    The two may err against each other or together, so the own quantile at a coverage is
    that of what the other part's half width h leaves open, sqrt(max(e^2 - h^2, 0))/s:
    the whole interval then covers whole answers, and is no wider than that takes.

    Parameters
    ----------
    known, own : Calibration and Spread of (N, m) arrays
        Of the part that keeps its quantiles, and of the one that gets new ones.
    errors, design, members
        As in `calibrate`, of the whole answer.
    """
    (fixed, other_spread), (part, spread) = known, own
    _, index, counts = np.unique(design, return_inverse=True, return_counts=True)
    n, weight = len(counts), 1 / counts[index]
    levels = part.coverages[part.coverages <= fixed.coverages[-1]]
    # At zero pressure there may be neither a scale nor an error.
    unit = np.maximum(part.scale(spread), np.finfo(float).tiny)
    other = fixed.scale(other_spread)
    typical = np.hypot(unit, other)
    size = np.abs(errors.mean(axis=0))
    quantiles = np.empty((errors.shape[2], len(levels)))
    for o in range(errors.shape[2]):
        gained = averaging_factor(errors[..., o] / typical[:, o], weight, n, members)
        for k, level in enumerate(levels):
            half = fixed.quantile(level)[o] * other[:, o]
            left = np.maximum((gained * size[:, o]) ** 2 - half**2, 0.0)
            quantiles[o, k] = design_quantiles(
                np.sqrt(left) / unit[:, o], weight, n, np.array([level])
            )[0]
    # The other part's half width grows with the level, what it leaves may shrink.
    return Calibration(part.shape, np.maximum.accumulate(quantiles, 1), levels, n)


def averaging_factor(scores: Array, weight: Array, designs: int, members: int) -> float:
    """How much less the mean of all members errs than that of a few.

    Only r members had not seen a design, while all M answer in use.  The square of an
    error of the mean of r is B + V/r: a part B that members share and a part V that
    averages out.  Both follow from the quantiles of the scores of single members and
    of the mean of r; the factor is sqrt((B + V/M)/(B + V/r)).

    Parameters
    ----------
    scores : (r, N) array
        Signed scores of each member.
    """
    r = len(scores)
    if r >= members or r == 1:
        return 1.0
    level = np.array([0.9 * designs / (designs + 1)])
    alone = np.mean(
        [design_quantiles(np.abs(s), weight, designs, level)[0] for s in scores]
    )
    together = design_quantiles(np.abs(scores.mean(axis=0)), weight, designs, level)[0]
    if together == 0:  # nothing there to err about
        return 1.0
    private = max(alone**2 - together**2, 0.0) / (1 - 1 / r)
    left = together**2 - private * (1 / r - 1 / members)
    # The shared part is never negative.
    return float(np.sqrt(max(left, together**2 * r / members) / together**2))


def design_quantiles(
    scores: Array, weight: Array, designs: int, levels: Array
) -> Array:
    """Least score whose mean distribution over designs reaches each level.

    `weight` sums to 1 over each design; the one added to the number of designs
    stands for the design that is still to come.
    """
    order = np.argsort(scores, kind="stable")
    share = np.cumsum(weight[order]) / (designs + 1)
    place = np.searchsorted(share, levels - 1e-12)
    # Rounding of the sum may leave its end a hair under the highest level.
    values: Array = scores[order][np.minimum(place, len(order) - 1)]
    return values


def fit_shape(size: Array, spread: Spread, weight: Array) -> Array:
    """Exponent, floor and growth of one output, for errors most alike everywhere.

    Maximum likelihood with Laplace errors, the common factor profiled out: it belongs
    to the quantiles.
    """
    typical = np.median(spread.size)

    def shape_of(free: Array) -> Array:
        return np.array([1 / (1 + np.exp(-free[0])), np.exp(free[1]), free[2]])

    def cost(free: Array) -> float:
        shape = shape_of(free)
        s = scale(spread, shape[None])[..., 0] / typical
        factor = np.average(size / typical / s, weights=weight)
        factor = max(factor, np.finfo(float).tiny)  # where there is no error at all
        likelihood = np.average(np.log(s), weights=weight) + np.log(factor)
        # Weak pull towards a plain scale, for small datasets.
        return float(likelihood + 1e-3 * (free[0] ** 2 + free[2] ** 2))

    start = np.array([1.0, np.log(0.01), 0.0])
    found = minimize(
        cost, start, method="L-BFGS-B", bounds=[(-4, 4), (-9.0, 0.0), (0, 3)]
    )
    return shape_of(found.x)
