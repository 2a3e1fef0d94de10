"""What the tests of effects share: devices at the draft mesh with effects in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from datagen.device import Design, named_device
from datagen.levels import mesh_level
from datagen.model import Model
from datagen.problem import Problem, baseline
from datagen.response import OUTPUT_NAMES, Path

Array = np.ndarray
Active = Mapping[str, Mapping[str, float]]

TIP, ANGLE, INFLATION, INFLATION_LOWER = (
    OUTPUT_NAMES.index(name)
    for name in ("tip_deflection", "bending_angle", "inflation", "inflation_lower")
)


def values(
    pressure: Sequence[float],
    active: Active | None = None,
    design: Design | None = None,
) -> Array:
    """Outputs (s, m), SI, of S1 or another design along gauge pressures, Pa."""
    model = Model(effects=tuple(active or {}), level="draft", parameters=active or {})
    response = model([design or named_device()], [Path(np.array(pressure))])
    assert response.path_status == ("completed",), response.message
    found: Array = response.values[0]
    return found


def problem(active: Active | None = None, design: Design | None = None) -> Problem:
    """The problem of S1 or another design with effects in it."""
    if not active:
        return baseline(design or named_device(), mesh_level("draft"))
    model = Model(effects=tuple(active), level="draft", parameters=active)
    return model.problem(design or named_device())
