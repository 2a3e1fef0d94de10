"""``pba adopt``: put effects into the model, and watch the error fall."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from datagen.atomic import write_text

from .discrepancy import (
    Cache,
    CameraTolerance,
    ModulusTolerance,
    Report,
    Seed,
    ThicknessTolerance,
    Workers,
    measurements_of,
    solving,
)
from .options import AsJson, EffectsDir, Level, WorkspaceDir
from .terminal import print_json, print_rich

if TYPE_CHECKING:
    from .adopted import Adopted


def adopt(
    effects: Annotated[
        str, Argument(metavar="EFFECT[,EFFECT]", help="Effects, in the ladder's order.")
    ],
    files: Annotated[
        list[Path],
        Argument(
            metavar="FILE...",
            help="Measurements: CSV files or PEtab tables, each with its own runs.",
        ),
    ],
    out: Annotated[
        str,
        Option(
            metavar="MODEL",
            help="Folder to write, or a bare name in the workspace.",
        ),
    ],
    on: Annotated[
        str,
        Option(
            metavar="MODEL",
            help="A version whose effects are kept and fitted together with these.",
        ),
    ] = "",
    effects_dir: EffectsDir = None,
    level: Level = "standard",
    modulus_tolerance: ModulusTolerance = 5.0,
    thickness_tolerance: ThicknessTolerance = 3.0,
    camera_tolerance: CameraTolerance = 0.5,
    workers: Workers = None,
    cache: Cache = None,
    workspace: WorkspaceDir = None,
    use: Annotated[
        bool,
        Option("--use/--no-use", help="Put it into use in its workspace."),
    ] = True,
    seed: Seed = 0,
    report: Report = None,
    as_json: AsJson = False,
) -> None:
    """Put effects into the model, fitted to measurements; before and after.

    Errors are on devices that took no part in the fit.  Finished solves are kept: a
    run that was stopped goes on where it was.
    """
    from .adopted import adopted

    names = [name.strip() for name in effects.split(",") if name.strip()]
    measured = [
        measurements_of(file, modulus_tolerance, thickness_tolerance, camera_tolerance)
        for file in files
    ]
    found = adopted(
        names,
        measured,
        solving(workers, cache, as_json),
        out=out,
        on=on,
        workspace=workspace,
        effects_dir=effects_dir,
        level=level,
        use=use,
        report=report is not None,
        seed=seed,
    )
    if report is not None:
        write_text(report, found.page)
    if as_json:
        print_json(found.to_json())
        return
    show(found)


def show(found: Adopted) -> None:
    """An adoption for people."""
    from .adoption import ladder_table, named, size_lines

    made, version = found.made, found.version
    print("Error on devices that took no part in the fit, in noise:\n")
    print_rich(ladder_table(made.ladder))
    print()
    for line in size_lines(made):
        print(line)
    for line in found.warnings:
        print(f"Warning: {line}")
    where = ""
    if found.home is None:
        where = " It is in no workspace: --model names it by its folder."
    elif found.in_use:
        where = f" It is in use in {found.home.folder}."
    if version.surrogate is not None:
        where += " It has a surrogate."
    print(f"\n{version.folder}: version {named(version)}, on {version.parent}.{where}")
