"""Mapped bricks: numbering, merging, sides, and the fans that close cavities."""

from __future__ import annotations

import numpy as np
import pytest

from datagen.bricks import brick, closed, fan, merge, rim
from datagen.cavity import cavity, face_tensor
from datagen.elements import element_data

Array = np.ndarray


def bent(r: Array, s: Array, t: Array) -> tuple[Array, Array, Array]:
    """A quarter of a ring."""
    return r * np.cos(s), r * np.sin(s), t


def ring(count: int) -> tuple[Array, Array, Array]:
    return (
        np.array([1.0, 2.0]),
        np.linspace(0, np.pi / 2, count + 1),
        np.array([0, 0.5]),
    )


def test_a_mapped_brick_has_its_volume() -> None:
    part = brick(*ring(6), bent)
    weight = element_data(part.nodes, part.cells).weight
    assert weight.sum() == pytest.approx(0.5 * np.pi / 4 * 3, rel=1e-5)
    assert len(part.nodes) == 3 * 13 * 3
    assert part.centre[:, 0] == pytest.approx(1.5)


def test_normals_of_all_sides_point_inwards() -> None:
    line = np.array([0.0, 0.5, 1.0])
    part = brick(line + 1, line + 2, line + 3)
    faces = np.concatenate(list(part.sides.values()))
    assert len(faces) == 24
    volume, _ = cavity(part.nodes, faces, face_tensor())
    assert volume == pytest.approx(-1.0)


def test_merged_bricks_share_their_nodes() -> None:
    line = np.array([0.0, 1.0])
    parts = [brick(line + i, line + j, line) for i in range(2) for j in range(2)]
    whole = merge(parts, 1e-9)
    assert len(whole.nodes) == 5 * 5 * 3  # the middle edge was in all four
    assert len(whole.sides[2, 1]) == 4
    assert np.array_equal(
        whole.nodes[whole.cells], np.concatenate([p.nodes[p.cells] for p in parts])
    )


def test_a_fan_closes_what_its_rim_bounds() -> None:
    """The hole of a ring: faces of the wall and a fan over its far end."""
    part = brick(*ring(6), bent)
    wall = part.sides[0, 0]
    edges = rim(wall, np.isclose(part.nodes[:, 2], 0.5))
    assert len(edges) == 6
    nodes = np.concatenate([part.nodes, [[0.0, 0.0, 0.5]]])
    faces = np.concatenate([wall, fan(edges, len(part.nodes))])
    volume, _ = cavity(nodes, faces, face_tensor())
    assert volume == pytest.approx(0.5 * np.pi / 4, rel=1e-5)
    assert closed(part, wall).gap.shape == (0, 2)


def test_the_volume_behind_a_fan_follows_its_rim() -> None:
    """Moved rims in their plane change the volume as the enclosed area does."""
    part = brick(*ring(6), bent)
    wall = part.sides[0, 0]
    edges = rim(wall, np.isclose(part.nodes[:, 2], 0.5))
    nodes = np.concatenate([part.nodes, [[0.0, 0.0, 0.5]]])
    faces = np.concatenate([wall, fan(edges, len(part.nodes))])
    moved = nodes * np.array([1.7, 0.6, 1.0])
    before, after = (cavity(x, faces, face_tensor())[0] for x in (nodes, moved))
    assert after == pytest.approx(1.7 * 0.6 * before, rel=1e-12)
