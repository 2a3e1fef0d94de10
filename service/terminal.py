"""What the command line shows to people: tables, curves, progress."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from datagen.errors import PbaError
from datagen.units import QUANTITY

if TYPE_CHECKING:
    from rich.progress import Progress
    from rich.status import Status

BARS = "▁▂▃▄▅▆▇█"

DIGITS = {"mm": 4, "deg": 3, "uL": 4}
"""Decimals shown by unit."""

STILL = 5e-5
"""mm.  A smaller deflection is shown as 0.0000 and told as none."""

SHORT = {
    "tip_deflection_mm": "tip",
    "bending_angle_deg": "angle",
    "inflation_mm": "inflation",
    "inflation_lower_mm": "lower",
    "cavity_volume_uL": "volume",
}
"""Column heads; the unit follows in the next line."""


class Stopped(PbaError):
    """Ctrl-C with something to say; typer keeps the words of no KeyboardInterrupt."""


def print_json(data: Mapping[str, Any]) -> None:
    """One JSON object on one line."""
    from .bench import plain

    print(json.dumps(plain(data), allow_nan=False), flush=True)


def print_rich(table: Table) -> None:
    """A table as wide as the terminal."""
    Console().print(table)


def waiting(words: str, quiet: bool) -> Status:
    """A spinner on standard error while something computes."""
    return Console(stderr=True, quiet=quiet).status(words)


def sparkline(values: Sequence[float | None], width: int = 10) -> str:
    """A curve in one line of text; a gap where there is no value.

    Parameters
    ----------
    values : sequence of float or None
    width : int
        Most characters; longer curves are thinned out.
    """
    if len(values) > width:
        last = len(values) - 1
        values = [values[round(i * last / (width - 1))] for i in range(width)]
    known = [v for v in values if v is not None]
    if not known:
        return ""
    low, high = min(known), max(known)
    step = (high - low) / (len(BARS) - 1)
    return "".join(
        " " if v is None else BARS[round((v - low) / step) if step > 0 else 0]
        for v in values
    )


def path_table(lists: Mapping[str, Any]) -> Table:
    """A path as a table: a row for each load step, with half its interval if any.

    Of finite elements that is the mesh error.

    Parameters
    ----------
    lists : mapping
        The JSON of ``pba solve`` or ``pba predict``.
    """
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("pressure\nkPa", justify="right")
    names = [name for name in QUANTITY if name in lists]
    for name in names:
        unit = QUANTITY[name].unit
        table.add_column(f"{SHORT[name]}\n{unit}", justify="right")
    for i, pressure in enumerate(lists["pressure_kPa"]):
        cells = [_number(lists, name, i) for name in names]
        table.add_row(f"{pressure:g}", *cells)
    if len(lists["pressure_kPa"]) > 2:
        table.add_row("", *(sparkline(lists[name]) for name in names), style="dim")
    return table


def _number(lists: Mapping[str, Any], name: str, i: int) -> str:
    value = lists[name][i]
    if value is None:
        return "-"
    digits = DIGITS[QUANTITY[name].unit]
    text = f"{round(value, digits) + 0:.{digits}f}"  # + 0 turns -0.0 into 0.0
    half = _half_interval(lists, name, i)
    if half is None:
        return text
    return f"{text}±{half:.{1 if lists.get('mesh_error') else 2}g}"


def _half_interval(lists: Mapping[str, Any], name: str, i: int) -> float | None:
    """Of the surrogate its interval, of the finite elements their mesh error."""
    if lists.get("mesh_error"):
        error: float | None = lists["mesh_error"][name][i]
        return error or None  # nothing at rest
    low, high = (lists.get(f"{name}_{end}") for end in ("low", "high"))
    if low is None or high is None or not high[i] > low[i]:
        return None
    return float(high[i] - low[i]) / 2


def sensitivity_table(lists: Mapping[str, Any]) -> Table:
    """What a little more of each parameter changes at the highest pressure reached.

    Parameters
    ----------
    lists : mapping
        The JSON of ``pba solve --sensitivities``.
    """
    found = lists["sensitivities"]
    first = next(iter(next(iter(found.values())).values()))
    reached = [i for i, value in enumerate(first) if value is not None]
    pressures = lists["pressure_kPa"]
    at = max(reached, key=lambda i: abs(pressures[i]), default=0)
    table = Table(
        title=f"change at {pressures[at]:g} kPa", box=None, title_justify="left"
    )
    table.add_column("with")
    for name in found:
        unit = QUANTITY[name].unit
        table.add_column(f"{SHORT[name]}\n{unit}", justify="right")
    for name in next(iter(found.values())):
        value = lists["design"].get(name)
        label, step = (
            (f"{escape(name)} +1 %", value / 100)
            if value is not None
            else (f"a unit of {escape(name)}", 1.0)
        )
        slopes = (columns[name][at] for columns in found.values())
        table.add_row(
            label, *("-" if s is None else f"{s * step:+.2g}" for s in slopes)
        )
    return table


def verdict(lists: Mapping[str, Any]) -> str:
    """One line: which way the tip goes, how far the roof rises, how the path ended."""
    pressure, tip = lists["pressure_kPa"], lists["tip_deflection_mm"]
    reached = [i for i, value in enumerate(tip) if value is not None]
    if not reached:
        return f"No load step was reached: {lists['message'] or lists['status']}."
    top = max(reached, key=lambda i: abs(pressure[i]))
    text = (
        f"At {pressure[top]:g} kPa {_tip_words(tip[top])} and the roof "
        f"{lists['inflation_mm'][top]:.3g} mm higher than its edge"
    )
    if lists["status"] != "completed":
        text += f"; then the path ends: {lists['message'] or lists['status']}"
        if lists.get("limit_pressure_error_kPa") is not None:
            text += f" (mesh error {lists['limit_pressure_error_kPa']:.2g} kPa)"
    if lists.get("unknowns"):
        text += f" ({lists['unknowns']} unknowns, {lists['seconds']:.1f} s)"
    return text + "."


def _tip_words(tip: float) -> str:
    if abs(tip) < STILL:
        return "the tip is where it was"
    return f"the tip is {abs(tip):.3g} mm {'up' if tip > 0 else 'down'}"


def accuracy_tables(found: Mapping[str, Any]) -> Iterator[Table]:
    """Errors over all held-out designs, then by region.

    Parameters
    ----------
    found : mapping
        The JSON of ``pba accuracy``.
    """
    inside = f"{found['coverage']['90']:.0%} inside the 90 % interval"
    sizes = f"{found['n_test']} held-out designs, trained on {found['n_train']}"
    yield _errors(f"{sizes}; {inside}", found["outputs"])
    for part in found["regions"]:
        by, region = part["by"], part["region"]
        title = region if region.startswith(by) else f"{by} {region}"
        yield _errors(f"{title} ({part['designs']} designs)", part["outputs"])


def _errors(title: str, outputs: Mapping[str, Mapping[str, Any]]) -> Table:
    """Errors of each quantity; percentages are of each path's maximum."""
    table = Table(title=escape(title), box=None, pad_edge=False, title_justify="left")
    heads = {
        "rmse": "rmse",
        "median_pct": "median %",
        "p95_pct": "95th %",
        "max_pct": "worst %",
        "r2": "R2",
        "coverage": "inside",
    }
    table.add_column("quantity")
    for head in heads.values():
        table.add_column(head, justify="right")
    for name, errors in outputs.items():
        table.add_row(name, *(_short(errors.get(key)) for key in heads))
    return table


def _short(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.4g}"


@contextmanager
def progress_bar(unit: str, quiet: bool = False) -> Iterator[Progress]:
    """A bar on standard error with rate and time left; nothing when it is no terminal.

    Parameters
    ----------
    unit : str
        What is counted, as in ``paths``.
    quiet : bool
        Show nothing at all.
    """
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
    )

    console = Console(stderr=True)
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        TextColumn("{task.fields[note]}"),
        TimeElapsedColumn(),
        console=console,
        disable=quiet or not console.is_terminal,
        transient=True,
    ) as bar:
        yield bar


def duration(seconds: float | None) -> str:
    """A time in words short enough for a progress bar."""
    if seconds is None:
        return "?"
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
