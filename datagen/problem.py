"""One boundary-value problem, frozen; its fields are what effects may change.

Stages are applied in the order of `STAGES`, each to its own `FIELDS`: nodes are moved
in the first for the device as it was made, straight, and in the second for how it lies
without any load.  An effect that acts on the fields of two stages, as a change of
temperature does on stiffness and growth, belongs to the later one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .device import POISSON, Design
from .elements import LOCAL_SHARE, local_share
from .levels import MeshLevel
from .materials import Hyperelastic, Law
from .mesh import UPPER, Mesh, StripMesh, build_mesh
from .surfaces import Skin, Springs

Array = np.ndarray

FIELDS = {
    "geometry": ("nodes", "thin"),
    "initial shape": ("nodes", "datum"),
    "material": ("laws", "shear_modulus", "bulk_modulus", "skins"),
    "initial strain": ("growth", "swellings"),
    "body force": ("density", "gravity"),
    "boundary": ("fixed", "springs"),
    "load": ("pressure_gain", "pressure_offset", "gas", "forces"),
    "observation": ("observers",),
}
"""Fields of the problem that each stage is there to change."""

STAGES = tuple(FIELDS)
"""The fixed order in which effects act, whatever the order they are named in."""

Swelling = Callable[[float], float]
"""Time, s, to the linear strain of the whole body since; 0 at time 0 and before."""

Observer = Callable[[dict[str, float], Array, Array], dict[str, float]]
"""(outputs by name, nodes of the datum, deformed nodes) to outputs, SI."""


@dataclass(frozen=True)
class Body:
    """Everything the solver needs to know of one body under pressure.

    Parameters
    ----------
    mesh : Mesh
        Topology; its own nodes are those of the baseline.
    thin : float, m
        Thickness of the thinnest wall, by which steps and tolerances are measured.
    nodes : (n, 3) array, m
        Stress-free node positions.
    laws : (Law, Law)
        Isochoric law of the lower and of the upper layer.
    shear_modulus, bulk_modulus : (e,) array, Pa
    growth : (e, 3, 3) array or None
        Initial strain Fg of F = Fe Fg; None for the identity.
    density : (e,) array, kg/m3
    gravity : (3,) array, m/s2
        Along x, y, z; y must stay 0 for the symmetry to hold.
    fixed : (n, 3) array of bool
        Displacements that are held at zero.
    pressure_gain, pressure_offset : float, 1 and Pa
        Cavity pressure = gain times gauge pressure + offset.
    forces : (n, 3) array, N, or None
        Dead loads on the nodes, there from the start.
    local_share : float
        Of the volumetric energy that is not projected, see `elements.local_share`;
        1 gives elements of displacements alone.
    springs : tuple of Springs
        Elastic supports.
    skins : tuple of Skin
        Thin stiff layers on faces of elements.
    gas : (e,) array or None
        Share of each element that is filled with gas at the pressure of the cavities;
        its moduli and density are those of what is left of the solid.
    swellings : tuple of Swelling
        Strains that come with time: Fg becomes Fg times 1 + strain of each.
    """

    mesh: Mesh
    thin: float
    nodes: Array
    laws: tuple[Law, Law]
    shear_modulus: Array
    bulk_modulus: Array
    growth: Array | None
    density: Array
    gravity: Array
    fixed: Array
    pressure_gain: float = 1.0
    pressure_offset: float = 0.0
    forces: Array | None = None
    local_share: float = LOCAL_SHARE
    springs: tuple[Springs, ...] = ()
    skins: tuple[Skin, ...] = ()
    gas: Array | None = None
    swellings: tuple[Swelling, ...] = ()

    @property
    def loaded_at_rest(self) -> bool:
        """True when something acts on the body at zero gauge pressure."""
        weighs = bool((self.density != 0).any() and (self.gravity != 0).any())
        acts = self.growth is not None or self.forces is not None
        return weighs or acts or self.pressure_offset != 0


@dataclass(frozen=True, kw_only=True)
class Problem(Body):
    """The boundary-value problem of one device.

    Parameters
    ----------
    mesh, thin, nodes, laws, shear_modulus, bulk_modulus, growth, density, gravity,
    fixed, pressure_gain, pressure_offset, forces, local_share, springs, skins,
    gas, swellings
        See `Body`.
    design : Design
        What the problem was made from.
    mesh : StripMesh
        With its named parts.
    observers : tuple of Observer
        What the instruments make of the outputs, applied in order.
    datum : (n, 3) array, m, or None
        Node positions from which the instruments count: the straight device, also
        where the stress-free one is bent.  None where `nodes` are straight.
    """

    design: Design
    mesh: StripMesh
    observers: tuple[Observer, ...] = ()
    datum: Array | None = None

    @property
    def counted_from(self) -> Array:
        """Node positions (n, 3), m, at which every instrument reads zero."""
        return self.nodes if self.datum is None else self.datum


def lame(modulus: Array, poisson: float = POISSON) -> tuple[Array, Array]:
    """Shear and bulk modulus: E / (2 (1 + nu)) and E / (3 (1 - 2 nu)), Pa."""
    return modulus / (2 * (1 + poisson)), modulus / (3 * (1 - 2 * poisson))


def baseline(design: Design, level: MeshLevel, like: Problem | None = None) -> Problem:
    """The contract's model of a design: no effect but the pressure acts.

    Parameters
    ----------
    design : Design
    level : MeshLevel
    like : Problem, optional
        Of a design with the same divisions, on the same level: its mesh is moved.
    """
    mesh = build_mesh(design, level) if like is None else like.mesh.of(design)
    modulus = np.where(mesh.layer == UPPER, design.upper_modulus, design.lower_modulus)
    shear, bulk = lame(modulus)
    fixed = np.zeros(mesh.nodes.shape, dtype=bool)
    fixed[mesh.root] = True
    fixed[mesh.mid_plane, 1] = True
    return Problem(
        design=design,
        mesh=mesh,
        thin=min(design.upper_thickness, design.lower_thickness),
        nodes=mesh.nodes,
        laws=(Hyperelastic(), Hyperelastic()),
        shear_modulus=shear,
        bulk_modulus=bulk,
        growth=None,
        density=np.zeros(len(mesh.cells)),
        gravity=np.zeros(3),
        fixed=fixed,
        local_share=local_share(shear, bulk),
    )
