"""``docs/accuracy.md``: what `accuracy` measured, in words and tables."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby

import numpy as np

from datagen.units import BY_FIELD

from .accuracy import Accuracy, OutputError

HEAD = (
    "| quantity | rmse | median % | 95th % | worst % | R2 | inside 90 % |\n"
    "| --- | --- | --- | --- | --- | --- | --- |\n"
)


def markdown(found: Accuracy, command: str) -> str:
    """The whole document.

    Parameters
    ----------
    found : Accuracy
    command : str
        What prints the same numbers.
    """
    parts = [
        "# Accuracy of the surrogate\n",
        f"Model `{found.version}`, trained on {found.n_train} designs; errors against "
        f"the finite elements on {found.n_test} designs ({found.test_steps} load "
        "steps) that no part of the training has seen.  Held-out designs are chosen by "
        "a hash of the design itself, so a larger dataset keeps them held out.\n",
        "Percentages are of each path's own largest magnitude, every design counts the "
        "same however many load steps it has, and the last column is the share of "
        "points inside their 90 % interval.  Measured by "
        f"`{command}`.\n",
        HEAD + _rows(found.outputs),
        f"Over all quantities {found.coverage:.1%} of the points are inside.\n",
    ]
    if found.limit:
        limit = found.limit
        parts.append(
            f"Limit pressure: {limit.designs} of these designs meet it; the prediction "
            f"is {limit.median_pct:.1f} % off in the median and {limit.p95_pct:.1f} % "
            f"at the 95th percentile.  The range check misses {limit.missed} of them "
            f"and holds {limit.false_alarms} designs back that have none.\n"
        )
    for by, regions in groupby(found.regions, key=lambda region: region.by):
        parts.append(f"## By {by.replace('_', ' ')}\n")
        for region in regions:
            title = f"{region.name}, {region.designs} designs:\n"
            parts.append(f"{title}\n{HEAD}{_rows(region.outputs)}")
    return "\n".join(parts)


def _rows(outputs: dict[str, OutputError]) -> str:
    return "".join(_row(name, error) for name, error in outputs.items())


def _row(name: str, error: OutputError) -> str:
    bench = BY_FIELD[name]
    cells: Iterable[str] = (
        f"{bench.field.replace('_', ' ')}",
        f"{bench.from_si(error.rmse):.3g} {bench.unit}",
        f"{error.median_pct:.2f}",
        f"{error.p95_pct:.2f}",
        f"{error.max_pct:.1f}",
        f"{error.r2:.4f}" if np.isfinite(error.r2) else "-",
        f"{error.coverage:.1%}",
    )
    return f"| {' | '.join(cells)} |\n"
