"""Solving many rows on whatever executor there is, and surviving its accidents."""

from __future__ import annotations

import signal
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from .errors import GenerationError, InputError
from .worker import Row, Solve, Task, run_task, start_worker

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

MAX_DEATHS = 3
"""How often one row may take its worker process down before it is given up."""

MAX_FAILURES = 5
"""Rows that fail unexpectedly before no more rows are begun."""

AHEAD = 2
"""Rows in flight for each worker: one being solved, one waiting, so none is idle."""

DASK_PATIENCE = 10
"""Seconds in which a Dask scheduler has to answer, at first or after a lost link."""


class Pool(Protocol):
    """What `solve_tasks` needs of an executor."""

    def submit(self, solve: Solve, task: Task) -> Future[Row]:
        """Start one row; BrokenExecutor where the workers are gone."""
        ...

    def window(self) -> int:
        """How many rows may be in flight."""
        ...

    def restart(self) -> None:
        """New workers for dead ones; GenerationError where that is impossible."""
        ...

    def close(self, now: bool) -> None:
        """Release the workers; `now` abandons the rows in flight."""
        ...


class ProcessPool:
    """Worker processes on this machine, single-threaded, each started afresh.

    They are spawned and not forked: a fork copies the locks of running BLAS and numba
    threads, held or not.
    """

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._start()

    def _start(self) -> None:
        from multiprocessing import get_context, resource_tracker

        context = get_context("spawn")
        resource_tracker.ensure_running()  # its start undoes `_ctrl_c_held`
        self._alive: tuple[Connection, Connection] = context.Pipe(duplex=False)
        self._executor = ProcessPoolExecutor(
            self._workers,
            mp_context=context,
            initializer=start_worker,
            initargs=(self._alive[0],),
        )

    def submit(self, solve: Solve, task: Task) -> Future[Row]:
        with _ctrl_c_held():
            return self._executor.submit(run_task, solve, task)

    def window(self) -> int:
        return AHEAD * self._workers

    def restart(self) -> None:
        self.close(now=True)
        self._start()

    def close(self, now: bool) -> None:
        reader, writer = self._alive
        if now:
            writer.close()  # the workers watch it and leave at once
        self._executor.shutdown(wait=True, cancel_futures=now)
        writer.close()
        reader.close()


@contextmanager
def _ctrl_c_held() -> Iterator[None]:
    """Hold Ctrl-C back; workers that are started meanwhile never receive it.

    It reaches the whole process group, and the parent alone decides what it means.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class GivenExecutor:
    """An executor that the caller owns; it is not shut down here."""

    def __init__(self, executor: Executor, workers: int) -> None:
        self._executor, self._workers = executor, workers
        self._begun: list[Future[Row]] = []

    def submit(self, solve: Solve, task: Task) -> Future[Row]:
        self._begun = [future for future in self._begun if not future.done()]
        future = self._executor.submit(run_task, solve, task)
        self._begun.append(future)
        return future

    def window(self) -> int:
        return AHEAD * self._workers

    def restart(self) -> None:
        raise GenerationError("the executor lost its workers")

    def close(self, now: bool) -> None:
        for future in self._begun:
            future.cancel()


class DaskPool:
    """The workers of a Dask cluster.

    Parameters
    ----------
    address : str
        Of its scheduler, as in ``tcp://127.0.0.1:8786``.

    Raises
    ------
    InputError
        When no scheduler answers there.
    GenerationError
        When Dask is not installed.
    """

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client
        except ImportError as error:
            raise GenerationError(
                "a scheduler needs Dask: pip install dask distributed"
            ) from error
        try:
            self._client: Any = Client(  # type: ignore[no-untyped-call]
                address, timeout=DASK_PATIENCE, set_as_default=False
            )
        except (OSError, ValueError) as error:
            allowed = "the address of a running Dask scheduler, tcp://host:8786"
            raise InputError("scheduler", address, allowed) from error
        self._gone = f"the Dask scheduler at {address} is gone"
        # Not pure: Dask would look for an older result of the same row first.
        self._executor: Executor = self._client.get_executor(  # type: ignore[no-untyped-call]
            pure=False
        )

    def submit(self, solve: Solve, task: Task) -> Future[Row]:
        return self._executor.submit(run_task, solve, task)

    def window(self) -> int:
        try:
            threads: int = sum(self._client.nthreads().values())  # they come and go
        except OSError as error:
            raise GenerationError(self._gone) from error
        return AHEAD * max(1, threads)

    def restart(self) -> None:
        raise GenerationError(self._gone)

    def close(self, now: bool) -> None:
        self._executor.shutdown(wait=not now)
        self._client.close()


@dataclass(frozen=True)
class Failure:
    """A row that failed other than numerically, and what was raised."""

    task: Task
    error: BaseException


def solve_tasks(
    tasks: Iterable[Task], pool: Pool, solve: Solve, keep: Callable[[Task, Row], None]
) -> list[Failure]:
    """Solve every task, with a bounded number in flight.

    A worker process that dies takes the pool and all rows in flight with it.  The pool
    is restarted and those rows are solved again one at a time, which finds the one that
    kills its worker and leaves it all the memory; after `MAX_DEATHS` it is given up.

    Parameters
    ----------
    tasks : iterable of Task
    pool : Pool
    solve : callable
        Top-level function from a `Task` to its `Row`.
    keep : callable
        Called in this thread with each finished row; twice where Ctrl-C cuts it short.

    Returns
    -------
    list of Failure
        Rows whose `solve` raised, or killed its worker too often.  No further row is
        begun after `MAX_FAILURES` of them.

    Raises
    ------
    GenerationError
        When the executor lost its workers and they are not ours to restart.
    """
    waiting = deque(tasks)
    flying: dict[Future[Row], Task] = {}
    deaths: Counter[int] = Counter()
    suspects: set[int] = set()
    failures: list[Failure] = []

    def finish(future: Future[Row], task: Task) -> None:
        error = future.exception()
        if error is None:
            keep(task, future.result())
        else:
            failures.append(Failure(task, error))
        del flying[future]
        suspects.discard(task.row)

    def begin() -> list[Task]:
        """Fill the window; the rows that found the pool dead."""
        allowed = 1 if suspects else pool.window()
        while waiting and len(flying) < allowed and len(failures) < MAX_FAILURES:
            task = waiting.popleft()
            try:
                flying[pool.submit(solve, task)] = task
            except BrokenExecutor:
                return [task]
        return []

    try:
        while flying or (waiting and len(failures) < MAX_FAILURES):
            lost = begin()
            done = wait(flying, return_when=FIRST_COMPLETED).done if not lost else ()
            if lost or any(_died(future) for future in done):
                # The others end with the pool, some of them well.
                done = wait(flying).done
            for future in sorted(done, key=lambda future: flying[future].row):
                if _died(future):
                    lost.append(flying.pop(future))
                else:
                    finish(future, flying[future])
            if lost:
                pool.restart()
            for task in sorted(lost, key=lambda task: task.row, reverse=True):
                deaths[task.row] += 1
                if deaths[task.row] < MAX_DEATHS:
                    suspects.add(task.row)
                    waiting.appendleft(task)
                else:
                    suspects.discard(task.row)
                    text = f"its worker process died {MAX_DEATHS} times"
                    failures.append(Failure(task, GenerationError(text)))
    except KeyboardInterrupt:
        for future, task in list(flying.items()):
            if future.done() and not _died(future):
                finish(future, task)
        raise
    return failures


def _died(future: Future[Row]) -> bool:
    """True when the worker is gone, rather than the row finished or failed."""
    return future.cancelled() or isinstance(future.exception(), BrokenExecutor)
