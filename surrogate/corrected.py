"""The surrogate with adopted effects in it: the base as it is, and what they change.

    y(design, p, theta) = base(design', p') + sum_j t_j sum_k B_k c_jk(features, theta),
    p' = (gain p + offset)/S(theta),    t_j = 0 at off

The base ensemble is untouched.  design', gain and offset are the equivalent device
without effects (`equivalent`), S is what the limit pressure shifts beyond it (`shift`),
B_k are the terms of `features`, and c_jk answers of an ensemble of small networks,
learned from pairs of paths with the effects and without (`change`).  At off every t_j
is exactly 0, so the corrected surrogate answers what its base does, bit for bit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from datagen.device import Design
from datagen.errors import InputError
from datagen.response import Path as LoadPath
from datagen.response import Response
from datagen.space import Parameter, Space

from .calibration import ONE_SIGMA, Calibration, Spread
from .domain import RangeCheck
from .effect_terms import changed
from .ensemble import (
    CHUNK,
    Ensemble,
    Prediction,
    answered,
    design_columns,
    stacked,
)
from .equivalent import Equivalent
from .expansion import Answers, Expansion
from .features import Features, Prepared, features, prepare
from .limit import Limit
from .shift import Shift, coordinates

Array = np.ndarray


LEAST_LIMIT = 1e-3
"""Of the equivalent device's: where a limit pressure with effects is held."""


@dataclass(frozen=True, eq=False)
class Asked:
    """Designs with their parameters, and what the base says of their limits.

    Parameters
    ----------
    columns : mapping of (n,) arrays, SI
        The variables of the space, as asked.
    drawn : Prepared
        The n designs for the base.
    plain, prepared : Prepared
        Their equivalent devices for the base, and for the networks of the change.
    t : (n, j) array
        Coordinates of the parameters.
    gain, offset : (n, 1) arrays, 1 and Pa
        From gauge pressure to the pressure at which the base is asked.
    drawn_limit : Limit
        Of the designs, without effects.
    base_limit : Limit
        Of the equivalent devices, at the base's pressures.
    limit : Limit
        With the effects, in gauge pressure.
    """

    columns: Mapping[str, Array]
    drawn: Prepared
    plain: Prepared
    prepared: Prepared
    t: Array
    gain: Array
    offset: Array
    drawn_limit: Limit
    base_limit: Limit
    limit: Limit

    def __len__(self) -> int:
        return len(self.t)

    def base_pressure(self, pressure: Array) -> Array:
        """(n, s) Pa at which the base is asked for gauge pressures (n, s), Pa."""
        moved: Array = pressure * self.gain + self.offset
        return moved

    def inputs(self, pressure: Array, some: slice) -> Features:
        """Inputs and terms of the change for some designs at the base's pressures."""
        prepared = self.prepared[some]
        own = features(prepared, pressure, self.base_limit.pressure[some])
        return changed(own, prepared, self.t[some])


@dataclass(frozen=True, eq=False)
class Corrected:
    """A forward model as fast as its base, with effects in it.

    Parameters
    ----------
    base : Ensemble
        Without effects.
    space : Space
        The base's variables, then ``effect.parameter`` over the stated ranges.
    effects : tuple of str
    equivalent : Equivalent
        What the effects make of a device, as far as that is another device.
    shift : Shift
        Of the limit pressure beyond that.
    change : Expansion
        Networks for what is left.
    calibration : Calibration
        Of the change, beside the base's own.
    description : dict
        Where the model comes from: base, increment, sizes, seeds, accuracy.
    samples : (m, j) array, SI
        Equally likely values of the parameters, in the order of `space`: what the
        measurements left open.  `marginal` averages over them.
    parameters : mapping
        ``{effect: {parameter: value}}``, SI; at its off value where not given.
    """

    base: Ensemble
    space: Space
    effects: tuple[str, ...]
    equivalent: Equivalent
    shift: Shift
    change: Expansion
    calibration: Calibration
    description: dict[str, Any]
    samples: Array
    parameters: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = [p.name for p in self.tuned]
        for effect, values in self.parameters.items():
            for name, value in values.items():
                if f"{effect}.{name}" not in known:
                    allowed = ", ".join(known)
                    raise InputError("parameters", f"{effect}.{name}", allowed)
                if not np.isfinite(value):
                    raise InputError(f"{effect}.{name}", value, "a finite number")
        object.__setattr__(self, "samples", self._checked(self.samples))

    def _checked(self, samples: Array) -> Array:
        samples = np.asarray(samples, dtype=float)
        width = len(self.tuned)
        if samples.ndim != 2 or samples.shape[1] != width or not len(samples):
            allowed = f"shape (m, {width}): " + ", ".join(p.name for p in self.tuned)
            raise InputError("samples", samples.shape, allowed)
        if not np.isfinite(samples).all():
            raise InputError("samples", "not finite", "finite numbers")
        return samples

    @property
    def outputs(self) -> tuple[str, ...]:
        return self.base.outputs

    @cached_property
    def tuned(self) -> tuple[Parameter, ...]:
        """The parameters of the effects, over their stated ranges."""
        return tuple(p for p in self.space if "." in p.name)

    @property
    def knows_limits(self) -> bool:
        """Whether limit pressures are learned."""
        return self.base.knows_limits

    @cached_property
    def version(self) -> str:
        """Twelve hexadecimal digits of what the model is made of."""
        from .corrected_store import content_digest

        return content_digest(self)[:12]

    def with_parameters(
        self, parameters: Mapping[str, Mapping[str, float]]
    ) -> Corrected:
        """The same model with its effects' parameters at other values, SI."""
        other = replace(self, parameters=parameters)
        # The version does not depend on them, and costs more than a prediction.
        other.__dict__["version"] = self.version
        return other

    def __call__(
        self, designs: Sequence[Design], paths: Sequence[LoadPath]
    ) -> Response:
        """Predict each design along its own path; std is one calibrated deviation."""
        return self.predict(designs, paths, ONE_SIGMA).response

    def predict(
        self,
        designs: Sequence[Design],
        paths: Sequence[LoadPath],
        coverage: float = 0.9,
    ) -> Prediction:
        """Predict at `parameters` with intervals of the given coverage.

        The half width is the root of the sum of squares of the base's and that of the
        change: the one was calibrated on paths without effects, the other on what that
        leaves open of the errors with them.

        Raises
        ------
        InputError
            When the coverage is beyond what either calibration supports.
        """
        pressure = stacked(designs, paths)
        asked = self.asked(designs, self._values(len(designs)))
        values, half, sigma = self._evaluate(asked, pressure, coverage)
        response = self._response(pressure, values, sigma, asked.limit)
        return Prediction(response, values - half, values + half, coverage)

    def marginal(
        self,
        designs: Sequence[Design],
        paths: Sequence[LoadPath],
        samples: Array | None = None,
        coverage: float = 0.9,
    ) -> Prediction:
        """Average over equally likely values of the parameters.

        The ends of the interval are the surrogate's own (mean over the samples) joined
        in squares with the way from the mean to the samples' quantiles; `std` adds the
        two variances.

        Parameters
        ----------
        designs, paths : sequences of equal length n
        samples : (m, j) array, SI, optional
            In the order of `tuned`; the model's own by default.
        coverage : float

        Returns
        -------
        Prediction
            The limit pressure is the geometric mean over the samples.
        """
        samples = self.samples if samples is None else self._checked(samples)
        pressure = stacked(designs, paths)
        n, m = len(designs), len(samples)
        asked = self.asked(
            [design for design in designs for _ in range(m)], np.tile(samples, (n, 1))
        )
        found = self._evaluate(asked, np.repeat(pressure, m, axis=0), coverage)
        values, half, sigma = (a.reshape(n, m, *a.shape[1:]) for a in found)
        mean = values.mean(axis=1)
        ends = [(1 - coverage) / 2, (1 + coverage) / 2]
        low, high = np.quantile(values, ends, axis=1)
        own = half.mean(axis=1)
        std = np.sqrt((sigma**2).mean(axis=1) + values.var(axis=1))
        logs = np.log(asked.limit.pressure).reshape(n, m)
        noise = np.sqrt((asked.limit.std.reshape(n, m) ** 2).mean(axis=1))
        limit = Limit(np.exp(logs.mean(axis=1)), np.sqrt(noise**2 + logs.var(axis=1)))
        return Prediction(
            self._response(pressure, mean, std, limit),
            mean - np.hypot(own, np.maximum(mean - low, 0.0)),
            mean + np.hypot(own, np.maximum(high - mean, 0.0)),
            coverage,
        )

    def check(self, design: Design, pressure: Array) -> RangeCheck:
        """Whether base and change were trained for this.

        Parameters
        ----------
        design : Design
        pressure : (s,) array, Pa
        """
        pressure = LoadPath(pressure).pressure
        asked = self.asked([design], self._values(1))
        domain = replace(self.base.domain, space=self.space)
        found = domain.check(asked.columns, pressure, asked.limit)
        found = self._check_equivalent(found, asked)
        own = asked.base_pressure(pressure[None])
        answers = self.base.answers(asked.plain, own, asked.base_limit)
        return replace(found, notes=self.base.notes(answers, pressure))

    def _check_equivalent(self, found: RangeCheck, asked: Asked) -> RangeCheck:
        """Refuse a device that the base is not asked for at off."""
        domain = self.base.domain
        distance = domain.distance(asked.plain.columns)
        far = distance > domain.allowed_distance
        if not far or domain.distance(asked.columns) > domain.allowed_distance:
            return found
        reason = (
            "the effects make of it a device far from the training designs: distance "
            f"{distance:.2f} in dimensionless groups, {domain.allowed_distance:.2f} is "
            "allowed"
        )
        steps = np.zeros_like(found.per_step)
        return replace(
            found, in_range=False, reasons=(*found.reasons, reason), per_step=steps
        )

    def limit_pressure(self, designs: Sequence[Design]) -> Limit:
        """Predicted limit pressure of each design with the effects in it."""
        return self.asked(designs, self._values(len(designs))).limit

    def save(self, folder: str | Path) -> None:
        """Write the model and its base into a folder."""
        from .corrected_store import write

        write(self, Path(folder))

    @classmethod
    def load(cls, folder: str | Path) -> Corrected:
        """Read a saved model.

        Raises
        ------
        FileError
            When a file is missing, damaged, of another version, or they do not belong
            together.
        """
        from .corrected_store import read

        return read(Path(folder))

    def _values(self, n: int) -> Array:
        """(n, j) values of the parameters, the same for n designs."""
        row = []
        for p in self.tuned:
            effect, _, name = p.name.rpartition(".")
            row.append(self.parameters.get(effect, {}).get(name, p.off))
        return np.tile(np.array(row, dtype=float), (n, 1))

    def asked(self, designs: Sequence[Design], values: Array) -> Asked:
        """Designs made ready, each with its row of parameters (n, j), SI."""
        columns = design_columns(designs)
        how = (self.equivalent, self.shift)
        return ask(self.base, self.space, how, columns, values)

    def _evaluate(
        self, asked: Asked, pressure: Array, coverage: float
    ) -> tuple[Array, Array, Array]:
        """Values, half width of the interval and one deviation: (n, s, m), SI."""
        quantiles = [
            [own.quantile(c) for c in (coverage, ONE_SIGMA)]
            for own in (self.base.calibration, self.calibration)
        ]
        found = evaluate(self.base, self.change, asked, pressure)
        scales = (
            self.base.calibration.scale(found.base.spread),
            self.calibration.scale(found.spread),
        )
        half, sigma = (
            np.hypot(quantiles[0][i] * scales[0], quantiles[1][i] * scales[1])
            for i in range(2)
        )
        return found.base.mean + found.more.mean, half, sigma

    def _response(
        self, pressure: Array, values: Array, sigma: Array, limit: Limit
    ) -> Response:
        info = {
            "source": "surrogate",
            "version": self.version,
            "effects": list(self.effects),
        }
        return answered(self.outputs, pressure, values, sigma, limit, info)


def ask(
    base: Ensemble,
    space: Space,
    how: tuple[Equivalent, Shift],
    columns: Mapping[str, Array],
    values: Array,
    members: Array | None = None,
) -> Asked:
    """Designs and parameters made ready.

    Parameters
    ----------
    base : Ensemble
    space : Space
        With the stated ranges of the parameters.
    how : Equivalent and Shift
    columns : mapping of (n,) arrays, SI
        The variables of the design space.
    values : (n, j) array, SI
        Of the parameters, in the order of `space`.
    members : (r, n) int array, optional
        Of the base, asked about each design's limit; all where it is not given.
    """
    tuned = tuple(p for p in space if "." in p.name)
    equivalent, shift = how
    t = coordinates(values, tuned)
    device, gain, offset = equivalent(columns, t)
    drawn, plain = prepare(columns, base.space), prepare(device, base.space)
    with_values = {p.name: values[:, j] for j, p in enumerate(tuned)}
    limit = base.limit(plain, members)
    log_shift, std = shift(plain.inputs, t)
    factor = np.exp(log_shift)
    gain, offset = gain / factor, offset / factor
    # A load that is there already may have passed the limit before any pressure.
    gauge = np.maximum((limit.pressure - offset) / gain, LEAST_LIMIT * limit.pressure)
    return Asked(
        columns={**columns, **with_values},
        drawn=drawn,
        plain=plain,
        prepared=prepare({**device, **with_values}, space),
        t=t,
        gain=gain[:, None],
        offset=offset[:, None],
        drawn_limit=base.limit(drawn, members),
        base_limit=limit,
        limit=Limit(gauge, np.hypot(limit.std, std)),
    )


@dataclass(frozen=True, eq=False)
class Unseen:
    """Members that had not seen each of n designs, and so err as they do in use.

    Parameters
    ----------
    base : (b, n) int array
        Of the base.
    change : (r, n) int array
        Networks of the change.
    """

    base: Array
    change: Array


@dataclass(frozen=True, eq=False)
class Found:
    """What base and networks say about n designs at s load steps.

    Parameters
    ----------
    base : Answers
        Of the base about the equivalent devices.
    more : Answers
        Of the networks: what the effects add to that.
    moved : (b, n, s, m) array, SI
        What the equivalent devices do less what the designs do without effects, by
        each member of the base.
    explained : (n, s, m) array, SI
        Its mean.
    spread : Spread of (n, s, m) arrays
        Of the whole change; exactly 0 at off.
    """

    base: Answers
    more: Answers
    moved: Array
    explained: Array
    spread: Spread


def evaluate(
    base: Ensemble,
    change: Expansion,
    asked: Asked,
    pressure: Array,
    unseen: Unseen | None = None,
) -> Found:
    """Ask base and networks at (n, s) gauge pressures, Pa.

    The spread of the change is that of both: the base's members disagree on what
    another device does otherwise, the networks on the rest.  Its size is that of the
    base's terms, times how far the parameters are from off.

    Parameters
    ----------
    unseen : Unseen, optional
        Members asked about each design; all of them where it is not given.
    """
    by_base, by_change = (
        (None, None) if unseen is None else (unseen.base, unseen.change)
    )
    own = asked.base_pressure(pressure)
    there = base.answers(asked.plain, own, asked.base_limit, by_base)
    here = base.answers(asked.drawn, pressure, asked.drawn_limit, by_base)
    more = _change_answers(change, asked, own, by_change)
    moved = there.values - here.values
    far = np.sqrt((asked.t**2).sum(axis=1))[:, None, None]
    return Found(
        base=there,
        more=more,
        moved=moved,
        explained=there.mean - here.mean,
        spread=Spread(
            np.hypot(moved.std(axis=0, ddof=1), more.spread.disagreement),
            np.hypot(far * there.spread.size, more.spread.size),
            there.spread.nearness,
        ),
    )


def _change_answers(
    change: Expansion, asked: Asked, pressure: Array, members: Array | None
) -> Answers:
    """What the effects add at (n, s) pressures of the base, Pa."""
    nearness = np.abs(pressure) / asked.base_limit.pressure[:, None]
    some = max(1, CHUNK // pressure.shape[1])
    parts = []
    for begin in range(0, len(asked), some):
        own = slice(begin, begin + some)
        inputs = asked.inputs(pressure[own], own)
        who = None if members is None else members[:, own]
        parts.append(change(inputs, nearness[own], who))
    return Answers.joined(parts)
