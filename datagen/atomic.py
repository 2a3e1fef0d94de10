"""Files that are either whole or not there, whatever happens to the process."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import FileError

TEMPORARY = ".tmp"
"""Suffix of files that are still being written; left over after a kill."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Write a file in full before it takes its name.

    Yields the path of a temporary file in the same folder.  When the block ends
    without an error the file is flushed to disk and renamed to `path`, then the folder
    is flushed; until then an older file at `path` stays as it was.

    Raises
    ------
    FileError
        When the folder is missing, not writable, or the disk is full.
    """
    if path.exists() and not path.is_file():  # a device, say, which a rename would end
        raise FileError(path, "cannot be written: is there, and no file")
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}{TEMPORARY}")
    try:
        temporary.touch(exist_ok=False)  # says early and clearly what is in the way
        yield temporary
        sync(temporary)
        os.replace(temporary, path)
        sync(path.parent)
    except OSError as error:
        raise FileError(path, f"cannot be written: {reason(error)}") from error
    finally:
        with suppress(OSError):
            temporary.unlink()


def write_text(path: Path, text: str) -> None:
    """Write a text file in full before it takes its name, see `replacing`.

    Raises
    ------
    FileError
    """
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def sync(path: Path) -> None:
    """Flush a file, or the names in a folder, to disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def reason(error: OSError) -> str:
    """What went wrong in a few words, on one line."""
    text = error.strerror or str(error) or type(error).__name__
    return " ".join(text.split())
