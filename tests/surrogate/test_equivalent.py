"""Equivalent devices: read from problems, kept as closed forms, exact at off."""

from __future__ import annotations

import numpy as np
import pytest

from datagen.device import DESIGN_SPACE, Design, named_device
from datagen.errors import InputError
from datagen.model import Model
from surrogate.equivalent import (
    READ,
    SIZES,
    fit_equivalent,
    read_device,
    same_device,
)
from surrogate.features import columns_of
from surrogate.increment import ranged_space
from surrogate.shift import coordinates

RANGES = {
    "bond_edge.growth": (0.0, 40e-6),
    "modulus_bias.common": (0.7, 1.2),
    "modulus_bias.ratio": (0.8, 1.3),
    "pressure_loss.gain": (0.85, 1.0),
}
EFFECTS = ("bond_edge", "modulus_bias", "pressure_loss")


def divided() -> Design:
    return named_device("D8-4x2")


@pytest.mark.parametrize("device", ["S1", "D8-4x2", "D8-1x2", "D8-3x1"])
def test_a_problem_without_effects_is_its_own_device(device: str) -> None:
    design = named_device(device)
    found = read_device(Model((), "draft").problem(design))
    assert (found.pop("gain"), found.pop("offset")) == (1.0, 0.0)
    for name, value in found.items():
        assert value == pytest.approx(getattr(design, name), rel=1e-9), name


def test_what_effects_make_of_a_device() -> None:
    parameters = {
        "bond_edge": {"growth": 20e-6},
        "modulus_bias": {"common": 0.8, "ratio": 1.21},
        "pressure_loss": {"gain": 0.9},
        "pressure_offset": {"offset": 500.0},
        "thickness_bias": {"upper": 0.1, "lower": -0.05},
    }
    design = divided()
    model = Model(tuple(parameters), "draft", parameters)
    found = read_device(model.problem(design))
    nx, ny, grown = design.divisions_x, design.divisions_y, 20e-6
    expected = {
        "balloon_length": design.balloon_length + 2 * nx * grown,
        "balloon_width": design.balloon_width + 2 * ny * grown,
        "wall": design.wall - 2 * grown,
        "rim": design.rim - grown,
        "balloon_start": design.balloon_start - grown,
        "tip_margin": design.tip_margin - grown,
        "upper_thickness": design.upper_thickness * 1.1,
        "lower_thickness": design.lower_thickness * 0.95,
        "cavity_height": design.cavity_height,
        "upper_modulus": design.upper_modulus * 0.8 * 1.1,
        "lower_modulus": design.lower_modulus * 0.8 / 1.1,
        "gain": 0.9,
        "offset": model.problem(design).pressure_offset,
    }
    assert set(found) == set(READ)
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=1e-6), name
    assert found["offset"] != 0


def test_closed_forms_hold_where_they_were_not_read() -> None:
    space = ranged_space(EFFECTS, RANGES)
    tuned = tuple(p for p in space if "." in p.name)
    equivalent = fit_equivalent(space, seed=0)
    rows = space.sample(12, seed=77)
    t = coordinates(rows[:, len(DESIGN_SPACE) :], tuned)
    columns, gain, offset = equivalent(columns_of(space.names, rows), t)
    checked = 0
    for i, row in enumerate(rows):
        values = dict(zip(space.names, map(float, row), strict=True))
        design = Design.from_sample({n: values[n] for n in DESIGN_SPACE.names})
        parameters: dict[str, dict[str, float]] = {}
        for p in tuned:
            effect, _, name = p.name.partition(".")
            parameters.setdefault(effect, {})[name] = values[p.name]
        try:
            found = read_device(Model(EFFECTS, "draft", parameters).problem(design))
        except InputError:
            continue
        checked += 1
        walls = design.divisions_x * design.divisions_y > 1
        for name in SIZES:
            if name == "wall" and not walls:
                continue  # there is none
            assert columns[name][i] == pytest.approx(found[name], rel=1e-6), name
        assert gain[i] == pytest.approx(found["gain"], rel=1e-9)
        assert offset[i] == pytest.approx(found["offset"], abs=1e-9)
    assert checked > 6


def test_off_is_the_same_device_bit_for_bit() -> None:
    space = ranged_space(EFFECTS, RANGES)
    tuned = tuple(p for p in space if "." in p.name)
    equivalent = fit_equivalent(space, seed=0)
    rows = DESIGN_SPACE.sample(30, seed=5)
    columns = columns_of(DESIGN_SPACE.names, rows)
    off = np.tile([float(p.off or 0.0) for p in tuned], (30, 1))
    t = coordinates(off, tuned)
    assert not t.any()
    found, gain, offset = equivalent(columns, t)
    for name in DESIGN_SPACE.names:
        np.testing.assert_array_equal(found[name], columns[name])
    np.testing.assert_array_equal(gain, 1.0)
    np.testing.assert_array_equal(offset, 0.0)


def test_effects_of_another_kind_leave_the_device() -> None:
    space = ranged_space(
        ("self_weight",),
        {
            "self_weight.density": (0.0, 1100.0),
            "self_weight.orientation": (0.0, 3.0),
        },
    )
    found = fit_equivalent(space, seed=0)
    np.testing.assert_array_equal(found.weights, same_device(2).weights)


def test_coordinates() -> None:
    space = ranged_space(EFFECTS, RANGES)
    tuned = tuple(p for p in space if "." in p.name)
    names = [p.name for p in tuned]
    ends = np.array([[p.lower for p in tuned], [p.upper for p in tuned]])
    t = coordinates(ends, tuned)
    assert np.abs(t).max(axis=0) == pytest.approx(np.ones(len(tuned)))
    common = names.index("modulus_bias.common")
    assert t[0, common] == -1
    assert t[1, common] == pytest.approx(np.log(1.2) / -np.log(0.7))
