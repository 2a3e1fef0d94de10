"""Intervals of the finite elements' answers with adopted effects in them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datagen.device import Design, named_device
from datagen.response import OUTPUT_NAMES, Response
from datagen.response import Path as LoadPath
from discrepancy.version import ModelVersion
from service.answer import Answer
from service.current import Serving
from service.tasks import predict
from service.versions import adopted_answer, left_open, version_answer
from tests.discrepancy.versions import estimate, version
from tests.service.fakes import FakeSurrogate

SLOPES = {"bond_edge.growth": 2.0, "cure_mismatch.difference": -30.0}
MESH_ERROR = 0.04
KPA = np.array([10e3, 20e3])
NINETY = 1.6449


class Linear:
    """A made-up model: values change along each parameter as `SLOPES` has it.

    Derivatives come in an order of the model's own; the second step has none.
    """

    def __init__(self, effects: tuple[str, ...]) -> None:
        self.effects = effects

    def __call__(
        self,
        designs: Sequence[Design],
        paths: Sequence[LoadPath],
        sensitivities: Sequence[str] = (),
        mesh_error: bool = False,
    ) -> Response:
        steps = len(paths[0].pressure)
        values = np.ones((1, steps, len(OUTPUT_NAMES)))
        names = tuple(name for name in SLOPES if name in sensitivities)
        slopes = values[..., None] * [SLOPES[name] for name in names]
        slopes[:, 1] = np.nan
        return Response(
            OUTPUT_NAMES,
            paths[0].pressure[None],
            values,
            np.zeros_like(values),
            np.full((1, steps), "converged"),
            ("completed",),
            np.array([math.nan]),
            ("",),
            {},
            parameters=names,
            jacobian=slopes,
            mesh_error=MESH_ERROR * values,
        )


def fitted(samples: np.ndarray) -> ModelVersion:
    """A version with both effects, not in the model's order, and such a posterior."""
    names = ("cure_mismatch.difference", "bond_edge.growth")
    return version(
        effects=("cure_mismatch", "bond_edge"),
        estimates=tuple(
            estimate(name, float(values.mean()), float(values.std()))
            for name, values in zip(names, samples.T, strict=True)
        ),
        mean=samples.mean(axis=0),
        covariance=np.cov(samples.T, bias=True),
        samples=samples,
        sources={},
    )


def answered(made: ModelVersion) -> Answer:
    model: Any = Linear(made.effects)
    asked = (named_device("S1"), KPA, False, ["no surrogate"])
    return adopted_answer(model, "made up", left_open(made), *asked)


def test_the_interval_holds_what_the_posterior_leaves_open() -> None:
    """Of a normal posterior: the mesh error and 1.645 deviations, in squares."""
    rng = np.random.default_rng(0)
    deep = np.array([[1e-6, 4e-6], [4e-6, 1e-4]])
    samples = rng.multivariate_normal([0.001, 0.02], deep, 40_000)
    found = answered(fitted(samples))
    slopes = np.array([SLOPES["cure_mismatch.difference"], SLOPES["bond_edge.growth"]])
    half = math.hypot(MESH_ERROR, NINETY * math.sqrt(slopes @ deep @ slopes))
    assert (found.high - found.value)[0] == pytest.approx(half, rel=0.02)
    assert (found.value - found.low)[0] == pytest.approx(half, rel=0.02)
    assert found.effects == ("cure_mismatch", "bond_edge")
    assert "cure_mismatch.difference, bond_edge.growth" in found.notes[0]


def test_a_posterior_at_its_bound_leaves_open_one_side_more() -> None:
    """A parameter that cannot be less than 0: its samples lie on one side."""
    growth = -0.01 * np.log(1 - (np.arange(4000) + 0.5) / 4000)  # exponential
    found = answered(fitted(np.stack([np.full(4000, 0.001), growth], axis=1)))
    ends = np.quantile(2.0 * growth, [0.05, 0.95]) - 2.0 * growth.mean()
    below, above = (found.value - found.low)[0, 0], (found.high - found.value)[0, 0]
    assert below == pytest.approx(math.hypot(MESH_ERROR, ends[0]))
    assert above == pytest.approx(math.hypot(MESH_ERROR, ends[1]))
    assert above > 1.2 * below


def test_without_derivatives_the_mesh_error_is_left_and_told() -> None:
    samples = np.array([[0.0, 0.01], [0.002, 0.03]])
    found = answered(fitted(samples))
    assert (found.high - found.value)[1] == pytest.approx(MESH_ERROR)
    assert (found.high - found.value)[0, 0] > 1.01 * MESH_ERROR
    assert "found at 20 kPa: the interval there is the mesh error" in found.notes[1]
    assert len(found.notes) == 2


def test_it_is_that_of_the_finite_elements_themselves(tmp_path: Path) -> None:
    """Against paths at the ends of the parameter's interval, and the job's body."""
    growth, std = 31.3e-6, 3e-6
    ends = growth + NINETY * std * np.array([-1.0, 1.0])
    made = version(
        effects=("bond_edge",),
        estimates=(replace(estimate("bond_edge.growth", growth, std), unit="m"),),
        mean=np.array([growth]),
        covariance=np.array([[std**2]]),
        samples=np.repeat(ends, 100)[:, None],  # whose quantiles they are
        sources={},
    ).save(tmp_path / "made")
    design, pressure = named_device("S1"), np.array([10e3])
    found = version_answer(made, design, pressure, "draft")
    assert found.mesh_error is not None
    paths = []
    for end in ends:
        model = made.forward("draft", {"bond_edge": {"growth": float(end)}})
        paths.append(model([design], [LoadPath(pressure)]).values[0])
    open_half = np.abs(paths[1] - paths[0]) / 2
    half = np.hypot(found.mesh_error, open_half)
    assert (found.high - found.low) / 2 == pytest.approx(half, rel=0.01)
    assert (open_half > 1e-3 * np.abs(found.value)).all()

    payload = {
        "design": design.to_dict(),
        "pressure": pressure.tolist(),
        "level": "draft",
        "in_range": False,
        "reasons": list(found.reasons),
        "notes": [],
        "adopted": Serving("made", FakeSurrogate(), made).adopted,
    }
    body = predict(payload, lambda progress: None)
    for name in ("tip_deflection_mm", "inflation_mm"):
        assert body[name] == found.to_dict()[name]
    assert body["notes"] == found.to_dict()["notes"]
