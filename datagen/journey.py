"""Visiting wanted pressures along an equilibrium path, and how the visit ends."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from .chart import Point
from .control import Leg, Outcome, StepFailed, legs
from .problem import Body

if TYPE_CHECKING:
    from .continuation import PathFollower

Array = np.ndarray


class Journey:
    """One run of a path follower through gauge pressures.

    Parameters
    ----------
    follower : PathFollower
    keep_all : bool
        Keep the points on the way and the limit point, too.
    far_enough : callable, optional
        Go on past a limit point until this is true of a point; all points there are
        kept.  Without it the path ends at the limit point.
    """

    def __init__(
        self,
        follower: PathFollower,
        keep_all: bool,
        far_enough: Callable[[Point], bool] | None,
    ) -> None:
        self.follower, self.keep_all = follower, keep_all
        self.far_enough = far_enough
        self.outcome = Outcome()
        self._legs = 0  # begun so far

    def go(self, targets: Array, times: Array) -> Outcome:
        """Visit gauge pressures (s,), Pa, at their times (s,), s, in turn."""
        follower = self.follower
        problem = follower.problem
        now = (gauge(problem, follower.point.pressure), follower.due)
        for leg in legs(targets, times, now, follower.parts):
            if self._visit(leg):
                return self.outcome
        if follower.limit is not None:
            self._end("completed", "")
        return self.outcome

    def _visit(self, leg: Leg) -> bool:
        """Go to the pressure of one leg; True where the path ends before."""
        follower = self.follower
        problem = follower.problem
        self._legs += 1
        target = problem.pressure_gain * leg.pressure + problem.pressure_offset
        held = target == follower.point.pressure
        try:
            follower.wait(leg.time, held)
        except StepFailed as failure:
            return self._end(failure.status, f"{failure.detail}, held at {self._at()}")
        if held:
            if self._touches(held):
                return True
            if leg.whole:
                follower.differentiate()
                self.outcome.keep(leg.step, follower.point)
            return False
        follower.head_for(target)
        while True:
            # Each leg before took a step at least, and one more where the body swells.
            allowed = follower.options.max_steps + 2 * (self._legs - 1)
            if follower.counters.steps >= allowed:
                words = f"after {follower.counters.steps} steps"
                return self._end("step_limit", words)
            try:
                reached = follower.advance(target)
            except StepFailed as failure:
                if failure.status == "limit_point":
                    follower.limit = follower.point
                    words = f"{failure.detail} at {self._at()}"
                    self.outcome.end("limit_point", words)
                    return True
                words = f"{failure.detail}, past {self._at()}"
                return self._end(failure.status, words)
            if self._look(leg.step, reached and leg.whole):
                return True
            if reached:
                return False

    def _look(self, step: int, wanted: bool) -> bool:
        """Keep the new point where it is wanted; True where the path ends there."""
        follower, point, go_on = self.follower, self.follower.point, self.far_enough
        follower.watch()
        if follower.limit is not None and follower.turned:
            if self.keep_all or go_on is not None:
                self.outcome.keep(step, follower.limit)
            if go_on is None:
                return self._end("limit_point", "")
        if self._touches():
            return True
        if wanted or self.keep_all or follower.limit is not None:
            self.outcome.keep(step, point)
        if wanted or follower.limit is None or go_on is None or not go_on(point):
            return False
        return self._end("limit_point", f"ends at {self._at()}")

    def _touches(self, held: bool = False) -> bool:
        """End the path where roof and floor touch at its last point.

        Weight, growth or time close a cavity without a change of pressure: `held`.
        """
        follower = self.follower
        touching = follower.problem.mesh.touching
        if not touching(follower.point.x):
            return False
        at = self._at(None if held else follower.first_where(touching))
        return self._end("contact", f"roof and floor touch at {at}")

    def _end(self, status: str, words: str) -> bool:
        """End the path; one that has turned says so first, whatever came after."""
        limit = self.follower.limit
        if limit is not None:
            turned = f"the path turns at {self._at(limit.pressure)}"
            status = "limit_point"
            words = turned + (f"; followed beyond: {words}" if words else "")
        self.outcome.end(status, words)
        return True

    def _at(self, pressure: float | None = None) -> str:
        """Gauge pressure in words of a cavity pressure, Pa, or of the last point."""
        pressure = self.follower.point.pressure if pressure is None else pressure
        return f"{gauge(self.follower.problem, pressure) / 1e3:.4g} kPa"


def gauge(problem: Body, pressure: float) -> float:
    """Gauge pressure of a cavity pressure, Pa."""
    return (pressure - problem.pressure_offset) / problem.pressure_gain
