"""How right an answer about a sealed set is: verdict, probability and parameters.

An answer is the JSON object of ``pba rank --json``; anybody's program may write one.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeGuard

from datagen.atomic import reason
from datagen.errors import FileError

from .columns import UNITS
from .sealed import NONE, UNNAMED, Planted, Truth

VERDICTS = ("adequate", "identified", "tied", "unexplained")

OUTCOMES = {
    "right": "the verdict says what was planted, or that nothing was",
    "in_tie": "what was planted is one of a tied group",
    "partial": "one effect of two, or one too many",
    "wrong": "effects are named that were not planted",
    "missed": "called adequate with an effect planted",
    "not_named": "called unexplained with an effect of the catalogue planted",
    "false_claim": "an effect is named and nothing was planted",
    "false_alarm": "called unexplained and nothing was planted",
}
"""What an answer can come to."""

RIGHT = ("right", "in_tie")

INTERVAL = 1.645
"""Half width of a 90 % interval, standard deviations."""

FLOOR = 1e-6
"""Least probability that the log score counts: an answer that rules the truth out, or
does not list it, loses 13.8 and not everything."""

NOTHING = frozenset({"", "nothing", "none", "baseline", "adequate"})
NO_NAME = frozenset({"unknown", "unexplained"})
"""How an answer writes "nothing is missing" and "something without a name"."""


@dataclass(frozen=True)
class Claim:
    """One entry of an answer's ranking.

    Parameters
    ----------
    effects : frozenset of str
        Empty for "nothing is missing".
    unnamed : bool
        Something without a name acts, alone or besides the effects.
    probability : float
    parameters : dict of str to (value, std, unit)
        As the answer gives them; std is NaN where there is none.
    """

    effects: frozenset[str]
    unnamed: bool
    probability: float
    parameters: dict[str, tuple[float, float, str]]


@dataclass(frozen=True)
class Answer:
    """What a ranking says of a set.

    Parameters
    ----------
    verdict : str
        One of `VERDICTS`.
    groups : tuple of frozenset of str
        Sets of effects that the verdict speaks of: one, or those that are tied.
    claims : tuple of Claim
    file_sha256 : str
        Of the measurements that were ranked; empty where the answer does not say.
    """

    verdict: str
    groups: tuple[frozenset[str], ...]
    claims: tuple[Claim, ...]
    file_sha256: str = ""


@dataclass(frozen=True)
class ParameterScore:
    """One true parameter and what the answer says of it.

    Parameters
    ----------
    name : str
        ``effect.parameter``.
    truth : float, SI
    value, std : float or None, SI
        None where the answer has none.
    unit : str
        Of all three.
    inside : bool or None
        Whether the truth is within 1.645 standard deviations; None without a std.
    """

    name: str
    truth: float
    value: float | None
    std: float | None
    unit: str
    inside: bool | None


@dataclass(frozen=True)
class Score:
    """How right one answer is.

    Parameters
    ----------
    name : str
        Of the set.
    kind : str
        Of the truth, see `sealed.Truth`.
    planted : str
        Effects joined by ``+``; ``nothing``.
    moved : float
        Largest change of a reading by the weakest of the planted effects, over the
        noise; 0 where nothing is planted.
    verdict : str
    named : tuple of str
        What the verdict names, effects of a pair joined by ``+``.
    outcome : str
        A key of `OUTCOMES`.
    probability : float
        Given to the truth.
    log_score : float
        Natural logarithm of it, at least that of `FLOOR`.
    parameters : tuple of ParameterScore
    """

    name: str
    kind: str
    planted: str
    moved: float
    verdict: str
    named: tuple[str, ...]
    outcome: str
    probability: float
    log_score: float
    parameters: tuple[ParameterScore, ...]

    @property
    def right(self) -> bool:
        return self.outcome in RIGHT

    def line(self) -> str:
        """The score in one line."""
        given = [p for p in self.parameters if p.inside is not None]
        text = f"{'right' if self.right else 'WRONG'}: planted {self.planted}"
        if self.kind != NONE:
            text += f" ({self.moved:.3g} times the noise)"
        text += f", answered {self.verdict}"
        text += f" {', '.join(self.named)}" if self.named else ""
        text += f"; {OUTCOMES[self.outcome]}"
        text += f"; truth given {self.probability:.3g}, log score {self.log_score:.2f}"
        if given:
            inside = sum(bool(p.inside) for p in given)
            text += f"; {inside} of {len(given)} parameters inside their 90 % intervals"
        return text


@dataclass(frozen=True)
class Summary:
    """Scores of several sets together.

    Parameters
    ----------
    sets, right : dict of str to int
        By kind of the truth, and ``all``.
    outcomes : dict of str to int
        Of all sets.
    log_score : float
        Mean.
    intervals, inside : int
        Parameters with an interval, and those whose interval holds the truth.
    """

    sets: dict[str, int]
    right: dict[str, int]
    outcomes: dict[str, int]
    log_score: float
    intervals: int
    inside: int


def read_answer(path: Path) -> Answer:
    """Read the JSON of a ranking.

    Raises
    ------
    FileError
        When the file cannot be read or is no such object; says which field is not as
        it has to be.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileError(path, f"cannot be read: {reason(error)}") from error
    except ValueError as error:
        raise FileError(path, f"not JSON: {error}") from error
    try:
        return answer_from(content)
    except ValueError as error:
        raise FileError(path, str(error)) from error


def answer_from(content: Any) -> Answer:
    """An answer from the object that ``pba rank --json`` prints.

    Raises
    ------
    ValueError
        When a field is missing or not as it has to be.
    """
    if not isinstance(content, Mapping):
        raise ValueError("not an object with verdict, effects and ranking")
    verdict = content.get("verdict")
    if verdict not in VERDICTS:
        raise ValueError(
            f"verdict: {verdict!r} is not allowed; allowed: {', '.join(VERDICTS)}"
        )
    effects, ranking = content.get("effects"), content.get("ranking")
    if not isinstance(effects, list):
        raise ValueError("effects: not a list of names")
    if not isinstance(ranking, list):
        raise ValueError("ranking: not a list of hypotheses")
    groups = tuple(_names(one, "effects")[0] for one in effects)
    if verdict in ("identified", "tied") and not any(groups):
        raise ValueError(f"effects: none named, with the verdict {verdict}")
    if verdict == "identified":  # a pair may be written as two names
        groups = (frozenset().union(*groups),)
    elif verdict != "tied":
        groups = ()
    claims = tuple(_claim(one, f"ranking[{i}]") for i, one in enumerate(ranking))
    total = sum(one.probability for one in claims)
    if total > 1.01:
        raise ValueError(f"ranking: probabilities add up to {total:.4g}, more than 1")
    return Answer(verdict, groups, claims, str(content.get("file_sha256") or ""))


def _names(given: Any, where: str) -> tuple[frozenset[str], bool]:
    """Effects of a hypothesis, and whether something without a name is part of it."""
    parts = [given] if isinstance(given, str) or given is None else given
    if not isinstance(parts, list) or not all(
        isinstance(part, str) or part is None for part in parts
    ):
        raise ValueError(f"{where}: {given!r} is neither a name nor a list of names")
    names = {name.strip() for part in parts for name in (part or "").split("+")}
    return frozenset(names - NOTHING - NO_NAME), bool(names & NO_NAME)


def _claim(given: Any, where: str) -> Claim:
    if not isinstance(given, Mapping) or "effect" not in given:
        raise ValueError(f"{where}: not an object with an effect")
    effects, unnamed = _names(given["effect"], f"{where}.effect")
    probability = given.get("probability")
    if not _number(probability) or not 0 <= probability <= 1:
        raise ValueError(
            f"{where}.probability: {probability!r} is not allowed; allowed: a number "
            "from 0 to 1"
        )
    parameters = given.get("parameters") or {}
    if not isinstance(parameters, Mapping):
        raise ValueError(f"{where}.parameters: not an object")
    read = {}
    for name, one in parameters.items():
        here = f"{where}.parameters.{name}"
        if not isinstance(one, Mapping) or not _number(one.get("value")):
            raise ValueError(f"{here}: no finite value")
        std = one.get("std")
        if std is not None and (not _number(std) or std < 0):
            raise ValueError(f"{here}.std: {std!r} is not allowed; allowed: 0 or more")
        unit = one.get("unit", "")
        if not isinstance(unit, str):
            raise ValueError(f"{here}.unit: {unit!r} is not a unit")
        spread = math.nan if std is None else float(std)
        read[str(name)] = (float(one["value"]), spread, unit)
    return Claim(effects, unnamed, float(probability), read)


def _number(value: Any) -> TypeGuard[float]:
    real = isinstance(value, (int, float)) and not isinstance(value, bool)
    return real and math.isfinite(value)


def _in_si(unit: str, si: str) -> float | None:
    """SI per unit of a parameter; None where the unit is of another kind."""
    if unit == si or {unit, si} <= {"", "1"}:
        return 1.0
    for units in UNITS.values():
        if unit in units and si in units:
            return units[unit] / units[si]
    return None


def outcome(truth: Truth, answer: Answer) -> str:
    """What an answer comes to: a key of `OUTCOMES`."""
    named = answer.verdict in ("identified", "tied")
    if truth.kind == NONE:
        if named:
            return "false_claim"
        return "right" if answer.verdict == "adequate" else "false_alarm"
    if answer.verdict == "adequate":
        return "missed"
    if answer.verdict == "unexplained":
        return "right" if truth.kind == UNNAMED else "not_named"
    if truth.effects in answer.groups:
        return "right" if len(answer.groups) == 1 else "in_tie"
    # All of the truth and something else, or some of it and nothing else.
    near = any(
        group and (group < truth.effects or group > truth.effects)
        for group in answer.groups
    )
    return "partial" if near else "wrong"


def _is_truth(claim: Claim, truth: Truth) -> bool:
    if truth.kind == UNNAMED:
        return claim.unnamed
    return not claim.unnamed and claim.effects == truth.effects


def score(truth: Truth, answer: Answer, name: str = "") -> Score:
    """Score one answer.

    Parameters
    ----------
    truth : Truth
    answer : Answer
    name : str
        Of the set, for the summary.

    Raises
    ------
    ValueError
        When a parameter is given in a unit of another kind.
    """
    claims = [one for one in answer.claims if _is_truth(one, truth)]
    probability = min(sum(one.probability for one in claims), 1.0)
    parameters: tuple[ParameterScore, ...] = ()
    if truth.kind != UNNAMED:
        given = claims[0].parameters if claims else {}
        parameters = tuple(
            _parameter(planted, parameter, given)
            for planted in truth.planted
            for parameter in planted.parameters
        )
    return Score(
        name=name,
        kind=truth.kind,
        planted="+".join(sorted(truth.effects)) or "nothing",
        moved=min((one.moved for one in truth.planted), default=0.0),
        verdict=answer.verdict,
        named=tuple("+".join(sorted(group)) for group in answer.groups),
        outcome=outcome(truth, answer),
        probability=probability,
        log_score=math.log(max(probability, FLOOR)),
        parameters=parameters,
    )


def _parameter(
    planted: Planted, name: str, given: Mapping[str, tuple[float, float, str]]
) -> ParameterScore:
    """One parameter; an answer writes ``effect.parameter`` or the parameter alone."""
    truth, unit = planted.parameters[name], planted.units[name]
    full = f"{planted.effect}.{name}"
    found = given.get(full, given.get(name))
    if found is None:
        return ParameterScore(full, truth, None, None, unit, None)
    factor = _in_si(found[2], unit)
    if factor is None:
        raise ValueError(
            f"{full}.unit: {found[2]!r} is not allowed; allowed: {unit}, or another "
            "unit of its kind"
        )
    value, std = found[0] * factor, found[1] * factor
    if not std > 0:  # not given, or no spread at all
        return ParameterScore(full, truth, value, None, unit, None)
    inside = abs(value - truth) <= INTERVAL * std
    return ParameterScore(full, truth, value, std, unit, inside)


def summarise(scores: Sequence[Score]) -> Summary:
    """Several scores together.

    Raises
    ------
    ValueError
        When there is none.
    """
    if not scores:
        raise ValueError("no scores")

    def count(chosen: Iterable[Score]) -> dict[str, int]:
        listed = list(chosen)
        kinds = sorted({one.kind for one in scores})
        by_kind = {kind: sum(one.kind == kind for one in listed) for kind in kinds}
        return by_kind | {"all": len(listed)}

    judged = [p for one in scores for p in one.parameters if p.inside is not None]
    found = [one.outcome for one in scores]
    return Summary(
        sets=count(scores),
        right=count(one for one in scores if one.right),
        outcomes={name: found.count(name) for name in OUTCOMES if name in found},
        log_score=math.fsum(one.log_score for one in scores) / len(scores),
        intervals=len(judged),
        inside=sum(bool(p.inside) for p in judged),
    )
