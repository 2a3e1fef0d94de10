"""The endpoints of model versions: which there are, which one answers, adopting."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any

from fastapi import APIRouter, Query
from fastapi.responses import Response

from datagen.errors import FileError, InputError
from discrepancy.folder import read, vacant
from discrepancy.layout import BASELINE, is_version
from discrepancy.version import ModelVersion
from discrepancy.workspace import UnknownModel, Workspace, place

from .adopted import made_before, possible
from .adoption import version_json, version_row
from .answer import COVERAGE
from .bench import plain
from .current import ModelNotFound, Serving
from .discrepancy_routes import payload_of, submit
from .discrepancy_tasks import measured_of
from .jobs import Job, payload_key
from .routes import ACCEPTED, BODY, Service, Shared, accepted, errors, known_effects
from .schemas import AdoptionIn, JobOut, SurrogateIn, UseIn
from .surrogates import about as told
from .surrogates import load

router = APIRouter(responses=errors(422, 500))


@router.get("/v1/models")
def models(service: Shared) -> dict[str, Any]:
    """The base model and the workspace's versions; `current` names what answers.

    `problem` says why it is another one than the workspace's, or none.
    """
    home, serving = service.switch.workspace, service.switch.look()
    rows = [_base(service, serving)]
    for one in home.entries():
        row: dict[str, Any] = {"name": one.name, "in_use": _answers(one.name, serving)}
        if one.version is None:
            rows.append(row | {"version": None, "problem": one.problem})
        else:
            trained = one.version.surrogate is not None
            rows.append(row | version_row(one.version) | {"surrogate": trained})
    return {
        "models": rows,
        "current": None if serving is None else serving.name,
        "workspace": str(home.folder),
        "problem": service.switch.problem if serving is None else serving.problem,
    }


@router.get("/v1/models/{name}", responses=errors(404))
def model(name: str, service: Shared) -> dict[str, Any]:
    """A version by its name or id: effects, sizes, ladder, measurements, code."""
    if service.switch.is_base(name):
        return _base(service, service.switch.look())
    found, version = _version(name, service)
    about: dict[str, Any] = plain(version_json(version))
    return {"name": found, "in_use": _answers(found, service.switch.look())} | about


@router.put("/v1/models/current", responses=BODY)
def use(body: UseIn, service: Shared) -> dict[str, Any]:
    """Put a version into use, or ``baseline``; requests under way end as they began.

    One that is damaged, or whose surrogate is, is refused.
    """
    service.switch.use(body.model)
    return _in_use(service)


@router.post("/v1/models/undo")
def undo(service: Shared) -> dict[str, Any]:
    """Go back to what was in use before."""
    service.switch.undo()
    return _in_use(service)


@router.delete("/v1/models/{name}", responses=errors(404))
def remove(
    name: str,
    service: Shared,
    force: Annotated[
        bool, Query(description="also where it is in use, or a parent")
    ] = False,
) -> dict[str, Any]:
    """Delete a version; one that is in use or a parent of others only by force."""
    named = BASELINE if service.switch.is_base(name) else name
    with _in_the_path():
        lines = service.switch.workspace.remove(named, force)
    return _in_use(service) | {"notes": list(lines)}


@contextmanager
def _in_the_path() -> Iterator[None]:
    """Where the path names a model that is not there, that is a 404."""
    try:
        yield
    except UnknownModel as error:
        raise ModelNotFound(str(error)) from error


def _version(name: str, service: Service) -> tuple[str, ModelVersion]:
    """Name and content of the version that the path names."""
    with _in_the_path():
        found = service.switch.workspace.find(name)
    assert found.version is not None  # find refuses what cannot be read
    return found.name, found.version


def _base(service: Service, serving: Serving | None) -> dict[str, Any]:
    """The model without adopted effects."""
    base = service.switch.base
    return {
        "name": base.name,
        "version": base.model_version,
        "coverage": COVERAGE,
        "description": plain(base.base.description),
        "effects": [],
        "in_use": serving is not None and serving.version is None,
    }


def _answers(name: str, serving: Serving | None) -> bool:
    """Whether the version of this name is what answers."""
    return serving is not None and serving.version is not None and serving.name == name


def _in_use(service: Service) -> dict[str, Any]:
    serving = service.switch.look()
    if serving is None:
        nothing: dict[str, Any] = {"current": None, "version": None, "effects": []}
        return nothing | {"problem": service.switch.problem}
    return {
        "current": serving.name,
        "version": serving.model_version,
        "effects": list(serving.effects),
        "problem": serving.problem,
    }


@router.post(
    "/v1/models/{name}/surrogate",
    status_code=202,
    response_model=JobOut,
    responses=ACCEPTED | BODY | errors(404, 503),
)
def train(name: str, body: SurrogateIn, service: Shared) -> Response:
    """Train the surrogate of a version, as ``pba models train --json`` says it.

    When the job is done it answers in range; until then the finite elements do.
    """
    if service.switch.is_base(name):
        raise InputError("model", name, "a version with adopted effects")
    _, version = _version(name, service)
    about = {"folder": str(version.folder), "version": version.version}
    # Each new beginning has a name: a job that is run again after a kill goes on.
    restart = {"restart": uuid.uuid4().hex if body.restart else ""}
    payload = about | body.model_dump() | restart
    key = payload_key(payload, "surrogate", service.release)

    def stands(done: Job) -> bool:
        """Whether the surrogate is the one that the job has left."""
        try:
            trained = load(version)
        except FileError:  # damaged since
            return False
        return trained is not None and plain(told(trained)) == done.result

    return accepted(service.store.submit("surrogate", payload, key, stands))


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
    home = service.switch.workspace
    parent = None
    if body.on and not service.switch.is_base(body.on):
        parent = home.find(body.on, "on").version
    known_effects(body.effects, () if parent is None else parent.effects)
    payload = payload_of(body, service) | {
        "effects": body.effects,
        "workspace": str(home.folder),
        "model": body.model,
        "on": "" if parent is None else parent.version,
        "use": body.use,
    }
    _refuse_taken(payload, home, parent)
    possible(body.effects, measured_of(payload), parent)
    folder = home.folder / body.model

    def stands(done: Job) -> bool:
        """Whether the version is as the job has left it, and in use if asked for."""
        if done.result is None or not is_version(folder):
            return False
        whole = read(folder).version == done.result["version"]
        return whole and (not body.use or home.current_name == body.model)

    return accepted(submit(service, "adopt", payload, stands))


def _refuse_taken(
    payload: dict[str, Any], home: Workspace, parent: ModelVersion | None
) -> None:
    """Refuse a name that something else than this very adoption has.

    Raises
    ------
    InputError
    """
    name = payload["model"]
    folder, _ = place(name, home.folder, "model")
    if not folder.exists():
        return
    given = (payload["effects"], measured_of(payload), parent)
    try:
        if made_before(folder, *given, payload["level"], payload["seed"]) is None:
            vacant(folder)
    except FileError as error:
        allowed = "a name that is not taken in the workspace"
        raise InputError("model", name, allowed) from error
