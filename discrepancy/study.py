"""Measurements and the finite-element solves that explain them, as hypotheses.

A study turns curves into readings with their errors, solves the baseline and effects
at a few parameter values, and makes hypotheses from them.  The baseline is solved on
the model's mesh; what an effect changes is solved on a faster one and added.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path as FilePath

import numpy as np

from datagen.device import Design, named_device
from datagen.effects import Effect, catalogue
from datagen.errors import EffectError, InputError
from datagen.model import Model
from datagen.problem import Problem
from datagen.specimens import Bulge, Tensile

from .calibration import FIELDS, Calibrations
from .emulator import Emulator
from .evidence import Prediction
from .hypotheses import Null, Present
from .measurement import Curve, Measurements
from .noise import Readings
from .prior import EVEN, Prior
from .repeats import ENOUGH, noise_from_repeats
from .solves import Solve, Solved, Solver, Values, values_of
from .unknown import shapes_of

Array = np.ndarray

CONDITIONS = ("orientation",)
"""Effect parameters that the measurement states, curve by curve; never inferred."""

GUESS = 0.005
"""Noise where none is stated and nothing was repeated, share of a curve's maximum."""

FIRST_NORMAL, FIRST_EVEN = 1.0, 0.4
"""Coordinate of an effect's first solve: a prior standard deviation, a part of the
range."""

QUICK_PARTS = (2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02)
"""More first solves, in parts of that one, where a solve costs nothing."""


@dataclass(frozen=True)
class Node:
    """What the solves of all curves say at one set of parameter values.

    Parameters
    ----------
    values : (n,) array, SI
    slopes : (n, k) array
        By the coordinates of the effects' parameters.
    fields : (n, 4) array
        By the true values of `FIELDS`.
    failed : tuple of str
        Why some curves did not get to the end, one line each.
    """

    values: Array
    slopes: Array
    fields: Array
    failed: tuple[str, ...]


class Study:
    """Measurements under explanation.

    Parameters
    ----------
    measurements : Measurements
    solver : Solver
    level, fast : str
        Mesh of the baseline, and of what effects change.
    effects : sequence of str, optional
        Candidates; the whole catalogue by default.
    effects_dir : path, optional
        Folder of a user's own effects, candidates as well.

    Raises
    ------
    EffectError
        When a candidate is unknown.
    InputError
        When the model reaches none of the measured pressures.
    """

    def __init__(
        self,
        measurements: Measurements,
        solver: Solver,
        *,
        level: str = "standard",
        fast: str = "draft",
        effects: Sequence[str] | None = None,
        effects_dir: FilePath | None = None,
    ) -> None:
        self.measurements, self.solver = measurements, solver
        self.level, self.fast = level, fast
        self.folder = effects_dir
        self.effects_dir = str(effects_dir) if effects_dir is not None else None
        known = catalogue(effects_dir)
        for name in effects or ():
            if name not in known:
                raise EffectError(
                    f"effect: {name!r} is unknown; allowed: {', '.join(known)}"
                )
        chosen = known if effects is None else {n: known[n] for n in effects}
        self.effects: dict[str, Effect] = dict(chosen)
        self._known = known
        self.warnings: list[str] = []
        self.cells = self._measured()
        self._nodes: dict[tuple[tuple[str, ...], tuple[float, ...]], Node] = {}
        self._present: dict[tuple[str, ...], tuple[int, Present]] = {}
        self._read()

    def with_readings(self, readings: Readings) -> Study:
        """The same solves under other readings of the same curves."""
        if len(readings.value) != len(self.readings.value):
            raise InputError(
                "readings", len(readings.value), "as many as were measured"
            )
        other = copy(self)
        other.__dict__.pop("_shapes", None)
        other.readings = readings
        return other

    # -- readings ------------------------------------------------------------------

    def _measured(self) -> list[tuple[int, int, int]]:
        """(curve, step, column) of every reading that is there."""
        return [
            (c, int(s), int(m))
            for c, curve in enumerate(self.measurements.curves)
            for m in range(len(curve.outputs))
            for s in np.flatnonzero(np.isfinite(curve.values[:, m]))
        ]

    def _read(self) -> None:
        """Solve the baseline; readings beyond its reach are left out and told."""
        fine = self._solved([((), self.level)])[(), self.level]
        fast = self._solved([((), self.fast)])[(), self.fast]
        values, _ = self._gather((), fine)
        quick, _ = self._gather((), fast)
        there = np.isfinite(values) & np.isfinite(quick)
        lost = sorted({self.cells[i][0] for i in np.flatnonzero(~there)})
        for c in lost:
            curve = self.measurements.curves[c]
            count = sum(1 for i in np.flatnonzero(~there) if self.cells[i][0] == c)
            self.warnings.append(
                f"device {curve.device}, run {curve.run}: {count} readings are past "
                "the end of the baseline's path and are left out"
            )
        if not there.any():
            raise InputError(
                "pressure_kPa",
                "all of them",
                "pressures that the baseline reaches: its path ends before the first",
            )
        self.cells = [one for one, ok in zip(self.cells, there, strict=True) if ok]
        self.shift = (values - quick)[there]
        self.readings = self._readings()
        self.calibrations = Calibrations.of(self.measurements, self.cells)
        off: tuple[str, ...] = ()
        self._nodes[off, ()] = self._node(off, (), fast)
        self.base = self._nodes[off, ()].values + self.shift

    def _readings(self) -> Readings:
        curves = self.measurements.curves
        kinds: dict[tuple[str, str], int] = {}
        groups, curve_of, places, noise, stated, devices, scales, values = (
            [] for _ in range(8)
        )
        top = {
            tensile: max(
                (
                    float(self._reach(c).max())
                    for c in curves
                    if self._pulled(c) == tensile
                ),
                default=1.0,
            )
            or 1.0
            for tensile in (False, True)
        }
        names = list(self.measurements.devices)
        size: dict[tuple[int, int], float] = {}
        for c, _, m in self.cells:
            if (c, m) not in size:
                column = np.abs(curves[c].values[:, m])
                size[c, m] = float(np.nanmax(column)) or 1.0
        for c, s, m in self.cells:
            curve = curves[c]
            kind = (curve.specimen, curve.outputs[m])
            groups.append(kinds.setdefault(kind, len(kinds)))
            curve_of.append(1000 * c + m)
            places.append(self._reach(curve)[s] / top[self._pulled(curve)])
            given = curve.std[s, m]
            stated.append(bool(np.isfinite(given)))
            noise.append(given)
            devices.append(names.index(curve.device))
            scales.append(size[c, m])
            values.append(curve.values[s, m])
        self.kinds = tuple(kinds)
        group, scale = np.array(groups), np.array(scales)
        std, is_stated = np.array(noise, dtype=float), np.array(stated)
        self.repeats = noise_from_repeats(self.measurements)
        for kind, g in kinds.items():
            at = group == g
            missing = at & ~is_stated
            repeated = self.repeats.get(kind)
            if repeated is None:
                std[missing] = GUESS * float(np.median(scale[at]))
            else:
                std[missing] = repeated.std
                is_stated[missing] = repeated.degrees >= ENOUGH
            # A curve that is nearly flat errs like the others of its quantity.
            scale[at] = np.maximum(scale[at], 0.2 * float(np.median(scale[at])))
        return Readings(
            value=np.array(values),
            group=group,
            curve=np.array(curve_of),
            place=np.array(places),
            noise=std,
            stated=is_stated,
            device=np.array(devices),
            scale=scale,
        )

    @staticmethod
    def _pulled(curve: Curve) -> bool:
        return isinstance(curve.design, Tensile)

    def _reach(self, curve: Curve) -> Array:
        """(s,) distance from rest: pressure, or stretch less one."""
        reach: Array = np.abs(curve.load - 1.0 if self._pulled(curve) else curve.load)
        return reach

    # -- solves --------------------------------------------------------------------

    def blind(self, name: str) -> str:
        """Why these readings cannot show an effect, empty where they may."""
        timeless = all(curve.time is None for curve in self.measurements.curves)
        if timeless and self._timed(name):
            return "it depends on time, and no reading has one (column time_s)"
        return ""

    def _timed(self, name: str) -> bool:
        """Whether an effect's answer depends on how long a load step takes."""
        problem = self._example(name)
        if problem is None:
            return False
        if bool(problem.swellings):
            return True
        f = np.tile(np.diag([1.2, 0.9, 1.0]).reshape(1, 9), (2, 1))
        for law in problem.laws:
            if not law.history_size:
                continue
            rest = np.zeros((2, law.history_size))
            quick, slow = (
                law.respond(f, np.ones(2), rest, dt, False).stress for dt in (1.0, 1e3)
            )
            if not np.array_equal(quick, slow):
                return True
        return False

    def _example(self, name: str) -> Problem | None:
        """A device with an effect in the middle of its range; None where none fits."""
        devices = (c.design for c in self.measurements.curves)
        design = next((d for d in devices if isinstance(d, Design)), None)
        middle = {
            p.name: 0.5 * (p.lower + p.upper) for p in self._known[name].parameters
        }
        directory = FilePath(self.effects_dir) if self.effects_dir else None
        model = Model((name,), "draft", {name: middle}, directory)
        try:
            return model.problem(design or named_device("S1"))
        except InputError:
            return None

    @cached_property
    def _remembering(self) -> dict[str, bool]:
        """Whether an effect's answer depends on what came before."""
        found = {}
        for name in self._known:
            problem = self._example(name)
            found[name] = problem is not None and (
                any(law.history_size for law in problem.laws) or bool(problem.swellings)
            )
        return found

    def _load(
        self, c: int, effects: Iterable[str]
    ) -> tuple[tuple[float, ...], tuple[float, ...] | None, Array]:
        """Loads and times of a curve's solve, and where its steps are among them."""
        curve = self.measurements.curves[c]
        load = np.asarray(curve.load)
        if any(self._remembering[name] for name in effects):
            before = [
                other
                for other in self.measurements.curves
                if other.device == curve.device
                and other.run < curve.run
                and other.orientation == curve.orientation
            ]
            before.sort(key=lambda other: other.run)
            parts = [*(np.asarray(b.load) for b in before), load]
            steps = sum(len(p) for p in parts)
            at = np.arange(steps - len(load), steps)
            times = [
                t for t in (*(b.time for b in before), curve.time) if t is not None
            ]
            time: tuple[float, ...] | None = None
            if len(times) == len(parts):
                whole: list[float] = []
                for t in times:  # clocks that were started anew run on
                    late = whole[-1] + 1.0 - t[0] if whole and t[0] <= whole[-1] else 0
                    whole += [float(x + late) for x in t]
                time = tuple(whole)
            return tuple(float(p) for p in np.concatenate(parts)), time, at
        if (load < 0).any() or self._pulled(curve):
            return tuple(float(p) for p in load), None, np.arange(len(load))
        unique, at = np.unique(load, return_inverse=True)
        return tuple(float(p) for p in unique), None, at

    def _task(self, c: int, effects: Values, level: str) -> Solve:
        curve = self.measurements.curves[c]
        by: tuple[str, ...] = FIELDS
        if isinstance(curve.design, Bulge):
            by = ("modulus", "thickness")
        elif isinstance(curve.design, Tensile):
            by = ("modulus",)
        load, time, _ = self._load(c, [name for name, _ in effects])
        return Solve(curve.design, load, time, effects, level, by, self.effects_dir)

    def _effects(
        self, c: int, names: tuple[str, ...], values: Mapping[str, float]
    ) -> Values:
        """All parameters of some effects for one curve, its conditions included."""
        orientation = self.measurements.curves[c].orientation
        given: dict[str, dict[str, float]] = {}
        for name in names:
            given[name] = {}
            for parameter in self._known[name].parameters:
                full = f"{name}.{parameter.name}"
                if parameter.name in CONDITIONS:
                    given[name][parameter.name] = orientation
                else:
                    given[name][parameter.name] = float(values[full])
        return values_of(given)

    def _solved(
        self, wanted: Sequence[tuple[tuple[tuple[str, Mapping[str, float]], ...], str]]
    ) -> dict[tuple[object, str], list[Solved]]:
        """Baseline solves of all curves on some meshes."""
        curves = range(len(self.measurements.curves))
        tasks = {
            (key, level): [self._task(c, (), level) for c in curves]
            for key, level in wanted
        }
        answers = self.solver.all(
            [task for group in tasks.values() for task in group], "baseline"
        )
        return {key: [answers[t] for t in group] for key, group in tasks.items()}

    def priors(self, names: Sequence[str]) -> tuple[Prior, ...]:
        """Priors of the parameters of some effects, named ``effect.parameter``."""
        from dataclasses import replace

        return tuple(
            Prior(replace(parameter, name=f"{name}.{parameter.name}"))
            for name in names
            for parameter in self._known[name].parameters
            if parameter.name not in CONDITIONS
        )

    def _gather(
        self, names: tuple[str, ...], solved: Sequence[Solved]
    ) -> tuple[Array, Array]:
        """(n,) values and (n, 4) derivatives by `FIELDS` of all readings."""
        n = len(self.cells)
        values, fields = np.empty(n), np.zeros((n, len(FIELDS)))
        places = {}
        for i, (c, s, m) in enumerate(self.cells):
            curve, answer = self.measurements.curves[c], solved[c]
            if c not in places:
                places[c] = self._load(c, names)[2]
            column = answer.outputs.index(curve.outputs[m])
            step = places[c][s]
            values[i] = answer.values[step, column]
            for j, name in enumerate(answer.by):
                if name in FIELDS:
                    fields[i, FIELDS.index(name)] = answer.jacobian[step, column, j]
                elif name in ("modulus", "thickness"):
                    layer = curve.design.layer  # type: ignore[union-attr]
                    at = FIELDS.index(f"{layer}_{name}")
                    fields[i, at] = answer.jacobian[step, column, j]
        return values, fields

    def _node(
        self, names: tuple[str, ...], t: tuple[float, ...], solved: Sequence[Solved]
    ) -> Node:
        values, fields = self._gather(names, solved)
        priors = self.priors(names)
        slopes = np.full((len(self.cells), len(priors)), np.nan)
        for k, prior in enumerate(priors):
            for i, (c, s, m) in enumerate(self.cells):
                answer = solved[c]
                if prior.parameter.name not in answer.by:
                    continue
                column = answer.outputs.index(self.measurements.curves[c].outputs[m])
                step = self._load(c, names)[2][s]
                by = answer.by.index(prior.parameter.name)
                slopes[i, k] = answer.jacobian[step, column, by] * prior.slope(t[k])
        if names:  # next to a limit point there are no derivatives: the baseline's
            fields = np.where(np.isfinite(fields), fields, self._nodes[(), ()].fields)
        else:
            fields = np.nan_to_num(fields)
        failed = tuple(
            f"device {self.measurements.curves[c].device}: {one.status} {one.message}"
            for c, one in enumerate(solved)
            if one.status != "completed"
        )
        return Node(values, slopes, fields, failed)

    def solve(
        self, wanted: Sequence[tuple[tuple[str, ...], Array]], what: str
    ) -> list[Node | None]:
        """Solve sets of effects at coordinates; None where a reading is not reached.

        Parameters
        ----------
        wanted : sequence of (names, (k,) coordinates)
        what : str
            For the progress.
        """
        tasks: dict[int, list[Solve]] = {}
        keys = [(names, tuple(float(x) for x in t)) for names, t in wanted]
        for i, key in enumerate(keys):
            if key in self._nodes:
                continue
            names, t = key
            values = {
                prior.parameter.name: float(prior.value(x))
                for prior, x in zip(self.priors(names), t, strict=True)
            }
            tasks[i] = [
                self._task(c, self._effects(c, names, values), self.fast)
                for c in range(len(self.measurements.curves))
            ]
        answers = self.solver.all([s for group in tasks.values() for s in group], what)
        for i, group in tasks.items():
            names, t = keys[i]
            self._nodes[names, t] = self._node(names, t, [answers[s] for s in group])
        found = [self._nodes[key] for key in keys]
        return [one if np.isfinite(one.values).all() else None for one in found]

    def on_mesh(
        self, names: tuple[str, ...], values: Mapping[str, float], level: str
    ) -> Array:
        """(n,) readings by finite elements, SI, NaN where a path ends before.

        Parameters
        ----------
        values : mapping of ``effect.parameter`` to float, SI
        """
        tasks = [
            self._task(c, self._effects(c, names, values), level)
            for c in range(len(self.measurements.curves))
        ]
        answers = self.solver.all(tasks, "corrected curves")
        return self._gather(names, [answers[task] for task in tasks])[0]

    # -- hypotheses ----------------------------------------------------------------

    def null(self) -> Null:
        """Nothing is missing."""
        node = self._nodes[(), ()]
        prediction = Prediction(
            self.base,
            np.zeros((len(self.base), 0)),
            self.calibrations.columns(self.base, node.fields),
        )
        return Null("nothing", prediction)

    def unknown(self) -> Null:
        """A smooth effect acts that is alike for devices that are alike."""
        return Null("unknown", self.null().prediction, self._shapes)

    @cached_property
    def _shapes(self) -> tuple[Array, ...]:
        designs = [self.measurements.curves[c].design for c, _, _ in self.cells]
        return shapes_of(self.readings, designs)

    def first(self, name: str) -> list[Array]:
        """Coordinates at which an effect is solved first: one along each parameter."""
        priors = self.priors((name,))
        off = np.array([p.off for p in priors])
        found = []
        for k, prior in enumerate(priors):
            lower, upper = prior.bounds
            step = FIRST_EVEN if prior.density == EVEN else FIRST_NORMAL
            up = upper - off[k] >= 0.99 * (off[k] - lower)
            way = min(step, upper - off[k]) if up else max(-step, lower - off[k])
            for part in QUICK_PARTS if self.quick else (1.0,):
                t = off.copy()
                t[k] = off[k] + part * way
                found.append(t)
        return found

    def _reach_of(self, names: tuple[str, ...], off: Array) -> Array:
        """(k, 2) coordinates between which paths got to the end, as far as is known.

        Told apart for effects of one parameter, from solves of that effect alone.
        """
        reach = np.tile([-np.inf, np.inf], (len(off), 1))
        places = {}
        for name in names:
            own = len(self.priors((name,)))
            if own == 1:
                places[name] = sum(len(self.priors((n,))) for n in names if n < name)
        for (solved, t), node in self._nodes.items():
            if len(solved) != 1 or np.isfinite(node.values).all():
                continue
            if solved[0] in places:
                at = places[solved[0]]
                side = 1 if t[0] > off[at] else 0
                nearer = min if side else max
                reach[at, side] = nearer(reach[at, side], t[0])
        return reach

    @property
    def quick(self) -> bool:
        """True where every solve is a formula: tensile specimens alone."""
        return all(self._pulled(curve) for curve in self.measurements.curves)

    def present(self, names: Sequence[str]) -> Present | None:
        """The hypothesis that some effects act, from what has been solved of them.

        Solves of fewer of the effects count, too, the others being off there.  None
        where nothing but the baseline has been solved.
        """
        names = tuple(sorted(names))
        ready = self._present.get(names)
        if ready is not None and ready[0] == len(self._nodes):
            return ready[1]
        priors = self.priors(names)
        off = np.array([p.off for p in priors])
        base = self._nodes[(), ()]
        n, k = len(self.cells), len(priors)
        nodes, found = [off], [(base, np.full((n, k), np.nan))]
        for (solved, t), node in self._nodes.items():
            if not solved or not set(solved) <= set(names):
                continue
            if not np.isfinite(node.values).all():
                continue
            own = [p.parameter.name for p in self.priors(solved)]
            places = [i for i, p in enumerate(priors) if p.parameter.name in own]
            where = off.copy()
            where[places] = t
            if any(np.allclose(where, other, atol=1e-9) for other in nodes):
                continue
            slopes = np.full((n, k), np.nan)
            slopes[:, places] = node.slopes
            nodes.append(where)
            found.append((node, slopes))
        if len(nodes) < 2:
            return None
        span = np.array([p.bounds[1] - p.bounds[0] for p in priors])
        curves = Emulator(
            np.array(nodes),
            np.stack([node.values for node, _ in found]),
            np.stack([slopes for _, slopes in found]),
            span,
        )
        fields = np.stack([node.fields.reshape(-1) for node, _ in found])
        made = Present(
            name="+".join(names),
            effects=names,
            priors=priors,
            curves=curves,
            fields=Emulator(
                np.array(nodes), fields, np.full((*fields.shape, k), np.nan), span
            ),
            shift=self.shift,
            calibrations=self.calibrations,
            reach=self._reach_of(names, off),
        )
        self._present[names] = (len(self._nodes), made)
        return made
