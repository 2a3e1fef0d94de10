"""Elastic supports, skins, and the effects made of them."""

from __future__ import annotations

import numpy as np
import pytest

from datagen.bricks import Brick, brick, closed
from datagen.continuation import PathFollower
from datagen.device import named_device
from datagen.effects.plasma_skin import bond_faces
from datagen.effects.self_weight import GRAVITY
from datagen.errors import EffectError
from datagen.materials import Hyperelastic
from datagen.mesh import reference
from datagen.model import Model
from datagen.problem import Body
from datagen.response import Path
from datagen.surfaces import Skin, Springs

Array = np.ndarray
KPA, UM = 1e3, 1e-6

# -- a block on springs ----------------------------------------------------------------


def block() -> Brick:
    """0 < x < 2, and a unit square around the x axis."""
    side = np.linspace(-0.5, 0.5, 3)
    return brick(np.linspace(0, 2, 5), side, side)


def pulled(traction: object, springs: tuple[Springs, ...], part: Brick) -> Array:
    """Displacements (n, 3) of the block under a dead traction (3,) of y and z.

    Shear modulus 1, free to narrow at its root: u_y = 0 at y = 0, u_z = 0 at a point.
    """
    nodes, ref = part.nodes, reference()
    forces = np.zeros(nodes.shape)
    for face in part.sides[0, 1]:
        points = ref.face_shape @ nodes[face]
        area = ref.face_weight / 4  # of the four faces of the unit square
        forces[face] += np.einsum("q,qa,qi->ai", area, ref.face_shape, traction(points))  # type: ignore[operator]
    root = np.isclose(nodes[:, 0], 0)
    fixed = np.zeros(nodes.shape, dtype=bool)
    fixed[root & np.isclose(nodes[:, 1], 0), 1] = True
    fixed[(np.abs(nodes) < 1e-9).all(axis=1), 2] = True
    count = len(part.cells)
    follower = PathFollower(
        Body(
            mesh=closed(part, np.zeros((0, 9), dtype=np.int64)),
            thin=1.0,
            nodes=nodes,
            laws=(Hyperelastic(), Hyperelastic()),
            shear_modulus=np.ones(count),
            bulk_modulus=np.full(count, 5.0),
            growth=None,
            density=np.zeros(count),
            gravity=np.zeros(3),
            fixed=fixed,
            forces=forces,
            springs=springs,
        )
    )
    moved: Array = follower.point.x - nodes
    return moved


def test_a_uniform_pull_moves_the_root_by_traction_times_compliance() -> None:
    part = block()
    grip = Springs(part.sides[0, 0], 1 / 0.3, 0.0)
    moved = pulled(lambda at: at * 0 + np.array([0.5, 0, 0]), (grip,), part)
    root = np.isclose(part.nodes[:, 0], 0)
    assert moved[root, 0] == pytest.approx(0.5 * 0.3, rel=1e-7)
    assert moved[~root, 0].min() > 0.16  # and the block is drawn out from there


def test_two_supports_of_one_face_add_up() -> None:
    part = block()
    grips = tuple(Springs(part.sides[0, 0], 1 / c, 0.0) for c in (0.2, 0.1))
    moved = pulled(lambda at: at * 0 + np.array([0.5, 0, 0]), grips, part)
    root = np.isclose(part.nodes[:, 0], 0)
    assert moved[root, 0] == pytest.approx(0.5 / (5 + 10), rel=1e-7)


def test_a_moment_turns_the_root_by_moment_over_stiffness() -> None:
    """Pure bending puts c t(z) on the springs: an angle M c / I of the root."""
    part, size = block(), 1e-5
    grip = Springs(part.sides[0, 0], 1 / 0.3, 0.0)
    moved = pulled(lambda at: size * at[:, 2:] * np.array([1.0, 0, 0]), (grip,), part)
    root = np.isclose(part.nodes[:, 0], 0)
    moment, inertia = size / 12, 1 / 12
    angle = moment * 0.3 / inertia
    assert moved[root, 0] == pytest.approx(
        angle * part.nodes[root, 2], abs=2e-5 * angle
    )


def test_an_inclined_face_feels_its_own_normal() -> None:
    """Forces of a rigid shift: area times kn along the normal, kt across it."""
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    part = brick(np.array([0.0, 2.0]), np.array([0.0, 3.0]), np.array([0.0, 1.0]))
    springs = Springs(part.sides[2, 0], 7.0, 2.0)
    matrices = springs.matrices(part.nodes @ turn.T)
    total = matrices.reshape(3, 9, 3, 9).sum(axis=(1, 3))
    assert np.allclose(total, 6.0 * turn @ np.diag([2.0, 2.0, 7.0]) @ turn.T)
    assert np.allclose(matrices, matrices.swapaxes(1, 2))


# -- skins -----------------------------------------------------------------------------


@pytest.fixture
def curved() -> tuple[Skin, Array, Array]:
    """A skin on two sides of a bent brick, and its nodes before and after."""

    def place(r: Array, s: Array, t: Array) -> tuple[Array, Array, Array]:
        return r * np.cos(s), r * np.sin(s), t + 0.1 * r * s

    part = brick(np.array([1.0, 1.4]), np.array([0.0, 0.6]), np.array([0, 0.5]), place)
    faces = np.concatenate([part.sides[0, 0], part.sides[2, 1]])
    moved = 0.05 * np.random.default_rng(2).normal(size=part.nodes.shape)
    return Skin(faces, 3.0), part.nodes, part.nodes * [1.3, 0.9, 1.1] + moved


def test_forces_of_a_skin_are_derivatives_of_its_energy(
    curved: tuple[Skin, Array, Array],
) -> None:
    skin, nodes, x = curved
    force = np.zeros_like(x)
    skin.respond(nodes, x, force, False)
    assert skin.energy(nodes, nodes) == pytest.approx(0.0, abs=1e-15)
    for node in np.unique(skin.faces):
        for i in range(3):
            step = np.zeros_like(x)
            step[node, i] = 1e-6
            rise = skin.energy(nodes, x + step) - skin.energy(nodes, x - step)
            assert force[node, i] == pytest.approx(rise / 2e-6, abs=2e-9)


def test_matrices_of_a_skin_are_derivatives_of_its_forces(
    curved: tuple[Skin, Array, Array],
) -> None:
    skin, nodes, x = curved
    matrices = skin.respond(nodes, x, np.zeros_like(x), True)
    full = np.zeros((x.size, x.size))
    for face, matrix in zip(skin.faces, matrices, strict=True):
        where = (3 * face[None, :] + np.arange(3)[:, None]).ravel()
        full[np.ix_(where, where)] += matrix
    for column in range(0, x.size, 5):
        step = np.zeros(x.size)
        step[column] = 1e-6
        forces = []
        for side in (1, -1):
            forces.append(np.zeros_like(x))
            skin.respond(nodes, x + side * step.reshape(-1, 3), forces[-1], False)
        slope = (forces[0] - forces[1]).ravel() / 2e-6
        assert np.allclose(full[:, column], slope, atol=2e-8)


def test_skins_of_a_drawn_plate_are_more_of_its_thickness() -> None:
    """Nominal force (E (H + 2 h) / 3) (l - l^-2) of an incompressible plate.

    The plate is 1 by 2 by 0.2, of modulus 3, its skins are worth 0.15 on each side.
    """
    part = brick(np.linspace(0, 1, 3), np.array([0, 1.0, 2]), np.array([0, 0.2]))
    nodes, stretch, bulk = part.nodes, 1.6, 1e4
    skins = tuple(Skin(part.sides[2, side], 3 * 0.15) for side in (0, 1))
    rollers = np.stack([np.isclose(nodes[:, axis], 0) for axis in range(3)], axis=1)
    forces = np.zeros(nodes.shape)
    # Per unit of width and of l - l^-2; the skins' parts go to their own lines of
    # nodes at the plate's end, the plate's by Simpson's rule over its thickness.
    lines = {0.0: 0.15 + 0.1 / 3, 0.1: 0.4 / 3, 0.2: 0.15 + 0.1 / 3}
    for height, carried in lines.items():
        for place, weight in zip((0, 0.5, 1, 1.5, 2), (1, 4, 2, 4, 1), strict=True):
            at_end = np.isclose(nodes, [1.0, place, height]).all(axis=1)
            assert at_end.sum() == 1
            forces[at_end, 0] = (stretch - stretch**-2) * carried * weight / 6
    whole = 2 * (0.2 + 2 * 0.15) * (stretch - stretch**-2)
    assert forces[:, 0].sum() == pytest.approx(whole)
    count = len(part.cells)
    follower = PathFollower(
        Body(
            mesh=closed(part, np.zeros((0, 9), dtype=np.int64)),
            thin=0.2,
            nodes=nodes,
            laws=(Hyperelastic(), Hyperelastic()),
            shear_modulus=np.ones(count),
            bulk_modulus=np.full(count, bulk),
            growth=None,
            density=np.zeros(count),
            gravity=np.zeros(3),
            fixed=rollers,
            forces=forces,
            skins=skins,
        )
    )
    wanted = nodes * [stretch, stretch**-0.5, stretch**-0.5]
    assert np.allclose(follower.point.x, wanted, atol=2e-4)


# -- the skin of a device --------------------------------------------------------------


def skinned(stiffness: float) -> Array:
    effects = {"plasma_skin": {"stiffness": stiffness}}
    model = Model(tuple(effects), "draft", effects)
    response = model([named_device()], [Path(np.array([20.0, 40.0]) * KPA)])
    assert response.path_status == ("completed",), response.message
    found: Array = response.values[0]
    return found


def test_a_skin_makes_the_roof_stiffer_in_proportion() -> None:
    bare, little, more, much = (skinned(k)[:, 2] for k in (0.0, 0.05, 0.1, 40.0))
    assert ((bare - more) / (bare - little)) == pytest.approx(2.0, rel=0.02)
    # 40 N/m beside the roof's 237 N/m; as a roof of that much more tension.
    assert (much < 0.97 * bare).all()
    assert (much > 0.85 * bare).all()


def test_the_bond_is_where_the_layers_meet_outside_the_cavities() -> None:
    problem = Model(level="draft").problem(named_device("D8-2x2"))
    bond = bond_faces(problem)
    centre = problem.nodes[bond[:, 4]]
    roof = problem.design.lower_thickness + problem.design.cavity_height
    assert centre[:, 2] == pytest.approx(roof)
    corners = problem.nodes[bond][:, [0, 2, 6, 8]]
    sides = np.ptp(corners, axis=1)
    design = problem.design
    balloons = design.balloon_length * design.balloon_width
    wanted = (design.length * design.width - balloons) / 2
    assert np.prod(sides[:, :2], axis=1).sum() == pytest.approx(wanted)


# -- the grip of a device --------------------------------------------------------------

PRESSURE = [0.0, 20.0, 40.0]


def values(compliance: float, density: float = 0.0) -> Array:
    effects = {
        "clamp_compliance": {"compliance": compliance},
        "self_weight": {"density": density},
    }
    model = Model(tuple(effects), "draft", effects)
    response = model([named_device()], [Path(np.array(PRESSURE) * KPA)])
    assert response.path_status == ("completed",), response.message
    found: Array = response.values[0]
    return found


def test_a_stiff_grip_is_the_clamp() -> None:
    held = values(0.0)
    far, near = (np.abs(values(c) - held)[1:, :3].max(axis=0) for c in (1e-13, 1e-15))
    scale = np.abs(held).max(axis=0)[:3]
    assert (far < 1e-2 * scale).all()
    assert (near < 0.05 * far).all()


def test_weight_turns_and_lowers_the_strip_by_its_moment_and_force() -> None:
    """Sag more than at the clamp: M c L / I + V c / A of the section at the root."""
    device, density, compliance = named_device(), 300.0, 2e-9
    area = device.width * device.thickness
    void = device.balloon_length * device.balloon_width * device.cavity_height
    solid = device.length * area
    middle = device.balloon_start + device.balloon_length / 2
    force = GRAVITY * density * (solid - void)
    moment = GRAVITY * density * (solid * device.length / 2 - void * middle)
    inertia = area * device.thickness**2 / 12
    sag = compliance * (moment / inertia * device.length + force / area)
    held, yields = values(0.0, density), values(compliance, density)
    assert held[0, 0] - yields[0, 0] == pytest.approx(sag, rel=0.04)
    inflation = abs(yields[1:, 2] / held[1:, 2] - 1)
    assert inflation.max() < 1e-3


def test_pressure_alone_does_not_turn_the_grip() -> None:
    """What a yielding grip changes without weight ends with the section set free."""
    soft, softer = values(1e-8), values(5e-8)
    assert np.abs(softer[:, 0] - soft[:, 0]).max() < 3 * UM
    assert np.abs(softer[:, 2] / np.maximum(soft[:, 2], UM) - 1)[1:].max() < 1e-4


def test_derivatives_beside_off_but_not_there() -> None:
    def model(compliance: float) -> Model:
        values = {"clamp_compliance": {"compliance": compliance}}
        return Model(("clamp_compliance",), "draft", values)

    device, path = [named_device()], [Path(np.array([20.0, 40.0]) * KPA)]
    with pytest.raises(
        EffectError, match=r"clamp_compliance\.compliance: no deriv.*off"
    ):
        model(0.0)(device, path, sensitivities=True)
    at, step = 1e-9, 1e-11
    found = model(at)(device, path, sensitivities=True)
    ahead, behind = (model(at + d)(device, path).values for d in (step, -step))
    wanted = (ahead - behind)[0] / (2 * step)
    assert found.jacobian is not None
    column = found.jacobian[0, :, :, -1]
    assert found.parameters[-1] == "clamp_compliance.compliance"
    assert np.allclose(column[:, :2], wanted[:, :2], rtol=5e-3)
