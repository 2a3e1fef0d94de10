"""What to measure next to know an adopted effect's size better.

Each proposal is added to the measurements as a curve that is still to be read.  With
S the slopes of all readings by the parameters' coordinates and C the covariance of
their errors, calibrations included, the posterior's inverse covariance becomes

    H = S^T C^-1 S + P,

P that of the prior: what the curve would bring does not depend on what is read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from datagen.device import Design
from datagen.errors import InputError

from .evidence import Fit
from .experiment import carried, proposals
from .measurement import Curve, Measurements
from .noise import Frame
from .prior import EVEN
from .study import Study
from .target import Target

Array = np.ndarray

LEAST = 0.9
"""Share of the standard deviation above which a measurement is not worth proposing."""


@dataclass(frozen=True)
class Sharpening:
    """A measurement that could be made next.

    Parameters
    ----------
    words : str
        What to do, in one sentence.
    curve : Curve
        Device or specimen and load steps; its values are not read yet.
    shares : dict of str to float
        Standard deviation then over that now, of each parameter.
    """

    words: str
    curve: Curve
    shares: dict[str, float]

    @property
    def best(self) -> tuple[str, float]:
        """The parameter that gains most, and its share."""
        name = min(self.shares, key=lambda one: self.shares[one])
        return name, self.shares[name]


def deviations(one: Fit) -> Array:
    """(k,) standard deviations of the coordinates that readings like these leave."""
    frame = Frame(one.readings)
    target = Target(frame, np.ones(len(one.readings.value), bool), one.hypothesis)
    eta = target.hyper.aligned(one.hyper.names, one.eta)
    _, slopes, columns = target.look(one.t)
    inverse = slopes.T @ target.covariance(eta, columns).solve(slopes)
    # An even prior on [0, 1] has a variance of 1/12.
    prior = [12.0 if p.density == EVEN else 1.0 for p in one.hypothesis.priors]
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(inverse + np.diag(prior)))))


def sharpen(study: Study, one: Fit) -> list[Sharpening]:
    """Proposals that would make the sizes of a fit's effects clearer, best first.

    Parameters
    ----------
    study : Study
    one : Fit
        With named effects, of this study.

    Returns
    -------
    list of Sharpening
        Those that take at least a tenth off one standard deviation.
    """
    effects: Sequence[str] = one.hypothesis.effects  # type: ignore[attr-defined]
    if not any(isinstance(c.design, Design) for c in study.measurements.curves):
        return []
    names = [p.parameter.name for p in one.hypothesis.priors]
    now = deviations(one)
    found = []
    for words, curve in proposals(study, ["+".join(effects)], one.noise):
        curves = (*study.measurements.curves, curve)
        try:
            more = Study(
                Measurements(curves, tolerances=study.measurements.tolerances),
                study.solver,
                level=study.fast,
                fast=study.fast,
                effects=effects,
                effects_dir=study.folder,
            )
        except InputError:
            continue
        then = carried(study, more, [one])
        if then is None:
            continue
        share = deviations(then[0]) / now
        found.append(
            Sharpening(words, curve, dict(zip(names, map(float, share), strict=True)))
        )
    found = [one for one in found if one.best[1] < LEAST]
    return sorted(found, key=lambda one: one.best[1])
