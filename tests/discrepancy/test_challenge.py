"""Sealed sets: reproducible, honest about what is hidden, and silent about it."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datagen.device import MATERIALS, Design
from datagen.effects import catalogue
from datagen.errors import EffectError, FileError, InputError
from datagen.levels import LEVELS
from datagen.model import Model
from datagen.response import Path as LoadPath
from discrepancy.challenge import NOISE, Challenge, Maker, Plan, make, parse_size
from discrepancy.laboratory import (
    FARTHEST,
    MESHES,
    draw_devices,
    programme,
    smooth_error,
    within,
)
from discrepancy.measurement import UNLOADING, Tolerances
from discrepancy.reading import read_measurements
from discrepancy.sealed import MANIFEST, MEASUREMENTS, TRUTH, Truth, seal, unseal
from discrepancy.unnamed import UNNAMED
from discrepancy.writing import measurements_text

SMALL = {"devices": 2, "pressures": 3, "level": "draft"}


@pytest.fixture(scope="module")
def hidden() -> Challenge:
    return make(Plan(seed=11, effects="self_weight", **SMALL))


@pytest.fixture(scope="module")
def nothing() -> Challenge:
    plan = Plan(seed=4, effects="none", unloading=True, stated=False, **SMALL)
    return make(replace(plan, pressures=2))


def test_a_seed_gives_the_same_set_bit_by_bit(hidden: Challenge) -> None:
    again = make(Plan(seed=11, effects="self_weight", **SMALL))
    assert measurements_text(again.measurements) == measurements_text(
        hidden.measurements
    )
    assert again.truth.text() == hidden.truth.text()


def test_another_seed_gives_another_laboratory() -> None:
    one, other = Maker(Plan(seed=1)), Maker(Plan(seed=2))
    assert one.stated != other.stated
    assert one.made != other.made


def test_what_is_hidden_does_not_change_the_laboratory() -> None:
    one, other = (Maker(Plan(seed=5, effects=e)) for e in ("none", "self_weight"))
    assert one.stated == other.stated
    assert one.made == other.made
    assert (one.top, one.hold) == (other.top, other.hold)


def test_the_file_is_a_measurement_file_and_says_nothing_more(
    hidden: Challenge, nothing: Challenge, tmp_path: Path
) -> None:
    seal(tmp_path / "set", measurements_text(hidden.measurements), hidden.truth)
    file = tmp_path / "set" / MEASUREMENTS
    read = read_measurements(file)
    assert read.devices == ("D1", "D2")
    assert read.warnings == ()
    text = file.read_text()
    assert not any(name in text for name in (*catalogue(), *UNNAMED, "truth", "seed"))
    # Columns and stated designs are those of a set without anything in it.
    rows = text.splitlines()
    plain = measurements_text(nothing.measurements).splitlines()
    kept = [name for name in rows[0].split(",") if "_std" not in name]
    assert [n for n in plain[0].split(",") if n != "branch"] == kept
    for curve in hidden.measurements.curves:
        true = Design(**hidden.truth.devices[curve.device])
        assert isinstance(curve.design, Design)
        assert set(curve.layers.values()) <= set(MATERIALS.values())
        assert curve.design != true
    # Readings end where the instrument's display does, with no digits of a solve.
    column = rows[0].split(",").index("inflation_mm")
    assert all(len(row.split(",")[column]) <= len("0.1234") for row in rows[1:])
    manifest = json.loads((tmp_path / "set" / MANIFEST).read_text())
    assert set(manifest) == {"schema", "sha256"}
    assert all(re.fullmatch("[0-9a-f]{64}", one) for one in manifest["sha256"].values())


def test_the_effect_has_the_size_that_was_asked_for(hidden: Challenge) -> None:
    (planted,) = hidden.truth.planted
    values = {planted.effect: planted.parameters}
    moved = 0.0
    path = LoadPath(np.array(hidden.truth.pressure))
    for design in (Design(**one) for one in hidden.truth.devices.values()):
        off = Model(level="draft")([design], [path])
        on = Model((planted.effect,), "draft", values)([design], [path])
        for name, std in NOISE.items():
            change = np.abs(on.output(name) - off.output(name)) / std
            moved = max(moved, float(change.max()))
    assert moved == pytest.approx(10.0, rel=0.05)
    assert planted.moved == pytest.approx(moved, rel=0.01)


def test_nuisances_are_within_their_tolerances(hidden: Challenge) -> None:
    truth = hidden.truth
    assert set(truth.batches) == {"A", "B"}
    for factor in truth.batches.values():
        assert 0 < abs(factor - 1) <= FARTHEST * 0.05
    for scale in truth.camera.values():
        assert 0 < abs(scale - 1) <= FARTHEST * 0.005
    for curve in hidden.measurements.curves:
        assert isinstance(curve.design, Design)
        true = Design(**truth.devices[curve.device])
        for name in ("upper_thickness", "lower_thickness"):
            off = getattr(true, name) - getattr(curve.design, name)
            assert 0 < abs(off) <= FARTHEST * 3e-6
        factors = {MATERIALS[name]: factor for name, factor in truth.batches.items()}
        stated = curve.design
        assert true.upper_modulus == pytest.approx(
            stated.upper_modulus * factors[stated.upper_modulus]
        )
        assert true.length == stated.length
    assert 0.005 <= truth.smooth <= 0.01


def test_with_nothing_planted_only_errors_are_left(nothing: Challenge) -> None:
    """Readings are those of the true devices but for scale, smooth errors and noise."""
    assert nothing.truth.kind == "none"
    assert nothing.truth.planted == ()
    for curve in nothing.measurements.curves:
        assert (curve.branch == UNLOADING).sum() == 1
        assert np.isnan(curve.std).all()
        design = Design(**nothing.truth.devices[curve.device])
        up = curve.load[: len(nothing.truth.pressure)]
        true = Model(level="draft")([design], [LoadPath(up)])
        scale = nothing.truth.camera[f"{curve.device} 1"]
        for name, std in NOISE.items():
            expected = true.output(name)[0]
            lack = curve.output(name)[: len(up)] - scale * expected
            largest = np.abs(expected).max()
            # 4 standard deviations of both, and 3 % for the mesh's other grading.
            bound = 4 * (std + nothing.truth.smooth * largest) + 0.03 * largest
            assert (np.abs(lack) < bound).all()
            assert np.abs(lack).max() > 0.1 * std


def test_readings_err_by_noise_smooth_errors_and_scale() -> None:
    """Of each alone, on curves that need no solve."""

    def lack(**options: object) -> tuple[np.ndarray, Maker]:
        maker = Maker(Plan(**({"seed": 8, "devices": 50, "pressures": 20} | options)))  # type: ignore[arg-type]
        schedule = programme(100e3, 20, unloading=False, runs=1, hold=5.0)
        true = np.broadcast_to(schedule.load[:, None] * 2e-9, (50, 1, 20, 2))
        curves = maker._measured(schedule, true.copy()).curves
        return np.array([c.values for c in curves]) - true[:, 0], maker

    exact = Tolerances(0.05, 3e-6, 0.0)
    noisy, _ = lack(smooth=(0.0, 0.0), tolerances=exact)
    assert noisy.std(axis=(0, 1)) == pytest.approx([3e-6, 2e-6], rel=0.05)
    flat = noisy - noisy.mean(axis=1, keepdims=True)
    neighbours = (flat[:, 1:] * flat[:, :-1]).mean() / (flat**2).mean()
    assert abs(neighbours) < 0.1  # independent, but for the mean taken off
    quiet = {"tip_deflection": 1e-9, "inflation": 1e-9}
    smooth, _ = lack(noise=quiet, smooth=(0.01, 0.01), tolerances=exact)
    assert np.sqrt((smooth**2).mean()) == pytest.approx(0.01 * 200e-6, rel=0.1)
    scaled, maker = lack(noise=quiet, smooth=(0.0, 0.0))
    top = scaled[:, -1] / 200e-6
    assert top == pytest.approx(np.repeat(maker.scales[::2, None] - 1, 2, 1), abs=2e-5)


def test_a_changed_truth_is_noticed(hidden: Challenge, tmp_path: Path) -> None:
    text = measurements_text(hidden.measurements)
    seal(tmp_path, text, hidden.truth)
    assert unseal(tmp_path) == hidden.truth
    for name in (TRUTH, MEASUREMENTS):
        file = tmp_path / name
        kept = file.read_bytes()
        file.write_bytes(kept.replace(b"0", b"1", 1))
        with pytest.raises(FileError, match=r"was changed after it was sealed"):
            unseal(tmp_path)
        file.write_bytes(kept)
    assert unseal(tmp_path) == hidden.truth
    with pytest.raises(FileError, match="holds a sealed set already"):
        seal(tmp_path, text, hidden.truth)
    (tmp_path / MANIFEST).unlink()  # as a kill would have left it
    seal(tmp_path, text, hidden.truth)
    (tmp_path / MANIFEST).write_text("{}")
    with pytest.raises(FileError, match="not the manifest"):
        unseal(tmp_path)


def test_nobody_elses_measurements_are_replaced(
    tmp_path: Path, hidden: Challenge
) -> None:
    text = measurements_text(hidden.measurements)
    (tmp_path / MEASUREMENTS).write_text("mine")
    with pytest.raises(FileError, match="is there already, and of no sealed set"):
        seal(tmp_path, text, hidden.truth)
    assert (tmp_path / MEASUREMENTS).read_text() == "mine"
    with pytest.raises(FileError, match="no folder to write to"):
        seal(tmp_path / MEASUREMENTS / "in", text, hidden.truth)


def test_a_truth_of_another_schema_is_refused(hidden: Challenge) -> None:
    with pytest.raises(ValueError, match="schema 1"):
        Truth.from_text(hidden.truth.text().replace('"schema": 1', '"schema": 9'))


def test_an_effect_that_moves_nothing_is_refused() -> None:
    with pytest.raises(InputError, match="mullins moves none of these readings"):
        make(Plan(seed=11, effects="mullins", **SMALL))


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("devices", 1, "devices: 1 is not allowed; allowed: a whole number, 2 to 50"),
        ("seed", -1, "seed: -1"),
        ("level", "coarse", "level: 'coarse'"),
        ("size", 0.0, "size: 0"),
        ("noise", {"stress": 1.0}, "noise: 'stress'"),
        ("noise", {"inflation": -1e-6}, "noise of inflation_mm: -0.001 mm"),
        ("smooth", (0.1, 0.0), "smooth: "),
    ],
)
def test_what_cannot_be_planned(field: str, value: object, words: str) -> None:
    with pytest.raises(InputError, match="^" + words.replace("(", r"\(")):
        Plan(**({"seed": 1} | {field: value}))  # type: ignore[arg-type]


def test_names_of_effects_are_checked_before_anything_is_solved() -> None:
    maker = Maker(Plan(seed=1, effects="self_weight,gravity"))
    with pytest.raises(EffectError, match=r"'gravity' is unknown; allowed: all, two"):
        maker.run()
    assert maker.solved == 0
    with pytest.raises(EffectError, match=r"edge_burr\+yeoh"):
        _ = Plan(seed=1, effects="edge_burr+yeoh").groups


def test_groups_of_names() -> None:
    assert Plan(seed=1, effects="none").groups == ((), {})
    assert Plan(seed=1, effects="yeoh,mooney").groups[0] == (("yeoh",), ("mooney",))
    assert Plan(seed=1, effects="yeoh+mooney").groups[0] == (("mooney", "yeoh"),)
    count = len(catalogue())
    assert len(Plan(seed=1).groups[0]) == count
    assert len(Plan(seed=1, effects="two").groups[0]) == count * (count - 1) / 2
    assert not set(Plan(seed=1, effects="unnamed").groups[1]) & set(catalogue())


def test_sizes() -> None:
    assert [parse_size(t) for t in ("small", "medium", "large", "5")] == [3, 10, 30, 5]
    with pytest.raises(InputError, match="size: 'huge'"):
        parse_size("huge")


def test_smooth_errors_have_size_one_and_are_smooth() -> None:
    rng = np.random.default_rng(0)
    place = np.linspace(0, 1, 101)
    drawn = np.array([smooth_error(rng, place) for _ in range(3000)])
    assert np.sqrt((drawn**2).mean()) == pytest.approx(1.0, abs=0.03)
    assert np.abs(drawn.mean(axis=0)).max() < 0.1
    neighbours = (drawn[:, 50] * drawn[:, 51]).mean() / (drawn[:, 50] ** 2).mean()
    assert neighbours > 0.99


def test_smooth_errors_of_both_ways_share_half_of_their_variance() -> None:
    rng = np.random.default_rng(0)
    up = np.linspace(0.1, 1, 10)
    place = np.concatenate([up, up[-2::-1]])
    drawn = np.array([smooth_error(rng, place) for _ in range(4000)])
    assert np.sqrt((drawn**2).mean()) == pytest.approx(1.0, abs=0.15)
    one, other = drawn[:, 1], drawn[:, -2]  # at one load, far apart in time
    assert np.corrcoef(one, other)[0, 1] == pytest.approx(0.5, abs=0.25)
    turn, before = drawn[:, 9], drawn[:, 8]
    assert np.corrcoef(turn, before)[0, 1] > 0.8


def test_nuisances_are_cut_normal() -> None:
    drawn = within(np.random.default_rng(0), 20000)
    assert np.abs(drawn).max() <= FARTHEST
    assert drawn.std() == pytest.approx(0.955, abs=0.02)  # of a normal cut at 2.5


def test_a_laboratory_has_both_batches_and_plausible_devices() -> None:
    for seed in range(20):
        designs = draw_devices(np.random.default_rng(seed), 6).values()
        moduli = {d.upper_modulus for d in designs} | {d.lower_modulus for d in designs}
        assert moduli == set(MATERIALS.values())
        assert len({d.cavity_height for d in designs}) == 1
        assert all(70e-6 <= d.upper_thickness <= 130e-6 for d in designs)
    divided = [
        d.divisions_x > 1
        for seed in range(40)
        for d in draw_devices(np.random.default_rng(seed), 6).values()
    ]
    assert 0.15 < np.mean(divided) < 0.35


def test_the_truth_has_load_steps_and_a_mesh_of_its_own() -> None:
    schedule = programme(70e3, 3, unloading=True, runs=2, hold=5.0)
    assert schedule.load.tolist() == [23e3, 47e3, 70e3, 47e3, 23e3]
    path, where = schedule.path(np.full((2, 5), 0.4))
    assert path.pressure[where].tolist() == [schedule.load.tolist()] * 2
    assert path.time is not None
    assert path.time[where] == pytest.approx(schedule.time)
    assert len(path.pressure) == 2 * 10 + 2  # and vented between the runs
    assert path.pressure[0] == pytest.approx(0.4 * 23e3)
    assert list(path.pressure[10:12]) == [0.0, 0.0]
    assert list(path.time[9:13] - path.time[9]) == [0.0, 5.0, 60.0, 62.0]
    for name, level in MESHES.items():
        assert level != LEVELS[name]


@pytest.mark.parametrize("name", UNNAMED)
def test_private_effects_are_sound_and_not_registered(name: str) -> None:
    """Through the door, with an equation; off they change nothing."""
    from datagen.device import named_device
    from datagen.problem import baseline

    assert name not in catalogue()
    one = UNNAMED[name]
    assert "=" in one.doc
    problem = baseline(named_device("S1"), LEVELS["draft"])
    assert one.apply(problem, one.off) is problem
    (parameter,) = one.parameters
    small = {parameter.name: 1e-9 * parameter.upper}
    changed = one.apply(problem, small)
    assert changed is not problem
    assert changed.nodes == pytest.approx(problem.nodes, rel=1e-6)
    assert changed.shear_modulus == pytest.approx(problem.shear_modulus, rel=1e-6)
