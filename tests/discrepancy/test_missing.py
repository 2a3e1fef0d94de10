"""Is anything missing: false alarms, power, and where, on errors of known size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from discrepancy import missing, regions
from discrepancy.evidence import fit
from discrepancy.missing import Residuals, Score, Units, combined, overall, scores
from discrepancy.study import Null
from discrepancy.target import Prediction

from .synthetic import devices

MOST = 0.06


def p_value(count: int, rng: np.random.Generator, **what: object) -> float:
    found, labels = devices(rng, count, **what)  # type: ignore[arg-type]
    clearest = Score(None, "region", count, 0.0, regions.regions(found, labels)[0])
    return overall([*scores(Residuals(found), labels), clearest])


@pytest.fixture(autouse=True)
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulated p-values to 0.5 %, which is fine enough against a level of 5 %."""
    monkeypatch.setattr(regions, "DRAWS", 199)


@pytest.mark.parametrize("calibrated", [False, True])
@pytest.mark.parametrize(("count", "sets"), [(5, 200), (10, 150), (20, 80)])
def test_false_alarms(count: int, sets: int, calibrated: bool) -> None:
    """At 1 % smooth error and 0.3 % noise; docs/compare.md has larger numbers."""
    rng = np.random.default_rng(count)
    found = [p_value(count, rng, calibrated=calibrated) for _ in range(sets)]
    assert np.mean(np.array(found) < missing.CLAIM) <= MOST


@pytest.mark.parametrize(("count", "least"), [(3, 0.6), (5, 0.8), (10, 0.95)])
def test_power(count: int, least: float) -> None:
    """An effect of 5 % in all devices, with modulus and thickness to hide behind."""
    rng = np.random.default_rng(1)
    found = [p_value(count, rng, effect=-0.05, begin=0.3) for _ in range(25)]
    assert np.mean(np.array(found) < missing.CLAIM) >= least


def test_points_are_not_the_unit() -> None:
    """The same errors taken for independent readings alarm in most sets."""
    rng = np.random.default_rng(2)
    naive = []
    for _ in range(40):
        found, labels = devices(rng, 10, calibrated=False)
        lack = found.readings.value - found.hypothesis.predict(found.t).values
        slope = stats.linregress(labels.load, lack / found.readings.scale)
        offset = stats.ttest_1samp(lack, 0).pvalue
        naive.append(min(slope.pvalue, offset) * 2)
    assert np.mean(np.array(naive) < missing.CLAIM) > 0.3


def test_wrong_moduli_are_missing_physics() -> None:
    """A modulus five tolerances off leaves no residual, and is told all the same."""
    rng = np.random.default_rng(3)
    found, labels = devices(rng, 5, modulus=5.0)
    by = {one.what: one.p for one in scores(Residuals(found), labels)}
    assert by["calibrations"] < 1e-3 < by["slope"]


def test_one_device_far_off_its_model() -> None:
    """With one curve, only what is believed of smooth errors can tell."""
    rng = np.random.default_rng(4)
    assert p_value(1, rng, effect=0.4, begin=0.3) < missing.CLAIM
    assert p_value(1, rng) > missing.CLAIM


def test_student_where_the_prior_is_worth_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(missing, "PRIOR_DEGREES", 0.0)
    value = np.array([1.0, 2.0, 0.5, 1.5, -0.2])
    units = Units(np.arange(5), value, np.eye(5), 1.0)
    assert units.p_value() == pytest.approx(stats.ttest_1samp(value, 0).pvalue)


def test_combination_of_p_values() -> None:
    """Of one p-value itself; of equal ones the same; of independent ones the level."""
    assert combined(np.array([0.03])) == pytest.approx(0.03)
    assert combined(np.full(7, 0.2)) == pytest.approx(0.2)
    rng = np.random.default_rng(5)
    p = np.array([combined(row) for row in rng.random((4000, 6))])
    assert np.mean(p < 0.05) == pytest.approx(0.052, abs=0.012)
    assert combined(np.array([1.0, 1e-4])) < 1e-3


def test_covariance_of_calibrated_residuals() -> None:
    """Against many simulated sets under one covariance."""
    rng = np.random.default_rng(6)
    found, _ = devices(rng, 3)
    residuals = Residuals(found)
    columns = found.hypothesis.predict(found.t).columns
    root = np.linalg.cholesky(residuals.errors)
    y = rng.standard_normal((20000, len(root))) @ root.T
    y += rng.standard_normal((20000, columns.shape[1])) @ columns.T
    whole = residuals.errors + columns @ columns.T
    left = y - y @ np.linalg.solve(whole, columns) @ columns.T
    sampled = left.T @ left / len(left)
    size = np.abs(residuals.covariance).max()
    assert np.allclose(sampled, residuals.covariance, atol=0.03 * size)


def test_whitened_residuals_are_white() -> None:
    rng = np.random.default_rng(7)
    found, _ = devices(rng, 3)
    residuals = Residuals(found)
    root = residuals.errors
    at = np.flatnonzero(found.readings.curve == 1)
    block = root[np.ix_(at, at)]
    white = residuals.whitened[at]
    lack = residuals.value[at]
    assert white @ white == pytest.approx(lack @ np.linalg.solve(block, lack))


def test_region_is_found_where_it_is() -> None:
    """10 % less above 30 % of the pressure, in the three thinnest of eight."""
    rng = np.random.default_rng(8)
    made, labels = devices(rng, 8, effect=-0.1, begin=3 / 7, thin=3)
    p, found = regions.regions(made, labels)
    region = found[0]
    assert p == 1 / 200 and len(found) == 1
    assert region.trait == "upper_thickness" and not region.above
    assert 77e-6 < region.threshold < 86e-6
    assert region.alike == ("length",) and region.devices == 3
    assert region.growth == regions.GROWING and not region.whole
    assert 10e3 < region.low < 30e3 and region.high == pytest.approx(50e3)
    assert abs(region.size + 0.1) < 3 * region.error < 0.06
    assert set(made.readings.device[region.at]) == {0, 1, 2}


def test_region_of_all_devices() -> None:
    rng = np.random.default_rng(9)
    made, labels = devices(rng, 6, effect=0.08)
    _, found = regions.regions(made, labels)
    assert found[0].trait == "" and found[0].devices == 6
    assert found[0].size > 0


def test_no_region_in_mere_errors() -> None:
    rng = np.random.default_rng(10)
    found = [regions.regions(*devices(rng, 6))[1] for _ in range(20)]
    assert sum(bool(one) for one in found) <= 3


def test_a_group_of_one_device_can_be_held_out() -> None:
    """An unknown effect has shapes for each group; one of them has no reading left."""
    rng = np.random.default_rng(11)
    made, _ = devices(rng, 4, calibrated=False)
    readings = replace(made.readings, group=np.repeat([0, 1, 0, 0], 7))
    shapes = tuple((readings.group == g)[:, None] * 1.0 for g in (0, 1))
    nothing = made.hypothesis.predict(made.t)
    unknown = Null("unknown", nothing, shapes)
    alone = readings.device == 1
    others = fit(readings, unknown, keep=~alone, evidence=False)
    same = fit(
        readings.subset(~alone),
        Null(
            "unknown",
            Prediction(*(part[~alone] for part in nothing)),
            (shapes[0][~alone],),
        ),
        evidence=False,
    )
    assert np.allclose(others.predict()[~alone], same.predict())
    assert np.allclose(others.predict()[alone], nothing.values[alone])
