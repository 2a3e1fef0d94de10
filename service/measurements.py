"""Measurement files that were sent to the server, kept in its state folder.

A file's id is the beginning of its bytes' hash: what is sent twice is kept once.
"""

from __future__ import annotations

import hashlib
import re
import shutil
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from datagen.atomic import TEMPORARY, reason
from datagen.errors import FileError, InputError, PbaError
from discrepancy.columns import NUMBERS
from discrepancy.measurement import Measurements, Tolerances
from discrepancy.reading import PROBLEM_FILES, read_measurements
from discrepancy.table import MeasurementError, short

LENGTH = 16
"""Hexadecimal digits of an id."""

ID = re.compile(rf"[0-9a-f]{{{LENGTH}}}")

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._()+-]{0,99}")
"""Names that a file may have here."""


class MeasurementsNotFound(PbaError):
    """No file of measurements has this id."""


@dataclass(frozen=True)
class MeasurementFiles:
    """Kept files of one state folder.

    Parameters
    ----------
    folder : Path
        Made with the first file.
    """

    folder: Path

    def add(self, name: str, content: bytes) -> str:
        """Keep a file that can be read as measurements; its id.

        Raises
        ------
        InputError
            When the name is not allowed.
        MeasurementError
            When the file says something that it must not; nothing is kept then.
        FileError
            When it cannot be kept.
        """
        if not NAME.fullmatch(name):
            allowed = "letters, digits, blanks and ._()+-, at most 100"
            raise InputError("name", name, allowed)
        if Path(name).suffix.lower() in PROBLEM_FILES:
            # It names other files, and those here are nobody's to read.
            allowed = "a table; PEtab problems are read by the commands, not sent"
            raise InputError("name", name, allowed)
        identity = hashlib.sha256(content).hexdigest()[:LENGTH]
        if (self.folder / identity).is_dir():
            return identity
        aside = self.folder / f"{uuid.uuid4().hex}{TEMPORARY}"
        try:
            aside.mkdir(parents=True)
            (aside / name).write_bytes(content)
            _check(aside / name)
            aside.rename(self.folder / identity)
        except OSError as error:
            if not (self.folder / identity).is_dir():  # sent twice at a time
                raise FileError(name, f"cannot be kept: {reason(error)}") from error
        finally:
            shutil.rmtree(aside, ignore_errors=True)
        return identity

    def path(self, identity: str) -> Path:
        """The file with this id.

        Raises
        ------
        MeasurementsNotFound
        """
        if ID.fullmatch(identity) and (self.folder / identity).is_dir():
            for file in (self.folder / identity).iterdir():
                return file
        raise MeasurementsNotFound(f"no measurements have the id {identity!r}")

    def all(self) -> Iterator[str]:
        """Ids, the newest first."""
        if not self.folder.is_dir():
            return
        kept = [one for one in self.folder.iterdir() if ID.fullmatch(one.name)]
        for one in sorted(kept, key=lambda one: -one.stat().st_mtime):
            yield one.name

    def remove(self, identity: str) -> None:
        """Forget a file; what was worked out from it stays.

        Raises
        ------
        MeasurementsNotFound
        """
        folder = self.path(identity).parent
        gone = self.folder / f"{uuid.uuid4().hex}{TEMPORARY}"
        folder.rename(gone)
        shutil.rmtree(gone, ignore_errors=True)

    def describe(self, identity: str) -> dict[str, Any]:
        """What is in a file, in bench units.

        Raises
        ------
        MeasurementsNotFound
        """
        path = self.path(identity)
        return {"id": identity, "name": path.name} | about(read_measurements(path))


def _check(path: Path) -> None:
    """Refuse a file that cannot be read, in words without the server's folders.

    Raises
    ------
    MeasurementError
    """
    try:
        read_measurements(path)
    except MeasurementError as error:
        found = tuple((short(place), text) for place, text in error.problems)
        raise MeasurementError(path.name, found) from None
    except FileError as error:
        place = short(error.path) if ":" in error.path else f"{path.name}:1"
        raise MeasurementError(path.name, ((place, error.reason),)) from None


def about(measured: Measurements) -> dict[str, Any]:
    """Devices, curves and quantities of measurements."""
    curves = []
    for curve in measured.curves:
        curves.append(
            {
                "device": curve.device,
                "run": curve.run,
                "specimen": curve.specimen,
                "orientation_deg": float(np.degrees(curve.orientation)),
                "steps": len(curve.load),
                "readings": curve.readings,
                "quantities": [NUMBERS[name].bench.name for name in curve.outputs],
                "timed": curve.time is not None,
                "branches": sorted(set(map(str, curve.branch))),
            }
        )
    return {
        "sha256": measured.sha256,
        "devices": list(measured.devices),
        "readings": measured.readings,
        "curves": curves,
        "warnings": list(measured.warnings),
    }


def tolerances(
    modulus_pct: float, thickness_um: float, camera_pct: float
) -> Tolerances:
    """Tolerances from bench units."""
    return Tolerances(modulus_pct / 100, thickness_um * 1e-6, camera_pct / 100)
