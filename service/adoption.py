"""An adoption and the versions it makes, for people and as JSON in bench units."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from datagen.specimens import Tensile
from discrepancy.adopt import Adoption, emulation_error
from discrepancy.columns import NUMBERS
from discrepancy.judging import Candidate
from discrepancy.ladder import Rung
from discrepancy.layout import BASELINE
from discrepancy.version import Estimate, ModelVersion, rung_json
from discrepancy.words import BENCH, decimals, sizes

from .comparison import load_of, number, numbers


def adoption_json(made: Adoption, version: ModelVersion) -> dict[str, Any]:
    """The contract's object of ``pba adopt --json``.

    Parameters
    ----------
    made : Adoption
    version : ModelVersion
        As it was saved.
    """
    return {
        "ladder": [rung_json(one) for one in made.ladder],
        "parameters": made.parameters,
        "model": str(version.folder),
        "version": version.version,
        "parent": version.parent,
        "effects": list(made.effects),
        "interval": made.interval,
        "emulation_error": number(emulation_error(made)),
        "curves": curves_json(made),
        "measurements": [
            {"name": one.name, "sha256": one.sha256, "devices": list(one.devices)}
            for one in version.measurements
        ],
    }


def curves_json(made: Adoption) -> list[dict[str, Any]]:
    """Measured devices before and after, a curve each.

    ``baseline`` and ``corrected`` are finite elements of the devices as stated,
    ``calibrated`` is the corrected model with what the tolerances leave open inferred.
    """
    study = made.study
    calibrated = made.fit.predict()
    found: dict[int, dict[str, Any]] = {}
    for c in dict.fromkeys(c for c, _, _ in study.cells):
        curve = study.measurements.curves[c]
        load = load_of("tensile" if isinstance(curve.design, Tensile) else "")
        quantities = {}
        for m, output in enumerate(curve.outputs):
            at = [i for i, cell in enumerate(study.cells) if cell[::2] == (c, m)]
            if not at:
                continue
            steps = [study.cells[i][1] for i in at]
            bench = NUMBERS[output].bench
            quantities[bench.name] = {
                load.name: numbers(load.from_si(np.asarray(curve.load)[steps]), 6),
                "measured": numbers(bench.from_si(study.readings.value[at])),
                "noise": numbers(bench.from_si(made.fit.noise[at])),
                "baseline": numbers(bench.from_si(study.base[at])),
                "corrected": numbers(bench.from_si(made.corrected[at])),
                "calibrated": numbers(bench.from_si(calibrated[at])),
            }
        degrees = NUMBERS["orientation"].bench.from_si(curve.orientation)
        found[c] = {
            "device": curve.device,
            "run": curve.run,
            "orientation_deg": number(degrees, 6),
            "specimen": curve.specimen,
            "quantities": quantities,
        }
    return list(found.values())


def ladder_table(rungs: Sequence[Rung]) -> Table:
    """Rungs with their held-out errors, in noise."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("model", no_wrap=True)
    for head in (
        "error on devices\nleft out",
        "90 %\ninterval",
        "over the rung\nbefore",
    ):
        table.add_column(head, justify="right", no_wrap=True)
    for rung in rungs:
        ratio = f"{rung.ratio:.2f} ({_span(rung.ratio_low, rung.ratio_high)})"
        table.add_row(
            escape(rung.name),
            _two(rung.heldout_error),
            _span(rung.low, rung.high),
            ratio if math.isfinite(rung.ratio) else "",
        )
    return table


def _two(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "-"


def _span(low: float, high: float) -> str:
    return f"{_two(low)} to {_two(high)}" if math.isfinite(low) else "-"


def size_lines(made: Adoption) -> list[str]:
    """Fitted parameters against their literature ranges."""
    return [
        f"{size.name}: {size.number} (90 % interval {size.interval}); {size.judgement}."
        for size in sizes(Candidate(made.fit, 1.0))
    ]


# -- versions ----------------------------------------------------------------------


def version_row(version: ModelVersion) -> dict[str, Any]:
    """A version in short."""
    return {
        "version": version.version,
        "parent": version.parent,
        "effects": list(version.effects),
        "date": version.date,
        "measurements": [one.name for one in version.measurements],
        "baseline_error": number(version.ladder[0].heldout_error, 5),
        "heldout_error": number(version.ladder[-2].heldout_error, 5),
        "noise_floor": number(version.ladder[-1].heldout_error, 5),
    }


def version_json(version: ModelVersion) -> dict[str, Any]:
    """A version in full, samples left out."""
    data = version.to_json()
    data.pop("samples")
    return {
        "version": version.version,
        **data,
        "samples": len(version.samples),
        "surrogate": version.surrogate is not None,
        "doubts": list(version.doubts()),
    }


def estimate_text(one: Estimate) -> str:
    """``cure_mismatch.difference -0.000508 ± 0.000006``, in its bench unit."""
    unit, factor = BENCH.get(one.unit, (one.unit, 1.0))
    digits = decimals(one.std / factor)
    value, std = one.value / factor, one.std / factor
    return f"{one.name} {value:.{digits}f} ± {std:.{digits}f} {unit}".rstrip()


def named(version: ModelVersion | None) -> str:
    """Version and effects in words, for an answer that used them."""
    if version is None:
        return BASELINE
    return f"{version.version} with {', '.join(version.effects)}"


def difference(a: ModelVersion | None, b: ModelVersion | None) -> dict[str, Any]:
    """What changes from one version to another; None is the baseline.

    ``parameters`` holds, for those of either, both values with their standard
    deviations, and their distance over the standard deviation of the difference.
    """
    ours, theirs = (
        {} if one is None else {e.name: e for e in one.estimates} for one in (a, b)
    )
    parameters = {}
    for name in dict.fromkeys([*ours, *theirs]):
        before, after = ours.get(name), theirs.get(name)
        row: dict[str, Any] = {
            "unit": (before or after).unit,  # type: ignore[union-attr]
            "before": None if before is None else [before.value, before.std],
            "after": None if after is None else [after.value, after.std],
            "change": None,
            "sigmas": None,
        }
        if before is not None and after is not None:
            row["change"] = after.value - before.value
            both = math.hypot(before.std, after.std)
            row["sigmas"] = number(row["change"] / both) if both else None
        parameters[name] = row
    effects = [set() if one is None else set(one.effects) for one in (a, b)]
    settings = {}
    for name in ("level", "fast", "seed", "generator", "package", "commit"):
        if a is not None and b is not None and getattr(a, name) != getattr(b, name):
            settings[name] = [getattr(a, name), getattr(b, name)]
    files = [set() if one is None else set(one.measurements) for one in (a, b)]
    return {
        "effects_added": sorted(effects[1] - effects[0]),
        "effects_removed": sorted(effects[0] - effects[1]),
        "parameters": parameters,
        "measurements_added": sorted(one.name for one in files[1] - files[0]),
        "measurements_removed": sorted(one.name for one in files[0] - files[1]),
        "heldout_error": [
            None if one is None else number(one.ladder[-2].heldout_error, 5)
            for one in (a, b)
        ],
        "settings": settings,
    }
