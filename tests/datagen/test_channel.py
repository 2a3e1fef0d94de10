"""The air channel, against a mesh that has it cut out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_matrix, triu

from datagen.continuation import PathFollower
from datagen.device import named_device
from datagen.effects import catalogue
from datagen.effects.air_channel import emptied
from datagen.equilibrium import Equilibrium, Workspace
from datagen.levels import mesh_level
from datagen.mesh import face_nodes
from datagen.model import Model
from datagen.observe import observe
from datagen.problem import Problem, baseline
from datagen.response import Path

Array = np.ndarray
KPA = 1e3


@pytest.fixture(scope="module")
def plain() -> Problem:
    return baseline(named_device(), mesh_level("draft"))


def with_channel(problem: Problem, width: float) -> Problem:
    return catalogue()["air_channel"].change(problem, width)


def cut_out(problem: Problem, gone: Array) -> Problem:
    """The problem with the elements `gone` (e,) left out of the mesh."""
    mesh, kept = problem.mesh, np.nonzero(~gone)[0]
    cells = mesh.cells[kept]
    inside = np.zeros(len(mesh.nodes), dtype=bool)
    inside[mesh.cells[gone]] = True
    used = np.zeros(len(mesh.nodes), dtype=bool)
    used[cells] = True
    walls = []
    for axis in range(3):
        for side in (0, 1):
            faces = cells[:, face_nodes(axis, side)]
            walls.append(faces[inside[faces].all(axis=1)])
    old = mesh.cavity_faces
    smaller = replace(
        mesh,
        cells=cells,
        layer=mesh.layer[kept],
        cavity_faces=np.concatenate([old[used[old].all(axis=1)], *walls]),
    )
    fixed = problem.fixed.copy()
    fixed[~used] = True
    return replace(
        problem,
        mesh=smaller,
        shear_modulus=problem.shear_modulus[kept],
        bulk_modulus=problem.bulk_modulus[kept],
        density=problem.density[kept],
        fixed=fixed,
    )


def outputs(problem: Problem, pressure: float) -> Array:
    follower = PathFollower(problem)
    done = follower.run(np.array([pressure]))
    assert done.status == "completed", done.message
    change = follower.point.volume - follower.first_volume
    return observe(problem, follower.point.x, change)


def test_a_channel_between_mesh_lines_is_a_channel_cut_out(plain: Problem) -> None:
    lines = np.unique(plain.nodes[plain.mesh.cells[:, 0], 1])
    width = 2 * float(lines[lines > 0][0])
    gone = emptied(plain, width)
    assert set(np.unique(gone)) == {0.0, 1.0}
    cut = cut_out(plain, gone == 1)
    filled, hollow, none = (
        outputs(one, 40 * KPA) for one in (with_channel(plain, width), cut, plain)
    )
    effect = np.abs(hollow - none)
    assert (np.abs(filled - hollow) < 2e-3 * effect).all()
    assert effect[0] > 1e-6  # of the tip: it has something to do


def test_the_volume_is_that_of_the_channel_too(plain: Problem) -> None:
    design, width = plain.design, 0.31e-3
    whole, bare = (
        2 * Equilibrium(one, Workspace()).volume(one.nodes)
        for one in (with_channel(plain, width), plain)
    )
    wanted = width * design.balloon_start * design.cavity_height
    assert whole - bare == pytest.approx(wanted, rel=1e-9)


def test_gas_pushes_with_the_gradient_of_its_volume(plain: Problem) -> None:
    equations = Equilibrium(with_channel(plain, 0.31e-3), Workspace())
    rng = np.random.default_rng(0)
    step = equations.extend(rng.normal(size=equations.unknowns))
    x = plain.nodes * 1.02 + 1e-6 * step
    found = equations.evaluate(x, 30 * KPA, tangent=True)
    rise = equations.volume(x + 1e-9 * step) - equations.volume(x - 1e-9 * step)
    along = equations.restrict(step)
    assert found.volume_gradient @ along == pytest.approx(rise / 2e-9, rel=1e-7)
    ahead, behind = (
        equations.evaluate(x + side * 1e-9 * step, 30 * KPA).residual
        for side in (1, -1)
    )
    pattern = equations.pattern
    upper = csr_matrix((found.tangent, pattern.indices, pattern.indptr))
    product = (upper + triu(upper, 1).T) @ along
    slope = (ahead - behind) / 2e-9
    assert np.abs(product - slope).max() < 1e-6 * np.abs(slope).max()


def values(width: float) -> Array:
    effects = {"air_channel": {"width": width}}
    model = Model(("air_channel",), "draft", effects)
    response = model([named_device()], [Path(np.array([20.0, 40.0]) * KPA)])
    assert response.path_status == ("completed",), response.message
    found: Array = response.values[0]
    return found


def test_the_width_is_felt_continuously_from_nothing_and_has_derivatives() -> None:
    model = Model(("air_channel",), "draft")
    path = [Path(np.array([20.0, 40.0]) * KPA)]
    found = model([named_device()], path, sensitivities=True)
    none, thin, thinner = values(0.0), values(4e-7), values(2e-7)
    scale = np.abs(thin - none).max(axis=0)
    assert (scale[:2] > 0).all()
    assert (scale < 1e-3 * np.abs(none).max(axis=0)).all()
    assert (np.abs((thin - none) - 2 * (thinner - none)) < 0.1 * scale).all()
    wanted = (4 * (thinner - none) - (thin - none)) / 4e-7
    assert found.jacobian is not None
    column = found.jacobian[0, :, :, -1]
    assert (np.abs(column - wanted) < 0.01 * np.abs(wanted).max(axis=0)).all()


def test_weight_is_lost_with_the_solid(plain: Problem) -> None:
    heavy = catalogue()["self_weight"].apply(plain, {"density": 1000.0})
    lighter = with_channel(heavy, 0.4e-3)
    gone = emptied(plain, 0.4e-3)
    assert np.allclose(lighter.density, 1000 * (1 - gone))
    assert (lighter.shear_modulus > 0).all()
