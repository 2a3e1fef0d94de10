"""What draft meshes and slopes at off know of an effect: docs/corrected-surrogate.md.

Devices at random from the shipped slopes, solved with a cure mismatch on the standard
mesh, which is the answer sought, and on the draft mesh with it and without.  Run by
``python docs/measure.py differences``, or alone as ``python -m docs.differences``;
minutes.
"""

from __future__ import annotations

import time
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from datagen.dataset import Dataset
from datagen.response import Path
from surrogate.ensemble import REFERENCE
from surrogate.slopes import SHIPPED

Array = np.ndarray

DEVICES, SEED = 12, 5
EFFECT, PARAMETER, VALUE = "cure_mismatch", "difference", -0.006
MEASURED = {"tip_deflection": 0, "bending_angle": 1, "inflation": 2}
WORKERS = 2


def solve(task: tuple[int, str, bool]) -> tuple[Array, float]:
    """(s, m) values, NaN where not reached, of a row of the slopes; and its seconds."""
    from datagen.model import Model

    row, level, on = task
    slopes = Dataset.read(SHIPPED)
    path = Path(slopes.pressure[row, : slopes.steps(row)])
    active = (EFFECT,) if on else ()
    model = Model(active, level, {EFFECT: {PARAMETER: VALUE}} if on else {})
    began = time.perf_counter()
    values = model([slopes.design(row)], [path]).values[0]
    return values, time.perf_counter() - began


def main() -> None:
    """Print the table."""
    slopes, base = Dataset.read(SHIPPED), Dataset.read(REFERENCE / "dataset.h5")
    assert slopes.base_row is not None and slopes.jacobian is not None
    rng = np.random.default_rng(SEED)
    rows = [int(row) for row in rng.choice(len(slopes), DEVICES, replace=False)]
    kinds = (("standard", True), ("draft", True), ("draft", False))
    tasks = [(row, level, on) for row in rows for level, on in kinds]
    with ProcessPoolExecutor(WORKERS) as pool:
        found = list(pool.map(solve, tasks))
    seconds = np.array([took for _, took in found]).reshape(-1, len(kinds)).sum(axis=0)
    place = slopes.parameters.index(f"{EFFECT}.{PARAMETER}")
    shares: list[list[Array]] = []
    for i, row in enumerate(rows):
        sought, draft, plain = (values for values, _ in found[3 * i : 3 * i + 3])
        steps = slopes.steps(row)
        of_base = int(slopes.base_row[row])
        own = np.searchsorted(base.pressure[of_base], slopes.pressure[row, :steps])
        before = base.values[of_base, own]
        slope = VALUE * slopes.jacobian[row, :steps, :, place]
        largest = np.nanmax(np.abs(sought), axis=0)
        errors = (
            sought - before,
            draft - sought,
            before + (draft - plain) - sought,
            before + slope - sought,
        )
        shares.append([100 * np.nanmedian(np.abs(e), axis=0) / largest for e in errors])
    median = np.median(np.array(shares), axis=0)
    heads = ("what the effect changes", "the draft path", "difference of drafts added")
    _line("%", *heads, "slope at off added")
    _line(*["---"] * 5)
    for name, o in MEASURED.items():
        plain_name = name.replace("_", " ")
        _line(plain_name, *(f"{value:.2f}" for value in median[:, o]))
    print(
        f"\nA {EFFECT.replace('_', ' ')} of {100 * VALUE:g} % on {DEVICES} devices at "
        "random: medians over them of the median along a path, in percent of the "
        "path's largest magnitude; the last three are errors against the standard "
        f"mesh. The two draft paths took {(seconds[1] + seconds[2]) / seconds[0]:.2f} "
        "of the standard path's time."
    )


def _line(*cells: str) -> None:
    print(f"| {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
