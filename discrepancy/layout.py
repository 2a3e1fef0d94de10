"""Names of what is in a model version's folder; imports nothing heavy.

::

    MODEL/
      model.json     what was fitted, to which measurements, by which code
      effects/       copies of the user's own effect files that it needs
      surrogate/     its fast surrogate, where one was trained
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from datagen.atomic import reason
from datagen.errors import FileError

SCHEMA, SCHEMA_VERSION = "pba-model-version", 2
"""Raised whenever an older reader would misread a newer folder.  2: ids leave names of
files and warnings out."""

MODEL, EFFECTS, SURROGATE = "model.json", "effects", "surrogate"

BASELINE = "baseline"
"""The model without adopted effects: the first parent."""


class DamagedError(FileError):
    """A file that no program has written so; what it held cannot be known."""


def record(path: Path, schema: str, version: int, other: str) -> dict[str, Any]:
    """A JSON file that names its schema.

    Parameters
    ----------
    path : Path
    schema : str
    version : int
        The only one that is read.
    other : str
        What is said of a file of another schema.

    Raises
    ------
    FileNotFoundError, NotADirectoryError
        When there is none.
    FileError
        When it cannot be read, or is of another version.
    DamagedError
        When it is not JSON, or of another schema.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        raise
    except OSError as error:
        raise FileError(path, f"cannot be read: {reason(error)}") from error
    except ValueError as error:
        raise DamagedError(path, "is damaged: not JSON") from error
    if not isinstance(data, dict) or data.get("schema") != schema:
        raise DamagedError(path, other)
    if data.get("schema_version") != version:
        raise FileError(
            path,
            f"has schema version {data.get('schema_version')!r}; this program reads "
            f"{version}",
        )
    return data


def is_version(folder: Path) -> bool:
    """True for a folder that says it is a model version, whole or not.

    Also where its record cannot be read: what is there is told, not passed over.
    """
    try:
        data = json.loads((folder / MODEL).read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return False
    except (OSError, ValueError):
        return True
    return isinstance(data, dict) and data.get("schema") == SCHEMA
