"""Adopt effects: put them into the model, fitted, and see how far the error falls.

Each effect is solved alone, then all together, until the curves of the best fit are
known there; what follows is the posterior of their parameters, the ladder of held-out
errors, and the corrected curves by finite elements at the posterior mean.  The fit
does not depend on the order in which effects are named; the ladder's rungs do.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from datagen.effects import Effect
from datagen.errors import EffectError, InputError

from .answer import parameters_of
from .evidence import Fit, fit
from .heldout import floor_interval, left_out, noise_floor
from .judging import Candidate
from .ladder import BASELINE, RECALIBRATED, Rung, ladder
from .measurement import Measurements
from .paths import Paths
from .rank import Search
from .study import Study
from .words import BEYOND

Array = np.ndarray

SAMPLES = 200
"""Equally weighted samples of the posterior that are kept."""

APART = 1.0
"""Largest distance, in noise, of the fit's curves from the finite elements at the
posterior mean that goes without a warning."""


@dataclass(frozen=True, eq=False)
class Adoption:
    """Effects in the model, and what the measurements say of it.

    Parameters
    ----------
    study : Study
    effects : tuple of str
        In the order in which they were adopted.
    baseline : Fit
        That nothing is missing: calibrations alone.
    fit : Fit
        With all effects.
    ladder : tuple of Rung
        Baseline, recalibrated, each effect in turn, noise floor.
    interval : str
        How its intervals were made, see `ladder.Judged.method`.
    corrected : (n,) array, SI
        Readings by finite elements at the posterior mean and the stated designs, on
        the study's mesh; NaN where a path ends before.
    warnings : tuple of str
        One line each.
    seed : int
    """

    study: Study
    effects: tuple[str, ...]
    baseline: Fit
    fit: Fit
    ladder: tuple[Rung, ...]
    interval: str
    corrected: Array
    warnings: tuple[str, ...]
    seed: int

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters as ``effect.parameter``, in the order of the numbers below."""
        return tuple(p.parameter.name for p in self.fit.hypothesis.priors)

    @property
    def mean(self) -> Array:
        """(k,) posterior means, SI."""
        return self.fit.mean()

    @property
    def covariance(self) -> Array:
        """(k, k) posterior covariance, SI."""
        apart = self.fit.values() - self.mean
        product: Array = (apart * self.fit.weights[:, None]).T @ apart
        return product

    @cached_property
    def samples(self) -> Array:
        """(`SAMPLES`, k) equally weighted samples of the posterior, SI."""
        chosen = resampled(self.fit.weights, SAMPLES, self.seed)
        samples: Array = self.fit.values()[chosen]
        return samples

    @property
    def parameters(self) -> dict[str, dict[str, Any]]:
        """Of each parameter its value, std, unit and range, as in a ranking."""
        return parameters_of(Candidate(self.fit, 1.0))

    @property
    def heldout_error(self) -> float:
        """With all effects."""
        return self.ladder[-2].heldout_error


def adopt(study: Study, effects: Sequence[str], seed: int = 0) -> Adoption:
    """Fit effects to a study's readings, all together, and judge each step.

    Parameters
    ----------
    study : Study
        Whose candidates hold the effects.
    effects : sequence of str
        The order is that of the ladder.
    seed : int
        Of the samples.

    Raises
    ------
    EffectError
        When an effect is no candidate of the study.
    InputError
        When none is given, one twice, or the readings cannot show one.
    """
    search = Search(study, seed)
    notes = _first_solves(search, effects)
    # Solved in an order of their own, and all together before some of them, so that
    # what the whole fit knows does not depend on the order of the rungs.
    known: dict[str, Fit] = {}
    for name in sorted(effects):
        known[name] = search.together((name,), {})
    whole = search.together(effects, known) if len(effects) > 1 else known[effects[0]]
    steps = [
        known[effects[0]] if count == 1 else search.together(effects[:count], known)
        for count in range(1, len(effects))
    ]
    nothing = fit(study.readings, study.null(), seed=seed)
    noise = whole.noise  # one unit for all rungs, where it is inferred too
    models: list[tuple[str, tuple[str, ...], Array, float]] = [
        (BASELINE, (), (study.readings.value - study.base) / noise, math.nan),
        (RECALIBRATED, (), left_out(nothing, noise), nothing.log_evidence),
    ]
    for count, one in enumerate([*steps, whole], start=1):
        chosen = tuple(effects[:count])
        errors = left_out(one, noise)
        models.append((f"+ {chosen[-1]}", chosen, errors, one.log_evidence))
    rungs, method = ladder(
        models,
        study.readings.device,
        noise_floor(whole),
        floor_interval(whole, seed),
    )
    names = tuple(sorted(effects))
    priors = whole.hypothesis.priors
    values = {
        p.parameter.name: float(v) for p, v in zip(priors, whole.mean(), strict=True)
    }
    corrected = study.on_mesh(names, values, study.level)
    made = Adoption(
        study=study,
        effects=tuple(effects),
        baseline=nothing,
        fit=whole,
        ladder=rungs,
        interval=method,
        corrected=corrected,
        warnings=(),
        seed=seed,
    )
    warnings = [*study.warnings, *notes, *_judgement(rungs), *_doubts(made)]
    return replace(made, warnings=tuple(dict.fromkeys(warnings)))


def refuse(effects: Sequence[str], known: Mapping[str, Effect], paths: Paths) -> None:
    """Refuse what is impossible whatever is solved.

    Parameters
    ----------
    effects : sequence of str
    known : mapping of str to Effect
        What may be named.
    paths : Paths
        Of the measurements.

    Raises
    ------
    EffectError
        When an effect is not known.
    InputError
        When none is given, one twice, or the readings cannot show one.
    """
    if not effects:
        raise InputError("effects", "none", "the name of at least one effect")
    for name in effects:
        if name not in known:
            allowed = ", ".join(known)
            raise EffectError(f"effect: {name!r} is unknown; allowed: {allowed}")
        if list(effects).count(name) > 1:
            raise InputError("effects", name, "each effect once")
        why = paths.blind(name)
        if why:
            raise InputError("effects", name, f"an effect that readings show: {why}")


def _first_solves(search: Search, effects: Sequence[str]) -> list[str]:
    """What is doubtful of the effects, one line each.

    Raises
    ------
    EffectError, InputError
        When something is impossible.
    """
    study = search.study
    refuse(effects, study.effects, study.paths)
    search.solve_singles(sorted(effects))
    for name in effects:
        if study.present((name,)) is None:
            allowed = "an effect whose paths reach the measured pressures at some size"
            raise InputError("effects", name, allowed)
    return [f"{name}: {why}" for name, why in search.unjudged.items()]


def _judgement(rungs: Sequence[Rung]) -> list[str]:
    """What the ladder warns of, one line each."""
    lines = []
    alone = math.isnan(rungs[1].heldout_error)
    if alone:
        lines.append("only one device: no error on devices that were left out")
    recalibrated, last, floor = rungs[1], rungs[-2], rungs[-1]
    if recalibrated.ratio_low > 1:
        lines.append(
            "recalibration alone makes the error on left-out devices "
            f"{recalibrated.ratio:.2f} times larger: moduli stand in for something else"
        )
    for rung in rungs[2:-1]:
        name = rung.name.removeprefix("+ ")
        if not alone and not rung.helps:
            how = "raises" if rung.ratio_low > 1 else "does not clearly lower"
            lines.append(
                f"{name} {how} the error on left-out devices: {rung.ratio:.2f} times "
                f"that of the rung before (90 % interval {rung.ratio_low:.2f} to "
                f"{rung.ratio_high:.2f})"
            )
        if rung.log_bayes < 0:
            odds = math.exp(min(-rung.log_bayes, 700.0))  # what exp can hold
            lines.append(
                f"{name} is not needed: the readings are {odds:.2g} times as probable "
                "without it"
            )
    if last.heldout_error > floor.high:
        lines.append(
            f"the error on left-out devices is still {last.heldout_error:.2f} times "
            f"the noise, above what a right model gives ({floor.low:.2f} to "
            f"{floor.high:.2f}): something else may be missing"
        )
    return lines


def _doubts(made: Adoption) -> list[str]:
    """Sizes at the end of their range, and curves away from the finite elements."""
    lines = [
        f"{name}: {one['value']:.4g} {one['unit']} is at the end of its range, "
        f"{one['range'][0]:g} to {one['range'][1]:g}: hardly plausible"
        for name, one in made.parameters.items()
        if one["plausibility"] == BEYOND
    ]
    lost = int((~np.isfinite(made.corrected)).sum())
    if lost:
        lines.append(
            f"{lost} readings are past the end of the corrected model's paths at the "
            "posterior mean"
        )
    apart = emulation_error(made)
    if apart > APART:
        lines.append(
            f"the curves of the fit are up to {apart:.1f} noise standard deviations "
            f"from the finite elements on the {made.study.level} mesh at the posterior "
            "mean"
        )
    return lines


def emulation_error(made: Adoption) -> float:
    """Largest distance, in noise, of the fit's curves from the finite elements.

    At the posterior mean: what interpolation between solves and the faster mesh of
    what effects change leave; 0 where no corrected reading is reached.
    """
    one = made.fit
    t = np.array(
        [
            prior.coordinate(value)
            for prior, value in zip(one.hypothesis.priors, made.mean, strict=True)
        ]
    )
    lack = np.abs(one.hypothesis.many(t[None, :])[0] - made.corrected) / one.noise
    return float(np.nanmax(lack, initial=0.0))


def resampled(weights: Array, count: int, seed: int) -> Array:
    """(count,) indices of equally weighted samples: systematic resampling.

    One random offset and even steps through the cumulated weights (Kitagawa 1996): no
    sample is lost or doubled beyond what its weight asks for.
    """
    offset = np.random.default_rng(seed).random()
    places = (offset + np.arange(count)) / count
    total = np.cumsum(weights) / np.sum(weights)
    total[-1] = 1.0
    found: Array = np.searchsorted(total, places, side="right")
    return found


def joined(parts: Sequence[Measurements]) -> Measurements:
    """Measurements of several files as one.

    Raises
    ------
    InputError
        When there is none, two of them hold the same run of a device or state another
        design for it, or tolerances differ.
    """
    if not parts:
        raise InputError("FILE", "none", "at least one file of measurements")
    if len(parts) == 1:
        return parts[0]
    owner: dict[tuple[str, int, float], str] = {}
    stated: dict[str, tuple[object, str]] = {}
    for part in parts:
        if part.tolerances != parts[0].tolerances:
            raise InputError("tolerances", part.source, "those of the first file")
        for curve in part.curves:
            design, first = stated.setdefault(curve.device, (curve.design, part.source))
            if design != curve.design:
                raise InputError(
                    "device",
                    curve.device,
                    f"one design a device: {part.source} states another than {first}",
                )
            key = (curve.device, curve.run, curve.orientation)
            if key in owner:
                raise InputError(
                    "run",
                    curve.run,
                    f"each run of {curve.device} in one file only, not in {owner[key]} "
                    f"and {part.source}; number repeated tests in the column 'run'",
                )
            owner[key] = part.source
    hashes = "".join(part.sha256 for part in parts)
    place = {device: i for i, device in enumerate(stated)}
    curves = [curve for part in parts for curve in part.curves]
    return Measurements(
        tuple(sorted(curves, key=lambda curve: place[curve.device])),
        ", ".join(part.source for part in parts),
        hashlib.sha256(hashes.encode()).hexdigest(),
        tuple(line for part in parts for line in part.warnings),
        parts[0].tolerances,
    )
