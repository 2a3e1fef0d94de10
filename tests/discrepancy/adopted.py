"""A small adoption, made once in a test run: three devices with a planted mismatch."""

from __future__ import annotations

from functools import cache
from pathlib import Path as FilePath
from tempfile import TemporaryDirectory

import numpy as np

from datagen.device import named_device
from datagen.model import Model
from datagen.response import Path
from discrepancy.adopt import Adoption, adopt
from discrepancy.measurement import Curve, Measurements
from discrepancy.solves import Solver
from discrepancy.study import Study

NOISE = {"tip_deflection": 3e-6, "inflation": 2e-6}
PLANTED = -0.0005
PRESSURE = np.array([10e3, 25e3, 45e3])
THICKNESSES = (95e-6, 80e-6, 110e-6)
EFFECTS = ("cure_mismatch", "pressure_offset")


@cache
def measurements(count: int = len(THICKNESSES)) -> Measurements:
    """Draft solves with the mismatch in them, and noise."""
    rng = np.random.default_rng(6)
    model = Model(
        ("cure_mismatch",), "draft", {"cure_mismatch": {"difference": PLANTED}}
    )
    std = np.tile(list(NOISE.values()), (len(PRESSURE), 1))
    curves = []
    for case, thickness in enumerate(THICKNESSES[:count], start=1):
        design = named_device("S1", case).with_values(upper_thickness=thickness)
        answer = model([design], [Path(PRESSURE)])
        values = np.stack([answer.output(name)[0] for name in NOISE], axis=1)
        curves.append(
            Curve(
                device=f"D{case}",
                run=1,
                orientation=0.0,
                design=design,
                load=PRESSURE,
                time=None,
                branch=np.full(len(PRESSURE), "loading"),
                outputs=tuple(NOISE),
                values=values + std * rng.normal(size=values.shape),
                std=std,
            )
        )
    return Measurements(tuple(curves), "<three>.csv", "ab" * 32, ("line 2 & odd",))


@cache
def folder() -> TemporaryDirectory[str]:
    """Of the solves that all tests of a run share."""
    return TemporaryDirectory()


def study(count: int = len(THICKNESSES), **options: object) -> Study:
    """A new study of the first devices."""
    solver = Solver(1, FilePath(folder().name))
    wanted = {"level": "draft", "effects": EFFECTS} | options
    return Study(measurements(count), solver, **wanted)  # type: ignore[arg-type]


@cache
def adopted(*effects: str) -> Adoption:
    """Some effects adopted from a study of their own; not to be changed."""
    return adopt(study(effects=effects), effects, seed=1)
