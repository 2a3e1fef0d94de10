"""The device: its design variables, the named devices, and the sampled space.

Frame of the contract: x along the strip from the clamp, y across it from the
mid-plane, z through the thickness from the bottom of the lower layer.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace

from .errors import InputError
from .space import Parameter, Space

POISSON = 0.48
"""Poisson's ratio of the baseline law; fixed by the contract."""

UM, MM, MPA = 1e-6, 1e-3, 1e6

LIMITS = Space(
    tuple(
        Parameter(name, unit, lower, upper, scale, source="what the mesh can carry")
        for name, unit, lower, upper, scale in (
            ("length", "m", 0.5 * MM, 60 * MM, "linear"),
            ("width", "m", 0.1 * MM, 30 * MM, "linear"),
            ("balloon_length", "m", 0.2 * MM, 50 * MM, "linear"),
            ("balloon_width", "m", 0.05 * MM, 20 * MM, "linear"),
            ("balloon_start", "m", 0.02 * MM, 20 * MM, "linear"),
            ("wall", "m", 0.02 * MM, 5 * MM, "linear"),
            ("divisions_x", "1", 1, 12, "integer"),
            ("divisions_y", "1", 1, 6, "integer"),
            ("cavity_height", "m", 5 * UM, 2000 * UM, "linear"),
            ("upper_thickness", "m", 10 * UM, 2000 * UM, "linear"),
            ("lower_thickness", "m", 10 * UM, 2000 * UM, "linear"),
            ("upper_modulus", "Pa", 0.01 * MPA, 100 * MPA, "linear"),
            ("lower_modulus", "Pa", 0.01 * MPA, 100 * MPA, "linear"),
        )
    )
)
"""What any request may ask for; the finite elements answer inside these limits."""

DESIGN_SPACE = Space(
    tuple(
        Parameter(name, unit, lower, upper, scale, source="contract")
        for name, unit, lower, upper, scale in (
            ("balloon_length", "m", 2 * MM, 10 * MM, "linear"),
            ("divisions_x", "1", 1, 6, "integer"),
            ("divisions_y", "1", 1, 2, "integer"),
            ("wall", "m", 0.1 * MM, 0.5 * MM, "linear"),
            ("balloon_start", "m", 0.25 * MM, 2.5 * MM, "linear"),
            ("tip_margin", "m", 0.25 * MM, 2.5 * MM, "linear"),
            ("balloon_width", "m", 0.6 * MM, 2.0 * MM, "linear"),
            ("rim", "m", 0.1 * MM, 1.0 * MM, "linear"),
            ("cavity_height", "m", 30 * UM, 150 * UM, "linear"),
            ("upper_thickness", "m", 40 * UM, 200 * UM, "linear"),
            ("lower_thickness", "m", 60 * UM, 300 * UM, "linear"),
            ("upper_modulus", "Pa", 0.8 * MPA, 5 * MPA, "linear"),
            ("lower_modulus", "Pa", 0.8 * MPA, 5 * MPA, "linear"),
        )
    )
)
"""The contract's default design space; length and width follow from it."""

LONG_NAMES = {
    "balloon_length": "length of all balloons together, walls excluded",
    "divisions_x": "number of balloons along the strip",
    "divisions_y": "number of balloons across the strip",
    "wall": "thickness of the wall between neighbouring balloons",
    "balloon_start": "distance from the clamp to the first balloon",
    "tip_margin": "distance from the last balloon to the tip",
    "balloon_width": "width of all balloons together, walls excluded",
    "rim": "distance from the balloons to the side of the strip",
    "cavity_height": "height of the undeformed cavity",
    "upper_thickness": "thickness of the upper membrane",
    "lower_thickness": "thickness of the lower membrane",
    "upper_modulus": "Young's modulus of the upper layer",
    "lower_modulus": "Young's modulus of the lower layer and of the spacer",
}
"""Of the variables of the design space."""

MAX_PRESSURE = 150e3
"""Pa.  Each path of a dataset runs to here or to its limit pressure."""

Interval = tuple[float, float]


@dataclass(frozen=True)
class Design:
    """One device, SI.

    Parameters
    ----------
    length, width : float, m
        Outer size of the strip.
    balloon_length, balloon_width : float, m
        Totals over the divisions, walls excluded.
    balloon_start : float, m
        Clamp to the first balloon.
    wall : float, m
        Solid wall between neighbouring balloons.
    divisions_x, divisions_y : int
        Number of balloons along and across.
    cavity_height, upper_thickness, lower_thickness : float, m
    upper_modulus, lower_modulus : float, Pa
        Young's moduli; the spacer around the cavity is of the lower material.

    Raises
    ------
    InputError
        When a value is not finite or outside `LIMITS`, or the balloons do not fit.
    """

    length: float
    width: float
    balloon_length: float
    balloon_width: float
    balloon_start: float
    wall: float
    divisions_x: int
    divisions_y: int
    cavity_height: float
    upper_thickness: float
    lower_thickness: float
    upper_modulus: float
    lower_modulus: float

    def __post_init__(self) -> None:
        for parameter in LIMITS:
            value = parameter.check(getattr(self, parameter.name))
            whole = parameter.scale == "integer"
            object.__setattr__(self, parameter.name, int(value) if whole else value)
        end = self.balloon_start + self.span_x
        least = LIMITS["wall"].lower * (1 - 1e-9)  # slack for unit conversion
        if self.tip_margin < least:
            raise InputError(
                "length_mm",
                self.length / MM,
                f"at least {(end + LIMITS['wall'].lower) / MM:g} mm: the balloons end "
                f"at {end / MM:g} mm (balloon_start + balloon_length + walls)",
                "mm",
            )
        if self.rim < least:
            raise InputError(
                "width_mm",
                self.width / MM,
                f"at least {(self.span_y + 2 * LIMITS['wall'].lower) / MM:g} mm: the "
                f"balloons and their walls span {self.span_y / MM:g} mm",
                "mm",
            )

    @property
    def span_x(self) -> float:
        """Length from the first balloon's start to the last one's end, m."""
        return self.balloon_length + (self.divisions_x - 1) * self.wall

    @property
    def span_y(self) -> float:
        """Width over all balloons and the walls between them, m."""
        return self.balloon_width + (self.divisions_y - 1) * self.wall

    @property
    def tip_margin(self) -> float:
        """From the last balloon to the tip, m."""
        return self.length - self.balloon_start - self.span_x

    @property
    def rim(self) -> float:
        """From the balloons to the side of the strip, m."""
        return (self.width - self.span_y) / 2

    @property
    def thickness(self) -> float:
        """Whole strip: lower membrane, spacer, upper membrane, m."""
        return self.lower_thickness + self.cavity_height + self.upper_thickness

    @property
    def balloon_size(self) -> tuple[float, float]:
        """Length and width of one balloon, m."""
        return (
            self.balloon_length / self.divisions_x,
            self.balloon_width / self.divisions_y,
        )

    def balloons_x(self) -> list[Interval]:
        """x intervals of the balloons, m, from the clamp to the tip."""
        size = self.balloon_size[0]
        starts = [
            self.balloon_start + i * (size + self.wall) for i in range(self.divisions_x)
        ]
        return [(start, start + size) for start in starts]

    def balloons_y(self) -> list[Interval]:
        """y intervals of the balloons in the half y >= 0, m, from the mid-plane.

        With an odd number the first one starts at 0 (half a balloon).
        """
        size = self.balloon_size[1]
        left = -self.span_y / 2
        whole = [
            (left + j * (size + self.wall), left + j * (size + self.wall) + size)
            for j in range(self.divisions_y)
        ]
        middle = self.divisions_y // 2
        if self.divisions_y % 2:
            return [(0.0, size / 2), *whole[middle + 1 :]]
        return whole[middle:]

    @classmethod
    def from_sample(cls, values: Mapping[str, float]) -> Design:
        """Design from the variables of `DESIGN_SPACE`; length and width follow."""
        given = dict(values)
        tip_margin, rim = given.pop("tip_margin"), given.pop("rim")
        nx, ny = int(given["divisions_x"]), int(given["divisions_y"])
        length = (
            given["balloon_start"]
            + given["balloon_length"]
            + (nx - 1) * given["wall"]
            + tip_margin
        )
        width = given["balloon_width"] + (ny - 1) * given["wall"] + 2 * rim
        given |= {"divisions_x": nx, "divisions_y": ny}
        return cls(length=length, width=width, **given)  # type: ignore[arg-type]

    def sampled(self) -> dict[str, float]:
        """The variables of `DESIGN_SPACE` of this design, SI."""
        return {name: float(getattr(self, name)) for name in DESIGN_SPACE.names}

    def to_dict(self) -> dict[str, float]:
        """SI fields by name."""
        return asdict(self)

    def with_values(self, **values: float) -> Design:
        """A copy with some fields changed, checked again."""
        unknown = set(values) - set(DESIGN_FIELDS)
        if unknown:
            raise InputError("design", sorted(unknown)[0], ", ".join(DESIGN_FIELDS))
        return replace(self, **values)  # type: ignore[arg-type]


DESIGN_FIELDS = tuple(field.name for field in fields(Design))

MATERIALS = {"A": 4.5 * MPA, "B": 2.5 * MPA}
"""Young's moduli of the published mixes, Pa (PDMS-A 8:1, PDMS-B 12:1)."""

CASES = {1: ("B", "A"), 2: ("A", "B"), 3: ("A", "A"), 4: ("B", "B")}
"""Upper and lower material of the published cases."""


def named_device(name: str = "S1", case: int = 1) -> Design:
    """A published device: ``S1`` or ``D8-MxN`` (M along, N across), cases 1 to 4.

    Raises
    ------
    InputError
        When the name or the case is unknown.
    """
    if case not in CASES:
        raise InputError("case", case, "1, 2, 3 or 4")
    upper, lower = (MATERIALS[mix] for mix in CASES[case])
    shared = {
        "balloon_start": 1.25 * MM,
        "wall": 0.2 * MM,
        "upper_thickness": 95 * UM,
        "lower_thickness": 140 * UM,
        "upper_modulus": upper,
        "lower_modulus": lower,
        "balloon_width": 1 * MM,
        "tip_margin": 1.25 * MM,
        "rim": 0.5 * MM,
    }
    if name == "S1":
        own = {"balloon_length": 4 * MM, "cavity_height": 75 * UM}
        return Design.from_sample(shared | own | {"divisions_x": 1, "divisions_y": 1})
    match = re.fullmatch(r"D8-([1-9]\d*)x([1-9]\d*)", name)
    if not match:
        raise InputError("device", name, "S1 or D8-MxN, as in D8-4x1")
    own = {"balloon_length": 8 * MM, "cavity_height": 65 * UM}
    divisions = {"divisions_x": int(match[1]), "divisions_y": int(match[2])}
    return Design.from_sample(shared | own | divisions)
