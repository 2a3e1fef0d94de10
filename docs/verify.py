"""Run every benchmark and every mutation, and write docs/verification.md.

``make verification`` runs it as ``python -m docs.verify``; it takes several minutes,
most of them for the mutations.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

# One thread, set before any library starts its own: the numbers are those of one core.
os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

from tests.verification.benchmarks import (
    BENCHMARKS,
    BOUND,
    LEVELS,
    Benchmark,
    run,
    stiffening,
)
from tests.verification.convergence import THEORY, study
from tests.verification.mutations import MUTATIONS, survivors

DOCUMENT = Path(__file__).parent / "verification.md"

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
- Stresses and tangents against differences of energies and of residuals (1e-7).
- The residual to first order, from which derivatives are made: products with it are
  those of the assembled tangent (1e-12), and along moved undeformed nodes it is the
  limit of central differences (1e-7).
"""

LIMITS = """\
## What is not verified here

- **Follower end load, tip moment, and pressure on one face of a beam.** The solver
  carries dead nodal forces and the pressure of closed cavities. Both have a potential,
  and its tangent is symmetric for that reason. A follower end load has none, nor has a
  pressure on a surface whose open edge moves; a tip moment has one only in the plane,
  which is the rotation of the end face, no load of this solver.
- **History laws on a body.** Their ramp and unloading tables (Ogden and Roxburgh,
  linear convolution) are tests of laws and paths, in `tests/datagen/test_history.py`.
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
        met = "met" if worst <= BOUND[level] else "NOT MET"
        most = max(row.unknowns for row in found_rows)
        lines.append(
            f"- {level}: {found.mesh[level]}; {most} unknowns at most; worst error "
            f"{100 * worst:.3f} %, bar {100 * BOUND[level]:g} % {met}.\n"
        )
    return f"## {found.title}\n\n{found.about}\n\n{''.join(lines)}\n{table(head, rows)}"


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
        "## Orders of convergence\n\n"
        "Sphere and tube, k = 1.5, nu = 0.48, at a fixed pressure, against the "
        "boundary-value problem of the radius: displacements and their gradients in "
        "the L2 norm, and the cavity's volume, which is the pressure's work conjugate "
        "and converges twice as fast as the gradients. Elements are counted through "
        "the wall and along 45 degrees.\n\n" + table(head, rows)
    )


def nearly_incompressible() -> str:
    """Section on the price of the local share of the volumetric energy."""
    rows = [
        [f"{bulk:.5g}", str(count), f"{100 * error:+.3f} %"]
        for bulk, count, error in stiffening()
    ]
    return (
        "## Much stiffer in volume than the contract's material\n\n"
        "A share of the volumetric energy is not projected (`LOCAL_SHARE` in "
        "`elements.py`). At nu = 0.48 it does no harm. At K/mu of a thousand and more "
        "coarse meshes of thick walls become too stiff at small strain, which is why "
        "incompressible rows above begin at la = 1.25. Pressure of the sphere, k = 2, "
        "near la = 1.1, against the exact answer at the same K:\n\n"
        + table(["K/mu", "elements through the wall", "error of p"], rows)
    )


def mutations() -> str:
    """Section on the breaks that the tests were shown to catch."""
    found = survivors()
    rows = []
    for mutation in MUTATIONS:
        missing = found.get(mutation.what, [])
        tests = [
            f"`{name.partition('::')[2]}`" + (" MISSED IT" if name in missing else "")
            for name in mutation.caught_by
        ]
        rows.append([mutation.what, f"`{mutation.file}`", ", ".join(tests)])
    caught = sum(mutation.what not in found for mutation in MUTATIONS)
    return (
        "## Mutations\n\n"
        "Each test was seen to fail. One line of the solver at a time is broken on "
        "purpose in a copy of the package, and the tests named beside it are run there "
        f"in a fresh process (`tests/verification/mutations.py`): {caught} of "
        f"{len(MUTATIONS)} breaks are caught by every test named.\n\n"
        + table(["break", "file", "tests that fail"], rows)
    )


def main() -> None:
    """Measure everything, then write the document at once."""
    print("benchmarks", flush=True)
    parts = [HEAD, *(benchmark(name, found) for name, found in BENCHMARKS.items())]
    print("convergence", flush=True)
    parts += [orders(), nearly_incompressible(), LAWS]
    print("mutations", flush=True)
    parts += [mutations(), LIMITS]
    DOCUMENT.write_text("\n".join(parts))


if __name__ == "__main__":
    main()
