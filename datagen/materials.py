"""Strain energies and history laws at quadrature points, each under its equation.

The strain energy is split, W = What(I1bar, I2bar) + K/2 (J - 1)^2, with the isochoric
invariants I1bar = J^(-2/3) tr C and I2bar = J^(-4/3) (tr^2 C - tr C^2)/2.  A law here
gives the isochoric part; the element carries the volumetric one through its own
pressure field.  Points are the first axis everywhere: F is (n, 9), row-major.
"""

from __future__ import annotations

from dataclasses import dataclass, is_dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from numba import njit

from .errors import EffectError

Array = np.ndarray


class EnergyDerivatives(NamedTuple):
    """What and its derivatives by the isochoric invariants, each (n,), Pa."""

    w: Array
    w1: Array
    w2: Array
    w11: Array
    w12: Array
    w22: Array


class LawResult(NamedTuple):
    """Isochoric answer of a law at n points.

    stress : (n, 9) array, Pa; first Piola-Kirchhoff stress dWhat/dF.
    tangent : (n, 81) array, Pa; dP/dF, or an empty array where it was not asked for.
    history : (n, h) array; state at the end of the step.
    """

    stress: Array
    tangent: Array
    history: Array


class Law(Protocol):
    """Isochoric response with a place for history and time.

    A law is called with the state at the start of the load step and the step's
    duration; the solver keeps the returned state only when the step converges.
    """

    @property
    def history_size(self) -> int:
        """Numbers kept at each point; 0 for a hyperelastic law."""
        ...

    def respond(
        self, f: Array, mu: Array, history: Array, dt: float, tangent: bool
    ) -> LawResult:
        """Stress and tangent.

        Parameters
        ----------
        f : (n, 9) array
            Elastic deformation gradient, row-major, det F > 0.
        mu : (n,) array, Pa
            Shear modulus at each point.
        history : (n, history_size) array
            State at the start of the step.
        dt : float, s
            Duration of the step.
        tangent : bool
            Whether the tangent is wanted.
        """
        ...


class Energy(Protocol):
    """An isochoric strain energy: all that a hyperelastic law needs to say."""

    def derivatives(self, i1: Array, i2: Array, mu: Array) -> EnergyDerivatives:
        """What and its derivatives at isochoric invariants `i1`, `i2` (n,)."""
        ...


@dataclass(frozen=True)
class NeoHookean:
    """What = mu/2 (I1bar - 3): the baseline of the contract."""

    def derivatives(self, i1: Array, i2: Array, mu: Array) -> EnergyDerivatives:
        zero = np.zeros_like(i1)
        return EnergyDerivatives(mu / 2 * (i1 - 3), mu / 2, zero, zero, zero, zero)


@dataclass(frozen=True)
class Gent:
    """What = -mu/(2 s) ln(1 - s (I1bar - 3)): chains of limited length (Gent 1996).

    Parameters
    ----------
    stiffening : float
        s = 1/Jm, the inverse of the largest I1bar - 3; 0 is the neo-Hookean law.

    Past the largest stretch there is no energy, and every number is NaN.
    """

    stiffening: float = 0.0

    def derivatives(self, i1: Array, i2: Array, mu: Array) -> EnergyDerivatives:
        s, zero = self.stiffening, np.zeros_like(i1)
        used = s * (i1 - 3)
        used = np.where(used < 1, used, np.nan)
        w = mu / 2 * (-np.log1p(-used) / s if s else i1 - 3)
        room = 1 - used
        slope = mu / 2 / room
        return EnergyDerivatives(w, slope, zero, s * slope / room, zero, zero)


@dataclass(frozen=True)
class Yeoh:
    """What = C1 (x + c2 x^2 + c3 x^3), x = I1bar - 3, 2 C1 = mu (Yeoh 1993).

    Parameters
    ----------
    second, third : float
        c2 = C2/C1 and c3 = C3/C1; with both 0 the law is neo-Hookean.
    """

    second: float = 0.0
    third: float = 0.0

    def derivatives(self, i1: Array, i2: Array, mu: Array) -> EnergyDerivatives:
        x, zero = i1 - 3, np.zeros_like(i1)
        a, b = self.second, self.third
        return EnergyDerivatives(
            mu / 2 * x * (1 + x * (a + b * x)),
            mu / 2 * (1 + x * (2 * a + 3 * b * x)),
            zero,
            mu / 2 * (2 * a + 6 * b * x),
            zero,
            zero,
        )


@dataclass(frozen=True)
class MooneyRivlin:
    """What = C1 (I1bar - 3) + C2 (I2bar - 3) (Mooney 1940, Rivlin 1948).

    Parameters
    ----------
    second, first : float
        2 C2 / mu and 2 C1 / mu; 0 and 1 make the neo-Hookean law.  The shear modulus
        at small strain is mu (first + second).
    """

    second: float = 0.0
    first: float = 1.0

    @classmethod
    def of_ratio(cls, ratio: float) -> MooneyRivlin:
        """C2/C1 = ratio, with mu for the shear modulus at small strain."""
        return cls(second=ratio / (1 + ratio), first=1 / (1 + ratio))

    def derivatives(self, i1: Array, i2: Array, mu: Array) -> EnergyDerivatives:
        zero, c1, c2 = np.zeros_like(i1), self.first * mu / 2, self.second * mu / 2
        return EnergyDerivatives(
            c1 * (i1 - 3) + c2 * (i2 - 3), c1, c2, zero, zero, zero
        )


@dataclass(frozen=True)
class Combined:
    """What = W0 + sum (W_k - W0): departures from the neo-Hookean W0 add up.

    Parameters
    ----------
    energies : tuple of Energy
        Each with the same mu; the order does not matter but for rounding.
    """

    energies: tuple[Energy, ...]

    def derivatives(self, i1: Array, i2: Array, mu: Array) -> EnergyDerivatives:
        each = [energy.derivatives(i1, i2, mu) for energy in self.energies]
        base = NeoHookean().derivatives(i1, i2, mu)
        extra = len(each) - 1
        return EnergyDerivatives(
            *(sum(terms) - extra * b for *terms, b in zip(*each, base, strict=True))
        )


@dataclass(frozen=True)
class Hyperelastic:
    """The law of an isochoric strain energy; it has no history."""

    energy: Energy = NeoHookean()

    @property
    def history_size(self) -> int:
        return 0

    def stored(self, f: Array, mu: Array) -> Array:
        """Isochoric energy density (n,), J/m3, at deformation gradients (n, 9)."""
        return self.energy.derivatives(*invariants(f), mu).w

    def respond(
        self, f: Array, mu: Array, history: Array, dt: float, tangent: bool
    ) -> LawResult:
        if isinstance(self.energy, NeoHookean):
            zero = np.zeros(0)
            d = EnergyDerivatives(zero, mu / 2, zero, zero, zero, zero)
            stress, slope = _respond(f, d.w1, zero, zero, zero, zero, False, tangent)
        else:
            d = self.energy.derivatives(*invariants(f), mu)
            stress, slope = _respond(f, d.w1, d.w2, d.w11, d.w12, d.w22, True, tangent)
        return LawResult(stress, slope, history)


def with_energy(law: Law, energy: Energy) -> Law:
    """A law with the departure of one more energy from the neo-Hookean in it.

    Parameters
    ----------
    law : Law
        `Hyperelastic`, or a dataclass around another law, in its field ``law``.
    energy : Energy

    Raises
    ------
    EffectError
        When there is no hyperelastic law inside.
    """
    if isinstance(law, Hyperelastic):
        if isinstance(law.energy, NeoHookean):
            return Hyperelastic(energy)
        known = law.energy.energies if isinstance(law.energy, Combined) else ()
        return Hyperelastic(Combined((*(known or (law.energy,)), energy)))
    inner = getattr(law, "law", None)
    if inner is None or not is_dataclass(law) or isinstance(law, type):
        raise EffectError(
            f"law {type(law).__name__}: its strain energy cannot be changed; allowed: "
            "Hyperelastic, or a dataclass with the law that it wraps in a field 'law'"
        )
    return replace(law, law=with_energy(inner, energy))


@njit(cache=True, fastmath=True)
def invariants(f: Array) -> tuple[Array, Array]:
    """Isochoric invariants I1bar, I2bar of deformation gradients (n, 9)."""
    n = f.shape[0]
    i1, i2 = np.empty(n), np.empty(n)
    for q in range(n):
        a = f[q]
        det = (
            a[0] * (a[4] * a[8] - a[5] * a[7])
            - a[1] * (a[3] * a[8] - a[5] * a[6])
            + a[2] * (a[3] * a[7] - a[4] * a[6])
        )
        trace, square = 0.0, 0.0
        for m in range(3):
            for k in range(3):
                c = a[m] * a[k] + a[3 + m] * a[3 + k] + a[6 + m] * a[6 + k]
                square += c * c
                if m == k:
                    trace += c
        j23 = det ** (-2.0 / 3.0)
        i1[q] = j23 * trace
        i2[q] = j23 * j23 * 0.5 * (trace * trace - square)
    return i1, i2


@njit(cache=True, fastmath=True)
def _respond(
    f: Array,
    w1: Array,
    w2: Array,
    w11: Array,
    w12: Array,
    w22: Array,
    general: bool,
    want_tangent: bool,
) -> tuple[Array, Array]:
    """Chain rule from energy derivatives to P = dWhat/dF and dP/dF.

    With H = F^-T:
    dI1bar/dF = 2 J^(-2/3) (F - I1/3 H),
    dI2bar/dF = 2 J^(-4/3) (I1 F - F C - 2/3 I2 H).
    `general` False leaves out the second invariant and all second derivatives.
    """
    n = f.shape[0]
    stress = np.empty((n, 9))
    tangent = np.empty((n if want_tangent else 0, 81))
    h, d1, d2, fc = np.empty(9), np.empty(9), np.empty(9), np.empty(9)
    c, b = np.empty(9), np.empty(9)
    for q in range(n):
        a = f[q]
        h[0] = a[4] * a[8] - a[5] * a[7]
        h[1] = a[5] * a[6] - a[3] * a[8]
        h[2] = a[3] * a[7] - a[4] * a[6]
        h[3] = a[2] * a[7] - a[1] * a[8]
        h[4] = a[0] * a[8] - a[2] * a[6]
        h[5] = a[1] * a[6] - a[0] * a[7]
        h[6] = a[1] * a[5] - a[2] * a[4]
        h[7] = a[2] * a[3] - a[0] * a[5]
        h[8] = a[0] * a[4] - a[1] * a[3]
        det = a[0] * h[0] + a[1] * h[1] + a[2] * h[2]
        trace = 0.0
        for k in range(9):
            h[k] /= det
            trace += a[k] * a[k]
        j23 = det ** (-2.0 / 3.0)
        for k in range(9):
            d1[k] = 2 * j23 * (a[k] - trace / 3 * h[k])
            stress[q, k] = w1[q] * d1[k]
        i2 = 0.0
        if general:
            square = 0.0
            for m in range(3):
                for k in range(3):
                    c[3 * m + k] = (
                        a[m] * a[k] + a[3 + m] * a[3 + k] + a[6 + m] * a[6 + k]
                    )
                    b[3 * m + k] = (
                        a[3 * m] * a[3 * k]
                        + a[3 * m + 1] * a[3 * k + 1]
                        + a[3 * m + 2] * a[3 * k + 2]
                    )
                    square += c[3 * m + k] * c[3 * m + k]
            i2 = 0.5 * (trace * trace - square)
            for m in range(3):
                for k in range(3):
                    fc[3 * m + k] = (
                        a[3 * m] * c[k]
                        + a[3 * m + 1] * c[3 + k]
                        + a[3 * m + 2] * c[6 + k]
                    )
            for k in range(9):
                g = trace * a[k] - fc[k]
                d2[k] = 2 * j23 * j23 * (g - 2 * i2 / 3 * h[k])
                stress[q, k] += w2[q] * d2[k]
        if not want_tangent:
            continue
        t = tangent[q]
        e1 = 2 * w1[q] * j23
        for i in range(3):
            for jj in range(3):
                r = 3 * i + jj
                fa, ha = a[r], h[r]
                for k in range(3):
                    for ll in range(3):
                        s = 3 * k + ll
                        value = (
                            -2.0 / 3.0 * (fa * h[s] + ha * a[s])
                            + 2.0 / 9.0 * trace * ha * h[s]
                            + trace / 3.0 * h[3 * i + ll] * h[3 * k + jj]
                        )
                        t[9 * r + s] = e1 * value
                t[10 * r] += e1
        if not general:
            continue
        e2 = 2 * w2[q] * j23 * j23
        for i in range(3):
            for jj in range(3):
                r = 3 * i + jj
                ga = trace * a[r] - fc[r]
                for k in range(3):
                    for ll in range(3):
                        s = 3 * k + ll
                        gs = trace * a[s] - fc[s]
                        value = (
                            -4.0 / 3.0 * (ga * h[s] + h[r] * gs)
                            + 8.0 / 9.0 * i2 * h[r] * h[s]
                            + 2.0 / 3.0 * i2 * h[3 * i + ll] * h[3 * k + jj]
                            + 2.0 * a[r] * a[s]
                            - a[3 * i + ll] * a[3 * k + jj]
                        )
                        if i == k:
                            value -= c[3 * ll + jj]
                        if jj == ll:
                            value -= b[3 * i + k]
                        if r == s:
                            value += trace
                        t[9 * r + s] += (
                            e2 * value
                            + w11[q] * d1[r] * d1[s]
                            + w12[q] * (d1[r] * d2[s] + d2[r] * d1[s])
                            + w22[q] * d2[r] * d2[s]
                        )
    return stress, tangent
