"""``pba adopt``: JSON, words, refusals, what it leaves in a workspace."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datagen.atomic import write_text
from datagen.errors import FileError
from discrepancy.folder import read
from discrepancy.workspace import Workspace
from discrepancy.writing import write_measurements
from service.cli import main
from service.surrogates import load
from tests.discrepancy.made import MISMATCH, measured
from tests.discrepancy.versions import OWN, own_folder
from tests.service.test_surrogates import learned_over

PLANTED = -0.0005


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of three devices, the same in two files, and effects of the user."""
    folder = tmp_path_factory.mktemp("adopt")
    whole, _ = measured(MISMATCH)
    write_measurements(whole, folder / "effect.csv")
    names = whole.devices
    for name, chosen in (("one.csv", names[:1]), ("rest.csv", names[1:])):
        write_measurements(whole.subset(chosen), folder / name)
    own_folder(folder / "effects")
    return folder


@pytest.fixture
def pba(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Any:
    """Run a command in the folder, solves kept beside it."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("PBA_CACHE", str(folder / "kept"))
    monkeypatch.delenv("PBA_WORKSPACE", raising=False)

    def run(*words: str) -> tuple[int, str, str]:
        more = ("--level", "draft", "--workers", "1") if words[0] == "adopt" else ()
        status = main([*words, *more])
        shown = capsys.readouterr()
        return status, shown.out, shown.err

    return run


def the_json(answer: tuple[int, str, str]) -> dict[str, Any]:
    status, out, err = answer
    assert (status, err) == (0, "") and out.count("\n") == 1
    found: dict[str, Any] = json.loads(out)
    return found


def test_json(pba: Any, folder: Path) -> None:
    found = the_json(
        pba("adopt", "cure_mismatch", "effect.csv", "--out", "./mine", "--json")
    )
    rungs = [one["rung"] for one in found["ladder"]]
    assert rungs == ["baseline", "recalibrated", "+ cure_mismatch", "noise floor"]
    for one in found["ladder"]:
        assert 0 < one["low"] < one["heldout_error"] < one["high"]
    errors = [one["heldout_error"] for one in found["ladder"]]
    assert errors[2] < errors[0] / 3 and errors[2] < 1.2 * found["ladder"][3]["high"]
    assert found["ladder"][2]["effects"] == ["cure_mismatch"]
    size = found["parameters"]["difference"]
    assert abs(size["value"] - PLANTED) < 4 * size["std"] and size["unit"] == "1"
    version = read(folder / "mine")
    assert (found["model"], found["version"]) == ("mine", version.version)
    assert found["parent"] == "baseline" and found["workspace"] is None
    assert not found["in_use"] and not (folder / "pba-models").exists()
    assert found["measurements"][0]["devices"] == ["thin", "S1", "swapped"]
    curve = found["curves"][1]
    assert curve["device"] == "S1"
    tip = curve["quantities"]["tip_deflection_mm"]
    assert tip["pressure_kPa"] == [10, 20, 35, 50]
    before, after = (
        np.abs(np.subtract(tip["measured"], tip[name])).max()
        for name in ("baseline", "corrected")
    )
    assert after < before / 3


def test_words_and_workspace(pba: Any, folder: Path) -> None:
    status, out, err = pba("adopt", "cure_mismatch", "effect.csv", "--out", "first")
    assert status == 0 and err == ""
    assert "Error on devices that took no part in the fit" in out
    assert "cure_mismatch.difference: -0.000" in out and "noise floor" in out
    assert "It is in use in pba-models." in out
    assert max(map(len, out.partition("\n\n")[2].partition("\n\n")[0].split("\n"))) < 81
    home = Workspace(folder / "pba-models")
    first = home.current()
    assert first is not None and first.name == "first" and first.version is not None

    second = the_json(
        pba("adopt", "pressure_offset", "effect.csv", "--on", "first",
            "--out", "second", "--no-use", "--json")
    )  # fmt: skip
    assert second["effects"] == ["cure_mismatch", "pressure_offset"]
    assert second["parent"] == first.version.version and not second["in_use"]
    assert set(second["parameters"]) == {
        "cure_mismatch.difference",
        "pressure_offset.offset",
    }
    assert home.current_name == "first"
    assert any("pressure_offset" in line for line in second["warnings"])
    status, out, err = pba("adopt", "mullins", "effect.csv", "--out", "first")
    assert status == 2 and out == "" and "pba-models/first: exists already" in err


def test_several_files_are_one_set(pba: Any, folder: Path) -> None:
    """And their order changes nothing that matters."""
    files = ("rest.csv", "one.csv")
    found = the_json(pba("adopt", "cure_mismatch", *files, "--out", "./both", "--json"))
    assert [one["name"] for one in found["measurements"]] == list(files)
    status, out, _ = pba("adopt", "cure_mismatch", "effect.csv", "--out", "./whole")
    assert status == 0 and "in no workspace: --model names it by its folder" in out
    assert not (folder / "current.json").exists()
    whole, parts = read(folder / "whole"), read(folder / "both")
    assert parts.mean == pytest.approx(whole.mean, abs=0.02 * whole.estimates[0].std)
    again = pba("adopt", "cure_mismatch", "one.csv", "one.csv", "--out", "./x")
    assert again[0] == 2 and "run: 1 is not allowed" in again[2]
    assert "not in one.csv and one.csv" in again[2]
    lost = the_json(
        pba("adopt", "cure_mismatch", "rest.csv", "--on", "both", "--out", "./less",
            "--workspace", ".", "--json")
    )  # fmt: skip
    assert any("one.csv, which the parent was fitted to" in w for w in lost["warnings"])
    assert lost["workspace"] == "." and lost["in_use"]


def test_more_measurements_keep_the_surrogate(pba: Any, folder: Path) -> None:
    """What the parent has learned holds for the new fit."""
    where = ("--workspace", "fast", "--json")
    base = the_json(pba("adopt", "cure_mismatch", "one.csv", "--out", "base", *where))
    assert base["surrogate"] is False
    learned_over(-0.001, 0.0, folder / "fast" / "base" / "surrogate")
    files = ("one.csv", "rest.csv")
    more = the_json(
        pba("adopt", "cure_mismatch", *files, "--on", "base", "--out", "more", *where)
    )
    assert more["surrogate"] is True
    made = read(folder / "fast" / "more")
    found = load(made)
    assert found is not None and found.version == made.version
    assert found.corrected.samples.mean() == pytest.approx(made.mean[0], abs=1e-5)
    (folder / "fast" / "base" / "surrogate" / "model.json").write_text("{")
    less = the_json(
        pba("adopt", "cure_mismatch", "one.csv", "--on", "base", "--out", "less",
            "--no-use", *where)
    )  # fmt: skip
    assert less["surrogate"] is False
    assert any("surrogate is not taken over" in line for line in less["warnings"])


def test_an_effect_of_ones_own_travels(pba: Any, folder: Path) -> None:
    own = ("--effects-dir", "effects")
    found = the_json(
        pba("adopt", "shrunk_roof", "effect.csv", "--out", "./own", *own, "--json")
    )
    size = found["parameters"]["shrinkage"]
    assert abs(size["value"] + PLANTED) < 4 * size["std"]
    version = read(folder / "own")
    assert version.own == {"shrunk_roof": "shrunk_roof.py"}
    solved = the_json(
        pba("solve", "--model", "./own", "--level", "draft", "--pressures", "10",
            "--no-mesh-error", "--json")
    )  # fmt: skip
    assert solved["effects"] == version.parameters()
    assert solved["model_version"].endswith(f"-draft+{version.version}")
    same = f"cure_mismatch:difference={-float(version.mean[0])!r}"
    builtin = the_json(
        pba("solve", "--level", "draft", "--pressures", "10", "--no-mesh-error",
            "--effect", same, "--json")
    )  # fmt: skip
    assert solved["tip_deflection_mm"] == pytest.approx(builtin["tip_deflection_mm"])
    # On top of it, without naming the folder again.
    more = the_json(
        pba("adopt", "pressure_offset", "effect.csv", "--on", "./own",
            "--out", "./more", "--json")
    )  # fmt: skip
    assert more["effects"] == ["shrunk_roof", "pressure_offset"]
    assert read(folder / "more").own == version.own


def test_a_report_is_written(
    pba: Any, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("discrepancy.sharpen.proposals", lambda *_: iter(()))
    wanted = ("--out", "./told", "--report", "out.html")
    status, _, err = pba("adopt", "cure_mismatch", "one.csv", *wanted)
    assert (status, err) == (0, "")
    text = (folder / "out.html").read_text()
    assert read(folder / "told").version in text and "one device only" in text


class Killed(BaseException):
    """The end of the process: nothing catches it."""


def _killed(*_: object) -> None:
    raise Killed


def test_a_run_that_was_killed_goes_on(
    pba: Any, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before the report, and after the version was written."""
    monkeypatch.setattr("discrepancy.sharpen.proposals", lambda *_: iter(()))
    files = ("adopt", "cure_mismatch", "one.csv")
    words = (*files, "--out", "late", "--report", "late.html", "--workspace", "lab")
    late = folder / "lab" / "late"
    with monkeypatch.context() as here:
        here.setattr("discrepancy.sharpen.sharpen", _killed)
        with pytest.raises(Killed):
            pba(*words)
    assert not late.exists() and not (folder / "late.html").exists()
    with monkeypatch.context() as here:
        here.setattr(Workspace, "use", _killed)
        with pytest.raises(Killed):
            pba(*words)
    assert read(late).version and not (folder / "late.html").exists()
    made = (late / "model.json").read_bytes()
    assert pba(*words)[0] == 0
    assert (late / "model.json").read_bytes() == made
    assert read(late).version in (folder / "late.html").read_text()
    assert Workspace(folder / "lab").current_name == "late"
    for other in (("--seed", "1"), ("--camera-tolerance", "1"), ("--on", "late")):
        status, _, err = pba(*words, *other)
        assert status == 2 and "late: exists already" in err, other


def test_an_effect_that_was_rewritten_is_another_fit(pba: Any, tmp_path: Path) -> None:
    own = own_folder(tmp_path / "effects")
    out = str(tmp_path / "own")
    words = ("adopt", "shrunk_roof", "one.csv", "--out", out, "--effects-dir", str(own))
    assert pba(*words)[0] == pba(*words)[0] == 0
    own_folder(own, OWN + "\n# refined\n")
    status, _, err = pba(*words)
    assert status == 2 and "own: exists already" in err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("cure", "effect.csv"), "effect: 'cure' is unknown; allowed: air_channel"),
        ((",", "effect.csv"), "the name of at least one effect"),
        (("mullins,mullins", "effect.csv"), "each effect once"),
        (("viscoelasticity", "effect.csv"), "no reading has one (column time_s)"),
        (("mullins", "nothing.csv"), "nothing.csv"),
        (("mullins", "effect.csv", "--on", "nothing"), "nothing"),
        (("cure", "effect.csv", "--on", "baseline"), "'cure' is unknown"),
        (("mullins", "effect.csv", "--report", "no/where.html"), "--report"),
        (("mullins", "effect.csv", "--report", "effect.csv"), "a new file, or a page"),
        (("mullins", "effect.csv", "--out", "baseline"), "--out: 'baseline'"),
        (("mullins", "effect.csv", "--out", "no/where/m"), "parent folder"),
        (("mullins", "effect.csv", "--out", "./effects"), "exists already"),
    ],
)
def test_bad_input_is_one_line(pba: Any, words: tuple[str, ...], says: str) -> None:
    status, out, err = pba("adopt", "--out", "new", "--json", *words)
    assert (status, out, err.count("\n")) == (2, "", 1) and says in err
    assert not Path("new").exists() and not Path("pba-models/new").exists()


def test_a_report_replaces_files_alone(pba: Any, tmp_path: Path) -> None:
    """Not a pipe or a device, which a rename would end."""
    pipe = tmp_path / "pipe.html"
    os.mkfifo(pipe)
    words = ("mullins", "effect.csv", "--out", "new", "--report", str(pipe))
    status, _, err = pba("adopt", *words)
    assert status == 2 and "a new file, or a page" in err
    with pytest.raises(FileError, match="is there, and no file"):
        write_text(pipe, "a page")
    assert pipe.is_fifo()


def test_a_file_is_needed(pba: Any) -> None:
    status, out, err = pba("adopt", "mullins", "--out", "new")
    assert (status, out) == (2, "") and "FILE" in err
