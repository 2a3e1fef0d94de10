"""Files as people make them, and every kind of bad input by its line."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import numpy as np
import pytest

from datagen.device import named_device
from datagen.errors import FileError
from datagen.specimens import Bulge, Tensile
from discrepancy.measurement import Tolerances
from discrepancy.reading import MeasurementError, read_measurements
from discrepancy.table import MOST

from .benches import LOADS, rows, text_of, write

DEG = np.pi / 180


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


@pytest.mark.parametrize(
    ("loads", "timed", "loading"),
    [
        ("10 20 30 30 20 10", False, 3),  # the way back begins at the top
        ("10 20 30 30 20 10", True, 4),  # held at the top
        ("10 20 20 30 30 30 20 20 10", True, 6),
        ("10 20 30 20 30 20 10", True, 7),  # no one way back
    ],
)
def test_loads_that_are_held(
    tmp_path: Path, loads: str, timed: bool, loading: int
) -> None:
    steps = [
        {"pressure_kPa": p} | ({"time_s": str(10 * i)} if timed else {})
        for i, p in enumerate(loads.split())
    ]
    (curve,) = read_measurements(write(tmp_path, *steps)).curves
    back = len(steps) - loading
    assert list(curve.branch) == ["loading"] * loading + ["unloading"] * back


def test_a_gauge_that_drifts_does_not_hide_the_way_back(tmp_path: Path) -> None:
    for loads in ("-0.02 10 20 30 19 9 -0.01", "10 20 30 29.9 20.1 20.2 10 0.01"):
        steps = [{"pressure_kPa": p} for p in loads.split()]
        (curve,) = read_measurements(write(tmp_path, *steps)).curves
        up = 1 + loads.split().index("30")
        back = len(steps) - up
        assert list(curve.branch) == ["loading"] * up + ["unloading"] * back


def timed(*seconds: float) -> list[dict[str, str]]:
    return [
        {"pressure_kPa": str(10 * i), "time_s": f"{s:.10g}"}
        for i, s in enumerate(seconds, 1)
    ]


@pytest.mark.parametrize("epoch", [1.75e9, 3.8e9])
def test_a_computers_clock_is_set_to_the_tests(tmp_path: Path, epoch: float) -> None:
    """Runs keep the rest between them."""
    first = timed(epoch, epoch + 10, epoch + 20)
    again = [one | {"run": "2"} for one in timed(epoch + 500, epoch + 510, epoch + 520)]
    found = read_measurements(write(tmp_path, *first, *again))
    times = [curve.time for curve in found.curves]
    assert times[0] == pytest.approx([10, 20, 30])
    assert times[1] == pytest.approx([510, 520, 530])
    (warning,) = found.warnings
    assert "is a clock's; time is counted from 10 s, one step, before" in warning


def test_a_clock_that_runs_before_the_test_is_told(tmp_path: Path) -> None:
    found = read_measurements(write(tmp_path, *timed(3600, 3601, 3602)))
    assert found.curves[0].time == pytest.approx([3600, 3601, 3602])
    (warning,) = found.warnings
    assert "the first reading is at 3600 s, the others are 1 s apart" in warning
    assert not read_measurements(write(tmp_path, *timed(10, 20, 30))).warnings


def test_milliseconds_of_a_clock_are_told_as_such(tmp_path: Path) -> None:
    path = write(tmp_path, *timed(1.75e12, 1.75e12 + 1e4))
    with pytest.raises(MeasurementError, match=r"probably meant in ms.* 1\.75e\+09 s"):
        read_measurements(path)


@pytest.mark.parametrize(("start", "corner"), [(0, ""), (1, '""')])
def test_the_index_of_a_data_frame_is_left_out(
    tmp_path: Path, start: int, corner: str
) -> None:
    head, *lines = text_of(rows(*LOADS), ",").splitlines()
    numbered = [f"{i},{line}" for i, line in enumerate(lines, start)]
    path = tmp_path / "frame.csv"
    path.write_text("\n".join([f"{corner},{head}", *numbered]) + "\n")
    found = read_measurements(path)
    assert found.readings == read_measurements(write(tmp_path, *LOADS)).readings
    (warning,) = found.warnings
    assert "holds the numbers of the rows and is left out" in warning
    path.write_text("\n".join([f"{corner},{head}", *reversed(numbered)]) + "\n")
    with pytest.raises(MeasurementError, match="column 1, which has no heading; allow"):
        read_measurements(path)


@pytest.mark.parametrize("word", ["NaN", "NA", "#NV"])
def test_programs_fill_empty_fields_with_words(tmp_path: Path, word: str) -> None:
    """Of other specimens' columns, and of what need not be given."""
    names = (
        *("length_mm", "width_mm", "balloon_start_mm", "wall_mm", "divisions_x"),
        *("divisions_y", "cavity_height_um", "lower_thickness_um"),
        *("lower_modulus_MPa", "tip_deflection_mm", "orientation_deg", "run"),
        *("branch", "time_s"),
    )
    empty = dict.fromkeys(names, word)
    bulge = {"device": "B", "specimen": "bulge"} | empty
    free = {"run": word, "branch": word, "orientation_deg": word, "time_s": word}
    found = read_measurements(write(tmp_path, free, bulge))
    assert [curve.specimen for curve in found.curves] == ["actuator", "bulge"]
    assert [curve.run for curve in found.curves] == [1, 1]
    with pytest.raises(MeasurementError, match="length_mm: nothing is not allowed"):
        read_measurements(write(tmp_path, {"length_mm": word}))


@pytest.mark.parametrize("name", ["inflation_mm_sd", "inflation_SD_mm"])
def test_standard_deviations_have_other_names(tmp_path: Path, name: str) -> None:
    (curve,) = read_measurements(write(tmp_path, {name: "0.002"})).curves
    assert curve.std[0, curve.outputs.index("inflation")] == pytest.approx(2e-6)


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
            "bench.csv:3: device 'S1', run 2 has no measured value and is left out: "
            "effects that remember do not know of its loads. One reading, as at rest, "
            "keeps them",
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


@pytest.mark.parametrize("end", ["\x0b", "\x0c", "\x1c", "\x85", "\u2028"])
def test_remarks_may_hold_what_ends_no_line(tmp_path: Path, end: str) -> None:
    path = tmp_path / "bench.csv"
    path.write_bytes(f"# page 1{end}\n{text_of(rows(*LOADS))}".encode())
    assert read_measurements(path).readings == 6


def test_a_remark_that_a_spreadsheet_has_quoted(tmp_path: Path) -> None:
    path = tmp_path / "bench.csv"
    path.write_text('"# measured by Meier, Bonn",,,\n' + text_of(rows(*LOADS)))
    assert read_measurements(path).readings == 6


def test_fields_in_quotation_marks_may_run_over_lines(tmp_path: Path) -> None:
    """Alt+Enter in a spreadsheet: in a title, in headings and in remarks."""
    text = text_of(rows(*({"note": '"the lamp\nwas on"'} | load for load in LOADS)))
    plain = read_measurements(write(tmp_path, *LOADS))
    text = text.replace("pressure_kPa", '"pressure\n[kPa]"')
    file = tmp_path / "odd.csv"
    for title in ("", '"Bench\nof Monday"\n', 'Bench 3" wide\n'):
        for end in ("\n", "\r\n"):
            file.write_text((title + text).replace("\n", end), newline="")
            found = read_measurements(file)
            assert found.curves[0].load.tolist() == plain.curves[0].load.tolist()
            np.testing.assert_array_equal(
                found.curves[0].values, plain.curves[0].values
            )


def test_a_blank_before_a_quotation_mark(tmp_path: Path) -> None:
    """As some programs write them; a decimal comma in one parts no fields."""
    names, *values = text_of(rows(*LOADS)).splitlines()
    lines = [", ".join(f'"{one}"' for one in names.split(","))]
    for line in values:
        quoted = (f'"{one.replace(".", ",")}"' for one in line.split(","))
        lines.append(", ".join(quoted))
    file = tmp_path / "quoted.csv"
    file.write_text("\n".join(lines) + "\n")
    plain = read_measurements(write(tmp_path, *LOADS))
    np.testing.assert_array_equal(
        read_measurements(file).curves[0].values, plain.curves[0].values
    )


def test_noise_of_a_tip_that_hardly_moves(tmp_path: Path) -> None:
    """Two bendings cancel: it is small on one device, or on all of them."""
    still = {"tip_deflection_mm": "0.001", "tip_deflection_std_mm": "0.005"}
    assert read_measurements(write(tmp_path, still)).curves[0].std[0, 0] == 5e-6
    large = still | {"tip_deflection_std_mm": "0.07"}
    with pytest.raises(FileError, match=r"from 0 to 0\.065 mm \(1% of the strip's"):
        read_measurements(write(tmp_path, large))
    other = {"device": "B", "tip_deflection_mm": "0.5"}
    assert len(read_measurements(write(tmp_path, large, other)).curves) == 2


def test_a_file_that_is_wrong_everywhere_is_read_no_further(tmp_path: Path) -> None:
    wrong = [{"pressure_kPa": "x", "inflation_mm": "y"}] * 1000
    with pytest.raises(
        MeasurementError, match=r"and at least 199 more, lines 2, 3"
    ) as e:
        read_measurements(write(tmp_path, *wrong))
    assert len(e.value.problems) == MOST


def test_a_line_that_is_too_short_is_told(tmp_path: Path) -> None:
    """Accepted, as spreadsheets cut what is empty; a lost separator looks the same."""
    path = tmp_path / "bench.csv"
    whole = text_of(rows(*LOADS)).splitlines()
    whole[2] = whole[2].rpartition(",")[0]
    path.write_text("\n".join(whole) + "\n")
    (told,) = read_measurements(path).warnings
    assert told.startswith("bench.csv:3: 16 fields, but 17 headings")
    assert "is a separator lost?" in told


def test_words_for_nothing_where_nothing_belongs(tmp_path: Path) -> None:
    path = write(tmp_path, {"stretch": "NaN"}, {"stretch": "", "pressure_kPa": "20"})
    assert read_measurements(path).readings == 4


def test_pressure_and_then_vacuum_is_no_way_back(tmp_path: Path) -> None:
    steps = ("10", "20", "30", "-1", "-2")
    found = read_measurements(write(tmp_path, *({"pressure_kPa": p} for p in steps)))
    assert list(found.curves[0].branch) == ["loading"] * 5


@pytest.mark.parametrize("title", ["Meier, Bonn", "Device list, run 3,,", "PBA"])
def test_a_title_above_the_headings_is_left_out(tmp_path: Path, title: str) -> None:
    path = tmp_path / "bench.csv"
    path.write_text(f"{title}\n2026-11-29\n\n" + text_of(rows(*LOADS)))
    found = read_measurements(path)
    assert found.readings == 6
    assert found.warnings == ("bench.csv:1: left out: stands above the headings",)


def test_a_minus_sign_that_is_no_hyphen(tmp_path: Path) -> None:
    path = write(tmp_path, {"tip_deflection_mm": "\N{MINUS SIGN}0.02"})
    assert read_measurements(path).curves[0].output("tip_deflection") == [-0.02e-3]


def test_angles_that_may_be_radians(tmp_path: Path) -> None:
    bent = {"tip_deflection_mm": "1.5", "pressure_kPa": "30"}
    for angle, told in (("30", 0), ("0.52", 1)):
        path = write(tmp_path, bent | {"bending_angle_deg": angle})
        warnings = read_measurements(path).warnings
        assert len(warnings) == told
        assert all("are the angles in degrees?" in words for words in warnings)


@pytest.mark.parametrize(
    ("stress", "meant"),
    [("1.2", ""), ("450", "; probably meant in kPa"), ("1e-6", "")],
)
def test_stress_against_the_stated_modulus(
    tmp_path: Path, stress: str, meant: str
) -> None:
    """2.5 MPa at a stretch of 1.5: 0.88 MPa, neo-Hookean."""
    strip = {"device": "T", "specimen": "tensile", "upper_modulus_MPa": "2.5"}
    table = [
        {**strip, "stretch": stretch, "stress_MPa": text}
        for stretch, text in (("1", "0"), ("1.5", stress))
    ]
    path = tmp_path / "strip.csv"
    path.write_text(text_of(table))
    if float(stress) == 1.2:
        assert read_measurements(path).readings == 2
        return
    with pytest.raises(MeasurementError) as told:
        read_measurements(path)
    assert str(told.value).endswith(
        f":3: stress_MPa: {float(stress):g} MPa at stretch 1.5 is not allowed; "
        "allowed: within a factor of 100 of the 0.8796 MPa that the stated modulus of "
        f"2.5 MPa makes expect{meant}"
    )
