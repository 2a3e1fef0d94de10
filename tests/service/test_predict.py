"""Predictions over HTTP: whose numbers, in which units, and who answers."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from datagen.device import named_device
from datagen.response import OUTPUT_NAMES
from datagen.units import BY_FIELD
from service.answer import surrogate_answer
from tests.service.fakes import BAND, MESH_ERROR, FakeSurrogate, closed_form

KPA = [0, 10, 20.5]
S1 = {
    "length_mm": 6.5,
    "width_mm": 2,
    "balloon_length_mm": 4,
    "balloon_width_mm": 1,
    "balloon_start_mm": 1.25,
    "cavity_height_um": 75,
    "upper_thickness_um": 95,
    "lower_thickness_um": 140,
    "upper_modulus_MPa": 2.5,
    "lower_modulus_MPa": 4.5,
}


def ask(client: TestClient, design: dict[str, Any], kpa: Any = KPA, **more: Any) -> Any:
    body = {"design": design, "pressure_kPa": kpa} | more
    return client.post("/v1/predict", json=body)


def test_numbers_are_those_of_the_library(client: TestClient) -> None:
    answer = ask(client, {"device": "S1", "case": 2}).json()
    design, pressure = named_device("S1", 2), np.array(KPA) * 1e3
    model = FakeSurrogate()
    check = model.check(design, pressure)
    assert answer == surrogate_answer(model, design, pressure, check).to_dict()


def test_bench_units_and_interval(client: TestClient) -> None:
    answer = ask(client, S1).json()
    expected = closed_form(named_device("S1", 1), np.array(KPA) * 1e3)
    assert answer["pressure_kPa"] == KPA
    for i, name in enumerate(OUTPUT_NAMES):
        column = BY_FIELD[name]
        got = answer[column.name]
        np.testing.assert_allclose(
            np.array(got["value"]) * column.factor, expected[:, i], rtol=1e-12
        )
        np.testing.assert_allclose(
            (np.array(got["high"]) - got["low"]) * column.factor / 2, BAND, rtol=1e-9
        )
    assert answer["source"] == "surrogate"
    assert (answer["in_range"], answer["reasons"]) == (True, [])
    assert answer["model_version"] == "fake-1"


def test_named_device_and_its_columns_are_the_same_design(client: TestClient) -> None:
    named = ask(client, {"device": "S1", "case": 1}).json()
    assert named["design"] == S1 | {"wall_mm": 0.2, "divisions_x": 1, "divisions_y": 1}
    assert named["design"] == ask(client, S1).json()["design"]


def test_columns_replace_those_of_the_named_device(client: TestClient) -> None:
    design = {"device": "D8-4x1", "case": 3, "upper_thickness_um": 80}
    answer = ask(client, design).json()
    assert answer["design"]["upper_thickness_um"] == 80
    assert answer["design"]["lower_modulus_MPa"] == 4.5
    assert answer["design"]["divisions_x"] == 4


def test_whole_numbers_may_be_written_as_floats(client: TestClient) -> None:
    answer = ask(client, S1 | {"divisions_x": 2.0}).json()
    assert answer["design"]["divisions_x"] == 2


def test_twice_the_range_is_answered_by_finite_elements(client: TestClient) -> None:
    answer = ask(client, S1 | {"upper_thickness_um": 400}).json()
    assert answer["source"] == "fem"
    assert answer["in_range"] is False
    assert answer["reasons"] == ["upper_thickness is outside the trained range"]
    assert answer["model_version"] == "fem-fake"
    assert answer["unknowns"] == 4321
    tip = answer["tip_deflection_mm"]
    half = answer["mesh_error"]["tip_deflection_mm"]
    assert half == pytest.approx([MESH_ERROR * abs(v) for v in tip["value"]])
    for value, low, high, error in zip(
        tip["value"], tip["low"], tip["high"], half, strict=True
    ):
        assert (low, high) == pytest.approx((value - error, value + error))


def test_past_the_trained_pressure_and_past_the_limit_point(client: TestClient) -> None:
    answer = ask(client, S1, [100, 300, 500]).json()
    assert answer["source"] == "fem"
    assert answer["status"] == "limit_point"
    assert answer["message"] == "the path turns at 400 kPa"
    assert answer["limit_pressure_kPa"] == 400
    inflation = answer["inflation_mm"]
    for key in ("value", "low", "high"):
        assert inflation[key][2] is None
        assert inflation[key][1] > inflation[key][0] > 0


def test_finite_elements_on_request(client: TestClient) -> None:
    answer = ask(client, S1, source="fem").json()
    assert (answer["source"], answer["in_range"]) == ("fem", True)


def test_long_work_becomes_a_job_with_the_same_answer(client: TestClient) -> None:
    slow = S1 | {"lower_thickness_um": 1500}  # takes 1.5 s, see the fake
    started = time.monotonic()
    response = ask(client, slow, wait_s=0.1)
    assert time.monotonic() - started < 1
    assert response.status_code == 202
    job = response.json()
    assert response.headers["location"] == f"/v1/jobs/{job['id']}"
    assert job["status"] in ("queued", "running")
    assert job["result"] is None
    again = ask(client, slow, wait_s=30)
    assert again.status_code == 200
    done = client.get(response.headers["location"]).json()
    assert done["status"] == "done"
    assert done["result"] == again.json()


def test_an_answer_is_not_computed_twice(client: TestClient) -> None:
    design = S1 | {"lower_thickness_um": 700}
    first = ask(client, design).json()
    started = time.monotonic()
    assert ask(client, design).json() == first
    assert time.monotonic() - started < 0.5
    other = ask(client, design | {"device": "S1"}, level="draft")
    assert other.status_code == 200
    ids = [job["id"] for job in client.get("/v1/jobs").json()]
    assert len(ids) == len(set(ids))


def test_the_server_answers_while_finite_elements_work(client: TestClient) -> None:
    slow = ask(client, S1 | {"lower_thickness_um": 1900}, wait_s=0)
    assert slow.status_code == 202
    started = time.monotonic()
    for _ in range(20):
        assert ask(client, S1).json()["source"] == "surrogate"
    assert time.monotonic() - started < 1
    assert client.delete(slow.headers["location"]).json()["status"] == "cancelled"


@pytest.mark.parametrize("quantity", ["tip_deflection_mm", "cavity_volume_uL"])
def test_check_says_what_a_request_means(client: TestClient, quantity: str) -> None:
    body = {"design": {"device": "S1"}, "pressure_kPa": [0, 200]}
    found = client.post("/v1/check", json=body).json()
    assert found["tip_margin_mm"] == 1.25
    assert found["rim_mm"] == 0.5
    assert found["thickness_um"] == 310
    assert found["in_range"] is False
    assert "150 kPa" in found["reasons"][0]
    assert quantity not in found


def test_models_devices_and_health(client: TestClient) -> None:
    (model,) = client.get("/v1/models").json()["models"]
    assert model["version"] == "fake-1"
    assert model["description"] == {"n_train": 3, "worst": None}
    assert client.get("/healthz").json()["status"] == "ok"
    devices = client.get("/v1/devices").json()
    for row in devices["devices"]:
        for case in row["cases"]:
            design = named_device(row["name"], case["case"])
            thickness = case["design"]["upper_thickness_um"]
            assert thickness == pytest.approx(design.upper_thickness / 1e-6)
