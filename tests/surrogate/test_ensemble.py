"""The trained model: physics built in, determinism, files."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from datagen.dataset import Dataset
from datagen.device import DESIGN_FIELDS, DESIGN_SPACE, Design, named_device
from datagen.errors import FileError, InputError
from datagen.response import OUTPUT_NAMES
from datagen.response import Path as LoadPath
from datagen.space import Parameter, Space
from surrogate.ensemble import Ensemble, stacked
from surrogate.split import held_out, training_rows
from surrogate.train import train
from tests.surrogate.conftest import QUICK
from tests.surrogate.synthetic import synthetic
from tests.surrogate.test_features import LENGTH_POWER

PATH = LoadPath(np.linspace(0, 120e3, 7))


def scaled(design: Design, length: float, modulus: float) -> Design:
    values = design.to_dict()
    for name in DESIGN_FIELDS:
        if name.endswith("modulus"):
            values[name] *= modulus
        elif not name.startswith("divisions"):
            values[name] *= length
    return Design(**values)  # type: ignore[arg-type]


def test_a_rescaled_device_gets_the_rescaled_answer(ensemble: Ensemble) -> None:
    design = named_device("D8-4x1", 2)
    length, modulus = 1.7, 0.6
    first = ensemble.predict([design], [PATH])
    other = ensemble.predict(
        [scaled(design, length, modulus)], [LoadPath(PATH.pressure * modulus)]
    )
    for o, name in enumerate(OUTPUT_NAMES):
        factor = length ** LENGTH_POWER[name]
        for mine, theirs in (
            (first.response.values, other.response.values),
            (first.response.std, other.response.std),
            (first.high, other.high),
        ):
            np.testing.assert_allclose(theirs[..., o], factor * mine[..., o], rtol=1e-8)
    ours = ensemble.limit_pressure([design]).pressure * modulus
    theirs = ensemble.limit_pressure([scaled(design, length, modulus)]).pressure
    np.testing.assert_allclose(theirs, ours, rtol=1e-9)


def test_members_that_had_not_seen_a_design_err_more(
    ensemble: Ensemble, dataset: Dataset
) -> None:
    rows = training_rows(dataset)[3::2]
    unseen = ensemble.unseen_by(dataset, rows)
    assert unseen.shape == (QUICK.repeats, len(rows))
    paths = [LoadPath(dataset.pressure[row, : dataset.steps(row)]) for row in rows]
    pressure = stacked([dataset.design(row) for row in rows], paths)
    answers, _ = ensemble._answers(
        ensemble._prepared([dataset.design(row) for row in rows]), pressure
    )
    values = dataset.values[rows][:, : pressure.shape[1]]
    error = np.nanmedian(np.abs(answers.values - values) / values, axis=(2, 3))
    own = np.zeros(error.shape, dtype=bool)
    own[unseen, np.arange(len(rows))] = True
    assert np.median(error[own]) > 1.2 * np.median(error[~own])


def test_what_members_have_seen_is_known_of_their_own_dataset(
    ensemble: Ensemble, dataset: Dataset
) -> None:
    with pytest.raises(InputError, match=r"dataset: .* as trained on"):
        ensemble.unseen_by(synthetic(240, seed=4), np.array([0]))
    for row in (np.flatnonzero(held_out(dataset))[0], len(dataset)):
        with pytest.raises(InputError, match="designs that were trained on"):
            ensemble.unseen_by(dataset, np.array([row]))


def test_no_response_at_zero_pressure(ensemble: Ensemble) -> None:
    found = ensemble.predict([named_device()], [PATH], 0.99)
    for array in (found.response.values, found.response.std, found.low, found.high):
        assert (array[:, 0] == 0).all()
        assert (array[:, 1:] != 0).all()


def test_intervals_nest_and_std_is_one_deviation(ensemble: Ensemble) -> None:
    design = [named_device("S1", 2)]
    half = [
        ensemble.predict(design, [PATH], c).high - ensemble(design, [PATH]).values
        for c in (0.5, 0.6827, 0.9, 0.99)
    ]
    assert (np.diff([h[0, 1:] for h in half], axis=0) > 0).all()
    np.testing.assert_allclose(half[1], ensemble(design, [PATH]).std, rtol=1e-3)


def test_batch_equals_single(ensemble: Ensemble, dataset: Dataset) -> None:
    designs = [dataset.design(i) for i in range(30)]
    paths = [LoadPath(np.linspace(5e3, 1e5, 2 + i % 5)) for i in range(30)]
    both = ensemble(designs, paths)
    assert both.values.shape == (30, 6, 5)
    for i, (design, path) in enumerate(zip(designs, paths, strict=True)):
        single = ensemble([design], [path])
        steps = len(path.pressure)
        # Matrix products of other sizes sum in another order.
        np.testing.assert_allclose(both.values[i, :steps], single.values[0], rtol=1e-9)
        assert np.isnan(both.values[i, steps:]).all()
        assert (both.status[i, :steps] == "converged").all()
        assert (both.status[i, steps:] == "no_step").all()
    again = ensemble(designs, paths)
    np.testing.assert_array_equal(both.values, again.values)


def test_fast(ensemble: Ensemble) -> None:
    design, path = [named_device()], [LoadPath(np.linspace(0, 140e3, 15))]
    ensemble.predict(design, path)
    seconds = []
    for _ in range(30):
        start = time.perf_counter()
        ensemble.predict(design, path)
        seconds.append(time.perf_counter() - start)
    # A fifth of this on a free core; the bound leaves room for a busy machine.
    assert min(seconds) < 5e-3


def test_answers_without_torch(ensemble: Ensemble, tmp_path: Path) -> None:
    ensemble.save(tmp_path)
    program = (
        "import sys, numpy as np\n"
        "from surrogate.ensemble import Ensemble\n"
        "from datagen.device import named_device\n"
        "from datagen.response import Path\n"
        f"e = Ensemble.load({str(tmp_path)!r})\n"
        "e.predict([named_device()], [Path(np.array([1e4]))])\n"
        "print([m for m in ('torch', 'pickle5', 'h5py') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_saved_and_loaded(ensemble: Ensemble, tmp_path: Path) -> None:
    ensemble.save(tmp_path / "model")
    assert sorted(p.name for p in (tmp_path / "model").iterdir()) == [
        "model.json",
        "weights.safetensors",
    ]
    back = Ensemble.load(tmp_path / "model")
    assert back.version == ensemble.version
    assert len(back.version) == 12
    assert back.description == json.loads(json.dumps(ensemble.description))
    one, two = (
        model.predict([named_device("D8-2x2", 3)], [PATH], 0.8)
        for model in (ensemble, back)
    )
    np.testing.assert_array_equal(one.response.values, two.response.values)
    np.testing.assert_array_equal(one.low, two.low)
    design, pressure = named_device(), np.array([2e4, 9e5])
    assert back.check(design, pressure).reasons == (
        ensemble.check(design, pressure).reasons
    )


def test_a_save_that_was_killed_leaves_one_model_whole(
    ensemble: Ensemble, tmp_path: Path
) -> None:
    """The new weights wait beside the old ones until `model.json` names them."""
    ensemble.save(tmp_path)
    weights, fresh = (tmp_path / f"weights.safetensors{end}" for end in ("", ".new"))
    whole = weights.read_bytes()
    fresh.write_bytes(b"of a model that never came")
    assert Ensemble.load(tmp_path).version == ensemble.version
    fresh.write_bytes(whole)
    weights.write_bytes(b"of the model before")
    assert Ensemble.load(tmp_path).version == ensemble.version
    ensemble.save(tmp_path)
    assert weights.read_bytes() == whole and not fresh.exists()


def _flip(path: Path, place: int) -> None:
    content = bytearray(path.read_bytes())
    content[place] ^= 1
    path.write_bytes(bytes(content))


def _edit(path: Path, key: str, value: object) -> None:
    model = json.loads(path.read_text())
    model[key] = value
    path.write_text(json.dumps(model))


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda f: (f / "model.json").unlink(), "model.json: does not exist"),
        (lambda f: (f / "weights.safetensors").unlink(), "safetensors: does not exist"),
        (lambda f: _flip(f / "weights.safetensors", -5), "safetensors: damaged"),
        (lambda f: (f / "model.json").write_text("{"), "model.json: not JSON"),
        (lambda f: (f / "model.json").write_bytes(b"\xff\xfe"), "model.json: not JSON"),
        (lambda f: (f / "model.json").write_text("[1]"), "not a pba-ensemble"),
        (lambda f: _edit(f / "model.json", "schema_version", 9), "schema version 9;"),
        (lambda f: _edit(f / "model.json", "features_version", 0), "features version"),
        (lambda f: _edit(f / "model.json", "outputs", 4), "model.json: damaged"),
        (lambda f: _edit(f / "model.json", "space", 3), "model.json: damaged"),
        (lambda f: _edit(f / "model.json", "allowed_distance", 9.0), "its version"),
    ],
)
def test_a_damaged_model_is_refused_in_one_line(
    ensemble: Ensemble, tmp_path: Path, damage: object, reason: str
) -> None:
    ensemble.save(tmp_path)
    damage(tmp_path)  # type: ignore[operator]
    with pytest.raises(FileError) as caught:
        Ensemble.load(tmp_path)
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_bad_requests(ensemble: Ensemble) -> None:
    with pytest.raises(InputError, match="paths"):
        ensemble([named_device()], [PATH, PATH])
    with pytest.raises(InputError, match="paths"):
        ensemble([], [])
    with pytest.raises(InputError, match=r"coverage: 0\.3 is not allowed"):
        ensemble.predict([named_device()], [PATH], 0.3)
    with pytest.raises(InputError, match="none, without effects"):
        ensemble.with_parameters({"self_weight": {"density": 1.0}})


def test_a_model_with_an_effect(tmp_path: Path) -> None:
    """Tilt moves the tip without pressure, in proportion to the length."""
    tilt = Parameter("tilt.angle", "rad", -0.2, 0.2, off=0.0)
    data = synthetic(120, 5, Space((*DESIGN_SPACE.parameters, tilt)))
    model = train(data, settings=QUICK)
    assert model.effects == ("tilt",)
    design, path = named_device("D8-1x1", 3), LoadPath(np.array([1.0, 4e4]))
    up, off, down = (
        model.with_parameters(values)([design], [path]).output("bending_angle")[0]
        for values in ({"tilt": {"angle": 0.15}}, {}, {"tilt": {"angle": -0.15}})
    )
    np.testing.assert_allclose(up - down, 0.3, rtol=0.2)
    np.testing.assert_allclose(up - off, 0.15, rtol=0.3)
    model.with_parameters({"tilt": {"angle": 0.1}}).save(tmp_path)
    assert Ensemble.load(tmp_path).parameters == {"tilt": {"angle": 0.1}}
    out = model.with_parameters({"tilt": {"angle": 0.5}}).check(design, path.pressure)
    assert "tilt.angle: 0.5 is above the trained range -0.2 to 0.2" in out.reasons
    with pytest.raises(InputError, match=r"tilt\.slope"):
        model.with_parameters({"tilt": {"slope": 1.0}})
