"""From a base and effects with their ranges to a corrected surrogate in a folder.

One call plans the increment, solves it, trains and writes.  Until the end everything is
in ``FOLDER.work`` beside the folder; the folder itself appears whole, by one rename.  A
run that was killed goes on with ``resume=True`` and gives the model that an
uninterrupted run gives.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from datagen.atomic import reason, sync, write_text
from datagen.dataset import Dataset
from datagen.device import Design
from datagen.errors import FileError, InputError
from datagen.generate import Progress, pool_of
from datagen.space import Space
from datagen.worker import Solve

from .budget import FEWEST_PATHS, SLOPES_PER_PATH, affordable, one_path
from .change import SETTINGS, ChangeSettings, fit_corrected, nested
from .corrected import Corrected
from .corrected_store import KIND
from .ensemble import Ensemble
from .equivalent import Equivalent, fit_equivalent
from .increment import (
    Fits,
    fem_fits,
    increment_tasks,
    mesh_of,
    plan,
    ranged_space,
    solve_increment,
    solve_pair,
)
from .pairs import tuned_names
from .slopes import (
    differentiable,
    fits_at_off,
    shipped,
    slope_rows,
    slopes_space,
    solve_at_off,
    solve_slopes,
)

Array = np.ndarray

PLAN, DRAFT, FORMER = "plan.json", "model", "former"
"""In the working folder."""

INCREMENT, SLOPES = "increment.h5", "slopes.h5"
"""In the working folder, and what goes along into the finished one."""

HANDED_ON = "handed_on"
"""Of a description: what the model was learned for, where it came to serve another."""

Report = Callable[[str, int, int, float | None], None]
"""report(stage, done, total, seconds left or None)."""


@dataclass(frozen=True)
class Means:
    """How paths are solved; only tests need others than the finite elements.

    Parameters
    ----------
    solve : callable
        Top-level function from a `PairTask` to its row.
    version : str or None
        Of what it computes; None for that of the finite elements.
    level : str or None
        Mesh level; None for that of the base.
    space : Space or None
        Design variables and parameters over their ranges; None for the effects' own.
    fits : callable or None
        Whether effects can act on a design; None asks the finite elements.
    equivalent : Equivalent or None
        None reads it from problems with the effects in them.
    slopes : Space or None
        Parameters with derivatives at off; None asks the finite elements where these
        solve the paths, too.
    solve_slopes : callable
        As `solve`, from a `SlopeTask`.
    """

    solve: Solve = solve_pair
    version: str | None = None
    level: str | None = None
    space: Space | None = None
    fits: Fits | None = None
    equivalent: Equivalent | None = None
    slopes: Space | None = None
    solve_slopes: Solve = solve_slopes


BY_FEM = Means()


def learn(
    base: Ensemble,
    dataset: Dataset,
    effects: Sequence[str],
    ranges: Mapping[str, tuple[float, float]],
    folder: str | Path,
    *,
    samples: Array | None = None,
    paths: int | None = None,
    minutes: float | None = None,
    seed: int = 0,
    near: Sequence[Design] = (),
    effects_dir: Path | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    executor: Executor | None = None,
    resume: bool = False,
    restart: str = "",
    report: Report | None = None,
    settings: ChangeSettings = SETTINGS,
    means: Means = BY_FEM,
) -> Corrected:
    """Learn what effects change and write the corrected surrogate.

    Parameters
    ----------
    base : Ensemble
        Without effects.
    dataset : Dataset
        Paths without effects, that new ones are paired with.
    effects : sequence of str
        Learned together, so that what they do to each other is learned, too; the order
        of their names changes nothing.
    ranges : mapping
        ``{effect.parameter: (lower, upper)}``, SI, one for each parameter; see
        `increment.stated_range`.
    folder : path
        Where the model is written; must not exist, its parent must.
    samples : (m, j) array, SI, optional
        Equally likely parameters, in the order of their names in the corrected model's
        `tuned` (effects as the model applies them); `marginal` averages over them.
    paths : int, optional
        How many are solved; 60 by default.
    minutes : float, optional
        Time budget, instead of `paths`: a path for each worker is timed first.
    seed : int
    near : sequence of Design
        Designs for which the answer is wanted most.
    effects_dir : Path, optional
        Folder with a user's own effects.
    workers, scheduler, executor
        As in `datagen.generate.generate`.
    resume : bool
        Go on with what an earlier run with the same settings has left.
    restart : str, optional
        Name of a new beginning: what an earlier run has left is discarded, a model that
        is there once the new one is complete.  The same name again goes on; so does
        another one where a new beginning with the same settings was stopped.
    report : callable, optional
        As `Report`.
    settings : ChangeSettings
    means : Means

    Raises
    ------
    InputError
        When a setting is not allowed, the folder exists (without `resume`), or was
        begun with other settings (with it), or another process is learning beside it.
    EffectError, FileError, GenerationError, Interrupted
        As in `datagen.generate.generate`.
    """
    folder = Path(folder)
    work = folder.with_name(f"{folder.name}.work")
    space = means.space or ranged_space(effects, ranges, effects_dir)
    active = tuple(sorted({p.name.split(".")[0] for p in space if "." in p.name}))
    if paths is not None and minutes is not None:
        raise InputError("minutes", minutes, "either paths or minutes")
    if minutes is not None and not (np.isfinite(minutes) and minutes > 0):
        raise InputError("minutes", minutes, "a number above 0", "min")
    paths = 60 if paths is None and minutes is None else paths
    if paths is not None and paths < FEWEST_PATHS:
        raise InputError("paths", paths, f"at least {FEWEST_PATHS}")
    wanted = _request(
        base, dataset, space, near, seed, samples, paths, minutes, settings
    ) | {"effects_dir": _sources(effects_dir)}
    with _alone(folder):
        _restore(folder, work)
        if folder.exists() and not (restart and _beginning(folder) != restart):
            return _finished(folder, work, wanted, resume or bool(restart))
        begun = _begin(work, wanted, resume, restart)
        level = means.level or mesh_of(dataset)
        fits = means.fits or fem_fits(active, level, effects_dir)
        sloped, slopes = _slopes_of(dataset, active, means, effects_dir)
        if "count" not in begun:
            count = paths
            if count is None:
                assert minutes is not None
                first = plan(dataset, space, FEWEST_PATHS, seed, near, fits)
                tasks = increment_tasks(first, dataset, level, effects_dir)
                pool = pool_of(workers, scheduler, executor)
                seconds = one_path(tasks, pool, max(workers, 1), means.solve)
                try:
                    solved_too = sloped is not None and slopes is None
                    coarser = any(task.coarser for task in tasks)
                    count = affordable(
                        minutes, seconds, max(workers, 1), coarser, solved_too
                    )
                except InputError:  # nothing was begun: other minutes may be tried
                    shutil.rmtree(work, ignore_errors=True)
                    raise
            begun = begun | {"count": count}
            write_text(work / PLAN, json.dumps(begun, indent=1) + "\n")
        planned = plan(dataset, space, int(begun["count"]), seed, near, fits)

        def told(stage: str) -> Callable[[Progress], None]:
            def solved(state: Progress) -> None:
                if report:
                    report(stage, state.done, state.total, state.seconds_left)

            return solved

        how: dict[str, Any] = {
            "effects_dir": effects_dir,
            "workers": workers,
            "scheduler": scheduler,
            "resume": True,
            "executor": executor,
            "version": means.version,
        }
        if sloped is not None and slopes is None:
            fitting = None
            if means.slopes is None:
                having = {p.name.split(".")[0] for p in sloped if "." in p.name}
                fitting = fits_at_off(tuple(sorted(having)), effects_dir)
            wanted_rows = slope_rows(
                dataset, SLOPES_PER_PATH * len(planned), planned.base_row, fitting
            )
            slopes = solve_at_off(
                dataset,
                sloped,
                wanted_rows,
                work / SLOPES,
                progress=told("slopes"),
                solve=means.solve_slopes,
                **how,
            )
        increment = solve_increment(
            planned,
            dataset,
            work / INCREMENT,
            level=level,
            progress=told("increment"),
            solve=means.solve,
            **how,
        )

        def trained(stage: str, step: int, steps: int, loss: float) -> None:
            if report:
                report(stage, step, steps, None)

        equivalent = means.equivalent or fit_equivalent(space, seed, effects_dir)
        model = fit_corrected(
            base,
            dataset,
            increment,
            seed,
            settings,
            equivalent,
            samples,
            trained,
            slopes,
        )
        more = {"unfit_designs": planned.unfit, "request": wanted, "restart": restart}
        model = replace(model, description=model.description | more)
        return _publish(model, folder, work, work)


def _slopes_of(
    dataset: Dataset,
    effects: tuple[str, ...],
    means: Means,
    effects_dir: Path | None,
) -> tuple[Space | None, Dataset | None]:
    """What has slopes at off, if anything, and the shipped ones, if they are those."""
    if means.slopes is not None:
        return means.slopes, None
    if means is not BY_FEM:
        return None, None
    having = differentiable(effects, dataset, effects_dir)
    if not having:
        return None, None
    return slopes_space(having, effects_dir), shipped(dataset, having)


def hand_on(
    source: Path, folder: Path, samples: Array, origin: str
) -> Corrected | None:
    """A finished surrogate for other samples of its parameters; nothing is learned.

    Parameters
    ----------
    source : Path
        Folder of the surrogate.
    folder : Path
        Where the same with these samples is written; must not exist.
    samples : (m, j) array, SI
        As in `learn`.
    origin : str
        What `source` was learned for, for the description.

    Returns
    -------
    Corrected or None
        None where a sample is outside the stated ranges, or `learn` has begun there.

    Raises
    ------
    InputError, FileError
        When the samples are of other parameters, or a file cannot be read or written.
    """
    with _alone(folder):
        return _hand_on(source, folder, samples, origin)


def _hand_on(
    source: Path, folder: Path, samples: Array, origin: str
) -> Corrected | None:
    work = folder.with_name(f"{folder.name}.work")
    if (work / PLAN).exists():
        return None
    model = replace(Corrected.load(source), samples=samples)
    ranges = np.array([(p.lower, p.upper) for p in model.tuned])
    if ((model.samples < ranges[:, 0]) | (model.samples > ranges[:, 1])).any():
        return None
    described = {k: v for k, v in model.description.items() if k != "request"}
    names = tuned_names(model.space)
    made = replace(
        model,
        parameters=nested(names, model.samples.mean(axis=0)),
        description=described | {HANDED_ON: origin},
    )
    _make(work)
    return _publish(made, folder, work, source)


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """No other process learns beside this folder while in the block.

    The lock is the folder that both it and its working folder are in: no file is left,
    and a killed run holds nothing.

    Raises
    ------
    InputError
        When another does.
    FileError
        When the folder around it cannot be read or locked.
    """
    try:
        around = os.open(folder.parent, os.O_RDONLY)
    except OSError as error:
        raise FileError(folder.parent, f"cannot be read: {reason(error)}") from error
    try:
        try:
            fcntl.flock(around, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            allowed = "a folder beside which no other training is running"
            raise InputError("out", str(folder), allowed) from None
        except OSError as error:
            told = f"cannot be locked: {reason(error)}"
            raise FileError(folder.parent, told) from error
        yield
    finally:
        os.close(around)


def _request(
    base: Ensemble,
    dataset: Dataset,
    space: Space,
    near: Sequence[Design],
    seed: int,
    samples: Array | None,
    paths: int | None,
    minutes: float | None,
    settings: ChangeSettings,
) -> dict[str, Any]:
    """What decides the model, as plain data."""
    designs = json.dumps([design.to_dict() for design in near])
    taken = b"" if samples is None else np.asarray(samples, "<f8").tobytes()
    return {
        "base": base.version,
        "dataset": dataset.digest(),
        "ranges": {p.name: [p.lower, p.upper] for p in space if "." in p.name},
        "near": hashlib.sha256(designs.encode()).hexdigest()[:12],
        "samples": hashlib.sha256(taken).hexdigest()[:12],
        "seed": seed,
        "paths": paths,
        "minutes": minutes,
        "settings": repr(settings),
        "scheme": KIND.schema_version,
    }


def _sources(effects_dir: Path | None) -> str:
    """Digest of a user's own effects; empty without."""
    if effects_dir is None:
        return ""
    sha = hashlib.sha256()
    for path in sorted(effects_dir.glob("*.py")):
        sha.update(path.name.encode() + b"\n" + path.read_bytes())
    return sha.hexdigest()[:12]


def _check_same(wanted: Mapping[str, Any], found: Mapping[str, Any], at: Path) -> None:
    """Refuse to go on with what other settings began."""
    for name, value in wanted.items():
        if found.get(name) != value:
            had = found.get(name)
            begun = (
                f"{'none' if had is None else repr(had)}, as {at} was begun with; "
                "restart (--restart) begins anew"
            )
            raise InputError(name, value, begun)


def _beginning(folder: Path) -> str:
    """What `restart` a model was learned with; empty also where it is damaged."""
    try:
        return str(Corrected.load(folder).description.get("restart", ""))
    except FileError:
        return ""


def _begin(
    work: Path, wanted: dict[str, Any], resume: bool, restart: str
) -> dict[str, Any]:
    """The working folder; what an earlier run has written there of its plan."""
    path = work / PLAN
    if restart:
        left = _plan_in(path)
        anew = left.get("restart", "")  # what is left is of a new beginning, too
        same = bool(anew) and all(left.get(k) == v for k, v in wanted.items())
        if anew != restart and not same:
            shutil.rmtree(work, ignore_errors=True)
    elif work.exists() and not resume:
        raise _refusal(work)
    _make(work)
    if not path.exists():  # a fresh run, or killed before it was written
        begun = wanted | {"restart": restart}
        write_text(path, json.dumps(begun, indent=1) + "\n")
        return begun
    found = _plan_in(path)
    if not found:
        raise FileError(path, "not a plan; restart (--restart) begins anew")
    _check_same(wanted, found, work)
    if restart and found.get("restart") != restart:
        found |= {"restart": restart}  # the one who goes on with it
        write_text(path, json.dumps(found, indent=1) + "\n")
    return found


def _plan_in(path: Path) -> dict[str, Any]:
    """What a file holds of a plan; empty where it is none."""
    try:
        found = json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _make(work: Path) -> None:
    try:
        work.mkdir(exist_ok=True)
    except OSError as error:
        raise FileError(work, f"cannot be made: {reason(error)}") from error


def _restore(folder: Path, work: Path) -> None:
    """Give a model its name back that had made way when the run was killed."""
    if folder.exists() or not (work / FORMER).exists():
        return
    try:
        os.replace(work / FORMER, folder)
    except OSError as error:
        raise FileError(folder, f"cannot be written: {reason(error)}") from error


def _finished(
    folder: Path, work: Path, wanted: Mapping[str, Any], resume: bool
) -> Corrected:
    """The model that is there already, if it is the one that was asked for."""
    if not resume:
        raise _refusal(folder)
    model = Corrected.load(folder)
    _check_same(wanted, model.description.get("request", {}), folder)
    begun = _plan_in(work / PLAN).get("restart", "")
    if begun in ("", model.description.get("restart", "")):
        shutil.rmtree(work, ignore_errors=True)  # killed in the clean-up
    return model  # a new beginning that was stopped can still go on


def _refusal(existing: Path) -> InputError:
    return InputError(
        "out",
        str(existing),
        "a folder that does not exist yet; --resume goes on with what was begun",
    )


def _publish(model: Corrected, folder: Path, work: Path, source: Path) -> Corrected:
    """Give the finished model its name, with what it was learned from in `source`.

    One that has the name makes way.
    """
    draft = work / DRAFT
    shutil.rmtree(draft, ignore_errors=True)  # of a run that was killed here
    model.save(draft)
    try:
        for name in (INCREMENT, SLOPES):
            if name == INCREMENT or (source / name).exists():
                shutil.copyfile(source / name, draft / name)
                sync(draft / name)
        sync(draft)
        if folder.exists():
            shutil.rmtree(work / FORMER, ignore_errors=True)
            os.replace(folder, work / FORMER)
        os.replace(draft, folder)
        sync(folder.parent)
    except OSError as error:
        raise FileError(folder, f"cannot be written: {reason(error)}") from error
    shutil.rmtree(work, ignore_errors=True)
    return Corrected.load(folder)
