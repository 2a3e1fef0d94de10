"""The files of a corrected surrogate: its base in a folder of its own, and the change.

``base/`` is the base model as it was, ``model.json`` and ``weights.safetensors`` hold
what the effects add.  The JSON names the base's version and the SHA-256 of the weights;
nothing in any file can run code.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from datagen.dataset import space_to_json
from datagen.errors import FileError
from datagen.space import Parameter, Space

from . import files
from .calibration import Calibration
from .corrected import Corrected
from .ensemble import Ensemble
from .equivalent import Equivalent
from .expansion import Expansion
from .files import MODEL, Kind, part
from .network import Stack
from .shift import Shift

Array = np.ndarray

KIND = Kind("pba-corrected", 2, "learn the effects again")

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
        **KIND.head,
        "base_version": model.base.version,
        "space": space_to_json(model.space),
        "effects": list(model.effects),
        "shift_noise": model.shift.noise,
        "calibration_designs": model.calibration.designs,
    }


def content_digest(model: Corrected) -> str:
    """SHA-256 of what the model answers by; its description is no part of it."""
    return files.digest(content_of(model), arrays_of(model))


def write(model: Corrected, folder: Path) -> None:
    """Write the base, the weights, then the description.

    Raises
    ------
    FileError
        When the folder or a file cannot be written.
    """
    files.make(folder)
    model.base.save(folder / BASE)
    files.write(model, folder, content_of(model), arrays_of(model))


def read(folder: Path) -> Corrected:
    """Read and check a model; see `Corrected.load`."""

    def build(content: dict[str, Any], arrays: dict[str, Array]) -> Corrected:
        base = Ensemble.load(folder / BASE)
        if base.version != content["base_version"]:
            raise FileError(
                folder / BASE,
                f"version {base.version}, {MODEL} was learned on "
                f"{content['base_version']}",
            )
        return _build(base, content, arrays)

    return files.read(folder, KIND, build)


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
