"""The benchmark's document, from its results."""

from __future__ import annotations

import math
from collections.abc import Iterable

from .record import (
    MESHES,
    OWN,
    SHORT,
    TURNS,
    Record,
    Run,
    cheapest,
)

AT = (10.0, 20.0, 30.0, 40.0, 50.0, 60.0)
"""kPa, of the table of answers."""

WANTED = (2.0, 0.5)
"""Percent: error of tip and inflation that an answer is wanted with."""


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A markdown table."""
    lines = [list(head)]
    lines += [["---"] * len(lines[0]), *(list(row) for row in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def answers(record: Record) -> str:
    """Tip and inflation of every run."""
    spots = [record.pressure.index(at) for at in AT]
    rows = []
    for run in record.runs:
        if run.done:
            pairs = [f"{run.tip[i]:.1f} / {run.inflation[i]:.1f}" for i in spots]
            rows.append([run.program, run.mesh, *pairs])
    return table(["program", "mesh", *(f"{at:.0f} kPa" for at in AT)], rows)


def _apart(one: Run, other: Run) -> tuple[float, float]:
    """Largest difference of tip and inflation over the path, um."""
    pairs = ((one.tip, other.tip), (one.inflation, other.inflation))
    tip, inflation = (
        max(abs(a - b) for a, b in zip(*both, strict=True)) for both in pairs
    )
    return tip, inflation


def agreement(record: Record) -> str:
    """How far the peers, which have the same element, are from each other."""
    lines = []
    for mesh in dict.fromkeys(run.mesh for run in record.runs):
        peers = [
            r for r in record.runs if r.done and r.mesh == mesh and r.program != OWN
        ]
        if len({run.program for run in peers}) > 1:
            apart = [_apart(one, other) for one in peers for other in peers]
            tip, inflation = (max(values) for values in zip(*apart, strict=True))
            lines.append([mesh, f"{tip:.2f}", f"{inflation:.2f}"])
    head = ["mesh", "tip, um at most", "inflation, um at most"]
    said = "The peers, which have the same element, differ from each other by"
    return f"{said}\n\n{table(head, lines)}\n" if lines else ""


def failures(record: Record) -> str:
    """Runs that gave nothing, and why; runs that were not made."""
    lines = [
        f"- {run.program}, {run.mesh} mesh: {run.reason}\n"
        for run in record.runs
        if not run.done
    ]
    for program in record.tolerances:
        made = {run.mesh for run in record.runs if run.program == program}
        left = ", ".join(mesh for mesh in MESHES if mesh not in made)
        lines += [f"- {program}: not run on {left}\n"] if left else []
    return "".join(["Without an answer:\n\n", *lines, "\n"]) if lines else ""


def costs(record: Record) -> str:
    """Errors and cost of every run, and what we take for as good an answer."""
    rows = []
    for run in record.runs:
        if not run.done:
            continue
        numbers = [
            f"{run.unknowns}",
            f"{run.seconds:.1f}",
            f"{run.processor:.1f}",
            f"{run.iterations}",
            f"{run.factorisations}",
        ]
        errors = [f"{error:.2f}" for error in record.errors(run)]
        rows.append([run.program, run.mesh, *numbers, *errors, *_matched(record, run)])
    head = [
        "program",
        "mesh",
        "unknowns",
        "seconds",
        "processor seconds",
        "iterations",
        "factorisations",
        "tip error, %",
        "inflation error, %",
        "ratio on this mesh",
        "our cheapest run as accurate",
        "ratio to that",
    ]
    return table(head, rows)


def _matched(record: Record, run: Run) -> list[str]:
    """A peer's time over ours: same mesh; our cheapest run that is no worse."""
    if run.program == OWN:
        return ["", "", ""]
    try:
        same = run.processor / record.find(OWN, run.mesh).processor
    except LookupError:
        same = math.nan
    cells = [f"{same:.1f}" if math.isfinite(same) else ""]
    ours = cheapest(record, OWN, *record.errors(run))
    if ours is None:
        return [*cells, "none", ""]
    return [*cells, ours.mesh, f"{run.processor / ours.processor:.1f}"]


def wanted(record: Record) -> str:
    """The cheapest run of each program that is as accurate as wanted."""
    ours = cheapest(record, OWN, *WANTED)
    rows = []
    for program in dict.fromkeys(run.program for run in record.runs):
        run = cheapest(record, program, *WANTED)
        if run is None:
            tried = [r for r in record.runs if r.program == program and r.done]
            longest = max((r.processor for r in tried), default=0.0)
            more = longest / ours.processor if ours else 0.0
            said = f"more than {more:.0f}" if more else ""
            rows.append([program, "none of these", f"more than {longest:.0f}", said])
        else:
            ratio = f"{run.processor / ours.processor:.1f}" if ours else ""
            rows.append([program, run.mesh, f"{run.processor:.1f}", ratio])
    return table(["program", "mesh", "processor seconds", "ratio"], rows)


def document(record: Record) -> str:
    """The whole document, markdown."""
    settled, span = record.settled, record.settled.span
    at = ", ".join(f"{p:g}" for p in settled.pressure)
    bars = (
        f"{100 * settled.tip_bar / span[0]:.2f} and "
        f"{100 * settled.inflation_bar / span[1]:.2f}"
    )
    facts = table(
        ["program", "versions", "converged when"],
        [
            [name, record.versions.get(name, "no run gave a result"), tolerance]
            for name, tolerance in record.tolerances.items()
        ],
    )
    steps = ", ".join(f"{p:g}" for p in record.pressure)
    calls = "all in one call" if record.one_call else "not all in one call (`--only`)"
    return f"""\
# Finite elements side by side

Written by `make bench-fem` from `fem.json`, which the same command measures. Change
neither by hand.

## The problem

Device S1, case 1; W = mu/2 (I1bar - 3) + K/2 (J - 1)^2 with nu = 0.48; half symmetric;
a follower pressure on all walls of the cavity. Load steps, kPa:
{steps}.

Every program gets the same grid lines (`datagen/mesh.py`, `benchmarks/case.py`): ours
puts 27 nodes on an element and projects the volume changes, the others take 20 nodes
and 2 x 2 x 2 points (C3D20R in CalculiX). Peers work in mm, uN and Pa; in larger units
absolute floors in both of them end their iterations early.

Tip and inflation of all programs are read by the same code from the nodes'
displacements (`datagen/observe.py`).

{record.hardware}.

One at a time, {calls}; of runs shorter than {SHORT:.0f} s the median of {TURNS}, of
others one, stopped after {record.limit:.0f} s. Seconds are wall time from the mesh in
memory to the last displacement: imports and compilation are left out; for CalculiX it
is the whole run of `ccx`. Where they exceed the processor's seconds by
far, the machine had other work; ratios are of the latter.

{facts}
FElupe is shown with its default linear solver and with the one that its documentation
names as the faster; each load step starts from the last solution. In a static step
CalculiX leaves out the stiffness of the follower pressure: its corrections shrink by a
constant factor, which comes close to one as the pressure grows.

## Answers

Tip deflection / inflation, um.

{answers(record)}
{agreement(record)}{failures(record)}## Errors and cost

Errors are the largest at {at} kPa, in percent of the largest amount
({span[0]:.1f} um tip, {span[1]:.1f} um inflation), against the converged answer
([refinement.md](../refinement.md)), which is known to {bars} %. The last
columns are ratios of a peer's time to ours: on the same mesh, and to our cheapest run
whose two errors are both no larger.

{costs(record)}
Cheapest runs with the tip within {WANTED[0]:g} % and inflation within {WANTED[1]:g} %:

{wanted(record)}
The tip converges slowly, as the edges of the cavity and of the clamp are singular and
act as hinges.
"""
