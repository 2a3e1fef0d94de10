"""The answer of every member: terms with the dimension of the output, weighed.

    y_o = sum_k B_ok c_ok

`base` is the best constant weight of each term over the training designs, so an
untrained network already answers with the closed forms.  The networks' answers move it:
c = base + unit net for outputs of either sign, c = base exp(net) for those that are
positive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .calibration import Spread
from .features import Features
from .network import Stack

Array = np.ndarray

LARGEST_LOG = 2.5
"""Bound of the logarithm of a positive weight over its constant value."""


@dataclass(frozen=True)
class Answers:
    """What members say about n designs at s load steps.

    Parameters
    ----------
    values : (r, n, s, m) array, SI
        Of each member that was asked.
    spread : Spread of (n, s, m) arrays
    """

    values: Array
    spread: Spread

    @property
    def mean(self) -> Array:
        """(n, s, m) mean over the members, SI."""
        mean: Array = self.values.mean(axis=0)
        return mean

    @classmethod
    def joined(cls, parts: Sequence[Answers]) -> Answers:
        """Answers about several groups of designs as one."""
        if len(parts) == 1:
            return parts[0]
        values = np.concatenate([part.values for part in parts], axis=1)
        return cls(values, Spread.joined([part.spread for part in parts]))


@dataclass(frozen=True)
class Expansion:
    """Stack of networks and what their answers mean.

    Parameters
    ----------
    stack : Stack
    base, unit : (k,) arrays
    positive : (k,) bool array
        Which weights are positive.
    owner : (k,) int array
        Output that each term belongs to.
    """

    stack: Stack
    base: Array
    unit: Array
    positive: Array
    owner: Array

    @cached_property
    def gather(self) -> Array:
        """(k, m) array that adds up the terms of each output."""
        places = np.arange(self.owner.max() + 1)
        gather: Array = (self.owner[:, None] == places).astype(float)
        return gather

    def weights(self, net: Array) -> Array:
        """(..., k) weights of the terms for (..., k) answers of the networks."""
        weights = self.base + self.unit * net
        # Factors seen are 0.3 to 3; far from the training data they stay bounded.
        held = np.clip(net[..., self.positive], -LARGEST_LOG, LARGEST_LOG)
        weights[..., self.positive] = self.base[self.positive] * np.exp(held)
        answer: Array = weights
        return answer

    def __call__(
        self, features: Features, nearness: Array, members: Array | None = None
    ) -> Answers:
        """Answers and spread of the members.

        Parameters
        ----------
        features : Features
        nearness : (n, s) array
            Pressure over the predicted limit pressure.
        members : (r, n) int array, optional
            Members asked about each design; all of them where it is not given.
        """
        n, s, f = features.point.shape
        net = self.stack(features.point.reshape(n * s, f))
        net = net.reshape(-1, n, s, len(self.base))
        if members is not None:
            net = net[members, np.arange(n)]
        parts = self.weights(net) * features.terms
        values = parts @ self.gather
        size = np.sqrt(parts.mean(axis=0) ** 2 @ self.gather)
        # Over r - 1: few members must not look more alike than many.
        disagreement = values.std(axis=0, ddof=1)
        near = np.minimum(nearness, 1.0)[..., None]
        return Answers(values, Spread(disagreement, size, near))
