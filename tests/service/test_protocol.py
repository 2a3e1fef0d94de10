"""HTTP's own rules, and what other sites and odd clients may not do."""

from __future__ import annotations

from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from tests.service.test_errors import S1_TEXT, the_error
from tests.service.test_predict import S1

BENCH = Path("examples/measurements/bench.csv")
JSON = {"Content-Type": "application/json"}


@pytest.mark.parametrize("path", ["/", "/healthz", "/v1/devices", "/v1/jobs"])
def test_head_is_get_without_the_body(client: TestClient, path: str) -> None:
    head, whole = client.head(path), client.get(path)
    assert head.status_code == whole.status_code == 200
    assert head.content == b""
    for name in ("content-type", "content-length"):
        assert head.headers[name] == whole.headers[name]


@pytest.mark.parametrize(
    ("path", "methods"),
    [
        ("/v1/jobs/x", "DELETE, GET, HEAD"),
        ("/v1/measurements", "GET, HEAD, POST"),
        ("/v1/predict", "POST"),
    ],
)
def test_what_a_path_allows(client: TestClient, path: str, methods: str) -> None:
    response = client.put(path)
    the_error(response, 405)
    assert response.headers["Allow"] == methods


@pytest.mark.parametrize("path", ["/", "/static/plotly.min.js", "/static/style.css"])
def test_what_a_browser_has_is_not_sent_again(client: TestClient, path: str) -> None:
    first = client.get(path)
    assert first.status_code == 200, path
    again = client.get(path, headers={"If-None-Match": first.headers["ETag"]})
    assert again.status_code == 304
    assert again.content == b""


@pytest.mark.parametrize(
    "kind", ["application/x-www-form-urlencoded", "text/plain", None]
)
def test_json_sent_as_something_else(client: TestClient, kind: str | None) -> None:
    headers = {"Content-Type": kind} if kind else {}
    response = client.post("/v1/predict", content=S1_TEXT, headers=headers)
    assert "Content-Type: application/json" in the_error(response, 415)["message"]


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Origin": "http://elsewhere.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Sec-Fetch-Site": "cross-site", "Origin": "http://testserver"}, 403),
        ({"Sec-Fetch-Site": "same-site"}, 403),
        ({"Origin": "http://testserver"}, 200),
        ({"Sec-Fetch-Site": "same-origin", "Origin": "https://lab.example"}, 200),
        ({"Origin": "https://lab.example", "X-Forwarded-Host": "lab.example"}, 200),
        ({}, 200),
    ],
)
def test_pages_of_other_sites_change_nothing(
    client: TestClient, headers: dict[str, str], status: int
) -> None:
    body = {"design": S1, "pressure_kPa": [1]}
    response = client.post("/v1/check", json=body, headers=headers)
    assert response.status_code == status
    if status == 403:
        assert the_error(response, 403)["type"] == "origin"
    assert client.get("/v1/devices", headers=headers).status_code == 200


@pytest.mark.parametrize("path", ["/v1/check", "/v1/predict"])
@pytest.mark.parametrize(
    "text",
    [
        '{"\\ud800": 1}',
        '{"design": {"\\ud800": 1}, "pressure_kPa": [1]}',
        '{"design": {"device": "\\ud800"}, "pressure_kPa": [1]}',
        '{"design": "\\ud800", "pressure_kPa": [1]}',
    ],
)
def test_half_a_character_is_bad_input(
    client: TestClient, path: str, text: str
) -> None:
    the_error(client.post(path, content=text, headers=JSON), 422)


def test_errors_are_short_whatever_was_sent(client: TestClient) -> None:
    long = "x" * 200_000
    response = client.post("/v1/predict", json={long: 1})
    the_error(response, 422)
    assert len(response.content) < 5000
    assert len(client.get(f"/v1/jobs/{long[:50_000]}").content) < 5000


@pytest.mark.parametrize("name", ["problem.yaml", "problem.YML"])
def test_a_sent_file_cannot_name_others(
    client: TestClient, name: str, tmp_path: Path
) -> None:
    """A PEtab problem names its tables, anywhere on the server."""
    secret = tmp_path / "secret.txt"
    secret.write_text("password=hunter2\nmore\n")
    kinds = ("measurement", "condition", "observable")
    text = "\n".join(f"{kind}_files: [{secret}]" for kind in kinds)
    response = client.post(f"/v1/measurements?name={name}", content=text)
    assert the_error(response, 422)["field"] == "name"
    assert "hunter2" not in response.text


def test_a_form_by_any_case(client: TestClient) -> None:
    sent = client.build_request(
        "POST", "/v1/measurements", files={"file": ("bench.csv", BENCH.read_bytes())}
    )
    kind = sent.headers["Content-Type"]
    sent.headers["Content-Type"] = kind.replace("multipart/form", "Multipart/Form")
    response = client.send(sent)
    assert response.status_code == 201, response.text


def test_measurements_are_adopted_once(client: TestClient) -> None:
    identity = client.post("/v1/measurements", content=BENCH.read_bytes()).json()["id"]
    body = {
        "measurements": [identity, identity],
        "effects": ["self_weight"],
        "model": "twice",
    }
    error = the_error(client.post("/v1/adoptions", json=body), 422)
    assert error["field"] == "measurements"
