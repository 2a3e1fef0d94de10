"""The published schema: complete, with units, and with the bounds that are applied."""

from __future__ import annotations

from typing import Any

import pytest
from fastapi.testclient import TestClient

from datagen.device import LIMITS
from datagen.units import BY_FIELD, DESIGN, QUANTITY
from service.bench import PRESSURE_RANGE, bounds
from service.schemas import DESIGN_COLUMNS, PredictOut
from tests.service.test_predict import S1, ask

# With margins that let balloons of any allowed size fit.
ROOM = S1 | {"length_mm": 60, "width_mm": 30}


@pytest.fixture(scope="module")
def schema(client: TestClient) -> dict[str, Any]:
    return client.get("/openapi.json").json()


def part(schema: dict[str, Any], name: str) -> dict[str, Any]:
    return schema["components"]["schemas"][name]


def test_every_column_with_its_unit_and_bounds(schema: dict[str, Any]) -> None:
    properties = part(schema, "DesignIn")["properties"]
    assert set(properties) == {"device", "case", *DESIGN}
    assert tuple(DESIGN) == DESIGN_COLUMNS
    for name, column in DESIGN.items():
        entry, parameter = properties[name], LIMITS[column.field]
        assert entry["unit"] == (column.unit or "1")
        assert entry["minimum"] * column.factor == pytest.approx(parameter.lower)
        assert entry["maximum"] * column.factor == pytest.approx(parameter.upper)
        whole = parameter.scale == "integer"
        assert entry["type"] == ("integer" if whole else "number")
        assert "default" not in entry


def test_quantities_and_pressures_have_units(schema: dict[str, Any]) -> None:
    out = part(schema, "PredictOut")
    for name, column in QUANTITY.items():
        assert out["properties"][name]["unit"] == column.unit
        assert name in out["required"]
    kpa = part(schema, "PredictIn")["properties"]["pressure_kPa"]
    assert kpa["unit"] == "kPa"
    assert (kpa["minItems"], kpa["maxItems"]) == (1, 1000)
    items = kpa["items"]
    assert (items["minimum"], items["maximum"]) == PRESSURE_RANGE


def test_every_endpoint_is_described(schema: dict[str, Any]) -> None:
    assert {
        "/v1/predict",
        "/v1/check",
        "/v1/models",
        "/v1/devices",
        "/v1/effects",
        "/v1/datasets",
        "/v1/jobs",
        "/v1/jobs/{job_id}",
        "/healthz",
    } <= set(schema["paths"])
    for methods in schema["paths"].values():
        for operation in methods.values():
            assert operation["description"]
            error = operation["responses"]["422"]["content"]["application/json"]
            assert error["schema"]["$ref"].endswith("/ErrorOut")
    assert "202" in schema["paths"]["/v1/predict"]["post"]["responses"]
    assert "HTTPValidationError" not in schema["components"]["schemas"]


@pytest.mark.parametrize("name", DESIGN)
def test_the_bounds_are_those_that_are_applied(client: TestClient, name: str) -> None:
    lower, upper = bounds(BY_FIELD[DESIGN[name].field])
    step = 1 if LIMITS[DESIGN[name].field].scale == "integer" else 1e-6 * upper
    for value in (lower, upper, lower - step, upper + step):
        body = {"design": ROOM | {name: value}, "pressure_kPa": [1]}
        response = client.post("/v1/check", json=body)
        error = response.json().get("error")
        if not lower <= value <= upper:
            assert error["field"] == name
            assert "number from" in error["allowed"]
        elif error:  # within the bounds, but shorter than what is in it
            assert (name, value) in (("length_mm", lower), ("width_mm", lower))
            assert error["allowed"].startswith("at least")


def test_answers_follow_the_schema(client: TestClient) -> None:
    for design, kpa in ((S1, [0, 10]), (S1 | {"upper_thickness_um": 400}, [10, 500])):
        body = ask(client, design, kpa).json()
        assert PredictOut.model_validate(body, strict=True).model_dump() == body
        assert set(body) == set(PredictOut.model_fields)


def test_where_to_look_next_is_part_of_the_answer(schema: dict[str, Any]) -> None:
    """202: the job, and when; 201: what was kept."""
    told = {
        path: answers[status]["headers"]
        for path, methods in schema["paths"].items()
        for answers in [methods.get("post", {}).get("responses", {})]
        for status in ("201", "202")
        if status in answers
    }
    assert told.pop("/v1/measurements").keys() == {"Location"}
    assert "/v1/datasets" in told and "/v1/predict" in told
    assert all(found.keys() == {"Location", "Retry-After"} for found in told.values())
