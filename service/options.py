"""Options that several commands share, and readers of numbers with clear errors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from typer import Option

from datagen.errors import InputError

DEFAULT_PRESSURES = ",".join(str(p) for p in range(0, 65, 5))

LEVELS = ("draft", "standard", "fine")
"""Meshes of today, which need not be looked up."""

MANY_DESIGNS = 10**8


def whole(name: str, lower: int, upper: int) -> Callable[[str], int]:
    """Reader of a whole number whose error names field, value and range."""

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = None
        if value is None or not lower <= value <= upper:
            allowed = f"a whole number from {lower} to {upper}"
            shown = text if value is None else value
            raise InputError(name, shown, allowed)
        return value

    return read


def number(name: str, lower: float, upper: float, unit: str) -> Callable[[str], float]:
    """Reader of a number whose error names field, value, unit and range."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not lower <= value <= upper:
            allowed = f"a number from {lower:g} to {upper:g} {unit}"
            raise InputError(name, text, allowed, unit)
        return value

    return read


AsJson = Annotated[
    bool, Option("--json", help="Print one JSON object and nothing else.")
]
Device = Annotated[
    str, Option(help="Named device: S1 or D8-MxN, as in D8-4x1.", metavar="NAME")
]
Case = Annotated[
    int,
    Option(
        help="Material case of the device, 1 to 4.",
        parser=whole("--case", 1, 4),
        metavar="1..4",
    ),
]
Settings = Annotated[
    list[str],
    Option(
        "--set",
        metavar="NAME=VALUE",
        help="Change a column of the device, as in upper_thickness_um=80. Repeatable.",
    ),
]
Pressures = Annotated[
    str, Option(metavar="P,P,...", help="Load steps in kPa, separated by commas.")
]
Level = Annotated[str, Option(help="Mesh: draft, standard or fine.")]
EffectsDir = Annotated[
    Path | None, Option(metavar="DIR", help="Folder with effects of your own.")
]
WorkspaceDir = Annotated[
    Path | None,
    Option(
        "--workspace",
        metavar="DIR",
        help="Folder of model versions; else PBA_WORKSPACE, or pba-models here.",
    ),
]
