"""The shipped dataset and model: regenerable, and what they say they are."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from datagen.dataset import Dataset
from datagen.device import DESIGN_SPACE
from datagen.levels import mesh_level
from datagen.model import GENERATOR_VERSION, Model
from datagen.response import Path
from datagen.worker import PROPER_ENDS
from surrogate.ensemble import REFERENCE, reference_model


@pytest.fixture(scope="module")
def data() -> Dataset:
    return Dataset.read(REFERENCE / "dataset.h5")


@pytest.fixture(scope="module")
def level(data: Dataset) -> str:
    """The mesh that the dataset was solved on; earlier generators had another."""
    if data.generator_version == GENERATOR_VERSION:
        return data.level
    return f"{data.level}-{data.generator_version}"


def test_dataset_is_of_a_known_generator(data: Dataset, level: str) -> None:
    mesh_level(level)
    assert data.space == DESIGN_SPACE
    assert len(data) >= 1000
    sampled = DESIGN_SPACE.sample(data.hypercube or len(data), data.seed)
    assert np.array_equal(data.inputs, sampled[: len(data)])


def test_nearly_every_path_went_as_far_as_it_can(data: Dataset) -> None:
    proper = [status in PROPER_ENDS for status in data.path_status]
    assert np.mean(proper) >= 0.995
    for row, ended in enumerate(proper):
        assert ended or data.message[row]
        if data.path_status[row] == "completed":
            last = data.pressure[row, data.steps(row) - 1]
            assert last == pytest.approx(data.max_pressure)
        if data.path_status[row] == "limit_point":
            top = np.nanmax(data.pressure[row])
            assert top == pytest.approx(data.limit_pressure[row], rel=1e-9)


def test_no_strip_turns_round_in_one_step(data: Dataset) -> None:
    angle = data.values[..., data.outputs.index("bending_angle")]
    steps = np.abs(np.diff(np.where(data.status == 0, angle, np.nan), axis=1))
    assert np.nanmax(steps) < np.pi / 4


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_rows_are_found_again(data: Dataset, level: str, seed: int) -> None:
    """A row drawn at random, solved again to a third and two thirds of its way."""
    rng = np.random.default_rng(seed)
    small = [r for r in range(len(data)) if data.design(r).divisions_x <= 4]
    row = int(rng.choice(small))
    steps = data.steps(row)
    assert steps > 3
    chosen = [steps // 3, 2 * steps // 3]
    pressure = data.pressure[row, chosen]
    with threadpool_limits(1):
        again = Model(level=level)([data.design(row)], [Path(pressure)])
    assert again.path_status == ("completed",), again.message
    scale = np.nanmax(np.abs(data.values[row]), axis=0)
    error = np.abs(again.values[0] - data.values[row, chosen]) / scale
    assert error.max() < 1e-6


def test_derivatives_are_found_again(data: Dataset, level: str) -> None:
    """Of a differentiated row, at a third of its way."""
    small = [r for r in range(data.sensitivities) if data.design(r).divisions_x <= 2]
    row = int(np.random.default_rng(11).choice(small))
    step = data.steps(row) // 3
    with threadpool_limits(1):
        again = Model(level=level)(
            [data.design(row)], [Path(data.pressure[row, [step]])], sensitivities=True
        )
    assert again.parameters == data.parameters
    assert again.jacobian is not None and data.jacobian is not None
    scale = np.nanmax(np.abs(data.jacobian[row]), axis=0)
    error = np.abs(again.jacobian[0, 0] - data.jacobian[row, step])
    assert (error <= 1e-3 * scale).all()


def test_model_was_trained_on_this_dataset(data: Dataset) -> None:
    model = reference_model()
    assert data.digest() in str(model.description)
    size = sum(file.stat().st_size for file in REFERENCE.iterdir())
    assert size < 8e6
