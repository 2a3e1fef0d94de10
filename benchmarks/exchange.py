"""What a peer is asked and what it answers: two files of plain arrays.

Peers run in processes of their own, FElupe's even in an environment of its own, so
this module needs numpy alone.  Elements have twenty nodes in the order that VTK,
FElupe and CalculiX share: corners of the lower face, of the upper face, middles of the
edges of the lower face, of the upper face, of the vertical edges.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

import numpy as np

Array = np.ndarray

FACES = (
    (0, 1, 2, 3),
    (4, 7, 6, 5),
    (0, 4, 5, 1),
    (1, 5, 6, 2),
    (2, 6, 7, 3),
    (3, 7, 4, 0),
)
"""Corners of an element's faces, in CalculiX's order: z-, z+, y-, x+, y+, x-."""

EDGES = (
    (0, 1),
    (1, 2),
    (2, 3),
    (3, 0),
    (4, 5),
    (5, 6),
    (6, 7),
    (7, 4),
    (0, 4),
    (1, 5),
    (2, 6),
    (3, 7),
)
"""Corners that the nodes 8 to 19 lie between."""

FACE_EDGES = tuple(
    tuple(8 + i for i, ends in enumerate(EDGES) if set(ends) <= set(face))
    for face in FACES
)
"""The four nodes on edges of each face."""

LENGTH, FORCE = 1e3, 1e6
"""Peers work in mm and uN, and so in Pa.

CalculiX takes a residual below 1e-6 for zero and FElupe adds 1e-3 to the force that it
divides residuals by, both whatever the units: in N and m every error would be small.
"""


@dataclass(frozen=True)
class Question:
    """One boundary-value problem on twenty-node hexahedra, SI.

    Parameters
    ----------
    nodes : (n, 3) array, m
    cells : (e, 20) array of int
    shear, bulk : (e,) array, Pa
        mu and K of W = mu/2 (I1bar - 3) + K/2 (J - 1)^2.
    fixed : (n, 3) array of bool
        Displacements that are held at zero.
    wet : (e, 6) array of bool
        Faces under pressure, in the order of `FACES`.
    pressure : (s,) array, Pa
        Increasing, applied one after the other.
    second : float
        C2/C1 of What = C1 (I1bar - 3) + C2 (I2bar - 3), mu = 2 (C1 + C2).
    inverse_limit : float
        1/Jm of What = -mu Jm/2 ln(1 - (I1bar - 3)/Jm); one of the two is 0.
    weight : float, N/m3
        Force along -z on the undeformed volume.
    """

    nodes: Array
    cells: Array
    shear: Array
    bulk: Array
    fixed: Array
    wet: Array
    pressure: Array
    second: float = 0.0
    inverse_limit: float = 0.0
    weight: float = 0.0

    @property
    def plain(self) -> bool:
        """Whether the law is the contract's, and pressure the only load."""
        return self.second == self.inverse_limit == self.weight == 0.0

    @property
    def unknowns(self) -> int:
        """Displacements that are free."""
        return int((~self.fixed).sum())

    def write(self, path: Path) -> None:
        np.savez(path, **{f.name: getattr(self, f.name) for f in fields(self)})

    @classmethod
    def read(cls, path: Path) -> Question:
        with np.load(path) as arrays:
            # [()] makes a number of an array without dimensions.
            return cls(**{f.name: arrays[f.name][()] for f in fields(cls)})


@dataclass(frozen=True)
class Cost:
    """What a path cost and what computed it.

    Parameters
    ----------
    seconds : float, s
        Wall time from the mesh to the last displacement, imports apart.
    processor : float, s
        The same in processor time: much less means that the core was shared.
    iterations, factorisations : int
        Of all load steps together.
    versions : dict of str to str
        Programs and libraries that took part.
    """

    seconds: float
    processor: float
    iterations: int
    factorisations: int
    unknowns: int
    versions: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Answer:
    """Displacements at each pressure.

    Parameters
    ----------
    displacement : (s, n, 3) array, m
    cost : Cost
    """

    displacement: Array
    cost: Cost

    def write(self, path: Path) -> None:
        np.savez(
            path, displacement=self.displacement, cost=json.dumps(asdict(self.cost))
        )

    @classmethod
    def read(cls, path: Path) -> Answer:
        with np.load(path) as arrays:
            cost = Cost(**json.loads(str(arrays["cost"])))
            return cls(arrays["displacement"], cost)
