"""A small ranking, made once in a test run: two devices with a planted mismatch."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path as FilePath
from tempfile import TemporaryDirectory

import numpy as np

from datagen.device import Design, named_device
from datagen.model import Model
from discrepancy.judging import Ranking
from discrepancy.measurement import Measurements
from discrepancy.rank import Search
from discrepancy.solves import Solver
from discrepancy.study import Study
from tests.discrepancy.noisy import curves

EFFECTS = ("cure_mismatch", "pressure_offset")
QUANTITIES = ("tip_deflection", "inflation")
NOISE = (3e-6, 2e-6)
DEVICES = ("<b>", "T & U")
"""Names that a page must not take for its own."""

PLANTED = -2e-3
PRESSURE = np.array([10e3, 25e3, 40e3])
SOURCE = "</script><i>run & rerun</i>.csv"
WARNING = "line 7: <u>inflation_mm</u> is odd"


def _design(name: str) -> Design:
    first = named_device("S1")
    if name == DEVICES[0]:
        return first
    return first.with_values(
        upper_thickness=first.lower_thickness, lower_thickness=first.upper_thickness
    )


@cache
def measurements() -> Measurements:
    """Draft solves with the mismatch in them, and noise."""
    hidden = {"cure_mismatch": {"difference": PLANTED}}
    first, second = curves(
        Model(tuple(hidden), "draft", hidden),
        PRESSURE,
        dict(zip(QUANTITIES, NOISE, strict=True)),
        5,
        {name: _design(name) for name in DEVICES},
    )
    values = second.values.copy()
    values[1, 0] = np.nan  # a reading that was not taken
    second = replace(second, values=values)
    return Measurements((first, second), SOURCE, "ab" * 32, (WARNING,))


@cache
def ranked() -> tuple[Study, Ranking]:
    """The study and its ranking; not to be changed."""
    with TemporaryDirectory() as folder, Solver(1, FilePath(folder)) as solver:
        study = Study(
            measurements(), solver, level="draft", fast="draft", effects=EFFECTS
        )
        return study, Search(study).run()
