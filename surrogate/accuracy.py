"""How far the surrogate is from the finite elements on designs it has not seen."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from datagen.dataset import Dataset
from datagen.errors import InputError
from datagen.response import Path
from datagen.units import BY_FIELD

from .corrected import Corrected
from .ensemble import Ensemble
from .split import held_out, usable

Array = np.ndarray
Surrogate = Ensemble | Corrected

COVERAGE = 0.9
"""Nominal coverage of the intervals that are judged."""

FEWEST_IN_REGION = 3
"""Regions with fewer test designs are left out."""


@dataclass(frozen=True)
class OutputError:
    """Errors of one output over the points of unseen designs.

    Every design counts the same, however many load steps its path has.

    Parameters
    ----------
    rmse : float, SI
    median_pct, p95_pct, max_pct : float
        Error in percent of the path's largest magnitude: median, 95th percentile,
        worst.
    r2 : float
        One less the squared error over the variance of the output; NaN where the
        output does not vary.
    coverage : float
        Share of the points inside their interval.
    """

    rmse: float
    median_pct: float
    p95_pct: float
    max_pct: float
    r2: float
    coverage: float


@dataclass(frozen=True)
class Region:
    """Errors in a part of the space.

    Parameters
    ----------
    by : str
        What the parts are made by.
    name : str
        Which part, in words.
    designs : int
    outputs : dict of OutputError
    """

    by: str
    name: str
    designs: int
    outputs: dict[str, OutputError]


@dataclass(frozen=True)
class LimitError:
    """Errors of the predicted limit pressure on unseen designs.

    Parameters
    ----------
    designs : int
        Unseen designs whose path met its limit point.
    median_pct, p95_pct : float
        Error in percent of the limit pressure of those.
    missed : int
        Of those, predicted to lie above the trained pressure even at the lower bound
        that the range check uses.
    false_alarms : int
        Unseen designs without a limit point that the range check holds below theirs.
    """

    designs: int
    median_pct: float
    p95_pct: float
    missed: int
    false_alarms: int


@dataclass(frozen=True)
class Accuracy:
    """What `accuracy` measures.

    Parameters
    ----------
    outputs : dict of OutputError
    coverage : float
        Share of all points of all outputs inside intervals of nominal `COVERAGE`.
    regions : tuple of Region
    limit : LimitError or None
        None where no unseen design met a limit point.
    n_train, n_test : int
        Numbers of designs.
    test_steps : int
        Load steps of the test designs.
    version : str
        Of the model.
    """

    outputs: dict[str, OutputError]
    coverage: float
    regions: tuple[Region, ...]
    limit: LimitError | None
    n_train: int
    n_test: int
    test_steps: int
    version: str

    def to_json(self) -> dict[str, Any]:
        """The object of ``pba accuracy --json``; rmse in the quantity's bench unit."""
        out: dict[str, Any] = {
            "outputs": _bench(self.outputs),
            "coverage": {f"{COVERAGE * 100:g}": round(self.coverage, 4)},
            "regions": [
                {
                    "by": region.by,
                    "region": region.name,
                    "designs": region.designs,
                    "outputs": _bench(region.outputs),
                }
                for region in self.regions
            ],
            "n_train": self.n_train,
            "n_test": self.n_test,
            "test_steps": self.test_steps,
            "model_version": self.version,
        }
        if self.limit:
            out["limit_pressure"] = {
                "designs": self.limit.designs,
                "median_pct": self.limit.median_pct,
                "p95_pct": self.limit.p95_pct,
                "missed": self.limit.missed,
                "false_alarms": self.limit.false_alarms,
            }
        return out


def _bench(outputs: dict[str, OutputError]) -> dict[str, dict[str, Any]]:
    """Errors by bench name, rmse in the bench unit, which is stated."""
    out: dict[str, dict[str, Any]] = {}
    for name, error in outputs.items():
        bench = BY_FIELD[name]
        out[bench.name] = {
            "rmse": float(bench.from_si(error.rmse)),
            "unit": bench.unit,
            "median_pct": error.median_pct,
            "p95_pct": error.p95_pct,
            "max_pct": error.max_pct,
            "r2": error.r2 if np.isfinite(error.r2) else None,
            "coverage": error.coverage,
        }
    return out


def accuracy(ensemble: Surrogate, dataset: Dataset) -> Accuracy:
    """Compare with the designs of a dataset that no training has seen.

    Raises
    ------
    InputError
        When the dataset has no such design, or other outputs or effects.
    """
    for field, own, given in (
        ("outputs", ensemble.outputs, dataset.outputs),
        ("effects", ensemble.effects, dataset.effects),
    ):
        if own != given:
            raise InputError(field, ", ".join(given), ", ".join(own) or "none")
    rows = np.flatnonzero(held_out(dataset) & usable(dataset))
    if not len(rows):
        raise InputError(
            "dataset", f"{len(dataset)} designs", "one with held-out designs in it"
        )
    data = dataset.subset(rows)
    points = _points(ensemble, data)
    regions = tuple(_regions(data, points))
    outputs = points.errors(np.ones(len(points.design), dtype=bool))
    return Accuracy(
        outputs=outputs,
        coverage=float(np.mean([error.coverage for error in outputs.values()])),
        regions=regions,
        limit=_limit(ensemble, data),
        n_train=int(ensemble.description.get("n_train", 0)),
        n_test=len(data),
        test_steps=len(points.design),
        version=ensemble.version,
    )


@dataclass(frozen=True)
class _Points:
    """Converged load steps of the test designs, one row each; (N, m) arrays, SI."""

    names: tuple[str, ...]
    design: Array
    pressure: Array
    truth: Array
    error: Array
    path_max: Array
    inside: Array

    def errors(self, chosen: Array) -> dict[str, OutputError]:
        """Errors over the chosen points, every design with the same weight."""
        _, index, counts = np.unique(
            self.design[chosen], return_inverse=True, return_counts=True
        )
        weight = 1 / (counts[index] * len(counts))
        found = {}
        for o, name in enumerate(self.names):
            error, truth = self.error[chosen, o], self.truth[chosen, o]
            percent = 100 * np.abs(error) / self.path_max[chosen, o]
            square = float(weight @ error**2)
            variance = float(weight @ (truth - weight @ truth) ** 2)
            found[name] = OutputError(
                rmse=square**0.5,
                median_pct=_quantile(percent, weight, 0.5),
                p95_pct=_quantile(percent, weight, 0.95),
                max_pct=float(percent.max()),
                r2=1 - square / variance if variance > 0 else float("nan"),
                coverage=float(weight @ self.inside[chosen, o]),
            )
        return found


def _points(ensemble: Surrogate, data: Dataset) -> _Points:
    """Predict the test designs at their own load steps."""
    n = len(data)
    values = np.zeros_like(data.values)
    low, high = np.zeros_like(values), np.zeros_like(values)
    for i in range(n):
        steps = data.steps(i)
        path = Path(data.pressure[i, :steps])
        model = ensemble.with_parameters(data.effect_parameters(i))
        found = model.predict([data.design(i)], [path], COVERAGE)
        values[i, :steps] = found.response.values[0]
        low[i, :steps], high[i, :steps] = found.low[0], found.high[0]
    good = data.status == 0
    truth = data.values[good]
    design = np.nonzero(good)[0]
    largest = np.where(good[..., None], np.abs(data.values), 0).max(axis=1)
    # An output that is zero along the whole path has no scale of its own.
    largest = np.maximum(largest, np.finfo(float).tiny)
    return _Points(
        data.outputs,
        design,
        data.pressure[good],
        truth,
        values[good] - truth,
        largest[design],
        (low[good] <= truth) & (truth <= high[good]),
    )


def _quantile(values: Array, weight: Array, level: float) -> float:
    """Weighted quantile; weights sum to 1."""
    order = np.argsort(values)
    share = np.cumsum(weight[order])
    place = min(int(np.searchsorted(share, level)), len(values) - 1)
    return float(values[order][place])


def _regions(data: Dataset, points: _Points) -> Iterator[Region]:
    """Pressure thirds, divisions, and how far along its own path a point is."""
    column = {name: data.inputs[:, i] for i, name in enumerate(data.variables)}

    def region(by: str, name: str, chosen: Array) -> Iterator[Region]:
        designs = len(np.unique(points.design[chosen]))
        if designs >= FEWEST_IN_REGION:
            yield Region(by, name, designs, points.errors(chosen))

    edges = np.linspace(0, data.max_pressure, 4)
    for low, high in pairwise(edges):
        inside = (points.pressure > low) & (points.pressure <= high * (1 + 1e-9))
        yield from region("pressure", f"{low / 1e3:g} to {high / 1e3:g} kPa", inside)
    for by in ("divisions_x", "divisions_y"):
        for value in np.unique(column[by]):
            inside = column[by][points.design] == value
            yield from region(by, f"{by} {value:g}", inside)
    met = np.isfinite(data.limit_pressure)
    for name, chosen in (
        ("paths that end at a limit point", met),
        ("paths without a limit point", ~met),
    ):
        yield from region("limit point", name, chosen[points.design])
    near = points.pressure > 0.95 * data.limit_pressure[points.design]
    yield from region("limit point", "past 95 % of the limit pressure", near)


def _limit(ensemble: Surrogate, data: Dataset) -> LimitError | None:
    """Errors of the predicted limit pressure."""
    from .domain import LIMIT_DEVIATIONS

    met = np.isfinite(data.limit_pressure)
    if not met.any() or not ensemble.knows_limits:
        return None
    middle, safe = np.empty(len(data)), np.empty(len(data))
    for i in range(len(data)):
        model = ensemble.with_parameters(data.effect_parameters(i))
        limit = model.limit_pressure([data.design(i)])
        middle[i] = limit.pressure[0]
        safe[i] = limit.quantile(-LIMIT_DEVIATIONS)[0]
    percent = 100 * np.abs(middle / data.limit_pressure - 1)[met]
    return LimitError(
        designs=int(met.sum()),
        median_pct=float(np.median(percent)),
        p95_pct=float(np.quantile(percent, 0.95)),
        missed=int((safe[met] > data.max_pressure).sum()),
        false_alarms=int((safe[~met] < data.max_pressure).sum()),
    )
