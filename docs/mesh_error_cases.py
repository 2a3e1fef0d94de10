"""Paths on every mesh, for the calibration of the discretisation error's bounds.

Each solved path is one line of docs/mesh-error.jsonl, which is kept with the project:
it takes days to fill.  An interrupted run goes on where it stopped, and lines of a mesh
that has changed are solved again.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import astuple, dataclass, field
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from datagen.continuation import PathFollower
from datagen.device import DESIGN_SPACE, MAX_PRESSURE, Design, named_device
from datagen.journey import gauge
from datagen.levels import COARSER, FORMER, LEVELS, SKETCH, MeshLevel
from datagen.mesh_error import bracket, scale_of
from datagen.observe import Instruments
from datagen.problem import baseline
from datagen.response import OUTPUT_NAMES

from .refine import PRESSURES

Array = np.ndarray
Run = dict[str, Any]

RUNS = FilePath(__file__).with_name("mesh-error.jsonl")

MESHES = (SKETCH, LEVELS["draft"], LEVELS["standard"], LEVELS["fine"])
PUBLISHED = {f"S1, case {case}": case for case in (1, 2, 3, 4)}
"""Solved too, at the pressures of docs/refine.py, where their answer is settled."""

DIVIDED = {
    f"{name}, case {case}": (name, case)
    for name, case in (
        ("D8-2x1", 1),
        ("D8-2x1", 2),
        ("D8-4x1", 1),
        ("D8-4x1", 2),
        ("D8-4x2", 1),
    )
}
"""Solved at the same pressures and shown, but no calibration is of them."""

TRUTH = "fine"

FORMER_TRUTH = FORMER["fine-5"]
"""Stands in for the fine mesh on designs that have not been solved on it yet."""

SEED, HYPERCUBE = 20_261, 100
"""Of the designs; the reference dataset has another seed."""

STEPS, SHARE = 8, 0.9
"""Even load steps, up to this share of where the draft path ends."""

BEYOND = 1.3
"""Of the draft path's limit pressure: where the path of any mesh has turned."""


def designs(count: int) -> dict[int | str, Design]:
    """The named devices, and the first of the random designs."""
    found: dict[int | str, Design] = {
        row: named_device("S1", case) for row, case in PUBLISHED.items()
    }
    found |= {row: named_device(*device) for row, device in DIVIDED.items()}
    for row, sample in enumerate(DESIGN_SPACE.sample(HYPERCUBE, SEED)[:count]):
        values = dict(zip(DESIGN_SPACE.names, sample, strict=True))
        found[row] = Design.from_sample(values)
    return found


def follow(design: Design, level: MeshLevel, targets: list[float]) -> Run:
    """One path on one mesh, SI: outputs at the load steps and at most up to there.

    ``values`` has None at load steps that were not reached; ``largest`` is the largest
    amount of each output on the path up to each load step.
    """
    began = time.perf_counter()
    problem = baseline(design, level)
    follower = PathFollower(problem)
    outcome = follower.run(np.array(targets), keep_all=True)
    instruments = Instruments(problem)
    steps = min(STEPS, len(targets))  # the one beyond a limit point left out
    values = np.full((steps, len(OUTPUT_NAMES)), np.nan)
    largest = np.zeros_like(values)
    top = 0.0
    for step, point in outcome.points:
        pressure = gauge(problem, point.pressure)
        top = max(top, pressure)
        if step < steps:
            seen = instruments.read(point.x, point.volume - follower.first_volume)
            largest[step:] = np.maximum(largest[step:], np.abs(seen))
            if np.isclose(pressure, targets[step], rtol=1e-9):
                values[step] = seen
    limit = follower.limit and gauge(problem, follower.limit.pressure)
    return {
        "level": level.name,
        "mesh": astuple(level)[1:],
        "targets": targets,
        "values": _plain(values),
        "largest": _plain(largest),
        "top": top,
        "status": outcome.status,
        "message": outcome.message,
        "limit": limit,
        "unknowns": follower.equations.unknowns,
        "seconds": time.perf_counter() - began,
    }


def _plain(array: Array) -> list[Any]:
    """Rows of numbers to ten digits, None for NaN."""
    return [
        [None if np.isnan(value) else float(f"{value:.10g}") for value in row]
        for row in array
    ]


def kept() -> list[Run]:
    """Every solved path that is kept, whatever its mesh.

    The last line of a killed run may be cut.
    """
    found = []
    for line in RUNS.read_text().splitlines() if RUNS.exists() else []:
        with suppress(ValueError):
            found.append(json.loads(line))
    return found


def known() -> dict[tuple[int | str, str], Run]:
    """Solved paths by row and level; those of a mesh that has changed are left out.

    But for the former fine mesh, where there is no path on the fine one.
    """
    current = {level.name: list(astuple(level)[1:]) for level in MESHES}
    former = list(astuple(FORMER_TRUTH)[1:])
    found: dict[tuple[int | str, str], Run] = {}
    for run in kept():
        key = run["row"], run["level"]
        is_former = run["level"] == TRUTH and run["mesh"] == former
        if run["mesh"] == current[run["level"]] or (is_former and key not in found):
            found[key] = run
    return found


def stand_in_errors() -> Array:
    """(n,) largest distances of the tip of both fine meshes, share of the path's tip.

    Of the designs that were solved on both at the same load steps.
    """
    tip = OUTPUT_NAMES.index("tip_deflection")
    by_row: dict[int | str, dict[bool, Run]] = {}
    for run in kept():
        if run["level"] == TRUTH and isinstance(run["row"], int):
            by_row.setdefault(run["row"], {})[is_current(run)] = run
    found = []
    for pair in by_row.values():
        if len(pair) == 2 and pair[True]["targets"] == pair[False]["targets"]:
            now, before = (_values(pair[current])[:, tip] for current in (True, False))
            both = np.isfinite(now) & np.isfinite(before)
            if both.any():
                apart = np.abs(now - before)[both].max()
                found.append(apart / np.abs(now[both]).max())
    return np.array(found)


def is_current(run: Run) -> bool:
    """Whether a path was solved on a mesh of today, and not on the former fine one."""
    mesh: list[float] = run["mesh"]
    return mesh != list(astuple(FORMER_TRUTH)[1:])


def targets_of(row: int | str, design: Design, runs: list[Run]) -> list[float]:
    """Load steps of a design on every mesh, Pa: those of its first run, if any."""
    if runs:
        first: list[float] = runs[0]["targets"]
        return first
    if isinstance(row, str):
        return [1e3 * pressure for pressure in PRESSURES]
    run = follow(design, LEVELS["draft"], [MAX_PRESSURE])
    top = run["limit"] or run["top"] or 1e3
    targets = np.linspace(0, SHARE * min(top, MAX_PRESSURE), STEPS + 1)[1:]
    if run["status"] != "completed":
        targets = np.append(targets, BEYOND * top)
    return [float(target) for target in targets]


def solve_design(row: int | str, design: Design, truth: bool) -> None:
    """Solve a design on the meshes that it lacks, one line a path.

    With `truth` on the fine mesh, too, where the former one stands in for it.
    """
    done = [run for (one, _), run in known().items() if one == row]
    for level in MESHES:
        if level.name in [run["level"] for run in done if not truth or is_current(run)]:
            continue
        run = follow(design, level, targets_of(row, design, done))
        done.append(run)
        line = json.dumps({"row": row} | run) + "\n"
        with RUNS.open("a") as lines:  # one short write: workers do not mix theirs
            lines.write(line)
        words = f"{run['unknowns']} unknowns, {run['seconds']:.0f} s"
        print(f"design {row}, {level.name}: {words}, {run['status']}", flush=True)


def solve_all(paths: int, workers: int) -> None:
    """Solve what is missing, a design by each worker; what has a stand-in, last."""
    if not paths:
        return
    with ProcessPoolExecutor(workers) as pool:
        for truth in (False, True):
            solving = [
                pool.submit(solve_design, *one, truth) for one in designs(paths).items()
            ]
            for one in solving:  # all of them, so that no path is solved twice
                one.result()


@dataclass(frozen=True)
class Cases:
    """Designs on every mesh, at their load steps.

    values, extent : dict of level to (n, s, m) array, SI
        Outputs, and `scale_of` their largest amounts up to each load step.
    limit : dict of level to (n,) array, Pa
        NaN where there is none.
    seconds : dict of level to (n,) array
    designs : tuple of n Design
    stand_ins : (n,) array of bool
        Whether the former fine mesh stands in for the fine one.
    """

    values: dict[str, Array]
    extent: dict[str, Array]
    limit: dict[str, Array]
    seconds: dict[str, Array]
    designs: tuple[Design, ...] = ()
    stand_ins: Array = field(default_factory=lambda: np.zeros(0, dtype=bool))

    def __len__(self) -> int:
        return len(self.limit[TRUTH])

    def some(self, chosen: Array) -> Cases:
        """Those of a mask or of indices."""
        fields = (self.values, self.extent, self.limit, self.seconds)
        parts = ({k: v[chosen] for k, v in field.items()} for field in fields)
        return Cases(*parts)

    def errors(self, level: str) -> Array:
        """Distance from the fine mesh, (n, s, m), SI."""
        error: Array = np.abs(self.values[level] - self.values[TRUTH])
        return error

    def brackets(self, level: str, floor: Array, alone: bool = False) -> Array:
        """The estimate over k, (n, s, m), SI; `alone`: each load step by itself."""
        other = COARSER[level].name
        parts = (self.values[level], self.values[other], self.extent[other])
        if alone:
            shape = parts[0].shape
            flat = (part.reshape(-1, 1, shape[2]) for part in parts)
            return np.stack(
                [bracket(*p, floor) for p in zip(*flat, strict=True)]
            ).reshape(shape)
        return np.stack([bracket(*p, floor) for p in zip(*parts, strict=True)])

    def limit_errors(self, level: str) -> Array:
        """Distance of the limit pressure from that of the fine mesh, (n,), Pa."""
        error: Array = np.abs(self.limit[level] - self.limit[TRUTH])
        return error

    def limit_brackets(self, level: str, floor: float) -> Array:
        """The estimate of the limit pressure's error over k, (n,), Pa."""
        here, other = self.limit[level], self.limit[COARSER[level].name]
        size: Array = np.abs(here - other) + floor * here
        return size

    @property
    def scale(self) -> Array:
        """Largest amount of every output on each path, (n, m), SI."""
        scale: Array = np.abs(self.values[TRUTH]).max(axis=1)
        return scale


def _values(run: Run) -> Array:
    """(s, m) outputs at the load steps, SI; NaN where one was not reached."""
    return np.array(run["values"], dtype=float)


def _extent(run: Run, design: Design) -> Array:
    """(s, m) scale of the estimate's second term, SI."""
    return scale_of(np.array(run["largest"], dtype=float), design)


def collect(
    rows: Iterable[int | str] = range(HYPERCUBE),
) -> tuple[Cases, list[str]]:
    """Designs that are solved on every mesh, and what was left out and why."""
    runs, chosen, left_out = known(), [], []
    drawn = designs(HYPERCUBE)
    made = []
    for row in rows:
        on = {m.name: runs[row, m.name] for m in MESHES if (row, m.name) in runs}
        if len(on) < len(MESHES):
            continue
        short = [n for n, run in on.items() if np.isnan(_values(run)).any()]
        left_out += [f"design {row}, {n}: {on[n]['message']}" for n in short]
        if not short:
            chosen.append(on)
            made.append(drawn[row])
    if not chosen:
        return Cases({}, {}, {TRUTH: np.empty(0)}, {}), left_out
    names = [level.name for level in MESHES]
    return (
        Cases(
            {n: np.stack([_values(on[n]) for on in chosen]) for n in names},
            {
                n: np.stack(
                    [_extent(on[n], one) for on, one in zip(chosen, made, strict=True)]
                )
                for n in names
            },
            {
                n: np.array([on[n]["limit"] for on in chosen], dtype=float)
                for n in names
            },
            {n: np.array([on[n]["seconds"] for on in chosen]) for n in names},
            tuple(made),
            np.array([not is_current(on[TRUTH]) for on in chosen]),
        ),
        left_out,
    )
