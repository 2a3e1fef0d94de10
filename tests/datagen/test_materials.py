"""Strain energies: derivatives, frame indifference, tables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from datagen.materials import EnergyDerivatives, Hyperelastic, NeoHookean, invariants

Array = np.ndarray


@dataclass(frozen=True)
class Everything:
    """An energy in which every derivative is different from zero."""

    def energy(self, i1: Array, i2: Array, mu: Array) -> Array:
        a, b = i1 - 3, i2 - 3
        return mu * (0.5 * a + 0.2 * b + 0.1 * a**2 + 0.07 * a * b + 0.05 * b**2)

    def derivatives(self, i1: Array, i2: Array, mu: Array) -> EnergyDerivatives:
        a, b = i1 - 3, i2 - 3
        one = np.ones_like(i1)
        return EnergyDerivatives(
            self.energy(i1, i2, mu),
            mu * (0.5 + 0.2 * a + 0.07 * b),
            mu * (0.2 + 0.07 * a + 0.1 * b),
            0.2 * mu * one,
            0.07 * mu * one,
            0.1 * mu * one,
        )


@pytest.fixture
def gradients() -> Array:
    rng = np.random.default_rng(3)
    f = np.eye(3).reshape(9) + 0.25 * rng.normal(size=(40, 9))
    keep = np.linalg.det(f.reshape(-1, 3, 3)) > 0.2
    return np.ascontiguousarray(f[keep])


LAWS = [Hyperelastic(), Hyperelastic(Everything())]


@pytest.mark.parametrize("law", LAWS, ids=["neo-Hookean", "general"])
def test_stress_and_tangent_are_derivatives_of_the_energy(
    law: Hyperelastic, gradients: Array
) -> None:
    n = len(gradients)
    mu = np.linspace(0.5, 2.0, n)

    def energy(f: Array) -> Array:
        return law.energy.derivatives(*invariants(f), mu).w

    def stress(f: Array) -> Array:
        return law.respond(f, mu, np.zeros((n, 0)), 1.0, False).stress

    result = law.respond(gradients, mu, np.zeros((n, 0)), 1.0, True)
    h = 1e-6
    for k in range(9):
        step = np.zeros(9)
        step[k] = h
        slope = (energy(gradients + step) - energy(gradients - step)) / (2 * h)
        assert np.allclose(result.stress[:, k], slope, atol=2e-8)
        column = (stress(gradients + step) - stress(gradients - step)) / (2 * h)
        assert np.allclose(result.tangent.reshape(n, 9, 9)[:, :, k], column, atol=2e-7)


@pytest.mark.parametrize("law", LAWS, ids=["neo-Hookean", "general"])
def test_rotation_turns_the_stress_along(law: Hyperelastic, gradients: Array) -> None:
    n = len(gradients)
    mu, none = np.ones(n), np.zeros((n, 0))
    q = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    q *= np.sign(np.linalg.det(q))
    turned = np.ascontiguousarray((q @ gradients.reshape(-1, 3, 3)).reshape(-1, 9))
    plain = law.respond(gradients, mu, none, 1.0, False).stress.reshape(-1, 3, 3)
    rotated = law.respond(turned, mu, none, 1.0, False).stress.reshape(-1, 3, 3)
    assert np.allclose(rotated, q @ plain, atol=1e-12)


def test_pure_dilatation_has_no_isochoric_energy() -> None:
    f = np.ascontiguousarray(np.array([0.7, 1.0, 1.6])[:, None] * np.eye(3).reshape(9))
    i1, i2 = invariants(f)
    assert np.allclose(i1, 3)
    assert np.allclose(i2, 3)
    result = Hyperelastic().respond(f, np.ones(3), np.zeros((3, 0)), 1.0, False)
    assert np.abs(result.stress).max() < 1e-14


def test_simple_tension_of_the_neo_hookean_law() -> None:
    """Nominal stress mu (l - l^-2) of an incompressible bar."""
    stretch = np.array([1.2, 1.5, 2.0, 3.0])
    f = np.zeros((4, 9))
    f[:, 0], f[:, 4], f[:, 8] = stretch, stretch**-0.5, stretch**-0.5
    p = Hyperelastic(NeoHookean()).respond(f, np.ones(4), np.zeros((4, 0)), 1.0, False)
    side = p.stress[:, 4] * f[:, 4]  # the pressure that frees the side faces
    nominal = p.stress[:, 0] - side / stretch
    assert np.allclose(nominal, stretch - stretch**-2.0, rtol=1e-12)
