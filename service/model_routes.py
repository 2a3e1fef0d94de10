"""The endpoints of model versions: which there are, which one answers, adopting."""

from __future__ import annotations

import uuid
from typing import Annotated, Any

from fastapi import APIRouter, Query
from fastapi.responses import Response

from .adoption import version_json, version_row
from .answer import COVERAGE
from .bench import plain
from .discrepancy_routes import ACCEPTED, payload_of, submit
from .jobs import payload_key
from .routes import BODY, Service, Shared, accepted, errors, known_effects
from .schemas import AdoptionIn, JobOut, SurrogateIn, UseIn

router = APIRouter(responses=errors(422, 500))


@router.get("/v1/models")
def models(service: Shared) -> dict[str, Any]:
    """The base model and the workspace's versions; `current` names what answers."""
    home, serving = service.switch.workspace, service.switch.now()
    base = service.switch.base
    rows: list[dict[str, Any]] = [
        {
            "name": base.name,
            "version": base.model_version,
            "coverage": COVERAGE,
            "description": plain(base.base.description),
            "effects": [],
            "in_use": serving.version is None,
        }
    ]
    for one in home.entries():
        row: dict[str, Any] = {"name": one.name, "in_use": one.name == serving.name}
        if one.version is None:
            rows.append(row | {"version": None, "problem": one.problem})
        else:
            trained = one.version.surrogate is not None
            rows.append(row | version_row(one.version) | {"surrogate": trained})
    return {
        "models": rows,
        "current": serving.name,
        "workspace": str(home.folder),
        "problem": service.switch.problem,
    }


@router.get("/v1/models/{name}", responses=errors(404))
def model(name: str, service: Shared) -> dict[str, Any]:
    """A version by its name or id: effects, sizes, ladder, measurements, code."""
    found = service.switch.workspace.find(name)
    assert found.version is not None  # find refuses what cannot be read
    in_use = found.name == service.switch.now().name
    about: dict[str, Any] = plain(version_json(found.version))
    return {"name": found.name, "in_use": in_use} | about


@router.put("/v1/models/current", responses=BODY)
def use(body: UseIn, service: Shared) -> dict[str, Any]:
    """Put a version into use, or ``baseline``; requests under way end as they began."""
    service.switch.workspace.use(body.model)
    return _in_use(service)


@router.post("/v1/models/undo")
def undo(service: Shared) -> dict[str, Any]:
    """Go back to what was in use before."""
    service.switch.workspace.undo()
    return _in_use(service)


@router.delete("/v1/models/{name}")
def remove(
    name: str,
    service: Shared,
    force: Annotated[
        bool, Query(description="also where it is in use, or a parent")
    ] = False,
) -> dict[str, Any]:
    """Delete a version; one that is in use or a parent of others only by force."""
    lines = service.switch.workspace.remove(name, force)
    return _in_use(service) | {"notes": list(lines)}


def _in_use(service: Service) -> dict[str, Any]:
    serving = service.switch.now()
    return {
        "current": serving.name,
        "version": serving.model_version,
        "effects": list(serving.effects),
    }


@router.post(
    "/v1/models/{name}/surrogate",
    status_code=202,
    response_model=JobOut,
    responses=ACCEPTED | BODY | errors(503),
)
def train(name: str, body: SurrogateIn, service: Shared) -> Response:
    """Train the surrogate of a version, as ``pba models train --json`` says it.

    When the job is done it answers in range; until then the finite elements do.
    """
    found = service.switch.workspace.find(name)
    assert found.version is not None
    # Each new beginning has a name: a job that is run again after a kill goes on.
    restart = {"restart": uuid.uuid4().hex if body.restart else ""}
    payload = {"folder": str(found.version.folder), **body.model_dump(), **restart}
    key = payload_key(payload, "surrogate", found.version.version, service.release)
    return accepted(service.store.submit("surrogate", payload, key))


@router.post(
    "/v1/adoptions",
    status_code=202,
    response_model=JobOut,
    responses=ACCEPTED | BODY | errors(404, 503),
)
def adopt(body: AdoptionIn, service: Shared) -> Response:
    """Put effects into the model, as ``pba adopt --json`` says it.

    The new version is in the workspace under `model` when the job is done, in use
    where `use` says so; the report, one HTML page, is then at ``/v1/jobs/ID/file``.
    """
    known_effects(body.effects)
    home = service.switch.workspace
    parent = home.find(body.on).name if body.on else ""
    payload = payload_of(body, service) | {
        "effects": body.effects,
        "workspace": str(home.folder),
        "model": body.model,
        "on": parent,
        "use": body.use,
    }
    return accepted(submit(service, "adopt", payload))
