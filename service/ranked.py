"""A ranking with all that is told of it, for the command line and for jobs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from discrepancy.answer import to_json
from discrepancy.compare import Comparison, compare
from discrepancy.experiment import Proposal, next_measurement
from discrepancy.judging import Ranking
from discrepancy.measurement import Measurements
from discrepancy.rank import Search
from discrepancy.solves import Solver
from discrepancy.study import Study

from .comparison import failure_json, failure_text

SURE = 0.99
"""Probability of an effect above which nothing more has to be measured to name it."""


@dataclass(frozen=True, eq=False)
class Ranked:
    """Which effect is missing, where the model fails, and what to measure next.

    Parameters
    ----------
    study : Study
    ranking : Ranking
    proposals : tuple of Proposal
        Best first; none where nothing is left to be split.
    compared : Comparison
    seed : int
    """

    study: Study
    ranking: Ranking
    proposals: tuple[Proposal, ...]
    compared: Comparison
    seed: int

    @property
    def warnings(self) -> list[str]:
        found = [*self.study.measurements.warnings, *self.ranking.warnings]
        if self.ranking.verdict == "adequate" and self.compared.fails_where:
            found.append(
                "the test of the residuals finds places where the model fails (p-value "
                f"{self.compared.p_value:.2g}), and the odds do not: more readings "
                "would settle it"
            )
        return found

    @property
    def fails_where(self) -> list[str]:
        """Where the model fails, a sentence each."""
        return [failure_text(one, self.compared) for one in self.compared.fails_where]

    @property
    def next_words(self) -> str:
        """What to measure next, empty where nothing is proposed."""
        return self.proposals[0].words if self.proposals else ""

    def to_json(self) -> dict[str, Any]:
        """The contract's object of ``pba rank --json``."""
        where = [failure_json(one, self.compared) for one in self.compared.fails_where]
        measured = self.study.measurements
        return to_json(self.ranking, where, self.proposals) | {
            "warnings": self.warnings,
            "file_sha256": measured.sha256,
        }

    @cached_property
    def page(self) -> str:
        """The report, one HTML file."""
        from discrepancy.report import report

        return report(
            self.study,
            self.ranking,
            fails_where=" ".join(self.fails_where),
            next_measurement=self.next_words,
            seed=self.seed,
        )


def ranked(
    measured: Measurements,
    solver: Solver,
    *,
    level: str = "standard",
    effects: Sequence[str] | None = None,
    effects_dir: Path | None = None,
    seed: int = 0,
) -> Ranked:
    """Rank effects by measurements.

    Parameters
    ----------
    measured : Measurements
    solver : Solver
    level : str
        Mesh of the baseline.
    effects : sequence of str, optional
        Candidates; the whole catalogue by default.
    effects_dir : Path, optional
        Of the user's own effects.
    seed : int
        Of the samples.

    Raises
    ------
    EffectError, InputError
        When a candidate is unknown, or the model reaches no reading.
    """
    study = Study(
        measured, solver, level=level, effects=effects, effects_dir=effects_dir
    )
    ranking = Search(study, seed).run()
    sure = ranking.verdict == "identified" and ranking.best.probability > SURE
    proposals = () if sure else tuple(next_measurement(study, ranking))
    return Ranked(study, ranking, proposals, compare(study, seed), seed)
