"""Points of an equilibrium path, and the local coordinate that predicts the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Point:
    """One equilibrium and the path's direction there.

    x : (n, 3) array, m; deformed nodes.  pressure : Pa, in the cavity.
    volume : m3.  direction : (n, 3) array, dx/ds of the path's length s.
    normal : (n, 3) array; ds/dx.  slope : Pa/m, dp/ds.
    stress : (27 e, 6) array, Pa; second Piola-Kirchhoff, at the quadrature points.
    stress_rate : (27 e, 6) array, Pa/m; its derivative by s.
    negative : int; negative eigenvalues of the tangent, 0 where stable.
    jacobian : (m, k) array, SI, or None; outputs by parameters, see `Sensitivity`.
    """

    x: Array
    pressure: float
    volume: float
    direction: Array
    normal: Array
    slope: float
    stress: Array
    stress_rate: Array
    negative: int = 0
    jacobian: Array | None = None


class Chart:
    """A straight coordinate s = normal . (x - here.x) of the path near two points.

    Parameters
    ----------
    here : Point
        s = 0, and there s is the arc length.
    before : Point, optional
        Another point of the path; without it the chart follows the tangent.
    normal : (n, 3) array, optional
        Direction in which s grows; the path's own at `here` by default.
    """

    def __init__(
        self, here: Point, before: Point | None = None, normal: Array | None = None
    ) -> None:
        normal = here.normal if normal is None else normal
        self.normal = normal / np.vdot(normal, here.direction)
        self.here, self.before = here, before
        if before is not None:
            self.start = self.measure(before.x)
            self.rate = float(np.vdot(self.normal, before.direction))
            if self.rate < 0.3 or self.start == 0:
                self.before = None  # the path has turned: two points say little

    def measure(self, x: Array) -> float:
        """Coordinate of nodes (n, 3), m."""
        return float(np.vdot(self.normal, x - self.here.x))

    def at(self, s: float) -> tuple[Array, float]:
        """Nodes and pressure expected at a coordinate."""
        b, a = self.here, self.before
        if a is None:
            return b.x + s * b.direction, self.at_pressure(s)
        x = self._cubic(s, (a.x, a.direction), (b.x, b.direction))
        return x, self.at_pressure(s)

    def at_pressure(self, s: float) -> float:
        """Pressure expected at a coordinate, Pa."""
        b, a = self.here, self.before
        if a is None:
            return b.pressure + s * b.slope
        return float(self._cubic(s, (a.pressure, a.slope), (b.pressure, b.slope)))

    def stress(self, s: float) -> Array:
        """Stress (27 e, 6), Pa, expected at a coordinate."""
        b, a = self.here, self.before
        if a is None:
            return b.stress + s * b.stress_rate
        stress: Array = self._cubic(
            s, (a.stress, a.stress_rate), (b.stress, b.stress_rate)
        )
        return stress

    def _cubic(self, s: float, before: Any, here: Any) -> Any:
        """Hermite's cubic through (value, slope) at the two points.

        From `here`, as the weights of the values sum to one: held displacements then
        stay held to the last bit.  Extrapolation would multiply their rounding errors
        in every step, and nothing corrects them.
        """
        width = -self.start
        t = 1 + s / width
        h00 = (1 + 2 * t) * (1 - t) ** 2
        h10, h11 = width * t * (1 - t) ** 2 / self.rate, width * t * t * (t - 1)
        return here[0] + h00 * (before[0] - here[0]) + h10 * before[1] + h11 * here[1]

    def reach(self, pressure: float, furthest: float) -> float | None:
        """Coordinate up to `furthest` where `pressure` is expected, or None."""
        share = np.linspace(0.0, 1.0, 41)
        ahead = np.array([self.at_pressure(furthest * t) for t in share])
        side = np.sign(pressure - self.here.pressure)
        beyond = np.nonzero(side * (ahead - pressure) >= 0)[0]
        if len(beyond) == 0 or beyond[0] == 0:
            return None
        k = int(beyond[0])
        inner = (pressure - ahead[k - 1]) / (ahead[k] - ahead[k - 1])
        return furthest * float(share[k - 1] + inner * (share[k] - share[k - 1]))

    def turning(self) -> float:
        """Coordinate between the two points where the cubic p(s) has zero slope."""
        a, b = self.before, self.here
        assert a is not None
        m0, m1 = -self.start * a.slope / self.rate, -self.start * b.slope
        rise = b.pressure - a.pressure
        # p'(t) = m0 + t (6 rise - 4 m0 - 2 m1) + t^2 (3 m0 + 3 m1 - 6 rise)
        roots = np.roots([3 * m0 + 3 * m1 - 6 * rise, 6 * rise - 4 * m0 - 2 * m1, m0])
        inside = [float(r.real) for r in roots if abs(r.imag) < 1e-9 and 0 < r.real < 1]
        return self.start * (1 - (inside[0] if inside else m0 / (m0 - m1)))


def extrapolate(known: Sequence[tuple[float, Array]], where: float) -> Array:
    """Lagrange's polynomial through (coordinate, value) pairs, from the last one."""
    last = known[-1][1]
    guess = last.copy()
    for i, (here, value) in enumerate(known[:-1]):
        others = [place for j, (place, _) in enumerate(known) if j != i]
        weight = np.prod([(where - other) / (here - other) for other in others])
        guess += weight * (value - last)  # what does not move stays, see Chart.at
    return guess


def largest(field: Array) -> float:
    """Largest component of a nodal field."""
    return float(np.abs(field).max())
