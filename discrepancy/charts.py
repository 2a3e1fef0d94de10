"""Parts that every figure is made of: colours, axes, panels, bands."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

Array = np.ndarray

INK, MUTED, GRID, PAPER = "#1f2a37", "#5b6875", "#e3e8ee", "#ffffff"
COLOURS = ("#0b5fa5", "#b3541e", "#2e7d4f", "#7a4fa3", "#8a6d00", "#5b6875")
DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "longdashdot")
"""Told apart by lightness and by dashes too, for colour-blind eyes and for print."""

BASELINE, BEST = COLOURS[1], COLOURS[0]

DIVERGING = [
    [0.0, "#08427a"],
    [0.25, "#5d9bcf"],
    [0.5, "#f7f7f7"],
    [0.75, "#e0955f"],
    [1.0, "#8c3a0e"],
]
"""Blue below, white at 0, orange above: safe for all common colour blindness."""

SEQUENTIAL = [[0.0, "#ffffff"], [0.5, "#7fb2dd"], [1.0, "#08427a"]]

FONT = {"family": "system-ui, sans-serif", "size": 12, "color": INK}

PANEL, GAP, COLUMNS = 165, 46, 3
"""px.  Height of a panel and what lies between two; panels side by side."""

LINE, KEY = 84, 7
"""Letters that fit beside each other in a legend, and those that a key takes."""


def plain(text: str) -> str:
    """Text that Plotly shows as it is: it takes some HTML in names."""
    return html.escape(text, quote=False)


def layout_of(title: str, height: float, top: float = 64) -> dict[str, Any]:
    """Layout with a title, `height` and the margin above the drawing in px."""
    return {
        "title": {
            "text": title,
            "x": 0,
            "xref": "container",
            "y": 1,
            "yref": "container",
            "yanchor": "top",
            "pad": {"t": 8, "l": 4},
            "font": FONT | {"size": 14},
        },
        "height": height,
        "font": FONT,
        "paper_bgcolor": PAPER,
        "plot_bgcolor": PAPER,
        "hoverlabel": {"font": FONT, "bgcolor": PAPER},
        "margin": {"l": 62, "r": 14, "t": top, "b": 48},
    }


def axis(title: str = "", **more: Any) -> dict[str, Any]:
    """An axis in the common style."""
    style = {
        "gridcolor": GRID,
        "linecolor": MUTED,
        "ticks": "outside",
        "ticklen": 3,
        "tickcolor": MUTED,
        "zeroline": False,
    }
    if title:
        style["title"] = {"text": title, "standoff": 6}
    return style | more


def suffix(index: int) -> str:
    """What Plotly appends to the names of the axes of panel 0, 1, 2, ...: ``x2``."""
    return "" if index == 0 else str(index + 1)


def note(text: str, x: float, y: float, **more: Any) -> dict[str, Any]:
    """A line of text whose lower left corner is at shares x, y of the drawing."""
    return {
        "text": text,
        "x": x,
        "y": y,
        "xref": "paper",
        "yref": "paper",
        "showarrow": False,
        "xanchor": "left",
        "yanchor": "bottom",
        "font": FONT,
    } | more


def faint(colour: str) -> str:
    """A colour for the band around a line of it."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.22)"


def panels(
    title: str,
    names: Sequence[str],
    x: str,
    y: str,
    legend: Sequence[str],
    shared: bool = False,
) -> dict[str, Any]:
    """Layout of a panel for each name, `COLUMNS` side by side.

    Parameters
    ----------
    title : str
    names : sequence of str
        Of the panels, row by row.
    x, y : str
        Titles of the axes.
    legend : sequence of str
        Entries for which there has to be room above the panels.
    shared : bool
        Whether all panels have the first one's range up and down.
    """
    count = len(names)
    columns = min(count, COLUMNS)
    rows = math.ceil(count / columns)
    inner = rows * PANEL + (rows - 1) * GAP
    lines = 1 + sum(len(entry) + KEY for entry in legend) // LINE
    room = 54 + 28 * lines
    layout = layout_of(title, inner + room + 48, top=room)
    layout["legend"] = {"orientation": "h", "x": 0, "y": 1 + 22 / inner}
    layout["legend"] |= {"yanchor": "bottom"}
    layout["annotations"] = []
    wide = (1 - 0.075 * (columns - 1)) / columns
    for i, name in enumerate(names):
        row, column = divmod(i, columns)
        left = column * (wide + 0.075)
        top = 1 - row * (PANEL + GAP) / inner
        last = i + columns >= count
        layout[f"xaxis{suffix(i)}"] = axis(
            x if last else "",
            domain=[left, min(left + wide, 1.0)],
            anchor=f"y{suffix(i)}",
        )
        layout[f"yaxis{suffix(i)}"] = axis(
            y if column == 0 else "",
            domain=[max(top - PANEL / inner, 0.0), top],
            anchor=f"x{suffix(i)}",
            zeroline=True,
            zerolinecolor=MUTED,
            **({"matches": "y"} if shared and i else {}),
        )
        layout["annotations"].append(note(f"<b>{plain(name)}</b>", left, top))
    return layout


def band(
    x: Array, low: Array, high: Array, colour: str, axes: dict[str, str]
) -> list[dict[str, Any]]:
    """Traces of the area between two lines (s,) over x (s,), all in bench units."""
    edge = {
        "type": "scatter",
        "mode": "lines",
        "x": x.tolist(),
        "line": {"width": 0},
        "hoverinfo": "skip",
        "showlegend": False,
    } | axes
    return [
        edge | {"y": low.tolist()},
        edge | {"y": high.tolist(), "fill": "tonexty", "fillcolor": faint(colour)},
    ]
