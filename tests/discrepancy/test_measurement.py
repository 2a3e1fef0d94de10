"""The types of measurements, and files that say again what was read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from datagen.device import named_device
from datagen.errors import FileError, InputError
from datagen.materials import Hyperelastic
from datagen.specimens import MODES, Bulge, Tensile, tensile_stress
from discrepancy.measurement import (
    LOADING,
    MEASURED,
    UNLOADING,
    Curve,
    Measurements,
    Tolerances,
)
from discrepancy.reading import read_measurements
from discrepancy.writing import measurements_text, write_measurements

DESIGN = named_device("S1")


def curve(**changes: Any) -> Curve:
    """Two load steps of the published device."""
    fields: dict[str, Any] = {
        "device": "S1",
        "run": 1,
        "orientation": 0.0,
        "design": DESIGN,
        "load": np.array([0.0, 10e3]),
        "time": None,
        "branch": np.array([LOADING, LOADING]),
        "outputs": ("inflation",),
        "values": np.array([[np.nan], [0.11e-3]]),
        "std": np.full((2, 1), np.nan),
    }
    return Curve(**fields | changes)


# -- types -----------------------------------------------------------------------------


def test_a_curve_leads_to_its_path() -> None:
    one = curve(time=np.array([1.0, 3.0]))
    assert (one.path.pressure == [0, 10e3]).all()
    assert one.path.time is not None and (one.path.time == [1, 3]).all()
    assert one.specimen == "actuator" and one.readings == 1
    with pytest.raises(AttributeError, match="has no stretch"):
        _ = one.stretch
    with pytest.raises(ValueError, match="read-only"):
        one.values[0, 0] = 1.0


def test_a_tensile_curve_has_no_pressure() -> None:
    strip = curve(design=Tensile(2e6), load=[1.0, 1.1], outputs=("stress",))
    assert strip.specimen == "tensile" and (strip.stretch == [1, 1.1]).all()
    assert strip.layers == {"upper": 2e6}
    with pytest.raises(AttributeError, match="has no pressure"):
        _ = strip.path


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"device": " S1"}, "device"),
        ({"device": ""}, "device"),
        ({"run": 0}, "run"),
        ({"outputs": ("stress",)}, "outputs"),
        ({"outputs": ()}, "outputs"),
        ({"load": [0.0, np.nan]}, "load"),
        ({"load": [0.0, 1.0, 2.0]}, "values"),
        ({"values": [[1.0, 2.0], [1.0, 2.0]]}, "values"),
        ({"values": [[np.nan], [np.nan]]}, "values"),
        ({"values": [[np.inf], [1.0]]}, "values"),
        ({"std": [[0.0], [1.0]]}, "std"),
        ({"time": [1.0, 1.0]}, "time"),
        ({"time": [1.0]}, "time"),
        ({"branch": ["up", "down"]}, "branch"),
        ({"branch": [UNLOADING, LOADING]}, "branch"),
    ],
)
def test_bad_curves(changes: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError) as caught:
        curve(**changes)
    assert caught.value.field == field


def test_tolerances_of_the_contract() -> None:
    tolerances = Tolerances()
    assert (tolerances.modulus, tolerances.thickness) == (0.05, 3e-6)
    assert tolerances.camera_scale == 0.005
    assert Tolerances(0, 0, 0) == Tolerances(0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"modulus": -0.05},
            "tolerance of modulus: -5 % is not allowed; allowed: a number from 0 to "
            "50 %",
        ),
        (
            {"thickness": 3.0},
            "tolerance of thickness: 3e+06 um is not allowed; allowed: a number from "
            "0 to 100 um",
        ),
        (
            {"camera_scale": float("nan")},
            "tolerance of camera_scale: nan % is not allowed; allowed: a number from "
            "0 to 20 %",
        ),
        (
            {"modulus": "5 %"},
            "tolerance of modulus: '5 %' % is not allowed; allowed: a number from 0 "
            "to 50 %",
        ),
    ],
)
def test_bad_tolerances(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        Tolerances(**changes)
    assert str(caught.value) == message


def test_measurements_of_several_devices() -> None:
    other = DESIGN.with_values(upper_modulus=4.5e6)
    strip = curve(
        device="T", design=Tensile(2.5e6), load=[1.0, 1.1], outputs=("stress",)
    )
    whole = Measurements(
        (curve(), curve(run=2), curve(device="X", design=other), strip)
    )
    assert whole.devices == ("S1", "X", "T") and whole.readings == 4
    assert [(batch.modulus, batch.members) for batch in whole.batches] == [
        (2.5e6, (("S1", "upper"), ("T", "upper"))),
        (4.5e6, (("S1", "lower"), ("X", "upper"), ("X", "lower"))),
    ]
    assert whole.batch_of("X", "upper") == 1
    with pytest.raises(InputError, match="T lower"):
        whole.batch_of("T", "lower")
    part = whole.subset(["T", "S1"])
    assert part.devices == ("S1", "T") and len(part.curves) == 3
    with pytest.raises(InputError, match=r"^device: 'Y' is not allowed"):
        whole.subset(["Y"])


@pytest.mark.parametrize(
    ("curves", "field"),
    [
        ((), "curves"),
        ((curve(), curve()), "run"),
        ((curve(), curve(run=2, design=named_device("S1", 2))), "device"),
    ],
)
def test_bad_measurements(curves: tuple[Curve, ...], field: str) -> None:
    with pytest.raises(InputError) as caught:
        Measurements(curves)
    assert caught.value.field == field


# -- files -----------------------------------------------------------------------------

NAMES = st.text(
    st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1, max_size=8
)


def apart(value: float) -> float:
    """Load steps nearer than this are one in a file of 15 digits."""
    return round(value, 9)


def near(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_subnormal=False)


SIZE = {
    "tip_deflection": 3e-3,
    "bending_angle": 6.0,
    "inflation": 2.4e-3,
    "inflation_lower": 2.4e-3,
    "cavity_volume": 2e-8,
}
"""Of readings, SI; stress is by the modulus and the stretch."""


@st.composite
def curves_of(draw: st.DrawFn, device: str) -> list[Curve]:
    """All curves of one device, any kind of specimen."""
    side = draw(st.sampled_from(["upper", "lower"]))
    modulus = draw(near(0.1e6, 9e6))
    design = draw(
        st.sampled_from(
            [
                DESIGN.with_values(upper_modulus=modulus, width=2e-3 * (1 + 1e-13)),
                Bulge(8e-3, 1e-3, 120e-6, modulus, side),
                Tensile(modulus, draw(st.sampled_from(MODES)), side),
            ]
        )
    )
    tensile = isinstance(design, Tensile)
    # Pressed further together in two directions, it would take more than 500 MPa.
    low, high = (0.4, 9.0) if tensile else (-50e3, 300e3)
    kind = "tensile" if tensile else "bulge" if isinstance(design, Bulge) else ""
    keys = draw(
        st.lists(
            st.tuples(st.integers(1, 99), near(-6.0, 6.0)),
            min_size=1,
            max_size=2,
            unique_by=lambda key: (key[0], apart(key[1])),
        )
    )
    found = []
    for run, orientation in keys:
        load = draw(st.lists(near(low, high), min_size=1, max_size=5, unique_by=apart))
        n = len(load)
        outputs = tuple(
            name
            for name in MEASURED[kind or "actuator"]
            if name in ("inflation", "stress") or draw(st.booleans())
        )
        if isinstance(design, Tensile):
            law, stretch = Hyperelastic(), np.array(load)
            stress = tensile_stress(law, modulus / 3, stretch, design.mode)
            top = np.maximum(np.abs(stress[:, None]), 0.01 * modulus)
        else:
            top = np.tile([SIZE[name] for name in outputs], (n, 1))
        cell = st.none() | near(-1, 1)
        grid = st.lists(cell, min_size=n * len(outputs), max_size=n * len(outputs))
        values = np.array(draw(grid), dtype=float).reshape(n, -1)
        if isinstance(design, Tensile):
            values = 0.5 + 0.4 * values
        values = values * top
        values[0] = 0.5 * top[0]
        std = np.abs(np.array(draw(grid), dtype=float).reshape(n, -1)) * 0.2 * top
        std = np.where((std > 1e-12 * top) & np.isfinite(values), std, np.nan)
        steps = draw(st.none() | st.lists(near(1e-3, 1e3), min_size=n, max_size=n))
        up = draw(st.integers(0, n))
        found.append(
            Curve(
                device=device,
                run=run,
                orientation=orientation,
                design=design,
                load=np.array(load),
                time=None if steps is None else np.cumsum(steps),
                branch=np.array([LOADING] * up + [UNLOADING] * (n - up)),
                outputs=outputs,
                values=values,
                std=std,
            )
        )
    return found


@st.composite
def any_measurements(draw: st.DrawFn) -> Measurements:
    devices = draw(st.lists(NAMES, min_size=1, max_size=3, unique=True))
    return Measurements(tuple(c for name in devices for c in draw(curves_of(name))))


@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(whole=any_measurements())
def test_round_trip(whole: Measurements, tmp_path: Path) -> None:
    """What is written is read again to 1e-12, whatever was measured of whatever."""
    path = tmp_path / "again.csv"
    write_measurements(whole, path)
    again = read_measurements(path)
    assert again.devices == whole.devices
    assert len(again.curves) == len(whole.curves)
    for old, new in zip(whole.curves, again.curves, strict=True):
        assert (new.device, new.run) == (old.device, old.run)
        assert new.orientation == pytest.approx(old.orientation, rel=1e-12, abs=0)
        for name, value in vars(old.design).items():
            if isinstance(value, str):
                assert getattr(new.design, name) == value
            else:
                assert getattr(new.design, name) == pytest.approx(value, rel=1e-12)
        assert (new.time is None) == (old.time is None)
        kept = [name for name in old.outputs if np.isfinite(old.output(name)).any()]
        assert new.outputs == tuple(kept)
        columns = [old.outputs.index(name) for name in kept]
        pairs = [
            (new.load, old.load),
            (new.values, old.values[:, columns]),
            (new.std, old.std[:, columns]),
        ]
        if old.time is not None and new.time is not None:
            pairs.append((new.time, old.time))
        for found, expected in pairs:
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=0)
        assert (new.branch == old.branch).all()


@pytest.mark.parametrize("sign", [1, -1])
def test_loads_that_go_back_while_loading_stay_loading(
    sign: int, tmp_path: Path
) -> None:
    turned = curve(
        load=sign * np.array([0.0, 3e3, 2e3, 1e3]),
        branch=np.array([LOADING] * 4),
        values=sign * np.full((4, 1), 0.11e-3),
        std=np.full((4, 1), np.nan),
    )
    write_measurements(Measurements((turned,)), tmp_path / "again.csv")
    again = read_measurements(tmp_path / "again.csv")
    assert list(again.curves[0].branch) == [LOADING] * 4


def test_only_columns_with_something_in_them_are_written() -> None:
    text = measurements_text(Measurements((curve(),)))
    header, *lines = text.splitlines()
    assert header == (
        "device,length_mm,width_mm,balloon_length_mm,balloon_width_mm,"
        "balloon_start_mm,wall_mm,divisions_x,divisions_y,cavity_height_um,"
        "upper_thickness_um,lower_thickness_um,upper_modulus_MPa,lower_modulus_MPa,"
        "pressure_kPa,inflation_mm"
    )
    assert len(lines) == 2 and lines[0].endswith(",0,")
    assert lines[1] == "S1,6.5,2,4,1,1.25,0.2,1,1,75,95,140,2.5,4.5,10,0.11"


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="cannot be written: No such file"):
        write_measurements(Measurements((curve(),)), tmp_path / "none/a.csv")
