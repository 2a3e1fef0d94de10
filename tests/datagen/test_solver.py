"""Paths of the whole model: the published device, limit points, statuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from datagen.continuation import PathFollower
from datagen.control import Options
from datagen.device import Design, named_device
from datagen.equilibrium import Workspace
from datagen.errors import EffectError, InputError
from datagen.levels import mesh_level
from datagen.model import Model, stack
from datagen.pardiso import mkl_library
from datagen.problem import baseline
from datagen.response import CONVERGED, OUTPUT_NAMES, Path
from datagen.solver import solve
from docs import refine

UM = 1e-6
KPA = 1e3


@pytest.fixture(scope="module")
def draft() -> Model:
    return Model(level="draft")


@pytest.fixture
def soft() -> Design:
    """A thin soft roof: its path turns at a few kilopascal."""
    return named_device("S1").with_values(
        upper_thickness=40e-6, upper_modulus=0.8e6, balloon_width=1.6e-3
    )


@pytest.mark.parametrize("case", [1, 2, 3, 4])
def test_s1_at_the_standard_mesh(case: int) -> None:
    """The mesh level's bars against the settled answer (docs/refinement.md)."""
    pressure = np.array(refine.PRESSURES) * KPA
    response = Model()([named_device("S1", case)], [Path(pressure)])
    assert response.path_status == ("completed",)
    tip = response.output("tip_deflection")[0] / UM
    inflation = response.output("inflation")[0] / UM
    for found, quantity, share in ((tip, "tip", 0.02), (inflation, "inflation", 0.005)):
        settled, _ = refine.settled(refine.known(), case, quantity)
        assert np.abs(found - settled).max() < share * np.abs(settled).max()


def test_all_cases_tip_up_at_low_pressure_and_as_published_at_high(
    draft: Model,
) -> None:
    devices = [named_device("S1", case) for case in (1, 2, 3, 4)]
    response = draft(devices, [Path(np.array([20, 100]) * KPA)] * 4)
    tip = response.output("tip_deflection")
    assert (tip[:, 0] > 0).all()
    assert tip[0, 1] < -80 * UM
    assert tip[1, 1] > 140 * UM
    assert tip[2, 1] > 0
    assert tip[3, 1] < 0


def test_zero_pressure_gives_zero_and_unloading_comes_back(draft: Model) -> None:
    path = Path(np.array([0, 20, 40, 20, 0]) * KPA)
    response = draft([named_device()], [path])
    values = response.values[0]
    assert np.abs(values[0]).max() < 1e-12
    assert np.allclose(values[3], values[1], rtol=1e-6, atol=1e-12)
    assert np.abs(values[4] / values[2]).max() < 1e-6


def test_only_pressure_over_modulus_matters(draft: Model) -> None:
    stiff = named_device("S1", 1)
    soft = stiff.with_values(upper_modulus=1.25e6, lower_modulus=2.25e6)
    path = np.array([10, 30]) * KPA
    a = draft([stiff], [Path(path)])
    b = draft([soft], [Path(path / 2)])
    assert np.allclose(a.values, b.values, rtol=1e-7, atol=1e-14)


def test_lengths_scale(draft: Model) -> None:
    small = named_device("S1", 1)
    names = ("length", "width", "balloon_length", "balloon_width", "balloon_start")
    names += ("wall", "cavity_height", "upper_thickness", "lower_thickness")
    large = small.with_values(**{name: 2 * getattr(small, name) for name in names})
    path = [Path(np.array([30]) * KPA)]
    a, b = draft([small], path), draft([large], path)
    powers = {"tip_deflection": 1, "bending_angle": 0, "inflation": 1}
    powers |= {"inflation_lower": 1, "cavity_volume": 3}
    for name, power in powers.items():
        assert b.output(name) == pytest.approx(2**power * a.output(name), rel=1e-6)


def test_path_ends_at_its_limit_point_and_keeps_what_it_has(
    draft: Model, soft: Design
) -> None:
    pressure = np.linspace(2, 60, 12) * KPA
    response = draft([soft], [Path(pressure)])
    assert response.path_status == ("limit_point",)
    limit = response.limit_pressure[0]
    reached = pressure < limit
    assert 0 < reached.sum() < 12
    assert np.isfinite(response.values[0, reached]).all()
    assert np.isnan(response.values[0, ~reached]).all()
    assert set(response.status[0, reached]) == {CONVERGED}
    assert set(response.status[0, ~reached]) == {"limit_point"}
    assert f"{limit / KPA:.4g} kPa" in response.message[0]


def test_limit_pressure_does_not_depend_on_the_steps(soft: Design) -> None:
    problem = baseline(soft, mesh_level("draft"))
    limits = []
    for pressures in ([60.0], [4.0, 8.0, 60.0]):
        follower = PathFollower(problem)
        follower.run(np.array(pressures) * KPA)
        assert follower.limit is not None
        limits.append(follower.limit.pressure)
        after = follower.point  # the point past the limit: lower, and unstable
        assert after.pressure < follower.limit.pressure
        assert after.volume > follower.limit.volume
        assert after.negative == 1
    assert limits[0] == pytest.approx(limits[1], rel=1e-4)


def test_exploring_keeps_every_step_and_ends_at_the_top(
    draft: Model, soft: Design
) -> None:
    tall = draft.explore(named_device(), 60 * KPA)
    assert tall.path_status == ("completed",)
    assert tall.pressure[0, -1] == 60 * KPA
    assert tall.pressure.shape[1] >= 10
    assert (np.diff(tall.pressure[0]) > 0).all()
    short = draft.explore(soft)
    assert short.path_status == ("limit_point",)
    assert short.pressure[0].max() == pytest.approx(short.limit_pressure[0], rel=1e-9)


def test_a_path_goes_on_past_its_limit_point(draft: Model) -> None:
    """The published device of half the stiffness: its pressure falls, it bends on."""
    soft = named_device().with_values(upper_modulus=1.25e6, lower_modulus=2.25e6)
    response = draft.explore(soft, beyond=True)
    limit = response.limit_pressure[0]
    assert response.path_status == ("limit_point",)
    assert f"turns at {limit / KPA:.4g} kPa; followed beyond" in response.message[0]
    top = int(np.argmax(response.pressure[0]))
    assert response.pressure[0, top] == limit
    assert set(response.status[0]) == {CONVERGED}
    after = response.pressure[0, top:]
    assert len(after) > 10
    assert (np.diff(after) < 0).all()
    assert after[-1] < limit / 2
    assert (np.diff(response.output("cavity_volume")[0, top:]) > 0).all()
    assert np.abs(response.output("bending_angle")[0, -1]) >= np.radians(120)
    plain = draft.explore(soft)
    assert plain.limit_pressure[0] == pytest.approx(limit, rel=1e-6)


def test_balloons_that_part_ways_end_a_path() -> None:
    """Four balloons that lose their stability one after the other just below the top.

    The path stops there at once; followed with ever smaller steps it turns at the same
    pressure.
    """
    # Where balloons give way nearer to the top, rounding decides which comes first;
    # here it is the same for layers 1 % thinner or thicker.
    strip = Design(
        length=10.12e-3,
        width=2.2e-3,
        balloon_length=7.545e-3,
        balloon_width=0.72e-3,
        balloon_start=0.93e-3,
        wall=0.453e-3,
        divisions_x=4,
        divisions_y=1,
        cavity_height=114e-6,
        upper_thickness=140.6e-6,
        lower_thickness=127.7e-6,
        upper_modulus=3.6e6,
        lower_modulus=1.11e6,
    )
    problem = baseline(strip, mesh_level("draft"))
    short, long = PathFollower(problem), PathFollower(problem)
    ended = short.run(np.array([150.0]) * KPA)
    turned = long.run(np.array([150.0]) * KPA, far_enough=lambda point: True)
    assert ended.status == turned.status == "limit_point"
    assert "stability is lost at" in ended.message
    assert "turns at" in turned.message
    assert short.limit is not None and long.limit is not None
    assert short.limit.pressure == pytest.approx(long.limit.pressure, rel=2e-4)
    assert short.counters.factorisations < long.counters.factorisations


def test_explored_steps_are_the_exact_equilibria(draft: Model) -> None:
    explored = draft.explore(named_device("D8-2x1"), 40 * KPA)
    pressure = explored.pressure[0, ::3]
    again = draft([named_device("D8-2x1")], [Path(pressure)])
    assert np.allclose(again.values[0], explored.values[0, ::3], rtol=1e-6, atol=1e-13)


def test_touching_roof_and_floor_stops_the_path(draft: Model) -> None:
    flat = named_device().with_values(cavity_height=30e-6)
    response = draft([flat], [Path(np.array([-0.5, -1, -2, -5, -20]) * KPA)])
    assert response.path_status == ("contact",)
    assert "roof and floor touch" in response.message[0]
    assert np.isfinite(response.values[0, 0]).all()
    assert np.isnan(response.values[0, -1]).all()
    assert response.output("cavity_volume")[0, 0] < 0


def test_the_pressure_of_contact_is_no_matter_of_the_steps(draft: Model) -> None:
    flat = named_device().with_values(cavity_height=30e-6)

    def said(pressures: list[float]) -> float:
        response = draft([flat], [Path(np.array(pressures))])
        assert response.path_status == ("contact",)
        return float(response.message[0].split()[-2]) * KPA

    coarse, fine = said([-20e3]), said([-10.0 * i for i in range(1, 2001)])
    assert coarse == pytest.approx(fine, rel=0.02)


def test_a_cavity_that_closes_at_rest_has_no_values() -> None:
    """Weight or an offset of the supply close it without a change of the gauge."""
    flat = named_device().with_values(
        cavity_height=5e-6,
        upper_thickness=40e-6,
        balloon_width=4e-3,
        width=5e-3,
        upper_modulus=0.8e6,
    )
    weight = {"self_weight": {"density": 1000.0, "orientation": 0.0}}
    heavy = Model(effects=("self_weight",), level="draft", parameters=weight)
    response = heavy([flat], [Path(np.array([0.0, 200.0]))])
    assert response.path_status == ("contact",)
    assert "touch at 0 kPa" in response.message[0]
    assert np.isnan(response.values).all()


def test_wanted_steps_are_among_the_explored_ones(draft: Model) -> None:
    wanted = np.array([0.0, 5.0, 20.0, 12.0]) * KPA
    found = draft.explore(named_device("D8-2x1"), wanted, beyond=True)
    assert found.path_status == ("completed",)
    steps = found.pressure[0]
    at = [int(np.argmin(np.abs(steps - one))) for one in wanted]
    assert np.allclose(steps[at], wanted, atol=1e-6)
    assert at == sorted(at)
    assert len(steps) > len(wanted)


def test_too_many_steps_are_said(soft: Design) -> None:
    problem = baseline(soft, mesh_level("draft"))
    few = solve(problem, Path(np.array([60e3])), options=Options(max_steps=3))
    assert few.path_status == ("step_limit",)
    assert "3 steps" in few.message[0]


def test_many_load_steps_are_not_too_many_steps(soft: Design) -> None:
    problem = baseline(soft, mesh_level("draft"))
    path = Path(np.linspace(0.5e3, 6e3, 12))
    every = solve(problem, path, options=Options(max_steps=8))
    assert every.path_status == ("completed",)


def test_hopeless_steps_are_said() -> None:
    problem = baseline(named_device(), mesh_level("draft"))
    options = Options(iterations=1, smallest_step=0.2)
    with_one = solve(problem, Path(np.array([60e3])), options=options)
    assert with_one.path_status == ("step_too_small",)
    assert np.isnan(with_one.values).all()


@pytest.mark.skipif(mkl_library() is None, reason="no MKL wheel on this machine")
def test_superlu_gives_the_same_path() -> None:
    path = [Path(np.array([10, 40]) * KPA)]
    a = Model(level="draft", backend="pardiso")([named_device()], path)
    b = Model(level="draft", backend="superlu")([named_device()], path)
    scale = np.nanmax(np.abs(a.values), axis=1, keepdims=True)
    assert (np.abs(a.values - b.values) < 1e-8 * scale).all()


def test_workspace_keeps_topologies_apart(draft: Model) -> None:
    """Solving another device in between changes nothing."""
    path = Path(np.array([20]) * KPA)
    shared = Workspace(size=1)
    level = mesh_level("draft")
    first = solve(baseline(named_device("S1"), level), path, shared)
    solve(baseline(named_device("D8-2x1"), level), path, shared)
    again = solve(baseline(named_device("S1"), level), path, shared)
    assert np.array_equal(first.values, again.values)


def test_stacked_responses_are_padded(draft: Model) -> None:
    one = draft([named_device()], [Path(np.array([5.0, 10.0]) * KPA)])
    two = draft([named_device("S1", 2)], [Path(np.array([5.0]) * KPA)])
    both = stack([one, two])
    assert both.values.shape == (2, 2, len(OUTPUT_NAMES))
    assert np.isnan(both.values[1, 1]).all()
    assert both.path_status == ("completed", "completed")


def test_model_refuses_what_it_does_not_know() -> None:
    with pytest.raises(InputError, match="draft, standard, fine"):
        Model(level="medium")
    with pytest.raises(EffectError, match="'wind' is unknown"):
        Model(effects=("wind",))
    with pytest.raises(InputError, match="active effects"):
        Model(parameters={"self_weight": {"density": 1000.0}})
    with pytest.raises(InputError, match="one path a design"):
        Model(level="draft")([named_device()], [])


def test_history_and_time_reach_the_law() -> None:
    """A law that adds up its time steps sees the load path's own clock."""
    from datagen.materials import Hyperelastic, LawResult

    class Clock(Hyperelastic):
        @property
        def history_size(self) -> int:
            return 1

        def respond(self, f, mu, history, dt, tangent):  # type: ignore[no-untyped-def]
            plain = Hyperelastic().respond(f, mu, history, dt, tangent)
            return LawResult(plain.stress, plain.tangent, history + dt)

    problem = baseline(named_device(), mesh_level("draft"))
    timed = replace(problem, laws=(Clock(), Clock()))
    follower = PathFollower(timed)
    start = [history.copy() for history in follower.equations.history]
    follower.run(np.array([2e3, 4e3]), np.array([3.0, 10.0]))
    for before, after in zip(start, follower.equations.history, strict=True):
        # The corrector's pressures differ a little from those the clock is led by.
        assert np.allclose(after - before, 10.0, rtol=0.02)  # from rest at time 0
