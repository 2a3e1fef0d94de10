"""How often the intervals of the ladder are right: the table of docs/adopt.md.

Made-up residuals of devices, no finite elements.  Run by
``python docs/measure.py intervals``, or alone as ``python -m docs.intervals``.
"""

from __future__ import annotations

import numpy as np

from discrepancy.ladder import Judged
from tests.discrepancy.synthetic import residuals

DEVICES = (2, 3, 4, 6, 12, 25)
SETS = 500
ERROR = 2.0
"""Of both models, over the noise: the step from one to the other is none."""


def rates(count: int) -> tuple[float, float]:
    """Parts of the sets whose interval holds the error, and whose step is clear."""
    rng = np.random.default_rng(count)
    held = clear = 0
    for _ in range(SETS):
        found = Judged.of(*residuals((ERROR, ERROR), count, rng))
        _, low, high = found.error(0)
        held += low < ERROR < high
        clear += found.ratio(1, 0)[2] < 1
    return held / SETS, clear / SETS


def main() -> None:
    """Print the table."""
    held, clear = zip(*map(rates, DEVICES), strict=True)
    print(f"| devices | {' | '.join(map(str, DEVICES))} |")
    print(f"| {' | '.join(['---'] * (1 + len(DEVICES)))} |")
    for words, parts in (
        ("the interval holds the true error", held),
        ("a step that is none is called clear", clear),
    ):
        print(f"| {words} | {' | '.join(f'{part:.0%}' for part in parts)} |")
    print(f"\nOf {SETS} sets each.")


if __name__ == "__main__":
    main()
