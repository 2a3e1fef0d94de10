"""Errors on devices that took no part in a fit, and what a right model would have."""

from __future__ import annotations

import math

import numpy as np

from .evidence import Fit, fit
from .noise import Frame

Array = np.ndarray

DRAWS = 4000
"""Made-up sets of residuals behind the floor's interval."""

TAIL = 0.05
"""Probability beyond each end of an interval."""


def left_out(one: Fit, noise: Array | None = None) -> Array:
    """(n,) residuals, over the noise, of devices left out one at a time.

    Calibrations that a left-out device shares (batch moduli) are those of the others;
    its own (thickness, camera) are at their stated values.  NaN where there is but one
    device.

    Parameters
    ----------
    one : Fit
    noise : (n,) array, optional
        That the errors of several hypotheses are measured by; the fit's own by default.
    """
    noise = one.noise if noise is None else noise
    readings = one.readings
    residuals = np.full(len(readings.value), np.nan)
    for device in np.unique(readings.device):
        out = readings.device == device
        if out.all():
            break
        frame = Frame(readings.subset(~out))
        # Without the only device that has a quantity, or noise that is not stated,
        # there are fewer amplitudes.
        hyper = frame.hyper(bool(one.hypothesis.common))
        others = fit(
            readings,
            one.hypothesis,
            keep=~out,
            frame=frame,
            starts=[one.t],
            eta=hyper.aligned(one.hyper.names, one.eta),
            fixed=set(frame.groups) == set(readings.group),  # it hardly moves them
            evidence=False,
        )
        residuals[out] = (readings.value - others.predict())[out] / noise[out]
    return residuals


def held_out(one: Fit, noise: Array | None = None) -> float:
    """Root mean square of `left_out`; NaN where there is but one device."""
    return float(np.sqrt(np.mean(left_out(one, noise) ** 2)))


def noise_floor(one: Fit, noise: Array | None = None) -> float:
    """Held-out error that the right physics would have.

    Independent noise, smooth errors inside a curve, and the tolerances of a device that
    was not measured: what is expected of the residual when a hypothesis is true.

    Parameters
    ----------
    one : Fit
        Of the hypothesis that is taken for true.
    noise : (n,) array, optional
        As in `left_out`.
    """
    readings = one.readings
    noise = one.noise if noise is None else noise
    smooth = one.amplitude("smooth")
    own = np.array([smooth.get(int(g), 0.0) for g in readings.group]) * readings.scale
    # Moduli are shared, and known from the other devices; the rest is the device's own.
    columns = one.hypothesis.predict(one.t).columns[:, ~shared(one)]
    variance = (one.noise**2 + own**2 + (columns**2).sum(axis=1)) / noise**2
    return float(np.sqrt(variance.mean()))


def explained(one: Fit, nothing: Fit) -> float:
    """Share of what could fall of the squared error on left-out devices that does fall.

    From the error with nothing missing to the noise floor, which counts the smooth
    errors that the hypothesis leaves as errors; all over the hypothesis' noise.

    Parameters
    ----------
    one, nothing : Fit
        Of the hypothesis, and of "nothing is missing", to the same readings.

    Returns
    -------
    float
        1 at the floor, 0 or less where the hypothesis does not help, or leaves errors
        so large that nothing could fall; NaN where there is but one device.
    """
    before, after = held_out(nothing, one.noise) ** 2, held_out(one) ** 2
    room = before - noise_floor(one) ** 2
    if math.isnan(room):
        return math.nan
    return (before - after) / room if room > 0 else 0.0


def shared(one: Fit) -> Array:
    """(r,) whether a calibration is of several devices, as a batch's modulus is."""
    columns, device = one.hypothesis.predict(one.t).columns, one.readings.device
    return np.array(
        [len(np.unique(device[np.abs(column) > 0])) > 1 for column in columns.T],
        dtype=bool,
    )


def floor_interval(one: Fit, seed: int, draws: int = DRAWS) -> tuple[float, float]:
    """Where the held-out error lies when nothing is missing, in 90 % of such sets.

    Residuals are drawn as `noise_floor` counts them: independent noise, smooth
    errors along each curve, and the tolerances that a device has for itself.

    Parameters
    ----------
    one : Fit
        Of the hypothesis that is taken for true.
    seed, draws : int
    """
    rng = np.random.default_rng(seed)
    readings, n = one.readings, len(one.readings.value)
    smooth = one.amplitude("smooth")
    columns = one.hypothesis.predict(one.t).columns[:, ~shared(one)]
    parts = [rng.standard_normal((draws, n))]
    tolerance = rng.standard_normal((draws, columns.shape[1])) @ columns.T
    parts.append(tolerance / one.noise)
    bent = np.zeros((draws, n))
    for curve in np.unique(readings.curve) if readings.correlated else ():
        at = np.flatnonzero(readings.curve == curve)
        kernel = readings.smooth(at) + 1e-10 * np.eye(len(at))
        amplitude = smooth.get(int(readings.group[at[0]]), 0.0) * readings.scale[at]
        drawn = rng.standard_normal((draws, len(at))) @ np.linalg.cholesky(kernel).T
        bent[:, at] = drawn * amplitude / one.noise[at]
    errors = np.sqrt(((parts[0] + parts[1] + bent) ** 2).mean(axis=1))
    low, high = np.quantile(errors, [TAIL, 1 - TAIL])
    return float(low), float(high)
