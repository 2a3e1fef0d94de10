"""Figures of a comparison and a ranking, as plain Plotly descriptions.

A figure is ``{"data": [...], "layout": {...}}``, which is what Plotly's JavaScript
draws and what ``plotly.graph_objects.Figure`` takes; nothing heavy is imported.  Page,
report and notebook show the same ones.  Those with a panel for each device show one
quantity, named by the number of its group of readings (`Study.kinds`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from .bands import MARGIN, calibrated_band
from .charts import (
    BASELINE,
    BEST,
    COLOURS,
    DASHES,
    DIVERGING,
    INK,
    MUTED,
    PAPER,
    SEQUENTIAL,
    axis,
    band,
    layout_of,
    note,
    panels,
    plain,
    suffix,
)
from .evidence import Fit
from .judging import Candidate, Ranking
from .measurement import UNLOADING
from .study import Study
from .words import in_words, load_axis, log_odds, percent, quantity_axis, sizes

Array = np.ndarray
Figure = dict[str, Any]

ROW, NUMBERED = 26, 14
"""px.  Height of a row of a map; most cells of a row that have room for numbers."""

SHOWN, LEAST = 12, 1e-3
"""Most hypotheses in the ranking's bars, and the probability that others need."""


class Line(NamedTuple):
    """A prediction in a figure.

    label, dash, colour : str; values : (n,) array, SI, of all readings, NaN where there
    is none; ends : (n,) arrays of a band around it, or None.
    """

    label: str
    dash: str
    colour: str
    values: Array
    ends: tuple[Array, Array] | None = None


def _curves(study: Study, group: int, device: int) -> list[Array]:
    """Indices of the readings of one quantity of one device, a curve each."""
    readings = study.readings
    at = np.flatnonzero((readings.group == group) & (readings.device == device))
    curve = readings.curve[at]
    return [at[curve == one] for one in dict.fromkeys(curve.tolist())]


def loads(study: Study) -> Array:
    """(n,) load of every reading: gauge pressure, Pa, or stretch."""
    curves = study.measurements.curves
    return np.array([curves[c].load[s] for c, s, _ in study.cells])


def _unloading(study: Study) -> Array:
    curves = study.measurements.curves
    return np.array([curves[c].branch[s] == UNLOADING for c, s, _ in study.cells])


def devices_of(study: Study, group: int) -> tuple[str, ...]:
    """Devices and specimens that have readings of one quantity."""
    readings, names = study.readings, study.measurements.devices
    found = np.unique(readings.device[readings.group == group])
    return tuple(names[i] for i in found)


def _chosen(study: Study, group: int, devices: Sequence[str] | None) -> list[str]:
    return [
        name for name in devices_of(study, group) if devices is None or name in devices
    ]


def _curve_name(study: Study, at: Array) -> str:
    """Run and orientation of a curve, where they are not the usual ones."""
    curve = study.measurements.curves[study.cells[at[0]][0]]
    turned = math.degrees(curve.orientation)
    parts = [f"run {curve.run}"] if curve.run > 1 else []
    parts += [f"turned by {turned:.4g} deg"] if abs(turned) > 1e-9 else []
    return ", ".join(parts)


# -- the figures -----------------------------------------------------------------------


def overlay(
    study: Study,
    group: int,
    baseline: Fit,
    best: Fit | None = None,
    devices: Sequence[str] | None = None,
) -> Figure:
    """Measured points over the calibrated baseline and the best hypothesis.

    Parameters
    ----------
    study : Study
    group : int
        Quantity, by its number in `Study.kinds`.
    baseline : Fit
        Of the hypothesis that nothing is missing.
    best : Fit, optional
        Of another hypothesis.
    devices : sequence of str, optional
        Those to show; all by default.

    Returns
    -------
    Figure
        Bars and bands hold 90 %: bars of the noise, bands of what the readings leave
        open in calibrations and parameters.
    """
    fits = [("Baseline, calibrated", "dash", BASELINE, baseline)]
    if best is not None and best.hypothesis.name != baseline.hypothesis.name:
        label = f"With {in_words(best.hypothesis.name)}"
        fits.append((label, "solid", BEST, best))
    lines = [
        Line(label, dash, colour, fit.predict(), calibrated_band(fit))
        for label, dash, colour, fit in fits
    ]
    return curves(study, group, lines, baseline, devices)


def curves(
    study: Study,
    group: int,
    lines: Sequence[Line],
    noise: Fit,
    devices: Sequence[str] | None = None,
) -> Figure:
    """Measured points over predictions, a panel a device.

    Parameters
    ----------
    study : Study
    group : int
        Quantity, by its number in `Study.kinds`.
    lines : sequence of Line
    noise : Fit
        Whose noise the bars of the points show, 90 % of it.
    devices : sequence of str, optional
        Those to show; all by default.
    """
    y, x = quantity_axis(study, group), load_axis(study, group)
    names = _chosen(study, group, devices)
    load = loads(study) / x.factor
    down = _unloading(study)
    title = f"{y.title}: measured and predicted"
    labels = [line.label for line in lines]
    layout = panels(title, names, x.label, y.label, [*labels, "Measured"])
    data: list[dict[str, Any]] = []
    for i, name in enumerate(names):
        axes = {"xaxis": f"x{suffix(i)}", "yaxis": f"y{suffix(i)}"}
        device = study.measurements.devices.index(name)
        for j, at in enumerate(_curves(study, group, device)):
            first = i == 0 and j == 0
            for line in lines:
                if line.ends is not None:
                    low, high = (end[at] / y.factor for end in line.ends)
                    data += band(load[at], low, high, line.colour, axes)
                value = line.values[at] / y.factor
                data.append(
                    {
                        "type": "scatter",
                        "mode": "lines",
                        "x": load[at].tolist(),
                        "y": [v if math.isfinite(v) else None for v in value.tolist()],
                        "line": {"color": line.colour, "width": 1.8, "dash": line.dash},
                        "name": plain(line.label),
                        "legendgroup": line.label,
                        "showlegend": first,
                        "hovertemplate": f"%{{y:.4g}} {y.unit}"
                        f"<extra>{plain(line.label)}</extra>",
                    }
                    | axes
                )
            data.append(_measured(study, at, load, down, noise, y, first) | axes)
    return {"data": data, "layout": layout}


def _measured(
    study: Study,
    at: Array,
    load: Array,
    down: Array,
    fit: Fit,
    y: Any,
    first: bool,
) -> dict[str, Any]:
    """Points of one curve with the bars of their noise; open ones on unloading."""
    run = _curve_name(study, at)
    return {
        "type": "scatter",
        "mode": "markers",
        "x": load[at].tolist(),
        "y": (study.readings.value[at] / y.factor).tolist(),
        "error_y": {
            "type": "data",
            "array": (MARGIN * fit.noise[at] / y.factor).tolist(),
            "color": INK,
            "thickness": 1,
            "width": 2,
        },
        "marker": {
            "color": INK,
            "size": 5,
            "symbol": ["circle-open" if d else "circle" for d in down[at]],
        },
        "name": "Measured",
        "legendgroup": "measured",
        "showlegend": first,
        "hovertemplate": f"%{{y:.4g}} {y.unit}<extra>Measured"
        f"{', ' + run if run else ''}</extra>",
    }


def residual_map(study: Study, baseline: Fit) -> Figure:
    """What the calibrated baseline leaves, in units of noise, over load and device.

    One panel a quantity, one row a curve and branch; readings of a row at one load are
    averaged.  Colours are full at the 95th percentile, or at 3.
    """
    residual = (study.readings.value - baseline.predict()) / baseline.noise
    full = max(3.0, float(np.percentile(np.abs(residual), 95)))
    groups = range(len(study.kinds))
    rows = {g: _rows(study, g) for g in groups}
    load = loads(study)
    high = {g: max(ROW * len(rows[g]), 60) for g in groups}
    inner = sum(high.values()) + 84 * (len(high) - 1)
    layout = layout_of("Where the baseline fails: measured less predicted", inner + 112)
    layout["margin"]["t"] = 62
    layout["annotations"] = []
    layout["coloraxis"] = {
        "colorscale": DIVERGING,
        "cmin": -full,
        "cmax": full,
        "colorbar": {
            "title": {"text": "Residual<br>(noise std)", "side": "top"},
            "thickness": 12,
            "outlinewidth": 0,
        },
    }
    data: list[dict[str, Any]] = []
    top = 1.0
    for g in groups:
        x = load_axis(study, g)
        bottom = top - high[g] / inner
        labels = [label for label, _ in rows[g]]
        layout[f"xaxis{suffix(g)}"] = axis(
            x.label, anchor=f"y{suffix(g)}", showgrid=False
        )
        layout[f"yaxis{suffix(g)}"] = axis(
            domain=[max(bottom, 0.0), top],
            anchor=f"x{suffix(g)}",
            range=[len(labels) - 0.5, -0.5],
            tickvals=list(range(len(labels))),
            ticktext=[plain(label) for label in labels],
            showgrid=False,
            automargin=True,
        )
        title = f"<b>{quantity_axis(study, g).title}</b>"
        layout["annotations"].append(note(title, 0, top))
        for i, (label, at) in enumerate(rows[g]):
            data.append(
                _strip(load[at] / x.factor, residual[at], i, label, x.unit)
                | {"xaxis": f"x{suffix(g)}", "yaxis": f"y{suffix(g)}"}
            )
        top = bottom - 84 / inner
    return {"data": data, "layout": layout}


def _rows(study: Study, group: int) -> list[tuple[str, Array]]:
    """Name and readings of every curve and branch of one quantity."""
    down, found = _unloading(study), []
    for name in devices_of(study, group):
        for at in _curves(study, group, study.measurements.devices.index(name)):
            for branch, part in (("", at[~down[at]]), (UNLOADING, at[down[at]])):
                more = [text for text in (_curve_name(study, at), branch) if text]
                if len(part):
                    found.append((", ".join([name, *more]), part))
    return found


def _strip(x: Array, z: Array, row: int, label: str, unit: str) -> dict[str, Any]:
    """One row of a map: a cell around each load, as wide as the loads are apart."""
    place, which = np.unique(x, return_inverse=True)
    mean = np.bincount(which, weights=z) / np.bincount(which)
    middle = (place[1:] + place[:-1]) / 2
    step = place[1] - place[0] if len(place) > 1 else 1.0
    edges = np.concatenate(
        [
            [place[0] - step / 2],
            middle,
            [place[-1] + (place[-1] - middle[-1] if len(middle) else step / 2)],
        ]
    )
    return {
        "type": "heatmap",
        "x": edges.tolist(),
        "y": [row - 0.46, row + 0.46],
        "z": [mean.tolist()],
        "coloraxis": "coloraxis",
        "customdata": [place.tolist()],
        "texttemplate": "%{z:.1f}" if len(place) <= NUMBERED else "",
        "textfont": {"size": 10},
        "hovertemplate": f"%{{customdata:.4g}} {unit}: %{{z:.2f}}"
        f"<extra>{plain(label)}</extra>",
    }


def signatures(
    study: Study,
    group: int,
    baseline: Fit,
    candidates: Sequence[Candidate],
    devices: Sequence[str] | None = None,
) -> Figure:
    """What each candidate changes at its best fit, over what the baseline leaves.

    Both against the calibrated baseline, the candidate calibrated anew: a candidate
    that is right runs through the points.  In units of noise.

    Parameters
    ----------
    study : Study
    group : int
        Quantity, by its number in `Study.kinds`.
    baseline : Fit
    candidates : sequence of Candidate
        As many as there are `COLOURS` at most.
    devices : sequence of str, optional
    """
    x = load_axis(study, group)
    names = _chosen(study, group, devices)
    title = f"{quantity_axis(study, group).title}: what each candidate would explain"
    legend = [*(in_words(one.name) for one in candidates), "Measured less baseline"]
    layout = panels(title, names, x.label, "Change (noise std)", legend, shared=True)
    load = loads(study) / x.factor
    start, noise = baseline.predict(), baseline.noise
    residual = (study.readings.value - start) / noise
    changes = [(one.fit.predict() - start) / noise for one in candidates]
    data: list[dict[str, Any]] = []
    for i, name in enumerate(names):
        axes = {"xaxis": f"x{suffix(i)}", "yaxis": f"y{suffix(i)}"}
        device = study.measurements.devices.index(name)
        for j, at in enumerate(_curves(study, group, device)):
            common = {"x": load[at].tolist(), "showlegend": i == 0 and j == 0} | axes
            for one, change, colour, dash in zip(
                candidates, changes, COLOURS, DASHES, strict=False
            ):
                data.append(
                    common
                    | {
                        "type": "scatter",
                        "mode": "lines",
                        "y": change[at].tolist(),
                        "line": {"color": colour, "width": 1.8, "dash": dash},
                        "name": plain(in_words(one.name)),
                        "legendgroup": one.name,
                        "hovertemplate": "%{y:.2f}"
                        f"<extra>{plain(in_words(one.name))}</extra>",
                    }
                )
            data.append(
                common
                | {
                    "type": "scatter",
                    "mode": "markers",
                    "y": residual[at].tolist(),
                    "marker": {"color": INK, "size": 5},
                    "name": "Measured less baseline",
                    "legendgroup": "residual",
                    "hovertemplate": "%{y:.2f}<extra>Measured less baseline</extra>",
                }
            )
    return {"data": data, "layout": layout}


def ranking_bars(ranking: Ranking) -> Figure:
    """Probability of every hypothesis, best first; those the verdict ties are marked.

    The log odds against the best one, the sizes and the held-out error are under the
    pointer.
    """
    shown = [
        one
        for i, one in enumerate(ranking.candidates)
        if one.name == "nothing" or one.tied_with or i < 3 or one.probability > LEAST
    ][:SHOWN]
    hover = []
    for one in shown:
        lines = [f"<b>{plain(in_words(one.name))}</b>"]
        lines.append(
            f"probability {percent(one.probability)}, {log_odds(ranking, one)}"
        )
        lines += [
            plain(f"{size.name} {size.number}, 90 % {size.interval}")
            for size in sizes(one)
        ]
        if math.isfinite(one.heldout_error):
            lines.append(f"held-out error {one.heldout_error:.2f} noise std")
        tied = one.tied_with
        if tied:
            others = ", ".join(in_words(name) for name in tied)
            lines.append(plain(f"tied with {others}"))
        hover.append("<br>".join(lines))
    trace = {
        "type": "bar",
        "orientation": "h",
        "x": [100 * one.probability for one in shown],
        "y": list(range(len(shown))),
        "text": [
            percent(one.probability) + (" (tied)" if one.tied_with else "")
            for one in shown
        ],
        "textposition": "outside",
        "cliponaxis": False,
        "customdata": hover,
        "hovertemplate": "%{customdata}<extra></extra>",
        "marker": {
            "color": [_bar_colour(ranking, one) for one in shown],
            "pattern": {
                "shape": ["/" if one.tied_with else "" for one in shown],
                "fgcolor": PAPER,
                "size": 7,
                "solidity": 0.25,
            },
        },
    }
    layout = layout_of("How probable each explanation is", 92 + 28 * len(shown), top=40)
    layout["margin"]["r"] = 90
    layout["bargap"] = 0.3
    layout["xaxis"] = axis("Probability (%)", range=[0, 100])
    layout["yaxis"] = axis(
        range=[len(shown) - 0.5, -0.5],
        tickvals=list(range(len(shown))),
        ticktext=[plain(in_words(one.name)) for one in shown],
        automargin=True,
        showgrid=False,
    )
    return {"data": [trace], "layout": layout}


def _bar_colour(ranking: Ranking, one: Candidate) -> str:
    if one.name in ranking.effects:
        return BEST
    return BASELINE if one.name == "nothing" else MUTED


def confusion_matrix(ranking: Ranking) -> Figure:
    """How often readings like these would be given to the right hypothesis, percent."""
    names = [plain(in_words(name)) for name in ranking.confused]
    share = 100 * np.asarray(ranking.confusion)
    places = list(range(len(names)))
    layout = layout_of("Could these readings tell the explanations apart?", 0, top=40)
    layout["height"] = 150 + 30 * len(names) + 40
    layout["xaxis"] = axis(
        "this would be named",
        tickvals=places,
        ticktext=names,
        tickangle=-35,
        showgrid=False,
        automargin=True,
    )
    layout["yaxis"] = axis(
        "If this were true,",
        range=[len(names) - 0.5, -0.5],
        tickvals=places,
        ticktext=names,
        showgrid=False,
        automargin=True,
    )
    trace = {
        "type": "heatmap",
        "x": places,
        "y": places,
        "z": share.tolist(),
        "zmin": 0,
        "zmax": 100,
        "colorscale": SEQUENTIAL,
        "texttemplate": "%{z:.0f}",
        "xgap": 1,
        "ygap": 1,
        "customdata": [[[row, column] for column in names] for row in names],
        "hovertemplate": "%{customdata[0]} would be taken for %{customdata[1]}: "
        "%{z:.1f} %<extra></extra>",
        "colorbar": {
            "title": {"text": "Probability<br>(%)", "side": "top"},
            "thickness": 12,
            "outlinewidth": 0,
        },
    }
    return {"data": [trace], "layout": layout}
