"""What every effect must keep to, checked on a small device: ours and a user's alike.

`CHECKS` reads like the specification: each is one function whose docstring is the
requirement.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array

from ..device import Design
from ..equilibrium import Equilibrium
from ..levels import MeshLevel
from ..observe import Instruments
from ..problem import FIELDS, STAGES, Problem
from ..response import CONVERGED, OUTPUT_NAMES, Response
from ..solver import solve
from .acting import fault, told
from .door import AUTHORS_ERRORS, Effect
from .trial import (
    PATH,
    STEP,
    Ground,
    NoAnswer,
    State,
    Subject,
    differing,
    leaves,
    spelled,
)

Array = np.ndarray

DEPARTURES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
"""Of the way from off to the end of the range; the effect has to fade from one to the
next.  The first two tell for most; an effect that is saturated there, as a support a
thousand times softer than the body, is followed closer to off.  A jump stays a jump."""

LEAST_ORDER = 0.4
"""Of the fading with the departure: 1 where the outputs have a slope, 0 for a jump."""

NOISE = 1e-6
"""Of an output's largest value on the path: what the solver's tolerance leaves."""

PROPER_ENDS = ("completed", "limit_point", "contact")
"""Path status that physics may have; the others are numerical failures."""

DIFFERENCE = 1e-4
"""Largest movement of a node, over the thinnest wall, to difference the residual by."""

TANGENT_ERROR = 1e-5
"""Between the tangent and differences of the residual, relative."""


@dataclass(frozen=True)
class Finding:
    """Outcome of one check: whether it passed, one sentence, and the numbers in it."""

    passed: bool
    why: str
    numbers: Mapping[str, float]


@dataclass(frozen=True)
class Result:
    """One line of a report.

    Parameters
    ----------
    check : str
        Name of the check, see `CHECKS`.
    asks : str
        The requirement.
    passed : bool
    why : str
        What was found, in one sentence.
    numbers : mapping of str to float
        What was measured, relative where no unit is in the name.
    """

    check: str
    asks: str
    passed: bool
    why: str
    numbers: Mapping[str, float]


@dataclass(frozen=True)
class Report:
    """What the checks found of one effect."""

    effect: str
    results: tuple[Result, ...]

    @property
    def passed(self) -> bool:
        return all(result.passed for result in self.results)

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the checks that failed."""
        return tuple(result.check for result in self.results if not result.passed)


Check = Callable[[Subject], Finding]
"""One requirement: looks at an effect, says what it found."""


def documented(subject: Subject) -> Finding:
    """Its text holds an equation; every parameter has a unit and a source."""
    effect = subject.effect
    lacks = [
        f"{p.name} has no {what}"
        for p in effect.parameters
        for what in ("unit", "source")
        if not getattr(p, what).strip()
    ]
    if not re.search(r"\S *[=<>] *\S", effect.doc):
        lacks.insert(0, "the docstring has no equation (no line with '=')")
    words = "; ".join(lacks) or "equation, units and sources are there"
    return Finding(not lacks, words, {"lacking": len(lacks)})


def stage(subject: Subject) -> Finding:
    """It changes what its stage is there for, and nothing that belongs to a later one.

    Effects act in the order of their stages, and only some stages act on specimens.
    """
    own = subject.effect.stage
    until = STAGES[: STAGES.index(own) + 1]
    changed: set[str] = set()
    for values in (subject.middle, *subject.corners):
        given = subject.ground.problem()
        changed |= _changed(given, subject.effect.apply(given, values))
    early = changed.difference(*(FIELDS[one] for one in until))
    words = f"changes {', '.join(sorted(changed)) or 'nothing'}"
    if early:
        last = next(one for one in reversed(STAGES) if early & {*FIELDS[one]})
        words += f"; {', '.join(sorted(early))} is for stage {last!r}, not {own!r}"
    elif changed and not changed & {*FIELDS[own]}:
        words += f", but not what stage {own!r} is for: {', '.join(FIELDS[own])}"
        early = changed
    return Finding(not early, words, {"misplaced": len(early)})


def off(subject: Subject) -> Finding:
    """At its off values it gives back the problem itself, or one bit-equal in outputs.

    Left out and given by name alike.
    """
    for values in ({}, subject.effect.off):
        problem = subject.ground.problem()
        there = subject.effect.apply(problem, values)
        if there is problem:
            continue
        found = solve(there, PATH, subject.ground.workspace).values
        want = subject.ground.response.values
        if not np.array_equal(found, want, equal_nan=True):
            apart = float(np.nanmax(np.abs(found - want)[0] / subject.ground.scale))
            words = (
                f"another problem comes back at {spelled(subject.effect.off)}, and its "
                f"outputs differ from the baseline's by {apart:.1e}"
            )
            return Finding(False, words, {"difference": apart})
    return Finding(True, "the baseline comes back, bit for bit", {"difference": 0.0})


def pure(subject: Subject) -> Finding:
    """It leaves the problem that it is given as it was, and answers alike twice."""
    effect, values = subject.effect, subject.middle
    untouched, given = subject.ground.problem(), subject.ground.problem()
    first, second = effect.apply(given, values), effect.apply(given, values)
    written = differing(untouched, given)
    if written:
        words = f"writes into the given problem: {', '.join(written)}; change a copy"
        return Finding(False, words, {"written": len(written)})
    state = subject.state

    def residual(problem: Problem) -> Array:
        equations = Equilibrium(problem, subject.ground.workspace)
        return equations.evaluate(state.x, state.pressure, STEP).residual

    def outputs(problem: Problem) -> Array:
        return Instruments(problem).read(state.x, state.volume)

    apart = differing(first, second)
    if not np.array_equal(residual(first), residual(second)):
        apart.append("residual")
    if not np.array_equal(outputs(first), outputs(second)):
        apart.append("outputs")
    if apart:
        words = f"two calls with the same values differ in {', '.join(sorted(apart))}"
        return Finding(False, words, {"differing": len(apart)})
    return Finding(True, "the given problem is untouched, twice the same", {})


def topology(subject: Subject) -> Finding:
    """Mesh, shapes and symmetry stay; every number in the problem is finite."""
    for values in (subject.middle, *subject.corners):
        given = subject.ground.problem()
        changed = subject.effect.apply(given, values)
        wrong = _fault(given, changed)
        if wrong:
            return Finding(False, f"{wrong}, at {spelled(values)}", {})
    return Finding(True, "mesh, shapes and symmetry are kept, all is finite", {})


def continuous(subject: Subject) -> Finding:
    """Close to off the outputs tend to the baseline's, without a jump."""
    numbers: dict[str, float] = {}
    for up in subject.rays:
        sizes: list[Array] = []
        shares: list[float] = []
        jumps = np.ones(1, dtype=bool)
        for share in DEPARTURES:
            values = subject.towards(up, share)
            if values == subject.effect.off:
                return Finding(True, "has only whole-number parameters", {})
            found = subject.response(values)
            if found.path_status != ("completed",):
                words = f"no path at {spelled(values)}: {_end(found)}"
                return Finding(False, words, {})
            sizes = [*sizes, subject.ground.change(found)][-2:]
            shares = [*shares, share][-2:]
            if len(sizes) < 2:
                continue
            # Each output by itself: a smooth large one must not hide another's jump.
            jumps = (sizes[1] > NOISE) & (
                sizes[1] > sizes[0] * (shares[1] / shares[0]) ** LEAST_ORDER
            )
            if not jumps.any():
                break
        far, near = (float(size.max()) for size in sizes)
        side = "upwards" if up else "downwards"
        numbers |= {f"change_{side}_far": far, f"change_{side}_near": near}
        if jumps.any():
            k = int(np.argmax(np.where(jumps, sizes[1], 0.0)))
            words = (
                f"{OUTPUT_NAMES[k]} jumps: it changes by {sizes[0][k]:.1e} at "
                f"{spelled(subject.towards(up, shares[0]))} and still by "
                f"{sizes[1][k]:.1e} at {spelled(subject.towards(up, shares[1]))}"
            )
            return Finding(False, words, numbers)
    words = ", ".join(
        f"from {numbers[f'change_{side}_far']:.1e} to "
        f"{numbers[f'change_{side}_near']:.1e} {side}"
        for side in ("upwards", "downwards")
        if f"change_{side}_far" in numbers
    )
    words = f"a tenth of the departure changes the outputs less: {words}"
    return Finding(True, words, numbers)


def finite(subject: Subject) -> Finding:
    """At the ends of its range paths are followed, with finite numbers, to 20 kPa.

    Or to an end that physics may have past the first load step, 10 kPa: a limit point,
    or roof and floor that touch.
    """
    reached = np.inf
    for values in subject.corners:
        found = subject.response(values)
        converged = found.status[0] == CONVERGED
        if found.path_status[0] not in PROPER_ENDS or not converged[1]:
            words = f"no path at {spelled(values)}: {_end(found)}"
            return Finding(False, words, {})
        if not np.isfinite(found.values[0][converged]).all():
            bad = ~np.isfinite(found.values[0][converged]).all(axis=0)
            names = ", ".join(np.array(OUTPUT_NAMES)[bad])
            return Finding(False, f"{names} not finite at {spelled(values)}", {})
        reached = min(reached, float(found.pressure[0][converged].max()))
    corners = len(subject.corners)
    words = (
        f"{corners} corner{'s' if corners > 1 else ''} of the range, each followed to "
        f"{reached / 1e3:g} kPa"
    )
    return Finding(True, words, {"reached_Pa": reached})


def moves(subject: Subject) -> Finding:
    """It moves at least one output by more than the solver's tolerance."""
    known = []
    for values in subject.corners:
        with suppress(NoAnswer):  # is the finding of `finite`
            change = subject.ground.change(subject.response(values))
            known += [change] if np.isfinite(change).all() else []
    if not known:
        return Finding(False, "no path at the ends of its range to compare", {})
    largest = np.max(known, axis=0)
    k = int(largest.argmax())
    numbers = dict(zip(OUTPUT_NAMES, map(float, largest), strict=True))
    if largest[k] <= NOISE:
        words = (
            f"no output changes by more than {NOISE:g} of its largest value: "
            f"{OUTPUT_NAMES[k]} by {largest[k]:.1e}"
        )
        return Finding(False, words, numbers)
    words = f"{OUTPUT_NAMES[k]} by up to {100 * largest[k]:.3g} % of its largest value"
    return Finding(True, words, numbers)


def tangent(subject: Subject) -> Finding:
    """The tangent is the derivative of the residual, with the effect in both.

    K v against (R(x + h v) - R(x - h v)) / 2h at the deformed state, once as one step
    from rest and once as a step on from the history; v along the path, along the
    displacement, and a smooth field at random.
    """
    state = subject.state
    fresh = Equilibrium(state.problem, subject.ground.workspace)
    steps = [("from rest", fresh)]
    if any(law.history_size for law in state.problem.laws):
        steps.append(("after loading", state.equations))
    worst, place = 0.0, ""
    for name, equations in steps:
        for kind, field in _directions(state):
            error = _tangent_error(equations, state, field)
            if not error <= worst:
                worst, place = error, f"{name}, {kind}"
    words = f"differs from differences by {worst:.1e} at most ({place})"
    passed = worst <= TANGENT_ERROR
    if not passed:
        words += f"; allowed {TANGENT_ERROR:g}"
    return Finding(passed, words, {"difference": worst})


CHECKS: tuple[Check, ...] = (
    documented,
    off,
    pure,
    topology,
    stage,
    continuous,
    finite,
    moves,
    tangent,
)
"""The specification of an effect, cheap requirements first."""


def check(
    effect: Effect,
    design: Design | None = None,
    level: str | MeshLevel = "draft",
    ground: Ground | None = None,
) -> Report:
    """Check an effect against every requirement.

    Parameters
    ----------
    effect : Effect
        Built in, or from a user's file.
    design : Design, optional
        The device on which it is tried; S1 where it is not given.
    level : str or MeshLevel
        Of the mesh.
    ground : Ground, optional
        To share between effects; in place of `design` and `level`.

    Returns
    -------
    Report
        A check that the effect's own code stops with an error has failed.
    """
    subject = Subject(effect, ground or Ground(design, level))
    return Report(effect.name, tuple(run(one, subject) for one in CHECKS))


def run(one: Check, subject: Subject) -> Result:
    """Run one check; an error in the author's code is a finding."""
    try:
        found = one(subject)
    except NoAnswer as error:
        found = Finding(False, str(error), {})
    except AUTHORS_ERRORS as error:
        found = Finding(False, told(subject.effect, error), {})
    asks = (one.__doc__ or "").splitlines()[0]
    return Result(one.__name__, asks, found.passed, found.why, found.numbers)


def _end(response: Response) -> str:
    """How a path ended, in words."""
    return response.message[0] or response.path_status[0]


def _fault(given: Problem, changed: Problem) -> str:
    """What an effect has done to a problem that it must not, or nothing."""
    wrong = fault(given, changed)
    if wrong:
        return wrong
    if changed.design is not given.design:
        return "the design is another one; outputs are read by its sizes"
    before = dict(leaves(given))
    for name, value in leaves(changed):
        if not isinstance(value, (np.ndarray, float)) or isinstance(value, bool):
            continue
        was = before.get(name)
        if isinstance(was, np.ndarray) and np.shape(value) != was.shape:
            return f"{name} has shape {np.shape(value)}, not {was.shape}"
        if not np.isfinite(value).all():
            return f"{name} is not finite"
    if changed.gravity[1] != 0:
        return "gravity has a part along y, across the plane of symmetry"
    if not changed.fixed[changed.mesh.mid_plane, 1].all():
        return "nodes of the plane of symmetry may leave it"
    aside = changed.nodes[changed.mesh.mid_plane, 1]
    if np.abs(aside).max() > 1e-9 * changed.thin:
        return "nodes of the plane of symmetry are moved out of it"
    return ""


def _changed(given: Problem, changed: Problem) -> set[str]:
    """Fields of the stages that are not what they were; of a tuple, its parts."""

    def same(was: object, value: object) -> bool:
        if isinstance(was, np.ndarray) and isinstance(value, np.ndarray):
            return np.array_equal(was, value)
        if isinstance(was, tuple) and isinstance(value, tuple):
            alike = (a is b for a, b in zip(was, value, strict=False))
            return len(was) == len(value) and all(alike)
        return was is value or (isinstance(was, float) and was == value)

    return {
        name
        for names in FIELDS.values()
        for name in names
        if not same(getattr(given, name), getattr(changed, name))
    }


def _directions(state: State) -> list[tuple[str, Array]]:
    """Fields (n, 3) in which the tangent is tried, each with its name."""
    nodes = state.problem.nodes
    rng = np.random.default_rng(0)
    span = np.ptp(nodes, axis=0)
    phase = nodes / span @ (2 * np.pi * rng.normal(size=(3, 3)))
    return [
        ("along the path", state.direction),
        ("along the displacement", state.x - nodes),
        ("in a random field", np.sin(phase + rng.uniform(0, 2 * np.pi, 3))),
    ]


def _tangent_error(equations: Equilibrium, state: State, field: Array) -> float:
    """Relative difference of K v and the differenced residual; 0 where v is nothing."""
    v = equations.restrict(field)
    size = float(np.abs(v).max())
    if size == 0:
        return 0.0
    step = DIFFERENCE * state.problem.thin / size
    move = step * equations.extend(v)
    ahead, behind = (
        equations.evaluate(state.x + sign * move, state.pressure, STEP).residual
        for sign in (1, -1)
    )
    values = equations.evaluate(state.x, state.pressure, STEP, tangent=True).tangent
    pattern = equations.pattern
    upper = csr_array((values, pattern.indices, pattern.indptr), shape=(len(v), len(v)))
    product = upper @ v + upper.T @ v - diags_array(upper.diagonal()) @ v
    slope = (ahead - behind) / (2 * step)
    largest = max(np.abs(product).max(), np.abs(slope).max())
    return float(np.abs(product - slope).max() / largest)
