"""Bugs, dead workers and Ctrl-C: told in one line, and finished rows are kept."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Future
from pathlib import Path
from typing import Any

import pytest
from numpy.testing import assert_array_equal

from datagen.dataset import Dataset
from datagen.errors import GenerationError

from . import fake_solver
from .fake_solver import Here
from .making import make

ROOT = Path(__file__).parents[2]


def test_a_bug_names_row_and_design_and_keeps_the_others(
    tmp_path: Path, whole: Dataset
) -> None:
    out = tmp_path / "a.h5"
    with pytest.raises(GenerationError) as caught:
        make(out, executor=None, workers=2, solve=fake_solver.solve_with_bug)
    told = str(caught.value)
    assert "row 3 failed: ZeroDivisionError('radius of row three')" in told
    assert f"balloon_length={whole.inputs[3, 0]:.6g}" in told
    assert "11 of 12 paths are kept" in told
    assert "\n" not in told
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    here = Here()
    assert make(out, resume=True, executor=here).digest() == whole.digest()
    assert here.rows == [3]


def test_many_bugs_stop_the_run(tmp_path: Path) -> None:
    here, solve = Here(), fake_solver.solve_only_bugs
    with pytest.raises(GenerationError, match=r"row 0 \(and 5 more rows\) failed"):
        make(tmp_path / "a.h5", 40, executor=here, solve=solve)
    assert len(here.rows) < 10
    assert list(tmp_path.iterdir()) == []


def test_a_converged_step_without_a_value_is_a_bug(tmp_path: Path) -> None:
    solve = fake_solver.solve_unfinished
    with pytest.raises(GenerationError, match="finite in every converged step"):
        make(tmp_path / "a.h5", executor=None, solve=solve)


def test_a_dead_worker_is_replaced(tmp_path: Path, whole: Dataset) -> None:
    data = make(
        tmp_path / "a.h5",
        executor=None,
        workers=2,
        level=str(tmp_path),
        solve=fake_solver.solve_or_die_once,
    )
    assert (tmp_path / "died").exists()
    assert_array_equal(data.values, whole.values)


def test_a_row_that_kills_its_worker_is_found(tmp_path: Path, whole: Dataset) -> None:
    out = tmp_path / "a.h5"
    with pytest.raises(GenerationError) as caught:
        make(out, executor=None, workers=2, solve=fake_solver.solve_or_die)
    told = str(caught.value)
    assert told.startswith("row 3 failed: its worker process died 3 times; its design")
    assert "11 of 12 paths are kept" in told
    assert make(out, resume=True).digest() == whole.digest()


def test_a_broken_executor_of_the_caller_is_told(
    tmp_path: Path, whole: Dataset
) -> None:
    class Broken(Here):
        def submit(self, function: Callable[..., Any], *args: Any) -> Future[Any]:
            if len(self.rows) == 4:
                raise BrokenExecutor
            return super().submit(function, *args)

    out = tmp_path / "a.h5"
    with pytest.raises(GenerationError, match=r"lost its workers; 4 of 12 paths"):
        make(out, executor=Broken())
    assert make(out, resume=True).digest() == whole.digest()


def test_a_row_with_the_wrong_number_is_a_bug(tmp_path: Path) -> None:
    with pytest.raises(GenerationError, match="row 0 was answered by row 1"):
        make(tmp_path / "a.h5", solve=fake_solver.solve_the_next)


SCRIPT = """
import sys
from datagen.errors import PbaError
from datagen.generate import generate
from tests.datagen.fake_solver import VERSION, solve_for_ever

if __name__ == "__main__":
    report = lambda progress: print(progress.done, flush=True)
    try:
        generate(12, 3, sys.argv[1], workers=2, solve=solve_for_ever, version=VERSION,
                 progress=report)
    except PbaError as error:
        sys.exit(f"told: {error}")
"""


@pytest.fixture
def running(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """A run in its own process group, with four finished rows and two that hang."""
    script, out = tmp_path / "script.py", tmp_path / "a.h5"
    script.write_text(SCRIPT)
    process = subprocess.Popen(
        [sys.executable, str(script), str(out)],
        env=os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout
    while process.stdout.readline().strip() != "4":
        assert process.poll() is None
    yield process, out
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def group_is_gone(group: int, patience: float = 10) -> bool:
    end = time.monotonic() + patience
    while time.monotonic() < end:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.02)
    return False


def test_ctrl_c_stops_at_once_and_says_how_to_go_on(
    running: tuple[subprocess.Popen[str], Path], whole: Dataset
) -> None:
    process, out = running
    os.killpg(process.pid, signal.SIGINT)  # as the terminal does: workers get it too
    _, errors = process.communicate(timeout=20)
    assert errors == (
        f"told: interrupted: 4 of 12 paths are kept in {out}.parts; "
        "the same command with --resume goes on\n"
    )
    assert process.returncode == 1
    assert group_is_gone(process.pid)
    assert make(out, resume=True).digest() == whole.digest()


def test_workers_leave_when_their_parent_is_killed(
    running: tuple[subprocess.Popen[str], Path],
) -> None:
    process, _ = running
    process.kill()  # the parent alone
    process.wait()
    assert group_is_gone(process.pid)


def test_no_worker_process_is_left(tmp_path: Path) -> None:
    make(tmp_path / "a.h5", 2, executor=None, workers=2)
    assert multiprocessing.active_children() == []
