"""The linearised residual against the assembled tangent and against differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_matrix, triu

from datagen.device import named_device
from datagen.drawn import collected, gradients, line_tables
from datagen.equilibrium import Equilibrium, Workspace
from datagen.mesh import reference
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


def test_many_fields_are_as_each_alone() -> None:
    """Padded to whole registers, and with nodes that stay as by the tangent."""
    problem, x = Model(level="draft").deformed(named_device("D8-2x2"), PRESSURE)
    linear = Linearised(Equilibrium(problem, Workspace()), x, PRESSURE, 1.0)
    deformed, undeformed = smooth(problem.nodes)
    still = np.zeros_like(x)
    dx = np.stack([deformed, still, 2 * deformed, undeformed, deformed])
    moves = np.stack([undeformed, still, 2 * undeformed, deformed, still])
    found = linear.moved(dx, moves)
    assert found.shape == (5, linear.equations.unknowns)
    for k in range(len(dx)):
        (alone,) = linear.moved(dx[k : k + 1], moves[k : k + 1])
        assert np.abs(found[k] - alone).max() < 1e-12 * np.abs(found).max()
    assert not found[1].any()
    free = linear.equations.extend(linear.equations.restrict(deformed))
    (by_nodes,) = linear.moved(free[None], still[None])
    by_tangent = linear.times(linear.equations.restrict(deformed)[:, None])[:, 0]
    assert np.abs(by_nodes - by_tangent).max() < 1e-12 * np.abs(by_tangent).max()


def test_products_of_lines_are_the_reference_element() -> None:
    """`drawn.py` counts on the order of scikit-fem's points and of our nodes."""
    unit = np.zeros((27, 3 * 27))
    for a in range(27):
        unit[a, a] = 1.0  # first component of field a
    out = np.empty((27, 9, 27))
    gradients(unit, line_tables(), np.empty((5, 27, 81)), out)
    wanted = reference().gradient  # point by node by direction
    assert np.abs(out[:, :3] - wanted.transpose(0, 2, 1)).max() < 1e-14
    assert not out[:, 3:].any()
    back = np.empty((27, 81))
    rng = np.random.default_rng(2)
    stress, fields = rng.standard_normal((27, 9, 27)), rng.standard_normal((27, 81))
    gradients(fields, line_tables(), np.empty((5, 27, 81)), out)
    collected(stress, line_tables(), np.empty((5, 27, 81)), back)
    assert np.vdot(out, stress) == pytest.approx(np.vdot(fields, back), rel=1e-12)
