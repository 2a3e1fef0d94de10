"""Virtual designs beside those whose paths were differentiated.

A network that is shown a design's outputs and, to first order, those of designs a few
percent away learns the slopes there too, and needs no other loss for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datagen.dataset import Dataset
from datagen.device import Design
from datagen.worker import split_inputs

Array = np.ndarray

COUNT = 6
"""Neighbours of each design."""

DISTANCE = 0.02
"""Standard deviation of every variable's change over its value.

Small enough for outputs that go with the third power of a thickness: what is left out
is a thousandth of them, mostly.
"""

NEAR_LIMIT = 0.9
"""Share of the limit pressure beyond which slopes say little: outputs end there like a
square root."""


@dataclass(frozen=True)
class Neighbours:
    """One neighbour of each of n designs, at the load steps of their paths.

    Parameters
    ----------
    inputs : (n, d) array, SI
        As in `Dataset`.
    values : (n, s, m) array, SI
    known : (n, s) bool array
        Where the values can be relied on.
    """

    inputs: Array
    values: Array
    known: Array


def neighbours(data: Dataset, seed: int) -> list[Neighbours]:
    """`COUNT` neighbours of each differentiated design; none without derivatives.

    Parameters
    ----------
    data : Dataset
    seed : int
    """
    if data.jacobian is None:
        return []
    rng = np.random.default_rng(seed)
    return [_one(data, data.jacobian, rng) for _ in range(COUNT)]


def _one(data: Dataset, jacobian: Array, rng: np.random.Generator) -> Neighbours:
    continuous = [p.scale != "integer" for p in data.space]
    change = DISTANCE * rng.standard_normal(data.inputs.shape) * continuous
    width = np.array([p.upper - p.lower for p in data.space])
    effect = np.array(["." in p.name for p in data.space])
    # A parameter of an effect may be 0, and is moved by a share of its range.
    step = change * np.where(effect, width, data.inputs)
    steps = np.zeros((len(data), len(data.parameters)))
    inputs = data.inputs.copy()
    rows = np.flatnonzero(np.isfinite(jacobian).any(axis=(1, 2, 3)))
    for row in rows.tolist():
        inputs[row] += step[row]
        beside, _ = split_inputs(data.variables, inputs[row], data.effects)
        here, there = data.design(row), Design.from_sample(beside)
        for k, name in enumerate(data.parameters):
            steps[row, k] = (
                step[row, data.variables.index(name)]
                if "." in name
                else getattr(there, name) - getattr(here, name)
            )
    moved = np.einsum("nsmk,nk->nsm", jacobian, steps)
    below = ~(data.pressure > NEAR_LIMIT * data.limit_pressure[:, None])
    known = (data.status == 0) & np.isfinite(moved).all(axis=2) & below
    return Neighbours(inputs, data.values + moved, known)
