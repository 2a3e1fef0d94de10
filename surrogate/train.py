"""Train an ensemble on a dataset and calibrate its intervals."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from datagen.dataset import Dataset
from datagen.effects import catalogue
from datagen.errors import InputError
from datagen.worker import PROPER_ENDS

from .accuracy import accuracy
from .calibration import Calibration, Spread, calibrate
from .domain import Domain
from .ensemble import Ensemble
from .expansion import LARGEST_LOG, Expansion
from .features import (
    TERMS,
    TURNED_OVER,
    Prepared,
    columns_of,
    features,
    positive_terms,
    prepare,
    term_owners,
    turned_over,
)
from .increment import fem_fits
from .limit import SETTINGS as LIMIT_SETTINGS
from .limit import fit_limit
from .neighbours import Neighbours, neighbours
from .network import FitSettings, Progress, Rows, fit, one_thread
from .split import folds, training_rows, usable
from .split import held_out as is_held_out

if TYPE_CHECKING:
    import torch

Array = np.ndarray

FEWEST_DESIGNS = 20
"""Training designs that folds, calibration and distances need at the very least."""

SCALE_FLOOR = 0.02
"""Least scale of an error, as a share of the largest term along the path.

Errors are measured against each path's maximum; where large terms cancel along the
whole path that maximum is so small that it would drown every other path.
"""

RIDGE = 1e-3
"""Of the constant weights: enough against terms that say the same."""

RESPONSE_SETTINGS = FitSettings(steps=4000, decay=0.1)

CHUNK = 64
"""Designs evaluated at a time, to bound memory."""


@dataclass(frozen=True)
class TrainSettings:
    """How an ensemble is trained.

    Parameters
    ----------
    folds : int
        Parts of the training designs; a member does not see one of them.
    repeats : int
        Different partitions; the ensemble has folds times repeats members.
    response, limit : FitSettings
        Of the networks for the outputs and for the limit pressure.
    huber : float
        Error, as a share of the path's maximum, from which on it counts linearly.
    """

    folds: int = 5
    repeats: int = 4
    response: FitSettings = RESPONSE_SETTINGS
    limit: FitSettings = LIMIT_SETTINGS
    huber: float = 0.02


def train(
    dataset: Dataset,
    seed: int = 0,
    settings: TrainSettings = TrainSettings(),
    progress: Progress | None = None,
) -> Ensemble:
    """Train on the designs that are not held out for testing; converged steps only.

    Parameters
    ----------
    dataset : Dataset
    seed : int
        The same seed gives the same ensemble on the same machine.
    settings : TrainSettings
    progress : callable, optional
        Called as progress(stage, step, steps, held-out loss).  What it raises stops
        the training; nothing is written before the ensemble is saved.

    Raises
    ------
    InputError
        When the dataset has too few designs, other outputs than `TERMS`, or effects
        of time or history.
    """
    rows = training_rows(dataset)
    if len(rows) < FEWEST_DESIGNS:
        raise InputError(
            "dataset",
            f"{len(rows)} designs to train on",
            f"at least {FEWEST_DESIGNS} with a converged step, test designs aside",
        )
    if dataset.outputs != tuple(TERMS):
        raise InputError("outputs", ", ".join(dataset.outputs), ", ".join(TERMS))
    known = catalogue()
    for name, own in dataset.effect_parameters(0).items():
        if name in known:  # refuses those that answer to time or history
            fem_fits((name,), "draft")(dataset.design(0), {name: own})
    data = dataset.subset(rows)
    held_out = folds(len(data), settings.folds, settings.repeats, seed)
    unseen_by = np.stack([np.flatnonzero(held) for held in held_out.T], axis=1)
    views = _views(data)
    reached = np.where(data.status == 0, data.pressure, 0.0).max(axis=1)
    # There is nothing to learn from past the place where a path was lost.
    lost = np.array([status not in PROPER_ENDS for status in data.path_status])
    with one_thread():
        limit, limit_report = fit_limit(
            [view.prepared for view in views],
            np.where(lost, reached, data.limit_pressure),
            reached,
            held_out,
            seed + 1,
            settings.limit,
            progress,
        )
        # Designs are shown with the limit pressure that members predict who had not
        # seen them: at prediction time there is nothing better.
        unseen = limit(views[0].prepared, unseen_by).pressure
        views = [replace(view, limit=unseen) for view in views]
        for beside in neighbours(data, seed + 3):
            more = _views(data, beside)
            there = limit(more[0].prepared, unseen_by).pressure
            views += [replace(view, limit=there) for view in more]
        expansion, response_report = _fit_response(
            data, views, held_out, seed + 2, settings, progress
        )
    calibration, disagreement = _calibrate(
        data, expansion, views[0].prepared, unseen, unseen_by
    )
    ensemble = Ensemble(
        outputs=data.outputs,
        space=data.space,
        effects=data.effects,
        expansion=expansion,
        limit=limit,
        calibration=calibration,
        domain=Domain.of(
            data.space, data.max_pressure, views[0].prepared.columns, disagreement
        ),
        description={
            "dataset": dataset.digest(),
            "generator_version": dataset.generator_version,
            "level": dataset.level,
            "dataset_seed": dataset.seed,
            "designs": len(dataset),
            "n_train": len(data),
            "train_steps": int((data.status == 0).sum()),
            "seed": seed,
            "settings": asdict(settings),
            "response_fit": response_report,
            "limit_fit": limit_report,
        },
    )
    return _with_accuracy(ensemble, dataset)


@dataclass(frozen=True)
class _View:
    """The same designs as they are, turned over, or a little changed.

    Parameters
    ----------
    prepared : Prepared
    values : (n, s, m) array, SI
    known : (n, s) bool array
        Where there are values to learn.
    limit : (n,) array, Pa
        Limit pressures that the networks are shown.
    """

    prepared: Prepared
    values: Array
    known: Array
    limit: Array


def _views(data: Dataset, beside: Neighbours | None = None) -> list[_View]:
    """The designs, or their neighbours, without limit pressures.

    And, where nothing else tells up from down, their mirror images.
    """
    if beside is None:
        beside = Neighbours(data.inputs, data.values, data.status == 0)
    columns = columns_of(data.variables, beside.inputs)
    nothing = np.full(len(data), np.nan)
    prepared, values = prepare(columns, data.space), beside.values
    views = [_View(prepared, values, beside.known, nothing)]
    if not data.effects:
        places = [data.outputs.index(TURNED_OVER[name][0]) for name in data.outputs]
        signs = np.array([TURNED_OVER[name][1] for name in data.outputs])
        mirrored = prepare(turned_over(columns), data.space)
        turned = signs * values[..., places]
        views.append(_View(mirrored, turned, beside.known, nothing))
    return views


def _with_accuracy(ensemble: Ensemble, dataset: Dataset) -> Ensemble:
    """The ensemble with its accuracy on held-out designs in its description."""
    if not (is_held_out(dataset) & usable(dataset)).any():
        return ensemble
    measured = accuracy(ensemble, dataset).to_json()
    return replace(ensemble, description=ensemble.description | {"accuracy": measured})


def path_scale(values: Array, terms: Array, owner: Array) -> Array:
    """(n, m) SI.  Largest magnitude of each output along each path, with a floor.

    Parameters
    ----------
    values : (n, s, m) array, SI
    terms : (n, s, k) array, SI
        Both 0 where there is no converged step.
    owner : (k,) int array
    """
    found = np.abs(values).max(axis=1)
    largest = np.abs(terms).max(axis=1)
    floor = [largest[:, owner == o].max(axis=1) for o in range(values.shape[2])]
    scale: Array = np.maximum(found, SCALE_FLOOR * np.stack(floor, axis=1))
    return scale


def _fit_response(
    data: Dataset,
    views: list[_View],
    held_out: Array,
    seed: int,
    settings: TrainSettings,
    progress: Progress | None,
) -> tuple[Expansion, dict[str, Any]]:
    """Fit the networks for the outputs on all views of the designs."""
    effects = bool(data.effects)
    owner, positive = term_owners(effects), positive_terms(effects)
    pressure = np.where(data.status == 0, data.pressure, 0.0)
    inputs = [features(view.prepared, pressure, view.limit) for view in views]
    known = [np.where(view.known[..., None], view.values, 0.0) for view in views]
    scales = [
        path_scale(values, np.where(view.known[..., None], own.terms, 0.0), owner)
        for view, values, own in zip(views, known, inputs, strict=True)
    ]
    # The views of a design stand one after another: together they are one design.
    chosen = np.stack([view.known for view in views], axis=1)
    place = np.nonzero(chosen)[:2]
    scale = np.stack(scales, axis=1)[place]
    target = np.stack(known, axis=1)[chosen] / scale
    terms = np.stack([own.terms for own in inputs], axis=1)[chosen] / scale[:, owner]
    point = np.stack([own.point for own in inputs], axis=1)[chosen]
    count = chosen.sum(axis=(1, 2))
    return fit_terms(
        point,
        terms,
        target,
        count,
        (owner, positive),
        held_out,
        seed,
        settings.response,
        settings.huber,
        "response",
        progress,
    )


def fit_terms(
    point: Array,
    terms: Array,
    target: Array,
    count: Array,
    roles: tuple[Array, Array],
    held_out: Array,
    seed: int,
    settings: FitSettings,
    huber: float,
    stage: str,
    progress: Progress | None,
    ridge: float = RIDGE,
    often: Array | None = None,
) -> tuple[Expansion, dict[str, Any]]:
    """Fit constant weights of the terms, then the networks on top of them.

    Parameters
    ----------
    point : (N, f) array
        Inputs of the networks; rows of a design stand one after another.
    terms : (N, k) array
        Each over the scale of its output.
    target : (N, m) array
        Over the same scales.
    count : (d,) int array
        Rows of each design.
    roles : (k,) int array and (k,) bool array
        The output that owns each term, and whether its weight is positive.
    held_out : (M, d) bool array
    seed : int
    settings : FitSettings
    huber : float
        Error, over the scale, from which on it counts linearly.
    stage, progress
        As in `fit`.
    ridge : float
        Of the constant weights, over the mean square of each term.
    often : (d,) int array, optional
        How many times as much as others a design counts; once by default.
    """
    import torch

    owner, positive = roles
    often = np.ones(len(count), dtype=int) if often is None else often
    weight = np.repeat(often / count, count)
    # In units in which a change of a weight by 1 changes the error by about 1.
    size = np.average(terms**2, axis=0, weights=weight)
    # A term that is nothing everywhere stays nothing.
    unit = 1 / np.sqrt(np.where(size > 0, size, 1.0))
    terms = terms * unit
    start = np.empty(len(owner))
    for o in range(target.shape[1]):
        own = owner == o  # anywhere: closed forms of effects come after all others
        start[own] = _constant_weights(
            terms[:, own], target[:, o], weight, positive[own].any(), ridge
        )

    def single(array: Array) -> torch.Tensor:
        return torch.tensor(array, dtype=torch.float32)

    gather = single(owner[:, None] == np.arange(target.shape[1]))
    base, parts, wanted = single(start), single(terms), single(target)
    grows = torch.tensor(positive)

    def loss(answers: torch.Tensor, picked: torch.Tensor) -> torch.Tensor:
        held = answers.clamp(-LARGEST_LOG, LARGEST_LOG)
        weights = torch.where(grows, base * torch.exp(held), base + answers)
        error = (weights * parts[picked]) @ gather - wanted[picked]
        each = torch.nn.functional.huber_loss(
            error, torch.zeros_like(error), delta=huber, reduction="none"
        )
        return each.sum(dim=-1) / huber

    stack, report = fit(
        point,
        Rows(
            np.repeat(np.cumsum(count) - count, often),
            np.repeat(count, often),
            np.repeat(held_out, often, axis=1),
        ),
        len(owner),
        loss,
        settings,
        seed,
        stage,
        progress,
    )
    return Expansion(stack, start * unit, unit, positive, owner), report


def _constant_weights(
    terms: Array, target: Array, weight: Array, positive: bool, ridge: float
) -> Array:
    """Weighted least squares for the terms of one output.

    With a ridge against terms that say the same, or, where weights are positive, with
    one factor for all of them.
    """
    root = np.sqrt(weight)[:, None]
    a, b = terms * root, target * root[:, 0]
    if positive:
        together = a.sum(axis=1)
        return np.full(terms.shape[1], (together @ b) / (together @ together))
    normal = a.T @ a
    diagonal = np.diag(normal)
    more = np.diag(np.where(diagonal > 0, ridge * diagonal, 1.0))
    solution: Array = np.linalg.solve(normal + more, a.T @ b)
    return solution


def _calibrate(
    data: Dataset,
    expansion: Expansion,
    prepared: Prepared,
    limit: Array,
    unseen_by: Array,
) -> tuple[Calibration, Array]:
    """Calibration on each design by the members that had not seen it.

    Returns it with the (m,) disagreement, over the size of the terms, that 99 % of
    those points stay below.
    """
    errors, spreads = [], []
    pressure = np.where(data.status == 0, data.pressure, 0.0)
    for begin in range(0, len(data), CHUNK):
        some = slice(begin, begin + CHUNK)
        inputs = features(prepared[some], pressure[some], limit[some])
        nearness = pressure[some] / limit[some, None]
        answers = expansion(inputs, nearness, unseen_by[:, some])
        good = data.status[some] == 0
        errors.append((answers.values - data.values[some])[:, good])
        spreads.append(answers.spread[good])
    spread = Spread.joined(spreads)
    design = np.nonzero(data.status == 0)[0]
    members = expansion.stack.members
    found = calibrate(np.concatenate(errors, axis=1), spread, design, members)
    return found, np.quantile(spread.disagreement / spread.size, 0.99, axis=0)
