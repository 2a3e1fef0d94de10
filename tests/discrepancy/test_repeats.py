"""Noise from repeated runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from datagen.device import named_device
from discrepancy.measurement import LOADING, Curve, Measurements
from discrepancy.repeats import noise_from_repeats

Array = np.ndarray

KPA = 1e3
LOAD = np.array([5, 10, 20, 30, 40, 50, 60]) * KPA
TRUE = 200e-6 * np.sqrt(LOAD / LOAD[-1])


def runs(
    count: int, rng: np.random.Generator, std: float, load: Array = LOAD
) -> Measurements:
    """One device measured `count` times; every run has a camera of its own."""
    curves = []
    for run in range(1, count + 1):
        true = np.interp(load, LOAD, TRUE) * (1 + 0.02 * rng.standard_normal())
        values = (true + std * rng.standard_normal(len(load)))[:, None]
        curves.append(
            Curve(
                device="S1",
                run=run,
                orientation=0.0,
                design=named_device("S1"),
                load=load,
                time=None,
                branch=np.full(len(load), LOADING),
                outputs=("inflation",),
                values=values,
                std=np.full(values.shape, np.nan),
            )
        )
    return Measurements(tuple(curves))


def test_noise_is_recovered_though_cameras_differ() -> None:
    """A camera 2 % off moves readings by more than the noise, and is not noise."""
    rng = np.random.default_rng(1)
    sets = [noise_from_repeats(runs(3, rng, 1e-6)) for _ in range(200)]
    found = [one["actuator", "inflation"] for one in sets]
    assert {one.degrees for one in found} == {2 * 5}
    rms = np.sqrt(np.mean([one.std**2 for one in found]))
    assert rms == pytest.approx(1e-6, rel=0.1)


def test_what_was_not_repeated_is_not_there() -> None:
    rng = np.random.default_rng(2)
    assert noise_from_repeats(runs(1, rng, 1e-6)) == {}
    far = runs(2, rng, 1e-6)
    other = Measurements(
        (far.curves[0], runs(2, rng, 1e-6, LOAD + 2.5 * KPA).curves[1])
    )
    assert noise_from_repeats(other) == {}


def test_loads_that_differ_in_the_last_digit_are_the_same() -> None:
    rng = np.random.default_rng(3)
    first = runs(2, rng, 1e-6).curves[0]
    again = runs(2, rng, 1e-6, LOAD * (1 + 1e-9)).curves[1]
    found = noise_from_repeats(Measurements((first, again)))
    assert found["actuator", "inflation"].degrees == 5


def test_few_shared_loads_take_an_offset_only() -> None:
    rng = np.random.default_rng(4)
    found = noise_from_repeats(runs(2, rng, 1e-6, LOAD[:3]))
    assert found["actuator", "inflation"].degrees == 2


def test_vacuum_is_a_load_too() -> None:
    rng = np.random.default_rng(5)
    load = np.array([0.0, -5, -10, -15]) * KPA
    found = noise_from_repeats(runs(3, rng, 1e-6, load))
    assert found["actuator", "inflation"].degrees == 4


def test_what_rounding_hides_is_no_noise() -> None:
    """Of runs that agree to the last digit, or were copied, nothing is known."""
    rng = np.random.default_rng(6)
    first = runs(1, rng, 1e-6).curves[0]

    def again(digits: int, noise: float, shift: float = 0.0) -> Measurements:
        curves = []
        for run in (1, 2, 3):
            values = first.values + run * shift
            values = values + noise * rng.standard_normal(values.shape)
            curves.append(replace(first, run=run, values=np.round(values, digits)))
        return Measurements(tuple(curves))

    assert noise_from_repeats(again(6, 0.0)) == {}
    assert noise_from_repeats(again(12, 0.0, shift=1e-5)) == {}
    assert noise_from_repeats(again(6, 1e-9)) == {}
    found = noise_from_repeats(again(6, 2e-6))["actuator", "inflation"]
    assert found.std == pytest.approx(2e-6, rel=0.6)


def test_a_quantity_may_be_missing_in_the_first_run() -> None:
    rng = np.random.default_rng(7)
    measured = runs(3, rng, 1e-6).curves
    blind = replace(measured[0], run=9, outputs=("tip_deflection",))
    for order in ((blind, *measured), (*measured, blind)):
        assert set(noise_from_repeats(Measurements(order))) == {
            ("actuator", "inflation")
        }


def test_angles_that_were_rounded_away_tell_no_noise() -> None:
    """Written in degrees, they are no round numbers in radians."""
    rng = np.random.default_rng(4)
    whole = runs(3, rng, 0.0)
    for unit, name in ((np.pi / 180, "bending_angle"), (1.0, "bending_angle")):
        for scatter, told in ((0.02, False), (2.0, True)):
            true = np.linspace(3.0, 22.0, len(LOAD))  # between whole digits
            curves = []
            for curve in whole.curves:
                read = np.round(true + scatter * rng.standard_normal(len(LOAD)))
                values = (unit * 10 * read)[:, None]
                curves.append(replace(curve, outputs=(name,), values=values))
            found = noise_from_repeats(Measurements(tuple(curves)))
            assert (("actuator", name) in found) is told
