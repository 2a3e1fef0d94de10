"""The linearised residual against the assembled tangent and against differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_matrix, triu

from datagen.device import named_device
from datagen.equilibrium import Equilibrium, Workspace
from datagen.model import Model
from datagen.rates import Linearised

PRESSURE = 40e3

Array = np.ndarray

EFFECTS: dict[str, dict[str, dict[str, float]]] = {
    "plain": {},
    "growth": {"cure_mismatch": {"difference": 5e-3}},
    "skin": {"plasma_skin": {"stiffness": 20.0}},
    "springs": {"clamp_compliance": {"compliance": 1e-10}},
    "gas": {"air_channel": {"width": 3e-4}},
    "law": {"mooney": {"second": 0.1}},
}


@pytest.mark.parametrize("kind", EFFECTS)
def test_products_are_those_of_the_assembled_tangent(kind: str) -> None:
    model = Model(tuple(EFFECTS[kind]), "draft", EFFECTS[kind])
    problem, x = model.deformed(named_device("S1"), PRESSURE)
    equations = Equilibrium(problem, Workspace())
    upper = csr_matrix(
        (
            equations.evaluate(x, PRESSURE, 1.0, True).tangent,
            equations.pattern.indices,
            equations.pattern.indptr,
        )
    )
    tangent = upper + triu(upper, 1).T
    vectors = np.random.default_rng(0).standard_normal((equations.unknowns, 2))
    wanted = tangent @ vectors
    found = Linearised(equations, x, PRESSURE, 1.0).times(vectors)
    assert np.abs(found - wanted).max() < 1e-12 * np.abs(wanted).max()


def smooth(nodes: Array) -> tuple[Array, Array]:
    """Movements (n, 3) of deformed and undeformed nodes, both of the strip's size."""
    size = np.abs(nodes).max()
    x, y, z = nodes.T
    undeformed = np.stack(
        [np.sin(3 * x / size) * z, y * x / size, z * np.cos(5 * x / size)], axis=1
    )
    deformed = np.stack(
        [0.3 * y, y * z / size, 0.1 * size * np.sin(4 * x / size)], axis=1
    )
    return deformed, undeformed


@pytest.mark.parametrize("kind", ["plain", "growth", "law"])
def test_moved_nodes_against_central_differences(kind: str) -> None:
    model = Model(tuple(EFFECTS[kind]), "draft", EFFECTS[kind])
    problem, x = model.deformed(named_device("S1"), PRESSURE)
    deformed, undeformed = smooth(problem.nodes)
    step = 1e-5
    ahead, behind = (
        Equilibrium(
            replace(problem, nodes=problem.nodes + side * step * undeformed),
            Workspace(),
        )
        .evaluate(x + side * step * deformed, PRESSURE)
        .residual
        for side in (1, -1)
    )
    wanted = (ahead - behind) / (2 * step)
    linear = Linearised(Equilibrium(problem, Workspace()), x, PRESSURE, 1.0)
    (found,) = linear.moved(deformed[None], undeformed[None])
    assert np.abs(found - wanted).max() < 1e-7 * np.abs(wanted).max()
