"""Measured curves as finite-element paths, and what is read off them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np

from datagen.device import Design, named_device
from datagen.effects import Effect
from datagen.specimens import Bulge, Tensile

from .calibration import FIELDS
from .measurement import Curve, Measurements
from .prior import Prior
from .provenance import source_digest
from .solves import Solve, Solved, Values, values_of
from .traits import Traits

Array = np.ndarray

CONDITIONS = ("orientation",)
"""Effect parameters that the measurement states, curve by curve; never inferred."""

RESTED = 1e5
"""s.  Between runs whose clocks were started anew: a day."""

Cells = Sequence[tuple[int, int, int]]
"""(curve, step, column) of readings."""


class Paths:
    """What has to be solved for measured curves, and where readings are in the answers.

    Parameters
    ----------
    measurements : Measurements
    known : mapping of str to Effect
    folder : path or None
        Of a user's own effects.
    """

    def __init__(
        self,
        measurements: Measurements,
        known: Mapping[str, Effect],
        folder: FilePath | None,
    ) -> None:
        self._measured = measurements.curves
        self._known = known
        self._folder = str(folder) if folder is not None else None
        self._sources: dict[str, str] = {}
        designs = (c.design for c in self._measured)
        device = next((d for d in designs if isinstance(d, Design)), named_device("S1"))
        self.traits = Traits(known, device, folder)

    @property
    def curves(self) -> range:
        """Numbers of the measured curves."""
        return range(len(self._measured))

    def priors(self, names: Sequence[str]) -> tuple[Prior, ...]:
        """Priors of the parameters of some effects, named ``effect.parameter``."""
        return tuple(
            Prior(replace(parameter, name=f"{name}.{parameter.name}"))
            for name in names
            for parameter in self._known[name].parameters
            if parameter.name not in CONDITIONS
        )

    def blind(self, name: str) -> str:
        """Why these curves cannot show an effect, empty where they may."""
        for p in self._known[name].parameters:
            if p.scale == "integer":
                return f"its {p.name} is a whole number, which cannot be fitted"
        timeless = [curve for curve in self._measured if curve.time is None]
        if not timeless or not self.traits.timed(name):
            return ""
        if len(timeless) == len(self._measured):
            return "it depends on time, and no reading has one (column time_s)"
        first = timeless[0]
        return (
            f"it depends on time, and device {first.device}, run {first.run}, has none "
            "(column time_s)"
        )

    def load(
        self, c: int, effects: Iterable[str]
    ) -> tuple[tuple[float, ...], tuple[float, ...] | None, Array]:
        """Loads and times of a curve's path, and where its steps are among them.

        Where an effect remembers, the path begins with the runs before it, vented in
        between; else steps are sorted, and solved once each: pressures first, vacuum,
        in which a path may end as roof and floor touch, last.
        """
        curve = self._measured[c]
        load = np.asarray(curve.load)
        if any(self.traits.remembers(name) for name in effects):
            # Turned over within a run, a device is as old as its curve before that.
            before = [
                other
                for i, other in enumerate(self._measured)
                if other.device == curve.device and (other.run, i) < (curve.run, c)
            ]
            before.sort(key=lambda other: other.run)
            loads, times = _one_after_another([*before, curve])
            at = np.arange(len(loads) - len(load), len(loads))
            return tuple(loads), tuple(times) if times else None, at
        if isinstance(curve.design, Tensile):
            return tuple(float(p) for p in load), None, np.arange(len(load))
        unique, at = np.unique(load, return_inverse=True)
        order = np.lexsort((np.abs(unique), unique < 0))
        return tuple(float(p) for p in unique[order]), None, np.argsort(order)[at]

    def task(
        self,
        c: int,
        level: str,
        names: tuple[str, ...] = (),
        t: Sequence[float] | Array = (),
        by: tuple[str, ...] | None = None,
    ) -> Solve:
        """The path of curve c with some effects on, at coordinates (k,).

        Differentiated by the fields that are calibrated, unless `by` says otherwise.
        """
        curve = self._measured[c]
        if by is None:
            by = FIELDS
            if isinstance(curve.design, Bulge):
                by = ("modulus", "thickness")
            elif isinstance(curve.design, Tensile):
                by = ("modulus",)
        load, time, _ = self.load(c, names)
        effects = self._effects(c, names, t)
        return Solve(
            curve.design,
            load,
            time,
            effects,
            level,
            by,
            self._folder,
            tuple(self._source(name) for name, _ in effects),
        )

    def _source(self, name: str) -> str:
        """Digest of an effect's file as it was when the effect was read."""
        if name not in self._sources:
            self._sources[name] = source_digest(self._known[name])
        return self._sources[name]

    def _effects(
        self, c: int, names: tuple[str, ...], t: Sequence[float] | Array
    ) -> Values:
        """All parameters of some effects for one curve, its conditions included."""
        values = {
            prior.parameter.name: float(prior.value(x))
            for prior, x in zip(self.priors(names), t, strict=True)
        }
        orientation = self._measured[c].orientation
        given: dict[str, dict[str, float]] = {}
        for name in names:
            given[name] = {
                p.name: orientation
                if p.name in CONDITIONS
                else values[f"{name}.{p.name}"]
                for p in self._known[name].parameters
            }
        return values_of(given)

    def gather(
        self,
        cells: Cells,
        names: tuple[str, ...],
        solved: Sequence[Solved] | Mapping[int, Solved],
    ) -> tuple[Array, Array]:
        """(n,) values and (n, 4) derivatives by `FIELDS` of readings."""
        n = len(cells)
        values, fields = np.empty(n), np.zeros((n, len(FIELDS)))
        for i, (c, step, column) in enumerate(self._places(cells, names, solved)):
            answer = solved[c]
            values[i] = answer.values[step, column]
            for j, name in enumerate(answer.by):
                if name in FIELDS:
                    fields[i, FIELDS.index(name)] = answer.jacobian[step, column, j]
                elif name in ("modulus", "thickness"):
                    layer = self._measured[c].design.layer  # type: ignore[union-attr]
                    at = FIELDS.index(f"{layer}_{name}")
                    fields[i, at] = answer.jacobian[step, column, j]
        return values, fields

    def slopes(
        self,
        cells: Cells,
        names: tuple[str, ...],
        t: Array,
        solved: Sequence[Solved],
    ) -> Array:
        """(n, k) derivatives by the coordinates of the effects' parameters."""
        priors = self.priors(names)
        slopes = np.full((len(cells), len(priors)), np.nan)
        if not priors:
            return slopes
        places = self._places(cells, names, solved)
        for k, prior in enumerate(priors):
            for i, (c, step, column) in enumerate(places):
                answer = solved[c]
                if prior.parameter.name in answer.by:
                    by = answer.by.index(prior.parameter.name)
                    slopes[i, k] = answer.jacobian[step, column, by] * prior.slope(t[k])
        return slopes

    def _places(
        self,
        cells: Cells,
        names: tuple[str, ...],
        solved: Sequence[Solved] | Mapping[int, Solved],
    ) -> list[tuple[int, int, int]]:
        """(curve, step, column) of readings in the answers."""
        steps = {c: self.load(c, names)[2] for c in {cell[0] for cell in cells}}
        return [
            (c, int(steps[c][s]), solved[c].outputs.index(self._measured[c].outputs[m]))
            for c, s, m in cells
        ]


def _one_after_another(runs: Sequence[Curve]) -> tuple[list[float], list[float]]:
    """Loads and times of runs in turn, unloaded in between; no times where one lacks.

    Unloading takes as long as a load step, and so does the first step of the next run;
    the rest of the pause the specimen lies unloaded.
    """
    loads: list[float] = []
    times: list[float] = []
    timed = all(run.time is not None for run in runs)
    for run in runs:
        rest = 1.0 if isinstance(run.design, Tensile) else 0.0
        clock = np.asarray(run.time if timed else np.arange(1.0, len(run.load) + 1))
        if loads:
            step = float(np.diff(clock).min()) if len(clock) > 1 else 1.0
            late = times[-1] + RESTED - clock[0] if clock[0] <= times[-1] else 0.0
            clock = clock + late
            step = min(step, (clock[0] - times[-1]) / 3)
            loads += [rest, rest]
            times += [times[-1] + step, float(clock[0]) - step]
        loads += [float(p) for p in run.load]
        times += [float(t) for t in clock]
    return loads, times if timed else []
