"""The folder of a model version: written whole or not at all, checked when read."""

from __future__ import annotations

import json
import os
import shutil
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from datagen.atomic import TEMPORARY, reason, sync
from datagen.effects import catalogue
from datagen.errors import EffectError, FileError, InputError

from .layout import EFFECTS, MODEL, SCHEMA, SCHEMA_VERSION, record
from .provenance import digest
from .version import ModelVersion, content_hash


def write(
    version: ModelVersion, folder: Path, effects_dir: Path | None = None
) -> ModelVersion:
    """Write a folder that is not there yet.

    Parameters
    ----------
    version : ModelVersion
    folder : Path
    effects_dir : Path, optional
        Where its own effect files are; where it was read from if not given.

    Returns
    -------
    ModelVersion
        The same, in that folder.

    Raises
    ------
    FileError
        When something is there already, or it cannot be written.
    """
    vacant(folder)
    begun = folder.with_name(f".{folder.name}.{uuid.uuid4().hex}{TEMPORARY}")
    try:
        begun.mkdir()
        own = sorted(set(version.own.values()))
        if own:
            source = effects_dir or version.effects_dir
            assert source is not None
            (begun / EFFECTS).mkdir()
            for name in own:
                copy = begun / EFFECTS / name
                shutil.copyfile(source / name, copy)
                if digest(copy) not in version.sources.values():
                    words = "was changed while it was fitted: adopt again"
                    raise FileError(source / name, words)
                sync(begun / EFFECTS / name)
            sync(begun / EFFECTS)
            catalogue(begun / EFFECTS)  # they have to do without what lay beside them
        content = version.to_json()
        data = {
            "schema": SCHEMA,
            "schema_version": SCHEMA_VERSION,
            "version": version.version,
            **content,
            "sha256": content_hash(content),
        }
        (begun / MODEL).write_text(json.dumps(data, indent=1) + "\n")
        sync(begun / MODEL)
        sync(begun)
        os.rename(begun, folder)  # takes the place of an empty folder, too
        sync(folder.parent)
    except OSError as error:
        vacant(folder)  # written by another meanwhile
        raise FileError(folder, f"cannot be written: {reason(error)}") from error
    finally:
        shutil.rmtree(begun, ignore_errors=True)
    return replace(version, folder=folder)


def read(folder: Path) -> ModelVersion:
    """Read a version and check that nothing in it was changed.

    Raises
    ------
    FileError
        When it is missing, damaged, of another kind or of a newer program.
    """
    path = folder / MODEL
    try:
        data = record(path, SCHEMA, SCHEMA_VERSION, "is not a model version")
    except (FileNotFoundError, NotADirectoryError) as error:
        raise FileError(folder, f"no model version: no {MODEL} in it") from error
    try:
        found = ModelVersion.from_json(data)
        whole = content_hash(found.to_json()) == data["sha256"]
    except (InputError, LookupError, TypeError, ValueError, AttributeError) as why:
        words = f"no {why}" if isinstance(why, KeyError) else str(why)
        raise FileError(path, f"is damaged: {words}") from why
    if not whole or found.version != data.get("version"):
        raise FileError(path, "is damaged: its content does not match its hash")
    for name, file in found.own.items():
        copy = folder / EFFECTS / file
        if not copy.is_file():
            raise FileError(copy, f"missing: effect {name} is written in it")
        try:
            now = digest(copy)
        except OSError as error:
            raise FileError(copy, f"cannot be read: {reason(error)}") from error
        if now != found.sources.get(name):
            raise FileError(copy, "was changed after the adoption")
    return replace(found, folder=folder)


def vacant(folder: Path) -> None:
    """Refuse a folder that a version cannot be written to.

    Raises
    ------
    FileError
        When something is there already, or there is nothing to put it in.
    """
    if folder.is_dir() and not any(folder.iterdir()):
        return
    if folder.exists() or folder.is_symlink():
        raise FileError(folder, "exists already; a version is written to a new folder")
    if not folder.parent.is_dir():
        raise FileError(folder, "its parent folder does not exist")
    if not os.access(folder.parent, os.W_OK):
        raise FileError(folder, "its parent folder cannot be written to")


def own_files(version: ModelVersion) -> dict[str, str]:
    """Its own effect files by name, each byte as the character of that number.

    So they can travel as JSON whatever their encoding is; see `unpacked`.

    Raises
    ------
    FileError
        When one cannot be read.
    """
    found = {}
    for name in sorted(set(version.own.values())):
        assert version.effects_dir is not None
        path = version.effects_dir / name
        try:
            found[name] = path.read_bytes().decode("latin-1")
        except OSError as error:
            raise FileError(path, f"cannot be read: {reason(error)}") from error
    return found


@contextmanager
def unpacked(files: Mapping[str, str]) -> Iterator[Path | None]:
    """A folder with the files of `own_files`, while in the block; None without any."""
    if not files:
        yield None
        return
    with TemporaryDirectory(prefix="pba-effects-") as folder:
        for name, text in files.items():
            (Path(folder) / name).write_bytes(text.encode("latin-1"))
        yield Path(folder)


@contextmanager
def effects_of(
    parent: ModelVersion | None, effects_dir: Path | None
) -> Iterator[Path | None]:
    """One folder with the user's effects and those that a parent version brings.

    Parameters
    ----------
    parent : ModelVersion or None
    effects_dir : Path or None

    Yields
    ------
    Path or None

    Raises
    ------
    EffectError
        When a folder is missing, or the two have files of one name that differ.
    """
    if parent is None or parent.effects_dir is None or effects_dir is None:
        yield effects_dir or (None if parent is None else parent.effects_dir)
        return
    with TemporaryDirectory(prefix="pba-effects-") as both:
        for folder in (parent.effects_dir, effects_dir):
            if not folder.is_dir():
                raise EffectError(f"{folder}: no such folder of effects")
            for file in sorted(folder.glob("*.py")):
                copy = Path(both) / file.name
                if copy.exists() and copy.read_bytes() != file.read_bytes():
                    raise EffectError(
                        f"{file}: differs from what version {parent.version} adopted; "
                        "leave that version out, or give the other effect a file and a "
                        "name of its own"
                    )
                shutil.copyfile(file, copy)
        yield Path(both)
