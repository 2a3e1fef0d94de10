"""Fixtures of the tests of datasets and their generation."""

from __future__ import annotations

import pytest

from datagen.dataset import Dataset

from .making import make


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Twelve rows, generated without interruption."""
    return make(tmp_path_factory.mktemp("whole") / "data.h5")
