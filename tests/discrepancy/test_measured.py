"""Measured rubbers: the neo-Hookean law fails, and stiffening is what is missing."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from discrepancy.evidence import fit
from discrepancy.measurement import Measurements, Tolerances
from discrepancy.rank import Search
from discrepancy.solves import Solver
from discrepancy.study import Study
from discrepancy.tensile import read_multiaxial, read_srmd

DATA = Path(os.environ.get("PBA_DATA", Path(__file__).parents[3] / "shared" / "data"))
STIFFENING = {"strain_stiffening", "yeoh"}
LAWS = ("modulus_bias", "mooney", "strain_stiffening", "yeoh")


def data(name: str) -> Path:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"no measured data: {path} (set PBA_DATA)")
    return path


def silicone() -> Measurements:
    return read_srmd(data("srmd_tensile/RTV615.csv"))


def natural_rubber() -> Measurements:
    modes = {"uniaxial": "UT", "equibiaxial": "ET", "planar": "PS"}
    return read_multiaxial(
        {
            mode: data(f"rubber_multiaxial/Treloar_1944_{short}.txt")
            for mode, short in modes.items()
        }
    )


def study(measured: Measurements, cache: Path) -> Study:
    return Study(measured, Solver(1, cache), level="draft", effects=LAWS)


@pytest.mark.parametrize("measured", [silicone, natural_rubber])
def test_stiffening_is_missing(measured: object, tmp_path: Path) -> None:
    ranking = Search(study(measured(), tmp_path)).run()  # type: ignore[operator]
    assert ranking.verdict in ("identified", "tied")
    named = [set(name.split("+")) for name in ranking.effects]
    assert all(names & STIFFENING for names in named)
    assert ranking.candidate("nothing").probability < 1e-3


def test_sizes_of_the_silicone_are_those_of_least_squares(tmp_path: Path) -> None:
    """Independent errors and a free modulus: what a least-squares fit does."""
    measured = replace(silicone(), tolerances=Tolerances(modulus=0.5))
    made = study(measured, tmp_path)
    Search(made).run()
    plain = made.readings
    noise = np.full(len(plain.value), np.median(plain.noise))
    readings = replace(plain, correlated=False, noise=noise)
    gent, yeoh = (made.present((name,)) for name in sorted(STIFFENING))
    assert gent is not None and yeoh is not None
    assert 1 / fit(readings, gent).mean()[0] == pytest.approx(10.67, rel=0.03)
    ratios = fit(readings, yeoh).mean()
    assert ratios == pytest.approx([0.01386 / 0.16324, 0.00094 / 0.16324], rel=0.05)
