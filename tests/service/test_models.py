"""Model versions over HTTP: which one answers, switching under load, adopting."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count, cycle
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from fastapi.testclient import TestClient

from datagen.device import named_device
from datagen.response import Path as LoadPath
from discrepancy.version import ModelVersion
from discrepancy.workspace import CURRENT, Workspace
from discrepancy.writing import measurements_text
from service.app import KINDS, Settings, create_app
from service.current import Switch
from service.jobs import Kind
from tests.discrepancy.made import MISMATCH, measured
from tests.discrepancy.versions import own_folder, own_version, version
from tests.service.fakes import FakeSurrogate
from tests.service.test_jobs import free_port, server, until
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


@contextmanager
def serving(home: Workspace, tmp_path: Path) -> Iterator[TestClient]:
    settings = Settings(tmp_path / "state", workspace=home.folder, kinds=KINDS)
    app = create_app(settings, lambda _folder: FakeSurrogate())
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client


@pytest.fixture
def client(home: Workspace, tmp_path: Path) -> Iterator[TestClient]:
    with serving(home, tmp_path) as client:
        yield client


def test_versions_are_listed_and_shown(client: TestClient) -> None:
    found = client.get("/v1/models").json()
    assert [row["name"] for row in found["models"]] == ["reference", "first", "second"]
    assert found["current"] == "reference"
    about = client.get("/v1/models/first").json()
    assert about["effects"] == ["cure_mismatch"] and not about["in_use"]
    for answer in (client.get("/v1/models/third"), client.delete("/v1/models/third")):
        assert answer.status_code == 404
        assert answer.json()["error"]["type"] == "not_found"


def test_a_list_is_of_one_moment(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    client.put("/v1/models/current", json={"model": "first"})
    switch = client.app.state.service.switch  # type: ignore[attr-defined]
    turns = cycle([switch.now(), switch.base])
    monkeypatch.setattr(Switch, "look", lambda _self: next(turns))
    found = client.get("/v1/models").json()
    used = [row["name"] for row in found["models"] if row["in_use"]]
    assert used == [found["current"]] == ["first"]


@pytest.mark.parametrize("name", ["baseline", "reference"])
def test_the_base_goes_by_both_its_names(
    client: TestClient, home: Workspace, name: str
) -> None:
    about = client.get(f"/v1/models/{name}").json()
    assert about == client.get("/v1/models").json()["models"][0] and about["in_use"]
    client.put("/v1/models/current", json={"model": "first"})
    used = client.put("/v1/models/current", json={"model": name}).json()
    assert (used["current"], used["effects"]) == ("reference", [])
    answer = client.delete(f"/v1/models/{name}?force=true")
    assert answer.status_code == 422 and "always stays" in answer.text
    version(seed=7).save(home.folder / "reference")  # a version has its name first
    used = client.put("/v1/models/current", json={"model": "reference"}).json()
    assert used["effects"] == ["cure_mismatch"]
    rows = client.get("/v1/models").json()["models"]
    assert sum(row["in_use"] for row in rows) == 1


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
    health = client.get("/healthz").json()
    assert health["status"] == "ok" and "second" in health["problem"]
    assert any("second" in note for note in checked(client)["notes"])
    answer = client.post("/v1/predict", json=FAR | {"wait_s": 120}).json()
    assert "first goes on answering" in answer["notes"][-1]
    (home.folder / CURRENT).unlink()
    assert client.get("/v1/models").json()["current"] == "reference"
    assert client.get("/healthz").json()["problem"] == ""
    assert checked(client)["notes"] == []


def checked(client: TestClient) -> dict[str, Any]:
    found: dict[str, Any] = client.post("/v1/check", json=ASKED).json()
    return found


def test_a_damaged_current_is_repaired_by_what_is_put_into_use(
    client: TestClient, home: Workspace
) -> None:
    for name in ("first", "baseline"):
        (home.folder / CURRENT).write_text("{")
        assert CURRENT in client.get("/v1/models").json()["problem"]
        answer = client.put("/v1/models/current", json={"model": name})
        assert answer.status_code == 200, answer.text
        assert client.get("/healthz").json()["problem"] == ""


def test_a_server_started_on_a_damaged_version_does_not_answer_with_another(
    home: Workspace, tmp_path: Path
) -> None:
    path = home.folder / "first" / "model.json"
    whole = path.read_text()
    home.use("first")
    path.write_text(whole.replace("-0.0005", "-0.0004"))
    with serving(home, tmp_path) as client:
        for ask in (
            lambda: client.get("/healthz"),
            lambda: client.post("/v1/check", json=ASKED),
            lambda: client.post("/v1/predict", json=ASKED),
            lambda: client.post("/v1/predict", json=FAR | {"source": "fem"}),
        ):
            answer = ask()
            assert answer.status_code == 503
            error = answer.json()["error"]
            assert error["type"] == "no_model" and "damaged" in error["message"]
        listed = client.get("/v1/models").json()
        assert listed["current"] is None and "first" in listed["problem"]
        assert not any(row["in_use"] for row in listed["models"])
        path.write_text(whole)  # repaired: answers again, by itself
        assert client.get("/v1/models").json()["current"] == "first"
        assert client.get("/healthz").json()["problem"] == ""


def test_a_damaged_surrogate_leaves_the_versions_own_finite_elements(
    home: Workspace, tmp_path: Path
) -> None:
    home.use("first")
    surrogate = home.folder / "first" / "surrogate"
    surrogate.mkdir()
    (surrogate / "model.json").write_text("{")
    with serving(home, tmp_path) as client:
        found = checked(client)
        assert not found["in_range"] and "cannot be read" in found["reasons"][0]
        answer = client.post("/v1/predict", json=FAR | {"wait_s": 120}).json()
        assert (answer["source"], answer["effects"]) == ("fem", ["cure_mismatch"])
        assert any("finite elements answer" in note for note in answer["notes"])
        assert "surrogate of first" in client.get("/healthz").json()["problem"]
        shutil.rmtree(surrogate)
        assert client.get("/healthz").json()["problem"] == ""


def test_what_cannot_answer_is_not_put_into_use(
    client: TestClient, home: Workspace
) -> None:
    client.put("/v1/models/current", json={"model": "first"})
    client.put("/v1/models/current", json={"model": "second"})
    for name in ("first", "second"):
        (home.folder / name / "surrogate").mkdir()
    (home.folder / "second" / "surrogate").rmdir()
    for answer in (
        client.put("/v1/models/current", json={"model": "first"}),
        client.post("/v1/models/undo"),
    ):
        assert answer.status_code == 500 and answer.json()["error"]["type"] == "file"
        assert home.current_name == "second"


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


@pytest.fixture(scope="module")
def csv() -> str:
    """Three devices with a mismatch of the cures in them."""
    return measurements_text(measured(MISMATCH)[0])


@pytest.fixture
def adoption(client: TestClient) -> dict[str, Any]:
    """A body that adopts one effect on two files of measurements, which are one set."""
    whole, _ = measured(MISMATCH)
    parts = whole.subset(whole.devices[:1]), whole.subset(whole.devices[1:])
    ids = [
        client.post("/v1/measurements", content=measurements_text(part)).json()["id"]
        for part in parts
    ]
    return {
        "measurements": ids,
        "effects": ["cure_mismatch"],
        "model": "fitted",
        "level": "draft",
    }


def test_adopting(client: TestClient, adoption: dict[str, Any]) -> None:
    job = ended(client, client.post("/v1/adoptions", json=adoption))
    assert job["status"] == "done", job["error"]
    files = job["result"]["measurements"]
    assert [one["sha256"][:16] for one in files] == adoption["measurements"]
    rungs = job["result"]["ladder"]
    assert rungs[-1]["rung"] == "noise floor"
    assert rungs[-2]["heldout_error"] < rungs[0]["heldout_error"]
    assert client.get("/v1/models").json()["current"] == "fitted"
    page = client.get(f"/v1/jobs/{job['id']}/file")
    assert page.text.startswith("<!DOCTYPE html>")
    Path(job["result"]["file"]).unlink()
    gone = client.get(f"/v1/jobs/{job['id']}/file")
    assert gone.status_code == 404 and "no longer there" in gone.text
    again = client.post("/v1/adoptions", json=adoption)
    assert again.json()["id"] == job["id"]
    other = client.post("/v1/adoptions", json=adoption | {"seed": 1})
    assert other.status_code == 422 and other.json()["error"]["field"] == "model"


@pytest.mark.parametrize(
    ("change", "field", "says"),
    [
        ({"effects": ["mullins", "mullins"]}, "effects", "each effect once"),
        ({"effects": ["viscoelasticity"]}, "effects", "no reading has one (column"),
        ({"effects": ["shrunk_roof"]}, "effects", "air_channel"),
        ({"model": "baseline"}, "model", "not 'baseline'"),
        ({"model": "current.json"}, "model", "'current.json'"),
        ({"model": "first"}, "model", "not taken"),
        ({"model": "damaged"}, "model", "not taken"),
        ({"on": "third"}, "on", "baseline, first, second"),
    ],
)
def test_adoptions_that_cannot_be_done_are_refused_at_once(
    client: TestClient,
    home: Workspace,
    adoption: dict[str, Any],
    change: Any,
    field: str,
    says: str,
) -> None:
    version().save(home.folder / "damaged")
    model = home.folder / "damaged" / "model.json"
    model.write_text(model.read_text().replace("bench.csv", "other.csv"))
    answer = client.post("/v1/adoptions", json=adoption | change)
    assert answer.status_code == 422, answer.text
    error = answer.json()["error"]
    assert error["field"] == field and says in error["message"]


@pytest.fixture
def quick(
    home: Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[TestClient]:
    """The same server, adopting and training without a fit."""
    for name in ("adopt", "surrogate"):
        monkeypatch.setitem(KINDS, name, Kind(f"tests.service.fakes:{name}"))
    with serving(home, tmp_path) as client:
        yield client


def test_a_done_adoption_counts_while_its_version_is_there_and_in_use(
    quick: TestClient, home: Workspace, csv: str
) -> None:
    sent = quick.post("/v1/measurements", content=csv).json()
    body = {"measurements": sent["id"], "effects": ["cure_mismatch"], "model": "new"}

    def adopted(**more: Any) -> str:
        job = ended(quick, quick.post("/v1/adoptions", json=body | more))
        assert job["status"] == "done", job["error"]
        return str(job["id"])

    first = adopted(on="baseline")
    assert adopted(on="reference") == adopted() == first
    for undo in (
        lambda: quick.post("/v1/models/undo"),
        lambda: quick.put("/v1/models/current", json={"model": "second"}),
        lambda: quick.delete("/v1/models/new?force=true"),
    ):
        assert undo().status_code == 200
        later = adopted()
        assert later != first and home.current_name == "new"
        assert adopted() == later
    unused = adopted(use=False)
    quick.post("/v1/models/undo")
    assert adopted(use=False) == unused and home.current_name != "new"
    # A parent made anew under its name is another parent.
    child = adopted(model="child", on="new")
    quick.delete("/v1/models/child?force=true")
    quick.delete("/v1/models/new?force=true")
    version(seed=8).save(home.folder / "new")
    assert adopted(model="child", on="new") != child
    found = home.find("child").version
    again = home.find("new").version
    assert found is not None and again is not None and found.parent == again.version


def test_an_effect_of_ones_own_is_fitted_again(
    quick: TestClient, home: Workspace, csv: str, tmp_path: Path
) -> None:
    """It is in the version that the new one is built on: no file is sent."""
    own = own_folder(tmp_path / "effects")
    own_version(own).save(home.folder / "own", own)
    sent = quick.post("/v1/measurements", content=csv).json()
    body = {"measurements": sent["id"], "effects": ["shrunk_roof"], "model": "new"}
    assert quick.post("/v1/adoptions", json=body).status_code == 422
    job = ended(quick, quick.post("/v1/adoptions", json=body | {"on": "own"}))
    assert job["status"] == "done", job["error"]


def test_a_done_surrogate_counts_while_it_is_there(
    quick: TestClient, home: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    def load(one: ModelVersion) -> str | None:
        return None if one.surrogate is None else one.version

    other: dict[str, Any] = {}
    monkeypatch.setattr("service.model_routes.load", load)
    monkeypatch.setattr(
        "service.model_routes.told", lambda one: {"version": one} | other
    )

    def trained() -> dict[str, Any]:
        return ended(quick, quick.post("/v1/models/first/surrogate", json={}))

    job = trained()
    assert job["status"] == "done" and trained()["id"] == job["id"]
    quick.delete("/v1/models/first")
    version(-0.0005).save(home.folder / "first")
    assert trained()["id"] != job["id"]
    assert (home.folder / "first" / "surrogate").is_dir()
    again = trained()["id"]
    other["paths"] = 50  # another one has taken its place meanwhile
    assert trained()["id"] != again


def test_accepted_predictions_are_answered_by_their_version_whatever_becomes_of_it(
    client: TestClient, home: Workspace, tmp_path: Path
) -> None:
    """It is removed before they run, and another one takes its name."""
    own_version(own_folder(tmp_path / "effects")).save(
        home.folder / "own", tmp_path / "effects"
    )
    wanted, jobs = [], []
    for name in ("first", "own"):
        made = home.find(name).version
        assert made is not None
        response = made.forward("draft")(
            [named_device("S1")], [LoadPath(np.array([5e3]))]
        )
        wanted.append((response.output("tip_deflection")[0, 0], made))
        client.put("/v1/models/current", json={"model": name})
        body = FAR | {"source": "fem", "wait_s": 0}
        jobs.append(client.post("/v1/predict", json=body))
    client.put("/v1/models/current", json={"model": "baseline"})
    for name in ("first", "own"):
        assert client.delete(f"/v1/models/{name}").status_code == 200
        version(0.001, seed=9).save(home.folder / name)
    for answer, (tip, made) in zip(jobs, wanted, strict=True):
        job = ended(client, answer)
        assert job["status"] == "done", job["error"]
        found = job["result"]
        assert found["model_version"].endswith(f"+{made.version}")
        assert found["effects"] == list(made.effects)
        assert found["tip_deflection_mm"]["value"][0] == pytest.approx(1e3 * tip)


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
    """Sixteen connections to a real server, while versions come, serve and go."""
    models = tmp_path / "state" / "models"
    models.parent.mkdir()
    home.folder.rename(models)
    store = Workspace(models)
    port = free_port()
    url = f"http://127.0.0.1:{port}"
    passing = {f"passing{i}": version(seed=10 + i) for i in range(2)}
    with server(tmp_path / "state", port):
        known = {name: one.version for name, one in passing.items()}
        known["reference"] = "fake-1"
        for name in ("first", "second"):
            entry = store.find(name)
            assert entry.version is not None
            known[name] = entry.version.version
        stop = threading.Event()
        seen: list[str] = []
        predicted: list[str] = []
        failed: list[str] = []

        def look(one: httpx.Client) -> None:
            answer = one.get("/v1/models")
            if answer.status_code != 200:
                failed.append(answer.text)
                return
            found = answer.json()
            used = [row for row in found["models"] if row["in_use"]]
            # A version in use may be gone by the time that the others are listed.
            gone = not used and found["current"] in passing
            if not gone and [row["name"] for row in used] != [found["current"]]:
                failed.append(answer.text)
            if used and used[0]["version"] != known[found["current"]]:
                failed.append(answer.text)
            seen.append(found["current"])
            checked = one.post("/v1/check", json=ASKED)
            if checked.status_code != 200:
                failed.append(checked.text)

        def predict(one: httpx.Client, thickness: float) -> None:
            design = {"device": "S1", "lower_thickness_um": thickness}
            body = ASKED | {"design": design, "source": "fem"}
            answer = one.post("/v1/predict", json=body)
            if answer.status_code != 200:
                failed.append(answer.text)
                return
            found = answer.json()
            _, _, used = found["model_version"].partition("+")
            effects = ["cure_mismatch"] if used else []
            if found["effects"] != effects or (used and used not in known.values()):
                failed.append(answer.text)
            predicted.append(used)

        def ask(number: int) -> None:
            with httpx.Client(base_url=url, timeout=20) as one:
                thickness = 60.0 + number
                for round_ in count():
                    if stop.is_set():
                        return
                    look(one)
                    if round_ % 4 == number % 4:
                        thickness += 0.001  # not asked before: a job of its own
                        predict(one, thickness)

        askers = [threading.Thread(target=ask, args=(i,)) for i in range(16)]

        def comes(found: list[str], wanted: str) -> None:
            before = len(found)
            until(lambda: wanted in found[before:], 60)

        for one in askers:
            one.start()
        try:
            for name, made in passing.items():
                made.save(models / name)
                store.use(name)
                comes(predicted, made.version)
                for other in ("first", "second"):
                    store.use(other)
                    comes(seen, other)
                store.use("baseline")
                store.remove(name)
                comes(seen, "reference")
        finally:
            stop.set()
            for one in askers:
                one.join()
    assert failed == []
