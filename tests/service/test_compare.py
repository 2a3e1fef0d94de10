"""``pba compare``: JSON, words, exit statuses, Ctrl-C."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from discrepancy import study
from discrepancy.compare import Failure
from discrepancy.missing import Kind
from discrepancy.regions import CONSTANT, FADING, GROWING, Region
from discrepancy.writing import write_measurements
from service.cli import main
from service.comparison import failure_json, failure_text
from tests.discrepancy.made import MISMATCH, measured


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("compare")
    write_measurements(measured(MISMATCH)[0], folder / "effect.csv")
    return folder


@pytest.fixture
def pba(folder: Path, capsys: pytest.CaptureFixture[str]) -> Any:
    def run(*words: str) -> tuple[int, str, str]:
        file = str(folder / "effect.csv")
        cache = ["--cache", str(folder / "kept"), "--level", "draft", "--workers", "1"]
        status = main(["compare", file, *cache, *words])
        shown = capsys.readouterr()
        return status, shown.out, shown.err

    return run


def test_json(pba: Any) -> None:
    status, out, err = pba("--json")
    assert status == 0 and err == ""
    found = json.loads(out)
    assert out.count("\n") == 1
    assert found["missing"] and found["p_value"] < found["claim_below"]
    first = found["fails_where"][0]
    assert first["quantity"] == "tip_deflection_mm" and first["measured"] == "above"
    assert first["pressure_kPa"][1] == 50 and first["design"] is None
    assert first["text"] in found["text"]
    assert found["noise"]["inflation_mm"] == {
        "std": 0.002,
        "unit": "mm",
        "source": "stated",
    }
    tip = found["quantities"]["tip_deflection_mm"]
    assert tip["rmse"] > 0.02 and tip["residual"] > 3
    curve = found["curves"][1]
    assert curve["device"] == "S1" and curve["pressure_kPa"] == [10, 20, 35, 50]
    tip = curve["quantities"]["tip_deflection_mm"]
    lack = np.subtract(tip["measured"], tip["calibrated"]) / tip["noise"]
    assert np.allclose(lack, tip["residual"], rtol=1e-3)
    modulus = next(c for c in found["calibrations"] if c["kind"] == "modulus")
    assert modulus["tolerance"] == 5 and modulus["stated_MPa"] == 2.5


def test_words(pba: Any) -> None:
    status, out, err = pba()
    assert status == 0 and err == ""
    assert "Something is missing in the model (p " in out
    assert "Tip deflection of all 3 devices" in out
    assert "modulus of the 2.5 MPa batch" in out
    table = out.partition("\n\n")[0].splitlines()
    assert len(table) == 2 + 3 and max(len(line) for line in table) <= 80


def test_tolerances_reach_the_comparison(pba: Any) -> None:
    wanted = ("--modulus-tolerance", "0", "--thickness-tolerance-um", "1.5")
    status, out, _ = pba("--json", *wanted, "--camera-tolerance", "1")
    assert status == 0
    found = {one["kind"]: one for one in json.loads(out)["calibrations"]}
    assert found["modulus"]["change"] == 0 and found["modulus"]["tolerance"] == 0
    assert found["thickness"]["tolerance"] == 1.5 and found["thickness"]["unit"] == "um"
    assert found["scale"]["tolerance"] == 1


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--modulus-tolerance", "51"), "--modulus-tolerance: '51' % is not allowed"),
        (("--camera-tolerance", "x"), "a number from 0 to 20 %"),
        (("--level", "rough"), "draft"),
        (("--workers", "0"), "a whole number from 1"),
    ],
)
def test_bad_input_is_one_line(pba: Any, words: tuple[str, ...], says: str) -> None:
    status, out, err = pba("--json", *words)
    assert status == 2 and out == "" and err.count("\n") == 1 and says in err


def test_a_bad_file_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bad.csv"
    path.write_text("device,pressure_kPa\nS1,5\n")
    assert main(["compare", str(path), "--json"]) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.count("\n") == 1


def test_interrupted(pba: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(study, "Study", stop)
    status, out, err = pba("--json")
    assert status == 130 and out == "" and err.count("\n") == 1
    assert "kept" in err and "same command" in err


def failure(
    growth: str, whole: bool, trait: str, share: float, of_model: bool
) -> Failure:
    kind = Kind("actuator", "inflation", 0.0, "loading")
    region = Region(
        kind=kind,
        growth=growth,
        low=35e3,
        high=50e3,
        whole=whole,
        trait=trait,
        above=False,
        threshold=81.3e-6,
        alike=("length",) if trait else (),
        at=np.arange(6),
        devices=2,
        size=share,
        error=0.02,
        lack=np.zeros(9),
        p=0.001,
    )
    return Failure(region, ("a", "b"), 80e-6, share, 0.02, of_model, -8.3)


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (
            (GROWING, False, "upper_thickness", -0.124, True),
            "Inflation of devices with an upper layer under 80 um, above 35 kPa: "
            "measured 12 % below the model at 50 kPa, on average 8.3 times the noise.",
        ),
        (
            (FADING, False, "", 0.055, False),
            "Inflation of all 2 devices, below 50 kPa: measured 5.5 % of the largest "
            "reading above the model at 35 kPa, on average 8.3 times the noise.",
        ),
        (
            (CONSTANT, True, "", 0.055, True),
            "Inflation of all 2 devices, from 35 to 50 kPa: measured 5.5 % above the "
            "model, on average 8.3 times the noise.",
        ),
    ],
)
def test_a_failure_in_words(made: tuple[Any, ...], says: str, folder: Path) -> None:
    from types import SimpleNamespace

    comparison: Any = SimpleNamespace(measurements=measured_nothing())
    assert failure_text(failure(*made), comparison) == says
    data = failure_json(failure(*made), comparison)
    assert data["pressure_kPa"] == [35, 50]
    if made[2]:
        assert data["design"] == {
            "variable": "upper_thickness_um",
            "min": None,
            "max": 80,
            "same_devices_by": ["length_mm"],
        }


def measured_nothing() -> Any:
    from types import SimpleNamespace

    return SimpleNamespace(curves=())
