"""Measurements back into a file of the contract's columns."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from datagen.atomic import write_text
from datagen.device import Design
from datagen.specimens import Tensile

from .columns import DESIGN_NAMES, NUMBERS, QUANTITY_NAMES
from .measurement import LOADING, Curve, Measurements


def _design_fields(curve: Curve) -> dict[str, float | str]:
    """What describes the device, by SI field name."""
    design = curve.design
    if isinstance(design, Design):
        return dict(design.to_dict())
    stated: dict[str, float | str] = {f"{design.layer}_modulus": design.modulus}
    if isinstance(design, Tensile):
        return stated | {"mode": design.mode}
    return stated | {
        "balloon_length": design.length,
        "balloon_width": design.width,
        f"{design.layer}_thickness": design.thickness,
    }


def _rows(curve: Curve) -> list[dict[str, float | str]]:
    """Fields of a curve's rows, SI; only those that are there."""
    load = "stretch" if isinstance(curve.design, Tensile) else "pressure"
    rows = []
    for i in range(len(curve.load)):
        row: dict[str, float | str] = {
            "device": curve.device,
            "specimen": curve.specimen,
            "run": curve.run,
            "orientation": curve.orientation,
            "branch": str(curve.branch[i]),
            load: float(curve.load[i]),
            **_design_fields(curve),
        }
        if curve.time is not None:
            row["time"] = float(curve.time[i])
        for k, name in enumerate(curve.outputs):
            for field, array in ((name, curve.values), (f"{name}_std", curve.std)):
                if np.isfinite(array[i, k]):
                    row[field] = float(array[i, k])
        rows.append(row)
    return rows


_USUAL = {"specimen": "actuator", "run": 1, "orientation": 0.0, "branch": LOADING}
"""Values that a reader takes where a column is not there."""


def _text(field: str, value: float | str) -> str:
    """A field in bench units, to 15 digits."""
    if isinstance(value, str):
        return value
    column = NUMBERS[field]
    if column.whole:
        return str(int(value))
    return f"{column.bench.from_si(value):.15g}"  # 0.11, not 0.11000000000000001


def measurements_text(measurements: Measurements) -> str:
    """A CSV file of the contract's columns, with those that have something in them."""
    rows = [row for curve in measurements.curves for row in _rows(curve)]
    order = ["device", "specimen", "mode", *DESIGN_NAMES]
    order += ["orientation", "run", "branch", "time", "pressure", "stretch"]
    for name in QUANTITY_NAMES:
        order += [name, f"{name}_std"]
    # Without the column a reader takes loads that go back to rest for unloading.
    falls = any(
        (np.diff(np.abs(curve.load - isinstance(curve.design, Tensile))) < 0).any()
        for curve in measurements.curves
    )
    used = [
        field
        for field in order
        if any(field in row and row[field] != _USUAL.get(field) for row in rows)
        or (field == "branch" and falls)
    ]
    out = io.StringIO(newline="")
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(NUMBERS[f].name if f in NUMBERS else f for f in used)
    for row in rows:
        writer.writerow(_text(f, row[f]) if f in row else "" for f in used)
    return out.getvalue()


def write_measurements(measurements: Measurements, path: str | Path) -> None:
    """Write measurements so that reading them gives the same numbers to 1e-12.

    Raises
    ------
    FileError
        When the file cannot be written.
    """
    write_text(Path(path), measurements_text(measurements))
