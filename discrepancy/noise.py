"""How readings err: independent noise, smooth errors inside a curve, calibration.

Points of one curve are not independent: camera set-up, meshing and whatever a model
lacks in small ways bend the whole curve.  Counting them as independent finds effects
that are not there.  The covariance of the readings is therefore

    C = S (tau_g^2 I + a_g^2 K) S + U U^T,

S the stated noise of each reading (or a guess of it), tau its factor (1 where it is
stated), K the smooth errors of each curve by itself in units of that noise, with the
amplitude a as a share of the curve's largest value, and U the changes by one prior
standard deviation of each calibration.  K is turned once to its eigenvectors; any
amplitude then costs no factorisation, and calibrations enter by Woodbury's identity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from datagen.errors import InputError

Array = np.ndarray

LENGTH = 0.5
"""Correlation length of smooth errors, share of a curve's own range of loads."""

SMOOTH_CENTRE, SMOOTH_WIDTH = 0.01, 1.0
"""Amplitude of smooth errors, share of a curve's maximum: log-normal around 1 %, with
95 % between 0.14 and 7 %.  Side by side, programs of the same mechanics differ by 0.2 %
in inflation and by 1 to 10 % in tip (docs/benchmarks/fem.md)."""

LARGE_SMOOTH = SMOOTH_CENTRE * math.exp(1.645 * SMOOTH_WIDTH)
"""Amplitude that smooth errors exceed in 5 %."""

NOISE_WIDTH = 1.2
"""Log-normal width of independent noise that is not stated, around its guess."""

COMMON_CENTRE, COMMON_WIDTH = 0.05, 1.2
"""Amplitude of an effect that no hypothesis knows, share of a curve's maximum."""


def smooth_kernel(place: Array, path: Array, length: float) -> Array:
    """Correlation (n, n) of smooth errors inside a curve: Matern 3/2.

    Half of the variance goes with the load, as what a model lacks does, and half with
    the way there: a camera that drifts does not come back with the load.

    Parameters
    ----------
    place, path : (n,) arrays
        See `Readings`.
    length : float
    """
    kernel = np.zeros((len(place), len(place)))
    for along in (place, path):
        distance = math.sqrt(3) * np.abs(along[:, None] - along[None, :]) / length
        kernel += 0.5 * (1 + distance) * np.exp(-distance)
    return kernel


_ARRAYS = (
    "value",
    "group",
    "curve",
    "place",
    "noise",
    "stated",
    "device",
    "scale",
    "path",
)


@dataclass(frozen=True)
class Readings:
    """Measured numbers and what is known of their errors.

    Parameters
    ----------
    value : (n,) array
    group : (n,) array of int
        Readings whose errors have one amplitude: those of one quantity.
    curve : (n,) array of int
        Readings whose smooth errors belong together: one quantity of one run.
    place : (n,) array
        Load over the largest one of all curves; below 0 under vacuum.
    noise : (n,) array
        Standard deviation of independent errors, stated or guessed; above 0.
    stated : (n,) array of bool
        Whether `noise` is stated; where it is not, the readings of a group have one
        factor that is inferred.  Alike for all readings of a curve.
    device : (n,) array of int
        Unit that is held out when predictions are judged.
    scale : (n,) array
        Largest magnitude of each reading's curve: the unit of smooth errors.
    path : (n,) array, optional
        Way along the curve from rest to the reading, in the unit of `place`, which it
        is where it is not given: it grows on the way back, too.
    correlated : bool
        Whether there are smooth errors; False for bodies of independent points.
    """

    value: Array
    group: Array
    curve: Array
    place: Array
    noise: Array
    stated: Array
    device: Array
    scale: Array
    path: Array = None  # type: ignore[assignment]  # `place` where not given
    correlated: bool = True

    def __post_init__(self) -> None:
        n = len(self.value)
        if self.path is None:
            object.__setattr__(self, "path", self.place)
        for name in _ARRAYS[1:]:
            if getattr(self, name).shape != (n,):
                raise InputError(name, getattr(self, name).shape, f"shape {(n,)}")
        if not (np.isfinite(self.noise).all() and (self.noise > 0).all()):
            raise InputError("noise", float(np.min(self.noise)), "numbers above 0")
        for curve in np.unique(self.curve):
            if len(np.unique(self.stated[self.curve == curve])) > 1:
                raise InputError("stated", "some", "all readings of a curve, or none")
        if not np.isfinite(self.value).all():
            raise InputError("value", "NaN", "finite numbers")

    def subset(self, keep: Array) -> Readings:
        """Those readings where `keep` (n,) is true."""
        return Readings(
            **{name: getattr(self, name)[keep] for name in _ARRAYS},
            correlated=self.correlated,
        )

    def smooth(self, at: Array) -> Array:
        """Correlation (m, m) of the smooth errors of one curve, its readings `at`."""
        place = self.place[at]
        reach = float(np.abs(place).max()) or 1.0
        return smooth_kernel(place, self.path[at], LENGTH * reach)


@dataclass(frozen=True)
class Hyper:
    """Names and log-normal priors of the amplitudes.

    names : tuple of str; ``noise 0``, ``smooth 0``, ``common 0`` by group.
    centre, width : (h,) arrays of the logarithms.
    """

    names: tuple[str, ...]
    centre: Array
    width: Array

    def aligned(self, names: tuple[str, ...], eta: Array) -> Array:
        """Log amplitudes (h,) in this order, from those of other readings.

        An amplitude that the others have not is at its centre.
        """
        known = dict(zip(names, eta, strict=True))
        found = [known.get(n, c) for n, c in zip(self.names, self.centre, strict=True)]
        return np.array(found)

    def raised(self) -> Array:
        """Log amplitudes (h,) at their centres, smooth errors two widths above them.

        A second start: what a hypothesis leaves can pass for noise as for smooth errors
        where both are inferred, and each can keep the other small.
        """
        smooth = np.array([name.startswith("smooth") for name in self.names])
        raised: Array = self.centre + 2 * smooth * self.width
        return raised

    def log_prior(self, eta: Array) -> float:
        """Log density of log amplitudes."""
        z = (eta - self.centre) / self.width
        norm = np.log(self.width * math.sqrt(2 * math.pi))
        return float(-0.5 * z @ z - norm.sum())


@dataclass(frozen=True)
class Frame:
    """Readings turned so that noise and smooth errors are both diagonal.

    Parameters
    ----------
    readings : Readings

    Attributes
    ----------
    turn : (n, n) array
        Rows of turned readings; turned values have noise of variance 1.
    smooth : (n,) array
        Variance of smooth errors of amplitude 1 (a whole curve's maximum).
    group : (n,) array of int
    """

    readings: Readings
    turn: Array = field(init=False)
    smooth: Array = field(init=False)

    def __post_init__(self) -> None:
        data = self.readings
        n = len(data.value)
        turn, smooth = np.zeros((n, n)), np.zeros(n)
        for curve in np.unique(data.curve):
            at = np.flatnonzero(data.curve == curve)
            if not data.correlated:
                turn[at, at] = 1 / data.noise[at]
                continue
            share = data.scale[at] / data.noise[at]
            kernel = data.smooth(at)
            kernel = share[:, None] * kernel * share[None, :]
            values, vectors = np.linalg.eigh(kernel)
            turn[np.ix_(at, at)] = vectors.T / data.noise[at][None, :]
            smooth[at] = np.maximum(values, 0.0)
        object.__setattr__(self, "turn", turn)
        object.__setattr__(self, "smooth", smooth)

    @property
    def group(self) -> Array:
        """(n,) group of each turned reading: curves never mix groups."""
        return self.readings.group

    @cached_property
    def groups(self) -> list[int]:
        """Groups that have readings, ascending."""
        return [int(g) for g in np.unique(self.group)]

    @cached_property
    def members(self) -> Array:
        """(groups, n) array: 1 where a reading is of a group, else 0."""
        same: Array = self.group == np.array(self.groups)[:, None]
        return same.astype(float)

    @property
    def log_volume(self) -> float:
        """Log determinant that turning adds to a density of the readings."""
        return -float(np.log(self.readings.noise).sum())

    def hyper(self, common: bool = False) -> Hyper:
        """Amplitudes to be inferred; `common` adds those of an unknown effect."""
        groups = self.groups
        open_groups = [
            g for g in groups if not self.readings.stated[self.group == g].all()
        ]
        smooth = groups if self.readings.correlated else []
        names, centre, width = [], [], []
        for kind, chosen, middle, spread in (
            ("noise", open_groups, 1.0, NOISE_WIDTH),
            ("smooth", smooth, SMOOTH_CENTRE, SMOOTH_WIDTH),
            ("common", groups if common else [], COMMON_CENTRE, COMMON_WIDTH),
        ):
            names += [f"{kind} {g}" for g in chosen]
            centre += [math.log(middle)] * len(chosen)
            width += [spread] * len(chosen)
        return Hyper(tuple(names), np.array(centre), np.array(width))


class Information(NamedTuple):
    """Derivatives of a log density by h log amplitudes.

    slope : (h,) array; first ones.
    average : (h, h) array; mean of the observed and the expected information of the
        amplitudes' squares, never negative (Gilmour, Thompson and Cullis 1995).
    observed : (h, h) array; second ones, with the sign turned.
    pulled : (h, n) array; derivatives of the covariance times what its inverse makes of
        the residual.
    """

    slope: Array
    average: Array
    observed: Array
    pulled: Array


class Covariance:
    """Covariance of turned readings at given amplitudes.

    Parameters
    ----------
    frame : Frame
    hyper : Hyper
    eta : (h,) array
        Log amplitudes, as `hyper` names them.
    columns : (n, r) array
        Turned changes by one standard deviation of each calibration.
    common : sequence of (n, m) arrays
        Turned shapes of an unknown effect, for each group, of amplitude 1.

    Raises
    ------
    numpy.linalg.LinAlgError
        When amplitudes overflow.
    """

    def __init__(
        self,
        frame: Frame,
        hyper: Hyper,
        eta: Array,
        columns: Array,
        common: tuple[Array, ...] = (),
    ) -> None:
        groups = frame.groups
        amplitude = dict(zip(hyper.names, np.exp(eta), strict=True))
        self._hyper, self._frame = hyper, frame
        self._open = ~frame.readings.stated
        noise = np.array([amplitude.get(f"noise {g}", 1.0) ** 2 for g in groups])
        smooth = np.array([amplitude.get(f"smooth {g}", 0.0) ** 2 for g in groups])
        self._noise2 = np.where(self._open, noise @ frame.members, 1.0)
        self._smooth2 = smooth @ frame.members * frame.smooth
        self.diagonal = self._noise2 + self._smooth2
        scaled = [
            amplitude[f"common {g}"] * shapes
            for g, shapes in zip(groups, common, strict=False)
        ]
        self._owner = np.concatenate(
            [np.full(columns.shape[1], -1)]
            + [np.full(s.shape[1], g) for g, s in zip(groups, scaled, strict=False)]
        )
        self.columns = np.concatenate([columns, *scaled], axis=1)
        self._weighted = self.columns / self.diagonal[:, None]
        middle = np.eye(self.columns.shape[1]) + self.columns.T @ self._weighted
        # By LAPACK itself: a search makes tens of thousands of these small factors.
        factor, failed = lapack.dpotrf(middle, lower=1)
        if failed:
            raise np.linalg.LinAlgError(f"leading minor {failed} is not positive")
        if len(factor):
            factor_inverse, _ = lapack.dtrtri(factor, lower=1)
        else:  # which LAPACK complains of
            factor_inverse = factor
        self._inverse = factor_inverse
        self._half = self._inverse @ self._weighted.T
        self.log_determinant = float(
            np.log(self.diagonal).sum() + 2 * np.log(factor.diagonal()).sum()
        )

    def solve(self, r: Array) -> Array:
        """C^-1 r for turned residuals (n,) or (n, k)."""
        weight = self.diagonal if r.ndim == 1 else self.diagonal[:, None]
        solved: Array = r / weight - self._half.T @ (self._half @ r)
        return solved

    def quadratic(self, r: Array) -> Array:
        """r^T C^-1 r (k,) of turned residuals (n, k)."""
        whole = (r**2 / self.diagonal[:, None]).sum(axis=0)
        taken = ((self._half @ r) ** 2).sum(axis=0)
        form: Array = whole - taken
        return form

    def coefficients(self, r: Array) -> Array:
        """Posterior means (r + m,) of calibrations and unknown shapes, prior units."""
        mean: Array = self._inverse.T @ (self._half @ r)
        return mean

    def log_density(self, r: Array) -> float:
        """Log density of turned residuals (n,), turning not counted."""
        form = float(self.quadratic(r[:, None])[0])
        return -0.5 * (form + self.log_determinant + len(r) * math.log(2 * math.pi))

    def information(self, r: Array) -> Information:
        """How the log density of turned residuals (n,) changes with the amplitudes."""
        names, k = self._hyper.names, self.columns.shape[1]
        pulls = np.zeros((len(names), len(r)))  # (h, n) of the diagonal
        owns = np.zeros((len(names), k))  # (h, k) whose columns are the amplitude's
        for i, name in enumerate(names):
            kind, g = name.split()
            if kind == "common":
                owns[i] = self._owner == int(g)
            else:
                part = self._noise2 * self._open if kind == "noise" else self._smooth2
                pulls[i] = 2 * part * (self._frame.group == int(g))
        # dC = diag(pull) + 2 K K^T, K the columns of the amplitude.
        weight, taken = 1 / self.diagonal, (self._half**2).sum(axis=0)
        alpha = self.solve(r)
        felt = self.columns.T @ alpha
        between = np.eye(k) - self._inverse.T @ self._inverse  # U^T C^-1 U
        slope = 0.5 * pulls @ (alpha**2 - weight + taken)
        slope += owns @ (felt**2 - between.diagonal())
        inner = self._half * pulls[:, None, :] @ self._half.T
        inner = inner.reshape(len(names), k * k)
        far = (pulls @ self.solve(self.columns) ** 2) @ owns.T
        expected = 0.5 * (
            (pulls * (weight**2 - 2 * weight * taken)) @ pulls.T + inner @ inner.T
        )
        expected += far + far.T + 2 * owns @ between**2 @ owns.T
        pulled = pulls * alpha + 2 * (owns * felt) @ self.columns.T
        average = 0.5 * pulled @ self.solve(pulled.T)
        # A square's logarithm bends with its slope.
        observed = 2 * average - expected - 2 * np.diag(slope)
        return Information(slope, average, observed, pulled)
