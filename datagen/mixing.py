"""Anderson's acceleration of a corrector that keeps its factorisation."""

from __future__ import annotations

import numpy as np

Array = np.ndarray


class Mixing:
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
