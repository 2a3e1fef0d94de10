"""Small devices read off the model with nothing but noise."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from datagen.device import Design, named_device
from datagen.model import Model
from datagen.response import Path
from discrepancy.measurement import Curve


def variants(thickness: Mapping[int, float]) -> dict[str, Design]:
    """S1 of some material cases, each with an upper layer of its own, m."""
    made = thickness.items()
    return {
        f"D{i}": named_device("S1", case).with_values(upper_thickness=upper)
        for i, (case, upper) in enumerate(made, start=1)
    }


THREE = variants({1: 95e-6, 2: 80e-6, 4: 110e-6})


def curves(
    model: Model,
    pressure: np.ndarray,
    noise: Mapping[str, float],
    seed: int,
    devices: Mapping[str, Design] = THREE,
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
    devices : dict of str to Design
        By name.
    """
    rng = np.random.default_rng(seed)
    std = np.tile(list(noise.values()), (len(pressure), 1))
    found = []
    for name, design in devices.items():
        response = model([design], [Path(pressure)])
        values = np.stack([response.output(one)[0] for one in noise], axis=1)
        found.append(
            Curve(
                device=name,
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
