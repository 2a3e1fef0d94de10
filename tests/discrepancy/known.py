"""Selection among models whose truth is known: cases from the literature.

A ball dropped through air, the simple machine of Brynjarsdottir and O'Hagan (2014,
Inverse Problems 30, 114007), and the support of a polynomial, through the inference
that `pba rank` uses.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from datagen.space import Parameter
from discrepancy.evidence import Fit
from discrepancy.noise import Readings
from discrepancy.prior import Prior
from discrepancy.weighing import probabilities, weigh
from tests.discrepancy.formula import Formula

Array = np.ndarray

GRAVITY, DRAG, HEIGHT = 9.8, 0.4, 60.0
EFFICIENCY = 0.65
POWERS = (0, 1, 2, 3, 4)
TRUE_POWERS = "(1, 2, 3)"


class Selected(NamedTuple):
    """What one set of readings gave.

    probability : float, of the true model.
    covered : bool; whether its 90 % interval holds the parameter that matters.
    naive : float; that parameter from the model that lacks something.
    """

    probability: float
    covered: bool
    naive: float


def prior(
    name: str,
    lower: float,
    upper: float,
    family: str = "uniform",
    off: float | None = None,
) -> Prior:
    """Of a number without a unit."""
    return Prior(Parameter(name, "1", lower, upper, prior=family, off=off, source="t"))


def independent(value: Array, noise: float) -> Readings:
    """Readings of one body with independent errors."""
    n = len(value)
    zero = np.zeros(n, dtype=int)
    return Readings(
        value=value,
        group=zero,
        curve=zero,
        place=np.linspace(0, 1, n),
        noise=np.full(n, noise),
        stated=np.ones(n, dtype=bool),
        device=zero,
        scale=np.ones(n),
        correlated=False,
    )


def choose(
    readings: Readings, hypotheses: list[Formula]
) -> tuple[list[float], list[Fit]]:
    """Probabilities of hypotheses that are equally likely, and their fits."""
    fits = weigh(readings, hypotheses)
    logs = np.array([one.log_evidence for one in fits])
    return list(probabilities(logs, np.zeros(len(logs)))), fits


def _selected(shares: list[float], fits: list[Fit], truth: float) -> Selected:
    low, high = fits[1].interval()[0]
    return Selected(shares[1], bool(low < truth < high), float(fits[0].mean()[0]))


def ball(seed: int) -> Selected:
    """Dropped from 60 m with a drag of 0.4 v^2; without it g would come out near 7."""
    t = np.linspace(0.05, 1, 20)
    end = math.sqrt(GRAVITY / DRAG)
    fall = np.log(np.cosh(DRAG * end * t)) / DRAG
    rng = np.random.default_rng(seed)
    readings = independent(HEIGHT - fall + rng.normal(0, 0.02, 20), 0.02)
    gravity = prior("g", 5.0, 15.0)
    coefficient = prior("drag", 0.0, 2.0, off=0.0)

    def free(g: float) -> Array:
        return HEIGHT - g * t**2 / 2

    def resisted(g: float, c: float) -> Array:
        c = max(float(c), 1e-9)
        return HEIGHT - np.log(np.cosh(math.sqrt(g * c) * t)) / c

    hypotheses = [
        Formula("free", (gravity,), free),
        Formula("drag", (gravity, coefficient), resisted),
    ]
    return _selected(*choose(readings, hypotheses), GRAVITY)


def machine(seed: int) -> Selected:
    """0.65 x / (1 + x / 20) against theta x: a loss is found, and the efficiency."""
    x = np.linspace(0.2, 4, 11)
    theta = prior("theta", 0.0, 2.0)
    loss = prior("loss", 0.0, 0.5, off=0.0)
    error = np.random.default_rng(seed).normal(0, 0.01, 11)
    readings = independent(EFFICIENCY * x / (1 + x / 20) + error, 0.01)
    hypotheses = [
        Formula("ideal", (theta,), lambda a: a * x),
        Formula("loss", (theta, loss), lambda a, b: a * x / (1 + b * x)),
    ]
    return _selected(*choose(readings, hypotheses), EFFICIENCY)


def _polynomial(powers: tuple[int, ...], x: Array) -> Formula:
    """A hypothesis of those powers, each with the same wide prior."""

    def value(*c: float) -> Array:
        total: Array = sum(
            (a * x**p for a, p in zip(c, powers, strict=True)), np.zeros_like(x)
        )
        return total

    wide = tuple(prior(f"c{p}", -100.0, 100.0, "normal", off=0.0) for p in powers)
    return Formula(str(powers), wide, value)


def support(seed: int) -> str:
    """The most probable powers of 20 t + 10 t^2 + 5 t^3 with noise of 1.

    101 points on 0..10; every set of powers is a hypothesis, the empty one left out.
    """
    x = np.linspace(0, 10, 101)
    rng = np.random.default_rng(seed)
    y = 20 * x + 10 * x**2 + 5 * x**3 + rng.normal(0, 1, 101)
    hypotheses = [
        _polynomial(chosen, x)
        for count in range(1, len(POWERS) + 1)
        for chosen in itertools.combinations(POWERS, count)
    ]
    shares, _ = choose(independent(y, 1.0), hypotheses)
    return hypotheses[int(np.argmax(shares))].name
