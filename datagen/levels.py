"""Mesh levels: how finely a strip is cut, by name, and what earlier ones were."""

from __future__ import annotations

from dataclasses import dataclass, replace

from .errors import InputError


@dataclass(frozen=True)
class MeshLevel:
    """How finely the strip is cut; counts are elements between two grid features.

    Parameters
    ----------
    balloon_x, balloon_y : int
        Elements along half an undivided balloon's length and half its width; a
        divided one has fewer, see `along` and `across`.
    root, tip, rim : int
        Elements from the clamp to the first balloon, from the last balloon to the
        tip, and across the rim.
    wall : int
        Elements across a wall between two balloons; half of them, rounded up, across
        the half wall at the mid-plane.
    membrane, spacer : int
        Elements through each membrane and through the spacer.
    edge_x, edge_y : float
        Size of the element at a balloon's edge over the thinner membrane's thickness.
    edge_z : float
        Size of the element at the cavity over that of equal ones in the membrane.
    edge_root : float
        Size of the element at the clamp over the thinner membrane's thickness; 0 where
        the elements grow from the first balloon all the way to the clamp.
    edge_divided : float
        Factor on `edge_x` and `edge_y` where the strip has more than one balloon:
        their middles are near, and its tip feels every edge.
    """

    name: str
    balloon_x: int
    balloon_y: int
    root: int
    tip: int
    rim: int
    wall: int
    membrane: int
    spacer: int
    edge_x: float
    edge_y: float
    edge_z: float
    edge_root: float
    edge_divided: float = 1.0

    def along(self, divisions: int) -> int:
        """Elements along half of one of `divisions` balloons."""
        return self._share(self.balloon_x, divisions)

    def across(self, divisions: int) -> int:
        """Elements across half of one of `divisions` balloons."""
        return self._share(self.balloon_y, divisions)

    def _share(self, count: int, divisions: int) -> int:
        """Shorter balloons need fewer elements, but not many fewer."""
        return count if divisions == 1 else max(count - divisions, count // 2 + 1)


LEVELS: dict[str, MeshLevel] = {
    level.name: level
    for level in (
        MeshLevel("draft", 4, 4, 3, 2, 2, 2, 1, 1, 0.85, 0.6, 1.0, 2.0),
        MeshLevel("standard", 5, 5, 4, 3, 3, 3, 2, 1, 1.2, 0.7, 0.67, 2.0, 0.44),
        MeshLevel("fine", 9, 6, 7, 4, 5, 4, 3, 2, 0.35, 0.35, 0.6, 0.35),
    )
}

FORMER: dict[str, MeshLevel] = {
    level.name: level
    for level in (
        MeshLevel("standard-1", 6, 4, 3, 2, 2, 1, 2, 1, 0.85, 0.7, 1.0, 0.0),
        MeshLevel("draft-4", 4, 4, 3, 3, 2, 1, 1, 1, 1.0, 0.85, 1.0, 2.0),
        MeshLevel("standard-4", 5, 4, 4, 3, 3, 1, 2, 1, 1.3, 0.9, 0.8, 2.0),
        replace(LEVELS["draft"], name="draft-5", wall=1),
        MeshLevel("standard-5", 5, 4, 4, 3, 3, 1, 2, 1, 1.3, 0.9, 0.8, 2.0),
        replace(LEVELS["fine"], name="fine-5", wall=2),
        replace(LEVELS["draft"], name="draft-6"),
        MeshLevel("standard-6", 5, 4, 4, 3, 3, 3, 2, 1, 1.3, 0.9, 0.8, 2.0, 0.5),
        replace(LEVELS["fine"], name="fine-6"),
    )
}
"""Levels of earlier generator versions, by which their datasets are solved again."""


SKETCH = MeshLevel("sketch", 3, 3, 2, 2, 2, 1, 1, 1, 1.0, 1.0, 1.0, 2.0)
"""Below draft: not an answer, only what others are compared with."""

COARSER: dict[str, MeshLevel] = {
    "draft": SKETCH,
    "standard": SKETCH,
    "fine": LEVELS["standard"],
}
"""The mesh that each level is compared with to estimate its error.

Draft and standard differ in different places, and may agree where both are wrong: with
draft for standard the difference was down to a sixth of the error.
"""


def mesh_level(name: str) -> MeshLevel:
    """A mesh level by name, or an `InputError` naming those there are."""
    if name not in LEVELS | FORMER:
        raise InputError("level", name, ", ".join(LEVELS))
    return (LEVELS | FORMER)[name]
