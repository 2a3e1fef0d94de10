"""Learn from pairs of paths what effects change, and calibrate how far that holds.

The target at a load step that both paths of a pair reached is the difference of the
two, less what the equivalent device explains already:

    D = y(theta) - y(off) - [base(design', p') - base(design, p)]

The base's own error stays out of it: it is in both of the base's answers.  How far that
holds is judged by members of base and change that had not seen the design: those that
had are nearer to it than they are to devices in use.  Derivatives
by the parameters bring more rows of each path at no cost: half way to off along the
parabola through the known ends and the slope there, and a little to each side along
each parameter where there are several.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from datagen.dataset import Dataset
from datagen.errors import InputError

from .accuracy import accuracy
from .calibration import Calibration, calibrate, calibrate_beside
from .corrected import Asked, Corrected, Unseen, ask, evaluate
from .effect_terms import changed, effect_owners
from .ensemble import Ensemble
from .equivalent import Equivalent, same_device
from .expansion import Expansion
from .features import TERMS, columns_of, features, prepare, term_owners
from .network import FitSettings, Progress, one_thread
from .shift import Shift, fit_shift, no_shift
from .split import folds_of, held_out
from .train import SCALE_FLOOR, fit_terms, path_scale

Array = np.ndarray

FEWEST_PAIRS = 8
"""Training pairs that folds and calibration need at the very least."""

ASIDE = 0.1
"""Step along one parameter, of its range, over which a slope is trusted alone."""

SHARES = tuple(np.linspace(0, 1, 11).tolist())
"""Of the networks' answers, from which `shrunk` chooses."""

DEVIATIONS = 2.0
"""Standard errors by which the networks must be better than nothing."""

CHANGE_RIDGE = 0.3
"""Of the constant weights: pairs are few."""

CHANGE_SETTINGS = FitSettings(
    hidden=(24,), steps=1500, batch=256, rate=2e-3, decay=10.0, check_every=50
)


@dataclass(frozen=True)
class ChangeSettings:
    """How the change is learned.

    Parameters
    ----------
    folds, repeats : int
        As in `TrainSettings`.
    fit : FitSettings
    huber : float
        Error, over the typical size of the change, from which on it counts linearly.
    """

    folds: int = 5
    repeats: int = 4
    fit: FitSettings = CHANGE_SETTINGS
    huber: float = 0.3


SETTINGS = ChangeSettings()


@dataclass(frozen=True, eq=False)
class Pairs:
    """Paths with effects beside those of their bases, n designs, s load steps.

    Parameters
    ----------
    data : Dataset
        With the effects.
    before : (n, s, m) array, SI
        The base's path at the same pressures; 0 where `shared` is not.
    shared : (n, s) bool array
        Steps that both paths reached.
    base_limit : (n,) array, Pa
        Limit pressure of the base's path; NaN where it was not met.
    """

    data: Dataset
    before: Array
    shared: Array
    base_limit: Array

    def __len__(self) -> int:
        return len(self.data)

    def subset(self, rows: Array) -> Pairs:
        """Those designs alone."""
        return Pairs(
            self.data.subset(rows),
            self.before[rows],
            self.shared[rows],
            self.base_limit[rows],
        )

    @property
    def pressure(self) -> Array:
        """(n, s) Pa; 0 where a step is not shared."""
        own: Array = np.where(self.shared, self.data.pressure, 0.0)
        return own

    @property
    def difference(self) -> Array:
        """(n, s, m) SI; 0 where a step is not shared."""
        found: Array = np.where(
            self.shared[..., None], self.data.values - self.before, 0.0
        )
        return found

    @property
    def log_shift(self) -> Array:
        """(n,) logarithm of limit pressure over the base's; NaN where one is not."""
        found: Array = np.log(self.data.limit_pressure / self.base_limit)
        return found


def pair(base: Dataset, increment: Dataset) -> Pairs:
    """Put each path of an increment beside its base's.

    Raises
    ------
    InputError
        When the increment is paired with another dataset, or a design is not the one
        of its base.
    """
    if increment.base_row is None or increment.base != base.digest():
        raise InputError("increment", increment.base[:12], "one made from this dataset")
    if increment.outputs != base.outputs:
        raise InputError(
            "outputs", ", ".join(increment.outputs), ", ".join(base.outputs)
        )
    rows = increment.base_row
    width = len(base.variables)
    if not np.array_equal(increment.inputs[:, :width], base.inputs[rows]):
        raise InputError("increment", "designs", "those of the base's rows")
    before = np.zeros_like(increment.values)
    shared = np.zeros(increment.status.shape, dtype=bool)
    for i, row in enumerate(rows):
        steps = base.steps(int(row))
        if not np.array_equal(
            increment.pressure[i, :steps], base.pressure[row, :steps]
        ):
            raise InputError("increment", f"row {i}", "the load steps of its base")
        before[i, :steps] = base.values[row, :steps]
        shared[i, :steps] = increment.status[i, :steps] == 0
    return Pairs(increment, before, shared, base.limit_pressure[rows])


def fit_corrected(
    base: Ensemble,
    dataset: Dataset,
    increment: Dataset,
    seed: int = 0,
    settings: ChangeSettings = SETTINGS,
    equivalent: Equivalent | None = None,
    samples: Array | None = None,
    progress: Progress | None = None,
) -> Corrected:
    """The base with what the increment teaches; designs held out stay unseen.

    Parameters
    ----------
    base : Ensemble
        Without effects.
    dataset : Dataset
        That the increment is paired with.
    increment : Dataset
    seed : int
        The same seed gives the same model on the same machine.
    settings : ChangeSettings
    equivalent : Equivalent, optional
        Of `fit_equivalent`; by default the effects leave the device what it is.
    samples : (m, j) array, SI, optional
        Equally likely parameters; the middle of their ranges by default.
    progress : callable, optional
        As in `train`.

    Raises
    ------
    InputError
        When base, dataset and increment do not fit, or there are too few pairs.
    """
    if base.effects:
        raise InputError("base", ", ".join(base.effects), "a model without effects")
    if base.outputs != tuple(TERMS) or increment.outputs != base.outputs:
        raise InputError("outputs", ", ".join(increment.outputs), ", ".join(TERMS))
    pairs = pair(dataset, increment)
    rows = np.flatnonzero(pairs.shared.any(axis=1) & ~held_out(increment))
    if len(rows) < FEWEST_PAIRS:
        raise InputError(
            "increment",
            f"{len(rows)} pairs of paths to train on",
            f"at least {FEWEST_PAIRS}, test designs aside",
        )
    pairs = pairs.subset(rows)
    assert pairs.data.base_row is not None  # `pair` refuses an increment without
    count, repeats = settings.folds, settings.repeats
    held = folds_of(pairs.data.base_row, count, repeats, seed)
    unseen = Unseen(
        base.unseen_by(dataset, pairs.data.base_row),
        np.stack([np.flatnonzero(one) for one in held.T], axis=1),
    )
    space = increment.space
    columns, values = _inputs(pairs.data)
    if equivalent is None:
        equivalent = same_device(values.shape[1])
    shift = _fit_shift(base, pairs, equivalent, held, unseen.base)
    how = (equivalent, shift)
    asked = ask(base, space, how, columns, values, unseen.base)
    with one_thread():
        change, report = _fit_change(base, pairs, how, held, seed, settings, progress)
    change, shares = shrunk(base, pairs, asked, change, unseen)
    calibration = _calibrate(base, pairs, asked, change, unseen)
    tuned = [p for p in space if "." in p.name]
    if samples is None:
        samples = np.array([[(p.lower + p.upper) / 2 for p in tuned]])
    samples = np.asarray(samples, dtype=float)
    model = Corrected(
        base=base,
        space=space,
        effects=increment.effects,
        equivalent=equivalent,
        shift=shift,
        change=change,
        calibration=calibration,
        description={
            "base": base.version,
            "dataset": dataset.digest(),
            "increment": increment.digest(),
            "generator_version": increment.generator_version,
            "level": increment.level,
            "increment_seed": increment.seed,
            "paths": len(increment),
            "n_train": len(pairs),
            "train_steps": int(pairs.shared.sum()),
            "limit_pairs": int(np.isfinite(pairs.log_shift).sum()),
            "limit_shift_noise": shift.noise,
            "seed": seed,
            "settings": asdict(settings),
            "change_fit": report | {"shares": shares.tolist()},
        },
        samples=samples,
        parameters=nested(tuned_names(space), samples.mean(axis=0)),
    )
    return with_accuracy(model, dataset, increment)


def tuned_names(space: Any) -> tuple[str, ...]:
    """Names of the parameters of effects in a space."""
    return tuple(p.name for p in space if "." in p.name)


def nested(names: Sequence[str], values: Array) -> dict[str, dict[str, float]]:
    """``{effect: {parameter: value}}``."""
    out: dict[str, dict[str, float]] = {}
    for full, value in zip(names, values, strict=True):
        effect, _, name = full.rpartition(".")
        out.setdefault(effect, {})[name] = float(value)
    return out


def _inputs(data: Dataset) -> tuple[dict[str, Array], Array]:
    """Columns of the design's variables, and (n, j) values of the parameters."""
    width = len(data.variables) - len(tuned_names(data.space))
    columns = columns_of(data.variables[:width], data.inputs[:, :width])
    return columns, data.inputs[:, width:]


def _fit_shift(
    base: Ensemble, pairs: Pairs, equivalent: Equivalent, held: Array, members: Array
) -> Shift:
    """The shift of the limit pressure beyond that of the equivalent device.

    As `members` of the base (r, n) say it that had not seen the designs.
    """
    columns, values = _inputs(pairs.data)
    plain = prepare(columns, base.space)
    none = no_shift(plain.inputs, values.shape[1], len(held))
    how = (equivalent, none)
    asked = ask(base, pairs.data.space, how, columns, values, members)
    known = np.log(asked.limit.pressure / base.limit(plain, members).pressure)
    return fit_shift(asked.plain.inputs, asked.t, pairs.log_shift - known, held)


def views_of(pairs: Pairs) -> list[tuple[Array, Array]]:
    """Parameters (n, j) and differences (n, s, m) there: of the paths, and near them.

    The first is what was solved.  With d its difference and d' its slope towards the
    parameters from off, the parabola through 0, d and d' gives 3/4 d - 1/4 d' half way.
    """
    data, difference = pairs.data, pairs.difference
    _, values = _inputs(data)
    found = [(values, difference)]
    slopes = data.jacobian
    names = tuned_names(data.space)
    if slopes is None or data.parameters != names:
        return found
    # At a limit point there are no slopes, and no views but what was solved.
    slopes = np.where(np.isfinite(slopes), slopes, np.nan)
    tuned = [data.space[name] for name in names]
    off = np.array([0.0 if p.off is None else p.off for p in tuned])
    along = np.einsum("nsmj,nj->nsm", slopes, values - off)
    found.append(((values + off) / 2, 0.75 * difference - 0.25 * along))
    if len(names) == 1:
        return found
    for j, p in enumerate(tuned):
        step = np.where(values[:, j] > (p.lower + p.upper) / 2, -ASIDE, ASIDE) * (
            p.upper - p.lower
        )
        moved = values.copy()
        moved[:, j] += step
        found.append((moved, difference + slopes[..., j] * step[:, None, None]))
    return found


def _fit_change(
    base: Ensemble,
    pairs: Pairs,
    how: tuple[Equivalent, Shift],
    held: Array,
    seed: int,
    settings: ChangeSettings,
    progress: Progress | None,
) -> tuple[Expansion, dict[str, Any]]:
    """Train the networks on what the shift leaves of the differences."""
    columns, _ = _inputs(pairs.data)
    pressure = pairs.pressure
    points, terms, targets, known = [], [], [], []
    for values, difference in views_of(pairs):
        asked = ask(base, pairs.data.space, how, columns, values)
        own = features(
            asked.prepared, asked.base_pressure(pressure), asked.base_limit.pressure
        )
        points.append(own.point)
        terms.append(changed(own, asked.prepared, asked.t).terms)
        targets.append(difference - _explained(base, asked, pressure))
        known.append(pairs.shared & np.isfinite(difference).all(axis=2))
    own_terms = features(asked.drawn, pressure, asked.drawn_limit.pressure).terms
    scale = path_scale(pairs.before, own_terms, term_owners(effects=False))
    owner = effect_owners(asked.t.shape[1])
    chosen = np.stack(known, axis=1)  # (n, views, s)
    scales = np.broadcast_to(scale[:, None, None], (*chosen.shape, scale.shape[1]))
    scales = scales[chosen]
    target = np.stack(targets, axis=1)[chosen] / scales
    count = chosen.sum(axis=(1, 2))
    weight = 1 / np.repeat(count, count)
    # In units of the typical change of each output: small ones count as large ones do.
    typical = np.sqrt(np.average(target**2, axis=0, weights=weight))
    typical = np.maximum(typical, 1e-9)
    rows = np.stack(terms, axis=1)[chosen] / (scales * typical)[:, owner]
    return fit_terms(
        np.stack(points, axis=1)[chosen],
        rows,
        target / typical,
        count,
        (owner, np.zeros(len(owner), dtype=bool)),
        held,
        seed + 2,
        settings.fit,
        settings.huber,
        "change",
        progress,
        CHANGE_RIDGE,
    )


def _explained(base: Ensemble, asked: Asked, pressure: Array) -> Array:
    """(n, s, m) What the equivalent devices change, SI."""
    there = base.answers(asked.plain, asked.base_pressure(pressure), asked.base_limit)
    here = base.answers(asked.drawn, pressure, asked.drawn_limit)
    moved: Array = there.mean - here.mean
    return moved


def shrunk(
    base: Ensemble, pairs: Pairs, asked: Asked, change: Expansion, unseen: Unseen
) -> tuple[Expansion, Array]:
    """The networks times the share of each output that helps pairs not seen.

    With few pairs what they say of an output can be worse than nothing.  Errors are
    those of the members that had not seen a pair; the share is the best of `SHARES`,
    or 0 where that is not clearly better than nothing.

    Returns
    -------
    Expansion, and the (m,) shares.
    """
    found = evaluate(base, change, asked, pairs.pressure, unseen)
    wanted = pairs.difference - found.explained
    scale = _typical(pairs, found.base.spread.size)
    chosen = []
    for o in range(wanted.shape[2]):
        costs = np.array(
            [
                _path_errors(
                    share * found.more.mean[..., o] - wanted[..., o], pairs, scale[:, o]
                )
                for share in SHARES
            ]
        )
        best = int(costs.mean(axis=1).argmin())
        gain = costs[0] - costs[best]  # over nothing
        doubt = gain.std(ddof=1) / np.sqrt(len(pairs))
        chosen.append(SHARES[best] if gain.mean() > DEVIATIONS * doubt else 0.0)
    shares = np.array(chosen)
    factor = shares[change.owner]
    return replace(change, base=change.base * factor, unit=change.unit * factor), shares


def _path_errors(error: Array, pairs: Pairs, scale: Array) -> Array:
    """(n,) root of each path's mean error over its scale.

    The root, as one path that goes wrong must not decide for all.
    """
    over = np.where(pairs.shared, np.abs(error) / scale[:, None], 0.0)
    found: Array = np.sqrt(over.sum(axis=1) / np.maximum(pairs.shared.sum(axis=1), 1))
    return found


def _typical(pairs: Pairs, size: Array) -> Array:
    """(n, m) SI.  Largest magnitude of each output along each path, with a floor."""
    found = np.abs(pairs.before).max(axis=1)
    floor = np.where(pairs.shared[..., None], size, 0.0).max(axis=1)
    scale: Array = np.maximum(found, SCALE_FLOOR * floor)
    return scale


def _calibrate(
    base: Ensemble, pairs: Pairs, asked: Asked, change: Expansion, unseen: Unseen
) -> Calibration:
    """Calibration of the change on each pair by the members that had not seen it.

    Its scale follows the errors of the change, its quantiles what the base's intervals
    leave open of those of the whole answer.  A member of the base and a network answer
    together, so that what averages out over both kinds is known.
    """
    found = evaluate(base, change, asked, pairs.pressure, unseen)
    good = pairs.shared
    both = min(len(found.moved), len(found.more.values))
    more, design = found.more.values[:both], np.nonzero(good)[0]
    errors = (more + found.moved[:both] - pairs.difference)[:, good]
    members = min(base.expansion.stack.members, change.stack.members)
    own = calibrate(errors, found.spread[good], design, members)
    whole = (more + found.base.values[:both] - pairs.data.values)[:, good]
    return calibrate_beside(
        (base.calibration, found.base.spread[good]),
        (own, found.spread[good]),
        whole,
        design,
        members,
    )


def change_errors(model: Corrected, pairs: Pairs) -> dict[str, dict[str, float]]:
    """Errors of the change alone, in percent of each path's largest magnitude.

    What the increment teaches, without what the base gets wrong already.

    Returns
    -------
    dict
        By output: median and 95th percentile, every design with the same weight, and
        ``size_pct``, the median size of the change itself.
    """
    columns, values = _inputs(pairs.data)
    how = (model.equivalent, model.shift)
    asked = ask(model.base, model.space, how, columns, values)
    answer = evaluate(model.base, model.change, asked, pairs.pressure)
    predicted = answer.more.mean + answer.explained
    largest = np.where(pairs.shared[..., None], np.abs(pairs.data.values), 0.0)
    largest = np.maximum(largest.max(axis=1), np.finfo(float).tiny)
    good = pairs.shared
    share = np.repeat(1 / good.sum(axis=1), good.sum(axis=1))
    found = {}
    for o, name in enumerate(pairs.data.outputs):
        over = 100 / largest[:, None, o]
        error = (np.abs(predicted - pairs.difference)[..., o] * over)[good]
        size = (np.abs(pairs.difference)[..., o] * over)[good]
        found[name] = {
            "median_pct": _weighted(error, share, 0.5),
            "p95_pct": _weighted(error, share, 0.95),
            "size_pct": _weighted(size, share, 0.5),
        }
    return found


def _weighted(values: Array, weight: Array, level: float) -> float:
    order = np.argsort(values)
    share = np.cumsum(weight[order]) / weight.sum()
    place = min(int(np.searchsorted(share, level)), len(values) - 1)
    return float(values[order][place])


def with_accuracy(model: Corrected, dataset: Dataset, increment: Dataset) -> Corrected:
    """The model with its accuracy on held-out designs in its description."""
    pairs = pair(dataset, increment)
    rows = np.flatnonzero(held_out(increment) & pairs.shared.any(axis=1))
    if not len(rows):
        return model
    measured = {
        "accuracy": accuracy(model, increment).to_json(),
        "change": change_errors(model, pairs.subset(rows)),
    }
    return replace(model, description=model.description | measured)
