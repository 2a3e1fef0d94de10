"""``pba models``, and predictions with a version: made by hand, without a fit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from discrepancy.layout import MODEL
from discrepancy.version import ModelVersion
from discrepancy.workspace import Workspace
from service import surrogates
from service.cli import main
from tests.discrepancy.versions import version


@pytest.fixture
def home(tmp_path: Path) -> Workspace:
    """Two versions, the second on top of the first, which is in use."""
    home = Workspace(tmp_path / "lab")
    home.make()
    first = version(date="2026-01-01").save(home.folder / "first")
    version(-0.0004, parent=first.version, date="2026-01-02", seed=4).save(
        home.folder / "second"
    )
    home.use("first")
    return home


@pytest.fixture
def pba(
    home: Workspace, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Any:
    monkeypatch.setenv("PBA_WORKSPACE", str(home.folder))

    def run(*words: str) -> tuple[int, str, str]:
        status = main(list(words))
        shown = capsys.readouterr()
        return status, shown.out, shown.err

    return run


def the_json(answer: tuple[int, str, str]) -> dict[str, Any]:
    status, out, err = answer
    assert (status, err) == (0, "") and out.count("\n") == 1
    found: dict[str, Any] = json.loads(out)
    return found


def of(home: Workspace, name: str) -> ModelVersion:
    found = home.find(name).version
    assert found is not None
    return found


def test_list(pba: Any, home: Workspace) -> None:
    found = the_json(pba("models", "list", "--json"))
    assert found["current"] == "first" and found["workspace"] == str(home.folder)
    first, second = found["models"]
    assert (first["name"], first["in_use"], second["in_use"]) == ("first", True, False)
    assert second["parent"] == first["version"] == of(home, "first").version
    assert (first["baseline_error"], first["heldout_error"]) == (10.0, 1.5)
    status, out, _ = pba("models", "list")
    lines = out.splitlines()
    assert status == 0 and lines[2].startswith("*  first")
    assert "second" in lines[3] and lines[3].split()[3] == "first"
    assert "10.00" in out and "1.50" in out
    empty = ("--workspace", str(home.folder / "none"))
    assert the_json(pba("models", "list", "--json", *empty))["models"] == []
    assert "pba adopt makes one" in pba("models", "list", *empty)[1]


def test_a_damaged_version_is_listed(pba: Any, home: Workspace) -> None:
    path = home.folder / "second" / MODEL
    path.write_text(path.read_text().replace("-0.0004", "-0.0003"))
    last = the_json(pba("models", "list", "--json"))["models"][-1]
    assert last["name"] == "second" and "damaged" in last["problem"]
    status, out, err = pba("models", "show", "second")
    assert (status, out, err.count("\n")) == (2, "", 1) and "damaged" in err


def test_show(pba: Any, home: Workspace) -> None:
    found = the_json(pba("models", "show", "first", "--json"))
    first = of(home, "first")
    assert found["version"] == first.version and found["samples"] == 5
    assert found["estimates"][0]["value"] == -0.0005
    assert found["ladder"][2]["rung"] == "+ cure_mismatch"
    by_id = the_json(pba("models", "show", first.version[:6], "--json"))
    by_path = the_json(pba("models", "show", str(home.folder / "first"), "--json"))
    assert by_id == by_path == found
    status, out, _ = pba("models", "show", "first")
    assert status == 0
    for text in (
        "cure_mismatch.difference -0.000500 \u00b1 0.000010",
        "noise floor",
        "bench.csv (abababababab): S1, S2",
        "the <lamp> was on",
        "seed 3",
    ):
        assert text in out, text
    assert "without adopted effects" in pba("models", "show", "baseline")[1]


def test_a_training_that_is_stopped_says_that_it_goes_on(
    pba: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*_args: Any, **_given: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(surrogates, "train", stopped)
    status, out, err = pba("models", "train", "first", "--json")
    assert (status, out) == (130, "")
    assert err == (
        "pba: interrupted; finished paths are kept, and the same command goes on\n"
    )


def test_diff(pba: Any) -> None:
    found = the_json(pba("models", "diff", "first", "second", "--json"))
    row = found["parameters"]["cure_mismatch.difference"]
    assert row["change"] == pytest.approx(1e-4)
    assert row["sigmas"] == pytest.approx(1e-4 / np.hypot(1e-5, 1e-5), rel=1e-2)
    assert found["settings"] == {"seed": [3, 4]}
    assert found["effects_added"] == found["measurements_added"] == []
    out = pba("models", "diff", "first", "second")[1]
    assert "-0.000500 \u00b1 0.000010 -> -0.000400 \u00b1 0.000010 (+7.1 std)" in out
    assert "seed 3 -> 4" in out
    back = the_json(pba("models", "diff", "first", "baseline", "--json"))
    assert back["effects_removed"] == ["cure_mismatch"]
    assert back["heldout_error"] == [1.5, None]
    assert "- cure_mismatch" in pba("models", "diff", "first", "baseline")[1]


def test_use_undo_remove(pba: Any, home: Workspace) -> None:
    second = of(home, "second")
    found = the_json(pba("models", "use", second.version, "--json"))
    assert found["current"] == "second" and found["version"] == second.version
    assert found["effects"] == ["cure_mismatch"]
    assert "is in use" in pba("models", "undo")[1] and home.current_name == "first"
    assert the_json(pba("models", "use", "baseline", "--json"))["version"] is None
    pba("models", "use", "second")
    for words, says in (
        (("use", "nothing"), "allowed: baseline, first, second"),
        (("remove", "second"), "--force"),
        (("remove", "first"), "no parent (of second)"),
        (("remove", "baseline"), "always stays"),
        (("show", "nothing"), "allowed: baseline, first, second"),
        (("diff", "first", "nothing"), "allowed: baseline, first, second"),
    ):
        status, out, err = pba("models", *words, "--json")
        assert (status, out, err.count("\n")) == (2, "", 1) and says in err, words
    status, out, _ = pba("models", "remove", "first", "--force")
    assert status == 0 and "first is removed; it was the parent of second" in out
    gone = the_json(pba("models", "remove", "second", "--force", "--json"))
    assert gone["current"] == "baseline" and home.entries() == ()
    assert pba("models", "undo")[0] == 2


def test_predictions_name_version_and_effects(pba: Any, home: Workspace) -> None:
    """The version in use answers, and the shipped model once the baseline is."""
    wanted = ("--pressures", "10", "--level", "draft", "--json")
    first = of(home, "first")
    found = the_json(pba("predict", *wanted))
    assert found["source"] == "fem" and found["version"] == first.version
    assert found["effects"] == ["cure_mismatch"]
    assert found["parameters"] == {"cure_mismatch": {"difference": -0.0005}}
    assert found["model_version"].endswith(first.version)
    assert "has no surrogate yet" in found["reasons"][0]
    by_name = the_json(pba("predict", "--model", "second", *wanted))
    assert by_name["parameters"] == {"cure_mismatch": {"difference": -0.0004}}
    tips = [one["tip_deflection_mm"][0] for one in (by_name, found)]
    assert tips[1] > tips[0] + 0.003
    shown = pba("predict", "--pressures", "10", "--level", "draft")[1]
    assert f"Model version {first.version} with cure_mismatch." in shown
    named = the_json(pba("predict", "--model", "baseline", *wanted))
    pba("models", "use", "baseline")
    plain = the_json(pba("predict", *wanted))
    assert plain == named and plain["source"] == "surrogate"
    assert "version" not in plain
    assert (plain["effects"], plain["parameters"]) == ([], {})


def test_solve_with_a_version(pba: Any, home: Workspace) -> None:
    """Only where it is named: `pba solve` switches on what it is told to."""
    wanted = ("--pressures", "10", "--level", "draft", "--no-mesh-error", "--json")
    plain = the_json(pba("solve", *wanted))
    assert plain["effects"] == {}
    first = of(home, "first")
    found = the_json(pba("solve", "--model", first.version[:8], *wanted))
    assert found["effects"] == {"cure_mismatch": {"difference": -0.0005}}
    assert found["model_version"] == f"{plain['model_version']}+{first.version}"
    off = ("--effect", "cure_mismatch:difference=0")
    same = the_json(pba("solve", "--model", "first", *off, *wanted))
    assert same["tip_deflection_mm"] == plain["tip_deflection_mm"]
    assert found["tip_deflection_mm"] != plain["tip_deflection_mm"]
    more = ("--effect", "pressure_offset:offset=100")
    shown = pba("solve", "--model", "first", *off, *more, *wanted[:-1])[1]
    assert (
        f"Model version {first.version} with cure_mismatch; pressure_offset on top of "
        "it; values of cure_mismatch as given."
    ) in " ".join(shown.split())
    for model, says in (("nothing", "first, second"), (str(home.folder), "no model")):
        status, out, err = pba("solve", "--model", model, *wanted)
        assert (status, out, err.count("\n")) == (2, "", 1) and says in err
