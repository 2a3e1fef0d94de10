"""Does the ranking find what was planted?  Thousands of trials without new solves.

Run by ``make recovery [SEEDS=20] [ONLY="soft strips"]``: the devices of the labs in
`tests.recovery.trial` are solved with every effect (kept: an interrupted run goes on),
then readings are made and ranked.  Each trial is one line of docs/recovery.csv, which
is kept with the project: it takes hours to fill.  docs/recovery.md is written from it.
"""

from __future__ import annotations

import csv
import io
import itertools
import os
import sys
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from datagen.effects import catalogue
from discrepancy.answer import parameters_of
from discrepancy.evidence import fit
from discrepancy.heldout import held_out, noise_floor
from discrepancy.hypotheses import Null
from discrepancy.judging import Candidate
from discrepancy.noise import Readings
from discrepancy.solves import Progress, Solver
from tests.recovery.trial import (
    KINDS,
    PULLED,
    Lab,
    doubt,
    rank,
    readings_of,
    size_for,
    unnamed_changes,
)

HERE = Path(__file__).parent
PAGE = HERE / "recovery.md"
TRIALS = HERE / "recovery.csv"

RULES = 3
"""Of making trials and ranking them.  A change that moves answers counts it up, and
trials of other rules are no longer read."""

SIZES = (3.0, 6.0, 12.0)
"""Largest change of a reading by the planted effect, over its doubt."""

NOISES = (1e-6, 3e-6, 6e-6)
"""Independent noise of tip and inflation, m."""

SMOOTH = 0.005
"""Smooth errors inside a curve, share of its maximum, where an effect is planted."""

NULL_NOISE, NULL_SMOOTH = 1e-6, 0.01
"""Errors where nothing is planted: the smooth ones are the larger."""

COUNTS = (5, 10)
"""Devices."""

LARGE, ABOVE = 5.0, 3.0
"""Times the independent noise, and times the noise floor: effects that should show."""

ALL = 20
"""Seeds, unless told otherwise."""

ADOPTED = (10, NOISES[1])
"""Devices and noise of the trials whose effect is adopted as well."""


@dataclass(frozen=True)
class Trial:
    """One set of readings: what is planted, how large, on how many devices."""

    lab: str
    kind: str  # single, nothing, unnamed, pair, moduli
    planted: tuple[str, ...]
    size: float
    devices: int
    noise: float
    seed: int


Labs = dict[tuple[str, int], Lab]


def trials(labs: Labs, seeds: int) -> Iterator[Trial]:
    """Every trial of the matrix."""
    kinds = [kind for kind in KINDS if (kind, max(COUNTS)) in labs]
    shown = {kind: judged(labs[kind, max(COUNTS)]) for kind in kinds}
    for seed, kind in itertools.product(range(seeds), kinds):
        rng = np.random.default_rng([7, seed, list(KINDS).index(kind)])
        names, unnamed = shown[kind], tuple(unnamed_changes(labs[kind, max(COUNTS)]))
        for devices, noise, size in itertools.product(COUNTS, NOISES, SIZES):
            for name in names:
                yield Trial(kind, "single", (name,), size, devices, noise, seed)
        for devices in COUNTS:
            for part in range(5):
                number = 1000 * part + seed
                yield Trial(kind, "nothing", (), 0.0, devices, NULL_NOISE, number)
            for name, size in itertools.product(unnamed, SIZES[1:]):
                yield Trial(kind, "unnamed", (name,), size, devices, NOISES[1], seed)
        for _ in range(6):
            a, b = (str(x) for x in rng.choice(names, 2, replace=False))
            yield Trial(kind, "pair", (a, b), SIZES[2], max(COUNTS), NOISES[1], seed)
        for name in names:
            if name != "modulus_bias":
                both = (name, "modulus_bias")
                yield Trial(
                    kind, "moduli", both, SIZES[2], max(COUNTS), NOISES[1], seed
                )


def judged(lab: Lab) -> list[str]:
    """Effects that can move a reading of these devices by the smallest size."""
    study = lab.study
    found = []
    own = doubt(lab, min(NOISES), SMOOTH)
    for name in study.effects:
        present = None if study.blind(name) else study.present((name,))
        if present is None:
            continue
        moved = own.times(present.curves.values - present.curves.values[0])
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
    ranking, asked = rank(lab, readings)
    named = [c for c in ranking.candidates if c.effects and not c.unnamed]
    inside = None
    for one in named:
        if set(one.effects) == set(trial.planted) and trial.kind == "single":
            inside = coverage(lab, trial, truth, one)
    adopted = None
    if trial.kind == "single" and (trial.devices, trial.noise) == ADOPTED:
        planted_one = next((c for c in named if c.effects == trial.planted), None)
        adopted = planted_one and fall(lab, readings, planted_one, truth)
    return {
        "rules": RULES,
        "trial": asdict(trial),
        "verdict": ranking.verdict,
        "effects": list(ranking.effects),
        "moved": round(planted.moved, 4),
        "inside": inside,
        "asked": asked,
        "adopted": adopted and {name: round(x, 4) for name, x in adopted.items()},
        "seconds": round(time.perf_counter() - began, 2),
    }


def fall(
    lab: Lab, readings: Readings, one: Candidate, truth: dict[str, Any]
) -> dict[str, float]:
    """Errors on devices left out, in noise: as stated, with the effect, the floor.

    And with the planted size itself: what nobody can do better than with these draws
    of tolerances, where the floor is what to expect of them.  And what the planted
    effect moves the readings by, its root mean square.
    """
    (name, t), base = next(iter(truth.items())), lab.study.base
    present = lab.present(name)
    assert present is not None
    effect = (present.predict(t).values - base) / one.fit.noise
    lack = (readings.value - base) / one.fit.noise
    planted = present.predict(t)._replace(slopes=np.zeros((len(base), 0)))
    told = fit(readings, Null("planted", planted), evidence=False)
    return {
        "effect": float(np.sqrt(np.mean(effect**2))),
        "before": float(np.sqrt(np.mean(lack**2))),
        "after": held_out(one.fit),
        "floor": noise_floor(one.fit),
        "ideal": held_out(told, one.fit.noise),
    }


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


_lab: Labs = {}


def _labs(solver: Solver, kinds: Iterable[str] = KINDS) -> Labs:
    found = {}
    for kind, count in itertools.product(kinds, COUNTS):
        found[kind, count] = Lab(solver, count, kind)
        found[kind, count].solve()
    return found


def _work(trial: Trial, cache: str | None) -> dict[str, Any]:
    """One trial in a worker process, which reads the kept solves once."""
    if (trial.lab, trial.devices) not in _lab:
        solver = Solver(1, Path(cache) if cache else None)
        _lab.update(_labs(solver, (trial.lab,)))
    return run(_lab[trial.lab, trial.devices], trial)


def main(
    seeds: str = str(ALL), workers: str = "2", only: str = "", cache: str = ""
) -> None:
    """Solve, run the trials of some labs that are missing, write the page."""
    kinds = only.split() or list(KINDS)
    for kind in kinds:
        if kind not in KINDS:
            raise SystemExit(f"lab: {kind!r} is unknown; allowed: {', '.join(KINDS)}")

    def show(state: Progress) -> None:
        print(f"\r{state.what} {state.done}/{state.total}", end="", flush=True)

    keep(known())
    PAGE.write_text(page(known()))
    with Solver(int(workers), Path(cache) if cache else None, show) as solver:
        labs = _labs(solver, kinds)
    print()
    rows = known()
    done = {Trial(**row["trial"]) for row in rows}
    missing = [t for t in trials(labs, int(seeds)) if t not in done]
    print(f"{len(rows)} trials are kept, {len(missing)} to do")
    with ProcessPoolExecutor(int(workers)) as pool:
        futures = [pool.submit(_work, trial, cache or None) for trial in missing]
        for i, future in enumerate(as_completed(futures)):
            with open(TRIALS, "a") as file:  # anew, as others may write it, too
                csv.writer(file, lineterminator="\n").writerow(
                    cells_of(future.result())
                )
            if i % 50 == 49:
                print(f"{i + 1}/{len(missing)}", flush=True)
                PAGE.write_text(page(known()))
    PAGE.write_text(page(known()))


ADOPTION = ("effect", "before", "after", "floor", "ideal")
"""See `fall`."""

COLUMNS = (
    "rules",
    *(field.name for field in fields(Trial)),
    *("verdict", "effects", "moved", "inside", "asked"),
    *ADOPTION,
    "seconds",
)
"""Of docs/recovery.csv."""


def cells_of(row: dict[str, Any]) -> list[str]:
    """A trial and its answer as a line of the table; lists by spaces, nothing empty."""
    flat = {**row, **row["trial"], **(row["adopted"] or {})}
    flat["planted"] = " ".join(flat["planted"])
    flat["effects"] = " ".join(flat["effects"])
    flat["inside"] = " ".join(str(int(x)) for x in flat["inside"] or ())
    return [str(flat.get(name, "")) for name in COLUMNS]


def row_of(cells: dict[str, str]) -> dict[str, Any]:
    """The other way round."""
    trial = {
        "lab": cells["lab"],
        "kind": cells["kind"],
        "planted": tuple(cells["planted"].split()),
        "size": float(cells["size"]),
        "devices": int(cells["devices"]),
        "noise": float(cells["noise"]),
        "seed": int(cells["seed"]),
    }
    adopted = {name: float(cells[name]) for name in ADOPTION if cells[name]}
    return {
        "rules": int(cells["rules"]),
        "trial": trial,
        "verdict": cells["verdict"],
        "effects": cells["effects"].split(),
        "moved": float(cells["moved"]),
        "inside": [x == "1" for x in cells["inside"].split()] or None,
        "asked": int(cells["asked"]),
        "adopted": adopted or None,
        "seconds": float(cells["seconds"]),
    }


def known() -> list[dict[str, Any]]:
    """Trials of today's rules that are kept; a killed run may cut the last line."""
    text = TRIALS.read_text() if TRIALS.exists() else ""
    lines = text[: text.rfind("\n") + 1].splitlines()
    table = csv.DictReader(lines)
    return [row_of(cells) for cells in table if cells["rules"] == str(RULES)]


def keep(rows: list[dict[str, Any]]) -> None:
    """Write the table anew, where it holds anything else."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerows([COLUMNS, *map(cells_of, rows)])
    if TRIALS.exists() and TRIALS.read_text() == text.getvalue():
        return
    whole = TRIALS.with_suffix(".part")
    whole.write_text(text.getvalue())
    os.replace(whole, TRIALS)


def share(rows: list[dict[str, Any]]) -> str:
    """Share of right answers and their number."""
    if not rows:
        return ""
    return f"{100 * np.mean([right(row) for row in rows]):.0f}% of {len(rows)}"


LABS = {
    "stiff": "Stiff devices, 10 to 70 kPa",
    "soft": "Soft devices, 3.6 to 25 kPa and back, with times",
    "strips": "Soft devices, 3.6 to 25 kPa in 7 min, and strips pulled to 2.4",
}


def page(rows: list[dict[str, Any]]) -> str:
    """The document."""
    seconds, asked = ([row[name] for row in rows] for name in ("seconds", "asked"))
    lines = [
        "# What the ranking finds",
        "",
        "Readings of tip and inflation at seven pressures, in one lab on the way back, "
        "too, of 5 or 10 devices, in another together with the stress of a strip of "
        "each batch, pulled and let back. Batch moduli, thicknesses and camera scales "
        "are drawn within their tolerances, with smooth errors inside every curve "
        "(Legendre polynomials, 0.5 % of its maximum; 1 % where nothing is planted) "
        f"and independent noise, {PULLED:.1%} of a strip's last stress and of devices "
        "1, 3 or 6 um. One effect is planted, its parameters in a random direction, "
        "with a size that moves some reading by 3, 6 or 12 times what noise, smooth "
        "errors and tolerances together leave open there (where there are strips, of "
        "what they make expect there). Right is "
        "the effect's name, or a tied group with it. The search is that of `pba rank`, "
        "the whole catalogue its candidates; its solves are answered from the "
        "interpolated curves that the readings were made from "
        "(`tests/recovery/rehearsal.py`). Sets that are solved on other meshes are "
        "those of `pba challenge`.",
        "",
        f"Written by `make recovery`, which goes on until {ALL} seeds are done.",
    ]
    for lab, title in LABS.items():
        chosen = [row for row in rows if row["trial"]["lab"] == lab]
        if chosen:
            lines += ["", f"## {title}", "", *section(chosen)]
    single = of_kind(rows, "single")
    shown = {row["trial"]["planted"][0] for row in single}
    weak = sorted(set(catalogue()) - shown)
    without = [
        f"{', '.join(f'`{name}`' for name in kind.without)} (lab: {LABS[lab]})"
        for lab, kind in KINDS.items()
        if kind.without
    ]
    lines += ["", "## All", ""]
    lines += ["| devices | 1 um noise | 3 um noise | 6 um noise |", "| --- " * 4 + "|"]
    for devices in COUNTS:
        cells = [share(pick(single, devices=devices, noise=noise)) for noise in NOISES]
        lines.append(f"| {devices} | {' | '.join(cells)} |")
    good = [row for row in single if right(row)]
    alone = [row for row in good if row["verdict"] == "identified"]
    # One that ends at the end of its range lies in no interval between two quantiles.
    within = [row for row in single if row["moved"] >= 0.99 * row["trial"]["size"]]
    inside = [x for row in within if row["inside"] is not None for x in row["inside"]]
    none = "none" if not weak else ", ".join(f"`{name}`" for name in weak)
    lines += [
        "",
        f"Of the right answers {100 * len(alone) / max(len(good), 1):.0f}% name the "
        "effect alone, the others a tied group. "
        f"{100 * np.mean(inside) if inside else 0:.0f}% of {len(inside)} planted "
        "parameters lie inside their 90 % interval, of effects that reach the wanted "
        "size within their range. Effects that no lab can move a "
        f"reading far enough with, within their ranges: {none}. No candidate, as paths "
        f"take too long to be solved by the hundred: {'; '.join(without)}.",
        "",
        f"{len(rows)} trials of {len({row['trial']['seed'] % 1000 for row in rows})} "
        "seeds (trials of one have the same draws of tolerances, smooth errors and "
        f"noise), {np.median(seconds) if seconds else 0:.1f} s each; the "
        f"search asked for {np.median(asked) if asked else 0:.0f} solves of "
        "each curve (median) besides the baseline.",
    ]
    lines += adoptions(single)
    return "\n".join(lines) + "\n"


def adoptions(rows: list[dict[str, Any]]) -> list[str]:
    """How far the error on devices left out falls when what was planted is adopted."""
    chosen = [row for row in rows if row.get("adopted")]
    if not chosen:
        return []
    lines = [
        "",
        "## Adopted",
        "",
        f"With the planted effect in the model ({ADOPTED[0]} devices, "
        f"{ADOPTED[1] * 1e6:g} um noise), fitted to nine devices and judged on the "
        "tenth, in turn:",
        "",
        "| size of the effect | sets | error at most 1.2 times the noise floor | at "
        "most 1.2 times the error with the planted size | error falls by a factor of 3 "
        "or more | median factor |",
        "| --- " * 6 + "|",
    ]
    for size in SIZES:
        found = [row["adopted"] for row in pick(chosen, size=size)]
        if not found:
            continue
        near, best = (
            np.mean([one["after"] <= 1.2 * one[name] for one in found])
            for name in ("floor", "ideal")
        )
        ratio = np.array([one["before"] / one["after"] for one in found])
        lines.append(
            f"| {size:g} x | {len(found)} | {near:.0%} | {best:.0%} | "
            f"{np.mean(ratio >= 3):.0%} | {np.median(ratio):.1f} |"
        )
    adopted = [row["adopted"] for row in chosen]
    lines += [
        "",
        "The noise floor is what to expect, over all draws of tolerances; a seed's own "
        "draw is the same in all of its trials, and is above what is expected or below "
        "it in all of them. With the planted size in place of the fitted one, the "
        "draws are those of the set.",
    ]
    for times, above_floor, words in (
        (LARGE, False, "independent noise"),
        (ABOVE, True, "noise floor, tolerances of unmeasured devices included,"),
    ):
        large = [
            one["before"] / one["after"]
            for one in adopted
            if one["effect"] >= times * (one["floor"] if above_floor else 1.0)
        ]
        if large:
            lines += [
                "",
                f"Of the {len(large)} sets whose effect is {times:g} times the {words} "
                "or more (root mean square over the readings), the error falls by a "
                f"factor of 3 or more in {np.mean(np.array(large) >= 3):.0%}, median "
                f"factor {np.median(large):.1f}.",
            ]
    return lines


def of_kind(rows: list[dict[str, Any]], kind: str) -> list[dict[str, Any]]:
    """Rows of one kind of trial, those where the planted effect is large enough."""
    chosen = [row for row in rows if row["trial"]["kind"] == kind]
    if kind != "single":
        return chosen
    return [row for row in chosen if row["moved"] >= 0.99 * min(SIZES)]


def pick(rows: list[dict[str, Any]], **wanted: object) -> list[dict[str, Any]]:
    """Rows whose trials have the wanted fields."""
    return [
        row
        for row in rows
        if all(row["trial"][name] == value for name, value in wanted.items())
    ]


def section(rows: list[dict[str, Any]]) -> list[str]:
    """The tables of one lab."""
    single = of_kind(rows, "single")
    names = sorted({row["trial"]["planted"] for row in single})
    cases = list(itertools.product(COUNTS, SIZES))
    head = ["effect", *(f"{d} devices, {s:g} x" for d, s in cases)]
    lines = [f"| {' | '.join([*head, 'said most often where wrong'])} |"]
    lines += ["| --- " * (len(head) + 1) + "|"]
    for planted in [*names, None]:
        own = pick(single, planted=planted) if planted else single
        cells = [share(pick(own, devices=d, size=s)) for d, s in cases]
        wrong = ["/".join(r["effects"]) or r["verdict"] for r in own if not right(r)]
        most = max(sorted(set(wrong)), key=wrong.count) if wrong else ""
        most = most if len(most) < 60 else most[:57] + "..."
        shown = f"`{planted[0]}`" if planted else "**all**"
        lines.append(f"| {' | '.join([shown, *cells, most])} |")
    more: list[str] = []
    for kind, words in (
        ("nothing", "nothing"),
        ("unnamed", "an effect that has no name here"),
        ("pair", "two effects"),
        ("moduli", "wrong moduli and an effect"),
    ):
        for devices in COUNTS:
            chosen = pick(rows, kind=kind, devices=devices)
            if not chosen:
                continue
            others: dict[str, int] = {}
            for row in chosen:
                if not right(row):
                    others[row["verdict"]] = others.get(row["verdict"], 0) + 1
            told = ", ".join(
                f"{name} {100 * n / len(chosen):.0f}%"
                for name, n in sorted(others.items(), key=lambda item: -item[1])
            )
            more.append(f"| {words} | {devices} | {share(chosen)} | {told} |")
    head = ["", "| planted | devices | right | otherwise |", "| --- " * 4 + "|"]
    return lines + (head + more if more else [])


if __name__ == "__main__":
    main(*sys.argv[1:])
