"""What derivatives add to the time of a path.

Prints a table of docs/finite-elements.md.  Run by
``python docs/measure.py derivatives``, or alone as ``python -m docs.derivative_cost``;
a few minutes on a core with nothing else to do.
"""

from __future__ import annotations

import time

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.bench_fem import hardware
from datagen.device import named_device
from datagen.effects.door import catalogue
from datagen.model import Model
from datagen.response import Path

ROUNDS = 7
PRESSURES = np.linspace(5e3, 60e3, 12)

NO_DERIVATIVE = ("clamp_compliance",)
"""Changes what is held: it has derivatives at other values than off alone."""

WITH_MEMORY = ("mullins", "swelling", "viscoelasticity")
"""Of time or of what was before."""


def settings() -> dict[str, tuple[Model, bool]]:
    """By its words: a model, and whether its path is differentiated."""
    every = [name for name in catalogue() if name not in NO_DERIVATIVE]
    plain = tuple(name for name in every if name not in WITH_MEMORY)
    return {
        "nothing": (Model(), False),
        "fields of the design": (Model(), True),
        f"those and {len(plain)} effects without memory": (Model(plain), True),
        f"all {len(every)} effects that have derivatives at off": (
            Model(tuple(every)),
            True,
        ),
    }


def main() -> None:
    """Print the table."""
    design, path = named_device("S1", 1), Path(PRESSURES)
    seconds: dict[str, list[float]] = {}
    counts: dict[str, int] = {}
    with threadpool_limits(1):
        for turn in range(ROUNDS + 1):  # the first compiles and analyses
            for words, (model, wanted) in settings().items():
                began = time.perf_counter()
                found = model([design], [path], sensitivities=wanted)
                spent = time.perf_counter() - began
                counts[words] = len(found.parameters) if wanted else 0
                if turn:
                    seconds.setdefault(words, []).append(spent)
    alone = np.array(seconds["nothing"])
    print("| differentiated by | parameters | s | more | middle half of the rounds |")
    print("| --- | --- | --- | --- | --- |")
    for words, spent in seconds.items():
        more = 100 * (np.array(spent) / alone - 1)
        low, middle, high = np.percentile(more, (25, 50, 75))
        cells = (f"{middle:.0f} %", f"{low:.0f} to {high:.0f} %")
        if words == "nothing":
            cells = ("", "")
        line = (words, str(counts[words]), f"{np.median(spent):.1f}", *cells)
        print(f"| {' | '.join(line)} |")
    print(
        f"\nS1 case 1, standard mesh, {len(PRESSURES)} load steps to "
        f"{PRESSURES[-1] / 1e3:g} kPa, one thread; medians of {ROUNDS} rounds, each of "
        f"which solves all of them, one after the other. {hardware()}."
    )


if __name__ == "__main__":
    main()
