"""How effects shift the limit pressure, learned from pairs of paths that both met it.

    L(theta) = L(off) exp(sum_j t_j m_j(design)),    t_j = 0 at off

With few pairs m is held linear in the design's dimensionless inputs, with a normal
prior around no shift (ridge regression); where no pair met both limits there is none.
The corrected surrogate asks its base at p L(off)/L(theta): a response that ends at the
limit point like a square root then ends at the shifted one, and what is left to learn
is smooth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datagen.space import Parameter

Array = np.ndarray

FEWEST_PAIRS = 4
"""With fewer pairs of limit points nothing is learned about their shift."""

RIDGES = tuple(10.0**e for e in np.arange(-3, 2.1, 0.5))
"""Ridges that are tried: variance of the noise over that of the coefficients."""

LARGEST_SHIFT = 1.0
"""Bound of the logarithm of the shift."""


def coordinates(values: Array, parameters: tuple[Parameter, ...]) -> Array:
    """(..., j) coordinates t of parameters: exactly 0 at off, at most 1 in size.

    On the parameter's own scale, over the larger of the ways from off to the two ends
    of its stated range.

    Parameters
    ----------
    values : (..., j) array, SI
    parameters : tuple of j Parameter
        With their stated ranges.
    """
    out = np.empty(np.shape(values))
    for j, p in enumerate(parameters):
        off = 0.0 if p.off is None else p.off
        if p.scale == "log" and off > 0:
            t = np.log(values[..., j] / off)
            ends = np.log(np.array([p.lower, p.upper]) / off)
        else:
            t = values[..., j] - off
            ends = np.array([p.lower, p.upper]) - off
        out[..., j] = t / np.abs(ends).max()
    return out


def far_end(parameter: Parameter, share: float = 1.0) -> float:
    """Value at a share of the way from off to the far end of the stated range, SI.

    Where `coordinates` is that share in size.
    """
    off = 0.0 if parameter.off is None else parameter.off
    ends = (parameter.lower, parameter.upper)
    if parameter.scale == "log" and off > 0:
        far = max(ends, key=lambda end: abs(np.log(end / off)))
        return float(off * (far / off) ** share)
    far = max(ends, key=lambda end: abs(end - off))
    return float(off + share * (far - off))


@dataclass(frozen=True, eq=False)
class Shift:
    """Logarithm of the limit pressure with effects over that without.

    Parameters
    ----------
    mean, scale : (f,) arrays
        Inputs are centred and scaled by these first.
    weights : (M, j, 1 + f) array
        Of each member: m_j = weights . (1, inputs).
    noise : float
        Standard deviation of the logarithm on pairs that a member had not seen.
    """

    mean: Array
    scale: Array
    weights: Array
    noise: float

    def __call__(self, inputs: Array, t: Array) -> tuple[Array, Array]:
        """Mean and standard deviation (n,) of the logarithm.

        Parameters
        ----------
        inputs : (n, f) array
            Dimensionless inputs of the designs.
        t : (n, j) array
            Coordinates of the parameters.
        """
        rows = _rows((inputs - self.mean) / self.scale, t)
        members = rows @ self.weights.reshape(len(self.weights), -1).T
        members = np.clip(members, -LARGEST_SHIFT, LARGEST_SHIFT)
        size = np.minimum(1.0, np.sqrt((t**2).sum(axis=1)))
        std = np.hypot(members.std(axis=1), self.noise * size)
        return members.mean(axis=1), std


def _rows(z: Array, t: Array) -> Array:
    """(n, j (1 + f)) products of coordinates and (1, inputs)."""
    one = np.concatenate([np.ones((len(z), 1)), z], axis=1)
    rows: Array = (t[:, :, None] * one[:, None, :]).reshape(len(z), -1)
    return rows


def no_shift(inputs: Array, parameters: int, members: int) -> Shift:
    """A limit pressure that stays where it is."""
    f = inputs.shape[1]
    return Shift(
        np.zeros(f), np.ones(f), np.zeros((members, parameters, 1 + f)), noise=0.0
    )


def fit_shift(inputs: Array, t: Array, log_ratio: Array, held_out: Array) -> Shift:
    """Learn the shift.

    Parameters
    ----------
    inputs : (n, f) array
        Dimensionless inputs of the designs.
    t : (n, j) array
    log_ratio : (n,) array
        Logarithm of the limit pressure with effects over that without; NaN where one
        of the two was not met.
    held_out : (M, n) bool array
        Designs that each member must not see.
    """
    known = np.flatnonzero(np.isfinite(log_ratio))
    if len(known) < FEWEST_PAIRS:
        return no_shift(inputs, t.shape[1], len(held_out))
    mean, scale = inputs.mean(axis=0), inputs.std(axis=0)
    scale = np.where(scale > 1e-9, scale, 1.0)
    rows = _rows((inputs - mean) / scale, t)[known]
    wanted = log_ratio[known]
    # A slope along one input is as likely as a constant a third its size.
    prior = np.tile(np.r_[1.0, np.full(inputs.shape[1], 1 / 9)], t.shape[1])
    left = [_left_out(rows, wanted, prior, ridge) for ridge in RIDGES]
    best = int(np.argmin([(errors**2).mean() for errors in left]))
    members = [
        _ridge(rows[~own], wanted[~own], prior, RIDGES[best])
        for own in held_out[:, known]
    ]
    size = np.minimum(1.0, np.sqrt((t[known] ** 2).sum(axis=1)))
    noise = float(np.sqrt(((left[best] / np.maximum(size, 0.1)) ** 2).mean()))
    shape = (len(held_out), t.shape[1], 1 + inputs.shape[1])
    return Shift(mean, scale, np.stack(members).reshape(shape), noise)


def _ridge(rows: Array, wanted: Array, prior: Array, ridge: float) -> Array:
    """Coefficients c of least |rows c - wanted|^2 + ridge sum c^2/prior."""
    scaled = rows * np.sqrt(prior)
    # The dual form: fewer rows than coefficients.
    gram = scaled @ scaled.T + ridge * np.eye(len(rows))
    found: Array = np.sqrt(prior) * (scaled.T @ np.linalg.solve(gram, wanted))
    return found


def _left_out(rows: Array, wanted: Array, prior: Array, ridge: float) -> Array:
    """(n,) errors at each row when it is left out (exact, from the hat matrix)."""
    gram = (rows * prior) @ rows.T
    inverse = np.linalg.inv(gram + ridge * np.eye(len(rows)))
    errors: Array = (inverse @ wanted) / np.diag(inverse)
    return errors
