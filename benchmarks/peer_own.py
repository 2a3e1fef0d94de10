"""Our own solver as one of the programs compared: ``peer_own LEVEL ANSWER``."""

from __future__ import annotations

import argparse
import time
from importlib import metadata
from pathlib import Path

import numpy as np

from datagen.continuation import PathFollower
from datagen.control import Options
from datagen.equilibrium import Workspace
from datagen.model import GENERATOR_VERSION

from .case import PRESSURES, problem_of
from .exchange import Answer, Cost

TOLERANCE = (
    f"every displacement to {Options().tolerance:.0e} of the thinnest wall, estimated "
    "from the last correction"
)


def solve(level: str, pressure: np.ndarray = PRESSURES) -> Answer:
    """Follow the path on one mesh level.

    Raises
    ------
    ArithmeticError
        When the path ends before the last pressure.
    """
    problem = problem_of(level)
    began, busy = time.perf_counter(), time.process_time()
    workspace = Workspace()
    follower = PathFollower(problem, workspace)
    outcome = follower.run(pressure)
    seconds, busy = time.perf_counter() - began, time.process_time() - busy
    if outcome.status != "completed":
        raise ArithmeticError(outcome.message)
    packages = ("numpy", "scipy", "numba", "scikit-fem")
    versions = {name: metadata.version(name) for name in packages}
    versions["pba generator"] = GENERATOR_VERSION
    if workspace.backend == "pardiso":
        versions["mkl"] = metadata.version("mkl")
    return Answer(
        np.stack([point.x - problem.nodes for _, point in outcome.points]),
        Cost(
            seconds=seconds,
            processor=busy,
            iterations=follower.counters.iterations,
            factorisations=follower.counters.factorisations,
            unknowns=follower.equations.unknowns,
            versions=versions,
        ),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("level")
    parser.add_argument("answer", type=Path)
    given = parser.parse_args()
    solve("draft", PRESSURES[:1])  # numba compiles or loads its kernels
    solve(given.level).write(given.answer)


if __name__ == "__main__":
    main()
