"""What an author of effects may get wrong, and what becomes of it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest

from datagen.device import named_device
from datagen.effects import Effect, catalogue, effect
from datagen.effects.acting import act
from datagen.effects.door import SHA256, effects_of_file
from datagen.errors import EffectError
from datagen.levels import mesh_level
from datagen.linear import default_backend, make_solver
from datagen.problem import Problem, baseline
from datagen.space import Parameter
from datagen.specimens import Tensile, tensile_body

AMOUNT = Parameter("amount", "1", 0.0, 1.0, off=0.0, source="a test")


@pytest.fixture(scope="module")
def problem() -> Problem:
    return baseline(named_device("S1"), mesh_level("draft"))


def of(change: Callable[[Problem, float], object]) -> Effect:
    """An effect of one parameter, `amount`."""

    def wrong(problem: Problem, amount: float) -> object:
        """x = amount."""
        return change(problem, amount)

    return effect("material", [AMOUNT])(wrong)  # type: ignore[arg-type]


def test_arrays_that_are_written_into_are_the_effects_own(problem: Problem) -> None:
    before = problem.shear_modulus.copy()

    def in_place(problem: Problem, amount: float) -> Problem:
        modulus = problem.shear_modulus
        modulus *= 1 + amount
        return replace(problem, shear_modulus=modulus)

    for _ in range(2):
        found = act(of(in_place), problem, {"amount": 0.5})
        assert np.array_equal(found.shear_modulus, 1.5 * before)
        assert np.array_equal(problem.shear_modulus, before)
        assert found.nodes is problem.nodes  # untouched: shared, not compared later


def test_what_refers_to_a_given_array_goes_on_sharing_it(problem: Problem) -> None:
    def bent(problem: Problem, amount: float) -> Problem:
        moved = problem.nodes + amount * 1e-6
        return replace(problem, nodes=moved, datum=problem.nodes)

    assert act(of(bent), problem, {"amount": 0.5}).datum is problem.nodes


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda p, a: p.soft,
            r"AttributeError: .* 'soft' \(test_acting.py, line \d+\)",
        ),
        (lambda p, a: {}["soft"], r"KeyError: 'soft' \(test_acting.py, line \d+\)"),
        (lambda p, a: sys.exit(3), r"SystemExit: 3 "),
        (lambda p, a: None, r"gives a NoneType, not a Problem, at amount=0.5"),
        (
            lambda p, a: replace(p, density=np.ones(5)),
            r"density has shape \(5,\), not \(\d+,\), at amount=0.5",
        ),
        (
            lambda p, a: replace(p, shear_modulus=p.shear_modulus * np.nan),
            r"shear_modulus is not finite, at amount=0.5",
        ),
        (
            lambda p, a: replace(p, pressure_gain=float("inf")),
            r"pressure_gain is not finite, at amount=0.5",
        ),
    ],
)
def test_mistakes_are_told_by_effect(
    problem: Problem, change: Callable[[Problem, float], object], words: str
) -> None:
    with pytest.raises(EffectError, match=rf"^effect wrong: {words}"):
        act(of(change), problem, {"amount": 0.5})


def test_what_asks_for_parts_of_a_device_does_not_act_on_a_specimen() -> None:
    body = tensile_body(Tensile(1e6))
    with pytest.raises(AttributeError):
        act(of(lambda p, a: p.design), body, {"amount": 0.5})
    with pytest.raises(EffectError):
        act(of(lambda p, a: p.laws[0].design), body, {"amount": 0.5})  # type: ignore[attr-defined]


def test_what_an_effect_prints_is_no_part_of_an_answer(
    problem: Problem, capsys: pytest.CaptureFixture[str]
) -> None:
    def loud(problem: Problem, amount: float) -> Problem:
        print("here")
        return replace(problem, pressure_offset=amount)

    assert act(of(loud), problem, {"amount": 0.5}).pressure_offset == 0.5
    assert capsys.readouterr() == ("", "here\n")


@pytest.mark.skipif(default_backend() != "pardiso", reason="no MKL PARDISO here")
def test_a_matrix_that_is_not_finite_does_not_end_the_process() -> None:
    """PARDISO wrote past its own memory."""
    indptr, indices = np.array([0, 2, 3]), np.array([0, 1, 1])
    solver = make_solver("pardiso", indptr, indices)
    with pytest.raises(ArithmeticError):
        solver.factorise(np.array([1.0, np.nan, 1.0]))
    solver.factorise(np.array([2.0, 1.0, 2.0]))
    with pytest.raises(ArithmeticError):
        solver.solve(np.array([np.nan, 1.0]))
    assert solver.solve(np.array([3.0, 3.0])) == pytest.approx([1.0, 1.0])


USER_FILE = '''
from dataclasses import replace

from datagen.effects import effect
from datagen.space import Parameter

@effect("load", [Parameter("offset", "Pa", 0.0, 2e3, off=0.0, source="a test")])
def gauge_offset(problem: "Problem", offset):
    """Cavity pressure = gauge pressure + offset."""
    return replace(problem, pressure_offset=problem.pressure_offset + offset)
'''


def test_what_was_loaded_is_known_after_the_file_was_edited(
    tmp_path: FilePath,
) -> None:
    file = tmp_path / "gauge.py"
    file.write_text(USER_FILE)
    first = effects_of_file(file)[0].change.__globals__[SHA256]
    loaded = catalogue(tmp_path)["gauge_offset"]
    file.write_text(USER_FILE.replace("+ offset)", "+ 2 * offset)"))
    assert loaded.change.__globals__[SHA256] == first
    again = catalogue(tmp_path)["gauge_offset"]
    assert again.change.__globals__[SHA256] != first


def test_a_file_that_leaves_the_program_is_told(tmp_path: FilePath) -> None:
    (tmp_path / "mine.py").write_text("import sys\nsys.exit(3)\n")
    code = (
        "from pathlib import Path; from datagen.effects import catalogue\n"
        f"catalogue(Path({str(tmp_path)!r}))"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60
    )
    assert run.returncode == 1 and "mine.py: SystemExit: 3" in run.stderr
