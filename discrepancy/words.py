"""A ranking in the words and units of the bench: names, sizes and the verdict.

Used by figures, report, command line and page, so that all of them say the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from datagen.units import PRESSURE

from .columns import NUMBERS
from .judging import CLAIM, SEPARATED, Candidate, Ranking
from .study import Study

BENCH = {
    "1": ("", 1.0),
    "m": ("um", 1e-6),
    "Pa": ("kPa", 1e3),
    "rad": ("deg", math.pi / 180),
    "m/Pa": ("um/kPa", 1e-9),
}
"""Bench unit of a parameter, and SI per bench unit, by SI unit; others stay as they
are."""

EDGE = 0.02
"""Share of a range within which an interval counts as reaching its end."""

SHARED = 0.05
"""Probability of something besides a named effect from which on it is told."""

INSIDE, OPEN, BEYOND = "plausible", "open", "implausible"
"""A size inside its literature range; one whose interval reaches the end of it; one
that would be larger still if the range let it."""

_QUANTITIES = {
    "tip_deflection": "tip deflection",
    "bending_angle": "bending angle",
    "inflation": "inflation of the roof",
    "inflation_lower": "inflation of the floor",
    "cavity_volume": "cavity volume",
    "stress": "nominal stress",
}

_SPECIMENS = {"actuator": "", "bulge": "bulge test, ", "tensile": "tensile test, "}


@dataclass(frozen=True)
class Axis:
    """A quantity as it is shown.

    title : str, without the unit; unit : str; factor : float, SI per unit.
    """

    title: str
    unit: str
    factor: float

    @property
    def label(self) -> str:
        """Title and unit: ``tip deflection (mm)``."""
        return f"{self.title} ({self.unit})" if self.unit else self.title


def quantity_axis(study: Study, group: int) -> Axis:
    """The measured quantity of one group of readings."""
    specimen, output = study.kinds[group]
    title = f"{_SPECIMENS[specimen]}{_QUANTITIES[output]}"
    column = NUMBERS[output]
    return Axis(title[0].upper() + title[1:], column.unit, column.bench.factor)


def load_axis(study: Study, group: int) -> Axis:
    """What one group of readings is plotted over: gauge pressure, or stretch."""
    if study.kinds[group][0] == "tensile":
        return Axis("Stretch", "", 1.0)
    return Axis("Pressure", PRESSURE.unit, PRESSURE.factor)


def in_words(name: str) -> str:
    """A hypothesis by name: effects as they are called, the others in words."""
    words = {"nothing": "nothing missing", "unknown": "an effect without a name"}
    return " + ".join(words.get(part, part) for part in name.split("+"))


def percent(probability: float) -> str:
    """A probability with as many digits as say something."""
    if probability < 0.001:
        return "below 0.1 %"
    if probability > 0.999:
        return "above 99.9 %"
    digits = 1 if min(probability, 1 - probability) < 0.095 else 0
    return f"{100 * probability:.{digits}f} %"


def decimals(spread: float) -> int:
    """Decimals that show two digits of a standard deviation."""
    if not math.isfinite(spread) or spread <= 0:
        return 3
    return min(max(1 - math.floor(math.log10(spread)), 0), 9)


@dataclass(frozen=True)
class Size:
    """How large a parameter of an effect is, in its bench unit.

    Parameters
    ----------
    name : str
        ``effect.parameter``.
    value, std : float
        Posterior mean and standard deviation.
    low, high : float
        Central 90 % interval.
    lower, upper : float
        Literature range.
    unit : str
        Empty for a pure number.
    source : str
        Of the range.
    plausibility : str
        `INSIDE`, `OPEN` or `BEYOND`.
    """

    name: str
    value: float
    std: float
    low: float
    high: float
    lower: float
    upper: float
    unit: str
    source: str
    plausibility: str

    @property
    def _unit(self) -> str:
        return f" {self.unit}" if self.unit else ""

    @property
    def number(self) -> str:
        """Value and standard deviation: ``41.3 \u00b1 2.1 um``."""
        digits = decimals(self.std)
        value, std = f"{self.value:.{digits}f}", f"{self.std:.{digits}f}"
        return f"{value} \u00b1 {std}{self._unit}"

    @property
    def short(self) -> str:
        """Name of the parameter without that of its effect."""
        return self.name.split(".")[-1]

    @property
    def interval(self) -> str:
        """The 90 % interval: ``37.9 to 44.8 um``."""
        digits = decimals(self.std)
        return f"{self.low:.{digits}f} to {self.high:.{digits}f}{self._unit}"

    @property
    def range(self) -> str:
        """The literature range: ``0 to 150 um``."""
        return f"{self.lower:.4g} to {self.upper:.4g}{self._unit}"

    @property
    def remark(self) -> str:
        """The size against its literature range, without naming the range."""
        return {
            INSIDE: "plausible: inside the literature range",
            OPEN: "not excluded: a size beyond the literature range",
            BEYOND: "implausible: the readings ask for more than the literature range "
            "allows",
        }[self.plausibility]

    @property
    def judgement(self) -> str:
        """The size against its literature range, in words."""
        return f"{self.remark} ({self.range})"


def sizes(candidate: Candidate) -> tuple[Size, ...]:
    """Sizes of a candidate's parameters; none for hypotheses without effects."""
    one = candidate.fit
    found = []
    for prior, mean, std, (low, high), best in zip(
        one.hypothesis.priors,
        one.mean(),
        one.std(),
        one.interval(),
        one.t,
        strict=True,
    ):
        p = prior.parameter
        unit, factor = BENCH.get(p.unit, (p.unit, 1.0))
        bounds = prior.bounds
        span = bounds[1] - bounds[0]
        plausibility = INSIDE
        for end, reached in zip(bounds, (low, high), strict=True):
            # An end at which the effect vanishes is no end of its size.
            if abs(end - prior.off) < EDGE * span:
                continue
            if abs(prior.coordinate(float(reached)) - end) < EDGE * span:
                at_end = abs(best - end) < 1e-3 * span
                plausibility = BEYOND if at_end else OPEN
        found.append(
            Size(
                name=p.name,
                value=float(mean) / factor,
                std=float(std) / factor,
                low=float(low) / factor,
                high=float(high) / factor,
                lower=p.lower / factor,
                upper=p.upper / factor,
                unit=unit,
                source=p.source,
                plausibility=plausibility,
            )
        )
    return tuple(found)


def verdict(ranking: Ranking, next_measurement: str = "") -> str:
    """The verdict in one or a few sentences for the bench.

    Parameters
    ----------
    ranking : Ranking
    next_measurement : str, optional
        What to measure next, in words.
    """
    return " ".join(_sentences(ranking, next_measurement))


def _sentences(ranking: Ranking, next_measurement: str) -> Iterator[str]:
    nothing = sum(c.probability for c in ranking.candidates if c.name == "nothing")
    unnamed = sum(c.probability for c in ranking.candidates if c.unnamed)
    if ranking.verdict == "adequate":
        yield (
            "Adequate: the baseline explains these readings within their errors; "
            f"nothing has to be missing (probability {percent(nothing)})."
        )
        named = [one for one in ranking.candidates if one.effects and not one.unnamed]
        best = max(named, key=lambda one: one.probability, default=None)
        if best is not None and best.probability > nothing:
            yield (
                f"An effect of {in_words(best.name)} is more probable "
                f"({percent(best.probability)}), but something is said to be missing "
                f"only where nothing missing has at most {percent(CLAIM)}."
            )
    elif ranking.verdict == "identified":
        best = ranking.candidate(ranking.effects[0])
        yield (
            f"Identified: {in_words(best.name)} is missing "
            f"(probability {_probability(ranking, best)})."
        )
        single = len(best.effects) == 1
        for size in sizes(best):
            name = size.short.capitalize() if single else size.name
            yield (
                f"{name} is {size.number} (90 % interval "
                f"{size.interval}); {size.judgement}."
            )
    elif ranking.verdict == "tied":
        tied = [ranking.candidate(name) for name in ranking.effects]
        names = " or ".join(in_words(one.name) for one in tied)
        yield f"Tied: {names}; these readings do not tell which of them is missing."
        yield from (why_tied(tied[0], other) for other in tied[1:])
    else:
        yield (
            "Unexplained: something is missing that no effect of the catalogue "
            f"accounts for (an effect without a name: probability {percent(unnamed)}; "
            f"nothing missing: {percent(nothing)})."
        )
        if ranking.nearest:
            yield from _nearest(ranking.nearest)
    if next_measurement:
        yield f"To measure next: {next_measurement.strip().rstrip('.')}."
    elif ranking.verdict == "tied":
        yield "No measurement that would split them has been worked out."


def _nearest(one: Candidate) -> Iterator[str]:
    """What comes nearest where nothing with a name is the answer, and why it is not."""
    found = f"Of those with a name, {in_words(one.name)} comes nearest"
    if not one.overruled:
        yield f"{found} (probability {percent(one.probability)})."
        return
    left = 100 * max(one.fit.amplitude("smooth").values())
    share = 100 * max(one.explained, 0.0)
    yield (
        f"{found}, but leaves smooth errors of {left:.0f} % of a curve's maximum and "
        f"explains {share:.0f} % of what could fall of the error on left-out devices."
    )


def _probability(ranking: Ranking, best: Candidate) -> str:
    """That the best one's effects are missing; and alone, where that is another."""
    among = sum(
        one.probability
        for one in ranking.candidates
        if set(best.effects) <= set(one.effects)
    )
    whole, alone = percent(among), percent(best.probability)
    if among - best.probability < SHARED:
        return alone
    return f"{whole}, nothing besides it {alone}"


def log_odds(ranking: Ranking, one: Candidate) -> str:
    """Log odds of a hypothesis against the most probable one, in words."""
    best = ranking.best.probability
    odds = math.log(max(one.probability, 1e-300) / best)
    return f"log odds {odds:.1f}" if odds < 0 else "the most probable"


def why_tied(best: Candidate, other: Candidate) -> str:
    """Why one candidate is tied with the best one, in a sentence."""
    worse = other.fit.misfit - best.fit.misfit
    odds = best.probability / max(other.probability, 1e-300)
    how = f"better than {in_words(best.name)} by a chi-square of {-worse:.1f}"
    if worse >= 0:
        how = f"worse than {in_words(best.name)} by a chi-square of only {worse:.1f}"
    fits = f"fits {how}"
    if odds < 1:
        return f"{in_words(other.name)} {fits}."
    limit = math.exp(SEPARATED)
    if odds < limit:
        return (
            f"{in_words(other.name)} {fits}, and the odds against it are "
            f"{odds:.1f} to 1, below the {limit:.0f} to 1 that name an effect."
        )
    return (
        f"{in_words(other.name)} {fits}; the odds against it come from the widths of "
        "the priors, which alone do not name an effect."
    )
