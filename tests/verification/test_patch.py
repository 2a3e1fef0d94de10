"""Distorted patches: uniform states, rigid motions, derivatives, initial strain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_matrix, triu

from datagen.bricks import Brick, closed
from datagen.continuation import PathFollower
from datagen.equilibrium import Equilibrium, Workspace
from datagen.materials import Energy, Gent, Hyperelastic, MooneyRivlin, Yeoh
from datagen.mesh import reference
from datagen.problem import Body

from . import bodies

Array = np.ndarray

ENERGIES = [None, Gent(0.1), Yeoh(0.085, 0.0058), MooneyRivlin(0.2)]
BULK = 25.0


def turn(angle: float, axis: tuple[float, float, float]) -> Array:
    """Rotation by Rodrigues' formula."""
    n = np.array(axis) / np.linalg.norm(axis)
    cross = np.cross(np.eye(3), -n)
    rotation: Array = (
        np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    )
    return rotation


STRETCH = np.array([[1.4, 0.3, 0.1], [0.0, 0.8, 0.2], [0.0, 0.0, 0.9]])
TENSION = np.array([[1.4, 0.1, 0.0], [0.0, 1.15, 0.1], [0.0, 0.0, 0.66]])
"""All principal stresses are tensions: dead pressures make a free block turn over."""

ROTATION = turn(2.4, (1.0, -2.0, 0.5))


def block(energy: Energy | None = None, growth: Array | None = None) -> Body:
    """A free block of 27 distorted elements."""
    part = bodies.patch(0.3)
    mesh = closed(part, np.zeros((0, 9), dtype=np.int64))
    cells = len(part.cells)
    grown = None if growth is None else np.tile(growth, (cells, 1, 1))
    free = np.zeros(part.nodes.shape, dtype=bool)
    return bodies.body(mesh, free, 1 / 3, BULK, energy, growth=grown)


def nominal(energy: Energy | None, f: Array) -> Array:
    """First Piola-Kirchhoff stress (3, 3) of a law with its volumetric energy."""
    law = Hyperelastic() if energy is None else Hyperelastic(energy)
    one = np.ones(1)
    answer = law.respond(f.reshape(1, 9), one, np.zeros((1, 0)), 1.0, False)
    j = np.linalg.det(f)
    return answer.stress.reshape(3, 3) + BULK * (j - 1) * j * np.linalg.inv(f).T


def surface_forces(part: Brick, stress: Array) -> Array:
    """Nodal forces (n, 3) of a uniform nominal stress on a block's flat faces."""
    forces = np.zeros(part.nodes.shape)
    share = reference().face_weight @ reference().face_shape / 9
    for (axis, side), faces in part.sides.items():
        traction = stress[:, axis] * (1 if side else -1)
        for face in faces:
            forces[face] += np.outer(share, traction)
    return forces


@pytest.mark.parametrize("energy", ENERGIES)
def test_nodal_forces_of_a_uniform_state_are_exact(energy: Energy | None) -> None:
    """Zero inside, the nominal stress on the faces; large stretch and rotation."""
    body = block(energy)
    f = ROTATION @ STRETCH
    equations = Equilibrium(body, Workspace())
    found = equations.extend(equations.evaluate(body.nodes @ f.T, 0.0).residual)
    right = surface_forces(bodies.patch(0.3), nominal(energy, f))
    assert np.abs(found - right).max() < 1e-12 * np.abs(right).max()


def test_initial_strain_of_any_size_gives_its_stress() -> None:
    """P = Jg Pe Fg^-T with F = Fe Fg: the forces of a grown block that is held."""
    growth = turn(0.4, (0, 0, 1)) @ np.diag([1.2, 0.9, 1.1])
    body = block(growth=growth)
    f = ROTATION @ STRETCH
    equations = Equilibrium(body, Workspace())
    found = equations.extend(equations.evaluate(body.nodes @ f.T, 0.0).residual)
    inverse = np.linalg.inv(growth)
    stress = np.linalg.det(growth) * nominal(None, f @ inverse) @ inverse.T
    right = surface_forces(bodies.patch(0.3), stress)
    assert np.abs(found - right).max() < 1e-12 * np.abs(right).max()


def test_rigid_rotation_gives_no_stress() -> None:
    body = block()
    equations = Equilibrium(body, Workspace())
    moved = body.nodes @ ROTATION.T + np.array([1.0, -2.0, 0.5])
    assert np.abs(equations.stress(moved)).max() < 1e-12
    assert np.abs(equations.evaluate(moved, 0.0).residual).max() < 1e-12


@pytest.mark.parametrize("energy", ENERGIES)
def test_solved_patch_takes_the_uniform_state(energy: Energy | None) -> None:
    """Dead surface forces of a uniform stress stretch a distorted patch uniformly."""
    part = bodies.patch(0.3)
    fixed = np.zeros(part.nodes.shape, dtype=bool)
    for corner, held in (((0, 0, 0), 3), ((1, 0, 0), 2), ((0, 1, 0), 1)):
        node = int(np.argmin(np.abs(part.nodes - corner).sum(axis=1)))
        fixed[node, 3 - held :] = True
    forces = surface_forces(part, nominal(energy, TENSION))
    body = replace(block(energy), fixed=fixed, forces=forces)
    follower = PathFollower(body)
    assert np.abs(follower.point.x - body.nodes @ TENSION.T).max() < 1e-8


@pytest.mark.parametrize("energy", ENERGIES)
def test_tangent_is_the_derivative_of_the_residual(energy: Energy | None) -> None:
    """Of elements and follower pressure, in a distorted state."""
    body = bodies.sphere(1.5, 1, 1, BULK, energy)
    equations = Equilibrium(body, Workspace())
    rng = np.random.default_rng(1)

    def random() -> Array:
        return equations.extend(rng.normal(size=equations.unknowns))

    x = 1.1 * body.nodes + 0.01 * random()
    ev = equations.evaluate(x, 0.7, tangent=True)
    direction = random()
    step = 1e-6 * direction
    ahead, behind = equations.evaluate(x + step, 0.7), equations.evaluate(x - step, 0.7)
    slope = (ahead.residual - behind.residual) / 2e-6
    pattern, n = equations.pattern, equations.unknowns
    upper = csr_matrix((ev.tangent, pattern.indices, pattern.indptr), shape=(n, n))
    whole = upper + triu(upper, 1).T
    product = whole @ equations.restrict(direction)
    assert np.abs(slope - product).max() < 1e-7 * np.abs(slope).max()
    swept = (ahead.volume - behind.volume) / 2e-6
    assert swept == pytest.approx(
        ev.volume_gradient @ equations.restrict(direction), rel=1e-7
    )
