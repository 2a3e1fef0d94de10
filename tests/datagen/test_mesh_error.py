"""Bounds of the discretisation error: the formula, its ends, and a finer mesh."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest

from datagen import mesh_error
from datagen.device import Design, named_device
from datagen.errors import FileError, InputError
from datagen.levels import COARSER, LEVELS, MeshLevel, mesh_level
from datagen.mesh_error import Factors, bracket, factors, follow, scale_of
from datagen.model import Model
from datagen.problem import baseline
from datagen.response import OUTPUT_NAMES, Path, Response

KPA = 1e3
PATH = Path(np.array([10.0, 30.0, 60.0]) * KPA)


@pytest.fixture(scope="module")
def model() -> Model:
    return Model(level="draft")


@pytest.fixture(scope="module")
def soft() -> Design:
    """Turns near 42 kPa."""
    return named_device("S1").with_values(
        upper_thickness=50e-6, upper_modulus=1e6, lower_modulus=1e6
    )


@pytest.fixture(scope="module")
def response(model: Model) -> Response:
    return model([named_device("S1")], [PATH], mesh_error=True)


def error_of(response: Response) -> np.ndarray:
    assert response.mesh_error is not None
    return response.mesh_error


def test_bracket_on_numbers_by_hand() -> None:
    values = np.array([[1.0], [3.0], [2.0]])
    coarse = np.array([[1.5], [2.0], [2.1]])  # differences 0.5, 1.0, 0.1
    largest = np.array([[1.5], [2.0], [4.0]])
    found = bracket(values, coarse, largest, np.array([0.1]))
    assert found[:, 0] == pytest.approx([0.65, 1.2, 1.4])
    known = Factors(np.array([3.0]), np.array([0.1]), 2.0, 0.01)
    assert known.bound(values, coarse, largest) == pytest.approx(3 * found)
    assert known.limit_bound(100.0, 90.0) == pytest.approx(2 * (10 + 1))
    assert np.isnan(known.limit_bound(np.nan, 90.0))


def test_values_stay_and_every_value_has_a_bound(
    model: Model, response: Response
) -> None:
    plain = model([named_device("S1")], [PATH])
    assert plain.mesh_error is plain.limit_pressure_error is None
    assert np.array_equal(plain.values, response.values)
    assert (error_of(response) > 0).all()
    assert (np.diff(error_of(response), axis=1) >= 0).all()
    assert response.info["mesh_error_seconds"] > 0
    assert response.limit_pressure_error is not None
    assert np.isnan(response.limit_pressure_error).all()


def test_the_bound_is_that_of_the_formula(model: Model, response: Response) -> None:
    """Made again from two plain solves; only the coarser path's maxima are its own."""
    other = baseline(named_device("S1"), COARSER["draft"])
    seen = follow(other, PATH.pressure)
    scale = scale_of(seen.largest, named_device("S1"))
    wanted = factors("draft").bound(response.values[0], seen.coarse, scale)
    assert error_of(response)[0] == pytest.approx(wanted, rel=1e-6)
    assert (seen.largest >= np.abs(seen.coarse)).all()


@pytest.mark.parametrize("case", [1, 2])
def test_two_meshes_lie_within_the_sum_of_their_bounds(model: Model, case: int) -> None:
    """Both bounds are of the distance from the same answer, that of the fine mesh."""
    design = named_device("S1", case)
    draft = model([design], [PATH], mesh_error=True)
    standard = Model(level="standard")([design], [PATH], mesh_error=True)
    distance = np.abs(draft.values - standard.values)
    assert (distance <= error_of(draft) + error_of(standard)).all()
    # ... and no bound is an empty one, though a tip's is large where it hardly moves.
    largest = np.abs(standard.values).max(axis=1)
    share = error_of(standard)[0, -1] / largest[0]
    assert (share < [0.4, 0.4, 0.02, 0.02, 0.05]).all()


def test_a_step_asked_for_alone_keeps_its_scale(model: Model) -> None:
    """At 56 kPa the coarser tip is back where it was; the bound does not vanish."""
    at, tip = Path(np.array([56 * KPA])), OUTPUT_NAMES.index("tip_deflection")
    seen = follow(baseline(named_device("S1"), COARSER["draft"]), at.pressure)
    assert seen.largest[0, tip] > 15e-6 > 5 * abs(seen.coarse[0, tip])
    alone = model([named_device("S1")], [at], mesh_error=True)
    floor = factors("draft").factor[tip] * factors("draft").floor[tip]
    scale = scale_of(seen.largest, named_device("S1"))
    assert error_of(alone)[0, 0, tip] >= floor * scale[0, tip] > 0


def test_tip_and_angle_err_by_what_inflates() -> None:
    largest = np.array([[1e-6, 1e-3, 30e-6, 20e-6, 1e-9]])
    one, many = named_device("D8-1x1"), named_device("D8-3x2")
    found = scale_of(largest, many)
    assert found[0] == pytest.approx(
        [900e-6, 900e-6 / many.length, 30e-6, 20e-6, 1e-9], rel=1e-12
    )
    assert scale_of(largest, one)[0, 0] == pytest.approx(50e-6)


def test_limit_pressure_and_what_follows_it(model: Model, soft: Design) -> None:
    path = Path(np.array([20.0, 40.0, 60.0]) * KPA)
    found = model([soft], [path], mesh_error=True)
    assert np.isfinite(error_of(found)[0, :2]).all()
    assert np.isnan(error_of(found)[0, 2]).all()
    assert found.limit_pressure_error is not None
    standard = Model(level="standard")([soft], [path])
    distance = abs(float(found.limit_pressure[0] - standard.limit_pressure[0]))
    bound = float(found.limit_pressure_error[0])
    assert distance <= bound < 0.1 * found.limit_pressure[0]


def test_an_explored_path_has_bounds_up_to_its_limit_point(
    model: Model, soft: Design
) -> None:
    found = model.explore(soft, 60 * KPA, beyond=True, mesh_error=True)
    before = int(np.argmax(found.pressure[0]))
    assert found.pressure[0, before] == found.limit_pressure[0]
    known = np.isfinite(error_of(found)[0])
    assert known[:before].all()
    assert not known[before:].any()


def test_where_the_coarser_path_ends_its_last_values_are_held(soft: Design) -> None:
    problem = baseline(soft, COARSER["draft"])
    seen = follow(problem, np.array([20.0, 60.0, 70.0]) * KPA)
    assert 40 * KPA < seen.end < 44 * KPA
    assert (seen.coarse[1:] == seen.coarse[0]).all()
    assert (seen.largest[1] > np.abs(seen.coarse[1])).any()
    far = follow(problem, np.array([60 * KPA]))
    assert (far.coarse == 0).all()


def test_a_path_that_reaches_nothing_has_no_bounds(model: Model) -> None:
    """Roof and floor touch before the first load step."""
    design = named_device("S1")
    found = model([design], [Path(np.array([-10.0]) * KPA)], mesh_error=True)
    assert found.path_status == ("contact",)
    assert found.mesh_error is not None and np.isnan(found.mesh_error).all()


def test_a_body_that_fails_at_rest_counts_as_nothing(soft: Design) -> None:
    problem = baseline(soft, COARSER["draft"])
    growth = np.broadcast_to(np.diag([1.0, 1.0, -0.5]), (len(problem.mesh.cells), 3, 3))
    seen = follow(replace(problem, growth=np.array(growth)), np.array([1 * KPA]))
    assert seen.end == 0
    assert (seen.coarse == 0).all()


def test_paths_of_different_length_are_stacked(model: Model) -> None:
    design = named_device("S1")
    short = Path(np.array([10 * KPA]))
    both = model([design, design], [PATH, short], mesh_error=True)
    assert error_of(both).shape == both.values.shape
    assert np.isfinite(error_of(both)[1]).sum() == len(OUTPUT_NAMES)
    assert both.limit_pressure_error is not None
    assert both.limit_pressure_error.shape == (2,)


def test_a_response_checks_the_shape(response: Response) -> None:
    with pytest.raises(InputError, match="mesh_error"):
        replace(response, mesh_error=np.zeros((1, 2, 5)))
    with pytest.raises(InputError, match="limit_pressure_error"):
        replace(response, limit_pressure_error=np.zeros(2))


@pytest.mark.parametrize("level", LEVELS)
def test_the_calibration_belongs_to_the_meshes(level: str) -> None:
    known = factors(level)
    assert (known.factor > 0).all()
    assert (known.floor > 0).all()
    assert min(known.limit_factor, known.limit_floor) > 0
    assert COARSER[level].name not in (level, "fine")


@pytest.mark.parametrize("damage", ["missing", "empty", "short", "mesh"])
def test_a_damaged_calibration_is_told(
    tmp_path: FilePath, monkeypatch: pytest.MonkeyPatch, damage: str
) -> None:
    file = tmp_path / "factors.json"
    content = json.loads(mesh_error.FACTORS.read_text())
    if damage == "short":
        del content["levels"]["draft"]["outputs"]["inflation"]
    if damage == "mesh":
        content["levels"]["draft"]["mesh"][0] += 1
    if damage != "missing":
        file.write_text("" if damage == "empty" else json.dumps(content))
    monkeypatch.setattr(mesh_error, "FACTORS", file)
    mesh_error._calibration.cache_clear()
    with pytest.raises(FileError, match="make mesh-error"):
        factors("draft")
    mesh_error._calibration.cache_clear()


def test_the_mesh_below_draft_is_not_offered() -> None:
    assert isinstance(COARSER["draft"], MeshLevel)
    with pytest.raises(InputError, match="draft, standard, fine"):
        mesh_level(COARSER["draft"].name)


def test_a_former_level_has_no_bound() -> None:
    with pytest.raises(InputError, match=r"mesh_error: 'standard-1'.*draft, standard"):
        Model(level="standard-1")([named_device()], [PATH], mesh_error=True)
