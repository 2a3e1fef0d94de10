"""From deformed nodes to the contract's quantities, on shapes known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from datagen.device import named_device
from datagen.levels import mesh_level
from datagen.model import Model
from datagen.observe import Instruments, observe
from datagen.problem import Problem, baseline
from datagen.response import OUTPUT_NAMES

Array = np.ndarray


@pytest.fixture(scope="module")
def problem() -> Problem:
    return baseline(named_device("S1"), mesh_level("standard"))


def outputs(problem: Problem, x: Array) -> dict[str, float]:
    return dict(zip(OUTPUT_NAMES, observe(problem, x, 2e-10), strict=True))


def rolled(nodes: Array, length: float, angle: float) -> Array:
    """The strip bent into an arc whose bottom edge keeps its length, upwards."""
    radius = length / angle
    turn = nodes[:, 0] / radius
    return np.stack(
        [
            (radius - nodes[:, 2]) * np.sin(turn),
            nodes[:, 1],
            radius - (radius - nodes[:, 2]) * np.cos(turn),
        ],
        axis=1,
    )


def test_at_rest_everything_is_zero(problem: Problem) -> None:
    at_rest = dict(zip(OUTPUT_NAMES, observe(problem, problem.nodes, 0.0), strict=True))
    assert max(map(abs, at_rest.values())) < 1e-15


@pytest.mark.parametrize("degrees", [30.0, -60.0, 170.0, 200.0, 300.0])
def test_an_arc_has_its_own_tip_and_angle(problem: Problem, degrees: float) -> None:
    design = problem.design
    angle = np.radians(degrees)
    found = outputs(problem, rolled(problem.nodes, design.length, angle))
    middle = design.length / angle - design.thickness / 2
    lift = design.length / angle - middle * np.cos(angle) - design.thickness / 2
    assert found["tip_deflection"] == pytest.approx(lift, rel=1e-9)
    # The fitted stretch starts a quarter into the tip margin: its chord turns less.
    start = design.length - 0.75 * design.tip_margin
    chord = angle * (1 + start / design.length) / 2
    assert found["bending_angle"] == pytest.approx(chord, rel=2e-2)
    assert abs(found["inflation"]) < 1e-9
    assert found["cavity_volume"] == 4e-10


def test_a_fold_under_a_wall_is_no_turn_of_the_strip() -> None:
    """The bottom line may go backwards there, as no part of the strip's side does."""
    design = named_device("D8-3x1")
    folded = baseline(design, mesh_level("draft"))
    x, row = folded.nodes.copy(), folded.mesh.lines["bottom"]
    wall = (design.balloons_x()[0][1] + design.balloons_x()[1][0]) / 2
    middle = int(np.abs(x[row, 0] - wall).argmin())
    curl = row[middle - 4 : middle + 5]
    place = np.linspace(0, 2 * np.pi, len(curl))
    size = 0.6 * (x[curl[-1], 0] - x[curl[0], 0])
    x[curl, 0] += size * np.sin(place)
    x[curl, 2] += size * (1 - np.cos(place))
    assert outputs(folded, x)["bending_angle"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("degrees", [0.01, 120.0])
def test_a_bulge_is_measured_along_the_normal_of_the_bent_strip(
    problem: Problem, degrees: float
) -> None:
    """A roof raised by 50 um before the strip is rolled up rises by 50 um after."""
    design, nodes = problem.design, problem.nodes.copy()
    (left, right), half = design.balloons_x()[0], design.balloons_y()[0][1]
    s = np.clip((nodes[:, 0] - left) / (right - left), 0, 1)
    t = np.clip(nodes[:, 1] / half, 0, 1)
    shape = np.sin(np.pi * s) * (1 - t**2)
    roof = nodes[:, 2] > design.lower_thickness + design.cavity_height / 2
    nodes[:, 2] += np.where(roof, 50e-6, -20e-6) * shape
    found = outputs(problem, rolled(nodes, design.length, np.radians(degrees)))
    assert found["inflation"] == pytest.approx(50e-6, rel=5e-3)
    assert found["inflation_lower"] == pytest.approx(20e-6, rel=5e-3)


@pytest.mark.parametrize(("name", "pressure"), [("S1", 50e3), ("D8-2x2", 40e3)])
def test_gradients_against_differences(name: str, pressure: float) -> None:
    found, x = Model(level="draft").deformed(named_device(name), pressure)
    instruments = Instruments(found)
    gradients = instruments.gradients(x)
    size = np.abs(x).max()
    for k in range(3):  # smooth: neighbouring samples keep their order
        along = np.stack(
            [np.sin((k + 2) * x[:, (i + k) % 3] / size + i) for i in range(3)], axis=1
        )
        step = 1e-9
        ahead, behind = (
            instruments.read(x + side * step * along, 0.0) for side in (1, -1)
        )
        wanted = (ahead - behind) / (2 * step)
        for output, gradient in gradients.items():
            slope = np.vdot(gradient, along)
            scale = np.abs(gradient).sum()
            error = abs(slope - wanted[OUTPUT_NAMES.index(output)])
            assert error < 1e-5 * abs(slope) + 1e-8 * scale, output


def test_a_strip_at_rest_is_flat(problem: Problem) -> None:
    instruments = Instruments(problem)
    assert instruments.flat(problem.nodes)
    risen = problem.nodes.copy()
    mesh = problem.mesh
    risen[mesh.lines["roof_middle"], 2] += 1e-7
    risen[mesh.lines["floor_middle"], 2] -= 1e-7
    assert not instruments.flat(risen)
