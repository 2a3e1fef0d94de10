"""Strain energies, moduli and temperature as effects, and energies together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from datagen.continuation import PathFollower
from datagen.device import named_device
from datagen.errors import EffectError
from datagen.materials import (
    Combined,
    Gent,
    Hyperelastic,
    Law,
    LawResult,
    MooneyRivlin,
    NeoHookean,
    Yeoh,
    with_energy,
)
from datagen.mesh import UPPER
from datagen.model import Model
from datagen.problem import lame

from .running import INFLATION, TIP, problem, values

Array = np.ndarray

LOADS = [10e3, 50e3]


@pytest.fixture(scope="module")
def plain() -> Array:
    return values(LOADS)


def nominal(law: Law, stretch: tuple[float, float, float]) -> float:
    """First principal nominal stress at mu = 1 with the third faces free."""
    f = np.diag(stretch).reshape(1, 9)
    stress = law.respond(f, np.ones(1), np.zeros((1, 0)), 1.0, False).stress[0]
    return float(stress[0] - stress[8] * stretch[2] / stretch[0])


@pytest.mark.parametrize(
    ("stretch", "expected"),
    [((2.0, 2**-0.5, 2**-0.5), 2.1875), ((2.0, 2.0, 0.25), 3.987342)],
)
def test_strain_stiffening_is_gents_law_in_both_layers(
    stretch: tuple[float, float, float], expected: float
) -> None:
    """Tables of Jm = 10 in uniaxial and equibiaxial tension at a stretch of 2."""
    for law in problem({"strain_stiffening": {"inverse_limit": 0.1}}).laws:
        assert nominal(law, stretch) == pytest.approx(expected, rel=1e-6)


def test_yeoh_is_a_polynomial_of_the_first_invariant() -> None:
    """Planar tension: P = (l - l^-3) (1 + 2 a x + 3 b x^2) at mu = 1."""
    law, _ = problem({"yeoh": {"second": 0.1, "third": 0.02}}).laws
    stretch, x = 2.0, 2.0**2 + 2.0**-2 - 2
    expected = (stretch - stretch**-3) * (1 + 0.2 * x + 0.06 * x**2)
    assert nominal(law, (2.0, 1.0, 0.5)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("second", [0.05, 0.3])
def test_mooney_changes_the_shape_and_not_the_modulus(second: float) -> None:
    law, _ = problem({"mooney": {"second": second}}).laws
    small = 1 + 1e-6
    slope = nominal(law, (small, small**-0.5, small**-0.5)) / 1e-6
    assert slope == pytest.approx(3.0, rel=1e-5)  # E = 3 mu where J = 1
    c1 = 0.5 / (1 + second)
    both = 2 * (2 - 2**-5) * (c1 + c1 * second * 2**2)
    assert nominal(law, (2.0, 2.0, 0.25)) == pytest.approx(both, rel=1e-12)
    one = 2 * (2 - 2**-2) * (c1 + c1 * second / 2)
    assert nominal(law, (2.0, 2**-0.5, 2**-0.5)) == pytest.approx(one, rel=1e-12)
    assert one < 2 - 2**-2  # softer than neo-Hookean in one direction, stiffer in two
    assert both > 2 - 2**-5


def test_stiffening_of_the_first_invariant_shows_in_inflation(plain: Array) -> None:
    """Nothing at low pressure; at 50 kPa a percent or so less, the tip hardly moves."""
    for active in (
        {"strain_stiffening": {"inverse_limit": 0.2}},
        {"yeoh": {"second": 0.1, "third": 0.006}},
    ):
        change = values(LOADS, active) / plain - 1
        assert -2e-3 < change[0, INFLATION] < 0
        assert -2.5e-2 < change[1, INFLATION] < -4e-3
        moved = (change * plain)[1, TIP]
        assert abs(moved) < 1e-6


def test_the_second_invariant_shows_at_the_tip(plain: Array) -> None:
    change = values(LOADS, {"mooney": {"second": 0.2}}) - plain
    assert change[1, TIP] > plain[1, TIP]  # more than 100 %
    assert abs(change[1, INFLATION]) < 5e-3 * plain[1, INFLATION]


def test_a_common_modulus_factor_is_a_scale_of_pressure() -> None:
    pressure = np.array([8e3, 24e3, 40e3])
    factored = values(list(pressure), {"modulus_bias": {"common": 0.8}})
    stated = values(list(pressure / 0.8))
    scale = np.abs(stated).max(axis=0)
    assert (np.abs(factored - stated) / scale).max() < 1e-6


def test_the_ratio_goes_to_the_layers_and_keeps_their_mean() -> None:
    design = named_device()
    biased = problem({"modulus_bias": {"common": 0.9, "ratio": 1.44}})
    roof = biased.mesh.layer == UPPER
    for chosen, modulus, factor in (
        (roof, design.upper_modulus, 0.9 * 1.2),
        (~roof, design.lower_modulus, 0.9 / 1.2),
    ):
        shear, bulk = lame(np.array(modulus * factor))
        assert biased.shear_modulus[chosen] == pytest.approx(float(shear), rel=1e-12)
        assert biased.bulk_modulus[chosen] == pytest.approx(float(bulk), rel=1e-12)


def test_moduli_of_two_effects_multiply() -> None:
    both = {"modulus_bias": {"common": 0.9}, "temperature": {"change": 50.0}}
    share = problem(both).shear_modulus / problem().shear_modulus
    assert share == pytest.approx(0.9 * 1.06, rel=1e-12)


def test_a_free_strip_expands_with_temperature_without_stress() -> None:
    warm = problem({"temperature": {"change": 50.0}})
    nodes = warm.mesh.nodes
    held = np.zeros_like(warm.fixed)
    held[warm.mesh.mid_plane, 1] = True
    row = warm.mesh.lines["bottom"]
    held[row[0]] = True
    held[row[-1], 2] = True
    follower = PathFollower(replace(warm, fixed=held))
    assert follower.point.x == pytest.approx(nodes * 1.015, rel=1e-9, abs=1e-13)
    stress = follower.equations.stress(follower.point.x)
    assert np.abs(stress).max() < 1e-9 * warm.shear_modulus.min()


def test_warmth_stiffens_and_the_clamp_stays(plain: Array) -> None:
    warm = values([0.0, *LOADS], {"temperature": {"change": 40.0}})
    # Both layers grow alike; the clamp, which does not, bends the strip a little.
    assert np.abs(warm[0, INFLATION]) < 1e-6
    assert np.abs(warm[0, TIP]) < 2e-2 * 0.012 * named_device().length
    assert (warm[1:, INFLATION] < plain[:, INFLATION]).all()
    grown = problem(
        {"temperature": {"change": 40.0}, "cure_mismatch": {"difference": 0.01}}
    )
    assert grown.growth is not None
    roof = grown.growth[grown.mesh.layer == UPPER]
    assert roof == pytest.approx(np.tile(1.01 * 1.012 * np.eye(3), (len(roof), 1, 1)))


# -- energies together -----------------------------------------------------------------


@dataclass(frozen=True)
class Halved:
    """A law around another one, as those with history are."""

    law: Law
    history_size: int = 0

    def respond(
        self, f: Array, mu: Array, history: Array, dt: float, tangent: bool
    ) -> LawResult:
        inner = self.law.respond(f, mu, history, dt, tangent)
        return LawResult(inner.stress / 2, inner.tangent / 2, inner.history)


def test_departures_from_the_neo_hookean_law_add_up() -> None:
    i1, i2 = np.linspace(3, 6, 5), np.linspace(3, 8, 5)
    mu = np.linspace(1.0, 2.0, 5)
    parts = Gent(0.1), MooneyRivlin.of_ratio(0.2), Yeoh(0.1, 0.01)
    whole = Combined(parts).derivatives(i1, i2, mu)
    base = NeoHookean().derivatives(i1, i2, mu)
    for k, found in enumerate(whole):
        each = sum(part.derivatives(i1, i2, mu)[k] - base[k] for part in parts)
        assert found == pytest.approx(base[k] + each, rel=1e-13, abs=1e-13)


def test_energies_combine_whatever_the_order_of_naming() -> None:
    active = {
        "yeoh": {"second": 0.1},
        "strain_stiffening": {"inverse_limit": 0.1},
        "mooney": {"second": 0.2},
    }
    backwards = dict(reversed(active.items()))
    one, other = problem(active), problem(backwards)
    assert one.laws == other.laws
    names = [e.name for e in Model(tuple(active)).active]
    assert names == sorted(active)
    assert one.laws[0] == Hyperelastic(
        Combined((MooneyRivlin.of_ratio(0.2), Gent(0.1), Yeoh(0.1)))
    )


def test_two_energies_act_together_in_a_device(plain: Array) -> None:
    gent = {"strain_stiffening": {"inverse_limit": 0.2}}
    mooney = {"mooney": {"second": 0.1}}
    both = values(LOADS, gent | mooney) - plain
    alone = values(LOADS, gent) + values(LOADS, mooney) - 2 * plain
    scale = np.abs(both).max(axis=0)
    assert (np.abs(both - alone) / scale)[:, [TIP, INFLATION]].max() < 0.1


def test_an_energy_reaches_the_law_inside_others() -> None:
    law = with_energy(Halved(Halved(Hyperelastic())), Gent(0.1))
    assert law == Halved(Halved(Hyperelastic(Gent(0.1))))
    stretch = (2.0, 2**-0.5, 2**-0.5)
    assert nominal(law, stretch) == pytest.approx(2.1875 / 4, rel=1e-6)


def test_a_law_without_an_energy_is_refused() -> None:
    @dataclass(frozen=True)
    class Own:
        history_size: int = 0

    with pytest.raises(EffectError, match=r"law Own: .*allowed: Hyperelastic"):
        with_energy(Own(), Gent(0.1))  # type: ignore[arg-type]
