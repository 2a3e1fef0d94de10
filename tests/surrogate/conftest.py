"""One small dataset and one small ensemble for all tests of the surrogate."""

from __future__ import annotations

import pytest

from datagen.dataset import Dataset
from surrogate.ensemble import Ensemble
from surrogate.network import FitSettings
from surrogate.train import TrainSettings, train
from tests.surrogate.synthetic import synthetic

QUICK = TrainSettings(
    folds=4,
    repeats=3,
    response=FitSettings(hidden=(32, 32), steps=500, batch=512),
    limit=FitSettings(hidden=(8,), steps=200, batch=128, check_every=20),
)


@pytest.fixture(scope="session")
def dataset() -> Dataset:
    return synthetic(240, seed=3)


@pytest.fixture(scope="session")
def ensemble(dataset: Dataset) -> Ensemble:
    return train(dataset, seed=1, settings=QUICK)
