"""Slopes: what effects change to first order, and what that teaches."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from datagen.dataset import Dataset
from datagen.device import DESIGN_SPACE, named_device
from datagen.effects import catalogue
from datagen.errors import InputError
from datagen.response import OUTPUT_NAMES
from datagen.space import Parameter
from datagen.worker import STEP_STATUS, Row, Task, solve_row
from surrogate import learn as learning
from surrogate.change import change_errors, fit_corrected
from surrogate.ensemble import REFERENCE, Ensemble
from surrogate.increment import PairTask, added, ranked_rows, solve_pair
from surrogate.learn import INCREMENT, SLOPES, learn
from surrogate.pairs import pair
from surrogate.shift import coordinates, far_end
from surrogate.slopes import (
    MOST_STEPS,
    SlopeTask,
    differentiable,
    fits_at_off,
    shipped,
    slope_rows,
    slopes_space,
    solve_slopes,
    tangent_of,
)
from surrogate.split import held_out
from tests.datagen.fake_solver import Here
from tests.surrogate.pairs import (
    QUICK,
    SPACES,
    equivalent,
    increment,
    means,
    slopes,
    solve_synthetic,
)

PICKY = '''
from dataclasses import replace

from datagen.effects import effect
from datagen.errors import InputError
from datagen.space import Parameter


@effect(
    stage="load",
    parameters=[
        Parameter(
            "offset", unit="Pa", lower=-1e3, upper=1e3, off=0.0, source="a test of ours"
        )
    ],
)
def picky(problem, offset):
    """An offset of the pressure, of strips of one row alone."""
    if problem.design.divisions_y > 1:
        raise InputError("divisions_y", problem.design.divisions_y, "1")
    return replace(problem, pressure_offset=problem.pressure_offset + offset)
'''

_ROW = Row(
    row=0,
    outputs=OUTPUT_NAMES,
    pressure=np.arange(1.0, 5.0),
    values=np.zeros((4, 5)),
    status=np.zeros(4, dtype=np.int8),
    path_status="completed",
    limit_pressure=np.nan,
    message="",
)


def test_rows_are_of_designs_that_training_sees(dataset: Dataset) -> None:
    rows = slope_rows(dataset)
    assert not held_out(dataset)[rows].any()
    np.testing.assert_array_equal(rows, np.sort(ranked_rows(dataset)))
    first = slope_rows(dataset, 20)
    others = slope_rows(dataset, 20, taken=first)
    assert len(first) == len(others) == 20 and not set(first) & set(others)
    every = slope_rows(dataset, len(rows), taken=first)
    np.testing.assert_array_equal(every, rows)  # there are no others


@pytest.mark.parametrize(
    ("p", "share", "expected"),
    [
        (Parameter("x.y", "1", -2.0, 1.0, off=0.0, source="t"), 0.5, -1.0),
        (Parameter("x.y", "1", 0.5, 1.0, off=1.0, source="t"), 1.0, 0.5),
        (Parameter("x.y", "1", 0.25, 2.0, "log", off=1.0, source="t"), 0.5, 0.5),
    ],
)
def test_far_end(p: Parameter, share: float, expected: float) -> None:
    assert far_end(p, share) == pytest.approx(expected)
    assert np.abs(coordinates(np.array([expected]), (p,))) == pytest.approx(share)


def test_a_tangent_has_the_parameters_of_a_space(
    dataset: Dataset, tmp_path: Path
) -> None:
    found = slopes(dataset, tmp_path / "s.h5", "tilt", 12)
    np.testing.assert_array_equal(found.base_row, slope_rows(dataset, 12))
    tangent = tangent_of(found, dataset, SPACES["both"])
    assert tangent is not None
    assert [tangent.tuned[j].name for j in tangent.known] == ["tilt.angle"]
    ((values, difference),) = tangent.views(0.5)
    np.testing.assert_array_equal(values, np.tile([1.0, 0.1], (12, 1)))
    # The tilt turns a strip by itself.
    np.testing.assert_allclose(difference[tangent.good][:, 1], 0.1, rtol=1e-6)
    assert (tangent.largest >= np.abs(tangent.before)).all()
    with pytest.raises(InputError, match=r"slopes: .* those of this dataset"):
        tangent_of(found, replace(dataset, seed=99), SPACES["tilt"])


def test_slopes_teach_what_few_pairs_do_not(
    ensemble: Ensemble, dataset: Dataset, tmp_path: Path
) -> None:
    few = increment(dataset, tmp_path / "i.h5", "both", 20, 4)
    many = slopes(dataset, tmp_path / "s.h5", "both", 120)
    pairs = pair(dataset, increment(dataset, tmp_path / "t.h5", "both", 60, 5))
    tests = pairs.subset(np.flatnonzero(held_out(pairs.data)))
    error = [
        change_errors(
            fit_corrected(
                ensemble,
                dataset,
                few,
                settings=QUICK,
                equivalent=equivalent("both"),
                slopes=given,
            ),
            tests,
        )["bending_angle"]["median_pct"]
        for given in (None, many)
    ]
    assert error[1] < 0.7 * error[0], error


def test_learning_solves_slopes_that_are_not_there(
    ensemble: Ensemble, dataset: Dataset, tmp_path: Path
) -> None:
    """Killed among them, it goes on; they go along into the model's folder."""
    told: list[str] = []

    def stop(stage: str, done: int, total: int, left: float | None) -> None:
        told.append(stage)
        if (stage, done) == ("slopes", 20):
            raise KeyboardInterrupt

    settings: dict[str, object] = {
        "paths": 16,
        "executor": Here(),
        "settings": replace(QUICK, fit=replace(QUICK.fit, steps=50)),
    }
    how = means("tilt", slopes=True)
    one, two = tmp_path / "one", tmp_path / "two"
    learn(ensemble, dataset, ("tilt",), {}, one, means=how, **settings)  # type: ignore[arg-type]
    with pytest.raises(KeyboardInterrupt):
        learn(ensemble, dataset, ("tilt",), {}, two, means=how, report=stop, **settings)  # type: ignore[arg-type]
    assert set(told) == {"slopes"}
    again = replace(how, solve_slopes=_Others(20))
    model = learn(
        ensemble,
        dataset,
        ("tilt",),
        {},
        two,
        means=again,
        resume=True,
        **settings,  # type: ignore[arg-type]
    )
    assert model.description["slope_paths"] == 32
    for name in (INCREMENT, SLOPES, "weights.safetensors"):
        assert (one / name).read_bytes() == (two / name).read_bytes(), name
    samples = np.array([[0.05]])
    other = learning.hand_on(one, tmp_path / "three", samples, "one")
    assert other is not None and (tmp_path / "three" / SLOPES).exists()


class _Others:
    """A solver that fails at rows before a given one: they have been solved already."""

    def __init__(self, first: int) -> None:
        self.first = first

    def __call__(self, task: Task) -> Row:
        assert task.row >= self.first
        return solve_synthetic(task)


def test_effects_that_have_slopes() -> None:
    """Not those that change what is held when they are turned on, nor with history."""
    base = Dataset.read(REFERENCE / "dataset.h5")
    none = {"clamp_compliance", "mullins", "swelling", "viscoelasticity"}
    every = tuple(catalogue())
    assert differentiable(every, base) == tuple(sorted(set(every) - none))
    assert shipped(base, ("clamp_compliance",)) is None
    found = shipped(base, ("cure_mismatch", "yeoh"))
    assert found is not None and "yeoh.third" in found.parameters
    assert shipped(replace(base, seed=99), ("yeoh",)) is None


def test_shipped_slopes_are_found_again() -> None:
    """Two rows drawn at random, solved again with their derivatives.

    To 1e-4 of the largest on the path, or to what moves the output over the parameter's
    whole range by less than 1e-5 of its largest amount: a rotation does not inflate,
    and the third term of Yeoh's law does nearly nothing at small strain.  Of such
    derivatives another processor's rounding changes a hundredth.
    """
    base = Dataset.read(REFERENCE / "dataset.h5")
    found = Dataset.read(REFERENCE / "slopes.h5")
    assert found.base == base.digest()
    assert found.base_row is not None and found.jacobian is not None
    assert not held_out(base)[found.base_row].any()
    assert np.isfinite(found.jacobian[found.status == 0]).mean() > 0.99
    effects = differentiable(tuple(catalogue()), base)
    assert found.effects == effects
    assert found.space == slopes_space(effects)
    steps = [found.steps(i) for i in range(len(found))]
    assert max(steps) <= MOST_STEPS
    small = [
        i
        for i in range(len(found))
        if found.design(i).divisions_x * found.design(i).divisions_y <= 3 and steps[i]
    ]
    for i in np.random.default_rng(3).choice(small, 2, replace=False):
        row = int(found.base_row[i])
        with threadpool_limits(1):
            again = solve_slopes(
                SlopeTask(
                    row=0,
                    variables=found.variables,
                    inputs=tuple(found.inputs[i].tolist()),
                    effects=found.effects,
                    level=found.level,
                    max_pressure=base.max_pressure,
                    pressure=tuple(base.pressure[row, : base.steps(row)].tolist()),
                )
            )
        assert again.parameters == found.parameters and again.jacobian is not None
        good = slice(0, steps[i])
        np.testing.assert_array_equal(again.pressure, found.pressure[i, good])
        values, slopes = found.values[i, good], found.jacobian[i, good]
        largest = np.nanmax(np.abs(values), axis=0)
        assert (np.abs(again.values - values) <= 1e-6 * largest).all()
        spans = [found.space[p].upper - found.space[p].lower for p in found.parameters]
        nothing = 1e-5 * largest[:, None] / np.array(spans)
        allowed = np.maximum(1e-4 * np.nanmax(np.abs(slopes), axis=0), nothing)
        assert (np.abs(again.jacobian - slopes) <= allowed).all()
        assert (nothing < np.nanmax(np.abs(slopes), axis=0)).mean() > 0.8


def test_a_coarser_mesh_has_the_difference() -> None:
    """Not the path: the difference added to it is the path with the effect in it."""
    sampled = named_device().sampled()
    names, inputs = tuple(sampled), tuple(sampled.values())
    with threadpool_limits(1):
        base = solve_row(Task(0, names, inputs, (), "standard", 30e3))
        task = PairTask(
            row=0,
            variables=(*names, "cure_mismatch.difference"),
            inputs=(*inputs, -0.004),
            effects=("cure_mismatch",),
            level="standard",
            max_pressure=30e3,
            pressure=tuple(base.pressure.tolist()),
            before=tuple(map(tuple, base.values.tolist())),
        )
        fine = solve_pair(task)
        found = solve_pair(replace(task, coarser="draft"))
        coarse = solve_pair(replace(task, level="draft"))
    assert set(DESIGN_SPACE.names) < set(task.variables)
    np.testing.assert_array_equal(found.pressure, fine.pressure)
    scale = np.abs(fine.values).max(axis=0)
    error = np.abs(found.values - fine.values).max(axis=0) / scale
    alone = np.abs(coarse.values - fine.values).max(axis=0) / scale
    assert error.max() < 3e-3 and error.max() < 0.5 * alone.max(), (error, alone)


def test_a_difference_ends_where_one_of_its_paths_does() -> None:
    def row(steps: int, limit: float, value: float) -> Row:
        return replace(
            _ROW,
            status=np.where(np.arange(4) < steps, 0, 3).astype(np.int8),
            values=np.full((4, 5), value),
            limit_pressure=limit,
        )

    before = ((10.0,) * 5,) * 3
    task = PairTask(
        0, (), (), (), "standard", 1e5, pressure=(1, 2, 3, 4), before=before
    )
    task = replace(task, base_limit=30.0)
    found = added(task, row(2, 26.0, 1.5), row(4, 20.0, 0.5))
    assert len(found.pressure) == 2
    assert found.limit_pressure == pytest.approx(39.0)
    np.testing.assert_array_equal(found.values, 11.0)
    longer = added(task, row(4, np.nan, 1.5), row(4, 20.0, 0.5))
    assert len(longer.pressure) == 3  # the base's path has no more
    assert np.isnan(longer.limit_pressure)
    # 2 Pa is beyond its own limit pressure, 1.6 times 2/2 Pa.
    past = replace(task, base_limit=2.0)
    assert len(added(past, row(4, 1.6, 1.5), row(4, 2.0, 0.5)).pressure) == 1
    # Without the effect there was none on the coarser mesh.
    alone = added(task, row(3, 26.0, 1.5), row(4, np.nan, 0.5))
    assert alone.limit_pressure == 26.0


def test_slopes_that_say_nothing_are_left_out(dataset: Dataset, tmp_path: Path) -> None:
    """Paths without a step, designs held out, a parameter that does nothing."""
    found = slopes(dataset, tmp_path / "s.h5", "both", 12)
    assert found.jacobian is not None and found.base_row is not None
    status, slope = found.status.copy(), found.jacobian.copy()
    status[3] = STEP_STATUS.index("step_too_small")
    slope[5] = np.nan
    tangent = tangent_of(
        replace(found, status=status, jacobian=slope), dataset, SPACES["both"]
    )
    assert tangent is not None
    left = np.delete(found.base_row, [3, 5])
    np.testing.assert_array_equal(tangent.base_row, left)
    place = found.parameters.index("tilt.angle")
    slope[..., place] = 0.0
    still = replace(found, jacobian=slope)
    both = tangent_of(still, dataset, SPACES["both"])
    assert both is not None
    assert [both.tuned[j].name for j in both.known] == ["soft.factor"]
    assert tangent_of(still, dataset, SPACES["tilt"]) is None
    held = np.flatnonzero(held_out(dataset))[:3]
    wrong = replace(found.subset(range(3)), base_row=held)
    with pytest.raises(InputError, match="those of the base's rows"):
        tangent_of(wrong, dataset, SPACES["tilt"])
    tests = replace(
        wrong, inputs=np.hstack([dataset.inputs[held], wrong.inputs[:, -2:]])
    )
    assert tangent_of(tests, dataset, SPACES["tilt"]) is None


def test_next_to_a_limit_point_a_slope_is_no_scale(
    dataset: Dataset, tmp_path: Path
) -> None:
    found = slopes(dataset, tmp_path / "s.h5", "tilt", 12)
    assert found.jacobian is not None
    before = tangent_of(found, dataset, SPACES["tilt"])
    steep = found.jacobian.copy()
    last = [found.steps(i) - 1 for i in range(12)]
    steep[np.arange(12), last] *= 1e4
    after = tangent_of(replace(found, jacobian=steep), dataset, SPACES["tilt"])
    assert before is not None and after is not None
    sizes = [one.largest.max(axis=1)[:, 1] for one in (before, after)]
    assert (sizes[1] <= 3 * sizes[0]).all()


def test_designs_on_which_an_effect_cannot_act(
    dataset: Dataset, tmp_path: Path
) -> None:
    """A user's effect that refuses strips of several rows: others are taken."""
    (tmp_path / "picky.py").write_text(PICKY)
    base = Dataset.read(REFERENCE / "dataset.h5")
    assert differentiable(("picky",), base, tmp_path) == ("picky",)
    rows = slope_rows(base, 5, fits=fits_at_off(("picky",), tmp_path))
    assert len(rows) == 5
    assert {base.design(row).divisions_y for row in rows.tolist()} == {1}


def test_pairs_of_paths_that_end_before_their_bases(
    dataset: Dataset, tmp_path: Path
) -> None:
    """All of them: the file has fewer load steps then than its base."""
    found = increment(dataset, tmp_path / "i.h5", "tilt", 20, 4)
    short = replace(
        found,
        pressure=found.pressure[:, :3],
        values=found.values[:, :3],
        status=found.status[:, :3],
        jacobian=None if found.jacobian is None else found.jacobian[:, :3],
    )
    pairs, whole = pair(dataset, short), pair(dataset, found)
    np.testing.assert_array_equal(pairs.before, whole.before[:, :3])
    np.testing.assert_array_equal(pairs.shared, whole.shared[:, :3])
