"""Devices measured on a made-up bench by the finite-element model itself."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from datagen.device import Design, named_device
from discrepancy.measurement import Measurements, Tolerances
from examples import bench

KPA = 1e3
LOAD = np.array([10, 20, 35, 50]) * KPA
S1 = named_device("S1", 1)
DEVICES: dict[str, Design] = {
    "thin": S1.with_values(upper_thickness=75e-6),
    "S1": S1,
    "swapped": named_device("S1", 2),
}
MISMATCH = {"cure_mismatch": {"difference": -0.0005}}


SEED = 5


def measured(
    hidden: Mapping[str, Mapping[str, float]], modulus: float = 1.0
) -> tuple[Measurements, dict[str, Design]]:
    """The devices measured once, and as they are made.

    All true moduli are `modulus` times those that the tolerances would give.
    """
    made = bench.Bench(hidden, SEED, Tolerances())
    curves, truth = [], {}
    for name, stated in DEVICES.items():
        true = made.true(stated)
        assert isinstance(true, Design)
        true = true.with_values(
            upper_modulus=true.upper_modulus * modulus,
            lower_modulus=true.lower_modulus * modulus,
        )
        truth[name] = true
        curves.append(made.test(name, stated, true, LOAD, 1))
    return Measurements(tuple(curves)), truth
