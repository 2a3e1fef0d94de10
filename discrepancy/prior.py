"""What is believed of a parameter before any reading: its range as a density.

A declared range means two standard deviations to each side (or to the one side there
is); beyond it there is nothing.  Inference works in a coordinate of its own in which
every prior is a truncated standard normal density or an even one on [0, 1].
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr, ndtr, ndtri

from datagen.errors import InputError
from datagen.space import Parameter

Array = np.ndarray

NORMAL, EVEN = "normal", "even"
"""Densities of the coordinate."""


@dataclass(frozen=True)
class Prior:
    """Density of one parameter over its range.

    Parameters
    ----------
    parameter : Parameter
        Its `prior` names the family, `off` the centre of the normal ones.

    Notes
    -----
    With t the coordinate:

    ===========  ==============================  ==================
    family       value                           t
    ===========  ==============================  ==================
    uniform      lower + (upper - lower) t       even on [0, 1]
    log-uniform  lower (upper / lower)^t         even on [0, 1]
    normal       off + s t, s = half range / 2   normal, truncated
    half-normal  off + s t, s = range / 2        normal, truncated
    log-normal   off exp(s t), s = log range/4   normal, truncated
    ===========  ==============================  ==================
    """

    parameter: Parameter

    def __post_init__(self) -> None:
        p = self.parameter
        if p.prior in ("log-uniform", "log-normal") and p.lower <= 0:
            raise InputError(f"{p.name}.lower", p.lower, f"above 0 for {p.prior}")

    @property
    def density(self) -> str:
        """`NORMAL` or `EVEN`, of the coordinate."""
        return EVEN if self.parameter.prior in ("uniform", "log-uniform") else NORMAL

    @property
    def _logarithmic(self) -> bool:
        return self.parameter.prior.startswith("log-")

    @property
    def _line(self) -> tuple[float, float]:
        """Origin and unit of the coordinate, on the value or its logarithm."""
        p = self.parameter
        lower, upper = p.lower, p.upper
        centre = p.off if p.off is not None else (lower + upper) / 2
        if self._logarithmic:
            lower, upper = math.log(lower), math.log(upper)
            centre = math.log(p.off) if p.off is not None else (lower + upper) / 2
        if self.density == EVEN:
            return lower, upper - lower
        sides = 2.0 if p.prior == "half-normal" else 4.0
        return centre, (upper - lower) / sides

    @property
    def bounds(self) -> tuple[float, float]:
        """Coordinates of the ends of the range."""
        p = self.parameter
        return self.coordinate(p.lower), self.coordinate(p.upper)

    @property
    def off(self) -> float:
        """Coordinate at which the effect vanishes; the middle where nothing does."""
        if self.parameter.off is None:
            return 0.5 * sum(self.bounds)
        return self.coordinate(self.parameter.off)

    def coordinate(self, value: float) -> float:
        """Coordinate of a value, SI."""
        origin, unit = self._line
        return ((math.log(value) if self._logarithmic else value) - origin) / unit

    def value(self, t: Array | float) -> Array:
        """Values (...,), SI, of coordinates (...,)."""
        origin, unit = self._line
        line = origin + unit * np.asarray(t, dtype=float)
        value: Array = np.exp(line) if self._logarithmic else line
        inside: Array = np.clip(value, self.parameter.lower, self.parameter.upper)
        return inside

    def slope(self, t: float) -> float:
        """d value / dt at a coordinate, SI."""
        unit = self._line[1]
        return float(unit * self.value(t)) if self._logarithmic else unit

    def log_density(self, t: Array) -> Array:
        """Log density (...,) of coordinates, minus infinity outside the range."""
        t = np.asarray(t, dtype=float)
        lower, upper = self.bounds
        inside = (t >= lower - 1e-12) & (t <= upper + 1e-12)
        if self.density == EVEN:
            return np.asarray(np.where(inside, 0.0, -np.inf))
        mass = _log_mass(lower, upper)
        logs = -0.5 * t**2 - 0.5 * math.log(2 * math.pi) - mass
        return np.asarray(np.where(inside, logs, -np.inf))

    def sample(self, u: Array) -> Array:
        """Coordinates (...,) of numbers in (0, 1), by the inverse distribution."""
        lower, upper = self.bounds
        if self.density == EVEN:
            return np.asarray(u, dtype=float)
        a, b = ndtr(lower), ndtr(upper)
        t: Array = np.clip(ndtri(a + (b - a) * u), lower, upper)
        return t


def _log_mass(lower: float, upper: float) -> float:
    """Log of the standard normal probability between two bounds."""
    if lower > 0:  # from the nearer tail, where differences are exact
        lower, upper = -upper, -lower
    return float(
        log_ndtr(upper) + math.log1p(-math.exp(log_ndtr(lower) - log_ndtr(upper)))
    )
