"""``pba challenge``: measurements with a hidden effect, and scores of answers."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from datagen.errors import FileError, InputError

from .options import AsJson, whole
from .terminal import print_json, print_rich, waiting

if TYPE_CHECKING:
    from discrepancy.scoring import Score, Summary

challenge_app = typer.Typer(
    help="Measurements with a hidden effect: make them, score answers.",
    no_args_is_help=True,
)


@challenge_app.command("make")
def challenge_make(
    out: Annotated[Path, Argument(metavar="OUT_DIR", help="Folder to write.")],
    seed: Annotated[
        int,
        Option(
            help="The same seed gives the same set.",
            parser=whole("--seed", 0, 2**63 - 1),
            metavar="S",
        ),
    ],
    devices: Annotated[
        int,
        Option(help="How many devices.", parser=whole("--devices", 2, 50), metavar="N"),
    ] = 6,
    effects: Annotated[
        str,
        Option(
            metavar="all|two|none|unnamed|A,B|A+B",
            help="What is hidden: one effect of the catalogue, two, nothing, one that "
            "the catalogue lacks; one of A,B; both of A+B.",
        ),
    ] = "all",
    pressures: Annotated[
        int,
        Option(
            help="Load steps on the way up.",
            parser=whole("--pressures", 2, 100),
            metavar="N",
        ),
    ] = 7,
    noise: Annotated[
        list[str],
        Option(
            metavar="QUANTITY=STD",
            help="What is measured and its noise, as in inflation_mm=0.002. "
            "Repeatable.",
        ),
    ] = [],  # noqa: B006  (typer reads it, nobody changes it)
    size: Annotated[
        str,
        Option(
            metavar="small|medium|large|K",
            help="Largest change of a reading by the effect, in times the noise: 3, "
            "10, 30 or K.",
        ),
    ] = "medium",
    level: Annotated[
        str,
        Option(help="Mesh of the truth, graded otherwise: draft, standard or fine."),
    ] = "standard",
    unloading: Annotated[
        bool, Option("--unloading", help="Measure on the way down, too.")
    ] = False,
    repeat: Annotated[
        bool, Option("--repeat", help="Measure every device twice.")
    ] = False,
    state_noise: Annotated[
        bool,
        Option("--std/--no-std", help="State the noise in the file."),
    ] = True,
    as_json: AsJson = False,
) -> None:
    """A sealed set: measurements to hand out, and the truth in a file of its own."""
    from discrepancy.challenge import NOISE, Plan, make, parse_size
    from discrepancy.sealed import MANIFEST, MEASUREMENTS, TRUTH, check_free, seal
    from discrepancy.writing import measurements_text

    check_free(out)  # before minutes are spent
    plan = Plan(
        seed=seed,
        devices=devices,
        effects=effects,
        pressures=pressures,
        noise=_noise(noise) or dict(NOISE),
        size=parse_size(size),
        level=level,
        unloading=unloading,
        repeat=repeat,
        stated=state_noise,
    )
    with waiting("drawing", as_json) as status:
        challenge = make(
            plan, lambda what, solved: status.update(f"{what}: {solved} paths")
        )
    sums = seal(out, measurements_text(challenge.measurements), challenge.truth)
    report = {
        "folder": str(out),
        "devices": len(challenge.measurements.devices),
        "readings": challenge.measurements.readings,
        "sha256": sums,
    }
    if as_json:
        print_json(report)
        return
    print(
        f"{out}: {report['readings']} readings of {report['devices']} devices in "
        f"{MEASUREMENTS}; the truth is in {TRUTH} (do not look), sealed by {MANIFEST}."
    )


@challenge_app.command("score")
def challenge_score(
    files: Annotated[
        list[Path],
        Argument(
            metavar="DIR ANSWER.json ...",
            help="A sealed set and the output of pba rank --json on it; more pairs "
            "give a summary.",
        ),
    ],
    as_json: AsJson = False,
) -> None:
    """Whether answers are right: verdict, probability of the truth, parameters."""
    from discrepancy.provenance import digest
    from discrepancy.scoring import read_answer, score, summarise
    from discrepancy.sealed import MEASUREMENTS, unseal

    if len(files) % 2:
        given = " ".join(str(file) for file in files)
        raise InputError("DIR ANSWER.json", given, "pairs of a folder and an answer")
    scores = []
    for folder, file in zip(files[::2], files[1::2], strict=True):
        truth, answer = unseal(folder), read_answer(file)
        if answer.file_sha256 not in ("", digest(folder / MEASUREMENTS)):
            words = f"is an answer to other measurements than {folder / MEASUREMENTS}"
            raise FileError(file, words)
        try:
            scores.append(score(truth, answer, str(folder)))
        except ValueError as error:
            raise FileError(file, str(error)) from error
    summary = summarise(scores)
    if as_json:
        print_json(
            {"sets": [_as_data(one) for one in scores], "summary": asdict(summary)}
        )
        return
    for one in scores:
        print(f"{one.name}: {one.line()}")
    if len(scores) > 1:
        _show(summary)


def _noise(texts: list[str]) -> dict[str, float]:
    """``inflation_mm=0.002`` texts to standard deviations by quantity, SI.

    Raises
    ------
    InputError
        When a text has another shape, or a quantity is unknown or given twice.
    """
    from datagen.units import QUANTITY

    from .bench import parse_number

    found: dict[str, float] = {}
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals or name not in QUANTITY:
            names = ", ".join(QUANTITY)
            raise InputError("--noise", text, f"QUANTITY=STD, with one of {names}")
        column = QUANTITY[name]
        if column.field in found:
            raise InputError("--noise", text, "each quantity at most once")
        number = parse_number(value)
        if not isinstance(number, float) or not math.isfinite(number):
            raise InputError(f"noise of {name}", value, "a number", column.unit)
        found[column.field] = column.to_si(number)
    return found


def _as_data(one: Score) -> dict[str, Any]:
    return asdict(one) | {"right": one.right, "line": one.line()}


def _show(summary: Summary) -> None:
    """Several sets in a table."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("planted")
    for head in ("sets", "right"):
        table.add_column(head, justify="right")
    for kind, count in summary.sets.items():
        table.add_row(kind, str(count), str(summary.right[kind]))
    print_rich(table)
    outcomes = ", ".join(f"{count} {name}" for name, count in summary.outcomes.items())
    print(f"outcomes: {outcomes}; mean log score {summary.log_score:.2f}")
    if summary.intervals:
        print(
            f"90 % intervals that hold the truth: {summary.inside} of "
            f"{summary.intervals}"
        )
