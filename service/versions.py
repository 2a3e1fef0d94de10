"""Answers with a model version: which one is meant, and what it predicts with."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from datagen.device import Design
from datagen.errors import InputError
from datagen.units import PRESSURE

from .answer import COVERAGE, Answer, fem_answer, surrogate_answer
from .tasks import fem_version

if TYPE_CHECKING:
    from datagen.model import Model
    from discrepancy.version import ModelVersion
    from surrogate.accuracy import Surrogate


def chosen_version(model: str | None, workspace: Path | None) -> ModelVersion | None:
    """The version that a request means; None for a model without adopted effects.

    Parameters
    ----------
    model : str or None
        Folder, name or id of a version, or the folder of an ensemble; without it what
        is in use in the workspace.
    workspace : Path or None
        The default one where it is not given.

    Raises
    ------
    FileError, InputError
        When there is no such version, or it is damaged.
    """
    from discrepancy.layout import BASELINE, is_version
    from discrepancy.workspace import Workspace, default_workspace, locate

    if model is None:
        entry = Workspace(workspace or default_workspace()).current()
        return None if entry is None else entry.version
    if model == BASELINE:
        return None
    folder = locate(model, workspace)
    if not is_version(folder):
        return None
    from discrepancy.folder import read

    return read(folder)


def named_version(model: str | None, workspace: Path | None) -> ModelVersion | None:
    """The version that a request names; None where it names none, or the baseline.

    Raises
    ------
    FileError, InputError
        When there is no such version, or it is damaged.
    """
    if model is None:
        return None
    from discrepancy.folder import read
    from discrepancy.layout import BASELINE
    from discrepancy.workspace import locate

    return None if model == BASELINE else read(locate(model, workspace))


def trained(
    model: str, dataset: Path | None, workspace: Path | None
) -> tuple[Surrogate, Path]:
    """A surrogate, and a file of paths to judge it by.

    Parameters
    ----------
    model : str
        As in `chosen_version`.
    dataset : Path or None
        Of a version, what its surrogate was trained from where it is not given.
    workspace : Path or None

    Raises
    ------
    FileError, InputError
        When there is no such model, it has no surrogate, or a dataset is needed.
    """
    from surrogate.corrected import Corrected
    from surrogate.ensemble import Ensemble
    from surrogate.learn import INCREMENT

    version = chosen_version(model, workspace)
    if version is None:
        if dataset is None:
            raise InputError("DATASET", "none", "an HDF5 file of paths")
        return Ensemble.load(Path(model)), dataset
    if version.surrogate is None:
        allowed = "a version with a surrogate (pba models train)"
        raise InputError("model", model, allowed)
    return Corrected.load(version.surrogate), dataset or version.surrogate / INCREMENT


@contextmanager
def fem_model(
    version: ModelVersion | None,
    parameters: Mapping[str, Mapping[str, float]],
    level: str,
    effects_dir: Path | None,
) -> Iterator[Model]:
    """The finite elements with a version's effects and others, while in the block.

    Parameters
    ----------
    version : ModelVersion or None
    parameters : mapping of str to mapping of str to float, SI
        Effects on top of the version's, or other values of these.
    level : str
    effects_dir : Path or None
        Of the user's own effects.
    """
    from datagen.model import Model

    if version is None:
        yield Model(tuple(parameters), level, parameters, effects_dir)
        return
    from discrepancy.folder import effects_of

    with effects_of(version, effects_dir) as own:
        yield version.forward(level, parameters, own)


def fem_name(level: str, version: ModelVersion | None) -> str:
    """What makes the numbers of the finite elements, adopted effects included."""
    return fem_version(level, "" if version is None else version.version)


def version_answer(
    version: ModelVersion, design: Design, pressure: np.ndarray, level: str
) -> Answer:
    """What a version predicts: its surrogate in range, else the finite elements.

    Parameters
    ----------
    version : ModelVersion
    design : Design
    pressure : (s,) array, Pa
    level : str
        Mesh of the finite elements.
    """
    from .surrogates import load

    surrogate = load(version)
    reasons: tuple[str, ...] = (
        f"model version {version.version} has no surrogate yet",
    )
    if surrogate is not None:
        check = surrogate.check(design, pressure)
        if check.in_range:
            answer = surrogate_answer(surrogate, design, pressure, check)
            return replace(answer, effects=version.effects)
        reasons = tuple(check.reasons)
    return adopted_answer(
        version.forward(level),
        fem_name(level, version),
        left_open(version),
        design,
        pressure,
        False,
        reasons,
    )


def left_open(version: ModelVersion) -> dict[str, list[float]]:
    """Of each fitted parameter, SI, the posterior's samples less their mean."""
    apart = (version.samples - version.mean).T
    return {name: own.tolist() for name, own in zip(version.names, apart, strict=True)}


def adopted_answer(
    model: Model,
    name: str,
    apart: Mapping[str, Sequence[float]],
    design: Design,
    pressure: np.ndarray,
    in_range: bool,
    reasons: Sequence[str],
) -> Answer:
    """What the finite elements answer with a version's effects, at their means.

    The interval joins in squares the mesh error and the way from the value to the
    quantiles of the posterior's samples, each moved along the derivatives by the
    parameters: it says what the measurements left open, as far as that is linear.

    Parameters
    ----------
    model : Model
        Its finite elements.
    name : str
        What makes these numbers, see `fem_name`.
    apart : mapping of str to sequence of q float
        Of `left_open`.
    design : Design
    pressure : (s,) array, Pa
    in_range, reasons
        What the surrogate said of this request.
    """
    answer = fem_answer(
        model, name, design, pressure, in_range, reasons, sensitivities=tuple(apart)
    )
    return replace(_marginal(answer, apart), effects=model.effects)


def _marginal(answer: Answer, apart: Mapping[str, Sequence[float]]) -> Answer:
    """An answer with derivatives, its interval widened by the posterior."""
    if answer.jacobian is None:  # nothing was fitted
        return answer
    known = np.isfinite(answer.jacobian).all(axis=2)
    slopes = np.where(known[..., None], answer.jacobian, 0.0)
    samples = np.array([apart[one] for one in answer.parameters])
    moved = np.einsum("smk,kq->qsm", slopes, samples)
    ends = [(1 - COVERAGE) / 2, (1 + COVERAGE) / 2]
    low, high = np.quantile(moved, ends, axis=0)
    return replace(
        answer,
        low=answer.value - np.hypot(answer.value - answer.low, np.maximum(-low, 0)),
        high=answer.value + np.hypot(answer.high - answer.value, np.maximum(high, 0)),
        notes=(*answer.notes, *_notes_on(tuple(apart), answer, known.all(axis=1))),
    )


def _notes_on(fitted: Sequence[str], answer: Answer, known: np.ndarray) -> list[str]:
    """What the interval holds; `known`, (s,) bool, are steps with derivatives."""
    names = ", ".join(fitted)
    lines = [
        f"{COVERAGE:.0%} interval: the mesh error, and what the measurements left open "
        f"of {names}."
    ]
    reached = np.isfinite(answer.value).all(axis=1)
    if lost := [f"{p / PRESSURE.factor:g}" for p in answer.pressure[reached & ~known]]:
        lines.append(
            f"No derivative by {names} was found at {', '.join(lost)} kPa: the "
            "interval there is the mesh error alone."
        )
    return lines
