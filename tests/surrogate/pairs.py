"""Increments from closed forms: a fake solver for pairs of synthetic paths.

Two effects: ``soft`` multiplies both moduli, which is another device exactly; ``tilt``
turns the strip by an angle, without pressure too, which no device does.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from datagen.dataset import Dataset
from datagen.device import DESIGN_SPACE
from datagen.response import OUTPUT_NAMES
from datagen.space import Parameter, Space
from datagen.worker import Row, Task, step_codes
from surrogate.change import ChangeSettings
from surrogate.equivalent import READ, Equivalent, same_device
from surrogate.increment import PairTask, plan, solve_increment
from surrogate.learn import Means
from surrogate.network import FitSettings
from surrogate.slopes import slope_rows, solve_at_off
from tests.datagen.fake_solver import Here
from tests.surrogate.synthetic import arc, response

Array = np.ndarray

SOFT = Parameter(
    "soft.factor", "1", 0.7, 1.1, scale="log", off=1.0, source="a test of ours"
)
TILT = Parameter("tilt.angle", "rad", 0.0, 0.2, off=0.0, source="a test of ours")
SPACES = {
    "soft": Space((*DESIGN_SPACE, SOFT)),
    "tilt": Space((*DESIGN_SPACE, TILT)),
    "both": Space((*DESIGN_SPACE, SOFT, TILT)),
}
VERSION = "synthetic pairs"

QUICK = ChangeSettings(
    folds=4,
    repeats=3,
    fit=FitSettings(
        hidden=(16,), steps=300, batch=128, rate=3e-3, decay=1.0, check_every=50
    ),
)


def truth(values: dict[str, float], pressure: Array) -> tuple[Array, float]:
    """Outputs (s, 5), NaN past the limit, and the limit pressure, Pa."""
    design = dict(values)
    factor = design.pop("soft.factor", 1.0)
    for name in ("upper_modulus", "lower_modulus"):
        design[name] *= factor
    limit = min(arc(design, layer)[0][-1] for layer in ("upper", "lower"))
    found = response(design, np.minimum(pressure, limit))
    found[pressure > limit * (1 + 1e-12)] = np.nan
    return found, float(limit)


def solve_synthetic(task: Task) -> Row:
    """A path of a `PairTask` with its derivatives by differences."""
    assert isinstance(task, PairTask)
    values = dict(zip(task.variables, task.inputs, strict=True))
    pressure = np.array(task.pressure)
    found, limit = truth(values, pressure)
    by = [name for name in task.variables if "." in name]
    slopes = np.empty((*found.shape, len(by)))
    for k, name in enumerate(by):
        ahead, back = (
            truth(values | {name: values[name] + h}, pressure)[0] for h in (1e-6, -1e-6)
        )
        slopes[..., k] = (ahead - back) / 2e-6
    reached = np.isfinite(found).all(axis=1)
    ended = not reached.all()
    return Row(
        row=task.row,
        outputs=OUTPUT_NAMES,
        pressure=pressure,
        values=found,
        status=step_codes(["converged" if r else "limit_point" for r in reached]),
        path_status="limit_point" if ended else "completed",
        limit_pressure=limit if ended else np.nan,
        message="",
        parameters=tuple(by),
        jacobian=slopes,
    )


@cache
def equivalent(which: str) -> Equivalent:
    """What `soft` makes of a device: exact, as its scale is logarithmic."""
    space = SPACES[which]
    same = same_device(len(space) - len(DESIGN_SPACE))
    if which == "tilt":
        return same
    weights, logarithmic = same.weights.copy(), same.logarithmic.copy()
    for name in ("upper_modulus", "lower_modulus"):
        i = READ.index(name)
        logarithmic[i] = True
        weights[i, 0] = np.log(1 / 0.7)  # at t = 1, or 0.7 at t = -1
    return Equivalent(weights, logarithmic)


def slopes(base: Dataset, out: Path, which: str, count: int) -> Dataset:
    """Solve synthetic paths at off, with their derivatives."""
    return solve_at_off(
        base,
        SPACES[which],
        slope_rows(base, count),
        out,
        level="synthetic",
        executor=Here(),
        solve=solve_synthetic,
        version=VERSION,
    )


def increment(base: Dataset, out: Path, which: str, paths: int, seed: int) -> Dataset:
    """Solve an increment of synthetic paths."""
    planned = plan(base, SPACES[which], paths, seed)
    return solve_increment(
        planned,
        base,
        out,
        level="synthetic",
        executor=Here(),
        solve=solve_synthetic,
        version=VERSION,
    )


def anything_fits(design: object, values: object) -> bool:
    return True


def means(which: str, *, slopes: bool = False) -> Means:
    """How `learn` solves these pairs, and at off, too, where slopes are wanted."""
    return Means(
        solve=solve_synthetic,
        version=VERSION,
        level="synthetic",
        space=SPACES[which],
        fits=anything_fits,
        equivalent=equivalent(which),
        slopes=SPACES[which] if slopes else None,
        solve_slopes=solve_synthetic,
    )
