"""Observed orders of convergence on meshes that are halved again and again.

Sphere and tube at nu = 0.48 under a fixed pressure, against the boundary-value problem
of the radius.  Theory for elements of second order: the displacements converge with
order 3 in the L2 norm, their gradients with order 2, and the cavity's volume, which is
the pressure's work conjugate, with order 4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from datagen import elements as el
from datagen.continuation import PathFollower
from datagen.mesh import reference
from datagen.problem import Body

from . import bodies
from . import closed_forms as exact
from .benchmarks import SOFT

Array = np.ndarray

THEORY = {"volume": 4.0, "displacement": 3.0, "gradient": 2.0}
RATIO = 1.5


@dataclass(frozen=True)
class Study:
    """Relative errors of each quantity on meshes of 1, 2, 4 ... elements.

    orders : dict of quantity to log2 of each mesh's error over the next one's.
    """

    name: str
    counts: tuple[int, ...]
    unknowns: tuple[int, ...]
    errors: dict[str, tuple[float, ...]]

    @property
    def orders(self) -> dict[str, tuple[float, ...]]:
        return {
            name: tuple(np.log2(e[:-1] / e[1:]).tolist())
            for name, errors in self.errors.items()
            for e in [np.array(errors)]
        }


def _errors(body: Body, dimension: int, la: float) -> tuple[dict[str, float], int]:
    """Errors of one mesh at the pressure where the exact inner stretch is `la`."""
    pressure, radius = exact.radial(la, RATIO, dimension, SOFT)
    follower = PathFollower(body)
    outcome = follower.run(np.array([pressure]))
    assert outcome.status == "completed", outcome.message
    x, data = follower.point.x, follower.equations.data
    shape, cells = reference().shape, body.mesh.cells
    at = np.einsum("qa,eai->eqi", shape, body.nodes[cells])
    moved = np.einsum("qa,eai->eqi", shape, x[cells])
    f = el.deformation(x, cells, reference().gradient, data.inverse)
    f = f.reshape(*at.shape, 3)

    # Outside the axis of symmetry nothing moves along it: plane strain.
    flat = at * (np.arange(3) < dimension)
    big = np.linalg.norm(flat, axis=2)
    r, slope = radius(np.clip(big, 1.0, RATIO))
    normal = flat / big[..., None]
    along = np.einsum("eqi,eqj->eqij", normal, normal)
    inside = np.diag((np.arange(3) < dimension).astype(float))
    hoop = (r / big)[..., None, None]
    f_exact = slope[..., None, None] * along + hoop * (inside - along)
    f_exact = f_exact + (np.eye(3) - inside)
    u_exact = (r - big)[..., None] * normal

    def norm(field: Array) -> float:
        square = (field.reshape(*data.weight.shape, -1) ** 2).sum(axis=2)
        return float(np.sqrt((square * data.weight).sum()))

    depth = body.nodes[:, 2].max()
    whole = np.pi / 6 * la**3 if dimension == 3 else np.pi / 4 * la**2 * depth
    return {
        "volume": abs(follower.point.volume / whole - 1),
        "displacement": norm(moved - at - u_exact) / norm(u_exact),
        "gradient": norm(f - f_exact) / norm(f_exact - np.eye(3)),
    }, follower.equations.unknowns


@cache
def study(name: str, counts: tuple[int, ...]) -> Study:
    """Halve the elements of one body: `counts` through the wall and along 45 degrees.

    name : ``sphere`` (at inner stretch 1.3) or ``tube`` (1.5).
    """
    build: Callable[[int], Body]
    if name == "sphere":
        dimension, la = 3, 1.3
        build = lambda n: bodies.sphere(RATIO, n, n, SOFT)  # noqa: E731
    else:
        dimension, la = 2, 1.5
        build = lambda n: bodies.tube(RATIO, n, 2 * n, SOFT)  # noqa: E731
    results = [_errors(build(n), dimension, la) for n in counts]
    return Study(
        name=name,
        counts=counts,
        unknowns=tuple(unknowns for _, unknowns in results),
        errors={key: tuple(errors[key] for errors, _ in results) for key in THEORY},
    )
