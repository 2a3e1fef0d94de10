"""Designs, never load steps, are what is split."""

from __future__ import annotations

import numpy as np

from datagen.device import DESIGN_SPACE, Design
from surrogate.split import TEST_SHARE, folds, folds_of, is_test


def test_held_out_designs_stay_held_out() -> None:
    inputs = DESIGN_SPACE.sample(2000, 0)
    held = is_test(inputs)
    assert abs(held.mean() - TEST_SHARE) < 0.03
    order = np.random.default_rng(0).permutation(2000)
    np.testing.assert_array_equal(is_test(inputs[order][:500]), held[order][:500])


def test_a_round_trip_through_a_design_does_not_change_sides() -> None:
    inputs = DESIGN_SPACE.sample(300, 1)
    back = []
    for row in inputs:
        values = dict(zip(DESIGN_SPACE.names, map(float, row), strict=True))
        back.append(list(Design.from_sample(values).sampled().values()))
    assert (np.array(back) != inputs).any()
    np.testing.assert_array_equal(is_test(np.array(back)), is_test(inputs))


def test_every_design_is_unseen_by_as_many_members() -> None:
    held = folds(103, folds=5, repeats=3, seed=2)
    assert held.shape == (15, 103)
    np.testing.assert_array_equal(held.sum(axis=0), 3)
    assert held.sum(axis=1).min() >= 20
    assert (held[:5] != held[5:10]).any()
    np.testing.assert_array_equal(held, folds(103, 5, 3, 2))
    assert (held != folds(103, 5, 3, 3)).any()


def test_a_design_that_comes_twice_is_unseen_both_times() -> None:
    once = np.array([7, 3, 9, 1, 5, 2])
    np.testing.assert_array_equal(folds_of(once, 3, 2, 4), folds(6, 3, 2, 4))
    twice = np.array([7, 3, 9, 3, 1, 7, 5, 2])
    held = folds_of(twice, 3, 2, 4)
    assert held.shape == (6, 8)
    np.testing.assert_array_equal(held[:, 1], held[:, 3])
    np.testing.assert_array_equal(held[:, 0], held[:, 5])
    np.testing.assert_array_equal(held.sum(axis=0), 2)
