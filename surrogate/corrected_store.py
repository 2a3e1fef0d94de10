"""The files of a corrected surrogate: its base in a folder of its own, and the change.

``base/`` is the base model as it was, ``model.json`` and ``weights.safetensors`` hold
what the effects add.  The JSON names the base's version and the SHA-256 of the weights;
nothing in any file can run code.
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
from .corrected import Corrected
from .ensemble import Ensemble
from .equivalent import Equivalent
from .expansion import Expansion
from .features import FEATURES_VERSION
from .network import Stack
from .shift import Shift
from .store import MODEL, WEIGHTS, bytes_of, part

Array = np.ndarray

SCHEMA = "pba-corrected"
SCHEMA_VERSION = 1
"""Raised whenever an older reader would misread a newer model."""

BASE = "base"
"""Folder of the base model, inside that of the corrected one."""


def arrays_of(model: Corrected) -> dict[str, Array]:
    """Every array of the change by name; the base has its own file."""
    m = model
    arrays = {f"change.{name}": a for name, a in m.change.stack.arrays().items()}
    arrays |= {
        "terms.base": m.change.base,
        "terms.unit": m.change.unit,
        "terms.positive": m.change.positive,
        "terms.owner": m.change.owner,
        "equivalent.weights": m.equivalent.weights,
        "equivalent.logarithmic": m.equivalent.logarithmic,
        "shift.mean": m.shift.mean,
        "shift.scale": m.shift.scale,
        "shift.weights": m.shift.weights,
        "calibration.shape": m.calibration.shape,
        "calibration.quantiles": m.calibration.quantiles,
        "calibration.coverages": m.calibration.coverages,
        "samples": m.samples,
    }
    return {name: np.ascontiguousarray(array) for name, array in arrays.items()}


def content_of(model: Corrected) -> dict[str, Any]:
    """What the model answers by, beside its arrays."""
    return {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "features_version": FEATURES_VERSION,
        "base_version": model.base.version,
        "space": space_to_json(model.space),
        "effects": list(model.effects),
        "shift_noise": model.shift.noise,
        "calibration_designs": model.calibration.designs,
    }


def content_digest(model: Corrected) -> str:
    """SHA-256 of what the model answers by; its description is no part of it."""
    sha = hashlib.sha256(json.dumps(content_of(model), sort_keys=True).encode())
    for name, array in sorted(arrays_of(model).items()):
        sha.update(f"{name} {array.dtype} {array.shape}\n".encode() + array.tobytes())
    return sha.hexdigest()


def write(model: Corrected, folder: Path) -> None:
    """Write the base, the weights, then the description.

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
    model.base.save(folder / BASE)
    weights = save(arrays_of(model))
    content = content_of(model) | {
        "version": model.version,
        "weights_sha256": hashlib.sha256(weights).hexdigest(),
        "parameters": {k: dict(v) for k, v in model.parameters.items()},
        "description": model.description,
    }
    with replacing(folder / WEIGHTS) as temporary:
        temporary.write_bytes(weights)
    with replacing(folder / MODEL) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n")


def read(folder: Path) -> Corrected:
    """Read and check a model; see `Corrected.load`."""
    from safetensors import SafetensorError
    from safetensors.numpy import load

    path = folder / MODEL
    try:
        content = json.loads(bytes_of(path))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise FileError(path, f"not JSON: {error}") from error
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise FileError(path, f"not a {SCHEMA}")
    for key, own in (
        ("schema_version", SCHEMA_VERSION),
        ("features_version", FEATURES_VERSION),
    ):
        if content.get(key) != own:
            raise FileError(
                path,
                f"{key.replace('_', ' ')} {content.get(key)}; this program has {own}: "
                "learn the effects again",
            )
    base = Ensemble.load(folder / BASE)
    if base.version != content.get("base_version"):
        raise FileError(
            folder / BASE,
            f"version {base.version}, {MODEL} was learned on "
            f"{content.get('base_version')}",
        )
    weights = bytes_of(folder / WEIGHTS)
    if hashlib.sha256(weights).hexdigest() != content.get("weights_sha256"):
        raise FileError(
            folder / WEIGHTS, f"damaged, or not the weights that {MODEL} names"
        )
    try:
        model = _build(base, content, load(weights))
        intact = model.version == content["version"]
    except SafetensorError as error:
        raise FileError(folder / WEIGHTS, f"not a safetensors file: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise FileError(path, f"damaged or incomplete: {error}") from error
    if not intact:
        raise FileError(path, "damaged: its content does not match its version")
    return model


def _build(
    base: Ensemble, content: dict[str, Any], arrays: dict[str, Array]
) -> Corrected:
    return Corrected(
        base=base,
        space=Space(tuple(Parameter(**p) for p in content["space"])),
        effects=tuple(str(name) for name in content["effects"]),
        equivalent=Equivalent(**part(arrays, "equivalent")),
        shift=Shift(noise=float(content["shift_noise"]), **part(arrays, "shift")),
        change=Expansion(
            Stack.from_arrays(part(arrays, "change")), **part(arrays, "terms")
        ),
        calibration=Calibration(
            designs=int(content["calibration_designs"]), **part(arrays, "calibration")
        ),
        description=dict(content["description"]),
        samples=arrays["samples"],
        parameters=content["parameters"],
    )
