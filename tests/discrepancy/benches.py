"""Measurement files as people make them, for the tests."""

from __future__ import annotations

from pathlib import Path

COLUMNS = {
    "device": "S1",
    "length_mm": "6.5",
    "width_mm": "2.0",
    "balloon_length_mm": "4",
    "balloon_width_mm": "1",
    "balloon_start_mm": "1.25",
    "wall_mm": "0.2",
    "divisions_x": "1",
    "divisions_y": "1",
    "cavity_height_um": "75",
    "upper_thickness_um": "95",
    "lower_thickness_um": "140",
    "upper_modulus_MPa": "2.5",
    "lower_modulus_MPa": "4.5",
    "pressure_kPa": "10",
    "tip_deflection_mm": "0.02",
    "inflation_mm": "0.11",
}
"""One reading of the published device."""


def rows(*changes: dict[str, str]) -> list[dict[str, str]]:
    """Rows of the published device, each with some fields changed or added."""
    return [COLUMNS | change for change in changes]


def text_of(table: list[dict[str, str]], separator: str = ",") -> str:
    """The table as text; an empty field where a row lacks a column."""
    names = list(dict.fromkeys(name for row in table for name in row))
    lines = [names, *([row.get(name, "") for name in names] for row in table)]
    return "".join(separator.join(line) + "\n" for line in lines)


def write(folder: Path, *changes: dict[str, str], name: str = "bench.csv") -> Path:
    """A file of `rows`."""
    path = folder / name
    path.write_text(text_of(rows(*changes)), encoding="utf-8")
    return path


LOADS = ({"pressure_kPa": "10"}, {"pressure_kPa": "20"}, {"pressure_kPa": "30"})
"""Three load steps of the bench's device, as changes of its row."""
