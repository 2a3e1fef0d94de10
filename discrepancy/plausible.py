"""What readings can be, given the device: slips that no column's range shows."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from datagen.device import Design
from datagen.materials import Hyperelastic
from datagen.specimens import Tensile, tensile_stress

from .columns import NUMBERS, UNITS
from .measurement import Curve

Array = np.ndarray

SMALLEST_TOP = {"pressure": 500.0, "inflation": 1e-6}
"""Pa and m.  A file whose largest value is smaller was hardly written in our unit."""

STRESS_FACTOR = 100.0
"""Between a stress and what the stated modulus makes expect, either way.  Far more than
rubbers stiffen over the greater part of a test, far less than kPa for MPa."""

STRAINED = 0.02
"""Strain from which on a stress tells something of its unit."""

SMALL_ANGLE = 8.0
"""Deflection over length times angle.  A strip that bends one way has at most 1; bent
two ways it may have more; radians that are taken for degrees bring a factor of 57."""


def stress_slip(design: Tensile, stretch: Array, stress: Array) -> tuple[int, str]:
    """A test's stress against the neo-Hookean one of the stated modulus.

    Parameters
    ----------
    design : Tensile
    stretch, stress : (s,) arrays, Pa
        NaN where there is no stress.

    Returns
    -------
    int, str
        A reading that shows it and the words; no words where all is well.
    """
    law = Hyperelastic()
    expected = tensile_stress(law, design.modulus / 3, stretch, design.mode)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.abs(stress / expected)
    told = (np.abs(stretch - 1) >= STRAINED) & np.isfinite(ratio) & (ratio > 0)
    if not told.any():
        return 0, ""
    middle = float(np.median(ratio[told]))
    if 1 / STRESS_FACTOR <= middle <= STRESS_FACTOR:
        return 0, ""
    at = int(np.flatnonzero(told)[-1])
    column = NUMBERS["stress"]
    shown = stress[at] / column.bench.factor
    text = (
        f"{column.name}: {shown:.6g} {column.unit} at stretch {stretch[at]:.6g} is not "
        f"allowed; allowed: within a factor of {STRESS_FACTOR:g} of the "
        f"{expected[at] / column.bench.factor:.4g} {column.unit} that the stated "
        f"modulus of {design.modulus / 1e6:g} MPa makes expect"
    )
    away = {
        unit: abs(math.log(middle * factor / column.bench.factor))
        for unit, factor in UNITS[column.kind].items()
    }
    unit = min(away, key=away.__getitem__)
    likely = unit != column.unit and away[unit] < math.log(10)
    return at, text + (f"; probably meant in {unit}" if likely else "")


def odd_curves(curves: Sequence[Curve], name: str) -> list[str]:
    """What is possible but odd about whole curves of the file `name`, in words."""
    return [*_small_tops(curves, name), *_small_angles(curves, name)]


def _small_tops(curves: Sequence[Curve], name: str) -> list[str]:
    """Columns whose largest value is so small that another unit may have been meant."""
    odd = []
    for field, least in SMALLEST_TOP.items():
        sizes = [
            np.abs(curve.load if field == "pressure" else curve.output(field))
            for curve in curves
            if curve.specimen != "tensile"
            and (field == "pressure" or field in curve.outputs)
        ]
        top = max((float(np.nanmax(size)) for size in sizes), default=0.0)
        if 0 < top < least:
            column = NUMBERS[field]
            text = f"{column.name}: {top / column.bench.factor:.10g} {column.unit}"
            odd.append(f"{name}: the largest {text} in the file: is the unit right?")
    return odd


def _small_angles(curves: Sequence[Curve], name: str) -> list[str]:
    """Devices whose tips move far for how little they are said to have turned."""
    odd = []
    for curve in curves:
        both = {"tip_deflection", "bending_angle"} <= set(curve.outputs)
        if not both or not isinstance(curve.design, Design):
            continue
        tip, angle = curve.output("tip_deflection"), curve.output("bending_angle")
        moved = (np.abs(tip) > 0.01 * curve.design.length) & (angle != 0)
        ratio = np.abs(tip[moved] / (curve.design.length * angle[moved]))
        if np.isfinite(ratio).any() and np.nanmedian(ratio) > SMALL_ANGLE:
            odd.append(
                f"{name}: device {curve.device!r}, run {curve.run}: bending_angle_deg "
                "is small for such deflections of the tip: are the angles in degrees?"
            )
    return odd
