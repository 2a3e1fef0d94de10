"""Stand-ins for surrogate and finite elements, with closed forms that tests know.

The fakes only stand where the real parts are not what is tested: the translation of
units, the choice of who answers, jobs, errors.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from datagen.device import DESIGN_SPACE, MAX_PRESSURE, Design
from datagen.errors import InputError
from datagen.response import CONVERGED, OUTPUT_NAMES, Path, Response
from service.answer import fem_answer
from service.workers import Report

BAND = 1e-6  # half the width of the fake interval, SI
MESH_ERROR = 0.01  # of the fake finite elements, over the value


def closed_form(design: Design, pressure: np.ndarray) -> np.ndarray:
    """(s, m) array: anything smooth that depends on design and pressure."""
    x = pressure / design.upper_modulus
    scale = design.upper_thickness * np.arange(1, len(OUTPUT_NAMES) + 1)
    return x[:, None] * scale


@dataclass(frozen=True)
class FakeCheck:
    in_range: bool
    reasons: tuple[str, ...]
    per_step: np.ndarray
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class FakePrediction:
    response: Response
    low: np.ndarray
    high: np.ndarray


def _response(designs: Sequence[Design], paths: Sequence[Path], end: float) -> Response:
    (design,), (path,) = designs, paths
    reached = path.pressure <= end
    values = np.where(reached[:, None], closed_form(design, path.pressure), np.nan)
    stopped = not reached.all()
    return Response(
        OUTPUT_NAMES,
        path.pressure[None],
        values[None],
        np.zeros_like(values)[None],
        np.where(reached, CONVERGED, "limit_point")[None],
        ("limit_point" if stopped else "completed",),
        np.array([end if stopped else np.nan]),
        (f"the path turns at {end / 1e3:g} kPa" if stopped else "",),
        {"unknowns": 4321, "seconds": 0.25},
    )


@dataclass(frozen=True)
class FakeSurrogate:
    version: str = "fake-1"
    description: Mapping[str, Any] = field(
        default_factory=lambda: {"n_train": np.int64(3), "worst": float("nan")}
    )

    def predict(
        self, designs: Sequence[Design], paths: Sequence[Path], coverage: float = 0.9
    ) -> FakePrediction:
        response = _response(designs, paths, np.inf)
        return FakePrediction(response, response.values - BAND, response.values + BAND)

    def check(self, design: Design, pressure: np.ndarray) -> FakeCheck:
        reasons = [
            f"{p.name} is outside the trained range"
            for p, _ in DESIGN_SPACE.outside(design.sampled())
        ]
        if pressure.max() > MAX_PRESSURE:
            reasons.append("pressure_kPa: past the trained 150 kPa")
        inside = np.full(pressure.shape, not reasons)
        return FakeCheck(not reasons, tuple(reasons), inside)


class FakeFem:
    """Finite elements whose path turns at 400 kPa."""

    def __call__(
        self,
        designs: Sequence[Design],
        paths: Sequence[Path],
        mesh_error: bool = False,
    ) -> Response:
        response = _response(designs, paths, 400e3)
        if not mesh_error:
            return response
        return replace(
            response,
            mesh_error=MESH_ERROR * np.abs(response.values),
            limit_pressure_error=MESH_ERROR * response.limit_pressure,
            info=response.info | {"mesh_error_seconds": 0.05},
        )


def predict(payload: Mapping[str, Any], report: Report) -> dict[str, Any]:
    """Task: the fake finite elements, after as many ms as `lower_thickness` has um.

    A `cavity_height` of 13 um stands for a request that only the worker can refuse,
    one of 14 um for a bug in it, 15 um for a process that dies.
    """
    design = Design(**payload["design"])
    special = round(design.cavity_height / 1e-6)
    if special == 13:
        raise InputError("cavity_height_um", 13.0, "another height", "um")
    if special == 14:
        raise ZeroDivisionError("a bug")
    if special == 15:
        os._exit(9)
    time.sleep(design.lower_thickness / 1e-6 / 1e3)
    adopted = payload["adopted"]
    answer = fem_answer(
        FakeFem(),
        f"fem-fake+{adopted['version']}" if adopted else "fem-fake",
        design,
        np.asarray(payload["pressure"], dtype=float),
        payload["in_range"],
        payload["reasons"],
    )
    return replace(
        answer, effects=tuple(adopted["effects"] if adopted else ())
    ).to_dict()


def adopt(payload: Mapping[str, Any], report: Report) -> dict[str, Any]:
    """Task: a version made by hand, kept and put into use as an adoption is."""
    from discrepancy.version import Measured
    from discrepancy.workspace import Workspace
    from service.discrepancy_tasks import measured_of
    from tests.discrepancy.versions import version

    home, (read,) = Workspace(FilePath(payload["workspace"])), measured_of(payload)
    folder = home.folder / payload["model"]
    made = version(
        parent=payload["on"] or "baseline",
        measurements=(Measured(read.source, read.sha256, read.devices),),
        tolerances=read.tolerances,
        level=payload["level"],
        seed=payload["seed"],
    )
    if not folder.exists():
        made.save(folder)
    if payload["use"]:
        home.use(folder.name)
    return {"version": made.version}


def surrogate(payload: Mapping[str, Any], report: Report) -> dict[str, Any]:
    """Task: an empty folder where the surrogate would be."""
    (FilePath(payload["folder"]) / "surrogate").mkdir(exist_ok=True)
    return {"version": payload["version"]}


def count(payload: Mapping[str, Any], report: Report) -> dict[str, Any]:
    """Task: as many steps as `designs`, each noted in a file; goes on after a kill."""
    notes = FilePath(payload["out"])
    done = len(notes.read_text().split()) if notes.exists() else 0
    started = done
    while done < payload["designs"]:
        time.sleep(0.05)
        done += 1
        with notes.open("a") as file:
            file.write(f"{done}\n")
        if done == started + 1:  # silent afterwards: a broken pipe shall not stop it
            report({"done": done, "total": payload["designs"]})
    return {"file": str(notes), "started": started, "designs": done}


KINDS = {
    "predict": "tests.service.fakes:predict",
    "dataset": "tests.service.fakes:count",
}
