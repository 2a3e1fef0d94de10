"""The door for effects, and the two first effects that use it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest

from datagen.device import named_device
from datagen.effects import catalogue, effect
from datagen.effects.door import effects_of_file
from datagen.errors import EffectError, InputError
from datagen.levels import mesh_level
from datagen.model import Model
from datagen.problem import STAGES, Problem, baseline
from datagen.response import Path
from datagen.space import Parameter

KPA = 1e3


def parameter(**changes: object) -> Parameter:
    given = {"name": "size", "unit": "1", "lower": 0.0, "upper": 1.0, "off": 0.0}
    return Parameter(**(given | {"source": "a test"} | changes))  # type: ignore[arg-type]


def values(pressure: list[float], level: str = "draft", **active: dict[str, float]):  # type: ignore[no-untyped-def]
    model = Model(effects=tuple(active), level=level, parameters=active)
    response = model([named_device()], [Path(np.array(pressure))])
    assert response.path_status == ("completed",), response.message
    return response


def test_catalogue_has_effects_of_different_stages() -> None:
    known = catalogue()
    assert {"self_weight", "cure_mismatch"} <= set(known)
    for name, one in known.items():
        assert one.name == name
        assert one.stage in STAGES
        assert one.doc
        assert all(p.source and p.unit for p in one.parameters)


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_off_is_the_baseline_bit_for_bit(name: str) -> None:
    problem = baseline(named_device(), mesh_level("draft"))
    assert catalogue()[name].apply(problem, {}) is problem
    pressure = [0.0, 20e3]
    on_at_off = values(pressure, **{name: {}})
    assert np.array_equal(on_at_off.values, values(pressure).values)


def test_weight_hangs_the_strip_and_turning_it_over_lifts_it() -> None:
    """Sag of a uniform cantilever: q L^4 / 8 B with the strip's own stiffness."""
    hang = values([0.0, 20e3], self_weight={"density": 1000.0})
    turned = values([0.0], self_weight={"density": 1000.0, "orientation": np.pi})
    sag = hang.output("tip_deflection")[0, 0]
    assert -200e-6 < sag < -40e-6
    assert turned.output("tip_deflection")[0, 0] == pytest.approx(-sag, rel=0.01)
    plain = values([20e3]).output("inflation")[0, 0]
    assert hang.output("inflation")[0, 1] == pytest.approx(plain, rel=2e-3)


def test_mismatch_bends_towards_the_layer_that_shrank() -> None:
    up = values([0.0], cure_mismatch={"difference": -0.005})
    down = values([0.0], cure_mismatch={"difference": 0.005})
    tip = up.output("tip_deflection")[0, 0]
    assert 0.3e-3 < tip < 0.8e-3  # 1 % gives about 1.2 mm on S1
    assert down.output("tip_deflection")[0, 0] == pytest.approx(-tip, rel=0.1)


def test_effects_combine_in_the_order_of_their_stages() -> None:
    both = {
        "self_weight": {"density": 1000.0},
        "cure_mismatch": {"difference": -0.002},
    }
    one = Model(effects=tuple(both), parameters=both, level="draft")
    other = Model(effects=tuple(reversed(both)), parameters=both, level="draft")
    assert [e.stage for e in one.active] == ["initial strain", "body force"]
    assert one.active == other.active
    together = values([0.0], **both).output("tip_deflection")[0, 0]
    alone = sum(
        values([0.0], **{n: v}).output("tip_deflection")[0, 0] for n, v in both.items()
    )
    assert together == pytest.approx(alone, rel=0.05)


def test_growth_of_both_layers_alike_only_scales() -> None:
    problem = baseline(named_device(), mesh_level("draft"))
    grown = catalogue()["cure_mismatch"].apply(problem, {"difference": 0.01})
    assert grown.growth is not None
    assert problem.growth is None
    stretched = grown.growth[problem.mesh.layer == 1]
    assert np.allclose(stretched, 1.01 * np.eye(3))
    assert np.allclose(grown.growth[problem.mesh.layer == 0], np.eye(3))


def test_values_outside_the_range_are_refused() -> None:
    with pytest.raises(InputError, match=r"density: 5000 kg/m3 .*0 to 1100"):
        Model(effects=("self_weight",), parameters={"self_weight": {"density": 5e3}})
    with pytest.raises(EffectError, match="unknown parameter 'mass'"):
        Model(effects=("self_weight",), parameters={"self_weight": {"mass": 1.0}})


def test_the_door_refuses_what_is_not_an_effect() -> None:
    def good(problem: Problem, size: float) -> Problem:
        """A documented change."""
        return problem

    def undocumented(problem: Problem, size: float) -> Problem:
        return problem

    assert effect("load", [parameter()])(good).name == "good"
    with pytest.raises(EffectError, match="unknown stage"):
        effect("weather", [parameter()])(good)
    with pytest.raises(EffectError, match="declares"):
        effect("load", [parameter(name="other")])(good)
    with pytest.raises(EffectError, match="no off value"):
        effect("load", [parameter(off=None)])(good)
    with pytest.raises(EffectError, match="off outside"):
        effect("load", [parameter(off=2.0)])(good)
    with pytest.raises(EffectError, match="no source"):
        effect("load", [parameter(source="")])(good)
    with pytest.raises(EffectError, match="no docstring"):
        effect("load", [parameter()])(undocumented)
    with pytest.raises(EffectError, match="no parameters"):
        effect("load", [])(lambda problem: problem)
    with pytest.raises(InputError, match="finite"):
        parameter(off=float("inf"))
    with pytest.raises(InputError, match="unit"):
        parameter(unit="")


USER_FILE = '''
"""A gauge that reads too low."""

from dataclasses import replace

from datagen.effects import effect
from datagen.space import Parameter


@effect(
    stage="load",
    parameters=[
        Parameter("offset", "Pa", -2e3, 2e3, off=0.0, source="vent test on the bench")
    ],
)
def gauge_offset(problem, offset):
    """Cavity pressure = gauge pressure + offset."""
    return replace(problem, pressure_offset=problem.pressure_offset + offset)
'''


def test_a_users_file_goes_through_the_same_door(tmp_path: FilePath) -> None:
    (tmp_path / "gauge.py").write_text(USER_FILE)
    assert "gauge_offset" in catalogue(tmp_path)
    shifted = Model(
        effects=("gauge_offset",),
        parameters={"gauge_offset": {"offset": 1000.0}},
        effects_dir=tmp_path,
        level="draft",
    )([named_device()], [Path(np.array([0.0, 19e3]))])
    plain = values([1e3, 20e3])
    assert np.allclose(shifted.values, plain.values, rtol=1e-6, atol=1e-13)


def test_bad_user_files_are_named_in_one_line(tmp_path: FilePath) -> None:
    file = tmp_path / "mine.py"
    file.write_text("def broken(:")
    with pytest.raises(EffectError, match=r"mine\.py: SyntaxError"):
        catalogue(tmp_path)
    file.write_text(USER_FILE.replace("gauge_offset", "self_weight"))
    with pytest.raises(EffectError, match="exists already"):
        catalogue(tmp_path)
    with pytest.raises(EffectError, match="no such folder"):
        catalogue(tmp_path / "nowhere")
    with pytest.raises(EffectError, match="no such folder"):  # though none is named
        Model(effects_dir=tmp_path / "none")


def test_mistakes_at_import_are_named_in_one_line(tmp_path: FilePath) -> None:
    file = tmp_path / "mine.py"
    for text, words in (
        ("x = 1 / 0", "ZeroDivisionError: division by zero"),
        ("import numpy\nnumpy.nothing", "AttributeError: .*nothing"),
        (USER_FILE.replace('"Pa"', '""'), "offset.unit: ''"),
    ):
        file.write_text(text)
        with pytest.raises(EffectError, match=rf"mine\.py: {words}"):
            catalogue(tmp_path)


LAW_FILE = (
    USER_FILE
    + '''
from dataclasses import dataclass

from datagen.effects.self_weight import self_weight
from datagen.materials import Hyperelastic

@dataclass(frozen=True)
class Own:
    """A law under postponed annotations, which dataclasses look up by the module."""

    share: float
    law: Hyperelastic = Hyperelastic()
'''
)


def test_a_users_file_may_hold_classes_and_import_effects(tmp_path: FilePath) -> None:
    file = tmp_path / "own.py"
    file.write_text("from __future__ import annotations\n" + LAW_FILE)
    assert catalogue(tmp_path)["self_weight"] is catalogue()["self_weight"]
    (own,) = effects_of_file(file)
    assert own.name == "gauge_offset"


def test_observers_change_what_is_reported() -> None:
    problem = baseline(named_device(), mesh_level("draft"))

    def camera(outputs, nodes, x):  # type: ignore[no-untyped-def]
        return outputs | {"inflation": 1.02 * outputs["inflation"]}

    from datagen.solver import solve

    path = Path(np.array([20e3]))
    plain = solve(problem, path)
    seen = solve(replace(problem, observers=(camera,)), path)
    ratio = seen.output("inflation") / plain.output("inflation")
    assert ratio == pytest.approx(1.02)
    assert np.array_equal(seen.output("tip_deflection"), plain.output("tip_deflection"))
