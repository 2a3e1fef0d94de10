"""Limit pressures from paths of which most never met theirs."""

from __future__ import annotations

import numpy as np
import pytest

from datagen.dataset import Dataset
from datagen.device import DESIGN_SPACE
from surrogate.ensemble import Ensemble
from surrogate.features import columns_of, prepare
from surrogate.limit import FEWEST_LIMITS, fit_limit, tobit_loss
from surrogate.network import FitSettings
from surrogate.split import folds


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
        own,
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


def test_learned_on_the_dataset(ensemble: Ensemble, dataset: Dataset) -> None:
    met = np.flatnonzero(np.isfinite(dataset.limit_pressure))
    found = ensemble.limit_pressure([dataset.design(i) for i in met])
    error = np.abs(np.log(found.pressure / dataset.limit_pressure[met]))
    columns = columns_of(dataset.variables, dataset.inputs[met])
    scale = prepare(columns, dataset.space).limit_scale
    before = np.abs(np.log(scale / dataset.limit_pressure[met]))
    assert np.median(error) < 0.15
    assert np.median(error) < 0.7 * np.median(before)


def test_too_few_limit_points_teach_nothing() -> None:
    own = prepare(
        columns_of(DESIGN_SPACE.names, DESIGN_SPACE.sample(40, 0)), DESIGN_SPACE
    )
    limit = np.full(40, np.nan)
    limit[: FEWEST_LIMITS - 1] = 1e5
    model, _ = fit_limit(own, limit, np.full(40, 1e5), folds(40, 4, 1, 0), seed=0)
    assert model.stack is None
    assert np.isinf(model(own).std).all()
