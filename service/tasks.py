"""What workers run: a function for each kind of job, from JSON to JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from datagen.device import Design

from .answer import fem_answer
from .workers import Report


def fem_version(level: str, adopted: str = "") -> str:
    """What makes the numbers of the finite elements, and at which mesh.

    Parameters
    ----------
    level : str
    adopted : str
        Id of the model version whose effects are on.
    """
    from datagen.model import GENERATOR_VERSION

    return f"fem-{GENERATOR_VERSION}-{level}" + (f"+{adopted}" if adopted else "")


def predict(payload: Mapping[str, Any], report: Report) -> dict[str, Any]:
    """One path by finite elements; the result is the body of ``/v1/predict``.

    ``adopted`` holds the model version, see `current.Serving.adopted`; None is the
    baseline.
    """
    from datagen.model import Model
    from discrepancy.folder import unpacked

    from .versions import adopted_answer

    level, version = payload["level"], payload["adopted"]
    asked = (
        Design(**payload["design"]),
        np.asarray(payload["pressure"], dtype=float),
        payload["in_range"],
        payload["reasons"],
    )
    if version is None:
        answer = fem_answer(Model(level=level), fem_version(level), *asked)
    else:
        name = fem_version(level, version["version"])
        with unpacked(version["own"]) as own:
            model = Model(tuple(version["effects"]), level, version["parameters"], own)
            answer = adopted_answer(model, name, version["left_open"], *asked)
    return replace(answer, notes=(*answer.notes, *payload["notes"])).to_dict()


def dataset(payload: Mapping[str, Any], report: Report) -> dict[str, Any]:
    """Generate a dataset; a job that was killed goes on where it stopped."""
    from datagen.generate import generate

    data = generate(
        payload["designs"],
        payload["seed"],
        payload["out"],
        effects=payload["effects"],
        level=payload["level"],
        resume=True,
        progress=lambda progress: report(asdict(progress)),
    )
    return {
        "file": str(Path(payload["out"])),
        "designs": len(data),
        "path_status": dict(Counter(data.path_status)),
        "digest": data.digest(),
    }
