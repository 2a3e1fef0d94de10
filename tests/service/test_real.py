"""The chain on its real parts: finite elements, a dataset, the shipped model."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from datagen.dataset import Dataset
from datagen.device import named_device
from datagen.model import Model
from datagen.response import OUTPUT_NAMES
from datagen.response import Path as LoadPath
from datagen.units import BY_FIELD
from service.app import Settings, create_app
from service.cli import main
from tests.service.fakes import FakeSurrogate
from tests.service.test_jobs import until

KPA = [5.0, 20.0]
OUTSIDE = {"device": "S1", "case": 1, "upper_thickness_um": 400}


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    app = create_app(
        Settings(tmp_path_factory.mktemp("state"), wait=120),
        lambda _folder: FakeSurrogate(),
    )
    with TestClient(app) as client:
        yield client


def bench(values: np.ndarray) -> dict[str, np.ndarray]:
    """(s, m) SI values by bench name, in bench units."""
    columns = (BY_FIELD[name] for name in OUTPUT_NAMES)
    return {c.name: values[:, i] / c.factor for i, c in enumerate(columns)}


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert main([*arguments, "--json"]) == 0
    data: dict[str, Any] = json.loads(capsys.readouterr().out)
    return data


@pytest.fixture(scope="module")
def solved() -> dict[str, np.ndarray]:
    design = named_device("S1", 1).with_values(upper_thickness=400e-6)
    path = LoadPath(np.array(KPA) * 1e3)
    return bench(Model(level="draft")([design], [path]).values[0])


def test_solve_gives_the_numbers_of_the_library(
    capsys: pytest.CaptureFixture[str], solved: dict[str, np.ndarray]
) -> None:
    data = run(
        capsys, "solve", "--set", "upper_thickness_um=400", "--pressures", "5,20",
        "--level", "draft",
    )  # fmt: skip
    assert data["status"] == "completed"
    assert data["unknowns"] > 1000
    for name, values in solved.items():
        np.testing.assert_allclose(data[name], values, rtol=1e-9)


def test_http_gives_the_numbers_of_the_library(
    client: TestClient, solved: dict[str, np.ndarray]
) -> None:
    body = {"design": OUTSIDE, "pressure_kPa": KPA, "level": "draft"}
    answer = client.post("/v1/predict", json=body).json()
    assert answer["source"] == "fem"
    assert answer["model_version"].startswith("fem-")
    for name, values in solved.items():
        np.testing.assert_allclose(answer[name]["value"], values, rtol=1e-9)


def test_an_effect_changes_the_answer(capsys: pytest.CaptureFixture[str]) -> None:
    common = ("solve", "--level", "draft", "--pressures", "0")
    still = run(capsys, *common)
    heavy = run(capsys, *common, "--effect", "self_weight:density=1000")
    assert abs(still["tip_deflection_mm"][0]) < 1e-6
    assert -0.2 < heavy["tip_deflection_mm"][0] < -0.03
    assert heavy["effects"] == {"self_weight": {"density": 1000.0}}


def test_effects_are_listed_and_shown(
    client: TestClient, capsys: pytest.CaptureFixture[str]
) -> None:
    listed = run(capsys, "effects", "list")["effects"]
    assert {"self_weight", "cure_mismatch"} <= {row["name"] for row in listed}
    assert listed == client.get("/v1/effects").json()["effects"]
    shown = run(capsys, "effects", "show", "self_weight")
    assert shown in listed
    assert all(p["unit"] and p["source"] for p in shown["parameters"])
    assert main(["effects", "show", "nothing"]) == 2
    assert "self_weight" in capsys.readouterr().err
    assert main(["effects", "show", "self_weight"]) == 0
    assert "density: 0 to" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        ("nothing", "self_weight"),
        ("self_weight:weight=1", "density"),
        ("self_weight:density=1e9", "a number from 0 to 1100 kg/m3"),
    ],
)
def test_bad_effects_are_one_line(
    capsys: pytest.CaptureFixture[str], effect: str, words: str
) -> None:
    assert main(["solve", "--effect", effect]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert words in err


def test_a_dataset_job_makes_a_dataset(client: TestClient, tmp_path: Path) -> None:
    body = {"designs": 1, "seed": 4, "level": "draft"}
    response = client.post("/v1/datasets", json=body)
    assert response.status_code == 202
    where = response.headers["location"]

    def look() -> Any:
        job = client.get(where).json()
        assert job["status"] in ("queued", "running", "done"), job
        return job["result"]

    result = until(look, 120)
    file = tmp_path / "paths.h5"
    file.write_bytes(client.get(f"{where}/file").content)
    data = Dataset.read(file)
    assert (len(data), data.seed, data.level) == (1, 4, "draft")
    assert data.digest() == result["digest"]


def test_an_unknown_effect_starts_no_dataset(client: TestClient) -> None:
    body = {"designs": 1, "seed": 4, "effects": ["nothing"]}
    error = client.post("/v1/datasets", json=body).json()["error"]
    assert error["field"] == "effects"
    assert "self_weight" in error["allowed"]
