"""Balloons larger than drawn: the bond ends away from their edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..device import LIMITS, Design, Interval
from ..errors import InputError
from ..problem import Problem
from ..space import Parameter
from .door import effect

Array = np.ndarray


@effect(
    stage="geometry",
    parameters=[
        Parameter(
            "growth",
            unit="m",
            lower=0.0,
            upper=150e-6,
            off=0.0,
            prior="half-normal",
            source="bench practice: a bond front that stops a membrane's thickness or "
            "so short of the drawn edge, by misalignment, spilt mask or delamination",
        )
    ],
)
def bond_edge(problem: Problem, growth: float) -> Problem:
    """Every balloon longer and wider by 2 d: its edges move outwards by d = growth.

    Walls get narrower by 2 d; rim, tip margin and the way from the clamp by d.
    Between the edges the nodes move by a piecewise linear map of x and one of y.

    Raises InputError where a wall or a margin would vanish.
    """
    room, place = room_to_grow(problem.design)
    if growth > room:
        raise InputError(
            "bond_edge.growth",
            growth,
            f"at most {room:.4g} m for this device: {place}",
            "m",
        )
    design = problem.design
    x, y, _ = problem.mesh.nodes.T
    nodes = problem.nodes.copy()
    nodes[:, 0] += _outwards(x, design.balloons_x(), design.length, growth)
    nodes[:, 1] += _outwards(y, design.balloons_y(), design.width / 2, growth)
    return replace(problem, nodes=nodes)


def room_to_grow(design: Design) -> tuple[float, str]:
    """How far (m) the edges of a device's balloons can move, and what stops them.

    What is left of a wall or a margin is as narrow as a design may have it.
    """
    least, divided = LIMITS["wall"].lower, max(design.divisions_x, design.divisions_y)
    rooms = {
        "from the clamp to the first balloon": design.balloon_start - least,
        "from the last balloon to the tip": design.tip_margin - least,
        "from the balloons to the side": design.rim - least,
    }
    if divided > 1:
        rooms["between two balloons"] = (design.wall - least) / 2
    place, room = min(rooms.items(), key=lambda item: item[1])
    return max(room, 0.0), f"{least:g} m of the bond {place} have to stay"


def _outwards(
    where: Array, balloons: list[Interval], end: float, growth: float
) -> Array:
    """Displacement (n,), m, of places along one axis, from 0 to `end`.

    The edges of the balloons move outwards; 0 and `end` stay, and so does an edge
    at 0, which is the mid-plane through a balloon.
    """
    knots, moves = [0.0], [0.0]
    for left, right in balloons:
        if left > 0:
            knots.append(left)
            moves.append(-growth)
        knots.append(right)
        moves.append(growth)
    moved: Array = np.interp(where, [*knots, end], [*moves, 0.0])
    return moved
