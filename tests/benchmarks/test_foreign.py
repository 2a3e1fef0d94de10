"""Files that another program's answers are in, and the document about them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.foreign import CASES, FILES, PAGE, RESULTS, devices, grown, page
from discrepancy.reading import read_measurements


def test_the_document_is_of_the_record() -> None:
    record = json.loads(RESULTS.read_text())
    assert set(record["cases"]) == set(CASES)
    assert PAGE.read_text() == page(record)


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
