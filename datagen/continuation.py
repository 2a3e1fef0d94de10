"""Path following: equilibria of one problem under growing, falling or turning pressure.

The cavity volume V is the continuation parameter: it grows steadily along the path,
also past a limit point, where the pressure turns (Riks 1979; here with V in place of
the arc length, as the pressure's work-conjugate).  Wanted pressures are hit exactly, by
a corrector at fixed pressure; all other steps are corrected at fixed volume by a
bordered system.

Predictor: cubic Hermite extrapolation in V of the last two points and their tangents.
Corrector: Newton's method that keeps its factorisation while the contraction is good.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .equilibrium import Equilibrium, Evaluation, InvertedElement, Workspace
from .linear import NotDefinite
from .problem import Problem

Array = np.ndarray


@dataclass(frozen=True)
class Options:
    """Settings of the path follower.

    Parameters
    ----------
    tolerance : float
        Estimated error of every displacement over the strip's thickness.
    iterations : int
        Corrector iterations before a step is cut.
    contraction : float
        A corrector that shrinks its steps less gets a new factorisation.
    patience : int
        Iterations with a factorisation before it is judged.
    memory : int
        Corrections that are combined to speed up the corrector.
    factorisations : int
        Of one step before it is cut.
    predictor_error : float
        Wanted distance of prediction and solution over the thinner membrane.
    largest_error : float
        A solution further from its prediction is refused: it may lie on another
        branch, and thin membranes have many.
    tangent_tolerance : float
        Relative error of the path's tangent, in displacement.
    tangent_iterations : int
    first_step : float
        Displacement of the first step over the thinner membrane.
    smallest_step : float
        Of the first step's volume; a smaller one ends the path.
    largest_growth : float
        Of one step over the one before.
    max_steps : int
        Steps of one path.
    """

    tolerance: float = 1e-9
    iterations: int = 30
    contraction: float = 0.9
    patience: int = 6
    memory: int = 6
    factorisations: int = 4
    predictor_error: float = 0.03
    largest_error: float = 0.15
    tangent_tolerance: float = 1e-4
    tangent_iterations: int = 12
    first_step: float = 0.12
    smallest_step: float = 1e-4
    largest_growth: float = 3.0
    max_steps: int = 400


@dataclass(frozen=True)
class Point:
    """One equilibrium and the path's direction there.

    x : (n, 3) array, m; deformed nodes.  pressure : Pa, in the cavity.
    volume : m3.  x_slope : (n, 3) array, dx/dV.  pressure_slope : Pa/m3, dp/dV.
    negative : int; negative eigenvalues of the tangent, 0 where stable.
    """

    x: Array
    pressure: float
    volume: float
    x_slope: Array
    pressure_slope: float
    negative: int = 0


class _Mixing:
    """Anderson's acceleration of corrections that share one factorisation.

    Keeps the last corrections s(u) and combines them so that the mixed one is least
    (Walker and Ni 2011); the pressure rides along.
    """

    def __init__(self, memory: int) -> None:
        self._memory = memory
        self.clear()

    def clear(self) -> None:
        self._last: tuple[Array, float, Array, float] | None = None
        self._steps: list[Array] = []
        self._moves: list[tuple[Array, float]] = []

    def improve(self, step: Array, change: float) -> tuple[Array, float]:
        """The correction to apply in place of (`step`, `change`)."""
        if self._last is not None:
            old, old_change, move, move_change = self._last
            self._steps = [*self._steps, step - old][-self._memory :]
            mixed = (move + step - old, move_change + change - old_change)
            self._moves = [*self._moves, mixed][-self._memory :]
        better, better_change = step, change
        if self._steps:
            basis = np.stack(self._steps, axis=1)
            share = np.linalg.lstsq(basis, step, rcond=1e-10)[0]
            for g, (move, move_change) in zip(share, self._moves, strict=True):
                better = better - g * move
                better_change = better_change - float(g) * move_change
        self._last = (step, change, better, better_change)
        return better, better_change


@dataclass
class Outcome:
    """Points that were kept, each with the target it belongs to, and how it ended."""

    points: list[tuple[int, Point]] = field(default_factory=list)
    status: str = "completed"
    message: str = ""

    def keep(self, target: int, point: Point) -> None:
        self.points.append((target, point))

    def end(self, status: str, message: str) -> Outcome:
        self.status, self.message = status, message
        return self


class StepFailed(ArithmeticError):
    """The corrector did not reach an equilibrium; `status` says why."""

    def __init__(self, status: str, detail: str) -> None:
        self.status, self.detail = status, detail
        super().__init__(detail)


@dataclass
class Counters:
    """What a path cost."""

    steps: int = 0
    factorisations: int = 0
    iterations: int = 0
    rejected: int = 0


def _hermite(t: float, a: Point, b: Point) -> tuple[Array, float]:
    """Cubic through two points and their slopes at V = a + t (b - a)."""
    width = b.volume - a.volume
    h00 = (1 + 2 * t) * (1 - t) ** 2
    h10, h11 = width * t * (1 - t) ** 2, width * t * t * (t - 1)
    # From b, as h00 + h01 = 1: held displacements then stay held to the last bit.
    # Extrapolation would multiply their rounding errors in every step, and nothing
    # corrects them.
    x = b.x + h00 * (a.x - b.x) + h10 * a.x_slope + h11 * b.x_slope
    p = (
        b.pressure
        + h00 * (a.pressure - b.pressure)
        + h10 * a.pressure_slope
        + h11 * b.pressure_slope
    )
    return x, p


class PathFollower:
    """Follows the equilibrium path of one problem.

    Parameters
    ----------
    problem : Problem
    workspace : Workspace, optional
        Shared by problems of the same topology.
    options : Options, optional
    """

    def __init__(
        self,
        problem: Problem,
        workspace: Workspace | None = None,
        options: Options | None = None,
    ) -> None:
        self.problem = problem
        self.workspace = workspace or Workspace()
        self.options = options or Options()
        self.equations = Equilibrium(problem, self.workspace)
        self.counters = Counters()
        self.limit: Point | None = None
        design = problem.design
        self._rate = 1.0  # seconds a pascal of the way to the next target
        self._thin = min(design.upper_thickness, design.lower_thickness)
        self._tolerance = self.options.tolerance * design.thickness
        self._definite = True
        self._before: Point | None = None
        self.point = self._start()
        self.first_volume = self.equations.evaluate(problem.nodes, 0.0).volume
        self._step = self.options.first_step * self._thin / self._speed(self.point)
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
        self, x: Array, pressure: float, dt: float, tangent: bool
    ) -> Evaluation:
        """Evaluate the equations; an inverted element fails the step."""
        try:
            return self.equations.evaluate(x, pressure, dt, tangent)
        except InvertedElement as error:
            place = self.equations.where(error.element)
            raise StepFailed(
                "inverted_element", f"an element turned inside out {place}"
            ) from error

    def _correct(
        self, x: Array, pressure: float, volume: float | None, dt: float
    ) -> Point:
        """Newton from a prediction, at fixed `volume` or (None) at fixed pressure.

        Raises
        ------
        StepFailed
        """
        eq, options = self.equations, self.options
        fresh, age, best, last = True, 0, np.inf, np.inf
        load = np.zeros(0)
        self._effort = 0
        mixing = _Mixing(options.memory)
        for _ in range(options.iterations):
            self.counters.iterations += 1
            ev = self._evaluate(x, pressure, dt, fresh)
            if fresh:
                self._effort += 1
                if self._effort > options.factorisations:
                    break
                self._factorise(ev)
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
            if volume is not None:
                lack = volume - ev.volume - ev.volume_gradient @ step
                change = float(lack / (ev.volume_gradient @ load))
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
        """Tangent of the path at an equilibrium: K dx/dp = dV/dx.

        Conjugate gradients on the tangent here, with the corrector's factorisation
        as preconditioner and products with K by differences of residuals.  A poor
        tangent costs more than these few solves: it spoils the next predictions.
        """
        eq = self.equations
        ev = self._evaluate(x, pressure, dt, False)
        load = self._solver.solve(ev.volume_gradient)
        scale = float(np.abs(load).max())
        lack, aim, last = ev.volume_gradient.copy(), load, load * 0.0
        load, before = last, 1.0
        for _ in range(self.options.tangent_iterations):
            weight = float(lack @ aim)
            last = aim + weight / before * last if before != 1.0 else aim
            before = weight
            small = 1e-5 * self._thin / float(np.abs(last).max())
            ahead = self._evaluate(x + small * eq.extend(last), pressure, dt, False)
            product = (ahead.residual - ev.residual) / small
            share = weight / float(last @ product)
            load = load + share * last
            lack = lack - share * product
            aim = self._solver.solve(lack)
            if float(np.abs(aim).max()) <= self.options.tangent_tolerance * scale:
                break
        compliance = float(ev.volume_gradient @ load)  # dV/dp
        self._pending = ev.history
        return Point(
            x=x,
            pressure=pressure,
            volume=ev.volume,
            x_slope=eq.extend(load) / compliance,
            pressure_slope=1.0 / compliance,
            negative=self._solver.negative,
        )

    # -- the path ------------------------------------------------------------------

    def _speed(self, point: Point) -> float:
        """Largest displacement a unit of volume, 1/m2."""
        return float(np.abs(point.x_slope).max())

    def _start(self) -> Point:
        """Equilibrium at zero gauge pressure; growth and weight are led in."""
        problem, eq = self.problem, self.equations
        pressure = problem.pressure_offset
        x, share, step = problem.nodes, 0.0, 0.5
        if not problem.loaded_at_rest:
            return self._correct(x, pressure, None, 1.0)
        known: list[tuple[float, Array]] = [(0.0, x)]
        while share < 1:
            target = min(1.0, share + step)
            eq.set_share(target)
            try:
                guess = _extrapolate(known[-3:], target)
                point = self._correct(guess, target * pressure, None, 1.0)
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

    def _predict(self, volume: float) -> tuple[Array, float]:
        """Position and pressure expected at a volume."""
        here = self.point
        if self._before is None:
            ahead = volume - here.volume
            return (
                here.x + ahead * here.x_slope,
                here.pressure + ahead * here.pressure_slope,
            )
        t = (volume - self._before.volume) / (here.volume - self._before.volume)
        return _hermite(t, self._before, here)

    def _volume_at(self, pressure: float, reach: float) -> float | None:
        """Volume within `reach` at which `pressure` is expected, None for further."""
        here = self.point
        share = np.linspace(0.0, 1.0, 41)
        ahead = np.array([self._predict(here.volume + reach * s)[1] for s in share])
        side = np.sign(pressure - here.pressure)
        beyond = np.nonzero(side * (ahead - pressure) >= 0)[0]
        if len(beyond) == 0 or beyond[0] == 0:
            return None
        k = int(beyond[0])
        inner = (pressure - ahead[k - 1]) / (ahead[k] - ahead[k - 1])
        return here.volume + reach * float(
            share[k - 1] + inner * (share[k] - share[k - 1])
        )

    def _accept(self, point: Point, x_predicted: Array) -> None:
        """Move on to a point and choose the next step from the prediction's error."""
        options = self.options
        error = float(np.abs(point.x - x_predicted).max()) / self._thin
        order = 2 if self._before is None else 4
        wanted = options.predictor_error / max(error, 1e-12)
        moved = abs(point.volume - self.point.volume)
        # A corrector that had to factorise again was close to failing.
        growth = options.largest_growth if self._effort == 1 else 1.0
        factor = min(growth, max(0.3, 0.9 * wanted ** (1 / order)))
        self._step = max(moved * factor, 2 * self._smallest)
        self._before, self.point = self.point, point
        self.equations.history = self._pending
        self._definite = point.negative == 0
        self.counters.steps += 1

    def advance(self, pressure: float) -> bool:
        """One step towards a cavity pressure; True when it was reached.

        Raises
        ------
        StepFailed
            When even the smallest step fails.
        """
        while True:
            here = self.point
            side = 1.0 if pressure >= here.pressure else -1.0
            towards = side * np.sign(here.pressure_slope)
            reach = towards * self._step
            volume = self._volume_at(pressure, reach)
            hit = volume is not None
            if volume is None:
                volume = here.volume + reach
                # Do not stop just short of the target: share the way evenly.
                further = self._volume_at(pressure, 1.5 * reach)
                if further is not None:
                    volume = here.volume + 0.6 * (further - here.volume)
            x, predicted = self._predict(volume)
            goal = pressure if hit else predicted
            try:
                fixed = hit
                dt = self._rate * max(abs(goal - here.pressure), 1e-9)
                point = self._correct(x, goal, None if fixed else volume, dt)
                error = float(np.abs(point.x - x).max()) / self._thin
                if error > self.options.largest_error:
                    detail = "the solution left its branch"
                    raise StepFailed("step_too_small", detail)
            except StepFailed:
                self.counters.rejected += 1
                self._step = abs(volume - here.volume) / 3
                if self._step < self._smallest:
                    raise
                self._definite = here.negative == 0  # a bad iterate tells nothing
                continue
            self._accept(point, x)
            return hit

    def locate_limit(self) -> Point:
        """The point between the last two where the pressure is highest."""
        a, b = self._before, self.point
        assert a is not None
        point = a
        for _ in range(6):
            t = _turning(a, b)
            x, pressure = _hermite(t, a, b)
            volume = a.volume + t * (b.volume - a.volume)
            try:
                point = self._correct(x, pressure, volume, 1.0)
            except StepFailed:
                break
            scale = abs(a.pressure_slope) + abs(b.pressure_slope)
            if abs(point.pressure_slope) < 1e-3 * scale:
                return point
            if point.pressure_slope * a.pressure_slope > 0:
                a = point
            else:
                b = point
        return point

    def run(
        self, targets: Array, times: Array | None = None, keep_all: bool = False
    ) -> Outcome:
        """Visit gauge pressures in turn, as far as the path goes.

        Parameters
        ----------
        targets : (s,) array, Pa
        times : (s,) array, s, optional
            Of each target; one second a target where not given.
        keep_all : bool
            Keep the points on the way and the limit point, too.

        Returns
        -------
        Outcome
        """
        problem, outcome = self.problem, Outcome()
        times = np.arange(1.0, len(targets) + 1) if times is None else times
        for i, wanted in enumerate(targets):
            target = problem.pressure_gain * float(wanted) + problem.pressure_offset
            if target == self.point.pressure:
                outcome.keep(i, self.point)
                continue
            elapsed = times[i] - (times[i - 1] if i else min(0.0, times[0] - 1.0))
            self._rate = float(elapsed) / abs(target - self.point.pressure)
            while True:
                if self.counters.steps >= self.options.max_steps:
                    return outcome.end(
                        "step_limit", f"after {self.counters.steps} steps"
                    )
                slope = self.point.pressure_slope
                try:
                    reached = self.advance(target)
                except StepFailed as failure:
                    at = gauge(problem, self.point.pressure) / 1e3
                    return outcome.end(
                        failure.status, f"{failure.detail}, past {at:.4g} kPa"
                    )
                if slope > 0 and self.point.pressure_slope <= 0:
                    self.limit = self.locate_limit()
                    at = gauge(problem, self.limit.pressure) / 1e3
                    if keep_all:
                        outcome.keep(i, self.limit)
                    return outcome.end("limit_point", f"the path turns at {at:.4g} kPa")
                if self.touching():
                    at = gauge(problem, self.point.pressure) / 1e3
                    return outcome.end(
                        "contact", f"roof and floor touch at {at:.4g} kPa"
                    )
                if reached or keep_all:
                    outcome.keep(i, self.point)
                if reached:
                    break
        return outcome

    def touching(self) -> bool:
        """True when a roof node has gone through the floor node under it."""
        mesh, x = self.problem.mesh, self.point.x
        across = x[mesh.gap[:, 1]] - x[mesh.gap[:, 0]]
        side = across[mesh.gap_wall]
        return bool((np.sum(across * side, axis=1) <= 0).any())


def _extrapolate(known: list[tuple[float, Array]], where: float) -> Array:
    """Lagrange's polynomial through (share, position) pairs, from the last one."""
    last = known[-1][1]
    guess = last.copy()
    for i, (here, x) in enumerate(known[:-1]):
        others = [share for j, (share, _) in enumerate(known) if j != i]
        weight = np.prod([(where - other) / (here - other) for other in others])
        guess += weight * (x - last)  # held displacements stay held, see _hermite
    return guess


def gauge(problem: Problem, pressure: float) -> float:
    """Gauge pressure of a cavity pressure, Pa."""
    return (pressure - problem.pressure_offset) / problem.pressure_gain


def _turning(a: Point, b: Point) -> float:
    """Where, in (0, 1), the cubic p(V) between two points has zero slope."""
    width = b.volume - a.volume
    m0, m1 = a.pressure_slope * width, b.pressure_slope * width
    rise = b.pressure - a.pressure
    # p'(t) = m0 + t (6 rise - 4 m0 - 2 m1) + t^2 (3 m0 + 3 m1 - 6 rise)
    roots = np.roots([3 * m0 + 3 * m1 - 6 * rise, 6 * rise - 4 * m0 - 2 * m1, m0])
    inside = [float(r.real) for r in roots if abs(r.imag) < 1e-9 and 0 < r.real < 1]
    return inside[0] if inside else m0 / (m0 - m1)
