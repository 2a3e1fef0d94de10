"""Paths with effects beside those of their bases: what the change is learned from.

Derivatives by the parameters bring more rows of each path at no cost: half way to off
along the parabola through the known ends and the slope there, and a little to each side
along each parameter where there are several.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from datagen.dataset import Dataset
from datagen.errors import InputError

from .features import columns_of

Array = np.ndarray

ASIDE = 0.1
"""Step along one parameter, of its range, over which a slope is trusted alone."""


@dataclass(frozen=True, eq=False)
class Pairs:
    """Paths with effects beside those of their bases, n designs, s load steps.

    Parameters
    ----------
    data : Dataset
        With the effects.
    before : (n, s, m) array, SI
        The base's path at the same pressures; 0 where `shared` is not.
    shared : (n, s) bool array
        Steps that both paths reached.
    base_limit : (n,) array, Pa
        Limit pressure of the base's path; NaN where it was not met.
    """

    data: Dataset
    before: Array
    shared: Array
    base_limit: Array

    def __len__(self) -> int:
        return len(self.data)

    def subset(self, rows: Array) -> Pairs:
        """Those designs alone."""
        return Pairs(
            self.data.subset(rows),
            self.before[rows],
            self.shared[rows],
            self.base_limit[rows],
        )

    @property
    def pressure(self) -> Array:
        """(n, s) Pa; 0 where a step is not shared."""
        own: Array = np.where(self.shared, self.data.pressure, 0.0)
        return own

    @property
    def difference(self) -> Array:
        """(n, s, m) SI; 0 where a step is not shared."""
        found: Array = np.where(
            self.shared[..., None], self.data.values - self.before, 0.0
        )
        return found

    @property
    def largest(self) -> Array:
        """(n, s, m) larger magnitude of the two, SI; 0 where a step is not shared."""
        after = np.where(self.shared[..., None], self.data.values, 0.0)
        found: Array = np.maximum(np.abs(self.before), np.abs(after))
        return found

    @property
    def log_shift(self) -> Array:
        """(n,) logarithm of limit pressure over the base's; NaN where one is not."""
        found: Array = np.log(self.data.limit_pressure / self.base_limit)
        return found


def pair(base: Dataset, increment: Dataset) -> Pairs:
    """Put each path of an increment beside its base's.

    Raises
    ------
    InputError
        When the increment is paired with another dataset, or a design is not the one
        of its base.
    """
    if increment.base_row is None or increment.base != base.digest():
        raise InputError("increment", increment.base[:12], "one made from this dataset")
    if increment.outputs != base.outputs:
        raise InputError(
            "outputs", ", ".join(increment.outputs), ", ".join(base.outputs)
        )
    rows = increment.base_row
    width = len(base.variables)
    if not np.array_equal(increment.inputs[:, :width], base.inputs[rows]):
        raise InputError("increment", "designs", "those of the base's rows")
    before = np.zeros_like(increment.values)
    shared = np.zeros(increment.status.shape, dtype=bool)
    for i, row in enumerate(rows):
        steps = min(base.steps(int(row)), increment.pressure.shape[1])
        given = np.isfinite(increment.pressure[i, :steps])
        if (increment.pressure[i, :steps] != base.pressure[row, :steps])[given].any():
            raise InputError("increment", f"row {i}", "the load steps of its base")
        before[i, :steps] = base.values[row, :steps]
        shared[i, :steps] = increment.status[i, :steps] == 0
    return Pairs(increment, before, shared, base.limit_pressure[rows])


def tuned_names(space: Any) -> tuple[str, ...]:
    """Names of the parameters of effects in a space."""
    return tuple(p.name for p in space if "." in p.name)


def inputs_of(data: Dataset) -> tuple[dict[str, Array], Array]:
    """Columns of the design's variables, and (n, j) values of the parameters."""
    width = len(data.variables) - len(tuned_names(data.space))
    columns = columns_of(data.variables[:width], data.inputs[:, :width])
    return columns, data.inputs[:, width:]


def views_of(pairs: Pairs) -> list[tuple[Array, Array]]:
    """Parameters (n, j) and differences (n, s, m) there: of the paths, and near them.

    The first is what was solved.  With d its difference and d' its slope towards the
    parameters from off, the parabola through 0, d and d' gives 3/4 d - 1/4 d' half way.
    """
    data, difference = pairs.data, pairs.difference
    _, values = inputs_of(data)
    found = [(values, difference)]
    slopes = data.jacobian
    names = tuned_names(data.space)
    if slopes is None or data.parameters != names:
        return found
    # At a limit point there are no slopes, and no views but what was solved.
    slopes = np.where(np.isfinite(slopes), slopes, np.nan)
    tuned = [data.space[name] for name in names]
    off = np.array([0.0 if p.off is None else p.off for p in tuned])
    along = np.einsum("nsmj,nj->nsm", slopes, values - off)
    found.append(((values + off) / 2, 0.75 * difference - 0.25 * along))
    if len(names) == 1:
        return found
    for j, p in enumerate(tuned):
        step = np.where(values[:, j] > (p.lower + p.upper) / 2, -ASIDE, ASIDE) * (
            p.upper - p.lower
        )
        moved = values.copy()
        moved[:, j] += step
        found.append((moved, difference + slopes[..., j] * step[:, None, None]))
    return found
