"""The device without effects that comes nearest to a device with them.

Some effects are a change of the device itself: wider balloons, other moduli, a pressure
that is not what the gauge says.  How much of an effect is that can be read from the
boundary-value problem without solving it: where the edges and surfaces are after the
effect, the mean modulus of each layer, and gain and offset of the pressure.  The base
is then asked for that device at that pressure, and networks learn what is left.  An
effect of another kind, such as gravity, leaves the device as it is.

What was read from many problems is kept as closed forms of design and parameters, each
term of which vanishes at off:

    log(x'/x) or (x' - x)/size = sum_j t_j (w_j + sum_i w_ji u_i) + sum_jk w_jk t_j t_k

with u the design over the middle of its space.  A model file so holds numbers alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from datagen.device import DESIGN_SPACE, POISSON, Design
from datagen.errors import InputError
from datagen.mesh import LOWER, UPPER
from datagen.problem import Problem
from datagen.space import Space
from datagen.worker import split_inputs

from .shift import coordinates

Array = np.ndarray

SIZES = tuple(p.name for p in DESIGN_SPACE if p.scale != "integer")
"""Variables of a design that effects may change."""

READ = (*SIZES, "gain", "offset")
"""What is read: the sizes, and cavity pressure = gain times gauge pressure + offset."""

MIDDLE = {p.name: (p.lower + p.upper) / 2 for p in DESIGN_SPACE}
PRESSURE_SIZE = 1e4
"""Pa.  Size over which offsets of the pressure are fitted."""

PROBLEMS = 3
"""Problems that are read for each feature of the closed forms."""

LARGEST = 1.0
"""Bound of the logarithm, or of the difference over the size."""


def read_device(problem: Problem) -> dict[str, float]:
    """Sizes, moduli and pressure of the device that a problem is of, SI.

    Names are those of `READ`.
    """
    design = problem.design
    found = {name: float(getattr(design, name)) for name in SIZES}
    if problem.datum is None:
        found |= _sizes(problem)
    # Where nodes are those of a bent strip, its sizes stay what they were.
    for name, layer in (("lower_modulus", LOWER), ("upper_modulus", UPPER)):
        shear = problem.shear_modulus[problem.mesh.layer == layer]
        found[name] = float(2 * (1 + POISSON) * shear.mean())
    return found | {
        "gain": problem.pressure_gain,
        "offset": problem.pressure_offset,
    }


def _sizes(problem: Problem) -> dict[str, float]:
    """Lengths of the device after its nodes have been moved."""
    design, drawn = problem.design, problem.mesh.nodes
    near = 1e-6 * problem.thin

    def place(axis: int, drawn_at: float) -> float:
        return float(
            problem.nodes[np.abs(drawn[:, axis] - drawn_at) < near, axis].mean()
        )

    along = [(place(0, a), place(0, b)) for a, b in design.balloons_x()]
    across = [
        (place(1, a) if a > 0 else -place(1, b), place(1, b))
        for a, b in design.balloons_y()
    ]
    heights = np.cumsum(
        [0, design.lower_thickness, design.cavity_height, design.upper_thickness]
    )
    z = [place(2, float(height)) for height in heights]
    wall = design.wall
    if len(along) > 1:
        wall = float(np.mean([b[0] - a[1] for a, b in pairwise(along)]))
    elif across[0][0] > 0:
        wall = 2 * across[0][0]
    width = sum(b - a for a, b in across)
    middle = design.divisions_y % 2  # that balloon stands on both sides already
    first = across[0][1] - across[0][0] if middle else 0.0
    return {
        "balloon_length": sum(b - a for a, b in along),
        "wall": wall,
        "balloon_start": along[0][0],
        "tip_margin": place(0, design.length) - along[-1][1],
        "balloon_width": 2 * width - first,
        "rim": place(1, design.width / 2) - across[-1][1],
        "lower_thickness": z[1] - z[0],
        "cavity_height": z[2] - z[1],
        "upper_thickness": z[3] - z[2],
    }


@dataclass(frozen=True, eq=False)
class Equivalent:
    """Closed forms of what effects make of a device.

    Parameters
    ----------
    weights : (r, f) array
        Of the features of `_features` for each name of `READ`.
    logarithmic : (r,) bool array
        Whether the form is of the logarithm or of the difference.
    """

    weights: Array
    logarithmic: Array

    def __call__(
        self, columns: Mapping[str, Array], t: Array
    ) -> tuple[dict[str, Array], Array, Array]:
        """Equivalent columns, and gain and offset (n,) of the pressure, 1 and Pa.

        Parameters
        ----------
        columns : mapping of (n,) arrays, SI
            The variables of the design space.
        t : (n, j) array
            Coordinates of the parameters.
        """
        change = np.clip(_features(columns, t) @ self.weights.T, -LARGEST, LARGEST)
        values = {
            **{name: columns[name] for name in SIZES},
            "gain": np.ones(len(t)),
            "offset": np.zeros(len(t)),
        }
        for i, name in enumerate(READ):
            if self.logarithmic[i]:
                values[name] = values[name] * np.exp(change[:, i])
            else:
                moved = values[name] + change[:, i] * _size(name)
                # A wall or a margin stays, however little of it.
                least = -np.inf if name == "offset" else 0.1 * values[name]
                values[name] = np.maximum(moved, least)
        gain, offset = values.pop("gain"), values.pop("offset")
        return {**columns, **values}, gain, offset


def _size(name: str) -> float:
    return {"gain": 1.0, "offset": PRESSURE_SIZE}.get(name) or MIDDLE[name]


def _features(columns: Mapping[str, Array], t: Array) -> Array:
    """(n, f) features, all of them 0 where t is."""
    u = np.stack([columns[p.name] / MIDDLE[p.name] for p in DESIGN_SPACE], axis=1)
    j = t.shape[1]
    linear = (t[:, :, None] * np.insert(u, 0, 1.0, axis=1)[:, None]).reshape(len(t), -1)
    pairs = [t[:, a] * t[:, b] for a in range(j) for b in range(a, j)]
    return np.concatenate([linear, np.stack(pairs, axis=1)], axis=1)


def same_device(parameters: int) -> Equivalent:
    """Effects that leave the device what it is."""
    weights = np.zeros((len(READ), _width(parameters)))
    return Equivalent(weights, np.zeros(len(READ), dtype=bool))


def _width(j: int) -> int:
    """Number of features of j parameters."""
    return j * (1 + len(DESIGN_SPACE)) + j * (j + 1) // 2


def fit_equivalent(
    space: Space, seed: int, effects_dir: Path | None = None
) -> Equivalent:
    """Read problems with the effects in them, over the space, and fit the forms.

    Parameters
    ----------
    space : Space
        Design variables and ``effect.parameter`` over their stated ranges.
    seed : int
    effects_dir : Path, optional
        Folder with a user's own effects.

    Raises
    ------
    InputError
        When the effects cannot act on any device of the space.
    """
    from datagen.model import Model

    tuned = tuple(p for p in space if "." in p.name)
    effects = tuple(sorted({p.name.split(".")[0] for p in tuned}))
    kept, before, after = [], [], []
    for row in space.sample(PROBLEMS * _width(len(tuned)), seed):
        values, parameters = split_inputs(space.names, row, effects)
        design = Design.from_sample(values)
        try:
            problem = Model(effects, "draft", parameters, effects_dir).problem(design)
        except InputError:
            continue
        now = read_device(problem)
        if design.divisions_x == design.divisions_y == 1:
            now["wall"] = np.nan  # there is none
        was = {"gain": 1.0, "offset": 0.0, **values}
        kept.append(row)
        before.append([was[name] for name in READ])
        after.append([now[name] for name in READ])
    if not kept:
        raise InputError("effects", ", ".join(effects), "some that fit a device")
    rows = np.array(kept)
    columns = {name: rows[:, i] for i, name in enumerate(space.names)}
    t = coordinates(rows[:, len(space) - len(tuned) :], tuned)
    return _fit(_features(columns, t), np.array(before), np.array(after))


def _fit(features: Array, before: Array, after: Array) -> Equivalent:
    """Least squares of both forms; the better one is taken, 0 where nothing moves."""
    weights = np.zeros((len(READ), features.shape[1]))
    logarithmic = np.zeros(len(READ), dtype=bool)
    for i, name in enumerate(READ):
        known = np.isfinite(after[:, i])
        was, now, rows = before[known, i], after[known, i], features[known]
        size = _size(name)
        difference = (now - was) / size
        if np.abs(difference).max(initial=0.0) < 1e-9:
            continue
        forms = [(False, difference)]
        if (was > 0).all() and (now > 0).all():
            forms.append((True, np.log(now / was)))
        best = np.inf
        for kind, wanted in forms:
            found = np.linalg.lstsq(rows, wanted, rcond=1e-10)[0]
            change = rows @ found
            predicted = was * np.exp(change) if kind else was + size * change
            worst = float(np.abs(predicted - now).max())
            if worst < best:
                best, weights[i], logarithmic[i] = worst, found, kind
    return Equivalent(weights, logarithmic)
