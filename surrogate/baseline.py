"""Closed forms of the device: what is known before anything is learned.

A balloon's roof (or floor) is a clamped rectangular plate that turns into a membrane;
the strip is a composite beam bent by the thrust on the balloon's end walls and by the
tension of the bulged membranes.  None of these forms is accurate on its own (they are
off by tens of percent), but each has the right dimensions, the right limits and no
response at zero pressure, so that a network has only a smooth factor left to learn.

Every array is (n,) for a design or (n, s) for a design's load steps, SI.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from datagen.device import POISSON

Array = np.ndarray

LARGEST_RISE = 2.5
"""Rise over half width past which the closed form is held.

The long strip membrane carries no load of pi or more, whatever its rise.
"""

NEWTON_STEPS = 5
"""A fixed number, so that the closed form is a smooth function of its arguments."""


def membrane_load(rise: Array) -> Array:
    """Load p a/(mu t) of a long clamped neo-Hookean strip membrane, exact.

    The deformed strip is a circular arc of half opening angle theta and stretch
    l = theta / sin(theta); p a/(mu t) = (l - l^-3) sin(theta) and w/a = tan(theta/2),
    with 2 a the width, t the thickness and w the rise.  With c = sin(theta)/theta the
    load is theta (1 - c^4).

    Parameters
    ----------
    rise : array
        w/a, at least 0.
    """
    return _membrane(rise)[0]


def _membrane(rise: Array) -> tuple[Array, Array, Array]:
    """Load, its derivative by the rise, and c = sin(theta)/theta."""
    square = rise * rise
    theta = 2 * np.arctan(rise)
    dtheta = 2 / (1 + square)
    c = (rise * dtheta + TINY) / (theta + TINY)
    cube = c**3
    cosine = (1 - square) / (1 + square)
    return (
        theta * (1 - cube * c),
        (1 + 3 * cube * c - 4 * cube * cosine) * dtheta,
        c,
    )


TINY = 1e-30
"""Makes sin(theta)/theta 1 at 0."""


def rise_of(load: Array, bending: Array, membrane: Array) -> tuple[Array, Array]:
    """Rise of a clamped plate that is turning into a membrane.

    Solves bending x + membrane P(x) = load with x = w/a and P of `membrane_load`.
    The start is the real root of the small-rise cubic, P = 16/3 x^3 (Cardano); then
    Newton.

    Parameters
    ----------
    load : array
        p a/(mu t), at least 0.
    bending, membrane : array
        Coefficients of the plate's and of the membrane's stiffness, above 0.

    Returns
    -------
    x, held at `LARGEST_RISE`, and c = sin(theta)/theta of the arc.
    """
    cubic = membrane * (16 / 3)
    slope = bending / cubic
    root = np.sqrt(slope / 3)
    argument = 1.5 / (cubic * slope * root) * load
    x = np.minimum(2 * root * np.sinh(np.arcsinh(argument) / 3), LARGEST_RISE)
    for _ in range(NEWTON_STEPS):
        value, derivative, _c = _membrane(x)
        residual = bending * x + membrane * value - load
        x = x - residual / (bending + membrane * derivative)
        x = np.minimum(np.maximum(x, 0), LARGEST_RISE)
    return x, _membrane(x)[2]


@dataclass(frozen=True)
class Balloon:
    """Roof and floor of one balloon as clamped plates; roof first in (2, n) arrays.

    Parameters
    ----------
    half_width : (n,) array, m
        Half of the shorter side, a.
    aspect : (n,) array
        Shorter over longer side, 0 to 1.
    thickness : (2, n) array, m
    shear_modulus : (2, n) array, Pa
    """

    half_width: Array
    aspect: Array
    thickness: Array
    shear_modulus: Array

    def __getitem__(self, some: slice) -> Balloon:
        """Those designs alone."""
        return Balloon(
            self.half_width[some],
            self.aspect[some],
            self.thickness[:, some],
            self.shear_modulus[:, some],
        )

    @property
    def slenderness(self) -> Array:
        """(2, n) a/t."""
        ratio: Array = self.half_width / self.thickness
        return ratio

    @property
    def load_scale(self) -> Array:
        """(2, n) Pa.  mu t/a: the pressure that stretches the membrane."""
        scale: Array = self.shear_modulus / self.slenderness
        return scale

    @property
    def bending(self) -> Array:
        """(2, n) coefficient of x in p a/(mu t): plate and shear in series.

        Clamped plate w = alpha p a^4/D, D = E t^3/(12 (1 - nu^2)), with alpha = 1/24
        for the long strip and Timoshenko's table for rectangles, which
        1/(1 + 1.063 (a/b)^4) follows to 1 %.  Shear: w = p a^2/(2 k mu t), k = 5/6.
        """
        plate = 4 / (1 - POISSON) * (1 + 1.063 * self.aspect**4) / self.slenderness**2
        series: Array = 1 / (1 / plate + 0.6)
        return series

    @property
    def limit_pressure(self) -> Array:
        """(n,) Pa.  Pressure at which roof or floor grows without bound.

        c (1 + s (a/b)^2) [sum_k (mu t/(a + q t))_k^-m]^(-1/m): each membrane alone
        carries a multiple of mu t/a, less where it is thick (its middle surface is
        wider than its loaded face), more where its ends help, and two of like strength
        give way together earlier.  The four constants were fitted to limit points of
        the finite elements, which they follow to 4 % (one standard deviation).
        """
        own = self.load_scale / (1 + 0.9 / self.slenderness)
        together = (own**-3.4).sum(axis=0) ** (-1 / 3.4)
        limit: Array = 1.38 * (1 + 0.3 * self.aspect**2) * together
        return limit

    @property
    def membrane(self) -> Array:
        """(n,) factor on the long strip's membrane stiffness for a rectangle.

        1.91 for the square, 1.006 at b/a = 4 (converged bulge coefficients).
        """
        return 1 + 0.91 * self.aspect**3.7


@dataclass(frozen=True)
class Section:
    """The strip's cross-section through a balloon as a composite beam, per design.

    Heights are from the bottom of the lower layer.

    Parameters
    ----------
    neutral : (n,) array, m
        Height of the neutral axis.
    stiffness : (n,) array, N m2
        Bending stiffness about it.
    axial : (n,) array, N
        Axial stiffness.
    """

    neutral: Array
    stiffness: Array
    axial: Array

    def __getitem__(self, some: slice) -> Section:
        """Those designs alone."""
        return Section(self.neutral[some], self.stiffness[some], self.axial[some])


def section(columns: Mapping[str, Array]) -> Section:
    """Composite beam through a balloon: two membranes, rims and walls between."""
    c = columns
    solid = 2 * c["rim"] + (c["divisions_y"] - 1) * c["wall"]
    width = c["balloon_width"] + solid
    lower, gap, upper = c["lower_thickness"], c["cavity_height"], c["upper_thickness"]
    # Three layers by row: width, thickness, height of the middle.
    t = np.stack([lower, gap, upper])
    z = np.stack([lower / 2, lower + gap / 2, lower + gap + upper / 2])
    force = t * np.stack(
        [
            c["lower_modulus"] * width,
            c["spacer_modulus"] * solid,
            c["upper_modulus"] * width,
        ]
    )
    axial = force.sum(axis=0)
    neutral = (force * z).sum(axis=0) / axial
    stiffness = (force * (t * t / 12 + (z - neutral) ** 2)).sum(axis=0)
    return Section(neutral, stiffness, axial)


def balloons(columns: Mapping[str, Array]) -> Balloon:
    """Roof and floor of one balloon."""
    c = columns
    long, wide = (
        c["balloon_length"] / c["divisions_x"],
        c["balloon_width"] / c["divisions_y"],
    )
    short = np.minimum(long, wide)
    return Balloon(
        half_width=short / 2,
        aspect=short / np.maximum(long, wide),
        thickness=np.stack([c["upper_thickness"], c["lower_thickness"]]),
        shear_modulus=np.stack([c["upper_modulus"], c["lower_modulus"]])
        / (2 * (1 + POISSON)),
    )
