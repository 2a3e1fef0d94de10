"""Published tensile tests: read, and fitted with the law that the device is made of."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from datagen.errors import FileError, InputError
from datagen.materials import Gent, Hyperelastic, NeoHookean, Yeoh
from datagen.specimens import Tensile, tensile_stress
from discrepancy.measurement import Measurements
from discrepancy.reading import MeasurementError
from discrepancy.tensile import (
    SRMD_COLUMNS,
    initial_modulus,
    read_multiaxial,
    read_srmd,
)

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("PBA_DATA", ROOT.parent / "shared/data"))
measured = pytest.mark.skipif(
    not DATA.is_dir(), reason="the measured data is not here; PBA_DATA names its folder"
)

MODES = {"uniaxial": "UT", "equibiaxial": "ET", "planar": "PS"}


def residual(
    whole: Measurements, energy: NeoHookean | Gent | Yeoh, mu: float
) -> np.ndarray:
    """Stress of the law less measured, Pa, over all tests."""
    parts = []
    for curve in whole.curves:
        assert isinstance(curve.design, Tensile)
        model = tensile_stress(
            Hyperelastic(energy), mu, curve.stretch, curve.design.mode
        )
        parts.append(model - curve.output("stress"))
    return np.concatenate(parts)


def gent_fit(whole: Measurements) -> tuple[float, float, float]:
    """mu (Pa), Jm and root-mean-square error (Pa), by least squares."""
    largest = max(
        float((c.stretch**2 + 2 / c.stretch).max()) for c in whole.curves
    )  # every mode stretches its chains less than twice as far
    start = [0.1 * whole.batches[0].modulus / 1e6, 0.5 / largest]
    fit = least_squares(
        lambda v: np.nan_to_num(residual(whole, Gent(v[1]), 1e6 * v[0]), nan=1e9),
        start,
        bounds=([0.0, 0.0], np.inf),
        x_scale=start,
    )
    return 1e6 * fit.x[0], 1 / fit.x[1], float(np.sqrt((fit.fun**2).mean()))


@measured
def test_rtv615_is_gents() -> None:
    whole = read_srmd(DATA / "srmd_tensile/RTV615.csv")
    (curve,) = whole.curves
    assert curve.device == "RTV615" and len(curve.load) == 84
    assert curve.time is not None and curve.time[0] == 0.2
    mu, jm, error = gent_fit(whole)
    assert mu == pytest.approx(0.385e6, rel=2e-3)
    assert jm == pytest.approx(10.67, rel=2e-3)
    stress = curve.output("stress")
    assert 1 - error**2 / stress.var() == pytest.approx(0.996, abs=5e-4)
    unit = residual(whole, NeoHookean(), 1.0) + stress
    soft = float(unit @ stress / (unit @ unit))
    plain = float(np.sqrt((residual(whole, NeoHookean(), soft) ** 2).mean()))
    assert plain > 3 * error


@measured
def test_rtv615_is_yeohs() -> None:
    whole = read_srmd(DATA / "srmd_tensile/RTV615.csv")
    c1, c2, c3 = 0.16324e6, 0.01386e6, 0.00094e6
    found = residual(whole, Yeoh(c2 / c1, c3 / c1), 2 * c1)
    assert np.sqrt((found**2).mean()) == pytest.approx(0.0047e6, rel=0.02)


@measured
@pytest.mark.parametrize(
    ("rubber", "mu", "jm"),
    [("Treloar_1944", 0.2745e6, 84.3), ("Meunier_2008", 0.3215e6, 11.7)],
)
def test_three_modes_are_fitted_together(rubber: str, mu: float, jm: float) -> None:
    folder = DATA / "rubber_multiaxial"
    paths = {mode: folder / f"{rubber}_{short}.txt" for mode, short in MODES.items()}
    whole = read_multiaxial(paths, name=rubber)
    assert whole.devices == tuple(f"{rubber} {mode}" for mode in MODES)
    assert len(whole.batches) == 1
    found = gent_fit(whole)
    assert found[0] == pytest.approx(mu, rel=0.01)
    assert found[1] == pytest.approx(jm, rel=0.02)


# -- the readers, without the data -----------------------------------------------------


def srmd(folder: Path, *lines: str) -> Path:
    path = folder / "rubber.csv"
    head = [
        "PARAMETER;INFO;URL;;",
        "Material;rubber;;;",
        ";;;;",
        ";".join(SRMD_COLUMNS),
    ]
    path.write_text("\n".join([*head, *lines, ""]))
    return path


def test_srmd_format(tmp_path: Path) -> None:
    path = srmd(tmp_path, "0.1;0.095;0.033;0.1;0.03", "0.2;0.18;0.066;0.2;0.055")
    found = read_srmd(path, modulus=0.3e6)
    (curve,) = found.curves
    assert found.warnings == () and curve.design == Tensile(0.3e6)
    assert curve.stretch == pytest.approx([1.1, 1.2])
    assert curve.output("stress") == pytest.approx([30e3, 55e3])
    (warning,) = read_srmd(path).warnings
    assert warning.startswith("rubber.csv: no modulus is stated; 0.327 MPa is")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("0.1;x;0.033;0.1;0.03", "0.1 x 0.033 0.1 0.03"),
        ("0.1;0.095;0.033;0.1", "0.1 0.095 0.033 0.1"),
        ("0.1;0.095;0.033;inf;0.1", "0.1 0.095 0.033 inf 0.1"),
    ],
)
def test_bad_srmd_lines(tmp_path: Path, line: str, words: str) -> None:
    path = srmd(tmp_path, "0;0;0;0;0", line)
    with pytest.raises(MeasurementError) as caught:
        read_srmd(path)
    assert str(caught.value) == (
        f"{path}:6: '{words}' is not allowed; allowed: 5 numbers"
    )


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.csv"
    path.write_text("a;b\n1;2\n")
    with pytest.raises(FileError, match="not a test of the database"):
        read_srmd(path)
    with pytest.raises(FileError, match="holds no readings"):
        read_srmd(srmd(tmp_path))
    with pytest.raises(MeasurementError, match=r"other\.csv:1: 'a;b' is not allowed"):
        read_multiaxial({"uniaxial": path})
    with pytest.raises(InputError, match=r"^mode: 'shear'"):
        read_multiaxial({"shear": path})
    with pytest.raises(InputError, match=r"^paths"):
        read_multiaxial({})


@pytest.mark.parametrize("mode", MODES)
def test_the_first_part_gives_the_modulus(mode: str) -> None:
    stretch = np.linspace(0.8, 3.0, 40)
    stress = tensile_stress(Hyperelastic(), 1e6, stretch, mode)
    stress[stretch > 1.3] *= 2
    assert initial_modulus(stretch, stress, mode) == pytest.approx(3e6, rel=1e-12)
    with pytest.raises(InputError, match=r"^stretch: 2 is not allowed"):
        initial_modulus(np.array([2.0, 3.0]), np.array([1.0, 2.0]), mode)
