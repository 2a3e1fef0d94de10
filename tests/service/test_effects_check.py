"""`pba effects check`, and the document that teaches how to write an effect."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from datagen.effects import Effect
from datagen.effects.conformance import CHECKS, Report, Result
from service.cli import main
from service.effects import effects_app
from tests.test_docs import DOCUMENTS, FENCE

DOCUMENT = DOCUMENTS["docs/writing-an-effect.md"]
NAMES = [one.__name__ for one in CHECKS]


def example() -> str:
    """The effect of the document: its first block of Python."""
    return next(found[2] for found in FENCE.finditer(DOCUMENT) if found[1] == "python")


@pytest.fixture
def seam(tmp_path: Path) -> Path:
    file = tmp_path / "my_effects" / "weld_seam.py"
    file.parent.mkdir()
    file.write_text(example())
    return file


@pytest.fixture
def pba(capsys: pytest.CaptureFixture[str]) -> Any:
    """Run a command: exit status, standard output, standard error."""

    def run(*arguments: object) -> tuple[int, str, str]:
        status = main([str(argument) for argument in arguments])
        streams = capsys.readouterr()
        return status, streams.out, streams.err

    return run


def test_the_documents_example_conforms(pba: Any, seam: Path) -> None:
    status, out, err = pba("effects", "check", seam, "--json")
    assert (status, err) == (0, "")
    data = json.loads(out)
    assert data["passed"] is True
    (one,) = data["effects"]
    assert (one["effect"], one["passed"]) == ("weld_seam", True)
    assert [line["check"] for line in one["checks"]] == NAMES
    moved = next(line for line in one["checks"] if line["check"] == "moves")
    assert moved["numbers"]["inflation"] > 0.1  # a seam that is twice as hard


def test_the_documents_example_can_be_solved(pba: Any, seam: Path) -> None:
    given = ["--effects-dir", seam.parent, "--level", "draft", "--pressures", "20"]
    solve = ["solve", "--json", *given]
    status, out, _ = pba(*solve, "--effect", "weld_seam:hardening=0.5")
    assert status == 0
    plain = json.loads(pba(*solve)[1])
    harder = json.loads(out)
    assert harder["inflation_mm"][0] < 0.95 * plain["inflation_mm"][0]


def test_the_document_knows_every_check() -> None:
    rows = re.findall(r"^\| `(\w+)` \| ", DOCUMENT.partition("## 3.")[2], re.MULTILINE)
    assert rows == NAMES


def findings(passed: bool) -> Any:
    """A stand-in for the checks: all pass but, where wanted, the tangent."""

    def check(effect: Effect, **_: object) -> Report:
        return Report(
            effect.name,
            tuple(
                Result(name, "a rule", passed or name != "tangent", "found", {"x": 1.0})
                for name in NAMES
            ),
        )

    return check


@pytest.mark.parametrize("passed", [True, False])
def test_one_line_a_check_and_the_exit_status(
    pba: Any, seam: Path, monkeypatch: pytest.MonkeyPatch, passed: bool
) -> None:
    monkeypatch.setattr("datagen.effects.conformance.check", findings(passed))
    for target in (seam, "self_weight"):
        status, out, err = pba("effects", "check", target)
        assert (status, err) == (0 if passed else 1, "")
        lines = [line.split() for line in out.splitlines()]
        verdicts = {
            line[1]: line[0] for line in lines if line[0] in {"passed", "FAILED"}
        }
        assert list(verdicts) == NAMES
        assert verdicts.pop("tangent") == ("passed" if passed else "FAILED")
        assert set(verdicts.values()) == {"passed"}
        assert ("wanted: a rule" in out) is not passed
    status, out, _ = pba("effects", "check", seam, "--json")
    assert status == (0 if passed else 1)
    assert json.loads(out)["passed"] is passed


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "no such file"),
        ("def broken(:", "SyntaxError"),
        ("x = [][1]", "IndexError: list index out of range"),
        ("x = 1", "declares no effect"),
        ("from datagen.effects.self_weight import self_weight", "declares no effect"),
        (example().replace("def weld_seam", "def self_weight"), "exists already"),
        (example().replace('unit="1"', 'unit=""'), "hardening.unit"),
        (example().replace("off=0.0,", ""), "hardening has no off value"),
    ],
)
def test_a_file_without_an_effect_is_one_line(
    pba: Any, seam: Path, content: str | None, words: str
) -> None:
    if content is None:
        seam.unlink()
    else:
        seam.write_text(content)
    status, out, err = pba("effects", "check", seam)
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert err.startswith("pba: ")
    assert str(seam) in err
    assert words in err


def test_a_folder_is_its_files(
    pba: Any, seam: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("datagen.effects.conformance.check", findings(True))
    other = seam.with_name("other.py")
    other.write_text(example().replace("def weld_seam", "def other_seam"))
    status, out, _ = pba("effects", "check", seam.parent)
    assert status == 0
    assert "other_seam (stage: material)" in out and "weld_seam (stage: " in out
    other.write_text("def other_seam(problem): return problem\n")
    status, out, err = pba("effects", "check", seam.parent)
    assert (status, out) == (2, "")
    assert f"{other}: declares no effect" in err
    status, out, err = pba("effects", "list", "--effects-dir", seam.parent)
    assert status == 0 and "weld_seam" in out
    assert err == f"{other}: declares no effect\n"
    empty = seam.parent / "empty"
    empty.mkdir()
    status, _, err = pba("effects", "check", empty)
    assert status == 2 and f"{empty}: no file of effects in it" in err


def test_an_unknown_name_is_one_line(pba: Any) -> None:
    status, out, err = pba("effects", "check", "weld_seam")
    assert (status, out) == (2, "")
    assert err.startswith("pba: effect: 'weld_seam' is not allowed; allowed: ")


def test_the_group_has_its_commands() -> None:
    names = [command.name for command in effects_app.registered_commands]
    assert names == ["list", "show", "check"]
