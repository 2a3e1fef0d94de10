"""From deformed nodes to the quantities of the contract."""

from __future__ import annotations

import numpy as np
from numba import njit

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


@njit(cache=True)
def _heights(base: Array, tangent: Array, line: Array, side: float) -> Array:
    """Distance of a line from each of some points along the normals there.

    In each normal's own frame the line crosses the axis where its tangential
    coordinate changes sign; of several crossings the nearest to the point's own
    material neighbour counts, as the lines run side by side.

    Parameters
    ----------
    base, tangent : (k, 2) arrays, m and 1
    line : (k, 2) array, m
    side : float
        +1 or -1, see `_rise`.

    Returns
    -------
    (k,) array, m; NaN where the line does not cross the normal.
    """
    count = len(base)
    height = np.full(count, np.nan)
    for i in range(count):
        tx, tz = tangent[i, 0], tangent[i, 1]
        bx, bz = base[i, 0], base[i, 1]
        for away in range(count):
            found = -1
            for j in (i - away, i + away):
                if 0 <= j < count - 1:
                    a0 = tx * (line[j, 0] - bx) + tz * (line[j, 1] - bz)
                    a1 = tx * (line[j + 1, 0] - bx) + tz * (line[j + 1, 1] - bz)
                    if a0 <= 0 < a1:
                        found = j
                        break
            if found >= 0:
                share = -a0 / (a1 - a0)
                px = line[found, 0] * (1 - share) + line[found + 1, 0] * share - bx
                pz = line[found, 1] * (1 - share) + line[found + 1, 1] * share - bz
                height[i] = side * (tx * pz - tz * px)
                break
    return height


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
    height = _heights(base, tangent, line, side)
    height = height[np.isfinite(height)]
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


class Instruments:
    """What is measured on one problem's device, counted from its datum.

    The change of the cavity's volume alone counts from rest, as a flow meter does.

    Parameters
    ----------
    problem : Problem
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        design = problem.design
        end = design.balloon_start + design.span_x
        self._fitted_from = end + 0.25 * (design.length - end)
        self._at_rest = self._shape(problem.counted_from)

    def _shape(self, x: Array) -> Array:
        """Angle (rad), rise of the roof and descent of the floor (m) of some nodes."""
        mesh = self.problem.mesh

        def plane(name: str) -> Array:
            rows: Array = x[mesh.lines[name]]
            return rows[:, [0, 2]]

        return np.array(
            [
                _tip_angle(mesh, self.problem.counted_from, x, self._fitted_from),
                _rise(plane("roof_edge"), plane("roof_middle"), 1.0),
                _rise(plane("floor_edge"), plane("floor_middle"), -1.0),
            ]
        )

    def read(self, x: Array, volume_change: float) -> Array:
        """Outputs of one equilibrium.

        Parameters
        ----------
        x : (n, 3) array, m
            Deformed node positions.
        volume_change : float, m3
            Of the cavities in the half model.

        Returns
        -------
        (m,) array, SI, in the order of `OUTPUT_NAMES`
        """
        mesh, datum = self.problem.mesh, self.problem.counted_from
        angle, up, down = self._shape(x) - self._at_rest
        values = {
            "tip_deflection": float(mesh.tip_weights @ (x - datum)[mesh.tip, 2]),
            "bending_angle": float(angle),
            "inflation": float(up),
            "inflation_lower": float(down),
            "cavity_volume": 2 * volume_change,
        }
        for observer in self.problem.observers:
            values = observer(values, datum, x)
        return np.array([values[name] for name in OUTPUT_NAMES])


def observe(problem: Problem, x: Array, volume_change: float) -> Array:
    """Outputs of one equilibrium, see `Instruments.read`."""
    return Instruments(problem).read(x, volume_change)
