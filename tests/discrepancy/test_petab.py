"""PEtab tables of both versions, and what of the format is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from datagen.errors import FileError
from discrepancy.reading import MeasurementError, read_measurements, read_petab

from .benches import COLUMNS

GEOMETRY = {
    name: text
    for name, text in COLUMNS.items()
    if name not in ("pressure_kPa", "tip_deflection_mm", "inflation_mm")
}

Table = list[dict[str, str]]


def save(path: Path, table: Table) -> None:
    names = list(dict.fromkeys(name for row in table for name in row))
    lines = [names, *([row.get(name, "") for name in names] for row in table)]
    path.write_text("".join("\t".join(line) + "\n" for line in lines))


OBSERVABLES: Table = [
    {
        "observableId": "rise",
        "observableFormula": "inflation_um",
        "noiseFormula": "noiseParameter1_rise",
    },
    {
        "observableId": "tip",
        "observableFormula": "tip_deflection_mm",
        "noiseFormula": "0.01",
    },
]


def version_1() -> dict[str, Table]:
    conditions = [
        {"conditionId": f"at{p}", "conditionName": f"{p} kPa", **GEOMETRY}
        | {"pressure_kPa": p, "orientation_deg": "180"}
        for p in ("10", "20")
    ]
    measurements = [
        {
            "observableId": name,
            "simulationConditionId": f"at{p}",
            "measurement": value,
            "time": "inf",
            "noiseParameters": noise,
            "replicateId": replicate,
        }
        for replicate in ("1", "2")
        for name, p, value, noise in (
            ("rise", "10", "110", "3"),
            ("tip", "10", "0.02", ""),
            ("rise", "20", "170", "4"),
        )
    ]
    return {
        "measurements": measurements,
        "conditions": conditions,
        "observables": [dict(row) for row in OBSERVABLES],
    }


def version_2() -> dict[str, Table]:
    geometry = [
        {"conditionId": "S1", "targetId": name, "targetValue": text}
        for name, text in (GEOMETRY | {"pressure_kPa": "0"}).items()
    ]
    loads = [
        {"conditionId": f"p{p}", "targetId": "pressure_kPa", "targetValue": p}
        for p in ("10", "20")
    ]
    down = [
        {"conditionId": "down", "targetId": "branch", "targetValue": "unloading"},
        {"conditionId": "down", "targetId": "pressure_kPa", "targetValue": "5"},
    ]
    experiments = [
        {"experimentId": "first", "time": time, "conditionId": condition}
        for time, condition in (
            ("20", "p20"),
            ("0", "S1"),
            ("10", "p10"),
            ("30", "down"),
        )
    ]
    measurements = [
        {
            "observableId": "rise",
            "experimentId": "first",
            "measurement": value,
            "time": time,
            "noiseParameters": "3",
        }
        for time, value in (("35", "60"), ("5", "0"), ("15", "110"), ("25", "170"))
    ]
    return {
        "measurements": measurements,
        "conditions": geometry + loads + down,
        "experiments": experiments,
        "observables": [dict(row) for row in OBSERVABLES[:1]],
    }


def folder(path: Path, tables: dict[str, Table]) -> Path:
    path.mkdir(exist_ok=True)
    for name, table in tables.items():
        save(path / f"{name}.tsv", table)
    return path


def test_version_1(tmp_path: Path) -> None:
    found = read_measurements(folder(tmp_path / "petab", version_1()))
    assert found.warnings == () and found.devices == ("S1",)
    assert [(c.run, c.orientation) for c in found.curves] == [(1, np.pi), (2, np.pi)]
    curve = found.curves[0]
    assert curve.design.balloon_length == pytest.approx(4e-3)  # type: ignore[union-attr]
    assert curve.load == pytest.approx([10e3, 20e3]) and curve.time is None
    assert curve.outputs == ("tip_deflection", "inflation")
    expected = np.array([[2e-5, 110e-6], [np.nan, 170e-6]])
    assert curve.values == pytest.approx(expected, nan_ok=True)
    expected = np.array([[1e-5, 3e-6], [np.nan, 4e-6]])
    assert curve.std == pytest.approx(expected, nan_ok=True)


def test_version_2(tmp_path: Path) -> None:
    """An experiment lays conditions on top of each other as its time goes on."""
    found = read_petab(folder(tmp_path / "petab", version_2()))
    (curve,) = found.curves
    assert found.warnings == ()
    assert curve.load == pytest.approx([0, 10e3, 20e3, 5e3])
    assert curve.time == pytest.approx([5, 15, 25, 35])
    assert list(curve.branch) == ["loading"] * 3 + ["unloading"]
    assert curve.output("inflation") == pytest.approx([0, 110e-6, 170e-6, 60e-6])


def test_conditions_of_one_time_act_together(tmp_path: Path) -> None:
    tables = version_2()
    tables["experiments"] = [
        {"experimentId": "first", "time": time, "conditionId": condition}
        for time, condition in (("0", "S1"), ("10", "p10"), ("10", "upside"))
    ]
    tables["conditions"] = [
        row for row in tables["conditions"] if row["targetId"] != "pressure_kPa"
    ] + [
        {"conditionId": "p10", "targetId": "pressure_kPa", "targetValue": "10"},
        {"conditionId": "upside", "targetId": "orientation_deg", "targetValue": "180"},
    ]
    tables["measurements"] = tables["measurements"][2:3]
    (curve,) = read_petab(folder(tmp_path, tables)).curves
    assert curve.pressure == pytest.approx([10e3])
    assert curve.orientation == pytest.approx(np.pi)
    tables["conditions"].append(
        {"conditionId": "upside", "targetId": "pressure_kPa", "targetValue": "20"}
    )
    with pytest.raises(MeasurementError, match="pressure: set twice at time 10 of"):
        read_petab(folder(tmp_path, tables))


def test_names_as_in_the_benchmark_collection(tmp_path: Path) -> None:
    """`experimentalCondition` is no table of experiments, replicates have names."""
    tables = version_1()
    for row in tables["measurements"]:
        row["replicateId"] = f"rep_{row['replicateId']}"
    plain = read_petab(folder(tmp_path / "plain", version_1()))
    names = {
        "measurements": "measurementData_x",
        "conditions": "experimentalCondition_x",
        "observables": "observables_x",
    }
    named = {names[kind]: table for kind, table in tables.items()}
    found = read_petab(folder(tmp_path / "named", named))
    assert [curve.run for curve in found.curves] == [1, 2]
    assert found.readings == plain.readings
    (warning,) = [line for line in found.warnings if "replicates" in line]
    assert "'rep_1' is 1, 'rep_2' is 2" in warning


@pytest.mark.parametrize("make", [version_1, version_2])
def test_a_problem_file_names_its_tables(
    tmp_path: Path, make: Callable[[], dict[str, Table]]
) -> None:
    folder(tmp_path / "tables", make())
    plain = read_measurements(tmp_path / "tables")
    listed = [f"{name[:-1]}_files: [tables/{name}.tsv]" for name in make()]
    if make is version_1:
        text = "format_version: 1\nproblems:\n  - sbml_files: []\n    "
        text += "\n    ".join(listed)
    else:
        text = "format_version: 2.0.0\n" + "\n".join(listed)
    problem = tmp_path / "problem.yaml"
    problem.write_text(text + "\n")
    for path in (problem, tmp_path):
        found = read_measurements(path)
        assert found.sha256 == plain.sha256
        for one, other in zip(found.curves, plain.curves, strict=True):
            assert (one.load == other.load).all()


REFUSED: dict[str, tuple[str, str, int, dict[str, str], str]] = {
    "formula": (
        "observables",
        "2",
        2,
        {"observableFormula": "2 * inflation_um"},
        "observableFormula: '2 * inflation_um' is not supported; allowed: the name of "
        "one quantity (tip_deflection_mm, bending_angle_deg, inflation_mm, "
        "inflation_lower_mm, cavity_volume_uL, stress_MPa)",
    ),
    "transformation": (
        "observables",
        "2",
        2,
        {"observableTransformation": "log10"},
        "observableTransformation: 'log10' is not supported; allowed: lin",
    ),
    "distribution": (
        "observables",
        "2",
        2,
        {"noiseDistribution": "laplace"},
        "noiseDistribution: 'laplace' is not supported; allowed: normal",
    ),
    "noise formula": (
        "observables",
        "2",
        2,
        {"noiseFormula": "0.1 * rise"},
        "noiseFormula: '0.1 * rise' is not supported; allowed: a number, "
        "noiseParameter1_rise or the name of a parameter",
    ),
    "condition on a parameter of the model": (
        "conditions",
        "1",
        3,
        {"k1": "3"},
        "k1: a condition on it is not supported; allowed: device, the design columns, "
        "pressure_kPa and what else a measurement file says about a reading",
    ),
    "condition by a parameter's name": (
        "conditions",
        "1",
        2,
        {"pressure_kPa": "p_top"},
        "pressure_kPa: 'p_top' is not allowed; allowed: a plain number in kPa, or "
        "nothing where a reading is missing",
    ),
    "observable parameters": (
        "measurements",
        "1",
        3,
        {"observableParameters": "scale"},
        "observableParameters: 'scale' is not supported; allowed: nothing",
    ),
    "pre-equilibration": (
        "measurements",
        "1",
        3,
        {"preequilibrationConditionId": "at10"},
        "preequilibrationConditionId: 'at10' is not supported; allowed: nothing",
    ),
    "unknown condition": (
        "measurements",
        "1",
        4,
        {"simulationConditionId": "at30"},
        "simulationConditionId: 'at30' is not in the conditions table",
    ),
    "unknown observable": (
        "measurements",
        "1",
        4,
        {"observableId": "sag"},
        "observableId: 'sag' is not in the observables table",
    ),
    "unknown experiment": (
        "measurements",
        "2",
        3,
        {"experimentId": "second"},
        "experimentId: 'second' is not in the table",
    ),
    "before the experiment": (
        "measurements",
        "2",
        3,
        {"time": "-5"},
        "time: -5 is before experiment 'first'",
    ),
    "no number": (
        "measurements",
        "1",
        2,
        {"measurement": "high"},
        "inflation_mm: 'high' is not allowed; allowed: a plain number, or nothing "
        "where a reading is missing",
    ),
    "a reading twice": (
        "measurements",
        "1",
        4,
        {"simulationConditionId": "at10"},
        "pressure_kPa: 10 kPa, loading, of device 'S1', run 1 is there already in line "
        "2; allowed: one row a load step; number repeated tests in the column 'run', "
        "and give the way back the branch 'unloading'",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(tmp_path: Path, case: str) -> None:
    name, version, line, change, text = REFUSED[case]
    tables = version_1() if version == "1" else version_2()
    tables[name][line - 2] |= change
    path = folder(tmp_path / "petab", tables)
    with pytest.raises(MeasurementError) as caught:
        read_petab(path)
    assert caught.value.problems[0] == (f"{path / name}.tsv:{line}", text)


def test_named_noise_is_unknown_noise(tmp_path: Path) -> None:
    tables = version_1()
    tables["measurements"][0]["noiseParameters"] = "sigma"
    found = read_petab(folder(tmp_path / "petab", tables))
    assert found.warnings == ("measurements.tsv:2: noise 'sigma' is taken for unknown",)
    assert np.isnan(found.curves[0].std[0, 1])


def test_a_misspelt_heading_is_told(tmp_path: Path) -> None:
    """Not those that are the user's own, which the format allows."""
    tables = version_1()
    for row in tables["measurements"]:
        row["noiseParameter"], row["operator"] = row.pop("noiseParameters"), "Meier"
    assert read_petab(folder(tmp_path / "petab", tables)).warnings == (
        "measurements.tsv:1: column 'noiseParameter' is not PEtab's and left out; did "
        "you mean noiseParameters?",
    )


def test_missing_tables_and_files(tmp_path: Path) -> None:
    tables = version_1()
    path = folder(tmp_path / "petab", tables)
    (path / "observables.tsv").unlink()
    with pytest.raises(FileError, match="has no table of observables"):
        read_petab(path)
    problem = tmp_path / "p.yaml"
    problem.write_text("problems: [{}, {}]")
    with pytest.raises(FileError, match="holds 2 problems; allowed: one"):
        read_petab(problem)
    problem.write_text("a: [")
    with pytest.raises(FileError, match="not a YAML file"):
        read_petab(problem)
    problem.write_text("measurement_files: x.tsv")
    with pytest.raises(FileError, match="measurement_files: allowed: a list"):
        read_petab(problem)


def test_missing_columns_are_named(tmp_path: Path) -> None:
    tables = version_1()
    for row in tables["conditions"]:
        del row["cavity_height_um"], row["device"]
    path = folder(tmp_path / "petab", tables)
    with pytest.raises(
        MeasurementError, match=r"missing 2 columns: device, cavity_height_um$"
    ):
        read_petab(path)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("measurement_files: 2020-99-99\n", "not a YAML file"),
        (
            'measurement_files: ["a\\0b"]\ncondition_files: [c]\nobservable_files: [o]',
            "null byte",
        ),
    ],
)
def test_a_problem_file_that_is_none(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "problem.yaml"
    path.write_text(text)
    with pytest.raises(FileError, match=told):
        read_measurements(path)


def test_what_stands_twice_is_refused(tmp_path: Path) -> None:
    tables = version_1()
    tables["observables"].append(tables["observables"][0])
    for name, table in tables.items():
        save(tmp_path / f"{name}.tsv", table)
    with pytest.raises(MeasurementError, match="'rise' is there already"):
        read_measurements(tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("observableId\t", '"observableId\t', 'a " may not be closed'),
        ("noiseParameters", "measurement", "'measurement' stands there twice"),
        ("\n", "\tsurplus\n", "fields, but"),
    ],
)
def test_tables_that_are_not_whole(
    tmp_path: Path, old: str, new: str, told: str
) -> None:
    for name, table in version_1().items():
        save(tmp_path / f"{name}.tsv", table)
    path = tmp_path / "measurements.tsv"
    text = path.read_text()
    head, _, rest = text.partition("\n")
    changed = head.replace(old, new) + "\n" + rest
    if old == "\n":
        changed = head + "\n" + rest.replace(old, new)
    path.write_text(changed)
    with pytest.raises(FileError, match=told):
        read_measurements(tmp_path)
