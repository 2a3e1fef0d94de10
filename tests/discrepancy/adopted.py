"""A small adoption, made once in a test run: three devices with a planted mismatch."""

from __future__ import annotations

from functools import cache
from pathlib import Path as FilePath
from tempfile import TemporaryDirectory

import numpy as np

from datagen.model import Model
from discrepancy.adopt import Adoption, adopt
from discrepancy.measurement import Measurements
from discrepancy.solves import Solver
from discrepancy.study import Study
from tests.discrepancy.noisy import curves, variants

NOISE = {"tip_deflection": 3e-6, "inflation": 2e-6}
PLANTED = -0.0005
PRESSURE = np.array([10e3, 25e3, 45e3])
DEVICES = variants({1: 95e-6, 2: 80e-6, 3: 110e-6})
EFFECTS = ("cure_mismatch", "pressure_offset")


@cache
def measurements(count: int = len(DEVICES)) -> Measurements:
    """Draft solves with the mismatch in them, and noise."""
    hidden = {"cure_mismatch": {"difference": PLANTED}}
    devices = dict(list(DEVICES.items())[:count])
    made = curves(Model(tuple(hidden), "draft", hidden), PRESSURE, NOISE, 6, devices)
    return Measurements(made, "<three>.csv", "ab" * 32, ("line 2 & odd",))


@cache
def folder() -> TemporaryDirectory[str]:
    """Of the solves that all tests of a run share."""
    return TemporaryDirectory()


def study(count: int = len(DEVICES), **options: object) -> Study:
    """A new study of the first devices."""
    solver = Solver(1, FilePath(folder().name))
    wanted = {"level": "draft", "effects": EFFECTS} | options
    return Study(measurements(count), solver, **wanted)  # type: ignore[arg-type]


@cache
def adopted(*effects: str) -> Adoption:
    """Some effects adopted from a study of their own; not to be changed."""
    return adopt(study(effects=effects), effects, seed=1)
