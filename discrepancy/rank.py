"""Which effect is missing: fit every candidate, weigh them, and say what can be said.

The order of work: derivatives by all effects where they are off, from a solve or two of
each curve; a solve of finite size of effects that have none or turn away from theirs,
on the side that the readings ask for; fits with the interpolated curves; solves at the
best fits of contenders until their curves are known there; pairs of the best with every
other; probabilities; ties, held-out devices and the verdict.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .evidence import Fit, Hypothesis, fit
from .heldout import explained, held_out, noise_floor
from .hypotheses import Null, Present
from .noise import LARGE_SMOOTH
from .study import Study
from .weighing import HOPELESS, nearest, probabilities, sound, weigh

Array = np.ndarray

CLAIM = 0.05
"""Largest probability of "nothing is missing" at which something is said to be."""

SEPARATED = math.log(20.0)
"""Log odds at which one hypothesis is named and another is not."""

SAME_FIT = 4.0
"""Chi-square by which a tied hypothesis may fit worse: odds that come from the widths
of priors alone do not name a hypothesis."""

CURVED = 0.5
"""Departure from the nearest solve's tangent, in noise, that asks for another solve."""

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

EXPLAINED = 0.5
"""Part of the error on left-out devices that effects have to take away (`explained`)
where they leave smooth errors above `LARGE_SMOOTH`: those are no errors, but something
else that is missing."""

JUDGED = 0.01
"""Probability from which on a hypothesis is held to that."""

SHARES = {"nothing": 0.5, "unknown": 0.05, "single": 0.35, "pair": 0.1}
"""Prior probabilities: of nothing, of an effect without a name, of all single effects
and of all pairs together."""


@dataclass(frozen=True)
class Candidate:
    """A hypothesis, what the readings say of it, and how probable it is.

    Parameters
    ----------
    fit : Fit
    probability : float
    heldout_error : float
        Root mean square of residuals on devices that were left out, over the noise;
        NaN where it was not computed.
    explained : float
        Share of the error on left-out devices that it explains (`heldout.explained`);
        NaN where the readings did not ask for this second judge.
    overruled : bool
        True where that is too little: an effect without a name has its probability.
    tied_with : tuple of str
        Under the verdict ``tied``: the hypotheses that these readings do not tell
        from it.  Under others candidates are alike because none of them is needed.
    """

    fit: Fit
    probability: float
    heldout_error: float = math.nan
    tied_with: tuple[str, ...] = ()
    explained: float = math.nan
    overruled: bool = False

    @property
    def name(self) -> str:
        return self.fit.hypothesis.name

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects that act; empty for "nothing" and "unknown"."""
        return tuple(getattr(self.fit.hypothesis, "effects", ()))

    @property
    def unnamed(self) -> bool:
        """True where a part of the hypothesis is an effect without a name."""
        return bool(self.fit.hypothesis.common)


@dataclass(frozen=True)
class Ranking:
    """The answer to "which effect is missing".

    Parameters
    ----------
    verdict : str
        ``adequate``, ``identified``, ``tied`` or ``unexplained``.
    effects : tuple of str
        Names the verdict speaks of: of an effect, or of a pair joined by ``+``.
    candidates : tuple of Candidate
        Best first.
    baseline_error, noise_floor : float
        Held-out error of the baseline, and that of a model with the right physics.
    confusion : (c, c) array
        Probability that readings like these, made by the hypothesis of the row, would
        be said to come from that of the column.
    confused : tuple of c str
        Names of the rows and columns.
    unjudged : dict of str to str
        Candidates that these readings cannot show, and why.
    warnings : tuple of str
    """

    verdict: str
    effects: tuple[str, ...]
    candidates: tuple[Candidate, ...]
    baseline_error: float
    noise_floor: float
    confusion: Array
    confused: tuple[str, ...]
    unjudged: dict[str, str]
    warnings: tuple[str, ...]

    @property
    def best(self) -> Candidate:
        return self.candidates[0]

    @property
    def nearest(self) -> Candidate | None:
        """The named effects with the largest evidence, overruled or not."""
        named = [one for one in self.candidates if one.effects and not one.unnamed]
        return max(named, key=lambda one: one.fit.log_evidence, default=None)

    def candidate(self, name: str) -> Candidate:
        """A candidate by name."""
        return next(one for one in self.candidates if one.name == name)


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
                if self._curved(present, one.t)
            ]
            if not wanted:
                break
            found = self.study.solve([(_effects(one), one.t) for one in wanted], what)
            lost = [
                one for one, node in zip(wanted, found, strict=True) if node is None
            ]
            if lost:  # half way to where a path ended early
                self.study.solve(
                    [(_effects(one), self._half_way(one)) for one in lost], what
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

    def _curved(self, hypothesis: Present, t: Array) -> bool:
        """Whether the interpolated curves at t are more than the nearest tangent."""
        curves = hypothesis.curves
        if curves.distance(t) < 1e-3:
            return False
        if len(curves.nodes) == 1:  # a tangent, which knows nothing of its bend
            moved = curves.many(t[None, :])[0] - curves.values[0]
            return bool(np.abs(moved / self.study.readings.noise).max() > STRAIGHT)
        gap = np.abs((curves.nodes - t) / curves.span).max(axis=1)
        at = int(np.argmin(gap))
        slopes = np.nan_to_num(curves.slopes[at])
        line = curves.values[at] + slopes @ (t - curves.nodes[at])
        lack = np.abs(curves.many(t[None, :])[0] - line) / self.study.readings.noise
        unknown_slope = not np.isfinite(curves.slopes[at]).all()
        return bool(lack.max() > CURVED) and (not unknown_slope or gap[at] > 0.02)

    def _again(self, one: Fit) -> Fit:
        present = self.study.present(_effects(one))
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
            (one for one in fits if len(_effects(one)) == 1),
            key=lambda one: -one.log_evidence,
        )
        best = max(one.log_evidence for one in fits)
        known = {one.hypothesis.name: one for one in singles}
        chosen = {
            tuple(sorted((a.hypothesis.name, b)))
            for a, b in itertools.product(singles[:PARTNERS], known)
            if a.hypothesis.name != b
        }
        tried = []
        for names in sorted(chosen):
            present = study.present(names)
            if present is None:
                continue
            better = min((known[name] for name in names), key=lambda one: one.misfit)
            quick = fit(
                study.readings,
                present,
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


def _effects(one: Fit) -> tuple[str, ...]:
    return tuple(getattr(one.hypothesis, "effects", ()))


def log_prior(one: Hypothesis, candidates: int) -> float:
    """Log prior probability of a hypothesis among those of a catalogue."""
    names = tuple(getattr(one, "effects", ()))
    if not names:
        return math.log(SHARES["unknown" if one.common else "nothing"])
    if len(names) == 1:
        share = SHARES["single"] / candidates
    else:
        share = SHARES["pair"] / max(candidates * (candidates - 1) / 2, 1)
    return math.log(share * (SHARES["unknown"] if one.common else 1.0))


def judge(
    study: Study,
    fits: Sequence[Fit],
    unjudged: dict[str, str],
    seed: int = 0,
    details: bool = True,
) -> Ranking:
    """Probabilities, ties, held-out devices and the verdict from fits."""
    count = max(len([f for f in fits if len(_effects(f)) == 1]), 1)

    def weight(one: Fit) -> float:
        return one.log_evidence + log_prior(one.hypothesis, count)

    named = sorted((f for f in fits if _effects(f)), key=weight, reverse=True)
    # The best that has a name may still leave something that has none.
    remainders = [
        fit(
            study.readings,
            replace(
                f.hypothesis, name=f"{f.hypothesis.name}+unknown", common=_shapes(fits)
            ),  # type: ignore[type-var]
            starts=[f.t],
            seed=seed,
        )
        for f in named[:2]
    ]
    whole = [*fits, *remainders]
    logs = np.array([one.log_evidence for one in whole])
    priors = np.array([log_prior(one.hypothesis, count) for one in whole])
    shares = probabilities(logs, priors)
    weighed = zip(whole, map(float, shares), strict=True)
    ranked = second_judge([Candidate(one, share) for one, share in weighed])
    ranked.sort(key=lambda one: -one.probability)

    ties = tied(ranked)
    verdict, effects = _verdict(ranked, ties)
    if verdict == "tied":
        ranked = [
            replace(one, tied_with=tuple(n for n in ties if n != one.name))
            if one.name in ties
            else one
            for one in ranked
        ]
    shown = [one for i, one in enumerate(ranked) if i < 6 or one.name == "nothing"]
    errors = {one.name: held_out(one.fit) for one in shown if details}
    ranked = [
        replace(one, heldout_error=errors.get(one.name, math.nan)) for one in ranked
    ]
    names, matrix = confusion(ranked if details else [], count, seed)
    return Ranking(
        verdict=verdict,
        effects=effects,
        candidates=tuple(ranked),
        baseline_error=errors.get("nothing", math.nan),
        noise_floor=noise_floor(ranked[0].fit),
        confusion=matrix,
        confused=names,
        unjudged=dict(unjudged),
        warnings=tuple(study.warnings),
    )


def second_judge(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Overrule named hypotheses that leave more than they explain.

    Smooth errors can swallow what a hypothesis does not explain, at a price that the
    other hypotheses pay as well.  Where they are larger than such errors are, the
    hypothesis has to show on devices that were left out that it explains the better
    part.  One that does not is at best a part of what is missing: its probability goes
    to an effect without a name.
    """
    nothing = next(one.fit for one in candidates if one.name == "nothing")
    found, moved = [], 0.0
    for one in candidates:
        named = one.effects and not one.unnamed and one.probability > JUDGED
        left = max(one.fit.amplitude("smooth").values(), default=0.0)
        if named and left > LARGE_SMOOTH:
            share = explained(one.fit, nothing)
            one = replace(one, explained=share, overruled=share < EXPLAINED)
        if one.overruled:
            moved += one.probability
            one = replace(one, probability=0.0)
        found.append(one)
    return [
        replace(one, probability=one.probability + moved)
        if one.name == "unknown"
        else one
        for one in found
    ]


def _shapes(fits: Sequence[Fit]) -> tuple[Array, ...]:
    return next(
        one.hypothesis.common
        for one in fits
        if isinstance(one.hypothesis, Null) and one.hypothesis.common
    )


def tied(ranked: Sequence[Candidate]) -> tuple[str, ...]:
    """Names that the readings do not tell from the best named hypothesis.

    Those within `SEPARATED` in log odds, and those that fit as well within `SAME_FIT`;
    what only adds an effect to the best one is not tied with it.
    """
    named = [
        one for one in ranked if one.effects and not (one.unnamed or one.overruled)
    ]
    if not named:
        return ()
    best = named[0]
    found = [best.name]
    for one in named[1:]:
        if set(one.effects) > set(best.effects):
            continue
        odds = math.log(max(best.probability, 1e-300) / max(one.probability, 1e-300))
        worse = one.fit.misfit - best.fit.misfit
        simpler = len(one.effects) <= len(best.effects)
        if odds < SEPARATED or (worse < SAME_FIT and simpler):
            found.append(one.name)
    return tuple(found)


def _verdict(
    ranked: Sequence[Candidate], ties: tuple[str, ...]
) -> tuple[str, tuple[str, ...]]:
    nothing = sum(one.probability for one in ranked if one.name == "nothing")
    unnamed = sum(one.probability for one in ranked if one.unnamed)
    if nothing > CLAIM or not ties:
        return ("adequate" if nothing > CLAIM else "unexplained"), ()
    if unnamed > 0.5:
        return "unexplained", ()
    return ("identified" if len(ties) == 1 else "tied"), ties


def confusion(
    ranked: Sequence[Candidate], candidates: int, seed: int, draws: int = 400
) -> tuple[tuple[str, ...], Array]:
    """How readings like these would be named if each hypothesis in turn were true.

    Errors are drawn around the best fit of each; every other hypothesis is taken where
    it comes nearest (`weighing.nearest`), with the width of its prior as in the fits.
    Effects without a name are left out: they have no best fit to draw from.

    Returns
    -------
    names : tuple of c str
    matrix : (c, c) array; rows sum to one
    """
    shown = [one for one in ranked if not one.unnamed][:8]
    rng = np.random.default_rng(seed)
    occam = np.array(
        [
            one.fit.log_evidence
            + 0.5 * one.fit.misfit
            + log_prior(one.fit.hypothesis, candidates)
            for one in shown
        ]
    )
    matrix = np.zeros((len(shown), len(shown)))
    for i, truth in enumerate(shown):
        lacks = []
        for j, other in enumerate(shown):
            start = [other.fit.t]
            lack = nearest(truth.fit, other.fit.hypothesis, start)[1]
            lacks.append(np.zeros_like(lack) if i == j else lack)
        shift = np.stack(lacks)
        z = rng.standard_normal((draws, shift.shape[1]))
        # |z + d|^2 less |z|^2, which all hypotheses share.
        score = -(z @ shift.T) - 0.5 * (shift**2).sum(axis=1) + occam
        score -= score.max(axis=1, keepdims=True)
        share = np.exp(score)
        matrix[i] = (share / share.sum(axis=1, keepdims=True)).mean(axis=0)
    return tuple(one.name for one in shown), matrix
