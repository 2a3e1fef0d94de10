"""Measured curves as load paths: what came before them, and when."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datagen.device import LIMITS, named_device
from datagen.effects import catalogue
from datagen.errors import FileError
from datagen.specimens import Bulge, Tensile
from discrepancy.measurement import Curve, Measurements
from discrepancy.paths import RESTED, Paths
from discrepancy.provenance import source_digest
from discrepancy.rank import Search
from discrepancy.solves import Solve, Solved, Solver, _model, solve, values_of
from discrepancy.study import Study

from .versions import OWN, own_folder

LOAD = np.array([10e3, 20e3, 10e3])
FIRST = Curve(
    device="A",
    run=1,
    orientation=0.0,
    design=named_device("S1"),
    load=LOAD,
    time=np.array([10.0, 20.0, 30.0]),
    branch=np.array(["loading", "loading", "unloading"]),
    outputs=("inflation",),
    values=np.ones((3, 1)),
    std=np.ones((3, 1)),
)
SECOND = replace(FIRST, run=2, time=np.array([100.0, 110.0, 120.0]))


def paths(*curves: Curve) -> Paths:
    return Paths(Measurements(curves), catalogue(), None)


def test_runs_follow_each_other_unloaded_in_between() -> None:
    load, time, at = paths(FIRST, SECOND).load(1, ("viscoelasticity",))
    assert load == (10e3, 20e3, 10e3, 0.0, 0.0, 10e3, 20e3, 10e3)
    assert time == (10, 20, 30, 40, 90, 100, 110, 120)
    assert list(at) == [5, 6, 7]


def test_a_clock_that_was_started_anew_means_a_long_rest() -> None:
    again = replace(SECOND, time=FIRST.time)
    load, time, _ = paths(FIRST, again).load(1, ("viscoelasticity",))
    assert time is not None
    assert load[3:5] == (0.0, 0.0)
    assert time[5] - time[2] == RESTED
    assert list(np.diff(time[5:])) == [10.0, 10.0]
    assert (np.diff(time) > 0).all()


def test_a_device_that_was_turned_over_remembers_all_the_same() -> None:
    over = replace(SECOND, orientation=np.pi)
    assert len(paths(FIRST, over).load(1, ("mullins",))[0]) == 8
    assert len(paths(FIRST, over).load(1, ("yeoh",))[0]) == 2


def test_a_device_that_was_turned_over_within_a_run_remembers_too() -> None:
    over = replace(FIRST, orientation=np.pi, time=SECOND.time)
    for name in ("mullins", "viscoelasticity"):
        assert paths(FIRST, over).load(0, (name,))[0] == tuple(LOAD)
        assert paths(FIRST, over).load(1, (name,))[0] == (*LOAD, 0.0, 0.0, *LOAD)


def test_runs_without_times_are_in_turn_too() -> None:
    load, time, at = paths(FIRST, replace(SECOND, time=None)).load(1, ("mullins",))
    assert load[3:5] == (0.0, 0.0) and time is None and list(at) == [5, 6, 7]


def test_effects_of_time_need_a_time_in_every_curve(tmp_path: Path) -> None:
    other = replace(FIRST, device="B", time=None)
    measured, solver = Measurements((FIRST, other)), Solver(1, tmp_path)
    study = Study(measured, solver, level="draft", effects=("yeoh",))
    assert "device B, run 1, has none" in study.blind("viscoelasticity")
    assert study.blind("mullins") == ""


COUNTED = """
from dataclasses import replace
from datagen.effects import effect
from datagen.space import Parameter

@effect("load", [Parameter("n", "1", 0, 3, scale="integer", off=0, source="a test")])
def counted(problem, n):
    "p = p0 (1 - n / 10)"
    return replace(problem, pressure_gain=problem.pressure_gain * (1 - n / 10))
"""


def test_what_is_counted_is_not_ranked_and_a_lost_decorator_is_told(
    tmp_path: Path,
) -> None:
    own = tmp_path / "own"
    own.mkdir()
    (own / "counted.py").write_text(COUNTED)
    (own / "forgotten.py").write_text("def forgotten(problem, size): return problem\n")
    solver = Solver(1, tmp_path / "kept")
    study = Study(Measurements((FIRST,)), solver, level="draft", effects_dir=own)
    assert study.warnings == ["forgotten.py: declares no effect"]
    assert "its n is a whole number" in study.blind("counted")
    search = Search(study)
    assert search.solve_singles(("counted",)) == []
    assert "its n is a whole number" in search.unjudged["counted"]


def test_a_sweep_that_begins_in_vacuum_keeps_its_pressures(tmp_path: Path) -> None:
    """Roof and floor touch at some -3.5 kPa, where a path ends."""
    sweep = replace(
        FIRST,
        load=np.array([-50e3, -1e3, 0.0, 5e3, -1e3]),
        time=None,
        outputs=("tip_deflection",),
        values=np.ones((5, 1)),
        std=np.ones((5, 1)),
        branch=np.full(5, "loading"),
    )
    path = paths(sweep)
    load, _, at = path.load(0, ())
    assert load == (0.0, 5e3, -1e3, -50e3)
    assert list(at) == [3, 2, 0, 1, 2]
    task = path.task(0, "draft", by=())
    solved = {0: Solver(1, tmp_path).all([task])[task]}
    values, _ = path.gather([(0, step, 0) for step in range(5)], (), solved)
    assert solved[0].status == "contact"
    assert np.isnan(values[0]) and abs(values[2]) < 1e-12
    assert 0.1e-6 < abs(values[1]) < 1e-6 and values[1] == values[4]
    assert 5e-6 < values[3] < 20e-6


def test_a_cache_that_cannot_be_kept_is_told_before_the_solve(tmp_path: Path) -> None:
    taken = tmp_path / "taken"
    taken.write_text("a file")
    with pytest.raises(
        FileError, match=r"taken: solves cannot be kept here: .*--cache"
    ):
        Solver(1, taken).all([paths(FIRST).task(0, "draft")])


def test_an_effect_that_is_edited_is_another_one(tmp_path: Path) -> None:
    """In one process, as in a notebook: neither its name nor its answer is the old."""
    own = own_folder(tmp_path)
    effects = values_of({"shrunk_roof": {"shrinkage": 0.001}})
    task = replace(paths(FIRST).task(0, "draft"), effects=effects, effects_dir=str(own))
    before, key = _model(effects, "draft", str(own)).active, task.key
    assert task.key == key
    own_folder(own, OWN + "\n# refined\n")
    assert task.key != key
    assert _model(effects, "draft", str(own)).active != before


def test_a_specimen_may_lie_on_a_limit(tmp_path: Path) -> None:
    """Its derivatives are taken inside."""
    edge = LIMITS["upper_modulus"].upper
    stretch = (1.0, 1.1, 1.2)
    ends = [Tensile(edge * factor) for factor in (1.0, 0.5)]
    at, below = (
        solve(Solve(one, stretch, None, (), "draft", ("modulus",))) for one in ends
    )
    np.testing.assert_allclose(at.jacobian, below.jacobian, rtol=1e-6)
    limit = LIMITS["upper_thickness"].lower
    thin = Bulge(4e-3, 1e-3, limit, 2e6)
    found = solve(Solve(thin, (1e3,), None, (), "draft", ("modulus", "thickness")))
    assert found.status == "completed" and np.isfinite(found.jacobian).all()


def test_a_worker_refuses_another_effect_than_it_was_sent_for(tmp_path: Path) -> None:
    """Its file was edited between the start of a run and that of a worker."""
    own = own_folder(tmp_path)
    known = catalogue(own)
    task = Paths(Measurements((FIRST,)), known, own).task(
        0, "draft", ("shrunk_roof",), [0.1]
    )
    assert task.sources == (source_digest(known["shrunk_roof"]),)
    key = task.key
    own_folder(own, OWN + "\n# refined\n")
    for one in (task, replace(task, sources=())):
        # What is asked for is as it was; a solve of the new file would not be.
        assert (one.key == key) is bool(one.sources)
    cache = tmp_path / "cache"
    with pytest.raises(FileError, match="an effect in it was changed meanwhile"):
        Solver(1, cache).all([task])
    assert not list(cache.rglob("*.npz"))


def test_an_effect_that_is_edited_during_its_solve_leaves_no_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = own_folder(tmp_path)
    effects = values_of({"shrunk_roof": {"shrinkage": 0.001}})
    task = replace(paths(FIRST).task(0, "draft"), effects=effects, effects_dir=str(own))

    def edited(_task: Solve) -> Solved:
        own_folder(own, OWN + "\n# refined\n")
        values = np.ones((3, 1))
        return Solved(("inflation",), values, (), values[:, None], "completed", "", 0.0)

    monkeypatch.setattr("discrepancy.solves.solve", edited)
    cache = tmp_path / "cache"
    with pytest.raises(FileError, match="an effect in it was changed meanwhile"):
        Solver(1, cache).all([task])
    assert not list(cache.rglob("*.npz"))
