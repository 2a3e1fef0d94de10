"""Scores of hand-written answers, for each kind of truth."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from datagen.errors import FileError
from discrepancy.scoring import (
    FLOOR,
    OUTCOMES,
    answer_from,
    read_answer,
    score,
    summarise,
)
from discrepancy.sealed import Planted, Truth
from service.cli import main

YEOH = Planted("yeoh", {"second": 0.1, "third": 0.01}, {"second": "1", "third": "1"}, 9)
EDGE = Planted("bond_edge", {"growth": 40e-6}, {"growth": "m"}, 12.0)
BURR = Planted("edge_burr", {"height": 0.2}, {"height": "1"}, 11.0)


def truth(kind: str, *planted: Planted) -> Truth:
    return Truth(
        seed=1,
        asked={},
        kind=kind,
        planted=planted,
        batches={},
        devices={},
        camera={},
        noise={},
        smooth=0.01,
        level="draft",
        pressure=(1e4,),
    )


NOTHING = truth("none")
ONE = truth("named", EDGE)
TWO = truth("named", YEOH, EDGE)
STRANGE = truth("unnamed", BURR)

RANKING: list[dict[str, Any]] = [
    {
        "effect": "bond_edge",
        "probability": 0.6,
        "parameters": {"growth": {"value": 42.0, "std": 2.0, "unit": "um"}},
    },
    {
        "effect": ["bond_edge", "yeoh"],
        "probability": 0.2,
        "parameters": {
            "bond_edge.growth": {"value": 50e-6, "std": 1e-6, "unit": "m"},
            "yeoh.second": {"value": 0.11, "std": 0.01, "unit": "1"},
            "yeoh.third": {"value": 0.01, "std": None, "unit": "1"},
        },
    },
    {"effect": "nothing", "probability": 0.1, "parameters": {}},
    {"effect": "unknown", "probability": 0.05, "parameters": {}},
    {"effect": "bond_edge+unknown", "probability": 0.03, "parameters": {}},
]


def answer(verdict: str, *effects: Any, ranking: Any = RANKING) -> dict[str, Any]:
    return {"verdict": verdict, "effects": list(effects), "ranking": ranking}


@pytest.mark.parametrize(
    ("sealed", "verdict", "effects", "outcome"),
    [
        (NOTHING, "adequate", [], "right"),
        (NOTHING, "identified", ["yeoh"], "false_claim"),
        (NOTHING, "tied", ["yeoh", "mooney"], "false_claim"),
        (NOTHING, "unexplained", [], "false_alarm"),
        (ONE, "identified", ["bond_edge"], "right"),
        (ONE, "tied", ["yeoh", "bond_edge"], "in_tie"),
        (ONE, "tied", ["yeoh", "mooney"], "wrong"),
        (ONE, "identified", ["yeoh"], "wrong"),
        (ONE, "identified", ["bond_edge+yeoh"], "partial"),
        (ONE, "adequate", [], "missed"),
        (ONE, "unexplained", [], "not_named"),
        (TWO, "identified", ["yeoh+bond_edge"], "right"),
        (TWO, "identified", [["yeoh", "bond_edge"]], "right"),
        (TWO, "identified", ["yeoh", "bond_edge"], "right"),
        (TWO, "tied", ["mooney+bond_edge", "bond_edge+yeoh"], "in_tie"),
        (TWO, "tied", ["yeoh", "bond_edge"], "partial"),
        (TWO, "identified", ["bond_edge"], "partial"),
        (TWO, "identified", ["bond_edge+mooney"], "wrong"),
        (TWO, "adequate", [], "missed"),
        (STRANGE, "unexplained", [], "right"),
        (STRANGE, "identified", ["bond_edge"], "wrong"),
        (STRANGE, "tied", ["bond_edge", "yeoh"], "wrong"),
        (STRANGE, "adequate", [], "missed"),
    ],
)
def test_outcomes(
    sealed: Truth, verdict: str, effects: list[Any], outcome: str
) -> None:
    found = score(sealed, answer_from(answer(verdict, *effects)))
    assert found.outcome == outcome
    assert found.right is (outcome in ("right", "in_tie"))
    assert OUTCOMES[outcome] in found.line()


@pytest.mark.parametrize(
    ("sealed", "probability"),
    [(NOTHING, 0.1), (ONE, 0.6), (TWO, 0.2), (STRANGE, 0.08)],
)
def test_log_score_is_of_the_truth(sealed: Truth, probability: float) -> None:
    found = score(sealed, answer_from(answer("unexplained")))
    assert found.probability == pytest.approx(probability)
    assert found.log_score == pytest.approx(math.log(probability))


def test_a_truth_that_is_not_listed_costs_a_finite_score() -> None:
    found = score(truth("named", YEOH), answer_from(answer("adequate")))
    assert (found.probability, found.log_score) == (0.0, math.log(FLOOR))
    assert [p.value for p in found.parameters] == [None, None]


def test_parameters_and_their_intervals() -> None:
    (growth,) = score(ONE, answer_from(answer("adequate"))).parameters
    assert growth.value == pytest.approx(42e-6)  # given in um
    assert growth.std == pytest.approx(2e-6)
    assert growth.inside is True
    found = score(TWO, answer_from(answer("adequate"))).parameters
    inside = {p.name: p.inside for p in found}
    assert inside == {
        "bond_edge.growth": False,  # 10 standard deviations away
        "yeoh.second": True,
        "yeoh.third": None,  # no std
    }
    assert score(STRANGE, answer_from(answer("unexplained"))).parameters == ()


@pytest.mark.parametrize(("off", "inside"), [(1.64, True), (1.65, False)])
def test_an_interval_is_of_90_percent(off: float, inside: bool) -> None:
    one = {"value": 40e-6 + off * 1e-6, "std": 1e-6, "unit": "m"}
    entry = {"effect": "bond_edge", "probability": 1.0, "parameters": {"growth": one}}
    (found,) = score(ONE, answer_from(answer("adequate", ranking=[entry]))).parameters
    assert found.inside is inside


def test_a_unit_of_another_kind_is_refused() -> None:
    one = {"value": 40.0, "std": 1.0, "unit": "kPa"}
    entry = {"effect": "bond_edge", "probability": 1.0, "parameters": {"growth": one}}
    with pytest.raises(ValueError, match=r"bond_edge.growth.unit: 'kPa'"):
        score(ONE, answer_from(answer("adequate", ranking=[entry])))


def test_a_summary_counts() -> None:
    scores = [
        score(NOTHING, answer_from(answer("adequate"))),
        score(NOTHING, answer_from(answer("identified", "yeoh"))),
        score(ONE, answer_from(answer("tied", "yeoh", "bond_edge"))),
        score(TWO, answer_from(answer("identified", "yeoh"))),
    ]
    found = summarise(scores)
    assert found.sets == {"named": 2, "none": 2, "all": 4}
    assert found.right == {"named": 1, "none": 1, "all": 2}
    assert found.outcomes == {"right": 1, "in_tie": 1, "partial": 1, "false_claim": 1}
    assert (found.inside, found.intervals) == (2, 3)
    logs = [math.log(p) for p in (0.1, 0.1, 0.6, 0.2)]
    assert found.log_score == pytest.approx(sum(logs) / 4)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ([], "not an object"),
        (answer("sure"), "verdict: 'sure' is not allowed"),
        ({"verdict": "adequate"}, "effects: not a list"),
        (answer("identified"), "effects: none named"),
        (answer("adequate", ranking={}), "ranking: not a list"),
        (answer("adequate", ranking=[{}]), r"ranking\[0\]: not an object with"),
        (
            answer("adequate", ranking=[{"effect": "yeoh", "probability": 2}]),
            r"ranking\[0\].probability: 2 is not allowed",
        ),
        (
            answer("adequate", ranking=[{"effect": "yeoh", "probability": 0.7}] * 2),
            "add up to 1.4",
        ),
    ],
)
def test_answers_that_cannot_be_read(content: Any, words: str, tmp_path: Path) -> None:
    file = tmp_path / "answer.json"
    file.write_text(json.dumps(content))
    with pytest.raises(FileError, match=words):
        read_answer(file)


def sealed_folder(folder: Path, sealed: Truth) -> Path:
    from discrepancy.sealed import seal

    seal(folder, "device\n", sealed)
    return folder


def test_the_command_scores(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = sealed_folder(tmp_path / "first", ONE)
    second = sealed_folder(tmp_path / "second", NOTHING)
    file = tmp_path / "answer.json"
    file.write_text(json.dumps(answer("identified", "bond_edge")))
    assert main(["challenge", "score", str(first), str(file)]) == 0
    line = capsys.readouterr().out
    assert line.count("\n") == 1
    assert "right: planted bond_edge (12 times the noise)" in line
    assert "1 of 1 parameters inside" in line

    pairs = [str(first), str(file), str(second), str(file)]
    assert main(["challenge", "score", *pairs]) == 0
    assert "outcomes: 1 right, 1 false_claim" in capsys.readouterr().out
    assert main(["challenge", "score", *pairs, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [one["right"] for one in found["sets"]] == [True, False]
    assert found["summary"]["right"] == {"named": 1, "none": 0, "all": 1}


def test_the_command_complains_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = sealed_folder(tmp_path / "set", ONE)
    file = tmp_path / "answer.json"
    file.write_text("{")
    other = tmp_path / "other.json"
    answer = {"verdict": "adequate", "effects": [], "ranking": []}
    other.write_text(json.dumps(answer | {"file_sha256": "0" * 64}))
    make = ["challenge", "make"]
    for arguments, words in (
        (["challenge", "score", str(folder)], "pairs of a folder and an answer"),
        (["challenge", "score", str(folder), str(file)], "not JSON"),
        (["challenge", "score", str(tmp_path), str(file)], "manifest.json: cannot be"),
        (["challenge", "score", str(folder), str(other)], "to other measurements than"),
        ([*make, str(folder), "--seed", "1"], "holds a sealed set already"),
        ([*make, str(tmp_path / "a"), "--seed", "x"], "--seed: 'x'"),
        ([*make, str(tmp_path / "a"), "--seed", "1", "--noise", "heat=1"], "--noise"),
        ([*make, str(tmp_path / "a"), "--seed", "1", "--effects", "heat"], "'heat'"),
        ([*make, str(tmp_path / "a"), "--seed", "1", "--size", "big"], "size: 'big'"),
    ):
        assert main(arguments) == 2
        streams = capsys.readouterr()
        assert streams.out == ""
        assert streams.err.count("\n") == 1
        assert words in streams.err
