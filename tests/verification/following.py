"""Loads that turn with a beam, carried by the solver as dead nodal forces.

A follower end load and a pressure on one side of a beam have no potential.  The forces
are made from the last shape, the solver finds the equilibrium under them, and so on
until they are those of the shape that they make, which is then in equilibrium with the
load that follows.  The beam is half of a square bar, see `bodies.beam`; its shear
modulus and its length are 1, and loads are those of the whole.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from datagen.bricks import Brick
from datagen.chart import extrapolate
from datagen.control import Counters, Options, StepFailed
from datagen.corrector import Corrector
from datagen.equilibrium import Equilibrium, Workspace
from datagen.mesh import reference
from datagen.mixing import Mixing
from datagen.problem import Body

Array = np.ndarray

Forces = Callable[[Array, float], Array]
"""Deformed nodes (n, 3) and the load to nodal forces (n, 3)."""

SETTLED = 1e-7
"""Largest change of a force over the largest force at which forces fit the shape."""


def spread(nodes: Array, faces: Array, weigh: bool = False) -> Array:
    """Integrals (n, 3) of shape function times normal over faces (f, 9).

    weigh : times z as well.
    """
    ref, found = reference(), np.zeros(nodes.shape)
    for face in faces:
        one, two = np.einsum("qad,ai->dqi", ref.face_gradient, nodes[face])
        normal = ref.face_weight[:, None] * np.cross(one, two)
        if weigh:
            normal = normal * (ref.face_shape @ nodes[face])[:, 2:]
        found[face] += ref.face_shape.T @ normal
    return found


def end_angle(part: Brick, x: Array) -> float:
    """Rotation of the end section of deformed nodes (n, 3), rad, -pi to pi."""
    end = np.unique(part.sides[0, 1])
    across = part.nodes[end, 2] @ x[end]
    return float(np.arctan2(-across[0], across[2]))


def end_load(part: Brick, modulus: float) -> Forces:
    """Load P L^2/EI across the end section, spread evenly over it."""
    h = float(np.ptp(part.nodes[:, 2]))
    share = -spread(part.nodes, part.sides[0, 1])[:, 0] / h**2  # half of the area: 1/2

    def forces(x: Array, load: float) -> Array:
        angle = end_angle(part, x)
        across = np.array([-np.sin(angle), 0.0, np.cos(angle)])
        return np.outer(load * modulus * h**4 / 12 * share, across)

    return forces


def end_moment(part: Brick, modulus: float) -> Forces:
    """Moment M L/EI, a stress along the turned end, linear over its height."""
    share = spread(part.nodes, part.sides[0, 1], weigh=True)[:, 0]

    def forces(x: Array, load: float) -> Array:
        angle = end_angle(part, x)
        along = np.array([np.cos(angle), 0.0, np.sin(angle)])
        return np.outer(load * modulus * share, along)

    return forces


def pressure(part: Brick, modulus: float) -> Forces:
    """Load q L^3/EI, half as pressure below and half as suction above.

    One of them alone would act on a length that bending changes by h/2 times the
    curvature; half of each acts on that of the middle line.
    """
    h = float(np.ptp(part.nodes[:, 2]))

    def forces(x: Array, load: float) -> Array:
        below, above = (spread(x, part.sides[2, side]) for side in (0, 1))
        return load * modulus * h**3 / 12 / 2 * (below - above)

    return forces


def follow_forces(
    body: Body, forces: Forces, loads: Sequence[float]
) -> Iterator[Array]:
    """Shapes (n, 3) in equilibrium with loads that grow from one to the next.

    Raises
    ------
    StepFailed
        When even a small step of the load fails.
    """
    workspace = Workspace()
    plain = Equilibrium(body, workspace)
    known, step = [(0.0, body.nodes)], loads[0] / 64
    for load in loads:
        while known[-1][0] < load:
            target = min(load, known[-1][0] + step)
            try:
                x = settle(body, forces, target, extrapolate(known[-4:], target), plain)
            except StepFailed:
                step /= 4
                if step < 1e-4 * load:
                    raise
                continue
            known, step = [*known, (target, x)], 1.5 * step
        yield known[-1][1]


def settle(
    body: Body, forces: Forces, load: float, x: Array, plain: Equilibrium
) -> Array:
    """The shape in equilibrium with the load that follows it, from a shape near it.

    plain : Equilibrium
        Of the body without the load.

    Raises
    ------
    StepFailed
    """
    acting, mixing = forces(x, load), Mixing(6)
    for _ in range(30):
        loaded = replace(body, forces=acting)
        equations = Equilibrium(loaded, plain.workspace, like=plain)
        corrector = Corrector(loaded, equations, plain.workspace, Options(), Counters())
        x, _ = corrector.correct(x, 0.0, 1.0)
        change = forces(x, load) - acting
        if np.abs(change).max() < SETTLED * np.abs(acting).max():
            return x
        acting = acting + mixing.improve(change.ravel(), 0.0)[0].reshape(acting.shape)
    raise StepFailed("step_too_small", f"forces do not settle at {load}")
