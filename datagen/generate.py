"""Generating a dataset: sample designs, solve each path, never lose a finished one.

>>> from datagen.generate import generate
>>> data = generate(300, seed=0, out="paths.h5", workers=4)  # doctest: +SKIP
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from .dataset import Dataset, space_to_json
from .device import DESIGN_SPACE, MAX_PRESSURE, Design
from .errors import GenerationError, InputError, Interrupted
from .parts import Manifest, Parts, inputs_digest, parts_folder, refusal
from .pool import DaskPool, Failure, GivenExecutor, Pool, ProcessPool, solve_tasks
from .space import Space
from .worker import PROPER_ENDS, Row, Solve, Task, solve_row, split_inputs

Array = np.ndarray

FIT_TRIES = 6
"""Times that effects are halved where they do not fit a design."""


@dataclass(frozen=True)
class Progress:
    """How far a run is.

    Parameters
    ----------
    done, total : int
        Finished rows, those of earlier sessions included, and all rows.
    failed : int
        Finished rows whose path stopped before its highest or its limit pressure.
    rate : float, 1/s
        Rows finished per second in this session; 0 before the first.
    seconds_left : float or None, s
        At this rate; None while there is none.
    """

    done: int
    total: int
    failed: int
    rate: float
    seconds_left: float | None


def sampled_space(effects: Sequence[str] = ()) -> Space:
    """The default design space, then the parameters of `effects`.

    Raises
    ------
    EffectError
        When an effect is unknown.
    InputError
        When an effect is named twice.
    """
    if not effects:
        return DESIGN_SPACE
    if len(set(effects)) < len(effects):
        raise InputError("effects", ", ".join(effects), "each effect once")
    from .model import Model

    return Model(effects=tuple(effects)).space


def generate(
    count: int,
    seed: int,
    out: str | Path,
    *,
    effects: Sequence[str] = (),
    level: str = "standard",
    workers: int = 1,
    scheduler: str | None = None,
    resume: bool = False,
    max_pressure: float = MAX_PRESSURE,
    sensitivities: int = 0,
    first: int | None = None,
    extend: str | Path | None = None,
    progress: Callable[[Progress], None] | None = None,
    executor: Executor | None = None,
    solve: Solve = solve_row,
    version: str | None = None,
) -> Dataset:
    """Generate a dataset into one HDF5 file.

    Finished paths wait in ``OUT.parts`` until all are there.  A killed run loses the
    paths in flight and nothing else; ``resume=True`` goes on, and the finished file has
    the values that an uninterrupted run gives, whatever the number of workers.

    Parameters
    ----------
    count : int
        Number of designs, a Latin hypercube over `sampled_space`.
    seed : int
        The same seed and count give the same designs.
    out : path
        The HDF5 file; it appears when it is complete.
    effects : sequence of str
        Effects to be active; their parameters are sampled with the design.
    level : str
        Mesh level.
    workers : int
        Worker processes, each on one thread; with `executor`, the number it has.
    scheduler : str, optional
        Address of a Dask scheduler whose workers are used instead.
    resume : bool
        Go on with what an earlier run with the same settings has left.
    max_pressure : float, Pa
        Each path runs to here or to its limit pressure.
    sensitivities : int
        How many rows, from the first, are differentiated, too.
    first : int, optional
        Solve the first designs alone, which a later run may `extend`: any part of a
        hypercube is a random sample, and the whole of it an even one.
    extend : path, optional
        A dataset of the first designs of the same hypercube, whose rows are taken over.
    progress : callable, optional
        Called with a `Progress` at the start and after each row.
    executor : concurrent.futures.Executor, optional
        Used instead of a process pool of ours; it stays open.
    solve : callable
        Top-level function from a `Task` to its `Row`.
    version : str, optional
        Version of what `solve` computes; that of the finite elements by default.

    Returns
    -------
    Dataset
        As read back from the file.

    Raises
    ------
    InputError
        When a setting is not allowed, `out` or its parts exist (without `resume`), or
        were begun with other settings (with it), or another run is writing them.
    EffectError
        When an effect is unknown.
    FileError
        When a file cannot be written or read.
    GenerationError
        When rows failed other than numerically; names the first with its design.
    Interrupted
        On Ctrl-C.
    """
    _check_whole("designs", count, 1, 10**8)
    _check_whole("seed", seed, 0, 2**63 - 1)
    _check_whole("workers", workers, 1, 4096)
    rows = count if first is None else first
    _check_whole("first", rows, 1, count)
    _check_whole("sensitivities", sensitivities, 0, rows)
    if not (math.isfinite(max_pressure) and max_pressure > 0):
        raise InputError("max_pressure", max_pressure, "a number above 0", "Pa")
    if scheduler is not None and executor is not None:
        raise InputError("scheduler", scheduler, "no executor beside it")
    active = tuple(sorted(effects))  # the order of their names changes nothing
    space = sampled_space(active)
    inputs = fitted(space, space.sample(count, seed)[:rows], active)
    tasks = [
        Task(
            i,
            space.names,
            tuple(row),
            active,
            level,
            float(max_pressure),
            i < sensitivities,
        )
        for i, row in enumerate(inputs.tolist())
    ]
    if version is None:
        version = _fem_version(tasks[0])
    manifest = Manifest(
        designs=rows,
        seed=int(seed),
        effects=active,
        level=level,
        max_pressure=float(max_pressure),
        generator_version=version,
        design_space=tuple(space_to_json(space)),
        inputs_sha256=inputs_digest(inputs),
        sensitivities=int(sensitivities),
        hypercube=count if rows < count else 0,
    )
    fixed = {"inputs": inputs, "space": space}
    known = [] if extend is None else _rows_of(Path(extend), manifest, inputs, count)
    return solve_all(
        out,
        manifest,
        tasks,
        fixed,
        workers=workers,
        scheduler=scheduler,
        resume=resume,
        progress=progress,
        executor=executor,
        solve=solve,
        known=known,
    )


def fitted(space: Space, inputs: Array, effects: tuple[str, ...]) -> Array:
    """The inputs (n, d) with effects that do not fit a design halved until they do.

    An edge can move no further than there is room between it and the next.

    Parameters
    ----------
    space : Space
    inputs : (n, d) array, SI
    effects : tuple of str

    Raises
    ------
    InputError
        When an effect does not even fit when it is all but off.
    """
    from .model import Model

    if not effects:
        return inputs
    found = inputs.copy()
    tuned = np.array(["." in name for name in space.names])
    off = np.array([p.off if p.off is not None else np.nan for p in space])[tuned]
    whole = np.array([p.scale == "integer" for p in space])[tuned]
    for row in found:
        for halved in range(FIT_TRIES + 1):
            design, parameters = split_inputs(space.names, row, effects)
            try:
                Model(effects, "draft", parameters).problem(Design.from_sample(design))
                break
            except InputError:
                if halved == FIT_TRIES:
                    raise
            half = off + (row[tuned] - off) / 2
            row[tuned] = np.where(whole, np.trunc(half), half)
    return found


def _rows_of(path: Path, manifest: Manifest, inputs: Array, count: int) -> list[Row]:
    """Rows of an earlier dataset, once it is one of the first designs of the same.

    Raises
    ------
    InputError
        Naming what differs.
    FileError
        When it cannot be read.
    """
    data = Dataset.read(path)
    rows = len(data)
    if rows > len(inputs) or (data.hypercube or rows) != count:
        words = f"{rows} of {data.hypercube or rows} designs"
        allowed = f"a file with the first of {count} designs, {len(inputs)} at most"
        raise InputError("extend", f"{path}, {words}", allowed)
    wanted = replace(
        manifest,
        designs=rows,
        hypercube=data.hypercube,
        inputs_sha256=inputs_digest(inputs[:rows]),
        sensitivities=min(manifest.sensitivities, rows),
    )
    wanted.check_resumes(json.loads(Manifest.of(data).to_json()), path)
    return [data.row(row) for row in range(rows)]


def solve_all(
    out: str | Path,
    manifest: Manifest,
    tasks: Sequence[Task],
    fixed: Mapping[str, Any],
    *,
    workers: int = 1,
    scheduler: str | None = None,
    resume: bool = False,
    progress: Callable[[Progress], None] | None = None,
    executor: Executor | None = None,
    solve: Solve = solve_row,
    known: Sequence[Row] = (),
) -> Dataset:
    """Solve tasks into one HDF5 file; what `generate` says of its run holds here.

    Parameters
    ----------
    out : path
    manifest : Manifest
        What is solved: a run is resumed only by the same.
    tasks : sequence of Task
        One a row, in their order.
    fixed : mapping
        Fields of the `Dataset` that neither manifest nor rows carry: `inputs`, `space`
        and, for paths that are paired, `base_row`.
    workers, scheduler, resume, progress, executor, solve
        As in `generate`, and so are the errors.
    known : sequence of Row
        Rows that need not be solved.
    """
    out = Path(out)
    folder = parts_folder(out)
    for path in (out, folder):
        if path.exists() and not resume:
            raise refusal(path)
    if out.exists() and not folder.exists():
        return _finished(out, manifest)
    with Parts(out, manifest, resume) as parts:
        if out.exists():  # killed, or finished by another run, before the clean-up
            data = _finished(out, manifest)
            parts.remove()
            return data
        session = _Session(parts, len(tasks), progress)
        session.take(known)
        try:
            rows = session.run(
                tasks, solve, lambda: pool_of(workers, scheduler, executor)
            )
            data = Dataset.from_rows(
                rows,
                variables=fixed["space"].names,
                seed=manifest.seed,
                level=manifest.level,
                effects=manifest.effects,
                generator_version=manifest.generator_version,
                max_pressure=manifest.max_pressure,
                sensitivities=manifest.sensitivities,
                base=manifest.base,
                hypercube=manifest.hypercube,
                **fixed,
            )
            data = parts.publish(data)
        except KeyboardInterrupt:
            raise Interrupted(f"interrupted: {session.kept()}") from None
        parts.remove()
        return data


def _check_whole(name: str, value: object, lower: int, upper: int) -> None:
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not whole or not lower <= value <= upper:  # type: ignore[operator]
        raise InputError(name, value, f"a whole number from {lower} to {upper}")


def _fem_version(task: Task) -> str:
    """Version of the finite elements, once they accept the settings of a task."""
    from .model import GENERATOR_VERSION, Model

    Model(effects=task.effects, level=task.level, parameters=task.split()[1])
    return GENERATOR_VERSION


def _finished(out: Path, manifest: Manifest) -> Dataset:
    """The dataset that is there already, if it is the one that was asked for."""
    data = Dataset.read(out)
    manifest.check_resumes(json.loads(Manifest.of(data).to_json()), out)
    return data


def pool_of(workers: int, scheduler: str | None, executor: Executor | None) -> Pool:
    """Where rows are solved; arguments as in `generate`."""
    if scheduler is not None:
        return DaskPool(scheduler)
    if executor is not None:
        return GivenExecutor(executor, workers)
    return ProcessPool(workers)


@dataclass
class _Session:
    """One session of a run: the rows that are there and those that it adds."""

    parts: Parts
    total: int
    progress: Callable[[Progress], None] | None
    rows: dict[int, Row] = field(default_factory=dict)
    failed: int = 0
    added: int = 0
    started: float = field(default_factory=time.monotonic)

    def take(self, rows: Iterable[Row]) -> None:
        """Rows that another dataset has."""
        for row in rows:
            self._count(row)

    def run(
        self, tasks: Iterable[Task], solve: Solve, make_pool: Callable[[], Pool]
    ) -> list[Row]:
        """Rows of all tasks: what is on disk is read, what is missing is solved."""
        self.take(self.parts.read(task for task in tasks if task.row not in self.rows))
        missing = [task for task in tasks if task.row not in self.rows]
        self._report()
        if missing:
            pool = make_pool()
            self._solve(missing, solve, pool)
        return list(self.rows.values())

    def _solve(self, tasks: list[Task], solve: Solve, pool: Pool) -> None:
        """Solve `tasks`; those that fail are named when the others are done."""
        try:
            failures = solve_tasks(tasks, pool, solve, self._keep)
        except BaseException as error:
            pool.close(now=True)
            if isinstance(error, GenerationError):
                raise GenerationError(f"{error}; {self.kept()}") from error
            raise
        pool.close(now=False)
        if failures:
            text = f"{_describe(failures)}; {self.kept()}"
            raise GenerationError(text) from failures[0].error

    def _keep(self, task: Task, row: Row) -> None:
        if row.row != task.row:
            raise GenerationError(f"row {task.row} was answered by row {row.row}")
        if row.row in self.rows:
            return
        self.parts.write(task, row)
        self._count(row)
        self.added += 1
        self._report()

    def _count(self, row: Row) -> None:
        self.rows[row.row] = row
        self.failed += row.path_status not in PROPER_ENDS

    def _report(self) -> None:
        if self.progress is None:
            return
        done, elapsed = len(self.rows), time.monotonic() - self.started
        rate = self.added / elapsed if elapsed > 0 else 0.0
        left = (self.total - done) / rate if rate > 0 else None
        self.progress(Progress(done, self.total, self.failed, rate, left))

    def kept(self) -> str:
        """What is on disk and how to go on, in words."""
        if not self.rows:
            return "no path was finished yet"
        return (
            f"{len(self.rows)} of {self.total} paths are kept in {self.parts.folder}; "
            "the same command with --resume goes on"
        )


def _describe(failures: list[Failure]) -> str:
    first = min(failures, key=lambda failure: failure.task.row)
    task, error = first.task, first.error
    text = " ".join(str(error).split())
    cause = text if isinstance(error, GenerationError) else repr(error)
    design = ", ".join(
        f"{name}={value:.6g}"
        for name, value in zip(task.variables, task.inputs, strict=True)
    )
    others = len(failures) - 1
    more = f" (and {others} more rows)" if others else ""
    return f"row {task.row}{more} failed: {cause}; its design, SI: {design}"
