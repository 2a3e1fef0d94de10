"""Does the ranking find what was planted?  Thousands of trials without new solves.

Run by ``make recovery [SEEDS=20]``: the devices of `tests.recovery.trial` are solved
with every effect (kept: an interrupted run goes on), then readings are made and ranked.
Trials wait in runs/recovery.jsonl; docs/recovery.md is written from them.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from datagen.effects import catalogue
from discrepancy.answer import parameters_of
from discrepancy.rank import Ranking
from discrepancy.solves import Progress, Solver
from tests.recovery.trial import (
    Lab,
    rank,
    readings_of,
    size_for,
    uncertainty,
    unnamed_changes,
)

HERE = Path(__file__).parent
PAGE = HERE / "recovery.md"
RUNS = HERE.parent / "runs"
TRIALS = RUNS / "recovery.jsonl"

SIZES = (3.0, 6.0, 12.0)
"""Largest change of a reading by the planted effect, over the whole uncertainty."""

NOISES = (1e-6, 3e-6, 6e-6)
"""Independent noise of tip and inflation, m."""

SMOOTH = 0.005
"""Smooth errors inside a curve, share of its maximum, where an effect is planted."""

NULL_NOISE, NULL_SMOOTH = 1e-6, 0.01
"""Errors where nothing is planted: the smooth ones are the larger."""

COUNTS = (5, 10)
"""Devices."""


@dataclass(frozen=True)
class Trial:
    """One set of readings: what is planted, how large, on how many devices."""

    kind: str  # single, nothing, unnamed, pair, moduli
    planted: tuple[str, ...]
    size: float
    devices: int
    noise: float
    seed: int

    @property
    def key(self) -> str:
        return json.dumps(asdict(self))


def trials(labs: dict[int, Lab], seeds: int) -> Iterator[Trial]:
    """Every trial of the matrix."""
    names = judged(labs[max(COUNTS)])
    kinds = tuple(unnamed_changes(labs[max(COUNTS)]))
    rng = np.random.default_rng(7)
    for seed in range(seeds):
        for devices in COUNTS:
            for noise in NOISES:
                for size in SIZES:
                    for name in names:
                        yield Trial("single", (name,), size, devices, noise, seed)
            for part in range(5):
                number = 1000 * part + seed
                yield Trial("nothing", (), 0.0, devices, NULL_NOISE, number)
            for name in kinds:
                for size in SIZES[1:]:
                    yield Trial("unnamed", (name,), size, devices, NOISES[1], seed)
        for _ in range(6):
            a, b = (str(x) for x in rng.choice(names, 2, replace=False))
            yield Trial("pair", (a, b), SIZES[2], max(COUNTS), NOISES[1], seed)
        for name in names:
            if name != "modulus_bias":
                both = (name, "modulus_bias")
                yield Trial("moduli", both, SIZES[2], max(COUNTS), NOISES[1], seed)


def judged(lab: Lab) -> list[str]:
    """Effects that can move a reading of these devices by the smallest size."""
    study = lab.study
    found = []
    left_open = uncertainty(lab, min(NOISES), SMOOTH)
    for name in study.effects:
        present = None if study.blind(name) else study.present((name,))
        if present is None:
            continue
        moved = np.abs(present.curves.values - present.curves.values[0]) / left_open
        if moved.max() >= min(SIZES):
            found.append(name)
    return found


def run(lab: Lab, trial: Trial) -> dict[str, Any]:
    """Make the readings of one trial, rank them, and judge the answer."""
    began = time.perf_counter()
    smooth = NULL_SMOOTH if trial.kind == "nothing" else SMOOTH
    truth = {}
    extra = None
    if trial.kind == "unnamed":
        extra = unnamed_changes(lab)[trial.planted[0]](trial.size, trial.noise, smooth)
    else:
        for i, name in enumerate(trial.planted):
            seed = 100 * trial.seed + i
            truth[name] = size_for(lab, name, trial.size, trial.noise, smooth, seed)
    readings, planted = readings_of(
        lab, truth, noise=trial.noise, smooth=smooth, seed=trial.seed, extra=extra
    )
    ranking = rank(lab, readings)
    named = [c for c in ranking.candidates if c.effects and not c.unnamed]
    inside = None
    for one in named:
        if set(one.effects) == set(trial.planted) and trial.kind == "single":
            inside = coverage(lab, trial, truth, one)
    return {
        "trial": asdict(trial),
        "verdict": ranking.verdict,
        "effects": list(ranking.effects),
        "moved": planted.moved,
        "probability": probability_of(ranking, trial),
        "inside": inside,
        "seconds": time.perf_counter() - began,
    }


def probability_of(ranking: Ranking, trial: Trial) -> float:
    """Probability that the ranking gives to what was planted."""
    wanted = set(trial.planted) if trial.kind not in ("unnamed",) else None
    return float(
        sum(
            c.probability
            for c in ranking.candidates
            if (c.unnamed if wanted is None else set(c.effects) == wanted)
            and (wanted is None or not c.unnamed)
            and (bool(wanted) or c.name == "nothing" or wanted is None)
        )
    )


def coverage(lab: Lab, trial: Trial, truth: dict[str, Any], one: Any) -> list[bool]:
    """Whether each planted parameter lies in its 90 % interval."""
    name = trial.planted[0]
    found = parameters_of(one)
    inside = []
    for prior, t in zip(lab.study.priors((name,)), truth[name], strict=True):
        row = found[prior.parameter.name.split(".", 1)[1]]
        value = float(prior.value(float(t)))
        inside.append(bool(row["low"] <= value <= row["high"]))
    return inside


def right(row: dict[str, Any]) -> bool:
    """Whether an answer is the right one for what was planted."""
    trial = row["trial"]
    if trial["kind"] == "nothing":
        return bool(row["verdict"] == "adequate")
    if trial["kind"] == "unnamed":
        return bool(row["verdict"] == "unexplained")
    wanted = set(trial["planted"])
    return row["verdict"] in ("identified", "tied") and any(
        set(name.split("+")) == wanted for name in row["effects"]
    )


_lab: dict[int, Lab] = {}


def _labs(solver: Solver) -> dict[int, Lab]:
    found = {}
    for count in COUNTS:
        found[count] = Lab(solver, count)
        found[count].solve()
    return found


def _work(trial: Trial, cache: str | None) -> dict[str, Any]:
    """One trial in a worker process, which reads the kept solves once."""
    if not _lab:
        _lab.update(_labs(Solver(1, Path(cache) if cache else None)))
    return run(_lab[trial.devices], trial)


def main(seeds: str = "20", workers: str = "2", cache: str = "") -> None:
    """Solve, run the trials that are missing, write the page."""

    def show(state: Progress) -> None:
        print(f"\r{state.what} {state.done}/{state.total}", end="", flush=True)

    with Solver(int(workers), Path(cache) if cache else None, show) as solver:
        labs = _labs(solver)
    print()
    RUNS.mkdir(exist_ok=True)
    rows = known()
    done = {json.dumps(row["trial"]) for row in rows}
    missing = [t for t in trials(labs, int(seeds)) if t.key not in done]
    print(f"{len(rows)} trials are kept, {len(missing)} to do")
    with ProcessPoolExecutor(int(workers)) as pool, open(TRIALS, "a") as file:
        futures = [pool.submit(_work, trial, cache or None) for trial in missing]
        for i, future in enumerate(as_completed(futures)):
            row = future.result()
            rows.append(row)
            file.write(json.dumps(row) + "\n")
            file.flush()
            if i % 50 == 49:
                print(f"{i + 1}/{len(missing)}", flush=True)
                PAGE.write_text(page(rows))
    PAGE.write_text(page(rows))


def known() -> list[dict[str, Any]]:
    """Trials that are kept; the last line of a killed run may be cut."""
    rows = []
    for line in TRIALS.read_text().splitlines() if TRIALS.exists() else []:
        try:
            row = json.loads(line)
        except ValueError:
            continue
        row["trial"]["planted"] = tuple(row["trial"]["planted"])
        rows.append(row)
    return rows


def share(rows: list[dict[str, Any]]) -> str:
    """Share of right answers and their number."""
    if not rows:
        return ""
    return f"{100 * np.mean([right(row) for row in rows]):.0f}% of {len(rows)}"


def page(rows: list[dict[str, Any]]) -> str:
    """The document."""
    lines = [
        "# What the ranking finds",
        "",
        "Readings of tip and inflation at seven pressures, 10 to 70 kPa, of 5 or 10 "
        "devices, with batch moduli, thicknesses and camera scales drawn within their "
        "tolerances, smooth errors inside every curve (Legendre polynomials, 0.5 % of "
        "its maximum; 1 % where nothing is planted) and independent noise of 1, 3 or 6 "
        "um. One effect is planted, its parameters in a random direction, with a size "
        "that moves some reading by 3, 6 or 12 times what noise, smooth errors and "
        "tolerances together leave open there. Right is the effect's name, or a tied "
        "group with it. Truth and ranking share their curves "
        "(`tests/recovery/trial.py`); sets that are solved on other meshes are those "
        "of `pba challenge`.",
        "",
        "Written by `make recovery`.",
        "",
        "## One effect",
        "",
    ]
    single = [r for r in rows if r["trial"]["kind"] == "single"]
    single = [r for r in single if r["moved"] >= 0.99 * min(SIZES)]
    names = sorted({r["trial"]["planted"][0] for r in single})
    weak = sorted(set(catalogue()) - set(names))
    head = ["effect", *(f"{d} devices, {s:g} x" for d in COUNTS for s in SIZES)]
    lines += [f"| {' | '.join([*head, 'said most often where wrong'])} |"]
    lines += ["| --- " * (len(head) + 1) + "|"]

    def pick(name: str | None, devices: int, size: float) -> list[dict[str, Any]]:
        return [
            r
            for r in single
            if (name is None or r["trial"]["planted"] == (name,))
            and r["trial"]["devices"] == devices
            and r["trial"]["size"] == size
        ]

    for name in [*names, None]:
        cells = [share(pick(name, d, s)) for d in COUNTS for s in SIZES]
        wrong = [
            "/".join(r["effects"]) or r["verdict"]
            for r in single
            if not right(r) and (name is None or r["trial"]["planted"] == (name,))
        ]
        most = max(set(wrong), key=wrong.count) if wrong else ""
        most = most if len(most) < 60 else most[:57] + "..."
        shown = f"`{name}`" if name else "**all**"
        lines.append(f"| {' | '.join([shown, *cells, most])} |")
    sharp = [r for r in single if right(r) and r["verdict"] == "identified"]
    good = [r for r in single if right(r)]
    inside = [x for r in single if r["inside"] is not None for x in r["inside"]]
    lines += [
        "",
        f"Of the right answers {100 * len(sharp) / max(len(good), 1):.0f}% name the "
        "effect alone, the others a tied group. "
        f"{100 * np.mean(inside) if inside else 0:.0f}% of {len(inside)} planted "
        "parameters lie inside their 90 % interval.",
        "",
        "Not in the table, as they cannot move any reading of these devices that far "
        "within their ranges, or need unloading or times: "
        + ", ".join(f"`{name}`" for name in weak)
        + ". The stiffening laws among them show in softer, wider and thinner devices "
        "near their limit pressure, and in tensile tests.",
        "",
        "| devices | 1 um noise | 3 um noise | 6 um noise |",
        "| --- | --- | --- | --- |",
    ]
    for devices in COUNTS:
        cells = [
            share(
                [
                    r
                    for r in single
                    if r["trial"]["devices"] == devices and r["trial"]["noise"] == noise
                ]
            )
            for noise in NOISES
        ]
        lines.append(f"| {devices} | {' | '.join(cells)} |")
    lines += ["", "## Nothing, something else, two", ""]
    lines += ["| planted | devices | right | otherwise |", "| --- | --- | --- | --- |"]
    for kind, words in (
        ("nothing", "nothing"),
        ("unnamed", "an effect that has no name here"),
        ("pair", "two effects"),
        ("moduli", "wrong moduli and an effect"),
    ):
        for devices in COUNTS:
            chosen = [
                r
                for r in rows
                if r["trial"]["kind"] == kind and r["trial"]["devices"] == devices
            ]
            if not chosen:
                continue
            others: dict[str, int] = {}
            for r in chosen:
                if not right(r):
                    others[r["verdict"]] = others.get(r["verdict"], 0) + 1
            told = ", ".join(
                f"{name} {100 * n / len(chosen):.0f}%"
                for name, n in sorted(others.items(), key=lambda item: -item[1])
            )
            lines.append(f"| {words} | {devices} | {share(chosen)} | {told} |")
    seconds = [r["seconds"] for r in rows]
    lines += [
        "",
        f"{len(rows)} trials, {np.median(seconds) if seconds else 0:.1f} s each.",
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main(*sys.argv[1:])
