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

SCHEMA, SCHEMA_VERSION = "pba-model-version", 1
"""Raised whenever an older reader would misread a newer folder."""

MODEL, EFFECTS, SURROGATE = "model.json", "effects", "surrogate"

BASELINE = "baseline"
"""The model without adopted effects: the first parent."""


def is_version(folder: Path) -> bool:
    """True for a folder that says it is a model version, whole or not."""
    try:
        data = json.loads((folder / MODEL).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(data, dict) and data.get("schema") == SCHEMA
