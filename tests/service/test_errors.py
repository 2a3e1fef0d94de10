"""Bad requests: one shape, one clear message, never a traceback."""

from __future__ import annotations

import json
import logging
from typing import Any

import pytest
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service import routes
from tests.service.test_predict import S1, ask


def the_error(response: Any, status: int) -> dict[str, str]:
    assert response.status_code == status, response.text
    body = response.json()
    assert set(body) == {"error"}
    error = body["error"]
    assert {"type", "message"} <= set(error) <= {"type", "message", "field", "allowed"}
    assert "Traceback" not in error["message"]
    assert "\n" not in error["message"]
    assert all(isinstance(text, str) for text in error.values())
    return error


S1_TEXT = json.dumps({"design": {"device": "S1"}, "pressure_kPa": [10]})

BAD_DESIGNS = [
    ({"upper_thickness_um": -5}, "upper_thickness_um", "-5 um", "from 10 to 2000 um"),
    ({"upper_thickness_um": 1e9}, "upper_thickness_um", "1e+09 um", "2000 um"),
    ({"upper_thickness_um": "95"}, "upper_thickness_um", "'95' um", "a number"),
    ({"upper_thickness_um": True}, "upper_thickness_um", "True", "a number"),
    ({"upper_thickness_um": None}, "upper_thickness_um", "None", "a number"),
    ({"lower_modulus_MPa": 0}, "lower_modulus_MPa", "0 MPa", "from 0.01 to 100 MPa"),
    ({"divisions_x": 2.5}, "divisions_x", "2.5", "a whole number from 1 to 12"),
    ({"divisions_x": 0}, "divisions_x", "0", "a whole number from 1 to 12"),
    ({"thickness": 5}, "design", "'thickness'", "upper_thickness_um"),
    ({"balloon_length_mm": 9}, "length_mm", "6.5 mm", "at least 10.27 mm"),
    ({"balloon_width_mm": 3}, "width_mm", "2 mm", "at least 3.04 mm"),
]


@pytest.mark.parametrize("path", ["/v1/predict", "/v1/check"])
@pytest.mark.parametrize(("change", "field", "value", "allowed"), BAD_DESIGNS)
def test_bad_design(
    client: TestClient, path: str, change: Any, field: str, value: str, allowed: str
) -> None:
    body = {"design": S1 | change, "pressure_kPa": [10]}
    error = the_error(client.post(path, json=body), 422)
    assert error["type"] == "input"
    assert error["field"] == field
    assert allowed in error["allowed"]
    for part in (field, value, error["allowed"]):
        assert part in error["message"]


def test_an_unknown_name_at_the_top(client: TestClient) -> None:
    body = {"device": "S1", "pressure_kPa": [10]}
    error = the_error(client.post("/v1/predict", json=body), 422)
    assert error["field"] == "body"
    assert "'device' is not allowed" in error["message"]
    assert "design, pressure_kPa" in error["allowed"]


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_numbers_that_json_does_not_have(client: TestClient, number: str) -> None:
    headers = {"Content-Type": "application/json"}
    text = S1_TEXT.replace('"S1"', f'"S1", "wall_mm": {number}')
    response = client.post("/v1/predict", content=text, headers=headers)
    assert the_error(response, 422)["field"] == "wall_mm"
    text = S1_TEXT.replace("[10]", f"[0, {number}]")
    response = client.post("/v1/predict", content=text, headers=headers)
    assert the_error(response, 422)["field"] == "pressure_kPa[1]"


@pytest.mark.parametrize(
    ("design", "field"),
    [
        ({}, "length_mm"),
        (
            {k: v for k, v in S1.items() if k != "lower_modulus_MPa"},
            "lower_modulus_MPa",
        ),
        ({"device": "S2"}, "device"),
        ({"device": "D8-0x1"}, "device"),
        ({"device": "D8-13x1"}, "divisions_x"),
        ({"device": "S1", "case": 5}, "case"),
        ({"device": "S1", "case": "1"}, "case"),
        ([], "design"),
        (3, "design"),
    ],
)
def test_bad_device(client: TestClient, design: Any, field: str) -> None:
    error = the_error(ask(client, design), 422)
    assert error["field"] == field
    assert error["allowed"]


@pytest.mark.parametrize(
    ("kpa", "field"),
    [
        ([], "pressure_kPa"),
        ([1] * 1001, "pressure_kPa"),
        (10, "pressure_kPa"),
        ([0, "10"], "pressure_kPa[1]"),
        ([0, 10, -101], "pressure_kPa[2]"),
        ([0, 10_001], "pressure_kPa[1]"),
        ([0, None], "pressure_kPa[1]"),
    ],
)
def test_bad_pressure(client: TestClient, kpa: Any, field: str) -> None:
    assert the_error(ask(client, S1, kpa), 422)["field"] == field


def test_a_thousand_load_steps_are_answered(client: TestClient) -> None:
    answer = ask(client, S1, [0.15 * i for i in range(1000)])
    assert len(answer.json()["inflation_mm"]["value"]) == 1000


@pytest.mark.parametrize(
    ("more", "field"),
    [
        ({"wait_s": -1}, "wait_s"),
        ({"wait_s": "soon"}, "wait_s"),
        ({"wait_s": 1e9}, "wait_s"),
        ({"source": "guess"}, "source"),
        ({"level": "finest"}, "level"),
        ({"coverage": 0.5}, "body"),
    ],
)
def test_bad_options(client: TestClient, more: Any, field: str) -> None:
    error = the_error(ask(client, S1, **more), 422)
    assert error["field"] == field
    assert error["allowed"]
    if "wait_s" in more:
        assert " s is not allowed" in error["message"]


@pytest.mark.parametrize("missing", ["design", "pressure_kPa"])
def test_missing_parts(client: TestClient, missing: str) -> None:
    body: dict[str, Any] = {"design": S1, "pressure_kPa": [1]}
    del body[missing]
    error = the_error(client.post("/v1/predict", json=body), 422)
    assert error["field"] == missing
    assert "(missing)" in error["message"]


@pytest.mark.parametrize("text", ["", "{", '{"design": nan}', "\xff\xfe", "[" * 99_999])
def test_malformed_json(client: TestClient, text: str) -> None:
    headers = {"Content-Type": "application/json"}
    response = client.post(
        "/v1/predict", content=text.encode("latin1"), headers=headers
    )
    assert response.status_code in (400, 422)
    the_error(response, response.status_code)


def test_a_body_without_end(client: TestClient) -> None:
    headers = {"Content-Type": "application/json"}
    chunks = (b"[" + b" " * 2**20 for _ in range(9))
    response = client.post("/v1/predict", content=chunks, headers=headers)
    assert the_error(response, 413)["type"] == "too_large"


def test_unknown_routes_and_methods(client: TestClient) -> None:
    assert the_error(client.get("/v2/predict"), 404)["type"] == "not_found"
    assert the_error(client.get("/static/nothing.js"), 404)["type"] == "not_found"
    assert the_error(client.get("/v1/predict"), 405)["type"] == "method"
    assert the_error(client.get("/v1/jobs/none"), 404)["type"] == "not_found"
    assert the_error(client.delete("/v1/jobs/none"), 404)["type"] == "not_found"
    assert the_error(client.get("/v1/jobs/none/file"), 404)["type"] == "not_found"
    assert the_error(client.get("/v1/jobs?limit=x"), 422)["field"] == "limit"


def test_files_outside_the_page_are_not_served(client: TestClient) -> None:
    for path in ("/static/../app.py", "/static/%2e%2e/app.py"):
        assert client.get(path).status_code == 404


def test_a_request_that_only_the_worker_can_refuse(client: TestClient) -> None:
    error = the_error(ask(client, S1 | {"cavity_height_um": 13}), 422)
    assert error["field"] == "cavity_height_um"


@pytest.mark.parametrize(("height", "code"), [(14, 1), (15, 9)])
def test_a_worker_that_dies(client: TestClient, height: int, code: int) -> None:
    design = S1 | {"cavity_height_um": height}
    error = the_error(ask(client, design), 500)
    assert error["type"] == "worker"
    assert f"code {code}" in error["message"]
    # A failure is not kept as the answer, and the next request has a worker again.
    assert the_error(ask(client, design), 500)["type"] == "worker"
    assert ask(client, S1, source="fem").status_code == 200


def test_an_unforeseen_error_shows_nothing_of_the_inside(
    client: TestClient,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("secret detail")

    monkeypatch.setattr(routes, "surrogate_answer", broken)
    with caplog.at_level(logging.CRITICAL):
        error = the_error(ask(client, S1), 500)
    assert error["type"] == "internal"
    assert "secret" not in error["message"]


json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=20)
    | st.sampled_from(["S1", "D8-2x1", 1, 95.0]),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(
                ["design", "pressure_kPa", "device", "case", "wall_mm", "x"]
            ),
            inner,
            max_size=4,
        )
    ),
    max_leaves=12,
)


@settings(
    max_examples=150,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(body=json_values)
def test_no_json_breaks_the_server(client: TestClient, body: Any) -> None:
    text = json.dumps(body).encode()
    headers = {"Content-Type": "application/json"}
    response = client.post("/v1/check", content=text, headers=headers)
    if response.status_code != 200:
        the_error(response, 422)
