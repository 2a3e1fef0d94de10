"""CalculiX on a question: ``peer_calculix QUESTION ANSWER``.

Writes an input deck, runs ``ccx``, reads what it printed.  C3D20R, *HYPERELASTIC, NEO
HOOKE, U = C10 (I1bar - 3) + (J - 1)^2 / D1: the contract's law with C10 = mu/2 and
D1 = 2/K.

In a static step CalculiX leaves the stiffness of the follower pressure out, so its
Newton's method converges linearly; tolerances that are tight enough have to be asked
for, and kept from being relaxed after nine iterations.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from .exchange import FORCE, LENGTH, Answer, Cost, Question

Array = np.ndarray

RESIDUAL, CORRECTION = 1e-6, 5e-4
"""Largest residual over the mean force, last correction over the increment's largest.

Corrections shrink by 0.93 an iteration at 60 kPa, so that this tolerance leaves a few
tenths of a micrometre at the tip.
"""

CONTROLS = f"""\
*CONTROLS, PARAMETERS=TIME INCREMENTATION
20, 100, 100, 200, 50, 4, , 10, ,
0.25, 0.5, 0.75, 0.85, , , 1.5,
*CONTROLS, PARAMETERS=FIELD
{RESIDUAL:g}, {CORRECTION:g}, , , {RESIDUAL:g}, 1e-9, , 1e-12
"""
"""Iterations before divergence is judged, before tolerances are relaxed and before an
increment is cut; then the tolerances, the relaxed one as tight as the other."""

SMALLEST = 1 / 64
"""Of a load step, before the path is given up."""

assert LENGTH**2 == FORCE, "stress stays in Pa"

_PER_LINE = 15
"""Numbers on a line of a deck; CalculiX reads at most sixteen."""


class PeerFailed(RuntimeError):
    """The program did not get to the last pressure; the text says why."""


def _lists(numbers: Array) -> Iterator[str]:
    """Lines of comma-separated numbers, each but the last ending in a comma."""
    for start in range(0, len(numbers), _PER_LINE):
        line = ", ".join(map(str, numbers[start : start + _PER_LINE]))
        yield line + ("," if start + _PER_LINE < len(numbers) else "")


def _model(question: Question) -> Iterator[str]:
    """Nodes, elements, materials and supports."""
    yield "*NODE, NSET=ALL"
    for i, (x, y, z) in enumerate(question.nodes * LENGTH, 1):
        yield f"{i}, {x:.12g}, {y:.12g}, {z:.12g}"
    for shear in np.unique(question.shear):
        chosen = np.flatnonzero(question.shear == shear)
        bulk = question.bulk[chosen[0]]
        name = f"LAYER{chosen[0] + 1}"
        yield f"*ELEMENT, TYPE=C3D20R, ELSET={name}"
        for e in chosen:
            yield from _lists(np.concatenate([[e + 1], question.cells[e] + 1]))
        yield f"*MATERIAL, NAME={name}"
        yield "*HYPERELASTIC, NEO HOOKE"
        yield f"{shear / 2:.15g}, {2 / bulk:.15g}"
        yield f"*SOLID SECTION, ELSET={name}, MATERIAL={name}"
    yield "*BOUNDARY"
    for node, axis in np.argwhere(question.fixed):
        yield f"{node + 1}, {axis + 1}, {axis + 1}"
    for face in range(6):
        wet = np.flatnonzero(question.wet[:, face])
        if len(wet):
            yield f"*ELSET, ELSET=WET{face + 1}"
            yield from _lists(wet + 1)


def _step(question: Question) -> Iterator[str]:
    """One static step, a unit of time for each pressure, printed at each.

    A step for each pressure would start from the last solution; increments of one step
    are extrapolated and take half the iterations.
    """
    count, last = len(question.pressure), float(question.pressure[-1])
    even = last * np.arange(1, count + 1) / count
    if not np.allclose(question.pressure, even, rtol=1e-9):
        raise ValueError("pressures must be multiples of the first: the load is a ramp")
    yield "*TIME POINTS, NAME=WANTED, GENERATE"
    yield f"1., {count}., 1."
    yield f"*STEP, NLGEOM, INC={round(count / SMALLEST)}"
    yield "*STATIC"
    yield f"1., {count}., {SMALLEST:g}, 1."
    yield CONTROLS.rstrip()
    yield "*DLOAD"
    for face in range(6):
        if question.wet[:, face].any():
            yield f"WET{face + 1}, P{face + 1}, {last:.12g}"
    yield "*NODE PRINT, NSET=ALL, TIME POINTS=WANTED"
    yield "U"
    yield "*END STEP"


def deck(question: Question) -> str:
    """CalculiX's input deck, in mm, uN and Pa."""
    return "\n".join([*_model(question), *_step(question), ""])


_HEADER = re.compile(r"^ displacements .*time\s+(\S+)\s*$", re.MULTILINE)


def displacements(printed: str, nodes: int) -> dict[int, Array]:
    """Displacements at each whole unit of time, from ccx's ``.dat`` file.

    Parameters
    ----------
    printed : str
    nodes : int
        Number of nodes that were asked for.

    Returns
    -------
    dict of time, from 1, to (n, 3) array, m

    Raises
    ------
    PeerFailed
        When a table is not whole.
    """
    headers = list(_HEADER.finditer(printed))
    ends = [header.start() for header in headers[1:]] + [len(printed)]
    tables = {}
    for header, end in zip(headers, ends, strict=True):
        total = float(header[1])
        rows = printed[header.end() : end].split()
        if len(rows) != 4 * nodes:
            raise PeerFailed(f"{len(rows) // 4} of {nodes} nodes printed at {total}")
        table = np.array(rows, dtype=float).reshape(nodes, 4)
        if (table[:, 0] != np.arange(1, nodes + 1)).any():
            raise PeerFailed(f"nodes out of order at {total}")
        if abs(total - round(total)) < 1e-6:
            tables[round(total)] = table[:, 1:] / LENGTH
    return tables


def count_iterations(history: str) -> int:
    """Iterations of all steps together, from ccx's ``.cvg`` file: one a line."""
    return len(re.findall(r"^\s+\d+\s+\d+\s+\d+\s+\d+\s", history, re.MULTILINE))


def version() -> str:
    """CalculiX's version.

    Raises
    ------
    PeerFailed
        When there is no ``ccx``.
    """
    try:
        said = subprocess.run(
            ["ccx", "-v"], capture_output=True, text=True, check=False
        ).stdout
    except FileNotFoundError as error:
        raise PeerFailed(
            "ccx is not installed (Debian package calculix-ccx)"
        ) from error
    found = re.search(r"Version (\S+)", said)
    return found[1] if found else "unknown"


def _busy() -> float:
    """Processor time of all children so far, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def linear_solver(said: str) -> str:
    """The linear solver that ccx said it used."""
    found = re.search(r"using the symmetric (\w+) solver", said)
    return found[1].upper() if found else "not named"


def solve(question: Question) -> Answer:
    """Run ccx in a folder of its own.

    Raises
    ------
    PeerFailed
        When ccx is missing, ended before the last pressure, or the question is not of
        the contract's law and pressure alone.
    """
    if not question.plain:
        raise PeerFailed("the deck has the contract's law and pressure alone")
    number = version()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "strip.inp").write_text(deck(question))
        began, busy = time.perf_counter(), _busy()
        done = subprocess.run(
            ["ccx", "strip"],
            cwd=folder,
            env={**os.environ, "OMP_NUM_THREADS": "1", "CCX_NPROC_STIFFNESS": "1"},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        seconds, busy = time.perf_counter() - began, _busy() - busy
        printed = folder / "strip.dat"
        tables = displacements(
            printed.read_text() if printed.exists() else "", len(question.nodes)
        )
        steps = len(question.pressure)
        if set(tables) != set(range(1, steps + 1)):
            said = [line for line in done.stdout.splitlines() if "*ERROR" in line]
            reason = " ".join((said or done.stdout.splitlines() or ["no output"])[-1:])
            reached = question.pressure[len(tables) - 1] / 1e3 if tables else 0.0
            raise PeerFailed(
                f"failed past {reached:.4g} kPa: {' '.join(reason.split())}"
            )
        iterations = count_iterations((folder / "strip.cvg").read_text())
    return Answer(
        np.stack([tables[i + 1] for i in range(steps)]),
        Cost(
            seconds=seconds,
            processor=busy,
            iterations=iterations,
            factorisations=iterations,
            unknowns=question.unknowns,
            versions={"CalculiX": number, "linear solver": linear_solver(done.stdout)},
        ),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("question", type=Path)
    parser.add_argument("answer", type=Path)
    given = parser.parse_args()
    try:
        answer = solve(Question.read(given.question))
    except PeerFailed as failure:
        raise SystemExit(str(failure)) from failure
    answer.write(given.answer)


if __name__ == "__main__":
    main()
