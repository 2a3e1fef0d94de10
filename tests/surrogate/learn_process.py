"""A run of `learn` that kills itself: ``BASE DATASET OUT STAGE COUNT``.

At the COUNT-th report of STAGE (``increment`` or ``change``), or at the COUNT-th file
that is renamed while the model is written (``publish``), the process gets SIGKILL.
STAGE ``never`` lets it finish.
"""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from typing import Any

from datagen.dataset import Dataset
from surrogate.corrected import Corrected
from surrogate.ensemble import Ensemble
from surrogate.learn import learn
from tests.datagen.fake_solver import Here
from tests.surrogate.pairs import QUICK, means

PATHS, SEED = 20, 3


def run(
    base: Ensemble, dataset: Dataset, out: Path, stage: str = "never", last: int = 0
) -> Corrected:
    """Learn, resuming what is there; die where it is said."""
    seen = 0

    def count(here: str) -> None:
        nonlocal seen
        seen += here == stage
        if here == stage and seen == last:
            os.kill(os.getpid(), signal.SIGKILL)

    if stage == "publish":
        replace = os.replace

        def counted(*names: Any) -> None:
            if "model" in Path(names[1]).parts or Path(names[1]) == out:
                count("publish")
            replace(*names)

        os.replace = counted
    return learn(
        base,
        dataset,
        ("soft", "tilt"),
        {},
        out,
        paths=PATHS,
        seed=SEED,
        executor=Here(),
        resume=True,
        report=lambda where, *_: count(where),
        settings=QUICK,
        means=means("both"),
    )


if __name__ == "__main__":
    folder, data, target, where, number = sys.argv[1:]
    run(Ensemble.load(folder), Dataset.read(data), Path(target), where, int(number))
