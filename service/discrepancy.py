"""``pba compare``, and what it shares with ``pba rank``.

Options of the stated tolerances, the solver with its progress bar, and what Ctrl-C
leaves: solves that are kept, so that the same command goes on where it was.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.table import Table
from typer import Argument, Option

from datagen.errors import InputError

from .options import AsJson, Level, number, whole
from .terminal import Stopped, print_json, print_rich, progress_bar

if TYPE_CHECKING:
    from discrepancy.compare import Comparison
    from discrepancy.measurement import Measurements
    from discrepancy.solves import Progress, Solver

MeasurementFile = Annotated[
    Path,
    Argument(metavar="FILE", help="Measurements: a CSV file, or PEtab tables."),
]
ModulusTolerance = Annotated[
    float,
    Option(
        help="Standard deviation of each batch's modulus, in % of what is stated.",
        parser=number("--modulus-tolerance", 0, 50, "%"),
        metavar="%",
    ),
]
ThicknessTolerance = Annotated[
    float,
    Option(
        "--thickness-tolerance-um",
        "--thickness-tolerance",
        help="Standard deviation of each layer's thickness, in um.",
        parser=number("--thickness-tolerance-um", 0, 100, "um"),
        metavar="UM",
    ),
]
CameraTolerance = Annotated[
    float,
    Option(
        help="Standard deviation of the camera's scale in each curve, in %.",
        parser=number("--camera-tolerance", 0, 20, "%"),
        metavar="%",
    ),
]
Workers = Annotated[
    int | None,
    Option(
        help="Processes that solve at a time; one for each processor without it.",
        parser=whole("--workers", 1, 4096),
        metavar="K",
    ),
]
Cache = Annotated[
    Path | None,
    Option(
        metavar="DIR",
        help="Folder where solves are kept; else PBA_CACHE, or pba/solves in the "
        "user's cache.",
    ),
]


def _report(text: str) -> Path:
    """Parser of ``--report``: refuses what could not be written, before the work."""
    path = Path(text)
    if not path.parent.is_dir() or path.is_dir():
        raise InputError("--report", text, "a file in a folder that exists")
    if path.exists() and not (path.is_file() and _is_page(path)):
        raise InputError("--report", text, "a new file, or a page to write anew")
    if not os.access(path.parent, os.W_OK):
        raise InputError("--report", text, "a file in a folder that can be written to")
    return path


def _is_page(path: Path) -> bool:
    """Whether a file is HTML, as a report is, or empty; no one's measurements."""
    try:
        with path.open("rb") as file:
            start = file.read(200).lstrip().lower()
    except OSError:
        return False
    return not start or start.startswith((b"<!doctype html", b"<html"))


Seed = Annotated[
    int,
    Option(help="Of the samples.", parser=whole("--seed", 0, 2**31), metavar="N"),
]
Report = Annotated[
    Path | None,
    Option(
        metavar="FILE", help="Write a report, one HTML file, as well.", parser=_report
    ),
]


def measurements_of(
    file: Path, modulus: float, thickness: float, camera: float
) -> Measurements:
    """The measurements of a file, with tolerances in bench units.

    Raises
    ------
    FileError, MeasurementError, InputError
        When the file, a line of it or a tolerance is not allowed.
    """
    from discrepancy.reading import read_measurements

    from .measurements import tolerances

    return read_measurements(file, tolerances(modulus, thickness, camera))


def cores() -> int:
    """Processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def solving(workers: int | None, cache: Path | None, quiet: bool) -> Iterator[Solver]:
    """A solver that shows its progress on standard error.

    Parameters
    ----------
    workers : int or None
        One for each processor where None.
    cache : path or None
    quiet : bool
        Show nothing.

    Raises
    ------
    Stopped
        At Ctrl-C, with the words for the user.
    """
    from threadpoolctl import threadpool_limits

    from discrepancy.solves import Solver

    # Small matrices cost more in threads than in work, and workers have the cores.
    with threadpool_limits(1), progress_bar("paths", quiet=quiet) as bar:
        shown = bar.add_task("finite elements", total=None, note="")

        def update(now: Progress) -> None:
            bar.update(shown, description=now.what, completed=now.done, total=now.total)

        solver = Solver(workers or cores(), cache, update)
        try:
            with solver:
                yield solver
        except KeyboardInterrupt as stop:
            raise Stopped(
                f"interrupted; {solver.solved} solves of this run are kept in "
                f"{solver.cache}: the same command goes on from there"
            ) from stop


def compare(
    file: MeasurementFile,
    modulus_tolerance: ModulusTolerance = 5.0,
    thickness_tolerance: ThicknessTolerance = 3.0,
    camera_tolerance: CameraTolerance = 0.5,
    level: Level = "standard",
    workers: Workers = None,
    cache: Cache = None,
    as_json: AsJson = False,
) -> None:
    """The model against measurements: errors, noise, calibrations, where it fails."""
    measured = measurements_of(
        file, modulus_tolerance, thickness_tolerance, camera_tolerance
    )
    from discrepancy.compare import compare as hold
    from discrepancy.study import Study

    with solving(workers, cache, as_json) as solver:
        study = Study(measured, solver, level=level, fast=level, effects=())
        found = hold(study)
    if as_json:
        from .comparison import comparison_json

        print_json(comparison_json(found, level))
        return
    show(found)


def show(found: Comparison) -> None:
    """A comparison for people."""
    from discrepancy.columns import NUMBERS

    from .comparison import SOURCE_WORDS, calibration_text, quantity, verdict_text

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("quantity", no_wrap=True)
    table.add_column("readings", justify="right")
    table.add_column("noise", no_wrap=True)
    for head in ("rmse\nas stated", "rmse\ncalibrated", "over\nnoise", "held\nout"):
        table.add_column(head, justify="right", no_wrap=True)
    for kind, error in found.errors.items():
        bench, noise = NUMBERS[kind[1]].bench, found.noise[kind]
        table.add_row(
            quantity(kind),
            str(error.readings),
            f"{bench.from_si(noise.value):.2g} {SOURCE_WORDS[noise.source]}",
            f"{bench.from_si(error.raw):.2g}",
            f"{bench.from_si(error.calibrated):.2g}",
            f"{error.residual:.1f}",
            "-" if math.isnan(error.heldout) else f"{error.heldout:.1f}",
        )
    print_rich(table)
    print()
    for line in verdict_text(found):
        print(line)
    print("\nInferred within the tolerances, those that are known best first:")
    known = sorted(
        (one for one in found.calibrations if one.tolerance),
        key=lambda one: one.std / one.tolerance,
    )
    for one in known[:8]:
        print(f"  {calibration_text(one)}")
    if len(known) > 8:
        print(f"  and {len(known) - 8} more (--json)")
    for warning in found.warnings:
        print(f"warning: {warning}")
