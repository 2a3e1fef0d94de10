"""Selection among models whose truth is known: the table of docs/rank.md.

Run by ``python docs/measure.py known``, or alone as ``python -m docs.known``; minutes.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor

from tests.discrepancy.known import TRUE_POWERS, Selected, ball, machine, support

SETS = 200
SURE = 0.99


def two(words: str, case: Callable[[int], Selected], run: Callable[..., object]) -> str:
    """The row of a case with two models."""
    found: list[Selected] = list(run(case, range(SETS)))  # type: ignore[call-overload]
    right = sum(one.probability > SURE for one in found)
    covered = sum(one.covered for one in found)
    naive = sum(one.naive for one in found) / SETS
    return f"| {words} | {right} of {SETS} | {covered} of {SETS} | {naive:.2f} |"


def main() -> None:
    """Print the table."""
    print("| case | right | its parameter in the 90 % interval | without the term |")
    print("| --- | --- | --- | --- |")
    with ProcessPoolExecutor() as pool:
        print(two("ball dropped through air: drag, g = 9.8", ball, pool.map))
        print(two("simple machine: loss, efficiency 0.65", machine, pool.map))
        found = list(pool.map(support, range(SETS), chunksize=5))
    right = sum(one == TRUE_POWERS for one in found)
    print(f"| polynomial: exactly the powers 1, 2, 3 | {right} of {SETS} | | |")


if __name__ == "__main__":
    main()
