"""The converged answer: its error bars hold what they are made of."""

from __future__ import annotations

import numpy as np
import pytest

from docs.refine import (
    PAGE,
    PRESSURES,
    QUANTITIES,
    extrapolated,
    known,
    name_of,
    page,
    settled,
)


@pytest.mark.parametrize("quantity", QUANTITIES.values())
@pytest.mark.parametrize("case", [1, 2, 3, 4])
def test_the_bars_hold_both_families(case: int, quantity: str) -> None:
    runs = known()
    value, bar = settled(runs, case, quantity)
    limits, own = extrapolated(runs, case, quantity)
    assert limits.shape == (2, len(PRESSURES))
    assert (np.abs(limits - value) <= bar * (1 + 1e-9)).all()
    assert (bar >= np.abs(limits[1] - limits[0]) / 2).all()
    assert bar.min() > 0.5 * own.min()


def test_families_that_agree_have_the_bar_of_their_extrapolation() -> None:
    """Errors of 4, 2 and 1 um in both: extrapolated by the last change, 1 um."""
    runs = {
        name_of(1, family, mesh): {"tip": [10.0 + error] * len(PRESSURES)}
        for family in ("mixed", "displacement")
        for mesh, error in (("1", 4.0), ("2", 2.0), ("3", 1.0))
    }
    value, bar = settled(runs, 1, "tip")
    assert value == pytest.approx(10.0)
    assert bar == pytest.approx(1 / np.sqrt(2))


def test_the_page_is_that_of_the_runs() -> None:
    assert page(known()) == PAGE.read_text()
