"""The command line ``pba``: every action of the project, for people and for scripts.

``--json`` prints one JSON object and nothing else on standard output.  Exit status 0
done, 2 bad input, 1 anything else, 130 interrupted; what went wrong is one line on
standard error.  Heavy packages are imported by the commands that need them.
"""

from __future__ import annotations

import io
import os
import sys
import time
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from datagen.errors import EffectError, FileError, InputError, Interrupted, PbaError

from .adopt import adopt
from .challenge import challenge_app
from .discrepancy import compare
from .effects import effects_app
from .models import models_app
from .options import (
    DEFAULT_PRESSURES,
    LEVELS,
    MANY_DESIGNS,
    AsJson,
    Case,
    Device,
    EffectsDir,
    Level,
    Pressures,
    Settings,
    WorkspaceDir,
    number,
    whole,
)
from .rank import rank
from .terminal import Stopped, print_json, print_rich, waiting

if TYPE_CHECKING:
    from datagen.device import Design
    from discrepancy.version import ModelVersion

INTERRUPTED = 130
"""Exit status after Ctrl-C, as in a shell."""

BAD_INPUT = (InputError, FileError, EffectError)


app = typer.Typer(
    name="pba",
    help="What does this pneumatic balloon actuator do?",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
)
app.add_typer(effects_app, name="effects")
app.add_typer(models_app, name="models")
app.command()(compare)
app.command()(rank)
app.command()(adopt)
app.add_typer(challenge_app, name="challenge")


@app.command()
def solve(
    device: Device = "S1",
    case: Case = 1,
    settings: Settings = [],  # noqa: B006  (typer reads it, nobody changes it)
    effect: Annotated[
        list[str],
        Option(
            metavar="NAME:PARAM=VALUE,...",
            help="Switch an effect on, parameters in its units. Repeatable.",
        ),
    ] = [],  # noqa: B006
    effects_dir: EffectsDir = None,
    model: Annotated[
        str | None,
        Option(
            metavar="MODEL",
            help="Folder, name or id of a model version: its effects are on, too.",
        ),
    ] = None,
    workspace: WorkspaceDir = None,
    pressures: Pressures = DEFAULT_PRESSURES,
    level: Level = "standard",
    sensitivities: Annotated[
        bool,
        Option(
            "--sensitivities",
            help="Differentiate by design columns and effect parameters, too.",
        ),
    ] = False,
    beyond: Annotated[
        bool,
        Option(
            "--beyond",
            help="Every equilibrium on the way, too, and where the path turns before, "
            "on past its limit point.",
        ),
    ] = False,
    mesh_error: Annotated[
        bool,
        Option(
            "--mesh-error/--no-mesh-error",
            help="Bound the discretisation error, by a coarser mesh.",
        ),
    ] = True,
    as_json: AsJson = False,
) -> None:
    """One path by finite elements."""
    from .bench import (
        check_acting,
        parse_effects,
        parse_pressures,
        pressures_from_bench,
    )

    design = _design(device, case, settings)
    pressure = pressures_from_bench(parse_pressures(pressures))
    parameters = parse_effects(effect)
    from .answer import fem_answer
    from .versions import fem_model, fem_name, named_version

    version = named_version(model, workspace)
    with fem_model(version, parameters, level, effects_dir) as forward:
        if not sensitivities:
            check_acting(parameters)
        parameters = {name: dict(own) for name, own in forward.parameters.items()}
        with waiting("finite elements", as_json):
            answer = fem_answer(
                forward,
                fem_name(level, version),
                design,
                pressure,
                sensitivities=sensitivities,
                beyond=beyond,
                mesh_error=mesh_error,
            )
    lists = answer.to_solution() | {"level": level, "effects": parameters}
    if as_json:
        print_json(lists)
        return
    _show_path(lists)
    for line in answer.notes:
        print(line)
    if sensitivities:
        from .terminal import sensitivity_table

        print_rich(sensitivity_table(lists))
    _show_version(version, parse_effects(effect))


@app.command()
def predict(
    model: Annotated[
        str | None,
        Option(
            metavar="MODEL",
            help="Folder of a trained model, or folder, name or id of a model version; "
            "else the version in use, else the shipped model.",
        ),
    ] = None,
    workspace: WorkspaceDir = None,
    device: Device = "S1",
    case: Case = 1,
    settings: Settings = [],  # noqa: B006
    pressures: Pressures = DEFAULT_PRESSURES,
    level: Level = "standard",
    as_json: AsJson = False,
) -> None:
    """The surrogate's answer with its interval; finite elements where out of range.

    Of the model version in use in the workspace, where there is one.
    """
    from .answer import fem_answer, load_model, surrogate_answer
    from .bench import parse_pressures, pressures_from_bench
    from .versions import chosen_version, version_answer

    if level not in LEVELS:  # refused where the finite elements are not asked, too
        from datagen.levels import mesh_level

        mesh_level(level)
    design = _design(device, case, settings)
    pressure = pressures_from_bench(parse_pressures(pressures))
    version = chosen_version(model, workspace)
    if version is not None:
        with waiting("model version", as_json):
            answer = version_answer(version, design, pressure, level)
    else:
        shipped = model is None or model == "baseline"
        surrogate = load_model(None if shipped else Path(str(model)))
        check = surrogate.check(design, pressure)
        if check.in_range:
            answer = surrogate_answer(surrogate, design, pressure, check)
        else:
            from datagen.model import Model

            from .tasks import fem_version

            fem = Model(level=level)
            with waiting("out of range: finite elements", as_json):
                answer = fem_answer(
                    fem, fem_version(level), design, pressure, False, check.reasons
                )
    lists = answer.to_columns() | {"parameters": {}}
    if version is not None:
        lists |= {"parameters": version.parameters(), "version": version.version}
    if as_json:
        print_json(lists)
        return
    _show_path(lists)
    who = f"Surrogate {answer.model_version}, 90 % interval."
    print(who if answer.source == "surrogate" else "Finite elements, because:")
    for line in (*answer.reasons, *answer.notes):
        print(f"  {line}")
    _show_version(version)


@app.command()
def generate(
    designs: Annotated[
        int,
        Option(
            help="How many designs.",
            parser=whole("--designs", 1, MANY_DESIGNS),
            metavar="N",
        ),
    ],
    seed: Annotated[
        int,
        Option(
            help="The same seed gives the same designs.",
            parser=whole("--seed", 0, 2**63 - 1),
            metavar="S",
        ),
    ],
    out: Annotated[Path, Option(metavar="FILE", help="The HDF5 file to write.")],
    effects: Annotated[
        str, Option(metavar="A,B", help="Effects whose parameters are sampled too.")
    ] = "",
    workers: Annotated[
        int,
        Option(
            help="Processes that solve at a time.",
            parser=whole("--workers", 1, 4096),
            metavar="K",
        ),
    ] = 1,
    scheduler: Annotated[
        str | None, Option(metavar="ADDRESS", help="Of Dask, in place of processes.")
    ] = None,
    resume: Annotated[
        bool, Option("--resume", help="Go on with an interrupted run.")
    ] = False,
    level: Level = "standard",
    max_pressure: Annotated[
        float,
        Option(
            help="Where each path ends, in kPa.",
            parser=number("--max-pressure", 1e-3, 10_000, "kPa"),
            metavar="KPA",
        ),
    ] = 150.0,
    sensitivities: Annotated[
        int,
        Option(
            help="Differentiate the outputs of the first K paths, too.",
            parser=whole("--sensitivities", 0, MANY_DESIGNS),
            metavar="K",
        ),
    ] = 0,
    first: Annotated[
        int | None,
        Option(
            help="Solve the first K designs alone; --extend goes on later.",
            parser=whole("--first", 1, MANY_DESIGNS),
            metavar="K",
        ),
    ] = None,
    extend: Annotated[
        Path | None,
        Option(
            metavar="FILE",
            help="A dataset of the first of the same designs, whose paths are taken.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """A dataset of paths by finite elements, over a Latin hypercube of designs."""
    from datagen.generate import Progress
    from datagen.generate import generate as run
    from datagen.units import PRESSURE

    from .terminal import duration, progress_bar

    start = time.perf_counter()
    with progress_bar("paths", quiet=as_json) as bar:
        shown = bar.add_task("generate", total=first or designs, note="")

        def update(now: Progress) -> None:
            note = f"{60 * now.rate:.1f}/min, {duration(now.seconds_left)} left"
            failed = f", {now.failed} stopped early" if now.failed else ""
            bar.update(shown, completed=now.done, total=now.total, note=note + failed)

        try:
            data = run(
                designs,
                seed,
                out,
                effects=[name.strip() for name in effects.split(",") if name.strip()],
                level=level,
                workers=workers,
                scheduler=scheduler,
                resume=resume,
                max_pressure=PRESSURE.to_si(max_pressure),
                sensitivities=sensitivities,
                first=first,
                extend=extend,
                progress=update,
            )
        except Interrupted as stop:
            raise Stopped(str(stop)) from stop
    seconds = time.perf_counter() - start
    ends = {end: data.path_status.count(end) for end in sorted(set(data.path_status))}
    report = {
        "file": str(out),
        "designs": len(data),
        "path_status": ends,
        "seconds": seconds,
        "digest": data.digest(),
        "generator_version": data.generator_version,
    }
    if as_json:
        print_json(report)
        return
    words = ", ".join(f"{count} {end}" for end, count in ends.items())
    print(f"{out}: {len(data)} paths ({words}) in {duration(seconds)}.")


@app.command()
def train(
    dataset: Annotated[Path, Argument(metavar="DATASET", help="HDF5 file of paths.")],
    out: Annotated[Path, Option(metavar="MODEL", help="Folder to write.")],
    seed: Annotated[
        int,
        Option(
            help="The same seed gives the same model.",
            parser=whole("--seed", 0, 2**32 - 1),
            metavar="S",
        ),
    ] = 0,
    as_json: AsJson = False,
) -> None:
    """An ensemble of networks, trained on a dataset."""
    from datagen.dataset import Dataset
    from surrogate.train import train as run

    from .terminal import accuracy_tables, duration, progress_bar

    data = Dataset.read(dataset)
    start = time.perf_counter()
    with progress_bar("steps", quiet=as_json) as bar:
        shown = bar.add_task("train", note="")

        def update(stage: str, step: int, steps: int, loss: float) -> None:
            note = f"held-out loss {loss:.3g}"
            bar.update(shown, description=stage, completed=step, total=steps, note=note)

        ensemble = run(data, seed, progress=update)
    ensemble.save(out)
    seconds = time.perf_counter() - start
    errors = ensemble.description.get("accuracy")
    report = {
        "model": str(out),
        "version": ensemble.version,
        "seconds": seconds,
        "accuracy": errors,
    }
    if as_json:
        print_json(report)
        return
    if errors:
        print_rich(next(accuracy_tables(errors)))
    print(f"{out}: model {ensemble.version}, {duration(seconds)}.")


@app.command()
def accuracy(
    model: Annotated[
        str,
        Argument(
            metavar="MODEL",
            help="Folder of a trained model, or folder, name or id of a model version.",
        ),
    ],
    dataset: Annotated[
        Path | None,
        Argument(
            metavar="DATASET",
            help="HDF5 file of paths; those that a version learned from without it.",
        ),
    ] = None,
    workspace: WorkspaceDir = None,
    as_json: AsJson = False,
) -> None:
    """Errors and coverage on designs that were held out from training."""
    from datagen.dataset import Dataset
    from surrogate.accuracy import accuracy as measure

    from .terminal import accuracy_tables
    from .versions import trained

    surrogate, paths = trained(model, dataset, workspace)
    found = measure(surrogate, Dataset.read(paths)).to_json()
    if as_json:
        print_json(found)
        return
    for table in accuracy_tables(found):
        print_rich(table)


@app.command()
def serve(
    port: Annotated[
        int,
        Option(
            help="Port to listen on; 0 takes any free one.",
            parser=whole("--port", 0, 65535),
            metavar="PORT",
        ),
    ] = 8000,
    host: Annotated[str, Option(help="Address to listen on.")] = "127.0.0.1",
    model: Annotated[
        Path | None, Option(metavar="MODEL", help="Folder of a trained model.")
    ] = None,
    state: Annotated[
        Path | None,
        Option(
            metavar="DIR",
            help="Folder of the jobs, those of each workspace apart; else PBA_STATE.",
        ),
    ] = None,
    database_url: Annotated[
        str | None, Option(metavar="URL", help="PostgreSQL for the jobs, not SQLite.")
    ] = None,
    wait: Annotated[
        float,
        Option(
            help="Seconds a request waits for the finite elements before it is a job.",
            parser=number("--wait", 0, 3600, "s"),
            metavar="S",
        ),
    ] = 20.0,
    workspace: WorkspaceDir = None,
) -> None:
    """Serve predictions over HTTP, and the web page."""
    from discrepancy.workspace import default_workspace

    from .app import Settings as ServerSettings
    from .app import default_state
    from .serve import run

    settings = ServerSettings(
        state or default_state(),
        model,
        database_url,
        wait,
        workspace or default_workspace(),
    )
    run(settings, host, port)


def _design(device: str, case: int, settings: Sequence[str]) -> Design:
    from .bench import design_from_bench, parse_settings

    return design_from_bench(parse_settings(settings), device, case)


def _show_version(version: ModelVersion | None, more: Collection[str] = ()) -> None:
    """Which version it was, and what was set beside it."""
    if version is None:
        return
    words = f"Model version {version.version} with {', '.join(version.effects)}"
    added = [name for name in more if name not in version.effects]
    other = [name for name in more if name in version.effects]
    words += f"; {', '.join(added)} on top of it" if added else ""
    words += f"; values of {', '.join(other)} as given" if other else ""
    print(f"{words}.")


def _show_path(lists: Mapping[str, Any]) -> None:
    from .terminal import path_table, verdict

    print_rich(path_table(lists))
    print(verdict(lists))
    if lists["mesh_error"]:
        from datagen.mesh_error import calibrated_on

        count = calibrated_on()
        print(f"± bounds the discretisation error, calibrated on {count} designs.")


def _complain(message: str) -> None:
    """One line on standard error."""
    print(f"pba: {' '.join(message.split())}", file=sys.stderr)


def _unforeseen(
    kind: type[BaseException], error: BaseException, _trace: TracebackType | None
) -> None:
    """What an error of nobody's making looks like: one line, unless asked for more."""
    words = f"{kind.__name__}: {error}"
    _complain(f"internal error, {words} (PBA_DEBUG=1 shows where)")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Without the name of the program; those of the process where not given.

    Returns
    -------
    int
        The exit status.
    """
    if arguments is None and not os.environ.get("PBA_DEBUG"):
        sys.excepthook = _unforeseen
    if arguments is None:
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="replace")  # a terminal that has no bars
    given = list(sys.argv[1:] if arguments is None else arguments)
    command = typer.main.get_command(app)
    try:
        status = command.main(given, prog_name="pba", standalone_mode=False)
    except Stopped as stop:
        _complain(str(stop))
        return INTERRUPTED
    except typer.Abort:  # a question was not answered
        _complain("aborted")
        return 1
    except typer.TyperException as error:  # a wrong option, a missing argument
        if message := error.format_message():  # none where the help was shown
            _complain(message)
        return error.exit_code
    except BAD_INPUT as error:
        _complain(str(error))
        return 2
    except PbaError as error:
        _complain(str(error))
        return 1
    if status == INTERRUPTED:
        _complain("interrupted")
    return status if isinstance(status, int) else 0


if __name__ == "__main__":
    sys.exit(main())
