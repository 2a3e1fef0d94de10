"""Interrupted runs go on: nothing lost, nothing foreign taken in."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datagen.dataset import Dataset
from datagen.device import DESIGN_SPACE
from datagen.errors import FileError, InputError, Interrupted
from datagen.generate import Progress
from datagen.parts import Manifest, Parts, inputs_digest, parts_folder, row_file
from datagen.response import OUTPUT_NAMES
from datagen.worker import Row, Task

from .fake_solver import VERSION, Here
from .making import alone, make

ROOT = Path(__file__).parents[2]


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
