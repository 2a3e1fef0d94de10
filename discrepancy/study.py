"""Measurements and the finite-element solves that explain them, as hypotheses.

A study turns curves into readings with their errors, solves the baseline and effects
at a few parameter values, and makes hypotheses from them.  The baseline is solved on
the model's mesh; what an effect changes is solved on a faster one and added.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path as FilePath

import numpy as np

from datagen.effects import Effect, catalogue
from datagen.effects.door import without_effects
from datagen.errors import EffectError, InputError
from datagen.specimens import Tensile

from .calibration import Calibrations
from .columns import NUMBERS
from .emulator import Emulator
from .hypotheses import Null, Present
from .measurement import Curve, Measurements
from .noise import Readings
from .paths import Paths
from .prior import EVEN, Prior
from .repeats import ENOUGH, at_rest_alone, noise_from_repeats
from .solves import Solve, Solved, Solver
from .target import Prediction
from .unknown import shapes_of

Array = np.ndarray

GUESS = 0.005
"""Noise where none is stated and nothing was repeated, share of a curve's maximum."""

SMALLEST = 1e-12
"""SI.  Of a curve's largest value, where neither it nor the baseline moves at all."""

FIRST_NORMAL, FIRST_EVEN = 1.0, 0.4
"""Distance of an effect's first solve from off: a prior standard deviation, a part of
the range."""

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
        known = catalogue(effects_dir)
        for name in effects or ():
            if name not in known:
                raise EffectError(
                    f"effect: {name!r} is unknown; allowed: {', '.join(known)}"
                )
        chosen = known if effects is None else {n: known[n] for n in effects}
        self.effects: dict[str, Effect] = dict(chosen)
        self.paths = Paths(measurements, known, effects_dir)
        self.warnings: list[str] = []
        self.cells = self._measured()
        self._nodes: dict[tuple[tuple[str, ...], tuple[float, ...]], Node] = {}
        self._present: dict[tuple[str, ...], tuple[int, Present]] = {}
        self._read()
        if effects_dir is not None:
            lost = [path.name for path in without_effects(effects_dir)]
            self.warnings += [f"{name}: declares no effect" for name in lost]

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
        fine, fast = self._baseline(self.level), self._baseline(self.fast)
        values, _ = self.paths.gather(self.cells, (), fine)
        quick, _ = self.paths.gather(self.cells, (), fast)
        there = np.isfinite(values) & np.isfinite(quick)
        lost = sorted({self.cells[i][0] for i in np.flatnonzero(~there)})
        for c in lost:
            curve = self.measurements.curves[c]
            count = sum(1 for i in np.flatnonzero(~there) if self.cells[i][0] == c)
            messages = [one.message for one in (fine[c], fast[c]) if one.message]
            why = f" ({messages[0]})" if messages else ""
            self.warnings.append(
                f"device {curve.device}, run {curve.run}: {count} readings are past "
                f"the end of the baseline's path{why} and are left out"
            )
        if not there.any():
            raise InputError(
                "pressure_kPa",
                "all of them",
                f"pressures that the baseline reaches: of {self.warnings[0]}",
            )
        there &= self._heard()
        if not there.any():
            raise InputError(
                "readings", "at rest alone", "some under load, or their noise (_std)"
            )
        self.cells = [one for one, ok in zip(self.cells, there, strict=True) if ok]
        self.shift = (values - quick)[there]
        self.readings = self._readings(values[there])
        self.calibrations = Calibrations.of(self.measurements, self.cells)
        off: tuple[str, ...] = ()
        self._nodes[off, ()] = self._node(off, np.zeros(0), fast)
        self.base = self._nodes[off, ()].values + self.shift

    def _heard(self) -> Array:
        """(n,) mask of readings of whose noise anything is known."""
        silent = at_rest_alone(self.measurements, self.cells)
        self.warnings += [
            f"{NUMBERS[name].name} of each {specimen} is read at rest alone, without "
            "its noise (_std), and left out"
            for specimen, name in silent
        ]
        curves = self.measurements.curves
        kinds = ((curves[c].specimen, curves[c].outputs[m]) for c, _, m in self.cells)
        return np.array([kind not in silent for kind in kinds])

    def _readings(self, baseline: Array) -> Readings:
        """The readings (n,) beside what the baseline says of them, SI."""
        curves = self.measurements.curves
        kinds: dict[tuple[str, str], int] = {}
        groups, curve_of, places, ways, noise, stated, devices, scales, values = (
            [] for _ in range(9)
        )
        top = {
            tensile: max(
                (
                    float(np.abs(c.reach).max())
                    for c in curves
                    if self._pulled(c) == tensile
                ),
                default=1.0,
            )
            or 1.0
            for tensile in (False, True)
        }
        names = list(self.measurements.devices)
        # A curve that never moves errs as one does that the baseline expects.
        flat: dict[tuple[int, int], float] = {}
        for (c, _, m), value in zip(self.cells, np.abs(baseline), strict=True):
            flat[c, m] = max(flat.get((c, m), SMALLEST), float(value))
        size: dict[tuple[int, int], float] = {}
        for c, _, m in self.cells:
            if (c, m) not in size:
                column = np.abs(curves[c].values[:, m])
                size[c, m] = float(np.nanmax(column)) or flat[c, m]
        for c, s, m in self.cells:
            curve = curves[c]
            kind = (curve.specimen, curve.outputs[m])
            groups.append(kinds.setdefault(kind, len(kinds)))
            curve_of.append(1000 * c + m)
            reach = curve.reach / top[self._pulled(curve)]
            places.append(reach[s])
            ways.append(np.abs(np.diff(reach[: s + 1], prepend=0.0)).sum())
            given = curve.std[s, m]
            stated.append(bool(np.isfinite(given)))
            noise.append(given)
            devices.append(names.index(curve.device))
            scales.append(size[c, m])
            values.append(curve.values[s, m])
        self.kinds = tuple(kinds)
        group, scale = np.array(groups), np.array(scales)
        own = np.array(curve_of)
        std, is_stated = np.array(noise, dtype=float), np.array(stated)
        for one in np.unique(own):  # a blank among those of its curve is like them
            at = own == one
            if is_stated[at].any():
                std[at & ~is_stated] = float(np.median(std[at & is_stated]))
                is_stated[at] = True
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
            curve=own,
            place=np.array(places),
            path=np.array(ways),
            noise=std,
            stated=is_stated,
            device=np.array(devices),
            scale=scale,
        )

    @staticmethod
    def _pulled(curve: Curve) -> bool:
        return isinstance(curve.design, Tensile)

    # -- solves --------------------------------------------------------------------

    def blind(self, name: str) -> str:
        """Why these readings cannot show an effect, empty where they may."""
        return self.paths.blind(name)

    def priors(self, names: Sequence[str]) -> tuple[Prior, ...]:
        """Priors of the parameters of some effects, named ``effect.parameter``."""
        return self.paths.priors(names)

    def _baseline(self, level: str) -> list[Solved]:
        tasks = [self.paths.task(c, level) for c in self.paths.curves]
        answers = self.solver.all(tasks, "baseline")
        return [answers[task] for task in tasks]

    def _node(self, names: tuple[str, ...], t: Array, solved: Sequence[Solved]) -> Node:
        values, fields = self.paths.gather(self.cells, names, solved)
        if names:  # next to a limit point there are no derivatives: the baseline's
            fields = np.where(np.isfinite(fields), fields, self._nodes[(), ()].fields)
        else:
            fields = np.nan_to_num(fields)
        failed = tuple(
            f"device {self.measurements.curves[c].device}: {one.status} {one.message}"
            for c, one in enumerate(solved)
            if one.status != "completed"
        )
        slopes = self.paths.slopes(self.cells, names, t, solved)
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
            tasks[i] = [
                self.paths.task(c, self.fast, names, t) for c in self.paths.curves
            ]
        answers = self.solver.all([s for group in tasks.values() for s in group], what)
        for i, group in tasks.items():
            names, t = keys[i]
            solved = [answers[task] for task in group]
            self._nodes[names, t] = self._node(names, np.array(t), solved)
        found = [self._nodes[key] for key in keys]
        return [one if np.isfinite(one.values).all() else None for one in found]

    def tangents(self, names: Sequence[str]) -> list[str]:
        """Differentiate by all effects where they are off, a solve or two a curve.

        Parameters
        ----------
        names : sequence of str

        Returns
        -------
        list of str
            Effects that have such derivatives; some change what is held or meshed as
            soon as they are there.
        """
        traits = self.paths.traits
        smooth = tuple(name for name in names if traits.smooth(name))
        off = {name: tuple(p.off for p in self.priors((name,))) for name in smooth}
        wanted = [n for n in smooth if ((n,), off[n]) not in self._nodes]
        groups = [  # those with a memory have another path
            tuple(n for n in wanted if traits.remembers(n) == remembers)
            for remembers in (False, True)
        ]
        tasks = {
            group: [
                self.paths.task(
                    c, self.fast, group, [t for name in group for t in off[name]]
                )
                for c in self.paths.curves
            ]
            for group in groups
            if group
        }
        answers = self.solver.all(
            [task for some in tasks.values() for task in some], "all effects at once"
        )
        for group, some in tasks.items():
            solved = [answers[task] for task in some]
            for name in group:
                node = self._node((name,), np.array(off[name]), solved)
                self._nodes[(name,), off[name]] = replace(
                    self._nodes[(), ()], slopes=node.slopes
                )
        return [
            name
            for name in smooth
            if np.isfinite(self._nodes[(name,), off[name]].slopes).all()
        ]

    def bends(self, toward: Mapping[str, Array]) -> dict[str, float]:
        """How far effects of finite size turn away from their tangents.

        Each is solved at its first size, on the one curve that its tangent moves most.

        Parameters
        ----------
        toward : mapping of str to (k,) array
            Effects with derivatives where they are off (`tangents`), and where the
            readings ask them to go.

        Returns
        -------
        dict of str to float
            Difference of the change and that of the tangent over the larger of them,
            0 to 2; 2 where the path does not get there.
        """
        spots: dict[str, tuple[int, Array]] = {}
        tangents: dict[str, Array] = {}
        for name, aim in toward.items():
            off = np.array([p.off for p in self.priors((name,))])
            t = self.first(name, aim)[0]
            slopes = self._nodes[(name,), tuple(off)].slopes
            tangent = slopes @ (t - off) / self.readings.noise
            curve = self.cells[int(np.argmax(np.abs(tangent)))][0]
            spots[name] = curve, t
            tangents[name] = tangent[self._of(curve)]
        found = {}
        for name, values in self._on_curves(spots).items():
            at = self._of(spots[name][0])
            change = (values - self._nodes[(), ()].values[at]) / self.readings.noise[at]
            apart, one, other = (
                float(np.linalg.norm(v))
                for v in (change - tangents[name], change, tangents[name])
            )
            size = max(one, other)
            found[name] = apart / size if size > 0 else 0.0
            if not math.isfinite(size):
                found[name] = 2.0
        return found

    def _of(self, curve: int) -> list[int]:
        """Numbers of the readings of a curve."""
        return [i for i, cell in enumerate(self.cells) if cell[0] == curve]

    def _on_curves(self, spots: Mapping[str, tuple[int, Array]]) -> dict[str, Array]:
        """Readings of one curve with one effect on, for each effect."""
        tasks = {
            name: self.paths.task(curve, self.fast, (name,), t)
            for name, (curve, t) in spots.items()
        }
        answers = self.solver.all(tasks.values(), "how straight effects are")
        found = {}
        for name, (curve, _) in spots.items():
            cells = [self.cells[i] for i in self._of(curve)]
            solved = {curve: answers[tasks[name]]}
            found[name] = self.paths.gather(cells, (name,), solved)[0]
        return found

    def on_mesh(
        self, names: tuple[str, ...], values: Mapping[str, float], level: str
    ) -> Array:
        """(n,) readings by finite elements, SI, NaN where a path ends before.

        Parameters
        ----------
        values : mapping of ``effect.parameter`` to float, SI
        """
        t = [p.coordinate(values[p.parameter.name]) for p in self.priors(names)]
        tasks = [self.paths.task(c, level, names, t) for c in self.paths.curves]
        answers = self.solver.all(tasks, "corrected curves")
        solved = [answers[task] for task in tasks]
        return self.paths.gather(self.cells, names, solved)[0]

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

    def first(self, name: str, toward: Array | None = None) -> list[Array]:
        """Coordinates at which an effect is solved first.

        All parameters at once, as its derivatives there tell them apart; one after the
        other and at more sizes where a solve is a formula.

        Parameters
        ----------
        name : str
        toward : (k,) array, optional
            Where the readings ask the effect to go: to that side of off, where it has
            room there; else to the wider one.
        """
        priors = self.priors((name,))
        off = np.array([p.off for p in priors])
        way = np.zeros(len(off))
        for k, prior in enumerate(priors):
            lower, upper = prior.bounds
            step = FIRST_EVEN if prior.density == EVEN else FIRST_NORMAL
            up = upper - off[k] >= 0.99 * (off[k] - lower)
            asked = 0.0 if toward is None else toward[k] - off[k]
            room = upper - off[k] if asked > 0 else off[k] - lower
            if abs(asked) > 1e-3 * (upper - lower) and room >= step / 2:
                up = asked > 0
            way[k] = min(step, upper - off[k]) if up else max(-step, lower - off[k])
        if self.quick:
            axes = np.diag(way)
            return [off + part * axis for axis in axes for part in QUICK_PARTS]
        return [off + way / math.sqrt(len(way))]

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
        where neither a solve nor a derivative tells it from the baseline.
        """
        names = tuple(sorted(names))
        ready = self._present.get(names)
        if ready is not None and ready[0] == len(self._nodes):
            return ready[1]
        priors = self.priors(names)
        off = np.array([p.off for p in priors])
        base = self._nodes[(), ()]
        n, k = len(self.cells), len(priors)
        at_off = np.full((n, k), np.nan)
        nodes, found = [off], [(base, at_off)]
        for (solved, t), node in self._nodes.items():
            if not solved or not set(solved) <= set(names):
                continue
            if not np.isfinite(node.values).all():
                continue
            own = [p.parameter.name for p in self.priors(solved)]
            places = [i for i, p in enumerate(priors) if p.parameter.name in own]
            where = off.copy()
            where[places] = t
            if np.allclose(where, off, atol=1e-9):
                at_off[:, places] = node.slopes
                continue
            if any(np.allclose(where, other, atol=1e-9) for other in nodes):
                continue
            slopes = np.full((n, k), np.nan)
            slopes[:, places] = node.slopes
            nodes.append(where)
            found.append((node, slopes))
        if len(nodes) < 2 and np.isnan(at_off).any(axis=0).all():
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
