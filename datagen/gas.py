"""Gas in elements that are emptied in part: a cavity without faces of its own.

Filled with gas of the pressure p an element has the potential -p share int J dV.  Next
to each other, and beside the faces of a cavity, such elements leave a force on the
solid's walls alone: the forces on a face they share cancel.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from .elements import cofactor

Array = np.ndarray


@njit(cache=True, fastmath=True)
def gas_volume(
    f: Array,
    filled: Array,
    share: Array,
    nodes: int,
    cells: Array,
    gradient: Array,
    inverse: Array,
    weight: Array,
) -> tuple[float, Array]:
    """Volume of gas in elements, the sum of share times the integral of J.

    Under the pressure p it has the potential -p V, as a cavity; in the tangent it is
    a pressure -p share in the elements' own field.

    Parameters
    ----------
    f : (27 g, 9) array
        Deformation gradients of the filled elements alone.
    filled : (g,) array of int
        Their numbers.
    share : (g,) array
        What of each of them is gas.
    nodes, cells, gradient, inverse, weight
        As in `internal_force`, of all elements.

    Returns
    -------
    volume : float, m3
    gradient : (nodes, 3) array, m2
    """
    out = np.zeros((nodes, 3))
    volume = 0.0
    cof, s = np.empty(9), np.empty(9)
    for g in range(filled.shape[0]):
        e = filled[g]
        for q in range(27):
            det = cofactor(f[27 * g + q], cof)
            w = share[g] * weight[e, q]
            volume += w * det
            d = inverse[e, q]
            for i in range(3):
                for j in range(3):
                    s[3 * i + j] = w * (
                        cof[3 * i] * d[3 * j]
                        + cof[3 * i + 1] * d[3 * j + 1]
                        + cof[3 * i + 2] * d[3 * j + 2]
                    )
            for a in range(27):
                for i in range(3):
                    for j in range(3):
                        out[cells[e, a], i] += s[3 * i + j] * gradient[q, a, j]
    return volume, out
