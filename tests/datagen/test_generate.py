"""Generation: the same values on any executor, nothing lost, accidents told."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from threadpoolctl import threadpool_info, threadpool_limits

from datagen.dataset import Dataset
from datagen.device import DESIGN_SPACE
from datagen.errors import (
    EffectError,
    FileError,
    GenerationError,
    InputError,
    Interrupted,
)
from datagen.generate import Progress, generate, sampled_space
from datagen.model import GENERATOR_VERSION, Model
from datagen.parts import Manifest, Parts, inputs_digest, parts_folder, row_file
from datagen.response import OUTPUT_NAMES
from datagen.worker import Row, Task

from . import fake_solver
from .fake_solver import VERSION, Here, solve_fake, solve_slowly

ROOT = Path(__file__).parents[2]


def make(out: Path, count: int = 12, seed: int = 3, **options: Any) -> Dataset:
    given = {"solve": solve_fake, "version": VERSION, "executor": Here()} | options
    return generate(count, seed, out, **given)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Twelve rows, generated without interruption."""
    return make(tmp_path_factory.mktemp("whole") / "data.h5")


def alone(out: Path) -> bool:
    """True when `out` is all there is in its folder."""
    return [path.name for path in out.parent.iterdir()] == [out.name]


def test_every_row_is_there_with_its_own_design(tmp_path: Path, whole: Dataset) -> None:
    out = tmp_path / "data.h5"
    data = make(out)
    assert alone(out)
    assert Dataset.read(out).digest() == data.digest() == whole.digest()
    assert_array_equal(data.inputs, DESIGN_SPACE.sample(12, 3))
    assert (data.seed, data.level, data.effects) == (3, "standard", ())
    assert data.generator_version == VERSION
    for i, inputs in enumerate(data.inputs.tolist()):
        row = solve_fake(Task(i, data.variables, tuple(inputs), (), "standard", 150e3))
        steps = data.steps(i)
        assert_array_equal(data.values[i, :steps], row.values)
        assert_array_equal(data.pressure[i, :steps], row.pressure)
        assert data.path_status[i] == row.path_status
        assert data.message[i] == row.message
        assert_array_equal(data.limit_pressure[i], row.limit_pressure)


def test_one_and_two_processes_give_the_same(tmp_path: Path, whole: Dataset) -> None:
    for workers in (1, 2):
        out = tmp_path / f"{workers}.h5"
        make(out, executor=None, workers=workers, solve=solve_slowly)
        assert Dataset.read(out).digest() == whole.digest()
    one, two = (tmp_path / f"{workers}.h5" for workers in (1, 2))
    assert one.read_bytes() == two.read_bytes()


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 2**63 - 1),
    count=st.integers(1, 9),
    workers=st.integers(2, 5),
)
def test_any_number_of_workers_gives_the_same(
    tmp_path_factory: pytest.TempPathFactory, seed: int, count: int, workers: int
) -> None:
    folder = tmp_path_factory.mktemp("workers")
    one = make(folder / "one.h5", count, seed)
    with ThreadPoolExecutor(workers) as threads:
        many = make(folder / "many.h5", count, seed, executor=threads, workers=workers)
    assert one.digest() == many.digest()
    assert len(many) == count


@pytest.fixture
def cluster() -> Iterator[Any]:
    """Two Dask workers behind loopback sockets."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=False,
        host="127.0.0.1",
        protocol="tcp",
        dashboard_address=None,
    ) as cluster:
        yield cluster


def test_a_dask_cluster_gives_the_same(
    tmp_path: Path, whole: Dataset, cluster: Any
) -> None:
    options = {"executor": None, "scheduler": cluster.scheduler_address}
    data = make(tmp_path / "a.h5", **options)
    assert data.digest() == whole.digest()
    with pytest.raises(GenerationError, match="row 3 failed: ZeroDivisionError"):
        make(tmp_path / "b.h5", solve=fake_solver.solve_with_bug, **options)


def test_a_dask_cluster_that_goes_away_is_told(
    tmp_path: Path, whole: Dataset, cluster: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("datagen.pool.DASK_PATIENCE", 1)
    out, address = tmp_path / "a.h5", cluster.scheduler_address

    def close(progress: Progress) -> None:
        if progress.done == 4:
            cluster.close()

    with pytest.raises(GenerationError, match=r"scheduler at .* is gone; \d+ of 12"):
        make(out, executor=None, scheduler=address, progress=close)
    assert make(out, resume=True).digest() == whole.digest()


def test_a_scheduler_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"scheduler: 'nonsense://x' is not allowed"):
        make(tmp_path / "a.h5", executor=None, scheduler="nonsense://x")
    assert list(tmp_path.iterdir()) == []


def test_rows_are_solved_on_one_thread(tmp_path: Path) -> None:
    solve = fake_solver.solve_and_say_threads
    with threadpool_limits(limits=2):
        data = make(tmp_path / "here.h5", 2, solve=solve)
        assert max(pool["num_threads"] for pool in threadpool_info()) == 2
    assert_array_equal(data.values[:, 0, 0], 1)
    data = make(tmp_path / "there.h5", 2, executor=None, solve=solve)
    assert_array_equal(data.values[:, 0, 0], 1)


def test_the_finite_elements_in_a_worker(tmp_path: Path) -> None:
    """The worker gets effects, level and pressure, and solves as we do here."""
    data = generate(
        1,
        5,
        tmp_path / "a.h5",
        effects=["self_weight"],
        level="draft",
        max_pressure=2e3,
    )
    assert data.generator_version == GENERATOR_VERSION
    model = Model(("self_weight",), "draft", data.effect_parameters(0))
    with threadpool_limits(limits=1):
        response = model.explore(data.design(0), 2e3)
    assert response.pressure[0, -1] == data.max_pressure == 2e3
    assert_array_equal(data.pressure, response.pressure)
    assert_array_equal(data.values, response.values)
    with pytest.raises(InputError, match="level"):
        generate(1, 5, tmp_path / "b.h5", level="finest")


def test_progress_counts_rows_and_failures(tmp_path: Path) -> None:
    seen: list[Progress] = []
    make(tmp_path / "a.h5", progress=seen.append)
    assert [step.done for step in seen] == list(range(13))
    assert {step.total for step in seen} == {12}
    assert seen[0].rate == 0
    assert seen[0].seconds_left is None
    assert seen[-1].failed == 4  # every third path of the fake ends inverted
    assert seen[-1].seconds_left == 0
    assert seen[6].rate > 0
    assert seen[6].seconds_left == pytest.approx(6 / seen[6].rate)


def test_only_a_few_rows_are_in_flight(tmp_path: Path) -> None:
    class Watched(ThreadPoolExecutor):
        flying = most = 0

        def submit(self, *args: Any) -> Future[Any]:  # type: ignore[override]
            future = super().submit(*args)
            self.flying += 1
            self.most = max(self.most, self.flying)
            return future

    with Watched(2) as threads:

        def landed(_: Progress) -> None:
            threads.flying -= 1

        threads.flying = 1  # the first report comes before any row
        make(tmp_path / "a.h5", 30, executor=threads, workers=2, progress=landed)
    assert 2 <= threads.most <= 4


# What a run refuses.


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"count": 0}, r"designs: 0 is not allowed; allowed: a whole number from 1"),
        ({"count": 2.5}, "designs: 2.5 is not"),
        ({"count": True}, "designs: True is not"),
        ({"seed": -1}, "seed: -1 is not"),
        ({"seed": 2**63}, "seed: 9223372036854775808 is not"),
        ({"workers": 0}, "workers: 0 is not"),
        ({"max_pressure": float("nan")}, "max_pressure: nan Pa is not"),
        ({"max_pressure": -5.0}, "max_pressure: -5 Pa is not"),
        ({"scheduler": "tcp://127.0.0.1:1"}, "scheduler: .* no executor beside it"),
    ],
)
def test_settings_out_of_range(
    tmp_path: Path, options: dict[str, Any], told: str
) -> None:
    with pytest.raises(InputError, match=told):
        make(tmp_path / "a.h5", **options)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_is_not_touched(tmp_path: Path) -> None:
    out = tmp_path / "a.h5"
    out.write_text("mine")
    with pytest.raises(InputError, match="a file that does not exist yet; --resume"):
        make(out)
    with pytest.raises(FileError, match="not an HDF5 file"):
        make(out, resume=True)
    assert out.read_text() == "mine"
    assert alone(out)


def test_a_missing_folder_is_told(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="cannot be written: No such file"):
        make(tmp_path / "none" / "a.h5")


# Going on after an interruption.


def interrupted(out: Path, after: int = 6, **options: Any) -> Interrupted:
    """A run that Ctrl-C stops after some rows."""

    def stop(progress: Progress) -> None:
        if progress.done == after:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted) as caught:
        make(out, progress=stop, **options)
    return caught.value


def test_resume_solves_only_what_is_missing(tmp_path: Path, whole: Dataset) -> None:
    out = tmp_path / "a.h5"
    told = interrupted(out)
    assert str(told) == (
        f"interrupted: 6 of 12 paths are kept in {out}.parts; "
        "the same command with --resume goes on"
    )
    assert isinstance(told, KeyboardInterrupt)
    assert not out.exists()
    here, seen = Here(), []
    data = make(out, resume=True, executor=here, progress=seen.append)
    assert here.rows == list(range(6, 12))
    assert data.digest() == whole.digest()
    assert (seen[0].done, seen[0].failed, seen[0].rate) == (6, 2, 0)
    assert alone(out)


def test_rows_that_are_finished_when_ctrl_c_comes_are_kept(tmp_path: Path) -> None:
    """Two rows are in flight and done; Ctrl-C comes while the first is counted."""
    told = interrupted(tmp_path / "a.h5", after=5)
    assert "6 of 12 paths are kept" in str(told)
    here = Here()
    make(tmp_path / "a.h5", resume=True, executor=here)
    assert here.rows == list(range(6, 12))


def test_resume_of_nothing_and_of_a_finished_file(
    tmp_path: Path, whole: Dataset
) -> None:
    out = tmp_path / "a.h5"
    assert make(out, resume=True).digest() == whole.digest()
    here = Here()
    assert make(out, resume=True, executor=here).digest() == whole.digest()
    assert here.rows == []
    with pytest.raises(InputError, match="seed: 4 is not allowed; allowed: 3, as"):
        make(out, resume=True, seed=4)


def test_an_interruption_before_the_first_row_leaves_nothing(tmp_path: Path) -> None:
    told = interrupted(tmp_path / "a.h5", after=0)
    assert str(told) == "interrupted: no path was finished yet"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"count": 13}, "designs: 13 is not allowed; allowed: 12, as "),
        ({"seed": 4}, "seed: 4 is not allowed; allowed: 3, as "),
        ({"level": "fine"}, "level: 'fine' is not allowed; allowed: 'standard', as "),
        ({"max_pressure": 1e5}, "max_pressure: 100000 Pa is not .* 150000.0 Pa, as"),
        ({"version": "2"}, "generator_version: '2' is not allowed; allowed: 'fake-1'"),
    ],
)
def test_resume_with_other_settings_is_refused(
    tmp_path: Path, options: dict[str, Any], told: str
) -> None:
    out = tmp_path / "a.h5"
    interrupted(out)
    before = sorted(parts_folder(out).iterdir())
    with pytest.raises(InputError, match=told):
        make(out, resume=True, **options)
    assert sorted(parts_folder(out).iterdir()) == before
    with pytest.raises(InputError, match="a file that does not exist yet"):
        make(out)


def test_resume_of_other_designs_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when another version of scipy samples otherwise."""
    out = tmp_path / "a.h5"
    interrupted(out)
    moved = DESIGN_SPACE.sample(12, 3)
    moved[7, 0] = np.nextafter(moved[7, 0], 1)
    monkeypatch.setattr(type(DESIGN_SPACE), "sample", lambda *_: moved)
    with pytest.raises(InputError, match="sampled the same designs"):
        make(out, resume=True)


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize(
    "damage",
    [
        flip,
        lambda path: path.write_bytes(path.read_bytes()[:-40]),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(path.with_name(row_file(1)).read_bytes()),
        lambda path: path.unlink(),
    ],
    ids=["flipped bit", "truncated", "empty", "another row", "gone"],
)
def test_a_damaged_part_is_solved_again(
    tmp_path: Path, whole: Dataset, damage: Callable[[Path], None]
) -> None:
    out = tmp_path / "a.h5"
    interrupted(out)
    damage(parts_folder(out) / row_file(2))
    here = Here()
    assert make(out, resume=True, executor=here).digest() == whole.digest()
    assert here.rows == [2, *range(6, 12)]


def test_a_part_of_another_run_is_solved_again(tmp_path: Path, whole: Dataset) -> None:
    """Sound in itself, the right row and even the right design, but not ours."""
    out, other = tmp_path / "a.h5", tmp_path / "b.h5"
    interrupted(out)
    interrupted(other, level="fine")
    alien = (parts_folder(other) / row_file(4)).read_bytes()
    (parts_folder(out) / row_file(4)).write_bytes(alien)
    here = Here()
    assert make(out, resume=True, executor=here).digest() == whole.digest()
    assert here.rows == [4, *range(6, 12)]


def test_files_of_others_in_the_folder_stay(tmp_path: Path) -> None:
    out = tmp_path / "a.h5"
    interrupted(out)
    note = parts_folder(out) / "note.txt"
    note.write_text("do not delete")
    make(out, resume=True)
    assert out.exists()
    assert [path.name for path in parts_folder(out).iterdir()] == ["note.txt"]
    assert make(out, resume=True).digest() == Dataset.read(out).digest()


def test_a_manifest_that_is_none_is_told(tmp_path: Path) -> None:
    out = tmp_path / "a.h5"
    interrupted(out)
    for content in ("{", "[1]"):
        (parts_folder(out) / "manifest.json").write_text(content)
        with pytest.raises(FileError, match="not a manifest; remove its folder"):
            make(out, resume=True)


def test_the_manifest_says_what_is_being_generated(tmp_path: Path) -> None:
    interrupted(tmp_path / "a.h5")
    manifest = json.loads((tmp_path / "a.h5.parts" / "manifest.json").read_text())
    assert manifest["designs"] == 12
    assert manifest["seed"] == 3
    assert manifest["level"] == "standard"
    assert manifest["max_pressure"] == 150e3
    assert manifest["generator_version"] == VERSION
    assert [entry["name"] for entry in manifest["design_space"]] == list(
        DESIGN_SPACE.names
    )
    assert manifest["inputs_sha256"] == inputs_digest(DESIGN_SPACE.sample(12, 3))


def test_two_generators_cannot_write_one_file(tmp_path: Path, whole: Dataset) -> None:
    out = tmp_path / "a.h5"
    inside, leave = threading.Event(), threading.Event()
    results: list[Dataset] = []

    def wait(progress: Progress) -> None:
        if progress.done == 2:
            inside.set()
            leave.wait(20)

    first = threading.Thread(target=lambda: results.append(make(out, progress=wait)))
    first.start()
    try:
        assert inside.wait(20)
        with pytest.raises(InputError, match="that no other generator is writing"):
            make(out, resume=True)
    finally:
        leave.set()
        first.join()
    assert results[0].digest() == whole.digest()


def test_a_full_disk_is_told_and_keeps_what_is_there(
    tmp_path: Path, whole: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "a.h5"
    real = os.replace

    def replace(source: Path, target: Path) -> None:
        if Path(target).name == row_file(6):
            raise OSError(28, "No space left on device")
        real(source, target)

    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(FileError, match=r"row-00000006.json: .*No space left"):
        make(out)
    monkeypatch.undo()
    here = Here()
    assert make(out, resume=True, executor=here).digest() == whole.digest()
    assert here.rows == list(range(6, 12))


def test_a_file_that_reads_back_otherwise_is_not_published(
    tmp_path: Path, whole: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "a.h5"
    monkeypatch.setattr(Dataset, "read", lambda _: whole.subset(range(11)))
    with pytest.raises(FileError, match="does not read back as it was written"):
        make(out)
    monkeypatch.undo()
    assert not out.exists()
    here = Here()
    assert make(out, resume=True, executor=here).digest() == whole.digest()
    assert here.rows == []


# Accidents in workers.


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
        make(tmp_path / "a.h5", solve=lambda task: solve_fake(_next(task)))


def _next(task: Task) -> Task:
    from dataclasses import replace

    return replace(task, row=task.row + 1)


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


# Effects.


def test_parameters_of_effects_are_further_columns(tmp_path: Path) -> None:
    space = sampled_space(("cure_mismatch", "self_weight"))
    assert space.names[: len(DESIGN_SPACE)] == DESIGN_SPACE.names
    further = space.names[len(DESIGN_SPACE) :]
    assert {name.split(".")[0] for name in further} == {"cure_mismatch", "self_weight"}
    out = tmp_path / "a.h5"
    data = make(out, effects=["self_weight", "cure_mismatch"])
    assert data.effects == ("cure_mismatch", "self_weight")
    assert data.variables == space.names
    assert_array_equal(data.inputs, space.sample(12, 3))
    parameters = Dataset.read(out).effect_parameters(5)
    flat = {f"{e}.{p}": v for e, ps in parameters.items() for p, v in ps.items()}
    assert flat == dict(zip(further, data.inputs[5, len(DESIGN_SPACE) :], strict=True))


def test_unknown_and_doubled_effects_are_refused(tmp_path: Path) -> None:
    with pytest.raises(EffectError, match=r"'magic' is unknown; .*self_weight"):
        make(tmp_path / "a.h5", effects=["magic"])
    with pytest.raises(InputError, match="each effect once"):
        make(tmp_path / "a.h5", effects=["self_weight", "self_weight"])


# The parts folder by itself.


def test_parts_give_back_rows_exactly(tmp_path: Path, whole: Dataset) -> None:
    """Through JSON and back: the smallest, the largest and the oddest numbers."""
    manifest = Manifest.of(whole)
    odd = [5e-324, -0.0, 1.7976931348623157e308, 0.1, np.nextafter(1, 2)]
    task = Task(0, ("wall",), (0.1 + 0.2,), (), "draft", 150e3)
    row = Row(
        row=0,
        outputs=OUTPUT_NAMES,
        pressure=np.array([1 / 3]),
        values=np.array([odd]),
        status=np.zeros(1, dtype=np.int8),
        path_status="completed",
        limit_pressure=np.nan,
        message='"\n\\ é',
    )
    with Parts(tmp_path / "a.h5", manifest, resume=False) as parts:
        parts.write(task, row)
        (read,) = parts.read([task])
    assert read.values.tobytes() == row.values.tobytes()
    assert read.pressure.tobytes() == row.pressure.tobytes()
    assert np.isnan(read.limit_pressure)
    assert read.message == row.message
