"""An increment: paths with effects in them, each paired with a path of the base.

The base dataset has no effects.  A path of the increment is one of its designs, solved
again with effects at values of their parameters, at the same pressures, so that the
difference of the two paths is what the effects do and nothing else: no interpolation,
and no change of mesh.  Derivatives by the effects' parameters come along for a few
percent of a path's cost.

What is trained on is a difference of two paths on a coarser mesh, added to the base's
path: a mesh that is too stiff is so with the effects and without, and what it gets
wrong of their difference is a small part of what it gets wrong of either.  What is
tested on is solved on the base's own mesh.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from datagen.dataset import Dataset, space_to_json
from datagen.device import DESIGN_SPACE, Design
from datagen.errors import InputError
from datagen.generate import Progress, solve_all
from datagen.parts import Manifest, inputs_digest
from datagen.space import Parameter, Space
from datagen.worker import PROPER_ENDS, Row, Solve, Task, split_inputs

from .features import columns_of, groups
from .split import held_out

Array = np.ndarray
Values = Mapping[str, Mapping[str, float]]
"""``{effect: {parameter: value}}``, SI."""

FEWEST_STEPS = 3
"""A base path with fewer converged steps says too little to be paired with."""

TEST_PATHS = 0.3
"""Share of the paths whose designs neither the base nor the increment trains on.

What is said of a model rests on them."""

COARSER = "draft"
"""Mesh of the differences: two of its paths take less than half of the time of one on
the standard mesh, and miss the difference of two of those by a small part of what one
of them misses (``docs/corrected-surrogate.md``)."""

NEAR_PATHS = 0.3
"""Share of the training paths whose designs are the nearest to given ones."""

EVEN_STEPS = 8
"""Even load steps to the highest pressure: where a path goes on past its base's end."""

Fits = Callable[[Design, Values], bool]
"""Whether effects at these values can act on a design."""


@dataclass(frozen=True)
class PairTask(Task):
    """One path of an increment to be solved.

    Parameters
    ----------
    pressure : tuple of s float, Pa
        Load steps: those of the base's path, and on from its end.
    effects_dir : str or None
        Folder with a user's own effects.
    coarser : str
        Mesh level of the difference that is added to the base's path; empty where the
        path itself is wanted, on `level`.
    before : tuple of b tuples of m float, SI
        Values along the base's path, at the first b load steps.
    base_limit : float, Pa
        Limit pressure of the base's path; NaN where it was not met.
    """

    pressure: tuple[float, ...] = ()
    effects_dir: str | None = None
    coarser: str = ""
    before: tuple[tuple[float, ...], ...] = ()
    base_limit: float = math.nan


def solve_pair(task: Task) -> Row:
    """Solve a `PairTask` with the finite elements, derivatives included."""
    if not isinstance(task, PairTask):
        raise InputError("task", type(task).__name__, "a PairTask")
    if not task.coarser:
        return solved(task, task.level, effects=True)
    changed = solved(task, task.coarser, effects=True)
    plain = solved(task, task.coarser, effects=False)
    return added(task, changed, plain)


def solved(task: PairTask, level: str, *, effects: bool) -> Row:
    """The path of a task on a mesh level, with derivatives where effects are on."""
    from datagen.model import Model
    from datagen.response import Path as LoadPath

    design, parameters = task.split()
    folder = Path(task.effects_dir) if task.effects_dir else None
    if effects:
        model = Model(task.effects, level, parameters, folder)
    else:
        model = Model((), level)
    by = [name for name in task.variables if "." in name]
    response = model(
        [Design.from_sample(design)],
        [LoadPath(np.array(task.pressure))],
        sensitivities=by if effects else False,
    )
    return Row.from_response(task.row, response)


def added(task: PairTask, changed: Row, plain: Row) -> Row:
    """The base's path with the difference of two paths on a coarser mesh added to it.

    The limit pressure moves in the same proportion, and the path goes as far as all
    three do and no further than that.
    """
    before = np.array(task.before)
    limit, moved = changed.limit_pressure, task.base_limit / plain.limit_pressure
    if math.isfinite(moved):
        limit *= moved
    steps = min(len(before), len(changed.status), len(plain.status))
    good = (changed.status[:steps] == 0) & (plain.status[:steps] == 0)
    if math.isfinite(limit):
        good &= changed.pressure[:steps] <= limit
    steps = int(np.logical_and.accumulate(good).sum())
    end = changed if plain.path_status in PROPER_ENDS else plain
    return Row(
        row=task.row,
        outputs=changed.outputs,
        pressure=changed.pressure[:steps],
        values=before[:steps] + (changed.values[:steps] - plain.values[:steps]),
        status=changed.status[:steps],
        path_status=end.path_status,
        limit_pressure=limit,
        message=end.message,
        parameters=changed.parameters,
        jacobian=None if changed.jacobian is None else changed.jacobian[:steps],
    )


@dataclass(frozen=True, eq=False)
class Plan:
    """Which designs an increment solves again, and at which parameters.

    Parameters
    ----------
    effects : tuple of str
        By name.
    space : Space
        The base's variables, then ``effect.parameter`` over the stated ranges.
    base_row : (n,) int array
    inputs : (n, d) array, SI
        In the order of `space`.
    seed : int
    unfit : int
        Designs passed over because the effects cannot act on them.
    """

    effects: tuple[str, ...]
    space: Space
    base_row: Array
    inputs: Array
    seed: int
    unfit: int

    def __len__(self) -> int:
        return len(self.base_row)


def mesh_of(base: Dataset) -> str:
    """Mesh level on which a dataset is solved again, whatever generator it is of.

    Raises
    ------
    InputError
        When this program has not got the mesh of that generator.
    """
    from datagen.levels import FORMER
    from datagen.model import GENERATOR_VERSION

    if base.generator_version == GENERATOR_VERSION:
        return base.level
    former = f"{base.level}-{base.generator_version}"
    if former not in FORMER:
        raise InputError(
            "dataset",
            f"generator {base.generator_version}, mesh {base.level}",
            f"generator {GENERATOR_VERSION}, or mesh {', '.join(FORMER)}",
        )
    return former


def stated_range(
    parameter: Parameter, value: float, std: float, deviations: float = 3.0
) -> tuple[float, float]:
    """Range around a fitted value over which its effect is learned.

    So many standard deviations to each side, at least a tenth of the declared range,
    inside the declared range; and on to `off` where that is no further away than the
    range is wide, so that the effect is learned from nothing on.

    Parameters
    ----------
    parameter : Parameter
        As the effect declares it.
    value, std : float, SI
    """
    if not (math.isfinite(value) and math.isfinite(std) and std >= 0):
        raise InputError(parameter.name, (value, std), "finite, and std 0 or more")
    half = max(deviations * std, 0.1 * (parameter.upper - parameter.lower))
    middle = min(max(value, parameter.lower), parameter.upper)
    lower = max(parameter.lower, middle - half)
    upper = min(parameter.upper, middle + half)
    off, width = parameter.off, upper - lower
    if off is not None and lower - width <= off <= upper + width:
        lower, upper = min(lower, off), max(upper, off)
    return lower, upper


def ranged_space(
    effects: Sequence[str],
    ranges: Mapping[str, tuple[float, float]],
    effects_dir: Path | None = None,
) -> Space:
    """The design space, then each parameter of the effects over its stated range.

    Raises
    ------
    EffectError
        When an effect is unknown.
    InputError
        When there is no effect, a range is missing, not of these effects, empty, or
        outside what the effect declares.
    """
    from datagen.model import Model

    if not effects:
        raise InputError("effects", "", "at least one")
    whole = Model(tuple(effects), effects_dir=effects_dir).space
    declared = [p for p in whole if "." in p.name]
    known = ", ".join(p.name for p in declared)
    for name in ranges:
        if name not in whole.names or "." not in name:
            raise InputError("range", name, known)
    found = []
    for parameter in declared:
        if parameter.name not in ranges:
            raise InputError("range", parameter.name, f"one for each of {known}")
        lower, upper = (parameter.check(end) for end in ranges[parameter.name])
        found.append(replace(parameter, lower=lower, upper=upper))
    return Space(DESIGN_SPACE.parameters + tuple(found))


def plan(
    base: Dataset,
    space: Space,
    paths: int,
    seed: int,
    near: Sequence[Design] = (),
    fits: Fits | None = None,
) -> Plan:
    """Choose designs of the base and values of the parameters.

    Designs are those that stand best for all the others (greedy facility location), a
    stated share of them nearest to given ones; `TEST_PATHS` of them are designs that
    the base has held out.  A design comes twice only when there are no more.

    Parameters
    ----------
    base : Dataset
        Without effects.
    space : Space
        Of `ranged_space`.
    paths : int
    seed : int
        Of the Latin hypercube of the parameters.
    near : sequence of Design
        Designs for which the answer is wanted most, as those that were measured.
    fits : callable, optional
        As `Fits`; designs on which the effects cannot act are passed over.

    Raises
    ------
    InputError
        When there are fewer than 2 paths, or too few designs that fit.
    """
    if base.effects:
        raise InputError("dataset", ", ".join(base.effects), "one without effects")
    if base.variables != tuple(p.name for p in space if "." not in p.name):
        raise InputError("dataset", ", ".join(base.variables), "the design space")
    if isinstance(paths, bool) or not isinstance(paths, int) or paths < 2:
        raise InputError("paths", paths, "a whole number of at least 2")
    parameters = [p for p in space if "." in p.name]
    effects = tuple(sorted({p.name.split(".")[0] for p in parameters}))
    values = Space(tuple(parameters)).sample(paths, seed)
    names = [p.name for p in parameters]
    good, held = _good(base), held_out(base)
    points = _standardised(base)
    tests = max(1, round(TEST_PATHS * paths)) if (good & held).any() else 0
    chosen: list[int] = []
    unfit = 0
    for pool, count, wanted in (
        (np.flatnonzero(good & ~held), paths - tests, near),
        (np.flatnonzero(good & held), tests, ()),
    ):
        order = _repeated(_order(points, pool, base, wanted), 2 * len(pool) + count)
        for _ in range(count):
            own = split_inputs(tuple(names), values[len(chosen)], effects)[1]
            for row in order:
                if fits is None or fits(base.design(row), own):
                    chosen.append(row)
                    break
                unfit += 1
            else:
                raise InputError(
                    "dataset",
                    f"{len(chosen)} designs on which the effects can act",
                    f"one that has them for {paths} paths",
                )
    base_row = np.array(chosen, dtype=np.int64)
    inputs = np.concatenate([base.inputs[base_row], values], axis=1)
    return Plan(effects, space, base_row, inputs, int(seed), unfit)


def ranked_rows(base: Dataset) -> Array:
    """(n,) rows that training sees and pairs need, those that stand best for all first.

    Parameters
    ----------
    base : Dataset
    """
    pool = np.flatnonzero(_good(base) & ~held_out(base))
    return np.array(_representative(_standardised(base), pool), dtype=np.int64)


def _good(base: Dataset) -> Array:
    """(n,) bool.  Paths that went as far as they can, and not too short."""
    whole = np.array([status in PROPER_ENDS for status in base.path_status])
    steps = np.array([base.steps(i) for i in range(len(base))])
    good: Array = whole & (steps >= FEWEST_STEPS)
    return good


def _standardised(base: Dataset) -> Array:
    """(n, g) dimensionless groups, centred and scaled."""
    raw = groups(columns_of(base.variables, base.inputs))
    scale: Array = raw.std(axis=0)
    points: Array = (raw - raw.mean(axis=0)) / np.where(scale > 1e-9, scale, 1.0)
    return points


def _order(
    points: Array, pool: Array, base: Dataset, near: Sequence[Design]
) -> list[int]:
    """Rows of the pool, best first: the i-th list of rows holds the (i-1)-th."""
    best = _representative(points, pool)
    if not near:
        return best
    raw = groups(columns_of(base.variables, base.inputs))
    scale = np.where(raw.std(axis=0) > 1e-9, raw.std(axis=0), 1.0)
    sampled = [[d.sampled()[name] for name in base.variables] for d in near]
    wanted = groups(columns_of(base.variables, np.array(sampled)))
    away = (((raw[pool, None] - wanted[None]) / scale) ** 2).sum(axis=2)
    # The nearest of each design in turn, then the second nearest of each, ...
    nearest = iter(pool[np.argsort(away, axis=0, kind="stable")].ravel().tolist())
    others = iter(best)
    mixed: list[int] = []
    due = 0.0
    for _ in range(len(pool)):
        due += NEAR_PATHS
        source = nearest if due >= 1 else others
        due -= due >= 1
        mixed.append(next(row for row in source if row not in mixed))
    return mixed


def _representative(points: Array, pool: Array) -> list[int]:
    """Rows of the pool, each the one that brings all of them nearest to a chosen one.

    Greedy facility location (Cornuejols, Fisher and Nemhauser, Management Science 23,
    1977): the sum over the pool of the distance to the nearest chosen row falls most.
    """
    own = points[pool]
    away = np.sqrt(((own[:, None] - own[None]) ** 2).sum(axis=2))
    nearest = np.full(len(pool), away.max() + 1 if len(pool) else 0.0)
    found: list[int] = []
    left = np.ones(len(pool), dtype=bool)
    for _ in range(len(pool)):
        total = np.minimum(nearest[:, None], away).sum(axis=0)
        one = int(np.where(left, total, np.inf).argmin())
        left[one] = False
        nearest = np.minimum(nearest, away[:, one])
        found.append(int(pool[one]))
    return found


def _repeated(rows: list[int], most: int) -> Iterator[int]:
    """The rows again and again, `most` of them: an end where none of them fits."""
    for i in range(most if rows else 0):
        yield rows[i % len(rows)]


def fem_fits(
    effects: Sequence[str], level: str, effects_dir: Path | None = None
) -> Fits:
    """Whether the finite elements accept a design with the effects in it.

    Raises
    ------
    InputError
        When an effect answers to time or history: a path of the surrogate has none.
    """
    return partial(_fem_fits, tuple(effects), level, effects_dir)


def _fem_fits(
    effects: tuple[str, ...],
    level: str,
    effects_dir: Path | None,
    design: Design,
    values: Values,
) -> bool:
    from datagen.model import Model

    model = Model(effects, level, values, effects_dir)
    try:
        problem = model.problem(design)
    except InputError:
        return False
    if problem.swellings or any(law.history_size for law in problem.laws):
        raise InputError(
            "effects",
            ", ".join(effects),
            "effects that act at once: the surrogate knows no time and no history; "
            "the finite elements do",
        )
    return True


def increment_tasks(
    planned: Plan, base: Dataset, level: str, effects_dir: Path | None
) -> list[PairTask]:
    """The paths of a plan, in its order."""
    held = held_out(base)
    # The former drafts are as coarse.
    coarser = "" if level.startswith(COARSER) else COARSER
    return [
        PairTask(
            row=i,
            variables=planned.space.names,
            inputs=tuple(planned.inputs[i].tolist()),
            effects=planned.effects,
            level=level,
            max_pressure=base.max_pressure,
            sensitivities=True,
            pressure=_load_steps(base, row),
            effects_dir=str(effects_dir) if effects_dir else None,
            coarser="" if held[row] else coarser,
            before=tuple(map(tuple, base.values[row, : base.steps(row)].tolist())),
            base_limit=float(base.limit_pressure[row]),
        )
        for i, row in enumerate(planned.base_row.tolist())
    ]


def solve_increment(
    planned: Plan,
    base: Dataset,
    out: str | Path,
    *,
    level: str | None = None,
    effects_dir: Path | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    resume: bool = False,
    progress: Callable[[Progress], None] | None = None,
    executor: Executor | None = None,
    solve: Solve = solve_pair,
    version: str | None = None,
) -> Dataset:
    """Solve the paths of a plan into one HDF5 file, resumable as `generate` is.

    Parameters
    ----------
    planned : Plan
    base : Dataset
        The one that was planned with.
    out : path
    level : str, optional
        Mesh level; that of the base by default, which pairs need.
    version : str, optional
        Version of what `solve` computes; that of the finite elements by default.
    effects_dir, workers, scheduler, resume, progress, executor, solve
        As in `datagen.generate.generate`, and so are the errors.

    Returns
    -------
    Dataset
        With `base_row`, the row of the base that each path is paired with.
    """
    level = mesh_of(base) if level is None else level
    tasks = increment_tasks(planned, base, level, effects_dir)
    return solve_paired(
        tasks,
        base,
        planned.space,
        planned.inputs,
        planned.base_row,
        out,
        seed=planned.seed,
        version=version,
        workers=workers,
        scheduler=scheduler,
        resume=resume,
        progress=progress,
        executor=executor,
        solve=solve,
    )


def solve_paired(
    tasks: Sequence[PairTask],
    base: Dataset,
    space: Space,
    inputs: Array,
    base_row: Array,
    out: str | Path,
    *,
    seed: int,
    version: str | None = None,
    **how: Any,
) -> Dataset:
    """Solve paths that are paired with rows of a base into one HDF5 file.

    Parameters
    ----------
    tasks : sequence of n PairTask
        All of the same effects and level.
    base : Dataset
    space : Space
    inputs : (n, d) array, SI
        In the order of `space`.
    base_row : (n,) int array
    out : path
    seed : int
        Of the inputs.
    version : str, optional
        Of what computes the paths; that of the finite elements by default.
    how
        As in `datagen.generate.solve_all`, and so are the errors.
    """
    from datagen.model import GENERATOR_VERSION

    manifest = Manifest(
        designs=len(tasks),
        seed=seed,
        effects=tasks[0].effects,
        level=tasks[0].level,
        max_pressure=base.max_pressure,
        generator_version=GENERATOR_VERSION if version is None else version,
        design_space=tuple(space_to_json(space)),
        inputs_sha256=inputs_digest(inputs),
        sensitivities=len(tasks),
        base=base.digest(),
    )
    fixed = {"inputs": inputs, "space": space, "base_row": base_row}
    return solve_all(out, manifest, tasks, fixed, **how)


def _load_steps(base: Dataset, row: int) -> tuple[float, ...]:
    """Pressures of a base's path, then even steps to the highest pressure, Pa.

    An effect may carry a path past the limit pressure of its base.
    """
    own = base.pressure[row, : base.steps(row)]
    even = base.max_pressure * np.arange(1, EVEN_STEPS + 1) / EVEN_STEPS
    further = even[even > own[-1] * (1 + 1e-6)]
    return tuple(np.concatenate([own, further]).tolist())
