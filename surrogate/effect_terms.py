"""What the networks of a change weigh: terms that vanish where the effects are off.

The terms of `features` (with those that need no pressure), and two closed forms of a
cantilever beam for tip and angle, each times the coordinate of each parameter.
"""

from __future__ import annotations

import numpy as np

from .features import Features, Prepared, term_owners

Array = np.ndarray

TIP, ANGLE = 0, 1
"""Places of the outputs in `features.TERMS`."""

STRAIN = 0.01
"""Strain of the upper layer against the others that the first form stands for."""

WEIGHT = 1e4
"""N/m3.  Body force that the second form stands for: about that of silicone."""


def effect_owners(parameters: int) -> Array:
    """(k,) int array: the output that each term of `changed` belongs to."""
    own = np.concatenate([term_owners(effects=True), [TIP, TIP, ANGLE, ANGLE]])
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
    beam = np.broadcast_to(beam_terms(prepared)[:, None], (n, s, 4))
    terms = np.concatenate([own.terms, beam], axis=2)
    each = [terms * t[:, j, None, None] for j in range(t.shape[1])]
    return Features(own.point, np.concatenate(each, axis=2))


def beam_terms(prepared: Prepared) -> Array:
    """(n, 4) tip by strain and by weight, m, then the angle by both, rad.

    The strip as a composite cantilever of length L and bending stiffness B.  Strain of
    the upper layer bends it by kappa = E_u A_u e (z_u - z_0)/B: angle kappa L, tip
    kappa L^2/2.  A body force g of the whole section A: angle g A L^3/(6 B), tip
    g A L^4/(8 B).
    """
    c, beam = prepared.columns, prepared.beam
    span = c["balloon_length"] + (c["divisions_x"] - 1) * c["wall"]
    length = c["balloon_start"] + span + c["tip_margin"]
    across = c["balloon_width"] + (c["divisions_y"] - 1) * c["wall"]
    width = across + 2 * c["rim"]
    height = c["lower_thickness"] + c["cavity_height"] + c["upper_thickness"]
    above = height - c["upper_thickness"] / 2 - beam.neutral
    force = c["upper_modulus"] * c["upper_thickness"] * width
    curvature = STRAIN * force * above / beam.stiffness
    load = WEIGHT * width * height / beam.stiffness
    terms: Array = np.stack(
        [
            curvature * length**2 / 2,
            load * length**4 / 8,
            curvature * length,
            load * length**3 / 6,
        ],
        axis=1,
    )
    return terms
