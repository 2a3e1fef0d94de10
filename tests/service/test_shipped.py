"""The shipped reference model: library, command line and service give its numbers.

A module of its own, as a process holds one job store at a time.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from typing import Any

import httpx
import numpy as np
import pytest
from fastapi.testclient import TestClient

from datagen.device import named_device
from service.answer import load_model, surrogate_answer
from service.app import Settings, create_app
from service.cli import main
from surrogate.ensemble import REFERENCE

shipped = pytest.mark.skipif(
    not (REFERENCE / "model.json").exists() and os.environ.get("CI") != "true",
    reason=f"no reference model in {REFERENCE.name}; `make reference` builds it",
)


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    app = create_app(Settings(tmp_path_factory.mktemp("state")))
    with TestClient(app) as client:
        yield client


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert main([*arguments, "--json"]) == 0
    data: dict[str, Any] = json.loads(capsys.readouterr().out)
    return data


@shipped
@pytest.mark.parametrize("case", [1, 2, 3, 4])
def test_library_command_and_service_agree(
    client: TestClient, capsys: pytest.CaptureFixture[str], case: int
) -> None:
    kpa = [0.0, 10.0, 20.0, 60.0]
    model, design = load_model(None), named_device("S1", case)
    pressure = np.array(kpa) * 1e3
    library = surrogate_answer(model, design, pressure, model.check(design, pressure))
    assert library.in_range, library.reasons
    text = ",".join(map(str, kpa))
    command = run(capsys, "predict", "--case", str(case), "--pressures", text)
    columns = library.to_columns() | {"parameters": {}}  # of effects: none
    assert command == json.loads(json.dumps(columns))
    body = {"design": {"device": "S1", "case": case}, "pressure_kPa": kpa}
    answer: httpx.Response = client.post("/v1/predict", json=body)
    assert answer.json() == library.to_dict()
    assert answer.json()["tip_deflection_mm"]["value"][2] > 0  # all cases, at 20 kPa


@shipped
def test_the_shipped_model_says_what_it_is(client: TestClient) -> None:
    (model,) = client.get("/v1/models").json()["models"]
    assert model["name"] == "reference"
    assert model["version"] == load_model(None).version
    assert model["description"]["n_train"] >= 200
