"""What readings cannot tell apart is said to be tied, and the proposal splits it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datagen.model import Model
from datagen.specimens import Tensile
from discrepancy.experiment import next_measurement
from discrepancy.judging import Ranking
from discrepancy.measurement import Curve, Measurements, Tolerances
from discrepancy.rank import Search
from discrepancy.solves import Solver
from discrepancy.study import Study
from tests.discrepancy import noisy

ROOT = Path(__file__).parents[2]
PRESSURE = np.array([15e3, 35e3, 60e3])
NOISE = {"tip_deflection": 2e-6, "inflation": 1.5e-6}
LOST = 0.87

TOLERANCES = Tolerances(modulus=0.02, thickness=1e-6, camera_scale=0.005)
"""Of a careful lab: usual ones could explain what is planted here."""


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("solves")


def searched(
    curves: Sequence[Curve],
    cache: Path,
    effects: Sequence[str] | None,
    folder: Path | None = None,
) -> tuple[Study, Ranking]:
    study = Study(
        Measurements(tuple(curves), tolerances=TOLERANCES),
        Solver(1, cache),
        level="draft",
        effects=effects,
        effects_dir=folder,
    )
    return study, Search(study).run()


def test_pressure_loss_and_common_modulus_are_tied_until_a_strip_is_pulled(
    cache: Path,
) -> None:
    """Pressure enters over moduli alone: only a test without pressure splits them."""
    effects = ("bond_edge", "modulus_bias", "pressure_loss")
    model = Model(("pressure_loss",), "draft", {"pressure_loss": {"gain": LOST}})
    curves = noisy.curves(model, PRESSURE, NOISE, seed=2)
    study, ranking = searched(curves, cache, effects)
    assert ranking.verdict == "tied"
    assert set(ranking.effects) == {"modulus_bias", "pressure_loss"}
    common = ranking.candidate("modulus_bias").fit.mean()[0]
    assert common * LOST == pytest.approx(1.0, abs=0.05)

    best = next_measurement(study, ranking)[0]
    assert isinstance(best.curve.design, Tensile)
    assert best.now < 4 < best.then

    rng = np.random.default_rng(3)
    strips = []
    for layer in ("upper", "lower"):
        modulus = getattr(curves[0].design, f"{layer}_modulus")
        strip = replace(best.curve.design, modulus=modulus, layer=layer)
        stress = Model((), "draft").tensile(strip, best.curve.load)
        std = best.curve.std * modulus / best.curve.design.modulus
        strips.append(
            replace(
                best.curve,
                device=f"strip of the {layer} layer",
                design=strip,
                values=stress[:, None] + std * rng.normal(size=std.shape),
                std=std,
            )
        )
    _, split = searched([*curves, *strips], cache, effects)
    assert (split.verdict, split.effects) == ("identified", ("pressure_loss",))


def test_strips_alone_are_ranked_and_what_splits_them_is_proposed(cache: Path) -> None:
    """No device is needed to learn of a material's law."""
    gent = Model(
        ("strain_stiffening",), "draft", {"strain_stiffening": {"inverse_limit": 0.1}}
    )
    stretch = np.linspace(1.1, 1.9, 9)
    rng = np.random.default_rng(1)
    std = np.full((len(stretch), 1), 5e3)
    strips = tuple(
        Curve(
            device=f"T{i}",
            run=1,
            orientation=0.0,
            design=Tensile(1.5e6),
            load=stretch,
            time=None,
            branch=np.full(len(stretch), "loading"),
            outputs=("stress",),
            values=gent.tensile(Tensile(1.5e6), stretch)[:, None]
            + std * rng.normal(size=std.shape),
            std=std,
        )
        for i in (1, 2)
    )
    laws = ("modulus_bias", "mooney", "strain_stiffening", "yeoh")
    study, ranking = searched(strips, cache, laws)
    assert "strain_stiffening" in ranking.effects
    found = next_measurement(study, ranking)
    assert found and all(isinstance(one.curve.design, Tensile) for one in found)
    words = [one.words for one in found]
    assert any("T1 in equibiaxial tension" in text for text in words)
    assert found[0].then > found[0].now


def test_an_effect_of_the_users_own_is_named(tmp_path: Path, cache: Path) -> None:
    """The effect of docs/writing-an-effect.md, as it stands there."""
    text = (ROOT / "docs/writing-an-effect.md").read_text()
    source = re.findall(r"```python\n(.*?)```", text, re.DOTALL)[0]
    (tmp_path / "weld_seam.py").write_text(source)
    planted = {"weld_seam": {"hardening": 0.6}}
    model = Model(("weld_seam",), "draft", planted, effects_dir=tmp_path)
    effects = ("weld_seam", "bond_edge", "modulus_bias", "self_weight")
    _, ranking = searched(
        noisy.curves(model, PRESSURE, NOISE, seed=5), cache, effects, tmp_path
    )
    best = ranking.best
    assert (ranking.verdict, ranking.effects) == ("identified", ("weld_seam",))
    low, high = best.fit.interval(0.98)[0]
    assert low < 0.6 < high
    assert best.heldout_error < ranking.baseline_error
