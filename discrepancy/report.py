"""A ranking as one HTML file that opens anywhere, without a network, and prints.

Everything that comes from a measurement or an effect file is escaped.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from html import escape

from datagen.model import GENERATOR_VERSION

from . import figures
from .figures import Figure
from .judging import Candidate, Ranking
from .page import (
    count,
    document,
    errors,
    figure,
    heading,
    pages,
    paragraph,
    small,
    table,
)
from .provenance import package
from .rank import PAIRS, PARTNERS
from .study import Study
from .words import INSIDE, in_words, log_odds, percent, sizes, verdict

SIGNATURES = 4
"""Candidates whose signatures are drawn."""

FIRST, LEAST = 6, 1e-3
"""Candidates that are shown with their numbers: the first ones, and those above a
probability."""

NONE = "\u2013"
"""What stands in a cell that has nothing to say."""


def report(
    study: Study,
    ranking: Ranking,
    *,
    fails_where: str = "",
    next_measurement: str = "",
    seed: int = 0,
) -> str:
    """The ranking of a study as one HTML file.

    Parameters
    ----------
    study : Study
    ranking : Ranking
        Of this study.
    fails_where : str, optional
        Where the baseline fails, in words.
    next_measurement : str, optional
        What to measure next, in words.
    seed : int
        That the ranking was made with.

    Returns
    -------
    str
    """
    name = study.measurements.source or "measurements"
    title = f"Which physics is missing: {name}"
    drawn: list[Figure] = []
    body = "\n".join(
        part
        for section in (
            _head(study, ranking, name, next_measurement),
            _candidates(study, ranking),
            _fails(fails_where),
            _figures(study, ranking, drawn),
            _next(next_measurement),
            _unjudged(ranking),
            _warnings(study, ranking),
            errors(study, ranking.best.fit),
            _method(study),
            _versions(study, seed),
        )
        for part in section
    )
    return document(title, body, drawn)


def _head(
    study: Study, ranking: Ranking, name: str, next_measurement: str
) -> Iterator[str]:
    devices = len({c.device for c in study.measurements.curves})
    judged = sum(1 for c in ranking.candidates if len(c.effects) == 1 and not c.unnamed)
    yield "<h1>Which physics is missing?</h1>"
    yield paragraph(
        f"{name}: {count(devices, 'device')}, "
        f"{count(len(study.measurements.curves), 'curve')}, "
        f"{count(len(study.readings.value), 'reading')}; "
        f"{count(judged, 'effect')} judged, alone and in pairs.",
        "muted",
    )
    text = escape(verdict(ranking, next_measurement))
    yield f'<p class="verdict {escape(ranking.verdict)}">{text}</p>'
    if math.isfinite(ranking.baseline_error):
        words = (
            "On devices left out of the fit, the baseline errs by "
            f"{ranking.baseline_error:.2f} times the noise; a model with the right "
            f"physics would err by about {ranking.noise_floor:.2f}, since each new "
            "device has its own tolerances."
        )
    else:
        words = "No device can be left out to judge by: there is but one."
    yield paragraph(words)


def _candidates(study: Study, ranking: Ranking) -> Iterator[str]:
    shown: list[Candidate] = []
    rest: list[Candidate] = []
    for i, one in enumerate(ranking.candidates):
        known = i < FIRST or one.name == "nothing" or one.tied_with
        (shown if known or one.probability > LEAST else rest).append(one)
    yield heading("Candidates")
    heads = "".join(
        f"<th{' class=number' if head in _NUMBERS else ''}>{escape(head)}</th>"
        for head in _HEADS
    )
    bodies = "\n".join(_body(ranking, one) for one in shown)
    yield f"<table>\n<thead><tr>{heads}</tr></thead>\n{bodies}\n</table>"
    if rest:
        names = ", ".join(in_words(one.name) for one in rest)
        yield paragraph(f"Judged, each below {100 * LEAST:g} %: {names}.", "muted")
    yield paragraph(
        "Log odds are against the first. Held-out error: root mean square of what is "
        "left on devices that took no part in the fit, in units of the noise; worked "
        'out for the most probable and for "nothing missing".',
        "muted",
    )
    named = dict.fromkeys(name for one in shown for name in one.effects)
    told = [(name, study.effects[name]) for name in named if name in study.effects]
    if told:
        rows = [(escape(n), escape(_first(effect.doc))) for n, effect in told]
        yield table(("Effect", "What it is"), rows, kind="named")


_HEADS = (
    "Explanation",
    "Probability",
    "Held-out error",
    "Parameter",
    "Value \u00b1 std",
    "90 % interval",
    "Literature range",
)
_NUMBERS = _HEADS[1:3]


def _body(ranking: Ranking, one: Candidate) -> str:
    """Rows of one candidate, one for each of its parameters."""
    name = f"<strong>{escape(in_words(one.name))}</strong>"
    tied = ", ".join(in_words(other) for other in one.tied_with)
    name += f"<br>{small(f'tied with {tied}')}" if tied else ""
    odds = escape(percent(one.probability))
    if one is not ranking.best:
        odds += f"<br>{small(log_odds(ranking, one))}"
    error = one.heldout_error
    left = f"{error:.2f}" if math.isfinite(error) else NONE
    rows = [
        (
            escape(size.name if len(one.effects) > 1 else size.short),
            f"<strong>{escape(size.number)}</strong>",
            escape(size.interval),
            escape(size.range)
            + ("" if size.plausibility == INSIDE else f"<br>{escape(size.remark)}"),
        )
        for size in sizes(one)
    ] or [(NONE,) * 4]
    span = f' rowspan="{len(rows)}"'
    cells = [
        "".join(f"<td>{cell}</td>" for cell in row)  # HTML already
        for row in rows
    ]
    cells[0] = (
        f'<td{span}>{name}</td><td class="number"{span}>{odds}</td>'
        f'<td class="number"{span}>{left}</td>{cells[0]}'
    )
    return f"<tbody>{''.join(f'<tr>{row}</tr>' for row in cells)}</tbody>"


def _first(doc: str) -> str:
    """First paragraph of a docstring, on one line."""
    return " ".join(doc.split("\n\n")[0].split())


def _fails(text: str) -> Iterator[str]:
    if text:
        yield heading("Where the baseline fails")
        yield from (paragraph(line) for line in text.splitlines() if line.strip())


def _figures(study: Study, ranking: Ranking, drawn: list[Figure]) -> Iterator[str]:
    baseline = ranking.candidate("nothing").fit
    named = [c for c in ranking.candidates if c.effects and not c.unnamed]
    groups = range(len(study.kinds))
    yield heading("Figures")
    yield (
        "<noscript><p>The figures are drawn by the script in this file; the tables say "
        "the same without it.</p></noscript>"
    )
    yield figure(
        drawn,
        figures.ranking_bars(ranking),
        "Probabilities add up to one over all explanations, those not shown included. "
        "Hatched: tied, these readings do not tell them apart.",
    )
    yield figure(
        drawn,
        figures.residual_map(study, baseline),
        "Each cell is a reading less what the baseline predicts after moduli, "
        "thicknesses and camera scale were adjusted within their tolerances. Values "
        "within 2 noise standard deviations are what noise alone does.",
    )
    for group in groups:
        for devices in pages(study, group):
            yield figure(
                drawn,
                figures.overlay(study, group, baseline, ranking.best.fit, devices),
                "Points: measured, their bars 90 % of the noise. Bands: 90 % of what "
                "calibrations and sizes leave open. Open points: unloading.",
            )
    for group in groups if named else ():
        for devices in pages(study, group):
            yield figure(
                drawn,
                figures.signatures(study, group, baseline, named[:SIGNATURES], devices),
                "Points: what the baseline leaves. Lines: what each candidate changes "
                "at its best size, calibrations adjusted anew. The right one runs "
                "through the points on every device.",
            )
    yield figure(
        drawn,
        figures.confusion_matrix(ranking),
        "If the explanation of a row were true, how often, in percent, readings of "
        "these devices with this noise would point to that of each column. Rows with "
        "large numbers off the diagonal cannot be told apart by these devices.",
    )


def _next(text: str) -> Iterator[str]:
    if text:
        yield heading("What to measure next")
        yield from (paragraph(line) for line in text.splitlines() if line.strip())


def _unjudged(ranking: Ranking) -> Iterator[str]:
    if ranking.unjudged:
        yield heading("What could not be judged")
        yield table(
            ("Effect", "Why"),
            [(escape(n), escape(why)) for n, why in sorted(ranking.unjudged.items())],
        )


def _warnings(study: Study, ranking: Ranking) -> Iterator[str]:
    lines = dict.fromkeys((*study.measurements.warnings, *ranking.warnings))
    if lines:
        yield heading("Warnings")
        yield f"<ul>{''.join(f'<li>{escape(line)}</li>' for line in lines)}</ul>"


def _method(study: Study) -> Iterator[str]:
    allowed = study.measurements.tolerances
    sentences = (
        "Every candidate is solved by finite elements at the measured devices and "
        "fitted to all curves at once, its parameters between the ends of their "
        "literature ranges with priors of that width.",
        "The stated values are not taken at their word: moduli of material batches "
        f"({100 * allowed.modulus:g} %), layer thicknesses "
        f"({1e6 * allowed.thickness:g} um) and camera scales "
        f"({100 * allowed.camera_scale:g} %) are inferred with every candidate, so "
        "that none of them passes for physics.",
        "Points of one curve are not independent: smooth errors along each curve are "
        "part of the errors, their size inferred from the readings.",
        "Candidates are weighed by their evidence, the probability of the readings "
        "averaged over the candidate's whole prior, against nothing missing and "
        "against a smooth effect without a name; the best ones are solved again at "
        f"their best sizes, and pairs of the best {PARTNERS} with all others are "
        f"tried, at most {PAIRS} of them solved.",
        "Candidates that these readings cannot tell apart are called tied, and every "
        "candidate is also judged on devices left out of its fit.",
    )
    yield heading("Method")
    yield f"<ol>{''.join(f'<li>{escape(one)}</li>' for one in sentences)}</ol>"


def _versions(study: Study, seed: int) -> Iterator[str]:
    measured = study.measurements
    rows = [
        ("Measurement file", measured.source or "not from a file"),
        ("Its SHA-256", measured.sha256 or "not from a file"),
        ("pba", package()),
        ("Generator version", GENERATOR_VERSION),
        ("Mesh", f"baseline {study.level}, changes by effects {study.fast}"),
        ("Seed", str(seed)),
        ("Effects", ", ".join(study.effects)),
    ]
    yield heading("Versions")
    yield table(
        ("What", "Which"),
        [(escape(what), f"<code>{escape(which)}</code>") for what, which in rows],
        kind="named",
    )
