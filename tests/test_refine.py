"""The converged answer: its error bars hold what they are made of."""

from __future__ import annotations

import numpy as np
import pytest

from docs.refine import (
    ORDERS,
    PAGE,
    PRESSURES,
    QUANTITIES,
    SETTLING,
    extrapolated,
    known,
    name_of,
    observed,
    page,
    settled,
)


@pytest.mark.parametrize("quantity", QUANTITIES.values())
@pytest.mark.parametrize("case", [1, 2, 3, 4])
def test_the_bars_hold_the_families_that_settle_it(case: int, quantity: str) -> None:
    runs = known()
    value, bar = settled(runs, case, quantity)
    limits, own = extrapolated(runs, case, quantity, SETTLING)
    assert limits.shape == (2, len(PRESSURES))
    assert (np.abs(limits - value) <= bar * (1 + 1e-9)).all()
    assert (bar >= np.abs(limits[1] - limits[0]) / 2).all()
    assert bar.min() > 0.5 * own.min()


def test_families_that_agree_have_the_bar_of_their_extrapolation() -> None:
    """Errors that halve with the elements: extrapolated by the last change, 1 um."""
    runs = {
        name_of(1, family, mesh): {
            "tip": [10.0 + error] * len(PRESSURES),
            "unknowns": unknowns,
        }
        for family in SETTLING
        for mesh, error, unknowns in (("1", 4.0, 1), ("2", 2.0, 8), ("3", 1.0, 64))
    }
    value, bar = settled(runs, 1, "tip")
    assert value == pytest.approx(10.0)
    assert bar == pytest.approx(1 / np.sqrt(2))


@pytest.mark.parametrize("order", [1.0, 1.6, 2.0])
def test_the_order_of_uneven_refinement_is_found(order: float) -> None:
    sizes = np.array([1.0, 0.66, 0.5])
    changes = -np.diff(sizes**order)
    assert observed(sizes, changes[0] / changes[1]) == pytest.approx(order)
    for steeper, ratio in ((0.2, ORDERS[0]), (9.0, ORDERS[1])):
        changes = -np.diff(sizes**steeper)
        assert observed(sizes, changes[0] / changes[1]) == ratio


def test_the_page_is_that_of_the_runs() -> None:
    assert page(known()) == PAGE.read_text()
