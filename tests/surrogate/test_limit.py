"""Limit pressures from paths of which most never met theirs."""

from __future__ import annotations

import numpy as np
import pytest

from datagen.device import DESIGN_SPACE
from surrogate.features import columns_of, prepare
from surrogate.limit import FEWEST_LIMITS, fit_limit, tobit_loss
from surrogate.network import FitSettings
from surrogate.split import folds
from tests.surrogate.synthetic import synthetic


def test_censored_designs_pull_the_estimate_up() -> None:
    """Limits scattered about 1.3 estimates, most of them above what was reached."""
    own = prepare(
        columns_of(DESIGN_SPACE.names, DESIGN_SPACE.sample(300, 0)), DESIGN_SPACE
    )
    scale = own.limit_scale
    rng = np.random.default_rng(0)
    factor = 1.3 * np.exp(0.1 * rng.normal(size=300))
    limit = factor * scale
    reached = np.minimum(limit, 1.25 * scale)
    met = limit <= reached
    assert 0.2 < met.mean() < 0.6
    model, report = fit_limit(
        [own],
        np.where(met, limit, np.nan),
        reached,
        folds(300, 4, 1, 0),
        seed=0,
        settings=FitSettings(hidden=(8,), steps=400, batch=128, check_every=50),
    )
    assert report["limit_points"] == met.sum()
    found = model(own)
    ratio = np.median(found.pressure / scale)
    # Without the censored ones it would be the mean of those below 1.25: about 1.17.
    assert ratio == pytest.approx(1.3, rel=0.04)
    assert np.median(found.std) == pytest.approx(0.1, rel=0.5)


def test_likelihood() -> None:
    torch = pytest.importorskip("torch")
    from scipy.stats import norm

    answers = torch.tensor([[0.2, 0.5], [0.2, 0.5]], dtype=torch.float64)
    sigma = np.exp(-3.4 + 2.9 * np.tanh(0.5 / 2.9))
    target = torch.tensor([0.25, 0.25], dtype=torch.float64)
    found = tobit_loss(answers, target, torch.tensor([False, True])).numpy()
    assert found[0] == pytest.approx(
        -norm.logpdf(0.25, 0.2, sigma) - 0.5 * np.log(2 * np.pi)
    )
    assert found[1] == pytest.approx(-norm.logsf(0.25, 0.2, sigma))


def test_better_than_the_closed_form() -> None:
    """On designs that the answering members had not seen."""
    data = synthetic(600, 8)
    own = prepare(columns_of(data.variables, data.inputs), data.space)
    held_out = folds(600, 4, 2, 0)
    unseen_by = np.stack([np.flatnonzero(held) for held in held_out.T], axis=1)
    reached = np.where(data.status == 0, data.pressure, 0.0).max(axis=1)
    model, _ = fit_limit([own], data.limit_pressure, reached, held_out, seed=0)
    found = model(own, unseen_by)
    met = np.isfinite(data.limit_pressure)
    error = np.log(found.pressure / data.limit_pressure)[met]
    before = np.log(own.limit_scale / data.limit_pressure)[met]
    assert np.sqrt(np.mean(error**2)) < 0.7 * np.std(before)
    # The stated deviation is the one that is met.
    assert 0.7 < np.sqrt(np.mean((error / found.std[met]) ** 2)) < 1.4


def test_too_few_limit_points_teach_nothing() -> None:
    own = prepare(
        columns_of(DESIGN_SPACE.names, DESIGN_SPACE.sample(40, 0)), DESIGN_SPACE
    )
    limit = np.full(40, np.nan)
    limit[: FEWEST_LIMITS - 1] = 1e5
    model, _ = fit_limit([own], limit, np.full(40, 1e5), folds(40, 4, 1, 0), seed=0)
    assert model.stack is None
    assert np.isinf(model(own).std).all()
