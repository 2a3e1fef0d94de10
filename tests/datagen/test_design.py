"""The device, its limits and the sampled space."""

from __future__ import annotations

import numpy as np
import pytest

from datagen.device import DESIGN_SPACE, Design, named_device
from datagen.errors import InputError


def test_s1_is_the_published_device() -> None:
    s1 = named_device("S1", 1)
    assert s1.length == pytest.approx(6.5e-3)
    assert s1.width == pytest.approx(2e-3)
    assert s1.balloons_x() == [pytest.approx((1.25e-3, 5.25e-3))]
    assert s1.balloons_y() == [(0.0, pytest.approx(0.5e-3))]
    assert (s1.upper_modulus, s1.lower_modulus) == (2.5e6, 4.5e6)


def test_division_keeps_the_balloon_area() -> None:
    for name in ("D8-1x1", "D8-4x1", "D8-3x2", "D8-2x3"):
        design = named_device(name)
        size = design.balloon_size
        count = design.divisions_x * design.divisions_y
        assert count * size[0] * size[1] == pytest.approx(8e-6)


def test_balloons_across_are_centred() -> None:
    odd, even = named_device("D8-1x3"), named_device("D8-1x2")
    assert odd.balloons_y()[0][0] == 0.0
    assert len(odd.balloons_y()) == 2
    assert even.balloons_y()[0][0] == pytest.approx(even.wall / 2)
    assert even.balloons_y()[-1][1] == pytest.approx(even.span_y / 2)


@pytest.mark.parametrize(
    ("field", "value", "named"),
    [
        ("upper_thickness", -5e-6, "upper_thickness_um: -5 um"),
        ("upper_thickness", float("nan"), "upper_thickness_um: nan um"),
        ("length", 5e-3, "length_mm: 5 mm"),
        ("width", 0.9e-3, "width_mm: 0.9 mm"),
        ("divisions_x", 2.5, "divisions_x: 2.5"),
        ("upper_modulus", "soft", "upper_modulus_MPa: 'soft'"),
        ("cavity_height", True, "cavity_height_um: True"),
    ],
)
def test_bad_values_are_named_with_unit_and_what_is_allowed(
    field: str, value: object, named: str
) -> None:
    with pytest.raises(InputError) as caught:
        named_device().with_values(**{field: value})  # type: ignore[arg-type]
    message = str(caught.value)
    assert message.startswith(named)
    assert "allowed:" in message
    assert "\n" not in message


def test_unknown_names_list_what_there_is() -> None:
    with pytest.raises(InputError, match="S1 or D8-MxN"):
        named_device("S2")
    with pytest.raises(InputError, match="1, 2, 3 or 4"):
        named_device("S1", 5)
    with pytest.raises(InputError, match="upper_thickness"):
        named_device().with_values(roof=1.0)


def test_every_sampled_design_is_valid_and_repeatable() -> None:
    points = DESIGN_SPACE.sample(300, seed=5)
    assert np.array_equal(points, DESIGN_SPACE.sample(300, seed=5))
    assert not np.array_equal(points, DESIGN_SPACE.sample(300, seed=6))
    for row in points:
        values = dict(zip(DESIGN_SPACE.names, row, strict=True))
        design = Design.from_sample(values)
        for name, value in values.items():
            assert getattr(design, name) == pytest.approx(value, rel=1e-9)


def test_latin_hypercube_fills_every_stratum() -> None:
    points = DESIGN_SPACE.sample(60, seed=0)
    for column, parameter in zip(points.T, DESIGN_SPACE, strict=True):
        unit = (column - parameter.lower) / (parameter.upper - parameter.lower)
        if parameter.scale == "integer":
            counts = np.unique(column, return_counts=True)[1]
            assert counts.max() - counts.min() == 0  # 60 divides by 6 and by 2
        else:
            assert sorted(np.floor(unit * 60).astype(int)) == list(range(60))
