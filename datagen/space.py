"""Parameters and the spaces they span, with Latin-hypercube sampling."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from .errors import InputError
from .units import BY_FIELD

SCALES = ("linear", "log", "integer")
PRIORS = ("uniform", "log-uniform", "normal", "half-normal", "log-normal")


@dataclass(frozen=True)
class Parameter:
    """One number that a model depends on.

    Parameters
    ----------
    name : str
        SI name, a Python identifier; ``effect.parameter`` where a space holds both
        design variables and the parameters of effects.
    unit : str
        SI unit, ``"1"`` for a pure number.
    lower, upper : float
        Range, both ends allowed.
    scale : str
        One of `SCALES`: how the range is sampled.
    off : float, optional
        Value at which an effect vanishes exactly; finite.  None for design variables.
    prior : str
        One of `PRIORS`: the family over the range when the value is inferred.
    source : str
        Where the range comes from.
    """

    name: str
    unit: str
    lower: float
    upper: float
    scale: str = "linear"
    off: float | None = None
    prior: str = "uniform"
    source: str = ""

    def __post_init__(self) -> None:
        if not all(part.isidentifier() for part in self.name.split(".")):
            raise InputError("name", self.name, "a Python identifier")
        if not self.unit:
            raise InputError(f"{self.name}.unit", self.unit, 'a unit, "1" for a number')
        for side, bound in (("lower", self.lower), ("upper", self.upper)):
            if not math.isfinite(bound):
                raise InputError(f"{self.name}.{side}", bound, "a finite bound")
        if self.lower >= self.upper:
            raise InputError(f"{self.name}.lower", self.lower, f"below {self.upper:g}")
        if self.scale not in SCALES:
            raise InputError(f"{self.name}.scale", self.scale, ", ".join(SCALES))
        if self.scale == "log" and self.lower <= 0:
            raise InputError(f"{self.name}.lower", self.lower, "above 0 on a log scale")
        if self.prior not in PRIORS:
            raise InputError(f"{self.name}.prior", self.prior, ", ".join(PRIORS))
        if self.prior.startswith("log-") and self.lower <= 0:
            allowed = f"above 0 for {self.prior}"
            raise InputError(f"{self.name}.lower", self.lower, allowed)
        if self.off is not None and not math.isfinite(self.off):
            raise InputError(f"{self.name}.off", self.off, "a finite number")

    def from_unit(self, u: np.ndarray) -> np.ndarray:
        """Map numbers in [0, 1) to the range, by the parameter's scale."""
        if self.scale == "integer":
            count = self.upper - self.lower + 1
            return self.lower + np.minimum(np.floor(u * count), count - 1)
        if self.scale == "log":
            return self.lower * (self.upper / self.lower) ** u
        return self.lower + u * (self.upper - self.lower)

    def contains(self, value: float) -> bool:
        """True inside the range, with one part in 1e9 of slack for unit conversion."""
        slack = 1e-9 * max(abs(self.lower), abs(self.upper))
        return self.lower - slack <= value <= self.upper + slack

    def check(self, value: object) -> float:
        """The value as a float, or an `InputError` in bench units."""
        bench = BY_FIELD.get(self.name)
        name, unit, factor = (
            (bench.name, bench.unit, bench.factor)
            if bench
            else (self.name, self.unit if self.unit != "1" else "", 1.0)
        )
        whole = self.scale == "integer"
        allowed = (
            f"a {'whole ' if whole else ''}number from {self.lower / factor:g} "
            f"to {self.upper / factor:g} {unit}".rstrip()
        )
        if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
            raise InputError(name, value, allowed, unit)
        number = float(value)
        if not self.contains(number) or (whole and number != round(number)):
            raise InputError(name, number / factor, allowed, unit)
        return float(round(number)) if whole else number


@dataclass(frozen=True)
class Space:
    """An ordered box of parameters.

    Raises
    ------
    InputError
        When two parameters share a name.
    """

    parameters: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        if len(set(self.names)) != len(self.parameters):
            raise InputError("names", list(self.names), "names that differ")

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(parameter.name for parameter in self.parameters)

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.parameters)

    def __len__(self) -> int:
        return len(self.parameters)

    def __getitem__(self, name: str) -> Parameter:
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise InputError("name", name, ", ".join(self.names))

    def sample(self, count: int, seed: int) -> np.ndarray:
        """Latin-hypercube sample (McKay, Beckman and Conover 1979).

        Parameters
        ----------
        count : int
            Number of points, at least 1.
        seed : int
            The same seed gives the same points, on any machine.

        Returns
        -------
        (count, len(self)) array, SI; integer parameters hold whole numbers.
        """
        if count < 1:
            raise InputError("designs", count, "a whole number of at least 1")
        from scipy.stats import qmc  # takes a second to import: only where it is used

        sampler = qmc.LatinHypercube(d=len(self), rng=np.random.default_rng(seed))
        unit = sampler.random(count)
        columns = [p.from_unit(unit[:, i]) for i, p in enumerate(self.parameters)]
        return np.stack(columns, axis=1)

    def outside(self, values: Mapping[str, float]) -> list[tuple[Parameter, float]]:
        """Those parameters whose value is outside its range, with the value."""
        return [
            (p, float(values[p.name]))
            for p in self.parameters
            if p.name in values and not p.contains(float(values[p.name]))
        ]
