"""Measurements over HTTP: kept, refused by line, compared and ranked as jobs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from datagen.errors import InputError
from discrepancy.writing import measurements_text
from service.app import KINDS, Settings, create_app
from service.discrepancy_tasks import measured_of
from service.measurements import MeasurementFiles, MeasurementsNotFound
from tests.discrepancy.made import MISMATCH, measured
from tests.service.fakes import FakeSurrogate


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    state = tmp_path_factory.mktemp("state")
    app = create_app(
        Settings(state, workspace=state / "models", kinds=KINDS),
        lambda _folder: FakeSurrogate(),
    )
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client


@pytest.fixture(scope="module")
def csv() -> bytes:
    """Three devices with a mismatch of the cures in them."""
    return measurements_text(measured(MISMATCH)[0]).encode()


@pytest.fixture(scope="module")
def identity(client: TestClient, csv: bytes) -> str:
    answer = client.post("/v1/measurements?name=bench.csv", content=csv)
    assert answer.status_code == 201, answer.text
    found: str = answer.json()["id"]
    assert answer.headers["Location"] == f"/v1/measurements/{found}"
    return found


def ended(client: TestClient, answer: Any, seconds: float = 300) -> dict[str, Any]:
    """The job of an answer once it has ended."""
    assert answer.status_code == 202, answer.text
    assert answer.headers["Retry-After"] == "1"
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        job: dict[str, Any] = client.get(answer.headers["Location"]).json()
        if job["status"] not in ("queued", "running"):
            return job
        time.sleep(0.2)
    raise AssertionError(f"not within {seconds} s: {job}")


def test_what_is_kept_is_described(
    client: TestClient, identity: str, csv: bytes
) -> None:
    found = client.get(f"/v1/measurements/{identity}").json()
    assert found["name"] == "bench.csv"
    assert found["devices"] == ["thin", "S1", "swapped"]
    assert sum(curve["readings"] for curve in found["curves"]) == found["readings"]
    assert {"id": identity, "name": "bench.csv"} in client.get(
        "/v1/measurements"
    ).json()["measurements"]
    again = client.post("/v1/measurements?name=other.csv", content=csv)
    assert again.json()["id"] == identity


def test_a_file_may_come_in_a_form(client: TestClient, csv: bytes) -> None:
    sent = csv + b"\r\n"
    plain = client.post("/v1/measurements", content=sent).json()
    answer = client.post("/v1/measurements", files={"file": ("lab.csv", sent)})
    assert answer.status_code == 201, answer.text
    assert answer.json()["id"] == plain["id"]
    other = client.post("/v1/measurements", files={"data": ("lab 2.csv", csv + b"\n")})
    assert other.json()["name"] == "lab 2.csv"


@pytest.mark.parametrize("count", [0, 2])
def test_a_form_has_one_file(client: TestClient, csv: bytes, count: int) -> None:
    files = [("file", (f"{i}.csv", csv)) for i in range(count)]
    files += [("note", (None, b"no file"))]
    answer = client.post("/v1/measurements", files=files)
    assert answer.status_code == 422
    message = answer.json()["error"]["message"]
    assert f"'{count} files' is not allowed; allowed: one file" in message


def test_what_is_not_allowed_is_told_by_line_and_not_kept(
    client: TestClient, csv: bytes
) -> None:
    before = client.get("/v1/measurements").json()
    lines = csv.decode().splitlines()
    head, row = lines[0].split(","), lines[2].split(",")
    row[head.index("upper_thickness_um")] = "-3"
    lines[2] = ",".join(row)
    answer = client.post("/v1/measurements", content="\n".join(lines))
    assert answer.status_code == 422
    error = answer.json()["error"]
    assert error["type"] == "measurements"
    assert "upper_thickness_um" in error["message"] and ":3" in error["message"]
    assert error["problems"][0]["line"] == "3"
    assert client.get("/v1/measurements").json() == before


@pytest.mark.parametrize(
    ("query", "content"), [("", b""), ("?name=../../etc", b"device\n"), ("", b"\xff")]
)
def test_bad_uploads(client: TestClient, query: str, content: bytes) -> None:
    answer = client.post(f"/v1/measurements{query}", content=content)
    assert answer.status_code == 422, answer.text
    error = answer.json()["error"]
    assert set(error) >= {"type", "message"}
    assert "state" not in error["message"]


def test_unknown_measurements(client: TestClient) -> None:
    for path in ("/v1/comparisons", "/v1/rankings"):
        answer = client.post(path, json={"measurements": "0" * 16})
        assert answer.status_code == 404
    assert client.get("/v1/measurements/0000").status_code == 404


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("effects", ["nonsense"]),
        ("level", "rough"),
        ("camera_tolerance_pct", -1),
        ("thickness_tolerance_um", 1000),
        ("seed", 0.5),
        ("colour", "red"),
    ],
)
def test_bad_questions(
    client: TestClient, identity: str, field: str, value: object
) -> None:
    body = {"measurements": identity, field: value}
    answer = client.post("/v1/rankings", json=body)
    assert answer.status_code == 422
    assert field in answer.json()["error"]["message"]


def test_comparison(client: TestClient, identity: str) -> None:
    body = {"measurements": identity, "level": "draft"}
    job = ended(client, client.post("/v1/comparisons", json=body))
    assert job["status"] == "done", job["error"]
    assert job["result"]["p_value"] < 0.05
    again = client.post("/v1/comparisons", json=body)
    assert again.json()["id"] == job["id"]


def test_ranking_and_its_report(client: TestClient, identity: str) -> None:
    body = {
        "measurements": identity,
        "level": "draft",
        "effects": ["cure_mismatch", "pressure_offset"],
    }
    job = ended(client, client.post("/v1/rankings", json=body))
    assert job["status"] == "done", job["error"]
    assert job["result"]["verdict"] == "identified"
    assert job["result"]["effects"] == ["cure_mismatch"]
    page = client.get(f"/v1/jobs/{job['id']}/file")
    assert "cure_mismatch" in page.text and page.text.startswith("<!DOCTYPE html>")
    assert page.headers["Content-Disposition"].endswith('.html"')


@pytest.mark.parametrize(
    ("sent", "kept"),
    [
        ("Messung März.csv", "Messung März.csv"),
        ("_bench,1.csv", "_bench,1.csv"),
        ("测量.csv", "测量.csv"),
        ("C:\\data\\bench 2.csv", "bench 2.csv"),
        (f"{'x' * 200}.csv", "x" * 100),
        (f"{chr(0x6E2C) * 96}.csv", chr(0x6E2C) * 66),  # three bytes each
    ],
)
def test_files_keep_the_names_that_people_give_them(
    client: TestClient, csv: bytes, sent: str, kept: str
) -> None:
    content = csv.replace(b"swapped", f"swapped {len(sent)}".encode())
    answer = client.post("/v1/measurements", files={"file": (sent, content)})
    assert answer.status_code == 201, answer.text
    assert answer.json()["name"] == kept
    assert client.delete(f"/v1/measurements/{answer.json()['id']}").status_code == 204


def test_a_file_that_goes_during_a_listing_is_not_in_it(
    tmp_path: Path, csv: bytes
) -> None:
    files = MeasurementFiles(tmp_path)
    first = files.add("a.csv", csv)
    other = files.add("b.csv", csv.replace(b"swapped", b"turned"))
    listing = files.all()
    files.remove(next(listing))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MeasurementFiles, "all", lambda _: iter([first, other]))
        assert len(files.names()) == 1


def test_what_is_damaged_is_kept_anew(tmp_path: Path, csv: bytes) -> None:
    """As a power loss may leave it."""
    files = MeasurementFiles(tmp_path)
    identity = files.add("a.csv", csv)
    files.path(identity).write_bytes(b"")
    assert files.add("b.csv", csv) == identity
    assert files.path(identity).name == "b.csv"
    assert files.path(identity).read_bytes() == csv


def test_what_is_forgotten_twice_at_a_time_is_not_there(
    tmp_path: Path, csv: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = MeasurementFiles(tmp_path)
    identity = files.add("a.csv", csv)
    path = files.path(identity)
    monkeypatch.setattr(MeasurementFiles, "path", lambda *_: path)
    files.remove(identity)
    for late in (files.remove, files.describe):
        with pytest.raises(MeasurementsNotFound):
            late(identity)


def test_a_file_that_is_wrong_everywhere_has_a_short_answer(
    client: TestClient, csv: bytes
) -> None:
    heading = csv.splitlines()[0]
    answer = client.post("/v1/measurements", content=heading + b"\nx" * 5000)
    assert answer.status_code == 422 and len(answer.content) < 100_000
    assert "at least" in answer.json()["error"]["message"]


def test_forgotten(client: TestClient, csv: bytes) -> None:
    other = csv.replace(b"swapped", b"turned")
    kept = client.post("/v1/measurements", content=other).json()["id"]
    assert client.delete(f"/v1/measurements/{kept}").status_code == 204
    assert client.get(f"/v1/measurements/{kept}").status_code == 404
    assert client.delete(f"/v1/measurements/{kept}").status_code == 404


def test_a_job_whose_measurements_are_gone_says_so(tmp_path: Path) -> None:
    payload = {"files": [str(tmp_path / "kept" / "bench.csv")], "tolerances": {}}
    with pytest.raises(InputError, match="deleted before the work") as told:
        measured_of(payload)
    assert str(tmp_path) not in str(told.value)


def test_files_are_those_that_were_sent(
    client: TestClient, identity: str, csv: bytes
) -> None:
    from service.measurements import MeasurementFiles

    service = client.app.state.service  # type: ignore[attr-defined]
    path = MeasurementFiles(Path(service.state) / "measurements").path(identity)
    assert path.read_bytes() == csv
