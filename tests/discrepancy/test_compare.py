"""Comparison with finite elements: devices with an effect in them, and without."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datagen.errors import InputError
from discrepancy.compare import Comparison, compare, labels_of
from discrepancy.measurement import Curve, Measurements, Tolerances
from discrepancy.solves import Solver
from discrepancy.study import Study
from examples import bench

from .made import DEVICES, LOAD, MISMATCH, S1, SEED, measured


def without_noise(curve: Curve) -> Curve:
    return replace(curve, std=np.full(curve.values.shape, np.nan))


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The baseline is solved once for all tests."""
    return tmp_path_factory.mktemp("solves")


def held(data: Measurements, cache: Path) -> Comparison:
    with Solver(1, cache) as solver:
        study = Study(data, solver, level="draft", fast="draft", effects=())
        return compare(study)


@pytest.fixture(scope="module")
def plain(cache: Path) -> Comparison:
    return held(measured({})[0], cache)


def test_nothing_is_missing_where_nothing_is(plain: Comparison) -> None:
    assert not plain.missing and plain.fails_where == ()
    for error in plain.errors.values():
        assert error.residual < 1.6 and error.heldout < 2.5 * plain.noise_floor
    inflation = plain.errors["actuator", "inflation"]
    assert inflation.calibrated < inflation.raw
    assert {one.source for one in plain.noise.values()} == {"stated"}


def test_calibrations_are_those_of_the_truth(plain: Comparison) -> None:
    """Batch moduli and thicknesses, within three standard deviations."""
    true = measured({})[1]
    for one in plain.calibrations:
        if one.kind == "scale":
            continue
        device, layer = one.of[0].rsplit(" ", 1)
        actual = getattr(true[device], f"{layer}_{one.kind}")
        change = actual / one.stated - 1 if one.kind == "modulus" else actual
        change -= 0 if one.kind == "modulus" else one.stated
        assert abs(one.change - change) < 3 * one.std <= 3 * one.tolerance * 1.001
    moduli = [one for one in plain.calibrations if one.kind == "modulus"]
    assert [one.stated for one in moduli] == [2.5e6, 4.5e6]
    assert moduli[0].std < moduli[0].tolerance


def test_an_effect_is_seen_where_it_acts(cache: Path) -> None:
    found = held(measured(MISMATCH)[0], cache)
    assert found.missing
    first = found.fails_where[0]
    assert first.region.kind.quantity == "tip_deflection"
    assert first.devices == tuple(DEVICES) and first.region.trait == ""
    assert first.share > 0 and first.noises > 5
    assert found.errors["actuator", "tip_deflection"].heldout > 5
    assert not any(one.region.kind.quantity == "inflation" for one in found.fails_where)


def test_moduli_far_off_are_told(cache: Path) -> None:
    found = held(measured({}, modulus=0.65)[0], cache)
    assert found.missing
    assert {one.kind for one in found.pulled} >= {"modulus"}
    assert all(one.change < 0 for one in found.pulled if one.kind == "modulus")


def test_noise_that_is_not_stated_is_inferred(cache: Path) -> None:
    """Without repeats from the scatter, with them from the repeats."""
    data, _ = measured({})
    once = Measurements(tuple(without_noise(curve) for curve in data.curves))
    noise = held(once, cache).noise["actuator", "inflation"]
    assert noise.source == "inferred"
    assert 0.3 < noise.value / bench.NOISE["inflation"] < 3
    made = bench.Bench({}, SEED, Tolerances())
    again = [
        replace(without_noise(made.test("S1", S1, S1, LOAD, 1)), run=run)
        for run in range(2, 7)
    ]
    noise = held(Measurements((*once.curves, *again)), cache).noise[
        "actuator", "inflation"
    ]
    assert noise.source == "repeats"
    assert noise.value == pytest.approx(bench.NOISE["inflation"], rel=0.5)


def test_readings_keep_their_places(cache: Path) -> None:
    """A missing reading is missing in the answer; loads and designs are the curve's."""
    data, _ = measured({})
    values = data.curves[1].values.copy()
    values[2, 0] = np.nan
    holed = replace(data.curves[1], values=values)
    data = Measurements((data.curves[0], holed, data.curves[2]))
    with Solver(1, cache) as solver:
        study = Study(data, solver, level="draft", fast="draft", effects=())
        found = compare(study)
        labels = labels_of(study)
    tip = next(
        one
        for one in found.curves
        if one.curve == 1 and one.quantity == "tip_deflection"
    )
    assert np.isnan(tip.residual).tolist() == [False, False, True, False]
    assert np.allclose(tip.measured, holed.output("tip_deflection"), equal_nan=True)
    assert len(labels.load) == 3 * 4 * 3 - 1
    assert labels.traits["upper_thickness"].tolist() == pytest.approx(
        [75e-6, 95e-6, 95e-6]
    )
    assert np.allclose((labels.pulls**2).sum(axis=0), 1)


def test_a_quantity_that_reads_zero_throughout_is_missing_something(
    cache: Path,
) -> None:
    """No error of a curve is as large as all that the curve should have been."""
    data = measured({})[0]
    curves = []
    for curve in data.curves:
        values = curve.values.copy()
        values[:, curve.outputs.index("inflation")] = 0.0
        curves.append(replace(curve, values=values))
    found = held(replace(data, curves=tuple(curves)), cache)
    assert found.missing
    assert any(place.share < -0.9 for place in found.fails_where)


def test_why_no_reading_is_reached_is_told(cache: Path) -> None:
    data = measured({})[0]
    curve = replace(data.curves[0], load=-np.linspace(5e3, 20e3, len(LOAD)))
    with pytest.raises(InputError, match="roof and floor touch at -"):
        held(replace(data, curves=(curve,)), cache)
