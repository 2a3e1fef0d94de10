"""What workers run: a function for each kind of job, from JSON to JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from datagen.device import Design

from .answer import fem_answer
from .workers import Report


def fem_version(level: str) -> str:
    """What makes the numbers of the finite elements, and at which mesh."""
    from datagen.model import GENERATOR_VERSION

    return f"fem-{GENERATOR_VERSION}-{level}"


def predict(payload: Mapping[str, Any], report: Report) -> dict[str, Any]:
    """One path by finite elements; the result is the body of ``/v1/predict``."""
    from .versions import adopted_answer, fem_model

    level = payload["level"]
    asked = (
        Design(**payload["design"]),
        np.asarray(payload["pressure"], dtype=float),
        payload["in_range"],
        payload["reasons"],
    )
    version = None
    if payload.get("adopted"):
        from discrepancy.folder import read

        version = read(Path(payload["adopted"]))
    with fem_model(version, {}, level, None) as model:
        if version is not None:
            return adopted_answer(version, model, level, *asked).to_dict()
        return fem_answer(model, fem_version(level), *asked).to_dict()


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
