"""``pba rank``: which physical effect does the model lack."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

from rich.markup import escape
from rich.table import Table
from typer import Option

from datagen.atomic import write_text

from .discrepancy import (
    Cache,
    CameraTolerance,
    MeasurementFile,
    ModulusTolerance,
    Report,
    Seed,
    ThicknessTolerance,
    Workers,
    measurements_of,
    solving,
)
from .options import AsJson, EffectsDir, Level
from .terminal import print_json, print_rich

if TYPE_CHECKING:
    from discrepancy.judging import Ranking

    from .ranked import Ranked

ROWS = 8
"""Candidates shown to people; JSON has them all."""


def rank(
    file: MeasurementFile,
    effects_dir: EffectsDir = None,
    effects: Annotated[
        str,
        Option(metavar="A,B,...", help="Candidates; the whole catalogue by default."),
    ] = "",
    level: Level = "standard",
    modulus_tolerance: ModulusTolerance = 5.0,
    thickness_tolerance: ThicknessTolerance = 3.0,
    camera_tolerance: CameraTolerance = 0.5,
    workers: Workers = None,
    cache: Cache = None,
    seed: Seed = 0,
    report: Report = None,
    as_json: AsJson = False,
) -> None:
    """Learn which physical effect the model lacks, from measurements.

    Finished solves are kept: a run that was stopped goes on where it was.
    """
    from .ranked import ranked

    measured = measurements_of(
        file, modulus_tolerance, thickness_tolerance, camera_tolerance
    )
    names = [name.strip() for name in effects.split(",") if name.strip()] or None
    with solving(workers, cache, as_json) as solver:
        found = ranked(
            measured,
            solver,
            level=level,
            effects=names,
            effects_dir=effects_dir,
            seed=seed,
        )
    if report is not None:
        write_text(report, found.page)
    if as_json:
        print_json(found.to_json())
        return
    show(found)


def show(found: Ranked) -> None:
    """A ranking for people."""
    from discrepancy.words import verdict

    ranking = found.ranking
    print(verdict(ranking, found.next_words))
    print()
    print_rich(ranking_table(ranking))
    print()
    if math.isfinite(ranking.baseline_error):
        print(
            "Error on devices that were left out, in noise: baseline "
            f"{ranking.baseline_error:.2f}, with the right physics about "
            f"{ranking.noise_floor:.2f}."
        )
    else:
        print("No device can be left out to judge by: there is but one.")
    for line in found.fails_where:
        print(f"The model fails here: {line}")
    for one in found.proposals[:3]:
        print(
            f"Next: {one.words}: the nearest two would then be told apart with "
            f"probability {one.probability:.0%}."
        )
    for name, why in ranking.unjudged.items():
        print(f"Not judged: {name}: {why}.")
    for line in found.warnings:
        print(f"Warning: {line}")


def ranking_table(ranking: Ranking) -> Table:
    """Best candidates with probabilities, sizes and held-out errors."""
    from discrepancy.answer import label
    from discrepancy.words import sizes

    table = Table(box=None, pad_edge=False, header_style="bold")
    for head in ("effect", "probability", "held-out error", "size (90 % interval)"):
        table.add_column(head)
    for i, one in enumerate(ranking.candidates):
        if i >= ROWS and one.name != "nothing":
            continue
        names = label(one)
        name = names if isinstance(names, str) else " + ".join(names)
        known = math.isfinite(one.heldout_error)
        error = f"{one.heldout_error:.2f}" if known else ""
        size = "; ".join(
            f"{size.short} {size.number} ({size.interval})" for size in sizes(one)
        )
        table.add_row(escape(name), f"{one.probability:.3f}", error, escape(size))
    return table
