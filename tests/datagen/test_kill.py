"""kill -9 at any moment, then resume: the finished file is the uninterrupted one."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest

from datagen.dataset import Dataset
from datagen.generate import generate
from datagen.parts import parts_folder

from .fake_solver import VERSION, Here, solve_fake
from .kill_server import COUNT, FEW, SEED

ROOT = Path(__file__).parents[2]


class Server:
    """The other end of ``kill_server.py``."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.datagen.kill_server"],
            cwd=ROOT,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # of killed workers
            text=True,
        )

    def start(self, command: str) -> int:
        """Number of the process, and of its group."""
        assert self._process.stdin
        self._process.stdin.write(f"{command}\n")
        self._process.stdin.flush()
        return self._answer()

    def end(self) -> int:
        """Exit status of the process, negative where a signal ended it."""
        return self._answer()

    def _answer(self) -> int:
        assert self._process.stdout
        return int(self._process.stdout.readline())

    def close(self) -> None:
        assert self._process.stdin
        self._process.stdin.close()
        self._process.wait()
        assert self._process.stdout
        self._process.stdout.close()


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    server = Server()
    yield server
    server.close()


def uninterrupted(out: Path, count: int) -> Dataset:
    return generate(
        count, SEED, out, executor=Here(), solve=solve_fake, version=VERSION
    )


def assert_equal_arrays(one: Path, other: Path) -> None:
    """Bit for bit, every variable of the two files."""
    with h5py.File(one) as a, h5py.File(other) as b:
        assert list(a) == list(b)
        for name in a:
            left, right = a[name][()], b[name][()]
            assert left.dtype == right.dtype
            if left.dtype.kind == "O":
                assert left.tolist() == right.tolist(), name
            else:
                assert np.array_equal(
                    left.view(np.uint8) if left.ndim else left,
                    right.view(np.uint8) if right.ndim else right,
                ), name


def finished_rows(out: Path) -> int:
    return len(list(parts_folder(out).glob("row-*.json")))


def test_twenty_kills_at_random_moments(server: Server, tmp_path: Path) -> None:
    """Moments spread over the start of the workers, the rows and the clean-up."""
    reference = tmp_path / "reference.h5"
    uninterrupted(reference, COUNT)
    moments = random.Random(20)
    kills = finished = 0
    held = []
    out = tmp_path / "0.h5"
    while kills < 20 or not out.exists():
        published = out.exists()  # killed in the clean-up
        group = server.start(f"run {out}")
        if kills < 20 and not published:
            rows = moments.randint(finished_rows(out), COUNT + 3)
            patience = time.monotonic() + 20
            while finished_rows(out) < rows and not out.exists():
                assert time.monotonic() < patience
                time.sleep(0.001)
            time.sleep(moments.uniform(0, 0.01))
            with suppress(ProcessLookupError):  # it may be faster
                os.killpg(group, signal.SIGKILL)
        status = server.end()
        assert status in (0, -signal.SIGKILL)
        kills += status != 0
        held.append(finished_rows(out))
        if status == 0:
            assert_equal_arrays(out, reference)
            assert out.read_bytes() == reference.read_bytes()
            assert not parts_folder(out).exists()
            finished += 1
            if kills < 20:
                out = tmp_path / f"{finished}.h5"
    assert len({rows for rows in held if 0 < rows < COUNT}) >= 5, held


def test_a_kill_before_every_step_on_the_disk(server: Server, tmp_path: Path) -> None:
    """Each step in turn, those of the consolidation and the clean-up included."""
    reference = tmp_path / "reference.h5"
    uninterrupted(reference, FEW)
    seen = set()
    for step in range(1, 1000):
        out = tmp_path / f"{step}.h5"
        server.start(f"crash {out} {step}")
        if server.end() == 0:
            break
        parts = parts_folder(out)
        rows = len(list(parts.glob("row-*.json")))
        published = out.exists()
        seen.add((published, parts.exists(), rows))
        if published:  # whole from the first moment on
            assert_equal_arrays(out, reference)
        here = Here()
        data = generate(
            FEW,
            SEED,
            out,
            executor=here,
            resume=True,
            solve=solve_fake,
            version=VERSION,
        )
        assert len(here.rows) == (0 if published else FEW - rows)
        assert len(data) == FEW
        assert_equal_arrays(out, reference)
        assert not parts.exists()
        assert [file.name for file in tmp_path.glob(".*")] == []
    assert step > 20
    # Nothing yet; each number of rows; published; partly removed.
    before = {(False, False, 0), *((False, True, rows) for rows in range(FEW + 1))}
    after = {(True, True, rows) for rows in range(FEW + 1)}
    assert seen == before | after
