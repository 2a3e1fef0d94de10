"""A ranking as the contract's JSON object."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from .experiment import Proposal
from .judging import Candidate, Ranking
from .words import sizes, verdict


def parameters_of(one: Candidate) -> dict[str, dict[str, Any]]:
    """Fitted parameters by name; ``effect.parameter`` where several effects act.

    Numbers are SI; `plausibility` is the literature range's, as `words.sizes` has it.
    """
    fit = one.fit
    rows = zip(
        fit.hypothesis.priors,
        fit.mean(),
        fit.std(),
        fit.interval(),
        sizes(one),
        strict=True,
    )
    found = {}
    for prior, mean, std, (low, high), size in rows:
        p = prior.parameter
        name = p.name if len(one.effects) > 1 else p.name.split(".", 1)[1]
        found[name] = {
            "value": float(mean),
            "std": float(std),
            "unit": p.unit,
            "low": float(low),
            "high": float(high),
            "range": [float(p.lower), float(p.upper)],
            "plausibility": size.plausibility,
            "source": p.source,
        }
    return found


def label(one: Candidate) -> str | list[str]:
    """Name of an effect, or the names of several; ``nothing`` and ``unknown``."""
    names = list(one.effects) + (["unknown"] if one.unnamed else [])
    if not names:
        return "nothing"
    return names[0] if len(names) == 1 else names


def to_json(
    ranking: Ranking,
    fails_where: Sequence[dict[str, Any]] = (),
    proposals: Sequence[Proposal] = (),
) -> dict[str, Any]:
    """The contract's object of ``pba rank --json``."""
    return {
        "verdict": ranking.verdict,
        "effects": [name for group in ranking.effects for name in group.split("+")]
        if len(ranking.effects) == 1
        else [group.split("+") if "+" in group else group for group in ranking.effects],
        "sentence": verdict(ranking, proposals[0].words if proposals else ""),
        "ranking": [
            {
                "effect": label(one),
                "probability": one.probability,
                "parameters": parameters_of(one),
                "heldout_error": _finite(one.heldout_error),
                "tied_with": [
                    name.split("+") if "+" in name else name for name in one.tied_with
                ],
                "log_evidence": one.fit.log_evidence,
                "overruled": one.overruled,
            }
            for one in ranking.candidates
        ],
        "baseline_error": _finite(ranking.baseline_error),
        "noise_floor": _finite(ranking.noise_floor),
        "fails_where": list(fails_where),
        "next_measurement": [proposal_json(one) for one in proposals[:3]],
        "confusion": {
            "names": list(ranking.confused),
            "matrix": ranking.confusion.tolist(),
        },
        "not_judged": dict(ranking.unjudged),
        "warnings": list(ranking.warnings),
    }


def proposal_json(one: Proposal) -> dict[str, Any]:
    """A proposal as data: what, on which device, and what it is expected to bring."""
    curve = one.curve
    tensile = curve.specimen == "tensile"
    data: dict[str, Any] = {
        "text": one.words,
        "specimen": curve.specimen,
        "device": curve.device,
        "orientation_deg": math.degrees(curve.orientation),
        "branch": list(map(str, curve.branch)),
        "chi_square_now": one.now,
        "chi_square_then": one.then,
        "probability_right": one.probability,
        "nearest": list(one.between),
    }
    if tensile:
        data["stretch"] = curve.load.tolist()
    else:
        data["pressure_kPa"] = (curve.load / 1e3).tolist()
    return data


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
