"""The command line: one JSON object, exit statuses, one line for what is wrong."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import pytest

from datagen.device import named_device
from datagen.errors import GenerationError, InputError, Interrupted
from datagen.response import OUTPUT_NAMES, Response
from datagen.response import Path as LoadPath
from datagen.units import BY_FIELD, QUANTITY
from service import answer, terminal
from service.cli import main
from tests.service.fakes import (
    BAND,
    MESH_ERROR,
    FakeFem,
    FakeSurrogate,
    closed_form,
)


@dataclass(frozen=True)
class FakeModel:
    """The interface of `datagen.model.Model` on the fake finite elements."""

    effects: tuple[str, ...] = ()
    level: str = "standard"
    parameters: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    effects_dir: Path | None = None

    def __post_init__(self) -> None:
        if self.level not in ("draft", "standard", "fine"):
            raise InputError("level", self.level, "draft, standard, fine")

    def __call__(
        self,
        designs: Sequence[Any],
        paths: Sequence[LoadPath],
        sensitivities: bool = False,
        mesh_error: bool = False,
    ) -> Response:
        response = FakeFem()(designs, paths, mesh_error)
        if not sensitivities:
            return response
        slopes = np.stack([response.values, 2 * response.values], axis=-1)
        names = ("upper_thickness", "effect.parameter")
        return replace(response, parameters=names, jacobian=slopes)

    def explore(
        self, design: Any, pressure: Any, beyond: bool, mesh_error: bool = False
    ) -> Response:
        assert beyond
        turning = np.insert(pressure, 1, 20e3)
        return FakeFem()([design], [LoadPath(turning)], mesh_error)


@pytest.fixture(autouse=True)
def fakes(monkeypatch: pytest.MonkeyPatch) -> None:
    module = SimpleNamespace(Model=FakeModel, GENERATOR_VERSION="fake")
    monkeypatch.setitem(sys.modules, "datagen.model", module)  # type: ignore[arg-type]
    monkeypatch.setattr(answer, "load_model", lambda folder: FakeSurrogate())


@pytest.fixture
def pba(capsys: pytest.CaptureFixture[str]) -> Any:
    """Run a command: exit status, standard output, standard error."""

    def run(command: str | Sequence[str]) -> tuple[int, str, str]:
        arguments = command.split() if isinstance(command, str) else command
        status = main(arguments)
        streams = capsys.readouterr()
        return status, streams.out, streams.err

    return run


def the_json(result: tuple[int, str, str]) -> dict[str, Any]:
    status, out, err = result
    assert (status, err) == (0, "")
    assert out.count("\n") == 1
    data = json.loads(out, parse_constant=lambda name: pytest.fail(name))
    assert isinstance(data, dict)
    return data


def test_solve_json(pba: Any) -> None:
    data = the_json(
        pba("solve --device S1 --case 2 --set upper_thickness_um=80 "
            "--pressures 0,50,300 --json")
    )  # fmt: skip
    design = named_device("S1", 2).with_values(upper_thickness=80e-6)
    expected = closed_form(design, np.array([0, 50e3, 300e3]))
    assert data["pressure_kPa"] == [0, 50, 300]
    for i, name in enumerate(OUTPUT_NAMES):
        column = BY_FIELD[name]
        values = np.array(data[column.name]) * column.factor
        np.testing.assert_allclose(values, expected[:, i], rtol=1e-12)
    assert data["status"] == "completed"
    assert data["limit_pressure_kPa"] is None
    assert (data["unknowns"], data["seconds"]) == (4321, 0.25)
    assert data["model_version"] == "fem-fake-standard"


def test_mesh_error_is_told_unless_not_wanted(pba: Any) -> None:
    command = "solve --pressures 0,100,500"
    data = the_json(pba(f"{command} --json"))
    for name in QUANTITY:
        values, errors = data[name], data["mesh_error"][name]
        assert errors[:2] == pytest.approx([MESH_ERROR * abs(v) for v in values[:2]])
        assert errors[2] is None
    assert data["limit_pressure_error_kPa"] == pytest.approx(400 * MESH_ERROR)
    assert data["mesh_error_seconds"] == 0.05
    status, out, _ = pba(command)
    assert status == 0
    assert "±0.0" in out
    assert "400 kPa (mesh error 4 kPa)" in out
    assert "± bounds the discretisation error, calibrated on" in out
    plain = the_json(pba(f"{command} --no-mesh-error --json"))
    assert plain["mesh_error"] is plain["limit_pressure_error_kPa"] is None
    assert plain["inflation_mm"] == data["inflation_mm"]
    assert "±" not in pba(f"{command} --no-mesh-error")[1]


def test_sensitivities_are_in_bench_units(pba: Any) -> None:
    data = the_json(pba("solve --pressures 10,300 --sensitivities --json"))
    tip = data["sensitivities"]["tip_deflection_mm"]
    # The fake differentiates to the value itself and to twice the value, in SI.
    wanted = [None if v is None else v * 1e-6 for v in data["tip_deflection_mm"]]
    assert tip["upper_thickness_um"] == pytest.approx(wanted)
    assert tip["effect.parameter"] == pytest.approx(
        [2 * v for v in data["tip_deflection_mm"]]
    )
    assert "sensitivities" not in the_json(pba("solve --pressures 10 --json"))


def test_beyond_gives_the_steps_of_the_solver(pba: Any) -> None:
    data = the_json(pba("solve --pressures 10,40 --beyond --json"))
    assert data["pressure_kPa"] == [10, 20, 40]


def test_sensitivities_are_told_for_one_percent(pba: Any) -> None:
    status, out, _ = pba("solve --pressures 10,40 --sensitivities")
    assert status == 0
    assert "change at 40 kPa" in out
    assert "upper_thickness_um +1 %" in out
    assert "a unit of effect.parameter" in out


def test_default_pressures_and_bare_names(pba: Any) -> None:
    bare = the_json(pba("solve --set upper_thickness=80 --json"))
    full = the_json(pba("solve --set upper_thickness_um=80 --json"))
    assert bare == full
    assert bare["pressure_kPa"] == list(range(0, 65, 5))
    assert bare["design"]["upper_thickness_um"] == 80


def test_steps_that_were_not_reached_are_null(pba: Any) -> None:
    data = the_json(pba("solve --pressures 100,500 --json"))
    assert data["status"] == "limit_point"
    assert data["limit_pressure_kPa"] == 400
    assert data["message"] == "the path turns at 400 kPa"
    for name in QUANTITY:
        assert data[name][0] is not None
        assert data[name][1] is None


def test_balloons_that_meet_are_told(pba: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    command = "solve --pressures 10,40"
    assert the_json(pba(f"{command} --json"))["self_contact_pressure_kPa"] is None
    apart = FakeModel.__call__

    def meeting(*arguments: Any, **options: Any) -> Response:
        response = apart(*arguments, **options)
        return replace(response, self_contact_pressure=np.array([21.5e3]))

    monkeypatch.setattr(FakeModel, "__call__", meeting)
    assert the_json(pba(f"{command} --json"))["self_contact_pressure_kPa"] == 21.5
    status, out, _ = pba(command)
    assert status == 0
    assert "Neighbouring balloons meet at 21.5 kPa." in out


def test_effects_reach_the_model(pba: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr(
        FakeModel, "__post_init__", lambda self: seen.append(self), raising=True
    )
    command = ["solve", "--effect", "self_weight:density=1000,angle=-1e-2"]
    command += ["--effect", "yeoh", "--sensitivities", "--level", "draft", "--json"]
    data = the_json(pba(command))
    (model,) = seen
    assert model.effects == ("self_weight", "yeoh")
    assert model.parameters["self_weight"] == {"density": 1000, "angle": -0.01}
    assert model.level == data["level"] == "draft"
    assert data["effects"] == model.parameters


def test_predict_json(pba: Any) -> None:
    data = the_json(pba("predict --pressures 0,10 --json"))
    assert (data["source"], data["in_range"], data["reasons"]) == (
        "surrogate", True, [],
    )  # fmt: skip
    for name, column in QUANTITY.items():
        half = (np.array(data[f"{name}_high"]) - data[f"{name}_low"]) / 2
        np.testing.assert_allclose(half * column.factor, BAND, rtol=1e-9)
        assert len(data[name]) == 2


def test_predict_out_of_range_asks_the_finite_elements(pba: Any) -> None:
    data = the_json(pba("predict --set lower_modulus_MPa=50 --pressures 10 --json"))
    assert (data["source"], data["in_range"]) == ("fem", False)
    assert data["reasons"] == ["lower_modulus is outside the trained range"]
    (value,), (half,) = data["inflation_mm"], data["mesh_error"]["inflation_mm"]
    assert half == pytest.approx(MESH_ERROR * value)
    assert data["inflation_mm_low"] == [pytest.approx(value - half)]
    assert data["inflation_mm_high"] == [pytest.approx(value + half)]
    assert the_json(pba("predict --pressures 200 --json"))["source"] == "fem"


def test_predict_for_people(pba: Any) -> None:
    status, out, _ = pba("predict --pressures 0,10,20")
    assert status == 0
    assert "tip" in out
    assert "±0.001" in out
    assert "At 20 kPa the tip is" in out
    assert "Surrogate fake-1" in out
    status, out, _ = pba("predict --pressures 100,500")
    assert "Finite elements, because:" in out
    assert "past the trained 150 kPa" in out
    assert "the path turns at 400 kPa" in out


COLUMNS = "length_mm, width_mm, balloon_length_mm"

BAD_INPUT = [
    ("solve --set upper_thickness_um=-5", "upper_thickness_um: -5 um", "10 to 2000 um"),
    ("solve --set upper_thickness=-5", "upper_thickness_um: -5 um", "10 to 2000 um"),
    ("solve --set upper_thickness_um=nan", "upper_thickness_um: nan um", "10 to 2000"),
    ("solve --set upper_thickness_um=inf", "upper_thickness_um: inf um", "10 to 2000"),
    ("solve --set upper_thickness_um=x", "upper_thickness_um: 'x' um", "10 to 2000"),
    ("solve --set divisions_x=1.5", "divisions_x: 1.5", "a whole number from 1 to 12"),
    ("solve --set thickness=5", "--set: 'thickness'", COLUMNS),
    ("solve --set upper_thickness_um", "--set: 'upper_thickness_um'", "name=value"),
    ("solve --set wall=1 --set wall_mm=1", "--set: 'wall_mm'", "at most once"),
    ("solve --set balloon_length_mm=9", "length_mm: 6.5 mm", "at least 10.27 mm"),
    ("solve --device S7", "device: 'S7'", "S1 or D8-MxN"),
    ("solve --case 5", "--case: 5", "from 1 to 4"),
    ("solve --case two", "--case: 'two'", "a whole number from 1 to 4"),
    ("solve --pressures 0,ten", "pressure_kPa[1]: 'ten' kPa", "from -100 to 10000 kPa"),
    ("solve --pressures nan", "pressure_kPa[0]: nan kPa", "from -100 to 10000 kPa"),
    ("solve --pressures ", "pressure_kPa[0]: ''", "a number"),
    ("solve --level finest", "level: 'finest'", "draft, standard, fine"),
    ("solve --effect a:b", "--effect: 'a:b'", "name:parameter=value"),
    ("solve --effect a:b=x", "a.b: 'x'", "a finite number"),
    ("solve --effect a:b=nan", "a.b: nan", "a finite number"),
    ("solve --effect yeoh", "--effect: 'yeoh'", "pba effects show yeoh"),
    ("solve --effect a --effect a", "--effect: 'a'", "at most once"),
    ("predict --pressures 1e9", "pressure_kPa[0]: 1e+09 kPa", "10000 kPa"),
    ("generate --designs 0 --seed 1 --out a", "--designs: 0", "from 1 to 100000000"),
    ("generate --designs 5 --seed -1 --out a", "--seed: -1", "from 0 to"),
    ("generate --designs 5 --seed 1 --out a --max-pressure -3",
     "--max-pressure: '-3' kPa", "a number from 0.001 to 10000 kPa"),
    ("generate --designs 5 --seed 1", "Missing option '--out'", ""),
    ("train none.h5 --out m", "none.h5", "does not exist"),
    ("serve --port 99999", "--port: 99999", "from 0 to 65535"),
    ("serve --wait forever", "--wait: 'forever' s", "from 0 to 3600 s"),
    ("solve --thickness 5", "No such option: --thickness", ""),
    ("calculate", "No such command 'calculate'", ""),
    ("train", "Missing argument", ""),
]  # fmt: skip


@pytest.mark.parametrize("as_json", [False, True])
@pytest.mark.parametrize(("command", "given", "allowed"), BAD_INPUT)
def test_bad_input_is_one_line(
    pba: Any, command: str, given: str, allowed: str, as_json: bool
) -> None:
    arguments = command.split(" ")
    status, out, err = pba([*arguments, "--json"] if as_json else arguments)
    if as_json and command.startswith(("serve", "calculate")):
        return  # these take no --json
    assert status == 2
    assert out == ""
    assert err.startswith("pba: ")
    assert err.count("\n") == 1
    assert given in err
    assert allowed in err
    assert "Traceback" not in err


def test_too_many_pressures(pba: Any) -> None:
    status, _, err = pba(["solve", "--pressures", ",".join(["1"] * 1001)])
    assert status == 2
    assert "1001 numbers" in err
    assert "1 to 1000 numbers" in err


@pytest.mark.parametrize("content", [b"", b"\x89HDF\r\n\x1a\n", b"not HDF5 at all"])
def test_a_corrupt_dataset_is_one_line(
    pba: Any, tmp_path: Path, content: bytes
) -> None:
    file = tmp_path / "paths.h5"
    file.write_bytes(content)
    status, out, err = pba(["train", str(file), "--out", str(tmp_path / "model")])
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert str(file) in err
    assert not (tmp_path / "model").exists()


@pytest.mark.parametrize("content", [None, "", "{}", '{"schema": 99}', "\x00\x01"])
def test_a_corrupt_model_is_one_line(
    pba: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: str | None
) -> None:
    monkeypatch.undo()  # the real loader
    if content is not None:
        (tmp_path / "model.json").write_text(content)
    status, out, err = pba(["predict", "--model", str(tmp_path), "--json"])
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert str(tmp_path) in err


def test_generate_reports_and_passes_everything_on(
    pba: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from datagen import generate

    seen: dict[str, Any] = {}

    class Data(list[int]):
        path_status = ("completed", "limit_point", "completed")
        generator_version = "7"

        def digest(self) -> str:
            return "abc"

    def fake(count: int, seed: int, out: Path, **more: Any) -> Data:
        seen.update(more, count=count, seed=seed, out=out)
        more["progress"](generate.Progress(1, 3, 0, 0.5, 4.0))
        return Data([1, 2, 3])

    monkeypatch.setattr(generate, "generate", fake)
    command = f"generate --designs 3 --seed 5 --out {tmp_path / 'a.h5'}"
    command += " --effects yeoh,self_weight --workers 2 --resume --level draft"
    data = the_json(pba(command + " --max-pressure 80 --json"))
    assert data["designs"] == 3
    assert data["path_status"] == {"completed": 2, "limit_point": 1}
    assert data["digest"] == "abc"
    assert (seen["count"], seen["seed"]) == (3, 5)
    assert seen["effects"] == ["yeoh", "self_weight"]
    assert (seen["workers"], seen["resume"], seen["level"]) == (2, True, "draft")
    assert seen["max_pressure"] == 80e3
    status, out, _ = pba(command)
    assert status == 0
    assert "3 paths (2 completed, 1 limit_point)" in out


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (Interrupted("interrupted: 2 of 9 kept; the same command with --resume"), 130),
        (KeyboardInterrupt(), 130),
        (GenerationError("row 3 failed:\nits design"), 1),
    ],
)
def test_an_interrupted_or_failed_run_is_one_line(
    pba: Any, monkeypatch: pytest.MonkeyPatch, error: BaseException, status: int
) -> None:
    from datagen import generate

    def fake(*_: Any, **__: Any) -> None:
        raise error

    monkeypatch.setattr(generate, "generate", fake)
    found, out, err = pba("generate --designs 9 --seed 1 --out a.h5 --json")
    assert (found, out) == (status, "")
    assert err.count("\n") == 1
    assert (" ".join(str(error).split()) or "interrupted") in err


def python(code: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


def test_help_needs_no_heavy_package() -> None:
    run = python(
        "import sys; from service.cli import main; status = main(['--help'])\n"
        "heavy = {'numpy', 'scipy', 'torch', 'skfem', 'numba', 'h5py', 'fastapi',\n"
        "         'dbos', 'plotly', 'pydantic'}\n"
        "print(sorted(heavy & set(sys.modules)), status, file=sys.stderr)"
    )
    assert run.stderr == "[] 0\n"
    for command in (
        "solve", "generate", "train", "accuracy", "predict", "effects", "serve",
    ):  # fmt: skip
        assert command in run.stdout


def test_the_meshes_that_need_no_look_are_all_of_todays() -> None:
    from datagen.levels import LEVELS
    from service import options, schemas

    assert options.LEVELS == tuple(LEVELS) == get_args(schemas.Level)


def test_predict_needs_neither_torch_nor_finite_elements() -> None:
    run = python(
        "import sys; from service.cli import main\n"
        "main(['predict', '--model', 'none'])\n"
        "print(sorted({'torch', 'skfem', 'numba', 'fastapi', 'dbos', 'plotly'}\n"
        "             & set(sys.modules)))"
    )
    assert run.stdout == "[]\n"


def test_an_unforeseen_error_is_one_line_and_status_1() -> None:
    code = (
        "import sys; from service import cli\n"
        "cli.app.command('broken')(lambda: 1 / 0)\n"
        "sys.argv = ['pba', 'broken']; sys.exit(cli.main())"
    )
    run = python(code)
    assert run.returncode == 1
    assert run.stderr.count("\n") == 1
    assert "ZeroDivisionError" in run.stderr
    debug = python("import os; os.environ['PBA_DEBUG'] = '1'\n" + code)
    assert debug.returncode == 1
    assert "Traceback" in debug.stderr


def test_a_reader_that_leaves_is_no_error() -> None:
    code = "import sys; from service.cli import main; sys.exit(main(['--help']))"
    shell = f'{sys.executable} -c "{code}" | true'
    run = subprocess.run(
        ["sh", "-c", shell], capture_output=True, text=True, timeout=60
    )
    assert "Traceback" not in run.stderr


def test_a_terminal_without_unicode_gets_its_answer() -> None:
    run = python(
        "import sys; sys.stdout.reconfigure(encoding='ascii', errors='strict')\n"
        "from service.cli import main\n"
        "sys.argv = ['pba', 'predict', '--device', 'S1', '--pressures', '10,20']\n"
        "sys.exit(main())"
    )
    assert run.returncode == 0, run.stderr
    assert "At 20 kPa the tip is" in run.stdout


def test_sparkline() -> None:
    assert terminal.sparkline([0, 1, None, 7]) == "▁▂ █"
    assert terminal.sparkline([2, 2]) == "▁▁"
    assert terminal.sparkline([None]) == ""
    assert terminal.sparkline(list(range(100)), width=8) == terminal.BARS


def test_a_path_without_any_step_is_told_as_such() -> None:
    lists = {
        "pressure_kPa": [1],
        "tip_deflection_mm": [None],
        "inflation_mm": [None],
        "status": "inverted_element",
        "message": "",
    }
    assert terminal.verdict(lists) == "No load step was reached: inverted_element."


def test_accuracy_tables() -> None:
    errors = {
        "rmse": 0.001, "median_pct": 1.5, "p95_pct": 4, "max_pct": 9, "r2": None,
        "coverage": 0.91,
    }  # fmt: skip
    found = {
        "n_test": 60, "n_train": 240, "coverage": {"90": 0.91},
        "outputs": {"inflation_mm": errors},
        "regions": [
            {"by": "pressure", "region": "0 to 50 kPa", "designs": 60,
             "outputs": {"inflation_mm": errors}},
        ],
    }  # fmt: skip
    titles = [table.title for table in terminal.accuracy_tables(found)]
    assert titles == [
        "60 held-out designs, trained on 240; 91% inside the 90 % interval",
        "pressure 0 to 50 kPa (60 designs)",
    ]
