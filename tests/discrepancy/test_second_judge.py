"""A name is not given to what leaves more than it explains on devices left out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from datagen.space import Parameter
from discrepancy.evidence import Fit, fit
from discrepancy.heldout import explained, held_out, noise_floor
from discrepancy.hypotheses import Null
from discrepancy.judging import Candidate, second_judge
from discrepancy.noise import LARGE_SMOOTH, Readings
from discrepancy.prior import Prior
from discrepancy.target import Prediction
from tests.discrepancy.formula import Formula

DEVICES, STEPS = 6, 7
DEVICE = np.repeat(np.arange(DEVICES), STEPS)
PLACE = np.tile(np.linspace(1 / STEPS, 1, STEPS), DEVICES)
THIN = np.repeat(np.array([1.0, 0.4, 1.3, 0.2, 0.8, 1.6]), STEPS)
NOISE = 0.003
SIZE = Prior(Parameter("size", "1", -1.0, 1.0, prior="normal", off=0.0, source="t"))


@dataclass(frozen=True)
class Named(Formula):
    """A formula that stands for effects."""

    effects: tuple[str, ...] = ("effect",)


def readings(effect: float, smooth: float = 0.003) -> Readings:
    """Curves of height 1; the effect acts on thin devices, and turns with pressure."""
    rng = np.random.default_rng(3)
    bent = smooth * rng.standard_normal(DEVICES)[DEVICE] * (2 * PLACE - 1)
    noise = NOISE * rng.standard_normal(len(PLACE))
    zero = np.zeros(len(PLACE), dtype=int)
    return Readings(
        value=np.sqrt(PLACE) + effect * THIN * np.sin(4 * PLACE) + bent + noise,
        group=zero,
        curve=DEVICE,
        place=PLACE,
        noise=np.full(len(PLACE), NOISE),
        stated=np.ones(len(PLACE), dtype=bool),
        device=DEVICE,
        scale=np.ones(len(PLACE)),
    )


def fits(measured: Readings) -> dict[str, Fit]:
    base = np.sqrt(PLACE)
    empty = np.zeros((len(base), 0))
    hypotheses = (
        Null("nothing", Prediction(base, empty, empty)),
        Null("unknown", Prediction(base, empty, empty)),
        Named("right", (SIZE,), lambda a: base + a * THIN * np.sin(4 * PLACE)),
        # Right in kind for some devices, and not for those that were left out.
        Named("wrong", (SIZE,), lambda a: base + a * (THIN > 1.5) * PLACE),
    )
    return {one.name: fit(measured, one) for one in hypotheses}


def judged(measured: Readings) -> dict[str, Candidate]:
    shares = {"nothing": 0.02, "unknown": 0.01, "right": 0.0, "wrong": 0.97}
    found = fits(measured)
    candidates = second_judge([Candidate(found[n], p) for n, p in shares.items()])
    assert sum(one.probability for one in candidates) == pytest.approx(1.0)
    return {one.name: one for one in candidates}


def test_the_share_is_one_for_what_is_right() -> None:
    found = fits(readings(0.3))
    right, wrong, nothing = (found[n] for n in ("right", "wrong", "nothing"))
    assert held_out(right) < 1.2 * noise_floor(right)
    assert explained(right, nothing) == pytest.approx(1.0, abs=0.1)
    assert explained(wrong, nothing) < 0.5
    assert explained(nothing, nothing) == 0.0


def test_errors_of_hypotheses_are_over_one_noise() -> None:
    """Where none is stated, each infers its own, and what fits badly a large one."""
    nowhere = np.zeros(len(DEVICE), dtype=bool)
    found = fits(replace(readings(0.3), stated=nowhere, correlated=False))
    right, nothing = found["right"], found["nothing"]
    assert nothing.noise[0] > 2 * right.noise[0]
    assert explained(right, nothing) == pytest.approx(1.0, abs=0.1)
    assert held_out(nothing, right.noise) > 2 * held_out(right)


def test_what_explains_little_loses_its_probability_to_what_has_no_name() -> None:
    found = judged(readings(0.3))
    assert found["wrong"].fit.amplitude("smooth")[0] > LARGE_SMOOTH
    assert found["wrong"].overruled and found["wrong"].probability == 0.0
    assert found["unknown"].probability == pytest.approx(0.98)
    assert not found["nothing"].overruled


def test_what_leaves_usual_errors_is_not_asked() -> None:
    """Small effects move devices that are left out by less than their tolerances."""
    found = judged(readings(0.01))
    assert found["wrong"].fit.amplitude("smooth")[0] < LARGE_SMOOTH
    assert np.isnan(found["wrong"].explained)
    assert found["wrong"].probability == 0.97


def test_one_device_is_not_judged() -> None:
    measured = readings(0.3)
    alone = replace(measured, device=np.zeros_like(DEVICE))
    found = judged(alone)
    assert np.isnan(found["wrong"].explained) and not found["wrong"].overruled
