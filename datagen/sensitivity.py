"""Derivatives of every output by design variables and effect parameters.

At an equilibrium R(u; t) = 0 the displacements follow a parameter by
K du/dt = -dR/dt.  dR/dt is a difference of two residuals at the same deformation: the
parameter may move nodes, change stress, growth, weight or load, and no effect needs to
know its own derivative.  K is factorised at the equilibrium, all parameters are solved
together, and the outputs are differenced along du/dt.

Laws with history bring derivatives of their own history along: each direction keeps
the history of its moved problem, so every step of the path has to be visited.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .chart import Point
from .equilibrium import Equilibrium, Workspace
from .errors import EffectError
from .linear import Solver
from .observe import Instruments
from .problem import Problem

Array = np.ndarray


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


class Sensitivity:
    """Derivatives along one path.

    Parameters
    ----------
    problem : Problem
        Whose path is followed.
    directions : sequence of k Direction
    workspace : Workspace
        The path follower's.

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
    ) -> None:
        self.problem, self.directions = problem, tuple(directions)
        self._instruments = Instruments(problem)
        self.names = tuple(direction.name for direction in directions)
        self._ahead: list[Equilibrium] = []
        for direction in directions:
            other = direction.problem
            if (
                other.nodes.shape != problem.nodes.shape
                or not (other.fixed == problem.fixed).all()
            ):
                raise EffectError(
                    f"{direction.name}: no derivative: it changes what is held or "
                    "meshed"
                )
            self._ahead.append(Equilibrium(other, workspace))
        self._read_ahead = [Instruments(one.problem) for one in directions]
        self._first_volume = [one.volume(one.problem.nodes) for one in self._ahead]
        # Derivatives of the displacements, (unknowns, k), those of the last point being
        # the first guess for the next.
        self._moving = [
            k
            for k, one in enumerate(directions)
            if (one.problem.nodes != problem.nodes).any()
        ]
        self._last = np.zeros((self._ahead[0].unknowns, len(self.directions)))
        self.has_history = any(
            law.history_size for one in directions for law in one.problem.laws
        )

    def visit(
        self,
        here: Equilibrium,
        solver: Solver,
        point: Point,
        dt: float,
        first_volume: float,
    ) -> Array:
        """Derivatives of the outputs at a point of the path, at fixed gauge pressure.

        Parameters
        ----------
        here : Equilibrium
            Of the problem, with the history before the step that led to `point`.
        solver : Solver
            Holds the factorised tangent at `point`.
        point : Point
        dt : float, s
            Duration of that step.
        first_volume : float, m3
            Of the cavities at rest.

        Returns
        -------
        (m, k) array, SI; outputs by parameters
        """
        problem = self.problem
        gauge = (point.pressure - problem.pressure_offset) / problem.pressure_gain
        residual = here.evaluate(point.x, point.pressure, dt).residual
        values = self._instruments.read(point.x, point.volume - first_volume)
        pressures = [
            one.problem.pressure_gain * gauge + one.problem.pressure_offset
            for one in self.directions
        ]

        def lack(k: int) -> Array:
            """What is missing at the equilibrium of problem k as far as it is known."""
            x = self._nodes_ahead(point, k)
            ahead = self._ahead[k].evaluate(x, pressures[k], dt)
            rate: Array = (residual - ahead.residual) / self.directions[k].step
            return rate

        # The second pass is Newton's next iteration for the moved shapes.  One is not
        # enough: moved nodes that keep their displacement shear a bent strip, and even
        # a millionth of that is no longer linear in a membrane.
        for columns in (range(len(self.directions)), self._moving):
            if len(columns):
                missing = np.stack([lack(k) for k in columns], axis=1)
                self._last[:, list(columns)] += solver.solve(missing)
        jacobian = np.empty((len(values), len(self.directions)))
        for k, (direction, ahead) in enumerate(
            zip(self.directions, self._ahead, strict=True)
        ):
            x = self._nodes_ahead(point, k)
            volume = ahead.volume(x) - self._first_volume[k]
            after = self._read_ahead[k].read(x, volume)
            jacobian[:, k] = (after - values) / direction.step
            if self.has_history:
                ahead.history = ahead.evaluate(x, pressures[k], dt).history
        return jacobian

    def _nodes_ahead(self, point: Point, k: int) -> Array:
        """Deformed nodes (n, 3), m, of problem k at a point, as far as is known."""
        one = self.directions[k]
        moved = point.x + (one.problem.nodes - self.problem.nodes)
        nodes: Array = moved + one.step * self._ahead[k].extend(self._last[:, k])
        return nodes
