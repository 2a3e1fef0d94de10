"""Few devices, and not all measured alike: what is said then, and that it is true."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datagen.device import named_device
from datagen.errors import InputError
from datagen.model import Model
from datagen.specimens import Bulge
from discrepancy.adopt import adopt
from discrepancy.adopt_report import adopt_report
from discrepancy.compare import INFERRED, REPEATS, STATED, compare, noise_source
from discrepancy.evidence import fit
from discrepancy.experiment import (
    BULGE_NOISE,
    _joined,
    _Like,
    _membrane,
    _of_device,
    proposals,
)
from discrepancy.heldout import held_out
from discrepancy.measurement import Curve, Measurements
from discrepancy.missing import CLAIM
from discrepancy.rank import Search
from discrepancy.regions import regions
from discrepancy.repeats import at_rest_alone
from discrepancy.report import report
from discrepancy.version import ModelVersion
from tests.discrepancy import synthetic
from tests.discrepancy.strips import strip, study


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("solves")


def test_the_only_device_of_unknown_noise_is_left_out_too() -> None:
    one, _ = synthetic.devices(np.random.default_rng(0), 3)
    readings = one.readings
    known = fit(readings, one.hypothesis)
    for unknown in ([1], [1, 2]):
        stated = ~np.isin(readings.device, unknown)
        mixed = fit(replace(readings, stated=stated), one.hypothesis)
        assert held_out(mixed) == pytest.approx(held_out(known), rel=0.3)


def test_smooth_errors_bend_a_curve_over_its_own_range() -> None:
    """Also that of a device which was measured to a tenth of the others' pressure."""
    one, _ = synthetic.devices(np.random.default_rng(0), 2)
    readings, at = one.readings, np.flatnonzero(one.readings.device == 0)
    low = replace(readings, place=readings.place / 10, path=readings.path / 10)
    assert low.smooth(at) == pytest.approx(readings.smooth(at), rel=1e-12)


@pytest.mark.parametrize("thin", [None, 4])
def test_regions_are_the_same_in_blocks(
    monkeypatch: pytest.MonkeyPatch, thin: int | None
) -> None:
    one, labels = synthetic.devices(
        np.random.default_rng(3), 8, effect=0.1, thin=thin, begin=0.3
    )
    p, whole = regions(one, labels)
    monkeypatch.setattr("discrepancy.regions.BLOCK", 7)
    again, parts = regions(one, labels)
    assert (again, len(parts)) == (p, len(whole)) and whole
    assert [r.size for r in parts] == pytest.approx([r.size for r in whole])
    assert [r.trait for r in parts] == [r.trait for r in whole]


def test_strips_with_and_without_stated_noise(cache: Path) -> None:
    curves = [strip("T1"), strip("T2", seed=2, stated=False), strip("T3", seed=3)]
    here = study(curves, cache)
    assert compare(here).p_value < CLAIM
    assert noise_source(here, 0) == INFERRED
    ranking = Search(here).run()
    assert ranking.verdict == "identified"
    assert ranking.effects == ("strain_stiffening",)


def test_what_is_read_at_rest_alone_accuses_nothing(cache: Path) -> None:
    """Nothing tells its noise, and the baseline is zero there."""
    still = replace(
        strip("T0", stated=False),
        load=np.ones(1),
        branch=np.array(["loading"]),
        values=np.array([[2e3]]),
        std=np.array([[np.nan]]),
    )
    with pytest.raises(InputError, match="readings: 'at rest alone' is not allowed"):
        study([still], cache)
    assert compare(study([replace(still, std=np.array([[2e3]]))], cache)).p_value > 0.1
    # With others under load its noise is guessed from theirs.
    assert len(study([still, strip("T1", stated=False)], cache).readings.value) == 10
    device = replace(
        still,
        device="S1",
        design=named_device("S1"),
        load=np.array([50.0, 10e3]),  # what a gauge shows at rest
        branch=np.array(["loading"] * 2),
        outputs=("tip_deflection", "inflation"),
        values=np.array([[1e-6, 1e-6], [np.nan, 1e-4]]),
        std=np.full((2, 2), np.nan),
    )
    cells = [(0, 0, 0), (0, 0, 1), (0, 1, 1)]
    found = at_rest_alone(Measurements((device,)), cells)
    assert found == (("actuator", "tip_deflection"),)


def test_noise_is_told_as_it_was_found(cache: Path) -> None:
    assert noise_source(study([strip("T1")], cache), 0) == STATED
    blank = strip("T1")
    std = blank.std.copy()
    std[3] = np.nan  # is like those of its curve
    assert noise_source(study([replace(blank, std=std)], cache), 0) == STATED
    runs = [replace(strip("T1", seed=i, stated=False), run=i) for i in (1, 2)]
    assert noise_source(study(runs, cache), 0) == REPEATS


def test_one_specimen_alone_is_reported_without_a_number_that_is_none(
    cache: Path,
) -> None:
    here = study([strip("T1")], cache)
    ranking = Search(here).run()
    assert math.isnan(ranking.baseline_error)
    page = report(here, ranking)
    text = page.partition("<script")[0]
    assert "there is but one" in text and " nan " not in text
    plain = study([strip("T1", model=Model((), "draft"))], cache)
    made = adopt(plain, ("strain_stiffening",))
    assert any("only one device" in line for line in made.warnings)
    assert any("is not needed" in line for line in made.warnings)


def test_the_report_says_which_way_the_error_goes(cache: Path) -> None:
    plain = Model((), "draft")
    curves = [strip(f"T{i}", seed=i, model=plain) for i in (1, 2, 3)]
    made = adopt(study(curves, cache), ("strain_stiffening",))
    first, last = made.ladder[0].heldout_error, made.ladder[-2].heldout_error
    way = "falls" if last < first else "rises"
    page = adopt_report(made, ModelVersion.of(made))
    assert f"the error {way} from {first:.2f} to {last:.2f}" in page
    assert last > first  # or the sentence for it was not tried


# -- what to measure next --------------------------------------------------------------

S1 = named_device("S1")
LOAD = np.array([10e3, 20e3, 35e3, 50e3])


def test_what_is_not_read_yet_says_nothing_of_what_was(cache: Path) -> None:
    """Its placeholders are no sizes, no noise and no repeated runs."""
    here = study([strip("T1", stated=False)], cache)
    noise = np.full(len(here.readings.value), 7e3)
    for _, curve in proposals(here, ["strain_stiffening"], noise):
        assert (curve.std == 7e3).all()
        more = study([*here.measurements.curves, curve], cache)
        new = np.array([c == 1 for c, _, _ in more.cells])
        readings = _joined(here, more, new)
        for name in ("noise", "stated", "scale"):
            was, now = getattr(here.readings, name), getattr(readings, name)[~new]
            assert np.array_equal(was, now)
        assert (readings.scale[new] < 10 * here.readings.scale.max()).all()


def device(outputs: tuple[str, ...], orientation: float, sign: float) -> Curve:
    shape = (len(LOAD), len(outputs))
    return Curve(
        device="A",
        run=1,
        orientation=orientation,
        design=S1,
        load=sign * LOAD,
        time=None,
        branch=np.full(len(LOAD), "loading"),
        outputs=outputs,
        values=np.ones(shape),
        std=np.ones(shape),
    )


@pytest.mark.parametrize(
    ("outputs", "noise", "wanted"),
    [
        (("inflation", "cavity_volume"), [2e-6, 1e-11], 2e-6),
        (("inflation", "bending_angle"), [2e-6, 1e-3], 2e-6),
        (("tip_deflection",), [4e-6], 4e-6),
        (("bending_angle",), [1e-3], BULGE_NOISE),
        (("inflation",), [math.nan], BULGE_NOISE),
    ],
)
def test_a_membrane_is_read_as_lengths_are(
    outputs: tuple[str, ...], noise: list[float], wanted: float
) -> None:
    like = _Like(device(outputs, 0.0, 1.0), np.array(noise), 2)
    _, curve = _membrane(like, S1)
    assert isinstance(curve.design, Bulge)
    assert (curve.std == wanted).all()


@pytest.mark.parametrize(
    ("degrees", "words"),
    [(0, "orientation_deg 180"), (180, "orientation_deg 0"), (90, None)],
)
def test_over_is_the_other_way_round(degrees: float, words: str | None) -> None:
    like = _Like(device(("inflation",), math.radians(degrees), 1.0), np.ones(1), 2)
    found = {text: curve for text, curve in _of_device(like, S1) if " over" in text}
    assert len(found) == (words is not None)
    for text, curve in found.items():
        assert words is not None and f"({words})" in text
        assert math.degrees(curve.orientation) == pytest.approx(180 - degrees)


def test_vacuum_stays_vacuum() -> None:
    like = _Like(device(("inflation",), 0.0, -0.05), np.ones(1), 2)
    for _, curve in _of_device(like, S1):
        assert (curve.load <= 0).all()
