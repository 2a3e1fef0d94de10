"""What is in the files of an ensemble."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from datagen.dataset import space_to_json
from datagen.space import Parameter, Space

from . import files
from .calibration import Calibration
from .domain import Domain
from .ensemble import Ensemble
from .expansion import Expansion
from .files import Kind, part
from .limit import LimitModel
from .network import Stack

Array = np.ndarray

KIND = Kind("pba-ensemble", 1, "train the model again")


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
        **KIND.head,
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
    return files.digest(content_of(ensemble), arrays_of(ensemble))


def write(ensemble: Ensemble, folder: Path) -> None:
    """Write both files; see `files.write`."""
    files.write(ensemble, folder, content_of(ensemble), arrays_of(ensemble))


def read(folder: Path) -> Ensemble:
    """Read and check a model; see `Ensemble.load`."""
    return files.read(folder, KIND, _build)


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
