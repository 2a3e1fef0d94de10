"""Files as people make them, and every kind of bad input by its line."""

from __future__ import annotations

import hashlib
import pickle
import re
from pathlib import Path

import numpy as np
import pytest

from datagen.device import named_device
from datagen.errors import FileError
from datagen.specimens import Bulge, Tensile
from discrepancy.measurement import Tolerances
from discrepancy.reading import MeasurementError, read_measurements

from .benches import COLUMNS, rows, text_of, write

DEG = np.pi / 180
LOADS = ({"pressure_kPa": "10"}, {"pressure_kPa": "20"}, {"pressure_kPa": "30"})


# -- what is read ----------------------------------------------------------------------


def test_a_plain_file(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        {"pressure_kPa": "0", "inflation_mm": "0"},
        {"inflation_std_mm": "0.002", "bending_angle_deg": "1.5"},
        {"pressure_kPa": "20", "tip_deflection_mm": ""},
    )
    found = read_measurements(path)
    (curve,) = found.curves
    assert (found.source, found.warnings, found.readings) == ("bench.csv", (), 6)
    assert found.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert found.tolerances == Tolerances()
    assert (curve.device, curve.run, curve.orientation) == ("S1", 1, 0.0)
    assert curve.specimen == "actuator" and curve.time is None
    for name, value in named_device("S1").to_dict().items():
        assert getattr(curve.design, name) == pytest.approx(value, rel=1e-12)
    assert curve.pressure == pytest.approx([0, 10e3, 20e3])
    assert curve.outputs == ("tip_deflection", "bending_angle", "inflation")
    expected = [[0.02e-3, np.nan, 0], [0.02e-3, 1.5 * DEG, 0.11e-3]]
    expected.append([np.nan, np.nan, 0.11e-3])
    assert curve.values == pytest.approx(np.array(expected), nan_ok=True)
    assert np.argwhere(np.isfinite(curve.std)).tolist() == [[1, 2]]
    assert curve.std[1, 2] == pytest.approx(2e-6)
    assert list(curve.branch) == ["loading"] * 3
    assert (curve.path.pressure == curve.pressure).all() and curve.path.time is None


def test_given_tolerances_are_kept(tmp_path: Path) -> None:
    tolerances = Tolerances(modulus=0.1)
    assert read_measurements(write(tmp_path, {}), tolerances).tolerances == tolerances


def comma_file(separator: str) -> str:
    """A spreadsheet of a country that writes 0,11."""
    return text_of(rows(*LOADS), separator).replace(".", ",")


@pytest.mark.parametrize(
    "data",
    [
        b"\xef\xbb\xbf" + text_of(rows(*LOADS)).encode(),
        text_of(rows(*LOADS)).encode("utf-16"),
        comma_file(";").encode(),
        comma_file("\t").encode(),
        b"sep=;\r\n" + comma_file(";").replace("\n", "\r\n").encode(),
        re.sub("\n", " ,,\n\n", text_of(rows(*LOADS))).encode(),
        text_of([dict(reversed(row.items())) for row in rows(*LOADS)]).encode(),
        text_of(rows(*LOADS)).replace(",", " , ").encode(),
        text_of(rows(*LOADS)).replace("pressure_kPa", "Pressure [kPa]").encode(),
        b"# bench 3, Tuesday\n" + text_of(rows(*LOADS)).encode(),
        text_of(rows(*LOADS)).replace("0.11\n", '"0.11"\n').encode(),
        text_of(rows(*LOADS)).replace("\n", ",,,\n,,,\n").encode(),
    ],
    ids=[
        "byte order mark",
        "utf-16",
        "semicolons and decimal commas",
        "tabs and decimal commas",
        "spreadsheet's separator line",
        "trailing blanks and empty lines",
        "columns in another order",
        "blanks around fields",
        "unit in brackets",
        "remark",
        "quoted",
        "lines of separators",
    ],
)
def test_one_table_in_many_forms(tmp_path: Path, data: bytes) -> None:
    plain = read_measurements(write(tmp_path, *LOADS)).curves[0]
    path = tmp_path / "other.csv"
    path.write_bytes(data)
    found = read_measurements(path)
    assert found.warnings == ()
    (curve,) = found.curves
    assert (curve.device, curve.design) == (plain.device, plain.design)
    assert (curve.load == plain.load).all() and (curve.values == plain.values).all()


def test_quoted_decimal_commas_between_commas(tmp_path: Path) -> None:
    table = [
        {name: f'"{text.replace(".", ",")}"' for name, text in row.items()}
        for row in rows(*LOADS)
    ]
    path = tmp_path / "quoted.csv"
    path.write_text(text_of(table))
    assert read_measurements(path).curves[0].output("inflation")[0] == 0.11e-3


def test_windows_text(tmp_path: Path) -> None:
    path = tmp_path / "old.csv"
    path.write_bytes(text_of(rows({"device": "Prüfling"})).encode("cp1252"))
    found = read_measurements(path)
    assert found.devices == ("Prüfling",)
    assert found.warnings == ("old.csv: not UTF-8; read as Windows text (cp1252)",)


@pytest.mark.parametrize(
    ("heading", "text", "field", "si"),
    [
        ("inflation_um", "110", "inflation_mm", 110e-6),
        ("inflation_µm", "110", "inflation_mm", 110e-6),
        ("pressure_bar", "0.1", "pressure_kPa", 10e3),
        ("pressure_PA", "10000", "pressure_kPa", 10e3),
        ("pressure_mbar", "100", "pressure_kPa", 10e3),
        ("upper_modulus_kPa", "2500", "upper_modulus_MPa", 2.5e6),
        ("upper_thickness (mm)", "0.095", "upper_thickness_um", 95e-6),
        ("bending_angle_rad", "0.5", "bending_angle_deg", 0.5),
        ("inflation_std_um", "2", "inflation_std_mm", 2e-6),
        ("inflation_um_std", "2", "inflation_std_mm", 2e-6),
    ],
)
def test_another_unit_in_the_heading_is_converted(
    tmp_path: Path, heading: str, text: str, field: str, si: float
) -> None:
    table = rows({})
    table[0].pop(field, None)
    path = tmp_path / "units.csv"
    path.write_text(text_of([table[0] | {heading: text}]), encoding="utf-8")
    found = read_measurements(path)
    (warning,) = found.warnings
    assert warning.startswith("units.csv:1: ") and f"({field})" in warning
    (curve,) = found.curves
    name = field.rpartition("_")[0]
    values = {
        "pressure": curve.load[0],
        "inflation_std": curve.std[0, curve.outputs.index("inflation")],
        **dict(zip(curve.outputs, curve.values[0], strict=True)),
        **curve.design.__dict__,
    }
    assert values[name] == pytest.approx(si, rel=1e-12)


def test_unknown_columns_are_named(tmp_path: Path) -> None:
    more = {"operator": "Mia", "inflaton_lower_mm": "0.1", "wall_thickness_um": "3"}
    found = read_measurements(write(tmp_path, more))
    assert found.warnings == (
        "bench.csv:1: column 'operator' is not known and left out",
        "bench.csv:1: column 'inflaton_lower_mm' is not known and left out; did you "
        "mean inflation_lower_mm?",
        "bench.csv:1: column 'wall_thickness_um' is not known and left out; did you "
        "mean lower_thickness_um?",
    )


def test_columns_that_only_begin_like_ours_are_left_out(tmp_path: Path) -> None:
    """A word behind the name that is no unit is another column."""
    names = ("time_utc", "pressure_ref", "inflation_raw", "inflation_px", "length_tol")
    more = dict.fromkeys((*names, "mode"), "x1")
    found = read_measurements(write(tmp_path, more))
    assert len(found.warnings) == len(names)
    for name, warning in zip(names, found.warnings, strict=True):
        assert f"column {name!r} is not known and left out" in warning


@pytest.mark.parametrize("wall", ["", "0", "0.0", "NaN"])
def test_an_undivided_device_needs_no_wall(tmp_path: Path, wall: str) -> None:
    (curve,) = read_measurements(write(tmp_path, {"wall_mm": f'"{wall}"'})).curves
    assert curve.design == named_device("S1")


@pytest.mark.parametrize("turned", ["-180", "180"])
def test_orientations_that_are_the_same_are_one_curve(
    tmp_path: Path, turned: str
) -> None:
    """Only the cosine of the angle to gravity acts."""
    path = write(
        tmp_path,
        {"orientation_deg": "0"},
        {"orientation_deg": "360", "pressure_kPa": "20"},
        {"orientation_deg": turned},
    )
    found = read_measurements(path)
    assert [c.orientation for c in found.curves] == [0.0, np.pi]


def test_words_for_a_missing_reading(tmp_path: Path) -> None:
    path = write(tmp_path, {"inflation_mm": "NaN"}, {**LOADS[1], "inflation_mm": "NaN"})
    found = read_measurements(path)
    assert found.warnings == (
        "bench.csv:2: 'NaN' is taken for a missing reading, and 1 times more",
    )
    assert found.curves[0].outputs == ("tip_deflection",)


def test_runs_orientations_branches_and_times(tmp_path: Path) -> None:
    up = {"time_s": "0", "branch": "loading"}
    path = write(
        tmp_path,
        up | {"run": "2"},
        up | {"orientation_deg": "180"},
        up | {"pressure_kPa": "40", "time_s": "2.5", "run": "2"},
        up | {"pressure_kPa": "40", "time_s": "9", "run": "2", "branch": "Unloading"},
        up | {"pressure_kPa": "5", "time_s": "12", "run": "2", "branch": "unloading"},
    )
    found = read_measurements(path)
    assert found.warnings == ()
    assert [(c.run, c.orientation) for c in found.curves] == [(2, 0), (1, np.pi)]
    curve = found.curves[0]
    assert list(curve.branch) == ["loading"] * 2 + ["unloading"] * 2
    assert curve.path.pressure == pytest.approx([10e3, 40e3, 40e3, 5e3])
    assert curve.path.time == pytest.approx([0, 2.5, 9, 12])


def test_specimens_in_one_file(tmp_path: Path) -> None:
    """Geometry that a specimen does not have stays empty."""
    bulge = {
        "device": "B7",
        "specimen": "bulge",
        "balloon_length_mm": "8",
        "balloon_width_mm": "2",
        "upper_thickness_um": "140",
        "upper_modulus_MPa": "4.5",
        "pressure_kPa": "10",
        "inflation_mm": "0.17",
    }
    tensile = {
        "device": "T1",
        "specimen": "tensile",
        "lower_modulus_MPa": "4.5",
        "mode": "planar",
        "stretch": "1.4",
        "stress_MPa": "2.1",
        "stress_std_MPa": "0.05",
    }
    path = tmp_path / "three.csv"
    path.write_text(text_of([*rows({}), bulge, tensile, {**tensile, "stretch": "1.6"}]))
    found = read_measurements(path)
    assert found.warnings == ()
    _, membrane, strip = found.curves
    assert membrane.design == Bulge(8e-3, 2e-3, 140e-6, 4.5e6)
    assert membrane.specimen == "bulge" and membrane.outputs == ("inflation",)
    assert strip.design == Tensile(4.5e6, "planar", "lower")
    assert strip.stretch == pytest.approx([1.4, 1.6])
    assert strip.output("stress") == pytest.approx([2.1e6, 2.1e6])
    assert strip.std[0, 0] == pytest.approx(5e4)
    assert [(b.modulus, b.members) for b in found.batches] == [
        (2.5e6, (("S1", "upper"),)),
        (4.5e6, (("S1", "lower"), ("B7", "upper"), ("T1", "lower"))),
    ]
    assert found.batch_of("T1", "lower") == 1


def test_a_way_back_without_a_branch_is_unloading(tmp_path: Path) -> None:
    loads = ("10", "20", "30", "20", "10")
    found = read_measurements(write(tmp_path, *({"pressure_kPa": p} for p in loads)))
    (curve,) = found.curves
    assert list(curve.branch) == ["loading"] * 3 + ["unloading"] * 2
    (warning,) = found.warnings
    assert "no branch is given; from line 5 on" in warning


def test_a_specimen_that_states_both_layers_is_of_the_upper_one(tmp_path: Path) -> None:
    """And what it states of a device's other parts is not looked at."""
    strange = {"specimen": "bulge", "tip_deflection_mm": "", "divisions_x": "0"}
    found = read_measurements(write(tmp_path, strange))
    (curve,) = found.curves
    s1 = named_device("S1")
    assert curve.design == Bulge(
        s1.balloon_length, s1.balloon_width, s1.upper_thickness, s1.upper_modulus
    )
    (warning,) = found.warnings
    assert "states both layers; it is taken for one of the upper layer" in warning


# -- what is odd -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "warning"),
    [
        (
            [{"inflation_mm": "-0.09"}],
            "bench.csv:2: inflation_mm: -0.09 mm at 10 kPa; under pressure a roof "
            "rises",
        ),
        (
            [LOADS[1], LOADS[0]],
            "bench.csv:2: device 'S1', run 1: the load falls in line 3 of the loading "
            "branch; rows are taken as the order applied",
        ),
        (
            [{"branch": "unloading"}],
            "bench.csv:2: device 'S1', run 1 has no loading branch: the highest load "
            "is not known",
        ),
        (
            [{}, {"run": "2", "inflation_mm": "", "tip_deflection_mm": ""}],
            "bench.csv:3: device 'S1', run 2 has no measured value and is left out",
        ),
        (
            [{"pressure_kPa": "0.05"}],
            "bench.csv: the largest pressure_kPa: 0.05 kPa in the file: is the unit "
            "right?",
        ),
    ],
    ids=["roof sinks", "falls", "unloading alone", "empty run", "small pressures"],
)
def test_odd_but_possible(
    tmp_path: Path, changes: list[dict[str, str]], warning: str
) -> None:
    assert warning in read_measurements(write(tmp_path, *changes)).warnings


def test_noise_may_dip_below_zero(tmp_path: Path) -> None:
    low = {"inflation_mm": "-0.09", "inflation_std_mm": "0.04"}
    assert read_measurements(write(tmp_path, low)).warnings == ()
    vacuum = ({"pressure_kPa": "0"}, {"pressure_kPa": "-5", "inflation_mm": "-0.09"})
    assert read_measurements(write(tmp_path, *vacuum)).warnings == ()


# -- what is refused -------------------------------------------------------------------

REFUSED: dict[str, tuple[list[dict[str, str]], int, str]] = {
    "pascals for kilopascals": (
        [{}, {"pressure_kPa": "50000"}],
        3,
        "pressure_kPa: 50000 kPa is not allowed; allowed: a number from -101.325 to "
        "1000 kPa; probably meant in Pa: 50000 Pa is 50 kPa",
    ),
    "beyond vacuum": (
        [{"pressure_kPa": "-120"}],
        2,
        "pressure_kPa: -120 kPa is not allowed; allowed: a number from -101.325 to "
        "1000 kPa; probably meant in Pa: -120 Pa is -0.12 kPa",
    ),
    "micrometres for millimetres": (
        [{}, {"pressure_kPa": "30", "inflation_mm": "200"}],
        3,
        "inflation_mm: 200 mm is not allowed; allowed: a number from -60 to 60 mm; "
        "probably meant in um: 200 um is 0.2 mm",
    ),
    "micrometres, few of them": (
        [{"inflation_mm": "11"}],
        2,
        "inflation_mm: 11 mm is not allowed; allowed: a number from -3 to 3 mm (3 "
        "times the shorter side of a balloon); probably meant in um: 11 um is 0.011 mm",
    ),
    "millimetres for micrometres": (
        [{"upper_thickness_um": "0.095"}],
        2,
        "upper_thickness_um: 0.095 um is not allowed; allowed: a number from 10 to "
        "2000 um; probably meant in mm: 0.095 mm is 95 um",
    ),
    "pascals for megapascals": (
        [{"lower_modulus_MPa": "4500000"}],
        2,
        "lower_modulus_MPa: 4500000 MPa is not allowed; allowed: a number from 0.01 "
        "to 100 MPa; probably meant in Pa: 4500000 Pa is 4.5 MPa",
    ),
    "kilopascals for megapascals": (
        [{"lower_modulus_MPa": "4500"}],
        2,
        "lower_modulus_MPa: 4500 MPa is not allowed; allowed: a number from 0.01 "
        "to 100 MPa; probably meant in kPa: 4500 kPa is 4.5 MPa",
    ),
    "longer than the strip": (
        [{}, {"pressure_kPa": "30", "tip_deflection_mm": "-7.5"}],
        3,
        "tip_deflection_mm: -7.5 mm is not allowed; allowed: a number from -6.5 to "
        "6.5 mm (the length of the strip); probably meant in um: -7.5 um is -0.0075 mm",
    ),
    "words for a number": (
        [{"inflation_mm": "0.2 mm"}],
        2,
        "inflation_mm: '0.2 mm' is not allowed; allowed: a plain number in mm, or "
        "nothing where a reading is missing",
    ),
    "infinite": (
        [{"inflation_mm": "inf"}],
        2,
        "inflation_mm: 'inf' is not allowed; allowed: a plain number in mm, or "
        "nothing where a reading is missing",
    ),
    "no number for the design": (
        [{"length_mm": "NaN"}],
        2,
        "length_mm: 'NaN' is not allowed; allowed: a plain number in mm, or nothing "
        "where a reading is missing",
    ),
    "nothing for the design": (
        [{}, {"pressure_kPa": "20", "length_mm": ""}],
        3,
        "length_mm: nothing is not allowed; allowed: a number in every row of specimen "
        "actuator",
    ),
    "no wall between two balloons": (
        [{"wall_mm": "", "divisions_x": "2"}],
        2,
        "wall_mm: nothing is not allowed; allowed: a number where a device is divided",
    ),
    "noise in another unit": (
        [{}, {"pressure_kPa": "20", "inflation_std_mm": "2"}],
        3,
        "inflation_std_mm: 2 mm is not allowed; allowed: a number from 0 to 0.33 mm (3 "
        "times the largest inflation_mm of the device); probably meant in um: 2 um is "
        "0.002 mm",
    ),
    "half a balloon": (
        [{"divisions_x": "1.5"}],
        2,
        "divisions_x: 1.5 is not allowed; allowed: a whole number from 1 to 12",
    ),
    "balloons beyond the tip": (
        [{"length_mm": "5"}],
        2,
        "length_mm: 5 mm is not allowed; allowed: at least 5.27 mm: the balloons end "
        "at 5.25 mm (balloon_start + balloon_length + walls)",
    ),
    "another geometry": (
        [{}, {"pressure_kPa": "20"}, {"pressure_kPa": "30", "wall_mm": "0.3"}],
        4,
        "wall_mm: 0.3 mm is not allowed; allowed: wall_mm: 0.2 mm as in line 2 of the "
        "same device 'S1'",
    ),
    "another specimen": (
        [
            {},
            {"pressure_kPa": "20", "specimen": "bulge", "tip_deflection_mm": ""},
        ],
        3,
        "specimen: 'bulge' is not allowed; allowed: actuator, as in line 2 of the "
        "same device 'S1'",
    ),
    "a quantity of another specimen": (
        [{"specimen": "bulge"}],
        2,
        "tip_deflection_mm: a value is not allowed for specimen bulge; allowed: "
        "inflation_mm",
    ),
    "an unknown specimen": (
        [{"specimen": "balloon"}],
        2,
        "specimen: 'balloon' is not allowed; allowed: actuator, bulge, tensile",
    ),
    "no device": (
        [{}, {"device": "", "pressure_kPa": "20"}],
        3,
        "device: nothing is not allowed; allowed: a name",
    ),
    "a repeated row": (
        [{}, {"pressure_kPa": "20"}, {}],
        4,
        "pressure_kPa: 10 kPa, loading, of device 'S1', run 1 is there already in line "
        "2; allowed: one row a load step; number repeated tests in the column 'run', "
        "and give the way back the branch 'unloading'",
    ),
    "loading after unloading": (
        [
            {},
            {"pressure_kPa": "5", "branch": "unloading"},
            {"pressure_kPa": "20"},
        ],
        4,
        "branch: 'loading' is not allowed after 'unloading' in line 3 of device 'S1', "
        "run 1; allowed: loading, then unloading, and another run for the next cycle",
    ),
    "an unknown branch": (
        [{"branch": "up"}],
        2,
        "branch: 'up' is not allowed; allowed: loading, unloading",
    ),
    "time stands still": (
        [{"time_s": "1"}, {"time_s": "1", "pressure_kPa": "20"}],
        3,
        "time_s: 1 s is not allowed; allowed: more than the 1 s of line 2, the load "
        "step before of device 'S1', run 1",
    ),
    "no time": (
        [{"time_s": "1"}, {"pressure_kPa": "20"}],
        3,
        "time_s: nothing is not allowed; allowed: a time in every row of device 'S1', "
        "run 1, as in line 2, or in none",
    ),
    "no value at all": (
        [{}, {"device": "S2", "inflation_mm": "", "tip_deflection_mm": ""}],
        3,
        "device: 'S2' has no measured value in any row; allowed: at least one of "
        "tip_deflection_mm, bending_angle_deg, inflation_mm, inflation_lower_mm, "
        "cavity_volume_uL",
    ),
    "no noise": (
        [{"inflation_std_mm": "0"}],
        2,
        "inflation_std_mm: 0 mm is not allowed; allowed: a number above 0, or nothing "
        "where it is not known",
    ),
    "run zero": (
        [{"run": "0"}],
        2,
        "run: 0 is not allowed; allowed: a whole number from 1 to 1e+06",
    ),
    "strain for stretch": (
        [
            {
                "specimen": "tensile",
                "stretch": "0.05",
                "stress_MPa": "0.1",
                "lower_modulus_MPa": "",
                "inflation_mm": "",
                "tip_deflection_mm": "",
            }
        ],
        2,
        "stretch: 0.05 is not allowed; allowed: a number from 0.1 to 20; probably "
        "meant as strain: stretch is 1 + strain",
    ),
    "an unknown unit": (
        [{"inflation_lower_kPa": "5"}],
        1,
        "column 'inflation_lower_kPa': unit 'kPa' is not allowed; allowed: "
        "inflation_lower_mm, or another unit of length (um, mm, m, cm, nm)",
    ),
    "no unit": (
        [{"time": "5"}],
        1,
        "column 'time': no unit is not allowed; allowed: time_s, or another unit of "
        "time (s, ms, min, h)",
    ),
    "one quantity twice": (
        [{"inflation_um": "5"}],
        1,
        "columns 'inflation_mm' and 'inflation_um' are the same quantity",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(tmp_path: Path, case: str) -> None:
    changes, line, text = REFUSED[case]
    path = write(tmp_path, *changes)
    with pytest.raises(MeasurementError) as caught:
        read_measurements(path)
    assert caught.value.problems == ((f"{path}:{line}", text),)
    assert str(caught.value) == f"{path}:{line}: {text}"
    assert caught.value.path == str(path)


def test_every_missing_column_is_named(tmp_path: Path) -> None:
    path = tmp_path / "short.csv"
    names = ("device", "length_mm", "pressure_kPa")
    path.write_text(text_of([{name: COLUMNS[name] for name in names}]))
    with pytest.raises(MeasurementError) as caught:
        read_measurements(path)
    assert str(caught.value) == (
        f"{path}:1: missing 12 columns: width_mm, balloon_length_mm, "
        "balloon_width_mm, balloon_start_mm, divisions_x, divisions_y, "
        "cavity_height_um, upper_thickness_um, lower_thickness_um, upper_modulus_MPa, "
        "lower_modulus_MPa, one of tip_deflection_mm, bending_angle_deg, inflation_mm, "
        "inflation_lower_mm, cavity_volume_uL"
    )


def test_all_problems_are_counted_and_kept(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        {"inflation_mm": "200", "cavity_height_um": "x"},
        {"pressure_kPa": "20"},
        {"pressure_kPa": "30000"},
    )
    with pytest.raises(MeasurementError) as caught:
        read_measurements(path)
    places = [place.rpartition(":")[2] for place, _ in caught.value.problems]
    assert places == ["2", "2", "4"]
    assert str(caught.value).startswith(f"{path}:2: cavity_height_um: 'x' is")
    assert str(caught.value).endswith(" (and 2 more, lines 2, 4)")
    assert "\n" not in str(caught.value)
    copy = pickle.loads(pickle.dumps(caught.value))
    assert (str(copy), copy.problems) == (str(caught.value), caught.value.problems)


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("", "", "is empty"),
        ("\n \n,,\n", "", "is empty"),
        (",".join(COLUMNS) + "\n", ":1", "no readings below the headings"),
        (
            text_of(rows({"inflation_mm": "0,11"})),
            ":2",
            "18 fields, but 17 headings; extra: '11'; decimal commas need semicolons",
        ),
        (
            text_of(rows({}, {"inflation_mm": '"1,234"'})),
            ":3",
            "inflation_mm: '1,234' has a decimal comma, but '6.5' in line 2 a decimal "
            "point",
        ),
        (text_of(rows({"device": '"S1'}, *LOADS)), ":2", 'a " is not closed'),
        (
            text_of(rows({"": "7"})),
            ":2",
            "'7' stands in a column without a heading",
        ),
        ("PK\3\4\0\0", "", "not a text file"),
    ],
    ids=[
        "empty",
        "blank",
        "headings alone",
        "decimal comma between commas",
        "thousands",
        "open quote",
        "no heading",
        "spreadsheet file",
    ],
)
def test_not_a_table(tmp_path: Path, text: str, place: str, words: str) -> None:
    path = tmp_path / "odd.csv"
    path.write_text(text)
    with pytest.raises(FileError) as caught:
        read_measurements(path)
    assert str(caught.value).startswith(f"{path}{place}: ")
    assert words in str(caught.value)


def test_no_such_file(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="cannot be read: No such file"):
        read_measurements(tmp_path / "none.csv")
