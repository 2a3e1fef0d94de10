"""The service: predictions over HTTP, long work as jobs, and the web page.

`create_app` puts the parts together: routes, the job store, the page, and the one table
that turns the project's errors into HTTP.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata, resources
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from fastapi.staticfiles import StaticFiles
from starlette.exceptions import HTTPException

from datagen.errors import EffectError, FileError, InputError, PbaError
from datagen.units import DESIGN, PRESSURE
from discrepancy.table import MeasurementError
from discrepancy.workspace import Workspace, default_workspace

from .answer import Predictor, load_model
from .bench import MISSING, Words, allowed, count_words, pressure_words
from .current import ModelNotFound, NoModel, Switch
from .discrepancy_routes import router as discrepancy_router
from .jobs import JobNotFound, JobStore, Kind, TooManyJobs, describe
from .measurements import MeasurementsNotFound
from .model_routes import router as model_router
from .protocol import BodyLimit, HeadAsGet, OwnPagesAlone, methods_of
from .routes import Service, router
from .tasks import fem_version
from .workers import WorkerDied

HTTP_STATUS: tuple[tuple[type[PbaError], int], ...] = (
    (InputError, 422),
    (EffectError, 422),
    (JobNotFound, 404),
    (MeasurementsNotFound, 404),
    (ModelNotFound, 404),
    (MeasurementError, 422),
    (TooManyJobs, 503),
    (NoModel, 503),
    (WorkerDied, 500),
    (FileError, 500),
    (PbaError, 500),
)
"""The table from errors to HTTP; the first that fits counts."""

KINDS: Mapping[str, Kind] = {
    "predict": Kind("service.tasks:predict", max(1, (os.cpu_count() or 2) // 2)),
    "dataset": Kind("service.tasks:dataset"),
    "compare": Kind("service.discrepancy_tasks:compare"),
    "rank": Kind("service.discrepancy_tasks:rank"),
    "adopt": Kind("service.discrepancy_tasks:adopt"),
    "surrogate": Kind("service.discrepancy_tasks:surrogate"),
}
"""Kinds of jobs.  Each has its own workers: a dataset of hours blocks no prediction."""

FURTHER_WORDS = {"case": "1, 2, 3 or 4"}
"""What is allowed, in better words than pydantic's."""

UNITS = {"s": "s", "pct": "%", "um": "um", "minutes": "min"}
"""Of fields that are no design's, by the end of their names."""

LONGEST = 2000
"""Characters of an error's parts."""

PAGE = Path(__file__).parent / "page"

CONTENT_SECURITY = (
    "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
"""The page runs its own scripts alone and talks to its own server alone; Plotly writes
its styles into the page and needs the one exception."""


def default_state() -> Path:
    """Where jobs are kept: ``PBA_STATE``, or ``~/.local/state/pba``."""
    given = os.environ.get("PBA_STATE")
    return Path(given) if given else Path.home() / ".local" / "state" / "pba"


@dataclass(frozen=True)
class Settings:
    """How one server runs.

    Parameters
    ----------
    state : Path
        Folder of the jobs and their files, those of each workspace in a folder of
        their own.
    model : Path, optional
        Folder of the ensemble; the shipped reference model where not given.
    database_url : str, optional
        PostgreSQL for the jobs, in place of SQLite in the state folder.
    wait : float, s
        How long a request waits for the finite elements before it answers 202.
    workspace : Path
        Folder of the model versions; the one in use there answers.  A relative path
        counts from the current folder of now, not from that of a later restart.
    kinds : mapping of str to Kind
    fem_version : callable
        From mesh level to what makes the numbers of the finite elements.
    """

    state: Path = field(default_factory=default_state)
    model: Path | None = None
    database_url: str | None = None
    wait: float = 20.0
    workspace: Path = field(default_factory=default_workspace)
    kinds: Mapping[str, Kind] = field(default_factory=lambda: KINDS)
    fem_version: Callable[[str], str] = fem_version

    def __post_init__(self) -> None:
        if not 0 <= self.wait <= 3600:
            raise InputError("--wait", self.wait, "a number from 0 to 3600 s", "s")
        for name in ("state", "workspace"):
            object.__setattr__(self, name, getattr(self, name).resolve())

    @property
    def kept(self) -> Path:
        """Where jobs and files of this workspace are kept, apart from all others'."""
        name = hashlib.sha256(os.fsencode(self.workspace)).hexdigest()[:16]
        return self.state / name

    def open_store(self) -> JobStore:
        """The job store of this server.

        Raises
        ------
        InputError
            When another server uses the state folder for this workspace.
        FileError
            When the state folder or the database cannot be used.
        """
        return JobStore(self.kept, self.kinds, self.database_url)


def create_app(
    settings: Settings | None = None,
    load_model: Callable[[Path | None], Predictor] = load_model,
    store: JobStore | None = None,
) -> FastAPI:
    """The application, to be run by any ASGI server in a single process.

    Parameters
    ----------
    settings : Settings, optional
    load_model : callable
        From the folder of a model, or None for the reference model, to the model.
    store : JobStore, optional
        Opened already; by default the one of `settings` is opened at startup.  It is
        closed at shutdown in either case.

    Raises
    ------
    FileError
        When the model is missing or corrupt.
    """
    chosen = Settings() if settings is None else settings
    model = load_model(chosen.model)
    name = "reference" if chosen.model is None else chosen.model.name

    @contextlib.asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        jobs = chosen.open_store() if store is None else store
        app.state.service = Service(
            Switch(model, name, Workspace(chosen.workspace)),
            jobs,
            chosen.kept,
            chosen.wait,
            chosen.fem_version,
            version(),
        )
        try:
            yield
        finally:
            jobs.close()

    app = FastAPI(
        title="pba",
        summary="What a pneumatic balloon actuator does at a pressure",
        description=(
            "Lengths, pressures and moduli are in bench units, which are part of the "
            "name: `upper_thickness_um`. Errors have one shape, `ErrorOut`."
        ),
        version=version(),
        lifespan=lifespan,
        docs_url=None,  # both would fetch their scripts from elsewhere;
        redoc_url=None,  # the schema itself is at /openapi.json
    )
    app.include_router(router)
    app.include_router(discrepancy_router)
    app.include_router(model_router)
    _add_error_handlers(app)
    _add_page(app)
    for middleware in (BodyLimit, HeadAsGet, OwnPagesAlone):
        app.add_middleware(middleware)
    return app


def version() -> str:
    """Version of the installed package."""
    try:
        return metadata.version("pba")
    except metadata.PackageNotFoundError:  # run from a source tree
        return "0+source"


def status_of(error: PbaError) -> int:
    """HTTP status of an error of the project."""
    return next(status for kind, status in HTTP_STATUS if isinstance(error, kind))


def _add_error_handlers(app: FastAPI) -> None:
    def answer(status: int, **error: Any) -> JSONResponse:
        headers = {"Retry-After": "5"} if status == 503 else None
        told = {name: _bounded(one) for name, one in error.items()}
        return JSONResponse({"error": told}, status, headers)

    @app.exception_handler(PbaError)
    async def of_the_project(_request: Request, error: PbaError) -> JSONResponse:
        return answer(status_of(error), **describe(error))

    @app.exception_handler(RequestValidationError)
    async def of_the_body(
        request: Request, error: RequestValidationError
    ) -> JSONResponse:
        first = error.errors()[0]
        if first["type"] == "json_invalid":
            reason = first.get("ctx", {}).get("error", "")
            message = f"the body is not JSON: {reason} at character {first['loc'][-1]}"
            return answer(400, type="json", message=message)
        if isinstance(first.get("input"), bytes):
            sent = request.headers.get("content-type", "no type")
            allowed = "a JSON object, sent with Content-Type: application/json"
            message = f"body: sent as {sent[:60]}; allowed: {allowed}"
            return answer(415, type="media_type", message=message)
        return answer(422, **describe(input_error(first)))

    @app.exception_handler(HTTPException)
    async def of_the_protocol(request: Request, error: HTTPException) -> JSONResponse:
        words = {404: "not_found", 405: "method", 413: "too_large"}
        response = answer(
            error.status_code,
            type=words.get(error.status_code, "request"),
            message=str(error.detail),
        )
        response.headers.update(error.headers or {})
        if error.status_code == 405:
            response.headers["Allow"] = methods_of(app, request.url.path)
        return response

    @app.exception_handler(Exception)
    async def of_nobody(_request: Request, _error: Exception) -> JSONResponse:
        # The traceback goes to the server's log, not to the client.
        return answer(
            500, type="internal", message="internal error; see the server log"
        )


def input_error(problem: Mapping[str, Any]) -> InputError:
    """One finding of pydantic in the words of the project.

    Parameters
    ----------
    problem : mapping
        An item of ``ValidationError.errors()``, its ``loc`` starting in ``body``.
    """
    location = [part for part in problem["loc"] if part not in ("body", "query")]
    value = _shown(problem.get("input"))
    if problem["type"] == "unknown_field":
        found = _shown(problem["ctx"]["name"])
        where = _name(location) if location else "body"
        return InputError(where, found, problem["ctx"]["allowed"])
    if not location:
        return InputError(
            "body", value, "a JSON object, sent with Content-Type: application/json"
        )
    name, field = str(location[-1]), _name(location)
    if problem["type"] == "missing":
        return InputError(field, MISSING, "a value; this field is needed")
    if name in DESIGN:
        return InputError(name, value, allowed(DESIGN[name]), DESIGN[name].unit)
    if name == PRESSURE.name:
        return InputError(field, value, count_words())
    if PRESSURE.name in location:
        return InputError(field, value, pressure_words(), PRESSURE.unit)
    words = str(problem["msg"]).removeprefix("Input should be ")
    unit = UNITS.get(name.rpartition("_")[2], "")
    if problem["type"] in ("greater_than_equal", "less_than_equal"):
        words = f"{words} {unit}".rstrip()
    return InputError(field, value, FURTHER_WORDS.get(name, words), unit)


def _bounded(value: object) -> object:
    """Part of an error that can be sent, whatever the client sent.

    JSON may hold halves of a character, which no answer can.
    """
    if not isinstance(value, str):
        return value
    value = value.encode(errors="backslashreplace").decode()
    return value if len(value) <= LONGEST else f"{value[:LONGEST]}..."


def _shown(value: object) -> object:
    """A value for an error: short, whatever was sent."""
    if isinstance(value, (dict, list)):
        return Words("a list" if isinstance(value, list) else "an object")
    if isinstance(value, (str, bytes)) and len(value) > 60:
        return Words(f"{value[:60]!r}...")
    return value


def _name(location: Sequence[object]) -> str:
    """``("pressure_kPa", 3)`` as ``pressure_kPa[3]``, ``("design", "a")`` as ``a``."""
    names = [str(part) for part in location if isinstance(part, str)]
    index = f"[{location[-1]}]" if isinstance(location[-1], int) else ""
    return (names[-1] if names else "body") + index


def _add_page(app: FastAPI) -> None:
    plotly = Path(str(resources.files("plotly"))) / "package_data" / "plotly.min.js"

    static = StaticFiles(directory=PAGE)

    def sent(file: Path, request: Request) -> Response:
        """A file, or that the client has it already."""
        return static.file_response(file, file.stat(), request.scope)

    @app.get("/", include_in_schema=False)
    def page(request: Request) -> Response:
        response = sent(PAGE / "index.html", request)
        response.headers["Content-Security-Policy"] = CONTENT_SECURITY
        response.headers["Cache-Control"] = "no-cache"
        return response

    @app.get("/static/plotly.min.js", include_in_schema=False)
    def plotly_script(request: Request) -> Response:
        response = sent(plotly, request)
        response.headers["Cache-Control"] = "public, max-age=86400"
        return response

    app.mount("/static", static, name="static")
