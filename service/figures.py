"""Figures, as plain Plotly descriptions: one function each, for page and notebook.

A figure is ``{"data": [...], "layout": {...}}``, which is what Plotly's JavaScript
draws and what ``plotly.graph_objects.Figure`` takes; nothing heavy is imported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from datagen.device import MM, MPA, UM, Design
from datagen.errors import InputError
from datagen.response import OUTPUTS
from datagen.units import BY_FIELD

Figure = dict[str, Any]

INK, MUTED, GRID = "#1f2a37", "#5b6875", "#e3e8ee"
COLOURS = ("#0b5fa5", "#b3541e", "#2e7d4f", "#7a4fa3", "#8a6d00", "#5b6875")
"""Readable on white, and apart for colour-blind eyes by lightness too."""

FONT = {"family": "system-ui, sans-serif", "size": 13, "color": INK}

TITLES = {
    "tip_deflection": "Tip deflection",
    "bending_angle": "Bending angle",
    "inflation": "Inflation of the roof",
    "inflation_lower": "Inflation of the floor",
    "cavity_volume": "Cavity volume",
}

LAYER = {"upper": "#7fb2dd", "spacer": "#c9d3dc", "lower": "#aab8c4", "void": "#ffffff"}

PANEL, GAP = 230, 36
"""px.  Height of one panel of curves, and what lies between two."""


def _titles() -> dict[str, tuple[str, str]]:
    """Title and unit of every quantity, by bench name."""
    return {
        BY_FIELD[output.name].name: (TITLES[output.name], BY_FIELD[output.name].unit)
        for output in OUTPUTS
    }


def response_figure(
    answers: Sequence[Mapping[str, Any]], quantities: Sequence[str]
) -> Figure:
    """Quantities against pressure, one panel each, with the 90 % interval as a band.

    Parameters
    ----------
    answers : sequence of mapping
        Bodies of ``/v1/predict``: a line with its band for the surrogate, markers on a
        line for the finite elements.
    quantities : sequence of str
        Bench names, one panel each from above.

    Raises
    ------
    InputError
        When a quantity is unknown.
    """
    titles = _titles()
    for name in quantities:
        if name not in titles:
            raise InputError("quantities", name, ", ".join(titles))
    count = len(quantities)
    height = count * PANEL + (count - 1) * GAP
    layout = _layout(height + 95)
    layout["hovermode"] = "x"
    layout["legend"] = {"orientation": "h", "x": 0, "y": 1, "yanchor": "bottom"}
    layout["margin"] = {"l": 64, "r": 12, "t": 38, "b": 46}
    layout["xaxis"] = _axis("Pressure (kPa)") | {"anchor": f"y{_suffix(count - 1)}"}
    data: list[dict[str, Any]] = []
    for row, name in enumerate(quantities):
        title, unit = titles[name]
        top = 1 - row * (PANEL + GAP) / height
        layout[f"yaxis{_suffix(row)}"] = _axis(f"{title} ({unit})") | {
            "domain": [max(0.0, top - PANEL / height), top],
            "zeroline": True,
            "zerolinecolor": MUTED,
        }
        for i, answer in enumerate(answers):
            data += _curve(answer, name, f"y{_suffix(row)}", i, legend=row == 0)
    return {"data": data, "layout": layout}


def _suffix(index: int) -> str:
    return "" if index == 0 else str(index + 1)


def _curve(
    answer: Mapping[str, Any], name: str, axis: str, index: int, legend: bool
) -> list[dict[str, Any]]:
    """Band and line of one quantity of one answer; markers for finite elements."""
    fem = answer["source"] == "fem"
    colour = INK if fem else COLOURS[index % len(COLOURS)]
    unit = _titles()[name][1]
    label = "Finite elements" if fem else "Surrogate, 90 % interval"
    x, quantity = answer["pressure_kPa"], answer[name]
    order = sorted(range(len(x)), key=lambda i: x[i])
    pressure = [x[i] for i in order]
    common = {"x": pressure, "yaxis": axis, "legendgroup": f"{label}{index}"}
    traces: list[dict[str, Any]] = []
    if not fem:
        edge = {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip"}
        low, high = ([quantity[key][i] for i in order] for key in ("low", "high"))
        fill = {"fill": "tonexty", "fillcolor": _faint(colour)}
        traces.append(common | edge | {"y": low, "showlegend": False})
        traces.append(common | edge | fill | {"y": high, "showlegend": False})
    line = {"color": colour, "width": 2, "dash": "dot" if fem else "solid"}
    traces.append(
        common
        | {
            "y": [quantity["value"][i] for i in order],
            "mode": "lines+markers",
            "line": line,
            "marker": {"size": 8 if fem else 5, "symbol": "x" if fem else "circle"},
            "name": label,
            "showlegend": legend,
            "connectgaps": False,
            "hovertemplate": f"%{{y:.4g}} {unit}<extra>{label}</extra>",
        }
    )
    return [{"type": "scatter"} | trace for trace in traces]


def _faint(colour: str) -> str:
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.18)"


def _layout(height: float) -> dict[str, Any]:
    return {
        "height": height,
        "font": FONT,
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "#ffffff",
        "hoverlabel": {"font": FONT | {"size": 12}},
    }


def _axis(title: str) -> dict[str, Any]:
    return {
        "title": {"text": title, "standoff": 8},
        "gridcolor": GRID,
        "linecolor": MUTED,
        "ticks": "outside",
        "tickcolor": MUTED,
        "zeroline": False,
        "automargin": True,
    }


def device_figure(design: Design) -> Figure:
    """The device to scale: from above, and cut lengthwise through a row of balloons.

    Parameters
    ----------
    design : Design

    Notes
    -----
    Both views have the same scale along and across; the cut goes through the middle of
    the balloon nearest to y = 0.
    """
    length, width = design.length / MM, design.width / MM
    thickness = design.thickness / MM
    room, line = 0.03 * length, 0.06 * length  # for the clamp, and a line of text
    # One drawing in the plane of the paper: the cut below the view from above.
    cut = -(width / 2 + room + 2 * line)
    top, bottom = width / 2 + room / 2 + line, cut - thickness - room
    layout = _layout(0)
    hidden = {"visible": False, "fixedrange": True}
    layout |= {
        "shapes": [*_top_view(design, room), *_cut_view(design, cut, room)],
        "annotations": [
            _note(width / 2 + room / 2, f"From above, {length:.4g} x {width:.4g} mm"),
            _note(cut + room / 2, "Cut lengthwise, same scale"),
        ],
        "margin": {"l": 2, "r": 2, "t": 2, "b": 2},
        "plot_bgcolor": "rgba(0,0,0,0)",
        "xaxis": hidden | {"range": [-2 * room, length + room]},
        "yaxis": hidden | {"range": [bottom, top], "scaleanchor": "x"},
        # The page sets the height from the width it has.
        "meta": {"aspect": (top - bottom) / (length + 3 * room)},
    }
    del layout["height"]
    return {"data": _hover(design, cut), "layout": layout}


def _note(y: float, text: str) -> dict[str, Any]:
    """A line of text above the clamp."""
    return {
        "x": 0,
        "y": y,
        "text": text,
        "showarrow": False,
        "font": FONT | {"size": 12},
        "xanchor": "left",
        "yanchor": "bottom",
    }


def _box(x0: float, y0: float, x1: float, y1: float, fill: str) -> dict[str, Any]:
    return {
        "type": "rect",
        "x0": x0,
        "y0": y0,
        "x1": x1,
        "y1": y1,
        "fillcolor": fill,
        "line": {"color": INK, "width": 1},
        "layer": "below",
    }


def _clamp(y0: float, y1: float, room: float) -> dict[str, Any]:
    box = _box(-room, y0 - room / 2, 0, y1 + room / 2, MUTED)
    return box | {"line": {"width": 0}}


def _top_view(design: Design, room: float) -> list[dict[str, Any]]:
    """Shapes of the strip and its balloons from above, mm, y up the paper."""
    half = design.width / MM / 2
    shapes = [
        _clamp(-half, half, room),
        _box(0, -half, design.length / MM, half, LAYER["upper"]),
    ]
    for x0, x1 in design.balloons_x():
        for y0, y1 in _all_balloons_y(design):
            shapes.append(_box(x0 / MM, y0 / MM, x1 / MM, y1 / MM, LAYER["void"]))
    return shapes


def _all_balloons_y(design: Design) -> list[tuple[float, float]]:
    """y intervals of the balloons over the whole width, m."""
    size = design.balloon_size[1]
    left = -design.span_y / 2
    return [
        (left + j * (size + design.wall), left + j * (size + design.wall) + size)
        for j in range(design.divisions_y)
    ]


def _cut_view(design: Design, top: float, room: float) -> list[dict[str, Any]]:
    """Shapes of the lengthwise cut, its upper side at `top`, mm."""
    length = design.length / MM
    roof = top - design.upper_thickness / MM
    floor = roof - design.cavity_height / MM
    bottom = floor - design.lower_thickness / MM
    shapes = [
        _clamp(bottom, top, room),
        _box(0, floor, length, roof, LAYER["spacer"]),
        _box(0, bottom, length, floor, LAYER["lower"]),
        _box(0, roof, length, top, LAYER["upper"]),
    ]
    for x0, x1 in design.balloons_x():
        shapes.append(_box(x0 / MM, floor, x1 / MM, roof, LAYER["void"]))
    return shapes


def _hover(design: Design, cut: float) -> list[dict[str, Any]]:
    """Invisible points that name the parts under the pointer."""
    middle = design.length / MM / 2
    roof = cut - design.upper_thickness / MM
    floor = roof - design.cavity_height / MM
    x0, x1 = design.balloons_x()[0]
    upper = f"upper layer, {design.upper_thickness / UM:.4g} µm, "
    lower = f"lower layer, {design.lower_thickness / UM:.4g} µm, "
    points = [
        (
            middle,
            cut - design.upper_thickness / MM / 2,
            f"{upper}{design.upper_modulus / MPA:.3g} MPa",
        ),
        (
            (x0 + x1) / 2 / MM,
            (roof + floor) / 2,
            f"cavity, {design.cavity_height / UM:.4g} µm high",
        ),
        (
            middle,
            floor - design.lower_thickness / MM / 2,
            f"{lower}{design.lower_modulus / MPA:.3g} MPa",
        ),
        (0.0, 0.0, "clamp"),
        (design.length / MM, 0.0, "tip: its deflection is read here"),
    ]
    return [
        {
            "type": "scatter",
            "mode": "markers",
            "x": [x for x, _, _ in points],
            "y": [y for _, y, _ in points],
            "text": [text for _, _, text in points],
            "hovertemplate": "%{text}<extra></extra>",
            "marker": {"opacity": 0, "size": 14},
            "showlegend": False,
        }
    ]
