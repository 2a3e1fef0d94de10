"""Path following: equilibria of one problem under growing, falling or turning pressure.

The path's own length is the continuation parameter, so that the path may turn in
pressure, in cavity volume or in both.  Wanted pressures are hit exactly, by a corrector
at fixed pressure; all other steps are corrected in the plane across the path.

Predictor: cubic Hermite extrapolation of the last two points and their tangents, and of
the stress by itself.

Time runs with the pressure, evenly between two targets; where the pressure is held it
passes in one step.  What a body has at rest it has had for long.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from .adjoint import Adjoint
from .chart import Chart, Point, extrapolate, largest
from .control import Counters, Options, Outcome, StepFailed
from .corrector import Corrector
from .equilibrium import Equilibrium, InvertedElement, Workspace
from .journey import Journey
from .overlap import overlapping
from .problem import Body, Problem
from .response import OUTPUT_NAMES
from .sensitivity import Direction, Sensitivity, follows_path

Array = np.ndarray

REST = 1e9
"""Time for which a body has rested before the path begins, s: some thirty years."""

HALVINGS = 8
"""Of a step in which walls have met."""


class PathFollower:
    """Follows the equilibrium path of one problem.

    Parameters
    ----------
    problem : Body
    workspace : Workspace, optional
        Shared by problems of the same topology.
    options : Options, optional
    directions : sequence of Direction, optional
        Parameters by which the outputs are differentiated at every kept point.
    """

    def __init__(
        self,
        problem: Body,
        workspace: Workspace | None = None,
        options: Options | None = None,
        directions: Sequence[Direction] = (),
    ) -> None:
        self.problem = problem
        self.workspace = workspace or Workspace()
        self.options = options or Options()
        self.equations = Equilibrium(problem, self.workspace)
        laws = [law for one in directions for law in one.problem.laws]
        self._body_remembers = any(law.history_size for law in problem.laws)
        self._remembers = self._body_remembers or any(law.history_size for law in laws)
        self._swells = any(
            one.swellings for one in (problem, *(d.problem for d in directions))
        )
        self.counters = Counters()
        self.limit: Point | None = None
        self.turned = False
        self.self_contact: float | None = None  # pressure at which balloons met, Pa
        self._clock = self.due = 0.0  # time at the last point and at the target, s
        self._thin = problem.thin
        self._before: Point | None = None
        self._keep_all, self._past_limits = False, False
        self._length = 0.0  # of the path so far
        self._heading = 1.0
        self.first_volume = self.equations.volume(problem.nodes)
        self.corrector = Corrector(
            problem, self.equations, self.workspace, self.options, self.counters
        )
        self._sensitivity: Sensitivity | Adjoint | None = None
        if directions:
            assert isinstance(problem, Problem), "outputs are those of a device"
            self._sensitivity = (Sensitivity if follows_path(problem) else Adjoint)(
                problem, directions, self.workspace, self.corrector
            )
        # Memories that fade ask for short steps in time.  Those of directions alone
        # take them between the points of the path.
        fades = any(getattr(law, "fades", False) for law in (*problem.laws, *laws))
        parts = self.options.fading_parts if fades else 1
        self.parts, self._parts_between = parts, 1
        if self._adjoint is not None:
            self.parts, self._parts_between = 1, parts
        self.point: Point = None  # type: ignore[assignment]  # the start needs to know
        self.point = self._start()
        if isinstance(self._sensitivity, Sensitivity):
            self.differentiate()  # its guesses start from here
        self._remember(self.point, REST)
        first = self.options.first_step * self._thin
        self._step = first / (largest(self.point.direction) or 1.0)
        self._smallest = self.options.smallest_step * self._step

    @property
    def _adjoint(self) -> Adjoint | None:
        """What differentiates the path of a body without memory."""
        found = self._sensitivity
        return found if isinstance(found, Adjoint) else None

    def _correct(
        self,
        x: Array,
        pressure: float,
        dt: float,
        plane: tuple[Chart, float] | None = None,
        expected: Array | None = None,
    ) -> Point:
        """The point of the path next to a prediction, see `Corrector.correct`."""
        found = self.corrector.correct(x, pressure, dt, plane, expected)
        return self.corrector.point(*found, dt, self.point)

    def differentiate(self) -> None:
        """Let the point at rest, which few paths keep, have its derivatives."""
        if self.point.jacobian is None:
            self.point = self._differentiated(self.point, REST)

    def _differentiated(self, point: Point, dt: float) -> Point:
        """The point with derivatives, NaN where they grow without bound.

        Only for points that are accepted: a refused one may lie on another branch.
        """
        sensitivity, corrector = self._sensitivity, self.corrector
        if sensitivity is None:
            return point

        def visit(last: bool) -> Array | None:
            where = self._length
            return sensitivity.visit(point, dt, self.first_volume, where, last)

        jacobian: Array | None = None
        try:
            jacobian = visit(last=False)
            if jacobian is None:  # the corrector's factorisation was not near enough
                corrector.factorise(
                    corrector.evaluate(point.x, point.pressure, dt, True)
                )
                jacobian = visit(last=True)
        except (StepFailed, InvertedElement):
            jacobian = None
        if jacobian is None:
            shape = (len(OUTPUT_NAMES), len(sensitivity.names))
            jacobian = np.full(shape, np.nan)
        return replace(point, jacobian=jacobian)

    # -- the path ------------------------------------------------------------------

    def _start(self) -> Point:
        """Equilibrium at zero gauge pressure; growth and weight are led in."""
        problem, eq = self.problem, self.equations
        pressure = problem.pressure_offset
        x, share, step = problem.nodes, 0.0, 0.5
        if not problem.loaded_at_rest:
            return self._correct(x, pressure, REST)
        corrector = self.corrector
        known: list[tuple[float, Array]] = [(0.0, x)]
        while share < 1:
            target = min(1.0, share + step)
            eq.set_share(target)
            try:
                guess = extrapolate(known[-3:], target)
                found = corrector.correct(guess, target * pressure, REST)
            except StepFailed:
                self.counters.rejected += 1
                step = (target - share) / 4
                if step < 1e-4:
                    raise
                continue
            share, step = target, (1.5 if corrector.effort > 1 else 2.5) * step
            known.append((share, found[0]))
        return corrector.point(*found, REST, None)

    def _accept(self, point: Point, x_predicted: Array, moved: float) -> None:
        """Move on to a point and choose the next step from the prediction's error."""
        options = self.options
        error = largest(point.x - x_predicted) / self._thin
        order = 2 if self._before is None else 4
        wanted = options.predictor_error / max(error, 1e-12)
        # A corrector that had to factorise again was close to failing.
        growth = options.largest_growth if self.corrector.effort == 1 else 1.0
        factor = min(growth, max(0.3, 0.9 * wanted ** (1 / order)))
        self._step = max(moved * factor, 2 * self._smallest)
        self._before, self.point = self.point, point
        self.counters.steps += 1

    def _remember(self, point: Point, dt: float) -> None:
        """Let the step of duration `dt` that led to a point be part of the history."""
        if self._sensitivity is not None:
            self._sensitivity.keep(point, dt)
        self.equations.history = self.corrector.history

    def _looked_between(self, point: Point, dt: float) -> float:
        """Let directions remember the way to a new point; the time left of dt, s.

        The body has no memory, so that its path is known between two points as well as
        at them, and theirs need no equilibrium of their own.
        """
        here, parts, passed = self.point, self._parts_between, 0.0
        adjoint, whole = self._adjoint, point.pressure - here.pressure
        if adjoint is None or parts == 1 or not whole:
            return dt
        chart = Chart(point, here, here.normal + point.normal)
        first = chart.measure(here.x)
        for share in np.arange(1, parts) / parts:
            x, pressure = chart.at((1 - share) * first)
            now = (pressure - here.pressure) / whole
            if chart.before is None or not passed < now < 1:
                continue
            between = replace(point, x=x, pressure=pressure)
            with suppress(InvertedElement):
                adjoint.keep(between, (now - passed) * dt)
                passed = now
        return (1 - passed) * dt

    def advance(self, pressure: float) -> bool:
        """One step towards a cavity pressure, Pa; True when it was reached.

        Raises
        ------
        StepFailed
            When even the smallest step fails.
        """
        # A memory keeps where the pressure has been: with one the pressure stays on its
        # course in time while it can, and never goes past the target.
        timed = self._remembers
        while True:
            here = self.point
            chart = Chart(here, self._before)
            furthest = self._heading * self._step
            s = chart.reach(pressure, furthest)
            hit = s is not None
            if s is None:
                s = furthest
                # Do not stop just short of the target: share the way evenly.
                further = chart.reach(pressure, 1.5 * furthest)
                if further is not None:
                    s = 0.6 * further
            x, predicted = chart.at(s)
            goal = pressure if hit else predicted
            try:
                dt = self.due - self._clock
                if not hit:
                    whole = max(abs(pressure - here.pressure), 1e-9)
                    dt *= min(1.0, abs(goal - here.pressure) / whole)
                plane = None if hit or timed else (chart, s)
                expected = chart.stress(s)
                point = self._correct(x, goal, dt, plane, expected)
                if largest(point.x - x) > self.options.largest_error * self._thin:
                    detail = "the solution left its branch"
                    raise StepFailed("step_too_small", detail)
                past = (point.pressure - pressure) * (here.pressure - pressure) < 0
                if past and self._remembers:
                    raise StepFailed("step_too_small", "the pressure went too far")
            except StepFailed as failure:
                self.counters.rejected += 1
                timed = False
                self._step = abs(s) / 2
                if self._critical(goal):
                    raise StepFailed("limit_point", "stability is lost") from failure
                if self._step < self._smallest:
                    raise
                continue
            self._length += abs(s)
            left = self._looked_between(point, dt)
            if self._wants_derivatives(hit):
                point = self._differentiated(point, left)
            self._remember(point, left)
            self._clock += dt
            self._accept(point, x, abs(s))
            self.turned = self.limit is None and here.slope > 0 >= point.slope
            if self.turned:
                self.limit = self.locate_limit()
            return hit

    def _settle(self, dt: float) -> None:
        """Equilibrium at the pressure held, `dt` later, grown up to the target's time.

        Raises
        ------
        StepFailed
        """
        begun, done, part = self._clock, 0.0, 1.0
        while done < 1:
            old, part = self.point, min(part, 1.0 - done)
            larger = self._grow(begun + (done + part) * (self.due - begun))
            try:
                x = self._enlarged(old.x, larger)
                point = self._correct(x, old.pressure, part * dt, expected=old.stress)
            except StepFailed:
                self.counters.rejected += 1
                self._grow(begun + done * (self.due - begun))
                part /= 4
                if part < 1e-3:
                    raise
                continue
            if self._wants_derivatives(dt > 0):
                point = self._differentiated(point, part * dt)
            self._remember(point, part * dt)
            if self._before is not None:
                # The way here was another one; its shape is the best guess of the next.
                before = self._before
                self._before = replace(
                    before,
                    x=before.x + (point.x - old.x),
                    stress=before.stress + (point.stress - old.stress),
                )
            self.point = point
            self.counters.steps += 1
            done += part
        self._clock += dt

    def _grow(self, time: float) -> float:
        """Let what swells be what it is at a time, s; how much larger than before."""
        if not self._swells:
            return 1.0
        if self._sensitivity is not None:
            self._sensitivity.set_time(time)
        return self.equations.set_time(time)

    def _enlarged(self, x: Array, factor: float) -> Array:
        """Nodes (n, 3) as they would lie, factor times larger, but for what is held.

        The pressure of a body does not depend on its size: it is the equilibrium away
        from the clamp.
        """
        nodes, held = self.problem.nodes, self.problem.fixed[:, 2]
        centre = np.array([0.0, 0.0, nodes[held, 2].mean() if held.any() else 0.0])
        moved = (factor - 1.0) * (x - centre)
        larger: Array = x + self.equations.extend(self.equations.restrict(moved))
        return larger

    def wait(self, time: float, held: bool) -> None:
        """Let the next target be due at a time, s; `held` at the pressure there is.

        Raises
        ------
        StepFailed
        """
        self._clock, self.due = self.due, time
        if held and (self._remembers or self._swells):
            self._settle(self.due - self._clock)
        elif self._swells and self._adjoint is None:
            self._settle(0.0)
        else:
            self._grow(time)  # of directions alone: the body stays as it is

    def head_for(self, pressure: float) -> None:
        """Go the way along the path on which a pressure, Pa, lies."""
        up = pressure > self.point.pressure
        self._turn(1.0 if up == (self.point.slope > 0) else -1.0)

    def _turn(self, heading: float) -> None:
        """Go along the path (1) or back (-1); a law with memory goes another way."""
        if heading == self._heading:
            return
        self._heading = heading
        if self._body_remembers:
            self._before = None
            self._step *= self.options.turned

    def _critical(self, predicted: float) -> bool:
        """True at a point where stability is lost and the path does not go on smoothly.

        Balloons that have inflated alike go different ways there: the tangent is
        definite at the last point and not at the prediction, whose pressure is the same
        but for a ten thousandth, and the corrector does not reach it.
        """
        here = self.point
        close = abs(predicted - here.pressure) <= 1e-4 * abs(here.pressure)
        lost = self.corrector.predicted_negative > here.negative == 0
        return close and lost and not self._past_limits

    def _wants_derivatives(self, hit: bool) -> bool:
        """True for points that are kept; for all where the laws have a history."""
        if self._sensitivity is None:
            return False
        return hit or self._keep_all or self._sensitivity.has_history

    def locate_limit(self) -> Point:
        """The point between the last two where the pressure is highest."""
        a, b = self._before, self.point
        assert a is not None
        best = max(a, b, key=lambda point: point.pressure)
        scale = abs(a.slope) + abs(b.slope)
        for _ in range(6):
            chart = Chart(b, a, a.normal + b.normal)
            s = chart.turning()
            x, pressure = chart.at(s)
            try:
                best = self._correct(x, pressure, 0.0, (chart, s))
            except StepFailed:
                break
            if abs(best.slope) < 1e-3 * scale:
                break
            a, b = (best, b) if best.slope * a.slope > 0 else (a, best)
        return best

    def watch(self) -> None:
        """Note where neighbouring balloons have met on the way to the last point."""
        problem, here = self.problem, self.point
        if self.self_contact is not None or not isinstance(problem, Problem):
            return
        mesh, design = problem.mesh, problem.design
        if design.divisions_x * design.divisions_y == 1:
            return
        if not overlapping(mesh, here.x):
            return
        self.self_contact = self.first_where(lambda x: overlapping(mesh, x))

    def first_where(self, true: Callable[[Array], bool]) -> float:
        """Cavity pressure, Pa, from which on something is true of the nodes (n, 3).

        It is true of the last point; looked for by halving the step that led there.
        """
        here, before = self.point, self._before
        found = here.pressure
        if before is None or true(before.x):
            return found
        chart = Chart(here, before, before.normal + here.normal)
        false, later = chart.measure(before.x), 0.0
        for _ in range(HALVINGS):
            middle = (false + later) / 2
            x, pressure = chart.at(middle)
            if true(x):
                later, found = middle, pressure
            else:
                false = middle
        return found

    def run(
        self,
        targets: Array,
        times: Array | None = None,
        keep_all: bool = False,
        far_enough: Callable[[Point], bool] | None = None,
    ) -> Outcome:
        """Visit gauge pressures in turn, as far as the path goes.

        Parameters
        ----------
        targets : (s,) array, Pa
        times : (s,) array, s, optional
            Of each target; one second a target where not given.
        keep_all : bool
            Keep the points on the way and the limit point, too.
        far_enough : callable, optional
            Go on past a limit point until this is true of a point; all points there
            are kept.  Without it the path ends at the limit point.

        Returns
        -------
        Outcome
        """
        self._keep_all = keep_all
        self._past_limits = far_enough is not None
        times = np.arange(1.0, len(targets) + 1) if times is None else times
        self.due = min(0.0, float(times[0]) - 1.0)
        return Journey(self, keep_all, far_enough).go(targets, times)
