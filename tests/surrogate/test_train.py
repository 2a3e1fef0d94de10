"""Training: repeatable, split by design, robust to failed paths, interruptible."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from datagen.dataset import Dataset
from datagen.errors import InputError
from datagen.space import Parameter, Space
from datagen.worker import STEP_STATUS
from surrogate import train as training
from surrogate.ensemble import Ensemble
from surrogate.features import columns_of, features, prepare, term_owners
from surrogate.network import FitSettings, Rows, fit, one_thread
from surrogate.split import folds, held_out, is_test
from surrogate.train import TrainSettings, fit_terms, train
from tests.surrogate.conftest import QUICK
from tests.surrogate.synthetic import response, synthetic

TINY = TrainSettings(
    folds=3,
    repeats=2,
    response=FitSettings(hidden=(8,), steps=60, batch=64, check_every=20),
    limit=FitSettings(hidden=(4,), steps=40, batch=32, check_every=20),
)


SPARE = Parameter("spare", "1", 0.0, 0.02, off=0.0, source="a test")


@pytest.fixture(scope="module")
def small() -> Dataset:
    return synthetic(60, 11)


def test_repeats_bit_by_bit(small: Dataset) -> None:
    first = train(small, seed=4, settings=TINY)
    torch.manual_seed(999)  # nothing may depend on the global generator
    assert train(small, seed=4, settings=TINY).version == first.version
    assert train(small, seed=5, settings=TINY).version != first.version


def test_test_designs_are_never_seen(small: Dataset) -> None:
    held = is_test(small.inputs)
    assert held.any()
    spoiled = small.values.copy()
    spoiled[held] *= 100
    other = replace(small, values=spoiled)
    assert train(other, settings=TINY).version == train(small, settings=TINY).version


def test_only_converged_steps_are_used(small: Dataset) -> None:
    """Failed steps may hold any number: nothing depends on it."""
    status = small.status.copy()
    code = STEP_STATUS.index("step_too_small")
    failed = np.flatnonzero(~is_test(small.inputs))[:15]
    for i in failed:
        status[i, small.steps(i) // 2 :] = code
    first = replace(small, status=status)
    wild = small.values.copy()
    wild[status != 0] = 1e30
    second = replace(first, values=wild)
    one, two = (train(data, settings=TINY) for data in (first, second))
    assert one.version == two.version
    assert one.description["train_steps"] == int(
        (status[~is_test(small.inputs)] == 0).sum()
    )


def test_a_path_without_a_single_step_is_left_out(small: Dataset) -> None:
    status = small.status.copy()
    lost = np.flatnonzero(~is_test(small.inputs))[:2]
    status[lost] = STEP_STATUS.index("step_too_small")
    found = train(replace(small, status=status), settings=TINY)
    assert found.description["n_train"] == (~is_test(small.inputs)).sum() - 2


def test_too_few_designs(small: Dataset) -> None:
    with pytest.raises(InputError, match="at least 20"):
        train(small.subset(range(15)), settings=TINY)


def test_progress_and_interrupt(small: Dataset) -> None:
    seen: list[tuple[str, int, int, float]] = []
    train(small, settings=TINY, progress=lambda *state: seen.append(state))
    assert [s[1] for s in seen if s[0] == "response"] == [20, 40, 60]
    assert all(np.isfinite(s[3]) for s in seen)

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    threads = torch.get_num_threads()
    with pytest.raises(KeyboardInterrupt):
        train(small, settings=TINY, progress=stop)
    assert torch.get_num_threads() == threads


def test_stops_early_and_keeps_the_best() -> None:
    """Pure noise: the held-out loss only rises once the network begins to fit."""
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(60, 6)), torch.tensor(rng.normal(size=60)).float()
    held = np.arange(60)[None, :] % 3 == np.arange(3)[:, None]
    rows = Rows(np.arange(60), np.ones(60, dtype=int), held)
    looks: list[float] = []

    def loss(answers: torch.Tensor, picked: torch.Tensor) -> torch.Tensor:
        return (answers[..., 0] - y[picked]) ** 2

    settings = FitSettings(
        hidden=(64,),
        steps=5000,
        batch=64,
        decay=0.0,
        check_every=10,
        patience=5,
    )
    with one_thread():
        stack, report = fit(
            x, rows, 1, loss, settings, 0, progress=lambda *s: looks.append(s[3])
        )
    assert len(looks) < 100
    assert report["loss"] == min(looks)
    assert looks.index(min(looks)) == len(looks) - 6
    answers = stack(x)[..., 0]
    own = np.mean([(answers[m] - y.numpy())[held[m]] ** 2 for m in range(3)])
    assert own == pytest.approx(report["loss"], rel=1e-4)


def test_a_design_counts_once_however_long_its_path(monkeypatch) -> None:  # type: ignore[no-untyped-def]
    """One design with 1000 rows and one with a single row pull alike."""
    x = np.zeros((1002, 1))
    y = torch.cat([torch.zeros(1000), torch.ones(1), torch.full((1,), 0.5)])
    rows = Rows(
        np.array([0, 1000, 1001]), np.array([1000, 1, 1]), np.eye(3, dtype=bool)[2:]
    )

    def loss(answers: torch.Tensor, picked: torch.Tensor) -> torch.Tensor:
        return (answers[..., 0] - y[picked]) ** 2

    settings = FitSettings(hidden=(4,), steps=600, batch=256, rate=1e-2, decay=0.0)
    stack, _ = fit(x, rows, 1, loss, settings, 0)
    assert stack(np.zeros((1, 1)))[0, 0, 0] == pytest.approx(0.5, abs=0.05)


def test_learns_what_closed_forms_do_not_know(
    ensemble: Ensemble, dataset: Dataset
) -> None:
    """Better than the closed forms with their best constant weights."""
    untrained = replace(QUICK, response=replace(QUICK.response, rate=0.0))
    before = train(dataset, seed=1, settings=untrained).description["accuracy"]
    after = ensemble.description["accuracy"]
    for name in ("inflation_mm", "inflation_lower_mm", "cavity_volume_uL"):
        old, new = before["outputs"][name], after["outputs"][name]
        assert new["median_pct"] < 0.35 * old["median_pct"]
        assert new["median_pct"] < 3
    assert after["outputs"]["tip_deflection_mm"]["r2"] > 0.7


def test_scale_floor(dataset: Dataset) -> None:
    """A path along which the terms cancel is not divided by next to nothing."""
    rows = np.arange(20)
    data = dataset.subset(rows)
    converged = data.status == 0
    values = np.where(converged[..., None], data.values, 0.0)
    own = prepare(columns_of(data.variables, data.inputs), data.space)
    pressure = np.where(converged, data.pressure, 0.0)
    terms = features(own, pressure, own.limit_scale).terms
    owner = term_owners(effects=False)
    flat = values.copy()
    flat[0, :, 0] *= 1e-9
    scale = training.path_scale(flat, terms, owner)
    largest = np.abs(terms[0][:, owner == 0]).max()
    assert scale[0, 0] == pytest.approx(training.SCALE_FLOOR * largest)
    assert scale[1, 2] == np.abs(values[1, :, 2]).max()


def test_mirror_images_of_designs_are_shown_too(small: Dataset) -> None:
    """The views' outputs are those of the strip with its layers exchanged."""
    plain, over = training._views(small)
    for i in (0, 7):
        design = dict(zip(small.variables, map(float, small.inputs[i]), strict=True))
        for kind in ("thickness", "modulus"):
            pair = (f"upper_{kind}", f"lower_{kind}")
            design[pair[0]], design[pair[1]] = design[pair[1]], design[pair[0]]
        spacer = float(small.inputs[i, small.variables.index("lower_modulus")])
        steps = small.steps(i)
        exact = response(design, small.pressure[i, :steps], spacer)
        np.testing.assert_allclose(over.values[i, :steps], exact, rtol=1e-9)
        assert over.prepared.columns["spacer_modulus"][i] == spacer
        assert plain.prepared.columns["spacer_modulus"][i] == spacer
    assert len(training._views(replace(small, effects=("self_weight",)))) == 1


def test_no_surrogate_learns_of_time_or_history(small: Dataset) -> None:
    for effect, parameter in (
        ("viscoelasticity", "beta_10"),
        ("mullins", "softening"),
        ("swelling", "strain"),
    ):
        name = f"{effect}.{parameter}"
        timed = replace(
            small,
            effects=(effect,),
            variables=(*small.variables, name),
            inputs=np.column_stack([small.inputs, np.full(len(small), 0.01)]),
            space=Space((*small.space.parameters, replace(SPARE, name=name))),
        )
        with pytest.raises(InputError, match="knows no time and no history"):
            train(timed, seed=1, settings=TINY)


def test_where_a_path_was_lost_the_range_ends(small: Dataset) -> None:
    """Nothing is known past it, and a limit is not far."""
    rows = np.flatnonzero(np.isnan(small.limit_pressure) & ~held_out(small))
    lost = list(small.path_status)
    for row in rows:
        lost[row] = "step_too_small"
    shortened = replace(small, path_status=tuple(lost))
    plain, wary = (train(one, seed=1, settings=TINY) for one in (small, shortened))
    met = plain.description["limit_fit"]["limit_points"]
    assert wary.description["limit_fit"]["limit_points"] == met + len(rows)


def test_constant_weights_belong_to_their_terms() -> None:
    """Terms of an output need not stand one after another."""
    rng = np.random.default_rng(1)
    designs, each = 30, 4
    point, terms = rng.normal(size=(designs * each, 3)), rng.normal(size=(120, 4))
    owner, weights = np.array([0, 1, 1, 0]), np.array([3.0, -2.0, 5.0, 0.5])
    target = np.stack(
        [(terms * weights)[:, owner == o].sum(axis=1) for o in range(2)], axis=1
    )
    found, _ = fit_terms(
        point,
        terms,
        target,
        np.full(designs, each),
        (owner, np.zeros(4, dtype=bool)),
        folds(designs, 3, 1, 0),
        0,
        FitSettings(hidden=(4,), steps=1, batch=8, check_every=1),
        1.0,
        "test",
        None,
        ridge=1e-9,
    )
    np.testing.assert_allclose(found.base, weights, rtol=1e-6)


def test_a_design_that_counts_more_often() -> None:
    """As much as if it stood there that often."""
    rng = np.random.default_rng(2)
    designs, each = 12, 3
    point, terms = rng.normal(size=(36, 2)), rng.normal(size=(36, 2))
    target = rng.normal(size=(36, 1))
    often = np.ones(designs, dtype=int)
    often[:2] = 3
    rows = np.concatenate([np.arange(6), np.arange(6), np.arange(36)])
    settings = FitSettings(hidden=(4,), steps=1, batch=8, check_every=1)

    def weights(chosen: np.ndarray, times: np.ndarray | None) -> np.ndarray:
        count = np.full(len(chosen) // each, each)
        found, _ = fit_terms(
            point[chosen],
            terms[chosen],
            target[chosen],
            count,
            (np.zeros(2, dtype=int), np.zeros(2, dtype=bool)),
            folds(len(count), 3, 1, 0),
            0,
            settings,
            1.0,
            "test",
            None,
            often=times,
        )
        return found.base

    np.testing.assert_allclose(
        weights(np.arange(36), often), weights(rows, None), rtol=1e-9
    )
