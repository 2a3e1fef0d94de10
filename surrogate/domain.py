"""Is a question inside what the surrogate was trained on, and if not, why not.

Three checks: the box of the sampled variables, the pressure (trained range and the
design's own predicted limit pressure), and the distance to the nearest training
designs in dimensionless groups.  Disagreement of the members is reported beside them:
an ensemble can agree and be wrong where it has seen nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from datagen.space import Parameter, Space
from datagen.units import BY_FIELD, PRESSURE

from .features import groups
from .limit import Limit

Array = np.ndarray

NEIGHBOURS = 5
"""The distance to the training designs is the mean over so many of them."""

FAR_QUANTILE = 0.99
"""Share of training designs that lie nearer to the others than the allowed distance."""

LIMIT_DEVIATIONS = 1.645
"""Standard deviations kept from the predicted limit pressure: 95 % one-sided."""

DERIVED = {
    "tip_margin": ("tip_margin_mm", "mm", 1e-3, "length_mm less the balloons' end"),
    "rim": ("rim_mm", "mm", 1e-3, "half of width_mm less the balloons"),
}
"""Sampled variables that are no column of a design: bench name, unit, what they are."""


@dataclass(frozen=True)
class RangeCheck:
    """Whether a prediction can be relied on.

    Parameters
    ----------
    in_range : bool
        True when every load step is in range.
    reasons : tuple of str
        Why not, one sentence a cause, in bench units.
    per_step : (s,) bool array
        Load steps that are in range.
    notes : tuple of str
        What is worth knowing beside the range: where the members disagree.
    """

    in_range: bool
    reasons: tuple[str, ...]
    per_step: Array
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Domain:
    """What was trained on.

    Parameters
    ----------
    space : Space
        The sampled box.
    max_pressure : float, Pa
    points : (n, g) array
        Dimensionless groups of the training designs, centred and scaled.
    centre, scale : (g,) arrays
    allowed_distance : float
        Quantile `FAR_QUANTILE` of the training designs' own distances.
    disagreement : (m,) array
        For each output, disagreement over size of the terms that 99 % of the points of
        unseen designs stay below.
    """

    space: Space
    max_pressure: float
    points: Array
    centre: Array
    scale: Array
    allowed_distance: float
    disagreement: Array

    @classmethod
    def of(
        cls,
        space: Space,
        max_pressure: float,
        columns: Mapping[str, Array],
        disagreement: Array,
    ) -> Domain:
        """Domain of a set of training designs."""
        raw = groups(columns)
        centre, scale = raw.mean(axis=0), raw.std(axis=0)
        scale = np.where(scale > 1e-9, scale, 1.0)
        points = (raw - centre) / scale
        own = [
            _distance(np.delete(points, i, axis=0), point)
            for i, point in enumerate(points)
        ]
        allowed = float(np.quantile(own, FAR_QUANTILE))
        return cls(space, max_pressure, points, centre, scale, allowed, disagreement)

    def distance(self, columns: Mapping[str, Array]) -> float:
        """Mean distance of one design to its nearest training designs.

        In standard deviations of the dimensionless groups.
        """
        return _distance(self.points, (groups(columns)[0] - self.centre) / self.scale)

    def check(
        self, columns: Mapping[str, Array], pressure: Array, limit: Limit
    ) -> RangeCheck:
        """Check one design along its load steps.

        Parameters
        ----------
        columns : mapping of (1,) arrays, SI
            The variables of the space.
        pressure : (s,) array, Pa
        limit : Limit
            Predicted limit pressure of the design.
        """
        values = {name: float(column[0]) for name, column in columns.items()}
        reasons = [
            _outside(parameter, value)
            for parameter, value in self.space.outside(values)
        ]
        distance = self.distance(columns)
        if distance > self.allowed_distance:
            reasons.append(
                f"far from the training designs: distance {distance:.2f} in "
                f"dimensionless groups, {FAR_QUANTILE:.0%} of them lie within "
                f"{self.allowed_distance:.2f} of each other"
            )
        steps = np.full(pressure.shape, not reasons)
        for bad, reason in self._pressure(pressure, limit):
            steps &= ~bad
            reasons.append(reason)
        return RangeCheck(bool(steps.all()), tuple(reasons), steps)

    def _pressure(self, pressure: Array, limit: Limit) -> list[tuple[Array, str]]:
        """Masks of load steps out of range, each with its reason."""
        found = []
        top = self.max_pressure * (1 + 1e-9)
        low, high = pressure < 0, pressure > top
        kpa = PRESSURE.factor
        if low.any():
            found.append(
                (
                    low,
                    f"{PRESSURE.name}: {pressure.min() / kpa:.10g} is below the "
                    f"trained range 0 to {self.max_pressure / kpa:g}",
                )
            )
        if high.any():
            found.append(
                (
                    high,
                    f"{PRESSURE.name}: {pressure.max() / kpa:.10g} is past the trained "
                    f"{self.max_pressure / kpa:g} kPa",
                )
            )
        if not np.isfinite(limit.std[0]):
            return found
        middle = float(limit.pressure[0])
        safe = float(limit.quantile(-LIMIT_DEVIATIONS)[0])
        near = pressure > safe
        if near.any():
            highest = float(pressure.max())
            side = "past" if highest > middle else "within the uncertainty of"
            margin = (middle - safe) / kpa
            found.append(
                (
                    near,
                    f"{PRESSURE.name}: {highest / kpa:g} is {side} the predicted "
                    f"limit pressure {middle / kpa:.3g} (+-{margin:.2g}) kPa of this "
                    "design",
                )
            )
        return found


def _distance(points: Array, point: Array) -> float:
    nearest = min(NEIGHBOURS, len(points))
    squares = ((points - point) ** 2).sum(axis=1)
    return float(np.sqrt(np.partition(squares, nearest - 1)[:nearest]).mean())


def _outside(parameter: Parameter, value: float) -> str:
    """One sentence for a variable outside its box, in bench units."""
    bench = BY_FIELD.get(parameter.name)
    meaning = ""
    if bench:
        name, factor = bench.name, bench.factor
    elif parameter.name in DERIVED:
        name, _, factor, meaning = DERIVED[parameter.name]
        meaning = f" ({meaning})"
    else:
        name, factor = parameter.name, 1.0
    side = "below" if value < parameter.lower else "above"
    return (
        f"{name}: {value / factor:.6g}{meaning} is {side} the trained range "
        f"{parameter.lower / factor:g} to {parameter.upper / factor:g}"
    )
