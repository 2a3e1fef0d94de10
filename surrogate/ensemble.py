"""The trained surrogate: answers, intervals, range check, and its two files.

A folder holds ``model.json``, which describes the model in words and numbers, and
``weights.safetensors`` with every array.  Nothing in either can run code.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from datagen.dataset import Dataset
from datagen.device import DESIGN_SPACE, Design
from datagen.errors import InputError
from datagen.response import CONVERGED, Response
from datagen.response import Path as LoadPath
from datagen.space import Space
from datagen.units import PRESSURE
from datagen.worker import NO_STEP

from .calibration import ONE_SIGMA, Calibration
from .domain import Domain, RangeCheck
from .expansion import Answers, Expansion
from .features import Prepared, columns_of, features, prepare
from .limit import Limit, LimitModel
from .split import folds, training_rows

Array = np.ndarray

REFERENCE = Path(__file__).parent / "reference"
"""Folder of the model that is shipped with the program."""

CHUNK = 4096
"""Load steps evaluated at a time, to bound memory."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """An answer with its interval.

    Parameters
    ----------
    response : Response
        Mean of the members, and one calibrated standard deviation.
    low, high : (n, s, m) arrays, SI
        Ends of the interval.
    coverage : float
        Share of the points of unseen designs that such intervals cover.
    """

    response: Response
    low: Array
    high: Array
    coverage: float


@dataclass(frozen=True, eq=False)
class Ensemble:
    """A forward model as fast as a formula.

    Parameters
    ----------
    outputs : tuple of m str
    space : Space
        What was sampled for the training: design variables, and parameters of effects
        as ``effect.parameter``.
    effects : tuple of str
        Effects that the training data had in them.
    expansion : Expansion
        Networks for the outputs.
    limit : LimitModel
        Networks for the limit pressure.
    calibration : Calibration
    domain : Domain
    description : dict
        Where the model comes from: dataset, sizes, seeds, settings, accuracy.
    parameters : mapping
        ``{effect: {parameter: value}}``, SI; at its off value where not given.
    """

    outputs: tuple[str, ...]
    space: Space
    effects: tuple[str, ...]
    expansion: Expansion
    limit: LimitModel
    calibration: Calibration
    domain: Domain
    description: dict[str, Any]
    parameters: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = {p.name for p in self.space if "." in p.name}
        for effect, values in self.parameters.items():
            for name, value in values.items():
                full = f"{effect}.{name}"
                if full not in known:
                    allowed = ", ".join(sorted(known)) or "none, without effects"
                    raise InputError("parameters", full, allowed)
                if not np.isfinite(value):
                    raise InputError(full, value, "a finite number")

    @cached_property
    def version(self) -> str:
        """Twelve hexadecimal digits of what the model is made of."""
        from .store import content_digest

        return content_digest(self)[:12]

    @property
    def knows_limits(self) -> bool:
        """Whether limit pressures are learned; otherwise they are a closed form."""
        return self.limit.stack is not None

    def with_parameters(
        self, parameters: Mapping[str, Mapping[str, float]]
    ) -> Ensemble:
        """The same model with its effects' parameters at other values, SI."""
        other = replace(self, parameters=parameters)
        # The version does not depend on them, and costs more than a prediction.
        other.__dict__["version"] = self.version
        return other

    def __call__(
        self, designs: Sequence[Design], paths: Sequence[LoadPath]
    ) -> Response:
        """Predict each design along its own path; std is one calibrated deviation."""
        pressure = stacked(designs, paths)
        answers, limit = self._answers(self._prepared(designs), pressure)
        scale = self.calibration.scale(answers.spread)
        return self._response(pressure, answers, scale, limit)

    def predict(
        self,
        designs: Sequence[Design],
        paths: Sequence[LoadPath],
        coverage: float = 0.9,
    ) -> Prediction:
        """Predict with intervals of the given coverage, 0.5 to 0.99.

        Raises
        ------
        InputError
            When the coverage is outside that, or beyond what the number of
            calibration designs supports.
        """
        pressure = stacked(designs, paths)
        quantile = self.calibration.quantile(coverage)
        answers, limit = self._answers(self._prepared(designs), pressure)
        scale = self.calibration.scale(answers.spread)
        response = self._response(pressure, answers, scale, limit)
        half = quantile * scale
        return Prediction(
            response, response.values - half, response.values + half, coverage
        )

    def check(self, design: Design, pressure: Array) -> RangeCheck:
        """Whether the model was trained for this, and where its members disagree.

        Parameters
        ----------
        design : Design
        pressure : (s,) array, Pa
        """
        pressure = LoadPath(pressure).pressure
        prepared = self._prepared([design])
        answers, limit = self._answers(prepared, pressure[None])
        found = self.domain.check(prepared.columns, pressure, limit)
        return replace(found, notes=self.notes(answers, pressure))

    def notes(self, answers: Answers, pressure: Array) -> tuple[str, ...]:
        """Where the members disagree more than they did on unseen designs.

        Parameters
        ----------
        answers : Answers
            About one design.
        pressure : (s,) array, Pa
        """
        spread = answers.spread[0]
        size = np.maximum(spread.size, np.finfo(float).tiny)
        ratio = spread.disagreement / size
        notes = []
        for o, name in enumerate(self.outputs):
            worst, most = ratio[:, o].argmax(), self.domain.disagreement[o]
            if ratio[worst, o] > most:
                kpa = pressure[worst] / PRESSURE.factor
                notes.append(
                    f"the ensemble disagrees on {name} at {kpa:g} kPa: its spread is "
                    f"{ratio[worst, o]:.1%} of the terms; {most:.1%} is not passed at "
                    "99 % of the points of unseen designs"
                )
        return tuple(notes)

    def limit_pressure(self, designs: Sequence[Design]) -> Limit:
        """Predicted limit pressure of each design."""
        return self.limit(self._prepared(designs))

    def unseen_by(self, dataset: Dataset, rows: Array) -> Array:
        """(r, n) int.  Members that had not seen the designs of some rows.

        Parameters
        ----------
        dataset : Dataset
            That the model was trained on.
        rows : (n,) int array
            Of designs that were trained on.

        Raises
        ------
        InputError
            When it was trained on another dataset, or not on all of these rows.
        """
        own, given = str(self.description["dataset"]), dataset.digest()
        if own != given:
            raise InputError("dataset", given[:12], f"{own[:12]}, as trained on")
        trained = training_rows(dataset)
        place = np.searchsorted(trained, rows)
        inside = place < len(trained)
        if not inside.all() or (trained[place] != rows).any():
            raise InputError("rows", "held-out designs", "designs that were trained on")
        settings, seed = self.description["settings"], self.description["seed"]
        held = folds(len(trained), settings["folds"], settings["repeats"], seed)
        return np.stack([np.flatnonzero(one) for one in held.T[place]], axis=1)

    def save(self, folder: str | Path) -> None:
        """Write ``model.json`` and ``weights.safetensors`` into a folder."""
        from .store import write

        write(self, Path(folder))

    @classmethod
    def load(cls, folder: str | Path) -> Ensemble:
        """Read a saved model.

        Raises
        ------
        FileError
            When a file is missing, damaged, of another version, or the two do not
            belong together.
        """
        from .store import read

        return read(Path(folder))

    def _prepared(self, designs: Sequence[Design]) -> Prepared:
        """Designs, with the effects' parameters at their values."""
        columns = design_columns(designs)
        for parameter in self.space:
            effect, dot, name = parameter.name.rpartition(".")
            if dot:
                value = self.parameters.get(effect, {}).get(name, parameter.off)
                columns[parameter.name] = np.full(len(designs), value, dtype=float)
        return prepare(columns, self.space)

    def _answers(self, prepared: Prepared, pressure: Array) -> tuple[Answers, Limit]:
        """Answers at (n, s) pressures; NaN where the pressure is."""
        limit = self.limit(prepared)
        return self.answers(prepared, pressure, limit), limit

    def answers(
        self,
        prepared: Prepared,
        pressure: Array,
        limit: Limit,
        members: Array | None = None,
    ) -> Answers:
        """Answers at (n, s) pressures, Pa, up to known limits.

        `members`, an (r, n) int array, are those asked about each design; all of them
        where it is not given.
        """
        nearness = np.abs(pressure) / limit.pressure[:, None]
        some = max(1, CHUNK // pressure.shape[1])
        parts = []
        for begin in range(0, len(prepared), some):
            own = slice(begin, begin + some)
            inputs = features(prepared[own], pressure[own], limit.pressure[own])
            who = None if members is None else members[:, own]
            parts.append(self.expansion(inputs, nearness[own], who))
        return Answers.joined(parts)

    def _response(
        self, pressure: Array, answers: Answers, scale: Array, limit: Limit
    ) -> Response:
        std = self.calibration.quantile(ONE_SIGMA) * scale
        info = {"source": "surrogate", "version": self.version}
        return answered(self.outputs, pressure, answers.mean, std, limit, info)


def answered(
    outputs: tuple[str, ...],
    pressure: Array,
    values: Array,
    std: Array,
    limit: Limit,
    info: dict[str, Any],
) -> Response:
    """What a surrogate answers along paths (n, s), its limit where they meet it."""
    n, _ = pressure.shape
    met = np.isfinite(limit.std) & (limit.pressure <= np.nanmax(pressure, axis=1))
    return Response(
        outputs=outputs,
        pressure=pressure,
        values=values,
        std=std,
        status=np.where(np.isfinite(pressure), CONVERGED, NO_STEP),
        path_status=("completed",) * n,
        limit_pressure=np.where(met, limit.pressure, np.nan),
        message=("",) * n,
        info=info,
    )


def reference_model() -> Ensemble:
    """The model that is shipped with the program."""
    return Ensemble.load(REFERENCE)


def design_columns(designs: Sequence[Design]) -> dict[str, Array]:
    """(n,) arrays of the variables of the design space, SI."""
    sampled = [
        [float(getattr(design, name)) for name in DESIGN_SPACE.names]
        for design in designs
    ]
    return columns_of(DESIGN_SPACE.names, np.array(sampled))


def stacked(designs: Sequence[Design], paths: Sequence[LoadPath]) -> Array:
    """(n, s) pressures, padded with NaN."""
    if len(designs) != len(paths) or not designs:
        raise InputError(
            "paths", len(paths), f"one path a design: {len(designs)}, at least 1"
        )
    most = max(len(path.pressure) for path in paths)
    pressure = np.full((len(paths), most), np.nan)
    for i, path in enumerate(paths):
        pressure[i, : len(path.pressure)] = path.pressure
    return pressure
