"""``pba models``: versions of the model in a workspace, and which one is in use."""

from __future__ import annotations

import time
import uuid
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table
from typer import Argument, Option

from datagen.errors import InputError

from .discrepancy import Workers
from .options import AsJson, WorkspaceDir, number, whole
from .terminal import print_json, print_rich

if TYPE_CHECKING:
    from pathlib import Path

    from discrepancy.version import ModelVersion
    from discrepancy.workspace import Workspace

models_app = typer.Typer(
    help="Versions of the model, and which one is in use.", no_args_is_help=True
)

Name = Annotated[
    str, Argument(metavar="NAME", help="Name of a version, or its id; or baseline.")
]


def _workspace(folder: Path | None) -> Workspace:
    from discrepancy.workspace import Workspace, default_workspace

    return Workspace(folder or default_workspace())


@models_app.command("list")
def models_list(workspace: WorkspaceDir = None, as_json: AsJson = False) -> None:
    """Every version of the workspace, the one in use marked."""
    from .adoption import version_row

    home = _workspace(workspace)
    current, rows = home.current_name, []
    for one in home.entries():
        row: dict[str, Any] = {"name": one.name, "in_use": one.name == current}
        about = {"problem": one.problem}
        rows.append(row | (about if one.version is None else version_row(one.version)))
    if as_json:
        print_json({"workspace": str(home.folder), "current": current, "models": rows})
        return
    if not rows:
        print(f"No versions in {home.folder}; pba adopt makes one.")
        return
    table = Table(box=None, pad_edge=False, header_style="bold")
    for head in ("", "name", "version", "effects", "on"):
        table.add_column(head)
    for head in ("error\nbefore", "error\nafter"):
        table.add_column(head, justify="right", no_wrap=True)
    table.add_column("date", no_wrap=True)
    names = {row.get("version"): row["name"] for row in rows}
    for row in rows:
        mark = "*" if row["in_use"] else ""
        if "problem" in row:
            table.add_row(mark, escape(row["name"]), "-", escape(row["problem"]))
            continue
        table.add_row(
            mark,
            escape(row["name"]),
            row["version"],
            escape(", ".join(row["effects"])),
            escape(names.get(row["parent"], row["parent"])),
            _error(row["baseline_error"]),
            _error(row["heldout_error"]),
            row["date"][:10],
        )
    print_rich(table)
    what = "The baseline is in use" if current == "baseline" else "*: in use"
    print(f"\n{what}. Errors are on devices that were left out, in noise.")


def _error(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


@models_app.command("show")
def models_show(
    name: Name, workspace: WorkspaceDir = None, as_json: AsJson = False
) -> None:
    """One version: effects, sizes, ladder, measurements, code."""
    from discrepancy.words import INSIDE

    from .adoption import estimate_text, ladder_table, version_json

    version = _version(name, workspace)
    if version is None:
        if as_json:
            print_json({"version": name, "effects": []})
        else:
            print(f"{name}: the model without adopted effects.")
        return
    if as_json:
        print_json(version_json(version) | {"model": str(version.folder)})
        return
    print(f"{version.folder}: version {version.version}, on {version.parent}")
    print(f"Effects: {', '.join(version.effects)}")
    for one in version.estimates:
        edge = "" if one.plausibility == INSIDE else f"; {one.plausibility}"
        print(f"  {estimate_text(one)}{edge}")
    print()
    print_rich(ladder_table(version.ladder))
    print()
    for file in version.measurements:
        print(f"Fitted to {file.name} ({file.sha256[:12]}): {', '.join(file.devices)}")
    code = f"pba {version.package}, generator {version.generator}"
    where = f", commit {version.commit[:12]}" if version.commit else ""
    print(f"Made {version.date or 'at an unknown date'} by {code}{where};")
    print(f"mesh {version.level}, changes by effects {version.fast}; ", end="")
    print(f"seed {version.seed}.")
    for line in (*version.warnings, *version.doubts()):
        print(f"Warning: {line}")


@models_app.command("train")
def models_train(
    name: Name,
    minutes: Annotated[
        float | None,
        Option(
            help="Time budget, paths and training together; 8 where nothing is given.",
            parser=number("--minutes", 0.1, 10_000, "min"),
            metavar="MIN",
        ),
    ] = None,
    paths: Annotated[
        int | None,
        Option(
            help="How many paths are solved, in place of a budget.",
            parser=whole("--paths", 1, 100_000),
            metavar="N",
        ),
    ] = None,
    seed: Annotated[
        int,
        Option(help="Of plan and training.", parser=whole("--seed", 0, 2**31)),
    ] = 0,
    workers: Workers = None,
    restart: Annotated[
        bool,
        Option(
            "--restart",
            help="Begin anew: discard what was begun or is there. Once more where that "
            "was stopped: go on.",
        ),
    ] = False,
    workspace: WorkspaceDir = None,
    as_json: AsJson = False,
) -> None:
    """The fast surrogate of a version, with its effects in it.

    Finished paths are kept: the same command goes on where it was stopped.  A version
    that was fitted again takes its parent's where that holds for the new fit, unless
    --minutes or --paths asks for one of its own.
    """
    from .discrepancy import cores
    from .surrogates import about, lines, train
    from .terminal import Stopped, duration, progress_bar

    version = _version(name, workspace)
    if version is None:
        raise InputError("model", name, "a version with adopted effects")
    start = time.perf_counter()
    with progress_bar("steps", quiet=as_json) as bar:
        shown = bar.add_task("increment", total=None, note="")

        def update(stage: str, done: int, total: int, left: float | None) -> None:
            note = "" if left is None else f"{duration(left)} left"
            bar.update(shown, description=stage, completed=done, total=total, note=note)

        try:
            made = train(
                version,
                minutes=minutes,
                paths=paths,
                seed=seed,
                workers=workers or cores(),
                restart=uuid.uuid4().hex if restart else "",
                report=update,
            )
        except KeyboardInterrupt as stop:
            raise Stopped(
                "interrupted; finished paths are kept, and the same command goes on"
            ) from stop
    seconds = time.perf_counter() - start
    if as_json:
        print_json(about(made) | {"seconds": seconds})
        return
    took = duration(seconds)
    print(f"{version.surrogate}: surrogate of {version.version} in {took}.")
    for line in lines(made):
        print(line)


@models_app.command("diff")
def models_diff(
    first: Annotated[str, Argument(metavar="A", help="A version, or baseline.")],
    second: Annotated[str, Argument(metavar="B", help="A version, or baseline.")],
    workspace: WorkspaceDir = None,
    as_json: AsJson = False,
) -> None:
    """What changes from version A to version B."""
    from .adoption import difference, estimate_text

    a, b = (_version(text, workspace) for text in (first, second))
    found = difference(a, b)
    if as_json:
        print_json({"a": first, "b": second} | found)
        return
    lines = [f"+ {name}" for name in found["effects_added"]]
    lines += [f"- {name}" for name in found["effects_removed"]]
    both = [{} if v is None else {e.name: e for e in v.estimates} for v in (a, b)]
    for name, row in found["parameters"].items():
        texts = [estimate_text(own[name]) if name in own else "-" for own in both]
        texts[1] = texts[1].removeprefix(f"{name} ")
        away = "" if row["sigmas"] is None else f" ({row['sigmas']:+.2g} std)"
        known = [text for text in texts if text != "-"]
        if known and texts[0] == "-":
            texts[0] = f"{name} -"
        lines.append(f"{texts[0]} -> {texts[1]}{away}")
    lines += [f"measurements + {name}" for name in found["measurements_added"]]
    lines += [f"measurements - {name}" for name in found["measurements_removed"]]
    before, after = (_error(value) for value in found["heldout_error"])
    lines.append(f"error on left-out devices {before} -> {after}")
    for name, (old, new) in found["settings"].items():
        lines.append(f"{name} {old} -> {new}")
    print("\n".join(lines))


@models_app.command("use")
def models_use(
    name: Name, workspace: WorkspaceDir = None, as_json: AsJson = False
) -> None:
    """Put a version into use; baseline goes back to the model without effects."""
    home = _workspace(workspace)
    _in_use(home, home.use(name), as_json)


@models_app.command("undo")
def models_undo(workspace: WorkspaceDir = None, as_json: AsJson = False) -> None:
    """Go back to the version that was in use before."""
    home = _workspace(workspace)
    _in_use(home, home.undo(), as_json)


@models_app.command("remove")
def models_remove(
    name: Name,
    force: Annotated[
        bool,
        Option("--force", help="Also where it is in use, or the parent of another."),
    ] = False,
    workspace: WorkspaceDir = None,
    as_json: AsJson = False,
) -> None:
    """Delete a version."""
    home = _workspace(workspace)
    lines = home.remove(name, force)
    if as_json:
        print_json(
            {"removed": name, "current": home.current_name, "notes": list(lines)}
        )
        return
    print("; ".join([f"{name} is removed", *lines]) + ".")


def _in_use(home: Workspace, name: str, as_json: bool) -> None:
    from .adoption import named

    entry = home.current()
    version = None if entry is None else entry.version
    if as_json:
        print_json(
            {
                "workspace": str(home.folder),
                "current": name,
                "version": None if version is None else version.version,
                "effects": [] if version is None else list(version.effects),
            }
        )
        return
    what = "" if version is None else f", version {named(version)},"
    print(f"{name}{what} is in use in {home.folder}.")


def _version(text: str, workspace: Path | None) -> ModelVersion | None:
    """A version by path, name or id; None for the baseline."""
    from discrepancy.folder import read
    from discrepancy.layout import BASELINE
    from discrepancy.workspace import locate

    return None if text == BASELINE else read(locate(text, workspace))
