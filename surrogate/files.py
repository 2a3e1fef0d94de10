"""The two files of any model: ``model.json`` and ``weights.safetensors``.

The JSON names the version of everything it depends on and the SHA-256 of the weights;
a file that is damaged, or was trained by another version, is refused in one line.
Nothing in either can run code.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from datagen.atomic import reason, replacing, write_text
from datagen.errors import FileError

from .features import FEATURES_VERSION

Array = np.ndarray

MODEL, WEIGHTS = "model.json", "weights.safetensors"
FRESH = f"{WEIGHTS}.new"


class Stored(Protocol):
    """What a model says of itself beside its arrays and content."""

    @property
    def version(self) -> str: ...

    @property
    def parameters(self) -> Mapping[str, Mapping[str, float]]: ...

    @property
    def description(self) -> dict[str, Any]: ...


M = TypeVar("M", bound=Stored)


@dataclass(frozen=True)
class Kind:
    """One kind of model on disk.

    Parameters
    ----------
    schema : str
    schema_version : int
        Raised whenever an older reader would misread a newer model.
    again : str
        What makes a model that this program can read.
    """

    schema: str
    schema_version: int
    again: str

    @property
    def head(self) -> dict[str, Any]:
        """Beginning of the content of such a model."""
        return {
            "schema": self.schema,
            "schema_version": self.schema_version,
            "features_version": FEATURES_VERSION,
        }


def digest(content: Mapping[str, Any], arrays: Mapping[str, Array]) -> str:
    """SHA-256 of what a model answers by; its description is no part of it."""
    sha = hashlib.sha256(json.dumps(content, sort_keys=True).encode())
    for name, array in sorted(arrays.items()):
        sha.update(f"{name} {array.dtype} {array.shape}\n".encode() + array.tobytes())
    return sha.hexdigest()


def make(folder: Path) -> None:
    """Make the folder of a model where it is not there.

    Raises
    ------
    FileError
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(folder, f"cannot be made: {reason(error)}") from error


def write(
    model: Stored, folder: Path, content: dict[str, Any], arrays: dict[str, Array]
) -> None:
    """Write both files; an older model stays until ``model.json`` is the new one.

    Whose weights wait beside the older ones until then, see `_weights`.

    Raises
    ------
    FileError
        When the folder or a file cannot be written.
    """
    from safetensors.numpy import save

    make(folder)
    weights = save(arrays)
    whole = content | {
        "version": model.version,
        "weights_sha256": hashlib.sha256(weights).hexdigest(),
        "parameters": {k: dict(v) for k, v in model.parameters.items()},
        "description": model.description,
    }
    fresh = folder / FRESH
    with replacing(fresh) as temporary:
        temporary.write_bytes(weights)
    write_text(folder / MODEL, json.dumps(whole, indent=1) + "\n")
    try:
        fresh.replace(folder / WEIGHTS)
    except OSError as error:
        raise FileError(fresh, f"cannot be renamed: {reason(error)}") from error


def read(
    folder: Path, kind: Kind, build: Callable[[dict[str, Any], dict[str, Array]], M]
) -> M:
    """Read and check a model.

    Parameters
    ----------
    folder : Path
    kind : Kind
    build : callable
        From content and arrays to the model.

    Raises
    ------
    FileError
        When a file is missing, damaged, of another kind or version, or the two do not
        belong together.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load

    path = folder / MODEL
    try:
        content = json.loads(bytes_of(path))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise FileError(path, f"not JSON: {error}") from error
    if not isinstance(content, dict) or content.get("schema") != kind.schema:
        raise FileError(path, f"not a {kind.schema}")
    for key, own in kind.head.items():
        if content.get(key) != own:
            raise FileError(
                path,
                f"{key.replace('_', ' ')} {content.get(key)}; this program has {own}: "
                f"{kind.again}",
            )
    weights = _weights(folder, str(content.get("weights_sha256")))
    try:
        model = build(content, load(weights))
        intact = model.version == content["version"]
    except SafetensorError as error:
        raise FileError(folder / WEIGHTS, f"not a safetensors file: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise FileError(path, f"damaged or incomplete: {error}") from error
    if not intact:
        raise FileError(path, "damaged: its content does not match its version")
    return model


def _weights(folder: Path, sha256: str) -> bytes:
    """The weights of a hash; a writer that was killed has left them beside others."""
    fresh = folder / FRESH
    if fresh.exists():
        weights = bytes_of(fresh)
        if hashlib.sha256(weights).hexdigest() == sha256:
            return weights
    weights = bytes_of(folder / WEIGHTS)
    if hashlib.sha256(weights).hexdigest() != sha256:
        raise FileError(
            folder / WEIGHTS, f"damaged, or not the weights that {MODEL} names"
        )
    return weights


def part(arrays: dict[str, Array], prefix: str) -> dict[str, Array]:
    """Arrays whose name begins with ``prefix.``, by the rest of it."""
    cut = len(prefix) + 1
    return {k[cut:]: v for k, v in arrays.items() if k.startswith(f"{prefix}.")}


def bytes_of(path: Path) -> bytes:
    """Content of a file, or a `FileError`."""
    if not path.exists():
        raise FileError(path, "does not exist")
    try:
        return path.read_bytes()
    except OSError as error:
        raise FileError(path, f"cannot be read: {reason(error)}") from error
