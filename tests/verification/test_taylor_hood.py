"""The second element family of docs/refinement.md is right, too."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import triu

from datagen.device import named_device
from datagen.model import Model
from docs.taylor_hood import TaylorHood

from . import bodies
from . import closed_forms as exact
from .benchmarks import SOFT, follow

PRESSURE = 20e3


def test_its_tangent_is_that_of_its_residual() -> None:
    problem, x = Model(level="draft").deformed(named_device("S1"), PRESSURE)
    family = TaylorHood(problem)
    rng = np.random.default_rng(0)
    count = family.unknowns
    _, own = family.split(1e4 * rng.standard_normal(count))
    way = rng.standard_normal(count)
    moved, more = family.split(way)
    moved, more = 1e-9 * moved, 1e2 * more
    upper, _ = family.linearised(x, own, PRESSURE)
    tangent = upper + triu(upper, 1).T
    scaled = np.where(np.arange(count) < count - len(more), 1e-9, 1e2) * way
    ahead, behind = (
        family.linearised(x + side * moved, own + side * more, PRESSURE)[1]
        for side in (1, -1)
    )
    expected = tangent @ scaled
    for part in (slice(None, -len(more)), slice(-len(more), None)):
        error = np.abs((ahead - behind) / 2 - expected)[part].max()
        assert error < 1e-6 * np.abs(expected[part]).max()


@pytest.mark.parametrize("elements", [2, 4])
def test_sphere(elements: int) -> None:
    """Thick, nu = 0.48, against its closed form; Newton's start is a percent off."""
    body = bodies.sphere(1.5, elements, elements, SOFT)
    stretch = 1.25
    pressure = exact.radial(stretch, 1.5, 3, SOFT)[0]
    follower, points = follow(body, pressure)
    nodes = body.nodes + 1.01 * (points[-1].x - body.nodes)
    found = TaylorHood(body).equilibrium(nodes, pressure)
    volume = follower.equations.volume(found)
    inner = (volume / follower.first_volume) ** (1 / 3)
    assert inner - 1 == pytest.approx(stretch - 1, rel=0.05 / elements**3)
