"""The direction in which a path goes on: displacements a pascal."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .control import Options
from .equilibrium import Equilibrium, Evaluation
from .linear import Solver

Array = np.ndarray


def loading_direction(
    residual: Callable[[Array], Array],
    equations: Equilibrium,
    solver: Solver,
    x: Array,
    ev: Evaluation,
    options: Options,
) -> Array:
    """Displacements a pascal: K u = dV/dx, by conjugate gradients.

    The corrector's factorisation is the preconditioner; products with the tangent
    at `x` are differences of residuals.  A poor tangent of the path costs more than
    these few solves: it spoils the next predictions.

    Parameters
    ----------
    residual : callable
        Of nodes (n, 3), m, at the pressure and the time of `ev`.
    equations : Equilibrium
    solver : Solver
        Holds a factorised tangent near `x`.
    x : (n, 3) array, m
        Deformed nodes.
    ev : Evaluation
        At `x`.
    options : Options

    Returns
    -------
    (k,) array, m/Pa
    """
    load = solver.solve(ev.volume_gradient)
    scale = float(np.abs(load).max())
    if scale == 0:  # a body without a cavity
        return load
    lack, aim, last = ev.volume_gradient.copy(), load, load * 0.0
    load, before = last, 1.0
    for _ in range(options.tangent_iterations):
        weight = float(lack @ aim)
        last = aim + weight / before * last if before != 1.0 else aim
        before = weight
        small = 1e-5 * equations.problem.thin / float(np.abs(last).max())
        ahead = residual(x + small * equations.extend(last))
        product = (ahead - ev.residual) / small
        share = weight / float(last @ product)
        load = load + share * last
        lack = lack - share * product
        aim = solver.solve(lack)
        if float(np.abs(aim).max()) <= options.tangent_tolerance * scale:
            break
    return load
