"""Durable jobs: what was accepted is finished, whatever happens to the server.

A job is a kind and a payload.  DBOS keeps it in SQLite, or in PostgreSQL by a URL; a
server that is killed, even by ``kill -9``, runs its unfinished jobs again when it is
started on the same state folder.  The work itself is done in processes of
`service.workers`, so that it can be cancelled and never holds up the server.
"""

from __future__ import annotations

import hashlib
import json
import logging
import queue
import sqlite3
import threading
import time
import uuid
from collections.abc import Callable, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from datagen.errors import EffectError, FileError, InputError, PbaError
from discrepancy.table import MeasurementError

from .current import ModelNotFound, NoModel
from .measurements import MeasurementsNotFound
from .workers import Worker, WorkerDied

if TYPE_CHECKING:
    from collections.abc import Iterator

    from dbos import DBOSConfig, WorkflowStatus

DATABASE = "jobs.sqlite"
LOCK = "server.lock"
IDENTITY = "server.id"

STATUS = {
    "ENQUEUED": "queued",
    "DELAYED": "queued",
    "PENDING": "running",
    "SUCCESS": "done",
    "ERROR": "failed",
    "CANCELLED": "cancelled",
    "MAX_RECOVERY_ATTEMPTS_EXCEEDED": "failed",
}
"""What DBOS says of a workflow, in the words of the interface."""

_ONE = threading.Lock()
"""DBOS is one in a process, and so is the job store."""

OPEN = ("queued", "running")
"""Statuses of a job that is still going to change."""

MAX_OPEN = 100
"""Jobs that may wait or run at a time."""

MAX_RECOVERIES = 20
"""Restarts after which a job is taken for the cause of the crashes."""


class JobNotFound(PbaError):
    """No job has this id."""


class TooManyJobs(PbaError):
    """The server has as many open jobs as it takes."""


class _Stop(BaseException):
    """Leaves a workflow without an outcome: it is cancelled, or the server stops.

    DBOS records an `Exception` as the end of the workflow; this one it lets pass.
    """


ERROR_TYPES: tuple[tuple[type[PbaError], str], ...] = (
    (InputError, "input"),
    (MeasurementError, "measurements"),
    (FileError, "file"),
    (EffectError, "effect"),
    (WorkerDied, "worker"),
    (JobNotFound, "not_found"),
    (MeasurementsNotFound, "not_found"),
    (ModelNotFound, "not_found"),
    (TooManyJobs, "busy"),
    (NoModel, "no_model"),
    (PbaError, "error"),
)
"""Errors by the name they have in answers; the first that fits counts."""


@dataclass(frozen=True)
class Kind:
    """A kind of job: its task as ``module:function``, and how many run at a time."""

    task: str
    slots: int = 1


@dataclass(frozen=True)
class Job:
    """A job as it stands.

    Parameters
    ----------
    id, kind : str
    status : str
        ``queued``, ``running``, ``done``, ``failed`` or ``cancelled``.
    submitted : float, s since 1970
    progress : dict
        What the task last reported, empty while it has not.
    result : dict or None
        Of a job that is done.
    error : dict or None
        ``type`` and ``message`` of a job that failed.
    """

    id: str
    kind: str
    status: str
    submitted: float
    progress: dict[str, Any] = field(default_factory=dict)
    result: dict[str, Any] | None = None
    error: dict[str, Any] | None = None


def describe(error: PbaError) -> dict[str, Any]:
    """An error as data: ``type``, ``message``, and ``field``, ``allowed`` if known."""
    kind = next(
        name for error_type, name in ERROR_TYPES if isinstance(error, error_type)
    )
    out: dict[str, Any] = {"type": kind, "message": str(error)}
    if isinstance(error, InputError):
        out |= {"field": error.field, "allowed": error.allowed}
    if isinstance(error, MeasurementError):
        out["problems"] = [
            {"line": place.rpartition(":")[2], "message": text}
            for place, text in error.problems
        ]
    return out


@dataclass
class _Live:
    """What this process knows of a job that it runs."""

    worker: Worker | None = None
    progress: dict[str, Any] = field(default_factory=dict)
    cancelled: bool = False


class JobStore:
    """Jobs of one state folder.

    Parameters
    ----------
    state : Path
        Folder of the job database, made when missing; one server at a time.
    kinds : mapping of str to Kind
    database_url : str, optional
        PostgreSQL for the jobs of several servers, each with a state folder; none sees
        another's.

    Raises
    ------
    InputError
        When another server uses the folder.
    FileError
        When the folder cannot be made or read.
    """

    def __init__(
        self, state: Path, kinds: Mapping[str, Kind], database_url: str | None = None
    ) -> None:
        self._kinds = dict(kinds)
        self._live: dict[str, _Live] = {}
        self._guard = threading.Lock()
        self._submitting = threading.Lock()
        self._stopping = False
        self._workers: list[Worker] = []
        self._free: dict[str, queue.SimpleQueue[Worker]] = {}
        for name, kind in self._kinds.items():
            self._free[name] = queue.SimpleQueue()
            for _ in range(kind.slots):
                self._workers.append(Worker())
                self._free[name].put(self._workers[-1])
        if not _ONE.acquire(blocking=False):
            raise RuntimeError("DBOS allows one open job store in a process")
        try:
            self._lock = _lock(state)
            try:
                self._identity = _identity(state)
                self._launch(database_url or f"sqlite:///{state / DATABASE}")
            except BaseException:
                self._lock.close()
                raise
        except BaseException:
            _ONE.release()
            raise

    def _launch(self, url: str) -> None:
        from dbos import DBOS, DBOSPortableJSONSerializer
        from dbos import error as dbos_error
        from sqlalchemy.exc import SQLAlchemyError

        config: DBOSConfig = {
            "name": "pba",
            "system_database_url": url,
            # Fixed: a newer version of the program finishes the older one's jobs.
            "application_version": "1",
            "executor_id": self._identity,
            "log_level": "CRITICAL",  # a failure to launch is raised, in one line
            "serializer": DBOSPortableJSONSerializer(),
            # Not used here, but closing waits for its thread.
            "notification_listener_polling_interval_sec": 0.1,
        }
        try:
            DBOS(config=config)

            @DBOS.workflow(name="job", max_recovery_attempts=MAX_RECOVERIES)
            def job(kind: str, payload: dict[str, Any], submitted: float) -> Any:
                return self._run(kind, payload)

            self._workflow = job
            DBOS.launch()
        except (dbos_error.DBOSException, SQLAlchemyError) as error:
            DBOS.destroy(destroy_registry=True)
            reason = str(error).splitlines()[0]
            raise FileError(
                "job database", f"{_without_password(url)} cannot be used: {reason}"
            ) from error
        log = logging.getLogger("dbos")
        log.setLevel("ERROR")

    def submit(
        self,
        kind: str,
        payload: Mapping[str, Any],
        key: str | None = None,
        stands: Callable[[Job], bool] = lambda _done: True,
    ) -> Job:
        """Accept a job; once this returns, it survives the server.

        Parameters
        ----------
        kind : str
        payload : mapping
            JSON, without NaN.
        key : str, optional
            What makes this job the same as another one.  A job with this key that is
            open or done is returned in place of a new one.
        stands : callable
            Whether what a done job has brought about is still so; else it is done
            again.

        Raises
        ------
        TooManyJobs
        """
        if key is None:
            return self._start(f"{kind}-{uuid.uuid4().hex[:16]}", kind, payload)
        own = hashlib.sha256(f"{self._identity} {key}".encode()).hexdigest()[:16]
        job_id = f"{kind}-{own}"
        with self._submitting:
            earlier = self._find(prefix=job_id)
            for job in earlier:
                if job.status in OPEN or (job.status == "done" and stands(job)):
                    return job
            again = f"-{len(earlier) + 1}" if earlier else ""
            return self._start(job_id + again, kind, payload)

    def _start(self, job_id: str, kind: str, payload: Mapping[str, Any]) -> Job:
        from dbos import DBOS, SetWorkflowID

        if len(self._live) >= MAX_OPEN:
            raise TooManyJobs(f"{MAX_OPEN} jobs are open already; try again later")
        with SetWorkflowID(job_id):
            DBOS.start_workflow(self._workflow, kind, dict(payload), time.time())
        return self.get(job_id)

    def get(self, job_id: str) -> Job:
        """One job.

        Raises
        ------
        JobNotFound
        """
        from dbos import DBOS

        status = DBOS.get_workflow_status(job_id)
        if status is None or status.executor_id != self._identity:
            raise JobNotFound(f"no job has the id {job_id!r}")
        return self._job(status)

    def latest(self, limit: int = 50) -> list[Job]:
        """Jobs, the newest first."""
        return sorted(self._find(limit=limit), key=lambda job: -job.submitted)

    def cancel(self, job_id: str) -> Job:
        """Stop a job; one that has ended stays as it is.

        Raises
        ------
        JobNotFound
        """
        from dbos import DBOS

        if self.get(job_id).status in OPEN:
            DBOS.cancel_workflow(job_id)
            with self._guard:
                live = self._live.get(job_id)
            if live is not None:
                live.cancelled = True
                self._stop(job_id)
        return self.get(job_id)

    def close(self) -> None:
        """Stop the server's part; unfinished jobs go on when it is started again."""
        from dbos import DBOS

        self._stopping = True
        for job_id in list(self._live):
            self._stop(job_id)
        for worker in self._workers:
            worker.kill()
        DBOS.destroy(destroy_registry=True)
        self._lock.close()
        _ONE.release()

    def _stop(self, job_id: str) -> None:
        """Kill the worker of a job until the job has left it.

        Once is not enough: a job between taking its worker and starting the process
        would start it after the kill.
        """
        while (live := self._live.get(job_id)) is not None:
            if (worker := live.worker) is not None:
                worker.kill()
            time.sleep(0.02)

    def _find(self, prefix: str | None = None, limit: int | None = None) -> list[Job]:
        from dbos import DBOS

        found = DBOS.list_workflows(
            workflow_id_prefix=prefix,
            limit=limit,
            sort_desc=True,
            executor_id=self._identity,
        )
        return [self._job(status) for status in found]

    def _job(self, status: WorkflowStatus) -> Job:
        assert status.input is not None
        kind, _payload, submitted = status.input["args"]
        word = STATUS[status.status]
        live = self._live.get(status.workflow_id)
        if word == "running" and (live is None or live.worker is None):
            word = "queued"
        outcome: dict[str, Any] = status.output or {}
        error = outcome.get("error")
        if word == "failed":
            error = {
                "type": "worker",
                "message": f"the server died {MAX_RECOVERIES} times while this job ran"
                if status.status.startswith("MAX_RECOVERY")
                else f"internal error: {status.error}",
            }
        return Job(
            status.workflow_id,
            kind,
            "failed" if error else word,
            submitted,
            live.progress if live is not None and word in OPEN else {},
            outcome.get("result"),
            error,
        )

    def _run(self, kind: str, payload: dict[str, Any]) -> dict[str, Any]:
        """Body of every job: its outcome, a result or an error, as data."""
        from dbos import DBOS

        job_id = DBOS.workflow_id
        assert job_id is not None
        live = _Live()
        with self._guard:
            self._live[job_id] = live
        try:
            with self._worker(kind, live) as worker:
                result = worker.run(
                    self._kinds[kind].task, payload, live.progress.update
                )
            return {"result": result}
        except PbaError as error:
            if self._stopping or live.cancelled:
                raise _Stop from error
            return {"error": describe(error)}
        finally:
            with self._guard:
                del self._live[job_id]

    @contextmanager
    def _worker(self, kind: str, live: _Live) -> Iterator[Worker]:
        """Wait for a free worker of this kind, and give it back afterwards."""
        while True:
            if self._stopping or live.cancelled:
                raise _Stop
            try:
                worker = self._free[kind].get(timeout=0.2)
                break
            except queue.Empty:
                continue
        try:
            with self._guard:
                if self._stopping or live.cancelled:
                    raise _Stop
                live.worker = worker
            yield worker
        finally:
            with self._guard:
                live.worker = None
            self._free[kind].put(worker)


def _lock(state: Path) -> sqlite3.Connection:
    """Hold the state folder until this process ends, in whatever way it ends."""
    try:
        state.mkdir(parents=True, exist_ok=True)
        lock = sqlite3.connect(state / LOCK, timeout=0, check_same_thread=False)
    except (OSError, sqlite3.Error) as error:
        raise FileError(state, f"cannot be used as state folder: {error}") from error
    try:
        lock.execute("BEGIN EXCLUSIVE")
    except sqlite3.OperationalError as error:
        lock.close()
        raise InputError(
            "--state", str(state), "a folder that no other running server uses"
        ) from error
    except sqlite3.DatabaseError as error:
        lock.close()
        raise FileError(state / LOCK, f"cannot be read: {error}") from error
    return lock


def _identity(state: Path) -> str:
    """Name of this server among those that share a database: who takes up which job."""
    file = state / IDENTITY
    if not file.exists():
        file.write_text(f"pba-{uuid.uuid4().hex[:12]}", encoding="ascii")
    return file.read_text(encoding="ascii").strip()


def _without_password(url: str) -> str:
    from sqlalchemy import make_url
    from sqlalchemy.exc import ArgumentError

    try:
        return make_url(url).render_as_string(hide_password=True)
    except ArgumentError:
        return "the URL"


def payload_key(payload: Mapping[str, Any], *versions: str) -> str:
    """Text that two requests share exactly when their answer is the same."""
    return json.dumps([dict(payload), *versions], sort_keys=True, allow_nan=False)
