"""Effects on the device's shape: thickness, bond edge, and a strip bent at rest."""

from __future__ import annotations

import numpy as np
import pytest

from datagen.device import Design, named_device
from datagen.effects.bond_edge import room_to_grow
from datagen.errors import InputError
from datagen.levels import mesh_level
from datagen.model import Model
from datagen.problem import baseline

from .running import ANGLE, INFLATION, INFLATION_LOWER, TIP, problem, values

Array = np.ndarray

LOADS = [10e3, 50e3]
UM = 1e-6


@pytest.fixture(scope="module")
def plain() -> Array:
    return values(LOADS)


def error(found: Array, wanted: Array) -> Array:
    """Largest error of each output over its own maximum."""
    largest: Array = np.abs(found - wanted).max(axis=0) / np.abs(wanted).max(axis=0)
    return largest


# -- thickness -------------------------------------------------------------------------


def test_thickness_is_that_of_a_design_with_it(plain: Array) -> None:
    """Same nodes where the grading does not change, which follows the thinner layer."""
    design = named_device()
    thicker = design.with_values(lower_thickness=1.08 * design.lower_thickness)
    biased = problem({"thickness_bias": {"lower": 0.08}})
    assert biased.nodes == pytest.approx(problem(None, thicker).nodes, abs=1e-12)
    turned = design.with_values(upper_thickness=150 * UM, lower_thickness=95 * UM)
    thinner = turned.with_values(upper_thickness=0.93 * 150 * UM)
    biased = problem({"thickness_bias": {"upper": -0.07}}, turned)
    assert biased.nodes == pytest.approx(problem(None, thinner).nodes, abs=1e-12)

    found = values(LOADS, {"thickness_bias": {"lower": 0.08}})
    wanted = values(LOADS, None, thicker)
    # The tip is read at the nominal mid-thickness, some micrometres from the other's.
    assert error(found, wanted).max() < 1e-3
    assert error(found[:, 1:], wanted[:, 1:]).max() < 1e-6


def test_a_thicker_roof_on_another_mesh(plain: Array) -> None:
    thicker = named_device().with_values(upper_thickness=1.05 * 95 * UM)
    change = values(LOADS, {"thickness_bias": {"upper": 0.05}}) - plain
    wanted = values(LOADS, None, thicker) - plain
    # A third of the draft mesh's own error, which is 0.6 % of the inflation.
    assert (np.abs(change - wanted) < 2e-3 * plain)[:, INFLATION].all()
    exponent = np.log1p(change[:, INFLATION] / plain[:, INFLATION]) / np.log(1.05)
    # -1.46 and -0.67 of the membrane alone; on a rim that yields -1.56 and -0.61, as
    # the standard mesh has it.
    assert exponent == pytest.approx([-1.56, -0.61], abs=0.03)


def test_a_gradient_begins_at_the_clamp_and_keeps_the_cavity() -> None:
    design = named_device()
    nodes = problem({"thickness_bias": {"gradient": 0.1}}).nodes
    mesh = baseline(design, mesh_level("draft")).mesh
    z = mesh.nodes[:, 2]
    rows = {
        name: np.abs(z - height) < 1e-12
        for name, height in (
            ("floor", design.lower_thickness),
            ("roof", design.lower_thickness + design.cavity_height),
            ("top", design.thickness),
        )
    }

    def profile(name: str) -> Array:
        x, height = nodes[rows[name], 0], nodes[rows[name], 2]
        return np.array(np.polynomial.polynomial.polyfit(x / design.length, height, 1))

    floor, roof, top = (profile(name) for name in rows)
    assert floor == pytest.approx(140 * UM * np.array([1.0, 0.1]), rel=1e-9)
    assert top - roof == pytest.approx(95 * UM * np.array([1.0, 0.1]), rel=1e-9)
    assert roof - floor == pytest.approx([75 * UM, 0.0], abs=1e-15)


# -- bond edge -------------------------------------------------------------------------


def grown(design: Design, growth: float) -> Design:
    """The design whose balloons are longer and wider by twice the growth."""
    return design.with_values(
        balloon_length=design.balloon_length + 2 * design.divisions_x * growth,
        balloon_width=design.balloon_width + 2 * design.divisions_y * growth,
        balloon_start=design.balloon_start - growth,
        wall=design.wall - 2 * growth,
    )


@pytest.mark.parametrize("name", ["S1", "D8-2x2", "D8-2x3"])
def test_balloons_are_those_of_the_larger_design(name: str) -> None:
    """Wherever a grid line of one mesh is an edge of a balloon, so it is in both."""
    design = named_device(name, 2)
    growth = 40 * UM
    nodes = problem({"bond_edge": {"growth": growth}}, design).nodes
    larger = grown(design, growth)
    wanted = problem(None, larger).mesh
    faces = nodes[wanted.cavity_faces]
    for balloon in np.unique(wanted.balloon):
        ours = faces[wanted.balloon == balloon].reshape(-1, 3)
        theirs = wanted.nodes[wanted.cavity_faces[wanted.balloon == balloon]]
        theirs = theirs.reshape(-1, 3)
        assert ours.min(axis=0) == pytest.approx(theirs.min(axis=0), abs=1e-12)
        assert ours.max(axis=0) == pytest.approx(theirs.max(axis=0), abs=1e-12)
    assert nodes.max(axis=0) == pytest.approx(wanted.nodes.max(axis=0), abs=1e-12)
    assert nodes.min(axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


def test_a_larger_footprint_inflates_more_at_all_pressures(plain: Array) -> None:
    growth = 30 * UM
    found = values(LOADS, {"bond_edge": {"growth": growth}})
    assert (found[:, INFLATION] > 1.05 * plain[:, INFLATION]).all()
    wanted = values(LOADS, None, grown(named_device(), growth))
    assert error(found, wanted)[[INFLATION, INFLATION_LOWER]].max() < 0.01
    change = (found - plain)[:, TIP]
    assert change == pytest.approx((wanted - plain)[:, TIP], rel=0.1)


def test_walls_that_would_vanish_are_refused() -> None:
    divided = named_device("D8-4x1")  # walls of 0.2 mm, of which 0.02 mm have to stay
    room, place = room_to_grow(divided)
    assert room == pytest.approx(90 * UM)
    assert "between two balloons" in place
    with pytest.raises(
        InputError,
        match=r"bond_edge\.growth: 0\.0001 m is not allowed; allowed: at most 9e-05 m",
    ):
        problem({"bond_edge": {"growth": 100 * UM}}, divided)
    narrow = named_device().with_values(width=1.1e-3)
    with pytest.raises(InputError, match="from the balloons to the side"):
        problem({"bond_edge": {"growth": 40 * UM}}, narrow)
    model = Model(("bond_edge",), "draft", {"bond_edge": {"growth": room}})
    steps = {one.name: one.step for one in model.directions(divided)}
    assert steps["bond_edge.growth"] < 0  # at the end of what fits: step back
    assert steps["wall"] > 0


# -- initial shape ---------------------------------------------------------------------

BENT = {"initial_shape": {"curvature": 20.0, "tilt": np.radians(-3.0)}}


def test_a_bent_strip_reads_its_offset_at_rest() -> None:
    """Tip of an arc from the clamp, rotated; the free end's line is a chord of it."""
    design = named_device()
    k, tilt = BENT["initial_shape"].values()
    tip, angle, up, down, volume = values([0.0], BENT)[0]
    turn = k * design.length
    x, z = np.sin(turn) / k, (1 - np.cos(turn)) / k
    assert tip == pytest.approx(z * np.cos(tilt) + x * np.sin(tilt), rel=1e-9)
    end = design.balloon_start + design.span_x
    fitted = end + 0.25 * (design.length - end)
    chord = k * (fitted + design.length) / 2 + tilt
    # Elements' parabolas are off an arc by the third power of the angle they span.
    assert angle == pytest.approx(chord, abs=(k * 1.25e-3) ** 3)
    assert np.abs([up, down]).max() < 1e-12
    assert abs(volume) < 1e-18


def test_a_tilt_alone_turns_everything() -> None:
    """Without weight the clamp's direction does not matter: outputs turn along."""
    tilt = np.radians(5.0)
    found = values(LOADS, {"initial_shape": {"tilt": tilt}})
    wanted = values(LOADS)
    same = [INFLATION, INFLATION_LOWER]
    assert error(found[:, same], wanted[:, same]).max() < 1e-6
    assert found[:, ANGLE] - wanted[:, ANGLE] == pytest.approx([tilt, tilt], rel=1e-6)


def test_a_curved_strip_straightens_under_pressure(plain: Array) -> None:
    """As in a Bourdon tube: the offset shrinks, and inflation hardly knows of it."""
    curved = {"initial_shape": {"curvature": 30.0}}
    offset = values([0.0], curved)[0, TIP]
    assert offset == pytest.approx(30 * 6.5e-3**2 / 2, rel=0.01)
    left = (values(LOADS, curved) - plain) / offset
    assert 0.8 < left[0, TIP] < 0.95
    assert 0.6 < left[1, TIP] < 0.8
    assert np.abs(left[:, INFLATION] * offset / plain[:, INFLATION]).max() < 5e-3


def test_a_device_is_made_first_and_then_bent() -> None:
    """The datum has the other thickness in it, and the layers stay normal to the arc.

    The thickness at the tip, measured across the bent strip, is that of the layers.
    """
    active = {"thickness_bias": {"upper": 0.1, "gradient": 0.05}, **BENT}
    made = problem({"thickness_bias": active["thickness_bias"]})
    bent = problem(dict(reversed(active.items())))
    assert np.array_equal(bent.nodes, problem(active).nodes)
    assert bent.datum is not None
    assert np.array_equal(bent.datum, made.nodes)
    bottom, top = (int(made.mesh.lines[name][-1]) for name in ("bottom", "roof_middle"))
    across = np.linalg.norm(bent.nodes[top] - bent.nodes[bottom])
    assert across == pytest.approx(made.nodes[top, 2] - made.nodes[bottom, 2], rel=1e-9)
