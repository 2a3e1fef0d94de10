"""How often `pba compare` says that something is missing, right and wrong.

Made-up devices with errors of known size, no finite elements; prints the table of
docs/compare.md.  Run by ``python docs/measure.py alarms``, or alone as
``python -m docs.alarms``.
"""

from __future__ import annotations

import numpy as np

from discrepancy import missing, regions
from discrepancy.missing import Residuals, Score, overall, scores
from tests.discrepancy.synthetic import devices

DRAWS = 199
"""Simulated sets behind the p-value of a region: to half a percent."""

COLUMNS = {
    "smooth errors Gaussian": {"errors": "gaussian"},
    "of slope": {"errors": "slope"},
    "of waves": {"errors": "waves"},
    "Gaussian, an effect of 5 % above 30 % of the pressure": {
        "effect": 0.05,
        "begin": 0.3,
    },
}
SETS = {3: 500, 5: 500, 10: 500, 20: 250}
WITH_EFFECT = 200


def share(count: int, sets: int, seed: int, what: dict[str, object]) -> float:
    """Part of the sets of `count` devices in which something is said to be missing."""
    rng = np.random.default_rng(seed)
    said = 0
    for _ in range(sets):
        found, labels = devices(rng, count, **what)  # type: ignore[arg-type]
        clearest = regions.regions(found, labels)[0]
        tests = [
            *scores(Residuals(found), labels),
            Score(None, "region", count, 0.0, clearest),
        ]
        said += overall(tests) < missing.CLAIM
    return said / sets


def main() -> None:
    """Print the table."""
    regions.DRAWS = DRAWS
    print(f"| devices | {' | '.join(COLUMNS)} |")
    print(f"| {' | '.join(['---'] * (1 + len(COLUMNS)))} |")
    for count, sets in SETS.items():
        row = [
            share(count, WITH_EFFECT if "effect" in what else sets, count, dict(what))
            for what in COLUMNS.values()
        ]
        print(f"| {count} | {' | '.join(f'{100 * part:.1f} %' for part in row)} |")
    print(
        f"\nOf {SETS[3]} sets each ({SETS[20]} with 20 devices, {WITH_EFFECT} with an "
        "effect)."
    )


if __name__ == "__main__":
    main()
