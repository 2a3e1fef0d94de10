"""Effects hidden in another program's answers: ``make foreign``.

The laboratory of `examples.bench`, but FElupe solves its devices: other elements, other
code for the effect, another way along the path.  What it reads goes into a measurement
file with tolerances and noise, and `pba rank` says what is missing.  The files stay in
``examples/foreign``, so that anyone can rank them: ``--rank`` does, without FElupe.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from datagen.atomic import write_text
from datagen.device import Design
from datagen.effects.self_weight import GRAVITY
from datagen.model import GENERATOR_VERSION, Model
from datagen.problem import baseline
from datagen.response import Path as LoadPath
from datagen.specimens import Bulge, Tensile
from discrepancy.measurement import Measurements, Tolerances
from discrepancy.writing import write_measurements
from examples.bench import Bench

from .bench_fem import FOLDER, ROOT, PeerStopped, call
from .case import ask, level_of, read
from .exchange import Answer

Array = np.ndarray
Parameters = Mapping[str, Mapping[str, float]]

FILES = ROOT / "examples/foreign"
RESULTS, PAGE = FOLDER / "foreign.json", FOLDER / "foreign.md"

MESH, OURS = "medium", "standard"
"""The peer's mesh, and ours that it is compared with."""

LINEAR = "pardiso" if platform.machine() in ("x86_64", "AMD64") else "superlu"
"""Where the wheel of the faster one exists."""

LIMIT = 3600.0
"""s, of each of the peer's paths."""

OUTPUTS = ("tip_deflection", "inflation")


@dataclass(frozen=True)
class Case:
    """One file of measurements.

    Parameters
    ----------
    hidden : mapping of str to mapping of str to float, SI
        Effects and their parameters; empty where nothing is missing.
    soft : bool
        Whether strains are to be large, see `devices`.
    law : mapping of str to float
        How the peer is told: fields of a `Question`.
    growth : float, m
        By which the cavities are larger than stated, on every side.
    """

    hidden: Parameters
    soft: bool = False
    law: Mapping[str, float] = field(default_factory=dict)
    growth: float = 0.0

    @property
    def load(self) -> Array:
        """(7,) array, Pa."""
        top = 40e3 if self.soft else 60e3
        return np.linspace(top / 7, top, 7)


CASES = {
    "nothing": Case({}),
    "larger": Case({"bond_edge": {"growth": 50e-6}}, growth=50e-6),
    "heavy": Case(
        {"self_weight": {"density": 1000.0}}, law={"weight": 1000.0 * GRAVITY}
    ),
    "mooney": Case({"mooney": {"second": 0.15}}, soft=True, law={"second": 0.15}),
    "gent": Case(
        {"strain_stiffening": {"inverse_limit": 0.125}},
        soft=True,
        law={"inverse_limit": 0.125},
    ),
}


def devices(soft: bool) -> dict[str, Design]:
    """Six devices of two batches; one is divided where moduli are the published ones.

    On this mesh FElupe's path of a soft divided device jumps near 30 kPa.
    """
    rng = np.random.default_rng(5)
    a, b = (1.5e6, 1.05e6) if soft else (4.5e6, 2.5e6)
    found = {}
    for i in range(6):
        upper, lower = ((b, a), (a, b), (a, a), (b, b))[i % 4]
        found[f"D{i + 1}"] = Design.from_sample(
            {
                "balloon_length": 1e-3 * round(rng.uniform(3.0, 5.0), 1),
                "divisions_x": 2 if i == 4 and not soft else 1,
                "divisions_y": 1,
                "wall": 0.2e-3,
                "balloon_start": 1e-3 * round(rng.uniform(0.6, 1.5), 2),
                "tip_margin": 1.2e-3,
                "balloon_width": 1e-3 * round(rng.uniform(0.9, 1.6), 2),
                "rim": 0.5e-3,
                "cavity_height": 75e-6,
                "upper_thickness": 1e-6 * round(rng.uniform(75, 125)),
                "lower_thickness": 1e-6 * round(rng.uniform(120, 190)),
                "upper_modulus": upper,
                "lower_modulus": lower,
            }
        )
    return found


def grown(design: Design, growth: float) -> Design:
    """A device whose cavities are larger on every side; the strip stays as it is."""
    return design.with_values(
        balloon_length=design.balloon_length + 2 * growth * design.divisions_x,
        balloon_width=design.balloon_width + 2 * growth * design.divisions_y,
        balloon_start=design.balloon_start - growth,
        wall=design.wall - 2 * growth,
    )


class Elsewhere(Bench):
    """A laboratory whose devices do what FElupe says.

    Parameters
    ----------
    case : Case
    seed : int
        Of tolerances and noise.
    python : Path
        Of FElupe's environment.
    """

    def __init__(self, case: Case, seed: int, python: Path) -> None:
        super().__init__(case.hidden, seed, Tolerances())
        self.case, self.python = case, python
        self.model = Model(tuple(case.hidden), OURS, case.hidden)
        self.apart: list[Array] = []  # of the programs, share of a curve's maximum
        self.versions: dict[str, str] = {}

    def answer(
        self, made: Design | Bulge | Tensile, load: Array
    ) -> tuple[tuple[str, ...], Array]:
        assert isinstance(made, Design)
        problem = baseline(grown(made, self.case.growth), level_of(MESH))
        question = replace(ask(problem, load), **dict[str, Any](self.case.law))
        with tempfile.TemporaryDirectory() as name:
            asked, answered = Path(name, "question.npz"), Path(name, "answer.npz")
            question.write(asked)
            module = "benchmarks.peer_felupe"
            command = [str(self.python), "-m", module, str(asked), str(answered)]
            call([*command, "--linear", LINEAR], LIMIT)
            found = Answer.read(answered)
        self.versions = found.cost.versions
        values = np.stack(read(problem, found.displacement), axis=1)
        response = self.model([made], [LoadPath(load)])
        own = np.stack([response.output(name)[0] for name in OUTPUTS], axis=1)
        self.apart.append(np.abs(values - own).max(axis=0) / np.abs(own).max(axis=0))
        return OUTPUTS, values


def digest(name: str) -> str:
    """SHA-256 of a case's file."""
    return hashlib.sha256((FILES / f"{name}.csv").read_bytes()).hexdigest()


def measure(name: str, python: Path) -> dict[str, Any]:
    """Make the file of one case: its digest, how far the programs are apart, versions.

    ``apart`` is the largest distance of the two programs' curves with the effect on in
    both, percent of a curve's maximum, by quantity.

    Raises
    ------
    PeerStopped
        When FElupe gives no answer.
    """
    case = CASES[name]
    bench = Elsewhere(case, 1 + list(CASES).index(name), python)
    curves = []
    for device, stated in devices(case.soft).items():
        print(f"{name}: {device} ...", flush=True)
        made = bench.true(stated)
        curves.append(bench.test(device, stated, made, case.load, 1))
    FILES.mkdir(parents=True, exist_ok=True)
    write_measurements(Measurements(tuple(curves)), FILES / f"{name}.csv")
    largest = 100 * np.max(bench.apart, axis=0)
    apart = {q: round(float(x), 2) for q, x in zip(OUTPUTS, largest, strict=True)}
    return {"sha256": digest(name), "apart": apart, "versions": bench.versions}


def rank(name: str) -> dict[str, Any]:
    """What ``pba rank --json`` says of a file, and the generator that it solved with.

    Raises
    ------
    SystemExit
        When it fails; it has said why.
    """
    pba = Path(sys.executable).with_name("pba")
    done = subprocess.run(
        [pba, "rank", FILES / f"{name}.csv", "--level", OURS, "--json"],
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    if done.returncode:
        raise SystemExit(f"{name}: pba rank failed")
    found = json.loads(done.stdout)
    kept = {key: found[key] for key in ("verdict", "effects", "sentence")}
    kept["ranking"] = [
        {key: one.get(key) for key in ("effect", "probability", "parameters")}
        for one in found["ranking"][:4]
    ]
    return {"answer": kept, "generator": GENERATOR_VERSION}


def known() -> dict[str, dict[str, Any]]:
    """What is recorded, by case."""
    found: dict[str, dict[str, Any]] = {}
    if RESULTS.exists():
        found = json.loads(RESULTS.read_text())["cases"]
    return found


def keep(name: str, parts: dict[str, Any]) -> None:
    """Add to what is recorded of one case; others may have written theirs meanwhile."""
    cases = known()
    cases[name] = cases.get(name, {}) | parts
    ordered = {name: cases[name] for name in CASES if name in cases}
    write_text(RESULTS, json.dumps({"cases": ordered}, indent=1) + "\n")


def shown(case: Case) -> str:
    """What is hidden, as a cell of a table."""
    words = [
        f"`{effect}` {name} {value:g}"
        for effect, values in case.hidden.items()
        for name, value in values.items()
    ]
    return ", ".join(words) or "nothing"


def names_of(effects: str | list[str]) -> list[str]:
    """One effect, or several that act together."""
    return [effects] if isinstance(effects, str) else effects


def sizes(name: str, ranking: list[dict[str, Any]]) -> str:
    """90 % intervals by the most probable that has what is hidden; if they hold it."""
    hidden = CASES[name].hidden
    for one in ranking:
        names = names_of(one["effect"])
        if hidden and set(hidden) <= set(names):
            words = []
            for effect, values in hidden.items():
                for parameter, value in values.items():
                    several = len(names) > 1
                    key = f"{effect}.{parameter}" if several else parameter
                    found = one["parameters"][key]
                    low, high = found["low"], found["high"]
                    holds = "holds it" if low <= value <= high else "misses it"
                    words.append(f"{low:.3g} to {high:.3g}, {holds}")
            return "; ".join(words)
    return ""


HEADINGS = (
    "| file | hidden, SI | programs apart, tip / inflation, % of a curve's maximum "
    "| `pba rank` | 90 % interval |"
)


def page(cases: Mapping[str, dict[str, Any]]) -> str:
    """The document."""
    lines: list[str] = []
    programs: dict[str, None] = {}  # a set that keeps its order
    for name, found in cases.items():
        answer = found["answer"]
        named = ", ".join(
            " with ".join(f"`{one}`" for one in names_of(effects))
            for effects in answer["effects"]
        )
        cells = [
            f"[{name}](../../examples/foreign/{name}.csv)",
            shown(CASES[name]),
            " / ".join(f"{found['apart'][q]:.1f}" for q in OUTPUTS),
            f"{answer['verdict']}: {named}" if named else answer["verdict"],
            sizes(name, answer["ranking"]),
        ]
        lines.append("| " + " | ".join(cells) + " |")
        own = {"pba generator": found["generator"]}
        programs |= {f"{k} {v}": None for k, v in (found["versions"] | own).items()}
    table = "\n".join([HEADINGS, "|" + " --- |" * 5, *lines])
    return f"""\
# Effects hidden in another program's answers

Written by `make foreign` from `foreign.json`, which the same command measures. Change
neither by hand.

Six devices with seven pressures each, solved by FElupe with an effect on: its own
elements of 20 nodes with 2 x 2 x 2 points, its own neo-Hookean law or an energy that it
differentiates itself, its own weight, its own Newton's method; a larger cavity is a
mesh of a larger cavity. Ours are the grid lines of the mesh (`{MESH}`) and the code
that reads tip and inflation off the deformed nodes. Then the laboratory of
`examples/bench.py`: moduli of batches, thicknesses and the camera's scale are drawn
from their tolerances, and tip and inflation have noise of 3 and 2 um, as the files
state.

Where a law is hidden, moduli are 1.5 and 1.05 MPa, pressures go to 40 kPa and no device
is divided (on this mesh FElupe's path of a soft divided one jumps to another branch);
elsewhere moduli are the published ones, pressures go to 60 kPa and one device is
divided in two.

The programs differ on their meshes, with the effect on in both, by as much as the
third column says; of a tip, whose two bendings cancel to some tens of um, that is many
percent. `pba rank` takes it for what it takes smooth errors of a bench for. An
interval is of the readings and the tolerances, and knows nothing of the peer's mesh:
so it can miss what is hidden. Where a pair is named, the second effect is what the
peer's mesh looks like. Each file was ranked with the whole catalogue on the {OURS}
mesh.

{table}

Of {", ".join(programs)}.
"""


def write_page() -> None:
    """Write the document of the cases that are ranked."""
    ranked = {name: found for name, found in known().items() if "answer" in found}
    if not ranked:
        raise SystemExit(f"{RESULTS.name} has no ranked case: make foreign")
    write_text(PAGE, page(ranked))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--felupe-python", type=Path, default=Path(sys.executable))
    parser.add_argument("--only", nargs="*", default=[], choices=list(CASES))
    parser.add_argument("--rank", action="store_true", help="rank the files again")
    parser.add_argument("--table", action="store_true", help="write the document alone")
    given = parser.parse_args()
    names = [] if given.table else given.only or list(CASES)
    python = given.felupe_python.absolute()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        solved = [] if given.rank else names
        made = {name: pool.submit(measure, name, python) for name in solved}
        try:
            for name in names:
                if name in made:
                    keep(name, made[name].result())
                elif name not in known():
                    raise SystemExit(f"{name} is not measured yet: make foreign")
                print(f"{name}: ranking ...", flush=True)
                keep(name, found := rank(name))
                print(f"{name}: {found['answer']['sentence']}", flush=True)
        except PeerStopped as stopped:
            raise SystemExit(str(stopped)) from stopped
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
    write_page()


if __name__ == "__main__":
    main()
