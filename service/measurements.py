"""Measurement files that were sent to the server, kept in its state folder.

A file's id is the beginning of its bytes' hash: what is sent twice is kept once.
"""

from __future__ import annotations

import hashlib
import re
import shutil
import uuid
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from datagen.atomic import TEMPORARY, reason, sync
from datagen.errors import FileError, InputError, PbaError
from discrepancy.columns import NUMBERS
from discrepancy.measurement import Measurements, Tolerances
from discrepancy.reading import PROBLEM_FILES, read_measurements
from discrepancy.table import MeasurementError, short

LENGTH = 16
"""Hexadecimal digits of an id."""

ID = re.compile(rf"[0-9a-f]{{{LENGTH}}}")

LONGEST, WIDEST = 100, 200
"""Characters of a file's name, and bytes: file systems have room for 255."""

NAMELESS = "measurements.csv"
"""Of a file that was sent without a name."""


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
        if not name or own_name(name) != name:
            allowed = (
                f"1 to {LONGEST} characters that can be seen, at most {WIDEST} bytes, "
                "no / or \\, no . first"
            )
            raise InputError("name", name, allowed)
        if Path(name).suffix.lower() in PROBLEM_FILES:
            # It names other files, and those here are nobody's to read.
            allowed = "a table; PEtab problems are read by the commands, not sent"
            raise InputError("name", name, allowed)
        identity = hashlib.sha256(content).hexdigest()[:LENGTH]
        if self._is_kept(identity, content):
            return identity
        aside = self.folder / f"{uuid.uuid4().hex}{TEMPORARY}"
        try:
            aside.mkdir(parents=True)
            (aside / name).write_bytes(content)
            _check(aside / name)
            sync(aside / name)
            sync(aside)
            aside.rename(self.folder / identity)
            sync(self.folder)
        except OSError as error:
            if not self._is_kept(identity, content):  # sent twice at a time
                raise FileError(name, f"cannot be kept: {reason(error)}") from error
        finally:
            shutil.rmtree(aside, ignore_errors=True)
        return identity

    def _is_kept(self, identity: str, content: bytes) -> bool:
        """Whether a file is there and whole; one that is damaged goes."""
        there = self.folder / identity
        if not there.exists():
            return False
        if self._is_whole(there, content):
            return True
        aside = self.folder / f"{uuid.uuid4().hex}{TEMPORARY}"
        try:
            there.rename(aside)
            if self._is_whole(aside, content):  # kept anew by another meanwhile
                aside.rename(there)
                return True
        except OSError:  # removed meanwhile, or kept anew
            return self._is_whole(there, content)
        finally:
            shutil.rmtree(aside, ignore_errors=True)
        return False

    @staticmethod
    def _is_whole(folder: Path, content: bytes) -> bool:
        try:
            (file,) = folder.iterdir()
            return file.read_bytes() == content
        except (OSError, ValueError):  # none there, or not one file
            return False

    def path(self, identity: str) -> Path:
        """The file with this id.

        Raises
        ------
        MeasurementsNotFound
        """
        if ID.fullmatch(identity) and (self.folder / identity).is_dir():
            with suppress(FileNotFoundError):  # removed meanwhile
                for file in (self.folder / identity).iterdir():
                    return file
        raise _not_found(identity)

    def all(self) -> Iterator[str]:
        """Ids, the newest first."""
        if not self.folder.is_dir():
            return
        kept = [one for one in self.folder.iterdir() if ID.fullmatch(one.name)]
        for one in sorted(kept, key=_age):
            yield one.name

    def names(self) -> dict[str, str]:
        """Name of each file by its id, the newest first."""
        found = {}
        for identity in self.all():
            with suppress(MeasurementsNotFound):  # removed meanwhile
                found[identity] = self.path(identity).name
        return found

    def remove(self, identity: str) -> None:
        """Forget a file; what was worked out from it stays.

        Raises
        ------
        MeasurementsNotFound
        """
        folder = self.path(identity).parent
        gone = self.folder / f"{uuid.uuid4().hex}{TEMPORARY}"
        try:
            folder.rename(gone)
        except FileNotFoundError:  # twice at a time
            raise _not_found(identity) from None
        shutil.rmtree(gone, ignore_errors=True)

    def describe(self, identity: str) -> dict[str, Any]:
        """What is in a file, in bench units.

        Raises
        ------
        MeasurementsNotFound
        """
        path = self.path(identity)
        try:
            found = about(read_measurements(path))
        except FileError:
            if path.exists():
                raise
            raise _not_found(identity) from None  # removed meanwhile
        return {"id": identity, "name": path.name} | found


def own_name(name: str) -> str:
    """A file's name as it may be here, of what a client calls it.

    Clients may send a path, of their own system.
    """
    last = re.split(r"[\\/]", name)[-1].lstrip(".").strip()
    seen = "".join(sign if sign.isprintable() else "_" for sign in last)
    return seen[:LONGEST].encode()[:WIDEST].decode(errors="ignore").strip()


def _not_found(identity: str) -> MeasurementsNotFound:
    return MeasurementsNotFound(f"no measurements have the id {identity!r}")


def _age(folder: Path) -> float:
    try:
        return -folder.stat().st_mtime
    except FileNotFoundError:  # removed meanwhile
        return 0.0


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
