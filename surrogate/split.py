"""Which designs train, which test, and which member sees which.

The unit is the design, never the load step: neighbouring points of one path say the
same thing.
"""

from __future__ import annotations

import hashlib

import numpy as np

from datagen.dataset import Dataset

Array = np.ndarray

TEST_SHARE = 0.15
"""Share of the designs that no training ever sees."""


def is_test(inputs: Array) -> Array:
    """(n,) bool.  Held-out designs, by a hash of the design's own numbers.

    The same design is held out in every dataset it appears in, however large, so a
    dataset can grow and be trained on again without a test design slipping in.

    Parameters
    ----------
    inputs : (n, d) array, SI
    """
    shares = []
    for row in inputs:
        # Ten digits: the same design must not change sides by a unit conversion.
        text = " ".join(f"{value:.9e}" for value in row)
        digest = hashlib.sha256(text.encode()).digest()
        shares.append(int.from_bytes(digest[:8], "big") / 2**64)
    return np.array(shares) < TEST_SHARE


def held_out(dataset: Dataset) -> Array:
    """(n,) bool.  Rows of designs that no training sees, with effects or without.

    The design alone decides: a path with an effect in it is held out where the same
    design without it is.
    """
    design = [i for i, name in enumerate(dataset.variables) if "." not in name]
    return is_test(dataset.inputs[:, design])


def usable(dataset: Dataset) -> Array:
    """(n,) bool.  Designs with at least one converged step."""
    return np.array([dataset.steps(i) > 0 for i in range(len(dataset))])


def training_rows(dataset: Dataset) -> Array:
    """(n,) int.  Rows that a base is trained on: usable, and not held out."""
    return np.flatnonzero(usable(dataset) & ~held_out(dataset))


def folds(designs: int, folds: int, repeats: int, seed: int) -> Array:
    """(repeats * folds, designs) bool: designs that each member must not see.

    Member (r, k) holds out fold k of partition r.  Every design is held out by
    `repeats` members, so that their mean and their disagreement on it are those of
    an ensemble that has not seen it.
    """
    rng = np.random.default_rng(seed)
    held = np.zeros((repeats, folds, designs), dtype=bool)
    for r in range(repeats):
        place = rng.permutation(np.arange(designs) % folds)
        held[r] = place[None, :] == np.arange(folds)[:, None]
    return held.reshape(repeats * folds, designs)


def folds_of(design: Array, count: int, repeats: int, seed: int) -> Array:
    """(repeats * count, n) bool: rows that each member must not see, as in `folds`.

    A design that comes twice is held out of the same members both times.

    Parameters
    ----------
    design : (n,) int array
        Which design each row is of.
    """
    place = {int(row): i for i, row in enumerate(dict.fromkeys(design.tolist()))}
    own = [place[int(row)] for row in design]
    held: Array = folds(len(place), count, repeats, seed)[:, own]
    return held
