"""Test pieces of a layer's material: a membrane over a hole, and a strip in tension.

They tell a layer's modulus apart from everything else that a device does.  Both are
made as a `Body`, so that the effects that act on a device's material act on them, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from .bricks import brick, closed
from .continuation import PathFollower
from .control import Options, Outcome, StepFailed
from .device import LIMITS
from .effects.acting import act
from .equilibrium import Workspace
from .errors import InputError
from .journey import gauge
from .levels import MeshLevel
from .materials import Hyperelastic, Law
from .mesh import LOWER, UPPER, Mesh, graded
from .problem import Body, lame
from .response import CONVERGED, Path, Response

if TYPE_CHECKING:
    from .effects import Effect

Array = np.ndarray

MODES = ("uniaxial", "equibiaxial", "planar")
"""Ways to pull a tensile specimen; the first is the usual one."""

SPECIMEN_STAGES = ("material", "initial strain", "load")
"""Stages of the effects that act on a specimen: it is of the device's material and is
measured by the same gauge, and has nothing else in common with the device.  It grows
before it is clamped, and its lengths are those that it then has: of an initial strain
acts only what comes along with it, as a warm rubber's modulus does."""

STEEPEST_BULGE = 1.25
"""Largest ratio of neighbouring elements: small loads bend the membrane everywhere."""

_LAYERS = {"lower": LOWER, "upper": UPPER}


def _check_layer(layer: str) -> None:
    if layer not in _LAYERS:
        raise InputError("layer", layer, ", ".join(_LAYERS))


@dataclass(frozen=True)
class Bulge:
    """A membrane bonded over a rectangular hole and inflated from below.

    Parameters
    ----------
    length, width : float, m
        Sides of the hole, in any order.
    thickness : float, m
    modulus : float, Pa
        Young's modulus of the membrane.
    layer : str
        ``upper`` or ``lower``: the layer of the devices that it is a piece of.

    Raises
    ------
    InputError
        When a value is outside what the mesh can carry.
    """

    length: float
    width: float
    thickness: float
    modulus: float
    layer: str = "upper"

    def __post_init__(self) -> None:
        _check_layer(self.layer)
        for own, shared in (
            ("length", "balloon_length"),
            ("width", "balloon_width"),
            ("thickness", f"{self.layer}_thickness"),
            ("modulus", f"{self.layer}_modulus"),
        ):
            object.__setattr__(self, own, LIMITS[shared].check(getattr(self, own)))


@dataclass(frozen=True)
class Tensile:
    """A piece of one layer's material, stretched evenly.

    Parameters
    ----------
    modulus : float, Pa
        Young's modulus.
    mode : str
        One of `MODES`.
    layer : str
        ``upper`` or ``lower``: the layer of the devices that it is a piece of.

    Raises
    ------
    InputError
        When the modulus is outside its limits or the mode is unknown.
    """

    modulus: float
    mode: str = "uniaxial"
    layer: str = "upper"

    def __post_init__(self) -> None:
        _check_layer(self.layer)
        if self.mode not in MODES:
            raise InputError("mode", self.mode, ", ".join(MODES))
        modulus = LIMITS[f"{self.layer}_modulus"].check(self.modulus)
        object.__setattr__(self, "modulus", modulus)


def bulge_body(specimen: Bulge, level: MeshLevel) -> Body:
    """Quarter of a membrane over a rectangular hole, the baseline law in it.

    The hole's centre is the origin, x runs along the shorter side and z is the
    membrane's normal; the pressure acts on the lower face z = 0.  Along the hole's
    edge the section is held in the plane, and across it at the lower face alone: below
    lies the plate that the membrane is bonded to, above it is free to grow thinner.

    Twice as many elements as over half a balloon's width of the level, and twice as
    many again along the longer side, graded towards the clamped edges.
    """
    half = np.sort([specimen.width, specimen.length]) / 2
    thickness = specimen.thickness
    count = 2 * level.balloon_y
    across, along = (
        graded(float(half[i]), 0.0, n, first * thickness, STEEPEST_BULGE)[::-1]
        for i, n, first in (
            (0, count, 2 * level.edge_y),
            (1, 2 * count, 4 * level.edge_x),
        )
    )
    part = brick(across, along, np.linspace(0.0, thickness, level.membrane + 1))
    nodes = part.nodes
    near = 1e-9 * half[1]
    fixed = np.zeros(nodes.shape, dtype=bool)
    edge = np.zeros(len(nodes), dtype=bool)
    for axis in (0, 1):
        fixed[:, axis] = nodes[:, axis] < near
        edge |= nodes[:, axis] > half[axis] - near
    fixed[edge, :2] = True
    fixed[edge & (nodes[:, 2] < near), 2] = True
    shear, bulk = lame(np.full(len(part.cells), specimen.modulus))
    layer = np.full(len(part.cells), _LAYERS[specimen.layer])
    return Body(
        mesh=closed(part, part.sides[2, 0], layer),
        thin=thickness,
        nodes=nodes,
        laws=(Hyperelastic(), Hyperelastic()),
        shear_modulus=shear,
        bulk_modulus=bulk,
        growth=None,
        density=np.zeros(len(part.cells)),
        gravity=np.zeros(3),
        fixed=fixed,
    )


def tensile_body(specimen: Tensile) -> Body:
    """One element of a tensile specimen: a carrier of its law and moduli."""
    line = np.array([0.0, 1e-3])
    part = brick(line, line, line)
    shear, bulk = lame(np.full(1, specimen.modulus))
    return Body(
        mesh=closed(part, part.sides[2, 0], np.full(1, _LAYERS[specimen.layer])),
        thin=1e-3,
        nodes=part.nodes,
        laws=(Hyperelastic(), Hyperelastic()),
        shear_modulus=shear,
        bulk_modulus=bulk,
        growth=None,
        density=np.zeros(1),
        gravity=np.zeros(3),
        fixed=np.zeros(part.nodes.shape, dtype=bool),
    )


def with_effects(
    body: Body, effects: Sequence[tuple[Effect, dict[str, float]]]
) -> Body:
    """The body with those effects in it whose stage is one of `SPECIMEN_STAGES`.

    Parameters
    ----------
    body : Body
    effects : sequence of (Effect, values by parameter)
        In the order in which they act.

    An effect that asks for parts that only a device has does not act on a specimen.
    """
    for one, values in effects:
        if one.stage not in SPECIMEN_STAGES:
            continue
        try:
            body = act(one, body, values)
        except AttributeError as error:
            # What asks for a device's parts (a channel) is not in a specimen.
            if not isinstance(error.obj, (Body, Mesh)):
                raise
        if body.growth is not None or body.swellings:
            body = replace(body, growth=None, swellings=())
    return body


def solve_bulge(
    body: Body,
    path: Path,
    workspace: Workspace | None = None,
    options: Options | None = None,
) -> Response:
    """Deflection of the membrane's centre along the load steps.

    Parameters
    ----------
    body : Body
        Of `bulge_body`, with or without effects.
    path : Path
        Gauge pressures in the order in which they are applied.
    workspace : Workspace, optional
    options : Options, optional

    Returns
    -------
    Response
        Of one specimen; its only output is ``inflation``, m, counted from the flat
        membrane and averaged over the thickness at the hole's centre.
    """
    began = perf_counter()
    info: dict[str, object] = {}
    limit = np.nan
    try:
        follower = PathFollower(body, workspace, options)
        outcome = follower.run(path.pressure, path.time)
    except StepFailed as failure:
        outcome = Outcome().end(failure.status, f"{failure.detail}, at rest")
    else:
        info = {
            "unknowns": follower.equations.unknowns,
            "seconds": perf_counter() - began,
            **asdict(follower.counters),
        }
        if follower.limit is not None:
            limit = gauge(body, follower.limit.pressure)
    near = 1e-9 * float(np.ptp(body.nodes))
    centre = (np.abs(body.nodes[:, :2]) < near).all(axis=1)
    steps = len(path.pressure)
    values = np.full((1, steps, 1), np.nan)
    states = np.full((1, steps), outcome.status, dtype="U16")
    for i, point in outcome.points:
        values[0, i, 0] = float((point.x - body.nodes)[centre, 2].mean())
        states[0, i] = CONVERGED
    return Response(
        outputs=("inflation",),
        pressure=path.pressure[None],
        values=values,
        std=np.where(np.isfinite(values), 0.0, np.nan),
        status=states,
        path_status=(outcome.status,),
        limit_pressure=np.array([limit]),
        message=(outcome.message,),
        info=info,
    )


_HELD = {"uniaxial": (0,), "equibiaxial": (0, 1), "planar": (0, 1)}
"""Directions whose stretch the grips prescribe; the others are free of stress."""


def tensile_stress(
    law: Law,
    shear_modulus: float,
    stretch: Array,
    mode: str = "uniaxial",
    bulk_modulus: float | None = None,
    time: Array | None = None,
) -> Array:
    """Nominal stress of an evenly stretched specimen.

    F = diag(l, t, t), diag(l, l, t) or diag(l, 1, t) in uniaxial, equibiaxial and
    planar tension.  With P the law's isochoric stress the free stretch t follows from
    P_33 + p J / t = 0, p = K (J - 1), and the stress is P_11 + p J / l.  Without a
    bulk modulus J is 1 and p eliminated, P_11 - P_33 t / l, which for a strain energy
    is the textbook's (Treloar 1975, chapter 5)

        uniaxial     2 (l - l^-2) (W1 + W2 / l)
        equibiaxial  2 (l - l^-5) (W1 + W2 l^2)
        planar       2 (l - l^-3) (W1 + W2)

    Parameters
    ----------
    law : Law
        May have a history; it starts at rest.
    shear_modulus : float, Pa
    stretch : (s,) array
        In the order in which it is applied.
    mode : str
        One of `MODES`.
    bulk_modulus : float, Pa, optional
        Incompressible where it is not given.
    time : (s,) array, s, optional
        Of each stretch, for laws with history; one second a step where not given.

    Returns
    -------
    (s,) array, Pa; NaN where the law has no stress.

    Raises
    ------
    InputError
        When the mode is unknown or a stretch is not a positive number.
    """
    if mode not in _HELD:
        raise InputError("mode", mode, ", ".join(MODES))
    stretch = np.asarray(stretch, dtype=float)
    if stretch.ndim != 1 or not (np.isfinite(stretch) & (stretch > 0)).all():
        raise InputError("stretch", stretch.tolist(), "a list of positive numbers")
    steps = len(stretch)
    if not law.history_size:
        return _stress(
            law, shear_modulus, stretch, mode, bulk_modulus, np.zeros((steps, 0)), 1.0
        )[0]
    # As a path's: the test begins at 0 s, or a second before a first reading at 0 s.
    clock = np.arange(1.0, steps + 1) if time is None else np.asarray(time, dtype=float)
    duration = np.diff(clock, prepend=min(0.0, clock[0] - 1.0))
    history, stress = np.zeros((1, law.history_size)), np.empty(steps)
    for i in range(steps):
        here, history = _stress(
            law,
            shear_modulus,
            stretch[i : i + 1],
            mode,
            bulk_modulus,
            history,
            float(duration[i]),
        )
        stress[i] = here[0]
    return stress


def _stress(
    law: Law,
    mu: float,
    stretch: Array,
    mode: str,
    bulk: float | None,
    history: Array,
    dt: float,
) -> tuple[Array, Array]:
    """Nominal stress (n,), Pa, and history after a step, of n separate specimens."""
    n = len(stretch)
    moduli = np.full(n, mu)
    free = [i for i in range(3) if i not in _HELD[mode]]
    # Stretches l, t, t; l, l, t; l, 1, t.
    second = {"uniaxial": None, "equibiaxial": stretch, "planar": np.ones(n)}[mode]
    power = 1 / len(free)
    held = stretch if second is None else stretch * second
    t = held**-power

    def state(t: Array) -> Array:
        f = np.zeros((n, 9))
        f[:, 0], f[:, 4], f[:, 8] = stretch, t if second is None else second, t
        return f

    if bulk is None:
        answer = law.respond(state(t), moduli, history, dt, False)
        p = answer.stress
        return p[:, 0] - p[:, 8] * t / stretch, answer.history
    for _ in range(50):
        answer = law.respond(state(t), moduli, history, dt, True)
        j = held * t ** len(free)
        lack = answer.stress[:, 8] + bulk * (j - 1) * j / t
        slope = sum(answer.tangent[:, 9 * 8 + 4 * i] for i in free)
        slope = slope + bulk * (len(free) * (2 * j - 1) - (j - 1)) * j / t**2
        step = np.nan_to_num(-lack / slope)  # there may be no stress
        t = t + np.clip(step, -0.2 * t, 0.2 * t)
        if (np.abs(step) <= 1e-13 * t).all():
            break
    answer = law.respond(state(t), moduli, history, dt, False)
    j = held * t ** len(free)
    return answer.stress[:, 0] + bulk * (j - 1) * j / stretch, answer.history
