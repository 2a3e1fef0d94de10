"""Finished paths on disk while a dataset is being generated.

``OUT.parts`` holds a manifest (what is being generated), one file for each finished
path, and a lock.  Every file is written under another name, flushed and renamed, so a
kill at any moment leaves whole files only.  Each path carries a checksum and the
fingerprint of its manifest: what does not fit is computed again.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from .atomic import TEMPORARY, reason, replacing, sync, write_text
from .dataset import Dataset, space_to_json
from .errors import FileError, InputError
from .worker import Row, Task

MANIFEST, LOCK, DATASET = "manifest.json", "lock", "dataset.h5"


def parts_folder(out: Path) -> Path:
    """Where the finished paths of `out` wait: beside it."""
    return out.with_name(f"{out.name}.parts")


def row_file(row: int) -> str:
    """Name of the file of one finished path."""
    return f"row-{row:08d}.json"


@dataclass(frozen=True)
class Manifest:
    """What is being generated; a run is resumed only by the same settings.

    `inputs_sha256` fixes the sampled designs themselves, which the seed alone does
    not: another version of scipy may sample otherwise.  `base` is the digest of the
    dataset that the paths are paired with, `hypercube` the size of the Latin hypercube
    where the designs are only the first of it.
    """

    designs: int
    seed: int
    effects: tuple[str, ...]
    level: str
    max_pressure: float
    generator_version: str
    design_space: tuple[Mapping[str, Any], ...]
    inputs_sha256: str
    sensitivities: int = 0
    base: str = ""
    hypercube: int = 0

    @classmethod
    def of(cls, data: Dataset) -> Manifest:
        """The manifest that a finished dataset was generated from."""
        return cls(
            designs=len(data),
            seed=data.seed,
            effects=data.effects,
            level=data.level,
            max_pressure=data.max_pressure,
            generator_version=data.generator_version,
            design_space=tuple(space_to_json(data.space)),
            inputs_sha256=inputs_digest(data.inputs),
            sensitivities=data.sensitivities,
            base=data.base,
            hypercube=data.hypercube,
        )

    def to_json(self) -> str:
        """One JSON object, keys in the order of the fields."""
        content = asdict(self)
        for name in ("base", "hypercube"):  # as before there were pairs and parts
            if not content[name]:
                del content[name]
        return json.dumps(content, indent=1) + "\n"

    def fingerprint(self) -> str:
        """SHA-256 that every file of a finished path repeats."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()

    def check_resumes(self, found: Mapping[str, Any], path: Path) -> None:
        """Refuse to go on with what other settings began.

        Raises
        ------
        InputError
            Naming the first setting that differs.
        """
        for name, wanted in json.loads(self.to_json()).items():
            begun = found.get(name)
            if begun == wanted:
                continue
            if name in ("design_space", "inputs_sha256"):
                allowed = "a run that sampled the same designs (design space, scipy)"
                raise InputError("resume", str(path), allowed)
            unit = "Pa" if name == "max_pressure" else ""
            begun = f"{begun!r} {unit}".rstrip()
            raise InputError(name, wanted, f"{begun}, as {path} was begun with", unit)


def inputs_digest(inputs: Any) -> str:
    """SHA-256 of an array of inputs, bit for bit."""
    return hashlib.sha256(inputs.astype("<f8").tobytes()).hexdigest()


class Parts:
    """The folder of finished paths, held under a lock.

    A context manager: entering locks the folder (and makes it, and its manifest);
    leaving unlocks it, and removes it where nothing was finished.

    Raises
    ------
    InputError
        When the folder exists and `resume` is false, belongs to other settings, or
        another process is writing it.
    FileError
        When it cannot be written.
    """

    def __init__(self, out: Path, manifest: Manifest, resume: bool) -> None:
        self.out, self.folder = out, parts_folder(out)
        self._manifest, self._resume = manifest, resume
        self._fingerprint = manifest.fingerprint()
        self._lock: IO[str] | None = None

    def __enter__(self) -> Parts:
        try:
            self._lock = self._locked()
        except OSError as error:
            raise FileError(
                self.folder, f"cannot be written: {reason(error)}"
            ) from error
        try:
            self._clean()
            self._check_manifest()
        except BaseException:
            self._lock.close()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self.folder.exists() and not any(self.folder.glob("row-*.json")):
            self.remove()
        if self._lock:
            self._lock.close()

    def _locked(self) -> IO[str]:
        import fcntl

        while True:
            try:
                self.folder.mkdir()
                sync(self.folder.parent)
            except FileExistsError:
                if not self._resume:
                    raise refusal(self.folder) from None
            try:
                lock = open(self.folder / LOCK, "w")  # noqa: SIM115 (held until the end)
            except FileNotFoundError:
                continue  # the other run has just finished and removed the folder
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                lock.close()
                raise InputError(
                    "out", str(self.out), "a file that no other generator is writing"
                ) from None
            with suppress(FileNotFoundError):
                if os.path.samestat(
                    os.fstat(lock.fileno()), (self.folder / LOCK).stat()
                ):
                    return lock
            lock.close()  # we hold a lock that was removed in the meantime: try again

    def _clean(self) -> None:
        for file in self.folder.glob(f".*{TEMPORARY}"):
            file.unlink(missing_ok=True)

    def _check_manifest(self) -> None:
        path = self.folder / MANIFEST
        try:
            found = json.loads(path.read_bytes())
        except FileNotFoundError:
            found = None
        except ValueError:
            raise FileError(path, "not a manifest; remove its folder") from None
        if isinstance(found, dict):
            self._manifest.check_resumes(found, self.folder)
        elif found is not None:
            raise FileError(path, "not a manifest; remove its folder")
        elif not self.out.exists():
            # Killed before it was written, or a fresh run.
            write_text(path, self._manifest.to_json())

    def write(self, task: Task, row: Row) -> None:
        """Keep one finished path; on disk when this returns."""
        content = {"manifest": self._fingerprint, "inputs": list(task.inputs)}
        payload = json.dumps(content | row.to_dict()).encode()
        checksum = hashlib.sha256(payload).hexdigest().encode()
        with replacing(self.folder / row_file(row.row)) as temporary:
            temporary.write_bytes(checksum + b"\n" + payload + b"\n")

    def read(self, tasks: Iterable[Task]) -> Iterator[Row]:
        """Those rows that are finished and sound; others are left out."""
        for task in tasks:
            row = self._read(task)
            if row is not None:
                yield row

    def _read(self, task: Task) -> Row | None:
        path = self.folder / row_file(task.row)
        try:
            checksum, payload = path.read_bytes().split(b"\n", 1)
        except (OSError, ValueError):
            return None
        payload = payload.removesuffix(b"\n")
        if hashlib.sha256(payload).hexdigest().encode() != checksum:
            return None
        try:
            content = json.loads(payload)
            row = Row.from_dict(content)
            fits = (
                content["manifest"] == self._fingerprint
                and tuple(content["inputs"]) == task.inputs
                and row.row == task.row
            )
        except (ValueError, KeyError, TypeError, InputError):
            return None
        return row if fits else None

    def publish(self, data: Dataset) -> Dataset:
        """Give the finished dataset its name, once it is read back as it was written.

        Raises
        ------
        FileError
            When it cannot be written, or reads back otherwise.
        """
        path = self.folder / DATASET
        data.write(path)
        written = Dataset.read(path)
        if len(written) != len(data) or written.digest() != data.digest():
            raise FileError(path, "does not read back as it was written")
        try:
            os.replace(path, self.out)
            sync(self.out.parent)
        except OSError as error:
            raise FileError(self.out, f"cannot be written: {reason(error)}") from error
        return written

    def remove(self) -> None:
        """Remove what was written here, the lock last; files of others stay."""
        self._clean()
        for file in self.folder.glob("row-*.json"):
            file.unlink(missing_ok=True)
        for name in (DATASET, MANIFEST, LOCK):
            (self.folder / name).unlink(missing_ok=True)
        # Not empty: a file of someone else, or a lock that a new run has just made.
        with suppress(OSError):
            self.folder.rmdir()


def refusal(existing: Path) -> InputError:
    """Why a path that exists is not touched."""
    return InputError(
        "out",
        str(existing),
        "a file that does not exist yet; --resume goes on with what was begun",
    )
