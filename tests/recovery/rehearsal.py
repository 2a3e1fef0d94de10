"""A study whose solves are answered from curves that are known already.

The search is the real one: it asks for derivatives where effects are off, for solves
at best fits, and refines.  What it gets comes from the interpolated curves of a lab,
so that thousands of rankings cost no finite elements.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from discrepancy.noise import Readings
from discrepancy.study import Node, Study

Array = np.ndarray


class Rehearsal(Study):
    """The readings of a study, with nothing solved of any effect yet.

    Made by `of`; counts what the search asks for in `asked`, curves not counted.
    """

    source: Study
    asked: int

    @classmethod
    def of(cls, source: Study, readings: Readings) -> Rehearsal:
        """Other readings of the same curves, to be explained from the beginning."""
        found = object.__new__(cls)
        found.__dict__.update(source.with_readings(readings).__dict__)
        found.source, found.asked = source, 0
        found._nodes = {((), ()): source._nodes[(), ()]}
        found._present = {}
        return found

    def _answer(self, names: tuple[str, ...], t: Array) -> Node:
        present = self.source.present(names)
        if present is None:
            nowhere = np.full(len(self.cells), np.nan)
            slopes = np.full((len(self.cells), len(t)), np.nan)
            return Node(nowhere, slopes, self._nodes[(), ()].fields, ("not known",))
        fields = present.fields.many(t[None, :])[0].reshape(len(self.cells), -1)
        at = present.predict(t)
        return Node(at.values - present.shift, at.slopes, fields, ())

    def solve(
        self, wanted: Sequence[tuple[tuple[str, ...], Array]], what: str
    ) -> list[Node | None]:
        found: list[Node | None] = []
        for names, t in wanted:
            key = (tuple(names), tuple(float(x) for x in t))
            if key not in self._nodes:
                self._nodes[key] = self._answer(tuple(names), np.array(key[1]))
                self.asked += 1
            node = self._nodes[key]
            found.append(node if np.isfinite(node.values).all() else None)
        return found

    def tangents(self, names: Sequence[str]) -> list[str]:
        ready = self.source.tangents(names)
        for name in ready:
            off = tuple(p.off for p in self.priors((name,)))
            self._nodes[(name,), off] = self.source._nodes[(name,), off]
        self.asked += 1
        return ready

    def _on_curves(self, spots: Mapping[str, tuple[int, Array]]) -> dict[str, Array]:
        return {
            name: self._answer((name,), t).values[self._of(curve)]
            for name, (curve, t) in spots.items()
        }
