"""``pba effects``: the catalogue, and whether an effect keeps to the rules."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument

from datagen.errors import InputError

from .options import AsJson, EffectsDir
from .terminal import print_json, print_rich, waiting

if TYPE_CHECKING:
    from datagen.effects import Effect

effects_app = typer.Typer(help="The catalogue of effects.", no_args_is_help=True)


@effects_app.command("list")
def effects_list(effects_dir: EffectsDir = None, as_json: AsJson = False) -> None:
    """Every effect, with its stage and parameters."""
    from datagen.effects import catalogue
    from datagen.effects.door import without_effects

    rows = [_row(effect) for effect in catalogue(effects_dir).values()]
    for path in without_effects(effects_dir) if effects_dir else ():
        print(f"{path}: declares no effect", file=sys.stderr)
    if as_json:
        print_json({"effects": rows})
        return
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for head in ("effect", "stage", "parameters"):
        table.add_column(head)
    for row in rows:
        names = (f"{p['name']} ({p['unit']})" for p in row["parameters"])
        table.add_row(row["name"], row["stage"], ", ".join(names))
    print_rich(table)


@effects_app.command("show")
def effects_show(
    name: Annotated[str, Argument(metavar="NAME")],
    effects_dir: EffectsDir = None,
    as_json: AsJson = False,
) -> None:
    """One effect: its equation, parameters, ranges and sources."""
    row = _row(_named(name, effects_dir))
    if as_json:
        print_json(row)
        return
    print(f"{row['name']} (stage: {row['stage']})\n\n{row['doc'].strip()}\n")
    for p in row["parameters"]:
        print(
            f"{p['name']}: {p['lower']:g} to {p['upper']:g} {p['unit']}, "
            f"off at {p['off']:g}, prior {p['prior']}; {p['source']}"
        )


@effects_app.command("check")
def effects_check(
    file: Annotated[
        str,
        Argument(
            metavar="FILE",
            help="A file with effects, a folder of such files, or an effect's name.",
        ),
    ],
    effects_dir: EffectsDir = None,
    as_json: AsJson = False,
) -> None:
    """Whether effects, those of a file or one by name, keep to the rules of an effect.

    Exit status 0 when all checks passed, 1 when some failed, 2 when there is no
    effect to check.
    """
    from datagen.effects.conformance import check
    from datagen.effects.door import effects_of_file, effects_of_folder
    from datagen.effects.trial import Ground

    path = Path(file)
    named = not path.exists() and path.suffix != ".py" and path.name == file
    if named:
        effects = [_named(file, effects_dir)]
    else:
        effects = effects_of_folder(path) if path.is_dir() else effects_of_file(path)
    ground = Ground()
    reports = []
    for effect in effects:
        with waiting(f"checking {effect.name}", as_json):
            report = check(effect, ground=ground)
        reports.append(report)
        if as_json:
            continue
        print(f"{effect.name} (stage: {effect.stage})")
        for result in report.results:
            verdict = "passed" if result.passed else "FAILED"
            print(f"  {verdict}  {result.check:<10}  {result.why}")
            if not result.passed:
                print(f"{'':22}wanted: {result.asks}")
    passed = all(report.passed for report in reports)
    if as_json:
        print_json(
            {
                "passed": passed,
                "effects": [
                    {
                        "effect": report.effect,
                        "passed": report.passed,
                        "checks": [asdict(result) for result in report.results],
                    }
                    for report in reports
                ],
            }
        )
    if not passed:
        raise typer.Exit(1)


def _named(name: str, effects_dir: Path | None) -> Effect:
    """An effect of the catalogue.

    Raises
    ------
    InputError
        When there is none of that name.
    """
    from datagen.effects import catalogue

    known = catalogue(effects_dir)
    if name not in known:
        raise InputError("effect", name, ", ".join(known))
    return known[name]


def _row(effect: Effect) -> dict[str, Any]:
    """An effect as data."""
    return {
        "name": effect.name,
        "stage": effect.stage,
        "doc": effect.doc,
        "parameters": [asdict(parameter) for parameter in effect.parameters],
    }
