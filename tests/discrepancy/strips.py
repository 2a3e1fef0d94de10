"""Strips pulled in tension: formulas, and no finite elements."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from datagen.model import Model
from datagen.specimens import Tensile
from discrepancy.measurement import Curve, Measurements
from discrepancy.solves import Solver
from discrepancy.study import Study

STRETCH = np.linspace(1.1, 1.9, 9)
MODULUS = 1.5e6
LAWS = ("modulus_bias", "strain_stiffening")
GENT = Model(
    ("strain_stiffening",), "draft", {"strain_stiffening": {"inverse_limit": 0.1}}
)


def strip(
    name: str,
    *,
    seed: int = 1,
    std: float = 5e3,
    stated: bool = True,
    model: Model = GENT,
) -> Curve:
    """A strip of a material that stiffens, read with noise of `std` Pa."""
    noise = std * np.random.default_rng(seed).standard_normal((len(STRETCH), 1))
    return Curve(
        device=name,
        run=1,
        orientation=0.0,
        design=Tensile(MODULUS),
        load=STRETCH,
        time=None,
        branch=np.full(len(STRETCH), "loading"),
        outputs=("stress",),
        values=model.tensile(Tensile(MODULUS), STRETCH)[:, None] + noise,
        std=np.full(noise.shape, std if stated else np.nan),
    )


def study(curves: Sequence[Curve], cache: Path) -> Study:
    """Of strips, with two laws as candidates."""
    return Study(
        Measurements(tuple(curves)),
        Solver(1, cache),
        level="draft",
        fast="draft",
        effects=LAWS,
    )
