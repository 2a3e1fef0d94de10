"""Every benchmark by the solver, within the bar of its mesh."""

from __future__ import annotations

import numpy as np
import pytest

from datagen.continuation import PathFollower

from . import bodies
from . import closed_forms as exact
from .benchmarks import BENCHMARKS, BOUND, follow, run

QUICK = ("tube", "strip", "bimorph")
"""Benchmarks whose fine mesh is cheap; ``make verification`` does all of them."""


def outside(name: str, level: str) -> list[str]:
    """Rows of a benchmark that are not within the bar of its mesh."""
    rows = run(name, level)
    assert rows
    return [
        f"{row.case}, {row.quantity}: {row.exact:.6g} exactly, {row.computed:.6g}"
        for row in rows
        if not abs(row.error) <= BOUND[level]
    ]


@pytest.mark.parametrize("name", BENCHMARKS)
def test_standard_mesh(name: str) -> None:
    assert outside(name, "standard") == []


@pytest.mark.parametrize("name", QUICK)
def test_fine_mesh(name: str) -> None:
    assert outside(name, "fine") == []


def test_sphere_goes_through_its_limit_pressure() -> None:
    """One maximum, found by the follower, and a falling path of growing spheres."""
    limit, stretch = exact.sphere_limit(1.1)
    body = bodies.sphere(1.1, 2, 2, 1e3)
    follower, points = follow(body, 1.1 * limit, swelling=27.0)
    assert follower.limit is not None
    assert follower.limit.pressure == pytest.approx(limit, rel=2e-3)
    swelling = (follower.limit.volume / follower.first_volume) ** (1 / 3)
    assert swelling == pytest.approx(stretch, rel=2e-3)
    highest = int(np.argmax([point.pressure for point in points]))
    # The point that first lay beyond the limit comes before the limit found from it.
    ordered = sorted(points, key=lambda point: point.volume)
    pressures = np.array([point.pressure for point in ordered])
    top = int(np.argmax(pressures))
    assert points[highest] is ordered[top]
    assert (np.diff(pressures[: top + 1]) > 0).all()
    assert (np.diff(pressures[top:]) < 0).all()
    end = (follower.point.volume / follower.first_volume) ** (1 / 3)
    assert end > 3


def test_stability_is_lost_at_the_limit() -> None:
    """The tangent has one negative eigenvalue beyond the limit, none before."""
    limit, _ = exact.sphere_limit(1.5)
    body = bodies.sphere(1.5, 1, 1, 25.0)
    follower, points = follow(body, 1.1 * limit, swelling=27.0)
    assert follower.limit is not None
    peak = follower.limit.volume
    before = [point.negative for point in points if point.volume < 0.99 * peak]
    beyond = [point.negative for point in points if point.volume > 1.01 * peak]
    assert len(before) > 2
    assert set(before) == {0}
    assert len(beyond) > 2
    assert set(beyond) == {1}


def test_closed_cavities_have_their_volume() -> None:
    """Planes through the origin and fans close the cavities of the bodies."""
    octant = PathFollower(bodies.sphere(1.5, 1, 4, 25.0)).first_volume
    assert octant == pytest.approx(np.pi / 6, rel=2e-5)
    quarter = bodies.tube(1.5, 1, 8, 25.0)
    depth = quarter.nodes[:, 2].max()
    volume = PathFollower(quarter).first_volume
    assert volume == pytest.approx(np.pi / 4 * depth, rel=5e-6)
    flat = bodies.membrane(0.01, 1, 4, 25.0)
    follower = PathFollower(flat)
    assert abs(follower.first_volume) < 1e-18
    # A parabola over the strip: the area under it is 2/3 of its height.
    x = flat.nodes.copy()
    inner = np.arange(len(x) - 1)  # all but the apex of the fan
    x[inner, 1] += 0.3 * (1 - x[inner, 0] ** 2)
    assert follower.equations.volume(x) == pytest.approx(0.2 * 0.01, rel=1e-3)
