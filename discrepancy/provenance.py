"""Where a model version is from: files of effects, and the code that made it."""

from __future__ import annotations

import hashlib
import inspect
import subprocess
from importlib import metadata
from pathlib import Path

from datagen.effects import Effect
from datagen.effects.door import SHA256
from datagen.errors import EffectError


def source_file(effect: Effect) -> Path:
    """The file that an effect is written in.

    Raises
    ------
    EffectError
        When it was not written in a file.
    """
    file = inspect.getsourcefile(effect.change)
    if file is None or not Path(file).is_file():
        raise EffectError(f"effect {effect.name}: is not written in a file")
    return Path(file)


def source_digest(effect: Effect) -> str:
    """SHA-256 of the file that an effect was loaded from, as it was then.

    Raises
    ------
    EffectError
        When it was not written in a file.
    """
    loaded = getattr(effect.change, "__globals__", {}).get(SHA256)
    return str(loaded) if loaded else digest(source_file(effect))


def digest(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def package() -> str:
    """Version of the installed package."""
    try:
        return metadata.version("pba")
    except metadata.PackageNotFoundError:  # run from a source tree
        return "0+source"


def commit() -> str:
    """Git commit of this program, ``-dirty`` with changes; empty where not known."""
    root = Path(__file__).parents[1]
    if not (root / ".git").exists():
        return ""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        done = subprocess.run(
            command, cwd=root, capture_output=True, text=True, timeout=20, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
