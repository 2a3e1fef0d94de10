"""Parts of a report: one HTML file that opens anywhere, without a network, and prints.

Plotly's script is embedded once, from the installed wheel; a content security policy
in the file keeps it from fetching anything.  Every text is escaped here.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from html import escape
from importlib import resources
from pathlib import Path as FilePath

import numpy as np

from . import figures
from .compare import noise_source
from .evidence import Fit
from .figures import Figure
from .study import Study
from .words import quantity_axis

CONTENT_SECURITY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data: blob:; base-uri 'none'; form-action 'none'"
)

WIDTH = 690
"""px.  Width of a figure: what A4 holds between its margins."""

PANELS = 12
"""Devices in one figure: more would not fit on a page."""

_DRAW = """
for (const place of document.querySelectorAll("figure > div[data-figure]")) {
  const source = document.getElementById(place.dataset.figure);
  const figure = JSON.parse(source.textContent);
  Plotly.newPlot(place, figure.data, figure.layout,
                 {displaylogo: false, responsive: false});
}
"""


def document(title: str, body: str, drawn: Sequence[Figure]) -> str:
    """The file.

    Parameters
    ----------
    title : str
    body : str
        HTML, see the parts below.
    drawn : sequence of Figure
        Those that `figure` made places for.
    """
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


def heading(text: str) -> str:
    return f"<h2>{escape(text)}</h2>"


def paragraph(text: str, kind: str = "") -> str:
    opened = f'<p class="{kind}">' if kind else "<p>"
    return f"{opened}{escape(text)}</p>"


def table(
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


def count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def small(text: str) -> str:
    return f'<span class="muted">{escape(text)}</span>'


def figure(drawn: list[Figure], figure: Figure, caption: str) -> str:
    """A place for a figure, which is drawn when the file is opened."""
    drawn.append(figure)
    height = figure["layout"]["height"]
    key = f"figure-{len(drawn) - 1}"
    return (
        f'<figure><div data-figure="{key}" style="min-height:{height:.0f}px"></div>'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def pages(study: Study, group: int) -> Iterator[Sequence[str]]:
    """Devices with readings of one quantity, as many at a time as a page holds."""
    names = figures.devices_of(study, group)
    for start in range(0, len(names), PANELS):
        yield names[start : start + PANELS]


def errors(study: Study, best: Fit) -> Iterator[str]:
    """What the readings' errors were taken to be."""
    readings, smooth = best.readings, best.amplitude("smooth")
    rows = []
    for g in range(len(study.kinds)):
        at = readings.group == g
        axis = quantity_axis(study, g)
        noise = np.median(best.noise[at]) / axis.factor
        source = noise_source(study, g)
        share = f"{100 * smooth[g]:.1f} %" if g in smooth else "none"
        rows.append(
            (
                escape(axis.title),
                str(at.sum()),
                f"{noise:.2g} {axis.unit}",
                source,
                share,
            )
        )
    yield heading("Errors of the readings")
    yield table(
        ("Quantity", "Readings", "Noise (std)", "Noise is", "Smooth errors"),
        rows,
        numbers=(1, 2, 4),
    )
    yield paragraph(
        "Smooth errors bend a whole curve (camera set-up, mesh, small lacks of the "
        "model); inferred, as a share of the curve's largest value.",
        "muted",
    )
