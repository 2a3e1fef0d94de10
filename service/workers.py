"""Processes that do the long work, one task at a time, and can be killed in it.

`concurrent.futures` cannot stop a task that has started.  A solve takes seconds, a
dataset hours, and both must stop when their job is cancelled: so each worker is a
process of its own behind a pipe, which also carries its progress.
"""

from __future__ import annotations

import atexit
import importlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection, wait
from typing import Any

from datagen.errors import PbaError

Report = Callable[[Mapping[str, Any]], None]
"""Called by a task with its progress."""

Task = Callable[[Mapping[str, Any], Report], dict[str, Any]]
"""What a worker runs: from a payload to a result, both JSON."""

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)


class WorkerDied(PbaError):
    """The process of a task ended before the task did."""


def task(name: str) -> Task:
    """The function behind ``module:function``."""
    module, _, function = name.partition(":")
    return getattr(importlib.import_module(module), function)  # type: ignore[no-any-return]


class Worker:
    """One spawned process; started by its first task, kept warm for the next ones."""

    def __init__(self) -> None:
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        # Python waits for its processes at exit; an idle one would wait for us.
        atexit.register(self.kill)

    def run(self, name: str, payload: Mapping[str, Any], report: Report) -> Any:
        """Run a task to its end.

        Parameters
        ----------
        name : str
            The task, as ``module:function``.
        payload : mapping
        report : callable
            Called here with each progress that the task reports.

        Raises
        ------
        PbaError
            As the task raised it.
        WorkerDied
            When the process ended first: killed, out of memory, or an unforeseen
            error, whose traceback is on the standard error of the server.
        """
        pipe = self._start()
        try:
            pipe.send((name, payload))
            while True:
                kind, content = pipe.recv()
                if kind == "progress":
                    report(content)
                elif kind == "error":
                    raise content
                else:
                    return content
        except (EOFError, ConnectionError) as end:
            raise WorkerDied(self._last_words()) from end

    def kill(self) -> None:
        """End the process and all that it started, at once."""
        process = self._process
        if process is None or process.pid is None:
            return
        if process.is_alive() and hasattr(os, "killpg"):
            try:
                os.killpg(process.pid, signal.SIGKILL)
            except ProcessLookupError:  # too young to have its own group
                process.kill()
        elif process.is_alive():
            process.kill()
        process.join()

    def _start(self) -> Connection:
        if self._process is not None and self._process.is_alive() and self._pipe:
            return self._pipe
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(theirs,), name="pba-worker"
        )
        self._process.start()
        theirs.close()
        return self._pipe

    def _last_words(self) -> str:
        assert self._process is not None
        self._process.join()
        return (
            f"the worker process ended with code {self._process.exitcode}; the log of "
            "the server says more unless it was killed or ran out of memory"
        )


def _serve(pipe: Connection) -> None:
    """Body of a worker process: tasks from the pipe until its other end closes."""
    for variable in THREAD_VARIABLES:  # before numpy is first imported
        os.environ[variable] = "1"
    if hasattr(os, "setsid"):
        os.setsid()  # Ctrl-C is for the server, and the group dies together
    threading.Thread(target=_die_with_parent, daemon=True).start()
    while True:
        try:
            name, payload = pipe.recv()
        except EOFError:
            return
        try:
            result = task(name)(payload, lambda p: pipe.send(("progress", dict(p))))
        except PbaError as error:
            pipe.send(("error", error))
        else:
            pipe.send(("done", result))


def _die_with_parent() -> None:
    """End this process when the server is gone, even by kill -9.

    The restarted server runs the same job again; two writers must not meet.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        if hasattr(os, "killpg"):
            os.killpg(0, signal.SIGKILL)
        os._exit(1)
