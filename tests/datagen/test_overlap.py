"""Neighbouring balloons that meet: found, told apart from what only comes near."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from datagen.continuation import PathFollower
from datagen.device import named_device
from datagen.mesh import StripMesh
from datagen.model import Model
from datagen.overlap import _surfaces, overlapping

Array = np.ndarray


def bulged(mesh: StripMesh, grown: float, lower: bool, sideways: float) -> Array:
    """The strip with its roofs or floors as elastica-like bulbs, wider than the base.

    Over each balloon a bulb of the height `grown` (m) leans over its walls by
    `sideways` (m), in x and y.
    """
    x = mesh.nodes.copy()
    surface = _surfaces(mesh)[0 if lower else 1]
    for axis in (0, 1):
        line = mesh.nodes[surface[:, 0] if axis == 0 else surface[0], axis]
        walls = WALLS[axis]
        for left, right in pairwise(walls):
            inside = (line > left) & (line < right)
            phase = 2 * np.pi * (line[inside] - left) / (right - left)
            chosen = surface[inside] if axis == 0 else surface[:, inside].T
            x[chosen, axis] -= sideways * np.sin(phase)[:, None]
            lift = grown * (1 - np.cos(phase))[:, None] / 2
            x[chosen, 2] += -lift if lower else lift
    return x


DEVICE = named_device("D8-2x2", 2).with_values(wall=1e-4)
MIDDLE = DEVICE.balloon_start + DEVICE.span_x / 2
WALLS = (
    (DEVICE.balloon_start, MIDDLE, DEVICE.balloon_start + DEVICE.span_x),
    (0.0, DEVICE.balloon_width + DEVICE.wall / 2),
)


@pytest.fixture(scope="module")
def mesh() -> StripMesh:
    return Model(level="draft").problem(DEVICE).mesh


@pytest.mark.parametrize("lower", [False, True])
def test_bulbs_that_lean_over_their_walls_overlap(mesh: StripMesh, lower: bool) -> None:
    assert not overlapping(mesh, mesh.nodes)
    assert not overlapping(mesh, bulged(mesh, 3e-4, lower, 0.0))
    assert overlapping(mesh, bulged(mesh, 3e-4, lower, 6e-4))


def test_turning_the_strip_changes_nothing(mesh: StripMesh) -> None:
    angle = 2.0
    turn = np.array(
        [
            [np.cos(angle), 0, -np.sin(angle)],
            [0, 1, 0],
            [np.sin(angle), 0, np.cos(angle)],
        ]
    )
    assert not overlapping(mesh, bulged(mesh, 3e-4, False, 0.0) @ turn.T)
    assert overlapping(mesh, bulged(mesh, 3e-4, False, 6e-4) @ turn.T)


@pytest.mark.parametrize(("name", "wall"), [("D8-2x1", 1.5e-4), ("D8-1x2", 1e-4)])
def test_soft_roofs_on_a_stiff_floor_meet_past_the_limit_point(
    name: str, wall: float
) -> None:
    """Along the strip, and across it with the mirror image."""
    soft = named_device(name, 2).with_values(
        upper_modulus=0.8e6,
        lower_modulus=5e6,
        wall=wall,
        upper_thickness=4e-5,
        lower_thickness=3e-4,
        cavity_height=3e-5,
    )
    problem = Model(level="draft").problem(soft)
    follower = PathFollower(problem)

    def met(_: object) -> bool:
        return follower.self_contact is not None or follower.counters.steps > 100

    points = follower.run(np.array([150e3]), keep_all=True, far_enough=met).points
    assert follower.limit is not None
    assert follower.self_contact is not None
    path = [point for _, point in points if point is not follower.limit]
    apart = [not overlapping(problem.mesh, point.x) for point in path]
    meeting = apart.index(False)
    assert all(apart[:meeting])
    assert not any(apart[meeting:])
    step = sorted(point.pressure for point in path[meeting - 1 : meeting + 1])
    assert step[0] < follower.self_contact < step[1]
