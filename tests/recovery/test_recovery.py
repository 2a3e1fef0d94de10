"""A few trials of the ranking; `make recovery` does them by the thousand."""

from __future__ import annotations

from pathlib import Path

import pytest

from discrepancy.solves import Solver
from docs import recover
from tests.recovery.trial import Lab, rank, readings_of, size_for, unnamed_changes

EFFECTS = ("bond_edge", "cure_mismatch", "self_weight")
NOISE, SMOOTH = 3e-6, 0.005


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    """Four devices, solved with three effects."""
    cache = tmp_path_factory.mktemp("solves")
    made = Lab(Solver(1, cache), devices=4, effects=EFFECTS)
    made.solve()
    return made


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", EFFECTS)
def test_what_is_planted_is_named(lab: Lab, name: str, seed: int) -> None:
    t = size_for(lab, name, 8.0, NOISE, SMOOTH, seed)
    readings, truth = readings_of(lab, {name: t}, noise=NOISE, smooth=SMOOTH, seed=seed)
    assert truth.moved > 5
    ranking = rank(lab, readings)[0]
    assert ranking.verdict in ("identified", "tied")
    assert name in ranking.effects


def test_nothing_is_named_where_nothing_is_planted(lab: Lab) -> None:
    said = []
    for seed in range(8):
        readings, _ = readings_of(lab, {}, noise=1e-6, smooth=0.01, seed=seed)
        said.append(rank(lab, readings)[0].verdict)
    assert said.count("adequate") >= 7


def test_what_has_no_name_is_not_given_one(lab: Lab) -> None:
    said = []
    for seed, change in enumerate(unnamed_changes(lab).values()):
        extra = change(12.0, NOISE, SMOOTH)
        readings, _ = readings_of(
            lab, {}, noise=NOISE, smooth=SMOOTH, seed=seed, extra=extra
        )
        said.append(rank(lab, readings)[0].verdict)
    assert said.count("identified") == 0
    assert said.count("unexplained") >= 2


def test_two_effects_are_both_named(lab: Lab) -> None:
    pair = ("bond_edge", "cure_mismatch")
    truth = {name: size_for(lab, name, 10.0, NOISE, SMOOTH, 5) for name in pair}
    readings, _ = readings_of(lab, truth, noise=NOISE, smooth=SMOOTH, seed=1)
    assert rank(lab, readings)[0].effects == ("bond_edge+cure_mismatch",)


def test_what_is_adopted_is_measured_by_the_planted_size(lab: Lab) -> None:
    t = size_for(lab, "bond_edge", 12.0, NOISE, SMOOTH, 3)
    readings, _ = readings_of(lab, {"bond_edge": t}, noise=NOISE, smooth=SMOOTH, seed=3)
    candidates = rank(lab, readings)[0].candidates
    one = next(c for c in candidates if c.effects == ("bond_edge",))
    found = recover.fall(lab, readings, one, {"bond_edge": t})
    assert found["ideal"] < found["before"] / 2
    assert found["after"] == pytest.approx(found["ideal"], rel=0.2)
    wrong = recover.fall(lab, readings, one, {"bond_edge": 0.5 * t})
    assert wrong["ideal"] > 1.5 * found["ideal"]


def test_kept_solves_are_not_solved_again(lab: Lab, tmp_path: Path) -> None:
    before = lab.solver.solved
    lab.solve()
    assert lab.solver.solved == before


def test_the_document_says_what_the_kept_trials_do() -> None:
    assert recover.PAGE.read_text() == recover.page(recover.known())


def test_a_table_that_a_kill_cut_loses_its_last_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = recover.known()[:5]
    monkeypatch.setattr(recover, "TRIALS", tmp_path / "trials.csv")
    assert recover.known() == []
    recover.keep(rows)
    assert recover.known() == rows
    whole = recover.TRIALS.read_text()
    recover.TRIALS.write_text(whole[:-4])
    assert recover.known() == rows[:4]
    old = f"\n{recover.RULES},", "\n0,"
    recover.TRIALS.write_text(whole.replace(*old, 1))  # of other rules
    assert recover.known() == rows[1:]
