"""Two labs on one machine: what one asks and keeps is not seen from the other."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from discrepancy.workspace import DEFAULT
from discrepancy.writing import measurements_text
from service.app import create_app
from service.jobs import OPEN, JobStore
from tests.discrepancy.made import MISMATCH, measured
from tests.service.fake_server import settings
from tests.service.fakes import FakeSurrogate
from tests.service.test_jobs import KINDS, counting, until


@contextmanager
def lab(folder: Path, state: Path) -> Iterator[TestClient]:
    """A server started in this folder, as ``pba serve`` without options."""
    with pytest.MonkeyPatch.context() as here:
        folder.mkdir(exist_ok=True)
        here.chdir(folder)
        chosen = replace(settings(state), workspace=Path(DEFAULT))
        app = create_app(chosen, lambda _folder: FakeSurrogate())
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client


def test_two_labs_with_one_state_folder_see_nothing_of_each_other(
    tmp_path: Path,
) -> None:
    state = tmp_path / "state"
    slow = {"designs": 10_000, "seed": 1}
    with lab(tmp_path / "a", state) as client:
        assert client.get("/v1/models").json()["workspace"] == str(
            tmp_path / "a" / DEFAULT
        )
        content = measurements_text(measured(MISMATCH)[0])
        client.post("/v1/measurements", content=content)
        job = client.post("/v1/datasets", json=slow).json()["id"]
        until(lambda: client.get(f"/v1/jobs/{job}").json()["progress"])
    with lab(tmp_path / "b", state) as client:
        assert client.get("/v1/jobs").json() == []
        assert client.get(f"/v1/jobs/{job}").status_code == 404
        assert client.get("/v1/measurements").json() == {"measurements": []}
        assert client.get("/v1/models").json()["workspace"] == str(
            tmp_path / "b" / DEFAULT
        )
    with lab(tmp_path / "a", state) as client:  # goes on where it was asked
        assert client.get(f"/v1/jobs/{job}").json()["status"] in OPEN
        assert len(client.get("/v1/measurements").json()["measurements"]) == 1
        client.delete(f"/v1/jobs/{job}")


def test_servers_that_share_a_database_share_no_jobs(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'shared.sqlite'}"
    ids = []
    for name in ("a", "b"):
        store = JobStore(tmp_path / name, KINDS, url)
        try:
            assert store.latest() == []
            ids.append(store.submit("count", counting(tmp_path, 1, name), "key").id)
            assert [job.id for job in store.latest()] == [ids[-1]]
        finally:
            store.close()
    assert ids[0] != ids[1]
