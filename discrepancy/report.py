"""A ranking as one HTML file that opens anywhere, without a network, and prints.

Plotly's script is embedded once, from the installed wheel; a content security policy
in the file keeps it from fetching anything.  Everything that comes from a measurement
or an effect file is escaped.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from html import escape
from importlib import metadata, resources
from pathlib import Path as FilePath

import numpy as np

from datagen.model import GENERATOR_VERSION

from . import figures
from .evidence import Fit
from .figures import Figure
from .rank import PAIRS, PARTNERS, Candidate, Ranking
from .study import Study
from .words import (
    INSIDE,
    in_words,
    log_odds,
    percent,
    quantity_axis,
    sizes,
    verdict,
)

CONTENT_SECURITY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data: blob:; base-uri 'none'; form-action 'none'"
)

WIDTH = 690
"""px.  Width of a figure: what A4 holds between its margins."""

PANELS = 12
"""Devices in one figure: more would not fit on a page."""

SIGNATURES = 4
"""Candidates whose signatures are drawn."""

FIRST, LEAST = 6, 1e-3
"""Candidates that are shown with their numbers: the first ones, and those above a
probability."""

NONE = "\u2013"
"""What stands in a cell that has nothing to say."""

_DRAW = """
for (const place of document.querySelectorAll("figure > div[data-figure]")) {
  const source = document.getElementById(place.dataset.figure);
  const figure = JSON.parse(source.textContent);
  Plotly.newPlot(place, figure.data, figure.layout,
                 {displaylogo: false, responsive: false});
}
"""


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
            _errors(study, ranking.best.fit),
            _method(study),
            _versions(study, seed),
        )
        for part in section
    )
    style = (resources.files(__package__) / "report.css").read_text(encoding="utf-8")
    data = "\n".join(
        f'<script type="application/json" id="figure-{i}">{_json(figure)}</script>'
        for i, figure in enumerate(drawn)
    )
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{CONTENT_SECURITY}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<style>
{style}</style>
</head>
<body>
<main>
{body}
</main>
{data}
<script>{_plotly()}</script>
<script>{_DRAW}</script>
</body>
</html>
"""


def _plotly() -> str:
    """Plotly's JavaScript, from the installed wheel."""
    folder = FilePath(str(resources.files("plotly"))) / "package_data"
    script = (folder / "plotly.min.js").read_text(encoding="utf-8")
    # Within a script element only its end tag is read as HTML.
    return script.replace("</script", "<\\/script")


def _json(figure: Figure) -> str:
    """A figure as JSON that cannot end the element it stands in."""
    figure["layout"]["width"] = WIDTH
    text = json.dumps(figure, allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e")


def _heading(text: str) -> str:
    return f"<h2>{escape(text)}</h2>"


def _paragraph(text: str, kind: str = "") -> str:
    opened = f'<p class="{kind}">' if kind else "<p>"
    return f"{opened}{escape(text)}</p>"


def _table(
    heads: Sequence[str],
    rows: Sequence[Sequence[str]],
    numbers: Sequence[int] = (),
    kind: str = "plain",
) -> str:
    """A table of cells that are HTML already; `numbers` are aligned to the right."""

    def cells(row: Sequence[str], tag: str) -> str:
        opened = [
            f'<{tag} class="number">' if i in numbers else f"<{tag}>"
            for i in range(len(row))
        ]
        return "".join(
            f"{start}{cell}</{tag}>" for start, cell in zip(opened, row, strict=True)
        )

    body = "\n".join(f"<tr>{cells(row, 'td')}</tr>" for row in rows)
    head = cells([escape(one) for one in heads], "th")
    return (
        f'<table class="{kind}">\n<thead><tr>{head}</tr></thead>\n'
        f"<tbody>\n{body}\n</tbody></table>"
    )


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _head(
    study: Study, ranking: Ranking, name: str, next_measurement: str
) -> Iterator[str]:
    devices = len({c.device for c in study.measurements.curves})
    judged = sum(1 for c in ranking.candidates if len(c.effects) == 1 and not c.unnamed)
    yield "<h1>Which physics is missing?</h1>"
    yield _paragraph(
        f"{name}: {_count(devices, 'device')}, "
        f"{_count(len(study.measurements.curves), 'curve')}, "
        f"{_count(len(study.readings.value), 'reading')}; "
        f"{_count(judged, 'effect')} judged, alone and in pairs.",
        "muted",
    )
    text = escape(verdict(ranking, next_measurement))
    yield f'<p class="verdict {escape(ranking.verdict)}">{text}</p>'
    yield _paragraph(
        "On devices left out of the fit, the baseline errs by "
        f"{ranking.baseline_error:.2f} times the noise; a model with the right physics "
        f"would err by about {ranking.noise_floor:.2f}, since each new device has its "
        "own tolerances."
    )


def _candidates(study: Study, ranking: Ranking) -> Iterator[str]:
    shown: list[Candidate] = []
    rest: list[Candidate] = []
    for i, one in enumerate(ranking.candidates):
        known = i < FIRST or one.name == "nothing" or one.tied_with
        (shown if known or one.probability > LEAST else rest).append(one)
    yield _heading("Candidates")
    heads = "".join(
        f"<th{' class=number' if head in _NUMBERS else ''}>{escape(head)}</th>"
        for head in _HEADS
    )
    bodies = "\n".join(_body(ranking, one) for one in shown)
    yield f"<table>\n<thead><tr>{heads}</tr></thead>\n{bodies}\n</table>"
    if rest:
        names = ", ".join(in_words(one.name) for one in rest)
        yield _paragraph(f"Judged, each below {100 * LEAST:g} %: {names}.", "muted")
    yield _paragraph(
        "Log odds are against the first. Held-out error: root mean square of what is "
        "left on devices that took no part in the fit, in units of the noise; worked "
        'out for the most probable and for "nothing missing".',
        "muted",
    )
    named = dict.fromkeys(name for one in shown for name in one.effects)
    told = [(name, study.effects[name]) for name in named if name in study.effects]
    if told:
        rows = [(escape(n), escape(_first(effect.doc))) for n, effect in told]
        yield _table(("Effect", "What it is"), rows, kind="named")


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
    name += f"<br>{_small(f'tied with {tied}')}" if tied else ""
    odds = escape(percent(one.probability))
    if one is not ranking.best:
        odds += f"<br>{_small(log_odds(ranking, one))}"
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


def _small(text: str) -> str:
    return f'<span class="muted">{escape(text)}</span>'


def _fails(text: str) -> Iterator[str]:
    if text:
        yield _heading("Where the baseline fails")
        yield from (_paragraph(line) for line in text.splitlines() if line.strip())


def _figure(drawn: list[Figure], figure: Figure, caption: str) -> str:
    """A place for a figure, which is drawn when the file is opened."""
    drawn.append(figure)
    height = figure["layout"]["height"]
    key = f"figure-{len(drawn) - 1}"
    return (
        f'<figure><div data-figure="{key}" style="min-height:{height:.0f}px"></div>'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def _figures(study: Study, ranking: Ranking, drawn: list[Figure]) -> Iterator[str]:
    baseline = ranking.candidate("nothing").fit
    named = [c for c in ranking.candidates if c.effects and not c.unnamed]
    groups = range(len(study.kinds))
    yield _heading("Figures")
    yield (
        "<noscript><p>The figures are drawn by the script in this file; the tables say "
        "the same without it.</p></noscript>"
    )
    yield _figure(
        drawn,
        figures.ranking_bars(ranking),
        "Probabilities add up to one over all explanations, those not shown included. "
        "Hatched: tied, these readings do not tell them apart.",
    )
    yield _figure(
        drawn,
        figures.residual_map(study, baseline),
        "Each cell is a reading less what the baseline predicts after moduli, "
        "thicknesses and camera scale were adjusted within their tolerances. Values "
        "within 2 noise standard deviations are what noise alone does.",
    )
    for group in groups:
        for devices in _pages(study, group):
            yield _figure(
                drawn,
                figures.overlay(study, group, baseline, ranking.best.fit, devices),
                "Points: measured, their bars 90 % of the noise. Bands: 90 % of what "
                "calibrations and sizes leave open. Open points: unloading.",
            )
    for group in groups if named else ():
        for devices in _pages(study, group):
            yield _figure(
                drawn,
                figures.signatures(study, group, baseline, named[:SIGNATURES], devices),
                "Points: what the baseline leaves. Lines: what each candidate changes "
                "at its best size, calibrations adjusted anew. The right one runs "
                "through the points on every device.",
            )
    yield _figure(
        drawn,
        figures.confusion_matrix(ranking),
        "If the explanation of a row were true, how often, in percent, readings of "
        "these devices with this noise would point to that of each column. Rows with "
        "large numbers off the diagonal cannot be told apart by these devices.",
    )


def _pages(study: Study, group: int) -> Iterator[Sequence[str]]:
    """Devices with readings of one quantity, as many at a time as a page holds."""
    names = figures.devices_of(study, group)
    for start in range(0, len(names), PANELS):
        yield names[start : start + PANELS]


def _next(text: str) -> Iterator[str]:
    if text:
        yield _heading("What to measure next")
        yield from (_paragraph(line) for line in text.splitlines() if line.strip())


def _unjudged(ranking: Ranking) -> Iterator[str]:
    if ranking.unjudged:
        yield _heading("What could not be judged")
        yield _table(
            ("Effect", "Why"),
            [(escape(n), escape(why)) for n, why in sorted(ranking.unjudged.items())],
        )


def _warnings(study: Study, ranking: Ranking) -> Iterator[str]:
    lines = dict.fromkeys((*study.measurements.warnings, *ranking.warnings))
    if lines:
        yield _heading("Warnings")
        yield f"<ul>{''.join(f'<li>{escape(line)}</li>' for line in lines)}</ul>"


def _errors(study: Study, best: Fit) -> Iterator[str]:
    """What the readings' errors were taken to be."""
    readings, smooth = best.readings, best.amplitude("smooth")
    rows = []
    for g in range(len(study.kinds)):
        at = readings.group == g
        axis = quantity_axis(study, g)
        noise = np.median(best.noise[at]) / axis.factor
        how = "stated" if readings.stated[at].all() else "inferred"
        share = f"{100 * smooth[g]:.1f} %" if g in smooth else "none"
        rows.append(
            (escape(axis.title), str(at.sum()), f"{noise:.2g} {axis.unit}", how, share)
        )
    yield _heading("Errors of the readings")
    yield _table(
        ("Quantity", "Readings", "Noise (std)", "Noise is", "Smooth errors"),
        rows,
        numbers=(1, 2, 4),
    )
    yield _paragraph(
        "Smooth errors bend a whole curve (camera set-up, mesh, small lacks of the "
        "model); inferred, as a share of the curve's largest value.",
        "muted",
    )


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
    yield _heading("Method")
    yield f"<ol>{''.join(f'<li>{escape(one)}</li>' for one in sentences)}</ol>"


def version() -> str:
    """Version of the installed package."""
    try:
        return metadata.version("pba")
    except metadata.PackageNotFoundError:  # run from a source tree
        return "0+source"


def _versions(study: Study, seed: int) -> Iterator[str]:
    measured = study.measurements
    rows = [
        ("Measurement file", measured.source or "not from a file"),
        ("Its SHA-256", measured.sha256 or "not from a file"),
        ("pba", version()),
        ("Generator version", GENERATOR_VERSION),
        ("Mesh", f"baseline {study.level}, changes by effects {study.fast}"),
        ("Seed", str(seed)),
        ("Effects", ", ".join(study.effects)),
    ]
    yield _heading("Versions")
    yield _table(
        ("What", "Which"),
        [(escape(what), f"<code>{escape(which)}</code>") for what, which in rows],
        kind="named",
    )
