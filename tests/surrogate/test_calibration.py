"""Intervals cover what they say, although points along a path err together."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from datagen.errors import InputError
from surrogate.calibration import (
    Spread,
    averaging_factor,
    calibrate,
    calibrate_beside,
    design_quantiles,
    fit_shape,
)


def spread_of(disagreement: np.ndarray, nearness: float | np.ndarray = 0.0) -> Spread:
    own = disagreement[:, None]
    return Spread(own, np.full_like(own, 30.0), np.reshape(nearness, (-1, 1)) + 0 * own)


def paths(
    rng: np.random.Generator, designs: int, members: int = 1
) -> tuple[np.ndarray, Spread, np.ndarray]:
    """Errors that share one factor along a path, and grow with the disagreement."""
    counts = rng.integers(2, 30, designs)
    design = np.repeat(np.arange(designs), counts)
    spread = np.exp(rng.normal(size=designs))[design] * rng.uniform(0.5, 1, len(design))
    error = rng.standard_t(4, designs)[design] * spread
    return (
        np.repeat(error[None, :, None], members, axis=0),
        spread_of(spread),
        design,
    )


def test_quantile_by_hand() -> None:
    """Two designs with one and three points: shares 1, 1/3, 1/3, 1/3 of 3."""
    scores = np.array([2.0, 1.0, 3.0, 4.0])
    weight = np.array([1.0, 1 / 3, 1 / 3, 1 / 3])
    levels = np.array([1 / 9, 0.12, 4 / 9, 0.5, 2 / 3])
    found = design_quantiles(scores, weight, 2, levels)
    np.testing.assert_array_equal(found, [1, 2, 2, 3, 4])


@pytest.mark.parametrize("designs", [30, 200])
@pytest.mark.parametrize("coverage", [0.5, 0.9])
def test_coverage_over_designs(designs: int, coverage: float) -> None:
    """Mean over many datasets of the share of points of new designs inside."""
    rng = np.random.default_rng(5)
    shares = []
    for _ in range(60):
        errors, spread, design = paths(rng, designs)
        found = calibrate(errors, spread, design, members=1)
        new, new_spread, new_design = paths(rng, 100)
        inside = np.abs(new[0]) <= found.quantile(coverage) * found.scale(new_spread)
        share = np.bincount(new_design, inside[:, 0]) / np.bincount(new_design)
        shares.append(share.mean())
    mean, error = np.mean(shares), np.std(shares) / np.sqrt(len(shares))
    # Never under; over by one part in the number of designs at most.
    assert coverage - 3 * error < mean < coverage + 1 / designs + 3 * error + 0.01


@pytest.mark.parametrize("share", [-1.0, 0.0, 1.0])
def test_coverage_of_two_parts_together(share: float) -> None:
    """They err apart, or one with or against the other; the other is known."""
    rng = np.random.default_rng(6)
    errors, spread, design = paths(rng, 400)
    known = calibrate(errors, spread, design, members=1)

    def pairs(designs: int) -> tuple[np.ndarray, np.ndarray, tuple[Spread, ...], Any]:
        """Errors of the whole and of the own part, spreads of both parts, designs."""
        one, first, design = paths(rng, designs)
        own = rng.standard_t(4, designs)[design] * first.disagreement[:, 0] / 2
        more = own[None, :, None] + share * one
        second = spread_of(first.disagreement[:, 0] * np.hypot(0.5, share))
        return one + more, more, (first, second), design

    shares, plain = [], []
    for _ in range(60):
        whole, more, (first, second), design = pairs(40)
        alone = calibrate(more, second, design, members=1)
        both = (known, first), (alone, second)
        own = calibrate_beside(*both, whole, design, members=1)
        new, _, (first, second), design = pairs(100)
        for found, kept in ((own, shares), (alone, plain)):
            half = np.hypot(
                known.quantile(0.9) * known.scale(first),
                found.quantile(0.9) * found.scale(second),
            )
            inside = (np.abs(new[0]) <= half)[:, 0]
            kept.append((np.bincount(design, inside) / np.bincount(design)).mean())
    mean, error = np.mean(shares), np.std(shares) / np.sqrt(len(shares))
    assert mean > 0.9 - 3 * error
    if share < 0:  # the other part's interval alone is wider than it need be
        assert own.quantile(0.9) < 0.1 * alone.quantile(0.9)
        assert mean < np.mean(plain)
        return
    assert mean < 0.9 + 1 / 40 + 3 * error + 0.01
    if share > 0:  # each part for itself promises too little
        assert np.mean(plain) < 0.9 - 3 * error


def test_scale_follows_the_disagreement() -> None:
    errors, spread, design = paths(np.random.default_rng(0), 400)
    weight = 1 / np.bincount(design)[design]
    exponent, _, growth = fit_shape(np.abs(errors[0, :, 0]), spread, weight)
    assert exponent > 0.85
    assert growth < 0.3
    rng = np.random.default_rng(1)
    near = rng.uniform(0, 1, len(design))
    size = np.abs(rng.normal(size=len(design))) * np.exp(1.5 * near**4)
    flat = spread_of(np.ones(len(design)), near)
    assert fit_shape(size, flat, weight)[2] == pytest.approx(1.5, abs=0.4)


def test_averaging_takes_off_what_members_do_not_share() -> None:
    """Shared variance 1, private 4: (1 + 4/20)/(1 + 4/4) in squares."""
    rng = np.random.default_rng(0)
    n = 40000
    scores = rng.normal(size=n) + 2 * rng.normal(size=(4, n))
    found = averaging_factor(scores, np.ones(n), n, members=20)
    assert found == pytest.approx(np.sqrt(1.2 / 2.0), rel=0.03)
    same = np.repeat(scores[:1], 4, axis=0)
    assert averaging_factor(same, np.ones(n), n, members=20) == pytest.approx(1)


def test_coverage_that_cannot_be_promised_is_refused() -> None:
    errors, spread, design = paths(np.random.default_rng(0), 30)
    found = calibrate(errors, spread, design, members=1)
    found.quantile(0.95)
    for asked in (0.99, 0.4, 1.0, float("nan")):
        with pytest.raises(InputError, match="30 calibration designs"):
            found.quantile(asked)
