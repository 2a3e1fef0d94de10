"""Measure again the numbers that the documents quote, and write them in.

A quoted table stands between two comments that name its block::

    <!-- begin: accuracy -->
    | ... |
    <!-- end: accuracy -->

Everything between them is written here, the command that measured it included.  Run
by ``make docs``, or for some blocks alone: ``python docs/measure.py accuracy``.
"""

from __future__ import annotations

import json
import os
import re
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
DOCUMENTS = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
BLOCK = re.compile(r"(<!-- begin: ([\w-]+) -->\n)(.*?)(<!-- end: \2 -->)", re.DOTALL)

ACCURACY = "accuracy surrogate/reference surrogate/reference/dataset.h5 --json"
CASES = (1, 2, 3, 4)
AT = (20, 60, 100)
TWELVE = "2,4,8,12,16,20,25,30,35,40,45,50"
COMPARE = "compare examples/measurements/bench.csv --level draft"
WORKED = "-m examples.worked"
PBA = (
    sys.executable,
    "-c",
    "import sys; from service.cli import main; sys.exit(main())",
)
COST = f"solve --device S1 --case 1 --pressures {TWELVE} --json"


@dataclass(frozen=True)
class Block:
    """A table of the documents.

    Parameters
    ----------
    write : callable
        Measures, and returns the text.
    repeats : bool
        Whether a second run gives the same numbers: seconds and bytes do not.
    """

    write: Callable[[], str]
    repeats: bool = True


def pba(arguments: str) -> dict[str, Any]:
    """What ``pba ARGUMENTS`` prints as JSON, run in the project's folder."""
    done = subprocess.run(
        [*PBA, *arguments.split()],
        cwd=ROOT,
        env={**os.environ, "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def table(head: list[str], rows: list[list[str]]) -> str:
    """A markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def accuracy() -> str:
    """Errors of the shipped surrogate on the held-out designs of its dataset."""
    found = pba(ACCURACY)
    rows = [
        [
            f"`{name}`",
            f"{errors['rmse']:.2g}",
            *(f"{errors[key]:.2f}" for key in ("median_pct", "p95_pct", "max_pct")),
            f"{errors['r2']:.4f}",
        ]
        for name, errors in found["outputs"].items()
    ]
    head = ["quantity", "rmse", "median %", "95th percentile %", "worst %", "R2"]
    return (
        f"{table(head, rows)}\n"
        f"Percent of each path's own maximum, over {found['n_test']} designs held out "
        f"of the training ({found['n_train']} designs); {found['coverage']['90']:.1%} "
        f"of their points lie inside the 90 % interval.\n\n"
        f"Measured by `pba {ACCURACY}`.\n"
    )


def cases() -> str:
    """The published device by finite elements and by the surrogate."""
    pressures = ",".join(map(str, AT))
    rows = []
    for case in CASES:
        asked = f"--device S1 --case {case} --pressures {pressures} --json"
        fem, quick = pba(f"solve {asked}"), pba(f"predict {asked}")
        for name in ("tip_deflection_mm", "inflation_mm"):
            cells = [
                f"{exact:.3f} ({low:.3f} to {high:.3f})"
                for exact, low, high in zip(
                    fem[name], quick[f"{name}_low"], quick[f"{name}_high"], strict=True
                )
            ]
            rows.append([str(case), f"`{name}`", *cells])
    head = ["case", "quantity", *(f"{at} kPa" for at in AT)]
    return (
        f"{table(head, rows)}\n"
        "Finite elements at the standard mesh, and in brackets the surrogate's 90 % "
        "interval.\n\n"
        f"Measured by `pba solve --device S1 --case 1 --pressures {pressures} --json` "
        "and `pba predict` of the same, cases 1 to 4.\n"
    )


def cost() -> str:
    """Time and memory of one path with twelve outputs."""
    found = pba(COST)
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    bytes_each = 1 if sys.platform == "darwin" else 1024
    return (
        "One path 0 to 50 kPa with 12 load steps, S1 case 1, standard mesh, "
        "one thread: "
        f"{found['unknowns']} unknowns, {found['seconds']:.1f} s, "
        f"{peak * bytes_each / 1e9:.2f} GB at most.\n\n"
        f"Measured by `pba {COST}`.\n"
    )


def compare() -> str:
    """The shipped measurements against the baseline, as people see it."""
    with tempfile.TemporaryDirectory() as kept:
        done = subprocess.run(
            [*PBA, *COMPARE.split()],
            cwd=ROOT,
            env={**os.environ, "PBA_CACHE": kept, "COLUMNS": "80"},
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
    lines = "\n".join(line.rstrip() for line in done.stdout.splitlines())
    return f"```text\n{lines}\n```\n\nMeasured by `pba {COMPARE}`.\n"


def worked() -> str:
    """The worked example, as people see it."""
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, *WORKED.split(), folder],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
    lines = "\n".join(line.rstrip() for line in done.stdout.rstrip().splitlines())
    return f"```text\n{lines}\n```\n\nMeasured by `python {WORKED}`.\n"


def printed(module: str) -> str:
    """The table that a module of this folder prints."""
    done = subprocess.run(
        [sys.executable, "-m", module],
        cwd=ROOT,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return f"{done.stdout}\nMeasured by `python -m {module}`.\n"


BLOCKS = {
    "cost": Block(cost, repeats=False),  # first: its memory is that of one child alone
    "accuracy": Block(accuracy),
    "cases": Block(cases),
    "compare": Block(compare),
    "worked": Block(worked, repeats=False),  # many minutes
    "intervals": Block(partial(printed, "docs.intervals")),
    # Some minutes each; the tests do fewer sets.
    "known": Block(partial(printed, "docs.known"), repeats=False),
    "alarms": Block(partial(printed, "docs.alarms"), repeats=False),
    "derivatives": Block(partial(printed, "docs.derivative_cost"), repeats=False),
    "differences": Block(partial(printed, "docs.differences"), repeats=False),
}


def blocks_of(text: str) -> dict[str, str]:
    """Blocks of a document and what stands in them."""
    return {name: body for _, name, body, _ in BLOCK.findall(text)}


def fill(text: str, name: str, body: str) -> str:
    """The document with one block replaced."""
    return BLOCK.sub(
        lambda found: (
            f"{found[1]}{body}{found[4]}" if found[2] == name else found.group()
        ),
        text,
    )


def main(names: list[str]) -> None:
    """Fill the named blocks, all of them where none is named."""
    unknown = set(names) - set(BLOCKS)
    if unknown:
        raise SystemExit(f"{sorted(unknown)[0]}: no such block; {', '.join(BLOCKS)}")
    for name, block in BLOCKS.items():
        holders = [
            document
            for document in DOCUMENTS
            if name in blocks_of(document.read_text())
        ]
        if holders and (not names or name in names):
            print(f"measuring {name}", flush=True)
            body = block.write()
            for document in holders:
                document.write_text(fill(document.read_text(), name, body))


if __name__ == "__main__":
    main(sys.argv[1:])
