"""Observed orders of convergence within 0.3 of theory."""

from __future__ import annotations

import pytest

from .convergence import THEORY, study


@pytest.mark.parametrize(
    ("name", "counts"), [("tube", (2, 4, 8)), ("sphere", (1, 2, 4))]
)
def test_orders(name: str, counts: tuple[int, ...]) -> None:
    found = study(name, counts)
    for quantity, order in THEORY.items():
        print(f"{name}, {quantity}: {found.orders[quantity]}, theory {order}")
    last = {quantity: orders[-1] for quantity, orders in found.orders.items()}
    assert last == pytest.approx(THEORY, abs=0.3)
