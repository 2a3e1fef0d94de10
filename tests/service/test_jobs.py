"""Jobs survive their server: kill -9, restart, cancel, and one server at a time."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from datagen.errors import FileError
from service import jobs
from service.jobs import Job, JobNotFound, JobStore, Kind, TooManyJobs
from tests.service import fakes

KINDS = {
    "count": Kind(fakes.KINDS["dataset"]),
    "predict": Kind(fakes.KINDS["predict"], slots=2),
}


@contextmanager
def opened(state: Path, database_url: str | None = None) -> Iterator[JobStore]:
    store = JobStore(state, KINDS, database_url)
    try:
        yield store
    finally:
        store.close()


@pytest.fixture
def store(tmp_path: Path) -> Iterator[JobStore]:
    with opened(tmp_path / "state") as store:
        yield store


def until(look: Callable[[], Any], seconds: float = 20) -> Any:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if found := look():
            return found
        time.sleep(0.03)
    raise AssertionError(f"not within {seconds} s")


def ended(store: JobStore, job: Job) -> Job:
    def look() -> Job | None:
        now = store.get(job.id)
        return now if now.status not in jobs.OPEN else None

    return until(look)


def counting(tmp_path: Path, steps: int, name: str = "notes") -> dict[str, Any]:
    return {"designs": steps, "out": str(tmp_path / name)}


def test_a_job_from_submission_to_result(store: JobStore, tmp_path: Path) -> None:
    job = store.submit("count", counting(tmp_path, 10))
    assert job.status in jobs.OPEN
    assert abs(job.submitted - time.time()) < 5
    running = until(lambda: (now := store.get(job.id)).progress and now)
    assert running.status == "running"
    assert running.progress["total"] == 10
    done = ended(store, job)
    assert done.status == "done"
    assert done.result == {
        "file": str(tmp_path / "notes"),
        "started": 0,
        "designs": 10,
    }
    assert (done.error, done.progress) == (None, {})
    assert [found.id for found in store.latest()] == [job.id]


def test_jobs_of_one_kind_wait_for_their_turn(store: JobStore, tmp_path: Path) -> None:
    first = store.submit("count", counting(tmp_path, 10, "a"))
    second = store.submit("count", counting(tmp_path, 2, "b"))
    until(lambda: store.get(first.id).progress)
    assert store.get(second.id).status == "queued"
    assert not (tmp_path / "b").exists()
    assert ended(store, second).status == "done"
    assert store.get(first.id).status == "done"
    assert [job.id for job in store.latest()] == [second.id, first.id]


def test_cancelling_stops_the_work(store: JobStore, tmp_path: Path) -> None:
    job = store.submit("count", counting(tmp_path, 10_000))
    waiting = store.submit("count", counting(tmp_path, 10_000, "b"))
    until(lambda: store.get(job.id).progress)
    assert store.cancel(waiting.id).status == "cancelled"
    assert store.cancel(job.id).status == "cancelled"
    size = (tmp_path / "notes").stat().st_size
    time.sleep(0.3)
    assert (tmp_path / "notes").stat().st_size == size
    assert not (tmp_path / "b").exists()
    after = store.submit("count", counting(tmp_path, 1, "c"))
    assert ended(store, after).status == "done"
    assert store.cancel(after.id).status == "done"
    with pytest.raises(JobNotFound):
        store.cancel("none")


def test_the_same_key_is_the_same_job_unless_it_failed(
    store: JobStore, tmp_path: Path
) -> None:
    payload = counting(tmp_path, 3)
    first = store.submit("count", payload, key="k")
    assert store.submit("count", payload, key="k").id == first.id
    assert store.submit("count", payload, key="other").id != first.id
    ended(store, first)
    assert store.submit("count", payload, key="k").status == "done"
    undone = store.submit("count", payload, "k", lambda done: done.id != first.id)
    assert undone.id != first.id
    ended(store, undone)
    assert store.submit("count", payload, key="k").id == undone.id
    slow = store.submit("count", counting(tmp_path, 10_000, "slow"), key="slow")
    store.cancel(slow.id)
    again = store.submit("count", counting(tmp_path, 1, "slow2"), key="slow")
    assert again.id != slow.id
    assert ended(store, again).status == "done"


def test_too_many_jobs_are_refused(
    store: JobStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jobs, "MAX_OPEN", 1)
    job = store.submit("count", counting(tmp_path, 10_000))
    until(lambda: store.get(job.id).progress)
    with pytest.raises(TooManyJobs):
        store.submit("count", counting(tmp_path, 1, "b"))
    store.cancel(job.id)
    assert store.submit("count", counting(tmp_path, 1, "b"))


def test_closing_keeps_the_job_for_the_next_server(tmp_path: Path) -> None:
    with opened(tmp_path / "state") as store:
        job = store.submit("count", counting(tmp_path, 30))
        until(lambda: store.get(job.id).progress)
    notes = tmp_path / "notes"
    kept = notes.stat().st_size
    time.sleep(0.3)
    assert notes.stat().st_size == kept  # nobody goes on without a server
    with opened(tmp_path / "state") as store:
        result = ended(store, job).result
    assert result is not None
    assert result["started"] > 0
    assert notes.read_text().split() == [str(i) for i in range(1, 31)]


def test_one_server_for_a_state_folder(store: JobStore, tmp_path: Path) -> None:
    script = (
        "import sys; from pathlib import Path; from service.jobs import JobStore\n"
        "from datagen.errors import InputError\n"
        "try: JobStore(Path(sys.argv[1]), {})\n"
        "except InputError as error: sys.exit(str(error))"
    )
    command = [sys.executable, "-c", script, str(tmp_path / "state")]
    other = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert other.returncode == 1
    assert other.stderr.count("\n") == 1
    assert "no other running server uses" in other.stderr


def test_a_damaged_or_impossible_state_is_one_clear_error(tmp_path: Path) -> None:
    damaged = tmp_path / "damaged"
    damaged.mkdir()
    (damaged / jobs.DATABASE).write_bytes(b"this is no database, it is text" * 99)
    with pytest.raises(FileError, match="cannot be used"), opened(damaged):
        pass
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError), opened(tmp_path / "file"):
        pass
    url = "postgresql://user:secret@127.0.0.1:9/none"
    with pytest.raises(FileError) as caught, opened(tmp_path / "remote", url):
        pass
    assert "secret" not in str(caught.value)
    with opened(tmp_path / "good") as store:  # the failures left nothing behind
        assert store.latest() == []


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port: int = listener.getsockname()[1]
        return port


@contextmanager
def server(state: Path, port: int) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "tests.service.fake_server", str(state), str(port)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert f"http://127.0.0.1:{port}" in line, process.communicate()
        yield process
    finally:
        process.kill()
        process.communicate()


def test_kill_9_and_restart_finishes_every_job(tmp_path: Path) -> None:
    port = free_port()
    base = f"http://127.0.0.1:{port}"
    slow = {
        "design": {"device": "S1", "lower_thickness_um": 1900},
        "pressure_kPa": [10, 20],
        "wait_s": 0,
    }
    with server(tmp_path / "state", port) as process:
        path = httpx.post(f"{base}/v1/predict", json=slow).headers["location"]
        count = {"designs": 30, "seed": 1}
        response = httpx.post(f"{base}/v1/datasets", json=count)
        assert response.status_code == 202
        dataset = response.headers["location"]
        until(lambda: httpx.get(base + dataset).json()["progress"])
        process.send_signal(signal.SIGKILL)
        process.wait()
    (notes,) = (tmp_path / "state").glob("*/datasets/*")
    time.sleep(0.2)  # the workers have seen that their server is gone
    kept = notes.read_text().split()
    time.sleep(0.3)
    assert notes.read_text().split() == kept
    assert 0 < len(kept) < 30
    with server(tmp_path / "state", port):
        assert httpx.get(base + path).json()["status"] != "done"

        def look(where: str) -> Any:
            job = httpx.get(base + where).json()
            assert job["status"] in ("queued", "running", "done"), job
            return job["result"]

        counted = until(lambda: look(dataset))
        assert counted["started"] >= len(kept)
        file = httpx.get(f"{base}{dataset}/file").text
        assert file.split() == [str(i) for i in range(1, 31)]
        answer = until(lambda: look(path))
        assert answer["inflation_mm"]["value"][1] > 0
        again = httpx.post(f"{base}/v1/predict", json=slow)
        assert again.json() == answer


def test_ctrl_c_ends_the_server_quietly(tmp_path: Path) -> None:
    port = free_port()
    with server(tmp_path / "state", port) as process:
        base = f"http://127.0.0.1:{port}"
        job = httpx.post(f"{base}/v1/datasets", json={"designs": 9999, "seed": 1})
        until(lambda: httpx.get(base + job.headers["location"]).json()["progress"])
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=20)
    assert process.returncode in (0, 130)
    assert "Traceback" not in errors


def test_a_taken_port_is_one_clear_error(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        command = [sys.executable, "-m", "service.cli", "serve", "--port", str(port)]
        run = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=60,
            env=os.environ | {"PBA_STATE": str(tmp_path)},
        )
    assert run.returncode == 2
    assert run.stderr.count("\n") == 1
    assert "--port" in run.stderr
    assert "a free port" in run.stderr


def test_input_errors_travel_from_the_worker(store: JobStore) -> None:
    from datagen.device import named_device

    design = named_device("S1").with_values(cavity_height=13e-6)
    payload = {
        "design": design.to_dict(),
        "pressure": [1e3],
        "in_range": True,
        "reasons": [],
        "adopted": None,
    }
    job = ended(store, store.submit("predict", payload))
    assert job.status == "failed"
    assert job.error is not None
    assert (job.error["type"], job.error["field"]) == ("input", "cavity_height_um")
