"""Versions of the model: a baseline with adopted effects, fitted to measurements.

A version never changes once it is made; its id is a hash of what is in it, so that an
answer that names the id names the physics, the numbers and where they are from.  It is
kept as a folder, see `layout`.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from datagen.device import Design
from datagen.effects import catalogue
from datagen.errors import InputError
from datagen.model import GENERATOR_VERSION, Model

from .ladder import Rung
from .layout import BASELINE, EFFECTS, SURROGATE
from .measurement import Measurements, Tolerances
from .provenance import commit, package, source_digest, source_file

if TYPE_CHECKING:
    from .adopt import Adoption

Array = np.ndarray

DIGITS = 12
"""Hexadecimal digits of an id."""


@dataclass(frozen=True)
class Estimate:
    """What the measurements say of one parameter, SI.

    Parameters
    ----------
    name : str
        ``effect.parameter``.
    unit : str
    value, std : float
        Posterior mean and standard deviation.
    low, high : float
        90 % interval.
    lower, upper : float
        Literature range.
    plausibility : str
        Against that range, as `words.Size` has it.
    source : str
        Of the range.
    """

    name: str
    unit: str
    value: float
    std: float
    low: float
    high: float
    lower: float
    upper: float
    plausibility: str
    source: str

    def __post_init__(self) -> None:
        for name in ("value", "std", "low", "high", "lower", "upper"):
            number = getattr(self, name)
            if not isinstance(number, float) or not math.isfinite(number):
                raise InputError(f"{self.name}.{name}", number, "a finite number")
        if self.std < 0 or self.low > self.high or self.lower >= self.upper:
            allowed = "std of at least 0, low up to high, lower below upper"
            raise InputError(self.name, self.std, allowed)


@dataclass(frozen=True)
class Measured:
    """A file of measurements that a version was fitted to.

    Parameters
    ----------
    name, sha256 : str
        Of the file, and of its bytes.
    devices : tuple of str
    designs : tuple of Design
        Of its devices as stated, each once, specimens aside; empty in versions that
        were written before these were kept.
    """

    name: str
    sha256: str
    devices: tuple[str, ...]
    designs: tuple[Design, ...] = field(default=(), compare=False)

    @classmethod
    def of(cls, file: Measurements) -> Measured:
        """What is kept of a file."""
        designs = [one.design for one in file.curves if isinstance(one.design, Design)]
        kept = tuple(dict.fromkeys(designs))
        return cls(file.source, file.sha256, file.devices, kept)

    def to_json(self) -> dict[str, Any]:
        """As data; designs, SI, only where there are any."""
        data = asdict(self)
        if not self.designs:
            del data["designs"]
        return data

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Measured:
        """From `to_json`."""
        designs = tuple(Design(**one) for one in data.get("designs", ()))
        return cls(data["name"], data["sha256"], tuple(data["devices"]), designs)


@dataclass(frozen=True, eq=False)
class ModelVersion:
    """A model with adopted effects.

    Parameters
    ----------
    parent : str
        Id of the version it was adopted on, or `BASELINE`.
    effects : tuple of str
        In the order of their adoption.
    estimates : tuple of k Estimate
        One for each inferred parameter.
    mean, covariance : (k,), (k, k) arrays, SI
        Of the posterior, in the order of the estimates.
    samples : (s, k) array, SI
        Equally weighted samples of the posterior.
    measurements : tuple of Measured
    tolerances : Tolerances
        Of what the measurements state.
    level, fast : str
        Meshes of the baseline, and of what effects change, in the fit.
    seed : int
    ladder : tuple of Rung
    interval : str
        How its intervals were made.
    sources : mapping of str to str
        SHA-256 of the file that each effect is written in.
    own : mapping of str to str
        File in ``effects/`` of each effect that is the user's own.
    warnings : tuple of str
        Of the adoption.
    generator, package, commit : str
        Versions of the code; commit is empty where it is not known.
    date : str
        When it was adopted, as the caller wrote it.
    folder : Path, optional
        Where it was read from or written to.

    Raises
    ------
    InputError
        When the parts do not fit together.
    """

    parent: str
    effects: tuple[str, ...]
    estimates: tuple[Estimate, ...]
    mean: Array
    covariance: Array
    samples: Array
    measurements: tuple[Measured, ...]
    tolerances: Tolerances
    level: str
    fast: str
    seed: int
    ladder: tuple[Rung, ...]
    interval: str
    sources: Mapping[str, str]
    own: Mapping[str, str]
    warnings: tuple[str, ...]
    generator: str
    package: str
    commit: str
    date: str
    folder: Path | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        k = len(self.estimates)
        for name, shape in (("mean", (k,)), ("covariance", (k, k))):
            array = np.array(getattr(self, name), dtype=float)
            if array.shape != shape or not np.isfinite(array).all():
                raise InputError(name, array.shape, f"finite numbers of shape {shape}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        samples = np.array(self.samples, dtype=float)
        if samples.ndim != 2 or samples.shape[1] != k or not np.isfinite(samples).all():
            raise InputError("samples", samples.shape, f"finite rows of {k} numbers")
        samples.setflags(write=False)
        object.__setattr__(self, "samples", samples)
        if not self.effects or len(set(self.effects)) < len(self.effects):
            raise InputError("effects", list(self.effects), "one or more, each once")
        for name in self.names:
            if name.split(".")[0] not in self.effects:
                raise InputError("estimates", name, "parameters of its effects")
        for files in (self.sources, self.own):
            if not set(files) <= set(self.effects):
                raise InputError("sources", list(files), "its effects")
        for file in self.own.values():
            if file != Path(file).name or not file.endswith(".py"):
                raise InputError("own", file, "the name of a Python file")

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters as ``effect.parameter``."""
        return tuple(one.name for one in self.estimates)

    @classmethod
    def of(
        cls,
        adoption: Adoption,
        *,
        parent: str = BASELINE,
        files: Sequence[Measurements] = (),
        date: str = "",
    ) -> ModelVersion:
        """The version that an adoption makes.

        Parameters
        ----------
        adoption : Adoption
        parent : str
            Id of the version it builds on.
        files : sequence of Measurements
            As they were read, where the study joined several.
        date : str
        """
        study = adoption.study
        known = catalogue(study.folder)
        builtin = catalogue()
        paths = {name: source_file(known[name]) for name in adoption.effects}
        estimates = tuple(
            Estimate(
                name=name,
                unit=one["unit"],
                value=one["value"],
                std=one["std"],
                low=one["low"],
                high=one["high"],
                lower=one["range"][0],
                upper=one["range"][1],
                plausibility=one["plausibility"],
                source=one["source"],
            )
            for name, one in zip(
                adoption.names, adoption.parameters.values(), strict=True
            )
        )
        return cls(
            parent=parent,
            effects=adoption.effects,
            estimates=estimates,
            mean=adoption.mean,
            covariance=adoption.covariance,
            samples=adoption.samples,
            measurements=tuple(
                Measured.of(one) for one in files or (study.measurements,)
            ),
            tolerances=study.measurements.tolerances,
            level=study.level,
            fast=study.fast,
            seed=adoption.seed,
            ladder=adoption.ladder,
            interval=adoption.interval,
            sources={name: source_digest(known[name]) for name in paths},
            own={n: path.name for n, path in paths.items() if n not in builtin},
            warnings=adoption.warnings,
            generator=GENERATOR_VERSION,
            package=package(),
            commit=commit(),
            date=date,
        )

    # -- the model ---------------------------------------------------------------------

    def parameters(self, values: Array | None = None) -> dict[str, dict[str, float]]:
        """Parameters by effect, SI: at the posterior mean, or at values (k,).

        Those that a mounting decides, as an orientation, are not among them.
        """
        found: dict[str, dict[str, float]] = {name: {} for name in self.effects}
        chosen = self.mean if values is None else values
        for name, value in zip(self.names, chosen, strict=True):
            effect, parameter = name.split(".")
            found[effect][parameter] = float(value)
        return found

    def forward(
        self,
        level: str | None = None,
        more: Mapping[str, Mapping[str, float]] | None = None,
        effects_dir: Path | None = None,
    ) -> Model:
        """The finite-element model with the effects at their posterior means.

        Parameters
        ----------
        level : str, optional
            Mesh; that of the fit where it is not given.
        more : mapping of str to mapping of str to float, SI
            Other effects on top, or other values of these.
        effects_dir : Path, optional
            Folder of its own effects and of `more`, see `folder.effects_of`.

        Raises
        ------
        EffectError
            When an effect is not there any more.
        """
        parameters = self.parameters()
        for effect, values in (more or {}).items():
            parameters[effect] = parameters.get(effect, {}) | dict(values)
        own = effects_dir or self.effects_dir
        return Model(tuple(parameters), level or self.level, parameters, own)

    @property
    def effects_dir(self) -> Path | None:
        """Folder of its own effect files; None where it has none."""
        if not self.own:
            return None
        if self.folder is None:
            raise InputError("folder", "none", "a version that was saved or loaded")
        return self.folder / EFFECTS

    @property
    def surrogate(self) -> Path | None:
        """Folder of its surrogate, where one was trained."""
        folder = None if self.folder is None else self.folder / SURROGATE
        return folder if folder is not None and folder.is_dir() else None

    def doubts(self) -> tuple[str, ...]:
        """What has changed since the adoption, one line each."""
        lines = []
        if self.generator != GENERATOR_VERSION:
            lines.append(
                f"fitted with generator version {self.generator}; this is "
                f"{GENERATOR_VERSION}: adopt again to fit to its numbers"
            )
        known = catalogue()
        for name in self.effects:
            if name in self.own:
                continue
            if name not in known:
                lines.append(f"effect {name} is not in the catalogue any more")
            elif source_digest(known[name]) != self.sources.get(name):
                lines.append(f"effect {name} was written otherwise at the adoption")
        return tuple(lines)

    # -- files -------------------------------------------------------------------------

    @cached_property
    def version(self) -> str:
        """Id: twelve hexadecimal digits of what decides its answers.

        When and from which commit it was made, what it warns of and what the files of
        measurements are called is left out: the same fit to the same bytes has the
        same id.
        """
        content = self.to_json()
        for name in ("date", "commit", "package", "warnings"):
            del content[name]
        for file in content["measurements"]:
            del file["name"]
        return content_hash(content)[:DIGITS]

    def to_json(self) -> dict[str, Any]:
        """All of it, as data."""
        found: dict[str, Any] = {
            one.name: getattr(self, one.name)
            for one in fields(self)
            if one.name != "folder"
        }
        found["estimates"] = [asdict(one) for one in self.estimates]
        found["measurements"] = [one.to_json() for one in self.measurements]
        found["tolerances"] = asdict(self.tolerances)
        found["ladder"] = [rung_json(one) for one in self.ladder]
        for name in ("mean", "covariance", "samples"):
            found[name] = found[name].tolist()
        return json.loads(json.dumps(found))  # type: ignore[no-any-return]

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> ModelVersion:
        """From `to_json`.

        Raises
        ------
        InputError, KeyError, TypeError, ValueError
            When something is missing or not allowed.
        """
        known = {one.name for one in fields(cls)} - {"folder"}
        content: dict[str, Any] = {name: data[name] for name in known}
        content["estimates"] = tuple(Estimate(**one) for one in data["estimates"])
        content["measurements"] = tuple(
            Measured.from_json(one) for one in data["measurements"]
        )
        content["tolerances"] = Tolerances(**data["tolerances"])
        content["ladder"] = tuple(_rung(one) for one in data["ladder"])
        content["effects"] = tuple(data["effects"])
        content["warnings"] = tuple(data["warnings"])
        return cls(**content)

    def save(self, folder: Path, effects_dir: Path | None = None) -> ModelVersion:
        """Write it into a new folder, see `folder.write`."""
        from .folder import write

        return write(self, folder, effects_dir)

    @classmethod
    def load(cls, folder: Path) -> ModelVersion:
        """Read it from a folder, see `folder.read`."""
        from .folder import read

        return read(folder)


def rung_json(one: Rung) -> dict[str, Any]:
    """A rung as data, by the contract's names; None for what is not known."""
    data: dict[str, Any] = {"rung": one.name, "effects": list(one.effects)}
    for name in (
        "heldout_error",
        "low",
        "high",
        "ratio",
        "ratio_low",
        "ratio_high",
        "log_bayes",
    ):
        value = getattr(one, name)
        data[name] = value if math.isfinite(value) else None
    return data


def _rung(data: Mapping[str, Any]) -> Rung:
    numbers = {
        name: math.nan if value is None else float(value)
        for name, value in data.items()
        if name not in ("rung", "effects")
    }
    return Rung(str(data["rung"]), tuple(data["effects"]), **numbers)


def content_hash(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
