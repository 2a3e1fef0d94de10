"""From a predicted point of a path to the equilibrium next to it.

Newton's method that keeps its factorisation while the contraction is good, with
Anderson's acceleration; at fixed pressure, or across the path by a bordered
system (Riks 1979).  The stress that makes the tangent's geometric part is predicted by
itself: a membrane's stress at extrapolated positions is far off, as it magnifies their
error by its stiffness; with the predicted one the factorisation at the prediction
serves the whole step (the idea is that of the mixed integration point Newton of
Magisano, Leonetti and Garcea 2017).
"""

from __future__ import annotations

import numpy as np

from .chart import Chart, Point, largest
from .control import Counters, Options, StepFailed
from .equilibrium import Equilibrium, Evaluation, InvertedElement, Workspace
from .linear import Solver
from .mixing import Mixing
from .problem import Body
from .rates import Linearised
from .tangent import solve_tangent

Array = np.ndarray

STRESS_STEP = 1e-5
"""Movement over the thinnest wall by which the stress along a path is differenced."""


class Corrector:
    """Solves the equilibrium equations of one problem from predictions.

    Parameters
    ----------
    problem : Body
    equations : Equilibrium
        Of the problem.
    workspace : Workspace
    options : Options
    counters : Counters
        Counts iterations and factorisations.

    Attributes
    ----------
    solver : Solver
        Holds the last factorised tangent.
    effort : int
        Factorisations of the last correction.
    predicted_negative : int
        Negative eigenvalues of the tangent at its prediction.
    history : per layer, (points, h) array
        At the last point; see `Evaluation`.
    linearised : Linearised
        The equations at the last point.
    """

    solver: Solver
    linearised: Linearised

    def __init__(
        self,
        problem: Body,
        equations: Equilibrium,
        workspace: Workspace,
        options: Options,
        counters: Counters,
    ) -> None:
        self.problem, self.equations = problem, equations
        self.workspace, self.options, self.counters = workspace, options, counters
        self.effort = self.predicted_negative = 0
        self.history = equations.history
        self._tolerance = options.tolerance * problem.thin
        faces = problem.mesh.cavity_faces[:, [0, 2, 8, 6]]
        one, two = (
            problem.nodes[faces[:, i]] - problem.nodes[faces[:, j]]
            for i, j in ((2, 0), (3, 1))
        )
        self._area = float(np.linalg.norm(np.cross(one, two), axis=1).sum() / 2) or 1.0

    def factorise(self, evaluation: Evaluation) -> None:
        """Factorise the tangent.

        Raises
        ------
        StepFailed
            When it is singular.
        """
        assert evaluation.tangent is not None
        self.counters.factorisations += 1
        self.solver = self.workspace.solver(self.problem)
        try:
            self.solver.factorise(evaluation.tangent)
        except ArithmeticError as error:
            raise StepFailed("step_too_small", "the tangent is singular") from error

    def evaluate(
        self,
        x: Array,
        pressure: float,
        dt: float,
        tangent: bool = False,
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

    def correct(
        self,
        x: Array,
        pressure: float,
        dt: float,
        plane: tuple[Chart, float] | None = None,
        expected: Array | None = None,
    ) -> tuple[Array, float]:
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

        Returns
        -------
        x : (n, 3) array, m
        pressure : float, Pa

        Raises
        ------
        StepFailed
        """
        eq, options = self.equations, self.options
        fresh, age, best, last = True, 0, np.inf, np.inf
        load = np.zeros(0)
        self.effort = self.predicted_negative = 0
        mixing = Mixing(options.memory)
        across = eq.restrict(plane[0].normal) if plane else np.zeros(0)
        for _ in range(options.iterations):
            self.counters.iterations += 1
            ev = self.evaluate(x, pressure, dt, fresh, expected)
            if not np.isfinite(ev.residual).all():
                break  # chains are drawn past their length, say
            if fresh:
                self.effort += 1
                if self.effort > options.factorisations:
                    break
                self.factorise(ev)
                if self.effort == 1:
                    self.predicted_negative = self.solver.negative
                both = self.solver.solve(
                    np.stack([-ev.residual, ev.volume_gradient], axis=1)
                )
                step, load = both[:, 0], both[:, 1]
                mixing.clear()
                age = 0
            else:
                step = self.solver.solve(-ev.residual)
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
                return x + eq.extend(step), pressure + change
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

    def point(
        self, x: Array, pressure: float, dt: float, before: Point | None
    ) -> Point:
        """An equilibrium with the direction in which the path goes on there.

        Parameters
        ----------
        x : (n, 3) array, m
            Deformed nodes, as they were corrected last.
        pressure : float, Pa
        dt : float, s
            Duration of the step to it.
        before : Point, optional
            The point from which the path came.
        """
        eq, ev = self.equations, self.evaluate(x, pressure, dt)
        self.history = ev.history
        # K u = dV/dx.  A poor tangent of the path costs more than these few solves: it
        # spoils the next predictions.
        self.linearised = Linearised(eq, x, pressure, dt)
        load, _ = solve_tangent(
            self.linearised.times,
            self.solver,
            ev.volume_gradient[:, None],
            self.options.tangent_tolerance,
            self.options.tangent_iterations,
        )
        direction = eq.extend(load[:, 0])
        # The length of a step: mean movement of the cavity's walls, and a little of
        # every node's.  All nodes alike would follow the tip, which stands still where
        # it turns while the balloons grow.
        walls = eq.extend(ev.volume_gradient) / self._area
        nodes = self.options.node_share**2 / len(direction)
        normal = np.vdot(walls, direction) * walls + nodes * direction
        length = float(np.sqrt(np.vdot(normal, direction))) or np.inf
        if before is not None and np.vdot(normal, before.direction) < 0:
            length = -length  # past a limit point the path goes on, the pressure falls
        direction = direction / length
        stress = eq.stress(x, dt)
        small = STRESS_STEP * self.problem.thin / (largest(direction) or 1.0)
        return Point(
            x=x,
            pressure=pressure,
            volume=ev.volume,
            direction=direction,
            normal=normal / length,
            slope=1.0 / length,
            stress=stress,
            stress_rate=(eq.stress(x + small * direction, dt) - stress) / small,
            negative=self.solver.negative,
        )
