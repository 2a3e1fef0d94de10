"""Files that another program's answers are in, and the document about them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import foreign
from benchmarks.exchange import Answer, Cost, Question
from benchmarks.foreign import CASES, FILES, PAGE, Elsewhere, devices, grown, page
from datagen.device import Design
from datagen.effects.self_weight import GRAVITY
from discrepancy.reading import read_measurements


def test_the_document_is_of_the_record_and_the_files() -> None:
    record = foreign.known()
    assert list(record) == list(CASES)
    assert PAGE.read_text() == page(record)
    for name, found in record.items():
        assert found["sha256"] == foreign.digest(name)


def test_a_case_is_added_to_what_is_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(foreign, "RESULTS", tmp_path / "foreign.json")
    foreign.keep("heavy", {"sha256": "a"})
    foreign.keep("nothing", {"sha256": "b"})
    foreign.keep("heavy", {"generator": "7"})
    assert foreign.known() == {
        "nothing": {"sha256": "b"},
        "heavy": {"sha256": "a", "generator": "7"},
    }


class Still:
    """A model of ours whose devices do not move."""

    def __call__(self, designs: list[Design], paths: list[Any]) -> Still:
        return self

    def output(self, name: str) -> np.ndarray:
        return np.ones((1, 1))


@pytest.mark.parametrize("name", CASES)
def test_the_peer_is_asked_for_what_is_hidden(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And its answer read: all nodes 10 um higher are a tip and no inflation."""
    asked: list[Question] = []

    def call(command: list[str], limit: float) -> None:
        asked.append(Question.read(Path(command[3])))
        up = np.zeros((1, len(asked[0].nodes), 3))
        up[..., 2] = 10e-6
        Answer(up, Cost(1.0, 1.0, 1, 1, 1)).write(Path(command[4]))

    monkeypatch.setattr(foreign, "call", call)
    bench = Elsewhere(CASES[name], 1, Path("python"))
    monkeypatch.setattr(bench, "model", Still())
    made = devices(CASES[name].soft)["D1"]
    outputs, values = bench.answer(made, np.array([5e3]))
    assert outputs == ("tip_deflection", "inflation")
    np.testing.assert_allclose(values, [[10e-6, 0.0]], atol=1e-12)
    (question,) = asked
    told = question.second, question.inverse_limit, question.weight
    hidden = {
        "heavy": (0.0, 0.0, 1000.0 * GRAVITY),
        "mooney": (0.15, 0.0, 0.0),
        "gent": (0.0, 0.125, 0.0),
    }
    assert told == hidden.get(name, (0.0, 0.0, 0.0))
    wet = question.nodes[question.cells[question.wet.any(axis=1)]]
    start = made.balloon_start - (50e-6 if name == "larger" else 0.0)
    lines = np.unique(question.nodes[:, 0])
    assert np.abs(lines - start).min() < 1e-9
    assert wet[..., 0].max() > made.balloon_start + made.balloon_length


@pytest.mark.parametrize("name", CASES)
def test_files_state_the_devices(name: str) -> None:
    found = read_measurements(FILES / f"{name}.csv")
    stated = devices(CASES[name].soft)
    assert not found.warnings
    assert [curve.device for curve in found.curves] == list(stated)
    for curve, design in zip(found.curves, stated.values(), strict=True):
        np.testing.assert_allclose(curve.load, CASES[name].load, rtol=1e-12)
        assert curve.design.to_dict() == pytest.approx(design.to_dict())


def test_a_grown_cavity_takes_from_rim_and_wall() -> None:
    design = devices(soft=False)["D5"]
    larger = grown(design, 50e-6)
    assert (larger.length, larger.width) == (design.length, design.width)
    moved = np.subtract(larger.balloons_x(), design.balloons_x())
    np.testing.assert_allclose(moved, [[-50e-6, 50e-6]] * 2)
    moved = np.subtract(larger.balloons_y(), design.balloons_y())
    np.testing.assert_allclose(moved, [[0.0, 50e-6]])  # half of the one in the middle


def test_what_is_hidden_is_found(tmp_path: Path) -> None:
    """Of those that raise balloons the one in FElupe's meshes, by three devices."""
    lines = (FILES / "larger.csv").read_text().splitlines(keepends=True)
    file = tmp_path / "three.csv"
    file.write_text("".join(lines[: 1 + 3 * len(CASES["larger"].load)]))
    effects = "bond_edge,modulus_bias,pressure_offset"
    command = [Path(sys.executable).with_name("pba"), "rank", file]
    options = ["--level", "draft", "--effects", effects, "--json", "--cache", tmp_path]
    done = subprocess.run([*command, *options], stdout=subprocess.PIPE, check=True)
    answer = json.loads(done.stdout)
    assert (answer["verdict"], answer["effects"]) == ("identified", ["bond_edge"])
    growth = answer["ranking"][0]["parameters"]["growth"]
    assert growth["value"] == pytest.approx(50e-6, rel=0.2)
