"""From deformed nodes to the quantities of the contract."""

from __future__ import annotations

import numpy as np

from .mesh import StripMesh
from .problem import Problem
from .response import OUTPUT_NAMES

Array = np.ndarray

_SAMPLES = 8
"""Points on each element of a line of nodes."""


def _curve(points: Array) -> tuple[Array, Array, Array]:
    """Points, derivatives and element positions along a quadratic line of nodes.

    Parameters
    ----------
    points : (2 c + 1, 2) array, m
        x and z of the nodes of c elements.

    Returns
    -------
    position, slope : (8 c + 1, 2) arrays; parameter : (8 c + 1,) array in elements
    """
    cells = (len(points) - 1) // 2
    t = np.arange(_SAMPLES * cells + 1) / _SAMPLES
    cell = np.minimum(t.astype(int), cells - 1)
    s = t - cell
    left, mid, right = points[2 * cell], points[2 * cell + 1], points[2 * cell + 2]
    s = s[:, None]
    position = (
        (1 - s) * (1 - 2 * s) * left + 4 * s * (1 - s) * mid + s * (2 * s - 1) * right
    )
    slope = (4 * s - 3) * left + (4 - 8 * s) * mid + (4 * s - 1) * right
    return position, slope, t


def _rise(edge: Array, middle: Array, side: float) -> float:
    """Largest distance of one line from another, along the other's normals.

    Parameters
    ----------
    edge, middle : (k, 2) arrays, m
        x and z of the nodes of both lines, deformed.
    side : float
        +1 for distances towards +z, -1 towards -z.
    """
    base, slope, _ = _curve(edge)
    line, _, _ = _curve(middle)
    tangent = slope / np.linalg.norm(slope, axis=1, keepdims=True)
    normal = side * np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    # In each normal's own frame the middle line crosses the axis where its
    # tangential coordinate changes sign; of several crossings take the nearest to
    # the point's own material neighbour, as the lines run side by side.
    along = (
        np.einsum("bi,mi->bm", tangent, line) - np.sum(tangent * base, axis=1)[:, None]
    )
    above = (
        np.einsum("bi,mi->bm", normal, line) - np.sum(normal * base, axis=1)[:, None]
    )
    crosses = (along[:, :-1] <= 0) & (along[:, 1:] > 0)
    own = np.arange(len(base))[:, None]
    steps = np.where(crosses, np.abs(np.arange(crosses.shape[1])[None] - own), 10**9)
    at = steps.argmin(axis=1)
    rows = np.nonzero(crosses.any(axis=1))[0]
    at = at[rows]
    a0, a1 = along[rows, at], along[rows, at + 1]
    share = -a0 / (a1 - a0)
    height = above[rows, at] * (1 - share) + above[rows, at + 1] * share
    best = int(height.argmax())
    if 0 < best < len(height) - 1:  # parabola through the top three samples
        before, top, after = height[best - 1 : best + 2]
        bend = before - 2 * top + after
        if bend < 0:
            return float(top - (before - after) ** 2 / (8 * bend))
    return float(height[best])


def _tip_angle(mesh: StripMesh, nodes: Array, x: Array, start: float) -> float:
    """Direction of the total-least-squares line through the strip's free end, rad.

    Parameters
    ----------
    nodes, x : (n, 3) arrays, m
        Undeformed and deformed.
    start : float, m
        Undeformed x from which the line is fitted, to the tip.
    """
    row = mesh.lines["bottom"]
    reference, _, _ = _curve(nodes[row][:, [0, 2]])
    deformed, slope, _ = _curve(x[row][:, [0, 2]])
    along = reference[:, 0]
    # Evenly spread over the fitted stretch, so that the mesh's grading has no say.
    spots = np.linspace(start, along[-1], 41)
    points = np.stack([np.interp(spots, along, deformed[:, i]) for i in (0, 1)], axis=1)
    centred = points - points.mean(axis=0)
    direction = np.linalg.svd(centred, full_matrices=False)[2][0]
    if direction @ (points[-1] - points[0]) < 0:
        direction = -direction
    angle = float(np.arctan2(direction[1], direction[0]))
    # Beyond half a turn the line alone does not tell; the turns of the strip do.
    turned = np.unwrap(np.arctan2(slope[:, 1], slope[:, 0]))
    mean = float(np.interp(spots, along, turned).mean())
    return angle + 2 * np.pi * round((mean - angle) / (2 * np.pi))


def observe(problem: Problem, x: Array, volume_change: float) -> Array:
    """Outputs of one equilibrium.

    Parameters
    ----------
    problem : Problem
    x : (n, 3) array, m
        Deformed node positions.
    volume_change : float, m3
        Of the cavities in the half model.

    Returns
    -------
    (m,) array, SI, in the order of `OUTPUT_NAMES`
    """
    mesh, nodes, design = problem.mesh, problem.nodes, problem.design

    def plane(field: Array, name: str) -> Array:
        rows: Array = field[mesh.lines[name]]
        return rows[:, [0, 2]]

    def rise(name: str, side: float) -> float:
        deformed = _rise(plane(x, f"{name}_edge"), plane(x, f"{name}_middle"), side)
        at_rest = _rise(
            plane(nodes, f"{name}_edge"), plane(nodes, f"{name}_middle"), side
        )
        return deformed - at_rest

    end = design.balloon_start + design.span_x
    start = end + 0.25 * (design.length - end)
    angle = _tip_angle(mesh, nodes, x, start) - _tip_angle(mesh, nodes, nodes, start)
    values = {
        "tip_deflection": float(mesh.tip_weights @ (x - nodes)[mesh.tip, 2]),
        "bending_angle": angle,
        "inflation": rise("roof", 1.0),
        "inflation_lower": rise("floor", -1.0),
        "cavity_volume": 2 * volume_change,
    }
    for observer in problem.observers:
        values = observer(values, nodes, x)
    return np.array([values[name] for name in OUTPUT_NAMES])
