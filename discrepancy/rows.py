"""Single rows of a measurement file: which fields there must be, and each by itself."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from datagen.specimens import MODES

from .columns import DESIGN_NAMES, NUMBERS, QUANTITY_NAMES, refusal
from .measurement import LOADING, MEASURED, SPECIMENS, UNLOADING, folded
from .table import MINUS, MISSING, NUMBER, Complaints, Row, Table

WALL = 0.2e-3
"""m.  Wall of an undivided device, which has none: any will do."""


@dataclass
class Reading:
    """One row, checked by itself; numbers are SI."""

    row: Row
    device: str
    specimen: str
    branch: str
    mode: str
    numbers: dict[str, float]

    def get(self, name: str, default: float = np.nan) -> float:
        return self.numbers.get(name, default)

    @property
    def load(self) -> float:
        return self.numbers["stretch" if self.specimen == "tensile" else "pressure"]


def needed(specimen: str) -> tuple[tuple[str, ...], ...]:
    """Fields that a specimen's rows must have; one of each group."""
    if specimen == "actuator":
        names = (name for name in DESIGN_NAMES if name != "wall")  # see `_wall`
        return (*((name,) for name in names), ("pressure",))
    if specimen == "bulge":
        return (
            ("balloon_length",),
            ("balloon_width",),
            ("upper_thickness", "lower_thickness"),
            ("upper_modulus", "lower_modulus"),
            ("pressure",),
        )
    return (("upper_modulus", "lower_modulus"), ("stretch",))


def check_columns(table: Table, complaints: Complaints) -> None:
    """Columns that are missing for the specimens there are, all named at once."""
    here = set(table.factors)
    kinds = {row.texts.get("specimen", "actuator").lower() for row in table.rows}
    missing: dict[str, None] = {}
    if "device" not in here:
        missing["device"] = None
    for kind in (kind for kind in SPECIMENS if kind in kinds):
        for group in needed(kind):
            if not here & set(group):
                missing[NUMBERS[group[0]].name] = None
        if not here & set(MEASURED[kind]):
            names = [NUMBERS[name].name for name in MEASURED[kind]]
            missing[names[0] if len(names) == 1 else f"one of {', '.join(names)}"] = (
                None
            )
    if missing:
        noun = "column" if len(missing) == 1 else f"{len(missing)} columns"
        unknown = f" ({'; '.join(table.unknown[:3])})" if table.unknown else ""
        complaints.add(table.place, f"missing {noun}: {', '.join(missing)}{unknown}")


def _word(
    row: Row, name: str, allowed: Iterable[str], default: str, complaints: Complaints
) -> str:
    """A field of words, in lower case."""
    text = row.texts.get(name, default)
    if text.lower() in allowed:
        return text.lower()
    complaints.add(
        row.where(name),
        f"{name}: {text!r} is not allowed; allowed: {', '.join(allowed)}",
    )
    return default


def _number(
    row: Row, name: str, text: str, table: Table, complaints: Complaints
) -> float | None:
    """A field of a number, SI; None where it is none or outside its range."""
    column = NUMBERS[name]
    same = table.in_bench_unit(name)
    heading = column.name if same else table.headings.get(name, column.name)
    unit = f" in {column.unit}" if column.unit and same else ""
    text = text.replace(MINUS, "-")
    if not NUMBER.fullmatch(text):
        complaints.add(
            row.where(name),
            f"{heading}: {text!r} is not allowed; allowed: a plain number{unit}, "
            "or nothing where a reading is missing",
        )
        return None
    value = float(text.replace(table.decimal, ".")) * table.factors[name]
    lower = column.lower
    wrong = refusal(name, value, lower, column.upper, hint=same)
    if wrong and not same:
        where = table.headings.get(name)
        wrong += f"; written as {text}" + (f" in column {where}" if where else "")
    if wrong is None and name.endswith("_std") and value <= 0:
        wrong = (
            f"{column.name}: {text} {column.unit} is not allowed; allowed: a number "
            "above 0, or nothing where it is not known"
        )
    if wrong:
        complaints.add(row.where(name), wrong)
        return None
    if name == "orientation":
        value = folded(value)
    return float(round(value)) if column.whole else value


def _wall(
    row: Row, table: Table, numbers: dict[str, float], complaints: Complaints
) -> float | None:
    """Wall between two balloons, which an undivided device need not state."""
    text = row.texts.get("wall", "")
    undivided = numbers.get("divisions_x") == numbers.get("divisions_y") == 1
    empty = not text.strip("0.,")
    if empty and undivided:
        return WALL
    if text:
        return _number(row, "wall", text, table, complaints)
    complaints.add(
        row.place,
        "wall_mm: nothing is not allowed; allowed: a number where a device is divided",
    )
    return None


def _without_missing(row: Row, unread: dict[str, list[str]]) -> Row:
    """The row without the words that programs write into empty fields.

    Those in place of a reading go to `unread`, to be told.
    """
    texts = {}
    for name, text in row.texts.items():
        if name == "device" or text.lower() not in MISSING:
            texts[name] = text
        elif name in QUANTITY_NAMES or name.endswith("_std"):
            unread.setdefault(text, []).append(row.where(name))
    return Row(row.place, texts, row.places)


def read_row(
    row: Row, table: Table, complaints: Complaints, unread: dict[str, list[str]]
) -> Reading:
    """One row, each field checked by itself."""
    row = _without_missing(row, unread)
    device = row.texts.get("device", "")
    if not device:
        complaints.add(row.place, "device: nothing is not allowed; allowed: a name")
    elif not device.isprintable():
        complaints.add(
            row.where("device"),
            f"device: {device!a} is not allowed; allowed: a name of characters "
            "that can be seen",
        )
    specimen = _word(row, "specimen", SPECIMENS, "actuator", complaints)
    branch = _word(row, "branch", (LOADING, UNLOADING), LOADING, complaints)
    mode = MODES[0]
    if specimen == "tensile":
        mode = _word(row, "mode", MODES, mode, complaints)
    numbers: dict[str, float] = {}
    used = {name for group in needed(specimen) for name in group}
    for name, text in row.texts.items():
        if name not in NUMBERS or (name in DESIGN_NAMES and name not in used):
            continue
        value = _number(row, name, text, table, complaints)
        if value is not None:
            numbers[name] = value
    for group in needed(specimen):
        if not any(name in row.texts for name in group):
            names = " or ".join(NUMBERS[name].name for name in group)
            complaints.add(
                row.place,
                f"{names}: nothing is not allowed; allowed: a number in every row "
                f"of specimen {specimen}",
            )
    if specimen == "actuator" and (wall := _wall(row, table, numbers, complaints)):
        numbers["wall"] = wall
    for name in MEASURED["actuator"] + MEASURED["tensile"]:
        for one in (name, f"{name}_std"):
            if one in numbers and name not in MEASURED[specimen]:
                complaints.add(
                    row.where(one),
                    f"{NUMBERS[one].name}: a value is not allowed for specimen "
                    f"{specimen}; allowed: "
                    f"{', '.join(NUMBERS[q].name for q in MEASURED[specimen])}",
                )
        if f"{name}_std" in numbers and name not in numbers:
            del numbers[f"{name}_std"]  # of a reading that is missing
    return Reading(row, device, specimen, branch, mode, numbers)
