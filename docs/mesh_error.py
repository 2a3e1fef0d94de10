"""Calibrate the bounds of the discretisation error, and write down how they do.

Run by ``make mesh-error [PATHS=100] [WORKERS=2]``.  Designs are drawn from the default
design space, and each is solved on every mesh, up to nine tenths of where its draft
path ends and then past its limit point (`mesh_error_cases`).  From what is there come
datagen/mesh_error.json and docs/mesh-error.md; PATHS=0 writes them without solving.
"""

from __future__ import annotations

import json
import math
import re
import sys
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np
from scipy.stats import t as student

from datagen.atomic import write_text
from datagen.levels import COARSER, LEVELS
from datagen.mesh_error import FACTORS, Factors, calibrated_meshes, factors
from datagen.response import OUTPUT_NAMES

from .mesh_error_cases import (
    DIVIDED,
    MESHES,
    PUBLISHED,
    TRUTH,
    Cases,
    collect,
    solve_all,
    stand_in_errors,
)
from .refine import PRESSURES, QUANTITIES, settled
from .refine import RUNS as SETTLED

Array = np.ndarray

PAGE = FilePath(__file__).with_name("mesh-error.md")

CALIBRATED = ("draft", "standard")

WANTED = 0.95
"""Probability that a bound holds at all load steps; more than the 90 % promised."""

FLOORS = (1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 1e-1, 2e-1, 5e-1)
"""Of c in the estimate, to choose from."""

INFLATION = OUTPUT_NAMES.index("inflation")

WORST = 6
"""Designs that are shown by themselves."""

ENOUGH = 19
"""Designs from which the conformal quantile of 95 % is no larger than all scores."""

PARTS = 10
"""In which the designs are split: each part is checked with factors of the others."""

FINE_FACTOR = 1.0
FINE_FLOORS = {"tip_deflection": 1e-3, "bending_angle": 1e-3}
FINE_FLOOR = 5e-3
"""k and c of the fine mesh, which there is nothing finer to calibrate against.

If every refinement divides the error by two or more, what is left on the fine mesh is
at most its distance from the standard one; c is as large as S1 needs where the answer
is settled, and `FINE_FLOOR` but for some outputs.
"""


def quantile(scores: Array) -> Array:
    """Bound of a new score, with probability 95 %, along the first axis.

    The conformal quantile, the ceil((n + 1) 0.95)-th smallest.  With fewer scores than
    that takes, the larger one of the largest score and Student's prediction bound for
    one more normal variate, of the logarithms: exp(m + t s sqrt(1 + 1/n)).
    """
    count = len(scores)
    rank = min(math.ceil((count + 1) * WANTED), count)
    found: Array = np.sort(scores, axis=0)[rank - 1]
    if 1 < count < ENOUGH:
        logs = np.log(scores)
        reach = student.ppf(WANTED, count - 1) * math.sqrt(1 + 1 / count)
        found = np.maximum(found, np.exp(logs.mean(0) + reach * logs.std(0, ddof=1)))
    return found


@dataclass(frozen=True)
class Calibration:
    """Factors, and from how many designs with a limit point theirs came."""

    factors: Factors
    turned: int


def calibrate(cases: Cases, level: str, published: Cases) -> Calibration:
    """k and c of one level.

    Of all floors the one is taken whose scores vary least over designs, relative to
    their mean: with the tightest bound instead, c would be chosen to fit the largest
    scores, and too few new designs would be within.  k is never less than what the
    published device needs, which is no random design.  For the limit pressure c is
    `FINE_FLOOR`, and k never less than 1: two meshes may agree by accident.
    """
    outputs = range(len(OUTPUT_NAMES))
    scores, needed, seen = [], [], []
    for c in FLOORS:
        floors = np.full(len(OUTPUT_NAMES), c)
        ratio = cases.errors(level) / cases.brackets(level, floors)
        scores.append(ratio.max(axis=1))
        own = np.zeros((0, len(OUTPUT_NAMES)))
        if len(published):
            ratio = published.errors(level) / published.brackets(level, floors)
            own = ratio.max(axis=1)
        seen.append(np.concatenate([scores[-1], own]))
        k = quantile(scores[-1] if len(cases) >= ENOUGH else seen[-1])
        needed.append(np.maximum(k, own.max(axis=0, initial=0.0)))
    best = most_even(np.stack(seen))
    factor = np.stack(needed)[best, outputs]
    floor = np.array(FLOORS)[best]

    turned = cases.some(np.isfinite([cases.limit[m.name] for m in MESHES]).all(axis=0))
    if not len(turned):
        return Calibration(Factors(factor, floor, 1.0, FINE_FLOOR), 0)
    errors = turned.limit_errors(level)
    ratios = errors / turned.limit_brackets(level, FINE_FLOOR)
    limit = max(float(quantile(ratios)), 1.0)
    return Calibration(Factors(factor, floor, limit, FINE_FLOOR), len(turned))


def most_even(scores: Array) -> Array:
    """Which floor, the first axis, has the smallest coefficient of variation."""
    found: Array = np.argmin(scores.std(axis=1) / scores.mean(axis=1), axis=0)
    return found


def check(cases: Cases, level: str, published: Cases) -> dict[str, Array]:
    """Errors, bounds and coverage, each part calibrated on the others.

    Returns
    -------
    dict of (m + 1,) arrays, the limit pressure last: ``error`` and ``bound`` in
    percent of the path's maximum (median), ``paths``, ``steps`` and ``alone`` shares
    that the bound holds: of paths at every load step, of load steps, and of load steps
    asked for alone.
    """
    parts = np.arange(len(cases)) % PARTS
    outputs, limits = [], []
    for part in np.unique(parts):
        own = calibrate(cases.some(parts != part), level, published).factors
        tested = cases.some(parts == part)
        bounds = (
            own.factor * tested.brackets(level, own.floor, alone=alone)
            for alone in (False, True)
        )
        percent = 100 / tested.scale[:, None]
        outputs.append(percent * np.stack([tested.errors(level), *bounds]))
        bound = own.limit_factor * tested.limit_brackets(level, own.limit_floor)
        both = np.stack([tested.limit_errors(level), bound, bound])
        limits.append(100 * both / tested.limit[TRUTH])
    error, bound, alone = np.concatenate(outputs, axis=1)
    limit_error, limit_bound, _ = known = np.concatenate(limits, axis=1)
    turned = np.isfinite(known).all(axis=0)
    held = [np.mean((limit_error <= limit_bound)[turned])]
    return {
        "error": np.append(
            np.median(error, axis=(0, 1)), np.median(limit_error[turned])
        ),
        "bound": np.append(
            np.median(bound, axis=(0, 1)), np.median(limit_bound[turned])
        ),
        "paths": np.append((error <= bound).all(axis=1).mean(axis=0), held),
        "steps": np.append((error <= bound).mean(axis=(0, 1)), held),
        "alone": np.append((error <= alone).mean(axis=(0, 1)), held),
    }


def write_factors(cases: Cases, published: Cases) -> None:
    """Write datagen/mesh_error.json."""
    found = {name: calibrate(cases, name, published) for name in CALIBRATED}
    same = np.ones(len(OUTPUT_NAMES))
    floors = np.array([FINE_FLOORS.get(name, FINE_FLOOR) for name in OUTPUT_NAMES])
    fine = Factors(FINE_FACTOR * same, floors, FINE_FACTOR, FINE_FLOOR)
    levels = {}
    for level in LEVELS:
        one = found[level].factors if level in found else fine
        mesh, coarser = calibrated_meshes(level)
        pairs = zip(one.factor, one.floor, strict=True)
        levels[level] = {
            "mesh": mesh,
            "coarser": coarser,
            "outputs": {
                name: [float(f"{k:.4g}"), c]
                for name, (k, c) in zip(OUTPUT_NAMES, pairs, strict=True)
            },
            "limit_pressure": [float(f"{one.limit_factor:.4g}"), one.limit_floor],
        }
    content = {
        "command": "make mesh-error",
        "designs": len(cases),
        "designs_with_limit_point": found["standard"].turned,
        "levels": levels,
    }
    text = json.dumps(content, indent=1)
    flat = re.sub(r"\[[^\[\]]+\]", lambda m: "".join(m[0].split()), text)
    write_text(FACTORS, flat.replace(",", ", ").replace(", \n", ",\n") + "\n")


def table(head: list[str], rows: list[list[str]]) -> list[str]:
    """Lines of a markdown table."""
    return [f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *rows)]


def page(cases: Cases, published: Cases, divided: Cases, left_out: list[str]) -> str:
    """The document."""
    content = json.loads(FACTORS.read_text())
    turned = content["designs_with_limit_point"]
    lines = [
        "# Bounds of the discretisation error",
        "",
        "Every answer of the finite elements has a `mesh_error` beside each value: a "
        "bound of its distance from the fine mesh's. It is made by solving the path "
        "again on a coarser mesh, see `datagen/mesh_error.py`:",
        "",
        "    e(s) = k (max over steps up to s of |v - w|  +  c S)",
        "",
        "v is the answer, w that of the coarser mesh, S the largest |w| on the coarser "
        "path up to s; of tip and angle, whose two bendings may cancel, inflation of "
        "both sides times the number of balloons, once more along the strip (the angle "
        "over the length). k and c are calibrated for the meshes draft and standard "
        f"on {len(cases)} designs drawn from the default design space, {turned} of "
        "them with a limit point below 150 kPa, as the conformal quantile of 95 % over "
        "designs (with fewer than 19 Student's prediction bound, S1 counted, of its "
        "logarithm) of the largest ratio of error and bracket on a path; k is never "
        "less than what S1 needs, up to 60 kPa, in its four material cases. "
        + (
            "At a new design of that space the bound then holds at all load steps "
            f"with a probability of {WANTED:.0%}."
            if len(cases) >= ENOUGH
            else f"**Provisional:** with fewer than {ENOUGH} designs the {WANTED:.0%} "
            "that this aims at is a hope, not a measurement."
        ),
        "",
        "What that does not cover: pressures above nine tenths of a limit point, "
        "effects, designs outside the default space, and the error of the fine mesh "
        "itself. From a limit point on there is no bound; where the coarser path ends "
        "before the answer's, all that changes from there on counts as error.",
        "",
        "Written by `make mesh-error`.",
        "",
        "## How it does",
        "",
        f"Each of {min(PARTS, len(cases))} parts of the designs is checked with "
        "factors calibrated on the others. "
        "Errors and bounds in percent of the path's largest amount of that output, "
        "medians over designs and load steps. The bound holds on so many paths at all "
        "load steps; at so many load steps; and at so many as if each had been asked "
        "for alone.",
        "",
    ]
    names = [*(f"`{name}`" for name in OUTPUT_NAMES), "limit pressure"]
    rows = []
    for level in CALIBRATED:
        found = check(cases, level, published)
        entry = content["levels"][level]
        pairs = [*entry["outputs"].values(), entry["limit_pressure"]]
        for i, name in enumerate(names):
            rows.append(
                [
                    level,
                    name,
                    f"{found['error'][i]:.2g}",
                    f"{found['bound'][i]:.2g}",
                    *(f"{found[key][i]:.0%}" for key in ("paths", "steps", "alone")),
                    *(f"{number:g}" for number in pairs[i]),
                ]
            )
    head = ["mesh", "output", "error %", "bound %", "paths", "steps", "alone", "k", "c"]
    lines += [*table(head, rows), "", "## Where the tip is missed most", ""]
    lines += [*worst_section(cases), "", "## What it costs", ""]
    rows = []
    for level, other in COARSER.items():
        here, more = cases.seconds[level], cases.seconds[other.name]
        share = np.median(more / here)
        rows.append([level, other.name, f"{np.median(here):.1f}", f"{share:.0%}"])
    head = ["mesh", "compared with", "path, s", "bound, share of it"]
    lines += [*table(head, rows), "", "Medians, on a shared core.", ""]
    lines += ["## The published device", "", *published_section(published), ""]
    lines += ["## Named divided devices", "", *divided_section(divided), ""]
    lines += ["## The fine mesh", "", *fine_section(cases, published), ""]
    lines += ["## Left out", ""]
    lines += [f"- {words}" for words in left_out] or ["No design was left out."]
    return "\n".join(lines) + "\n"


def worst_section(cases: Cases) -> list[str]:
    """The designs whose tip is furthest from the fine mesh's."""
    tip = OUTPUT_NAMES.index("tip_deflection")
    error = {
        level: 100 * cases.errors(level)[..., tip].max(axis=1) / cases.scale[:, tip]
        for level in CALIBRATED
    }
    middle = {level: float(np.median(one)) for level, one in error.items()}
    rows = []
    for i in np.argsort(-error["standard"])[:WORST]:
        one = cases.designs[i]
        a, b = (1e3 * side for side in one.balloon_size)
        layers = 1e6 * one.upper_thickness, 1e6 * one.lower_thickness
        rows.append(
            [
                f"{one.divisions_x} x {one.divisions_y}",
                f"{a:.2f} x {b:.2f}",
                " / ".join(f"{h:.0f}" for h in layers),
                *(f"{1e6 * cases.scale[i, k]:.0f}" for k in (tip, INFLATION)),
                *(f"{error[level][i]:.1f}" for level in CALIBRATED),
            ]
        )
    head = ["balloons", "each, mm", "layers, um", "tip, um", "inflation, um"]
    head += [f"{level}, %" for level in CALIBRATED]
    words = (
        "Largest error of the tip on the path, in percent of its largest amount there. "
        f"Median over designs: {middle['draft']:.1f} % on the draft mesh, "
        f"{middle['standard']:.1f} % on the standard one."
    )
    return [words, "", *table(head, rows)]


def published_section(published: Cases) -> list[str]:
    """How far each mesh is from the settled answer."""
    if len(published) < len(PUBLISHED):
        return ["S1 is not solved yet; there the answer is settled."]
    runs = json.loads(SETTLED.read_text())
    rows = []
    for row, case in enumerate(PUBLISHED.values()):
        for quantity, short in QUANTITIES.items():
            value, bar = settled(runs, case, short)
            percent = 100 / np.abs(value).max()
            i = OUTPUT_NAMES.index(quantity)
            off = [
                np.abs(1e6 * published.values[level][row, :, i] - value).max()
                for level in LEVELS
            ]
            shown = [f"{percent * one:.2f}" for one in (*off, bar.max())]
            rows.append([f"S1 case {case}", short, *shown])
    words = (
        "Largest distance from the converged answer ([refinement.md](refinement.md)), "
        f"{PRESSURES[0]:g} to {PRESSURES[-1]:g} kPa, in percent of the largest amount; "
        "last the error bar of the converged answer itself."
    )
    head = ["device", "output", *(f"{level}, %" for level in LEVELS), "its bar, %"]
    return [words, "", *table(head, rows)]


def divided_section(divided: Cases) -> list[str]:
    """How far draft and standard are from the fine mesh on devices people ask for."""
    if len(divided) < len(DIVIDED):
        return ["Not all of them are solved, see the end."]
    bounds = {}
    for level in CALIBRATED:
        one = factors(level)
        bounds[level] = one.factor * divided.brackets(level, one.floor)
    rows = []
    for row, (name, case) in enumerate(DIVIDED.values()):
        for quantity, short in QUANTITIES.items():
            i = OUTPUT_NAMES.index(quantity)
            cells = [f"{name} case {case}", short]
            for level in CALIBRATED:
                error = divided.errors(level)[row, :, i]
                percent = 100 / divided.scale[row, i]
                cells.append(f"{percent * error.max():.1f}")
                held = np.mean(error <= bounds[level][row, :, i])
                cells.append(f"{percent * bounds[level][row, :, i].max():.1f}")
                cells.append(f"{held:.0%}")
            rows.append(cells)
    head = ["device", "output"]
    for level in CALIBRATED:
        head += [f"{level}, %", "its bound, %", "held"]
    words = (
        "Largest distance from the fine mesh, "
        f"{PRESSURES[0]:g} to {PRESSURES[-1]:g} kPa, in percent of the largest amount, "
        "the largest bound, and at how many of the load steps it holds: factors are "
        "calibrated on random designs, and the bound is of 95 % of them. Balloons of "
        "these devices are longer than most: the standard mesh has "
        f"{LEVELS['standard'].along(2)} elements along half of one of two, and "
        f"{LEVELS['standard'].along(1)} where there is one alone."
    )
    return [words, "", *table(head, rows)]


def fine_section(cases: Cases, published: Cases) -> list[str]:
    """Why its k is one, and how it does where the answer is settled."""
    steps = [
        float(np.median(cases.errors(a)[:, -1] / cases.errors(b)[:, -1]))
        for a, b in (("draft", "sketch"), ("standard", "sketch"))
    ]
    lines = [
        "There is no finer mesh to calibrate it against on many designs: k is 1, and "
        f"c is {FINE_FLOOR:g}, for tip and angle {FINE_FLOORS['tip_deflection']:g}. "
        "Its bound is thus at least the whole distance from the standard "
        "mesh, and holds where the last refinement has taken away at least half of the "
        f"error. The median error of draft is {steps[0]:.2g} times that of the sketch "
        f"mesh at the last load step, and that of standard {steps[1]:.2g} times.",
    ]
    if (count := int(cases.stand_ins.sum())) and len(both := stand_in_errors()):
        lines += [
            "",
            f"On {count} of the designs the fine mesh of generator 5, with two "
            "elements across a wall in place of four, still stands in for the fine "
            f"mesh. Where both were solved, on {len(both)} designs, their tips differ "
            f"by {100 * np.median(both):.1f} % (median of the worst load step) and at "
            f"most {100 * both.max():.1f} %.",
        ]
    if len(published) < len(PUBLISHED):
        return [*lines, "", "S1 is not solved yet; there the answer is settled."]
    settled_runs = json.loads(SETTLED.read_text())
    one, rows = factors("fine"), []
    bounds = 1e6 * one.factor * published.brackets("fine", one.floor)
    for row, case in enumerate(PUBLISHED.values()):
        for quantity, short in QUANTITIES.items():
            value, bar = settled(settled_runs, case, short)
            i = OUTPUT_NAMES.index(quantity)
            bound = bounds[row, :, i]
            error = np.abs(1e6 * published.values["fine"][row, :, i] - value)
            rows.append(
                [
                    f"S1 case {case}",
                    short,
                    f"{error.max():.2f}",
                    f"{bar.max():.2f}",
                    f"{bound.max():.2f}",
                    f"{np.mean(error <= bound):.0%}",
                    f"{np.mean(error <= bound + bar):.0%}",
                ]
            )
    head = [
        "device",
        "output",
        "error, um",
        "its bar, um",
        "bound, um",
        "held",
        "within the bar",
    ]
    words = (
        "Against the converged answer of the published device ([refinement.md]"
        "(refinement.md)), largest on the path. The converged answer has an error bar "
        "of its own; the last column allows for it:"
    )
    return [*lines, "", words, "", *table(head, rows)]


def main(paths: str = "100", workers: str = "2") -> None:
    """Solve what is missing; with 0 paths only calibrate and write."""
    solve_all(int(paths), int(workers))
    cases, left_out = collect()
    if len(cases) < 3:
        raise SystemExit(f"{len(cases)} designs are too few: make mesh-error PATHS=100")
    published, _ = collect(PUBLISHED)
    write_factors(cases, published)
    divided, more = collect(DIVIDED)
    PAGE.write_text(page(cases, published, divided, left_out + more))


if __name__ == "__main__":
    main(*sys.argv[1:])
