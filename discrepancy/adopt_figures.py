"""Figures of an adoption: the ladder of held-out errors, devices before and after."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from .adopt import Adoption
from .bands import calibrated_band
from .charts import (
    BASELINE,
    BEST,
    COLOURS,
    MUTED,
    axis,
    faint,
    layout_of,
    note,
    plain,
)
from .figures import Figure, Line, curves
from .ladder import FLOOR, Rung
from .words import in_words

ROW = 34
"""px.  Height of a rung."""


def ladder_figure(rungs: Sequence[Rung]) -> Figure:
    """Held-out error of each rung with its 90 % interval, the noise floor as a band.

    Parameters
    ----------
    rungs : sequence of Rung
        The noise floor last.

    Returns
    -------
    Figure
        On a logarithmic axis: equal steps are equal factors.
    """
    shown = [one for one in rungs if math.isfinite(one.heldout_error)]
    floor = next((one for one in shown if one.name == FLOOR), None)
    steps = [one for one in shown if one.name != FLOOR]
    layout = layout_of("Error on devices left out of the fit", 108 + ROW * len(steps))
    layout["margin"]["r"] = 40
    layout["xaxis"] = axis("Error (noise std)", type="log", dtick="D2")
    layout["yaxis"] = axis(
        range=[len(steps) - 0.5, -0.5],
        tickvals=list(range(len(steps))),
        ticktext=[plain(one.name) for one in steps],
        showgrid=False,
        automargin=True,
    )
    layout["shapes"], layout["annotations"] = [], []
    if floor is not None:
        across = {"xref": "x", "yref": "paper", "y0": 0, "y1": 1, "layer": "below"}
        layout["shapes"] = [
            {"type": "rect", "x0": floor.low, "x1": floor.high}
            | {"fillcolor": faint(MUTED), "line": {"width": 0}}
            | across,
            {"type": "line", "x0": floor.heldout_error, "x1": floor.heldout_error}
            | {"line": {"color": MUTED, "width": 1.5, "dash": "dash"}}
            | across,
        ]
        text = f"{FLOOR} {floor.heldout_error:.2f}"
        layout["annotations"].append(
            note(text, math.log10(floor.heldout_error), 1.0, xref="x", xanchor="center")
        )
    trace: dict[str, Any] = {
        "type": "scatter",
        "mode": "markers+text",
        "x": [one.heldout_error for one in steps],
        "y": list(range(len(steps))),
        "error_x": {
            "type": "data",
            "symmetric": False,
            "array": [_reach(one.high - one.heldout_error) for one in steps],
            "arrayminus": [_reach(one.heldout_error - one.low) for one in steps],
            "thickness": 1.6,
            "width": 5,
            "color": MUTED,
        },
        "marker": {
            "size": 10,
            "color": [BEST if one.effects else BASELINE for one in steps],
            "symbol": ["circle" if one.effects else "diamond" for one in steps],
        },
        "text": [f"{one.heldout_error:.2f}" for one in steps],
        "textposition": "top center",
        "cliponaxis": False,
        "customdata": [_hover(one) for one in steps],
        "hovertemplate": "%{customdata}<extra></extra>",
        "showlegend": False,
    }
    return {"data": [trace], "layout": layout}


def _reach(value: float) -> float:
    """Length of an error bar; none where the interval is not known."""
    return max(value, 0.0) if math.isfinite(value) else 0.0


def _hover(one: Rung) -> str:
    lines = [
        f"<b>{plain(one.name)}</b>",
        f"{one.heldout_error:.3g}, 90 % {one.low:.3g} to {one.high:.3g}"
        if math.isfinite(one.heldout_error)
        else "no device was left out",
    ]
    if math.isfinite(one.ratio):
        lines.append(
            f"{one.ratio:.3g} times the rung before, "
            f"{one.ratio_low:.3g} to {one.ratio_high:.3g}"
        )
    return "<br>".join(lines)


def before_after(
    made: Adoption, group: int, devices: Sequence[str] | None = None
) -> Figure:
    """Measured devices, the baseline, and the model with the effects in it.

    Parameters
    ----------
    made : Adoption
    group : int
        Quantity, by its number in `Study.kinds`.
    devices : sequence of str, optional
        Those to show; all by default.
    """
    study = made.study
    what = in_words(made.fit.hypothesis.name)
    lines = [
        Line("Baseline, as stated", "dash", BASELINE, study.base),
        Line(f"With {what}, as stated", "dot", COLOURS[2], made.corrected),
        Line(
            f"With {what}, calibrated",
            "solid",
            BEST,
            made.fit.predict(),
            calibrated_band(made.fit, made.seed),
        ),
    ]
    return curves(study, group, lines, made.fit, devices)
