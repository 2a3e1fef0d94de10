"""Stress that fades after a stretch: creep, relaxation, loops that depend on rate."""

from __future__ import annotations

from dataclasses import replace

from ..history import Viscoelastic
from ..problem import Problem
from ..space import Parameter
from .door import effect

TIMES = (1.0, 10.0, 100.0)
"""Relaxation times, s: what a bench run of minutes can tell apart."""


def _share(time: float) -> Parameter:
    return Parameter(
        f"beta_{time:g}",
        unit="1",
        lower=0.0,
        upper=0.05,
        off=0.0,
        prior="half-normal",
        source="relaxation of Sylgard 184 by a few percent a decade of time: Lin et "
        "al. 2009, J. Microelectromech. Syst. 18, 1087",
    )


@effect(stage="material", parameters=[_share(time) for time in TIMES])
def viscoelasticity(
    problem: Problem, beta_1: float, beta_10: float, beta_100: float
) -> Problem:
    """Convolution of the isochoric stress: S = S_iso + sum_i H_i.

    dH_i/dt + H_i / tau_i = beta_i dS_iso/dt with tau = 1, 10 and 100 s.  The moduli
    are those of slow loading.  Loops close after a rest, and every cycle is like the
    one before.
    """
    betas = dict(zip(TIMES, (beta_1, beta_10, beta_100), strict=True))
    # What has no share remembers nothing.
    there = {time: beta for time, beta in betas.items() if beta}
    shares, times = tuple(there.values()), tuple(there)
    lower, upper = (Viscoelastic(law, shares, times) for law in problem.laws)
    return replace(problem, laws=(lower, upper))
