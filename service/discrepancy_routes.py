"""The endpoints of measurements, comparisons and rankings, and of what follows.

Measurements are sent once and named by their id; comparing, ranking and adopting are
jobs, whose results are what the commands print with ``--json``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import JSONResponse, Response

from datagen.errors import InputError

from .jobs import Job, payload_key
from .measurements import NAMELESS, MeasurementFiles, own_name, tolerances
from .routes import ACCEPTED, BODY, Service, Shared, accepted, errors, known_effects
from .schemas import AdoptionIn, JobOut, MeasuredIn, MeasurementsOut, RankingIn
from .tasks import fem_version

router = APIRouter(responses=errors(422, 500))


KEPT: dict[int | str, dict[str, Any]] = {
    201: {
        "headers": {
            "Location": {
                "description": "where the measurements are",
                "schema": {"type": "string"},
            }
        }
    }
}


def files_of(service: Service) -> MeasurementFiles:
    """The measurement files that this server keeps."""
    return MeasurementFiles(service.state / "measurements")


@router.post(
    "/v1/measurements",
    status_code=201,
    response_model=MeasurementsOut,
    responses=KEPT | BODY,
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {
                "text/csv": {"schema": {"type": "string"}},
                "multipart/form-data": {
                    "schema": {
                        "type": "object",
                        "properties": {"file": {"type": "string", "format": "binary"}},
                        "required": ["file"],
                    }
                },
            },
        }
    },
)
async def send_measurements(
    request: Request,
    service: Shared,
    name: Annotated[
        str | None,
        Query(description="of the file; its own in a form", max_length=100),
    ] = None,
) -> Response:
    """Keep a measurement file, the body or sent in a form; measurement-format.md."""
    own, content = await _sent(request)
    name = name or own
    if not content:
        raise InputError("body", "empty", "the bytes of a CSV file")
    files = files_of(service)
    identity = await run_in_threadpool(files.add, name, content)
    found = await run_in_threadpool(files.describe, identity)
    where = {"Location": f"/v1/measurements/{identity}"}
    return JSONResponse(found, 201, headers=where)


async def _sent(request: Request) -> tuple[str, bytes]:
    """Name and bytes of the file in a request: its body, or in a form.

    Raises
    ------
    InputError
        When a form has not exactly one file.
    """
    kind = request.headers.get("content-type", "").lower()
    if not kind.startswith("multipart/form-data"):
        return NAMELESS, await request.body()
    async with request.form() as form:
        files = [one for _, one in form.multi_items() if not isinstance(one, str)]
        if len(files) != 1:
            raise InputError("form", f"{len(files)} files", "one file")
        return own_name(files[0].filename or "") or NAMELESS, await files[0].read()


@router.get("/v1/measurements")
def list_measurements(service: Shared) -> dict[str, list[dict[str, str]]]:
    """Kept files, the newest first."""
    kept = files_of(service).names()
    return {"measurements": [{"id": one, "name": kept[one]} for one in kept]}


@router.get("/v1/measurements/{identity}", responses=errors(404))
def get_measurements(identity: str, service: Shared) -> MeasurementsOut:
    """What is in a kept file."""
    return MeasurementsOut(**files_of(service).describe(identity))


@router.delete("/v1/measurements/{identity}", status_code=204, responses=errors(404))
def remove_measurements(identity: str, service: Shared) -> Response:
    """Forget a file; jobs that have ended keep their results."""
    files_of(service).remove(identity)
    return Response(status_code=204)


def payload_of(body: MeasuredIn | AdoptionIn, service: Service) -> dict[str, Any]:
    """What all jobs on measurements share."""
    allowed = tolerances(
        body.modulus_tolerance_pct,
        body.thickness_tolerance_um,
        body.camera_tolerance_pct,
    )
    asked = body.measurements
    if not isinstance(asked, str) and len(set(asked)) < len(asked):
        raise InputError("measurements", ", ".join(asked), "every id once")
    files = files_of(service)
    return {
        "files": [
            str(files.path(one))
            for one in ([asked] if isinstance(asked, str) else asked)
        ],
        "tolerances": asdict(allowed),
        "level": body.level,
        "seed": body.seed,
        "cache": str(service.state / "solves"),
    }


def submit(
    service: Service,
    kind: str,
    payload: dict[str, Any],
    stands: Callable[[Job], bool] = lambda _done: True,
) -> Job:
    """Accept a job; the same question asked again is the same job while it stands."""
    key = payload_key(payload, kind, fem_version(payload["level"]), service.release)
    out = {} if kind == "compare" else {"out": _report(service, kind, key)}
    return service.store.submit(kind, payload | out, key, stands)


def _report(service: Service, kind: str, key: str) -> str:
    name = hashlib.sha256(key.encode()).hexdigest()[:16]
    return str(service.state / "reports" / f"{kind}-{name}.html")


@router.post(
    "/v1/comparisons",
    status_code=202,
    response_model=JobOut,
    responses=ACCEPTED | BODY | errors(404, 503),
)
def compare(body: MeasuredIn, service: Shared) -> Response:
    """The model against measurements, as ``pba compare --json`` says it."""
    return accepted(submit(service, "compare", payload_of(body, service)))


@router.post(
    "/v1/rankings",
    status_code=202,
    response_model=JobOut,
    responses=ACCEPTED | BODY | errors(404, 503),
)
def rank(body: RankingIn, service: Shared) -> Response:
    """Which effect is missing, as ``pba rank --json`` says it.

    The report, one HTML page, is then at ``/v1/jobs/ID/file``.
    """
    known_effects(body.effects)
    payload = payload_of(body, service) | {"effects": body.effects or None}
    return accepted(submit(service, "rank", payload))
