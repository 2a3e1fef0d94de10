"""What the networks of a change weigh: terms that vanish where the effects are off.

The terms of `features` (with those that need no pressure), and closed forms of a
cantilever beam for tip and angle, each times the coordinate of each parameter.
"""

from __future__ import annotations

import numpy as np

from .baseline import Section, section
from .features import Columns, Features, Prepared, term_owners

Array = np.ndarray

TIP, ANGLE = 0, 1
"""Places of the outputs in `features.TERMS`."""

STRAIN = 0.01
"""Strain of the upper layer against the others that bends the strip."""

WEIGHT = 1e4
"""N/m3.  Body force that bends it: about that of silicone."""

CURVATURE = 10.0
"""1/m.  Curvature of an unloaded strip before anything bends it."""

BEAM_OWNERS = (TIP,) * 5 + (ANGLE,) * 4
"""The output that each term of `beam_terms` belongs to."""


def effect_owners(parameters: int) -> Array:
    """(k,) int array: the output that each term of `changed` belongs to."""
    own = np.concatenate([term_owners(effects=True), BEAM_OWNERS])
    return np.tile(own, parameters)


def changed(own: Features, prepared: Prepared, t: Array) -> Features:
    """The same inputs; each term times each coordinate, so that it vanishes at off.

    Parameters
    ----------
    own : Features
        Of n designs at s load steps, with the terms that need no pressure.
    prepared : Prepared
        The same designs.
    t : (n, j) array

    Returns
    -------
    Features
        Terms in the order of `effect_owners`.
    """
    n, s, _ = own.terms.shape
    beam = beam_terms(prepared)
    beam = np.broadcast_to(beam[:, None], (n, s, beam.shape[1]))
    terms = np.concatenate([own.terms, beam], axis=2)
    each = [terms * t[:, j, None, None] for j in range(t.shape[1])]
    return Features(own.point, np.concatenate(each, axis=2))


def beam_terms(prepared: Prepared) -> Array:
    """(n, 9) closed forms in the order of `BEAM_OWNERS`: tip, m, then angle, rad.

    The strip as a composite cantilever of length L, in pieces of two sections: through
    a balloon, and solid where there is none.  Strain of the upper layer bends a piece
    by kappa = E_u A_u e (z_u - z_0)/B: angle kappa l, tip kappa l times the way from
    its middle to the tip; one term for the balloons and one for the rest.  A body force
    g of the whole section A: angle g A L^3/(6 B), tip g A L^4/(8 B).  An unloaded strip
    that is curved by k: angle k L, tip k L^2/2; one that is tilted: tip L.
    """
    c, beam = prepared.columns, prepared.beam
    walls = (c["divisions_x"] - 1) * c["wall"]
    span = c["balloon_length"] + walls
    start, margin = c["balloon_start"], c["tip_margin"]
    length = start + span + margin
    across = c["balloon_width"] + (c["divisions_y"] - 1) * c["wall"]
    width = across + 2 * c["rim"]
    height = c["lower_thickness"] + c["cavity_height"] + c["upper_thickness"]
    force = STRAIN * c["upper_modulus"] * c["upper_thickness"] * width

    def curvature(piece: Section) -> Array:
        above = height - c["upper_thickness"] / 2 - piece.neutral
        found: Array = force * above / piece.stiffness
        return found

    hollow, solid = (
        curvature(beam),
        curvature(section(_solid(c, width))),
    )
    arm = margin + span / 2
    rest = start * (length - start / 2) + margin**2 / 2 + walls * arm
    load = WEIGHT * width * height / beam.stiffness
    terms: Array = np.stack(
        [
            hollow * c["balloon_length"] * arm,
            solid * rest,
            load * length**4 / 8,
            CURVATURE * length**2 / 2,
            length,
            hollow * c["balloon_length"],
            solid * (start + walls + margin),
            load * length**3 / 6,
            CURVATURE * length,
        ],
        axis=1,
    )
    return terms


def _solid(columns: Columns, width: Array) -> Columns:
    """Columns of a cross-section of some width that is rim alone."""
    nothing, one = np.zeros_like(width), np.ones_like(width)
    return {**columns, "balloon_width": nothing, "divisions_y": one, "rim": width / 2}
