"""Measurements with a hidden effect: what a claim about the ranking is tested on.

A laboratory is drawn from a seed: devices, how far they are from what is stated, a
camera, noise, and an effect with its size.  What the ranker takes for granted differs
here: the mesh is graded otherwise, load steps lie between the measured ones, and the
smooth errors inside a curve are Legendre polynomials, not the ranker's kernel.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field

import numpy as np

from datagen.device import MATERIALS, Design
from datagen.effects import Effect, catalogue
from datagen.effects.acting import act
from datagen.equilibrium import Workspace
from datagen.errors import EffectError, InputError
from datagen.levels import LEVELS, MeshLevel
from datagen.problem import STAGES, baseline
from datagen.response import Path
from datagen.solver import solve

from .calibration import LENGTHS
from .columns import NUMBERS
from .laboratory import (
    MESHES,
    Programme,
    draw_devices,
    programme,
    smooth_error,
    within,
)
from .measurement import (
    LOADING,
    MEASURED,
    UNLOADING,
    Curve,
    Measurements,
    Tolerances,
)
from .paths import CONDITIONS
from .prior import Prior
from .sealed import NAMED, NONE, UNNAMED, Planted, Truth
from .unnamed import UNNAMED as PRIVATE

Array = np.ndarray
Active = tuple[tuple[Effect, dict[str, float]], ...]
"""Effects that act, and all their parameters, SI."""

SIZES = {"small": 3.0, "medium": 10.0, "large": 30.0}
"""Largest change that an effect makes in a reading, over the noise."""

NOISE = {"tip_deflection": 3e-6, "inflation": 2e-6}
"""Standard deviation of the instruments, m: a pixel of a microscope's camera."""

SMOOTH = (0.005, 0.01)
"""Size of smooth errors, share of a curve's maximum: drawn from this range."""

TOP = (80e3, 140e3)
"""Pa.  Range of the highest pressure, before any path is found to end below it."""

MARGIN = 0.85
"""Highest pressure of the next try over the one that a path did not get past."""

CLOSE, SOLVES = 0.05, 12
"""Relative error of an effect's size, and solves at most to get there."""

RAYS = 3
"""Directions tried with each effect before it is said to move too little."""

HOPELESS = 1e-3
"""Share of the wanted change at a fifth of an effect's range that leads nowhere: even
a fourth power would not get there."""

UNSEEN = 0.02
"""The same, over the noise: less may be what a solve stops at."""

ALIKE = 0.95
"""Cosine between the changes of two effects above which they are not drawn together."""


@dataclass(frozen=True)
class Plan:
    """What a set is to be.

    Parameters
    ----------
    seed : int
        The same plan gives the same set.
    devices : int
        2 to 50.
    effects : str
        ``all``: one of the catalogue; ``two``: two of it; ``none``; ``unnamed``: one
        that the catalogue lacks; or names: one of ``a,b``, both of ``a+b``.
    pressures : int
        Load steps on the way up, 2 to 100.
    noise : mapping of str to float, SI
        Quantities that are measured, and the standard deviation of each.
    size : float
        Largest change of a reading that the effect makes, over the noise.
    level : str
        Mesh of the truth: a key of `MESHES`.
    unloading : bool
        Measure on the way down, too.
    repeat : bool
        Measure every device twice.
    stated : bool
        Whether the file states the noise.
    smooth : (float, float)
        Range of the smooth errors' size, share of a curve's maximum.
    tolerances : Tolerances
        How far the true devices are from the stated ones.

    Raises
    ------
    InputError
        When a value is not allowed.
    """

    seed: int
    devices: int = 6
    effects: str = "all"
    pressures: int = 7
    noise: Mapping[str, float] = field(default_factory=lambda: dict(NOISE))
    size: float = SIZES["medium"]
    level: str = "standard"
    unloading: bool = False
    repeat: bool = False
    stated: bool = True
    smooth: tuple[float, float] = SMOOTH
    tolerances: Tolerances = field(default_factory=Tolerances)

    def __post_init__(self) -> None:
        for name, lower, upper in (
            ("seed", 0, 2**63 - 1),
            ("devices", 2, 50),
            ("pressures", 2, 100),
        ):
            value = getattr(self, name)
            whole = isinstance(value, int) and not isinstance(value, bool)
            if not whole or not lower <= value <= upper:
                raise InputError(name, value, f"a whole number, {lower} to {upper}")
        if self.level not in MESHES:
            raise InputError("level", self.level, ", ".join(MESHES))
        if not 0.1 <= self.size <= 1000:
            raise InputError("size", self.size, "0.1 to 1000 times the noise")
        low, high = self.smooth
        if not 0 <= low <= high <= 0.5:
            raise InputError("smooth", self.smooth, "a range within 0 to 0.5")
        if not self.noise:
            raise InputError("noise", "none", "at least one quantity")
        for name, std in self.noise.items():
            if name not in MEASURED["actuator"]:
                raise InputError("noise", name, ", ".join(MEASURED["actuator"]))
            column = NUMBERS[name]
            if not 0 < std <= column.upper:
                given = float(column.bench.from_si(std))
                largest = column.bench.from_si(column.upper)
                allowed = f"above 0, up to {largest:g} {column.unit}"
                raise InputError(f"noise of {column.name}", given, allowed, column.unit)

    @property
    def groups(self) -> tuple[tuple[tuple[str, ...], ...], dict[str, Effect]]:
        """Sets of names to draw one from, in order, and the effects by name.

        Raises
        ------
        EffectError
            When a name is unknown.
        """
        known = catalogue()
        singles = tuple((name,) for name in known)
        if self.effects == "none":
            return (), {}
        if self.effects == "unnamed":
            return tuple((name,) for name in PRIVATE), dict(PRIVATE)
        if self.effects == "all":
            return singles, known
        if self.effects == "two":
            names = list(known)
            pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
            return tuple(pairs), known
        every = known | PRIVATE
        wanted = tuple(
            tuple(sorted({name.strip() for name in one.split("+")}))
            for one in self.effects.split(",")
        )
        for group in wanted:
            for name in group:
                if name not in every:
                    raise EffectError(
                        f"effect: {name!r} is unknown; allowed: all, two, none, "
                        f"unnamed, {', '.join(every)}"
                    )
            if len(group) > 1 and any(name in PRIVATE for name in group):
                raise EffectError(
                    f"effect: {'+'.join(group)!r} is not allowed; allowed: pairs of "
                    "the catalogue's effects"
                )
        return wanted, every

    def asked(self) -> dict[str, object]:
        """The plan as data."""
        content = asdict(self)
        return content | {"noise": dict(self.noise), "smooth": list(self.smooth)}


@dataclass(frozen=True)
class Challenge:
    """A set of measurements and what is hidden in it."""

    measurements: Measurements
    truth: Truth


class _Ended(Exception):
    """A path does not get to its highest pressure; `reached`, Pa, is how far it got."""

    def __init__(self, reached: float) -> None:
        super().__init__(f"{reached:g} Pa")
        self.reached = reached


class _Unfit(Exception):
    """An effect cannot be planted as wanted; the message is what is allowed."""


def _in_order(active: Active) -> Active:
    """Effects as the model applies them: by stage, within one by name."""
    return tuple(sorted(active, key=lambda e: (STAGES.index(e[0].stage), e[0].name)))


def _significant(value: float, digits: int = 4) -> float:
    """A value that does not depend on the last bits of a solve."""
    return float(f"{value:.{digits - 1}e}")


class Maker:
    """Makes one set; every aspect has a stream of random numbers of its own.

    Parameters
    ----------
    plan : Plan
    progress : callable, optional
        Called with words and the number of paths solved.
    """

    def __init__(
        self, plan: Plan, progress: Callable[[str, int], None] | None = None
    ) -> None:
        self.plan, self.progress = plan, progress
        self.solved = 0
        streams = np.random.SeedSequence(plan.seed).spawn(5)
        lab, off, self._effect_seed, errors, steps = streams
        self._errors, self._steps = map(np.random.default_rng, (errors, steps))
        rng = np.random.default_rng(lab)
        self.stated = draw_devices(rng, plan.devices)
        self.top = float(np.round(rng.uniform(*TOP) / 1e3)) * 1e3
        self.hold = float(rng.integers(2, 21))
        rng = np.random.default_rng(off)
        allowed = plan.tolerances
        self.batches = {mix: 1 + allowed.modulus * within(rng) for mix in MATERIALS}
        self.made = {name: self._made(rng, d) for name, d in self.stated.items()}
        self.scales = 1 + allowed.camera_scale * within(rng, 2 * plan.devices)
        self.smooth = float(rng.uniform(*plan.smooth))
        self._workspace = Workspace()

    def _made(self, rng: np.random.Generator, stated: Design) -> Design:
        """A device as it was made."""
        factor = {MATERIALS[mix]: float(f) for mix, f in self.batches.items()}
        off = self.plan.tolerances.thickness * within(rng, 2)
        return stated.with_values(
            upper_modulus=stated.upper_modulus * factor[stated.upper_modulus],
            lower_modulus=stated.lower_modulus * factor[stated.lower_modulus],
            upper_thickness=stated.upper_thickness + off[0],
            lower_thickness=stated.lower_thickness + off[1],
        )

    # -- solves --------------------------------------------------------------------

    def _answers(
        self,
        what: str,
        active: Active,
        level: MeshLevel,
        path: Path,
        where: Array,
    ) -> Array:
        """(devices, ..., m) array, SI, of the measured quantities at steps `where`.

        Raises
        ------
        _Ended
            When a path does not get to its end.
        InputError
            When an effect does not fit a device.
        """
        found = []
        for design in self.made.values():
            problem = baseline(design, level)
            for one, values in _in_order(active):
                problem = act(one, problem, values)
            response = solve(problem, path, self._workspace)
            self.solved += 1
            if self.progress is not None:
                self.progress(what, self.solved)
            if response.path_status[0] != "completed":
                done = np.isfinite(response.values[0]).all(axis=1)
                limit = float(response.limit_pressure[0])
                known = math.isfinite(limit)
                raise _Ended(limit if known else path.pressure[done].max(initial=0.0))
            columns = [response.output(name)[0] for name in self.plan.noise]
            found.append(np.stack(columns, axis=-1)[where])
        return np.stack(found)

    def _programme(self) -> Programme:
        plan = self.plan
        runs = 2 if plan.repeat else 1
        return programme(self.top, plan.pressures, plan.unloading, runs, self.hold)

    def _noise(self) -> Array:
        return np.array(list(self.plan.noise.values()))

    def run(self) -> Challenge:
        """Draw, plant, solve and measure.

        Raises
        ------
        InputError
            When an effect cannot be planted at the wanted size.
        EffectError
            When an effect is unknown.
        """
        _ = self.plan.groups  # names are checked before anything is solved
        while True:
            schedule = self._programme()
            try:
                planted, active = self._plant(schedule)
                between = self._steps.uniform(
                    0.3, 0.7, (schedule.runs, len(schedule.load))
                )
                true = self._answers(
                    "the truth",
                    active,
                    MESHES[self.plan.level],
                    *schedule.path(between),
                )
                break
            except _Ended as end:
                self._lower(end)
        return Challenge(self._measured(schedule, true), self._truth(planted))

    def _lower(self, end: _Ended) -> None:
        """A lower highest pressure, that all paths exist at."""
        top = MARGIN * min(self.top, end.reached)
        self.top = max(math.floor(top / 1e3), 1) * 1e3
        if top < 2e3:
            raise InputError(
                "seed", self.plan.seed, "another: a path of this set ends at once"
            )

    # -- effects -------------------------------------------------------------------

    def _plant(self, schedule: Programme) -> tuple[tuple[Planted, ...], Active]:
        """The effects of the first group of names, in random order, that can be had."""
        path, where = schedule.path()
        higher = Path(np.append(path.pressure, 1.1 * schedule.load.max()))
        draft = LEVELS["draft"]
        rest = self._answers("nothing missing", (), draft, higher, where)
        groups, known = self.plan.groups
        if not groups:
            return (), ()
        rng = np.random.default_rng(self._effect_seed)
        why = ""
        for i in np.tile(rng.permutation(len(groups)), RAYS):
            one_rng = np.random.default_rng([int(i), int(rng.integers(2**31))])
            try:
                found = [
                    self._sized(known[name], one_rng, path, where, rest)
                    for name in groups[i]
                ]
                shifts = [shift.ravel() for _, _, shift in found]
                if len(shifts) == 2 and _cosine(*shifts) > ALIKE:
                    raise _Unfit(
                        f"effects that differ: {' and '.join(groups[i])} change these "
                        f"readings alike"
                    )
            except _Unfit as unfit:
                why = str(unfit)
                continue
            planted = tuple(one for one, _, _ in found)
            active = tuple(
                (known[one.effect], known[one.effect].check(values))
                for one, values, _ in found
            )
            return planted, active
        raise InputError("size", float(self.plan.size), why, "times the noise")

    def _sized(
        self,
        one: Effect,
        rng: np.random.Generator,
        path: Path,
        where: Array,
        rest: Array,
    ) -> tuple[Planted, dict[str, float], Array]:
        """An effect whose largest change of a reading is `Plan.size` times the noise.

        A point is drawn from the priors; the effect lies on the ray from off through
        it.  The place on the ray, 1 at the end of the range, is found by the secant
        method on logarithms, within a bracket where a path was lost.

        Returns
        -------
        planted : Planted
        values : dict of str to float, SI
        shift : (devices, runs, s, m) array
            Changes over the noise.

        Raises
        ------
        _Unfit
            When the range ends, or the paths do, before the size is reached.
        """
        priors = [Prior(p) for p in one.parameters if p.name not in CONDITIONS]
        off = np.array([p.off for p in priors])
        drawn = np.array([float(p.sample(np.array(rng.random()))) for p in priors])
        ends = np.array([p.bounds for p in priors])
        step = drawn - off
        room = np.where(step < 0, ends[:, 0] - off, ends[:, 1] - off)
        step /= np.max(np.divide(step, room, where=step != 0, out=np.zeros(len(step))))

        def values_at(place: float) -> dict[str, float]:
            found = {}
            for prior, t in zip(priors, off + place * step, strict=True):
                p, value = prior.parameter, _significant(float(prior.value(t)))
                found[p.name] = min(max(value, p.lower), p.upper)
            return found

        def shift_at(place: float) -> Array | None:
            try:
                active = ((one, one.check(values_at(place))),)
                draft = LEVELS["draft"]
                answers = self._answers("an effect", active, draft, path, where)
            except (_Ended, InputError):  # too much, or a device that it does not fit
                return None
            shift: Array = (answers - rest) / self._noise()
            return shift

        wanted = self.plan.size
        place, below, above = 0.2, 0.0, 1.0
        known: list[tuple[float, float]] = []
        for _ in range(SOLVES):
            shift = shift_at(place)
            if shift is None:
                above = place
                place = math.sqrt(below * above) if below else above / 4
                continue
            moved = float(np.abs(shift).max())
            if abs(moved / wanted - 1) < CLOSE:
                values = values_at(place)
                units = {p.parameter.name: p.parameter.unit for p in priors}
                planted = Planted(one.name, values, units, _significant(moved, 3))
                return planted, values, shift
            if moved < max(HOPELESS * wanted, UNSEEN):
                raise _Unfit(
                    f"another effect: {one.name} moves none of these readings (some "
                    "effects need unloading, a repeat or divided devices)"
                )
            if moved < wanted:
                below = max(below, place)
                if place >= above or above - below < 1e-3 * above:
                    break
            else:
                above = min(above, place)
            known.append((place, moved))
            power = 1.0
            if len(known) > 1:
                (x0, y0), (x1, y1) = known[-2:]
                if x0 != x1 and y0 != y1:
                    power = math.log(y1 / y0) / math.log(x1 / x0)
                power = min(max(power, 0.3), 4.0)
            place = place * (wanted / moved) ** (1 / power)
            if not below < place < above:
                inner = math.sqrt(below * above) if below else above / 4
                place = above if above == 1.0 and moved < wanted else inner
        most = max((y for _, y in known), default=0.0)
        raise _Unfit(f"up to {most:.3g} for {one.name} on these devices")

    # -- measurement ---------------------------------------------------------------

    def _measured(self, schedule: Programme, true: Array) -> Measurements:
        """The file that the bench hands out; what it states is the nominal design."""
        names = tuple(self.plan.noise)
        lengths = np.array([name in LENGTHS for name in names])
        place = schedule.load / schedule.load.max()
        top = int(np.argmax(schedule.load))
        branch = np.where(np.arange(len(place)) <= top, LOADING, UNLOADING)
        curves = []
        for i, (device, stated) in enumerate(self.stated.items()):
            for run in range(schedule.runs):
                values = true[i, run]
                largest = np.abs(values).max(axis=0)
                values = values * np.where(lengths, self.scales[2 * i + run], 1.0)
                for k in range(len(names)):
                    shape = smooth_error(self._errors, place)
                    values[:, k] += self.smooth * largest[k] * shape
                noise = self._errors.standard_normal(values.shape)
                values += self._noise() * noise
                std = np.broadcast_to(self._noise(), values.shape)
                curves.append(
                    Curve(
                        device=device,
                        run=run + 1,
                        orientation=0.0,
                        design=stated,
                        load=schedule.load,
                        time=schedule.time[run],
                        branch=branch,
                        outputs=names,
                        values=self._displayed(values),
                        std=std if self.plan.stated else np.full(std.shape, np.nan),
                    )
                )
        return Measurements(tuple(curves), tolerances=self.plan.tolerances)

    def _displayed(self, values: Array) -> Array:
        """Readings (s, m) to the last digit that an instrument of this noise shows."""
        columns = []
        for k, (name, std) in enumerate(self.plan.noise.items()):
            bench = NUMBERS[name].bench
            digits = -math.floor(math.log10(bench.from_si(std) / 10))
            shown = np.round(bench.from_si(values[:, k]), digits)
            columns.append([bench.to_si(float(x)) for x in shown])
        return np.array(columns).T

    def _truth(self, planted: tuple[Planted, ...]) -> Truth:
        kind = NONE
        if planted:
            kind = UNNAMED if planted[0].effect in PRIVATE else NAMED
        runs = 2 if self.plan.repeat else 1
        return Truth(
            seed=self.plan.seed,
            asked=self.plan.asked(),
            kind=kind,
            planted=planted,
            batches={mix: float(factor) for mix, factor in self.batches.items()},
            devices={name: design.to_dict() for name, design in self.made.items()},
            camera={
                f"{name} {run + 1}": float(self.scales[2 * i + run])
                for i, name in enumerate(self.stated)
                for run in range(runs)
            },
            noise=dict(self.plan.noise),
            smooth=self.smooth,
            level=self.plan.level,
            pressure=tuple(
                float(p) for p in self._programme().load[: self.plan.pressures]
            ),
        )


def _cosine(a: Array, b: Array) -> float:
    """How alike two changes are, 1 where one is a multiple of the other."""
    norm = float(np.linalg.norm(a) * np.linalg.norm(b))
    return abs(float(a @ b)) / norm if norm > 0 else 0.0


def make(plan: Plan, progress: Callable[[str, int], None] | None = None) -> Challenge:
    """Make a set after a plan; see `Maker`."""
    return Maker(plan, progress).run()


def parse_size(text: str) -> float:
    """A size by name, or a number of times the noise.

    Raises
    ------
    InputError
        When it is neither.
    """
    if text in SIZES:
        return SIZES[text]
    try:
        return float(text)
    except ValueError:
        allowed = f"{', '.join(SIZES)}, or a number: times the noise"
        raise InputError("size", text, allowed) from None
