"""From measurements to a verdict, with real solves of small studies."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from datagen.errors import EffectError
from datagen.model import Model
from discrepancy.answer import to_json
from discrepancy.emulator import Emulator
from discrepancy.evidence import fit
from discrepancy.experiment import next_measurement
from discrepancy.judging import Ranking
from discrepancy.measurement import Measurements
from discrepancy.rank import Search, could_take
from discrepancy.solves import Solver
from discrepancy.study import Study
from discrepancy.words import verdict
from tests.discrepancy.noisy import curves

PRESSURE = np.array([10e3, 25e3, 45e3])
NOISE = {"tip_deflection": 3e-6, "inflation": 2e-6}
PLANTED = -0.0005
CANDIDATES = ("cure_mismatch", "pressure_offset")


def measured(effects: dict[str, dict[str, float]]) -> Measurements:
    """Three devices of two batches, measured with noise alone."""
    model = Model(tuple(effects), "draft", effects)
    return Measurements(curves(model, PRESSURE, NOISE, seed=4))


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("solves")


@pytest.fixture(scope="module")
def study(cache: Path) -> Study:
    return Study(
        measured({"cure_mismatch": {"difference": PLANTED}}),
        Solver(1, cache),
        level="draft",
        effects=CANDIDATES,
    )


@pytest.fixture(scope="module")
def ranking(study: Study) -> Ranking:
    return Search(study).run()


def test_the_planted_effect_is_named(ranking: Ranking) -> None:
    assert (ranking.verdict, ranking.effects) == ("identified", ("cure_mismatch",))
    best = ranking.best
    assert best.name == "cure_mismatch"
    low, high = best.fit.interval(0.99)[0]
    assert low < PLANTED < high
    assert high - low < 0.3 * abs(PLANTED)
    assert best.heldout_error < 0.5 * ranking.baseline_error
    assert ranking.confusion.sum(axis=1) == pytest.approx(1.0)
    assert sum(one.probability for one in ranking.candidates) == pytest.approx(1.0)


def test_the_interpolated_curves_are_those_of_the_solver(
    study: Study, ranking: Ranking
) -> None:
    """At the best fit, which was solved, and half way to it, which was not."""
    present = study.present(("cure_mismatch",))
    assert present is not None
    for share, allowed in ((1.0, 0.05), (0.5, 0.5)):
        t = share * ranking.best.fit.t
        value = float(present.priors[0].value(t[0]))
        model = Model(
            ("cure_mismatch",), "draft", {"cure_mismatch": {"difference": value}}
        )
        solved = []
        for curve in study.measurements.curves:
            response = model([curve.design], [curve.path])
            solved.append(response)
        wanted = np.array(
            [
                solved[c].output(study.measurements.curves[c].outputs[m])[0, s]
                for c, s, m in study.cells
            ]
        )
        lack = np.abs(present.many(t[None, :])[0] - wanted) / study.readings.noise
        assert lack.max() < allowed


def test_nothing_is_claimed_where_nothing_was_planted(cache: Path) -> None:
    study = Study(measured({}), Solver(1, cache), level="draft", effects=CANDIDATES)
    ranking = Search(study).run()
    assert (ranking.verdict, ranking.effects) == ("adequate", ())
    assert "nothing has to be missing" in verdict(ranking)


def test_a_second_run_solves_nothing(cache: Path, ranking: Ranking) -> None:
    solver = Solver(1, cache)
    again = Study(
        measured({"cure_mismatch": {"difference": PLANTED}}),
        solver,
        level="draft",
        effects=CANDIDATES,
    )
    found = Search(again).run()
    assert solver.solved == 0
    assert found.best.probability == ranking.best.probability


def test_a_damaged_solve_is_solved_again(cache: Path, study: Study) -> None:
    file = sorted(cache.rglob("*.npz"))[0]
    file.write_bytes(file.read_bytes()[:100])
    solver = Solver(1, cache)
    Search(
        Study(
            measured({"cure_mismatch": {"difference": PLANTED}}),
            solver,
            level="draft",
            effects=CANDIDATES,
        )
    ).run()
    assert solver.solved == 1


def test_the_contract_of_the_answer(study: Study, ranking: Ranking) -> None:
    answer = to_json(ranking, proposals=next_measurement(study, ranking))
    json.dumps(answer, allow_nan=False)
    assert answer["verdict"] == "identified"
    assert answer["effects"] == ["cure_mismatch"]
    first = answer["ranking"][0]
    assert first["effect"] == "cure_mismatch"
    assert set(first["parameters"]["difference"]) >= {"value", "std", "unit"}
    assert answer["next_measurement"][0]["text"]
    for key in ("baseline_error", "noise_floor", "fails_where"):
        assert key in answer


def test_a_proposal_tells_the_two_apart_better(study: Study, ranking: Ranking) -> None:
    found = next_measurement(study, ranking)
    assert found == sorted(found, key=lambda one: -one.then)
    assert found[0].then > found[0].now
    assert all(0.5 <= one.probability <= 1 for one in found)


def test_curves_without_time_cannot_show_creep(cache: Path) -> None:
    study = Study(
        measured({}), Solver(1, cache), level="draft", effects=("viscoelasticity",)
    )
    ranking = Search(study).run()
    assert "time_s" in ranking.unjudged["viscoelasticity"]
    assert ranking.verdict == "adequate"


def test_an_unknown_candidate_is_named(cache: Path) -> None:
    with pytest.raises(EffectError, match="'magic' is unknown"):
        Study(measured({}), Solver(1, cache), effects=("magic",))


def test_readings_past_the_baselines_end_are_told(cache: Path) -> None:
    data = measured({})
    curve = data.curves[0]
    far = replace(
        curve,
        load=np.array([10e3, 25e3, 900e3]),
    )
    study = Study(
        Measurements((far, *data.curves[1:])),
        Solver(1, cache),
        level="draft",
        effects=(),
    )
    assert len(study.readings.value) == 16
    assert "D1" in study.warnings[0]


def test_smooth_errors_take_the_certainty(study: Study) -> None:
    """The same residuals prove less where curves may err as a whole."""
    alone = replace(study.readings, correlated=False)
    null, other = study.null(), study.present(("cure_mismatch",))
    assert other is not None

    def odds(readings: object) -> float:
        both = [fit(readings, one).log_evidence for one in (other, null)]  # type: ignore[arg-type]
        return both[0] - both[1]

    assert odds(alone) > odds(study.readings) > 3


def test_what_a_bent_effect_could_take() -> None:
    """Its tangent's share where it is straight, all of the rest where it is not."""
    assert could_take(10.0, 0.0, 50.0) == pytest.approx(10.0)
    assert could_take(0.0, 0.5, 50.0) == pytest.approx(25.0)
    assert could_take(0.0, 1.0, 50.0) == pytest.approx(100.0)
    assert could_take(50.0, 0.6, 50.0) == pytest.approx(98.0)
    assert could_take(0.0, 0.7, 0.0) == 0.0


def test_a_best_fit_far_from_all_solves_is_solved() -> None:
    """Where interpolation and tangent agree far away, both may be wrong."""
    nodes = np.array([[0.0], [0.8]])
    slopes = np.full((2, 1, 1), 10.0)
    curves = Emulator(nodes, 10.0 * nodes, slopes, np.ones(1))
    present = SimpleNamespace(curves=curves)

    def curved(t: float) -> bool:
        one = SimpleNamespace(t=np.array([t]), noise=np.full(1, 0.1))
        return Search._curved(one, present)  # type: ignore[arg-type]

    line = curves.many(np.array([[0.4]]))[0, 0]
    assert line == pytest.approx(4.0, abs=0.05)
    assert curved(0.4)
    assert not curved(0.8) and not curved(0.77)
