"""Where the calibrated baseline fails: quantity, branch, loads and devices.

A region is a shape that the missing part might have: one quantity on one branch, for
all devices or those on one side of a design variable's threshold, the same share of
each curve's maximum at all loads, or growing from some load upwards or downwards.  Each
is weighed with calibrations and errors of the readings free to explain what they can:
generalised least squares under the covariance C of "nothing is missing".
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from .evidence import Fit, fit
from .hypotheses import Null
from .missing import CLAIM, Kind, Labels
from .noise import Covariance, Frame

Array = np.ndarray

CONSTANT, GROWING, FADING = "constant", "growing", "fading"
"""How a region's misfit changes as the load rises."""

PLAUSIBLE = 1.645
"""Prior standard deviations over its centre up to which an amplitude of smooth errors
is believed: its 95 % quantile.  Larger ones are a misfit that took their place."""

HINGES, SPLITS, DRAWS = 10, 12, 999
"""Most loads where a misfit may begin, most thresholds of a design variable, and
simulated sets of readings behind a p."""

BLOCK = 2000
"""Regions that are weighed at a time: many devices have millions of numbers in them."""

MOST = 4
"""Regions told at most."""

FEWEST = 2
"""Devices on each side of a split by a design variable."""

PRICE = 2.0
"""Log likelihood by which a set of devices must beat all of them, besides the logarithm
of the number of such sets: odds of 7 to 1."""


@dataclass(frozen=True)
class Region:
    """A part of the readings where the calibrated baseline fails.

    Parameters
    ----------
    kind : Kind
    growth : str
        ``constant``, ``growing`` or ``fading`` with the load.
    low, high : float, SI
        Loads where it fails.
    whole : bool
        Whether these are all loads of its devices.
    trait : str
        Design variable that limits it; empty where all devices are in.
    above : bool
        Whether devices above `threshold` are in, or those below.
    threshold : float, SI
    alike : tuple of str
        Other design variables that split the devices in the same way.
    at : (m,) array of int
        Its readings.
    devices : int
    size, error : float
        Where it is largest, measured less model as a share of each curve's maximum,
        and the standard deviation of that.
    lack : (n,) array, SI
        Measured less model by this region's shape, all readings.
    p : float
        Share of simulated sets of mere errors in which some region is as clear.
    """

    kind: Kind
    growth: str
    low: float
    high: float
    whole: bool
    trait: str
    above: bool
    threshold: float
    alike: tuple[str, ...]
    at: Array
    devices: int
    size: float
    error: float
    lack: Array
    p: float


@dataclass(frozen=True)
class _Split:
    """Devices: all of a kind, or those on one side of a threshold."""

    members: Array
    trait: str = ""
    above: bool = False
    threshold: float = math.nan
    alike: tuple[str, ...] = ()
    price: float = 0.0


@dataclass(frozen=True)
class _Shape:
    """One region before it is weighed: `profile` (n,) is 1 where it is largest."""

    kind: Kind
    members: tuple[int, ...]
    growth: str
    split: _Split
    profile: Array


def _splits(devices: Array, traits: dict[str, Array]) -> list[_Split]:
    """All devices, then every set that a threshold of one design variable makes."""
    found: dict[bytes, _Split] = {}
    for name, values in traits.items():
        own = values[devices]
        levels = np.unique(own[np.isfinite(own)])
        gaps = list(itertools.pairwise(levels))
        if len(gaps) > SPLITS:
            ranks = np.linspace(0, len(gaps) - 1, SPLITS).round().astype(int)
            gaps = [gaps[rank] for rank in ranks]
        for lower, upper in gaps:
            threshold = float(lower + upper) / 2
            for above in (False, True):
                inside = own > threshold if above else own < threshold
                if min(inside.sum(), (~inside).sum()) < FEWEST:
                    continue
                key = inside.tobytes()
                if key not in found:
                    found[key] = _Split(devices[inside], name, above, threshold)
                elif name not in (found[key].trait, *found[key].alike):
                    also = (*found[key].alike, name)
                    found[key] = replace(found[key], alike=also)
    price = PRICE + math.log(len(found)) if found else 0.0
    return [_Split(devices), *(replace(one, price=price) for one in found.values())]


def _hinges(loads: Array) -> Array:
    """Loads where a misfit may begin: those measured, or quantiles of them."""
    unique: Array = np.unique(loads)
    if len(unique) > HINGES:
        ranks = np.linspace(0, 1, HINGES)
        unique = np.unique(np.quantile(unique, ranks, method="nearest"))
    return unique


def _together(kinds: tuple[Kind, ...]) -> list[tuple[Kind, tuple[int, ...]]]:
    """Each kind, and both branches of a quantity together where there are two."""
    found: list[tuple[Kind, tuple[int, ...]]] = [
        (kind, (k,)) for k, kind in enumerate(kinds)
    ]
    both: dict[Kind, tuple[int, ...]] = {}
    for k, kind in enumerate(kinds):
        either = replace(kind, branch="")
        both[either] = (*both.get(either, ()), k)
    found += [(kind, members) for kind, members in both.items() if len(members) > 1]
    return found


def _shapes(labels: Labels, device: Array, taken: set[int]) -> Iterator[_Shape]:
    """Every region that is looked at, of kinds that are not `taken`."""
    for kind, members in _together(labels.kinds):
        here = np.isin(labels.kind, members)
        if taken & set(members):
            continue
        load = np.where(here, labels.load, np.nan)
        low, high = float(np.nanmin(load)), float(np.nanmax(load))
        rest = 1.0 if kind.quantity == "stress" else 0.0
        profiles = [(CONSTANT, np.ones(len(load)))]
        if high > low:
            begins = {min(rest, low), *_hinges(load[here])[:-1]}
            for begin in sorted(begins):
                profiles.append((GROWING, (labels.load - begin) / (high - begin)))
            for end in _hinges(load[here])[1:]:
                profiles.append((FADING, (end - labels.load) / (end - low)))
        for split in _splits(np.unique(device[here]), labels.traits):
            inside = here & np.isin(device, split.members)
            for growth, profile in profiles:
                shape = np.where(inside, np.clip(profile, 0.0, None), 0.0)
                if shape.any():
                    yield _Shape(kind, members, growth, split, shape)


def regions(nothing: Fit, labels: Labels, seed: int = 0) -> tuple[float, list[Region]]:
    """Regions that errors and calibrations do not make, clearest first.

    The log likelihood that a shape h gains on residuals r is
    (h^T C^-1 r)^2 / (2 h^T C^-1 h).  The clearest region is kept if fewer than
    `CLAIM` of simulated residuals of covariance C have one as clear; then its size
    joins the calibrations, amplitudes of errors are inferred anew, and the other kinds
    of readings are searched.

    Parameters
    ----------
    nothing : Fit
        Of "nothing is missing", on all readings.
    labels : Labels
    seed : int
        Of the simulated residuals.

    Returns
    -------
    p : float
        Of the clearest region, kept or not; 1 where there is none to look at.
    list of Region
    """
    readings = nothing.readings
    frame = Frame(readings)
    prediction = nothing.hypothesis.predict(nothing.t)
    rng = np.random.default_rng(seed)
    kept: list[tuple[_Shape, float]] = []
    clearest = 1.0
    taken: set[int] = set()
    best = nothing
    while len(kept) < MOST:
        r = frame.turn @ (readings.value - prediction.values)
        covariance = _plausible(best, frame)
        drawn = rng.standard_normal((DRAWS, len(r))) * np.sqrt(covariance.diagonal)
        spread = rng.standard_normal((DRAWS, covariance.columns.shape[1]))
        drawn += spread @ covariance.columns.T
        every = _shapes(labels, readings.device, taken)
        top, chance, clear = -math.inf, np.full(DRAWS, -math.inf), None
        while block := list(itertools.islice(every, BLOCK)):
            profiles = np.array([one.profile for one in block]) * readings.scale
            price = np.array([one.split.price for one in block])
            turned = frame.turn @ profiles.T
            weighted = covariance.solve(turned)
            norm = (turned * weighted).sum(axis=0)
            least = 1e-12 * (turned**2 / covariance.diagonal[:, None]).sum(axis=0)
            weighted = weighted / np.sqrt(np.maximum(norm, least))
            price[norm <= least] = math.inf  # calibrations can be all of it
            gains = 0.5 * (r @ weighted) ** 2 - price
            chances = 0.5 * (drawn @ weighted) ** 2 - price
            chance = np.maximum(chance, chances.max(axis=1))
            if gains.max() > top:
                top, clear = float(gains.max()), block[int(np.argmax(gains))]
        if clear is None:
            break
        p = (1 + int((chance >= top).sum())) / (1 + DRAWS)
        if not kept:
            clearest = p
        if p > CLAIM:
            break
        kept.append((clear, p))
        taken |= set(kept[-1][0].members)
        added = np.array([shape.profile * readings.scale for shape, _ in kept])
        wider = np.concatenate([prediction.columns, added.T], axis=1)
        best = fit(
            readings,
            Null("nothing", prediction._replace(columns=wider)),
            frame=frame,
            eta=best.eta,
            evidence=False,
        )
    if not kept:
        return clearest, []
    r = frame.turn @ (readings.value - prediction.values)
    sizes = best.covariance.coefficients(r)[-len(kept) :]
    columns = best.covariance.columns
    normal = np.eye(columns.shape[1]) + columns.T @ (
        columns / best.covariance.diagonal[:, None]
    )
    errors = np.sqrt(np.diag(np.linalg.inv(normal)))[-len(kept) :]
    return clearest, [
        _region(shape, p, float(size), float(error), nothing, labels)
        for (shape, p), size, error in zip(kept, sizes, errors, strict=True)
    ]


def _plausible(one: Fit, frame: Frame) -> Covariance:
    """Covariance with smooth errors no larger than is believed of them."""
    hyper = one.hyper
    most = hyper.centre + PLAUSIBLE * hyper.width
    smooth = np.array([name.startswith("smooth") for name in hyper.names], dtype=bool)
    eta = np.where(smooth, np.minimum(one.eta, most), one.eta)
    columns = frame.turn @ one.hypothesis.predict(one.t).columns
    return Covariance(frame, hyper, eta, columns)


def _region(
    shape: _Shape, p: float, size: float, error: float, nothing: Fit, labels: Labels
) -> Region:
    readings = nothing.readings
    at = np.flatnonzero(shape.profile > 1e-9)
    own = np.isin(labels.kind, shape.members) & np.isin(
        readings.device, shape.split.members
    )
    low, high = float(labels.load[at].min()), float(labels.load[at].max())
    # A misfit that grows from a load begins there, not at the next reading.
    loads = np.unique(labels.load[own])
    if shape.growth == GROWING and low > loads[0]:
        low = float(loads[loads < low][-1])
    if shape.growth == FADING and high < loads[-1]:
        high = float(loads[loads > high][0])
    return Region(
        kind=shape.kind,
        growth=shape.growth,
        low=low,
        high=high,
        whole=bool(low <= loads[0] and high >= loads[-1]),
        trait=shape.split.trait,
        above=shape.split.above,
        threshold=shape.split.threshold,
        alike=shape.split.alike,
        at=at,
        devices=len(np.unique(readings.device[at])),
        size=size,
        error=error,
        lack=size * readings.scale * shape.profile,
        p=p,
    )
