"""What fitted hypotheses say: probabilities, a second judge, ties and the verdict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .evidence import Fit, fit
from .heldout import explained, held_out, noise_floor
from .hypotheses import Null
from .noise import LARGE_SMOOTH
from .study import Study
from .target import Hypothesis
from .weighing import nearest, probabilities, sound

Array = np.ndarray

CLAIM = 0.05
"""Largest probability of "nothing is missing" at which something is said to be."""

SEPARATED = math.log(20.0)
"""Log odds at which one hypothesis is named and another is not."""

SAME_FIT = 4.0
"""Chi-square by which a tied hypothesis may fit worse: odds that come from the widths
of priors alone do not name a hypothesis."""

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


def effects_of(one: Fit) -> tuple[str, ...]:
    """Names of the effects that act in a fitted hypothesis."""
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
    count = max(len([f for f in fits if len(effects_of(f)) == 1]), 1)

    def weight(one: Fit) -> float:
        return one.log_evidence + log_prior(one.hypothesis, count)

    named = sorted((f for f in fits if effects_of(f)), key=weight, reverse=True)
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
    whole = [*fits, *sound(study.readings, remainders, seed)]
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
    # Hypotheses infer noises of their own where none is stated: one for all of them.
    noise = max(fits, key=lambda one: one.log_evidence).noise
    errors = {one.name: held_out(one.fit, noise) for one in shown if details}
    ranked = [
        replace(one, heldout_error=errors.get(one.name, math.nan)) for one in ranked
    ]
    names, matrix = confusion(ranked if details else [], count, seed)
    return Ranking(
        verdict=verdict,
        effects=effects,
        candidates=tuple(ranked),
        baseline_error=errors.get("nothing", math.nan),
        noise_floor=noise_floor(ranked[0].fit, noise),
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
