"""Increments: which designs and parameters, on which mesh, paired with what."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from datagen.dataset import Dataset
from datagen.device import DESIGN_SPACE, named_device
from datagen.errors import EffectError, InputError
from datagen.model import GENERATOR_VERSION, Model
from datagen.space import Parameter
from datagen.worker import STEP_STATUS, Task, solve_row
from surrogate.ensemble import REFERENCE
from surrogate.increment import (
    TEST_PATHS,
    PairTask,
    fem_fits,
    mesh_of,
    plan,
    ranged_space,
    solve_pair,
    stated_range,
)
from surrogate.pairs import pair
from surrogate.split import held_out
from tests.surrogate.pairs import SPACES, increment

GROWTH = "bond_edge.growth"


def test_plan(dataset: Dataset) -> None:
    planned = plan(dataset, SPACES["both"], 40, seed=3)
    rows = planned.base_row
    assert len(set(rows.tolist())) == 40
    width = len(DESIGN_SPACE)
    np.testing.assert_array_equal(planned.inputs[:, :width], dataset.inputs[rows])
    assert held_out(dataset)[rows].sum() == round(40 * TEST_PATHS)
    # A Latin hypercube: each of 40 strata of each parameter once.
    for i, p in enumerate(SPACES["both"]):
        if "." in p.name:
            values = planned.inputs[:, i]
            if p.scale == "log":
                unit = np.log(values / p.lower) / np.log(p.upper / p.lower)
            else:
                unit = (values - p.lower) / (p.upper - p.lower)
            assert sorted(np.floor(unit * 40).astype(int)) == list(range(40)), i
    again = plan(dataset, SPACES["both"], 40, seed=3)
    np.testing.assert_array_equal(planned.inputs, again.inputs)
    assert (plan(dataset, SPACES["both"], 40, seed=4).inputs != planned.inputs).any()


def test_plan_stands_for_all_designs(dataset: Dataset) -> None:
    """Each design has a chosen one nearer than with designs taken in their order."""
    from surrogate.increment import _standardised

    points = _standardised(dataset)

    def away(rows: np.ndarray) -> float:
        apart = ((points[:, None] - points[rows][None]) ** 2).sum(axis=2)
        return float(np.sqrt(apart.min(axis=1)).mean())

    chosen = plan(dataset, SPACES["tilt"], 30, seed=0).base_row
    assert away(chosen) < 0.95 * away(np.arange(30))


def test_failed_paths_are_not_paired_with(dataset: Dataset) -> None:
    chosen = plan(dataset, SPACES["tilt"], 30, seed=0).base_row
    ends = list(dataset.path_status)
    ends[chosen[0]] = "step_too_small"
    status = dataset.status.copy()
    status[chosen[1], 2:] = STEP_STATUS.index("no_step")
    short = replace(dataset, path_status=tuple(ends), status=status)
    again = plan(short, SPACES["tilt"], 30, seed=0).base_row
    assert not {chosen[0], chosen[1]} & set(again.tolist())


def test_designs_near_given_ones_come_early(dataset: Dataset) -> None:
    from surrogate.increment import _standardised

    device = named_device()
    near = plan(dataset, SPACES["tilt"], 30, seed=0, near=[device]).base_row
    plain = plan(dataset, SPACES["tilt"], 30, seed=0).base_row
    sampled = np.array([[device.sampled()[name] for name in dataset.variables]])
    joined = replace(
        dataset.subset([*range(len(dataset)), 0]),
        inputs=np.concatenate([dataset.inputs, sampled]),
    )
    points = _standardised(joined)
    away = np.sqrt(((points[:-1] - points[-1]) ** 2).sum(axis=1))
    away[held_out(dataset)] = np.inf
    nearest = set(np.argsort(away)[:5].tolist())
    assert nearest <= set(near.tolist())
    assert not nearest <= set(plain.tolist())


def test_designs_on_which_the_effects_cannot_act(dataset: Dataset) -> None:
    planned = plan(
        dataset, SPACES["tilt"], 20, 0, fits=lambda design, _: design.divisions_x > 3
    )
    assert planned.unfit > 0
    assert min(dataset.design(row).divisions_x for row in planned.base_row) > 3
    with pytest.raises(InputError, match="0 designs on which the effects can act"):
        plan(dataset, SPACES["tilt"], 20, 0, fits=lambda *_: False)


def test_bad_plans(dataset: Dataset) -> None:
    with pytest.raises(InputError, match="paths: 1 is not allowed"):
        plan(dataset, SPACES["tilt"], 1, 0)
    with pytest.raises(InputError, match="one without effects"):
        plan(replace(dataset, effects=("tilt",)), SPACES["tilt"], 20, 0)


@pytest.mark.parametrize(
    ("value", "std", "expected"),
    [
        (5.0, 0.1, (4.0, 6.0)),  # a tenth of the range at least; off is far
        (5.0, 1.0, (0.0, 8.0)),  # off is nearer than the range is wide
        (0.5, 0.1, (0.0, 1.5)),  # clipped
        (9.8, 1.0, (6.8, 10.0)),
        (12.0, 0.1, (9.0, 10.0)),  # a fit outside what is declared
    ],
)
def test_stated_range(value: float, std: float, expected: tuple[float, float]) -> None:
    parameter = Parameter("x", "1", 0.0, 10.0, off=0.0, source="test")
    assert stated_range(parameter, value, std) == pytest.approx(expected)


def test_stated_range_refuses() -> None:
    parameter = Parameter("x", "1", 0.0, 10.0, off=0.0, source="test")
    with pytest.raises(InputError, match="x: "):
        stated_range(parameter, np.nan, 0.1)


def test_ranged_space() -> None:
    space = ranged_space(("bond_edge",), {GROWTH: (0.0, 50e-6)})
    assert space[GROWTH].upper == 50e-6
    assert space.names[:-1] == DESIGN_SPACE.names
    both = {
        GROWTH: (0.0, 50e-6),
        "pressure_loss.gain": (0.9, 1.0),
    }
    one = ranged_space(("bond_edge", "pressure_loss"), both)
    assert one == ranged_space(("pressure_loss", "bond_edge"), both)
    for effects, ranges, told in (
        ((), {}, "effects: '' is not allowed"),
        (("bond_edge",), {}, "bond_edge.growth"),
        (("bond_edge",), {GROWTH: (0.0, 1.0)}, "bond_edge.growth: 1 m"),
        (("bond_edge",), {GROWTH: (5e-5, 5e-5)}, "below"),
        (("bond_edge",), both, "range: 'pressure_loss.gain'"),
    ):
        with pytest.raises(InputError, match=told):
            ranged_space(effects, ranges)
    with pytest.raises(EffectError, match="'nothing' is unknown"):
        ranged_space(("nothing",), {})


def test_mesh_is_that_of_the_base() -> None:
    """Of this generator, or of an earlier one whose mesh is still here."""
    base = Dataset.read(REFERENCE / "dataset.h5")
    assert mesh_of(replace(base, generator_version=GENERATOR_VERSION)) == "standard"
    for former in ("1", "4", "5"):
        of_former = replace(base, generator_version=former)
        assert mesh_of(of_former) == f"standard-{former}"
    with pytest.raises(InputError, match="generator 0, mesh standard"):
        mesh_of(replace(base, generator_version="0"))


def test_effects_with_time_are_refused() -> None:
    design = Dataset.read(REFERENCE / "dataset.h5").design(0)
    for effect in ("viscoelasticity", "swelling", "mullins"):
        model = Model((effect,))
        values = {effect: {p.name: p.upper for p in model.active[0].parameters}}
        with pytest.raises(InputError, match="knows no time and no history"):
            fem_fits((effect,), "draft")(design, values)
    narrow = {"bond_edge": {"growth": 149e-6}}
    rim = replace(design, width=design.span_y + 2 * 50e-6)
    assert not fem_fits(("bond_edge",), "draft")(rim, narrow)
    assert fem_fits(("bond_edge",), "draft")(rim, {"bond_edge": {"growth": 20e-6}})


def test_increment_is_paired(dataset: Dataset, tmp_path: Path) -> None:
    found = increment(dataset, tmp_path / "soft.h5", "soft", 120, seed=2)
    assert found.base == dataset.digest()
    again = Dataset.read(tmp_path / "soft.h5")
    assert again.digest() == found.digest()
    pairs = pair(dataset, again)
    factor = again.inputs[:, -1]
    further = 0
    for i, row in enumerate(again.base_row):
        steps = dataset.steps(int(row))
        np.testing.assert_array_equal(
            again.pressure[i, :steps], dataset.pressure[row, :steps]
        )
        shared = pairs.shared[i]
        assert shared[:steps].any() and not shared[steps:].any()
        # Softer layers rise more.
        rise = pairs.difference[i, shared, 2]
        assert (np.sign(rise) == (1 if factor[i] < 1 else -1)).all()
        # Where the base has turned, a stiffer device goes on towards the same end.
        assert again.pressure[i][np.isfinite(again.pressure[i])][-1] == 150e3
        if np.isfinite(dataset.limit_pressure[row]) and factor[i] > 1.05:
            further += again.steps(i) - steps
    assert further > 0
    both = np.isfinite(pairs.log_shift)
    assert both.any()
    np.testing.assert_allclose(pairs.log_shift[both], np.log(factor[both]), rtol=1e-6)
    some = again.subset([3, 1])
    np.testing.assert_array_equal(some.base_row, again.base_row[[3, 1]])


def test_pairs_of_another_base_are_refused(dataset: Dataset, tmp_path: Path) -> None:
    found = increment(dataset, tmp_path / "tilt.h5", "tilt", 20, seed=1)
    with pytest.raises(InputError, match="one made from this dataset"):
        pair(replace(dataset, seed=99), found)
    with pytest.raises(InputError, match="one made from this dataset"):
        pair(dataset, dataset)
    assert found.base_row is not None
    wrong = replace(found, base_row=np.roll(found.base_row, 1))
    with pytest.raises(InputError, match="those of the base's rows"):
        pair(dataset, wrong)


def test_a_pair_by_finite_elements() -> None:
    """At off a pair is its base; next to it, it differs by what the slope says."""
    sampled = named_device().sampled()
    names, inputs = tuple(sampled), tuple(sampled.values())
    with threadpool_limits(1):
        base = solve_row(Task(0, names, inputs, (), "draft", 30e3))
        rows = [
            solve_pair(
                PairTask(
                    row=0,
                    variables=(*names, GROWTH),
                    inputs=(*inputs, growth),
                    effects=("bond_edge",),
                    level="draft",
                    max_pressure=30e3,
                    pressure=tuple(base.pressure.tolist()),
                )
            )
            for growth in (0.0, 1e-6)
        ]
    np.testing.assert_array_equal(rows[0].pressure, base.pressure)
    scale = np.abs(base.values).max(axis=0)
    assert (np.abs(rows[0].values - base.values) / scale).max() < 1e-6
    assert rows[0].parameters == (GROWTH,)
    assert rows[0].jacobian is not None and rows[1].jacobian is not None
    slope = (rows[0].jacobian + rows[1].jacobian)[..., 0] / 2
    change = (rows[1].values - rows[0].values) / 1e-6
    size = np.abs(change).max(axis=0)
    assert (np.abs(slope - change) / size).max() < 1e-2
