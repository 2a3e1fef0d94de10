"""The benchmarks' bodies, all for the solver as it is.

Dimensionless: the shear modulus is 1, and so is the length that a closed form divides
by.  Symmetric bodies fill the first octant or quadrant around the origin, and their
planes of symmetry hold the displacement across them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from datagen.bricks import Brick, brick, closed, fan, merge, rim
from datagen.elements import local_share
from datagen.materials import Energy, Hyperelastic, NeoHookean
from datagen.mesh import LOWER, UPPER, Mesh, graded
from datagen.problem import Body

from .following import end_load

Array = np.ndarray


def body(
    mesh: Mesh,
    fixed: Array,
    thin: float,
    bulk: float,
    energy: Energy | None = None,
    modulus: Array | None = None,
    growth: Array | None = None,
    forces: Array | None = None,
) -> Body:
    """A weightless body; `bulk` is that of an element over its shear `modulus`."""
    law = Hyperelastic(energy or NeoHookean())
    shear = np.ones(len(mesh.cells)) if modulus is None else modulus
    return Body(
        mesh=mesh,
        thin=thin,
        nodes=mesh.nodes,
        laws=(law, law),
        shear_modulus=shear,
        bulk_modulus=bulk * shear,
        growth=growth,
        density=np.zeros(len(mesh.cells)),
        gravity=np.zeros(3),
        fixed=fixed,
        forces=forces,
        local_share=local_share(shear, bulk * shear),
    )


def at(nodes: Array, axis: int, value: float) -> Array:
    """Nodes (n,) in a plane across an axis."""
    near: Array = np.abs(nodes[:, axis] - value) < 1e-9 * np.ptp(nodes)
    return near


def hold_symmetry(nodes: Array, *axes: int) -> Array:
    """Displacements (n, 3) held by symmetry planes through the origin."""
    fixed = np.zeros(nodes.shape, dtype=bool)
    for axis in axes:
        fixed[:, axis] = at(nodes, axis, 0.0)
    return fixed


def slice_of(part: Brick, cavity: Array, depth: float) -> tuple[Mesh, Array]:
    """Plane strain between z = 0 and `depth`: the mesh, and its held displacements.

    The cavity's end at `depth` is closed by a fan around a held node on the z axis.
    """
    fixed = hold_symmetry(part.nodes, 2)
    end = at(part.nodes, 2, depth)
    fixed[end, 2] = True
    apex = len(part.nodes)
    cap = fan(rim(cavity, end), apex)
    nodes = np.concatenate([part.nodes, [[0.0, 0.0, depth]]])
    whole = Brick(nodes, part.cells, part.centre, part.sides)
    fixed = np.concatenate([fixed, np.ones((1, 3), dtype=bool)])
    return closed(whole, np.concatenate([cavity, cap])), fixed


def sphere(
    k: float,
    through: int,
    around: int,
    bulk: float,
    energy: Energy | None = None,
) -> Body:
    """Octant of a thick sphere, radii 1 and k, of three patches of a projected cube.

    through, around : elements through the wall and along 45 degrees of a patch.
    """

    def place(r: Array, s: Array, t: Array) -> tuple[Array, Array, Array]:
        y, z = np.tan(s * np.pi / 4), np.tan(t * np.pi / 4)
        x = r / np.sqrt(1 + y**2 + z**2)
        return x, x * y, x * z

    side = np.linspace(0, 1, around + 1)
    patch = brick(np.linspace(1, k, through + 1), side, side, place)
    turned = [
        Brick(
            np.roll(patch.nodes, turn, axis=1), patch.cells, patch.centre, patch.sides
        )
        for turn in range(3)
    ]
    part = merge(turned, 1e-9)
    mesh = closed(part, part.sides[0, 0])
    fixed = hold_symmetry(part.nodes, 0, 1, 2)
    return body(mesh, fixed, k - 1, bulk, energy)


def tube(
    k: float,
    through: int,
    around: int,
    bulk: float,
    energy: Energy | None = None,
) -> Body:
    """Quarter of a thick tube in plane strain, radii 1 and k.

    through, around : elements through the wall and along 90 degrees.
    """

    def place(r: Array, s: Array, t: Array) -> tuple[Array, Array, Array]:
        angle = s * np.pi / 2
        return r * np.cos(angle), r * np.sin(angle), t

    depth = (k - 1) / through
    part = brick(
        np.linspace(1, k, through + 1),
        np.linspace(0, 1, around + 1),
        np.array([0.0, depth]),
        place,
    )
    mesh, fixed = slice_of(part, part.sides[0, 0], depth)
    fixed |= hold_symmetry(mesh.nodes, 0, 1)
    return body(mesh, fixed, k - 1, bulk, energy)


def membrane(
    thickness: float,
    through: int,
    along: int,
    bulk: float,
    energy: Energy | None = None,
) -> Body:
    """Half of a long clamped strip, 0 < x < 1, over a cavity of no height at first.

    Its elements are graded towards the clamp, where it bends.
    """
    part = brick(
        graded(1.0, 0.0, along, thickness)[::-1],
        np.linspace(0, thickness, through + 1),
        np.array([0.0, thickness]),
    )
    mesh, fixed = slice_of(part, part.sides[1, 0], thickness)
    fixed |= hold_symmetry(mesh.nodes, 0)
    fixed[at(mesh.nodes, 0, 1.0)] = True
    return body(mesh, fixed, thickness, bulk, energy)


def plate(
    thickness: float,
    through: int,
    along: tuple[int, int],
    first: float,
    ratio: float = 4.0,
    poisson: float = 0.48,
) -> Body:
    """Quarter of a clamped rectangular membrane, 0 < x < 1, 0 < y < ratio.

    The edges are clamped as plate theory has it: they hold the displacements in the
    plane, and across it at the lower side alone.  A face held altogether would also
    keep its thickness, which makes the membrane stiffer by about h/5 of its half width.

    first : size of the elements at the short edge, from which they grow along y.
    """
    part = brick(
        np.linspace(0, 1, along[0] + 1),
        graded(ratio, 0.0, along[1], first)[::-1],
        np.linspace(0, thickness, through + 1),
    )
    mesh = closed(part, part.sides[2, 0])
    fixed = hold_symmetry(part.nodes, 0, 1)
    edge = at(part.nodes, 0, 1.0) | at(part.nodes, 1, ratio)
    fixed[edge, :2] = True
    fixed[edge & at(part.nodes, 2, 0.0), 2] = True
    return body(mesh, fixed, thickness, 2 * (1 + poisson) / (3 * (1 - 2 * poisson)))


def beam(
    slenderness: float, along: int, through: int = 1, poisson: float = 0.48
) -> tuple[Body, Brick]:
    """Half (y > 0) of a cantilever of length 1 and square section, without a load.

    The root holds x alone, y by symmetry and z on the middle line: the section is free
    to narrow, as in beam theory.
    """
    h = 1 / slenderness
    part = brick(
        np.linspace(0, 1, along + 1),
        np.array([0.0, h / 2]),
        np.linspace(-h / 2, h / 2, through + 1),
    )
    nodes = part.nodes
    fixed = hold_symmetry(nodes, 0, 1)
    fixed[at(nodes, 0, 0.0) & (np.abs(nodes[:, 2]) < 1e-3 * h), 2] = True
    bulk = 2 * (1 + poisson) / (3 * (1 - 2 * poisson))
    none = np.zeros((0, 9), dtype=np.int64)
    return body(closed(part, none), fixed, h, bulk), part


def cantilever(
    slenderness: float, along: int, load: float, through: int = 1, poisson: float = 0.48
) -> Body:
    """The beam under a dead end load P L^2/EI along +z, spread evenly over the end."""
    bare, part = beam(slenderness, along, through, poisson)
    forces = end_load(part, 2 * (1 + poisson))(part.nodes, load)
    return replace(bare, forces=forces)


def bimorph(
    lower: float,
    upper: float,
    ratio: float,
    mismatch: float,
    along: int,
    through: int = 1,
    length: float = 20.0,
    poisson: float = 0.48,
) -> Body:
    """Half of a free strip of two layers in plane strain, 0 < x < length.

    lower, upper : thicknesses; ratio : modulus of the lower layer over the upper one's.
    The lower layer grows by +mismatch/2 in every direction, the upper one shrinks.
    """
    part = brick(
        np.linspace(0, length, along + 1),
        np.array([0.0, 1.0]),
        np.concatenate(
            [
                np.linspace(0, lower, through + 1),
                np.linspace(lower, lower + upper, through + 1)[1:],
            ]
        ),
    )
    layer = np.where(part.centre[:, 2] > lower, UPPER, LOWER)
    fixed = hold_symmetry(part.nodes, 0, 1)
    fixed[at(part.nodes, 1, 1.0), 1] = True
    fixed[at(part.nodes, 0, 0.0) & at(part.nodes, 2, 0.0), 2] = True
    sign = np.where(layer == LOWER, 0.5, -0.5)
    growth = (1 + mismatch * sign)[:, None, None] * np.eye(3)
    modulus = np.where(layer == LOWER, ratio, 1.0)
    bulk = 2 * (1 + poisson) / (3 * (1 - 2 * poisson))
    none = np.zeros((0, 9), dtype=np.int64)
    return body(
        closed(part, none, layer),
        fixed,
        min(lower, upper),
        bulk,
        modulus=modulus,
        growth=growth,
    )


def patch(distortion: float) -> Brick:
    """Block of 3 x 3 x 3 elements whose inner nodes, all of them, are displaced."""
    line = np.linspace(0, 1, 4)
    part = brick(line, line, line)
    nodes = part.nodes.copy()
    inner = ((nodes > 1e-9) & (nodes < 1 - 1e-9)).all(axis=1)
    rng = np.random.default_rng(5)
    nodes[inner] += distortion / 6 * rng.uniform(-1, 1, size=(int(inner.sum()), 3))
    return Brick(nodes, part.cells, part.centre, part.sides)
