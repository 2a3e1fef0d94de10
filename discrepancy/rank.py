"""Which effect is missing: the search that solves and fits every candidate.

The order of work: derivatives by all effects where they are off, from a solve or two of
each curve; a solve of finite size of effects that have none or turn away from theirs,
on the side that the readings ask for; fits with the interpolated curves; solves at the
best fits of contenders until their curves are known there; pairs of the best with every
other.  What the fits say is for `judging`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from .evidence import Fit, fit
from .hypotheses import Present
from .judging import Ranking, effects_of, judge
from .noise import Frame
from .study import Study
from .target import Hypothesis
from .weighing import HOPELESS, sound, weigh

Array = np.ndarray

CURVED = 0.5
"""Departure from the nearest solve's tangent, in noise, that asks for another solve."""

NEAR = 0.1
"""Distance of a best fit from the nearest solve, in ranges, above which it is solved:
far from all solves the interpolation and the tangent agree, and both may be wrong."""

STRAIGHT = 1.0
"""Largest change, in noise, at which the tangent where an effect is off will do."""

BENT = 0.25
"""Departure of an effect from its tangent (`Study.bends`) at which the tangent says
little of what larger sizes do to other devices."""

ROUGH = 0.7
"""Departure above which a tangent says nothing."""

SHARE = 0.5
"""Part of the misfit that the best tangent takes away which another has to take away
to be solved: signatures turn with size, but not to something else."""

UNSEEN = 0.1
"""Largest change, in noise, of an effect that the readings cannot show."""

GAIN = 6.0
"""Chi-square that an effect has to take away from nothing's to be refined, and a second
one from the first's for a pair to be weighed."""

ROUNDS, JOINT_ROUNDS, QUICK_ROUNDS = 4, 2, 10
"""Refinements of a contender, of a pair, and of either where solves cost nothing."""

PARTNERS, PAIRS = 3, 4
"""Singles that are paired with all others, and pairs that are solved."""


@dataclass
class Search:
    """The work of a ranking on one study.

    Parameters
    ----------
    study : Study
    seed : int
        Of the samples behind the evidence.
    details : bool
        Whether to hold devices out and draw the confusion matrix.
    """

    study: Study
    seed: int = 0
    details: bool = True
    unjudged: dict[str, str] = field(default_factory=dict)

    def run(self) -> Ranking:
        """Solve, fit, weigh and judge."""
        singles = self.solve_singles()
        fits = self.weigh_singles(singles)
        fits = self.refine(fits)
        fits += self.pairs(fits)
        fits = sound(self.study.readings, fits, self.seed)
        return judge(self.study, fits, self.unjudged, self.seed, self.details)

    # -- solves --------------------------------------------------------------------

    def solve_singles(self, among: Sequence[str] | None = None) -> list[str]:
        """First solves of candidates, of all or of some; those that can be judged."""
        study = self.study
        among = list(study.effects) if among is None else among
        for name in among:
            why = study.blind(name)
            if why:
                self.unjudged[name] = why
        names = [name for name in among if name not in self.unjudged]
        ready = [] if study.quick else study.tangents(names)
        tangents = {name: self._tangent(study.present((name,))) for name in ready}
        bends = study.bends({name: one.t for name, one in tangents.items()})
        open_ones = self._open(tangents, bends)
        self._solve_first(
            {
                name: tangents[name].t if name in tangents else None
                for name in names
                if name not in tangents or name in open_ones
            }
        )
        return [name for name in names if self._shown(name)]

    def _tangent(self, hypothesis: Hypothesis | None) -> Fit:
        """A fit by tangents alone: where the readings ask an effect to go."""
        assert hypothesis is not None
        return fit(self.study.readings, hypothesis, evidence=False)

    def _open(
        self, tangents: Mapping[str, Fit], bends: Mapping[str, float]
    ) -> list[str]:
        """Effects whose tangent does not say what larger sizes take from the misfit."""
        study = self.study
        nothing, unknown = (self._tangent(h) for h in (study.null(), study.unknown()))
        gains = {
            name: max(nothing.misfit - one.misfit, 0.0)
            for name, one in tangents.items()
        }
        most = max(nothing.misfit - unknown.misfit, *gains.values(), 0.0)
        least = max(GAIN, SHARE * most)
        return [
            name
            for name, bend in bends.items()
            if bend > ROUGH
            or (bend >= BENT and could_take(gains[name], bend, most) >= least)
        ]

    def _solve_first(self, toward: Mapping[str, Array | None]) -> None:
        """First solves, of smaller effects where paths end early."""
        study = self.study
        open_ones = [(n, t) for n, aim in toward.items() for t in study.first(n, aim)]
        for _ in range(4):
            found = study.solve([((n,), t) for n, t in open_ones], "one effect each")
            again = []
            for (name, t), node in zip(open_ones, found, strict=True):
                if node is None:  # a path ended early: a smaller effect
                    off = np.array([p.off for p in study.priors((name,))])
                    again.append((name, off + (t - off) / 3))
            open_ones = again
            if not again:
                break

    def _shown(self, name: str) -> bool:
        """Whether the readings can show an effect; why not is noted."""
        present = self.study.present((name,))
        if present is None:
            self.unjudged[name] = "its paths end before the measured pressures"
            return False
        moved = present.curves.changes() / self.study.readings.noise
        seen = float(moved.max()) >= UNSEEN
        if not seen:
            self.unjudged[name] = (
                "it moves no reading by a tenth of the noise along these paths"
            )
        return seen

    def weigh_singles(self, names: Sequence[str]) -> list[Fit]:
        study = self.study
        present = [study.present((name,)) for name in names]
        hypotheses: list[Hypothesis] = [study.null(), study.unknown()]
        hypotheses += [one for one in present if one is not None]
        return weigh(study.readings, hypotheses, self.seed)

    def refine(
        self, fits: list[Fit], what: str = "the contenders", rounds: int = ROUNDS
    ) -> list[Fit]:
        """Solve contenders at their best fits until their curves are known there."""
        rounds = QUICK_ROUNDS if self.study.quick else rounds
        for _ in range(rounds):
            wanted = [
                one
                for one, present in self._contenders(fits)
                if self._curved(one, present)
            ]
            if not wanted:
                break
            found = self.study.solve([(effects_of(one), one.t) for one in wanted], what)
            lost = [
                one for one, node in zip(wanted, found, strict=True) if node is None
            ]
            if lost:  # half way to where a path ended early
                self.study.solve(
                    [(effects_of(one), self._half_way(one)) for one in lost], what
                )
            fresh = {one.hypothesis.name: self._again(one) for one in wanted}
            fits = [fresh.get(one.hypothesis.name, one) for one in fits]
        return fits

    @staticmethod
    def _contenders(fits: Sequence[Fit]) -> list[tuple[Fit, Present]]:
        """Effects that are near the best, or may be once they are solved.

        Where "nothing is missing" is among the fits, those that take little from its
        misfit stay as they are: more solves would not make them the answer.
        """
        best = max((one.log_evidence for one in fits), default=0.0)
        least = min((one.misfit for one in fits), default=0.0)
        nothing = next(
            (one.misfit for one in fits if one.hypothesis.name == "nothing"), math.inf
        )
        found = []
        for one in fits:
            gain = nothing - one.misfit
            if not isinstance(one.hypothesis, Present) or gain < GAIN:
                continue
            tangent = len(one.hypothesis.nodes) == 1
            turning = tangent and gain > SHARE * (nothing - least)
            if turning or one.log_evidence > best - HOPELESS:
                found.append((one, one.hypothesis))
        return found

    @staticmethod
    def _half_way(one: Fit) -> Array:
        """Between a best fit and the nearest coordinates that were solved."""
        assert isinstance(one.hypothesis, Present)
        curves = one.hypothesis.curves
        gap = np.abs((curves.nodes - one.t) / curves.span).max(axis=1)
        half: Array = (one.t + curves.nodes[int(np.argmin(gap))]) / 2
        return half

    @staticmethod
    def _curved(one: Fit, hypothesis: Present) -> bool:
        """Whether the curves at a best fit are not known yet."""
        curves, t = hypothesis.curves, one.t
        gap = np.abs((curves.nodes - t) / curves.span).max(axis=1)
        at = int(np.argmin(gap))
        if gap[at] < 1e-3:
            return False
        if len(curves.nodes) == 1:  # a tangent, which knows nothing of its bend
            moved = curves.many(t[None, :])[0] - curves.values[0]
            return bool(np.abs(moved / one.noise).max() > STRAIGHT)
        if gap[at] > NEAR:
            return True
        slopes = np.nan_to_num(curves.slopes[at])
        line = curves.values[at] + slopes @ (t - curves.nodes[at])
        lack = np.abs(curves.many(t[None, :])[0] - line) / one.noise
        unknown_slope = not np.isfinite(curves.slopes[at]).all()
        return bool(lack.max() > CURVED) and (not unknown_slope or gap[at] > 0.02)

    def _again(self, one: Fit) -> Fit:
        present = self.study.present(effects_of(one))
        assert present is not None
        return fit(self.study.readings, present, starts=[one.t], seed=self.seed)

    def together(self, names: Sequence[str], known: dict[str, Fit]) -> Fit:
        """Effects at once, solved until their curves are known at the best fit.

        Starts from the fits of each of them alone.
        """
        present = self.study.present(names)
        assert present is not None
        starts = [self._joined(present, known)] if known else []
        readings = self.study.readings
        first = fit(readings, present, starts=starts, seed=self.seed)
        return sound(readings, self.refine([first]), self.seed)[0]

    def pairs(self, fits: Sequence[Fit]) -> list[Fit]:
        """Pairs of the best singles with all others, the promising ones solved."""
        study = self.study
        singles = sorted(
            (one for one in fits if len(effects_of(one)) == 1),
            key=lambda one: -one.log_evidence,
        )
        best = max(one.log_evidence for one in fits)
        known = {one.hypothesis.name: one for one in singles}
        chosen = {
            tuple(sorted((a.hypothesis.name, b)))
            for a, b in itertools.product(singles[:PARTNERS], known)
            if a.hypothesis.name != b
        }
        tried, frame = [], Frame(study.readings)
        for names in sorted(chosen):
            present = study.present(names)
            if present is None:
                continue
            better = min((known[name] for name in names), key=lambda one: one.misfit)
            quick = fit(
                study.readings,
                present,
                frame=frame,
                starts=[self._joined(present, known)],
                eta=better.eta,
                evidence=False,
            )
            if quick.misfit < better.misfit - GAIN:
                tried.append(quick)
        tried.sort(key=lambda one: one.misfit)
        weighed = [
            fit(study.readings, one.hypothesis, starts=[one.t], eta=one.eta)
            for one in tried[: 2 * PAIRS]
        ]
        promising = [one for one in weighed if one.log_evidence > best + 1.0]
        promising.sort(key=lambda one: -one.log_evidence)
        return self.refine(promising[:PAIRS], "pairs of effects", JOINT_ROUNDS)

    @staticmethod
    def _joined(present: Present, known: dict[str, Fit]) -> Array:
        """Coordinates of the single fits together."""
        return np.concatenate([known[name].t for name in present.effects])


def could_take(gain: float, bend: float, most: float) -> float:
    """Most that an effect of finite size could take from the misfit.

    A signature that turns by the angle asin(bend) takes what lies in its tangent and,
    with the turn, of what others take.  Twice the most that any tangent takes stands
    for all that could be taken: bent up to `ROUGH`, an effect of its first size has
    half of its own gain in its tangent.

    Parameters
    ----------
    gain : float
        That its tangent takes.
    bend : float
        Its turn, see `Study.bends`; at most 1.
    most : float
        That any tangent takes.
    """
    straight = math.sqrt(gain * (1 - bend**2))
    turned = bend * math.sqrt(max(2 * most - gain, 0.0))
    return (straight + turned) ** 2
