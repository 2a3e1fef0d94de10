"""Growth that comes with time: the path keeps it up, and its derivatives too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from datagen.device import named_device
from datagen.model import Model
from datagen.response import Path, Response
from datagen.solver import solve

Array = np.ndarray
KPA = 1e3
STRAIN, TIME = 0.02, 600.0


def follow(
    pressure: list[float],
    time: list[float],
    effects: dict[str, dict[str, float]],
    sensitivities: bool = False,
) -> Response:
    model = Model(tuple(effects), "draft", effects)
    path = Path(np.array(pressure) * KPA, np.array(time))
    response = model([named_device()], [path], sensitivities)
    assert response.path_status == ("completed",), response.message
    return response


def swollen(strain: float = STRAIN, time: float = TIME) -> dict[str, dict[str, float]]:
    return {"swelling": {"strain": strain, "time": time}}


def test_each_step_is_the_equilibrium_of_the_body_as_large_as_it_is_then() -> None:
    """Against growth that has been there from the start, without any time."""
    pressure, time = [20.0, 40.0, 40.0, 10.0], [100.0, 500.0, 900.0, 1e5]
    values = follow(pressure, time, swollen()).values[0]
    problem = Model(level="draft").problem(named_device())
    for value, p, t in zip(values, pressure, time, strict=True):
        strain = STRAIN * (1 - np.exp(-t / TIME))
        growth = np.tile((1 + strain) * np.eye(3), (len(problem.mesh.cells), 1, 1))
        grown = replace(problem, growth=growth)
        there = solve(grown, Path(np.array([p * KPA])))
        wanted = there.values[0, 0]
        assert value == pytest.approx(wanted, rel=1e-6, abs=1e-12)


def test_a_cavity_at_rest_grows_with_the_cube_of_the_size() -> None:
    time = [1.0, 300.0, 1200.0, 1e5]
    values = follow([0.0] * 4, time, swollen()).values[0]
    device = named_device()
    volume = device.balloon_length * device.balloon_width * device.cavity_height
    strain = STRAIN * (1 - np.exp(-np.array(time) / TIME))
    growth = volume * ((1 + strain) ** 3 - 1)
    assert values[:, 4] == pytest.approx(growth, rel=0.01)


def test_a_large_jump_in_size_is_followed() -> None:
    slow = {"cure_mismatch": {"difference": 0.005}}
    jumped = follow([0.0, 30.0], [1.0, 1e6], slow | swollen(0.05, 60.0)).values[0]
    steps = [1.0, 20.0, 40.0, 60.0, 100.0, 200.0, 1e6]
    led = follow([0, 5, 10, 15, 20, 25, 30], steps, slow | swollen(0.05, 60.0)).values
    assert jumped[-1] == pytest.approx(led[0, -1], rel=1e-6)


def test_swelling_and_shrinkage_multiply() -> None:
    both = swollen() | {"cure_mismatch": {"difference": -0.004}}
    values = follow([15.0], [1e6], both).values[0, 0]
    problem = Model(level="draft").problem(named_device())
    factor = np.where(problem.mesh.layer == 1, 1 - 0.004, 1.0) * (1 + STRAIN)
    grown = replace(problem, growth=factor[:, None, None] * np.eye(3))
    wanted = solve(grown, Path(np.array([15.0]) * KPA)).values[0, 0]
    assert values == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize("at", [0.0, 0.01])
def test_derivatives_also_where_the_pressure_is_held(at: float) -> None:
    pressure, time, step = [20.0, 20.0, 35.0], [100.0, 1000.0, 1500.0], 1e-5
    found = follow(pressure, time, swollen(at), sensitivities=True)
    ahead = follow(pressure, time, swollen(at + step)).values
    further = follow(pressure, time, swollen(at + 2 * step)).values
    wanted = (4 * (ahead - found.values) - (further - found.values)) / (2 * step)
    assert found.jacobian is not None
    column = found.parameters.index("swelling.strain")
    error = np.abs(found.jacobian[..., column] - wanted).max(axis=(0, 1))
    assert (error < 2e-3 * np.abs(wanted).max(axis=(0, 1))).all()
    assert abs(wanted[0, 1, 2] / wanted[0, 0, 2]) > 2  # it goes on at held pressure


def test_nothing_swells_before_its_time() -> None:
    """A path may begin before time 0: the body is as large as at time 0."""
    early = follow([10.0, 20.0], [-50.0, 0.0], swollen()).values
    plain = follow([10.0, 20.0], [1.0, 2.0], {}).values
    assert np.allclose(early, plain, rtol=1e-6, atol=1e-13)
