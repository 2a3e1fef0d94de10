"""Is anything missing at all: tests with the device as the unit.

Readings of one curve share their smooth errors, and so do runs of one device.  What
counts is therefore one number a device: offset or slope of its calibrated residual
over the load.  Their mean is held against how much the devices differ from one
another, together with what is believed of smooth errors beforehand, which lets few
devices speak as well.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import chi2, norm
from scipy.stats import t as student

from .evidence import Fit
from .noise import SMOOTH_CENTRE, Frame

Array = np.ndarray

CLAIM = 0.05
"""p-value at which something is said to be missing."""

PRIOR_DEGREES = 1.0
"""Degrees of freedom that the prior of smooth errors is worth.  The logarithm of a
scale from d degrees has the variance trigamma(d / 2) / 4, which is that of the prior,
1, at d = 1.1."""

FEWEST = 2
"""Devices from which on their mean is tested: one has nothing to be compared with."""

LARGE = 0.95
"""Largest p-value that counts when p-values are combined."""

KNOWN = 0.1
"""Share of its prior variance that readings must tell of a calibration before its
distance from the stated value is judged."""


@dataclass(frozen=True)
class Kind:
    """Readings that are judged together: one quantity, orientation and branch.

    An empty branch is both.
    """

    specimen: str
    quantity: str
    orientation: float
    branch: str


@dataclass(frozen=True)
class Labels:
    """What the tests need to know of each reading besides its value.

    Parameters
    ----------
    kinds : tuple of Kind
    kind : (n,) array of int
        Index into `kinds`.
    load : (n,) array, SI
    traits : dict of str to (d,) array
        Design variables by device number; NaN where a device has none.
    pulls : (r, q) array
        Columns of calibrations that are judged together; each of length 1.
    """

    kinds: tuple[Kind, ...]
    kind: Array
    load: Array
    traits: dict[str, Array]
    pulls: Array


@dataclass(frozen=True)
class Score:
    """One test: a number of each device, and whether their mean differs from zero.

    Parameters
    ----------
    kind : Kind or None
        None for tests on all readings.
    what : str
        ``offset``, ``slope``, ``calibrations``, ``amplitude`` or ``region``.
    devices : int
    mean : float
        Of the devices, as a share of each curve's largest value; NaN where there is
        no such number.
    p : float
    """

    kind: Kind | None
    what: str
    devices: int
    mean: float
    p: float


@dataclass(frozen=True)
class Residuals:
    """Calibrated residuals and how far mere errors would make them.

    Parameters
    ----------
    fit : Fit
        Of "nothing is missing", on all readings.
    """

    fit: Fit

    @cached_property
    def value(self) -> Array:
        """(n,) measured less calibrated baseline, SI."""
        value: Array = self.fit.readings.value - self.fit.predict()
        return value

    @cached_property
    def _back(self) -> Array:
        """(n, n) from turned residuals to those of the readings."""
        back: Array = np.linalg.inv(Frame(self.fit.readings).turn)
        return back

    @cached_property
    def calibrations(self) -> Array:
        """(r,) posterior means of the calibrations in units of their tolerances."""
        fit = self.fit
        raw = fit.readings.value - fit.hypothesis.predict(fit.t).values
        return fit.covariance.coefficients(Frame(fit.readings).turn @ raw)

    @cached_property
    def posterior(self) -> Array:
        """(r, r) covariance of the calibrations in units of their tolerances."""
        columns, diagonal = self.fit.covariance.columns, self.fit.covariance.diagonal
        normal = np.eye(columns.shape[1]) + columns.T @ (columns / diagonal[:, None])
        posterior: Array = np.linalg.inv(normal)
        return posterior

    @cached_property
    def errors(self) -> Array:
        """(n, n) covariance of independent and smooth errors, SI."""
        return self._turned_back(np.diag(self.fit.covariance.diagonal))

    @cached_property
    def covariance(self) -> Array:
        """(n, n) covariance of the calibrated residuals where nothing is missing, SI.

        With L the errors' and U the calibrations' part, C = L + U U^T, calibrating
        leaves L C^-1 r, of covariance L C^-1 L = L - U (I + U^T L^-1 U)^-1 U^T.
        """
        columns = self.fit.covariance.columns
        taken = columns @ self.posterior @ columns.T
        return self._turned_back(np.diag(self.fit.covariance.diagonal) - taken)

    @cached_property
    def expected(self) -> Array:
        """(n, n) the same if smooth errors had the middle of their prior, SI."""
        fit, columns = self.fit, self.fit.covariance.columns
        frame = Frame(fit.readings)
        noise = (fit.noise / fit.readings.noise) ** 2
        diagonal = fit.covariance.diagonal
        before = np.diag(noise + SMOOTH_CENTRE**2 * frame.smooth) + columns @ columns.T
        weighted = columns / diagonal[:, None]
        after = np.eye(len(diagonal)) - columns @ self.posterior @ weighted.T
        return self._turned_back(after @ before @ after.T)

    def _turned_back(self, covariance: Array) -> Array:
        whole: Array = self._back @ covariance @ self._back.T
        return whole

    @cached_property
    def whitened(self) -> Array:
        """(n,) residuals over their errors, correlation inside curves taken out.

        By the symmetric root of the inverse covariance, which keeps each number as
        near as can be to the reading that it stands for.
        """
        found = np.empty_like(self.value)
        for curve in np.unique(self.fit.readings.curve):
            at = np.flatnonzero(self.fit.readings.curve == curve)
            values, vectors = np.linalg.eigh(self.errors[np.ix_(at, at)])
            found[at] = vectors @ ((vectors.T @ self.value[at]) / np.sqrt(values))
        return found


@dataclass(frozen=True)
class Units:
    """One number a device, each over its standard deviation by errors alone.

    Parameters
    ----------
    devices : (d,) array of int
    value : (d,) array
    correlation : (d, d) array
        Calibrations that devices share make their residuals depend on each other.
    expected : float
        Mean variance by the prior of smooth errors, over that by their fit.
    """

    devices: Array
    value: Array
    correlation: Array
    expected: float

    def p_value(self) -> float:
        """Two-sided p-value of their mean being zero.

        Student's test with a variance to which the prior adds `PRIOR_DEGREES`
        (Smyth 2004, Stat. Appl. Genet. Mol. Biol. 3(1), 3), and with the mean's and
        the scatter's expectations under `correlation`.
        """
        d = len(self.value)
        mean = float(self.value.mean())
        of_mean = float(self.correlation.sum()) / d**2
        scatter = float(((self.value - mean) ** 2).sum())
        of_scatter = float(np.trace(self.correlation)) - d * of_mean
        squares = PRIOR_DEGREES * self.expected
        degrees = PRIOR_DEGREES
        if d > 1 and of_scatter > 1e-9:
            squares += scatter / of_scatter * (d - 1)
            degrees += d - 1
        t = abs(mean) / math.sqrt(max(of_mean, 1e-12) * squares / degrees)
        return float(2 * student.sf(t, degrees))


def _units(residuals: Residuals, devices: Array, weights: Array) -> Units | None:
    """Weighted sums of readings, one a device; None where calibrations take them all.

    Parameters
    ----------
    devices : (d,) array of int
    weights : (d, n) array
    """
    variance = np.diag(weights @ residuals.covariance @ weights.T)
    whole = np.diag(weights @ residuals.errors @ weights.T)
    keep = variance > 1e-6 * whole
    if not keep.any():
        return None
    weights = weights[keep] / np.sqrt(variance[keep])[:, None]
    return Units(
        devices=devices[keep],
        value=weights @ residuals.value,
        correlation=weights @ residuals.covariance @ weights.T,
        expected=float(np.diag(weights @ residuals.expected @ weights.T).mean()),
    )


def _shape_weights(
    residuals: Residuals, labels: Labels, k: int
) -> Iterator[tuple[str, Array, Array]]:
    """(name, devices, weights (d, n)) of offset and slope of one kind of readings.

    Least squares on the residual as a share of its curve's largest value, against the
    load from -1 to 1 over the device's own range.
    """
    readings = residuals.fit.readings
    n = len(readings.value)
    rows: dict[str, list[Array]] = {"offset": [], "slope": []}
    owners: dict[str, list[int]] = {"offset": [], "slope": []}
    for device in np.unique(readings.device[labels.kind == k]):
        at = np.flatnonzero((labels.kind == k) & (readings.device == device))
        load = labels.load[at]
        middle, half = (load.max() + load.min()) / 2, np.ptp(load) / 2
        sloped = len(np.unique(load)) > 1
        place = (load - middle) / half if sloped else np.zeros(len(at))
        basis = np.stack([np.ones(len(at)), place], axis=1)[:, : 1 + sloped]
        inverse = np.linalg.pinv(basis) / readings.scale[at][None, :]
        for name, row in zip(rows, inverse, strict=False):
            weights = np.zeros(n)
            weights[at] = row
            rows[name].append(weights)
            owners[name].append(int(device))
    for name, found in rows.items():
        if found:
            yield name, np.array(owners[name]), np.array(found)


def scores(residuals: Residuals, labels: Labels) -> list[Score]:
    """Tests of whether something is missing; that of regions is not among them."""
    found = []
    for k, kind in enumerate(labels.kinds):
        for name, devices, weights in _shape_weights(residuals, labels, k):
            units = _units(residuals, devices, weights)
            if units is None or len(units.devices) < FEWEST:
                continue
            mean = float((weights @ residuals.value).mean())
            d = len(units.devices)
            found.append(Score(kind, name, d, mean, units.p_value()))
    count = len(np.unique(residuals.fit.readings.device))
    for name, p in (
        ("calibrations", _calibrations(residuals, labels)),
        ("amplitude", _amplitudes(residuals.fit)),
    ):
        if p is not None:
            found.append(Score(None, name, count, math.nan, p))
    return found


def _amplitudes(fit: Fit) -> float | None:
    """p-value of the largest smooth errors that "nothing is missing" needs.

    Their inferred amplitude against its prior; Bonferroni's over the quantities.
    """
    z = [
        (value - centre) / width
        for name, value, centre, width in zip(
            fit.hyper.names, fit.eta, fit.hyper.centre, fit.hyper.width, strict=True
        )
        if name.startswith("smooth")
    ]
    return min(1.0, len(z) * float(norm.sf(max(z)))) if z else None


def _calibrations(residuals: Residuals, labels: Labels) -> float | None:
    """p-value of the calibrations' distance from the stated values.

    Where nothing is missing their posterior means scatter with the covariance
    I - V, V that of the posterior: a chi-square over the directions that are known.
    """
    mean = labels.pulls.T @ residuals.calibrations
    told = np.eye(len(residuals.posterior)) - residuals.posterior
    values, vectors = np.linalg.eigh(labels.pulls.T @ told @ labels.pulls)
    known = values > KNOWN
    if not known.any():
        return None
    form = ((vectors.T @ mean)[known] ** 2 / values[known]).sum()
    return float(chi2.sf(form, int(known.sum())))


def combined(p_values: Array) -> float:
    """One p-value of many that may depend on each other: the Cauchy combination.

    Liu and Xie 2020, J. Am. Stat. Assoc. 115, 393: the mean of tan((1/2 - p) pi) has
    nearly the standard Cauchy distribution in its tail, whatever the dependence.  p is
    taken for `LARGE` at most: one test at 1 would silence all others.  Of independent
    tests at a level of 5 % that makes 5.2 %.
    """
    p = np.clip(np.asarray(p_values, dtype=float), 1e-15, LARGE)
    mean = float(np.tan((0.5 - p) * math.pi).mean())
    return float(np.clip(0.5 - math.atan(mean) / math.pi, 0.0, 1.0))


def overall(tests: Sequence[Score]) -> float:
    """p-value of nothing being missing.

    Tests of single kinds of readings are combined first, so that many kinds do not
    drown what the tests on all readings say.
    """
    single = [one.p for one in tests if one.kind is not None]
    whole = [one.p for one in tests if one.kind is None]
    return combined(
        np.array([*([combined(np.array(single))] if single else []), *whole])
    )
