"""Run every benchmark and every mutation, and write docs/verification.md.

``make verification`` runs it as ``python -m docs.verify``; it takes many minutes, most
of them for the mutations.  ``make verification ONLY="sphere history.py"`` runs some
alone and leaves the rest of the document as it is: sections by their name in
`SECTIONS`, mutations by their file.  It fails where a bar is not met or a test misses
its mutation.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

# One thread, set before any library starts its own: the numbers are those of one core.
os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

from tests.verification.benchmarks import (
    BENCHMARKS,
    BOUND,
    LEVELS,
    Benchmark,
    run,
    specimen,
    stiffening,
)
from tests.verification.convergence import THEORY, study
from tests.verification.mutations import MUTATIONS, Caught, Mutation, caught

DOCUMENT = Path(__file__).parent / "verification.md"

MISSES = ("NOT MET", "MISSED IT")
"""Words of the document where a bar is not met, or a test does not see a break."""

HEAD = """\
# Verification

Written by `make verification`; change `docs/verify.py` instead. How the solver works is
told in [finite-elements.md](finite-elements.md).

The same solver that follows devices (elements, follower pressure, path control, linear
algebra) is run here on bodies whose answers are known. The bodies are in
`tests/verification/bodies.py`, the exact answers, each derived from its own equations,
in `tests/verification/closed_forms.py`. Lengths and moduli are dimensionless. Errors
are relative: the bar is 0.5 % at the standard mesh and 0.1 % at the fine one.
"""

LAWS = """\
## Laws and patches

To rounding (1e-12), in `tests/verification`:

- Neo-Hookean, Gent, Yeoh and Mooney-Rivlin laws in uniaxial, equibiaxial and planar
  tension and compression, the pressure eliminated by the free face.
- A patch of 27 distorted elements under a large uniform stretch, turned by 138 degrees:
  nodal forces are those of the nominal stress on the outer faces, and zero inside. The
  same with an initial strain Fg that is neither small nor symmetric.
- A rigid rotation gives no stress.

And to the accuracy of what they are compared with:

- The same patch solved under dead surface forces takes the uniform state (1e-8).
- Stresses and tangents of the laws against differences of energies and stresses (3e-8
  and 3e-7 of the shear modulus), the assembled tangent against differences of residuals
  (1e-7).
- The residual to first order, from which derivatives are made: products with it are
  those of the assembled tangent (1e-12), and along moved undeformed nodes it is the
  limit of central differences (1e-7).
"""

LIMITS = """\
## What is not verified here

- **History laws on a body of known answer.** Their ramp and unloading tables (Ogden and
  Roxburgh, linear convolution) are tests of the laws at a point, and devices load and
  unload with them, in `tests/datagen/test_history.py`; mutations above break them.
- **The clamp of a device.** A face that is held altogether has a singularity at its
  edge, and no closed form; the plate above is clamped as plate theory has it.
"""


def cell(number: float) -> str:
    """A number as the tables show it."""
    return f"{number:.5g}"


def table(head: list[str], rows: list[list[str]]) -> str:
    """A markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def benchmark(name: str, found: Benchmark) -> str:
    """Section of one benchmark, both meshes side by side."""
    began = time.perf_counter()
    results = {level: run(name, level) for level in LEVELS}
    print(f"  {name}: {time.perf_counter() - began:.0f} s", flush=True)
    rows = [
        [
            standard.case,
            standard.quantity,
            *(
                text
                for row in (standard, fine)
                for text in (
                    cell(row.exact),
                    cell(row.computed),
                    f"{100 * row.error:+.3f} %",
                )
            ),
        ]
        for standard, fine in zip(*results.values(), strict=True)
    ]
    head = ["case", "quantity"]
    head += [
        f"{what}, {at}" for at in LEVELS for what in ("exact", "computed", "error")
    ]
    lines = []
    for level, found_rows in results.items():
        worst = max(abs(row.error) for row in found_rows)
        met = "met" if worst <= BOUND[level] else MISSES[0]
        most = max(row.unknowns for row in found_rows)
        lines.append(
            f"- {level}: {found.mesh[level]}; {most} unknowns at most; worst error "
            f"{100 * worst:.3f} %, bar {100 * BOUND[level]:g} % {met}.\n"
        )
    return f"{found.about}\n\n{''.join(lines)}\n{table(head, rows)}"


def orders() -> str:
    """Section on convergence."""
    rows = []
    for name, counts in (("tube", (1, 2, 4, 8)), ("sphere", (1, 2, 4, 8))):
        found = study(name, counts)
        for quantity, theory in THEORY.items():
            seen = ", ".join(f"{order:.2f}" for order in found.orders[quantity])
            errors = ", ".join(f"{error:.1e}" for error in found.errors[quantity])
            meshes = ", ".join(map(str, counts))
            rows.append([name, quantity, meshes, errors, seen, f"{theory:g}"])
    head = ["body", "quantity", "elements", "relative errors", "orders", "theory"]
    return (
        "Sphere and tube, k = 1.5, nu = 0.48, at a fixed pressure, against the "
        "boundary-value problem of the radius: displacements and their gradients in "
        "the L2 norm, and the cavity's volume, which is the pressure's work conjugate "
        "and converges twice as fast as the gradients. Elements are counted through "
        "the wall and along 45 degrees.\n\n" + table(head, rows)
    )


def nearly_incompressible() -> str:
    """Section on the local share of the volumetric energy."""
    rows = [
        [f"{bulk:.5g}", str(count), f"{100 * error:+.3f} %"]
        for bulk, count, error in stiffening()
    ]
    return (
        "A share of the volumetric energy is not projected (`local_share` in "
        "`elements.py`): two percent of it at nu = 0.48, and so much less at a larger "
        "K/mu that it never exceeds half a shear modulus. The error of a mesh then "
        "does not depend on K. Pressure of the sphere, k = 2, near la = 1.1, against "
        "the exact answer at the same K:\n\n"
        + table(["K/mu", "elements through the wall", "error of p"], rows)
    )


def thick_specimen() -> str:
    """Section on the specimen that plate theory is used for."""
    rows = [
        [
            str(kpa),
            f"{plate:.4f}",
            f"{solid:.4f}",
            f"{100 * (solid / plate - 1):+.1f} %",
        ]
        for kpa, plate, solid in specimen()
    ]
    head = ["p, kPa", "plate, mm", "solid, mm", "difference"]
    return (
        "2 x 8 mm, 140 um, 4.5 MPa: h/a = 0.14, for which plate theory is no exact "
        "answer. It knows neither shear, of order 5 (h/a)^2 of w, nor that a membrane "
        "that is stretched gets thinner. No bar applies; the last rows of the clamped "
        "membrane's table have the same loads on a thin one. Standard mesh of "
        "`datagen/specimens.py`.\n\n" + table(head, rows)
    )


SECTIONS: dict[str, tuple[str, Callable[[], str]]] = {
    **{
        name: (found.title, partial(benchmark, name, found))
        for name, found in BENCHMARKS.items()
    },
    "specimen": ("The bulge specimen as thick as it is", thick_specimen),
    "orders": ("Orders of convergence", orders),
    "stiffening": (
        "Much stiffer in volume than the contract's material",
        nearly_incompressible,
    ),
}
"""Title and text of all that is measured but for the mutations, in their order."""

ROW = re.compile(r"^\| (.+?) \| `\w+\.py` \| .+ \|$", re.MULTILINE)
"""A mutation's row; the first column is its words."""


def mutation_row(mutation: Mutation, found: dict[str, Caught]) -> str:
    """What became of the tests that should see a break."""
    tests = []
    for name, (failed, kinds) in found.items():
        words = f"`{name.partition('::')[2]}`"
        if kinds > 1:
            words += f" ({failed} of {kinds})"
        tests.append(words if failed else f"{words} {MISSES[1]}")
    return f"| {mutation.what} | `{mutation.file}` | {', '.join(tests)} |"


def mutations(known: dict[str, str], only: Sequence[str]) -> str:
    """Section on the breaks that the tests were shown to catch.

    known : rows of a former run by the mutation's words.
    only : files whose mutations are run; all where it is empty.
    """
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for mutation in MUTATIONS:
            if not only or mutation.file in only:
                print(f"  {mutation.what}", flush=True)
                found = caught(mutation, Path(folder))
                rows.append(mutation_row(mutation, found))
            elif mutation.what in known:
                rows.append(known[mutation.what])
    seen = sum(MISSES[1] not in row for row in rows)
    return (
        "One line of the solver at a time is broken on purpose in a copy of the "
        "package, and the tests named beside it are run there in a fresh process "
        "(`tests/verification/mutations.py`). Behind a test of several kinds stands "
        "how many of them fail, where that was counted: a break of one law fails that "
        "law's alone. Every test "
        "of `tests/verification` that runs the solver is named; of `tests/datagen`, "
        "those of history, paths, derivatives, instruments and surfaces that the "
        f"breaks were made for. {seen} of {len(MUTATIONS)} breaks are caught by every "
        "test named.\n\n"
        "| break | file | tests that fail |\n| --- | --- | --- |\n"
        + "".join(f"{row}\n" for row in rows)
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, write the document at once, and count what is missed."""
    parser = argparse.ArgumentParser(prog="docs.verify")
    files = sorted({mutation.file for mutation in MUTATIONS})
    names = (*SECTIONS, *files)
    parser.add_argument("--only", nargs="+", choices=names, default=[], metavar="NAME")
    only = parser.parse_args(arguments).only
    old = DOCUMENT.read_text()
    former = dict(re.findall(r"^## (.+)\n\n((?:(?!^## ).*\n)*)", old, re.MULTILINE))
    parts = [HEAD]
    for name, (title, write) in SECTIONS.items():
        if only and name not in only:
            text = former.get(title, "Not run yet.\n").rstrip() + "\n"
        else:
            print(name, flush=True)
            text = write()
        parts.append(f"## {title}\n\n{text}")
    parts.append(LAWS)
    print("mutations", flush=True)
    rows = {found[1]: found[0] for found in ROW.finditer(old)}
    parts += [f"## Mutations\n\n{mutations(rows, only)}", LIMITS]
    DOCUMENT.write_text("\n".join(parts))
    missed = [line for part in parts for line in part.splitlines() if told(line)]
    print(*missed, sep="\n", file=sys.stderr)
    return len(missed)


def told(line: str) -> bool:
    """Whether a line of the document says that something was missed."""
    return any(words in line for words in MISSES)


if __name__ == "__main__":
    sys.exit(min(main(), 1))
