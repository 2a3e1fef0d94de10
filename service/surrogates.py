"""The fast surrogate of a model version: trained from an increment of paths.

Its base is the shipped reference model with the dataset that it learned from; the
version's parameters become inputs over a stated range around their fit, and its
posterior is what predictions average over.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from datagen.device import Design
from datagen.effects import catalogue
from datagen.errors import InputError
from datagen.response import Path as LoadPath
from datagen.space import Parameter
from datagen.units import BY_FIELD
from discrepancy.folder import effects_of
from discrepancy.layout import SURROGATE
from discrepancy.version import ModelVersion
from discrepancy.workspace import Workspace

if TYPE_CHECKING:
    from surrogate.corrected import Corrected
    from surrogate.ensemble import Prediction

    from .answer import RangeCheck

Array = np.ndarray

MINUTES = 8.0
"""Time budget of a surrogate that nothing else is said of."""

SAMPLES = 50
"""Of the posterior, that a prediction averages over."""

STATED = 0.02
"""Half range, over that of the parameter, of what is no property of the device and
stays where it is: the orientation that predictions are made for."""

Report = Callable[[str, int, int, float | None], None]


@dataclass(frozen=True, eq=False)
class AdoptedSurrogate:
    """A version's surrogate as the service asks it: averaged over its posterior.

    Parameters
    ----------
    version : str
        Of the model version.
    corrected : Corrected
    """

    version: str
    corrected: Corrected

    @cached_property
    def description(self) -> dict[str, Any]:
        return self.corrected.description

    def predict(
        self,
        designs: Sequence[Design],
        paths: Sequence[LoadPath],
        coverage: float = 0.9,
    ) -> Prediction:
        """As `surrogate.corrected.Corrected.marginal`."""
        return self.corrected.marginal(designs, paths, coverage=coverage)

    def check(self, design: Design, pressure: Array) -> RangeCheck:
        return self.corrected.check(design, pressure)


def load(version: ModelVersion) -> AdoptedSurrogate | None:
    """The surrogate of a version; None where none was trained.

    Raises
    ------
    FileError
        When it is damaged.
    """
    if version.surrogate is None:
        return None
    from surrogate.corrected import Corrected

    corrected = Corrected.load(version.surrogate)
    return AdoptedSurrogate(
        version.version, corrected.with_parameters(version.parameters())
    )


def train(
    version: ModelVersion,
    *,
    minutes: float | None = None,
    paths: int | None = None,
    seed: int = 0,
    workers: int = 1,
    restart: str = "",
    report: Report | None = None,
) -> AdoptedSurrogate:
    """Train the surrogate of a version, or go on where an earlier run has stopped.

    Where nothing is said of how long, and the parent's serves, that is taken.

    Parameters
    ----------
    version : ModelVersion
        In a folder; the surrogate comes to lie in it.
    minutes : float, optional
        Time budget; `MINUTES` where no number of paths is given.
    paths : int, optional
        How many are solved, in place of a budget.
    seed : int
    workers : int
        Processes that solve.
    restart : str, optional
        Name of a new beginning, see `surrogate.learn.learn`.
    report : callable, optional
        ``report(stage, done, total, seconds left or None)``.

    Raises
    ------
    InputError
        When the effects have a memory, a setting is not allowed, or another training
        has begun or ended there and `restart` is not given.
    FileError, GenerationError, Interrupted
        As in `surrogate.learn.learn`.
    """
    from datagen.dataset import Dataset
    from surrogate.ensemble import REFERENCE, reference_model
    from surrogate.learn import learn

    if version.folder is None:
        raise InputError("model", version.version, "a version that was saved")
    there = None if restart else _handed_on(version, minutes, paths)
    if there is not None:
        return there
    if minutes is None and paths is None:
        minutes = MINUTES
    measured = [design for one in version.measurements for design in one.designs]
    with effects_of(version, None) as own:
        parameters = declared(version, own)
        ranges, samples = learned(version, parameters)
        learn(
            reference_model(),
            Dataset.read(REFERENCE / "dataset.h5"),
            version.effects,
            ranges,
            version.folder / SURROGATE,
            samples=samples,
            paths=paths,
            minutes=minutes,
            seed=seed,
            near=tuple(dict.fromkeys(measured)),
            effects_dir=own,
            workers=workers,
            resume=True,
            restart=restart,
            report=report,
        )
    found = load(version)
    assert found is not None
    return found


def _handed_on(
    version: ModelVersion, minutes: float | None, paths: int | None
) -> AdoptedSurrogate | None:
    """The parent's surrogate, in place already or now; None where it is not asked for.

    Raises
    ------
    InputError
        When it is in place and one of its own is asked for.
    """
    from surrogate.learn import HANDED_ON

    there = load(version)
    if minutes is None and paths is None:
        if there is None:
            return hand_on(version, _parent(version))
        return there if HANDED_ON in there.description else None
    if there is not None and HANDED_ON in there.description:
        origin = there.description[HANDED_ON]
        allowed = f"a new beginning (--restart): that of {origin} serves here"
        raise InputError("restart", False, allowed)
    return None


def _parent(version: ModelVersion) -> ModelVersion | None:
    """The version it is built on, where that is beside it."""
    assert version.folder is not None
    for entry in Workspace(version.folder.parent).entries():
        if entry.version is not None and entry.version.version == version.parent:
            return entry.version
    return None


def hand_on(
    version: ModelVersion, parent: ModelVersion | None
) -> AdoptedSurrogate | None:
    """The parent's surrogate for a version that was fitted again; seconds, not minutes.

    What it has learned holds over its stated ranges: a posterior inside needs no other.

    Parameters
    ----------
    version : ModelVersion
        In a folder, without a surrogate.
    parent : ModelVersion or None

    Returns
    -------
    AdoptedSurrogate or None
        None where the parent has none, has other effects or had them written or solved
        otherwise, or the posterior is not inside its ranges.

    Raises
    ------
    FileError
        When the parent's is damaged, or this one cannot be written.
    """
    from surrogate import learn

    if version.folder is None or version.surrogate or parent is None:
        return None
    if parent.surrogate is None or (parent.sources, parent.generator) != (
        version.sources,
        version.generator,
    ):
        return None
    with effects_of(version, None) as own:
        samples = _samples(version, declared(version, own))
    folder = version.folder / SURROGATE
    made = learn.hand_on(parent.surrogate, folder, samples, parent.version)
    return None if made is None else load(version)


def declared(version: ModelVersion, effects_dir: Path | None) -> dict[str, Parameter]:
    """Parameters of a version's effects, in the order in which they act."""
    from datagen.model import Model

    space = Model(version.effects, effects_dir=effects_dir).space
    known = catalogue(effects_dir)
    return {
        p.name: known[effect].space[name]
        for p in space
        if "." in p.name
        for effect, name in [p.name.split(".")]
    }


def learned(
    version: ModelVersion, parameters: dict[str, Parameter]
) -> tuple[dict[str, tuple[float, float]], Array]:
    """Stated ranges of the parameters, and (m, j) samples of them, SI.

    What the version does not infer, a measurement's orientation, stays at off.
    """
    from surrogate.increment import stated_range

    fitted = {one.name: one for one in version.estimates}
    ranges = {}
    for name, parameter in parameters.items():
        if name in fitted:
            one = fitted[name]
            ranges[name] = stated_range(parameter, one.value, one.std)
        else:
            still = _still(parameter)
            half = STATED * (parameter.upper - parameter.lower)
            ranges[name] = (
                max(parameter.lower, still - half),
                min(parameter.upper, still + half),
            )
    lower, upper = np.array(list(ranges.values())).T
    return ranges, np.clip(_samples(version, parameters), lower, upper)


def _still(parameter: Parameter) -> float:
    """Where a parameter stays that a version does not infer."""
    return parameter.lower if parameter.off is None else parameter.off


def _samples(version: ModelVersion, parameters: dict[str, Parameter]) -> Array:
    """(m, j) samples of the posterior, SI, at most `SAMPLES`."""
    every = np.linspace(0, len(version.samples) - 1, SAMPLES).round().astype(int)
    chosen = version.samples[np.unique(every)]
    columns = [
        chosen[:, version.names.index(name)]
        if name in version.names
        else np.full(len(chosen), _still(parameter))
        for name, parameter in parameters.items()
    ]
    return np.stack(columns, axis=1)


def about(made: AdoptedSurrogate) -> dict[str, Any]:
    """What is known of a surrogate: paths, stated ranges, errors on held-out designs.

    `change` is the error of what the effects change alone, `accuracy` that of the whole
    answer, both in percent of each path's largest magnitude; `handed_on` is the version
    that it was learned for, where that is another one.
    """
    said = made.description
    return {
        "version": made.version,
        "paths": said["paths"],
        "base": said["base"],
        "handed_on": said.get("handed_on"),
        "level": said["level"],
        "ranges": {p.name: [p.lower, p.upper] for p in made.corrected.tuned},
        "accuracy": said.get("accuracy"),
        "change": said.get("change"),
    }


def lines(made: AdoptedSurrogate) -> list[str]:
    """The same for people."""
    known = about(made)
    tests = (known["accuracy"] or {}).get("n_test", 0)
    found = [
        f"{known['paths']} paths, {tests} of them to test, on mesh {known['level']}."
    ]
    if known["handed_on"]:
        found.append(f"Learned for version {known['handed_on']}: this fit is inside.")
    for p in made.corrected.tuned:
        found.append(f"{p.name}: {p.lower:.4g} to {p.upper:.4g} {p.unit}")
    if known["accuracy"]:
        whole = known["accuracy"]["outputs"]
        for output, alone in known["change"].items():
            column = BY_FIELD[output]
            found.append(
                f"{column.name}: median error {whole[column.name]['median_pct']:.2g} % "
                f"of the path's largest value on held-out designs, of the change alone "
                f"{alone['median_pct']:.2g} %"
            )
        covered = known["accuracy"]["coverage"]["90"]
        found.append(f"90 % intervals hold {covered:.0%} of held-out points.")
    return found
