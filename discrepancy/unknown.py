"""An effect that has no name: smooth in load, alike for devices that are alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from datagen.device import Design

from .noise import Readings, smooth_kernel

Array = np.ndarray

ALIKE = 0.7
"""Distance of two designs, in logarithms of their fields, over which an unknown effect
is taken to change."""


def shapes_of(readings: Readings, designs: Sequence[object]) -> tuple[Array, ...]:
    """Principal shapes of an unknown effect, for each group of readings.

    Half of its variance is one shape for all devices, half changes over the logarithms
    of the design's fields with the length `ALIKE`.

    Parameters
    ----------
    readings : Readings
    designs : sequence of n Design, Bulge or Tensile
        Of each reading.

    Returns
    -------
    tuple of (n, m) arrays
    """
    spots = np.array([_traits(design) for design in designs])
    shapes = []
    for g in np.unique(readings.group):
        at = np.flatnonzero(readings.group == g)
        apart = ((spots[at][:, None] - spots[at][None]) ** 2).sum(axis=2)
        alike = 0.5 + 0.5 * np.exp(-0.5 * apart / ALIKE**2)
        kernel = smooth_kernel(readings.place[at], readings.path[at], 1.0) * alike
        kernel = kernel * readings.scale[at][:, None] * readings.scale[at][None]
        values, vectors = np.linalg.eigh(kernel)
        keep = values > 1e-4 * values.max()
        shape = np.zeros((len(readings.value), int(keep.sum())))
        shape[at] = vectors[:, keep] * np.sqrt(values[keep])
        shapes.append(shape)
    return tuple(shapes)


def _traits(specimen: object) -> Array:
    """Logarithms of what tells designs apart; one point for all other specimens."""
    if not isinstance(specimen, Design):
        return np.zeros(9)
    return np.log(
        [
            specimen.length,
            specimen.width,
            specimen.balloon_size[0],
            specimen.balloon_size[1],
            specimen.cavity_height,
            specimen.upper_thickness,
            specimen.lower_thickness,
            specimen.upper_modulus,
            specimen.lower_modulus,
        ]
    )
