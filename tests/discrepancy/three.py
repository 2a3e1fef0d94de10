"""Three small devices of two batches, read off the model with nothing but noise."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from datagen.device import named_device
from datagen.model import Model
from datagen.response import Path as LoadPath
from discrepancy.measurement import Curve

DEVICES = ((1, 95e-6), (2, 80e-6), (4, 110e-6))
"""Material case of S1 and thickness of the upper layer, m."""


def curves(
    model: Model, pressure: np.ndarray, noise: Mapping[str, float], seed: int
) -> tuple[Curve, ...]:
    """One curve of each device.

    Parameters
    ----------
    model : Model
        With the effects that are to be found.
    pressure : (s,) array, Pa
    noise : dict of str to float, SI
        Standard deviation of the noise of each quantity that is read.
    seed : int
    """
    rng = np.random.default_rng(seed)
    found = []
    for i, (case, thickness) in enumerate(DEVICES):
        design = named_device("S1", case).with_values(upper_thickness=thickness)
        response = model([design], [LoadPath(pressure)])
        values = np.stack([response.output(name)[0] for name in noise], axis=1)
        std = np.tile(list(noise.values()), (len(pressure), 1))
        found.append(
            Curve(
                device=f"D{i + 1}",
                run=1,
                orientation=0.0,
                design=design,
                load=pressure,
                time=None,
                branch=np.full(len(pressure), "loading"),
                outputs=tuple(noise),
                values=values + std * rng.normal(size=values.shape),
                std=std,
            )
        )
    return tuple(found)
