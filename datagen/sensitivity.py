"""Derivatives of every output by design variables and effect parameters, with memory.

At an equilibrium R(u; t) = 0 the displacements follow a parameter by
K du/dt = -dR/dt.  dR/dt is a difference of two residuals at the same deformation: the
parameter may move nodes, change stress, growth, weight or load, and no effect needs to
know its own derivative.  All parameters are solved together with the factorisation that
the path's corrector has left, and the outputs are differenced along du/dt.

Laws with history bring derivatives of their own history along: each direction keeps
the history of its moved problem, so every step of the path has to be visited.  Without
any memory `Adjoint` gives the same for a fraction of the solves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .chart import Point
from .corrector import Corrector
from .equilibrium import Equilibrium, InvertedElement, Workspace
from .errors import EffectError
from .observe import Instruments
from .problem import Problem

Array = np.ndarray

PASSES, CLOSE, NOTHING = 6, 3e-4, 1e-11
"""Newton's iterations at a point, and the last relative correction.  Each one shrinks
the error by a factor of ten to a hundred, so that some 1e-5 of it is left at most:
the tip often moves a hundredth of what the whole strip does along a parameter.
A correction that a step ahead moves no node by `NOTHING` of the thinnest wall is that
of a derivative that vanishes, as all by design fields do at rest."""


@dataclass(frozen=True)
class Direction:
    """One parameter and the problem a small step ahead of it.

    Parameters
    ----------
    name : str
    step : float, SI
        Signed; what was added to the parameter.
    problem : Problem
        Of the same topology and with the same displacements held.
    """

    name: str
    step: float
    problem: Problem


def check_alike(problem: Problem, directions: Sequence[Direction]) -> None:
    """Refuse directions that change what is held or the mesh's topology.

    Raises
    ------
    EffectError
    """
    for direction in directions:
        other = direction.problem
        if (
            other.nodes.shape != problem.nodes.shape
            or not (other.fixed == problem.fixed).all()
        ):
            raise EffectError(
                f"{direction.name}: no derivative: a step changes what is held or "
                "meshed; an effect that does so leaving its off value has "
                "derivatives at other values only"
            )


def follows_path(problem: Problem) -> bool:
    """Whether derivatives have to be followed along the path, see `Sensitivity`."""
    remembers = any(law.history_size for law in problem.laws)
    return remembers or bool(problem.swellings) or bool(problem.observers)


class Sensitivity:
    """Derivatives along one path.

    Parameters
    ----------
    problem : Problem
        Whose path is followed.
    directions : sequence of k Direction
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
        self._corrector = corrector
        self._instruments = Instruments(problem)
        self.names = tuple(direction.name for direction in directions)
        self._ahead = [
            Equilibrium(one.problem, workspace, corrector.equations)
            for one in directions
        ]
        self._read_ahead = [Instruments(one.problem) for one in directions]
        self._first_volume = [one.volume(one.problem.nodes) for one in self._ahead]
        # Derivatives of the displacements, (unknowns, k), here and at the last points.
        self._follow = np.zeros((self._ahead[0].unknowns, len(self.directions)))
        self._known: list[tuple[float, Array]] = []
        # Not found at the last point; and lost, since the history there is not known.
        self._missed = np.zeros(len(self.directions), dtype=bool)
        self._lost = np.zeros(len(self.directions), dtype=bool)
        self.has_history = any(
            law.history_size for one in directions for law in one.problem.laws
        )

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
            The path's length up to `point`.
        last : bool
            There will be no other try: a derivative that was not found is NaN.

        Returns
        -------
        (m, k) array, SI; outputs by parameters.  None where the corrector's
        solver is not near enough; what was found so far is kept for another try.
        """
        problem, here = self.problem, self._corrector.equations
        solver = self._corrector.solver
        residual = here.evaluate(point.x, point.pressure, dt).residual
        values = self._instruments.read(point.x, point.volume - first_volume)

        def lack(k: int) -> Array:
            """What is missing at the equilibrium of problem k as far as it is known.

            NaN where what is known of it is no deformation.
            """
            x = self._nodes_ahead(point, k)
            pressure = self._pressure_ahead(point, k)
            try:
                ahead = self._ahead[k].evaluate(x, pressure, dt)
            except InvertedElement:
                return np.full_like(residual, np.nan)
            rate: Array = (residual - ahead.residual) / self.directions[k].step
            return rate

        if not self._known or self._known[-1][0] != where:
            self._guess(where)
        # Newton's method for all the problems ahead, with one factorisation.  Moved
        # nodes need the second pass even with an exact one: with displacements that
        # stay they shear a bent strip, and a millionth of that is not linear any more.
        steps = np.array([abs(one.step) for one in self.directions])
        open_columns = np.flatnonzero(~self._lost)
        guess, first = self._follow.copy(), np.zeros(len(self.directions))
        astray = np.zeros(len(self.directions), dtype=bool)
        moved = np.zeros(0)
        for _ in range(PASSES):
            if not len(open_columns):
                break
            rates = np.stack([lack(int(k)) for k in open_columns], axis=1)
            known = np.isfinite(rates).all(axis=0)
            if not known.all():
                astray[open_columns[~known]] = True
                open_columns, rates = open_columns[known], rates[:, known]
                continue
            change = solver.solve(rates)
            moved = np.abs(change).max(axis=0)
            if not first.any():
                first[open_columns] = moved
            self._follow[:, open_columns] += change
            size = np.maximum(
                CLOSE * np.abs(self._follow[:, open_columns]).max(axis=0),
                NOTHING * problem.thin / steps[open_columns],
            )
            moved, open_columns = moved[moved > size], open_columns[moved > size]
        if len(moved) == len(open_columns):
            astray[open_columns[moved > first[open_columns]]] = True
        # Where it went astray, another try had better start from the guess again.
        self._follow[:, astray] = guess[:, astray]
        self._known[-1] = (where, self._follow.copy())
        self._missed = astray | np.isin(np.arange(len(self.directions)), open_columns)
        if self._missed.any() and not last:
            return None
        jacobian = np.full((len(values), len(self.directions)), np.nan)
        for k, (direction, ahead) in enumerate(
            zip(self.directions, self._ahead, strict=True)
        ):
            if self._missed[k] or self._lost[k]:
                continue
            x = self._nodes_ahead(point, k)
            volume = ahead.volume(x) - self._first_volume[k]
            after = self._read_ahead[k].read(x, volume)
            jacobian[:, k] = (after - values) / direction.step
        return jacobian

    def set_time(self, time: float) -> None:
        """Let every problem ahead be swollen as it is at a time, s."""
        for ahead in self._ahead:
            ahead.set_time(time)

    def keep(self, point: Point, dt: float) -> None:
        """Let the step that led to a visited point be part of the laws' history.

        What was not found there is not known from there on.
        """
        if not self.has_history:
            return
        self._lost |= self._missed
        for k, ahead in enumerate(self._ahead):
            if self._lost[k]:
                continue
            x, pressure = self._nodes_ahead(point, k), self._pressure_ahead(point, k)
            ahead.history = ahead.evaluate(x, pressure, dt).history

    def _guess(self, where: float) -> None:
        """Expect derivatives at a place of the path, from those at the last ones."""
        guess = np.zeros_like(self._follow)
        for i, (here, follow) in enumerate(self._known):
            others = [there for j, (there, _) in enumerate(self._known) if j != i]
            guess += np.prod([(where - o) / (here - o) for o in others]) * follow
        self._follow = guess
        self._known = [*self._known, (where, guess)][-3:]

    def _pressure_ahead(self, point: Point, k: int) -> float:
        """Cavity pressure of problem k at the gauge pressure of a point, Pa."""
        here, there = self.problem, self.directions[k].problem
        gauge = (point.pressure - here.pressure_offset) / here.pressure_gain
        return there.pressure_gain * gauge + there.pressure_offset

    def _nodes_ahead(self, point: Point, k: int) -> Array:
        """Deformed nodes (n, 3), m, of problem k at a point, as far as is known."""
        one = self.directions[k]
        moved = point.x + (one.problem.nodes - self.problem.nodes)
        nodes: Array = moved + one.step * self._ahead[k].extend(self._follow[:, k])
        return nodes
