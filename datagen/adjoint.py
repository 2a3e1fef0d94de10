"""Derivatives of every output by any number of parameters, from one system an output.

At an equilibrium R(x; t) = 0 an output O(x; t) follows a parameter by

    dO/dt = partial O - l . partial R,    K l = dO/dx.

The adjoint l is solved for once an output; a parameter costs the derivative of one
residual, and no effect needs to know its own.  Where a parameter moves undeformed nodes
by dX, the partial derivatives are those along dX and F dX, as if the nodes were drawn
on the body; for elements they are exact (`rates.py`).  All that a parameter changes
besides (laws, moduli, growth, supports, weight, load) is a difference at the same
nodes, which loses nothing to rounding.

A body with a memory needs all of the displacements' derivatives, see `Sensitivity`.
One without may have directions in which it gets one, as an effect of time has from its
off value: to first order what they remember is the path of the body without.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .chart import Point, extrapolate
from .corrector import Corrector
from .equilibrium import Equilibrium, Workspace
from .mesh import reference
from .observe import Instruments
from .problem import Problem
from .rates import nodal_deformation
from .response import OUTPUT_NAMES
from .sensitivity import Direction, check_alike
from .tangent import solve_tangent

Array = np.ndarray

TOLERANCE, ITERATIONS = 2e-5, 12
"""Of the adjoints, see `solve_tangent`."""

SPRUNG = 2e-7
"""Tolerance of a body on springs: its adjoints are large where it turns on them, and
what they are besides would drown in a share of that."""

GOAL, ROUGH = 5e-4, 1e-3
"""See `Goal`."""

SHAPES = tuple(name for name in OUTPUT_NAMES if name != "cavity_volume")
"""Outputs that the deformed nodes alone decide."""

VOLUME = OUTPUT_NAMES.index("cavity_volume")
SHAPE_ROWS = [row for row in range(len(OUTPUT_NAMES)) if row != VOLUME]


class Goal:
    """When adjoints are as good as the derivatives need them.

    An adjoint that is within `ROUGH` need not be better when what is about to be added
    changes no derivative by more than `GOAL` of its largest amount on the path so far.
    Usually far less is left then, but one step does not tell how much less.

    Parameters
    ----------
    residuals : (unknowns, k) array
        Rates of the residual along the parameters.
    load, rise : (unknowns,) arrays
        dV/dx, and what moves by it per work of it: along it adjoints will be set right.
    partial, largest : (c, k) arrays, SI
        Derivatives without the adjoints' share, and their largest amounts so far.
    """

    def __init__(
        self, residuals: Array, load: Array, rise: Array, partial: Array, largest: Array
    ) -> None:
        self._residuals, self._load = residuals, load
        self._by_rise = rise @ residuals
        self._partial, self._largest = partial, largest

    def __call__(self, adjoints: Array, aim: Array, columns: Array) -> Array:
        """`enough` of `solve_tangent`."""
        rough = np.abs(aim).max(axis=0) <= ROUGH * np.abs(adjoints).max(axis=0)
        change = aim.T @ self._residuals - np.outer(self._load @ aim, self._by_rise)
        now = np.abs(self._partial[columns] - adjoints.T @ self._residuals)
        scale = np.fmax(self._largest[columns], now)
        size = (np.abs(change) / np.where(scale > 0, scale, 1.0)).max(axis=1)
        good: Array = rough & (size <= GOAL)
        return good


class Adjoint:
    """Derivatives along one path of a problem without memory.

    Parameters
    ----------
    problem : Problem
        Whose path is followed; its laws have no history, and it does not swell.
    directions : sequence of k Direction
        Into problems that may have both.
    workspace : Workspace
        The path follower's.
    corrector : Corrector
        The path follower's; its solver holds a factorised tangent near each point.

    Raises
    ------
    EffectError
        When a direction changes the mesh's topology or what is held.
    """

    def __init__(
        self,
        problem: Problem,
        directions: Sequence[Direction],
        workspace: Workspace,
        corrector: Corrector,
    ) -> None:
        check_alike(problem, directions)
        self.problem, self.directions = problem, tuple(directions)
        self.names = tuple(direction.name for direction in directions)
        self._corrector, self._here = corrector, corrector.equations
        self._workspace = workspace
        self._instruments = Instruments(problem)
        self._ahead = [
            Equilibrium(one.problem, workspace, self._here) for one in directions
        ]
        # Rates of undeformed nodes (n, 3), m a unit, where any moves.
        self._moves = {
            k: moved / one.step
            for k, one in enumerate(directions)
            if one.problem.nodes is not problem.nodes
            and (moved := one.problem.nodes - problem.nodes).any()
        }
        self._grows = self._growing()
        # The same bodies on the nodes that stay: what changes besides the nodes.
        self._stayed = [
            self._on_nodes(one.problem, ahead, k in self._moves)
            for k, (one, ahead) in enumerate(zip(directions, self._ahead, strict=True))
        ]
        self._remembering = [
            one
            for one in self._stayed
            if one is not None and any(law.history_size for law in one.problem.laws)
        ]
        self._read_ahead = [
            Instruments(one.problem) if self._reads_otherwise(k) else None
            for k, one in enumerate(directions)
        ]
        self._first_volume = np.array(
            [one.volume(one.problem.nodes) for one in self._ahead]
        )
        self._known: list[tuple[float, Array]] = []  # adjoints at the last points
        # Largest amounts of the derivatives so far, (m, k).
        self._largest = np.zeros((len(OUTPUT_NAMES), len(self.directions)))

    def _growing(self) -> dict[int, float]:
        """Rates at which the body grows; it grows without stress but at the clamp."""
        mine = _mean_growth(self.problem)
        return {
            k: rate
            for k, (one, ahead) in enumerate(
                zip(self.directions, self._ahead, strict=True)
            )
            if (rate := (_mean_growth(one.problem) * ahead.size - mine) / one.step)
        }

    def _reads_otherwise(self, k: int) -> bool:
        """Whether the instruments may see something else along direction k."""
        mine, other = self.problem, self.directions[k].problem
        seen = mine.datum is other.datum and mine.observers == other.observers
        return k in self._moves or not seen

    def _on_nodes(
        self, other: Problem, ahead: Equilibrium, moves: bool
    ) -> Equilibrium | None:
        """Elements ahead on the nodes that stay; None where they are alike."""
        mine = self.problem
        alike = (
            other.laws == mine.laws
            and other.swellings == mine.swellings
            and other.local_share == mine.local_share
            and np.array_equal(other.shear_modulus, mine.shear_modulus)
            and np.array_equal(other.bulk_modulus, mine.bulk_modulus)
            and _alike(other.growth, mine.growth)
            and _alike(other.gas, mine.gas)
        )
        if alike or not moves:
            return None if alike else ahead
        stayed = replace(other, nodes=mine.nodes)
        return Equilibrium(stayed, self._workspace, self._here)

    def visit(
        self, point: Point, dt: float, first_volume: float, where: float, last: bool
    ) -> Array | None:
        """Derivatives of the outputs at a point of the path, at fixed gauge pressure.

        Parameters
        ----------
        point : Point
        dt : float, s
            Duration of the step that led to it.
        first_volume : float, m3
            Of the cavities at rest.
        where : float, m
            The path's length up to the point.
        last : bool
            There will be no other try: what was not found is NaN.

        Returns
        -------
        (m, k) array, SI; outputs by parameters.  None where the corrector's solver is
        not near enough.
        """
        x, steps = point.x, np.array([one.step for one in self.directions])
        drawn = self._drawn(x)
        residuals, dilated = self._residuals(point, dt, drawn)
        change = point.volume - first_volume
        if self._instruments.flat(x):
            return self._directly(x, change, drawn, residuals)
        gradients = self._instruments.gradients(x)
        direct = self._partial(point, change, gradients, drawn)
        direct[VOLUME] += 2 * (dilated - (self._first_volume - first_volume) / steps)
        adjoints, found = self._adjoints(point, gradients, residuals, direct, where)
        if not (found.all() or last):
            return None
        jacobian: Array = direct - adjoints.T @ residuals
        jacobian[~found] = np.nan
        self._largest = np.fmax(self._largest, np.abs(jacobian))
        return jacobian

    def _partial(
        self,
        point: Point,
        change: float,
        gradients: dict[str, Array],
        drawn: dict[int, tuple[Array, Array]],
    ) -> Array:
        """Derivatives (m, k) while the body is drawn along and nothing gives way."""
        x = point.x
        found = np.zeros((len(OUTPUT_NAMES), len(self.directions)))
        by_nodes = [gradients[name] for name in SHAPES]
        by_nodes.insert(VOLUME, 2 * self._corrector.linearised.known.gradient)
        plain = self._instruments.read(x, change)
        for k, one in enumerate(self.directions):
            if k in drawn:
                dx, _ = drawn[k]
                found[:, k] = [np.vdot(gradient, dx) for gradient in by_nodes]
            if (instruments := self._read_ahead[k]) is not None:
                # Of the same nodes: what the instruments themselves see otherwise.
                found[:, k] += (instruments.read(x, change) - plain) / one.step
        return found

    def _residuals(
        self, point: Point, dt: float, drawn: dict[int, tuple[Array, Array]]
    ) -> tuple[Array, Array]:
        """Rates of the residual (unknowns, k), and of the volume of the same nodes."""
        here, x, linear = self._here, point.x, self._corrector.linearised
        forces = here.outer_forces(x)
        residuals = np.zeros((here.unknowns, len(self.directions)))
        dilated = np.zeros(len(self.directions))
        if drawn:
            along = [np.stack(fields) for fields in zip(*drawn.values(), strict=True)]
            residuals[:, list(drawn)] = linear.moved(*along).T
        for k, (one, ahead, stayed) in enumerate(
            zip(self.directions, self._ahead, self._stayed, strict=True)
        ):
            if stayed is not None:
                other = linear.known
                if not stayed.strains_as(self.problem):
                    other = stayed.kinematics(x)
                stress = stayed.respond(other.f, dt, False)[0]
                force = stayed.internal_force(other.f, stress)[0] - linear.force
                force -= point.pressure * (other.gradient - linear.known.gradient)
                residuals[:, k] += here.restrict(force) / one.step
                dilated[k] = (other.volume - linear.known.volume) / one.step
            more = self._pressure_ahead(point, k) - point.pressure
            if more:
                load = here.restrict(linear.known.gradient)
                residuals[:, k] -= more / one.step * load
            if here.has_outer_forces or ahead.has_outer_forces:
                x_ahead = x + one.step * drawn[k][0] if k in drawn else x
                outer = ahead.outer_forces(x_ahead) - forces
                residuals[:, k] += here.restrict(outer) / one.step
        return residuals, dilated

    def _directly(
        self,
        x: Array,
        change: float,
        drawn: dict[int, tuple[Array, Array]],
        residuals: Array,
    ) -> Array:
        """Derivatives (m, k) from those of the displacements, one system a parameter.

        Where nothing has moved yet the largest rise may be anywhere: it has derivatives
        to one side, and no gradient.
        """
        moved, _ = solve_tangent(
            self._corrector.linearised.times,
            self._corrector.solver,
            residuals,
            TOLERANCE,
            ITERATIONS,
        )
        before = self._instruments.read(x, change)
        jacobian = np.empty((len(before), len(self.directions)))
        for k, (one, ahead) in enumerate(
            zip(self.directions, self._ahead, strict=True)
        ):
            dx = -self._here.extend(moved[:, k])
            if k in drawn:
                dx += drawn[k][0]
            x_ahead = x + one.step * dx
            instruments = self._read_ahead[k] or self._instruments
            volume = ahead.volume(x_ahead) - self._first_volume[k]
            after = instruments.read(x_ahead, volume)
            jacobian[:, k] = (after - before) / one.step
        return jacobian

    def _drawn(self, x: Array) -> dict[int, tuple[Array, Array]]:
        """How deformed and undeformed nodes move, (n, 3) each, m a unit.

        By F dX where undeformed nodes move, and apart where the body grows: what is
        then out of balance is small.  Directions in which nothing moves are left out.
        """
        problem, held = self.problem, self.problem.fixed
        f = nodal_deformation(
            problem.nodes, x, problem.mesh.cells, reference().node_gradient
        )
        drawn = {}
        for k in self._moves.keys() | self._grows.keys():
            undeformed = self._moves.get(k, np.zeros(x.shape))
            dx = np.einsum("nij,nj->ni", f, undeformed) + self._grows.get(k, 0.0) * x
            dx[held] = undeformed[held]
            drawn[k] = dx, undeformed
        return drawn

    def _adjoints(
        self,
        point: Point,
        gradients: dict[str, Array],
        residuals: Array,
        direct: Array,
        where: float,
    ) -> tuple[Array, Array]:
        """Adjoints (unknowns, m) of the outputs, and which of them were found (m,).

        As good as the derivatives need them, `direct` - l . `residuals`.

        Derivatives by moduli, pressure or temperature are small differences of what the
        pressure does.  The path's own direction u, K u = dV/dx, is known: each adjoint
        is kept right along it, l . K u = dO/dx . u, whatever error is left in l.
        """
        here, corrector = self._here, self._corrector
        load = here.restrict(corrector.linearised.known.gradient)
        direction = here.restrict(point.direction) / point.slope
        rise = direction / (direction @ load)

        def along(adjoints: Array) -> Array:
            lack = direction @ wanted - load @ adjoints
            right: Array = adjoints + rise[:, None] * lack
            return right

        goal = Goal(
            residuals, load, rise, direct[SHAPE_ROWS], self._largest[SHAPE_ROWS]
        )
        wanted = np.stack([here.restrict(gradients[name]) for name in SHAPES], axis=1)
        again = bool(self._known) and self._known[-1][0] == where
        guess = None
        if self._known:
            guess = self._known[-1][1] if again else extrapolate(self._known, where)
            guess = along(guess)
        shapes, found = solve_tangent(
            corrector.linearised.times,
            corrector.solver,
            wanted,
            SPRUNG if self.problem.springs else TOLERANCE,
            ITERATIONS,
            guess,
            goal,
        )
        shapes = along(shapes)
        if found.all():
            before = self._known[:-1] if again else self._known
            self._known = [*before, (where, shapes)][-3:]
        shapes_and_volume = np.insert(shapes, VOLUME, 2 * direction, axis=1)
        return shapes_and_volume, np.insert(found, VOLUME, True)

    has_history = False
    """Derivatives at a point need none at the points before."""

    def keep(self, point: Point, dt: float) -> None:
        """Let the step of `dt`, s, to a point be part of what directions remember.

        Raises
        ------
        InvertedElement
        """
        if not self._remembering:
            return
        plain = self._here.kinematics(point.x)
        for one in self._remembering:
            alike = one.strains_as(self.problem)
            f = (plain if alike else one.kinematics(point.x)).f
            one.history = one.respond(f, dt, False)[2]

    def set_time(self, time: float) -> None:
        """Let the problems ahead be swollen as they are at a time, s."""
        for ahead, stayed in zip(self._ahead, self._stayed, strict=True):
            if ahead.problem.swellings:
                ahead.set_time(time)
                if stayed is not None:
                    stayed.set_time(time)
        self._grows = self._growing()

    def _pressure_ahead(self, point: Point, k: int) -> float:
        """Cavity pressure along direction k at the gauge pressure of a point, Pa."""
        here, there = self.problem, self.directions[k].problem
        gauge = (point.pressure - here.pressure_offset) / here.pressure_gain
        return there.pressure_gain * gauge + there.pressure_offset


def _mean_growth(problem: Problem) -> float:
    """Mean stretch of the initial strain Fg."""
    if problem.growth is None:
        return 1.0
    return float(np.trace(problem.growth, axis1=1, axis2=2).mean() / 3)


def _alike(one: Array | None, other: Array | None) -> bool:
    """Whether two optional arrays are equal, or both not there."""
    if one is None or other is None:
        return one is other
    return np.array_equal(one, other)
