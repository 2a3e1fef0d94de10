"""Learn from pairs of paths what effects change, and calibrate how far that holds.

The target at a load step that both paths of a pair reached is the difference of the
two, less what the equivalent device explains already:

    D = y(theta) - y(off) - [base(design', p') - base(design, p)]

The base's own error stays out of it: it is in both of the base's answers.  How far that
holds is judged by members of base and change that had not seen the design: those that
had are nearer to it than they are to devices in use.  Slopes at off (`slopes`) are
rows, too: a difference over a small step, and that step divided out of both sides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from datagen.dataset import Dataset
from datagen.errors import InputError
from datagen.space import Space

from .accuracy import accuracy
from .calibration import Calibration, calibrate, calibrate_beside
from .corrected import Asked, Corrected, Unseen, ask, evaluate
from .effect_terms import changed, effect_owners
from .ensemble import Ensemble
from .equivalent import Equivalent, same_device
from .expansion import Expansion
from .features import TERMS, features, prepare, term_owners
from .network import FitSettings, Progress, one_thread
from .pairs import Pairs, inputs_of, pair, tuned_names, views_of
from .shift import Shift, fit_shift, no_shift
from .slopes import Tangent, tangent_of
from .split import folds_of, held_out
from .train import SCALE_FLOOR, fit_terms, path_scale

Array = np.ndarray

FEWEST_PAIRS = 8
"""Training pairs that folds and calibration need at the very least."""

SLOPE_STEP = 0.02
"""Step from off in the coordinate of a parameter, over which slopes are rows."""

SHARES = tuple(np.linspace(0, 1, 11).tolist())
"""Of the networks' answers, from which `shrunk` chooses."""

DEVIATIONS = 2.0
"""Standard errors by which the networks must be better than nothing."""

PAIRS_TO_SLOPES = 0.2
"""How much pairs count at least, all together, over slopes: few as they are, they alone
know what is not linear.  As much where a parameter has no slopes."""

CHANGE_RIDGE = 0.03
"""Of the constant weights: pairs are few."""

CHANGE_SETTINGS = FitSettings(
    hidden=(64, 64), steps=4000, batch=256, rate=1e-2, decay=1.0, check_every=100
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
        Error, over the typical size of the change, from which on it counts linearly:
        small, as slopes are large near limit points.
    """

    folds: int = 5
    repeats: int = 4
    fit: FitSettings = CHANGE_SETTINGS
    huber: float = 0.03


SETTINGS = ChangeSettings()


def fit_corrected(
    base: Ensemble,
    dataset: Dataset,
    increment: Dataset,
    seed: int = 0,
    settings: ChangeSettings = SETTINGS,
    equivalent: Equivalent | None = None,
    samples: Array | None = None,
    progress: Progress | None = None,
    slopes: Dataset | None = None,
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
    slopes : Dataset, optional
        Of `slopes.solve_slopes`: what the effects change to first order.

    Raises
    ------
    InputError
        When base, dataset, increment and slopes do not fit, or there are too few pairs.
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
    tangent = None if slopes is None else tangent_of(slopes, dataset, increment.space)
    held = folds_of(pairs.data.base_row, count, repeats, seed)
    every = held if tangent is None else _held_too(held, pairs, tangent, settings, seed)
    unseen = Unseen(
        base.unseen_by(dataset, pairs.data.base_row),
        np.stack([np.flatnonzero(one) for one in held.T], axis=1),
    )
    space = increment.space
    columns, values = inputs_of(pairs.data)
    if equivalent is None:
        equivalent = same_device(values.shape[1])
    shift = _fit_shift(base, pairs, equivalent, held, unseen.base)
    how = (equivalent, shift)
    asked = ask(base, space, how, columns, values, unseen.base)
    with one_thread():
        change, report = _fit_change(
            base, pairs, tangent, how, every, seed, settings, progress
        )
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
            "slopes": "" if slopes is None else slopes.digest(),
            "slope_paths": 0 if tangent is None else len(tangent.base_row),
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


def nested(names: Sequence[str], values: Array) -> dict[str, dict[str, float]]:
    """``{effect: {parameter: value}}``."""
    out: dict[str, dict[str, float]] = {}
    for full, value in zip(names, values, strict=True):
        effect, _, name = full.rpartition(".")
        out.setdefault(effect, {})[name] = float(value)
    return out


def _fit_shift(
    base: Ensemble, pairs: Pairs, equivalent: Equivalent, held: Array, members: Array
) -> Shift:
    """The shift of the limit pressure beyond that of the equivalent device.

    As `members` of the base (r, n) say it that had not seen the designs.
    """
    columns, values = inputs_of(pairs.data)
    plain = prepare(columns, base.space)
    none = no_shift(plain.inputs, values.shape[1], len(held))
    how = (equivalent, none)
    asked = ask(base, pairs.data.space, how, columns, values, members)
    known = np.log(asked.limit.pressure / base.limit(plain, members).pressure)
    return fit_shift(asked.plain.inputs, asked.t, pairs.log_shift - known, held)


@dataclass(frozen=True, eq=False)
class _Block:
    """Rows for the networks, N of d designs, those of a design one after another.

    Parameters
    ----------
    point : (N, f) array
    terms : (N, k) array
    target : (N, m) array
        Both over the scale of the output on its path.
    count : (d,) int array
        Rows of each design.
    """

    point: Array
    terms: Array
    target: Array
    count: Array


def _block(
    base: Ensemble,
    space: Space,
    how: tuple[Equivalent, Shift],
    columns: Mapping[str, Array],
    path: tuple[Array, Array, Array],
    views: Sequence[tuple[Array, Array]],
    over: float = 1.0,
) -> _Block:
    """Rows of some designs: what the equivalent device leaves of differences.

    Parameters
    ----------
    path : (n, s), (n, s, m) and (n, s) arrays
        Pressures, largest magnitudes with effects or without, and which steps count.
    views : sequence of pairs of (n, j) and (n, s, m) arrays
        Parameters, and differences there.
    over : float
        Both sides are divided by it: differences over a small step are slopes.
    """
    pressure, largest, good = path
    points, terms, targets, known = [], [], [], []
    for values, difference in views:
        asked = ask(base, space, how, columns, values)
        own = features(
            asked.prepared, asked.base_pressure(pressure), asked.base_limit.pressure
        )
        points.append(own.point)
        terms.append(changed(own, asked.prepared, asked.t).terms / over)
        targets.append((difference - _explained(base, asked, pressure)) / over)
        known.append(good & np.isfinite(difference).all(axis=2))
    own_terms = features(asked.drawn, pressure, asked.drawn_limit.pressure).terms
    scale = path_scale(largest, own_terms, term_owners(effects=False))
    owner = effect_owners(asked.t.shape[1])
    chosen = np.stack(known, axis=1)  # (n, views, s)
    scales = np.broadcast_to(scale[:, None, None], (*chosen.shape, scale.shape[1]))
    scales = scales[chosen]
    return _Block(
        np.stack(points, axis=1)[chosen],
        np.stack(terms, axis=1)[chosen] / scales[:, owner],
        np.stack(targets, axis=1)[chosen] / scales,
        chosen.sum(axis=(1, 2)),
    )


def _held_too(
    held: Array, pairs: Pairs, tangent: Tangent, settings: ChangeSettings, seed: int
) -> Array:
    """(M, n + d) bool: of the pairs as it is, then of the slopes.

    Those of a design that is paired are held out with its pair.
    """
    assert pairs.data.base_row is not None
    found = folds_of(tangent.base_row, settings.folds, settings.repeats, seed + 1)
    paired = {int(row): i for i, row in enumerate(pairs.data.base_row)}
    for i, row in enumerate(tangent.base_row.tolist()):
        if row in paired:
            found[:, i] = held[:, paired[row]]
    return np.concatenate([held, found], axis=1)


def _fit_change(
    base: Ensemble,
    pairs: Pairs,
    tangent: Tangent | None,
    how: tuple[Equivalent, Shift],
    held: Array,
    seed: int,
    settings: ChangeSettings,
    progress: Progress | None,
) -> tuple[Expansion, dict[str, Any]]:
    """Train the networks on what the shift leaves of the differences."""
    space = pairs.data.space
    columns, values = inputs_of(pairs.data)
    path = (pairs.pressure, pairs.largest, pairs.shared)
    blocks = [_block(base, space, how, columns, path, views_of(pairs))]
    if tangent is not None:
        views = tangent.views(SLOPE_STEP)
        path = (tangent.pressure, tangent.largest, tangent.good)
        blocks.append(
            _block(base, space, how, tangent.columns, path, views, SLOPE_STEP)
        )
    point, terms, target, count = (
        np.concatenate([getattr(block, name) for block in blocks])
        for name in ("point", "terms", "target", "count")
    )
    owner = effect_owners(values.shape[1])
    often = np.ones(len(count), dtype=int)
    if tangent is not None:
        whole = len(tangent.known) == len(tangent.tuned)
        share = PAIRS_TO_SLOPES if whole else 1.0
        often[: len(pairs)] = max(1, round(share * len(tangent.base_row) / len(pairs)))
    weight = np.repeat(often / count, count)
    # In units of the typical change of the output that changes most: all outputs are
    # shares of their path's largest magnitude, and as such what is missed of one that
    # hardly changes matters as little.
    typical = np.sqrt(np.average(target**2, axis=0, weights=weight)).max()
    typical = max(float(typical), 1e-9)
    return fit_terms(
        point,
        terms / typical,
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
        often,
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
    columns, values = inputs_of(pairs.data)
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
