"""The inference on cases whose answer is known."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest

from datagen.space import Parameter
from discrepancy.evidence import Fit, fit
from discrepancy.noise import Covariance, Frame, Readings
from discrepancy.prior import Prior
from discrepancy.weighing import probabilities, weigh
from tests.discrepancy.formula import Formula

Array = np.ndarray


def prior(
    name: str,
    lower: float,
    upper: float,
    family: str = "uniform",
    off: float | None = None,
) -> Prior:
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


def test_evidence_of_a_line_is_exact() -> None:
    """Gaussian prior, linear model: the evidence is a multivariate normal density."""
    rng = np.random.default_rng(1)
    x = np.linspace(0, 1, 30)
    slope = Prior(
        Parameter("slope", "1", -400.0, 400.0, prior="normal", off=0.0, source="t")
    )
    readings = independent(3.0 * x + rng.normal(0, 0.5, 30), 0.5)
    found = fit(readings, Formula("line", (slope,), lambda a: a * x))
    cov = 0.25 * np.eye(30) + 200.0**2 * np.outer(x, x)
    y = readings.value
    exact = -0.5 * (
        y @ np.linalg.solve(cov, y)
        + np.linalg.slogdet(cov)[1]
        + 30 * math.log(2 * math.pi)
    )
    assert found.log_evidence == pytest.approx(exact, abs=0.06)
    low, high = found.interval()[0]
    assert low < 3.0 < high


def test_evidence_at_the_edge_of_a_range() -> None:
    """Best value outside the range: quadrature is the judge, Laplace would be off."""
    x = np.linspace(0, 1, 30)
    readings = independent(-0.2 * x, 0.5)
    edge = prior("slope", 0.0, 10.0)
    found = fit(readings, Formula("line", (edge,), lambda a: a * x))
    a = np.linspace(0, 10, 200001)
    sums = -0.5 * ((readings.value[:, None] - a * x[:, None]) ** 2).sum(axis=0) / 0.25
    density = np.exp(sums) * (2 * math.pi * 0.25) ** -15
    exact = math.log(np.trapezoid(density, a) / 10)
    assert found.t[0] == 0.0
    assert found.log_evidence == pytest.approx(exact, abs=0.06)


def test_nested_sampling_agrees() -> None:
    """Two far optima: importance sampling around one of them does not suffice."""
    x = np.linspace(0, 1, 10)
    readings = independent(4.0 * x, 0.3)
    wide = prior("root", -5.0, 5.0)
    square = Formula("square", (wide,), lambda a: a**2 * x)
    found = fit(readings, square, nested=True)
    a = np.linspace(-5, 5, 200001)
    sums = (
        -0.5 * ((readings.value[:, None] - a**2 * x[:, None]) ** 2).sum(axis=0) / 0.09
    )
    top = sums.max()
    exact = top + math.log(np.trapezoid(np.exp(sums - top), a) / 10)
    exact += -5 * math.log(2 * math.pi * 0.09)
    assert found.log_evidence == pytest.approx(exact, abs=0.2)


def test_calibrations_are_integrated_out() -> None:
    """The covariance by Woodbury's identity is that of the dense matrix."""
    rng = np.random.default_rng(5)
    n = 24
    readings = Readings(
        value=rng.normal(size=n),
        group=np.repeat([0, 1], 12),
        curve=np.repeat([0, 1, 2, 3], 6),
        place=np.tile(np.linspace(0.1, 1, 6), 4),
        noise=rng.uniform(0.5, 2.0, n),
        stated=np.zeros(n, dtype=bool),
        device=np.tile(np.repeat([0, 1], 6), 2),
        scale=np.repeat([3.0, 4.0, 5.0, 6.0], 6),
    )
    frame = Frame(readings)
    hyper = frame.hyper(common=True)
    eta = rng.normal(size=len(hyper.names))
    columns = rng.normal(size=(n, 3))
    shapes = tuple(
        rng.normal(size=(n, 2)) * (readings.group == g)[:, None] for g in (0, 1)
    )
    cov = Covariance(
        frame,
        hyper,
        eta,
        frame.turn @ columns,
        tuple(frame.turn @ s for s in shapes),
    )
    size = dict(zip(hyper.names, np.exp(eta), strict=True))
    from discrepancy.noise import smooth_kernel

    dense = columns @ columns.T
    for g in (0, 1):
        at = readings.group == g
        dense += np.diag(at * (size[f"noise {g}"] * readings.noise) ** 2)
        dense += size[f"common {g}"] ** 2 * shapes[g] @ shapes[g].T
    for c in range(4):
        at = np.flatnonzero(readings.curve == c)
        g = readings.group[at[0]]
        block = smooth_kernel(readings.place[at]) * readings.scale[at[0]] ** 2
        dense[np.ix_(at, at)] += size[f"smooth {g}"] ** 2 * block
    y = readings.value
    r = frame.turn @ y
    exact = -0.5 * (
        y @ np.linalg.solve(dense, y)
        + np.linalg.slogdet(dense)[1]
        + n * math.log(2 * math.pi)
    )
    assert cov.log_density(r) + frame.log_volume == pytest.approx(exact, abs=1e-8)
    slope = cov.slope(r)
    for i in range(len(eta)):
        step = np.zeros(len(eta))
        step[i] = 1e-6

        def density(e: Array) -> float:
            return Covariance(
                frame,
                hyper,
                e,
                frame.turn @ columns,
                tuple(frame.turn @ s for s in shapes),
            ).log_density(r)

        number = (density(eta + step) - density(eta - step)) / 2e-6
        assert slope[i] == pytest.approx(number, abs=1e-5)


def choose(readings: Readings, hypotheses: list[Formula]) -> tuple[list[float], Fit]:
    """Probabilities of hypotheses that are equally likely, and the best fit."""
    fits = weigh(readings, hypotheses)
    logs = np.array([one.log_evidence for one in fits])
    shares = probabilities(logs, np.zeros(len(logs)))
    return list(shares), fits[int(np.argmax(logs))]


@pytest.mark.parametrize("seed", range(5))
def test_ball_drop(seed: int) -> None:
    """Dropped from 60 m with a drag of 0.4 v^2; without it g would come out near 7."""
    t = np.linspace(0.05, 1, 20)
    g, drag = 9.8, 0.4
    end = math.sqrt(g / drag)
    fall = np.log(np.cosh(drag * end * t)) / drag
    rng = np.random.default_rng(seed)
    readings = independent(60 - fall + rng.normal(0, 0.02, 20), 0.02)
    gravity = prior("g", 5.0, 15.0)
    coefficient = prior("drag", 0.0, 2.0, off=0.0)

    def without(g: float) -> Array:
        return 60 - g * t**2 / 2

    def resisted(g: float, c: float) -> Array:
        c = max(float(c), 1e-9)
        return 60 - np.log(np.cosh(math.sqrt(g * c) * t)) / c

    naive = fit(readings, Formula("free", (gravity,), without))
    assert naive.mean()[0] == pytest.approx(7.0, abs=0.3)
    shares, best = choose(
        readings,
        [
            Formula("free", (gravity,), without),
            Formula("drag", (gravity, coefficient), resisted),
        ],
    )
    assert shares[1] > 0.99
    low, high = best.interval(0.99)[0]
    assert low < g < high


def test_simple_machine() -> None:
    """0.65 x / (1 + x / 20) against theta x: a loss is found, and the efficiency."""
    x = np.linspace(0.2, 4, 11)
    theta = prior("theta", 0.0, 2.0)
    loss = prior("loss", 0.0, 0.5, off=0.0)
    covered = 0
    for seed in range(20):
        error = np.random.default_rng(seed).normal(0, 0.01, 11)
        readings = independent(0.65 * x / (1 + x / 20) + error, 0.01)
        shares, best = choose(
            readings,
            [
                Formula("ideal", (theta,), lambda a: a * x),
                Formula("loss", (theta, loss), lambda a, b: a * x / (1 + b * x)),
            ],
        )
        assert shares[1] > 0.99
        low, high = best.interval()[0]
        covered += bool(low < 0.65 < high)
    assert 15 <= covered <= 20


POLYNOMIAL_POWERS = (0, 1, 2, 3, 4)


def polynomial(powers: tuple[int, ...], x: Array) -> Formula:
    """A hypothesis of those powers, each with the same wide prior."""

    def value(*c: float) -> Array:
        total: Array = sum(
            (a * x**p for a, p in zip(c, powers, strict=True)), np.zeros_like(x)
        )
        return total

    wide = tuple(prior(f"c{p}", -100.0, 100.0, "normal", off=0.0) for p in powers)
    return Formula(str(powers), wide, value)


def support(seed: int, choices: Callable[[Array], list[Formula]]) -> str:
    """Name of the most probable polynomial for one noisy set."""
    x = np.linspace(0, 10, 101)
    rng = np.random.default_rng(seed)
    y = 20 * x + 10 * x**2 + 5 * x**3 + rng.normal(0, 1, 101)
    hypotheses = choices(x)
    shares, _ = choose(independent(y, 1.0), hypotheses)
    return hypotheses[int(np.argmax(shares))].name


def all_subsets(x: Array) -> list[Formula]:
    """Every set of powers, the empty one left out."""
    return [
        polynomial(chosen, x)
        for count in range(1, len(POLYNOMIAL_POWERS) + 1)
        for chosen in itertools.combinations(POLYNOMIAL_POWERS, count)
    ]


def test_support_of_a_polynomial() -> None:
    """The exact powers are found; ``make recovery`` does 200 seeds."""
    found = [support(seed, all_subsets) for seed in range(2)]
    assert found == ["(1, 2, 3)", "(1, 2, 3)"]
