"""The two files of a model: ``model.json`` and ``weights.safetensors``.

The JSON names the version of everything it depends on and the SHA-256 of the weights;
a file that is damaged, or was trained by another version, is refused in one line.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from datagen.atomic import reason, replacing
from datagen.dataset import space_to_json
from datagen.errors import FileError
from datagen.space import Parameter, Space

from .calibration import Calibration
from .domain import Domain
from .ensemble import Ensemble
from .expansion import Expansion
from .features import FEATURES_VERSION
from .limit import LimitModel
from .network import Stack

Array = np.ndarray

SCHEMA = "pba-ensemble"
SCHEMA_VERSION = 1
"""Raised whenever an older reader would misread a newer model."""

MODEL, WEIGHTS = "model.json", "weights.safetensors"

CONTENT = (
    "outputs",
    "space",
    "effects",
    "limit_shift",
    "calibration_designs",
    "max_pressure_Pa",
    "allowed_distance",
)
"""Keys of the JSON that decide what the model answers."""


def arrays_of(ensemble: Ensemble) -> dict[str, Array]:
    """Every array of a model by name."""
    e = ensemble
    stacks = {"response": e.expansion.stack}
    if e.limit.stack is not None:
        stacks["limit"] = e.limit.stack
    arrays = {
        f"{part}.{name}": array
        for part, stack in stacks.items()
        for name, array in stack.arrays().items()
    }
    arrays |= {
        "terms.base": e.expansion.base,
        "terms.unit": e.expansion.unit,
        "terms.positive": e.expansion.positive,
        "terms.owner": e.expansion.owner,
        "calibration.shape": e.calibration.shape,
        "calibration.quantiles": e.calibration.quantiles,
        "calibration.coverages": e.calibration.coverages,
        "domain.points": e.domain.points,
        "domain.centre": e.domain.centre,
        "domain.scale": e.domain.scale,
        "domain.disagreement": e.domain.disagreement,
    }
    return {name: np.ascontiguousarray(array) for name, array in arrays.items()}


def content_of(ensemble: Ensemble) -> dict[str, Any]:
    """What the model answers by, beside its arrays."""
    e = ensemble
    return {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "features_version": FEATURES_VERSION,
        "outputs": list(e.outputs),
        "space": space_to_json(e.space),
        "effects": list(e.effects),
        "limit_shift": e.limit.shift,
        "calibration_designs": e.calibration.designs,
        "max_pressure_Pa": e.domain.max_pressure,
        "allowed_distance": e.domain.allowed_distance,
    }


def content_digest(ensemble: Ensemble) -> str:
    """SHA-256 of what the model answers by; its description is no part of it."""
    sha = hashlib.sha256(json.dumps(content_of(ensemble), sort_keys=True).encode())
    for name, array in sorted(arrays_of(ensemble).items()):
        sha.update(f"{name} {array.dtype} {array.shape}\n".encode() + array.tobytes())
    return sha.hexdigest()


def write(ensemble: Ensemble, folder: Path) -> None:
    """Write both files, the weights first; an older model stays until then.

    Raises
    ------
    FileError
        When the folder or a file cannot be written.
    """
    from safetensors.numpy import save

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(folder, f"cannot be made: {reason(error)}") from error
    weights = save(arrays_of(ensemble))
    model = content_of(ensemble) | {
        "version": ensemble.version,
        "weights_sha256": hashlib.sha256(weights).hexdigest(),
        "parameters": {k: dict(v) for k, v in ensemble.parameters.items()},
        "description": ensemble.description,
    }
    with replacing(folder / WEIGHTS) as temporary:
        temporary.write_bytes(weights)
    with replacing(folder / MODEL) as temporary:
        temporary.write_text(json.dumps(model, indent=1) + "\n")


def read(folder: Path) -> Ensemble:
    """Read and check a model; see `Ensemble.load`."""
    from safetensors import SafetensorError
    from safetensors.numpy import load

    path = folder / MODEL
    try:
        model = json.loads(bytes_of(path))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise FileError(path, f"not JSON: {error}") from error
    if not isinstance(model, dict) or model.get("schema") != SCHEMA:
        raise FileError(path, f"not a {SCHEMA}")
    for key, own in (
        ("schema_version", SCHEMA_VERSION),
        ("features_version", FEATURES_VERSION),
    ):
        if model.get(key) != own:
            raise FileError(
                path,
                f"{key.replace('_', ' ')} {model.get(key)}; this program has {own}: "
                "train the model again",
            )
    weights = bytes_of(folder / WEIGHTS)
    if hashlib.sha256(weights).hexdigest() != model.get("weights_sha256"):
        raise FileError(
            folder / WEIGHTS, f"damaged, or not the weights that {MODEL} names"
        )
    try:
        ensemble = _build(model, load(weights))
        intact = ensemble.version == model["version"]
    except SafetensorError as error:
        raise FileError(folder / WEIGHTS, f"not a safetensors file: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise FileError(path, f"damaged or incomplete: {error}") from error
    if not intact:
        raise FileError(path, "damaged: its content does not match its version")
    return ensemble


def _build(model: dict[str, Any], arrays: dict[str, Array]) -> Ensemble:
    outputs = tuple(str(name) for name in model["outputs"])
    space = Space(tuple(Parameter(**p) for p in model["space"]))
    limit = part(arrays, "limit")
    return Ensemble(
        outputs=outputs,
        space=space,
        effects=tuple(str(name) for name in model["effects"]),
        expansion=Expansion(
            Stack.from_arrays(part(arrays, "response")), **part(arrays, "terms")
        ),
        limit=LimitModel(
            Stack.from_arrays(limit) if limit else None, float(model["limit_shift"])
        ),
        calibration=Calibration(
            designs=int(model["calibration_designs"]), **part(arrays, "calibration")
        ),
        domain=Domain(
            space=space,
            max_pressure=float(model["max_pressure_Pa"]),
            allowed_distance=float(model["allowed_distance"]),
            **part(arrays, "domain"),
        ),
        description=dict(model["description"]),
        parameters=model["parameters"],
    )


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
