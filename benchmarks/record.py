"""The benchmark's results as a file: ``docs/benchmarks/fem.json``."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from datagen.atomic import write_text

Array = np.ndarray

OWN, FINEST = "pba", "finest"
TURNS, SHORT = 3, 60.0
"""Runs of each program on each mesh, and how short, s, they are for more than one."""

MESHES = ("draft", "coarse", "standard", "medium", "fine", FINEST)


@dataclass(frozen=True)
class Run:
    """One program on one mesh, or the reason why it gave nothing.

    Parameters
    ----------
    program, mesh : str
    seconds, processor : float, s
        Wall time and processor time.
    iterations, factorisations, unknowns : int
    tip, inflation : list of float, um
        At each pressure of the record; empty where there is a `reason`.
    reason : str
        Why there is no result; empty where there is one.
    """

    program: str
    mesh: str
    unknowns: int = 0
    seconds: float = 0.0
    processor: float = 0.0
    iterations: int = 0
    factorisations: int = 0
    tip: list[float] = field(default_factory=list)
    inflation: list[float] = field(default_factory=list)
    reason: str = ""

    @property
    def done(self) -> bool:
        return not self.reason


@dataclass(frozen=True)
class Settled:
    """The converged answer that errors are of, and its error bars.

    Parameters
    ----------
    pressure : list of float, kPa
        Among those of the record.
    tip, inflation : list of float, um
    tip_bar, inflation_bar : float, um
    """

    pressure: list[float]
    tip: list[float]
    inflation: list[float]
    tip_bar: float
    inflation_bar: float

    @property
    def span(self) -> tuple[float, float]:
        """Largest amounts of tip and inflation, um."""
        return max(map(abs, self.tip)), max(map(abs, self.inflation))


@dataclass(frozen=True)
class Record:
    """All runs and what they have in common.

    Parameters
    ----------
    pressure : list of float, kPa
    hardware : str
    limit : float, s
        Time after which a run was stopped.
    tolerances : dict of program to str
    settled : Settled
    versions : dict of program to str
    runs : tuple of Run
    one_call : bool
        Whether one call of the command made all of them.
    """

    pressure: list[float]
    hardware: str
    limit: float
    tolerances: dict[str, str]
    settled: Settled
    versions: dict[str, str] = field(default_factory=dict)
    runs: tuple[Run, ...] = ()
    one_call: bool = False

    def with_run(self, run: Run) -> Record:
        """A copy with this run, in the place of an older one of the same name."""
        name = (run.program, run.mesh)
        runs = {(old.program, old.mesh): old for old in self.runs} | {name: run}
        order = list(self.tolerances)
        return replace(
            self,
            runs=tuple(
                sorted(
                    runs.values(),
                    key=lambda r: (order.index(r.program), MESHES.index(r.mesh)),
                )
            ),
        )

    def find(self, program: str, mesh: str) -> Run:
        """A run that gave a result.

        Raises
        ------
        LookupError
            When there is none.
        """
        for run in self.runs:
            if (run.program, run.mesh) == (program, mesh) and run.done:
                return run
        raise LookupError(f"no result of {program} on the {mesh} mesh")

    def errors(self, run: Run) -> tuple[float, float]:
        """Largest error of tip and inflation over the path, percent of its maximum."""
        spots = [self.pressure.index(at) for at in self.settled.pressure]
        pairs = ((run.tip, self.settled.tip), (run.inflation, self.settled.inflation))
        tip, inflation = (
            _error([mine[spot] for spot in spots], right) for mine, right in pairs
        )
        return tip, inflation

    def write(self, path: Path) -> None:
        write_text(path, json.dumps(asdict(self), indent=1) + "\n")

    @classmethod
    def read(cls, path: Path) -> Record:
        found = json.loads(path.read_text())
        found["runs"] = tuple(Run(**run) for run in found["runs"])
        return cls(**found | {"settled": Settled(**found["settled"])})


def _error(mine: Iterable[float], right: Iterable[float]) -> float:
    a, b = np.array(list(mine)), np.array(list(right))
    return float(100 * np.abs(a - b).max() / np.abs(b).max())


def cheapest(record: Record, program: str, tip: float, inflation: float) -> Run | None:
    """The run of a program that is at least so accurate in the least processor time.

    Parameters
    ----------
    tip, inflation : float, percent
        Largest errors allowed.
    """
    good = []
    for run in record.runs:
        if run.program == program and run.done:
            errors = record.errors(run)
            if errors[0] <= tip and errors[1] <= inflation:
                good.append(run)
    return min(good, key=lambda run: run.processor, default=None)
