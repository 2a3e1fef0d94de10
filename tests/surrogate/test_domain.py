"""The range check: what is out of range, at which load steps, and why."""

from __future__ import annotations

import numpy as np
import pytest

from datagen.dataset import Dataset
from datagen.device import DESIGN_SPACE, MM, UM, named_device
from surrogate.domain import Domain
from surrogate.ensemble import Ensemble
from surrogate.features import columns_of
from surrogate.limit import Limit

NO_LIMIT = Limit(np.array([1e6]), np.array([0.05]))


@pytest.fixture(scope="module")
def domain(dataset: Dataset) -> Domain:
    columns = columns_of(dataset.variables, dataset.inputs)
    return Domain.of(dataset.space, 150e3, columns, np.ones(5))


def one(dataset: Dataset, **values: float) -> dict[str, np.ndarray]:
    """A device in the middle of the box, with some variables changed."""
    row = {p.name: (p.lower + p.upper) / 2 for p in dataset.space}
    row |= {"divisions_x": 3, "divisions_y": 1} | values
    return {name: np.array([float(value)]) for name, value in row.items()}


def test_inside(domain: Domain, dataset: Dataset) -> None:
    found = domain.check(one(dataset), np.array([0.0, 75e3, 150e3]), NO_LIMIT)
    assert found.in_range
    assert found.reasons == ()
    assert found.per_step.all()


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        (
            {"upper_thickness": 30 * UM},
            "upper_thickness_um: 30 is below the trained range 40 to 200",
        ),
        (
            {"divisions_x": 7},
            "divisions_x: 7 is above the trained range 1 to 6",
        ),
        (
            {"tip_margin": 4 * MM},
            "tip_margin_mm: 4 (length_mm less the balloons' end) is above the trained "
            "range 0.25 to 2.5",
        ),
    ],
)
def test_outside_the_box(
    domain: Domain, dataset: Dataset, values: dict[str, float], reason: str
) -> None:
    found = domain.check(one(dataset, **values), np.array([1e4, 2e4]), NO_LIMIT)
    assert not found.in_range
    assert reason in found.reasons
    assert not found.per_step.any()


def test_pressure(domain: Domain, dataset: Dataset) -> None:
    steps = np.array([-5e3, 0.0, 150e3, 180e3])
    found = domain.check(one(dataset), steps, NO_LIMIT)
    np.testing.assert_array_equal(found.per_step, [False, True, True, False])
    assert found.reasons == (
        "pressure_kPa: -5 is below the trained range 0 to 150",
        "pressure_kPa: 180 is past the trained 150 kPa",
    )


def test_limit_pressure(domain: Domain, dataset: Dataset) -> None:
    limit = Limit(np.array([35e3]), np.array([0.03]))
    steps = np.array([30e3, 34.5e3, 42e3])
    found = domain.check(one(dataset), steps, limit)
    np.testing.assert_array_equal(found.per_step, [True, False, False])
    assert found.reasons == (
        "pressure_kPa: 42 is past the predicted limit pressure 35 (+-1.7) kPa of this "
        "design",
    )
    near = domain.check(one(dataset), steps[:2], limit)
    assert "34.5 is within the uncertainty of the predicted limit" in near.reasons[0]
    unknown = Limit(np.array([35e3]), np.array([np.inf]))
    assert domain.check(one(dataset), steps, unknown).in_range


def test_distance_has_the_promised_share_of_false_alarms(domain: Domain) -> None:
    columns = columns_of(DESIGN_SPACE.names, DESIGN_SPACE.sample(500, 99))
    far = [
        domain.distance({k: v[i : i + 1] for k, v in columns.items()})
        > domain.allowed_distance
        for i in range(500)
    ]
    assert 0 < np.mean(far) < 0.05


def test_far_inside_the_box(dataset: Dataset) -> None:
    """A corner of the box that training left out is far, although inside the box."""
    thick = DESIGN_SPACE.names.index("upper_thickness")
    kept = dataset.inputs[:, thick] > 150 * UM
    columns = columns_of(dataset.variables, dataset.inputs[kept])
    domain = Domain.of(dataset.space, 150e3, columns, np.ones(5))
    probe = one(dataset, upper_thickness=45 * UM)
    found = domain.check(probe, np.array([1e4]), NO_LIMIT)
    assert not found.in_range
    assert found.reasons[0].startswith("far from the training designs: distance ")


def test_published_device(ensemble: Ensemble) -> None:
    found = ensemble.check(named_device("S1", 1), np.array([20e3, 60e3]))
    assert found.in_range, found.reasons
    twice = named_device("S1", 1).with_values(upper_thickness=400 * UM)
    found = ensemble.check(twice, np.array([20e3]))
    assert "upper_thickness_um: 400 is above the trained range 40 to 200" in (
        found.reasons
    )


def test_disagreement_is_a_note_and_no_reason(ensemble: Ensemble) -> None:
    from dataclasses import replace

    design, pressure = named_device("S1", 1), np.array([20e3, 60e3])
    strict = replace(
        ensemble, domain=replace(ensemble.domain, disagreement=np.zeros(5))
    )
    found = strict.check(design, pressure)
    assert found.in_range
    assert len(found.notes) == 5
    assert "the ensemble disagrees on inflation at " in " ".join(found.notes)
