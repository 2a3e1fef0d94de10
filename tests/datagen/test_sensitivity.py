"""Derivatives of the outputs against paths that are solved again."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from datagen.device import Design, named_device
from datagen.effects import catalogue
from datagen.errors import EffectError
from datagen.levels import mesh_level
from datagen.materials import Hyperelastic, LawResult, invariants
from datagen.model import CONTINUOUS_FIELDS, Model
from datagen.problem import Problem, baseline
from datagen.response import Path, Response
from datagen.sensitivity import Direction, check_alike
from datagen.solver import solve

KPA = 1e3
PATH = Path(np.array([5.0, 15.0, 30.0, 50.0]) * KPA)

Array = np.ndarray


def worst(jacobian: Array, wanted: Array, values: Array, scale: float) -> Array:
    """Largest error of each output's derivative over its own maximum on the path.

    Where an output hardly depends on the parameter, its derivative is compared with a
    thousandth of the output over the parameter's `scale`.
    """
    error = np.abs(jacobian - wanted).max(axis=(0, 1))
    least = 1e-3 * np.abs(values).max(axis=(0, 1)) / scale
    result: Array = error / np.maximum(np.abs(wanted).max(axis=(0, 1)), least)
    return result


@pytest.fixture(scope="module")
def model() -> Model:
    return Model(level="draft")


@pytest.fixture(scope="module")
def divided() -> Design:
    return named_device("D8-2x2", 2)


@pytest.fixture(scope="module")
def response(model: Model, divided: Design) -> Response:
    return model([divided], [PATH], sensitivities=True)


@pytest.mark.parametrize("name", CONTINUOUS_FIELDS)
def test_design_fields(
    model: Model, divided: Design, response: Response, name: str
) -> None:
    value = getattr(divided, name)
    step = 1e-4 * value
    ahead, behind = (
        model([divided.with_values(**{name: value + side * step})], [PATH]).values
        for side in (1, -1)
    )
    assert response.jacobian is not None
    found = response.jacobian[..., response.parameters.index(name)]
    wanted = (ahead - behind) / (2 * step)
    assert worst(found, wanted, response.values, value).max() < 1e-3


def test_a_field_at_its_end_is_stepped_back(model: Model) -> None:
    """Neither thicker than allowed nor longer than fits: derivatives from below."""
    design = named_device("S1").with_values(upper_thickness=2e-3)
    tight = design.with_values(length=design.balloon_start + design.span_x + 20e-6)
    steps = {one.name: one.step for one in model.directions(tight)}
    assert steps["upper_thickness"] < 0
    assert steps["balloon_length"] < 0
    assert steps["width"] > 0


def test_values_are_those_without_derivatives(
    model: Model, divided: Design, response: Response
) -> None:
    plain = model([divided], [PATH])
    assert plain.jacobian is None
    assert np.allclose(plain.values, response.values, rtol=1e-6, atol=1e-13)


@pytest.mark.parametrize(
    ("effect", "parameter", "at"),
    [
        ("cure_mismatch", "difference", 0.0),
        ("cure_mismatch", "difference", 2e-3),
        ("self_weight", "density", 500.0),
        ("self_weight", "orientation", 0.4),
    ],
)
def test_effect_parameters(effect: str, parameter: str, at: float) -> None:
    design = named_device("S1")
    entry = catalogue()[effect].space[parameter]
    step = 1e-4 * (entry.upper - entry.lower)
    others = {"density": 1000.0} if parameter == "orientation" else {}

    def at_value(value: float) -> Model:
        values = {effect: {**others, parameter: value}}
        return Model((effect,), "draft", values)

    response = at_value(at)([design], [PATH], sensitivities=True)
    ahead, behind = (
        at_value(at + side * step)([design], [PATH]).values for side in (1, -1)
    )
    assert response.jacobian is not None
    column = response.parameters.index(f"{effect}.{parameter}")
    wanted = (ahead - behind) / (2 * step)
    found = response.jacobian[..., column]
    assert worst(found, wanted, response.values, 1e4 * step).max() < 1e-3


def test_load_parameters() -> None:
    problem = baseline(named_device("S1"), mesh_level("draft"))
    path = Path(np.array([10 * KPA, 20 * KPA]))
    directions = [
        Direction("gain", 1e-6, replace(problem, pressure_gain=1 + 1e-6)),
        Direction("offset", 1e-2, replace(problem, pressure_offset=1e-2)),
    ]
    found = solve(problem, path, directions=directions)
    assert found.jacobian is not None
    for k, change in enumerate(({"pressure_gain": 1e-3}, {"pressure_offset": 20.0})):
        ((field, step),) = change.items()
        values = [
            solve(replace(problem, **{field: getattr(problem, field) + d}), path).values
            for d in (step, -step)
        ]
        wanted = (values[0] - values[1]) / (2 * step)
        scale = 1.0 if field == "pressure_gain" else KPA
        error = worst(found.jacobian[..., k], wanted, found.values, scale)
        assert error.max() < 1e-3


def test_growth_and_offset_at_rest() -> None:
    """At zero pressure nothing has moved, and yet the tip follows both."""
    model = Model(("cure_mismatch",), "draft")
    rest = Path(np.array([0.0, 5 * KPA]))
    found = model([named_device("S1")], [rest], sensitivities=True)
    assert found.jacobian is not None
    tip = found.jacobian[0, 0, 0]
    fields = len(CONTINUOUS_FIELDS)
    assert np.abs(tip[:fields]).max() < 1e-6
    grown = Model(("cure_mismatch",), "draft", {"cure_mismatch": {"difference": 1e-5}})
    moved = grown([named_device("S1")], [rest]).values[0, 0, 0]
    assert tip[fields] == pytest.approx(moved / 1e-5, rel=1e-3)


def test_explored_paths_have_them_everywhere_but_at_the_limit(model: Model) -> None:
    soft = named_device("S1").with_values(upper_modulus=0.6e6, lower_modulus=0.8e6)
    response = model.explore(soft, sensitivities=True)
    assert response.path_status == ("limit_point",)
    assert response.jacobian is not None
    known = np.isfinite(response.jacobian[0]).all(axis=(1, 2))
    assert known[:-1].all()
    assert not known[-1]


def test_what_changes_the_mesh_or_what_is_held_is_refused() -> None:
    problem = baseline(named_device("S1"), mesh_level("draft"))
    free = replace(problem, fixed=np.zeros_like(problem.fixed))
    with pytest.raises(EffectError, match="clamp: no derivative"):
        check_alike(problem, [Direction("clamp", 1e-6, free)])


@dataclass(frozen=True)
class Softening:
    """Neo-Hookean, softer by `share` times a fading memory of its strain."""

    share: float
    time: float = 5.0
    history_size: int = 1

    def respond(
        self, f: Array, mu: Array, history: Array, dt: float, tangent: bool
    ) -> LawResult:
        result = Hyperelastic().respond(f, mu, history, dt, tangent)
        left = 1 - self.share * history
        kept = np.exp(-dt / self.time)
        memory = history[:, 0] * kept + (invariants(f)[0] - 3) * (1 - kept)
        slope = result.tangent * left if tangent else result.tangent
        return LawResult(result.stress * left, slope, memory[:, None])


def test_the_history_of_a_law_is_followed() -> None:
    problem = baseline(named_device("S1"), mesh_level("draft"))
    # Each load step in one step of the follower: a history depends on the steps.
    path = Path(np.array([0.5, 2.0, 4.0, 6.0, 9.0, 12.0, 16.0, 20.0]) * KPA)

    def soft(share: float) -> Problem:
        return replace(problem, laws=(Softening(share), Softening(share)))

    found = solve(soft(0.3), path, directions=[Direction("share", 1e-5, soft(0.30001))])
    assert found.info["steps"] == len(path.pressure)
    ahead, behind = (solve(soft(0.3 + step), path) for step in (1e-3, -1e-3))
    assert ahead.info["steps"] == behind.info["steps"] == len(path.pressure)
    assert found.jacobian is not None
    wanted = (ahead.values - behind.values) / 2e-3
    assert np.abs(wanted[0, -1, 2]) > 1e-8  # it matters: 10 nm of inflation and more
    assert worst(found.jacobian[..., 0], wanted, found.values, 1.0).max() < 2e-3
