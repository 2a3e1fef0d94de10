"""The conformance checks: ours pass, and each catches what it is there to catch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np
import pytest

from datagen.control import Options
from datagen.effects import Effect, catalogue, effect
from datagen.effects.conformance import CHECKS, NOISE, Report, check, run
from datagen.effects.trial import PATH, Ground, Subject
from datagen.levels import MeshLevel
from datagen.materials import Array, Hyperelastic, LawResult, invariants
from datagen.mesh import UPPER
from datagen.problem import Problem
from datagen.solver import solve
from datagen.space import Parameter

SIZE = Parameter("size", "1", 0.0, 1.0, off=0.0, source="a test")
NAMES = [one.__name__ for one in CHECKS]


COARSE = MeshLevel("coarse", 3, 2, 1, 1, 1, 1, 1, 1, 1.0, 1.0, 1.0, 0.0)
"""A third of the draft mesh's unknowns: enough to see whether rules are kept."""


@pytest.fixture(scope="module")
def ground() -> Ground:
    return Ground(level=COARSE)


def lines(report: Report) -> str:
    return "\n".join(f"{r.check}: {r.passed}: {r.why}" for r in report.results)


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_built_in_effects_conform(name: str, ground: Ground) -> None:
    report = check(catalogue()[name], ground=ground)
    assert report.passed, lines(report)
    assert [result.check for result in report.results] == NAMES


def stiffer(problem: Problem, factor: float) -> Problem:
    return replace(problem, shear_modulus=factor * problem.shear_modulus)


@effect("material", [SIZE])
def undocumented(problem: Problem, size: float) -> Problem:
    """Everything becomes stiffer."""
    return stiffer(problem, 1 + size)


class Unguarded(Effect):
    """Calls the change at its off values, too."""

    def apply(self, problem: Problem, values: Mapping[str, float]) -> Problem:
        return self.change(problem, **self.check(values))


@effect("material", [SIZE])
def almost_off(problem: Problem, size: float) -> Problem:
    """E = E0 (1 + size), and a rounding error."""
    return stiffer(problem, 1 + size + 1e-12)


@effect("material", [SIZE])
def writes(problem: Problem, size: float) -> Problem:
    """E = E0 (1 + size), in place."""
    problem.shear_modulus[:] *= 1 + size
    return problem


CALLS = count()


@effect("material", [SIZE])
def forgets(problem: Problem, size: float) -> Problem:
    """E = E0 (1 + size + 1e-9 n) in the nth call."""
    return stiffer(problem, 1 + size + 1e-9 * next(CALLS))


@effect("observation", [SIZE])
def flickers(problem: Problem, size: float) -> Problem:
    """w = w0 (1 + size + 1e-9 n) in the nth reading."""

    def camera(outputs: dict[str, float], nodes: Array, x: Array) -> dict[str, float]:
        factor = 1 + size + 1e-9 * next(CALLS)
        return outputs | {"inflation": factor * outputs["inflation"]}

    return replace(problem, observers=(*problem.observers, camera))


@effect("body force", [SIZE])
def sideways(problem: Problem, size: float) -> Problem:
    """E = E0 (1 + size), g_y = 1: of a body without mass."""
    return replace(stiffer(problem, 1 + size), gravity=np.array([0.0, 1.0, 0.0]))


@effect("material", [SIZE])
def meshed_anew(problem: Problem, size: float) -> Problem:
    """E = E0 (1 + size), on another mesh."""
    return replace(stiffer(problem, 1 + size), mesh=deepcopy(problem.mesh))


@effect("material", [SIZE])
def misshapen(problem: Problem, size: float) -> Problem:
    """E = E0 (1 + size), the density a single number."""
    return replace(stiffer(problem, 1 + size), density=np.zeros(1))


@effect("material", [SIZE])
def undefined(problem: Problem, size: float) -> Problem:
    """E = E0 (1 + size), rho = 0/0: of a body without gravity."""
    density = np.full_like(problem.density, np.nan)
    return replace(stiffer(problem, 1 + size), density=density)


@effect("geometry", [SIZE])
def too_early(problem: Problem, size: float) -> Problem:
    """E = E0 (1 + size), before the stage at which others make laws and moduli."""
    return stiffer(problem, 1 + size)


@effect("observation", [SIZE])
def too_late(problem: Problem, size: float) -> Problem:
    """E = E0 (1 + size), as if a camera saw it."""
    return stiffer(problem, 1 + size)


@effect("material", [SIZE])
def jumps(problem: Problem, size: float) -> Problem:
    """E = E0 (1.01 + size)."""
    return stiffer(problem, 1.01 + size)


@effect("observation", [SIZE])
def jumps_a_little(problem: Problem, size: float) -> Problem:
    """w = w0 (1 + 10 size), alpha = alpha0 (1 + 1e-4): one large, one with a jump."""

    def camera(outputs: dict[str, float], nodes: Array, x: Array) -> dict[str, float]:
        return outputs | {
            "inflation": (1 + 10 * size) * outputs["inflation"],
            "bending_angle": (1 + 1e-4) * outputs["bending_angle"],
        }

    return replace(problem, observers=(*problem.observers, camera))


@effect("geometry", [replace(SIZE, lower=-1.0)])
def inverts(problem: Problem, size: float) -> Problem:
    """x = x0 (1 + 0.01 size), and z = -z0 past size 0.9."""
    nodes = problem.nodes * np.array([1 + 0.01 * size, 1.0, 1.0 if size < 0.9 else -1])
    return replace(problem, nodes=nodes)


@effect("material", [replace(SIZE, lower=-1.0)])
def collapses(problem: Problem, size: float) -> Problem:
    """E = E0 (1 + 0.1 size), and none past size 0.9."""
    return stiffer(problem, 1 + 0.1 * size if size < 0.9 else 0.0)


@effect("material", [replace(SIZE, lower=-1.0)])
def gives_way(problem: Problem, size: float) -> Problem:
    """E = E0 (1 + 0.1 size), and -E0 past size 0.9: a limit point at once."""
    return stiffer(problem, 1 + 0.1 * size if size < 0.9 else -1.0)


@effect("observation", [replace(SIZE, lower=-1.0)])
def blinds(problem: Problem, size: float) -> Problem:
    """w = w0 (1 + size), 0/0 past size 0.9."""

    def camera(outputs: dict[str, float], nodes: Array, x: Array) -> dict[str, float]:
        factor = 1 + size if size < 0.9 else np.nan
        return outputs | {"inflation": factor * outputs["inflation"]}

    return replace(problem, observers=(*problem.observers, camera))


@effect("body force", [replace(SIZE, upper=1000.0, unit="kg/m3")])
def weightless(problem: Problem, size: float) -> Problem:
    """f = rho g, where g = 0."""
    return replace(problem, density=np.full_like(problem.density, size))


@dataclass(frozen=True)
class WrongTangent:
    """(1 + share) times neo-Hookean, with 1 % more in the tangent."""

    share: float
    history_size: int = 0

    def respond(
        self, f: Array, mu: Array, history: Array, dt: float, tangent: bool
    ) -> LawResult:
        found = Hyperelastic().respond(f, (1 + self.share) * mu, history, dt, tangent)
        return found._replace(tangent=1.01 * found.tangent)


@effect("material", [SIZE])
def wrong_tangent(problem: Problem, size: float) -> Problem:
    """W = (1 + size) W0."""
    return replace(problem, laws=(WrongTangent(size), problem.laws[1]))


@dataclass(frozen=True)
class Damage:
    """Softer by `share` times the highest I1bar - 3 that was there before the step.

    share : float
    slack : float
        What the tangent leaves out of the softening, as a share of it.
    """

    share: float
    slack: float = 0.0
    history_size: int = 1

    def respond(
        self, f: Array, mu: Array, history: Array, dt: float, tangent: bool
    ) -> LawResult:
        found = Hyperelastic().respond(f, mu, history, dt, tangent)
        lost = self.share * history
        seen = np.maximum(history[:, 0], invariants(f)[0] - 3)
        slope = found.tangent
        if tangent:
            slope = slope * (1 - (1 - self.slack) * lost)
        return LawResult(found.stress * (1 - lost), slope, seen[:, None])


@effect("material", [SIZE])
def damage(problem: Problem, size: float) -> Problem:
    """P = (1 - size max(I1bar - 3)) P0."""
    return replace(problem, laws=(Damage(size), Damage(size)))


@effect("material", [SIZE])
def wrong_after_loading(problem: Problem, size: float) -> Problem:
    """P = (1 - size max(I1bar - 3)) P0, with a tangent that is right from rest only."""
    return replace(problem, laws=(Damage(size, 0.1), Damage(size, 0.1)))


BROKEN: dict[str, tuple[Effect, str]] = {
    "documented": (undocumented, "no equation"),
    "off": (Unguarded(**vars(almost_off)), "differ from the baseline's by"),
    "pure": (writes, "writes into the given problem: shear_modulus"),
    "topology": (sideways, "gravity has a part along y"),
    "stage": (too_early, "shear_modulus is for stage 'material', not 'geometry'"),
    "continuous": (jumps, "jumps: it changes by"),
    "finite": (collapses, "no path at size = 1: "),
    "moves": (weightless, "no output changes"),
    "tangent": (wrong_tangent, "differs from differences by"),
}
"""For each check an effect that it alone catches, and what it says."""


@pytest.mark.parametrize("name", NAMES)
def test_a_broken_effect_fails_exactly_its_check(name: str, ground: Ground) -> None:
    broken, words = BROKEN[name]
    report = check(broken, ground=ground)
    assert report.failed == (name,), lines(report)
    why = next(result.why for result in report.results if result.check == name)
    assert words in why


@pytest.mark.parametrize(
    ("name", "broken", "words"),
    [
        ("pure", forgets, "differ in residual, shear_modulus"),
        ("pure", flickers, "differ in outputs"),
        ("topology", meshed_anew, "the mesh is another one"),
        ("topology", misshapen, "density has shape"),
        ("topology", undefined, "density is not finite"),
        ("stage", too_late, "but not what stage 'observation' is for: observers"),
        ("continuous", jumps_a_little, "bending_angle jumps"),
        ("finite", inverts, "is inverted (elements.py, line"),
        ("finite", gives_way, "the path turns at 0."),
        ("finite", blinds, "inflation not finite at size = 1"),
        ("tangent", wrong_after_loading, "after loading"),
    ],
)
def test_other_ways_to_fail_a_check(
    name: str, broken: Effect, words: str, ground: Ground
) -> None:
    result = run(CHECKS[NAMES.index(name)], Subject(broken, ground))
    assert not result.passed
    assert words in result.why


def test_a_law_with_history_is_tried_after_loading(ground: Ground) -> None:
    report = check(damage, ground=ground)
    assert report.passed, lines(report)
    moved = next(result for result in report.results if result.check == "moves")
    assert moved.numbers["inflation"] > 1e-3
    state = Subject(damage, ground).state
    assert all(history.max() > 0.01 for history in state.equations.history)


def failing(change: Callable[..., Problem]) -> Effect:
    return effect("load", [SIZE])(change)


def test_an_error_in_the_authors_code_is_a_finding(ground: Ground) -> None:
    def crashes(problem: Problem, size: float) -> Problem:
        """p = p0 / 0."""
        return replace(problem, pressure_gain=[][int(size)])

    report = check(failing(crashes), ground=ground)
    assert set(report.failed) == set(NAMES) - {"documented", "off"}
    whys = {result.check: result.why for result in report.results}
    assert whys.pop("moves").startswith("no path")
    for name in set(report.failed) & set(whys):
        assert "IndexError: list index out of range (test_conform" in whys[name]


def test_what_is_no_problem_is_told(ground: Ground) -> None:
    def nothing(problem: Any, size: float) -> Any:
        """p = p0 (1 + size), forgotten to return."""

    report = check(failing(nothing), ground=ground)
    whys = {result.check: result.why for result in report.results}
    assert whys["topology"].startswith("gives a NoneType, not a Problem")


def test_the_way_from_off_reaches_every_end(ground: Ground) -> None:
    space = [
        Parameter("a", "1", -1.0, 3.0, off=0.0, source="a test"),
        Parameter("b", "1", 0.0, 2.0, off=2.0, source="a test"),
        Parameter("n", "1", 0, 4, scale="integer", off=0.0, source="a test"),
    ]

    def three(problem: Problem, a: float, b: float, n: float) -> Problem:
        """p = p0 (1 + a (2 - b) n)."""
        return problem

    subject = Subject(effect("load", space)(three), ground)
    assert subject.towards(True, 1.0) == {"a": 3.0, "b": 0.0, "n": 4.0}
    assert subject.towards(False, 0.5) == {"a": -0.5, "b": 1.0, "n": 0.0}
    assert subject.rays == [True, False]
    for parameter in space:
        ends = {values[parameter.name] for values in subject.corners}
        assert ends == {parameter.lower, parameter.upper}


def test_the_noise_is_that_of_the_solver(ground: Ground) -> None:
    """Other steps to the same pressures change outputs by less, yet not far less."""
    options = Options(predictor_error=0.03, first_step=0.05)
    other = solve(ground.problem(), PATH, ground.workspace, options)
    assert other.info["steps"] > ground.response.info["steps"]
    assert ground.change(other).max() < NOISE
    loose = solve(ground.problem(), PATH, ground.workspace, Options(tolerance=3e-5))
    assert ground.change(loose).max() > NOISE


def test_a_ground_may_be_another_device() -> None:
    from datagen.device import named_device

    design = named_device("S1", 4).with_values(upper_thickness=150e-6)
    ground = Ground(design)
    assert ground.problem().thin == 140e-6
    upper = ground.problem().mesh.layer == UPPER
    assert ground.problem().shear_modulus[upper][0] == pytest.approx(2.5e6 / 2.96)
