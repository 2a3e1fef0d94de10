"""The converged answer for the published device: two element families, refined.

Run by ``make refinement [CASES=1,2,3,4] [MESHES=3]``.  Each run is kept in
docs/refinement.json as soon as it is done, and an interrupted study goes on where it
stopped; docs/refinement.md is written from what is there.

Family ``mixed`` is the product's element: the change of volume projected on a linear
field, two percent of it local.  Family ``displacement`` projects nothing
(``local_share = 1``) and is stiffer where a mesh is coarse.  Both converge to the same
answer, neither from one side only.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from datagen.atomic import write_text
from datagen.device import named_device
from datagen.mesh import MeshLevel
from datagen.problem import baseline
from datagen.response import Path
from datagen.solver import solve

HERE = FilePath(__file__).parent
RUNS = HERE / "refinement.json"
PAGE = HERE / "refinement.md"

PRESSURES = (5.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0)
"""kPa."""

FAMILIES = {"mixed": 0.02, "displacement": 1.0}

MESHES = (
    MeshLevel("1", 6, 4, 3, 2, 2, 1, 2, 1, 0.70, 0.70, 1.0),
    MeshLevel("2", 8, 6, 5, 3, 3, 1, 3, 2, 0.35, 0.35, 0.7),
    MeshLevel("3", 11, 8, 7, 4, 4, 1, 4, 2, 0.16, 0.16, 0.45),
    MeshLevel("4", 14, 10, 9, 5, 5, 1, 5, 3, 0.08, 0.08, 0.3),
)
"""Each finer everywhere, and twice as fine or more at the balloon's edges."""

QUANTITIES = {"tip_deflection": "tip", "inflation": "inflation"}


def run(case: int, family: str, level: MeshLevel) -> dict[str, Any]:
    """Solve one case on one mesh: curves in um, unknowns, seconds."""
    problem = baseline(named_device("S1", case), level)
    problem = replace(problem, local_share=FAMILIES[family])
    response = solve(problem, Path(1e3 * np.array(PRESSURES)))
    if response.path_status != ("completed",):
        raise SystemExit(
            f"case {case}, {family}, mesh {level.name}: {response.message}"
        )
    curves = {
        short: (1e6 * response.output(name)[0]).round(4).tolist()
        for name, short in QUANTITIES.items()
    }
    spent = {key: response.info[key] for key in ("unknowns", "seconds")}
    return curves | {
        "seconds": round(spent["seconds"], 1),
        "unknowns": spent["unknowns"],
    }


def known() -> dict[str, Any]:
    """Runs by name that are done."""
    return json.loads(RUNS.read_text()) if RUNS.exists() else {}


def name_of(case: int, family: str, mesh: str) -> str:
    return f"case {case}, {family}, mesh {mesh}"


def settled(runs: dict[str, Any], case: int, quantity: str) -> tuple[Any, Any]:
    """Estimate from the two families on their finest common mesh, and its error bar.

    Both families are extrapolated from their last two meshes as if the error fell by
    the factor it fell by between the last three, or by 2 where that is less.  The
    answer is the mean of the two; the error bar is half their distance plus half of
    the larger extrapolation.

    Returns
    -------
    value, bar : (s,) arrays, um
    """
    meshes = [
        level.name
        for level in MESHES
        if all(name_of(case, family, level.name) in runs for family in FAMILIES)
    ]
    limits, shifts = [], []
    for family in FAMILIES:
        curves = [
            np.array(runs[name_of(case, family, mesh)][quantity]) for mesh in meshes
        ]
        change = curves[-1] - curves[-2]
        before = np.abs(curves[-2] - curves[-3]).max() if len(curves) > 2 else 0.0
        factor = max(2.0, before / max(np.abs(change).max(), 1e-12))
        limits.append(curves[-1] + change / (factor - 1))
        shifts.append(np.abs(change) / (factor - 1))
    value = (limits[0] + limits[1]) / 2
    bar = np.abs(limits[0] - limits[1]) / 2 + np.maximum(*shifts) / 2
    return value, bar


def page(runs: dict[str, Any]) -> str:
    """The document."""
    lines = [
        "# The converged answer",
        "",
        "The published device S1, contract law, by two element families on meshes that "
        "are refined together (`docs/refine.py`): the product's mixed element, and the "
        "same element without projection. Both converge to the same answer, the "
        "second more slowly; neither bounds it. The settled value is the mean of the "
        "two, each extrapolated from its last meshes, and its error bar is half their "
        "distance and half of the larger extrapolation: an estimate, not a bracket.",
        "",
        "Written by `make refinement` from `docs/refinement.json`. All in um.",
    ]
    for case in (1, 2, 3, 4):
        done = [
            (family, level)
            for level in MESHES
            for family in FAMILIES
            if name_of(case, family, level.name) in runs
        ]
        if not done:
            continue
        for quantity in QUANTITIES.values():
            lines += ["", f"## Case {case}: {quantity}", ""]
            head = [
                "family",
                "mesh",
                "unknowns",
                *(f"{p:g} kPa" for p in PRESSURES),
            ]
            lines += [f"| {' | '.join(head)} |", "| --- " * len(head) + "|"]
            for family, level in done:
                found = runs[name_of(case, family, level.name)]
                cells = [f"{value:.2f}" for value in found[quantity]]
                first = [
                    family,
                    level.name,
                    str(found["unknowns"]),
                ]
                lines.append(f"| {' | '.join([*first, *cells])} |")
            common = [
                level.name
                for level in MESHES
                if all(name_of(case, f, level.name) in runs for f in FAMILIES)
            ]
            if len(common) >= 2:
                value, bar = settled(runs, case, quantity)
                cells = [f"{v:.2f} ± {b:.2f}" for v, b in zip(value, bar, strict=True)]
                lines.append(f"| **settled** | | | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def main(cases: str = "1,2,3,4", meshes: str = "3") -> None:
    """Run what is missing, one after the other, and write the page."""
    runs = known()
    for level in MESHES[: int(meshes)]:
        for case in map(int, cases.split(",")):
            for family in FAMILIES:
                name = name_of(case, family, level.name)
                if name not in runs:
                    print(name, flush=True)
                    runs[name] = run(case, family, level)
                    runs = known() | runs
                    write_text(RUNS, json.dumps(runs, indent=1) + "\n")
                    PAGE.write_text(page(runs))
    PAGE.write_text(page(runs))


if __name__ == "__main__":
    main(*sys.argv[1:])
