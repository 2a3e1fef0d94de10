"""A sealed set on disk: what is handed out, and the truth that stays behind.

Three files in one folder.  ``measurements.csv`` is all that a bench would hand out;
``truth.json`` says what was hidden; ``manifest.json`` has the SHA-256 of both.  Whoever
holds measurements and manifest can tell later that the truth is the one sealed then.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from datagen.atomic import reason, replacing
from datagen.errors import FileError, InputError

MEASUREMENTS, TRUTH, MANIFEST = "measurements.csv", "truth.json", "manifest.json"

SCHEMA = 1
"""Of the truth and the manifest."""

NONE, NAMED, UNNAMED = "none", "named", "unnamed"
"""What was planted: nothing, effects of the catalogue, or one that it lacks."""


@dataclass(frozen=True)
class Planted:
    """An effect that acts on every device of a set.

    Parameters
    ----------
    effect : str
    parameters : dict of str to float, SI
    units : dict of str to str
    moved : float
        Largest change of a reading that this effect alone makes, over the noise.
    """

    effect: str
    parameters: dict[str, float]
    units: dict[str, str]
    moved: float


@dataclass(frozen=True)
class Truth:
    """What is hidden in a set of measurements.

    Parameters
    ----------
    seed : int
    asked : dict
        The options of the plan that the set was made by.
    kind : str
        `NONE`, `NAMED` or `UNNAMED`.
    planted : tuple of Planted
        Empty where nothing is missing.
    batches : dict of str to float
        True over stated modulus of each batch, by the batch's letter.
    devices : dict of str to dict
        True design of each device, SI; what it was stated to be is in the measurements.
    camera : dict of str to float
        True scale of each run, by ``device run``.
    noise : dict of str to float, SI
        Standard deviation of each quantity.
    smooth : float
        Size of the smooth errors, share of a curve's maximum.
    level : str
        Mesh level whose other grading the truth was solved on.
    pressure : tuple of float, Pa
        Load steps on the way up.

    Raises
    ------
    InputError
        When the kind and what is planted do not fit.
    """

    seed: int
    asked: dict[str, Any]
    kind: str
    planted: tuple[Planted, ...]
    batches: dict[str, float]
    devices: dict[str, dict[str, float]]
    camera: dict[str, float]
    noise: dict[str, float]
    smooth: float
    level: str
    pressure: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.kind not in (NONE, NAMED, UNNAMED):
            raise InputError("kind", self.kind, ", ".join((NONE, NAMED, UNNAMED)))
        if bool(self.planted) != (self.kind != NONE):
            planted = [one.effect for one in self.planted]
            raise InputError("planted", planted, f"what {self.kind} says")

    @property
    def effects(self) -> frozenset[str]:
        """Names of what was planted."""
        return frozenset(one.effect for one in self.planted)

    def text(self) -> str:
        """As the file holds it."""
        content = {"schema": SCHEMA, **asdict(self)}
        return json.dumps(content, indent=1, sort_keys=True) + "\n"

    @classmethod
    def from_text(cls, text: str) -> Truth:
        """Back from a file.

        Raises
        ------
        ValueError
            When it is no truth of this schema.
        """
        content = json.loads(text)
        if not isinstance(content, dict) or content.pop("schema", None) != SCHEMA:
            raise ValueError(f"not a truth of schema {SCHEMA}")
        names = {field.name for field in fields(cls)}
        if set(content) != names:
            raise ValueError(f"fields differ: {sorted(set(content) ^ names)}")
        content["planted"] = tuple(Planted(**one) for one in content["planted"])
        content["pressure"] = tuple(content["pressure"])
        return cls(**content)


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def check_free(folder: Path) -> None:
    """Refuse a folder in which a set would replace what it is not.

    What a set that was being written has left is written anew.

    Raises
    ------
    FileError
        When there is a set already, a file of another's, or no place for a folder.
    """
    if (folder / MANIFEST).exists():
        raise FileError(folder, "holds a sealed set already; choose another folder")
    if (folder / MEASUREMENTS).exists() and not (folder / TRUTH).exists():
        words = "is there already, and of no sealed set; choose another folder"
        raise FileError(folder / MEASUREMENTS, words)
    there = folder
    while not there.exists() and there != there.parent:
        there = there.parent
    if not there.is_dir() or not os.access(there, os.W_OK):
        raise FileError(folder, f"cannot be made: {there} is no folder to write to")


def seal(folder: Path, measurements: str, truth: Truth) -> dict[str, str]:
    """Write the three files of a set.

    Parameters
    ----------
    folder : Path
        Made where it is not there.
    measurements : str
        Text of the CSV file.
    truth : Truth

    Returns
    -------
    dict of str to str
        SHA-256 of each file, as in the manifest.

    Raises
    ------
    FileError
        When there is a set already, or the files cannot be written.
    """
    check_free(folder)
    # The truth first: measurements without it are somebody else's, see `check_free`.
    contents = {TRUTH: truth.text().encode(), MEASUREMENTS: measurements.encode()}
    sums = {name: _sha256(data) for name, data in contents.items()}
    manifest = json.dumps({"schema": SCHEMA, "sha256": sums}, indent=1) + "\n"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(folder, f"cannot be made: {reason(error)}") from error
    for name, data in (*contents.items(), (MANIFEST, manifest.encode())):
        with replacing(folder / name) as temporary:
            temporary.write_bytes(data)
    return sums


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise FileError(path, f"cannot be read: {reason(error)}") from error


def unseal(folder: Path) -> Truth:
    """The truth of a set, when it and the measurements are those that were sealed.

    Raises
    ------
    FileError
        When a file is missing, damaged, or not the one that the manifest names.
    """
    path = folder / MANIFEST
    try:
        content = json.loads(_read(path))
        schema, sums = content["schema"], content["sha256"]
        wanted = {name: str(sums[name]) for name in (MEASUREMENTS, TRUTH)}
    except (ValueError, KeyError, TypeError) as error:
        raise FileError(path, "not the manifest of a sealed set") from error
    if schema != SCHEMA:
        raise FileError(path, f"schema {schema!r} is not allowed; allowed: {SCHEMA}")
    for name, sha256 in wanted.items():
        found = _sha256(_read(folder / name))
        if found != sha256:
            raise FileError(
                folder / name,
                f"was changed after it was sealed: SHA-256 {found[:12]}..., in the "
                f"manifest {sha256[:12]}...",
            )
    try:
        return Truth.from_text(_read(folder / TRUTH).decode())
    except (ValueError, KeyError, TypeError, AttributeError, InputError) as error:
        raise FileError(folder / TRUTH, f"not a sealed truth: {error}") from error
