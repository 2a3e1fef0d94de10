"""The corrected surrogate: its base at off, the effects elsewhere, honest intervals."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datagen.dataset import Dataset
from datagen.device import DESIGN_SPACE, Design, named_device
from datagen.errors import FileError, InputError
from datagen.response import Path as LoadPath
from surrogate import change as learning
from surrogate.accuracy import accuracy
from surrogate.calibration import Calibration, calibrate
from surrogate.change import FEWEST_PAIRS, change_errors, fit_corrected
from surrogate.corrected import Corrected, ask
from surrogate.ensemble import Ensemble
from surrogate.equivalent import READ, Equivalent
from surrogate.increment import TEST_PATHS
from surrogate.pairs import pair
from surrogate.shift import fit_shift
from surrogate.split import folds, held_out
from tests.surrogate.pairs import QUICK, equivalent, increment, truth

Array = np.ndarray
PATH = LoadPath(np.linspace(5e3, 60e3, 8))


@pytest.fixture(scope="module")
def both(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """An increment with two effects."""
    return increment(dataset, tmp_path_factory.mktemp("both") / "i.h5", "both", 60, 2)


@pytest.fixture(scope="module")
def model(ensemble: Ensemble, dataset: Dataset, both: Dataset) -> Corrected:
    return fit_corrected(
        ensemble, dataset, both, settings=QUICK, equivalent=equivalent("both")
    )


def at(model: Corrected, factor: float, angle: float) -> Corrected:
    return model.with_parameters({"soft": {"factor": factor}, "tilt": {"angle": angle}})


def designs(count: int, seed: int) -> list[Design]:
    rows = DESIGN_SPACE.sample(count, seed)
    return [
        Design.from_sample(dict(zip(DESIGN_SPACE.names, map(float, row), strict=True)))
        for row in rows
    ]


@pytest.mark.parametrize("given", [{}, {"soft": {"factor": 1.0}, "tilt": {"angle": 0}}])
def test_at_off_it_is_its_base_bit_for_bit(
    model: Corrected, ensemble: Ensemble, given: dict[str, dict[str, float]]
) -> None:
    some = designs(40, 9)
    paths = [PATH] * len(some)
    one, two = (
        model.with_parameters(given).predict(some, paths),
        ensemble.predict(some, paths),
    )
    np.testing.assert_array_equal(one.response.values, two.response.values)
    np.testing.assert_array_equal(one.response.std, two.response.std)
    np.testing.assert_array_equal(one.low, two.low)
    np.testing.assert_array_equal(one.high, two.high)
    off = model.with_parameters(given)
    limits = off.limit_pressure(some), ensemble.limit_pressure(some)
    np.testing.assert_array_equal(limits[0].pressure, limits[1].pressure)
    np.testing.assert_array_equal(limits[0].std, limits[1].std)
    found = off.check(some[0], PATH.pressure)
    assert found.reasons == ensemble.check(some[0], PATH.pressure).reasons
    moved = at(model, 0.8, 0.1).predict(some, paths).response.values
    assert (moved != two.response.values).all()


def test_learns_what_effects_change(
    model: Corrected, dataset: Dataset, both: Dataset
) -> None:
    """On designs that neither base nor increment was trained on."""
    pairs = pair(dataset, both)
    rows = np.flatnonzero(held_out(both))
    assert len(rows) == round(TEST_PATHS * 60)
    for name, error in change_errors(model, pairs.subset(rows)).items():
        assert error["median_pct"] < 0.35 * error["size_pct"], name
    assert model.description["n_train"] == 60 - len(rows)


def test_networks_learn_what_no_device_does(
    ensemble: Ensemble, dataset: Dataset, tmp_path: Path
) -> None:
    """The tilt is no device: without the networks nothing of it would be known."""
    found = increment(dataset, tmp_path / "tilt.h5", "tilt", 60, 4)
    model = fit_corrected(ensemble, dataset, found, settings=QUICK)
    assert model.description["change_fit"]["shares"][1] > 0.5
    pairs = pair(dataset, found).subset(np.flatnonzero(held_out(found)))
    errors = change_errors(model, pairs)
    assert errors["bending_angle"]["median_pct"] < (
        0.35 * errors["bending_angle"]["size_pct"]
    )
    some = designs(30, 6)
    turned = model.with_parameters({"tilt": {"angle": 0.15}})
    moved = turned(some, [PATH] * 30).values - ensemble(some, [PATH] * 30).values
    assert np.median(np.abs(moved[..., 1] - 0.15)) < 0.35 * 0.15
    # What it does not touch is left alone.
    assert errors["inflation"]["median_pct"] < 0.1
    assert model.description["accuracy"]["n_test"] == round(TEST_PATHS * 60)


def test_intervals_cover_unseen_designs(model: Corrected) -> None:
    """Against the closed forms themselves, on designs of no dataset."""
    rng = np.random.default_rng(8)
    inside = []
    for design in designs(80, 123):
        factor, angle = float(rng.uniform(0.7, 1.1)), float(rng.uniform(0, 0.2))
        values = design.sampled() | {"soft.factor": factor, "tilt.angle": angle}
        pressure = np.linspace(10e3, 150e3, 12)
        known, limit = truth(values, pressure)
        pressure = pressure[pressure <= limit]
        if not len(pressure):
            continue
        found = at(model, factor, angle).predict([design], [LoadPath(pressure)])
        good = known[: len(pressure)]
        inside.append(((found.low[0] <= good) & (good <= found.high[0])).mean())
    assert 0.85 <= np.mean(inside) <= 0.98


def test_intervals_rest_on_members_that_had_not_seen_the_designs(
    ensemble: Ensemble,
    dataset: Dataset,
    both: Dataset,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of the base, too: those that had know its paths better than a device's in use."""
    given: list[Array] = []

    def kept(errors: Array, *others: Any) -> Calibration:
        given.append(errors)
        return calibrate(errors, *others)

    monkeypatch.setattr(learning, "calibrate", kept)
    settings = replace(QUICK, fit=replace(QUICK.fit, steps=50))
    model = fit_corrected(
        ensemble, dataset, both, settings=settings, equivalent=equivalent("both")
    )
    pairs = pair(dataset, both).subset(np.flatnonzero(~held_out(both)))
    rows = pairs.data.base_row
    assert rows is not None
    columns = {p.name: pairs.data.inputs[:, i] for i, p in enumerate(DESIGN_SPACE)}
    by_base = ensemble.unseen_by(dataset, rows)
    held = folds(len(pairs), QUICK.folds, QUICK.repeats, 0)
    by_change = np.stack([np.flatnonzero(one) for one in held.T], axis=1)
    asked = ask(
        ensemble,
        model.space,
        (model.equivalent, model.shift),
        columns,
        pairs.data.inputs[:, len(DESIGN_SPACE) :],
        by_base,
    )
    own, pressure = asked.base_pressure(pairs.pressure), pairs.pressure
    there = ensemble.answers(asked.plain, own, asked.base_limit).values
    here = ensemble.answers(asked.drawn, pressure, asked.drawn_limit).values
    nearness = own / asked.base_limit.pressure[:, None]
    more = model.change(asked.inputs(own, slice(None)), nearness).values
    each = np.arange(len(pairs))
    found = (there - here)[by_base, each] + more[by_change, each] - pairs.difference
    np.testing.assert_allclose(given[0], found[:, pairs.shared], rtol=1e-9, atol=1e-15)


def test_limit_pressure_shifts(model: Corrected, ensemble: Ensemble) -> None:
    """Softer by a factor: the limit is lower by it."""
    some = designs(30, 4)
    before, after = (
        ensemble.limit_pressure(some),
        at(model, 0.8, 0.0).limit_pressure(some),
    )
    np.testing.assert_allclose(after.pressure / before.pressure, 0.8, rtol=0.03)
    assert (after.std >= before.std * (1 - 1e-12)).all()


def test_pressure_of_the_equivalent_device(
    model: Corrected, ensemble: Ensemble
) -> None:
    """A gauge that reads wrong: the base at the true pressure, and its limit read."""
    weights = np.zeros_like(model.equivalent.weights)
    logarithmic = np.zeros_like(model.equivalent.logarithmic)
    weights[READ.index("gain"), 0] = 0.2  # t = -1: gain 0.8
    weights[READ.index("offset"), 0] = -0.3  # 3 kPa
    equal = replace(
        model,
        equivalent=Equivalent(weights, logarithmic),
        change=replace(
            model.change, base=0 * model.change.base, unit=0 * model.change.unit
        ),
    )
    some = designs(10, 4)
    found = at(equal, 0.7, 0.0)
    true = [LoadPath(0.8 * PATH.pressure + 3e3)] * 10
    np.testing.assert_allclose(
        found(some, [PATH] * 10).values, ensemble(some, true).values, rtol=1e-9
    )
    limit = ensemble.limit_pressure(some).pressure
    np.testing.assert_allclose(
        found.limit_pressure(some).pressure, (limit - 3e3) / 0.8, rtol=1e-9
    )


def test_a_shift_that_no_device_explains() -> None:
    rng = np.random.default_rng(1)
    inputs, t = rng.normal(size=(40, 6)), rng.uniform(-1, 1, (40, 1))
    exact = t[:, 0] * (0.2 + 0.05 * inputs[:, 2])
    known = exact + 0.003 * rng.normal(size=40)
    known[::4] = np.nan
    held = np.arange(40)[None] % 4 == np.arange(4)[:, None]
    shift = fit_shift(inputs, t, known, held)
    mean, std = shift(inputs, t)
    assert np.abs(mean - exact).max() < 0.03
    assert 0.001 < shift.noise < 0.03
    assert (std > 0).all()
    at_off, no_std = shift(inputs, np.zeros_like(t))
    assert not at_off.any() and not no_std.any()
    few = np.where(np.arange(40) < 3, known, np.nan)
    assert not fit_shift(inputs, t, few, held)(inputs, t)[0].any()


def test_marginal(model: Corrected) -> None:
    some, paths = designs(3, 2), [PATH] * 3
    one = at(model, 0.9, 0.1).predict(some, paths)
    same = model.marginal(some, paths, np.array([[0.9, 0.1]]))
    np.testing.assert_allclose(same.response.values, one.response.values, rtol=1e-12)
    np.testing.assert_allclose(same.low, one.low, rtol=1e-9)
    np.testing.assert_allclose(same.high, one.high, rtol=1e-9)
    rng = np.random.default_rng(0)
    samples = np.column_stack(
        [rng.normal(0.9, 0.05, 200).clip(0.7, 1.1), rng.normal(0.1, 0.02, 200)]
    )
    found = model.marginal(some, paths, samples)
    values = np.array(
        [at(model, *s).predict(some, paths).response.values for s in samples[:30]]
    )
    few = model.marginal(some, paths, samples[:30])
    np.testing.assert_allclose(few.response.values, values.mean(axis=0), rtol=1e-9)
    assert ((found.high - found.low) > (one.high - one.low)).mean() > 0.99
    assert (few.response.std**2 >= 0.99 * values.var(axis=0)).all()
    assert (found.low < found.response.values).all()
    # What the model brings along is the default.
    own = replace(model, samples=samples)
    np.testing.assert_array_equal(own.marginal(some, paths).low, found.low)
    with pytest.raises(InputError, match=r"shape \(m, 2\): soft.factor, tilt.angle"):
        model.marginal(some, paths, samples[:, :1])


def test_check_refuses_parameters_outside_their_range(model: Corrected) -> None:
    device = named_device()
    assert at(model, 0.9, 0.1).check(device, PATH.pressure).in_range
    found = at(model, 0.9, 0.3).check(device, PATH.pressure)
    assert not found.in_range
    assert found.reasons == ("tilt.angle: 0.3 is above the trained range 0 to 0.2",)
    high = at(model, 0.9, 0.1).check(device, np.array([10e3, 160e3]))
    assert high.per_step.tolist() == [True, False]
    with pytest.raises(InputError, match=r"soft\.factor, tilt\.angle"):
        model.with_parameters({"soft": {"colour": 1.0}})
    with pytest.raises(InputError, match="a finite number"):
        at(model, np.nan, 0.1)


def test_check_refuses_a_device_that_effects_make_strange(model: Corrected) -> None:
    """The base answers for the equivalent device: it has to know such devices."""
    weights = model.equivalent.weights.copy()
    logarithmic = model.equivalent.logarithmic.copy()
    for name, change in (
        ("balloon_width", -1.0),
        ("rim", 1.0),
        ("balloon_start", 1.0),
        ("tip_margin", 1.0),
        ("cavity_height", -1.0),
    ):
        i = READ.index(name)
        weights[i], logarithmic[i] = 0.0, True
        weights[i, 0] = change
    strange = replace(model, equivalent=Equivalent(weights, logarithmic))
    device = named_device()
    assert at(strange, 1.0, 0.0).check(device, PATH.pressure).in_range
    found = at(strange, 0.7, 0.0).check(device, PATH.pressure)
    assert not found.in_range and not found.per_step.any()
    assert "the effects make of it a device far from" in found.reasons[-1]


def test_repeats_bit_by_bit(
    ensemble: Ensemble, dataset: Dataset, both: Dataset, model: Corrected
) -> None:
    settings = replace(QUICK, fit=replace(QUICK.fit, steps=50))

    def version(seed: int, data: Dataset = both) -> str:
        return fit_corrected(
            ensemble, dataset, data, seed, settings, equivalent("both")
        ).version

    first = version(0)
    assert version(0) == first
    assert version(1) != first
    # Held-out paths decide nothing.
    values = both.values.copy()
    values[held_out(both)] *= 100
    assert version(0, replace(both, values=values)) == first
    assert at(model, 0.9, 0.1).version == model.version


def test_noise_is_not_learned(
    ensemble: Ensemble, dataset: Dataset, tmp_path: Path
) -> None:
    """Differences that follow nothing: the networks get no share in the answer."""
    found = increment(dataset, tmp_path / "tilt.h5", "tilt", 40, 4)
    rng = np.random.default_rng(0)
    assert found.base_row is not None
    # As many up as down of those that train, so that there is no mean either.
    trains = ~held_out(found)
    signs = np.ones((40, 5))
    signs[trains] = rng.permuted(np.tile([[-1.0], [1.0]], (14, 5)), axis=0)
    values = found.values.copy()
    for i, row in enumerate(found.base_row):
        steps = dataset.steps(int(row))
        size = np.abs(dataset.values[row, :steps]).max(axis=0)
        values[i, :steps] = dataset.values[row, :steps]
        values[i, :steps] += 0.05 * size * signs[i]
    noisy = replace(found, values=values, jacobian=None, parameters=(), sensitivities=0)
    model = fit_corrected(ensemble, dataset, noisy, settings=QUICK)
    assert model.description["change_fit"]["shares"] == [0.0] * 5


def test_bad_increments(ensemble: Ensemble, dataset: Dataset, both: Dataset) -> None:
    few = both.subset(np.arange(FEWEST_PAIRS - 1))
    with pytest.raises(InputError, match="7 pairs of paths to train on"):
        fit_corrected(ensemble, dataset, few)
    with pytest.raises(InputError, match="a model without effects"):
        fit_corrected(replace(ensemble, effects=("soft",)), dataset, both)


def test_accuracy_is_reported_like_the_base(model: Corrected, both: Dataset) -> None:
    found = accuracy(model, both)
    assert found.n_test == round(TEST_PATHS * 60)
    assert found.version == model.version
    assert model.description["accuracy"] == found.to_json()
    assert found.outputs["inflation"].median_pct < 5


def test_saved_and_loaded(model: Corrected, tmp_path: Path) -> None:
    fitted = replace(at(model, 0.9, 0.1), samples=np.array([[0.9, 0.1], [0.92, 0.08]]))
    fitted.save(tmp_path / "m")
    again = Corrected.load(tmp_path / "m")
    assert again.version == fitted.version
    assert again.description == json.loads(json.dumps(model.description))
    some, paths = designs(5, 3), [PATH] * 5
    one, two = fitted.predict(some, paths), again.predict(some, paths)
    np.testing.assert_allclose(
        two.response.values, one.response.values, rtol=1e-6, atol=1e-12
    )
    np.testing.assert_array_equal(again.samples, fitted.samples)
    assert again.parameters == fitted.parameters


def _edit(name: str, key: str, value: object) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        content = json.loads((folder / name).read_text())
        content[key] = value
        (folder / name).write_text(json.dumps(content))

    return edit


def _cut(folder: Path) -> None:
    path = folder / "weights.safetensors"
    path.write_bytes(path.read_bytes()[:-1])


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (_edit("model.json", "schema", "pba-ensemble"), "not a pba-corrected"),
        (_edit("model.json", "schema_version", 9), "schema version 9; this program"),
        (_edit("model.json", "base_version", "0" * 12), "was learned on 000000000000"),
        (_edit("model.json", "effects", ["other"]), "does not match its version"),
        (_edit("model.json", "space", None), "damaged or incomplete"),
        (_cut, "damaged, or not the weights"),
        (lambda f: (f / "model.json").write_text("{"), "not JSON"),
        (lambda f: (f / "base" / "model.json").unlink(), "does not exist"),
    ],
)
def test_a_bad_model_is_one_clear_line(
    model: Corrected, tmp_path: Path, spoil: Callable[[Path], None], told: str
) -> None:
    model.save(tmp_path / "m")
    spoil(tmp_path / "m")
    with pytest.raises(FileError, match=told) as caught:
        Corrected.load(tmp_path / "m")
    assert "\n" not in str(caught.value)
