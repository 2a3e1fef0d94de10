"""Jobs on measurements: compare, rank, adopt; from JSON to JSON.

A payload holds the files (one, but for an adoption), their tolerances as in
`discrepancy.measurement.Tolerances`, and what the command line's options of the same
names say.  Solves are kept in the server's state folder: a job that was killed goes on
where it was.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from datagen.errors import InputError

from .workers import Report

if TYPE_CHECKING:
    from discrepancy.measurement import Measurements
    from discrepancy.solves import Progress, Solver


@contextmanager
def _solver(payload: Mapping[str, Any], report: Report) -> Iterator[Solver]:
    from discrepancy.solves import Solver

    from .discrepancy import cores

    def update(now: Progress) -> None:
        report({"what": now.what, "done": now.done, "total": now.total})

    with Solver(cores(), Path(payload["cache"]), update) as solver:
        yield solver


def measured_of(payload: Mapping[str, Any]) -> list[Measurements]:
    """The measurements that a job is about, a file each."""
    from discrepancy.measurement import Tolerances
    from discrepancy.reading import read_measurements

    for file in payload["files"]:
        if not Path(file).is_file():
            words = "measurements that are kept; these were deleted before the work"
            raise InputError("measurements", Path(file).name, words)
    allowed = Tolerances(**payload["tolerances"])
    return [read_measurements(file, allowed) for file in payload["files"]]


def compare(payload: Mapping[str, Any], report: Report) -> dict[str, Any]:
    """The object of ``pba compare --json``."""
    from discrepancy.compare import compare as hold
    from discrepancy.study import Study

    from .comparison import comparison_json

    level = payload["level"]
    with _solver(payload, report) as solver:
        (measured,) = measured_of(payload)
        study = Study(measured, solver, level=level, fast=level, effects=())
        return comparison_json(hold(study, payload["seed"]), level)


def rank(payload: Mapping[str, Any], report: Report) -> dict[str, Any]:
    """The object of ``pba rank --json``; the report is the job's file."""
    from .ranked import ranked

    (measured,) = measured_of(payload)
    with _solver(payload, report) as solver:
        found = ranked(
            measured,
            solver,
            level=payload["level"],
            effects=payload["effects"],
            seed=payload["seed"],
        )
    return found.to_json() | {"file": _kept(payload, found.page)}


def adopt(payload: Mapping[str, Any], report: Report) -> dict[str, Any]:
    """The object of ``pba adopt --json``; the report is the job's file.

    A job that was killed after it had written its version finds it there and ends.
    """
    from .adopted import adopted

    found = adopted(
        payload["effects"],
        measured_of(payload),
        _solver(payload, report),
        out=payload["model"],
        on=payload["on"],
        workspace=Path(payload["workspace"]),
        level=payload["level"],
        use=payload["use"],
        report=True,
        seed=payload["seed"],
    )
    return found.to_json() | {"file": _kept(payload, found.page)}


def surrogate(payload: Mapping[str, Any], report: Report) -> dict[str, Any]:
    """The object of ``pba models train --json``; paths that are finished are kept."""
    from discrepancy.folder import read

    from .discrepancy import cores
    from .surrogates import about, train

    def update(stage: str, done: int, total: int, left: float | None) -> None:
        report({"what": stage, "done": done, "total": total, "seconds_left": left})

    version = read(Path(payload["folder"]))
    if version.version != payload["version"]:
        raise InputError("model", version.version, payload["version"])
    made = train(
        version,
        minutes=payload["minutes"],
        paths=payload["paths"],
        seed=payload["seed"],
        workers=cores(),
        restart=payload["restart"],
        report=update,
    )
    return about(made)


def _kept(payload: Mapping[str, Any], page: str) -> str:
    """Write a report to where the payload says; the path."""
    from datagen.atomic import write_text

    out = Path(payload["out"])
    out.parent.mkdir(parents=True, exist_ok=True)
    write_text(out, page)
    return str(out)
