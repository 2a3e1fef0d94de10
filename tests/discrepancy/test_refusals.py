"""Every kind of bad input is refused by its line."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

from datagen.errors import FileError
from discrepancy.reading import MeasurementError, read_measurements

from .benches import COLUMNS, LOADS, rows, text_of, write

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
    "nanolitres for microlitres": (
        [{"cavity_volume_uL": "700"}],
        2,
        "cavity_volume_uL: 700 uL is not allowed; allowed: a number from -24 to 24 uL "
        "(roofs and floors 3 times as high as a balloon is wide); probably meant in "
        "nL: 700 nL is 0.7 uL",
    ),
    "kilopascals for megapascals of stress": (
        [{"stress_MPa": "1200"}],
        2,
        "stress_MPa: 1200 MPa is not allowed; allowed: a number from -500 to 500 MPa; "
        "probably meant in kPa: 1200 kPa is 1.2 MPa",
    ),
    "a name that nobody sees": (
        [{"device": "S1\u200b"}],
        2,
        "device: 'S1\\u200b' is not allowed; allowed: a name of characters that can be "
        "seen",
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
        "length_mm: nothing is not allowed; allowed: a number in every row of "
        "specimen actuator",
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
        "times the largest inflation_mm of the file); probably meant in um: 2 um is "
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
        (text_of(rows({"device": '"S1'}, *LOADS)), ":2", 'a " may not be closed'),
        (
            text_of(rows({"note": '"left\nrim"'}, {"pressure_kPa": "2e4"})),
            ":4",
            "pressure_kPa: 20000 kPa is not allowed",
        ),
        (
            text_of(rows({"pressure_kPa": "0.5bar"})).replace("_kPa", "_bar"),
            ":2",
            "pressure_bar: '0.5bar' is not allowed; allowed: a plain number, or",
        ),
        (
            text_of(rows({"inflation_mm": "2000000"})).replace("ion_mm", "ion_um"),
            ":2",
            "inflation_mm: 2000 mm is not allowed; allowed: a number from -60 to 60 "
            "mm; written as 2000000 in column inflation_um",
        ),
        (
            text_of(rows({"": "7"})),
            ":2",
            "'7' stands in column 18, which has no heading; allowed: a heading over",
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
        "line after one that runs on",
        "words in a unit of the file's own",
        "too large in a unit of the file's own",
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


WHOLE = {"length_mm": "7", "balloon_start_mm": "1", "wall_mm": ""} | {
    "upper_modulus_MPa": "2",
    "lower_modulus_MPa": "4",
    "tip_deflection_mm": "",
    "inflation_mm": "",
}
"""Changes that leave a row without any decimal sign."""


@pytest.mark.parametrize(
    ("texts", "refused"),
    [
        (("600", "800", "1,050"), "'1,050' may be 1.050 or 1050"),
        (("600", "0,8", "1,050"), ""),
        (("0,600", "0,800", "1,050"), ""),
    ],
)
def test_commas_that_may_part_thousands(
    tmp_path: Path, texts: tuple[str, ...], refused: str
) -> None:
    path = tmp_path / "bench.csv"
    steps = [
        WHOLE | {"width_mm": "2", "pressure_kPa": str(10 * i), "inflation_um": text}
        for i, text in enumerate(texts, 1)
    ]
    text = text_of(rows(*steps), ";").replace("inflation_mm", "remark")
    path.write_text(text)
    if not refused:
        read_measurements(path)
        return
    with pytest.raises(MeasurementError, match=refused):
        read_measurements(path)


def test_a_misspelt_column_is_named_where_it_is_missing(tmp_path: Path) -> None:
    path = tmp_path / "bench.csv"
    path.write_text(text_of(rows({})).replace("pressure_kPa", "presure_kPa"))
    with pytest.raises(MeasurementError, match="did you mean pressure_kPa"):
        read_measurements(path)


def test_a_remark_between_rows_is_said_to_lack_the_design(tmp_path: Path) -> None:
    path = tmp_path / "bench.csv"
    lines = text_of(rows({}, {"pressure_kPa": "20"})).splitlines()
    path.write_text("\n".join([*lines[:2], "# pump changed", *lines[2:]]) + "\n")
    with pytest.raises(MeasurementError, match="length_mm: nothing is not allowed"):
        read_measurements(path)


def test_a_line_without_end(tmp_path: Path) -> None:
    path = tmp_path / "bench.csv"
    path.write_text("x" * 200_000 + "\n")
    with pytest.raises(FileError, match="not CSV"):
        read_measurements(path)
