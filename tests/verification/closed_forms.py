"""Exact answers of the benchmarks, each derived here from its own equations.

Nothing of the solver is used.  Lengths, moduli and pressures are dimensionless or in
units of the arguments.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq, minimize_scalar, newton

Array = np.ndarray

# -- incompressible laws: pressure as an integral over the wall ------------------------


def neo_hookean(x: float) -> float:
    """2 dW/dI1 over mu at x = I1 - 3."""
    return 1.0


def gent(jm: float) -> Callable[[float], float]:
    """2 dW/dI1 over mu of Gent's law."""
    return lambda x: jm / (jm - x)


def sphere_pressure(
    la: float, k: float, slope: Callable[[float], float] = neo_hookean
) -> float:
    """p/mu of a thick sphere, B/A = k, whose inner radius has stretched by la.

    p is the integral of dW/dl / (l^3 - 1) over hoop stretches l from lb to la, with
    I1 = 2 l^2 + l^-4 (Ogden 1984, section 5.3).
    """
    lb = (1 + (la**3 - 1) / k**3) ** (1 / 3)

    def integrand(s: float) -> float:
        return slope(2 * s**2 + s**-4 - 3) * (2 * s - 2 * s**-5) / (s**3 - 1)

    return float(quad(integrand, lb, la, epsabs=1e-13, epsrel=1e-13)[0])


def sphere_limit(k: float) -> tuple[float, float]:
    """Largest p/mu of the neo-Hookean sphere, and la there."""
    found = minimize_scalar(
        lambda la: -sphere_pressure(la, k), bounds=(1.1, 2.5), method="bounded"
    )
    return -float(found.fun), float(found.x)


def tube_pressure(
    la: float, k: float, slope: Callable[[float], float] = neo_hookean
) -> float:
    """p/mu of a thick tube in plane strain, B/A = k, inner stretch la.

    As the sphere, with dW/dl / (l^2 - 1) and I1 = l^2 + l^-2 + 1.
    """
    lb = np.sqrt(1 + (la**2 - 1) / k**2)

    def integrand(s: float) -> float:
        return slope(s**2 + s**-2 - 2) * (s - s**-3) / (s**2 - 1)

    return float(quad(integrand, lb, la, epsabs=1e-13, epsrel=1e-13)[0])


def strip_membrane(
    angle: float,
    slope: Callable[[float], float] = neo_hookean,
    bulk: float = np.inf,
) -> tuple[float, float]:
    """w/a and p a/(mu H) of a long membrane of width 2 a that is an arc of 2 angles.

    An arc of radius a / sin angle and length 2 a angle / sin angle, hence the stretch;
    the tension is nominal stress times thickness, the pressure tension over radius.
    With a finite `bulk` modulus over mu, of a neo-Hookean law, the stretch across is
    the one that leaves the faces free.
    """
    stretch = angle / np.sin(angle)
    tension = slope(stretch**2 + stretch**-2 - 2) * (stretch - stretch**-3)
    if np.isfinite(bulk):

        def stress(across: float) -> tuple[float, float]:
            j = stretch * across
            mean = (stretch**2 + 1 + across**2) / 3
            shared = bulk * (j - 1) * j - j ** (-2 / 3) * mean
            along = j ** (-2 / 3) * stretch + shared / stretch
            return along, j ** (-2 / 3) * across + shared / across

        across = brentq(
            lambda s: stress(s)[1], 0.8 / stretch, 1.4 / stretch, xtol=1e-15
        )
        tension = stress(across)[0]
    return float(np.tan(angle / 2)), float(tension * np.sin(angle))


# -- compressible: the boundary-value problem of the radius ----------------------------


def radial(
    la: float,
    k: float,
    dimension: int,
    bulk: float,
    law: Callable[[float], float] = neo_hookean,
) -> tuple[float, Callable[[Array], tuple[Array, Array]]]:
    """Sphere (dimension 3) or tube (2) of W = What(I1bar) + K/2 (J - 1)^2.

    Parameters
    ----------
    la : float
        Stretch of the inner radius, which is 1 undeformed.
    k : float
        Outer radius, undeformed.
    bulk : float
        K/mu.
    law : callable
        2 dWhat/dI1bar over mu at I1bar - 3.

    Returns
    -------
    p/mu, and a function from undeformed radii to r and dr/dR.
    """
    hoops = dimension - 1

    def stress(radial_stretch: complex, hoop: complex) -> tuple[complex, complex]:
        j = radial_stretch * hoop**hoops
        trace = radial_stretch**2 + hoops * hoop**2 + (3 - dimension)
        pressure = bulk * (j - 1) * j
        scale = j ** (-2 / 3)
        scale = scale * law(scale * trace - 3)
        return (
            scale * (radial_stretch - trace / 3 / radial_stretch)
            + pressure / radial_stretch,
            scale * (hoop - trace / 3 / hoop) + pressure / hoop,
        )

    def rate(radius: float, y: Array) -> list[float]:
        """dP_r/dR + hoops (P_r - P_h)/R = 0 as r'' = ..., complex-step derivatives."""
        hoop, tiny = y[0] / radius, 1e-30
        by_radial = stress(y[1] + 1j * tiny, hoop)[0].imag / tiny
        by_hoop = stress(y[1] + 0j, hoop + 1j * tiny)[0].imag / tiny
        p_r, p_h = stress(y[1] + 0j, hoop + 0j)
        turned = by_hoop * (y[1] - hoop) / radius
        balance = hoops * (p_r - p_h).real / radius
        return [y[1], -(balance + turned) / by_radial]

    def shoot(slope: float) -> tuple[float, object]:
        done = solve_ivp(
            rate,
            (1.0, k),
            [la, slope],
            "DOP853",
            rtol=1e-12,
            atol=1e-12,
            dense_output=True,
        )
        end = done.y[:, -1]
        return stress(end[1] + 0j, end[0] / k + 0j)[0].real, done.sol

    guess = la**-hoops
    slope = newton(lambda s: shoot(s)[0], guess, x1=1.001 * guess, tol=1e-14)
    solution = shoot(slope)[1]
    pressure = -stress(slope + 0j, la + 0j)[0].real / la**hoops

    def at(radius: Array) -> tuple[Array, Array]:
        y = solution(np.ravel(radius))  # type: ignore[operator]
        return y[0].reshape(np.shape(radius)), y[1].reshape(np.shape(radius))

    return pressure, at


def radial_limit(k: float, bulk: float) -> float:
    """Largest p/mu of the compressible sphere."""
    found = minimize_scalar(
        lambda la: -radial(la, k, 3, bulk)[0],
        bounds=(1.1, 2.5),
        method="bounded",
        options={"xatol": 1e-4},
    )
    return -float(found.fun)


# -- slender beams ---------------------------------------------------------------------


def elastica(load: float) -> tuple[float, float, float]:
    """Tip angle, u/L and w/L of a cantilever under a dead end load P L^2/EI.

    theta'' = -load cos theta, theta(0) = 0, theta'(1) = 0; by shooting.
    """

    def shoot(curvature: float) -> Array:
        done = solve_ivp(
            lambda s, y: [y[1], -load * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])],
            (0, 1),
            [0, curvature, 0, 0],
            "DOP853",
            rtol=1e-12,
            atol=1e-12,
        )
        end: Array = done.y[:, -1]
        return end

    root = brentq(lambda c: shoot(c)[1], 0.2 * load, load + 1e-9, xtol=1e-13)
    angle, _, x, w = shoot(root)
    return float(angle), float(1 - x), float(w)


def follower(end: float, pressure: float) -> tuple[float, float, float]:
    """Tip angle, u/L and w/L of a cantilever under loads that turn with it.

    end, pressure : P L^2/EI across the tip, and q L^3/EI across the beam everywhere.

    From the tip, in its own frame, all is known: the angle a to the tip's tangent, the
    curvature k and the force F of what lies between are a' = -k, k' = F n and F' = q n,
    with the normal n = (-sin a, cos a).
    """

    def rate(_: float, y: Array) -> list[float]:
        cos, sin = np.cos(y[0]), np.sin(y[0])
        across = y[3] * cos - y[2] * sin
        return [-y[1], across, -pressure * sin, pressure * cos, cos, sin]

    start = [0, 0, 0, end, 0, 0]
    done = solve_ivp(rate, (0, 1), start, "DOP853", rtol=1e-12, atol=1e-12)
    angle, *_, x, w = done.y[:, -1] * [-1, 1, 1, 1, 1, 1]
    cos, sin = np.cos(angle), np.sin(angle)
    return float(angle), float(1 - (x * cos - w * sin)), float(x * sin + w * cos)


def rolled(moment: float) -> tuple[float, float, float]:
    """Tip angle, u/L and w/L of a cantilever under a tip moment M L/EI: an arc."""
    along, across = np.sin(moment) / moment, (1 - np.cos(moment)) / moment
    return moment, float(1 - along), float(across)


def bilayer(m: float, n: float) -> float:
    """kappa h / d_eps of two bonded layers, m = t1/t2, n = E1/E2.

    Equal forces and moments of two Euler beams with one curvature and no slip; here as
    the 2 x 2 system for the strain at the interface e0 and the curvature, t2 = 1.
    """
    t1, t2, e1, e2 = m, 1.0, n, 1.0
    # Axial force and moment about the interface vanish; layer 1 lies at z > 0 and
    # wants to be longer by one: sigma = E (e0 + kappa z - grown).
    force = [e1 * t1 + e2 * t2, (e1 * t1**2 - e2 * t2**2) / 2]
    moment = [(e1 * t1**2 - e2 * t2**2) / 2, (e1 * t1**3 + e2 * t2**3) / 3]
    _, curvature = np.linalg.solve([force, moment], [e1 * t1, e1 * t1**2 / 2])
    return float(abs(curvature) * (t1 + t2))


# -- Foppl-von Karman plate ------------------------------------------------------------


def clamped_plate(
    loads: Array, ratio: float = 4.0, poisson: float = 0.48, terms: tuple = (8, 14)
) -> Array:
    """w/h at the middle of a clamped rectangular plate with immovable edges.

    Ritz's method on the half sides 1 and `ratio`, with even Legendre polynomials times
    what the edges demand; loads are p a^4/(E h^4), lengths in a, w in h, u in h^2/a.
    """
    nx, ny = terms
    gx, wx = np.polynomial.legendre.leggauss(2 * nx + 6)
    gy, wy = np.polynomial.legendre.leggauss(2 * ny + 8)
    gx, wx = gx[gx > 0], wx[gx > 0]
    gy, wy = gy[gy > 0], wy[gy > 0]
    weight = ratio * np.outer(wx, wy).ravel()

    def family(points: Array, count: int, power: int, odd: bool) -> list[Array]:
        """(1 - x^2)^power P_k(x) and its first two derivatives, each (points, k)."""
        edge = np.polynomial.Polynomial([1, 0, -1]) ** power
        found: list[list[Array]] = [[], [], []]
        for k in range(count):
            base = np.polynomial.Legendre.basis(2 * k + odd).convert(
                kind=np.polynomial.Polynomial
            )
            shape = edge * base
            for order in range(3):
                found[order].append((shape.deriv(order) if order else shape)(points))
        return [np.stack(rows, axis=1) for rows in found]

    def product(px: Array, py: Array) -> Array:
        return np.einsum("ia,jb->ijab", px, py).reshape(len(weight), nx * ny)

    even = [family(gx, nx, 2, False), family(gy, ny, 2, False)]
    w = product(even[0][0], even[1][0])
    w_x = product(even[0][1], even[1][0])
    w_y = product(even[0][0], even[1][1]) / ratio
    laplace = product(even[0][2], even[1][0])
    laplace = laplace + product(even[0][0], even[1][2]) / ratio**2
    ux, uy = family(gx, nx, 1, True), family(gy, ny, 1, False)
    vx, vy = family(gx, nx, 1, False), family(gy, ny, 1, True)
    none = np.zeros_like(w)
    size = nx * ny
    # Membrane strains (x, y, shear) are linear in u and v and quadratic in w.
    linear = np.stack(
        [
            np.hstack([none, product(ux[1], uy[0]), none]),
            np.hstack([none, none, product(vx[0], vy[1]) / ratio]),
            np.hstack(
                [none, product(ux[0], uy[1]) / ratio, product(vx[1], vy[0])],
            ),
        ]
    )
    elastic = np.array(
        [[1, poisson, 0], [poisson, 1, 0], [0, 0, (1 - poisson) / 2]]
    ) / (1 - poisson**2)
    bending = np.zeros((3 * size, 3 * size))
    bending[:size, :size] = (laplace.T * weight) @ laplace / (12 * (1 - poisson**2))
    force = np.zeros(3 * size)
    force[:size] = w.T @ weight
    centre = np.outer(
        family(np.zeros(1), nx, 2, False)[0], family(np.zeros(1), ny, 2, False)[0]
    ).ravel()

    c = np.zeros(3 * size)
    answers = []
    steps = np.unique(np.concatenate([loads, np.geomspace(0.2, max(loads), 16)]))
    for load in steps:
        for _ in range(30):
            sx, sy = w_x @ c[:size], w_y @ c[:size]
            strain = linear @ c + np.stack([sx**2 / 2, sy**2 / 2, sx * sy])
            by = linear.copy()
            by[0, :, :size] += sx[:, None] * w_x
            by[1, :, :size] += sy[:, None] * w_y
            by[2, :, :size] += sx[:, None] * w_y + sy[:, None] * w_x
            stress = np.einsum("ij,jq->iq", elastic, strain) * weight
            residual = bending @ c - load * force
            residual += np.einsum("iqc,iq->c", by, stress)
            weighted = np.einsum("ij,jqc->iqc", elastic, by) * weight[:, None]
            tangent = bending + np.einsum("iqc,iqd->cd", by, weighted, optimize=True)
            tangent[:size, :size] += (
                (w_x.T * stress[0]) @ w_x
                + (w_y.T * stress[1]) @ w_y
                + (w_x.T * stress[2]) @ w_y
                + (w_y.T * stress[2]) @ w_x
            )
            step = np.linalg.solve(tangent, -residual)
            c = c + step
            if np.abs(step).max() < 1e-10 * np.abs(c).max():
                break
        else:
            raise ArithmeticError(f"no equilibrium of the plate at {load}")
        if load in loads:
            answers.append(float(centre @ c[:size]))
    return np.array(answers)


# -- homogeneous states of a law -------------------------------------------------------


def nominal_stress(
    kind: str, stretch: float, w1: Callable[[float], float], w2: float
) -> float:
    """Nominal stress of an incompressible law in a state of plane stress.

    kind : ``UT``, ``ET`` or ``PS`` (uniaxial, equibiaxial, planar tension).
    w1, w2 : dW/dI1 as a function of I1 - 3, and dW/dI2.

    The stretch across is what incompressibility leaves; the energy's derivative by the
    stretch is the work conjugate of one loaded pair of faces (Treloar 1975, chapter 5).
    """
    s = stretch
    if kind == "UT":
        x, factor, second = s**2 + 2 / s - 3, s - s**-2, 1 / s
    elif kind == "ET":
        x, factor, second = 2 * s**2 + s**-4 - 3, s - s**-5, s**2
    else:
        x, factor, second = s**2 + s**-2 - 2, s - s**-3, 1.0
    return 2 * factor * (w1(x) + w2 * second)
