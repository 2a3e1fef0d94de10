"""Laws with a memory: tables, derivatives, and paths that load and unload."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from datagen.continuation import PathFollower
from datagen.control import Options
from datagen.device import named_device
from datagen.history import Mullins, Viscoelastic, convolve
from datagen.levels import mesh_level
from datagen.materials import Gent, Hyperelastic, Law, MooneyRivlin
from datagen.model import Model
from datagen.problem import Problem, baseline
from datagen.response import Path, Response
from datagen.solver import solve

Array = np.ndarray
KPA = 1e3
INFLATION, VOLUME = 2, 4


# -- laws at a point -------------------------------------------------------------------


def uniaxial(stretch: float) -> Array:
    f = np.zeros((1, 9))
    f[0, 0], f[0, 4], f[0, 8] = stretch, stretch**-0.5, stretch**-0.5
    return f


def nominal(stress: Array, stretch: float) -> float:
    """Nominal stress with the pressure that leaves the sides free."""
    return float(stress[0, 0] - stress[0, 4] * stretch**-1.5)


def drawn(law: Law, stretches: Array, dt: float) -> list[float]:
    """Nominal stresses along a uniaxial path, mu = 1."""
    history, found = np.zeros((1, law.history_size)), []
    for stretch in stretches:
        result = law.respond(uniaxial(stretch), np.ones(1), history, dt, False)
        history = result.history
        found.append(nominal(result.stress, stretch))
    return found


@pytest.mark.parametrize(
    ("time", "wanted"), [(1, 0.099922), (10, 0.06336), (100, 8.306e-3)]
)
def test_convolution_of_a_ramp_in_stretch(time: float, wanted: float) -> None:
    """beta .1, tau 10; the nominal stress of a bar drawn to stretch 1.5 in `time`."""
    steps = 400
    stretch = 1 + 0.5 * np.arange(steps + 1) / steps
    stress = stretch - stretch**-2
    assert stress[-1] == pytest.approx(1.055556, abs=1e-6)
    memory = np.zeros(1)
    for old, new in pairwise(stress):
        memory = convolve(memory, new - old, 0.1, time / steps / 10)
    assert memory[0] == pytest.approx(wanted, abs=1.5e-6)


@pytest.mark.parametrize("time", [1.0, 10.0, 100.0])
def test_viscoelastic_ramp(time: float) -> None:
    """Overstress of the three-dimensional law against its convolution integral.

    S_iso = mu (I - I1/3 C^-1); the free sides turn the memories H into the nominal
    overstress l H_11 - l^-2 H_22.
    """

    def integral(slope: Callable[[float], float]) -> float:
        def rate(t: float) -> float:
            return 0.1 * np.exp((t - time) / 10) * slope(1 + t / time / 2) / time / 2

        return float(quad(rate, 0, time)[0])

    along = integral(lambda s: 2 * s**-4)  # d/dl of 1 - (l^2 + 2/l) / (3 l^2), and
    across = integral(lambda s: -(s**2))  # of 1 - (l^2 + 2/l) l / 3
    law = Viscoelastic(Hyperelastic(), (0.1,), (10.0,))
    steps = 1000
    stretches = 1 + 0.5 * np.arange(1, steps + 1) / steps
    over = drawn(law, stretches, time / steps)[-1] - (1.5 - 1.5**-2)
    assert over == pytest.approx(1.5 * along - across / 1.5**2, rel=2e-5)


def test_viscoelastic_stress_fades_to_that_of_slow_loading() -> None:
    law = Viscoelastic(Hyperelastic(), (0.05, 0.02), (1.0, 10.0))
    history = np.zeros((1, law.history_size))
    f, mu = uniaxial(1.5), np.ones(1)
    base = 1.5 - 1.5**-2
    at_once = law.respond(f, mu, history, 0.0, False)
    assert nominal(at_once.stress, 1.5) == pytest.approx(1.07 * base, rel=1e-12)
    later = law.respond(f, mu, at_once.history, 10.0, False)
    left = 0.05 * np.exp(-10) + 0.02 * np.exp(-1)
    assert nominal(later.stress, 1.5) == pytest.approx((1 + left) * base, rel=1e-12)


def test_ogden_roxburgh_unloading() -> None:
    """Neo-Hookean mu = 1, largest stretch 2, r 1.5, m 0.5, b 0."""
    law = Mullins(Hyperelastic(), 1 / 1.5, 0.5)
    path = np.array([1.5, 2.0, 1.95, 1.8, 1.5, 1.2, 1.5, 2.0, 2.1])
    found = drawn(law, path, 1.0)
    virgin = path - path**-2
    assert found[:2] == pytest.approx(virgin[:2], rel=1e-12)
    table = [1.471044, 0.853845, 0.383608, 0.171018]
    assert found[2:6] == pytest.approx(table, abs=1e-6)
    assert found[6] == pytest.approx(found[4], rel=1e-12)  # reloads as it unloaded
    assert found[7:] == pytest.approx(virgin[7:], rel=1e-12)


def laws() -> dict[str, Law]:
    stiff = Hyperelastic(Gent(0.1))
    softened = Mullins(Hyperelastic(MooneyRivlin(0.2)), 0.6, 0.3)
    return {
        "viscoelastic": Viscoelastic(stiff, (0.05, 0.03), (1.0, 20.0)),
        "Mullins": softened,
        "both": Viscoelastic(softened, (0.05,), (3.0,)),
    }


def gradients(seed: int) -> Array:
    f = np.eye(3).reshape(9) + 0.15 * np.random.default_rng(seed).normal(size=(30, 9))
    return np.ascontiguousarray(f)


@pytest.mark.parametrize("name", laws())
def test_tangents_are_derivatives_in_the_middle_of_a_history(name: str) -> None:
    law, mu = laws()[name], np.linspace(0.5, 2.0, 30)
    before = law.respond(gradients(1), mu, np.zeros((30, law.history_size)), 0.7, False)
    f = gradients(2)
    result = law.respond(f, mu, before.history, 0.4, True)
    plain = law.respond(f, mu, np.zeros_like(before.history), 0.4, False)
    assert np.abs(result.stress - plain.stress).max() > 1e-3  # the history matters
    for k in range(9):
        step = np.zeros(9)
        step[k] = 1e-6
        ahead, behind = (
            law.respond(f + side * step, mu, before.history, 0.4, False).stress
            for side in (1, -1)
        )
        column = (ahead - behind) / 2e-6
        assert np.allclose(result.tangent.reshape(-1, 9, 9)[:, :, k], column, atol=1e-6)
    assert np.allclose(
        result.tangent.reshape(-1, 9, 9),
        result.tangent.reshape(-1, 9, 9).swapaxes(1, 2),
    )


@pytest.mark.parametrize("name", laws())
def test_a_rotation_between_two_steps_only_turns_the_stress(name: str) -> None:
    law, mu = laws()[name], np.ones(30)
    before = law.respond(gradients(1), mu, np.zeros((30, law.history_size)), 0.7, False)
    q = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    q *= np.sign(np.linalg.det(q))
    f = gradients(2)
    turned = np.ascontiguousarray((q @ f.reshape(-1, 3, 3)).reshape(-1, 9))
    plain = law.respond(f, mu, before.history, 0.4, False)
    rotated = law.respond(turned, mu, before.history, 0.4, False)
    wanted = q @ plain.stress.reshape(-1, 3, 3)
    assert np.allclose(rotated.stress.reshape(-1, 3, 3), wanted, atol=1e-12)
    assert np.allclose(rotated.history, plain.history, atol=1e-12)


def test_a_virgin_softening_law_is_the_law_without_it_to_the_last_bit() -> None:
    base, mu = Hyperelastic(Gent(0.1)), np.ones(30)
    plain = base.respond(gradients(2), mu, np.zeros((30, 0)), 1.0, True)
    law = Mullins(base, 0.6, 0.3)
    virgin = law.respond(gradients(2), mu, np.zeros((30, 1)), 1.0, True)
    assert np.array_equal(virgin.stress, plain.stress)
    assert np.array_equal(virgin.tangent, plain.tangent)


# -- paths of a device -----------------------------------------------------------------

SOFT = {"mullins": {"softening": 0.5, "scale": 0.2}}
SLOW = {"viscoelasticity": {"beta_1": 0.03, "beta_10": 0.03}}


def follow(
    pressure: list[float],
    effects: dict[str, dict[str, float]],
    time: Array | None = None,
    sensitivities: bool = False,
) -> Response:
    path = Path(np.array(pressure) * KPA, time)
    model = Model(tuple(effects), "draft", effects)
    response = model([named_device()], [path], sensitivities)
    assert response.path_status == ("completed",), response.message
    return response


def test_the_baseline_unloads_along_its_loading_path() -> None:
    """Also in steps back onto the very points of the way up."""
    up = [5.0, 6.0, 7.0, 20.0, 40.0]
    values = follow([*up, *up[-2::-1], 0.0], {}).values[0]
    scale = np.abs(values).max(axis=0)
    assert np.allclose(values[5:9] / scale, values[3::-1] / scale, atol=1e-7)
    assert np.abs(values[9] / scale).max() < 1e-7


def test_no_step_is_lost_where_the_pressure_turns() -> None:
    """The way back meets the points of the way up, no distance apart."""
    follower = PathFollower(baseline(named_device(), mesh_level("draft")))
    outcome = follower.run(np.array([20, 21, 20, 19, 18]) * KPA)
    assert outcome.status == "completed"
    assert follower.counters.rejected == 0


def test_softening_unloads_lower_and_reloads_as_it_unloaded() -> None:
    cycle = [15.0, 40.0, 15.0, 0.0]
    values = follow([*cycle, *cycle, 55.0], SOFT).values[0]
    plain = follow([15.0, 40.0, 55.0], {}).values[0]
    volume = values[:, VOLUME]
    # The same pressure holds a larger volume: lower pressure at the same volume.
    assert volume[2] > 1.02 * volume[0]
    assert volume[4] == pytest.approx(volume[2], rel=1e-4)  # second loading
    assert volume[6] == pytest.approx(volume[2], rel=1e-4)  # second unloading
    assert abs(volume[3] / volume[1]) < 1e-5  # nothing is left at rest
    # Almost every point loads all the way up; beyond the first cycle again.
    assert volume[[0, 1, 8]] == pytest.approx(plain[:, VOLUME], rel=2e-3)


def test_softening_does_not_depend_on_rate() -> None:
    cycle = [20.0, 40.0, 20.0]
    quick = follow(cycle, SOFT).values
    slow = follow(cycle, SOFT, np.array([100.0, 300.0, 500.0])).values
    assert np.allclose(quick, slow, rtol=1e-9)


def test_a_viscoelastic_loop_closes_on_rest() -> None:
    # Small load steps, so that both cycles are followed in the same steps: from one
    # step to another the convolution changes by its error in time.
    up = [0.5, 1.0, 2.0, 3.5, 5.0, 7.0, 9.0, 14.0, 20.0]
    cycle = [*up, *up[-2::-1], 0.0, 0.0]
    clock = np.append(np.arange(1.0, len(cycle)), 300.0)
    values = follow([*cycle, *cycle], SLOW, np.concatenate([clock, clock + 300])).values
    inflation = values[0, :, INFLATION]
    plain = follow(up, {}).values[0, :, INFLATION]
    assert (inflation[:9] < 0.995 * plain).all()  # not there yet
    assert (inflation[9:17] > 1.005 * inflation[7::-1]).all()  # the loop
    assert inflation[17] > 1e-6  # 1 um and more is left when the pressure is gone
    assert abs(inflation[18]) < 1e-10  # and nothing after minutes
    scale = np.abs(values[0]).max(axis=0)
    assert (np.abs(values[0, 19:] - values[0, :19]) < 1e-5 * scale).all()


def test_the_follower_takes_time_in_steps_that_are_short_enough() -> None:
    """Against a load step in sixteen parts; the tip is the most sensitive of all."""
    path = Path(np.array([10.0, 20.0, 40.0, 20.0]) * KPA)
    model = Model(tuple(SLOW), "draft", SLOW)
    coarse, fine = (
        solve(model.problem(named_device()), path, options=options).values[0]
        for options in (Options(), Options(fading_parts=16))
    )
    scale = np.abs(fine).max(axis=0)
    assert (np.abs(coarse - fine).max(axis=0) < 1e-3 * scale).all()


def test_creep_at_held_pressure_ends_where_slow_loading_does() -> None:
    held = follow([40.0, 40.0, 40.0, 40.0], SLOW, np.array([1.0, 3.0, 20.0, 500.0]))
    inflation = held.values[0, :, INFLATION]
    assert (np.diff(inflation) > 1e-7).all()
    plain = follow([40.0], {}).values[0, -1]
    assert np.allclose(held.values[0, -1], plain, rtol=1e-6)
    slow = follow([40.0], SLOW, np.array([1e6]))
    assert np.allclose(slow.values[0, -1], plain, rtol=1e-5)


@pytest.mark.parametrize(
    ("effect", "parameter", "step"),
    [("viscoelasticity", "beta_10", 1e-3), ("mullins", "softening", 1e-2)],
)
def test_derivatives_at_off_follow_the_history(
    effect: str, parameter: str, step: float
) -> None:
    cycle = [5.0, 12.0, 20.0, 30.0, 20.0, 12.0, 12.0]
    found = follow(cycle, {effect: {}}, sensitivities=True)
    assert found.jacobian is not None
    column = found.parameters.index(f"{effect}.{parameter}")
    moved = follow(cycle, {effect: {parameter: step}}).values
    wanted = (moved - found.values) / step
    scale = np.abs(wanted).max(axis=(0, 1))
    error = np.abs(found.jacobian[..., column] - wanted).max(axis=(0, 1)) / scale
    assert (scale[[INFLATION, VOLUME]] > 0).all()
    assert error.max() < 0.03  # of the step: one-sided and finite


def test_derivatives_at_off_look_between_the_points_of_the_path() -> None:
    """A memory in directions alone costs no equilibrium; of second order in time."""
    path, device = Path(np.array([10.0, 20.0, 10.0]) * KPA), named_device()

    def problem(share: float) -> Problem:
        shares = {"beta_1": share}
        model = Model(("viscoelasticity",), "draft", {"viscoelasticity": shares})
        return model.problem(device)

    model, step = Model(("viscoelasticity",), "draft"), 1e-3
    directions = model.directions(device, ("viscoelasticity.beta_1",))
    plain = solve(problem(0.0), path)
    fine = Options(fading_parts=16)
    once, twice = (solve(problem(k * step), path, options=fine) for k in (1, 2))
    wanted = (4 * once.values - twice.values - 3 * plain.values) / (2 * step)
    errors = []
    for parts in (1, 2, 4):
        options = Options(fading_parts=parts)
        found = solve(problem(0.0), path, options=options, directions=directions)
        assert found.info["steps"] == plain.info["steps"]
        assert found.jacobian is not None
        apart = np.abs(found.jacobian[..., 0] - wanted).max(axis=(0, 1))
        errors.append(float((apart / np.abs(wanted).max(axis=(0, 1))).max()))
    assert errors[2] < 0.005, errors
    assert all(late < early / 2 for early, late in pairwise(errors)), errors
