"""Dimensionless inputs, and terms with the dimension of the outputs."""

from __future__ import annotations

import numpy as np
import pytest

from datagen.device import DESIGN_SPACE
from datagen.response import OUTPUT_NAMES
from datagen.space import Parameter, Space
from surrogate.features import (
    GROUPS,
    TERMS,
    TURNED_OVER,
    columns_of,
    effect_inputs,
    features,
    groups,
    prepare,
    term_owners,
    turned_over,
)

MODULI = ("upper_modulus", "lower_modulus")
COUNTS = ("divisions_x", "divisions_y")
LENGTH_POWER = {
    "tip_deflection": 1,
    "bending_angle": 0,
    "inflation": 1,
    "inflation_lower": 1,
    "cavity_volume": 3,
}


def sample(count: int = 40, seed: int = 0) -> dict[str, np.ndarray]:
    return columns_of(DESIGN_SPACE.names, DESIGN_SPACE.sample(count, seed))


def scaled(
    columns: dict[str, np.ndarray], length: float, modulus: float
) -> dict[str, np.ndarray]:
    out = {}
    for name, column in columns.items():
        factor = modulus if name in MODULI else 1.0 if name in COUNTS else length
        out[name] = column * factor
    return out


def test_inputs_do_not_see_size_or_modulus() -> None:
    columns = sample()
    pressure = np.linspace(0, 1.5e5, 7) * np.ones((40, 1))
    own = prepare(columns, DESIGN_SPACE)
    twin = prepare(scaled(columns, 3.7, 0.21), DESIGN_SPACE)
    np.testing.assert_allclose(twin.limit_scale, 0.21 * own.limit_scale)
    first = features(own, pressure, own.limit_scale)
    other = features(twin, pressure * 0.21, twin.limit_scale)
    np.testing.assert_allclose(other.point, first.point, rtol=1e-9, atol=1e-11)
    powers = np.array([LENGTH_POWER[name] for name in OUTPUT_NAMES])
    expected = first.terms * 3.7 ** powers[term_owners(effects=False)]
    np.testing.assert_allclose(other.terms, expected, rtol=1e-8)


def test_terms_vanish_at_zero_pressure_and_are_odd() -> None:
    columns = sample()
    p = np.array([[-2e4, 0.0, 2e4]]) * np.ones((40, 1))
    own = prepare(columns, DESIGN_SPACE)
    found = features(own, p, own.limit_scale)
    assert np.isfinite(found.point).all()
    terms = found.terms
    assert terms.shape == (40, 3, sum(len(names) for names in TERMS.values()))
    assert (terms[:, 1] == 0).all()
    assert (terms[:, 2] != 0).all()
    np.testing.assert_array_equal(terms[:, 0], -terms[:, 2])


def test_groups_span_the_space() -> None:
    """Eleven independent groups: thirteen variables less length and modulus."""
    columns = sample(400)
    divided = columns["divisions_x"] > 1
    found = groups(columns)
    assert found.shape[1] == len(GROUPS)
    # Both walls are the same number over the same width.
    found = np.delete(found[divided], GROUPS.index("wall_y/balloon_width"), axis=1)
    assert np.linalg.matrix_rank(found - found.mean(axis=0)) == 11


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_wall_that_is_not_there_does_not_count(axis: str) -> None:
    columns = sample()
    single = {**columns, "divisions_x": np.ones(40), "divisions_y": np.ones(40)}
    thick = {**single, "wall": 2 * single["wall"]}
    np.testing.assert_array_equal(groups(single), groups(thick))
    divided = {**single, f"divisions_{axis}": 2 * np.ones(40)}
    wider = {**divided, "wall": 2 * divided["wall"]}
    assert (groups(divided) != groups(wider)).any(axis=1).all()


def test_effects_bring_their_parameters_and_a_term_without_pressure() -> None:
    tilt = Parameter("tilt.angle", "rad", -0.1, 0.3, off=0.0)
    space = Space((*DESIGN_SPACE.parameters, tilt))
    columns = columns_of(space.names, space.sample(10, 0))
    extra = effect_inputs(columns, space)
    assert extra is not None
    assert extra.shape == (10, 3)
    assert np.abs(extra[:, 0]).max() <= 1
    assert effect_inputs(columns, DESIGN_SPACE) is None
    own = prepare(columns, space)
    found = features(own, np.zeros((10, 1)), own.limit_scale)
    owner = term_owners(effects=True)
    assert found.terms.shape == (10, 1, len(owner))
    for o in range(len(OUTPUT_NAMES)):
        terms = found.terms[..., owner == o]
        assert (terms[..., -1] > 0).all()
        assert (terms[..., :-1] == 0).all()


def test_a_strip_turned_over() -> None:
    """Closed forms know up from down by nothing but the spacer's material."""
    columns = sample()
    columns["spacer_modulus"] = np.sqrt(
        columns["upper_modulus"] * columns["lower_modulus"]
    )
    over = turned_over(columns) | {"spacer_modulus": columns["spacer_modulus"]}
    p = np.linspace(1e3, 1e5, 4) * np.ones((40, 1))
    own, twin = (prepare(c, DESIGN_SPACE) for c in (columns, over))
    np.testing.assert_allclose(twin.limit_scale, own.limit_scale)
    ours, theirs = (features(x, p, own.limit_scale).terms for x in (own, twin))
    owner = term_owners(effects=False)
    names = [term for terms in TERMS.values() for term in terms]
    opposite = {"roof": "floor", "floor": "roof"}
    for k, name in enumerate(names):
        side, _, kind = name.partition(" ")
        output, sign = TURNED_OVER[OUTPUT_NAMES[owner[k]]]
        twin_name = f"{opposite[side]} {kind}" if side in opposite else name
        j = next(
            i
            for i, other in enumerate(names)
            if other == twin_name and OUTPUT_NAMES[owner[i]] == output
        )
        # The plain thrust term has no side: its weight takes the sign.
        factor = 1.0 if name == "thrust" else sign
        np.testing.assert_allclose(theirs[..., k], factor * ours[..., j], rtol=1e-9)


def test_some_designs_alone() -> None:
    own = prepare(sample(), DESIGN_SPACE)
    p = np.linspace(0, 1e5, 4) * np.ones((40, 1))
    all_of_them = features(own, p, own.limit_scale)
    some = features(own[7:12], p[7:12], own[7:12].limit_scale)
    np.testing.assert_array_equal(some.point, all_of_them.point[7:12])
    np.testing.assert_array_equal(some.terms, all_of_them.terms[7:12])
