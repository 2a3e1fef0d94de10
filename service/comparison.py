"""A comparison in bench units: its JSON, and what it says in words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from datagen.specimens import Tensile
from datagen.units import PRESSURE, Bench
from discrepancy.columns import NUMBERS
from discrepancy.compare import Calibration, Comparison, Failure, Noise
from discrepancy.measurement import LOADING
from discrepancy.missing import CLAIM, Kind, Score
from discrepancy.regions import FADING, GROWING

QUANTITY_WORDS = {
    "tip_deflection": "tip deflection",
    "bending_angle": "bending angle",
    "inflation": "inflation",
    "inflation_lower": "inflation of the floor",
    "cavity_volume": "cavity volume",
    "stress": "stress",
}

STRETCH = Bench("stretch", "stretch", "", 1.0)

SOURCE_WORDS = {
    "stated": "stated",
    "repeats": "from repeats",
    "inferred": "inferred",
}


def quantity(kind: tuple[str, str]) -> str:
    """Bench name of a (specimen, quantity), with the specimen unless an actuator."""
    specimen, name = kind
    bench = NUMBERS[name].bench.name
    return bench if specimen == "actuator" else f"{specimen}.{bench}"


def load_of(specimen: str) -> Bench:
    """What is applied to a specimen, and its unit."""
    return STRETCH if specimen == "tensile" else PRESSURE


def number(value: float, digits: int = 3) -> float | None:
    """A number with as many digits as it is worth; None where there is none."""
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None


def numbers(values: Any, digits: int = 5) -> list[float | None]:
    return [number(float(value), digits) for value in values]


# -- words -------------------------------------------------------------------------


def _subject(kind: Kind, comparison: Comparison) -> str:
    """``Inflation while unloading`` of a kind of readings, as short as it is clear."""
    words = QUANTITY_WORDS[kind.quantity]
    own = [
        curve
        for curve in comparison.measurements.curves
        if curve.specimen == kind.specimen and kind.quantity in curve.outputs
    ]
    if kind.branch and any((curve.branch != LOADING).any() for curve in own):
        words += f" while {kind.branch}"
    if len({curve.orientation for curve in own}) > 1:
        degrees = NUMBERS["orientation"].bench.from_si(kind.orientation)
        words += f" at orientation {degrees:g} deg"
    return words


def _group(failure: Failure, comparison: Comparison) -> str:
    """``devices with an upper layer under 80 um``."""
    region = failure.region
    names = {"bulge": "bulge specimens", "tensile": "tensile specimens"}
    plural = names.get(region.kind.specimen, "devices")
    if not region.trait:
        if region.devices == 1:
            return failure.devices[0]
        kind = region.kind
        whole = {
            curve.device
            for curve in comparison.measurements.curves
            if curve.specimen == kind.specimen
            and kind.quantity in curve.outputs
            and math.isclose(curve.orientation, kind.orientation, abs_tol=1e-9)
        }
        if region.devices < len(whole):
            return f"the {region.devices} {plural} measured there"
        return f"all {region.devices} {plural}"
    bench = NUMBERS[region.trait].bench
    side = "over" if region.above else "under"
    limit = f"{bench.from_si(failure.limit):g} {bench.unit}".rstrip()
    words = {
        "upper_thickness": "an upper layer {}",
        "lower_thickness": "a lower layer {}",
        "upper_modulus": "an upper modulus {}",
        "lower_modulus": "a lower modulus {}",
        "length": "a length {}",
        "width": "a width {}",
        "balloon_length": "a balloon length {}",
        "balloon_width": "a balloon width {}",
        "balloon_start": "a balloon start {}",
        "wall": "walls {}",
        "divisions_x": "divisions along the length {}",
        "divisions_y": "divisions across the width {}",
        "cavity_height": "a cavity height {}",
    }[region.trait]
    return f"{plural} with {words.format(f'{side} {limit}')}"


def _loads(failure: Failure) -> str:
    region = failure.region
    load = load_of(region.kind.specimen)
    low, high = (float(f"{load.from_si(v):.4g}") for v in (region.low, region.high))
    unit = f" {load.unit}" if load.unit else ""
    what = "" if load.unit else "stretch "
    if region.growth == GROWING and not region.whole:
        return f"above {what}{low:g}{unit}"
    if region.growth == FADING and not region.whole:
        return f"below {what}{high:g}{unit}"
    return f"from {what}{low:g} to {high:g}{unit}"


def failure_text(failure: Failure, comparison: Comparison) -> str:
    """One sentence on where the baseline fails."""
    region = failure.region
    side = "above" if failure.share > 0 else "below"
    percent = 100 * abs(failure.share)
    size = f"{percent:.{0 if percent >= 10 else 1}f} %"
    over = "" if failure.of_model else " of the largest reading"
    load = load_of(region.kind.specimen)
    ends = {GROWING: region.high, FADING: region.low}
    where = ""
    if region.growth in ends and region.low < region.high:
        at = f"{load.from_si(ends[region.growth]):.4g} {load.unit}".rstrip()
        where = f" at {at}" if load.unit else f" at stretch {at}"
    subject = _subject(region.kind, comparison)
    return (
        f"{subject[0].upper()}{subject[1:]} of {_group(failure, comparison)}, "
        f"{_loads(failure)}: measured {size}{over} {side} the model{where}, on average "
        f"{abs(failure.noises):.2g} times the noise."
    )


def calibration_text(one: Calibration) -> str:
    """``modulus of the 2.5 MPa batch +3.1 % ± 2.0 %``."""
    if one.kind == "thickness":
        scale, unit, what = 1e6, "um", f"thickness of {one.of[0]}"
    elif one.kind == "modulus":
        stated = NUMBERS["upper_modulus"].bench.from_si(one.stated)
        scale, unit, what = 100.0, "%", f"modulus of the {stated:g} MPa batch"
    else:
        scale, unit, what = 100.0, "%", f"camera scale of {one.of[0]}"
    change = round(scale * one.change, 1) + 0.0  # no minus before nothing
    return f"{what} {change:+.1f} {unit} ± {scale * one.std:.1f} {unit}"


def verdict_text(comparison: Comparison) -> list[str]:
    """The answer in a few sentences."""
    p = max(comparison.p_value, 1e-4)
    devices = len(comparison.measurements.devices)
    shown = f"p {'<' if comparison.p_value < p else '='} {p:.1g}"
    unit = "device" if devices == 1 else "devices"
    if not comparison.missing:
        lines = [
            f"Nothing is missing as far as {devices} {unit} can tell ({shown}): noise, "
            "smooth errors and the stated tolerances explain the readings."
        ]
    else:
        lines = [f"Something is missing in the model ({shown}, {devices} {unit})."]
        lines += [failure_text(one, comparison) for one in comparison.fails_where]
        if not comparison.fails_where:
            lines.append("Where it fails cannot be told from these readings.")
    lines += [
        f"To fit, the {calibration_text(one)} would have to hold, "
        f"{abs(one.pull):.1f} times the tolerance from what is stated."
        for one in comparison.pulled
    ]
    return lines


# -- JSON --------------------------------------------------------------------------


def comparison_json(comparison: Comparison, level: str) -> dict[str, Any]:
    """What ``pba compare --json`` prints."""
    measurements = comparison.measurements
    return {
        "file": measurements.source,
        "sha256": measurements.sha256,
        "level": level,
        "devices": len(measurements.devices),
        "readings": len(comparison.fit.readings.value),
        "missing": comparison.missing,
        "p_value": number(comparison.p_value),
        "claim_below": CLAIM,
        "text": " ".join(verdict_text(comparison)),
        "baseline_error": number(comparison.baseline_error, 4),
        "noise_floor": number(comparison.noise_floor, 4),
        "quantities": {
            quantity(kind): {
                "readings": error.readings,
                "rmse": number(NUMBERS[kind[1]].bench.from_si(error.raw), 4),
                "rmse_calibrated": number(
                    NUMBERS[kind[1]].bench.from_si(error.calibrated), 4
                ),
                "residual": number(error.residual, 4),
                "heldout_error": number(error.heldout, 4),
            }
            for kind, error in comparison.errors.items()
        },
        "noise": {
            quantity(kind): _noise_json(kind, noise)
            for kind, noise in comparison.noise.items()
        },
        "calibrations": [_calibration_json(one) for one in comparison.calibrations],
        "tests": [_score_json(one) for one in comparison.tests],
        "fails_where": [
            failure_json(one, comparison) for one in comparison.fails_where
        ],
        "curves": _curves_json(comparison),
        "warnings": list(comparison.warnings),
    }


def _noise_json(kind: tuple[str, str], noise: Noise) -> dict[str, Any]:
    bench = NUMBERS[kind[1]].bench
    return {
        "std": number(bench.from_si(noise.value), 4),
        "unit": bench.unit,
        "source": noise.source,
    }


def _calibration_json(one: Calibration) -> dict[str, Any]:
    scale, unit = (1e6, "um") if one.kind == "thickness" else (100.0, "%")
    stated: dict[str, Any] = {}
    if one.kind == "modulus":
        stated = {
            "stated_MPa": number(NUMBERS["upper_modulus"].bench.from_si(one.stated), 6)
        }
    elif one.kind == "thickness":
        stated = {"stated_um": number(1e6 * one.stated, 6)}
    return {
        "kind": one.kind,
        "of": list(one.of),
        **stated,
        "change": number(scale * one.change, 4),
        "std": number(scale * one.std, 4),
        "tolerance": number(scale * one.tolerance, 4),
        "unit": unit,
        "text": calibration_text(one),
    }


def _kind_json(kind: Kind) -> dict[str, Any]:
    degrees = NUMBERS["orientation"].bench.from_si(kind.orientation)
    return {
        "specimen": kind.specimen,
        "quantity": NUMBERS[kind.quantity].bench.name,
        "branch": kind.branch or "both",
        "orientation_deg": number(degrees, 6),
    }


def _score_json(one: Score) -> dict[str, Any]:
    of: Mapping[str, Any] = _kind_json(one.kind) if one.kind else {}
    return {
        "test": one.what,
        **of,
        "devices": one.devices,
        "mean_pct": number(100 * one.mean),
        "p_value": number(one.p),
    }


def failure_json(failure: Failure, comparison: Comparison) -> dict[str, Any]:
    """One region where the baseline fails, as data in bench units."""
    region = failure.region
    load = load_of(region.kind.specimen)
    design = None
    if region.trait:
        bench = NUMBERS[region.trait].bench
        limit = float(bench.from_si(failure.limit))
        design = {
            "variable": bench.name,
            "min": number(limit, 6) if region.above else None,
            "max": None if region.above else number(limit, 6),
            "same_devices_by": [NUMBERS[name].bench.name for name in region.alike],
        }
    return {
        "text": failure_text(failure, comparison),
        **_kind_json(region.kind),
        load.name: [
            number(float(load.from_si(end)), 6) for end in (region.low, region.high)
        ],
        "all_loads": region.whole,
        "with_load": region.growth,
        "design": design,
        "measured": "above" if failure.share > 0 else "below",
        "effect_pct": number(100 * failure.share),
        "effect_std_pct": number(100 * failure.error),
        "effect_of": "model" if failure.of_model else "largest reading",
        "effect_noise": number(failure.noises),
        "devices": list(failure.devices),
        "readings": len(region.at),
        "p_value": number(region.p),
    }


def _curves_json(comparison: Comparison) -> list[dict[str, Any]]:
    found = []
    for c, curve in enumerate(comparison.measurements.curves):
        load = load_of("tensile" if isinstance(curve.design, Tensile) else "")
        own = [one for one in comparison.curves if one.curve == c]
        quantities = {}
        for one in own:
            bench = NUMBERS[one.quantity].bench
            quantities[bench.name] = {
                "measured": numbers(bench.from_si(one.measured)),
                "baseline": numbers(bench.from_si(one.raw)),
                "calibrated": numbers(bench.from_si(one.calibrated)),
                "noise": numbers(bench.from_si(one.noise)),
                "residual": numbers(one.residual),
                "whitened": numbers(one.whitened),
            }
        degrees = NUMBERS["orientation"].bench.from_si(curve.orientation)
        found.append(
            {
                "device": curve.device,
                "run": curve.run,
                "orientation_deg": number(degrees, 6),
                "specimen": curve.specimen,
                load.name: numbers(load.from_si(np.asarray(curve.load)), 6),
                "branch": [str(branch) for branch in curve.branch],
                "quantities": quantities,
            }
        )
    return found
