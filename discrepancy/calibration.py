"""Calibrations: how far batches, layers and cameras may be from what is stated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from datagen.specimens import Tensile

from .measurement import Measurements

Array = np.ndarray

FIELDS = ("upper_modulus", "lower_modulus", "upper_thickness", "lower_thickness")
"""What is calibrated in a device, in the order of derivatives."""

LENGTHS = ("tip_deflection", "inflation", "inflation_lower")
"""Quantities that a camera's scale changes."""


@dataclass(frozen=True)
class Calibrations:
    """Calibrations of a set of readings, each with a normal prior.

    Parameters
    ----------
    names : tuple of r tuples
        ``("modulus", batch)``, ``("thickness", device, layer)``, ``("scale", curve)``.
    weights : (n, 5, r) array
        Change by one standard deviation, over the derivatives by `FIELDS` and over the
        value itself.
    """

    names: tuple[tuple[object, ...], ...]
    weights: Array

    @classmethod
    def of(
        cls, measurements: Measurements, cells: Sequence[tuple[int, int, int]]
    ) -> Calibrations:
        """Calibrations of readings (curve, step, column), by the tolerances."""
        known: dict[tuple[object, ...], int] = {}
        allowed = measurements.tolerances
        found: list[tuple[int, int, int, float]] = []
        for i, (c, _, m) in enumerate(cells):
            curve = measurements.curves[c]
            for layer, modulus in curve.layers.items():
                batch = measurements.batch_of(curve.device, layer)
                at = known.setdefault(("modulus", batch), len(known))
                field = FIELDS.index(f"{layer}_modulus")
                found.append((i, field, at, modulus * allowed.modulus))
                if not isinstance(curve.design, Tensile):
                    key = ("thickness", curve.device, layer)
                    at = known.setdefault(key, len(known))
                    field = FIELDS.index(f"{layer}_thickness")
                    found.append((i, field, at, allowed.thickness))
            if curve.outputs[m] in LENGTHS:
                at = known.setdefault(("scale", c), len(known))
                found.append((i, len(FIELDS), at, allowed.camera_scale))
        weights = np.zeros((len(cells), len(FIELDS) + 1, len(known)))
        for i, field, at, factor in found:
            weights[i, field, at] += factor
        return cls(tuple(known), weights)

    def columns(self, values: Array, fields: Array) -> Array:
        """Changes by one standard deviation of each calibration.

        Parameters
        ----------
        values : (n,) array, SI
        fields : (n, 4) array
            By the true values of `FIELDS`.

        Returns
        -------
        (n, r) array
        """
        both = np.concatenate([fields, values[:, None]], axis=1)
        columns: Array = np.matmul(both[:, None, :], self.weights)[:, 0]
        return columns
