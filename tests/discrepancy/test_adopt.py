"""Adoption: the fit, the ladder of held-out errors, corrected curves, the report."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datagen.device import Design
from datagen.errors import EffectError, InputError
from datagen.model import Model
from discrepancy.adopt import adopt, emulation_error, joined, resampled
from discrepancy.adopt_figures import ladder_figure
from discrepancy.adopt_report import adopt_report
from discrepancy.experiment import proposals
from discrepancy.heldout import floor_interval, left_out, noise_floor
from discrepancy.ladder import Judged, Rung, ladder
from discrepancy.measurement import Measurements, Tolerances
from discrepancy.sharpen import Sharpening, deviations, sharpen
from discrepancy.version import ModelVersion, rung_json
from tests.discrepancy.adopted import (
    EFFECTS,
    NOISE,
    PLANTED,
    adopted,
    measurements,
    study,
)
from tests.discrepancy.synthetic import devices, residuals
from tests.discrepancy.test_report import Page

# -- the statistics of the ladder, without finite elements ---------------------------


def test_the_error_is_the_root_mean_square_of_all_readings() -> None:
    given = np.array([3.0, 4.0, 0.0, 0.0, 1.0])
    found = Judged.of([given], np.array([0, 0, 1, 1, 1]))
    assert found.error(0)[0] == pytest.approx(math.sqrt(26 / 5))
    assert found.counts.tolist() == [2, 3]


@pytest.mark.parametrize("count", [2, 3, 6, 12])
def test_intervals_hold_the_true_error(count: int) -> None:
    rng = np.random.default_rng(3)
    inside, sets = 0, 300
    for _ in range(sets):
        one = Judged.of(*residuals((2.0,), count, rng))
        value, low, high = one.error(0)
        assert 0 < low <= value <= high
        inside += low < 2.0 < high
    assert 0.82 < inside / sets < 0.95


@pytest.mark.parametrize("count", [3, 6, 12])
def test_a_step_that_is_none_is_seldom_clear(count: int) -> None:
    """And one to two thirds of the error is, with six devices or more."""
    rng = np.random.default_rng(4)
    sets, clear, found = 300, 0, 0
    for _ in range(sets):
        one = Judged.of(*residuals((2.0, 2.0, 1.33), count, rng))
        clear += one.ratio(1, 0)[2] < 1
        found += one.ratio(2, 1)[2] < 1
    assert clear / sets < 0.12
    assert found / sets > (0.3 if count < 6 else 0.95)


def test_a_step_is_judged_by_pairs_of_devices() -> None:
    """What makes some devices hard for both models does not blur their ratio."""
    rng = np.random.default_rng(4)
    device = np.repeat(np.arange(8), 6)
    hard = np.exp(rng.standard_normal(8))[device]
    before = hard * (1 + 0.05 * rng.standard_normal(len(device)))
    found = Judged.of([before, 0.8 * before], device)
    value, low, high = found.ratio(1, 0)
    assert value == pytest.approx(0.8) and low == pytest.approx(high)
    assert found.error(1)[2] > found.error(0)[1]  # apart they overlap


def test_one_device_has_no_interval() -> None:
    nothing = np.full(4, np.nan)
    models = [
        ("baseline", (), np.ones(4), math.nan),
        ("recalibrated", (), nothing, -3.0),
    ]
    rungs, method = ladder(models, np.zeros(4, dtype=int), 1.2, (1.0, 1.4))
    assert method == "none"
    assert rungs[0].heldout_error == 1 and math.isnan(rungs[0].low)
    assert math.isnan(rungs[1].heldout_error) and not rungs[1].helps
    assert (rungs[2].name, rungs[2].low, rungs[2].high) == ("noise floor", 1.0, 1.4)


def test_the_floor_is_where_a_right_model_errs() -> None:
    """Held-out errors of many made-up sets in which nothing is missing."""
    rng = np.random.default_rng(5)
    inside, sets = 0, 60
    for i in range(sets):
        one, _ = devices(rng, 6)
        low, high = floor_interval(one, i, draws=400)
        assert low < noise_floor(one) < high
        error = math.sqrt(float(np.mean(left_out(one) ** 2)))
        inside += low < error < high
    assert 0.78 <= inside / sets <= 0.99
    bent, _ = devices(rng, 6, calibrated=False)  # smooth errors alone
    low, high = floor_interval(bent, 0)
    assert 1.5 < low < noise_floor(bent) < high


def test_rungs_check_themselves() -> None:
    with pytest.raises(InputError, match="heldout_error"):
        Rung("x", (), -1.0, 0.0, 1.0)
    with pytest.raises(InputError, match="low"):
        Rung("x", (), 1.0, 2.0, 1.0)


def test_resampling_is_as_often_as_the_weights_say() -> None:
    weights = np.array([0.5, 0.0, 0.301, 0.199])
    for seed in range(20):
        counts = np.bincount(resampled(weights, 100, seed), minlength=4)
        assert counts.sum() == 100 and counts[1] == 0
        assert np.abs(counts - 100 * weights).max() < 1


# -- with finite elements ------------------------------------------------------------


def test_the_planted_effect_comes_back() -> None:
    made = adopted("cure_mismatch")
    low, high = made.fit.interval(0.99)[0]
    assert low < PLANTED < high and high - low < 0.3 * abs(PLANTED)
    assert made.names == ("cure_mismatch.difference",)
    assert made.parameters["difference"]["value"] == made.mean[0]
    assert made.covariance[0, 0] == pytest.approx(made.fit.std()[0] ** 2)
    assert made.samples.shape == (200, 1)
    assert made.samples.mean() == pytest.approx(
        made.mean[0], abs=0.1 * made.samples.std()
    )


def test_the_error_falls_on_devices_that_were_left_out() -> None:
    made = adopted("cure_mismatch")
    baseline, recalibrated, with_it, floor = made.ladder
    assert [len(one.effects) for one in made.ladder] == [0, 0, 1, 1]
    assert made.interval == "jackknife"
    assert with_it.helps and with_it.heldout_error < baseline.heldout_error / 3
    assert with_it.heldout_error < 1.2 * floor.high
    assert with_it.ratio == pytest.approx(
        with_it.heldout_error / recalibrated.heldout_error
    )
    for rung, one in ((recalibrated, made.baseline), (with_it, made.fit)):
        wanted = math.sqrt(float(np.mean(left_out(one) ** 2)))
        assert rung.heldout_error == pytest.approx(wanted)
    # A device that is left out leaves no mark on what predicts it.
    whole = made.fit
    value = whole.readings.value.copy()
    first = whole.readings.device == 0
    value[first] += 5 * whole.noise[first]
    moved = replace(whole, readings=replace(whole.readings, value=value))
    change = (left_out(moved) - left_out(whole))[first]
    assert change == pytest.approx(5.0, abs=1e-6)


def test_nominal_errors_are_of_nothing_fitted() -> None:
    made = adopted("cure_mismatch")
    errors = []
    for curve in made.study.measurements.curves:
        answer = Model(level="draft")([curve.design], [curve.path])
        for m, name in enumerate(curve.outputs):
            lack = curve.values[:, m] - answer.output(name)[0]
            errors.append(lack / NOISE[name])
    wanted = math.sqrt(float(np.mean(np.concatenate(errors) ** 2)))
    assert made.ladder[0].heldout_error == pytest.approx(wanted, rel=1e-6)


def test_corrected_curves_are_those_of_the_version() -> None:
    made = adopted("cure_mismatch")
    model = ModelVersion.of(made).forward()
    assert np.isfinite(made.corrected).all() and emulation_error(made) < 0.05
    curve = made.study.measurements.curves[1]
    answer = model([curve.design], [curve.path])
    for m, name in enumerate(curve.outputs):
        at = [i for i, cell in enumerate(made.study.cells) if cell[::2] == (1, m)]
        assert made.corrected[at] == pytest.approx(answer.output(name)[0], rel=1e-6)


def test_the_order_changes_the_ladder_and_not_the_fit() -> None:
    one, other = adopted(*EFFECTS), adopted(*EFFECTS[::-1])
    assert np.array_equal(one.mean, other.mean)
    assert np.array_equal(one.covariance, other.covariance)
    assert np.array_equal(one.samples, other.samples)
    assert one.ladder[-2].heldout_error == other.ladder[-2].heldout_error
    assert one.ladder[-2].effects == other.ladder[-2].effects[::-1] == EFFECTS
    assert one.ladder[2].name == "+ cure_mismatch" == other.ladder[3].name
    # Alone its derivatives come from another solve, the same to the solver's tolerance.
    alone = adopted("cure_mismatch").heldout_error
    assert one.ladder[2].heldout_error == pytest.approx(alone, rel=1e-5)


def test_an_effect_that_does_not_help_is_adopted_and_told() -> None:
    made = adopted(*EFFECTS)
    low, high = made.fit.interval(0.99)[1]
    assert low < 0 < high  # no offset was planted
    assert made.ladder[3].log_bayes < 0 < made.ladder[2].log_bayes
    lines = [text for text in made.warnings if "pressure_offset" in text]
    assert any("not needed: the readings are" in text for text in lines)
    told = any("error on left-out devices" in text for text in lines)
    assert told != made.ladder[3].helps
    assert not any("cure_mismatch" in text for text in made.warnings)


def test_what_is_impossible_is_refused() -> None:
    one = study()
    for effects, says in (
        ((), "at least one effect"),
        (("cure_mismatch", "cure_mismatch"), "each effect once"),
    ):
        with pytest.raises(InputError, match=says):
            adopt(one, effects)
    with pytest.raises(EffectError, match="'cure' is unknown; allowed: cure_mismatch"):
        adopt(one, ("cure",))
    with pytest.raises(InputError, match="no reading has one"):
        adopt(study(effects=("viscoelasticity",)), ("viscoelasticity",))


def test_a_wrong_effect_is_adopted_and_told() -> None:
    made = adopt(study(2, effects=("pressure_loss",)), ("pressure_loss",))
    prior = made.fit.hypothesis.priors[0].parameter
    assert prior.lower < made.mean[0] < prior.upper
    assert not made.ladder[2].helps and any("pressure_loss" in w for w in made.warnings)


def test_what_to_measure_next_is_worth_it(monkeypatch: pytest.MonkeyPatch) -> None:
    made = adopted("cure_mismatch")
    assert deviations(made.fit)[0] == pytest.approx(
        made.fit.std()[0] / made.fit.hypothesis.priors[0].slope(0.0), rel=0.2
    )
    all_of_them = proposals(made.study, ["cure_mismatch"], made.fit.noise)
    chosen = [one for one in all_of_them if "finely" in one[0] or "strip" in one[0]]
    monkeypatch.setattr("discrepancy.sharpen.proposals", lambda *_: iter(chosen))
    assert len(chosen) == 3  # strips of two batches: a mismatch does not act on them
    (one,) = sharpen(made.study, made.fit)
    name, share = one.best
    assert "more finely" in one.words and name == "cure_mismatch.difference"
    # Readings where the mismatch is largest: 3 more of 9, and the least hidden ones.
    assert 0.3 < share < 0.9


def test_measurements_are_joined_file_by_file() -> None:
    whole = measurements()
    first, rest = whole.subset(["D1"]), whole.subset(["D2", "D3"])
    both = joined([replace(first, source="a"), replace(rest, source="b")])
    assert both.devices == ("D1", "D2", "D3") and both.source == "a, b"
    assert joined([first]) is first
    with pytest.raises(
        InputError, match=r"run: 1 .* each run of D1 in one file only, not in a and b"
    ):
        joined([replace(first, source="a"), replace(whole, source="b")])
    other = replace(rest, tolerances=Tolerances(0.1))
    with pytest.raises(InputError, match="tolerances"):
        joined([first, other])
    with pytest.raises(InputError, match="FILE"):
        joined([])


def test_a_device_is_measured_again_in_another_file() -> None:
    """Its runs stand together, whatever file they are of."""
    whole = measurements()
    again = replace(whole.subset(["D1"]).curves[0], run=2)
    more = replace(whole, curves=(again,), source="b")
    both = joined([replace(whole, source="a"), more])
    runs = [(curve.device, curve.run) for curve in both.curves]
    assert runs == [("D1", 1), ("D1", 2), ("D2", 1), ("D3", 1)]
    assert isinstance(again.design, Design)
    thicker = again.design.with_values(upper_thickness=99e-6)
    other = replace(more, curves=(replace(again, design=thicker),))
    with pytest.raises(InputError, match=r"'D1' .* b states another than a"):
        joined([replace(whole, source="a"), other])


# -- the report ----------------------------------------------------------------------


def test_the_report_says_it_all() -> None:
    made = adopted(*EFFECTS)
    version = ModelVersion.of(made, parent="f" * 12, date="2026-03-04")
    curve = made.study.measurements.curves[0]
    proposal = Sharpening("bulge & burst", curve, {"a.b": 0.9, "c.d": 0.614})
    page = Page(adopt_report(made, version, [proposal], ["a <note>"]))
    for text in (
        "cure_mismatch + pressure_offset in the model",
        "<three>.csv: 3 devices",
        f"{made.ladder[0].heldout_error:.2f}",
        "+ pressure_offset",
        "noise floor",
        "line 2 & odd",
        "a <note>",
        "bulge & burst c.d 61 %",
        "Madsen et al. 2014",
        "jackknife",
        version.version,
        "f" * 12,
        "2026-03-04",
    ):
        assert text in page.text, text
    figures = [
        json.loads(text)
        for about, text in page.scripts
        if about.get("type") == "application/json"
    ]
    assert len(figures) == 1 + len(NOISE)
    names = {trace.get("name") for trace in figures[1]["data"]}
    assert {"Baseline, as stated", "Measured"} <= names


def test_the_ladder_figure_shows_what_is_known() -> None:
    unknown = Rung("recalibrated", (), math.nan, math.nan, math.nan)
    figure = ladder_figure(
        (
            Rung("baseline", (), 8.0, 6.0, 11.0),
            unknown,
            Rung("+ <a>", ("a",), 2.0, math.nan, math.nan),
            Rung("noise floor", ("a",), 1.5, 1.1, 1.9),
        )
    )
    json.dumps(figure, allow_nan=False)
    (trace,) = figure["data"]
    assert trace["x"] == [8.0, 2.0]
    assert trace["error_x"]["array"] == [3.0, 0.0]
    assert figure["layout"]["yaxis"]["ticktext"] == ["baseline", "+ &lt;a&gt;"]
    assert (
        figure["layout"]["shapes"][0]["x0"],
        figure["layout"]["shapes"][0]["x1"],
    ) == (
        1.1,
        1.9,
    )


def test_a_version_of_an_adoption_keeps_its_numbers(tmp_path: Path) -> None:
    made = adopted("cure_mismatch")
    parts = [made.study.measurements, Measurements(measurements(1).curves, "one.csv")]
    saved = ModelVersion.of(made, files=parts, date="now").save(tmp_path / "m")
    found = ModelVersion.load(tmp_path / "m")
    assert np.array_equal(found.mean, made.mean)
    assert [rung_json(r) for r in found.ladder] == [rung_json(r) for r in made.ladder]
    assert np.array_equal(found.covariance, made.covariance)
    assert [one.name for one in found.measurements] == ["<three>.csv", "one.csv"]
    assert found.measurements[1].devices == ("D1",)
    assert (found.parent, found.effects) == ("baseline", ("cure_mismatch",))
    assert found.version == saved.version and found.own == {}
    assert found.doubts() == ()
