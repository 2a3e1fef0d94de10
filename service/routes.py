"""The endpoints under ``/v1``; each is a few lines on top of the library."""

from __future__ import annotations

import asyncio
import datetime
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Depends, Query, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import FileResponse, JSONResponse, Response

from datagen.device import CASES, DESIGN_SPACE, MATERIALS, MM, UM, Design, named_device
from datagen.errors import InputError
from datagen.response import OUTPUTS
from datagen.units import BY_FIELD

from . import figures
from .answer import RangeCheck, surrogate_answer
from .bench import (
    DEVICES,
    MAX_STEPS,
    PRESSURE_RANGE,
    design_columns,
    plain,
    pressures_from_bench,
    rounded,
)
from .current import Serving, Switch
from .jobs import OPEN, Job, JobNotFound, JobStore, payload_key
from .schemas import (
    CheckIn,
    CheckOut,
    DatasetIn,
    DesignIn,
    ErrorOut,
    FigureIn,
    JobOut,
    PredictIn,
    PredictOut,
    limits_table,
)

FIRST_POLL, LAST_POLL = 0.03, 0.5
"""s.  Time between two looks at a job that a request waits for; grows by half."""


@dataclass(frozen=True)
class Service:
    """What the endpoints share: the model in use, one job store, and settings.

    `release` is the version of the package: results of jobs on measurements are its.
    """

    switch: Switch
    store: JobStore
    state: Path
    wait: float
    fem_version: Callable[[str], str]
    release: str = "source"

    def submit_predict(
        self,
        serving: Serving,
        design: Design,
        pressure: np.ndarray,
        level: str,
        check: RangeCheck,
    ) -> Job:
        """A finite-element prediction as a job; the same request is the same job.

        It takes along all that it needs of the version in use.
        """
        payload = {
            "design": design.to_dict(),
            "pressure": pressure.tolist(),
            "level": level,
            "in_range": check.in_range,
            "reasons": list(check.reasons),
            "notes": list(serving.notes),
            "adopted": serving.adopted,
        }
        same = payload | {"design": design_columns(design)}
        key = payload_key(same, self.fem_version(level))
        return self.store.submit("predict", payload, key)

    async def ended(self, job: Job, wait: float) -> Job:
        """The job after it has ended, or after `wait` seconds as it then stands."""
        deadline, pause = time.monotonic() + wait, FIRST_POLL
        while job.status in OPEN and (left := deadline - time.monotonic()) > 0:
            await asyncio.sleep(min(pause, left))
            pause = min(1.5 * pause, LAST_POLL)
            job = await run_in_threadpool(self.store.get, job.id)
        return job


def _service(request: Request) -> Service:
    service: Service = request.app.state.service
    return service


Shared = Annotated[Service, Depends(_service)]


def errors(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Statuses that a route may answer with an error's body."""
    return {status: {"model": ErrorOut} for status in statuses}


ACCEPTED: dict[int | str, dict[str, Any]] = {
    202: {
        "model": JobOut,
        "description": "Long work: a job",
        "headers": {
            "Location": {
                "description": "where the job is",
                "schema": {"type": "string"},
            },
            "Retry-After": {
                "description": "after how long to look at it (s)",
                "schema": {"type": "integer"},
            },
        },
    }
}
"""Of a request that starts a job."""

BODY = errors(400, 413, 415)  # of any request with a body: no JSON, too long
router = APIRouter(responses=errors(422, 500))


@router.post(
    "/v1/predict",
    response_model=PredictOut,
    responses=ACCEPTED | BODY | errors(409, 503),
)
async def predict(body: PredictIn, service: Shared) -> Any:
    """What a device does at each pressure, from the surrogate where it was trained.

    Where it was not, the finite elements answer; when they take longer than `wait_s`
    the answer is 202 with a job, whose result is this body.
    """
    design = body.design.design()
    pressure = pressures_from_bench(body.pressure_kPa)
    serving = service.switch.now()
    check = serving.check(design, pressure)
    if body.source == "auto" and check.in_range and serving.model is not None:
        answer = surrogate_answer(serving.model, design, pressure, check)
        return replace(answer, effects=serving.effects).to_dict()
    job = await run_in_threadpool(
        service.submit_predict, serving, design, pressure, body.level, check
    )
    asked = body.model_dump(exclude_unset=True).get("wait_s", service.wait)
    job = await service.ended(job, asked)
    if job.status in OPEN:
        return accepted(job)
    if job.result is None:
        return _failed(job)
    return job.result


@router.post("/v1/check", responses=BODY | errors(503))
async def check(body: CheckIn, service: Shared) -> CheckOut:
    """What a request means, and whether the surrogate would answer it."""
    design = body.design.design()
    pressure = pressures_from_bench(body.pressure_kPa)
    found = service.switch.now().check(design, pressure)
    return CheckOut(
        design=design_columns(design),
        tip_margin_mm=rounded(design.tip_margin / MM),
        rim_mm=rounded(design.rim / MM),
        thickness_um=rounded(design.thickness / UM),
        in_range=found.in_range,
        reasons=list(found.reasons),
        notes=list(found.notes),
    )


@router.get("/v1/devices")
def devices() -> dict[str, Any]:
    """Named devices, and what a design or a request may hold."""
    return {
        "devices": [{"name": name, "cases": _cases(name)} for name in DEVICES],
        "materials_MPa": {name: e / 1e6 for name, e in MATERIALS.items()},
        "columns": limits_table(),
        "trained": [_trained(parameter.name) for parameter in DESIGN_SPACE],
        "pressure_kPa": {
            "lower": PRESSURE_RANGE[0],
            "upper": PRESSURE_RANGE[1],
            "max_count": MAX_STEPS,
        },
        "quantities": [
            {
                "name": BY_FIELD[output.name].name,
                "unit": BY_FIELD[output.name].unit,
                "long_name": output.long_name,
            }
            for output in OUTPUTS
        ],
    }


def _cases(name: str) -> list[dict[str, Any]]:
    return [
        {
            "case": case,
            "upper_material": upper,
            "lower_material": lower,
            "design": design_columns(named_device(name, case)),
        }
        for case, (upper, lower) in CASES.items()
    ]


def _trained(field: str) -> dict[str, Any]:
    """A row of the sampled space; two of its variables are no columns of a design."""
    parameter = DESIGN_SPACE[field]
    bench = BY_FIELD.get(field)
    name, factor = (bench.name, bench.factor) if bench else (f"{field}_mm", MM)
    return {
        "name": name,
        "lower": rounded(parameter.lower / factor),
        "upper": rounded(parameter.upper / factor),
    }


@router.get("/v1/effects")
def effects() -> dict[str, Any]:
    """The catalogue of effects; their parameters are in SI units."""
    from datagen.effects import catalogue

    rows = [
        {
            "name": effect.name,
            "stage": effect.stage,
            "doc": effect.doc,
            "parameters": [asdict(parameter) for parameter in effect.parameters],
        }
        for effect in catalogue().values()
    ]
    return {"effects": plain(rows)}


def known_effects(names: list[str], own: Sequence[str] = ()) -> None:
    """Refuse names that neither the catalogue nor `own` has, or that come twice.

    Raises
    ------
    InputError
    """
    from datagen.effects import catalogue

    known = dict.fromkeys([*catalogue(), *own])
    for name in names:
        if name not in known:
            raise InputError("effects", name, ", ".join(known))
        if names.count(name) > 1:
            raise InputError("effects", name, "each effect once")


@router.post(
    "/v1/datasets",
    status_code=202,
    response_model=JobOut,
    responses=ACCEPTED | BODY | errors(503),
)
def generate_dataset(body: DatasetIn, service: Shared) -> Response:
    """Generate a dataset as a job; its file is then at ``/v1/jobs/ID/file``."""
    known_effects(body.effects)
    folder = service.state / "datasets"
    folder.mkdir(parents=True, exist_ok=True)
    payload = body.model_dump() | {"out": str(folder / f"{uuid.uuid4().hex}.h5")}
    return accepted(service.store.submit("dataset", payload))


@router.get("/v1/jobs")
def jobs(
    service: Shared, limit: Annotated[int, Query(ge=1, le=1000)] = 50
) -> list[JobOut]:
    """Jobs, the newest first."""
    return [_job(job) for job in service.store.latest(limit)]


@router.get("/v1/jobs/{job_id}", responses=errors(404))
def job(job_id: str, service: Shared) -> JobOut:
    """A job as it stands."""
    return _job(service.store.get(job_id))


@router.delete("/v1/jobs/{job_id}", responses=errors(404))
def cancel(job_id: str, service: Shared) -> JobOut:
    """Cancel a job; one that has ended stays as it is."""
    return _job(service.store.cancel(job_id))


@router.get(
    "/v1/jobs/{job_id}/file", response_class=FileResponse, responses=errors(404)
)
def job_file(job_id: str, service: Shared) -> FileResponse:
    """The file that a job has made."""
    result = service.store.get(job_id).result or {}
    if "file" not in result:
        raise JobNotFound(f"job {job_id!r} has no file (yet)")
    path = Path(result["file"])
    if not path.is_file():
        raise JobNotFound(f"job {job_id!r}: {path.name} is no longer there")
    return FileResponse(path, filename=f"{job_id}{path.suffix}")


@router.post("/v1/figures/response", responses=BODY)
def response_figure(body: FigureIn) -> dict[str, Any]:
    """Curves of one or more answers against pressure, as a Plotly figure."""
    answers = [answer.model_dump() for answer in body.answers]
    return figures.response_figure(answers, body.quantities)


@router.post("/v1/figures/device", responses=BODY)
def device_figure(design: DesignIn) -> dict[str, Any]:
    """The device to scale, from above and cut along its middle, as a Plotly figure."""
    return figures.device_figure(design.design())


@router.get("/healthz", responses=errors(503))
def health(service: Shared) -> dict[str, Any]:
    """Whether the server answers, with what; `problem` says why not with another."""
    serving = service.switch.now()
    return {
        "status": "ok",
        "model_version": serving.model_version,
        "problem": serving.problem,
    }


def _job(job: Job) -> JobOut:
    at = datetime.datetime.fromtimestamp(job.submitted, datetime.UTC)
    return JobOut.model_validate(
        asdict(job) | {"submitted": at.isoformat(timespec="seconds")}
    )


def accepted(job: Job) -> JSONResponse:
    """202, with the job and where it is."""
    where = {"Location": f"/v1/jobs/{job.id}", "Retry-After": "1"}
    return JSONResponse(_job(job).model_dump(), 202, headers=where)


def _failed(job: Job) -> Response:
    error = job.error or {"type": "cancelled", "message": f"job {job.id} was cancelled"}
    status = {"input": 422, "effect": 422, "cancelled": 409}.get(error["type"], 500)
    return JSONResponse({"error": error}, status)
