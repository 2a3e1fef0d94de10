"""Mesh of the divided strip."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from datagen.cavity import cavity, face_tensor
from datagen.device import Design, named_device
from datagen.elements import element_data
from datagen.errors import InputError
from datagen.levels import mesh_level
from datagen.mesh import UPPER, build_mesh, graded, graded_both, grid_lines

DEVICES = ["S1", "D8-4x1", "D8-2x2", "D8-1x3", "D8-6x2"]


@pytest.mark.parametrize("name", DEVICES)
@pytest.mark.parametrize("level", ["draft", "standard"])
def test_volumes_are_those_of_the_device(name: str, level: str) -> None:
    design = named_device(name)
    mesh = build_mesh(design, mesh_level(level))
    hole = design.balloon_length * design.balloon_width * design.cavity_height
    whole = design.length * design.width * design.thickness
    weight = element_data(mesh.nodes, mesh.cells).weight.sum(axis=1)
    assert 2 * weight.sum() == pytest.approx(whole - hole, rel=1e-10)
    upper = design.length * design.width * design.upper_thickness
    assert 2 * weight[mesh.layer == UPPER].sum() == pytest.approx(upper, rel=1e-10)
    volume, gradient = cavity(mesh.nodes, mesh.cavity_faces, face_tensor())
    assert 2 * volume == pytest.approx(hole, rel=1e-10)
    # A closed cavity pushes nowhere; the half one only across the symmetry plane.
    assert np.abs(gradient.sum(axis=0)[[0, 2]]).max() < 1e-12 * np.abs(gradient).sum()
    assert len(np.unique(mesh.balloon)) == design.divisions_x * len(design.balloons_y())


def test_named_parts_lie_where_they_should() -> None:
    design = named_device("D8-2x2")
    mesh = build_mesh(design, mesh_level("draft"))
    left, right = design.balloons_y()[0]
    expected = {
        "bottom": (0.0, 0.0),
        "rim": (design.width / 2, 0.0),
        "roof_middle": ((left + right) / 2, design.thickness),
        "roof_edge": (right, design.thickness),
        "floor_middle": ((left + right) / 2, 0.0),
        "floor_edge": (right, 0.0),
    }
    for name, (y, z) in expected.items():
        row = mesh.nodes[mesh.lines[name]]
        assert np.allclose(row[:, 1:], (y, z), atol=1e-12)
        assert (np.diff(row[:, 0]) > 0).all()
    tip = mesh.tip_weights @ mesh.nodes[mesh.tip]
    assert tip == pytest.approx((design.length, 0.0, design.thickness / 2), abs=1e-15)
    apart = mesh.nodes[mesh.gap[:, 1]] - mesh.nodes[mesh.gap[:, 0]]
    assert np.allclose(apart, (0, 0, design.cavity_height), atol=1e-12)
    walls = mesh.nodes[mesh.gap[mesh.gap_wall, 0], 1]
    assert np.allclose(walls, design.balloons_y()[-1][1])


def test_elements_never_straddle_a_balloon_edge() -> None:
    design = named_device("D8-6x2")
    x, y, z = grid_lines(design, mesh_level("standard"))
    for lines, edges in (
        (x, [e for pair in design.balloons_x() for e in pair]),
        (y, [e for pair in design.balloons_y() for e in pair]),
        (z, [design.lower_thickness, design.lower_thickness + design.cavity_height]),
    ):
        assert (np.diff(lines) > 0).all()
        assert all(np.abs(lines - edge).min() < 1e-12 for edge in edges)


def test_two_elements_through_each_membrane_at_the_standard_level() -> None:
    design = named_device("S1")
    z = grid_lines(design, mesh_level("standard"))[2]
    roof = design.lower_thickness + design.cavity_height
    assert (z < design.lower_thickness - 1e-9).sum() >= 2
    assert (z > roof + 1e-9).sum() >= 2


def test_grading_grows_away_from_its_start() -> None:
    sizes = np.diff(graded(1.0, 3.0, 6, 0.05))
    assert sizes[0] == pytest.approx(0.05)
    ratios = sizes[1:] / sizes[:-1]
    assert (ratios > 1).all()
    assert np.ptp(ratios) < 1e-6
    assert np.allclose(np.diff(graded(1.0, -1.0, 4, 9.0)), -0.5)


def test_same_divisions_give_the_same_topology() -> None:
    one = named_device("D8-3x2")
    other = one.with_values(upper_thickness=50e-6, balloon_length=6e-3)
    level = mesh_level("standard")
    a, b = build_mesh(one, level), build_mesh(other, level)
    assert np.array_equal(a.cells, b.cells)
    assert np.array_equal(a.cavity_faces, b.cavity_faces)


def test_thin_walls_and_short_ends_still_mesh() -> None:
    design = Design(
        length=3.02e-3,
        width=1.04e-3,
        balloon_length=2.5e-3,
        balloon_width=0.9e-3,
        balloon_start=0.2e-3,
        wall=0.1e-3,
        divisions_x=3,
        divisions_y=2,
        cavity_height=150e-6,
        upper_thickness=200e-6,
        lower_thickness=300e-6,
        upper_modulus=1e6,
        lower_modulus=1e6,
    )
    mesh = build_mesh(design, mesh_level("standard"))
    assert element_data(mesh.nodes, mesh.cells).weight.min() > 0


@pytest.mark.parametrize("level", ["draft", "standard", "fine"])
def test_walls_are_as_many_elements_as_the_level_says(level: str) -> None:
    """One across a wall between balloons is a hinge: tips were off by half."""
    mesh = mesh_level(level)
    assert mesh.wall >= 2
    design = named_device("D8-4x2")
    x, y, _ = grid_lines(design, mesh)
    for here, beside in pairwise(design.balloons_x()):
        within = (x > here[1] - 1e-12) & (x < beside[0] + 1e-12)
        assert within.sum() == mesh.wall + 1
    half = y < design.balloons_y()[0][0] + 1e-12
    assert half.sum() == (mesh.wall + 1) // 2 + 1


def test_undivided_strips_kept_their_mesh() -> None:
    """Generator 6 changed divided strips alone: S1's published figures stand."""
    for level in ("draft", "standard", "fine"):
        meshes = [mesh_level(f"{level}-{generator}") for generator in (5, 6)]
        for one, same in (("S1", True), ("D8-4x1", False), ("D8-1x3", False)):
            a, b = (grid_lines(named_device(one), it) for it in meshes)
            assert all(np.array_equal(p, q) for p, q in zip(a, b, strict=True)) == same


def test_unknown_level_is_refused() -> None:
    with pytest.raises(InputError, match="draft, standard, fine"):
        mesh_level("coarse")


@pytest.mark.parametrize("count", [2, 3, 4, 7])
def test_lines_graded_towards_both_ends(count: int) -> None:
    sizes = np.diff(graded_both(1.0, 3.0, count, 0.1, 0.2))
    assert sizes.sum() == pytest.approx(2.0, rel=1e-14)
    if count > 2:
        assert sizes[[0, -1]] == pytest.approx([0.1, 0.2])
        growth = sizes[1:] / sizes[:-1]
        assert (np.diff(growth) < 1e-12).all()  # up first, then down
    else:
        assert sizes[1] == pytest.approx(2 * sizes[0])


def test_lines_that_need_no_grading_are_even() -> None:
    assert np.allclose(np.diff(graded_both(0.0, 1.0, 4, 0.5, 0.5)), 0.25)


@pytest.mark.parametrize("name", ["S1", "D8-2x2"])
def test_a_mesh_is_moved_to_another_design(name: str) -> None:
    design = named_device(name)
    other = design.with_values(upper_thickness=60e-6, balloon_start=2e-3, length=12e-3)
    mesh, wanted = (build_mesh(d, mesh_level("draft")) for d in (design, other))
    moved = mesh.of(other)
    assert np.array_equal(moved.nodes, wanted.nodes)
    assert np.array_equal(moved.tip, wanted.tip)
    assert np.array_equal(moved.tip_weights, wanted.tip_weights)
    assert np.array_equal(moved.cells, wanted.cells)
    with pytest.raises(InputError, match="divisions"):
        mesh.of(named_device("D8-4x1"))
