"""What kind of effect one is, asked of the problem that it makes of a device."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from datagen.device import Design
from datagen.effects import Effect
from datagen.errors import InputError
from datagen.model import Model
from datagen.problem import Problem

STRAIN = np.tile(np.diag([1.2, 0.9, 1.0]).reshape(1, 9), (2, 1))
"""Deformation gradients at which laws are asked whether they know time."""

QUICK, SLOW = 1.0, 1e3
"""Durations of a load step, s, that a law without time does not tell apart."""


@dataclass(frozen=True)
class Traits:
    """Answers about effects, each with the effect in the middle of its range.

    Parameters
    ----------
    known : mapping of str to Effect
    device : Design
        On which the effects are tried.
    folder : path or None
        Of a user's own effects.
    """

    known: Mapping[str, Effect]
    device: Design
    folder: Path | None = None
    _problems: dict[str | None, Problem | None] = field(
        default_factory=dict, init=False, repr=False
    )

    def _problem(self, name: str | None) -> Problem | None:
        """The device with an effect, None where that does not fit it."""
        if name not in self._problems:
            middle = {
                one: {p.name: 0.5 * (p.lower + p.upper) for p in effect.parameters}
                for one, effect in self.known.items()
                if one == name
            }
            model = Model(tuple(middle), "draft", middle, self.folder)
            try:
                self._problems[name] = model.problem(self.device)
            except InputError:
                self._problems[name] = None
        return self._problems[name]

    def remembers(self, name: str) -> bool:
        """Whether what came before changes the answer."""
        problem = self._problem(name)
        return problem is not None and (
            any(law.history_size for law in problem.laws) or bool(problem.swellings)
        )

    def timed(self, name: str) -> bool:
        """Whether the duration of a load step changes the answer."""
        problem = self._problem(name)
        if problem is None or not self.remembers(name):
            return False
        if problem.swellings:
            return True
        for law in problem.laws:
            rest = np.zeros((2, law.history_size))
            quick, slow = (
                law.respond(STRAIN, np.ones(2), rest, dt, False).stress
                for dt in (QUICK, SLOW)
            )
            if law.history_size and not np.array_equal(quick, slow):
                return True
        return False

    def smooth(self, name: str) -> bool:
        """Whether there are derivatives where the effect is off.

        There are none for an effect that frees what was held, or meshes anew, as soon
        as it is there; and one with a memory has a path of its own.
        """
        problem, rest = self._problem(name), self._problem(None)
        return (
            problem is not None
            and rest is not None
            and not self.remembers(name)
            and all(p.off is not None for p in self.known[name].parameters)
            and problem.nodes.shape == rest.nodes.shape
            and bool((problem.fixed == rest.fixed).all())
        )
