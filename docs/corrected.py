"""How near the surrogate with effects in it comes: docs/corrected-accuracy.md.

Run by ``make corrected [MINUTES=10] [ONLY="bond_edge mooney"]``.  Each is learned from
the shipped model as `pba models train` does, around parameters as a fit of a few
devices leaves them.  A run that was stopped goes on; what is done waits in
docs/corrected.json, and the page is written from it.
"""

from __future__ import annotations

import json
import shutil
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from datagen.atomic import write_text
from datagen.dataset import Dataset
from datagen.effects import catalogue
from surrogate.accuracy import accuracy
from surrogate.corrected import Corrected
from surrogate.ensemble import REFERENCE, Ensemble, reference_model
from surrogate.increment import stated_range
from surrogate.learn import INCREMENT, learn

HERE = Path(__file__).parent
PAGE, FOUND = HERE / "corrected-accuracy.md", HERE / "corrected.json"
RUNS = HERE.parent / "runs" / "corrected"

WORKERS = 2

FITTED = {
    "bond_edge.growth": (40e-6, 8e-6),
    "clamp_compliance.compliance": (3e-8, 5e-9),
    "cure_mismatch.difference": (-0.006, 0.001),
    "modulus_bias.common": (0.9, 0.04),
    "modulus_bias.ratio": (1.1, 0.04),
    "mooney.second": (0.1, 0.02),
}
"""Value and standard deviation, SI, around which each parameter is learned."""

CASES: tuple[tuple[str, ...], ...] = (
    ("bond_edge",),
    ("cure_mismatch",),
    ("modulus_bias",),
    ("bond_edge", "cure_mismatch"),
    ("mooney",),
    ("clamp_compliance",),
)

BARS = {"tip_deflection_mm": 1.0, "bending_angle_deg": 1.0, "inflation_mm": 0.5}
"""Sought: median error, % of a path's largest magnitude."""

COVERED = (85, 95)
"""Sought: points inside their 90 % interval, %."""


def ranges_of(effects: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    """Stated range of every parameter of some effects, SI."""
    known = catalogue()
    return {
        f"{effect}.{parameter.name}": stated_range(
            parameter, *FITTED[f"{effect}.{parameter.name}"]
        )
        for effect in effects
        for parameter in known[effect].parameters
    }


def measure(
    base: Ensemble, dataset: Dataset, effects: tuple[str, ...], minutes: float
) -> dict[str, Any]:
    """Learn one case from the base, and what its held-out paths say of it."""
    name = " ".join(effects)
    folder = RUNS / base.version / f"{name.replace(' ', '+')}-{minutes:g}"
    folder.parent.mkdir(parents=True, exist_ok=True)
    clock = folder.with_name(f"{folder.name}.seconds")  # of all runs that it took
    before = float(clock.read_text()) if clock.exists() else 0.0
    began, ranges = time.perf_counter(), ranges_of(effects)

    def spent() -> float:
        return before + time.perf_counter() - began

    def report(stage: str, done: int, total: int, left: float | None) -> None:
        del left
        write_text(clock, f"{spent():.1f}\n")
        if stage == "increment":
            print(f"{name}: path {done} of {total}", flush=True)

    model: Corrected = learn(
        base,
        dataset,
        effects,
        ranges,
        folder,
        minutes=minutes,
        workers=WORKERS,
        resume=True,
        report=report,
    )
    minutes_spent = round(spent() / 60, 1)
    told = model.description
    increment = Dataset.read(folder / INCREMENT)
    assert increment.base_row is not None  # learned just now
    alone = accuracy(base, dataset.subset(increment.base_row)).to_json()
    whole = told["accuracy"]
    for one in (whole, alone):  # the page needs none of it
        del one["regions"]
    shutil.rmtree(folder)
    clock.unlink(missing_ok=True)
    return {
        "base": base.version,
        "minutes": minutes,
        "spent_minutes": minutes_spent,
        "ranges": ranges,
        "n_train": told["n_train"],
        "alone": alone,
        "accuracy": whole,
        "change": told["change"],
    }


def known() -> dict[str, Any]:
    """What is done, by the names of the effects."""
    found: dict[str, Any] = json.loads(FOUND.read_text()) if FOUND.exists() else {}
    return found


def page(found: dict[str, Any]) -> str:
    """The document."""
    rows = [_row(name, one) for name, one in found.items()]
    heads = ["effects", "paths: learned, held out", *map(_plain, BARS)]
    heads += ["inside 90 %", "minutes"]
    return "\n".join(
        [
            "# How near the surrogate with effects comes",
            "",
            "The shipped model with one effect or two in it, learned with "
            f"`--minutes {_minutes(found)}` on {WORKERS} worker processes, over the "
            "ranges below. Errors against the finite elements, on designs that neither "
            "the base nor the increment has seen: median, in percent of each path's "
            "largest magnitude. First the whole answer with the effects on, then what "
            "the effects change alone; in brackets the base itself on the same designs "
            "without effects.",
            "",
            f"Sought: {_sought()}, {COVERED[0]} to {COVERED[1]} % of the points inside "
            "their 90 % interval, 10 minutes.",
            "",
            f"| {' | '.join(heads)} |",
            "| --- " * len(heads) + "|",
            *rows,
            "",
            _together(found),
            "",
            "Ranges, SI:",
            "",
            *(
                f"- `{name}`: {low:.3g} to {high:.3g}"
                for name, (low, high) in sorted(_ranges(found).items())
            ),
            "",
            f"Base: model {_bases(found)}. Written by `make corrected` from "
            "`docs/corrected.json`.",
            "",
        ]
    )


def _row(name: str, one: dict[str, Any]) -> str:
    """One line of the table."""
    told = one["accuracy"]
    cells = [f"`{name}`", f"{one['n_train']}, {told['n_test']}"]
    for output in BARS:
        whole, alone = (
            one[kind]["outputs"][output]["median_pct"] for kind in ("accuracy", "alone")
        )
        change = one["change"][output.rsplit("_", 1)[0]]["median_pct"]
        cells.append(f"{whole:.2f}, {change:.2f} ({alone:.2f})")
    inside, alone = (100 * one[k]["coverage"]["90"] for k in ("accuracy", "alone"))
    cells += [f"{inside:.1f} ({alone:.1f})", f"{one['spent_minutes']:g}"]
    return f"| {' | '.join(cells)} |"


def _together(found: dict[str, Any]) -> str:
    """Coverage over all cases: that of one rests on ten paths."""
    tests = [one["accuracy"]["n_test"] for one in found.values()]
    inside = [
        np.average(
            [100 * one[kind]["coverage"]["90"] for one in found.values()], weights=tests
        )
        for kind in ("accuracy", "alone")
    ]
    return (
        f"Over all {sum(tests)} held-out paths {inside[0]:.1f} % of the points are "
        f"inside, with the base alone, on the same designs without effects, "
        f"{inside[1]:.1f} %."
    )


def _bases(found: dict[str, Any]) -> str:
    return ", ".join(sorted({f"`{one['base']}`" for one in found.values()}))


def _plain(output: str) -> str:
    """An output's name without its unit."""
    return output.rsplit("_", 1)[0].replace("_", " ")


def _minutes(found: dict[str, Any]) -> str:
    return ", ".join(sorted({f"{one['minutes']:g}" for one in found.values()}))


def _ranges(found: dict[str, Any]) -> dict[str, list[float]]:
    return {k: v for one in found.values() for k, v in one["ranges"].items()}


def _sought() -> str:
    return ", ".join(f"{_plain(output)} {bar:g} %" for output, bar in BARS.items())


def main(minutes: str = "10", *only: str) -> None:
    """Learn what is missing, one after the other, and write the page."""
    base, dataset = reference_model(), Dataset.read(REFERENCE / "dataset.h5")
    chosen = [one for one in CASES if not only or "+".join(one) in only]
    if only and len(chosen) < len(only):
        raise SystemExit(f"allowed: {', '.join('+'.join(one) for one in CASES)}")
    for effects in chosen:
        name = " ".join(effects)
        done = known().get(name, {})
        if (done.get("base"), done.get("minutes")) != (base.version, float(minutes)):
            found = known() | {name: measure(base, dataset, effects, float(minutes))}
            write_text(FOUND, json.dumps(found, indent=1) + "\n")
            write_text(PAGE, page(found))
    write_text(PAGE, page(known()))


if __name__ == "__main__":
    main(*sys.argv[1:])
