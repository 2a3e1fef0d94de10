"""From deformed nodes to the quantities of the contract."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit

from .mesh import StripMesh
from .problem import Problem
from .response import OUTPUT_NAMES

Array = np.ndarray

_SAMPLES = 8
"""Points on each element of a line of nodes."""


@lru_cache(maxsize=16)
def _weights(nodes: int) -> tuple[Array, Array]:
    """What samples of a quadratic line of nodes and its derivatives are made of.

    Parameters
    ----------
    nodes : int
        2 c + 1 nodes of c elements.

    Returns
    -------
    position, slope : (8 c + 1, 2 c + 1) arrays
        Times the nodes' coordinates: those of the samples, and their derivatives by the
        place along an element.
    """
    cells = (nodes - 1) // 2
    t = np.arange(_SAMPLES * cells + 1) / _SAMPLES
    cell = np.minimum(t.astype(int), cells - 1)
    s = t - cell
    position, slope = np.zeros((len(t), nodes)), np.zeros((len(t), nodes))
    rows = np.arange(len(t))
    for k, (value, rate) in enumerate(
        (
            ((1 - s) * (1 - 2 * s), 4 * s - 3),
            (4 * s * (1 - s), 4 - 8 * s),
            (s * (2 * s - 1), 4 * s - 1),
        )
    ):
        position[rows, 2 * cell + k] = value
        slope[rows, 2 * cell + k] = rate
    return position, slope


def _curve(points: Array) -> tuple[Array, Array]:
    """Samples along a quadratic line of nodes, and the line's derivatives there.

    Parameters
    ----------
    points : (2 c + 1, 2) array, m
        x and z of the nodes of c elements.

    Returns
    -------
    position, slope : (8 c + 1, 2) arrays
    """
    position, slope = _weights(len(points))
    return position @ points, slope @ points


@njit(cache=True)
def _heights(
    base: Array, tangent: Array, line: Array, side: float
) -> tuple[Array, Array]:
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
    height : (k,) array, m
        NaN where the line does not cross the normal.
    crossed : (k,) array of int
        Point of the line before the crossing, -1 for none.
    """
    count = len(base)
    height = np.full(count, np.nan)
    crossed = np.full(count, -1)
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
                crossed[i] = found
                break
    return height, crossed


def _rise(edge: Array, middle: Array, side: float) -> float:
    """Largest distance of one line from another, along the other's normals.

    Parameters
    ----------
    edge, middle : (k, 2) arrays, m
        x and z of the nodes of both lines, deformed.
    side : float
        +1 for distances towards +z, -1 towards -z.
    """
    return _highest(edge, middle, side)[0]


def _highest(
    edge: Array, middle: Array, side: float
) -> tuple[float, list[tuple[int, float]], Array]:
    """The largest distance, the samples it is made of with weights, and crossings."""
    base, slope = _curve(edge)
    line, _ = _curve(middle)
    tangent = slope / np.linalg.norm(slope, axis=1, keepdims=True)
    height, crossed = _heights(base, tangent, line, side)
    there = np.flatnonzero(np.isfinite(height))
    best = int(height[there].argmax())
    if 0 < best < len(there) - 1:  # parabola through the top three samples
        before, top, after = height[there[best - 1 : best + 2]]
        bend = before - 2 * top + after
        if bend < 0:
            tilt = (before - after) / (4 * bend)
            shares = (2 * tilt**2 - tilt, 1 - 4 * tilt**2, 2 * tilt**2 + tilt)
            found = [
                (int(there[best + k - 1]), float(share))
                for k, share in enumerate(shares)
            ]
            return float(top - tilt * (before - after) / 2), found, crossed
    return float(height[there[best]]), [(int(there[best]), 1.0)], crossed


def _rise_gradient(edge: Array, middle: Array, side: float) -> tuple[Array, Array]:
    """Derivatives of `_rise` by the nodes of both lines, arrays of their shapes.

    With the unit tangent t, the normal n, the base b and the crossing p - b of the
    segment from l to l + e at its share s, a distance is h = n . (p - b), and
    t . (p - b) = 0 gives the share: with m = n - t (n . e)/(t . e)

        dh = m . (dl + s de - db) + (p_z, -p_x) . dt - (n . e)/(t . e) p . dt.
    """
    position, slope_of = _weights(len(edge))
    base, slope = _curve(edge)
    line, _ = _curve(middle)
    by_base, by_slope, by_line = (np.zeros_like(base) for _ in range(3))
    _, samples, crossed = _highest(edge, middle, side)
    for i, share in samples:
        j, length = crossed[i], np.linalg.norm(slope[i])
        t = slope[i] / length
        n = np.array([-t[1], t[0]])
        e, off = line[j + 1] - line[j], line[j] - base[i]
        s = -(t @ off) / (t @ e)
        p, lean = off + s * e, (n @ e) / (t @ e)
        m = side * share * (n - lean * t)
        by_base[i] -= m
        by_line[j] += (1 - s) * m
        by_line[j + 1] += s * m
        by_tangent = side * share * (np.array([p[1], -p[0]]) - lean * p)
        by_slope[i] += (by_tangent - (by_tangent @ t) * t) / length
    return position.T @ by_base + slope_of.T @ by_slope, position.T @ by_line


def _tip_angle(mesh: StripMesh, nodes: Array, x: Array, start: float) -> float:
    """Direction of the total-least-squares line through the strip's free end, rad.

    Parameters
    ----------
    nodes, x : (n, 3) arrays, m
        Undeformed and deformed.
    start : float, m
        Undeformed x from which the line is fitted, to the tip.
    """
    spots, points = _free_end(mesh, nodes, x, start)
    centred = points - points.mean(axis=0)
    direction = np.linalg.svd(centred, full_matrices=False)[2][0]
    if direction @ (points[-1] - points[0]) < 0:
        direction = -direction
    angle = float(np.arctan2(direction[1], direction[0]))
    # Beyond half a turn the line alone does not tell; the turns of the strip do, along
    # its side: under a wall between balloons the bottom may fold, and go backwards.
    _, slope = _curve(x[mesh.lines["rim"]][:, [0, 2]])
    turned = np.unwrap(np.arctan2(slope[:, 1], slope[:, 0]))
    mean = float((spots @ turned).mean())
    return angle + 2 * np.pi * round((mean - angle) / (2 * np.pi))


def _free_end(
    mesh: StripMesh, nodes: Array, x: Array, start: float
) -> tuple[Array, Array]:
    """Points evenly spread over the fitted stretch, so that the mesh has no say.

    Returns
    -------
    spots : (41, 8 c + 1) array
        Times samples of a line of nodes along x: values at the points.
    points : (41, 2) array, m
        x and z, deformed.
    """
    row = mesh.lines["bottom"]
    along = _curve(nodes[row][:, [0, 2]])[0][:, 0]
    deformed, _ = _curve(x[row][:, [0, 2]])
    where = np.linspace(start, along[-1], 41)
    right = np.clip(np.searchsorted(along, where), 1, len(along) - 1)
    share = (where - along[right - 1]) / (along[right] - along[right - 1])
    spots = np.zeros((len(where), len(along)))
    spots[np.arange(41), right - 1], spots[np.arange(41), right] = 1 - share, share
    return spots, spots @ deformed


def _tip_angle_gradient(mesh: StripMesh, nodes: Array, x: Array, start: float) -> Array:
    """Derivatives of `_tip_angle` by x and z of the bottom line's nodes, (2 c + 1, 2).

    The line of total least squares has the angle atan2(2 Sxz, Sxx - Szz) / 2, with S
    the sums of products of the centred points.
    """
    spots, points = _free_end(mesh, nodes, x, start)
    cx, cz = (points - points.mean(axis=0)).T
    across, along = cx @ cz, cx @ cx - cz @ cz
    by_point = np.stack(
        [along * cz - 2 * across * cx, along * cx + 2 * across * cz], axis=1
    ) / (along**2 + 4 * across**2)
    position, _ = _weights(len(mesh.lines["bottom"]))
    gradient: Array = position.T @ (spots.T @ by_point)
    return gradient


class Instruments:
    """What is measured on one problem's device, counted from its datum.

    The change of the cavity's volume alone counts from the body without stress.

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

    def flat(self, x: Array) -> bool:
        """Whether roof or floor of deformed nodes x (n, 3), m, have hardly risen."""
        _, up, down = np.abs(self._shape(x))
        return bool(min(up, down) < 1e-6 * self.problem.thin)

    def gradients(self, x: Array) -> dict[str, Array]:
        """Derivatives of the outputs by the deformed nodes, before any observer.

        Parameters
        ----------
        x : (n, 3) array, m

        Returns
        -------
        dict of output to (n, 3) array, SI
            All but the cavity volume, which the solver knows.
        """
        mesh, datum = self.problem.mesh, self.problem.counted_from
        found = {name: np.zeros(x.shape) for name in OUTPUT_NAMES[:4]}
        found["tip_deflection"][mesh.tip, 2] = mesh.tip_weights
        found["bending_angle"][mesh.lines["bottom"][:, None], [0, 2]] = (
            _tip_angle_gradient(mesh, datum, x, self._fitted_from)
        )
        for output, wall, side in (
            ("inflation", "roof", 1.0),
            ("inflation_lower", "floor", -1.0),
        ):
            edge, middle = mesh.lines[f"{wall}_edge"], mesh.lines[f"{wall}_middle"]
            by_edge, by_middle = _rise_gradient(
                x[edge][:, [0, 2]], x[middle][:, [0, 2]], side
            )
            found[output][edge[:, None], [0, 2]] += by_edge
            found[output][middle[:, None], [0, 2]] += by_middle
        return found

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
