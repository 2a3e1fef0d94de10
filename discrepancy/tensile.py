"""Published tensile tests of rubbers, in the formats that they are shared in."""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from datagen.errors import FileError, InputError
from datagen.materials import Hyperelastic
from datagen.specimens import MODES, Tensile, tensile_stress

from .measurement import LOADING, Curve, Measurements, Tolerances
from .table import MeasurementError, decode, read_bytes

Array = np.ndarray

SMALL_STRAIN = 0.3
"""Largest strain, either way, at which a modulus is read off."""

UNSTATED = 0.3
"""Tolerance of a modulus that was read off: laws that stiffen or soften early miss the
true one by this much."""


def initial_modulus(stretch: Array, stress: Array, mode: str = "uniaxial") -> float:
    """Young's modulus of the neo-Hookean law nearest to a test's first part, Pa.

    E = 3 mu by least squares on nominal stress up to `SMALL_STRAIN`.

    Raises
    ------
    InputError
        When no reading is that close to stretch 1, or stress falls with stretch.
    """
    small = np.abs(stretch - 1) <= SMALL_STRAIN
    unit = tensile_stress(Hyperelastic(), 1.0, stretch[small], mode)
    if not unit.any() or not unit @ stress[small] > 0:
        allowed = f"readings of tension within {SMALL_STRAIN:g} of stretch 1"
        raise InputError("stretch", float(np.min(stretch)), allowed)
    return float(3 * (unit @ stress[small]) / (unit @ unit))


def _measurements(
    tests: Mapping[str, tuple[str, Array, Array, Array | None]],
    modulus: float | None,
    source: str,
    data: bytes,
) -> Measurements:
    """Measurements of tests by name: mode, stretch, stress (Pa), time (s)."""
    warnings: tuple[str, ...] = ()
    tolerances = Tolerances()
    if modulus is None:
        tolerances = Tolerances(modulus=UNSTATED)
        mode, stretch, stress, _ = next(iter(tests.values()))
        modulus = initial_modulus(stretch, stress, mode)
        warnings = (
            f"{source}: no modulus is stated; {modulus / 1e6:.4g} MPa is taken, from "
            f"the first {SMALL_STRAIN:.0%} of strain in the {mode} test, with a "
            f"tolerance of {UNSTATED:.0%}",
        )
    curves = tuple(
        Curve(
            device=name,
            run=1,
            orientation=0.0,
            design=Tensile(modulus, mode),
            load=stretch,
            time=time,
            branch=np.full(len(stretch), LOADING),
            outputs=("stress",),
            values=stress[:, None],
            std=np.full((len(stretch), 1), np.nan),
        )
        for name, (mode, stretch, stress, time) in tests.items()
    )
    digest = hashlib.sha256(data).hexdigest()
    return Measurements(curves, source, digest, warnings, tolerances)


def _numbers(path: Path, line: int, texts: list[str], wanted: int) -> list[float]:
    """Exactly so many numbers from a line."""
    try:
        numbers = [float(text) for text in texts]
    except ValueError:
        numbers = []
    if len(numbers) != wanted or not np.isfinite(numbers).all():
        problem = f"{' '.join(texts)!r} is not allowed; allowed: {wanted} numbers"
        raise MeasurementError(path, ((f"{path}:{line}", problem),))
    return numbers


SRMD_COLUMNS = [
    "Time (s)",
    "True Strain",
    "True Stress (MPa)",
    "Engineering Strain",
    "Engineering Stress (MPa)",
]


def read_srmd(path: str | Path, modulus: float | None = None) -> Measurements:
    """One uniaxial test of the Soft Robotics Materials Database.

    Lines of ``;``-separated remarks, then `SRMD_COLUMNS`.  Stretch is 1 + engineering
    strain, which is that of the crosshead and has the grips' slip in it.
    Source: Marechal et al. 2021, Soft Robotics 8, 284.

    Parameters
    ----------
    path : path
    modulus : float, Pa, optional
        As stated for the batch; `initial_modulus` where it is not given.

    Raises
    ------
    FileError
        When the file is not of this kind.
    MeasurementError
        When a line does not hold five numbers.
    """
    path = Path(path)
    data = read_bytes(path)
    text, _ = decode(path, data)
    lines = list(csv.reader(io.StringIO(text, newline=""), delimiter=";"))
    if SRMD_COLUMNS not in lines:
        wanted = ";".join(SRMD_COLUMNS)
        raise FileError(path, f"not a test of the database; allowed: a line {wanted}")
    top = lines.index(SRMD_COLUMNS) + 1
    rows = np.array(
        [
            _numbers(path, number, fields, 5)
            for number, fields in enumerate(lines[top:], top + 1)
            if any(fields)
        ]
    )
    if not len(rows):
        raise FileError(path, "holds no readings")
    tests = {path.stem: ("uniaxial", 1 + rows[:, 3], 1e6 * rows[:, 4], rows[:, 0])}
    return _measurements(tests, modulus, path.name, data)


def read_multiaxial(
    paths: Mapping[str, str | Path], modulus: float | None = None, name: str = "rubber"
) -> Measurements:
    """Tests of one rubber in several modes: lines of nominal stress (MPa) and stretch.

    Parameters
    ----------
    paths : mapping of mode to path
        Modes of `datagen.specimens.MODES`.
    modulus : float, Pa, optional
        As stated for the batch; `initial_modulus` of the first where not given.
    name : str
        Of the rubber; the specimens are called after it and the mode.

    Raises
    ------
    InputError
        When there is no file or a mode is unknown.
    FileError, MeasurementError
        When a file cannot be read.
    """
    if not paths:
        raise InputError("paths", 0, "at least one file")
    tests: dict[str, tuple[str, Array, Array, Array | None]] = {}
    content = b""
    for mode, one in paths.items():
        if mode not in MODES:
            raise InputError("mode", mode, ", ".join(MODES))
        path = Path(one)
        data = read_bytes(path)
        content += data
        rows = np.array(
            [
                _numbers(path, number, line.split(), 2)
                for number, line in enumerate(decode(path, data)[0].splitlines(), 1)
                if line.strip()
            ]
        )
        if not len(rows):
            raise FileError(path, "holds no readings")
        tests[f"{name} {mode}"] = (mode, rows[:, 1], 1e6 * rows[:, 0], None)
    source = ", ".join(Path(one).name for one in paths.values())
    return _measurements(tests, modulus, source, content)
