"""``pba adopt``: put effects into the model, and watch the error fall."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from datagen.errors import InputError

from .discrepancy import (
    Cache,
    CameraTolerance,
    ModulusTolerance,
    ThicknessTolerance,
    Workers,
    measurements_of,
    solving,
)
from .options import AsJson, EffectsDir, Level, WorkspaceDir, whole
from .terminal import print_json, print_rich

if TYPE_CHECKING:
    from discrepancy.measurement import Measurements
    from discrepancy.version import ModelVersion


def adopt(
    effects: Annotated[
        str, Argument(metavar="EFFECT[,EFFECT]", help="Effects, in the ladder's order.")
    ],
    files: Annotated[
        list[Path],
        Argument(
            metavar="FILE...",
            help="Measurements: CSV files or PEtab tables, each with its own devices.",
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
    seed: Annotated[
        int,
        Option(help="Of the samples.", parser=whole("--seed", 0, 2**31), metavar="N"),
    ] = 0,
    report: Annotated[
        Path | None,
        Option(metavar="FILE", help="Write a report, one HTML file, as well."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Put effects into the model, fitted to measurements; before and after.

    Errors are on devices that took no part in the fit.  Finished solves are kept: a
    run that was stopped goes on where it was.
    """
    from threadpoolctl import threadpool_limits

    from discrepancy.adopt import adopt as fit
    from discrepancy.adopt import joined
    from discrepancy.folder import effects_of, vacant
    from discrepancy.layout import BASELINE
    from discrepancy.study import Study
    from discrepancy.version import ModelVersion
    from discrepancy.workspace import locate, place

    from .adoption import adoption_json

    names = [name.strip() for name in effects.split(",") if name.strip()]
    measured = [
        measurements_of(file, modulus_tolerance, thickness_tolerance, camera_tolerance)
        for file in files
    ]
    everything = joined(measured)
    if report is not None and not report.parent.is_dir():
        raise InputError("--report", str(report), "a file in a folder that exists")
    parent = ModelVersion.load(locate(on, workspace)) if on else None
    names = _all(names, parent)
    folder, home = place(out, workspace)
    if home is not None:
        home.make()
    vacant(folder)
    date = datetime.now(UTC).isoformat(timespec="seconds")
    with (
        effects_of(parent, effects_dir) as own,
        solving(workers, cache, as_json) as solver,
        threadpool_limits(1),
    ):
        study = Study(everything, solver, level=level, effects=names, effects_dir=own)
        made = fit(study, names, seed)
        version = ModelVersion.of(
            made,
            parent=BASELINE if parent is None else parent.version,
            files=measured,
            date=date,
        ).save(folder, own)
        in_use = home is not None and use
        if home is not None and use:
            home.use(folder.name)
        if report is not None:
            from datagen.atomic import replacing
            from discrepancy.adopt_report import adopt_report
            from discrepancy.sharpen import sharpen

            page = adopt_report(
                made, version, sharpen(study, made.fit), _lineage(parent, measured)
            )
            with replacing(report) as temporary:
                temporary.write_text(page, encoding="utf-8")
    warnings = [*everything.warnings, *made.warnings, *_lineage(parent, measured)]
    if as_json:
        data = adoption_json(made, version)
        place_json = {"workspace": str(home.folder) if home else None, "in_use": in_use}
        print_json(data | place_json | {"warnings": warnings})
        return
    from .adoption import ladder_table, named, size_lines

    print("Error on devices that took no part in the fit, in noise:\n")
    print_rich(ladder_table(made.ladder))
    print()
    for line in size_lines(made):
        print(line)
    for line in warnings:
        print(f"Warning: {line}")
    where = f" It is in use in {home.folder}." if home and in_use else ""
    print(f"\n{folder}: version {named(version)}, on {version.parent}.{where}")


def _all(names: Sequence[str], parent: ModelVersion | None) -> list[str]:
    """The parent's effects, then the new ones; those named again are fitted again."""
    kept = [] if parent is None else list(parent.effects)
    return kept + [name for name in names if name not in kept]


def _lineage(
    parent: ModelVersion | None, measured: Sequence[Measurements]
) -> list[str]:
    """What a version leaves behind of the one it is built on, one line each."""
    if parent is None:
        return []
    given = {one.sha256 for one in measured}
    lost = [one.name for one in parent.measurements if one.sha256 not in given]
    if not lost:
        return []
    return [
        f"{', '.join(lost)}, which the parent was fitted to, is not among these files: "
        "everything is fitted to these alone"
    ]
