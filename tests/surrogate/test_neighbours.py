"""Virtual designs beside differentiated ones, against the finite elements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from datagen.dataset import Dataset
from datagen.device import DESIGN_SPACE, Design, named_device
from datagen.model import GENERATOR_VERSION, Model
from datagen.response import Path
from datagen.worker import Row
from surrogate import neighbours as module
from surrogate.neighbours import NEAR_LIMIT, neighbours


@pytest.fixture(scope="module")
def data() -> Dataset:
    """S1 with derivatives, and without."""
    response = Model(level="draft").explore(named_device(), 40e3, sensitivities=True)
    row = Row.from_response(0, response)
    plain = replace(row, row=1, parameters=(), jacobian=None)
    inputs = list(named_device().sampled().values())
    return Dataset.from_rows(
        [row, plain],
        variables=DESIGN_SPACE.names,
        inputs=np.array([inputs, inputs]),
        space=DESIGN_SPACE,
        seed=0,
        level="draft",
        effects=(),
        generator_version=GENERATOR_VERSION,
        max_pressure=40e3,
        sensitivities=1,
    )


def test_neighbours_are_what_the_finite_elements_give(data: Dataset) -> None:
    found = neighbours(data, seed=3)
    assert len(found) == module.COUNT
    model = Model(level="draft")
    for one in found[:2]:
        assert one.known[0].sum() >= 5
        chosen = np.flatnonzero(one.known[0])
        values = dict(zip(data.variables, one.inputs[0], strict=True))
        path = Path(data.pressure[0, chosen])
        solved = model([Design.from_sample(values)], [path]).values[0]
        scale = np.abs(data.values[0]).max(axis=0)
        moved = np.abs(solved - data.values[0, chosen]) / scale
        left = np.abs(solved - one.values[0, chosen]) / scale
        assert moved.max() > 0.02
        assert left.max() < 0.25 * moved.max()
        assert np.median(left) < 0.1 * np.median(moved)


def test_designs_without_derivatives_have_no_neighbours(data: Dataset) -> None:
    for one in neighbours(data, seed=3):
        assert not one.known[1].any()
        assert np.array_equal(one.inputs[1], data.inputs[1])
    assert neighbours(replace(data, parameters=(), jacobian=None), seed=3) == []


def test_neighbours_differ_in_what_is_continuous_and_repeat(data: Dataset) -> None:
    one, two, *_ = neighbours(data, seed=3)
    whole = [p.scale == "integer" for p in data.space]
    assert ((one.inputs[0] == data.inputs[0]) == whole).all()
    assert ((one.inputs[0] == two.inputs[0]) == whole).all()
    again = neighbours(data, seed=3)
    assert np.array_equal(again[0].inputs, one.inputs)
    assert not np.array_equal(neighbours(data, seed=4)[0].inputs, one.inputs)


def test_slopes_are_not_used_near_the_limit_pressure(data: Dataset) -> None:
    limit = np.full(2, data.pressure[0, 4] / NEAR_LIMIT * (1 - 1e-9))
    one = neighbours(replace(data, limit_pressure=limit), seed=3)[0]
    assert one.known[0, :4].any()
    assert not one.known[0, 4:].any()
