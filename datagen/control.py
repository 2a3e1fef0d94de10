"""Settings of path following, what a path cost, and how it ended."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from .chart import Point

Array = np.ndarray


@dataclass(frozen=True)
class Options:
    """Settings of the path follower.

    Parameters
    ----------
    tolerance : float
        Estimated error of every displacement over the thinnest wall.
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
        Wanted distance of prediction and solution over the thinnest wall.
    largest_error : float
        A solution further from its prediction is refused: it may lie on another
        branch, and thin membranes have many.
    tangent_tolerance : float
        Relative error of the path's tangent, in displacement.
    tangent_iterations : int
    node_share : float
        Of every node's movement in the length of a step.
    first_step : float
        Displacement of the first step over the thinnest wall.
    smallest_step : float
        Of the first step's volume; a smaller one ends the path.
    largest_growth : float
        Of one step over the one before.
    max_steps : int
        Steps of one path, and one more for each load step.
    turned : float
        First step after the pressure has turned, with memory, over the one before.
    fading_parts : int
        Parts of a load step where a law fades with time, an equilibrium at the end of
        each: the memory is of second order in time, see `history.convolve`.
    """

    tolerance: float = 3e-9
    iterations: int = 30
    contraction: float = 0.9
    patience: int = 6
    memory: int = 6
    factorisations: int = 4
    predictor_error: float = 0.1
    largest_error: float = 0.4
    tangent_tolerance: float = 1e-4
    tangent_iterations: int = 12
    node_share: float = 0.03
    first_step: float = 0.3
    smallest_step: float = 1e-4
    largest_growth: float = 3.0
    max_steps: int = 400
    turned: float = 0.3
    fading_parts: int = 2


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


class Leg(NamedTuple):
    """Part of a load step: its number, pressure (Pa) and time (s) at the part's end.

    whole : bool; whether the load step ends with it.
    """

    step: int
    pressure: float
    time: float
    whole: bool


def legs(
    targets: Array, times: Array, now: tuple[float, float], parts: int
) -> Iterator[Leg]:
    """Parts of load steps in turn.

    Parameters
    ----------
    targets, times : (s,) arrays, Pa and s
    now : (float, float)
        Pressure and time at which the first load step begins.
    parts : int
        Of each load step; its last one is whole.
    """
    pressure, time = now
    for i, (wanted, due) in enumerate(zip(targets, times, strict=True)):
        for share in np.arange(1, parts) / parts:
            part = pressure + share * (wanted - pressure)
            yield Leg(i, float(part), float(time + share * (due - time)), False)
        pressure, time = float(wanted), float(due)
        yield Leg(i, pressure, time, True)


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
