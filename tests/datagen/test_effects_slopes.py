"""Derivatives by the effects' parameters, all effects acting, against re-solves."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from datagen.device import named_device
from datagen.effects import catalogue
from datagen.model import Model
from datagen.response import Path, Response

PATH = Path(np.array([0.0, 50e3]))

INSIDE: dict[str, dict[str, float]] = {
    "bond_edge": {"growth": 40e-6},
    "initial_shape": {"curvature": 10.0, "tilt": -0.03},
    "modulus_bias": {"common": 0.9, "ratio": 1.2},
    "mooney": {"second": 0.1},
    "strain_stiffening": {"inverse_limit": 0.1},
    "temperature": {"change": 20.0},
    "thickness_bias": {"upper": 0.04, "lower": -0.03, "gradient": 0.05},
    "yeoh": {"second": 0.08, "third": 0.006},
}
PARAMETERS = [(effect, name) for effect, given in INSIDE.items() for name in given]


def solve(
    values: dict[str, dict[str, float]],
    effects: tuple[str, ...] = tuple(INSIDE),
    sensitivities: bool = False,
) -> Response:
    model = Model(effects, "draft", {n: v for n, v in values.items() if n in effects})
    response = model([named_device()], [PATH], sensitivities)
    assert response.path_status == ("completed",), response.message
    return response


@pytest.fixture(scope="module")
def off() -> Response:
    return solve({}, sensitivities=True)


@cache
def inside(effects: tuple[str, ...]) -> Response:
    return solve(INSIDE, effects, sensitivities=True)


def column(response: Response, effect: str, name: str) -> np.ndarray:
    assert response.jacobian is not None
    found: np.ndarray = response.jacobian[
        0, ..., response.parameters.index(f"{effect}.{name}")
    ]
    return found


def agree(
    found: np.ndarray, wanted: np.ndarray, values: np.ndarray, width: float
) -> bool:
    """Whether to 1e-3 of each output's largest derivative.

    Where it hardly depends on the parameter: to 1e-6 of the output over the range.
    """
    error = np.abs(found - wanted).max(axis=0)
    floor = 1e-3 * np.abs(values).max(axis=0) / width
    allowed = 1e-3 * np.maximum(np.abs(wanted).max(axis=0), floor)
    return bool((error < allowed).all())


@pytest.mark.parametrize(("effect", "name"), PARAMETERS)
def test_inside_the_range(effect: str, name: str) -> None:
    parameter = catalogue()[effect].space[name]
    width = parameter.upper - parameter.lower
    at, step = INSIDE[effect][name], 1e-3 * width
    # Growth, which has to be led in at rest, acts only where it is asked about.
    effects = tuple(e for e in INSIDE if e != "temperature" or effect == e)
    ahead, behind = (
        solve(
            {**INSIDE, effect: {**INSIDE[effect], name: at + side * step}}, effects
        ).values[0]
        for side in (1, -1)
    )
    found = inside(effects)
    wanted = (ahead - behind) / (2 * step)
    assert agree(column(found, effect, name), wanted, found.values[0], width)


@pytest.mark.parametrize(("effect", "name"), PARAMETERS)
def test_at_off(off: Response, effect: str, name: str) -> None:
    """From the inner side to second order: outputs are smooth up to the off value."""
    parameter = catalogue()[effect].space[name]
    assert parameter.off is not None
    width = parameter.upper - parameter.lower
    step = 2e-4 * width
    once, twice = (
        solve({effect: {name: parameter.off + k * step}}).values[0] for k in (1, 2)
    )
    wanted = (4 * once - twice - 3 * off.values[0]) / (2 * step)
    assert agree(column(off, effect, name), wanted, off.values[0], width)
