"""The closed forms against published tables."""

from __future__ import annotations

import numpy as np
import pytest

from datagen.device import POISSON
from surrogate.baseline import Balloon, membrane_load, rise_of, section


@pytest.mark.parametrize(
    ("theta", "rise", "load"),
    [
        (0.25, 0.125655, 0.010224),
        (0.75, 0.393627, 0.238279),
        (1.25, 0.721484, 0.834753),
        (np.pi / 2, 1.0, 1.312784),
        (2.0, 1.557408, 1.914546),
    ],
)
def test_strip_membrane(theta: float, rise: float, load: float) -> None:
    assert np.tan(theta / 2) == pytest.approx(rise, abs=2e-6)
    assert membrane_load(np.array(np.tan(theta / 2))) == pytest.approx(load, abs=2e-6)


def test_rise_inverts_load() -> None:
    x = np.array([0.0, 1e-4, 0.1, 0.5, 1.0, 1.8])
    for bending in (1e-3, 0.1, 5.0):
        for membrane in (1.0, 1.9):
            load = bending * x + membrane * membrane_load(x)
            found, arc = rise_of(load, np.array(bending), np.array(membrane))
            np.testing.assert_allclose(found, x, rtol=2e-6, atol=1e-14)
            theta = 2 * np.arctan(x)
            np.testing.assert_allclose(arc, np.sinc(theta / np.pi), rtol=2e-6)


def test_plate_limit() -> None:
    """w = p a^4 / (24 D) of the long thin clamped strip."""
    a, t, mu, p = 1e-3, 1e-5, 1e6, 1e-5
    one = Balloon(
        np.array([a]), np.array([0.0]), np.array([[t], [t]]), np.array([[mu], [mu]])
    )
    stiffness = 2 * mu * (1 + POISSON) * t**3 / (12 * (1 - POISSON**2))
    x, _ = rise_of(p / one.load_scale, one.bending, one.membrane)
    np.testing.assert_allclose(x * a, p * a**4 / (24 * stiffness), rtol=1e-3)


def test_section_of_two_layers() -> None:
    """Timoshenko's bimetal: without a gap the section is the classical bilayer."""
    t1, t2, e1, e2, b = 1e-4, 3e-4, 2e6, 5e6, 2e-3
    columns = {
        "rim": np.array([0.5e-3]),
        "wall": np.array([1e-3]),
        "divisions_y": np.array([1.0]),
        "balloon_width": np.array([b - 1e-3]),
        "lower_thickness": np.array([t1]),
        "cavity_height": np.array([0.0]),
        "upper_thickness": np.array([t2]),
        "lower_modulus": np.array([e1]),
        "spacer_modulus": np.array([e1]),
        "upper_modulus": np.array([e2]),
    }
    found = section(columns)
    m, n = t1 / t2, e1 / e2
    h = t1 + t2
    kappa_over_strain = (
        6
        * (1 + m) ** 2
        / (h * (3 * (1 + m) ** 2 + (1 + m * n) * (m * m + 1 / (m * n))))
    )
    # A mismatch strain eps makes the force pair P with moment P h/2 = EI kappa, and
    # both layers' strains meet: eps = kappa h/2 + P (1/E1 t1 + 1/E2 t2)/b.
    own = b * (e1 * t1**3 + e2 * t2**3) / 12
    pair = own / (h / 2)
    compliance = (1 / (e1 * t1) + 1 / (e2 * t2)) / b
    assert 1 / (h / 2 + pair * compliance) == pytest.approx(kappa_over_strain)
    parallel = e1 * t1 * e2 * t2 / (e1 * t1 + e2 * t2) * b * h**2 / 4
    assert found.stiffness[0] == pytest.approx(own + parallel)
    assert found.axial[0] == pytest.approx(b * (e1 * t1 + e2 * t2))
