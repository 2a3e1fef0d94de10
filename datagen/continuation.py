"""Path following: equilibria of one problem under growing, falling or turning pressure.

The arc length of the displacements is the continuation parameter, so that the path may
turn in pressure, in cavity volume or in both.  Wanted pressures are hit exactly, by a
corrector at fixed pressure; all other steps are corrected in the plane across the path
by a bordered system (Riks 1979).

Predictor: cubic Hermite extrapolation of the last two points and their tangents; the
stress is extrapolated by itself.  A membrane's stress at extrapolated positions is far
off, as it magnifies their error by its stiffness; with that of the last points in the
tangent's geometric part the factorisation at the prediction serves the whole step
(the idea is that of the mixed integration point Newton of Magisano, Leonetti and
Garcea 2017).
Corrector: Newton's method that keeps its factorisation while the contraction is good.

Time runs with the pressure, evenly between two targets; where the pressure is held it
passes in one step.  What a body has at rest it has had for long.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from .chart import Chart, Point, expected_stress, extrapolate
from .control import Counters, Options, Outcome, StepFailed
from .equilibrium import Equilibrium, Evaluation, InvertedElement, Workspace
from .linear import NotDefinite
from .loading import loading_direction
from .mixing import Mixing
from .problem import Body, Problem
from .response import OUTPUT_NAMES
from .sensitivity import Direction, Sensitivity

Array = np.ndarray

REST = 1e9
"""Time for which a body has rested before the path begins, s: some thirty years."""

TURNED = 0.3
"""First step after the pressure has turned over the last one before, with memory."""


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
        self._sensitivity: Sensitivity | None = None
        if directions:
            assert isinstance(problem, Problem), "outputs are those of a device"
            self._sensitivity = Sensitivity(problem, directions, self.workspace)
        self._remembers = any(law.history_size for law in problem.laws) or (
            self._sensitivity is not None and self._sensitivity.has_history
        )
        self._swells = any(
            one.swellings for one in (problem, *(d.problem for d in directions))
        )
        self.counters = Counters()
        self.limit: Point | None = None
        self._clock = self._due = 0.0  # time at the last point and at the target, s
        self._thin = problem.thin
        self._tolerance = self.options.tolerance * self._thin
        self._definite = True
        self._before: Point | None = None
        self._keep_all, self._past_limits = False, False
        self._predicted_negative = 0
        self._length = 0.0  # of the path so far
        self._heading = 1.0
        self.first_volume = self.equations.volume(problem.nodes)
        faces = problem.mesh.cavity_faces[:, [0, 2, 8, 6]]
        one, two = (
            problem.nodes[faces[:, i]] - problem.nodes[faces[:, j]]
            for i, j in ((2, 0), (3, 1))
        )
        self._area = float(np.linalg.norm(np.cross(one, two), axis=1).sum() / 2) or 1.0
        self.point: Point = None  # type: ignore[assignment]  # the start needs to know
        self.point = self._differentiated(self._start(), REST)
        self._remember(self.point, REST)
        self._last = [self.point]
        first = self.options.first_step * self._thin
        self._step = first / (_largest(self.point.direction) or 1.0)
        self._smallest = self.options.smallest_step * self._step

    # -- linear algebra ------------------------------------------------------------

    def _factorise(self, evaluation: Evaluation) -> None:
        """Factorise the tangent: Cholesky while it is stable, LDL from then on."""
        assert evaluation.tangent is not None
        self.counters.factorisations += 1
        if self._definite:
            try:
                self._solver = self.workspace.solver(self.problem, definite=True)
                self._solver.factorise(evaluation.tangent)
                return
            except NotDefinite:
                self._definite = False
        self._solver = self.workspace.solver(self.problem, definite=False)
        try:
            self._solver.factorise(evaluation.tangent)
        except ArithmeticError as error:
            raise StepFailed("step_too_small", "the tangent is singular") from error

    def _evaluate(
        self,
        x: Array,
        pressure: float,
        dt: float,
        tangent: bool,
        expected: Array | None = None,
    ) -> Evaluation:
        """Evaluate the equations; an inverted element fails the step."""
        try:
            return self.equations.evaluate(x, pressure, dt, tangent, expected)
        except InvertedElement as error:
            place = self.equations.where(error.element)
            raise StepFailed(
                "inverted_element", f"an element turned inside out {place}"
            ) from error

    def _correct(
        self,
        x: Array,
        pressure: float,
        dt: float,
        plane: tuple[Chart, float] | None = None,
        expected: Array | None = None,
    ) -> Point:
        """Newton from a prediction, at fixed pressure or at a chart's coordinate.

        Parameters
        ----------
        x : (n, 3) array, m
        pressure : float, Pa
        dt : float, s
            Duration of the step, for laws with history.
        plane : chart and its coordinate, optional
            Where to stay; the pressure is then free.
        expected : (27 e, 6) array, Pa, optional
            Stress expected at the solution, for the tangent.

        Raises
        ------
        StepFailed
        """
        eq, options = self.equations, self.options
        fresh, age, best, last = True, 0, np.inf, np.inf
        load = np.zeros(0)
        self._effort = self._predicted_negative = 0
        mixing = Mixing(options.memory)
        across = eq.restrict(plane[0].normal) if plane else np.zeros(0)
        for _ in range(options.iterations):
            self.counters.iterations += 1
            ev = self._evaluate(x, pressure, dt, fresh, expected)
            if fresh:
                self._effort += 1
                if self._effort > options.factorisations:
                    break
                self._factorise(ev)
                if self._effort == 1:
                    self._predicted_negative = self._solver.negative
                both = self._solver.solve(
                    np.stack([-ev.residual, ev.volume_gradient], axis=1)
                )
                step, load = both[:, 0], both[:, 1]
                mixing.clear()
                age = 0
            else:
                step = self._solver.solve(-ev.residual)
                age += 1
            change = 0.0
            if plane is not None:
                lack = plane[1] - plane[0].measure(x) - across @ step
                change = float(lack / (across @ load))
                step = step + change * load
            size = float(np.abs(step).max())
            if not np.isfinite(size) or size > 10 * best:
                break
            if size <= self._tolerance:
                return self._finish(x + eq.extend(step), pressure + change, dt)
            if not fresh and (
                size > 2 * last
                or (age >= options.patience and size > options.contraction * last)
            ):
                fresh = True  # the step is not worth taking: factorise here first
                continue
            fresh, last, best = False, size, min(best, size)
            step, change = mixing.improve(step, change)
            x, pressure = x + eq.extend(step), pressure + change
        raise StepFailed("step_too_small", "Newton's method did not converge")

    def _finish(self, x: Array, pressure: float, dt: float) -> Point:
        """The point of the path at an equilibrium, with its direction there."""
        eq = self.equations
        ev = self._evaluate(x, pressure, dt, False)
        load = loading_direction(
            lambda nodes: self._evaluate(nodes, pressure, dt, False).residual,
            eq,
            self._solver,
            x,
            ev,
            self.options,
        )
        self._pending = ev.history
        direction = eq.extend(load)
        # The length of a step: mean movement of the cavity's walls, and a little of
        # every node's.  All nodes alike would follow the tip, which stands still where
        # it turns while the balloons grow.
        walls = eq.extend(ev.volume_gradient) / self._area
        nodes = self.options.node_share**2 / len(direction)
        normal = np.vdot(walls, direction) * walls + nodes * direction
        length = float(np.sqrt(np.vdot(normal, direction))) or np.inf
        if self.point is not None and np.vdot(normal, self.point.direction) < 0:
            length = -length  # past a limit point the path goes on, the pressure falls
        return Point(
            x=x,
            pressure=pressure,
            volume=ev.volume,
            direction=direction / length,
            normal=normal / length,
            slope=1.0 / length,
            stress=eq.stress(x, dt),
            negative=self._solver.negative,
        )

    def _differentiated(self, point: Point, dt: float) -> Point:
        """The point with derivatives, NaN where they grow without bound.

        Only for points that are accepted: a refused one may lie on another branch.
        """
        sensitivity = self._sensitivity
        if sensitivity is None:
            return point

        def visit() -> Array | None:
            return sensitivity.visit(
                self.equations, self._solver, point, dt, self.first_volume, self._length
            )

        jacobian: Array | None = None
        try:
            jacobian = visit()
            if jacobian is None:  # the corrector's factorisation was not near enough
                self._factorise(self._evaluate(point.x, point.pressure, dt, True))
                jacobian = visit()
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
        known: list[tuple[float, Array]] = [(0.0, x)]
        while share < 1:
            target = min(1.0, share + step)
            eq.set_share(target)
            try:
                guess = extrapolate(known[-3:], target)
                point = self._correct(guess, target * pressure, REST)
            except StepFailed:
                self.counters.rejected += 1
                step = (target - share) / 4
                self._definite = True
                if step < 1e-4:
                    raise
                continue
            share, step = target, 1.5 * step if self._effort > 1 else 2.5 * step
            known.append((share, point.x))
        return point

    def _accept(self, point: Point, x_predicted: Array, moved: float) -> None:
        """Move on to a point and choose the next step from the prediction's error."""
        options = self.options
        error = _largest(point.x - x_predicted) / self._thin
        order = 2 if self._before is None else 4
        wanted = options.predictor_error / max(error, 1e-12)
        # A corrector that had to factorise again was close to failing.
        growth = options.largest_growth if self._effort == 1 else 1.0
        factor = min(growth, max(0.3, 0.9 * wanted ** (1 / order)))
        self._step = max(moved * factor, 2 * self._smallest)
        self._before, self.point = self.point, point
        self._last = [*self._last, point][-3:]
        self._definite = point.negative == 0
        self.counters.steps += 1

    def _remember(self, point: Point, dt: float) -> None:
        """Let the step of duration `dt` that led to a point be part of the history."""
        if self._sensitivity is not None:
            self._sensitivity.keep(point, dt)
        self.equations.history = self._pending

    def advance(self, pressure: float) -> bool:
        """One step towards a cavity pressure; True when it was reached.

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
                dt = self._due - self._clock
                if not hit:
                    whole = max(abs(pressure - here.pressure), 1e-9)
                    dt *= min(1.0, abs(goal - here.pressure) / whole)
                plane = None if hit or timed else (chart, s)
                expected = expected_stress(chart, self._last, s)
                point = self._correct(x, goal, dt, plane, expected)
                if _largest(point.x - x) > self.options.largest_error * self._thin:
                    detail = "the solution left its branch"
                    raise StepFailed("step_too_small", detail)
                past = (point.pressure - pressure) * (here.pressure - pressure) < 0
                if past and self._remembers:
                    raise StepFailed("step_too_small", "the pressure went too far")
            except StepFailed as failure:
                self.counters.rejected += 1
                timed = False
                self._step = abs(s) / 3
                if self._critical(goal):
                    raise StepFailed("limit_point", "stability is lost") from failure
                if self._step < self._smallest:
                    raise
                self._definite = here.negative == 0  # a bad iterate tells nothing
                continue
            self._length += abs(s)
            if self._wants_derivatives(hit):
                point = self._differentiated(point, dt)
            self._remember(point, dt)
            self._clock += dt
            self._accept(point, x, abs(s))
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
            larger = self._grow(begun + (done + part) * (self._due - begun))
            try:
                x = self._enlarged(old.x, larger)
                point = self._correct(x, old.pressure, part * dt, expected=old.stress)
            except StepFailed:
                self.counters.rejected += 1
                self._definite = old.negative == 0
                self._grow(begun + done * (self._due - begun))
                part /= 4
                if part < 1e-3:
                    raise
                continue
            if self._wants_derivatives(dt > 0):
                point = self._differentiated(point, part * dt)
            self._remember(point, part * dt)
            # The way here was another one; its shape is the best guess of the next.
            self._last = [
                replace(
                    one,
                    x=one.x + (point.x - old.x),
                    stress=one.stress + (point.stress - old.stress),
                )
                for one in self._last[:-1]
            ]
            self._before = self._last[-1] if self._last and self._before else None
            self._last.append(point)
            self.point = point
            self._definite = point.negative == 0
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

    def _turn(self, heading: float) -> None:
        """Go along the path (1) or back (-1); a law with memory goes another way."""
        if heading == self._heading:
            return
        self._heading, self._last = heading, [self.point]
        if self._remembers:
            self._before = None
            self._step *= TURNED

    def _critical(self, predicted: float) -> bool:
        """True at a point where stability is lost and the path does not go on smoothly.

        Balloons that have inflated alike go different ways there: the tangent is
        definite at the last point and not at the prediction, whose pressure is the same
        but for a ten thousandth, and the corrector does not reach it.
        """
        here = self.point
        close = abs(predicted - here.pressure) <= 1e-4 * abs(here.pressure)
        lost = self._predicted_negative > here.negative == 0
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
        problem, outcome = self.problem, Outcome()
        self._keep_all = keep_all
        self._past_limits = far_enough is not None
        times = np.arange(1.0, len(targets) + 1) if times is None else times
        for i, wanted in enumerate(targets):
            target = problem.pressure_gain * float(wanted) + problem.pressure_offset
            self._clock = float(times[i - 1] if i else min(0.0, times[0] - 1.0))
            self._due = float(times[i])
            held = target == self.point.pressure
            try:
                if held and (self._remembers or self._swells):
                    self._settle(self._due - self._clock)
                elif self._swells:
                    self._settle(0.0)
            except StepFailed as failure:
                words = f"{failure.detail}, held at {self._at()}"
                return self._end(outcome, failure.status, words)
            if held:
                outcome.keep(i, self.point)
                continue
            rising = (target > self.point.pressure) == (self.point.slope > 0)
            self._turn(1.0 if rising else -1.0)
            while True:
                if self.counters.steps >= self.options.max_steps:
                    return self._end(
                        outcome, "step_limit", f"after {self.counters.steps} steps"
                    )
                slope = self.point.slope
                try:
                    reached = self.advance(target)
                except StepFailed as failure:
                    if failure.status == "limit_point":
                        self.limit = self.point
                        return outcome.end(
                            "limit_point", f"{failure.detail} at {self._at()}"
                        )
                    words = f"{failure.detail}, past {self._at()}"
                    return self._end(outcome, failure.status, words)
                if self.limit is None and slope > 0 and self.point.slope <= 0:
                    self.limit = self.locate_limit()
                    if keep_all or far_enough is not None:
                        outcome.keep(i, self.limit)
                    if far_enough is None:
                        return self._end(outcome, "limit_point", "")
                if problem.mesh.touching(self.point.x):
                    words = f"roof and floor touch at {self._at()}"
                    return self._end(outcome, "contact", words)
                if reached or keep_all or self.limit is not None:
                    outcome.keep(i, self.point)
                if reached:
                    break
                if self.limit is not None and far_enough and far_enough(self.point):
                    return self._end(outcome, "limit_point", f"ends at {self._at()}")
        return outcome if self.limit is None else self._end(outcome, "completed", "")

    def _end(self, outcome: Outcome, status: str, words: str) -> Outcome:
        """End a path; one that has turned says so first, whatever came after."""
        if self.limit is None:
            return outcome.end(status, words)
        turned = f"the path turns at {self._at(self.limit)}"
        more = f"; followed beyond: {words}" if words else ""
        return outcome.end("limit_point", turned + more)

    def _at(self, point: Point | None = None) -> str:
        """Gauge pressure of a point in words."""
        pressure = (point or self.point).pressure
        return f"{gauge(self.problem, pressure) / 1e3:.4g} kPa"


def _largest(field: Array) -> float:
    """Largest component of a nodal field."""
    return float(np.abs(field).max())


def gauge(problem: Body, pressure: float) -> float:
    """Gauge pressure of a cavity pressure, Pa."""
    return (pressure - problem.pressure_offset) / problem.pressure_gain
