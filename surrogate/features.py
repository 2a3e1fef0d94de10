"""Dimensionless inputs of the networks and the dimensional terms they weigh.

The problem depends on p/E and on ratios of lengths alone.  Networks therefore see
nothing but dimensionless numbers, and their answers are weights on terms that carry
the dimension of the output.  A device scaled in size or in modulus gets exactly the
scaled answer, and every term vanishes at zero pressure, so the answer does too.

    y_o(design, p) = sum_k B_ok(design, p) c_ok(features),    B_ok(design, 0) = 0

Effects can bring dimensions of their own and a response without pressure.  A model
with effects therefore gets two more kinds of input, the absolute scales of the design
and the effects' parameters, and one more term an output, which does not vanish.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from datagen.space import Space

from .baseline import Balloon, Section, balloons, rise_of, section

Array = np.ndarray
Columns = Mapping[str, Array]
"""(n,) arrays, SI, by the names of the variables of the design space."""

FEATURES_VERSION = 1
"""Changes with the meaning of the features: older weights are then refused."""

GROUPS = (
    "balloon_length/balloon_width",
    "balloon_width/upper_thickness",
    "lower_thickness/upper_thickness",
    "upper_modulus/lower_modulus",
    "cavity_height/upper_thickness",
    "wall_x/balloon_width",
    "wall_y/balloon_width",
    "rim/balloon_width",
    "balloon_start/balloon_width",
    "tip_margin/balloon_width",
    "divisions_x",
    "divisions_y",
)
"""Dimensionless groups of a design; a balloon's sizes are those of one balloon."""

TERMS: dict[str, tuple[str, ...]] = {
    "tip_deflection": ("thrust", "offset thrust", "roof tension", "floor tension"),
    "bending_angle": ("thrust", "offset thrust", "roof tension", "floor tension"),
    "inflation": ("roof rise",),
    "inflation_lower": ("floor rise",),
    "cavity_volume": ("roof volume", "floor volume"),
}
"""Terms B_ok of each output, in the order of the networks' weights."""

POSITIVE = ("inflation", "inflation_lower", "cavity_volume")
"""Outputs that never change sign along a path without effects."""

TURNED_OVER = {
    "tip_deflection": ("tip_deflection", -1.0),
    "bending_angle": ("bending_angle", -1.0),
    "inflation": ("inflation_lower", 1.0),
    "inflation_lower": ("inflation", 1.0),
    "cavity_volume": ("cavity_volume", 1.0),
}
"""Which output of a strip each output of the strip turned over is, and its sign."""


def term_owners(effects: bool) -> Array:
    """(k,) int array: the output that each term belongs to, by its place in `TERMS`."""
    counts = [len(terms) + effects for terms in TERMS.values()]
    return np.repeat(np.arange(len(counts)), counts)


def positive_terms(effects: bool) -> Array:
    """(k,) bool array: terms whose weight is positive.

    Those of outputs that never change sign; effects can make any output do so.
    """
    positive = np.array([name in POSITIVE and not effects for name in TERMS])
    chosen: Array = positive[term_owners(effects)]
    return chosen


@dataclass(frozen=True)
class Prepared:
    """Designs, and everything about them that needs no pressure.

    Parameters
    ----------
    columns : mapping of (n,) arrays, SI
    both : Balloon
        Roof and floor.
    beam : Section
    inputs : (n, f) array
        Dimensionless inputs that are the same at every load step.
    effects : bool
        Whether parameters of effects are among them.
    """

    columns: Columns
    both: Balloon
    beam: Section
    inputs: Array
    effects: bool

    @property
    def limit_scale(self) -> Array:
        """(n,) Pa.  Closed-form estimate of the limit pressure."""
        return self.both.limit_pressure

    def __len__(self) -> int:
        return len(self.inputs)

    def __getitem__(self, some: slice) -> Prepared:
        """Those designs alone."""
        return Prepared(
            {name: column[some] for name, column in self.columns.items()},
            self.both[some],
            self.beam[some],
            self.inputs[some],
            self.effects,
        )


@dataclass(frozen=True)
class Features:
    """What the networks see and what they weigh.

    Parameters
    ----------
    point : (n, s, f) array
        Dimensionless inputs at each load step.
    terms : (n, s, k) array, SI
        The terms of all outputs, in the order of `TERMS`; exactly 0 at zero pressure
        without effects.
    """

    point: Array
    terms: Array


def columns_of(names: tuple[str, ...], inputs: Array) -> dict[str, Array]:
    """(n,) arrays by name from an (n, d) array."""
    return {name: inputs[:, i] for i, name in enumerate(names)}


def effect_inputs(columns: Columns, space: Space) -> Array | None:
    """(n, e) further inputs of a model with effects; None without.

    Each parameter of an effect over its range, then the absolute scales.
    """
    parameters = [p for p in space if "." in p.name]
    if not parameters:
        return None
    unit = [
        2 * (columns[p.name] - p.lower) / (p.upper - p.lower) - 1 for p in parameters
    ]
    scales = [np.log(columns[name]) for name in ("upper_modulus", "upper_thickness")]
    return np.stack([*unit, *scales], axis=1)


def groups(columns: Columns) -> Array:
    """(n, g) dimensionless groups of `GROUPS`: logarithms of ratios, and counts.

    A wall between balloons counts only where there are two balloons to part: it
    enters as log(1 + ratio), which is 0 without one.
    """
    c = columns
    nx, ny = c["divisions_x"], c["divisions_y"]
    long, wide = c["balloon_length"] / nx, c["balloon_width"] / ny
    roof = c["upper_thickness"]
    wall = c["wall"] / wide
    ratios = [
        long / wide,
        wide / roof,
        c["lower_thickness"] / roof,
        c["upper_modulus"] / c["lower_modulus"],
        c["cavity_height"] / roof,
        1 + wall * (nx > 1),
        1 + wall * (ny > 1),
        c["rim"] / wide,
        c["balloon_start"] / wide,
        c["tip_margin"] / wide,
        nx,
        ny,
    ]
    logs: Array = np.log(np.stack(ratios, axis=1))
    return logs


def turned_over(columns: Columns) -> dict[str, Array]:
    """The same strips upside down.

    The spacer is of the lower material, so it then is of the upper one; without
    effects nothing else tells up from down.  `TURNED_OVER` says what becomes of the
    outputs.
    """
    c = dict(columns)
    for kind in ("thickness", "modulus"):
        upper, lower = f"upper_{kind}", f"lower_{kind}"
        c[upper], c[lower] = columns[lower], columns[upper]
    c["spacer_modulus"] = columns["lower_modulus"]
    return c


def prepare(columns: Columns, space: Space) -> Prepared:
    """Closed forms and dimensionless inputs of designs.

    Parameters
    ----------
    columns : mapping of (n,) arrays, SI
        ``spacer_modulus`` is that of the lower layer where it is not given.
    space : Space
        Says which of the columns are parameters of effects.
    """
    c = {"spacer_modulus": columns["lower_modulus"], **columns}
    both, beam = balloons(c), section(c)
    height = c["lower_thickness"] + c["cavity_height"] + c["upper_thickness"]
    middle = c["lower_thickness"] + c["cavity_height"] / 2
    long = c["balloon_length"] / c["divisions_x"]
    # How free a balloon's edge is to be drawn in by roof and floor: their tension
    # against the in-plane bending of the rim, a clamped beam as long as the balloon.
    pull = (both.shear_modulus * both.thickness).sum(axis=0) / both.half_width
    rim = 32 * c["spacer_modulus"] * height * (c["rim"] / long) ** 3 / long
    own = [
        (beam.neutral - middle) / height,
        np.log(beam.stiffness / (beam.axial * height**2)),
        np.log(both.load_scale[0] / both.load_scale[1]),
        np.log1p(pull / rim),
        both.aspect,
        1 / both.slenderness[0],
        1 / both.slenderness[1],
        np.log(c["spacer_modulus"] ** 2 / (c["upper_modulus"] * c["lower_modulus"])),
    ]
    inputs = [groups(c), np.stack(own, axis=1)]
    extra = effect_inputs(c, space)
    if extra is not None:
        inputs.append(extra)
    return Prepared(
        c, both, beam, np.concatenate(inputs, axis=1), effects=extra is not None
    )


def features(prepared: Prepared, pressure: Array, limit: Array) -> Features:
    """Inputs of the networks and their terms.

    Parameters
    ----------
    prepared : Prepared
        n designs.
    pressure : (n, s) array, Pa
        Any sign: the terms are odd in it.
    limit : (n,) array, Pa
        Predicted limit pressure.
    """
    both = prepared.both
    size = np.abs(pressure)
    load = size / both.load_scale[:, :, None]
    x, arc = rise_of(load, both.bending[:, :, None], both.membrane[:, None])
    plate = load / both.bending[:, :, None]
    relative = size / limit[:, None]
    moving = (
        *np.log1p(plate),
        *np.log1p(5 * load),
        *x,
        np.minimum(relative, 1.5),
        # Responses end at the limit point like a square root, here rounded off by
        # what is not known of its place.
        np.sqrt(1 - relative + np.hypot(1 - relative, 0.05)),
    )
    fixed = prepared.inputs.shape[1]
    point = np.empty((*pressure.shape, fixed + len(moving)))
    point[..., :fixed] = prepared.inputs[:, None, :]
    for i, values in enumerate(moving):
        point[..., fixed + i] = values
    return Features(point, _terms(prepared, pressure, x, arc))


def _terms(prepared: Prepared, pressure: Array, x: Array, arc: Array) -> Array:
    """(n, s, k) terms; `x` and `arc` are (2, n, s), roof and floor."""
    c, both, beam = prepared.columns, prepared.both, prepared.beam
    nx, ny = c["divisions_x"], c["divisions_y"]
    long, wide = c["balloon_length"] / nx, c["balloon_width"] / ny
    rise = np.copysign(both.half_width[:, None] * x, pressure)
    # Membrane stress along x over mu: l - l^-3 where the arc lies along x (a balloon
    # short in x), 1 - l^-2 (plane strain) where it lies across; l = 1/arc.
    share = (long**2 / (long**2 + wide**2))[:, None]
    stress = share * (1 - arc**2) + (1 - share) * (1 / arc - arc**3)
    strength = both.shear_modulus * both.thickness * c["balloon_width"]
    tension = np.copysign(strength[:, :, None] * stress, pressure)
    height = c["lower_thickness"] + c["cavity_height"] + c["upper_thickness"]
    middle = c["lower_thickness"] + c["cavity_height"] / 2
    top = height - c["upper_thickness"] / 2 - beam.neutral
    bottom = beam.neutral - c["lower_thickness"] / 2
    thrust = c["cavity_height"] * c["balloon_width"]
    turn = (c["balloon_length"] / beam.stiffness)[:, None] * np.stack(
        [
            pressure * (thrust * height)[:, None],
            pressure * (thrust * (beam.neutral - middle))[:, None],
            tension[0] * (top[:, None] + np.abs(rise[0]) / 2),
            -tension[1] * (bottom[:, None] + np.abs(rise[1]) / 2),
        ]
    )
    span = c["balloon_length"] + (nx - 1) * c["wall"]
    arm = (c["tip_margin"] + span / 2)[:, None]
    area = c["balloon_length"] * c["balloon_width"]
    by_output = {
        "tip_deflection": turn * arm,
        "bending_angle": turn,
        "inflation": rise[:1],
        "inflation_lower": rise[1:],
        "cavity_volume": rise * (area / 2)[:, None],
    }
    if prepared.effects:
        # What effects do without pressure, in sizes of the device.
        sizes = {
            "tip_deflection": c["balloon_length"],
            "bending_angle": np.ones(len(area)),
            "inflation": both.half_width,
            "inflation_lower": both.half_width,
            "cavity_volume": area * both.half_width,
        }
        for name, value in sizes.items():
            offset = np.broadcast_to(value[:, None], pressure.shape)[None]
            by_output[name] = np.concatenate([by_output[name], offset])
    terms: Array = np.concatenate([by_output[name] for name in TERMS])
    return np.moveaxis(terms, 0, 2)
