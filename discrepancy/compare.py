"""The baseline against measurements: errors, noise, calibrations, and where it fails.

Nothing here knows an effect: the baseline is calibrated within the stated tolerances,
and what is left is held against noise and smooth errors inside curves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from datagen.device import Design
from datagen.units import DESIGN

from .columns import NUMBERS
from .evidence import Fit, fit
from .heldout import left_out, noise_floor
from .measurement import Curve, Measurements
from .missing import CLAIM, Kind, Labels, Residuals, Score, overall, scores
from .regions import Region, regions
from .study import Study

Array = np.ndarray

STATED, REPEATS, INFERRED = "stated", "repeats", "inferred"
"""Where the noise of a quantity is from."""

PULLED = 2.0
"""Tolerances from its stated value at which a calibration is told."""


@dataclass(frozen=True)
class Noise:
    """Independent noise of one quantity.

    Parameters
    ----------
    value : float, SI
        Median of its readings.
    source : str
        ``stated``, ``repeats`` (pooled standard deviation of repeated runs) or
        ``inferred`` from how the readings scatter about smooth curves.
    """

    value: float
    source: str


@dataclass(frozen=True)
class Error:
    """Errors of the baseline in one quantity.

    Parameters
    ----------
    readings : int
    raw, calibrated : float, SI
        Root mean square of measured less baseline, as stated and calibrated.
    residual : float
        The calibrated one, each reading over its noise.
    heldout : float
        The same on devices left out of the calibration one at a time; NaN where there
        is but one device.
    """

    readings: int
    raw: float
    calibrated: float
    residual: float
    heldout: float


@dataclass(frozen=True)
class Calibration:
    """One stated value, and what the readings say of the true one.

    Parameters
    ----------
    kind : str
        ``modulus`` (relative), ``thickness`` (m) or ``scale`` (relative, of a curve).
    of : tuple of str
        Layers (``S1 upper``) or the device and run.
    stated : float, SI
        1 for a scale.
    change, std : float
        Posterior mean and standard deviation of true less stated, relative where the
        kind is.
    tolerance : float
        Standard deviation before any reading.
    """

    kind: str
    of: tuple[str, ...]
    stated: float
    change: float
    std: float
    tolerance: float

    @property
    def pull(self) -> float:
        """Distance from the stated value in tolerances."""
        return self.change / self.tolerance if self.tolerance else 0.0


@dataclass(frozen=True)
class Compared:
    """One quantity of one curve; arrays (s,) over its load steps, SI.

    NaN where there is no reading, or where it is past the end of the baseline's path.

    Parameters
    ----------
    measured, raw, calibrated : (s,) array, SI
        Reading, baseline as stated, baseline calibrated.
    noise : (s,) array, SI
    residual : (s,) array
        Measured less calibrated, over the noise.
    whitened : (s,) array
        The same over noise and smooth errors, correlation along the curve taken out.
    """

    curve: int
    quantity: str
    measured: Array
    raw: Array
    calibrated: Array
    noise: Array
    residual: Array
    whitened: Array


@dataclass(frozen=True)
class Failure:
    """Where the calibrated baseline fails, with the size of the misfit.

    Parameters
    ----------
    region : Region
    devices : tuple of str
    limit : float, SI
        Its design variable's threshold, rounded; NaN where all devices are in.
    share, error : float
        Where it is largest: measured less model over the model, and the standard
        deviation of that; over the curve's maximum where the model is near zero.
    of_model : bool
        Whether it is over the model.
    noises : float
        Mean misfit of the region's readings, over the noise.
    """

    region: Region
    devices: tuple[str, ...]
    limit: float
    share: float
    error: float
    of_model: bool
    noises: float


@dataclass(frozen=True)
class Comparison:
    """The answer to "does the baseline explain these measurements".

    Parameters
    ----------
    measurements : Measurements
    fit : Fit
        The calibrated baseline.
    curves : tuple of Compared
    errors, noise : dict of (specimen, quantity) to Error, Noise
    calibrations : tuple of Calibration
    tests : tuple of Score
    p_value : float
        Of nothing being missing.
    fails_where : tuple of Failure
        Clearest first; empty where nothing is claimed to be missing.
    baseline_error, noise_floor : float
        As `rank.Ranking` has them.
    warnings : tuple of str
    """

    measurements: Measurements
    fit: Fit
    curves: tuple[Compared, ...]
    errors: dict[tuple[str, str], Error]
    noise: dict[tuple[str, str], Noise]
    calibrations: tuple[Calibration, ...]
    tests: tuple[Score, ...]
    p_value: float
    fails_where: tuple[Failure, ...]
    baseline_error: float
    noise_floor: float
    warnings: tuple[str, ...]

    @property
    def missing(self) -> bool:
        """Whether something is missing."""
        return self.p_value < CLAIM

    @property
    def pulled(self) -> tuple[Calibration, ...]:
        """Calibrations that are farther from the stated value than is likely."""
        return tuple(one for one in self.calibrations if abs(one.pull) > PULLED)


def compare(study: Study, seed: int = 0) -> Comparison:
    """Hold the calibrated baseline against the measurements of a study.

    Parameters
    ----------
    study : Study
        Needs no candidates: ``effects=()`` solves the baseline alone.
    seed : int
        Of the simulated errors behind a region's p-value.
    """
    best = fit(study.readings, study.null(), evidence=False)
    labels = labels_of(study)
    residuals = Residuals(best)
    clearest, found = regions(best, labels, seed)
    count = len(np.unique(study.readings.device))
    tests = [
        *scores(residuals, labels),
        Score(None, "region", count, math.nan, clearest),
    ]
    p_value = overall(tests)
    heldout = left_out(best)
    return Comparison(
        measurements=study.measurements,
        fit=best,
        curves=_curves(study, residuals),
        errors={
            kind: _error(study, residuals, heldout, g)
            for g, kind in enumerate(study.kinds)
        },
        noise={kind: _noise(study, best, g) for g, kind in enumerate(study.kinds)},
        calibrations=_calibrations(study, residuals),
        tests=tuple(tests),
        p_value=p_value,
        fails_where=tuple(
            _failure(study, best, labels, one) for one in found if p_value < CLAIM
        ),
        baseline_error=_rms(heldout),
        noise_floor=noise_floor(best),
        warnings=(*study.measurements.warnings, *study.warnings),
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def labels_of(study: Study) -> Labels:
    """Kind, load and design of every reading, and calibrations judged together."""
    kinds: dict[Kind, int] = {}
    kind, load = [], []
    for c, s, m in study.cells:
        curve = study.measurements.curves[c]
        one = Kind(
            curve.specimen, curve.outputs[m], curve.orientation, str(curve.branch[s])
        )
        kind.append(kinds.setdefault(one, len(kinds)))
        load.append(float(curve.load[s]))
    names = study.measurements.devices
    designs = {curve.device: curve.design for curve in study.measurements.curves}
    traits = {}
    for bench in DESIGN.values():
        values = np.full(len(names), np.nan)
        for d, name in enumerate(names):
            design = designs[name]
            if isinstance(design, Design):
                values[d] = design.to_dict()[bench.field]
        traits[bench.field] = values
    together: dict[tuple[object, ...], list[int]] = {}
    for i, key in enumerate(study.calibrations.names):
        alike = key if key[0] == "modulus" else (key[0], *key[2:])
        together.setdefault(alike, []).append(i)
    pulls = np.zeros((len(study.calibrations.names), len(together)))
    for j, members in enumerate(together.values()):
        pulls[members, j] = 1 / math.sqrt(len(members))
    return Labels(tuple(kinds), np.array(kind), np.array(load), traits, pulls)


def noise_source(study: Study, g: int) -> str:
    """Where the noise of a group of readings is from, or of those of unknown noise."""
    at = study.readings.group == g
    if not study.readings.stated[at].all():
        return INFERRED
    curves = study.measurements.curves
    own = {(c, m) for (c, _, m), here in zip(study.cells, at, strict=True) if here}
    given = all(np.isfinite(curves[c].std[:, m]).any() for c, m in own)
    return STATED if given else REPEATS


def _noise(study: Study, best: Fit, g: int) -> Noise:
    at = study.readings.group == g
    return Noise(float(np.median(best.noise[at])), noise_source(study, g))


def _error(study: Study, residuals: Residuals, heldout: Array, g: int) -> Error:
    at = study.readings.group == g
    best = residuals.fit
    return Error(
        readings=int(at.sum()),
        raw=_rms((study.readings.value - study.base)[at]),
        calibrated=_rms(residuals.value[at]),
        residual=_rms((residuals.value / best.noise)[at]),
        heldout=_rms(heldout[at]),
    )


def _curves(study: Study, residuals: Residuals) -> tuple[Compared, ...]:
    best = residuals.fit
    columns = {
        "measured": study.readings.value,
        "raw": study.base,
        "calibrated": best.predict(),
        "noise": best.noise,
        "residual": residuals.value / best.noise,
        "whitened": residuals.whitened,
    }
    found: dict[tuple[int, int], dict[str, Array]] = {}
    for i, (c, s, m) in enumerate(study.cells):
        steps = len(study.measurements.curves[c].load)
        if (c, m) not in found:
            found[c, m] = {name: np.full(steps, np.nan) for name in columns}
        for name, values in columns.items():
            found[c, m][name][s] = values[i]
    return tuple(
        Compared(c, study.measurements.curves[c].outputs[m], **arrays)
        for (c, m), arrays in found.items()
    )


def _calibrations(study: Study, residuals: Residuals) -> tuple[Calibration, ...]:
    measurements, means = study.measurements, residuals.calibrations
    stds = np.sqrt(np.diag(residuals.posterior))
    allowed = measurements.tolerances
    designs = {curve.device: curve.design for curve in measurements.curves}
    found = []
    for key, mean, std in zip(study.calibrations.names, means, stds, strict=True):
        if key[0] == "modulus":
            batch = measurements.batches[int(str(key[1]))]
            of = tuple(f"{device} {layer}" for device, layer in batch.members)
            kind, stated, unit = "modulus", batch.modulus, allowed.modulus
        elif key[0] == "thickness":
            device, layer = str(key[1]), str(key[2])
            design = designs[device]
            field = f"{layer}_thickness" if isinstance(design, Design) else "thickness"
            of = (f"{device} {layer}",)
            kind, stated, unit = "thickness", getattr(design, field), allowed.thickness
        else:
            curve = measurements.curves[int(str(key[1]))]
            of = (f"{curve.device} run {curve.run}{turned(curve)}",)
            kind, stated, unit = "scale", 1.0, allowed.camera_scale
        found.append(
            Calibration(kind, of, stated, float(mean) * unit, float(std) * unit, unit)
        )
    return tuple(found)


def turned(curve: Curve) -> str:
    """`, turned by 180 deg` where a curve's orientation is not the usual one."""
    angle = math.degrees(curve.orientation)
    return f", turned by {angle:.4g} deg" if abs(angle) > 1e-9 else ""


def _failure(study: Study, best: Fit, labels: Labels, region: Region) -> Failure:
    readings, at = study.readings, region.at
    peak = np.abs(region.lack[at]) / readings.scale[at]
    top = at[peak > 0.99 * peak.max()]
    model = float(np.abs(best.predict()[top]).mean())
    largest = float(readings.scale[top].mean())
    lack = float(region.lack[top].mean())
    of_model = model > max(0.3 * largest, abs(lack))
    share = lack / (model if of_model else largest)
    names = study.measurements.devices
    return Failure(
        region=region,
        devices=tuple(names[d] for d in np.unique(readings.device[at])),
        limit=_limit(region, labels),
        share=share,
        error=abs(share) * region.error / abs(region.size),
        of_model=of_model,
        noises=float((region.lack[at] / best.noise[at]).mean()),
    )


def _limit(region: Region, labels: Labels) -> float:
    """A threshold with the fewest digits, in its bench unit, that splits alike; SI."""
    if not region.trait:
        return math.nan
    bench = NUMBERS[region.trait].bench
    values = labels.traits[region.trait]
    values = values[np.isfinite(values)]
    for digits in range(1, 7):
        shown = float(f"{bench.from_si(region.threshold):.{digits}g}")
        limit = bench.to_si(shown)
        if ((values > limit) == (values > region.threshold)).all() and not (
            np.isclose(values, limit, rtol=1e-9).any()
        ):
            return float(limit)
    return region.threshold
