"""A ranking in words: units of the bench, and a verdict that says what it must."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from discrepancy.judging import Candidate
from discrepancy.words import (
    BEYOND,
    INSIDE,
    OPEN,
    Size,
    decimals,
    in_words,
    percent,
    sizes,
    verdict,
)
from tests.discrepancy.ranked import PLANTED, ranked
from tests.discrepancy.test_figures import tie


def test_names() -> None:
    assert in_words("nothing") == "nothing missing"
    assert in_words("mooney+unknown") == "mooney + an effect without a name"
    assert in_words("mooney+yeoh") == "mooney + yeoh"


@pytest.mark.parametrize(
    ("probability", "text"),
    [
        (1.0, "above 99.9 %"),
        (0.98, "98.0 %"),
        (0.5, "50 %"),
        (0.031, "3.1 %"),
        (0.0, "below 0.1 %"),
    ],
)
def test_probabilities(probability: float, text: str) -> None:
    assert percent(probability) == text


@pytest.mark.parametrize(
    ("std", "digits"), [(20, 0), (2.1, 1), (0.05, 3), (0.0, 3), (float("nan"), 3)]
)
def test_digits_follow_the_standard_deviation(std: float, digits: int) -> None:
    assert decimals(std) == digits


def pushed(low: float, high: float, best: float) -> Size:
    """Size of a pressure offset, its posterior even between two shares of its range."""
    one = ranked()[1].candidate("pressure_offset")
    lower, upper = one.fit.hypothesis.priors[0].bounds
    at = np.linspace(low, high, 1001)[:, None]
    fit = replace(
        one.fit,
        t=np.array([lower + best * (upper - lower)]),
        samples=lower + at * (upper - lower),
        weights=np.full(1001, 1 / 1001),
    )
    return sizes(replace(one, fit=fit))[0]


def test_a_size_is_in_bench_units_with_its_range() -> None:
    size = pushed(0.6, 0.7, 0.65)  # of -2 to 2 kPa
    assert (size.name, size.short, size.unit) == (
        "pressure_offset.offset",
        "offset",
        "kPa",
    )
    assert size.value == pytest.approx(0.6)
    assert size.std == pytest.approx(0.4 / np.sqrt(12), rel=1e-2)
    assert (size.low, size.high) == pytest.approx((0.42, 0.78), abs=1e-3)
    assert size.number == "0.60 \u00b1 0.12 kPa"
    assert size.interval == "0.42 to 0.78 kPa"
    assert size.range == "-2 to 2 kPa"


@pytest.mark.parametrize(
    ("low", "high", "best", "judged"),
    [
        (0.6, 0.7, 0.65, INSIDE),
        (0.9, 0.99, 0.95, OPEN),
        (0.9, 1.0, 0.97, OPEN),
        (0.97, 1.0, 1.0, BEYOND),
        (0.0, 0.05, 0.0, BEYOND),
        (0.48, 0.52, 0.5, INSIDE),
    ],
)
def test_plausibility(low: float, high: float, best: float, judged: str) -> None:
    assert pushed(low, high, best).plausibility == judged


def nudged(name: str, probability: float) -> tuple[Candidate, ...]:
    return tuple(
        replace(one, probability=probability if one.name == name else 0.01)
        for one in ranked()[1].candidates
    )


def test_identified_says_name_size_and_plausibility() -> None:
    ranking = ranked()[1]
    assert ranking.verdict == "identified"
    size = sizes(ranking.best)[0]
    assert abs(size.value - PLANTED) < 5 * size.std
    assert verdict(ranking) == (
        f"Identified: cure_mismatch is missing (probability "
        f"{percent(ranking.best.probability)}). Difference is {size.number} (90 % "
        f"interval {size.interval}); plausible: inside the literature range (-0.01 to "
        "0.01)."
    )


def test_identified_among_others_says_how_probable_it_is_alone() -> None:
    ranking = ranked()[1]
    best = ranking.best
    fitted = replace(best.fit, hypothesis=replace(best.fit.hypothesis, name="both"))  # type: ignore[type-var]
    more = replace(best, probability=0.5, fit=fitted)
    less = replace(best, probability=0.45)
    made = replace(ranking, candidates=(less, more))
    assert "(probability 95.0 %, nothing besides it 45 %)" in verdict(made)


def test_tied_says_which_why_and_what_next() -> None:
    tied = tie(ranked()[1])
    text = verdict(tied, "device T & U, turned over.")
    assert text.startswith("Tied: cure_mismatch or pressure_offset; ")
    assert "chi-square of only 5" in text
    assert "the odds against it are 1.7 to 1, below the 20 to 1" in text
    assert text.endswith("To measure next: device T & U, turned over.")
    assert verdict(tied).endswith("has been worked out.")


def test_adequate_and_unexplained() -> None:
    ranking = ranked()[1]
    adequate = replace(ranking, verdict="adequate", candidates=nudged("nothing", 0.9))
    assert "Adequate" in verdict(adequate)
    assert verdict(adequate).endswith("(probability 90 %).")
    doubtful = replace(
        ranking, verdict="adequate", candidates=nudged("cure_mismatch", 0.93)
    )
    assert "An effect of cure_mismatch is more probable (93.0 %)" in verdict(doubtful)
    unexplained = replace(
        ranking, verdict="unexplained", candidates=nudged("unknown", 0.85)
    )
    text = verdict(unexplained)
    assert text.startswith("Unexplained: something is missing")
    # With those of the other hypotheses that an effect without a name is a part of.
    assert "an effect without a name: probability 87 %" in text
    assert "cure_mismatch comes nearest (probability" in text


def test_what_was_overruled_is_told() -> None:
    ranking = ranked()[1]
    candidates = tuple(
        replace(one, overruled=True, explained=0.31)
        if one.name == "cure_mismatch"
        else one
        for one in ranking.candidates
    )
    text = verdict(replace(ranking, verdict="unexplained", candidates=candidates))
    assert "cure_mismatch comes nearest, but leaves smooth errors of " in text
    assert "explains 31 % of what could fall of the error on left-out devices" in text
