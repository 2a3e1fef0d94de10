"""Strain energies in homogeneous states, against their closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from datagen.materials import (
    Energy,
    Gent,
    Hyperelastic,
    MooneyRivlin,
    NeoHookean,
    Yeoh,
    invariants,
)

from . import closed_forms as exact

Array = np.ndarray

ENERGIES: dict[str, Energy] = {
    "neo-Hookean": NeoHookean(),
    "Gent": Gent(0.1),
    "Yeoh": Yeoh(0.085, 0.0058),
    "Mooney-Rivlin": MooneyRivlin(0.2),
}

SLOPES = {
    "neo-Hookean": (lambda x: 0.5, 0.0),
    "Gent": (lambda x: 0.5 * 10 / (10 - x), 0.0),
    "Yeoh": (lambda x: 0.5 * (1 + 0.17 * x + 0.0174 * x**2), 0.0),
    "Mooney-Rivlin": (lambda x: 0.5, 0.1),
}
"""dW/dI1 over mu as a function of I1 - 3, and dW/dI2 over mu."""

ACROSS = {"UT": (-0.5, -0.5), "ET": (1.0, -2.0), "PS": (0.0, -1.0)}
"""Powers of the stretch in the second and third direction."""

STRETCHES = np.array([0.7, 1.2, 1.5, 2.0, 2.5])


def states(kind: str, stretch: Array) -> Array:
    f = np.zeros((len(stretch), 9))
    f[:, 0] = stretch
    f[:, 4], f[:, 8] = (stretch**power for power in ACROSS[kind])
    return f


def respond(energy: Energy, f: Array, tangent: bool = False) -> tuple[Array, Array]:
    ones, none = np.ones(len(f)), np.zeros((len(f), 0))
    result = Hyperelastic(energy).respond(f, ones, none, 1.0, tangent)
    return result.stress, result.tangent


@pytest.mark.parametrize("kind", ACROSS)
@pytest.mark.parametrize("name", ENERGIES)
def test_tension(name: str, kind: str) -> None:
    """Nominal stress, with the pressure that leaves the third pair of faces free."""
    stretch = STRETCHES if kind != "ET" else STRETCHES[:-1]  # Gent locks at 2.5
    f = states(kind, stretch)
    stress, _ = respond(ENERGIES[name], f)
    nominal = stress[:, 0] - stress[:, 8] * f[:, 8] / f[:, 0]
    w1, w2 = SLOPES[name]
    right = [exact.nominal_stress(kind, float(s), w1, w2) for s in stretch]
    assert nominal == pytest.approx(right, rel=1e-12)
    if kind == "ET":  # the second direction is loaded as the first
        second = stress[:, 4] - stress[:, 8] * f[:, 8] / f[:, 4]
        assert second == pytest.approx(right, rel=1e-12)


@pytest.mark.parametrize("name", ENERGIES)
def test_stress_and_tangent_are_derivatives(name: str) -> None:
    energy = ENERGIES[name]
    rng = np.random.default_rng(3)
    f = np.eye(3).reshape(9) + 0.2 * rng.normal(size=(30, 9))
    f = np.ascontiguousarray(f[np.linalg.det(f.reshape(-1, 3, 3)) > 0.3])
    stress, tangent = respond(energy, f, tangent=True)

    def value(f: Array) -> Array:
        return energy.derivatives(*invariants(f), np.ones(len(f))).w

    for k in range(9):
        step = np.zeros(9)
        step[k] = 1e-6
        slope = (value(f + step) - value(f - step)) / 2e-6
        assert np.allclose(stress[:, k], slope, atol=3e-8)
        column = (respond(energy, f + step)[0] - respond(energy, f - step)[0]) / 2e-6
        assert np.allclose(tangent.reshape(-1, 9, 9)[:, :, k], column, atol=3e-7)


@pytest.mark.parametrize("off", [Gent(), Yeoh(), MooneyRivlin()])
def test_off_is_neo_hookean_to_the_last_bit(off: Energy) -> None:
    f = states("PS", STRETCHES)
    for ours, plain in zip(
        respond(off, f, True), respond(NeoHookean(), f, True), strict=True
    ):
        assert np.array_equal(ours, plain)


def test_gent_has_no_answer_past_its_largest_stretch() -> None:
    f = states("UT", np.array([3.0, 3.6]))  # I1 - 3 is 6.7 and 10.5
    stress, _ = respond(Gent(0.1), f)
    assert np.isfinite(stress[0]).all()
    assert np.isnan(stress[1]).any()
