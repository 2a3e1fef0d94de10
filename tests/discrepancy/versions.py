"""Model versions made by hand, without a fit, for tests of what is done with them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from datagen.effects import catalogue
from datagen.model import GENERATOR_VERSION
from discrepancy.ladder import BASELINE, FLOOR, RECALIBRATED, Rung
from discrepancy.measurement import Tolerances
from discrepancy.provenance import digest, source_file
from discrepancy.version import Estimate, Measured, ModelVersion

OWN = '''"""A roof that shrank when it was cured."""

from dataclasses import replace

import numpy as np

from datagen.effects import effect
from datagen.mesh import UPPER
from datagen.space import Parameter


@effect(
    stage="initial strain",
    parameters=[
        Parameter(
            "shrinkage", unit="1", lower=-0.01, upper=0.01, off=0.0, prior="normal",
            source="made up for this test",
        )
    ],
)
def shrunk_roof(problem, shrinkage):
    """Fg = (1 - shrinkage) I in the upper layer."""
    growth = np.tile(np.eye(3), (len(problem.mesh.cells), 1, 1))
    growth[problem.mesh.layer == UPPER] *= 1.0 - shrinkage
    return replace(problem, growth=growth)
'''
"""An effect file as a user writes it: what `cure_mismatch` does, by another name."""


def own_folder(folder: Path, text: str = OWN) -> Path:
    """A folder with the user's effect in it."""
    folder.mkdir(exist_ok=True)
    (folder / "shrunk_roof.py").write_text(text)
    return folder


def estimate(name: str, value: float, std: float) -> Estimate:
    """A parameter that is known so well."""
    return Estimate(
        name=name,
        unit="1",
        value=value,
        std=std,
        low=value - 1.6 * std,
        high=value + 1.6 * std,
        lower=-0.01,
        upper=0.01,
        plausibility="plausible",
        source="made up",
    )


def version(difference: float = -0.0005, **changes: Any) -> ModelVersion:
    """A version with `cure_mismatch` in it, some of its fields changed."""
    std = 1e-5
    source = digest(source_file(catalogue()["cure_mismatch"]))
    made = ModelVersion(
        parent="baseline",
        effects=("cure_mismatch",),
        estimates=(estimate("cure_mismatch.difference", difference, std),),
        mean=np.array([difference]),
        covariance=np.array([[std**2]]),
        samples=difference + std * np.linspace(-1, 1, 5)[:, None],
        measurements=(Measured("bench.csv", "ab" * 32, ("S1", "S2")),),
        tolerances=Tolerances(),
        level="draft",
        fast="draft",
        seed=3,
        ladder=(
            Rung(BASELINE, (), 10.0, 8.0, 12.0),
            Rung(RECALIBRATED, (), 9.0, 7.0, 11.0, 0.9, 0.8, 1.0),
            Rung("+ cure_mismatch", ("cure_mismatch",), 1.5, 1.2, 1.8, 0.17, 0.1, 0.2),
            Rung(FLOOR, ("cure_mismatch",), 1.4, 1.1, 1.7),
        ),
        interval="jackknife",
        sources={"cure_mismatch": source},
        own={},
        warnings=("the <lamp> was on",),
        generator=GENERATOR_VERSION,
        package="0.1.0",
        commit="",
        date="2026-01-02T03:04:05+00:00",
    )
    return replace(made, **changes)


def own_version(folder: Path) -> ModelVersion:
    """A version with the user's own effect of a folder, see `own_folder`."""
    name = "shrunk_roof"
    return version(
        effects=(name,),
        estimates=(estimate(f"{name}.shrinkage", 0.0005, 1e-5),),
        mean=np.array([0.0005]),
        sources={name: digest(folder / f"{name}.py")},
        own={name: f"{name}.py"},
    )
