"""Effects on what pressure acts where: gauge offset, loss in the feed."""

from __future__ import annotations

import numpy as np
import pytest

from datagen.device import named_device
from datagen.model import Model
from datagen.response import Path, Response

KPA = 1e3


def values(pressure: list[float], **active: dict[str, float]) -> Response:
    model = Model(effects=tuple(active), level="draft", parameters=active)
    response = model([named_device()], [Path(np.array(pressure) * KPA)])
    assert response.path_status == ("completed",), response.message
    return response


@pytest.mark.parametrize(
    ("effects", "cavity"),
    [
        ({"pressure_offset": {"offset": -1500.0}}, [18.5, 38.5]),
        ({"pressure_loss": {"gain": 0.9}}, [18.0, 36.0]),
        (
            {"pressure_loss": {"gain": 1.05}, "pressure_offset": {"offset": 800.0}},
            [21.8, 42.8],
        ),
    ],
)
def test_the_cavity_sees_another_pressure(
    effects: dict[str, dict[str, float]], cavity: list[float]
) -> None:
    seen = values([20, 40], **effects)
    assert np.array_equal(seen.pressure, [[20e3, 40e3]])  # still the gauge's
    assert np.allclose(seen.values, values(cavity).values, rtol=1e-6, atol=1e-13)


def test_an_offset_acts_at_rest() -> None:
    rest = values([0], pressure_offset={"offset": 1000.0}).values
    assert np.allclose(rest, values([1]).values, rtol=1e-6, atol=1e-13)


def test_loss_is_a_common_factor_of_the_moduli() -> None:
    """The pair that no quasi-static curve can separate."""
    device = named_device()
    stiff = device.with_values(
        upper_modulus=device.upper_modulus / 0.9,
        lower_modulus=device.lower_modulus / 0.9,
    )
    path = [Path(np.array([15, 45]) * KPA)]
    lost = values([15, 45], pressure_loss={"gain": 0.9})
    assert np.allclose(
        lost.values, Model(level="draft")([stiff], path).values, rtol=1e-6
    )
