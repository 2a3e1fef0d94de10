"""Errors, ratios and the document follow from the recorded runs."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest

from benchmarks import bench_fem
from benchmarks.bench_fem import PeerStopped, call, chosen, programs
from benchmarks.record import OWN, Record, Run, Settled, cheapest
from benchmarks.report import costs, document

ROOT = Path(__file__).parents[2]
PRESSURE = [10.0, 20.0, 30.0, 40.0, 50.0, 60.0]


def run(program: str, mesh: str, seconds: float, tip: float, inflation: float) -> Run:
    """A run with these errors, um, at the last pressure."""
    return Run(
        program=program,
        mesh=mesh,
        unknowns=1000,
        seconds=2 * seconds,
        processor=seconds,
        iterations=5,
        factorisations=2,
        tip=[20.0, 10.0, 0.0, -5.0, -8.0, -10.0 + tip],
        inflation=[100.0, 150.0, 200.0, 220.0, 240.0, 250.0 + inflation],
    )


def record() -> Record:
    return Record(
        PRESSURE,
        "one processor",
        60.0,
        {OWN: "tight", "peer": "tight"},
        Settled(
            [10.0, 30.0, 60.0], [20.0, 0.0, -10.0], [100.0, 200.0, 250.0], 0.1, 0.2
        ),
        {OWN: "1", "peer": "2"},
        (
            run(OWN, "draft", 1.0, 2.0, 0.0),
            run(OWN, "standard", 4.0, 0.2, 0.5),
            run("peer", "coarse", 30.0, -3.0, 1.0),
            run("peer", "fine", 60.0, 0.3, -1.0),
            Run("peer", "draft", reason="failed past 30 kPa"),
        ),
    )


def test_errors_are_percent_of_the_path_s_maximum() -> None:
    made = record()
    assert made.errors(made.find("peer", "coarse")) == pytest.approx((15.0, 0.4))
    assert made.errors(run(OWN, "fine", 9.0, 0.0, 0.0)) == (0.0, 0.0)
    with pytest.raises(LookupError, match="draft"):
        made.find("peer", "draft")


def test_the_cheapest_is_as_accurate() -> None:
    made = record()
    assert cheapest(made, OWN, 15.0, 0.4).mesh == "draft"  # type: ignore[union-attr]
    assert cheapest(made, OWN, 1.5, 0.4).mesh == "standard"  # type: ignore[union-attr]
    assert cheapest(made, "peer", 1.0, 0.1) is None


def test_ratios_are_of_seconds_at_matched_accuracy() -> None:
    lines = {
        tuple(cell.strip() for cell in line.split("|")[1:3]): line
        for line in costs(record()).splitlines()
    }
    assert lines["peer", "coarse"].endswith("| 15.00 | 0.40 |  | draft | 30.0 |")
    assert lines["peer", "fine"].endswith("| 1.50 | 0.40 |  | standard | 15.0 |")
    assert ("peer", "draft") not in lines
    assert "- peer: not run on standard, medium, finest\n" in document(record())
    both = record().with_run(run("peer", "standard", 32.0, 0.2, 0.5))
    assert "| 0.20 | 8.0 | standard | 8.0 |" in costs(both)
    assert "- peer, draft mesh: failed past 30 kPa\n" in document(record())


def test_a_record_is_kept(tmp_path: Path) -> None:
    made = record()
    made.write(tmp_path / "fem.json")
    assert Record.read(tmp_path / "fem.json") == made
    newer = made.with_run(run("peer", "draft", 5.0, 1.0, 1.0))
    assert len(newer.runs) == len(made.runs)
    assert newer.find("peer", "draft").processor == 5.0


def test_the_document_is_that_of_its_results() -> None:
    folder = ROOT / "docs/benchmarks"
    found = Record.read(folder / "fem.json")
    assert (folder / "fem.md").read_text() == document(found)
    assert found.settled == bench_fem.settled_answer()
    assert [program.name for program in programs(Path("python"))] == list(
        found.tolerances
    )


def test_short_runs_are_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    """The median of three by the processor's time; a long run or a failure stays."""
    own = programs(Path("python"))[0]
    for seconds, kept in (
        ([5.0, 3.0, 4.0], 4.0),
        ([50.0, 1.0, 1.0], 50.0),
    ):
        left = [run(OWN, "draft", one, 0.0, 0.0) for one in seconds]
        monkeypatch.setattr(
            bench_fem, "measure_once", lambda *_, left=left: (left.pop(0), {"a": "1"})
        )
        found, versions = bench_fem.measure(own, "draft", 10.0)
        assert (found.processor, versions) == (kept, {"a": "1"})
    failed = Run(OWN, "draft", reason="no mesh")
    monkeypatch.setattr(bench_fem, "measure_once", lambda *_: (failed, {}))
    assert bench_fem.measure(own, "draft", 10.0) == (failed, {})


def test_a_failure_gives_its_last_line() -> None:
    with pytest.raises(PeerStopped, match=r"^no mesh$"):
        call([sys.executable, "-c", "print('a'); raise SystemExit('no mesh')"], 30.0)
    with pytest.raises(PeerStopped, match="not installed"):
        call(["no-such-program"], 30.0)


def test_a_run_is_stopped_with_its_children(tmp_path: Path) -> None:
    """The grandchild would write its file after three seconds."""
    late = tmp_path / "late"
    grandchild = f"import time; time.sleep(3); open({str(late)!r}, 'w')"
    run_it = f"subprocess.run([sys.executable, '-c', {grandchild!r}])"
    child = f"import subprocess, sys; {run_it}"
    with pytest.raises(PeerStopped, match="not done after 1 s"):
        call([sys.executable, "-c", child], 1.0)
    time.sleep(3)
    assert not late.exists()


def test_runs_can_be_chosen() -> None:
    every = programs(Path("python"))
    assert len(list(chosen(every, []))) == sum(len(p.meshes) for p in every)
    few = [(p.name, mesh) for p, mesh in chosen(every, ["CalculiX", "pba:fine"])]
    assert few[0] == ("pba", "fine")
    assert {name for name, _ in few[1:]} == {"CalculiX"}
