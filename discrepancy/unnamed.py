"""Physics that the catalogue does not know, for sets that nothing known explains.

Made like every effect and passing the same checks, but in no place where the catalogue
looks: a ranking cannot name them, and should say so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from datagen.effects import Effect, effect
from datagen.materials import EnergyDerivatives, with_energy
from datagen.mesh import UPPER, face_nodes
from datagen.problem import Problem
from datagen.space import Parameter
from datagen.surfaces import Springs

Array = np.ndarray

REACH = 0.2e-3
"""m.  Distance over which a weld and a burr fade."""

NOMINAL = 100e-6
"""m.  Thickness of a layer that cures as its batch's test piece did."""


def _one(name: str, unit: str, upper: float, source: str) -> list[Parameter]:
    """A size from 0, off, to its largest."""
    return [
        Parameter(name, unit, 0.0, upper, off=0.0, prior="half-normal", source=source)
    ]


def _from_outline(problem: Problem, points: Array) -> Array:
    """Distance (...,) in the plane of points (..., 3) from the balloons, m.

    From their outlines, inside and outside alike.
    """
    design = problem.design
    distance = np.full(points.shape[:-1], np.inf)
    x, y = points[..., 0], points[..., 1]
    for left, right in design.balloons_x():
        for near, far in design.balloons_y():
            out_x = np.maximum(left - x, x - right)
            # The plane of symmetry is no edge.
            out_y = y - far if near == 0.0 else np.maximum(near - y, y - far)
            outside = np.hypot(np.maximum(out_x, 0.0), np.maximum(out_y, 0.0))
            inside = np.minimum(np.maximum(out_x, out_y), 0.0)
            distance = np.minimum(distance, np.abs(outside + inside))
    return distance


@effect(
    stage="material",
    parameters=_one(
        "hardening",
        "1",
        4.0,
        "Sylgard 184 cured at 25 to 200 C: 1.32 to 2.97 MPa, Johnston et al. 2014, "
        "J. Micromech. Microeng. 24 035017; twice that for a charred seam",
    ),
)
def weld_ring(problem: Problem, hardening: float) -> Problem:
    """Hard seam around each balloon: mu = mu0 (1 + hardening e^(-d/r)), r = 0.2 mm.

    d is the distance from the balloon's outline in the plane of the strip; the bulk
    modulus grows alike.
    """
    mesh = problem.mesh
    distance = _from_outline(problem, mesh.nodes[mesh.cells])
    factor = 1 + hardening * np.exp(-distance / REACH).mean(axis=1)
    return replace(
        problem,
        shear_modulus=problem.shear_modulus * factor,
        bulk_modulus=problem.bulk_modulus * factor,
    )


@effect(
    stage="material",
    parameters=_one(
        "exponent",
        "1",
        2.0,
        "thin PDMS is stiffer: Liu et al. 2009, Thickness-dependent mechanical "
        "properties of PDMS membranes, J. Micromech. Microeng. 19 035028; how much is "
        "a guess, ample",
    ),
)
def cure_gradient(problem: Problem, exponent: float) -> Problem:
    """Thin layers cure harder: mu = mu0 (t / 100 um)^-exponent, t of the layer.

    The bulk modulus follows.  Devices of one thickness cannot tell it from a modulus.
    """
    design = problem.design
    upper = problem.mesh.layer == UPPER
    thickness = np.where(upper, design.upper_thickness, design.lower_thickness)
    factor = (thickness / NOMINAL) ** -exponent
    return replace(
        problem,
        shear_modulus=problem.shear_modulus * factor,
        bulk_modulus=problem.bulk_modulus * factor,
    )


@effect(
    stage="geometry",
    parameters=_one(
        "height",
        "1",
        1.5,
        "bench practice: adhesive squeezed out beside a cavity sets as a bead of up to "
        "the membrane's thickness or so",
    ),
)
def edge_burr(problem: Problem, height: float) -> Problem:
    """Bead along the balloons' edges: thickness t = t0 (1 + height e^(-d/r)).

    Of both membranes, on their outer faces; d is the distance from the balloon's
    outline in the plane of the strip and r = 0.2 mm.
    """
    design = problem.design
    z = problem.mesh.nodes[:, 2]
    bead = height * np.exp(-_from_outline(problem, problem.mesh.nodes) / REACH)
    floor, roof = design.lower_thickness, design.lower_thickness + design.cavity_height
    nodes = problem.nodes.copy()
    nodes[:, 2] += np.maximum(z - roof, 0.0) * bead
    nodes[:, 2] -= np.maximum(floor - z, 0.0) * bead
    return replace(problem, nodes=nodes)


@dataclass(frozen=True)
class Slipping:
    """What = mu/(2 s) ln(1 + s (I1bar - 3)): chains that give way when stretched.

    Parameters
    ----------
    slip : float
        s; 0 is the neo-Hookean law.
    """

    slip: float

    def derivatives(self, i1: Array, i2: Array, mu: Array) -> EnergyDerivatives:
        """What and its derivatives by I1bar; it does not depend on I2bar."""
        x, zero = i1 - 3, np.zeros_like(i1)
        room = 1 + self.slip * x
        slope = mu / 2 / room
        w = mu / 2 * (np.log1p(self.slip * x) / self.slip if self.slip else x)
        return EnergyDerivatives(w, slope, zero, -self.slip * slope / room, zero, zero)


@effect(
    stage="material",
    parameters=_one(
        "slip",
        "1",
        0.5,
        "a guess: an under-cured network at twice its length keeps half of its modulus",
    ),
)
def chain_slip(problem: Problem, slip: float) -> Problem:
    """Softening with stretch, recovered at once: What = mu/(2 s) ln(1 + s (I1bar - 3)).

    s = slip; the opposite of chains of limited length, in both layers.
    """
    lower, upper = problem.laws
    energy = Slipping(slip)
    return replace(
        problem, laws=(with_energy(lower, energy), with_energy(upper, energy))
    )


@effect(
    stage="boundary",
    parameters=_one(
        "stiffness",
        "Pa/m",
        1e7,
        "a guess: a thread or a wire at the tip, up to the strip's own stiffness",
    ),
)
def tip_tether(problem: Problem, stiffness: float) -> Problem:
    """Something holds the tip's end face back: traction t = -stiffness u."""
    mesh = problem.mesh
    far = mesh.nodes[:, 0].max()
    at_tip = mesh.nodes[:, 0] > far * (1 - 1e-9)
    ends = mesh.cells[:, face_nodes(0, 1)]
    tether = Springs(ends[at_tip[ends].all(axis=1)], stiffness, stiffness)
    return replace(problem, springs=(*problem.springs, tether))


UNNAMED: dict[str, Effect] = {
    one.name: one
    for one in (chain_slip, cure_gradient, edge_burr, tip_tether, weld_ring)
}
"""The effects of this file by name."""
