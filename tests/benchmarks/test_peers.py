"""Peers get the problem that we solve, and their answers are read as ours are.

No timing here: FElupe and CalculiX run on a single element, where they are installed.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import fsolve

from benchmarks import peer_calculix
from benchmarks.case import ask, kept_nodes, lift, problem_of, read
from benchmarks.exchange import EDGES, FACE_EDGES, FACES, Answer, Cost, Question
from benchmarks.peer_own import solve
from datagen.problem import Problem

ROOT = Path(__file__).parents[2]
FELUPE = Path(os.environ.get("PBA_BENCH", ROOT / ".venv-bench"), "bin", "python")
CUBE = np.array(
    [(x, y, z) for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
)


@lru_cache(maxsize=1)
def strip() -> Problem:
    return problem_of("draft")


def cube(pressure: float, shear: float, bulk: float) -> Question:
    """A cube of 1 mm on rollers with pressure on its side x+."""
    middles = [(CUBE[a] + CUBE[b]) / 2 for a, b in EDGES]
    nodes = np.concatenate([CUBE, middles]) * 1e-3
    wet = np.zeros((1, 6), dtype=bool)
    wet[0, 3] = True
    return Question(
        nodes=nodes,
        cells=np.arange(20)[None],
        shear=np.array([shear]),
        bulk=np.array([bulk]),
        fixed=nodes == 0,
        wet=wet,
        pressure=np.array([0.5, 1.0]) * pressure,
    )


def stretches(
    pressure: float,
    shear: float,
    bulk: float,
    second: float = 0.0,
    inverse_limit: float = 0.0,
) -> np.ndarray:
    """Along x and across of W = What(I1bar, I2bar) + K/2 (J - 1)^2, closed form.

    Cauchy's stress with bbar = J^(-2/3) b is 2/J dev(What_1 bbar - What_2 bbar^-1) +
    K (J - 1) I: -p along x, 0 across.
    """

    def stress(unknown: np.ndarray) -> list[float]:
        along, across = unknown
        volume = along * across**2
        square = np.array([along, across, across]) ** 2 * volume ** (-2 / 3)
        first = shear / 2 / (1 + second)
        first /= 1 - inverse_limit * (square.sum() - 3)
        part = first * square - second * shear / 2 / (1 + second) / square
        total = 2 / volume * (part - part.mean()) + bulk * (volume - 1)
        return [total[0] + pressure, total[1]]

    found: np.ndarray = fsolve(stress, [1.0, 1.0], xtol=1e-13)
    return found


def test_wet_faces_are_the_cavity() -> None:
    """Every wall of the cavity once, and by the same eight nodes."""
    problem = strip()
    asked = ask(problem)
    kept = kept_nodes(problem)
    ours = {
        frozenset(face[[0, 1, 2, 3, 5, 6, 7, 8]]) for face in problem.mesh.cavity_faces
    }
    theirs = [
        frozenset(kept[asked.cells[element][[*FACES[face], *FACE_EDGES[face]]]])
        for element, face in np.argwhere(asked.wet)
    ]
    assert len(theirs) == len(problem.mesh.cavity_faces)
    assert set(theirs) == ours


def test_nodes_stand_in_the_peers_order() -> None:
    """Corners counted as on a unit cube, then each edge's middle."""
    asked = ask(strip())
    corners = asked.nodes[asked.cells[:, :8]]
    low, high = corners.min(axis=1), corners.max(axis=1)
    np.testing.assert_allclose(
        (corners - low[:, None]) / (high - low)[:, None],
        np.tile(CUBE, (len(low), 1, 1)),
    )
    for node, (a, b) in enumerate(EDGES, 8):
        np.testing.assert_allclose(
            asked.nodes[asked.cells[:, node]], (corners[:, a] + corners[:, b]) / 2
        )
    assert asked.fixed[asked.nodes[:, 0] == 0].all()
    assert asked.unknowns == np.sum(~asked.fixed)


def test_lift_is_exact_for_serendipity_fields() -> None:
    """x y z and every quadratic are in the space; x^2 y^2 is not."""
    problem = strip()
    x, y, z = (problem.nodes / problem.nodes.max(axis=0)).T
    inside = np.stack([x**2 + y * z, x * y * z, z**2 - x * y], axis=1)
    kept = kept_nodes(problem)
    np.testing.assert_allclose(lift(problem, inside[kept]), inside, atol=1e-12)
    outside = np.stack([x**2 * y**2] * 3, axis=1)
    assert np.abs(lift(problem, outside[kept]) - outside).max() > 1e-4


def test_readings_need_the_peers_nodes_alone() -> None:
    """Our own answer at the twenty nodes reads as at all twenty-seven."""
    problem = strip()
    answer = solve("draft", np.array([5e3]))
    whole = read(problem, answer.displacement)
    part = read(problem, answer.displacement[:, kept_nodes(problem)])
    np.testing.assert_allclose(part, whole, rtol=1e-12)
    assert whole[0][0] > 5e-6 and whole[1][0] > 50e-6
    assert answer.cost.unknowns > 3000


def test_deck_says_the_problem() -> None:
    asked = ask(strip(), np.array([5e3, 10e3]))
    text = peer_calculix.deck(asked)
    blocks = [block.splitlines() for block in text.split("*")]
    named = {block[0]: block[1:] for block in blocks if block}
    assert len(named["NODE, NSET=ALL"]) == len(asked.nodes)
    tip = named["NODE, NSET=ALL"][np.argmax(asked.nodes[:, 0])].split(",")
    assert float(tip[1]) == pytest.approx(6.5)  # mm
    laws = [block[1] for block in blocks if block and "HYPERELASTIC" in block[0]]
    assert len(laws) == 2
    for law, shear in zip(laws, np.unique(asked.shear), strict=True):
        c10, d1 = map(float, law.split(","))
        assert c10 == pytest.approx(shear / 2)
        assert 2 / d1 == pytest.approx(asked.bulk[asked.shear == shear][0])
    elements = [
        number
        for block in blocks
        if block and block[0].startswith("ELEMENT")
        for number in " ".join(block[1:]).replace(",", " ").split()
    ]
    table = np.array(elements, dtype=int).reshape(-1, 21)
    order = np.argsort(table[:, 0])
    assert (table[order, 1:] - 1 == asked.cells).all()
    assert len(named["BOUNDARY"]) == asked.fixed.sum()
    loads = [block[1:] for block in blocks if block and block[0] == "DLOAD"]
    assert [float(step[0].split(",")[2]) for step in loads] == [10e3]  # a ramp
    assert named["STATIC"][0].split(", ")[:2] == ["1.", "2."]
    assert len(loads[0]) == np.count_nonzero(asked.wet.any(axis=0))
    assert max(map(len, text.splitlines())) <= 132


PRINTED = """
 displacements (vx,vy,vz) for set ALL and time  0.5000000E+00

         1  0.000000E+00  0.000000E+00  1.000000E-03
         2  2.000000E-03  0.000000E+00  0.000000E+00

 displacements (vx,vy,vz) for set ALL and time  0.1000000E+01

         1  0.000000E+00  0.000000E+00  3.000000E-03
         2 -4.000000E-03  0.000000E+00  0.000000E+00
"""


def test_printed_displacements_are_read() -> None:
    """At the end of steps alone, in m."""
    tables = peer_calculix.displacements(PRINTED, 2)
    assert list(tables) == [1]
    np.testing.assert_allclose(tables[1], [[0, 0, 3e-6], [-4e-6, 0, 0]])


def test_a_torn_table_is_refused() -> None:
    with pytest.raises(peer_calculix.PeerFailed, match="1 of 2 nodes"):
        peer_calculix.displacements(PRINTED.rpartition("2 -4")[0], 2)
    with pytest.raises(peer_calculix.PeerFailed, match="out of order"):
        peer_calculix.displacements(PRINTED.replace(" 1  0.0", " 3  0.0"), 2)


def test_iterations_are_counted() -> None:
    history = (
        "SUMMARY OF C0NVERGENCE INFORMATION\n  STEP   INC  ATT   ITER     CONT.\n"
        "     1     1     1     1        0  0.9768E+04  0.1000E+03\n"
        "     1     1     1     2        0  0.1688E+04  0.7953E+01\n"
        "     2     1     1     1        0  0.1583E+04  0.1657E+02\n"
    )
    assert peer_calculix.count_iterations(history) == 3


def test_files_keep_what_they_carry(tmp_path: Path) -> None:
    asked = replace(cube(1e3, 1e6, 2e7), weight=9.81e3)
    asked.write(tmp_path / "question.npz")
    again = Question.read(tmp_path / "question.npz")
    assert (again.wet == asked.wet).all() and (again.cells == asked.cells).all()
    assert (again.second, again.weight, again.plain) == (0.0, 9.81e3, False)
    answer = Answer(np.ones((1, 2, 3)), Cost(1.5, 1.4, 4, 3, 2, {"program": "1.0"}))
    answer.write(tmp_path / "answer.npz")
    assert Answer.read(tmp_path / "answer.npz").cost == answer.cost


def check_cube(answer: Answer, asked: Question, shear: float, bulk: float) -> None:
    law = asked.second, asked.inverse_limit
    for u, pressure in zip(answer.displacement, asked.pressure, strict=True):
        along, across = stretches(float(pressure), shear, bulk, *law)
        far = u[np.argmin(np.abs(asked.nodes - 1e-3).sum(axis=1))] / 1e-3
        np.testing.assert_allclose(far, [along - 1, across - 1, across - 1], rtol=1e-4)


SHEAR, BULK, PRESSURE = 0.8e6, 8e6, 0.4e6
"""Pa; a fifth of the cube's length is pressed away, where laws tell apart."""


@pytest.mark.skipif(shutil.which("ccx") is None, reason="ccx is not installed")
def test_calculix_has_the_law_and_the_load() -> None:
    asked = cube(PRESSURE, SHEAR, BULK)
    answer = peer_calculix.solve(asked)
    check_cube(answer, asked, SHEAR, BULK)
    assert answer.cost.versions["linear solver"] in ("SPOOLES", "PARDISO", "PASTIX")
    assert 2 < answer.cost.iterations < 100


needs_felupe = pytest.mark.skipif(
    not FELUPE.exists(),
    reason="neither make bench-fem nor make foreign has installed FElupe",
)


def felupe_says(asked: Question, folder: Path) -> Answer:
    """FElupe's answer, from its own environment."""
    question, answer = folder / "question.npz", folder / "answer.npz"
    asked.write(question)
    command = [str(FELUPE), "-m", "benchmarks.peer_felupe", str(question), str(answer)]
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return Answer.read(answer)


@needs_felupe
@pytest.mark.parametrize(
    "law",
    [{}, {"second": 0.3}, {"inverse_limit": 0.5}],
    ids=["plain", "second", "gent"],
)
def test_felupe_has_the_law_and_the_load(law: dict[str, Any], tmp_path: Path) -> None:
    asked = replace(cube(PRESSURE, SHEAR, BULK), **law)
    check_cube(felupe_says(asked, tmp_path), asked, SHEAR, BULK)


@needs_felupe
def test_felupe_weighs_what_it_solves(tmp_path: Path) -> None:
    """A cube on rollers, nu = 0, hardly pressed: rho g h^2 / 2E shorter, E = 2 mu."""
    weight = 10 * SHEAR
    asked = replace(cube(1e-3, SHEAR, 2 * SHEAR / 3), weight=weight)
    u = felupe_says(asked, tmp_path).displacement[-1]
    top = asked.nodes[:, 2] > 0.99e-3
    np.testing.assert_allclose(u[top, 2], -weight * 1e-6 / (4 * SHEAR), rtol=0.01)


def test_calculix_refuses_other_laws() -> None:
    with pytest.raises(peer_calculix.PeerFailed, match="pressure alone"):
        peer_calculix.solve(replace(cube(1e3, SHEAR, BULK), second=0.1))


def test_a_missing_calculix_is_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(peer_calculix.PeerFailed, match="not installed"):
        peer_calculix.solve(cube(PRESSURE, SHEAR, BULK))
