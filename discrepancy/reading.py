"""Measurement files into curves: every reading is checked before anything uses it.

What cannot be true is an error that names file, line, field, value, unit, what is
allowed and, where another unit would do, what was probably meant.  What is odd but
possible is a warning.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from datagen.device import Design
from datagen.errors import InputError
from datagen.specimens import Bulge, Tensile

from .columns import DESIGN_NAMES, NUMBERS, refusal
from .measurement import (
    JITTER,
    LOADING,
    MEASURED,
    UNLOADING,
    Curve,
    Measurements,
    Tolerances,
)
from .petab import petab_table
from .plausible import odd_curves, stress_slip
from .rows import Reading, check_columns, needed, read_row
from .table import (
    Complaints,
    MeasurementError,
    Row,
    Table,
    read_bytes,
    read_table,
    short,
)

LARGEST_RISE = 3.0
"""Largest inflation over the shorter side of a balloon or hole.  At its limit pressure
a balloon is about a hemisphere, 0.5; beyond it soft balloons reach some 2."""

LARGEST_STD = 3.0
"""Largest standard deviation over the largest reading of a file: a quantity that is
less certain than that was not measured, or is in another unit."""

STILL = 0.01
"""Of a strip's length: noise of its tip that is never too large."""

LEAST_DIP = 20e-6
"""m.  A roof lower than at rest by more than this, and by three standard deviations,
is reported: noise of a camera is smaller."""

CLOCK = 1e8
"""s.  Three years: a time of that size is a date, and not a test's."""

LATE = 20.0
"""Steps of a test before its first reading from which on that is told."""

PROBLEM_FILES = (".yaml", ".yml")
"""Endings of PEtab's problem files, which name the tables."""


def read_measurements(
    path: str | Path, tolerances: Tolerances | None = None
) -> Measurements:
    """Read a CSV file of the contract's columns, or a folder of PEtab tables.

    Parameters
    ----------
    path : path
        A text file; a folder or a problem file (``.yaml``) is read as PEtab, see
        `petab.petab_table`.
    tolerances : Tolerances, optional
        Of the stated values; the contract's where not given.

    Returns
    -------
    Measurements

    Raises
    ------
    FileError
        When the file cannot be read.
    MeasurementError
        When something in it is not allowed; names the first problem and the lines of
        the others.
    """
    path = Path(path)
    if path.is_dir() or path.suffix.lower() in PROBLEM_FILES:
        table, data = petab_table(path)
    else:
        data = read_bytes(path)
        table = read_table(path, data)
    return _measurements(table, hashlib.sha256(data).hexdigest(), tolerances)


def read_petab(path: str | Path, tolerances: Tolerances | None = None) -> Measurements:
    """Read PEtab tables: a folder of them or a problem file, see `petab.petab_table`.

    Raises
    ------
    FileError
        When a table cannot be read.
    MeasurementError
        When something in one is not allowed.
    """
    table, data = petab_table(Path(path))
    return _measurements(table, hashlib.sha256(data).hexdigest(), tolerances)


@dataclass
class _Device:
    """A device as its first row states it."""

    row: Row
    specimen: str
    stated: dict[str, float | str]
    design: Design | Bulge | Tensile | None = None
    curves: dict[tuple[int, float], list[Reading]] = field(default_factory=dict)

    @property
    def readings(self) -> list[Reading]:
        """Those of all its curves."""
        return [one for rows in self.curves.values() for one in rows]


def _measurements(
    table: Table, sha256: str, tolerances: Tolerances | None
) -> Measurements:
    """Curves of a table."""
    warnings = list(table.warnings)
    complaints = Complaints(table.path)
    check_columns(table, complaints)
    complaints.settle()
    readings = []
    unread: dict[str, list[str]] = {}
    for row in table.rows:
        before = len(complaints.problems)
        reading = read_row(row, table, complaints, unread)
        if len(complaints.problems) == before:
            readings.append(reading)
    for word, places in unread.items():
        warnings.append(
            f"{short(places[0])}: {word!r} is taken for a missing reading"
            + (f", and {len(places) - 1} times more" if len(places) > 1 else "")
        )
    devices = _devices(readings, complaints, warnings)
    complaints.settle()
    for name, device in devices.items():
        _start_clock(name, device, warnings)
    curves = []
    largest = _largest(devices.values())
    for name, device in devices.items():
        _check_values(device, table, complaints, warnings)
        _check_stds(device, largest, table, complaints)
        measured = [
            curve
            for key, rows in device.curves.items()
            if (curve := _curve(name, key, device, rows, complaints, warnings))
        ]
        if not measured and not complaints.problems:
            quantities = ", ".join(NUMBERS[q].name for q in MEASURED[device.specimen])
            complaints.add(
                device.row.place,
                f"device: {name!r} has no measured value in any row; allowed: at least "
                f"one of {quantities}",
            )
        curves += measured
    complaints.settle()
    warnings += odd_curves(curves, table.path.name)
    return Measurements(
        tuple(curves),
        table.path.name,
        sha256,
        tuple(warnings),
        tolerances or Tolerances(),
    )


# -- devices ---------------------------------------------------------------------------


def _stated(reading: Reading) -> dict[str, float | str]:
    """What a row says about the device itself."""
    names = {
        "actuator": DESIGN_NAMES,
        "bulge": tuple(name for group in needed("bulge")[:-1] for name in group),
        "tensile": ("upper_modulus", "lower_modulus"),
    }[reading.specimen]
    stated: dict[str, float | str] = {
        name: reading.numbers[name] for name in names if name in reading.numbers
    }
    if reading.specimen == "tensile":
        stated["mode"] = reading.mode
    return stated


def _design(specimen: str, stated: dict[str, float | str]) -> Design | Bulge | Tensile:
    """The design of a device; an `InputError` where it cannot be."""
    if specimen == "actuator":
        return Design(**stated)  # type: ignore[arg-type]
    side = _layer(stated)
    modulus = float(stated[f"{side}_modulus"])
    if specimen == "tensile":
        return Tensile(modulus, str(stated["mode"]), side)
    if f"{side}_thickness" not in stated:
        raise InputError(
            f"{side}_modulus_MPa",
            modulus / 1e6,
            "thickness and modulus of one and the same layer",
            "MPa",
        )
    return Bulge(
        float(stated["balloon_length"]),
        float(stated["balloon_width"]),
        float(stated[f"{side}_thickness"]),
        modulus,
        side,
    )


def _layer(stated: Mapping[str, object]) -> str:
    """The layer that a specimen is of: the upper one where both are stated."""
    whole = [
        side
        for side in ("upper", "lower")
        if f"{side}_modulus" in stated
        and (f"{side}_thickness" in stated or "balloon_length" not in stated)
    ]
    return whole[0] if whole else "upper" if "upper_modulus" in stated else "lower"


def _devices(
    readings: list[Reading], complaints: Complaints, warnings: list[str]
) -> dict[str, _Device]:
    """Devices in order of appearance, each with its readings by run and orientation."""
    devices: dict[str, _Device] = {}
    for reading in readings:
        stated, row = _stated(reading), reading.row
        device = devices.get(reading.device)
        if device is None:
            device = _Device(row, reading.specimen, stated)
            devices[reading.device] = device
            try:
                device.design = _design(reading.specimen, stated)
            except InputError as error:
                complaints.add(row.place, str(error))
            both = stated.get("lower_modulus"), stated.get("upper_modulus")
            if reading.specimen != "actuator" and None not in both:
                warnings.append(
                    f"{short(row.place)}: specimen {reading.device!r} states both "
                    f"layers; it is taken for one of the {_layer(stated)} layer"
                )
        elif reading.specimen != device.specimen:
            complaints.add(
                row.where("specimen"),
                f"specimen: {reading.specimen!r} is not allowed; allowed: "
                f"{device.specimen}, as in {device.row.line} of the same device "
                f"{reading.device!r}",
            )
            continue
        elif stated != device.stated:
            name = next(
                n
                for n in {**stated, **device.stated}
                if stated.get(n) != device.stated.get(n)
            )
            complaints.add(
                row.where(name),
                f"{_shown(name, stated.get(name))} is not allowed; allowed: "
                f"{_shown(name, device.stated.get(name))} as in {device.row.line} of "
                f"the same device {reading.device!r}",
            )
            continue
        key = (int(reading.get("run", 1)), reading.get("orientation", 0.0))
        device.curves.setdefault(key, []).append(reading)
    return devices


def _start_clock(name: str, device: _Device, warnings: list[str]) -> None:
    """Let time count from the beginning of a device's test, where a clock's is given.

    A device is at rest at time 0, and its first load step begins there.
    """
    runs = [[r for r in rows if "time" in r.numbers] for rows in device.curves.values()]
    if not any(runs):
        return
    first = min((run for run in runs if run), key=lambda run: run[0].get("time"))
    begun = first[0].get("time")
    steps = np.diff([reading.get("time") for reading in first])
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    place = f"{short(first[0].row.place)}: device {name!r}, "
    if abs(begun) >= CLOCK:
        for reading in (reading for run in runs for reading in run):
            reading.numbers["time"] -= begun - step
        warnings.append(
            f"{place}time_s: {begun:.10g} s is a clock's; time is counted from "
            f"{step:.4g} s, one step, before the first reading"
        )
    elif begun > LATE * step and len(first) > 1:
        warnings.append(
            f"{place}time_s: the first reading is at {begun:.6g} s, the others are "
            f"{step:.4g} s apart; time counts from when the load was first applied"
        )


def _shown(name: str, value: float | str | None) -> str:
    if name not in NUMBERS:
        return f"{name}: {value!r}"
    column = NUMBERS[name]
    if value is None:
        return f"{column.name}: nothing"
    shown = float(value) / column.bench.factor
    return f"{column.name}: {shown:.10g} {column.unit}".rstrip()


def _limits(design: Design | Bulge | Tensile) -> dict[str, tuple[float, float, str]]:
    """What a design allows of each quantity, SI, and why in words."""
    if isinstance(design, Tensile):
        return {}
    if isinstance(design, Bulge):
        side = min(design.length, design.width)
        rise, why = LARGEST_RISE * side, "times the shorter side of the hole"
    else:
        rise = LARGEST_RISE * min(design.balloon_size)
        why = "times the shorter side of a balloon"
    why = f"{LARGEST_RISE:g} {why}"
    limits = {name: (-rise, rise, why) for name in ("inflation", "inflation_lower")}
    if isinstance(design, Design):
        most = 2 * rise * design.balloon_length * design.balloon_width
        limits["cavity_volume"] = (
            -most,
            most,
            f"roofs and floors {LARGEST_RISE:g} times as high as a balloon is wide",
        )
        reach = design.length
        limits["tip_deflection"] = (-reach, reach, "the length of the strip")
    return limits


def _check_values(
    device: _Device, table: Table, complaints: Complaints, warnings: list[str]
) -> None:
    """Readings against what the design allows."""
    if device.design is None:
        return
    limits = _limits(device.design)
    if isinstance(device.design, Tensile):
        _check_stress(device.design, device.curves.values(), complaints)
    for reading in device.readings:
        row = reading.row
        for quantity, (lower, upper, why) in limits.items():
            if quantity in reading.numbers:
                value, hint = reading.get(quantity), table.in_bench_unit(quantity)
                wrong = refusal(quantity, value, lower, upper, why, hint=hint)
                if wrong:
                    complaints.add(row.where(quantity), wrong)
        rise, std = reading.get("inflation", 0.0), reading.get("inflation_std", 0.0)
        if rise < -max(LEAST_DIP, 3 * std) and reading.load > 0:
            warnings.append(
                f"{short(row.where('inflation'))}: {_shown('inflation', rise)} at "
                f"{reading.load / 1e3:.6g} kPa; under pressure a roof rises"
            )


def _largest(devices: Iterable[_Device]) -> dict[tuple[str, str], float]:
    """Largest amount of each specimen's quantities in the file, SI."""
    found: dict[tuple[str, str], float] = {}
    for device in devices:
        for reading in device.readings:
            for quantity in MEASURED[device.specimen]:
                key = device.specimen, quantity
                amount = abs(reading.get(quantity, 0.0))
                found[key] = max(found.get(key, 0.0), amount)
    return found


def _check_stds(
    device: _Device,
    largest: dict[tuple[str, str], float],
    table: Table,
    complaints: Complaints,
) -> None:
    """Stated noise against the largest reading of its quantity in the file.

    A tip may hardly move, as two bendings cancel: of a strip's length noise may always
    be `STILL`.
    """
    design = device.design
    if design is None:
        return
    for quantity in MEASURED[device.specimen]:
        top = LARGEST_STD * largest.get((device.specimen, quantity), 0.0)
        field = f"{quantity}_std"
        why = f"{LARGEST_STD:g} times the largest {NUMBERS[quantity].name} of the file"
        still = STILL * design.length if isinstance(design, Design) else 0.0
        if quantity == "tip_deflection" and 0 < top < still:
            top, why = still, f"{STILL:.0%} of the strip's length"
        for reading in device.readings:
            if top > 0 and field in reading.numbers:
                std = reading.get(field)
                hint = table.in_bench_unit(field)
                wrong = refusal(field, std, 0.0, top, why, hint=hint)
                if wrong:
                    complaints.add(reading.row.where(field), wrong)


def _check_stress(
    design: Tensile, curves: Iterable[list[Reading]], complaints: Complaints
) -> None:
    """Stresses against the stated modulus."""
    for rows in curves:
        stretch = np.array([reading.load for reading in rows])
        stress = np.array([reading.get("stress") for reading in rows])
        at, wrong = stress_slip(design, stretch, stress)
        if wrong:
            complaints.add(rows[at].row.where("stress"), wrong)


# -- curves ----------------------------------------------------------------------------


def _curve(
    name: str,
    key: tuple[int, float],
    device: _Device,
    rows: list[Reading],
    complaints: Complaints,
    warnings: list[str],
) -> Curve | None:
    """One curve; None where it has no value, or a problem that was complained about."""
    before = len(complaints.problems)
    turned = _find_unloading(rows)
    for check in (_check_order, _check_times, _check_repeats):
        check(name, key[0], rows, complaints)
    outputs = tuple(
        quantity
        for quantity in MEASURED[device.specimen]
        if any(quantity in reading.numbers for reading in rows)
    )
    if device.design is None or len(complaints.problems) > before:
        return None
    prefix = f"{short(rows[0].row.place)}: device {name!r}, "
    if not outputs:
        warnings.append(
            f"{prefix}run {key[0]} has no measured value and is left out: effects that "
            "remember do not know of its loads. One reading, as at rest, keeps them"
        )
        return None
    if turned is not None:
        warnings.append(
            f"{prefix}run {key[0]}: no branch is given; from {turned.row.line} on, "
            "on the way back, it is taken for unloading"
        )
    warnings += [prefix + text for text in _odd_steps(key[0], rows)]
    timed = "time" in rows[0].numbers
    return Curve(
        device=name,
        run=key[0],
        orientation=key[1],
        design=device.design,
        load=np.array([reading.load for reading in rows]),
        time=np.array([reading.get("time") for reading in rows]) if timed else None,
        branch=np.array([reading.branch for reading in rows]),
        outputs=outputs,
        values=np.array([[one.get(q) for q in outputs] for one in rows]),
        std=np.array([[one.get(f"{q}_std") for q in outputs] for one in rows]),
    )


def _sizes(rows: list[Reading]) -> np.ndarray:
    """(s,) distance of the loads from rest: into vacuum, loading lowers a pressure."""
    rest = 1.0 if rows[0].specimen == "tensile" else 0.0
    return np.abs(np.array([reading.load for reading in rows]) - rest)


def _find_unloading(rows: list[Reading]) -> Reading | None:
    """Let rows without a branch, whose loads rise and then fall, be both.

    Where rows have times, loads may be held on the way and at the top; without them
    the highest may stand twice: the last of the way up and the first of the way back.

    Returns
    -------
    Reading or None
        The first of the unloading rows, where there are any.
    """
    size = _sizes(rows)
    top = np.flatnonzero(size == size.max())
    first, last = int(top[0]), int(top[-1])
    if any("branch" in reading.row.texts for reading in rows):
        return None
    loads = [reading.load for reading in rows]
    jitter = JITTER * float(size.max())
    if min(loads) < -jitter and max(loads) > jitter:
        return None  # into vacuum is another loading, not the way back
    # One row that goes back may as well be one too many.
    if not 0 < first <= last < len(rows) - 2 or last - first >= len(top):
        return None
    timed = "time" in rows[0].numbers
    on = np.concatenate([np.diff(size[: first + 1]), -np.diff(size[last:])])
    if (on < -jitter).any() or (not timed and ((on == 0).any() or len(top) > 2)):
        return None
    while timed and last < len(rows) - 1 and size[last + 1] >= size.max() - jitter:
        last += 1
    back = last + 1 if timed else first + 1
    for reading in rows[back:]:
        reading.branch = UNLOADING
    return rows[back]


def _check_order(
    name: str, run: int, rows: list[Reading], complaints: Complaints
) -> None:
    """Loading first, then unloading."""
    down = None
    for reading in rows:
        if reading.branch == UNLOADING:
            down = down or reading
        elif down is not None:
            complaints.add(
                reading.row.where("branch"),
                f"branch: 'loading' is not allowed after 'unloading' in "
                f"{down.row.line} of device {name!r}, run {run}; allowed: loading, "
                "then unloading, and another run for the next cycle",
            )
            return


def _check_times(
    name: str, run: int, rows: list[Reading], complaints: Complaints
) -> None:
    """A time in every row or in none, and increasing."""
    timed = ["time" in reading.numbers for reading in rows]
    if not any(timed):
        return
    if not all(timed):
        complaints.add(
            rows[timed.index(False)].row.place,
            f"time_s: nothing is not allowed; allowed: a time in every row of device "
            f"{name!r}, run {run}, as in {rows[timed.index(True)].row.line}, or in "
            "none",
        )
        return
    for last, reading in pairwise(rows):
        if not reading.get("time") > last.get("time"):
            complaints.add(
                reading.row.where("time"),
                f"time_s: {reading.get('time'):.10g} s is not allowed; allowed: more "
                f"than the {last.get('time'):.10g} s of {last.row.line}, the load step "
                f"before of device {name!r}, run {run}",
            )
            return


def _check_repeats(
    name: str, run: int, rows: list[Reading], complaints: Complaints
) -> None:
    """One row a load step, unless time passes between two."""
    seen: dict[tuple[str, float, float], Reading] = {}
    for reading in rows:
        key = (reading.branch, reading.load, reading.get("time", -1.0))
        first = seen.setdefault(key, reading)
        if first is not reading:
            kind = "stretch" if reading.specimen == "tensile" else "pressure"
            complaints.add(
                reading.row.place,
                f"{_shown(kind, reading.load)}, {reading.branch}, of device {name!r}, "
                f"run {run} is there already in {first.row.line}; allowed: one row a "
                "load step; number repeated tests in the column 'run', and give the "
                "way back the branch 'unloading'",
            )


def _odd_steps(run: int, rows: list[Reading]) -> list[str]:
    """What is odd about the order of the load steps."""
    odd = []
    if rows[0].branch == UNLOADING:
        odd.append(f"run {run} has no loading branch: the highest load is not known")
    for branch, way in ((LOADING, "falls"), (UNLOADING, "rises")):
        steps = [reading for reading in rows if reading.branch == branch]
        size = _sizes(steps) if steps else np.zeros(0)
        for reading, last, here in zip(steps[1:], size, size[1:], strict=False):
            if (here < last) if branch == LOADING else (here > last):
                odd.append(
                    f"run {run}: the load {way} in {reading.row.line} of the "
                    f"{branch} branch; rows are taken as the order applied"
                )
                break
    return odd


__all__ = ["MeasurementError", "read_measurements", "read_petab"]
