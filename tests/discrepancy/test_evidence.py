"""The inference on cases whose answer is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import lsq_linear, minimize

from datagen.space import Parameter
from discrepancy.calibration import FIELDS, Calibrations
from discrepancy.emulator import Emulator
from discrepancy.evidence import fit
from discrepancy.hypotheses import Present
from discrepancy.noise import LENGTH, Covariance, Frame, Readings, smooth_kernel
from discrepancy.prior import Prior
from discrepancy.target import Target
from tests.discrepancy.formula import Formula
from tests.discrepancy.known import (
    TRUE_POWERS,
    ball,
    independent,
    machine,
    prior,
    support,
)

Array = np.ndarray


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
        stated=np.repeat([False, True, False, True], 6),
        device=np.tile(np.repeat([0, 1], 6), 2),
        scale=np.repeat([3.0, 4.0, 5.0, 6.0], 6),
        path=np.tile(np.linspace(0.1, 2, 6), 4),
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

    def dense_at(eta: Array) -> Array:
        size = dict(zip(hyper.names, np.exp(eta), strict=True))
        dense: Array = columns @ columns.T
        for g in (0, 1):
            at = readings.group == g
            factor = np.where(readings.stated, 1.0, size[f"noise {g}"])
            dense += np.diag(at * (factor * readings.noise) ** 2)
            dense += size[f"common {g}"] ** 2 * shapes[g] @ shapes[g].T
        for c in range(4):
            at = np.flatnonzero(readings.curve == c)
            g = readings.group[at[0]]
            reach = LENGTH * readings.place[at].max()
            kernel = smooth_kernel(readings.place[at], readings.path[at], reach)
            block = kernel * readings.scale[at[0]] ** 2
            dense[np.ix_(at, at)] += size[f"smooth {g}"] ** 2 * block
        return dense

    dense = dense_at(eta)
    y = readings.value
    r = frame.turn @ y
    exact = -0.5 * (
        y @ np.linalg.solve(dense, y)
        + np.linalg.slogdet(dense)[1]
        + n * math.log(2 * math.pi)
    )
    assert cov.log_density(r) + frame.log_volume == pytest.approx(exact, abs=1e-8)
    about = cov.information(r)
    alpha = np.linalg.solve(dense, y)
    for i in range(len(eta)):
        step = np.zeros(len(eta))
        step[i] = 1e-6

        def at(e: Array) -> Covariance:
            return Covariance(
                frame,
                hyper,
                e,
                frame.turn @ columns,
                tuple(frame.turn @ s for s in shapes),
            )

        ahead, behind = at(eta + step), at(eta - step)
        number = (ahead.log_density(r) - behind.log_density(r)) / 2e-6
        assert about.slope[i] == pytest.approx(number, abs=1e-5)
        bend = (behind.information(r).slope - ahead.information(r).slope) / 2e-6
        assert about.observed[i] == pytest.approx(bend, abs=1e-5)
        assert ahead.solve(about.pulled[i]) == pytest.approx(
            (behind.solve(r) - ahead.solve(r)) / 2e-6, abs=1e-5
        )
    # The mean of observed and expected needs neither traces nor second derivatives.
    parts = []
    for i in range(len(eta)):
        ahead = eta + 1e-6 * (np.arange(len(eta)) == i)
        parts.append((dense_at(ahead) - dense_at(2 * eta - ahead)) / 2e-6 @ alpha)
    expected = 0.5 * np.array(parts) @ np.linalg.solve(dense, np.array(parts).T)
    assert about.average == pytest.approx(expected, abs=1e-5)
    assert np.linalg.eigvalsh(about.average)[0] > -1e-9
    assert alpha == pytest.approx(frame.turn.T @ cov.solve(r), abs=1e-8)


@pytest.mark.parametrize("seed", range(12))
def test_the_best_fit_is_the_lowest_misfit_within_its_bounds(seed: int) -> None:
    """Against a general minimiser from many starts.

    Best sizes lie inside or at an end, and what is left passes for either error.
    """
    rng = np.random.default_rng(seed)
    place = np.tile(np.linspace(0.1, 1, 8), 4)
    shape = place * (1 + 0.3 * rng.normal(size=(3, 32)))
    a, b = rng.uniform(-0.5, 1.5, 2)  # often beyond 0 to 1
    value = a * shape[0] + a * b * shape[1] ** 2 + 0.02 * rng.normal(size=32)
    readings = Readings(
        value=value,
        group=np.repeat([0, 1], 16),
        curve=np.repeat([0, 1, 2, 3], 8),
        place=place,
        noise=np.full(32, 0.03),
        stated=np.repeat([True, False], 16),
        device=np.tile(np.repeat([0, 1], 8), 2),
        scale=np.repeat([np.abs(c).max() for c in value.reshape(4, 8)], 8),
    )
    effect = Formula(
        "effect",
        (prior("size", 0.0, 1.0), prior("way", 0.0, 1.0)),
        lambda a, b: a * shape[0] + a * b * shape[1] ** 2,
        0.05 * shape[2][:, None],
        scale=0.1,
    )
    target = Target(Frame(readings), np.ones(32, dtype=bool), effect)
    found = fit(readings, effect, starts=[np.array([0.1, 0.5])], evidence=False)

    def cost(x: Array) -> float:
        seen = target.look(x[:2])
        density = target.covariance(x[2:], seen.columns).log_density(seen.residual)
        return float(-2 * density - 2 * target.hyper.log_prior(x[2:]))

    centre = target.hyper.centre
    bounds = [(0.0, 1.0)] * 2 + [(c - 5, c + 5) for c in centre]
    judged = [
        minimize(
            cost,
            np.concatenate([rng.uniform(0, 1, 2), centre + rng.uniform(-1, 3, 3)]),
            bounds=bounds,
            method="L-BFGS-B",
        ).fun
        for _ in range(6)
    ]
    best = np.concatenate([found.t, found.eta])
    assert found.misfit == pytest.approx(cost(best), abs=1e-9)
    assert found.misfit <= min(judged) + 5e-3
    assert ((found.t >= 0) & (found.t <= 1)).all()


def test_calibrations_bend_as_their_columns_differ() -> None:
    """Derivatives of a device hypothesis' columns, against differences."""
    rng = np.random.default_rng(3)
    n, r = 10, 4
    nodes = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, -1.0]])
    span = np.array([2.0, 2.0])
    flat = np.full((3, n * len(FIELDS), 2), np.nan)
    effect = Present(
        name="made up",
        effects=("made up",),
        priors=(prior("a", -1.0, 1.0), prior("b", -1.0, 1.0)),
        curves=Emulator(
            nodes, rng.normal(size=(3, n)), rng.normal(size=(3, n, 2)), span
        ),
        fields=Emulator(nodes, rng.normal(size=(3, n * len(FIELDS))), flat, span),
        shift=rng.normal(size=n),
        calibrations=Calibrations(
            tuple(("scale", i) for i in range(r)),
            rng.normal(size=(n, len(FIELDS) + 1, r)),
        ),
        reach=np.tile([-np.inf, np.inf], (2, 1)),
    )
    t = np.array([0.3, -0.4])
    for i, along in enumerate(1e-5 * np.eye(2)):
        ahead, behind = effect.predict(t + along), effect.predict(t - along)
        bend = (ahead.columns - behind.columns) / 2e-5
        assert effect.bends(t)[i] == pytest.approx(bend, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("seed", range(20))
def test_a_best_fit_follows_two_bounds_at_once(seed: int) -> None:
    """Two sizes whose effects look alike, in a box: least squares is the judge."""
    rng = np.random.default_rng(seed)
    first = rng.normal(size=30)
    shapes = np.stack([first, 0.98 * first + 0.2 * rng.normal(size=30)], axis=1)
    value = shapes @ rng.uniform(-1.5, 2.5, 2) + 0.01 * rng.normal(size=30)
    line = Formula(
        "two",
        (prior("a", 0.0, 1.0), prior("b", 0.0, 1.0)),
        lambda a, b: shapes @ np.array([a, b]),
    )
    found = fit(independent(value, 0.01), line, evidence=False)
    judge = lsq_linear(shapes, value, (0, 1))
    assert found.t == pytest.approx(judge.x, abs=1e-4)


@pytest.mark.parametrize("seed", range(5))
def test_ball_drop(seed: int) -> None:
    found = ball(seed)
    assert found.naive == pytest.approx(7.0, abs=0.3)
    assert found.probability > 0.99


def test_simple_machine() -> None:
    found = [machine(seed) for seed in range(20)]
    assert min(one.probability for one in found) > 0.99
    assert 15 <= sum(one.covered for one in found) <= 20


def test_support_of_a_polynomial() -> None:
    """The exact powers are found; 200 sets are in docs/rank.md."""
    assert [support(seed) for seed in range(2)] == [TRUE_POWERS] * 2
