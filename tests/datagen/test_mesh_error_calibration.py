"""The calibration of the mesh error's bounds, on numbers whose law is known."""

from __future__ import annotations

import json
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from datagen.levels import COARSER, FORMER, LEVELS
from datagen.response import OUTPUT_NAMES
from docs import mesh_error, mesh_error_cases
from docs.mesh_error import calibrate, check, quantile
from docs.mesh_error_cases import (
    MESHES,
    TRUTH,
    Cases,
    is_current,
    known,
    stand_in_errors,
)

NONE = Cases({}, {}, {TRUTH: np.empty(0)}, {})


def drawn(count: int, seed: int) -> Cases:
    """Paths on meshes whose errors shrink by random factors from one to the next."""
    rng = np.random.default_rng(seed)
    load = np.linspace(0.125, 1, 8)[:, None]
    shape = (count, 1, len(OUTPUT_NAMES))
    truth = rng.uniform(1, 2, shape) * np.sqrt(load)
    share = 0.1 * rng.lognormal(0.0, 0.5, shape)
    values, limit = {}, {}
    for level in MESHES:
        values[level.name] = truth * (1 + share)
        limit[level.name] = 1e5 * (1 + share[:, 0, 0])
        share = share * rng.uniform(-0.5, 0.5, shape)
    values[TRUTH], limit[TRUTH] = truth, np.full(count, 1e5)
    extent = {name: np.abs(value) for name, value in values.items()}
    return Cases(values, extent, limit, {name: np.ones(count) for name in values})


def test_a_path_on_the_former_fine_mesh_stands_in_until_there_is_one_on_todays(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """In whatever order they stand, and with the last line cut by a kill."""
    runs = tmp_path / "runs.jsonl"
    monkeypatch.setattr(mesh_error_cases, "RUNS", runs)
    assert known() == {}
    tip = [[[2e-3] + 4 * [0.0]], [[1e-3] + 4 * [0.0]]]
    former, current, draft = (
        {"level": level, "mesh": list(astuple(mesh)[1:]), "targets": [1e4], "values": v}
        for level, mesh, v in (
            ("fine", FORMER["fine-5"], tip[0]),
            ("fine", LEVELS["fine"], tip[1]),
            ("draft", FORMER["draft-5"], tip[1]),
        )
    )
    rows = [
        (1, former),
        (1, draft),
        (2, former),
        (2, current),
        (3, current),
        (3, former),
    ]
    lines = [json.dumps({"row": row} | run) for row, run in rows]
    runs.write_text("\n".join([*lines, lines[0][:40]]))
    found = known()
    assert {key: is_current(run) for key, run in found.items()} == {
        (1, "fine"): False,
        (2, "fine"): True,
        (3, "fine"): True,
    }
    assert stand_in_errors().tolist() == pytest.approx([1.0, 1.0])


def test_the_quantile_is_the_conformal_one() -> None:
    scores = np.arange(1.0, 40.0)  # 39 of them: ceil(40 x 0.95) = 38
    assert quantile(scores) == 38
    # Too few, of logarithms 0 and 2: m + t s sqrt(1 + 1/n), t(0.95, 1) = 6.3138.
    few = np.exp([0.0, 2.0])
    assert np.log(quantile(few)) == pytest.approx(1 + 6.3138 * np.sqrt(3), rel=1e-4)
    assert quantile(np.array([3.0, 3.0, 3.0])) == pytest.approx(3)
    assert quantile(np.stack([scores, 2 * scores], axis=1)).tolist() == [38, 76]


def test_the_bound_holds_on_paths_that_it_has_not_seen() -> None:
    for level in ("draft", "standard"):
        found = calibrate(drawn(60, 1), level, NONE)
        assert found.turned == 60
        fresh = drawn(2000, 2)
        own = found.factors
        bound = own.factor * fresh.brackets(level, own.floor)
        held = (fresh.errors(level) <= bound).all(axis=1).mean(axis=0)
        assert (held > 0.9).all()
        assert (held < 1.0).all()
        limits = own.limit_factor * fresh.limit_brackets(level, own.limit_floor)
        assert (fresh.limit_errors(level) <= limits).mean() > 0.9
        assert own.limit_factor >= 1  # two meshes may agree on it by accident
        told = check(drawn(400, 3), level, NONE)
        *outputs, limit_pressure = told["paths"]
        assert (np.abs(np.array(outputs) - 0.95) < 0.04).all()
        assert limit_pressure > 0.9


def test_the_published_device_is_never_out_of_its_bound() -> None:
    cases, published = drawn(60, 1), drawn(3, 4)
    for level in ("draft", "standard"):
        published.values[level][0] *= 1.5
        own = calibrate(cases, level, published).factors
        bound = own.factor * published.brackets(level, own.floor)
        assert (published.errors(level) <= bound * (1 + 1e-12)).all()
        without = calibrate(cases, level, NONE).factors
        bound = without.factor * published.brackets(level, without.floor)
        assert (published.errors(level) > bound).any()


def test_the_document_is_of_the_paths_and_factors() -> None:
    cases, left_out = mesh_error_cases.collect()
    published, _ = mesh_error_cases.collect(mesh_error_cases.PUBLISHED)
    divided, more = mesh_error_cases.collect(mesh_error_cases.DIVIDED)
    written = mesh_error.page(cases, published, divided, left_out + more)
    assert mesh_error.PAGE.read_text() == written


def test_a_floor_is_taken_where_two_meshes_agree_by_accident() -> None:
    cases = drawn(60, 1)
    other = COARSER["standard"].name
    cases.values[other][:] = cases.values["standard"]
    own = calibrate(cases, "standard", NONE).factors
    bound = own.factor * cases.brackets("standard", own.floor)
    held = (cases.errors("standard") <= bound).all(axis=1).mean(axis=0)
    assert (held >= 0.9).all()
