"""A small ranking, made once in a test run: two devices with a planted mismatch."""

from __future__ import annotations

from functools import cache
from pathlib import Path as FilePath
from tempfile import TemporaryDirectory

import numpy as np

from datagen.device import Design, named_device
from datagen.model import Model
from datagen.response import Path
from discrepancy.measurement import Curve, Measurements
from discrepancy.rank import Ranking, Search
from discrepancy.solves import Solver
from discrepancy.study import Study

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
    rng = np.random.default_rng(5)
    model = Model(
        ("cure_mismatch",), "draft", {"cure_mismatch": {"difference": PLANTED}}
    )
    curves = []
    for name in DEVICES:
        design = _design(name)
        answer = model([design], [Path(PRESSURE)])
        values = np.stack([answer.output(q)[0] for q in QUANTITIES], axis=1)
        values = values + np.array(NOISE) * rng.standard_normal(values.shape)
        if name == DEVICES[1]:
            values[1, 0] = np.nan  # a reading that was not taken
        curves.append(
            Curve(
                device=name,
                run=1,
                orientation=0.0,
                design=design,
                load=PRESSURE,
                time=None,
                branch=np.array(["loading"] * len(PRESSURE)),
                outputs=QUANTITIES,
                values=values,
                std=np.tile(NOISE, (len(PRESSURE), 1)),
            )
        )
    return Measurements(tuple(curves), SOURCE, "ab" * 32, (WARNING,))


@cache
def ranked() -> tuple[Study, Ranking]:
    """The study and its ranking; not to be changed."""
    with TemporaryDirectory() as folder, Solver(1, FilePath(folder)) as solver:
        study = Study(
            measurements(), solver, level="draft", fast="draft", effects=EFFECTS
        )
        return study, Search(study).run()
