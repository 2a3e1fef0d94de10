"""The device on which an effect is tried, and the effect's paths on it.

Every path loads, unloads and takes time, so that softening and viscoelasticity show.
Between `off` and an end of the range an effect is tried along straight lines on which
all its parameters leave `off` together: one alone may do nothing, as the direction of
a weight that is zero.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property
from types import FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from ..continuation import PathFollower
from ..device import Design, named_device
from ..equilibrium import Equilibrium, Workspace
from ..errors import EffectError
from ..levels import MeshLevel, mesh_level
from ..problem import Problem, baseline
from ..response import OUTPUT_NAMES, Path, Response
from ..solver import solve
from .acting import told
from .door import AUTHORS_ERRORS, Effect

Array = np.ndarray
Values = dict[str, float]

STEP = 5.0
"""s.  Between two load steps: between the fast and the slow relaxation of PDMS."""

PATH = Path(np.array([0.0, 10e3, 20e3, 10e3]), STEP * np.arange(4))
"""Load steps, Pa and s, of every check: at rest, loading, unloading."""

PART = 0.6
"""Way from off to the end of the range at which an effect is in its middle.

Not a half: some vanish there, as a weight that lies on its side.
"""


class Ground:
    """The device without the effect, and what is known of it; effects may share it.

    Parameters
    ----------
    design : Design, optional
        S1 where it is not given.
    level : str or MeshLevel
        Of the mesh, by name or as it is; the rules do not depend on it.
    """

    def __init__(
        self, design: Design | None = None, level: str | MeshLevel = "draft"
    ) -> None:
        chosen = mesh_level(level) if isinstance(level, str) else level
        self._problem = baseline(design or named_device("S1"), chosen)
        self.workspace = Workspace()

    def problem(self) -> Problem:
        """A copy of its own: an effect that writes into it spoils nothing else."""
        return deepcopy(self._problem)

    @cached_property
    def response(self) -> Response:
        """Along `PATH`."""
        return solve(self._problem, PATH, self.workspace)

    @cached_property
    def scale(self) -> Array:
        """(m,) array, SI; largest value of each output."""
        largest: Array = np.abs(self.response.values[0]).max(axis=0)
        return largest

    def change(self, other: Response) -> Array:
        """(m,) array; largest change of each output over its scale, NaN where none.

        Over the load steps that both paths reached.
        """
        apart = np.abs(other.values[0] - self.response.values[0]) / self.scale
        reached = np.isfinite(apart).all(axis=1)
        if not reached.any():
            return np.full(len(OUTPUT_NAMES), np.nan)
        largest: Array = apart[reached].max(axis=0)
        return largest


@dataclass(frozen=True)
class State:
    """A deformed state with the effect in it.

    problem : Problem
    x : (n, 3) array, m; nodes at the end of `PATH`, or where the path ended.
    pressure : float, Pa; in the cavity.
    volume : float, m3; change of the cavity in the half model.
    equations : Equilibrium; with the laws' history up to there.
    direction : (n, 3) array; along the path.
    """

    problem: Problem
    x: Array
    pressure: float
    volume: float
    equations: Equilibrium
    direction: Array


class NoAnswer(EffectError):
    """An effect stopped with an error of its own where an answer was due."""


class Subject:
    """An effect under test; what several checks need of it is computed once."""

    def __init__(self, effect: Effect, ground: Ground) -> None:
        self.effect, self.ground = effect, ground
        self._responses: dict[tuple[float, ...], Response] = {}

    def towards(self, up: bool, share: float) -> Values:
        """All parameters this share of the way from off to an end of their range.

        A parameter that is off at that very end goes to the other one; whole numbers
        stay off until they are at the end.
        """
        values = {}
        for p in self.effect.parameters:
            off = self.effect.off[p.name]
            end = p.upper if up else p.lower
            if end == off:
                end = p.lower if up else p.upper
            value = off + share * (end - off)
            values[p.name] = off if p.scale == "integer" and share < 1 else value
        return values

    @property
    def rays(self) -> list[bool]:
        """Directions in which to leave off: one where both are the same."""
        same = self.towards(True, 1.0) == self.towards(False, 1.0)
        return [True] if same else [True, False]

    @property
    def corners(self) -> list[Values]:
        """Corners of the range: all low, all high, and two that alternate.

        Both ends of every parameter are among them.
        """

        def corner(pick: Callable[[int], bool]) -> Values:
            ends = enumerate(self.effect.parameters)
            return {p.name: p.upper if pick(i) else p.lower for i, p in ends}

        picks: list[Callable[[int], bool]] = [
            lambda i: False,
            lambda i: True,
            lambda i: i % 2 == 0,
            lambda i: i % 2 == 1,
        ]
        found: list[Values] = []
        for values in map(corner, picks):
            if values not in found and values != self.effect.off:
                found.append(values)
        return found

    def response(self, values: Values) -> Response:
        """Along `PATH` with the effect in it.

        Raises
        ------
        NoAnswer
            When the effect, or the solver on what it has made, stops with an error.
        """
        key = tuple(values[p.name] for p in self.effect.parameters)
        if key not in self._responses:
            try:
                problem = self.effect.apply(self.ground.problem(), values)
                self._responses[key] = solve(problem, PATH, self.ground.workspace)
            except AUTHORS_ERRORS as error:
                words = f"{told(self.effect, error)}, at {spelled(values)}"
                raise NoAnswer(words) from error
        return self._responses[key]

    @property
    def middle(self) -> Values:
        return self.towards(True, PART)

    @cached_property
    def state(self) -> State:
        """In the middle of the range, under pressure and unloading."""
        problem = self.effect.apply(self.ground.problem(), self.middle)
        follower = PathFollower(problem, self.ground.workspace)
        follower.run(PATH.pressure, PATH.time)
        point = follower.point
        return State(
            problem=problem,
            x=point.x,
            pressure=point.pressure,
            volume=point.volume - follower.first_volume,
            equations=follower.equations,
            direction=point.direction,
        )


def spelled(values: Mapping[str, float]) -> str:
    """Parameters and their values, for messages."""
    return ", ".join(f"{name} = {value:.4g}" for name, value in values.items())


def leaves(value: object, name: str = "") -> Iterator[tuple[str, object]]:
    """Arrays, numbers and texts inside a value, each with its place.

    Functions are left out: what they do is compared, not what they are.
    """
    if isinstance(value, (FunctionType, MethodType, ModuleType, type)):
        return
    parts: Mapping[Any, object] | None = None
    if is_dataclass(value):
        parts = {field.name: getattr(value, field.name) for field in fields(value)}
    elif isinstance(value, Mapping):
        parts = value
    elif isinstance(value, (list, tuple)):
        parts = dict(enumerate(value))
    elif hasattr(value, "__dict__") and not isinstance(value, np.ndarray):
        parts = vars(value)
    if parts is None:
        yield name, value
    else:
        yield f"{name}.type", type(value).__name__
        for key, part in parts.items():
            yield from leaves(part, f"{name}.{key}" if name else str(key))


def differing(one: object, other: object) -> list[str]:
    """Places where two values are not the same to the last bit."""
    left, right = dict(leaves(one)), dict(leaves(other))

    def same(name: str) -> bool:
        if name not in left or name not in right:
            return False
        a, b = left[name], right[name]
        if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
            return a.dtype == b.dtype and a.tobytes() == b.tobytes()
        return bool(a == b)

    return [name for name in sorted({*left, *right}) if not same(name)]
