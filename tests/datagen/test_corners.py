"""Inputs at the ends of what is allowed, which once ended in an error or in NaN."""

from __future__ import annotations

from pathlib import Path as FilePath

import numpy as np
import pytest

from datagen import adjoint
from datagen.control import Options
from datagen.device import DESIGN_SPACE, Design, named_device
from datagen.effects import catalogue
from datagen.effects.acting import act
from datagen.errors import InputError
from datagen.generate import fitted, sampled_space
from datagen.levels import FORMER, SKETCH
from datagen.model import Model
from datagen.problem import baseline
from datagen.response import Path
from datagen.solver import solve
from datagen.worker import split_inputs

KPA = 1e3
S1 = named_device("S1")


@pytest.fixture(autouse=True)
def sketch(monkeypatch: pytest.MonkeyPatch) -> None:
    """The coarsest mesh by name, as models want it."""
    monkeypatch.setitem(FORMER, "sketch", SKETCH)


def test_chains_that_are_drawn_past_their_length_end_the_path() -> None:
    """Gent's law has no stress there; a corrector may look on its way."""
    soft = S1.with_values(
        upper_thickness=50e-6, upper_modulus=7e4, lower_thickness=230e-6
    )
    model = Model(
        ("strain_stiffening",), "draft", {"strain_stiffening": {"inverse_limit": 0.36}}
    )
    found = model([soft], [Path(np.array([150 * KPA]))])
    assert found.path_status != ("completed",)
    assert found.message[0]


@pytest.mark.parametrize(
    ("effect", "values"),
    [("viscoelasticity", {"beta_10": 0.05}), ("swelling", {"strain": 0.01})],
)
def test_the_limit_of_steps_grows_with_the_load_steps(
    effect: str, values: dict[str, float]
) -> None:
    """Two equilibria a load step, where a memory fades or the body swells."""
    problem = act(catalogue()[effect], baseline(S1, SKETCH), values)
    path = Path(np.linspace(100, 1200, 12))
    found = solve(problem, path, options=Options(max_steps=4))
    assert found.path_status == ("completed",)


def test_derivatives_with_a_memory_are_there_for_slender_strips() -> None:
    """By a parameter that changes the residual by little more than its rounding."""
    slender = Design(
        length=0.012723161715325879,
        width=0.0009127894581691892,
        balloon_length=0.008046770075192557,
        balloon_width=0.0006852905401054823,
        balloon_start=0.00243752774208503,
        wall=0.0001489880959928413,
        divisions_x=2,
        divisions_y=1,
        cavity_height=6.031818797957119e-05,
        upper_thickness=6.930615324063664e-05,
        lower_thickness=0.00026945705304968527,
        upper_modulus=1464908.6026079212,
        lower_modulus=4099482.6846683575,
    )
    values = {
        "mullins": {"softening": 0.3445895772359748, "scale": 0.24486596511064912},
        "yeoh": {"second": 0.25634903303301854, "third": 0.021036155098074084},
    }
    by = ["yeoh.third", "mullins.softening"]
    path = [Path(np.array([10, 20, 40]) * KPA)]
    model = Model(tuple(values), "sketch", values)
    found = model([slender], path, sensitivities=by)
    jacobian, column = found.jacobian, found.parameters.index("yeoh.third")
    assert jacobian is not None and np.isfinite(jacobian).all()
    step, here = 1e-3, values["yeoh"]
    moved = [
        Model(
            tuple(values),
            "sketch",
            values | {"yeoh": here | {"third": here["third"] + side * step}},
        )([slender], path).values[0]
        for side in (1, -1)
    ]
    wanted = (moved[0] - moved[1]) / (2 * step)
    error = np.abs(jacobian[0, :, :, column] - wanted) / np.abs(wanted).max(axis=0)
    assert error.max() < 2e-3


def test_a_derivative_that_is_lost_costs_no_other() -> None:
    """Its history is not known from there on; the path and the others are."""
    flat = Design(
        length=1.29636e-3,
        width=22e-3,
        balloon_length=0.27636e-3,
        balloon_width=20e-3,
        balloon_start=20e-6,
        wall=1.62e-3,
        divisions_x=1,
        divisions_y=1,
        cavity_height=5e-6,
        upper_thickness=216.45e-6,
        lower_thickness=10e-6,
        upper_modulus=62815.0,
        lower_modulus=288696.0,
    )
    values = {"mullins": {"softening": 0.8, "scale": 0.5}}
    model = Model(("mullins",), "sketch", values)
    path = [Path(np.array([1000.0, 100.0]))]
    by = ["lower_thickness", "upper_modulus"]
    found = model([flat], path, sensitivities=by)
    assert found.path_status == ("completed",)
    assert found.jacobian is not None
    lost = np.isnan(found.jacobian[0]).any(axis=(0, 1))
    assert not lost[found.parameters.index("upper_modulus")]


COUNTED = """
from dataclasses import replace
from datagen.effects import effect
from datagen.space import Parameter

@effect("material", [Parameter("count", "1", 0, 3, scale="integer", off=0, source="-")])
def plies(problem, count):
    "mu = mu0 (1 + count / 10)"
    return replace(problem, shear_modulus=problem.shear_modulus * (1 + count / 10))
"""


def test_nothing_is_differentiated_by_a_count(tmp_path: FilePath) -> None:
    (tmp_path / "plies.py").write_text(COUNTED)
    model = Model(("plies",), "sketch", {"plies": {"count": 1}}, tmp_path)
    found = model([S1], [Path(np.array([5 * KPA]))], sensitivities=True)
    assert not any("plies" in name for name in found.parameters)
    with pytest.raises(InputError, match="sensitivities"):
        model.directions(S1, ["plies.count"])


def test_a_design_without_room_for_a_step_is_named() -> None:
    tight = S1.with_values(balloon_start=20e-6, length=20e-6 + 4e-3 + 20e-6)
    with pytest.raises(
        InputError, match=r"derivative by balloon_start: 2e-05 .* room for a step"
    ):
        Model((), "draft").directions(tight)


@pytest.mark.parametrize("time", [[1.0, np.inf], [-np.inf, 1.0], [1.0, np.nan]])
def test_times_are_finite(time: list[float]) -> None:
    with pytest.raises(InputError, match="finite, strictly increasing"):
        Path(np.array([1.0, 2.0]), np.array(time))


def test_adjoints_are_exact_where_the_root_turns_on_its_grip(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """They are large along that turn; what bends the strip is not lost beside it."""
    short = S1.with_values(
        length=5.362e-3,
        width=2.66e-3,
        balloon_length=4.2947e-3,
        balloon_width=1.43225e-3,
        balloon_start=0.3636e-3,
        cavity_height=139.68e-6,
        upper_thickness=61.87e-6,
        lower_thickness=117.99e-6,
        upper_modulus=4.6735e6,
        lower_modulus=1.4915e6,
    )
    model = Model(
        ("clamp_compliance",), "sketch", {"clamp_compliance": {"compliance": 2.8e-8}}
    )
    path = [Path(np.array([8 * KPA, 3 * KPA]))]
    found = model([short], path, sensitivities=True).jacobian
    for name, value in (("GOAL", 0.0), ("SPRUNG", 1e-9), ("ITERATIONS", 200)):
        monkeypatch.setattr(adjoint, name, value)
    exact = model([short], path, sensitivities=True).jacobian
    assert found is not None and exact is not None
    scale = np.abs(exact[0]).max(axis=0)
    error = np.abs(found[0] - exact[0]) / np.where(scale > 0, scale, 1.0)
    assert error.max() < 1e-3


def test_effects_are_sampled_as_far_as_they_fit_a_design() -> None:
    """An edge moves no further than to the next one; nothing else is changed."""
    space = sampled_space(("bond_edge",))
    inputs = space.sample(200, 3)[:40]
    found = fitted(space, inputs, ("bond_edge",))
    assert np.array_equal(found, fitted(space, inputs, ("bond_edge",)))
    designs = len(DESIGN_SPACE.names)
    assert np.array_equal(found[:, :designs], inputs[:, :designs])
    halved = inputs[:, designs] / found[:, designs]
    assert set(halved.round(9)) <= {1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0}
    assert (halved == 1).sum() > 20 and (halved > 1).sum() > 2
    for row, was in zip(found, inputs, strict=True):
        design, parameters = split_inputs(space.names, row, ("bond_edge",))
        Model(("bond_edge",), "draft", parameters).problem(Design.from_sample(design))
        if row[designs] != was[designs]:
            own = {"bond_edge": {"growth": 2 * row[designs]}}
            with pytest.raises(InputError):
                Model(("bond_edge",), "draft", own).problem(Design.from_sample(design))
