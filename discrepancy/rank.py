"""Which effect is missing: fit every candidate, weigh them, and say what can be said.

The order of work: the baseline and one solve of each candidate along each of its
parameters; fits with the interpolated curves; more solves where a contender's best fit
lies away from what has been solved; pairs of the best with every other; probabilities;
ties, held-out devices and the verdict.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .evidence import Fit, Hypothesis, fit
from .hypotheses import Null, Present
from .study import Study
from .weighing import nearest, probabilities, sound, weigh

Array = np.ndarray

CLAIM = 0.05
"""Largest probability of "nothing is missing" at which something is said to be."""

SEPARATED = math.log(20.0)
"""Log odds at which one hypothesis is named and another is not."""

SAME_FIT = 4.0
"""Chi-square by which a tied hypothesis may fit worse: odds that come from the widths
of priors alone do not name a hypothesis."""

CONTENDER = 12.0
"""Log evidence behind the best at which a candidate is still refined."""

CURVED = 0.5
"""Departure from the nearest solve's tangent, in noise, that asks for another solve."""

UNSEEN = 0.1
"""Largest change, in noise, of an effect that the readings cannot show."""

GAIN = 6.0
"""Chi-square that a second effect has to take away for a pair to be weighed."""

ROUNDS, JOINT_ROUNDS, QUICK_ROUNDS = 3, 2, 10
"""Refinements of a contender, of a pair, and of either where solves cost nothing."""

PARTNERS, PAIRS = 3, 4
"""Singles that are paired with all others, and pairs that are solved."""

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
    tied_with : tuple of str
        Names of the hypotheses that these readings do not tell from it.
    """

    fit: Fit
    probability: float
    heldout_error: float = math.nan
    tied_with: tuple[str, ...] = ()

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
    solves : bool
        Whether to solve at all; False ranks with what the study has.
    details : bool
        Whether to hold devices out and draw the confusion matrix.
    """

    study: Study
    seed: int = 0
    solves: bool = True
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
        if self.solves:
            self._solve_first(names)
        return [name for name in names if self._shown(name)]

    def _solve_first(self, names: Sequence[str]) -> None:
        """One solve along each parameter, of a smaller effect where paths end early."""
        study = self.study
        open_ones = [(name, t) for name in names for t in study.first(name)]
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
        moved = present.curves.values - present.curves.values[0]
        seen = float(np.abs(moved / self.study.readings.noise).max()) >= UNSEEN
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

    def refine(self, fits: list[Fit]) -> list[Fit]:
        """Solve contenders at their best fits until their curves are known there."""
        rounds = QUICK_ROUNDS if self.study.quick else ROUNDS
        for _ in range(rounds if self.solves else 0):
            best = max(one.log_evidence for one in fits)
            wanted = [
                one
                for one in fits
                if isinstance(one.hypothesis, Present)
                and one.log_evidence > best - CONTENDER
                and self._curved(one.hypothesis, one.t)
            ]
            if not wanted:
                break
            found = self.study.solve(
                [(_effects(one), one.t) for one in wanted], "the contenders"
            )
            lost = [one for one, node in zip(wanted, found, strict=True) if not node]
            if lost:  # half way to where a path ended early
                self.study.solve(
                    [(_effects(one), self._half_way(one)) for one in lost],
                    "the contenders",
                )
            fresh = {one.hypothesis.name: self._again(one) for one in wanted}
            fits = [fresh.get(one.hypothesis.name, one) for one in fits]
        return fits

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
        promising = promising[:PAIRS]
        rounds = QUICK_ROUNDS if study.quick else JOINT_ROUNDS
        for _ in range(rounds if self.solves else 0):
            found = study.solve(
                [(_effects(one), one.t) for one in promising], "pairs of effects"
            )
            promising = [
                one if node is None else self._again(one)
                for one, node in zip(promising, found, strict=True)
            ]
        return promising

    @staticmethod
    def _joined(present: Present, known: dict[str, Fit]) -> Array:
        """Coordinates of the single fits together."""
        return np.concatenate([known[name].t for name in present.effects])


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
    order = np.argsort(-shares)
    ranked = [Candidate(whole[i], float(shares[i])) for i in order]

    ties = tied(ranked)
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
    verdict, effects = _verdict(ranked, ties)
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
    named = [one for one in ranked if one.effects and not one.unnamed]
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


def left_out(one: Fit) -> Array:
    """(n,) residuals, over the noise, of devices left out one at a time.

    Calibrations that a left-out device shares (batch moduli) are those of the others;
    its own (thickness, camera) are at their stated values.  NaN where there is but one
    device.
    """
    readings = one.readings
    residuals = np.full(len(readings.value), np.nan)
    for device in np.unique(readings.device):
        out = readings.device == device
        if out.all():
            break
        same = set(readings.group[~out]) == set(readings.group)
        others = fit(
            readings,
            one.hypothesis,
            keep=~out,
            starts=[one.t],
            eta=one.eta if same else None,
            fixed=same,  # one device hardly moves the amplitudes of all
            evidence=False,
        )
        residuals[out] = (readings.value - others.predict())[out] / one.noise[out]
    return residuals


def held_out(one: Fit) -> float:
    """Root mean square of `left_out`; NaN where there is but one device."""
    return float(np.sqrt(np.mean(left_out(one) ** 2)))


def noise_floor(one: Fit) -> float:
    """Held-out error that the right physics would have.

    Independent noise, smooth errors inside a curve, and the tolerances of a device that
    was not measured: what is expected of the residual when a hypothesis is true.
    """
    readings = one.readings
    smooth = one.amplitude("smooth")
    own = np.array([smooth.get(int(g), 0.0) for g in readings.group]) * readings.scale
    columns = one.hypothesis.predict(one.t).columns
    # Moduli are shared, and known from the other devices; the rest is the device's own.
    shared = np.array(
        [
            len(np.unique(readings.device[np.abs(column) > 0])) > 1
            for column in columns.T
        ],
        dtype=bool,
    )
    tolerance = (columns[:, ~shared] ** 2).sum(axis=1)
    variance = 1 + (own**2 + tolerance) / one.noise**2
    return float(np.sqrt(variance.mean()))


def confusion(
    ranked: Sequence[Candidate], candidates: int, seed: int, draws: int = 400
) -> tuple[tuple[str, ...], Array]:
    """How readings like these would be named if each hypothesis in turn were true.

    Errors are drawn around the best fit of each; every other hypothesis is taken where
    it comes nearest (`evidence.nearest`), with the width of its prior as in the fits.
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
