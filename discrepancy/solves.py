"""Finite-element solves that a comparison needs: each done once, kept, and in parallel.

A solve is named by the hash of all that determines it, so that a run that was stopped
or killed goes on where it was, and compare, rank and adopt share what they solved.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path as FilePath
from zipfile import BadZipFile

import numpy as np

from datagen.atomic import reason, replacing
from datagen.device import LIMITS, Design
from datagen.effects import Effect, catalogue
from datagen.equilibrium import Workspace
from datagen.errors import FileError, InputError
from datagen.model import GENERATOR_VERSION, Model
from datagen.response import Path
from datagen.specimens import Bulge, Tensile

from .provenance import source_digest

Array = np.ndarray
Specimen = Design | Bulge | Tensile

Values = tuple[tuple[str, tuple[tuple[str, float], ...]], ...]
"""Active effects and their parameters, SI, sorted by name."""

Files = tuple[tuple[str, int, int, int], ...]
"""Files of a user's own effects as they are now: name, inode, time, size."""

SPECIMEN_STEP = 1e-3
"""Relative step of the differences by a specimen's thickness and modulus."""


def values_of(parameters: dict[str, dict[str, float]]) -> Values:
    """Parameters in the order in which they are hashed."""
    return tuple(
        (name, tuple(sorted((k, float(v)) for k, v in values.items())))
        for name, values in sorted(parameters.items())
    )


@dataclass(frozen=True)
class Solve:
    """One path to be solved.

    Parameters
    ----------
    specimen : Design, Bulge or Tensile
    load : tuple of float
        Gauge pressures, Pa; stretches of a tensile specimen.
    time : tuple of float, s, or None
    effects : Values
    level : str
    by : tuple of str
        Fields of the specimen to differentiate by; parameters of the active effects
        are always differentiated by.
    effects_dir : str or None
    sources : tuple of str
        Digests of the files that the effects are written in, in their order, where the
        answer has to be of just those; else of what is there when it is asked for.
    """

    specimen: Specimen
    load: tuple[float, ...]
    time: tuple[float, ...] | None
    effects: Values
    level: str
    by: tuple[str, ...] = ()
    effects_dir: str | None = None
    sources: tuple[str, ...] = ()

    @property
    def written(self) -> tuple[str, ...]:
        """Digests of the effects' files as they are now."""
        known = _catalogue(self.effects_dir)
        return tuple(source_digest(known[name]) for name, _ in self.effects)

    @property
    def key(self) -> str:
        """Hash of all that determines the answer, the effects' source included."""
        content = asdict(self) | {
            "kind": type(self.specimen).__name__,
            "effects_dir": None,
            "generator": GENERATOR_VERSION,
            "sources": self.sources or self.written,
        }
        text = json.dumps(content, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


def _files(effects_dir: str | None) -> Files:
    """What changes when a file of a user's own effects is written again."""
    if effects_dir is None:
        return ()
    found = []
    for path in sorted(FilePath(effects_dir).glob("*.py")):
        with suppress(FileNotFoundError):  # taken away meanwhile
            state = path.stat()
            found.append((path.name, state.st_ino, state.st_mtime_ns, state.st_size))
    return tuple(found)


def _catalogue(effects_dir: str | None) -> dict[str, Effect]:
    return _catalogue_of(effects_dir, _files(effects_dir))


@lru_cache(maxsize=8)
def _catalogue_of(effects_dir: str | None, _as_written: Files) -> dict[str, Effect]:
    return catalogue(FilePath(effects_dir) if effects_dir else None)


@dataclass(frozen=True)
class Solved:
    """The answer to one `Solve`.

    Parameters
    ----------
    outputs : tuple of m str
    values : (s, m) array, SI
        NaN where the path did not get to.
    by : tuple of k str
        Fields of the specimen and ``effect.parameter``.
    jacobian : (s, m, k) array, SI
        NaN where there is no derivative.
    status : str
        Of the path; ``completed`` for a tensile specimen.
    message : str
    seconds : float
    """

    outputs: tuple[str, ...]
    values: Array
    by: tuple[str, ...]
    jacobian: Array
    status: str
    message: str
    seconds: float

    def write(self, path: FilePath) -> None:
        """Keep it in one file."""
        texts = {
            "outputs": self.outputs,
            "by": self.by,
            "status": self.status,
            "message": self.message,
            "seconds": self.seconds,
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary, open(temporary, "wb") as file:
            np.savez(
                file,
                values=self.values,
                jacobian=self.jacobian,
                text=np.array(json.dumps(texts)),
            )

    @classmethod
    def read(cls, path: FilePath) -> Solved | None:
        """What is in a file; None where there is none or it is damaged."""
        try:
            with np.load(path, allow_pickle=False) as file:
                texts = json.loads(str(file["text"]))
                return cls(
                    outputs=tuple(texts["outputs"]),
                    values=file["values"],
                    by=tuple(texts["by"]),
                    jacobian=file["jacobian"],
                    status=texts["status"],
                    message=texts["message"],
                    seconds=texts["seconds"],
                )
        except (OSError, ValueError, KeyError, EOFError, BadZipFile):
            return None


@lru_cache(maxsize=1)
def _workspace() -> Workspace:
    """One analysis of a topology serves every model of a process."""
    return Workspace()


def _model(effects: Values, level: str, effects_dir: str | None) -> Model:
    return _model_of(effects, level, effects_dir, _files(effects_dir))


@lru_cache(maxsize=16)
def _model_of(
    effects: Values, level: str, effects_dir: str | None, _as_written: Files
) -> Model:
    model = Model(
        effects=tuple(effect for effect, _ in effects),
        level=level,
        parameters={effect: dict(values) for effect, values in effects},
        effects_dir=FilePath(effects_dir) if effects_dir else None,
    )
    model.__dict__["_workspace"] = _workspace()
    return model


def _solve_as_written(task: Solve) -> Solved:
    """Solve, in any process, with the effects as the task has them or not at all."""
    before = task.sources or task.written
    if task.written == before:
        answer = solve(task)
        if task.written == before:
            return answer
    raise FileError(task.effects_dir, "an effect in it was changed meanwhile")


def solve(task: Solve) -> Solved:
    """Solve one path with its derivatives, in this process."""
    if isinstance(task.specimen, Design):
        return _solve_device(task, task.specimen)
    return _solve_specimen(task, task.specimen)


def _solve_device(task: Solve, design: Design) -> Solved:
    model = _model(task.effects, task.level, task.effects_dir)
    time = None if task.time is None else np.array(task.time)
    path = Path(np.array(task.load), time)
    own = tuple(f"{e}.{p}" for e, values in task.effects for p, _ in values)
    try:
        response = model([design], [path], sensitivities=task.by + own)
    except InputError as error:
        if not task.effects:
            raise
        # A device that the effect does not fit: a hole larger than the strip.
        shape = (len(task.load), len(model.outputs))
        return Solved(
            outputs=model.outputs,
            values=np.full(shape, np.nan),
            by=task.by + own,
            jacobian=np.full((*shape, len(task.by + own)), np.nan),
            status="impossible",
            message=str(error),
            seconds=0.0,
        )
    jacobian = response.jacobian
    if jacobian is None:
        jacobian = np.zeros((*response.values.shape, 0))
    return Solved(
        outputs=response.outputs,
        values=response.values[0],
        by=response.parameters,
        jacobian=jacobian[0],
        status=response.path_status[0],
        message=response.message[0],
        seconds=float(response.info.get("seconds", 0.0)),
    )


def _solve_specimen(task: Solve, specimen: Bulge | Tensile) -> Solved:
    """Values and central differences; a specimen's path is short."""
    import time as clock

    began = clock.perf_counter()
    status = ["completed", ""]

    def run(specimen: Bulge | Tensile, effects: Values) -> Array:
        model = _model(effects, task.level, task.effects_dir)
        time = None if task.time is None else np.array(task.time)
        if isinstance(specimen, Tensile):
            stress: Array = model.tensile(specimen, np.array(task.load), time)
            return stress[:, None]
        response = model.bulge(specimen, Path(np.array(task.load), time))
        status[:] = [response.path_status[0], response.message[0]]
        values: Array = response.values[0]
        return values

    values = run(specimen, task.effects)
    slopes, names = [], []
    for name in task.by:
        value = getattr(specimen, name)
        limit = LIMITS[f"{specimen.layer}_{name}"]  # a value may lie on it
        high = min(value * (1 + SPECIMEN_STEP), limit.upper)
        low = max(value * (1 - SPECIMEN_STEP), limit.lower)
        ends = [
            run(type(specimen)(**(asdict(specimen) | {name: moved})), task.effects)
            for moved in (high, low)
        ]
        slopes.append((ends[0] - ends[1]) / (high - low))
        names.append(name)
    known = _catalogue(task.effects_dir)
    for effect, given in task.effects:
        for parameter, value in given:
            one = known[effect].space[parameter]
            step = SPECIMEN_STEP * (one.upper - one.lower)
            high = min(value + step, one.upper)
            low = max(value - step, one.lower)
            ends = []
            for moved in (high, low):
                other = {e: dict(v) for e, v in task.effects}
                other[effect][parameter] = moved
                ends.append(run(specimen, values_of(other)))
            slopes.append((ends[0] - ends[1]) / (high - low))
            names.append(f"{effect}.{parameter}")
    jacobian = np.stack(slopes, axis=-1) if slopes else np.zeros((*values.shape, 0))
    return Solved(
        outputs=("stress",) if isinstance(specimen, Tensile) else ("inflation",),
        values=values,
        by=tuple(names),
        jacobian=jacobian,
        status=status[0],
        message=status[1],
        seconds=clock.perf_counter() - began,
    )


def default_cache() -> FilePath:
    """Folder of kept solves: ``PBA_CACHE``, or ``pba/solves`` in the user's cache."""
    given = os.environ.get("PBA_CACHE")
    if given:
        return FilePath(given)
    base = os.environ.get("XDG_CACHE_HOME")
    return (FilePath(base) if base else FilePath.home() / ".cache") / "pba" / "solves"


KEPT = "solves cannot be kept here: {}; another folder is named by --cache or PBA_CACHE"


@dataclass(frozen=True)
class Progress:
    """How far a set of solves is: `done` of `total`, and what they are for."""

    done: int
    total: int
    what: str


class Solver:
    """Solves sets of paths on worker processes, through the kept ones.

    A context manager: workers start with the first solve that is not kept and end with
    the block.

    Parameters
    ----------
    workers : int
    cache : path, optional
        Folder of kept solves; `default_cache` where it is not given.
    progress : callable, optional
        Called with a `Progress` after each solve.
    """

    def __init__(
        self,
        workers: int = 1,
        cache: FilePath | None = None,
        progress: Callable[[Progress], None] | None = None,
    ) -> None:
        self.workers, self.cache = workers, cache or default_cache()
        self.progress = progress
        self.solved = 0
        self._memory: dict[str, Solved] = {}
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Solver:
        return self

    def __exit__(self, *reason: object) -> None:
        if self._pool is not None:
            now = reason[0] is not None
            self._pool.shutdown(wait=not now, cancel_futures=True)
            if now:
                for process in list((self._pool._processes or {}).values()):
                    with suppress(OSError):
                        process.terminate()
            self._pool = None

    def _file(self, key: str) -> FilePath:
        return self.cache / GENERATOR_VERSION / key[:2] / f"{key}.npz"

    def known(self, task: Solve) -> Solved | None:
        """The answer to a solve where it is kept."""
        key = task.key
        if key not in self._memory:
            found = Solved.read(self._file(key))
            if found is None:
                return None
            self._memory[key] = found
        return self._memory[key]

    def all(self, tasks: Iterable[Solve], what: str = "") -> dict[Solve, Solved]:
        """Answers to all tasks, each kept as soon as it is there.

        Raises
        ------
        InputError
            When a specimen or its load is not allowed.
        FileError
            When the folder of kept solves cannot be written to, or an effect of one's
            own was changed meanwhile.
        """
        wanted = list(dict.fromkeys(tasks))
        keys = {task: task.key for task in wanted}
        answers: dict[Solve, Solved] = {}
        missing = []
        for task in wanted:
            found = self.known(task)
            if found is None:
                missing.append(task)
            else:
                answers[task] = found

        def keep(task: Solve, answer: Solved) -> None:
            answers[task] = self._memory[keys[task]] = answer
            answer.write(self._file(keys[task]))
            self.solved += 1
            if self.progress is not None:
                self.progress(Progress(len(answers), len(wanted), what))

        if self.progress is not None and wanted:
            self.progress(Progress(len(answers), len(wanted), what))
        if missing:
            self._check_cache()
        if self.workers == 1 or len(missing) <= 1:
            for task in missing:
                keep(task, _solve_as_written(task))
            return answers
        pool = self._executor()
        futures = {pool.submit(_solve_as_written, task): task for task in missing}
        for future in as_completed(futures):
            keep(futures[future], future.result())
        return answers

    def _check_cache(self) -> None:
        """Better told before a solve than after it."""
        try:
            self.cache.mkdir(parents=True, exist_ok=True)
            allowed = os.access(self.cache, os.W_OK)
        except OSError as error:
            raise FileError(self.cache, KEPT.format(reason(error))) from error
        if not allowed:
            raise FileError(self.cache, KEPT.format("not writable"))

    def _executor(self) -> ProcessPoolExecutor:
        if self._pool is None:
            import multiprocessing

            self._pool = ProcessPoolExecutor(
                self.workers,
                mp_context=multiprocessing.get_context("spawn"),
                initializer=_one_thread,
            )
        return self._pool


def _one_thread() -> None:
    """Workers share the cores by processes; a terminal's Ctrl-C is the parent's."""
    import signal

    from threadpoolctl import threadpool_limits

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threadpool_limits(1)
