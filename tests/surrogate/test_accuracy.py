"""What `accuracy` reports, against numbers computed another way."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from datagen.dataset import Dataset
from datagen.errors import InputError
from datagen.response import Path
from surrogate.accuracy import accuracy
from surrogate.ensemble import Ensemble
from surrogate.report import markdown
from surrogate.split import is_test
from tests.surrogate.synthetic import synthetic


def test_by_hand(ensemble: Ensemble, dataset: Dataset) -> None:
    found = accuracy(ensemble, dataset)
    held = np.flatnonzero(is_test(dataset.inputs))
    assert found.n_test == len(held)
    assert found.n_train == len(dataset) - len(held)
    column = dataset.outputs.index("inflation")
    squares, worst, inside = [], [], []
    for i in held:
        steps = dataset.steps(i)
        truth = dataset.values[i, :steps, column]
        path = Path(dataset.pressure[i, :steps])
        answer = ensemble.predict([dataset.design(i)], [path], 0.9)
        error = answer.response.values[0, :, column] - truth
        squares.append(np.mean(error**2))
        worst.append(100 * np.abs(error).max() / truth.max())
        low, high = answer.low[0, :, column], answer.high[0, :, column]
        inside.append(np.mean((low <= truth) & (truth <= high)))
    own = found.outputs["inflation"]
    assert own.rmse == pytest.approx(np.sqrt(np.mean(squares)))
    assert own.max_pct == pytest.approx(max(worst))
    assert own.coverage == pytest.approx(np.mean(inside))
    assert own.median_pct < own.p95_pct < own.max_pct
    assert 0.9 < own.r2 < 1


def test_coverage_on_new_designs(ensemble: Ensemble) -> None:
    """Nine in ten points of designs from another seed are inside, or a few more."""
    fresh = accuracy(ensemble, synthetic(1200, 1234))
    assert fresh.n_test > 150
    assert 0.86 < fresh.coverage < 0.98
    for error in fresh.outputs.values():
        assert 0.8 < error.coverage < 0.99


def test_json(ensemble: Ensemble, dataset: Dataset) -> None:
    found = accuracy(ensemble, dataset)
    out = json.loads(json.dumps(found.to_json()))
    assert set(out["outputs"]) == {
        "tip_deflection_mm",
        "bending_angle_deg",
        "inflation_mm",
        "inflation_lower_mm",
        "cavity_volume_uL",
    }
    tip = out["outputs"]["tip_deflection_mm"]
    assert {"rmse", "median_pct", "p95_pct", "max_pct", "r2"} <= set(tip)
    assert tip["rmse"] == pytest.approx(1e3 * found.outputs["tip_deflection"].rmse)
    angle = out["outputs"]["bending_angle_deg"]
    assert angle["rmse"] == pytest.approx(
        np.degrees(found.outputs["bending_angle"].rmse)
    )
    assert (tip["unit"], angle["unit"]) == ("mm", "deg")
    assert out["coverage"] == {"90": round(found.coverage, 4)}
    assert (out["n_train"], out["n_test"]) == (found.n_train, found.n_test)
    kinds = {region["by"] for region in out["regions"]}
    assert kinds == {"pressure", "divisions_x", "divisions_y", "limit point"}
    for region in out["regions"]:
        assert set(region["outputs"]) == set(out["outputs"])
    halves = [r["designs"] for r in out["regions"] if r["by"] == "divisions_y"]
    assert sum(halves) == found.n_test
    assert out["limit_pressure"]["designs"] > 0


def test_a_worse_model_reads_worse(ensemble: Ensemble, dataset: Dataset) -> None:
    base = ensemble.expansion.base
    off = replace(ensemble, expansion=replace(ensemble.expansion, base=1.5 * base))
    good, bad = accuracy(ensemble, dataset), accuracy(off, dataset)
    for name, error in good.outputs.items():
        assert bad.outputs[name].rmse > error.rmse
        assert bad.outputs[name].coverage < error.coverage


def test_refusals(ensemble: Ensemble, dataset: Dataset) -> None:
    seen = np.flatnonzero(~is_test(dataset.inputs))
    with pytest.raises(InputError, match="held-out designs"):
        accuracy(ensemble, dataset.subset(seen[:10]))
    with pytest.raises(InputError, match="effects"):
        accuracy(ensemble, replace(dataset, effects=("self_weight",)))


def test_markdown(ensemble: Ensemble, dataset: Dataset) -> None:
    found = accuracy(ensemble, dataset)
    text = markdown(found, "pba accuracy model data.h5")
    assert ensemble.version in text
    assert "`pba accuracy model data.h5`" in text
    assert f"{found.outputs['inflation'].median_pct:.2f}" in text
    tables = [line for line in text.splitlines() if line.startswith("| inflation |")]
    assert len(tables) == 1 + len(found.regions)
