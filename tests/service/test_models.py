"""Model versions over HTTP: which one answers, switching under load, adopting."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi.testclient import TestClient

from discrepancy.workspace import CURRENT, Workspace
from discrepancy.writing import measurements_text
from service.app import KINDS, Settings, create_app
from tests.discrepancy.made import MISMATCH, measured
from tests.discrepancy.versions import version
from tests.service.fakes import FakeSurrogate
from tests.service.test_jobs import free_port, server
from tests.service.test_measurements import ended

ASKED = {"design": {"device": "S1"}, "pressure_kPa": [10.0]}
FAR = {"design": {"device": "S1"}, "pressure_kPa": [5.0], "level": "draft"}


@pytest.fixture
def home(tmp_path: Path) -> Workspace:
    """A workspace with two versions, none in use."""
    made = Workspace(tmp_path / "models")
    made.make()
    for name, difference in (("first", -0.0005), ("second", 0.0004)):
        version(difference).save(made.folder / name)
    return made


@pytest.fixture
def client(home: Workspace, tmp_path: Path) -> Iterator[TestClient]:
    settings = Settings(tmp_path / "state", workspace=home.folder, kinds=KINDS)
    app = create_app(settings, lambda _folder: FakeSurrogate())
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client


def test_versions_are_listed_and_shown(client: TestClient) -> None:
    found = client.get("/v1/models").json()
    assert [row["name"] for row in found["models"]] == ["reference", "first", "second"]
    assert found["current"] == "reference"
    about = client.get("/v1/models/first").json()
    assert about["effects"] == ["cure_mismatch"] and not about["in_use"]
    assert client.get("/v1/models/third").status_code == 422


def test_what_is_in_use_answers_and_says_so(client: TestClient) -> None:
    plain = client.post("/v1/predict", json=ASKED).json()
    assert (plain["source"], plain["effects"]) == ("surrogate", [])
    used = client.put("/v1/models/current", json={"model": "first"})
    assert used.json()["effects"] == ["cure_mismatch"]
    assert not client.post("/v1/check", json=ASKED).json()["in_range"]
    answer = client.post("/v1/predict", json=FAR | {"wait_s": 120}).json()
    assert (answer["source"], answer["effects"]) == ("fem", ["cure_mismatch"])
    assert used.json()["version"] in answer["model_version"]
    assert "cure_mismatch" in answer["reasons"][0]
    baseline = client.post(
        "/v1/predict", json=FAR | {"wait_s": 120, "source": "fem"}
    ).json()
    assert baseline["tip_deflection_mm"] == answer["tip_deflection_mm"]
    back = client.post("/v1/models/undo").json()
    assert back["current"] == "reference"
    other = client.post(
        "/v1/predict", json=FAR | {"wait_s": 120, "source": "fem"}
    ).json()
    assert other["effects"] == []
    assert other["tip_deflection_mm"] != answer["tip_deflection_mm"]


def test_a_version_that_cannot_be_read_is_told_and_the_former_answers(
    client: TestClient, home: Workspace
) -> None:
    client.put("/v1/models/current", json={"model": "first"})
    home.use("second")
    (home.folder / "second" / "model.json").write_text("{")
    found = client.get("/v1/models").json()
    assert found["current"] == "first" and "second" in found["problem"]
    (home.folder / CURRENT).unlink()
    assert client.get("/v1/models").json()["current"] == "reference"


def test_removing(client: TestClient) -> None:
    client.put("/v1/models/current", json={"model": "second"})
    assert client.delete("/v1/models/second").status_code == 422
    left = client.delete("/v1/models/first").json()
    assert left["current"] == "second"
    names = [row["name"] for row in client.get("/v1/models").json()["models"]]
    assert names == ["reference", "second"]


@pytest.mark.parametrize(
    ("body", "word"),
    [
        ({"model": "../etc"}, "model"),
        ({"model": "third"}, "third"),
        ({}, "model"),
        ({"model": "first", "now": True}, "now"),
    ],
)
def test_bad_names(client: TestClient, body: dict[str, Any], word: str) -> None:
    answer = client.put("/v1/models/current", json=body)
    assert answer.status_code == 422
    assert word in answer.json()["error"]["message"]


def test_adopting(client: TestClient) -> None:
    """On two files, which are one set."""
    whole, _ = measured(MISMATCH)
    parts = whole.subset(whole.devices[:1]), whole.subset(whole.devices[1:])
    ids = [
        client.post("/v1/measurements", content=measurements_text(part)).json()["id"]
        for part in parts
    ]
    body = {
        "measurements": ids,
        "effects": ["cure_mismatch"],
        "model": "fitted",
        "level": "draft",
    }
    job = ended(client, client.post("/v1/adoptions", json=body))
    assert job["status"] == "done", job["error"]
    files = job["result"]["measurements"]
    assert [one["sha256"][:16] for one in files] == ids
    rungs = job["result"]["ladder"]
    assert rungs[-1]["rung"] == "noise floor"
    assert rungs[-2]["heldout_error"] < rungs[0]["heldout_error"]
    assert client.get("/v1/models").json()["current"] == "fitted"
    page = client.get(f"/v1/jobs/{job['id']}/file")
    assert page.text.startswith("<!DOCTYPE html>")
    again = client.post("/v1/adoptions", json=body | {"measurements": ids[0]})
    refused = ended(client, again)
    assert refused["status"] == "failed"
    assert "fitted" in refused["error"]["message"]


@pytest.mark.parametrize(
    ("measurements", "says"),
    [
        ([], "measurements"),
        (None, "measurements"),
        (["x"], "measurements[0]"),
        ("x", "measurements[0]"),
        (["0" * 16] * 21, "at most 20"),
        ([16 * "0"], "0000"),
    ],
)
def test_files_that_are_none(client: TestClient, measurements: Any, says: str) -> None:
    body = {"measurements": measurements, "effects": ["yeoh"], "model": "none"}
    answer = client.post("/v1/adoptions", json=body)
    assert answer.status_code in (404, 422)
    assert says in answer.json()["error"]["message"]


def test_the_schema_knows_one_file_and_several(client: TestClient) -> None:
    schemas = client.get("/openapi.json").json()["components"]["schemas"]
    kinds = schemas["AdoptionIn"]["properties"]["measurements"]["anyOf"]
    assert [one["type"] for one in kinds] == ["string", "array"]


def test_no_answer_fails_or_is_mixed_while_versions_change(
    home: Workspace, tmp_path: Path
) -> None:
    """Sixteen connections to a real server, while what is in use changes."""
    models = tmp_path / "state" / "models"
    models.parent.mkdir()
    home.folder.rename(models)
    store = Workspace(models)
    port = free_port()
    url = f"http://127.0.0.1:{port}"
    with server(tmp_path / "state", port):
        known = {"reference": "fake-1"}
        for name in ("first", "second"):
            entry = store.find(name)
            assert entry.version is not None
            known[name] = entry.version.version
        stop = threading.Event()
        seen: list[str] = []
        failed: list[str] = []

        def ask() -> None:
            with httpx.Client(base_url=url, timeout=20) as one:
                while not stop.is_set():
                    answer = one.get("/v1/models")
                    if answer.status_code != 200:
                        failed.append(answer.text)
                        continue
                    found = answer.json()
                    used = [row for row in found["models"] if row["in_use"]]
                    whole = len(used) == 1 and used[0]["name"] == found["current"]
                    if not whole or used[0]["version"] != known[found["current"]]:
                        failed.append(answer.text)
                    seen.append(found["current"])
                    checked = one.post("/v1/check", json=ASKED)
                    if checked.status_code != 200:
                        failed.append(checked.text)

        askers = [threading.Thread(target=ask) for _ in range(16)]
        for one in askers:
            one.start()
        for round_ in range(12):
            store.use(("first", "second", "baseline")[round_ % 3])
            time.sleep(0.3)
        stop.set()
        for one in askers:
            one.join()
    assert failed == []
    assert set(seen) == {"reference", "first", "second"}
