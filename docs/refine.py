"""The converged answer for the published device: three element families, refined.

Run by ``make refinement [CASES=1,2,3,4] [MESHES=3]``.  Each run is kept in
docs/refinement.json as soon as it is done, and an interrupted study goes on where it
stopped; docs/refinement.md is written from what is there.

Family ``mixed`` is the product's element: the change of volume projected on a linear
field, two percent of it local.  ``Taylor-Hood`` has a continuous pressure of its own
unknowns and the same local share (`docs/taylor_hood.py`).  ``displacement`` projects
nothing (``local_share = 1``): it locks, is far stiffer where a mesh is coarse, and is
shown to come to the same place, but settles nothing.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from scipy.optimize import brentq

from datagen.atomic import write_text
from datagen.continuation import PathFollower
from datagen.device import named_device
from datagen.levels import MeshLevel
from datagen.observe import Instruments
from datagen.problem import Problem, baseline
from datagen.response import OUTPUT_NAMES, Path
from datagen.solver import solve

from .taylor_hood import TaylorHood

Array = np.ndarray

HERE = FilePath(__file__).parent
RUNS = HERE / "refinement.json"
PAGE = HERE / "refinement.md"

PRESSURES = (5.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0)
"""kPa."""

SHARES = {"mixed": 0.02, "displacement": 1.0}
"""Local share of the volumetric energy in the product's solver."""

SETTLING = ("mixed", "Taylor-Hood")
"""Families that the settled answer rests on."""

FAMILIES = (*SETTLING, "displacement")

MESHES = (
    MeshLevel("1", 6, 4, 4, 3, 3, 1, 2, 1, 0.70, 0.70, 0.80, 0.70),
    MeshLevel("2", 9, 6, 7, 4, 5, 1, 3, 2, 0.35, 0.35, 0.60, 0.35),
    MeshLevel("3", 12, 8, 10, 5, 7, 1, 4, 3, 0.17, 0.17, 0.45, 0.17),
    MeshLevel("4", 16, 11, 13, 7, 9, 1, 5, 4, 0.085, 0.085, 0.34, 0.085),
)
"""Each finer everywhere, and twice as fine at the edges of balloon and clamp."""

ORDERS = (1.0, 2.0)
"""Between which errors fall: that of singular edges, and the elements' own at best."""

QUANTITIES = {"tip_deflection": "tip", "inflation": "inflation"}


def run(case: int, family: str, level: MeshLevel) -> dict[str, Any]:
    """Solve one case on one mesh: curves in um, unknowns, seconds."""
    began = time.perf_counter()
    share = SHARES.get(family, SHARES["mixed"])
    problem, points, unknowns = followed(case, share, level)
    if family not in SHARES:
        other = TaylorHood(problem)
        points = list(along(other, points))
        unknowns = other.unknowns
    instruments = Instruments(problem)
    values = 1e6 * np.array([instruments.read(x, 0.0) for x, _ in points])
    curves = {
        short: values[:, OUTPUT_NAMES.index(name)].round(4).tolist()
        for name, short in QUANTITIES.items()
    }
    spent = round(time.perf_counter() - began, 1)
    return curves | {"seconds": spent, "unknowns": unknowns}


@lru_cache(maxsize=1)  # Taylor-Hood starts from the path that was solved just before
def followed(
    case: int, share: float, level: MeshLevel
) -> tuple[Problem, list[tuple[Array, float]], int]:
    """The product's path: its problem, nodes (n, 3), m, and pressures, Pa, unknowns."""
    problem = replace(baseline(named_device("S1", case), level), local_share=share)
    follower = PathFollower(problem)
    outcome = follower.run(1e3 * np.array(PRESSURES))
    if outcome.status != "completed":
        raise SystemExit(f"case {case}, mesh {level.name}: {outcome.message}")
    points = [(point.x, point.pressure) for _, point in outcome.points]
    return problem, points, follower.equations.unknowns


def along(
    other: TaylorHood, points: Sequence[tuple[Array, float]]
) -> Iterator[tuple[Array, float]]:
    """Nodes (n, 3), m, and pressures, Pa, of the other family along the same path.

    Sought from the product's nodes, moved as those at the pressure before had to be.
    """
    moved = np.zeros_like(points[0][0])
    for x, pressure in points:
        found = other.equilibrium(x + moved, pressure)
        yield found, pressure
        moved = found - x


def known() -> dict[str, Any]:
    """Runs by name that are done."""
    return json.loads(RUNS.read_text()) if RUNS.exists() else {}


def name_of(case: int, family: str, mesh: str) -> str:
    return f"case {case}, {family}, mesh {mesh}"


def settled(runs: dict[str, Any], case: int, quantity: str) -> tuple[Any, Any]:
    """Estimate from the families of `SETTLING`, and its error bar.

    The answer is the mean of their limits (`extrapolated`) weighted by their bars.  Its
    bar is never less than the distance to the further of the limits: what they differ
    by, their extrapolation has not explained.

    Returns
    -------
    value, bar : (s,) arrays, um
    """
    limit, bars = extrapolated(runs, case, quantity, SETTLING)
    weight = 1 / bars[:, None] ** 2
    value = (weight * limit).sum(axis=0) / weight.sum()
    apart = np.abs(limit - value).max(axis=0)
    return value, np.maximum(apart, 1 / np.sqrt(weight.sum()))


def extrapolated(
    runs: dict[str, Any], case: int, quantity: str, families: Sequence[str] = FAMILIES
) -> tuple[Any, Any]:
    """Limits of k families, each from its own meshes, and their error bars.

    Each is extrapolated as an error of order p in h = unknowns^(-1/3), with the p of
    `ORDERS` that the last three meshes show, or the lowest where there are but two
    (Richardson's extrapolation for uneven refinement; Roache 1994, J. Fluids Eng. 116,
    405).  At the edges the elements' size falls faster than h: a careful measure.  Its
    own bar is the extrapolation or half of the last change, whichever is larger on the
    path.

    Returns
    -------
    limits : (k, s) array, um
    bars : (k,) array, um
    """
    limits, bars = [], []
    for family in families:
        done = [
            runs[name_of(case, family, mesh)] for mesh in solved(runs, case, family)
        ]
        curves = [np.array(run[quantity]) for run in done]
        sizes = np.array([run["unknowns"] for run in done]) ** (-1 / 3)
        change = curves[-1] - curves[-2]
        largest = np.abs(change).max()
        order = ORDERS[0]
        if len(curves) > 2:
            before = np.abs(curves[-2] - curves[-3]).max()
            order = observed(sizes[-3:], before / max(largest, 1e-12))
        left = 1 / ((sizes[-2] / sizes[-1]) ** order - 1)
        limits.append(curves[-1] + left * change)
        bars.append(largest * max(left, 0.5))
    return np.array(limits), np.array(bars)


def observed(sizes: Any, ratio: float) -> float:
    """Order in three element sizes that makes the first change `ratio` of the second.

    The nearest of `ORDERS` where there is none between them.
    """
    first, middle, last = sizes

    def lack(order: float) -> float:
        powers = first**order, middle**order, last**order
        found: float = (powers[0] - powers[1]) / (powers[1] - powers[2]) - ratio
        return found

    if lack(ORDERS[0]) >= 0:
        return ORDERS[0]
    if lack(ORDERS[1]) <= 0:
        return ORDERS[1]
    return float(brentq(lack, *ORDERS))


def solved(runs: dict[str, Any], case: int, family: str) -> list[str]:
    """Meshes on which a family is there."""
    names = [level.name for level in MESHES]
    return [mesh for mesh in names if name_of(case, family, mesh) in runs]


WHERE = (
    "## Where the tip's error is made",
    "",
    "The tip turns about edges: those of the cavity, and those of the clamp, where the "
    "stress is singular and every mesh is too stiff or too soft a hinge. Elements that "
    "grow from the balloon all the way to the clamp meet its edges with one as long as "
    "the strip is thick: however fine the mesh is elsewhere, the tip then settles too "
    "high, and inflation does not notice (last line). Elements that are graded towards "
    "both ends cure it for one more. `python -m docs.refine one` changes one thing at "
    "a time from mesh 2, case 1:",
    "",
)


def page(runs: dict[str, Any]) -> str:
    """The document."""
    lines = [
        "# The converged answer",
        "",
        "The published device S1, contract law, by three element families on meshes "
        "that are refined together (`docs/refine.py`): the product's mixed element, "
        "the change of volume projected in each element; Taylor-Hood elements of the "
        "same nodes, with a pressure that is continuous in each layer, assembled and "
        "solved by other code (`docs/taylor_hood.py`); and the product's element "
        "without projection. All must converge to the same answer. The settled value "
        "is the mean of the first two, each extrapolated from its last meshes by the "
        "order in the size of the elements that they show (1 to 2), weighted by how "
        "far that is; the error bar is at least the distance to the further one. The "
        "third locks, converges slowly, and settles nothing: where it is extrapolated "
        "to is given as a gap from the first, beside its own error bar. None of them "
        "bounds the answer: the settled value is an estimate, not a bracket. The "
        "first two leave the same small share of the volumetric energy unprojected "
        "(2 %), without which single points of either collapse at the edges; the "
        "third leaves all of it.",
        "",
        *reached(runs),
        *WHERE,
        *shares(runs),
        "",
        "Written by `make refinement` (case 1 further: `CASES=1 MESHES=4`) from "
        "`docs/refinement.json`. All in um.",
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
                about = [family, level.name, str(found["unknowns"])]
                lines.append(f"| {' | '.join([*about, *cells])} |")
            if all(len(solved(runs, case, family)) >= 2 for family in FAMILIES):
                limits, bars = extrapolated(runs, case, quantity)
                for k, family in enumerate(FAMILIES[1:], 1):
                    gaps = [f"{gap:+.2f}" for gap in limits[k] - limits[0]]
                    said = f"gap of {family}, extrapolated (± {bars[k]:.2f})"
                    lines.append(f"| {said} | | | {' | '.join(gaps)} |")
                value, bar = settled(runs, case, quantity)
                cells = [f"{v:.2f} ± {b:.2f}" for v, b in zip(value, bar, strict=True)]
                lines.append(f"| **settled** | | | {' | '.join(cells)} |")
    return "\n".join(lines + turning(runs)) + "\n"


def reached(runs: dict[str, Any]) -> list[str]:
    """How well the four cases are known, in words."""
    worst = dict.fromkeys(QUANTITIES.values(), 0.0)
    for case in (1, 2, 3, 4):
        if any(len(solved(runs, case, family)) < 2 for family in SETTLING):
            return []
        for quantity in worst:
            value, bar = settled(runs, case, quantity)
            scale = np.abs(value).max() / 100 if quantity == "inflation" else 1.0
            worst[quantity] = max(worst[quantity], bar.max() / scale)
    tip, inflation = (apart(runs, quantity) for quantity in worst)
    return [
        f"The largest bars: tip {worst['tip']:.2f} um, inflation "
        f"{worst['inflation']:.2f} % of its largest value. Sought were 0.5 um and "
        f"0.1 %. On their finest meshes the first two families differ by at most "
        f"{tip:.2f} um in tip and {inflation:.2f} um in inflation.",
        "",
    ]


def apart(runs: dict[str, Any], quantity: str) -> float:
    """Largest difference of the families of `SETTLING` on their finest meshes, um."""
    one, other = (
        [
            runs[name_of(case, family, solved(runs, case, family)[-1])][quantity]
            for case in (1, 2, 3, 4)
        ]
        for family in SETTLING
    )
    return float(np.abs(np.array(one) - np.array(other)).max())


ONE: dict[str, dict[str, Any]] = {
    "elements along the balloon": {"balloon_x": 12},
    "across the balloon": {"balloon_y": 8},
    "from the clamp to the balloon": {"root": 10},
    "from the balloon to the tip": {"tip": 6},
    "across the rim": {"rim": 7},
    "through each membrane": {"membrane": 4},
    "through the spacer": {"spacer": 3},
    "half the size at the balloon's ends": {"edge_x": 0.17},
    "half the size at its sides": {"edge_y": 0.17},
    "half the size at the clamp": {"edge_root": 0.17},
    "no grading at the clamp": {"edge_root": 0.0},
}
"""Changes of mesh 2, one at a time."""


def one_at_a_time() -> None:
    """Change one thing of mesh 2 at a time, case 1, mixed elements."""
    runs = known()
    for words, change in ONE.items():
        name = f"one: {words}"
        if name not in runs:
            print(name, flush=True)
            runs[name] = run(1, "mixed", replace(MESHES[1], **change))
            write_text(RUNS, json.dumps(runs, indent=1) + "\n")
    PAGE.write_text(page(runs))


def shares(runs: dict[str, Any]) -> list[str]:
    """Table of what one change of mesh 2 does."""
    whole = runs.get(name_of(1, "mixed", "2"))
    done = [words for words in ONE if f"one: {words}" in runs]
    if whole is None or not done:
        return []
    lines = [
        "| change | unknowns | tip at 60 kPa, um | inflation at 60 kPa, um |",
        "| --- | --- | --- | --- |",
    ]
    for words in done:
        found = runs[f"one: {words}"]
        tip, inflation = (found[q][-1] - whole[q][-1] for q in QUANTITIES.values())
        lines.append(
            f"| {words} | {found['unknowns']} | {tip:+.2f} | {inflation:+.2f} |"
        )
    return [*lines, ""]


TURNING = (1, 2, 4)
"""Cases whose paths turn below `FAR`."""

FAR = 400e3
"""Pa; past every limit point of the published device."""


def limits() -> None:
    """Limit pressures of the published device on the first two meshes, kPa."""
    runs = known()
    for level in MESHES[:2]:
        for case in TURNING:
            for family, share in SHARES.items():
                name = f"limit, {name_of(case, family, level.name)}"
                if name in runs:
                    continue
                print(name, flush=True)
                problem = baseline(named_device("S1", case), level)
                problem = replace(problem, local_share=share)
                found = solve(problem, Path(np.array([FAR])))
                if found.path_status != ("limit_point",):
                    raise SystemExit(f"{name}: {found.message}")
                limit = float(found.limit_pressure[0]) / 1e3
                runs[name] = {"limit": round(limit, 3)}
                write_text(RUNS, json.dumps(runs, indent=1) + "\n")
    PAGE.write_text(page(runs))


def turning(runs: dict[str, Any]) -> list[str]:
    """Table of limit pressures."""
    meshes = [level.name for level in MESHES[:2]]
    heads = [f"{family}, mesh {mesh}" for family in SHARES for mesh in meshes]
    rows = []
    for case in TURNING:
        names = [name_of(case, f, mesh) for f in SHARES for mesh in meshes]
        if all(f"limit, {name}" in runs for name in names):
            cells = [f"{runs[f'limit, {name}']['limit']:.2f}" for name in names]
            rows.append(f"| {case} | {' | '.join(cells)} |")
    if not rows:
        return []
    return [
        "",
        "## Limit pressures, kPa",
        "",
        f"| case | {' | '.join(heads)} |",
        "| --- " * (len(heads) + 1) + "|",
        *rows,
    ]


def main(cases: str = "1,2,3,4", meshes: str = "3") -> None:
    """Run what is missing, one after the other, and write the page."""
    runs = known()
    for level in MESHES[: int(meshes)]:
        families = SETTLING if level is MESHES[-1] else FAMILIES
        for case in map(int, cases.split(",")):
            for family in families:
                name = name_of(case, family, level.name)
                if name not in runs:
                    print(name, flush=True)
                    runs[name] = run(case, family, level)
                    runs = known() | runs
                    write_text(RUNS, json.dumps(runs, indent=1) + "\n")
                    PAGE.write_text(page(runs))
    PAGE.write_text(page(runs))


if __name__ == "__main__":
    if sys.argv[1:] == ["one"]:
        one_at_a_time()
    elif sys.argv[1:] == ["limits"]:
        limits()
    else:
        main(*sys.argv[1:])
