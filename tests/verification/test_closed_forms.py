"""The exact answers against each other and against values computed elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from . import closed_forms as exact
from .benchmarks import SPECIMEN_LOADS


@pytest.mark.parametrize(
    ("la", "k", "pressure"),
    [(1.1, 1.1, 0.069447), (1.5, 1.5, 0.488176), (2.0, 2.0, 0.806927)],
)
def test_sphere(la: float, k: float, pressure: float) -> None:
    lb = (1 + (la**3 - 1) / k**3) ** (1 / 3)
    closed = 2 / lb + 1 / (2 * lb**4) - 2 / la - 1 / (2 * la**4)
    assert exact.sphere_pressure(la, k) == pytest.approx(closed, rel=1e-10)
    assert closed == pytest.approx(pressure, abs=1e-6)


@pytest.mark.parametrize(
    ("k", "highest", "la"),
    [(1.1, 0.118013, 1.42638), (1.5, 0.493519, 1.60343), (2.0, 0.816424, 1.82815)],
)
def test_sphere_limit(k: float, highest: float, la: float) -> None:
    found = exact.sphere_limit(k)
    assert found == pytest.approx((highest, la), abs=1e-5)


@pytest.mark.parametrize(
    ("jm", "la", "pressure"), [(10, 2.0, 0.657160), (30, 2.3, 0.487715)]
)
def test_gent_sphere(jm: float, la: float, pressure: float) -> None:
    found = exact.sphere_pressure(la, 1.5, exact.gent(jm))
    assert found == pytest.approx(pressure, abs=1e-6)


@pytest.mark.parametrize(("la", "pressure"), [(1.1, 0.094789), (3.0, 0.394639)])
def test_tube(la: float, pressure: float) -> None:
    lb = np.sqrt(1 + (la**2 - 1) / 1.5**2)
    closed = np.log(la / lb) + (lb**-2 - la**-2) / 2
    assert exact.tube_pressure(la, 1.5) == pytest.approx(closed, rel=1e-10)
    assert closed == pytest.approx(pressure, abs=1e-6)


@pytest.mark.parametrize("law", [exact.neo_hookean, exact.gent(10)])
@pytest.mark.parametrize("dimension", [2, 3])
def test_compressible_walls_become_incompressible(dimension: int, law: object) -> None:
    """The boundary-value problem tends to the integral, with 1/K."""
    integral = exact.sphere_pressure if dimension == 3 else exact.tube_pressure
    limit = integral(2.0, 1.5, law)  # type: ignore[arg-type]
    errors = [
        exact.radial(2.0, 1.5, dimension, bulk, law)[0] / limit - 1  # type: ignore[arg-type]
        for bulk in (1e4, 1e5)
    ]
    assert abs(errors[1]) < 5e-5
    assert errors[0] / errors[1] == pytest.approx(10, rel=0.02)


@pytest.mark.parametrize(
    ("angle", "rise", "pressure"),
    [(0.5, 0.255342, 0.077356), (1.25, 0.721484, 0.834753), (2, 1.557408, 1.914546)],
)
def test_strip_membrane(angle: float, rise: float, pressure: float) -> None:
    assert exact.strip_membrane(angle) == pytest.approx((rise, pressure), abs=1e-6)
    stiff = exact.strip_membrane(angle, bulk=1e7)
    assert stiff == pytest.approx((rise, pressure), abs=2e-6)


@pytest.mark.parametrize(
    ("load", "angle", "u", "w"),
    [(0.5, 0.244534, 0.015919, 0.162144), (4, 1.121239, 0.328941, 0.669964)],
)
def test_elastica(load: float, angle: float, u: float, w: float) -> None:
    assert exact.elastica(load) == pytest.approx((angle, u, w), abs=1e-6)


@pytest.mark.parametrize(
    ("load", "angle", "u", "w"),
    [
        (0.5, 0.249481, 0.016519, 0.165043),
        (1, 0.495885, 0.064354, 0.320642),
        (2, 0.968239, 0.232638, 0.573839),
        (4, 1.776436, 0.657254, 0.786168),
    ],
)
def test_follower_end_load(load: float, angle: float, u: float, w: float) -> None:
    assert exact.follower(load, 0.0) == pytest.approx((angle, u, w), abs=1e-6)


@pytest.mark.parametrize(
    ("load", "u", "w"),
    [
        (1, 0.008896, 0.124444),
        (2, 0.035205, 0.245592),
        (4, 0.134987, 0.466023),
        (8, 0.460701, 0.763510),
    ],
)
def test_follower_pressure(load: float, u: float, w: float) -> None:
    assert exact.follower(0.0, load)[1:] == pytest.approx((u, w), abs=1e-6)


@pytest.mark.parametrize(
    ("m", "n", "curvature"), [(1, 1, 1.5), (95 / 140, 1.8, 1.496814)]
)
def test_bilayer(m: float, n: float, curvature: float) -> None:
    """The linear system gives Timoshenko's formula."""
    timoshenko = 6 * (1 + m) ** 2
    timoshenko /= 3 * (1 + m) ** 2 + (1 + m * n) * (m**2 + 1 / (m * n))
    assert exact.bilayer(m, n) == pytest.approx(timoshenko, rel=1e-12)
    assert timoshenko == pytest.approx(curvature, abs=1e-6)


def test_clamped_plate() -> None:
    found = exact.clamped_plate(np.array([0.1, 1, 10, 50, 100]))
    assert found == pytest.approx([0.0385, 0.353, 1.4818, 2.829, 3.639], rel=1e-3)
    specimen = 0.14 * exact.clamped_plate(np.array(SPECIMEN_LOADS))
    table = [0.0302, 0.0559, 0.1084, 0.1599, 0.2213, 0.2627, 0.3219]
    assert specimen == pytest.approx(table, rel=2e-3)
    # A long plate under a small load is a clamped strip: w = p a^4 / (24 D).
    small = exact.clamped_plate(np.array([1e-3]), ratio=6.0)[0]
    assert small == pytest.approx(1e-3 * 12 * (1 - 0.48**2) / 24, rel=1e-3)


@pytest.mark.parametrize(
    ("kind", "stretch", "stress"),
    [
        ("UT", 1.5, 1.120944),
        ("ET", 1.5, 1.648079),
        ("PS", 1.5, 1.293532),
        ("UT", 2.0, 2.1875),
        ("ET", 2.0, 3.987342),
        ("PS", 2.0, 2.419355),
    ],
)
def test_gent_tension(kind: str, stretch: float, stress: float) -> None:
    def w1(x: float) -> float:
        return exact.gent(10)(x) / 2

    assert exact.nominal_stress(kind, stretch, w1, 0.0) == pytest.approx(
        stress, abs=1e-6
    )
