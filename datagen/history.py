"""Laws with a memory: viscoelasticity and stress softening, each under its equation.

A law with history wraps the law it changes, in the field `law`, so that laws nest.
Its state at a point is the wrapped law's state followed by its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from numba import njit

from .materials import Law, LawResult

Array = np.ndarray


@runtime_checkable
class Stored(Law, Protocol):
    """A law that has a stored energy."""

    def stored(self, f: Array, mu: Array) -> Array:
        """Isochoric energy density (n,), J/m3, at deformation gradients (n, 9)."""
        ...


def convolve(memory: Array, change: Array, weight: float, decay: float) -> Array:
    """One step of the memory h of a stress, dh/dt + h/tau = weight dS/dt.

    h(n+1) = exp(-dt/tau) h(n) + weight exp(-dt/(2 tau)) (S(n+1) - S(n)): exact in
    decay, of second order in dt for a stress that changes (Simo 1987, Comput. Methods
    Appl. Mech. Eng. 60, 153; Holzapfel 1996, Int. J. Numer. Methods Eng. 39, 3903).

    Parameters
    ----------
    memory, change : arrays of one shape, Pa
        h at the start of the step, and S(n+1) - S(n).
    weight : float
    decay : float
        dt/tau.
    """
    kept, new = np.exp(-decay), weight * np.exp(-decay / 2)
    result: Array = kept * memory + new * change
    return result


@dataclass(frozen=True)
class Viscoelastic:
    """Finite linear viscoelasticity: S = S_iso + sum_i H_i, H_i by `convolve`.

    S_iso is the isochoric second Piola-Kirchhoff stress of the wrapped law, which is
    that of infinitely slow loading.  State: S_iso (6 numbers) and each H_i (6).

    Parameters
    ----------
    law : Law
    weights : tuple of k float
        beta_i: after a jump the i-th memory is beta_i times the jump of the stress.
    times : tuple of k float, s
        tau_i > 0.
    """

    law: Law
    weights: tuple[float, ...]
    times: tuple[float, ...]

    fades: ClassVar[bool] = True
    """Asks the path follower for short steps in time."""

    @property
    def history_size(self) -> int:
        return self.law.history_size + 6 * (1 + len(self.weights))

    def respond(
        self, f: Array, mu: Array, history: Array, dt: float, tangent: bool
    ) -> LawResult:
        inner = self.law.history_size
        base = self.law.respond(f, mu, history[:, :inner], dt, tangent)
        old, *memories = np.split(history[:, inner:], 1 + len(self.weights), axis=1)
        stress = _second(f, base.stress)
        change = stress - old
        state = [base.history, stress]
        grown, fading = 1.0, np.zeros_like(old)
        for weight, time, memory in zip(
            self.weights, self.times, memories, strict=True
        ):
            new = weight * float(np.exp(-dt / time / 2))
            grown += new
            fading += np.exp(-dt / time) * memory - new * old
            state.append(convolve(memory, change, weight, dt / time))
        # S = grown S_iso(F) + fading, and `fading` does not depend on F.
        total, slope = grown * base.stress, grown * base.tangent
        _add_second(f, fading, total, slope)
        return LawResult(total, slope, np.concatenate(state, axis=1))


@dataclass(frozen=True)
class Mullins:
    """Stress softening of Ogden and Roxburgh (1999): P = eta P0.

    eta = 1 - softening erf((Wm - W) / (width mu)), with the stored energy W and the
    largest Wm it has had: 1 while W grows beyond Wm, less on unloading and reloading.
    Proc. R. Soc. Lond. A 455, 2861, with r = 1/softening, m = width mu.
    State: Wm.

    Parameters
    ----------
    law : Stored
    softening : float
        0 <= 1/r < 1.
    width : float
        m/mu > 0.
    """

    law: Stored
    softening: float
    width: float

    @property
    def fades(self) -> bool:
        """True where the wrapped law does, see `Viscoelastic`."""
        return getattr(self.law, "fades", False)

    @property
    def history_size(self) -> int:
        return self.law.history_size + 1

    def stored(self, f: Array, mu: Array) -> Array:
        """Energy of the law before it softens, J/m3."""
        return self.law.stored(f, mu)

    def respond(
        self, f: Array, mu: Array, history: Array, dt: float, tangent: bool
    ) -> LawResult:
        base = self.law.respond(f, mu, history[:, :-1], dt, tangent)
        energy = self.law.stored(f, mu)
        stress, slope = base.stress.copy(), base.tangent.copy()
        largest = _soften(
            stress, slope, energy, history[:, -1], self.softening, self.width * mu
        )
        return LawResult(stress, slope, np.column_stack([base.history, largest]))


@njit(cache=True, fastmath=True)
def _second(f: Array, stress: Array) -> Array:
    """S = F^-1 P as (n, 6): 11, 22, 33, 12, 13, 23."""
    out = np.empty((f.shape[0], 6))
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    g = np.empty(9)
    for q in range(f.shape[0]):
        a, p = f[q], stress[q]
        g[0] = a[4] * a[8] - a[5] * a[7]
        g[1] = a[2] * a[7] - a[1] * a[8]
        g[2] = a[1] * a[5] - a[2] * a[4]
        g[3] = a[5] * a[6] - a[3] * a[8]
        g[4] = a[0] * a[8] - a[2] * a[6]
        g[5] = a[2] * a[3] - a[0] * a[5]
        g[6] = a[3] * a[7] - a[4] * a[6]
        g[7] = a[1] * a[6] - a[0] * a[7]
        g[8] = a[0] * a[4] - a[1] * a[3]
        det = a[0] * g[0] + a[1] * g[3] + a[2] * g[6]
        for entry in range(6):
            i, j = pairs[entry]
            total = 0.0
            for k in range(3):
                total += g[3 * i + k] * p[3 * k + j]
            out[q, entry] = total / det
    return out


@njit(cache=True, fastmath=True)
def _add_second(f: Array, second: Array, stress: Array, tangent: Array) -> None:
    """Add F S of a constant S (n, 6) to P, and its derivative to dP/dF, in place."""
    s = np.empty((3, 3))
    for q in range(f.shape[0]):
        c = second[q]
        s[0, 0], s[1, 1], s[2, 2] = c[0], c[1], c[2]
        s[0, 1] = s[1, 0] = c[3]
        s[0, 2] = s[2, 0] = c[4]
        s[1, 2] = s[2, 1] = c[5]
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    stress[q, 3 * i + j] += f[q, 3 * i + k] * s[k, j]
                    if tangent.shape[0]:
                        tangent[q, 9 * (3 * i + j) + 3 * i + k] += s[j, k]


@njit(cache=True)
def _soften(
    stress: Array,
    tangent: Array,
    energy: Array,
    before: Array,
    softening: float,
    width: Array,
) -> Array:
    """Multiply P and dP/dF by eta, in place; the largest energies (n,) so far.

    d eta/dW = softening 2/sqrt(pi) exp(-z^2) / width, z = (Wm - W) / width.
    """
    largest = np.empty(energy.shape[0])
    for q in range(energy.shape[0]):
        largest[q] = max(before[q], energy[q])
        z = (largest[q] - energy[q]) / width[q]
        if z <= 0:
            continue
        eta = 1 - softening * math.erf(z)
        slope = softening * 2 / math.sqrt(math.pi) * math.exp(-z * z) / width[q]
        if tangent.shape[0]:
            for r in range(9):
                for s in range(9):
                    tangent[q, 9 * r + s] = (
                        eta * tangent[q, 9 * r + s]
                        + slope * stress[q, r] * stress[q, s]
                    )
        for r in range(9):
            stress[q, r] *= eta
    return largest
