"""What effects change to first order: derivatives of a base's paths, at off.

Many effects are small strains, small loads or small changes of a wall: what they change
is nearly linear in their parameters, and the derivative at off has nearly all of it.
It costs a fraction of a path, and those of all effects of the catalogue come along with
one path.  Those of the shipped dataset are shipped, too; for other datasets, and for a
user's own effects, some are solved before an increment.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from datagen.dataset import Dataset
from datagen.device import DESIGN_SPACE, Design
from datagen.errors import EffectError, FileError, InputError
from datagen.generate import Progress
from datagen.space import Parameter, Space
from datagen.worker import Row, Solve, Task

from .ensemble import REFERENCE
from .features import columns_of
from .increment import COARSER, PairTask, ranked_rows, solve_paired, solved
from .shift import far_end
from .split import held_out

if TYPE_CHECKING:
    from datagen.problem import Problem
    from datagen.sensitivity import Direction

Array = np.ndarray

SHIPPED = REFERENCE / "slopes.h5"
"""Those of the shipped dataset, by all effects of the catalogue that have any."""

BEYOND_MEDIAN = 2.0
"""How much larger than in the middle of its path a value at a far end may be taken."""

PROBES = 20
"""Designs that are tried for one on which an effect can act."""

MOST_STEPS = 7
"""Load steps of a path that are kept: neighbours say the same thing."""


@dataclass(frozen=True)
class SlopeTask(PairTask):
    """One path at off to be differentiated, on the level of the task."""


def solve_slopes(task: Task) -> Row:
    """Solve a `SlopeTask` with the finite elements.

    At `MOST_STEPS` of its load steps, in single precision, which is more than the mesh
    is worth.
    """
    if not isinstance(task, SlopeTask):
        raise InputError("task", type(task).__name__, "a SlopeTask")
    return thinned(solved(task, task.level, effects=True))


def thinned(row: Row) -> Row:
    """The converged steps that are kept, in single precision."""
    steps = int((row.status == 0).sum())
    kept = np.linspace(0, steps - 1, min(steps, MOST_STEPS)).round().astype(int)

    def single(array: Array) -> Array:
        rounded: Array = array[kept].astype(np.float32).astype(float)
        return rounded

    assert row.jacobian is not None
    return Row(
        row=row.row,
        outputs=row.outputs,
        pressure=row.pressure[kept],
        values=single(row.values),
        status=row.status[kept],
        path_status=row.path_status,
        limit_pressure=row.limit_pressure,
        message=row.message,
        parameters=row.parameters,
        jacobian=single(row.jacobian),
    )


def differentiable(
    effects: Sequence[str], base: Dataset, effects_dir: Path | None = None
) -> tuple[str, ...]:
    """Those of the effects that act at once and have derivatives at off.

    Effects that change what is held or meshed when they are turned on have none there,
    and those that answer to time or history have no place in a surrogate.

    Raises
    ------
    EffectError
        When an effect is unknown.
    """
    from datagen.sensitivity import check_alike, follows_path

    found = []
    for name in effects:
        for row in ranked_rows(base)[:PROBES]:
            ahead = _ahead((name,), base.design(row), effects_dir)
            if ahead is None:
                continue
            problem, directions = ahead
            try:
                check_alike(problem, directions)
            except EffectError:
                break
            if directions and not any(follows_path(d.problem) for d in directions):
                found.append(name)
            break
    return tuple(sorted(found))


def _ahead(
    effects: tuple[str, ...], design: Design, effects_dir: Path | None
) -> tuple[Problem, list[Direction]] | None:
    """A device with effects at off, and a step from there; None where none fits."""
    from datagen.model import Model

    model = Model(effects, COARSER, effects_dir=effects_dir)
    by = [p.name for p in model.space if "." in p.name and p.scale != "integer"]
    try:
        return model.problem(design), model.directions(design, by)
    except InputError:
        return None


def slopes_space(effects: Sequence[str], effects_dir: Path | None = None) -> Space:
    """Design variables, and the continuous parameters of effects as they declare them.

    Raises
    ------
    EffectError
        When an effect is unknown.
    """
    from datagen.model import Model

    whole = Model(tuple(effects), effects_dir=effects_dir).space
    own = [p for p in whole if "." in p.name and p.scale != "integer"]
    return Space(DESIGN_SPACE.parameters + tuple(own))


def slope_rows(
    base: Dataset,
    count: int | None = None,
    taken: Array | None = None,
    fits: Callable[[Design], bool] | None = None,
) -> Array:
    """(n,) rows of the base that training sees, those that stand best for all first.

    Parameters
    ----------
    count : int, optional
        As many of them; all by default.
    taken : int array, optional
        Rows that are wanted only when there are no others.
    fits : callable, optional
        Whether the effects can act on a design; others are passed over.
    """
    rows = ranked_rows(base)
    if taken is not None:
        seen = np.isin(rows, taken)
        rows = np.concatenate([rows[~seen], rows[seen]])
    if fits is not None:
        fitting = (row for row in rows.tolist() if fits(base.design(row)))
        rows = np.array(list(islice(fitting, count)), dtype=np.int64)
    return np.sort(rows[:count])


def fits_at_off(
    effects: tuple[str, ...], effects_dir: Path | None = None
) -> Callable[[Design], bool]:
    """Whether a design takes effects that are hardly more than off."""
    return lambda design: _ahead(effects, design, effects_dir) is not None


def solve_at_off(
    base: Dataset,
    space: Space,
    rows: Array,
    out: str | Path,
    *,
    effects_dir: Path | None = None,
    level: str = COARSER,
    workers: int = 1,
    scheduler: str | None = None,
    resume: bool = False,
    progress: Callable[[Progress], None] | None = None,
    executor: Executor | None = None,
    solve: Solve = solve_slopes,
    version: str | None = None,
) -> Dataset:
    """Solve rows of a base again, and differentiate them by effects that are off.

    Parameters
    ----------
    base : Dataset
        Without effects.
    space : Space
        Of `slopes_space`.
    rows : (n,) int array
        Of the base.
    out, level, workers, scheduler, resume, progress, executor, solve, version
        As in `increment.solve_increment`, and so are the errors.

    Returns
    -------
    Dataset
        Effects at off, with `base_row` and derivatives.
    """
    tuned = [p for p in space if "." in p.name]
    effects = tuple(sorted({p.name.split(".")[0] for p in tuned}))
    off = [0.0 if p.off is None else p.off for p in tuned]
    inputs = np.hstack([base.inputs[rows], np.tile(off, (len(rows), 1))])
    tasks = [
        SlopeTask(
            row=i,
            variables=space.names,
            inputs=tuple(inputs[i].tolist()),
            effects=effects,
            level=level,
            max_pressure=base.max_pressure,
            sensitivities=True,
            pressure=tuple(base.pressure[row, : base.steps(row)].tolist()),
            effects_dir=str(effects_dir) if effects_dir else None,
        )
        for i, row in enumerate(rows.tolist())
    ]
    return solve_paired(
        tasks,
        base,
        space,
        inputs,
        rows,
        out,
        seed=base.seed,
        version=version,
        workers=workers,
        scheduler=scheduler,
        resume=resume,
        progress=progress,
        executor=executor,
        solve=solve,
    )


def shipped(base: Dataset, effects: Sequence[str]) -> Dataset | None:
    """The shipped slopes, where they are this dataset's and have all of the effects."""
    try:
        found = Dataset.read(SHIPPED)
    except FileError:
        return None
    known = set(effects) <= set(found.effects)
    return found if known and found.base == base.digest() else None


@dataclass(frozen=True, eq=False)
class Tangent:
    """Paths without effects, and their derivatives by j parameters, n designs.

    Parameters
    ----------
    columns : mapping of (n,) arrays, SI
        The variables of the design space.
    base_row : (n,) int array
        Rows of the base's dataset.
    pressure : (n, s) array, Pa
        0 where there is no step.
    before : (n, s, m) array, SI
        0 where there is no step.
    good : (n, s) bool array
    tuned : tuple of j Parameter
        Over their stated ranges.
    known : tuple of k int
        Which of them have derivatives.
    jacobian : (n, s, m, k) array, SI
        NaN at limit points.
    """

    columns: Mapping[str, Array]
    base_row: Array
    pressure: Array
    before: Array
    good: Array
    tuned: tuple[Parameter, ...]
    known: tuple[int, ...]
    jacobian: Array

    @property
    def largest(self) -> Array:
        """(n, s, m) largest magnitude, at off or at a far end of a range, SI."""
        found: Array = np.abs(self.before)
        least = found.max(axis=1)
        for _, difference in self.views(1.0):
            known = np.isfinite(difference)
            after = np.abs(self.before + np.where(known, difference, 0.0))
            # Next to a limit point a straight line from off leads far beyond.
            seen = np.where(known & self.good[..., None], after, np.nan)
            most = np.maximum(least, BEYOND_MEDIAN * np.nanmedian(seen, axis=1))
            found = np.maximum(found, np.minimum(after, most[:, None]))
        return found

    def views(self, step: float) -> list[tuple[Array, Array]]:
        """Parameters (n, j) and differences (n, s, m) a step of t from off, along each.

        Parameters
        ----------
        step : float
            Of the coordinate that `shift.coordinates` gives.
        """
        off = np.array([0.0 if p.off is None else p.off for p in self.tuned])
        found = []
        for k, j in enumerate(self.known):
            values = np.tile(off, (len(self.base_row), 1))
            values[:, j] = far_end(self.tuned[j], step)
            found.append((values, self.jacobian[..., k] * (values[0, j] - off[j])))
        return found


def tangent_of(slopes: Dataset, base: Dataset, space: Space) -> Tangent | None:
    """The slopes by the parameters of a space, for training; None where it has none.

    Parameters
    ----------
    slopes : Dataset
        Whose rows are paired with the base's, effects at off.
    base : Dataset
    space : Space
        Design variables, and parameters over their stated ranges.

    Raises
    ------
    InputError
        When they were made from another dataset, or of other designs or outputs.
    """
    if slopes.base_row is None or slopes.base != base.digest():
        raise InputError("slopes", slopes.base[:12], "those of this dataset")
    width, rows = len(base.variables), slopes.base_row
    same = np.array_equal(slopes.inputs[:, :width], base.inputs[rows])
    if not same or slopes.outputs != base.outputs or slopes.jacobian is None:
        raise InputError("slopes", "designs, outputs", "those of the base's rows")
    tuned = tuple(p for p in space if "." in p.name)
    known, places = [], []
    for j, p in enumerate(tuned):
        if p.name in slopes.parameters:
            place = slopes.parameters.index(p.name)
            own = slopes.jacobian[..., place]
            # The direction of a weight that is nothing: true, and nothing to learn.
            if np.nanmax(np.abs(own), initial=0.0) > 0:
                known.append(j)
                places.append(place)
    found = slopes.jacobian[..., places]
    whole = np.isfinite(found).all(axis=2).any(axis=2)  # of all outputs, by some
    some = ((slopes.status == 0) & whole).any(axis=1)
    some &= ~held_out(slopes)
    if not some.any():
        return None
    slopes, found = slopes.subset(np.flatnonzero(some)), found[some]
    assert slopes.base_row is not None
    good = slopes.status == 0
    return Tangent(
        columns=columns_of(base.variables, base.inputs[slopes.base_row]),
        base_row=slopes.base_row,
        pressure=np.where(good, slopes.pressure, 0.0),
        before=np.where(good[..., None], slopes.values, 0.0),
        good=good,
        tuned=tuned,
        known=tuple(known),
        jacobian=found,
    )


def main(arguments: Sequence[str]) -> int:
    """``python -m surrogate.slopes DATASET OUT COUNT WORKERS``, by the whole catalogue.

    A run that was stopped goes on.
    """
    from datagen.effects import catalogue

    source, out, count, workers = arguments
    base = Dataset.read(source)

    def report(state: Progress) -> None:
        if state.done % 20 == 0:
            print(f"{state.done} of {state.total} paths at off", flush=True)

    found = solve_at_off(
        base,
        slopes_space(differentiable(tuple(catalogue()), base)),
        slope_rows(base, int(count)),
        out,
        workers=int(workers),
        resume=True,
        progress=report,
    )
    print(f"{out}: {len(found)} paths, {len(found.parameters)} derivatives each")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
