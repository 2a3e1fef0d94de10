"""Our finite elements, FElupe and CalculiX on one problem: ``make bench-fem``.

Each run has a process of its own, one core and a time limit; one that fails leaves its
reason in the table.  Results go to ``docs/benchmarks/fem.json`` after every run, and
the document is written from that file: ``--table`` writes it without running anything.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from docs import refine

from . import peer_calculix, peer_own
from .case import PRESSURES, ask, problem_of, read
from .exchange import Answer
from .record import MESHES, OWN, SHORT, TURNS, Record, Run, Settled
from .report import document

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs/benchmarks"
THREADS = ("OMP", "MKL", "OPENBLAS", "NUMBA")


@dataclass(frozen=True)
class Program:
    """One program, and how it is run.

    Parameters
    ----------
    name : str
    module : str
        Of `benchmarks`, run with ``python -m``.
    python : Path
        Of the environment that it needs.
    meshes : tuple of str
    options : tuple of str
    tolerance : str
        In words.
    """

    name: str
    module: str
    python: Path
    meshes: tuple[str, ...]
    options: tuple[str, ...] = ()
    tolerance: str = ""


def programs(felupe_python: Path) -> tuple[Program, ...]:
    """Everything that is compared, in the order of the tables.

    Meshes that take a program tens of minutes are left out, so that all are run in one
    call; where none of its runs is as accurate as ours, the longest is a lower bound.
    """
    newton = "residual below 1e-6 of the reactions"
    here = Path(sys.executable)
    return (
        Program(
            OWN,
            "peer_own",
            here,
            MESHES,
            tolerance=peer_own.TOLERANCE,
        ),
        Program(
            "FElupe, PARDISO",
            "peer_felupe",
            felupe_python,
            MESHES[:-1],
            ("--linear", "pardiso"),
            newton,
        ),
        Program(
            "FElupe, SuperLU",
            "peer_felupe",
            felupe_python,
            MESHES[1:3],
            tolerance=newton,
        ),
        Program(
            "CalculiX",
            "peer_calculix",
            here,
            MESHES[:4],
            tolerance=(
                f"residual below {peer_calculix.RESIDUAL:.0e} of the mean force, last "
                f"correction below {peer_calculix.CORRECTION:.0e} of the increment"
            ),
        ),
    )


def hardware() -> str:
    """Processor, cores and memory in words."""
    model = platform.processor() or platform.machine()
    cpus = Path("/proc/cpuinfo")
    if cpus.exists():
        found = re.search(r"^model name\s*: (.+)$", cpus.read_text(), re.MULTILINE)
        model = found[1].strip() if found else model
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    system = f"{platform.system()} {platform.machine()}"
    python = f"Python {platform.python_version()}"
    cores = f"{os.cpu_count()} cores, one of them used"
    return f"{model}, {cores}, {memory:.0f} GiB, {system}, {python}"


def settled_answer() -> Settled:
    """The converged answer at those of its pressures that the benchmark has, too."""
    runs = json.loads(refine.RUNS.read_text())
    asked = [float(pressure) / 1e3 for pressure in PRESSURES]
    kept = [i for i, pressure in enumerate(refine.PRESSURES) if pressure in asked]
    (tip, tip_bar), (inflation, inflation_bar) = (
        [
            [round(float(one[i]), 4) for i in kept]
            for one in refine.settled(runs, 1, name)
        ]
        for name in ("tip", "inflation")
    )
    return Settled(
        pressure=[refine.PRESSURES[i] for i in kept],
        tip=tip,
        inflation=inflation,
        tip_bar=max(tip_bar),
        inflation_bar=max(inflation_bar),
    )


class PeerStopped(RuntimeError):
    """A run that gave no answer; the text says why."""


def call(command: list[str], limit: float) -> None:
    """Run a command and its children on one core, for so many seconds at most.

    Raises
    ------
    PeerStopped
        When it fails, or takes longer.
    """
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    environment |= {f"{name}_NUM_THREADS": "1" for name in THREADS}
    try:
        process = subprocess.Popen(
            command,
            cwd=ROOT,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,  # so that its children can be stopped with it
        )
    except FileNotFoundError as error:
        raise PeerStopped(f"{Path(command[0]).name} is not installed") from error
    try:
        said, _ = process.communicate(timeout=limit)
    except subprocess.TimeoutExpired as error:
        raise PeerStopped(f"not done after {limit:.0f} s") from error
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    if process.returncode:
        lines = [line for line in said.splitlines() if line.strip()]
        status = f"exit status {process.returncode}"
        raise PeerStopped(lines[-1].strip() if lines else status)


def measure(program: Program, mesh: str, limit: float) -> tuple[Run, dict[str, str]]:
    """One program on one mesh, and the versions of what took part.

    Of short runs the one whose processor time is the median: a shared machine has slow
    minutes.
    """
    run, versions = measure_once(program, mesh, limit)
    runs = [run]
    while run.done and run.seconds < SHORT and len(runs) < TURNS:
        run, _ = measure_once(program, mesh, limit)
        runs.append(run)
    runs.sort(key=lambda one: one.processor)
    return runs[len(runs) // 2], versions


def measure_once(
    program: Program, mesh: str, limit: float
) -> tuple[Run, dict[str, str]]:
    """One run, and the versions of what took part."""
    problem = problem_of(mesh)
    with tempfile.TemporaryDirectory() as name:
        question, answer = Path(name, "question.npz"), Path(name, "answer.npz")
        ask(problem).write(question)
        asked = mesh if program.name == OWN else str(question)
        module = f"benchmarks.{program.module}"
        command = [str(program.python), "-m", module, asked, str(answer)]
        try:
            call([*command, *program.options], limit)
        except PeerStopped as stopped:
            return Run(program.name, mesh, reason=str(stopped)), {}
        found = Answer.read(answer)
    tip, inflation = read(problem, found.displacement)
    cost = found.cost
    run = Run(
        program=program.name,
        mesh=mesh,
        unknowns=cost.unknowns,
        seconds=round(cost.seconds, 2),
        processor=round(cost.processor, 2),
        iterations=cost.iterations,
        factorisations=cost.factorisations,
        tip=[round(float(value) * 1e6, 4) for value in tip],
        inflation=[round(float(value) * 1e6, 4) for value in inflation],
    )
    return run, cost.versions


def chosen(
    every: tuple[Program, ...], only: list[str]
) -> Iterator[tuple[Program, str]]:
    """Programs and meshes that were asked for: ``NAME`` or ``NAME:MESH``."""
    for program in every:
        for mesh in program.meshes:
            names = (program.name, f"{program.name}:{mesh}")
            if not only or any(name in only for name in names):
                yield program, mesh


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--felupe-python", type=Path, default=Path(sys.executable))
    parser.add_argument("--limit", type=float, default=3600.0, help="s, of each run")
    parser.add_argument("--only", nargs="*", default=[], help="NAME or NAME:MESH")
    parser.add_argument("--table", action="store_true", help="write the document alone")
    given = parser.parse_args()
    FOLDER.mkdir(parents=True, exist_ok=True)
    results, page = FOLDER / "fem.json", FOLDER / "fem.md"
    if not given.table:
        every = programs(given.felupe_python.absolute())
        record = Record(
            pressure=[float(p) / 1e3 for p in PRESSURES],
            hardware=hardware(),
            limit=given.limit,
            tolerances={program.name: program.tolerance for program in every},
            settled=settled_answer(),
            one_call=not given.only,
        )
        if given.only and results.exists():
            old = Record.read(results)
            record = replace(record, versions=old.versions, runs=old.runs)
        if hasattr(os, "sched_setaffinity"):  # inherited by every run
            os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
        for program, mesh in chosen(every, given.only):
            print(f"{program.name}, {mesh} mesh ...", flush=True)
            run, versions = measure(program, mesh, given.limit)
            print(f"  {run.reason or f'{run.seconds:.1f} s'}", flush=True)
            record = record.with_run(run)
            if versions:
                words = ", ".join(f"{name} {v}" for name, v in versions.items())
                record.versions[program.name] = words
            record.write(results)
    else:  # of the same runs, against today's converged answer
        replace(Record.read(results), settled=settled_answer()).write(results)
    page.write_text(document(Record.read(results)))


if __name__ == "__main__":
    main()
