"""The benchmarks: each body followed by the solver, beside its exact answer.

`run(name, level)` gives the numbers that the tests judge and that the command
``make verification`` writes into the documents.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from datagen.chart import Point
from datagen.continuation import PathFollower
from datagen.levels import mesh_level
from datagen.materials import Energy, Gent, MooneyRivlin, Yeoh
from datagen.problem import Body
from datagen.response import Path
from datagen.specimens import Bulge, bulge_body, solve_bulge

from . import bodies, following
from . import closed_forms as exact

Array = np.ndarray

LEVELS = ("standard", "fine")
BOUND = {"standard": 5e-3, "fine": 1e-3}
"""Largest relative error: the bar of this project."""

MESH = {"standard": (2, 2), "fine": (4, 4)}
"""Of sphere and tube: elements through the wall, and along 45 degrees."""

SOFT = 2 * 1.48 / (3 * (1 - 2 * 0.48))
"""K/mu of the contract's material, nu = 0.48."""

STIFF = {"standard": 1e3, "fine": 1e4}
"""K/mu where the exact answer is incompressible; p is then off by about 1.5 mu/K."""

SPECIMEN = Bulge(length=8e-3, width=2e-3, thickness=140e-6, modulus=4.5e6)
SPECIMEN_KPA = (1, 2, 5, 10, 20, 30, 50)
SPECIMEN_LOADS = tuple(1e3 * p * 1e-3**4 / (4.5e6 * 140e-6**4) for p in SPECIMEN_KPA)
"""p a^4/(E h^4) of the published bulge specimen."""


@dataclass(frozen=True)
class Row:
    """One number of a benchmark, by the solver and exactly."""

    case: str
    quantity: str
    exact: float
    computed: float
    unknowns: int

    @property
    def error(self) -> float:
        """Relative to the exact number."""
        return self.computed / self.exact - 1


@dataclass(frozen=True)
class Benchmark:
    """A benchmark and what its numbers mean.

    title : str.  about : str; what is solved, and against what, for the document.
    mesh : dict of level to str.
    rows : function of the level.
    """

    title: str
    about: str
    mesh: dict[str, str]
    rows: Callable[[str], Iterator[Row]]


class Failed(AssertionError):
    """The solver did not follow the path that it should."""


def follow(
    body: Body, *pressures: float, swelling: float = 1.0
) -> tuple[PathFollower, list[Point]]:
    """The path through pressures in turn, all points kept, the limit point too.

    swelling : the cavity's volume, over that at rest, up to which a path is followed
        past its limit point; by default it ends there.
    """
    follower = PathFollower(body)
    start, goal = follower.point, swelling * follower.first_volume
    further = (lambda point: point.volume > goal) if swelling > 1 else None
    outcome = follower.run(np.array(pressures), keep_all=True, far_enough=further)
    points = [start, *(point for _, point in outcome.points)]
    done = outcome.status == "completed" or follower.limit is not None
    if not done or points[-1].volume < goal:
        raise Failed(f"{outcome.status}: {outcome.message}")
    return follower, points


def node_at(body: Body, *place: float) -> int:
    """The node nearest to a place of the undeformed body."""
    return int(np.argmin(((body.nodes - np.array(place)) ** 2).sum(axis=1)))


# -- sphere and tube -------------------------------------------------------------------


def _wall(
    body: Body,
    dimension: int,
    pressure: Callable[[float], float],
    legs: list[float],
    stretch: float = 1.0,
) -> Iterator[tuple[float, float, float, int]]:
    """Inner stretch of the cavity's volume, exact and computed pressure, unknowns.

    stretch : up to which a path is followed past its limit point.
    """
    follower, points = follow(body, *legs, swelling=stretch**dimension)
    for point in points:
        if point.pressure == 0:
            continue
        la = (point.volume / follower.first_volume) ** (1 / dimension)
        yield la, pressure(la), point.pressure, follower.equations.unknowns


def _pick(
    case: str,
    found: list[tuple[float, float, float, int]],
    lowest: float,
    wanted: tuple[float, ...],
) -> Iterator[Row]:
    """Rows of the points nearest to the wanted stretches, and of the worst point from
    the lowest stretch to the last of them."""
    stretches = np.array([la for la, *_ in found])
    for la in wanted:
        _, right, computed, unknowns = found[int(np.argmin(np.abs(stretches - la)))]
        yield Row(case, f"p/mu near la = {la:g}", right, computed, unknowns)
    rows = (
        Row(case, f"p/mu, worst of la = {lowest:g} to {wanted[-1]:g}", *rest)
        for la, *rest in found
        if lowest <= la <= 1.001 * wanted[-1]
    )
    yield max(rows, key=lambda row: abs(row.error))


def sphere_rows(level: str) -> Iterator[Row]:
    through, around = MESH[level]
    wanted = (1.1, 1.25, 1.5, 2.0, 3.0)
    for k in (1.1, 1.5, 2.0):
        limit, _ = exact.sphere_limit(k)
        for case, bulk, pressure, highest in (
            (
                f"nu = 0.48, k = {k}",
                SOFT,
                lambda la, k=k: exact.radial(la, k, 3, SOFT)[0],  # type: ignore[misc]
                exact.radial_limit(k, SOFT),
            ),
            (
                f"incompressible, k = {k}",
                STIFF[level],
                lambda la, k=k: exact.sphere_pressure(la, k),  # type: ignore[misc]
                limit,
            ),
        ):
            body = bodies.sphere(k, through, around, bulk)
            legs = [*map(pressure, wanted[:2]), 1.1 * highest]
            found = list(_wall(body, 3, pressure, legs, wanted[-1]))
            top = max(pressure for _, _, pressure, _ in found)
            yield Row(case, "largest p/mu", highest, top, found[0][3])
            yield from _pick(case, found, 1.05, wanted)
    for jm, goes_on in ((10.0, True), (30.0, False)):
        law, wanted = exact.gent(jm), (1.5, 2.0, 2.3)
        for case, bulk, pressure in (
            (
                "nu = 0.48",
                SOFT,
                lambda la, law=law: exact.radial(la, 1.5, 3, SOFT, law)[0],
            ),
            (
                "incompressible",
                # Near its largest stretch the law magnifies a change of volume.
                10 * STIFF[level],
                lambda la, law=law: exact.sphere_pressure(la, 1.5, law),
            ),
        ):
            body = bodies.sphere(1.5, through, around, bulk, Gent(1 / jm))
            # The softer law's pressure turns between the first two stretches.
            legs = [*map(pressure, wanted)] if goes_on else [1.1 * pressure(2.0)]
            past = 1.0 if goes_on else wanted[-1]
            found = list(_wall(body, 3, pressure, legs, past))
            yield from _pick(f"{case}, Gent, Jm = {jm:g}, k = 1.5", found, 1.05, wanted)


def tube_rows(level: str) -> Iterator[Row]:
    through, around = MESH[level]
    k, stiff, wanted = 1.5, STIFF[level], (1.1, 1.5, 2.0, 3.0)
    yeoh = Yeoh(0.085, 0.0058)

    def soft(law: Callable[[float], float]) -> Callable[[float], float]:
        return lambda la: exact.radial(la, k, 2, SOFT, law)[0]

    cases: list[tuple[str, float, Energy | None, Callable[[float], float]]] = [
        ("nu = 0.48, neo-Hookean", SOFT, None, soft(exact.neo_hookean)),
        ("nu = 0.48, Gent, Jm = 10", SOFT, Gent(0.1), soft(exact.gent(10))),
        (
            "nu = 0.48, Yeoh, c2 = 0.085, c3 = 0.0058",
            SOFT,
            yeoh,
            soft(lambda x: 1 + 2 * yeoh.second * x + 3 * yeoh.third * x**2),
        ),
        (
            "incompressible, neo-Hookean",
            stiff,
            None,
            lambda la: exact.tube_pressure(la, k),
        ),
        # In plane strain I1 = I2, so the second term acts as more of the first.
        (
            "incompressible, Mooney-Rivlin, C2/C1 = 0.2",
            stiff,
            MooneyRivlin(0.2),
            lambda la: 1.2 * exact.tube_pressure(la, k),
        ),
    ]
    for name, bulk, energy, pressure in cases:
        body = bodies.tube(k, through, 2 * around, bulk, energy)
        found = list(_wall(body, 2, pressure, [pressure(la) for la in wanted]))
        yield from _pick(name, found, 1.05, wanted)


# -- membranes -------------------------------------------------------------------------


def strip_rows(level: str) -> Iterator[Row]:
    thickness, along = (1e-3, 16) if level == "standard" else (2.5e-4, 24)
    for name, energy, slope, bulk, angles in (
        (
            "neo-Hookean, nu = 0.48",
            None,
            exact.neo_hookean,
            SOFT,
            (0.5, 1.0, np.pi / 2, 2.0),
        ),
        ("Gent, Jm = 10, K/mu = 1000", Gent(0.1), exact.gent(10), None, (0.75, 1.25)),
    ):
        body = bodies.membrane(thickness, 2, along, bulk or 1e3, energy)
        answers = [exact.strip_membrane(a, slope, bulk or np.inf) for a in angles]
        follower = PathFollower(body)
        top = node_at(body, 0.0, thickness / 2, 0.0)
        outcome = follower.run(np.array([p * thickness for _, p in answers]))
        if outcome.status != "completed":
            raise Failed(f"{outcome.status}: {outcome.message}")
        for (w, p), (_, point) in zip(answers, outcome.points, strict=True):
            rise = float(point.x[top, 1] - thickness / 2)
            unknowns = follower.equations.unknowns
            yield Row(name, f"w/a at p a/(mu H) = {p:.4f}", w, rise, unknowns)


def plate_rows(level: str) -> Iterator[Row]:
    thickness, through, along = (
        (0.02, 2, (16, 14)) if level == "standard" else (0.007, 1, (36, 24))
    )
    table = (0.1, 0.5, 1, 2, 5, 10, 20, 50, 100)
    loads = np.unique([*table, *SPECIMEN_LOADS])
    answers = exact.clamped_plate(loads)
    body = bodies.plate(thickness, through, along, 0.06)
    follower = PathFollower(body)
    modulus = 2 * 1.48
    outcome = follower.run(loads * modulus * thickness**4)
    if outcome.status != "completed":
        raise Failed(f"{outcome.status}: {outcome.message}")
    top = node_at(body, 0.0, 0.0, thickness / 2)
    unknowns = follower.equations.unknowns
    found = {
        load: (w, float(point.x[top, 2] / thickness - 0.5))
        for load, w, (_, point) in zip(loads, answers, outcome.points, strict=True)
    }
    for load in table:
        what = f"w/h at p a^4/(E h^4) = {load:g}"
        yield Row("nu = 0.48", what, *found[load], unknowns)
    thick = 1e3 * SPECIMEN.thickness
    for kpa, load in zip(SPECIMEN_KPA, SPECIMEN_LOADS, strict=True):
        w, rise = (thick * one for one in found[load])
        yield Row("2 x 8 mm, 140 um, 4.5 MPa", f"w, mm, {kpa} kPa", w, rise, unknowns)


def specimen() -> list[tuple[int, float, float]]:
    """The bulge specimen: kPa, w of plate theory and of the solid as it is, mm."""
    path = Path(1e3 * np.array(SPECIMEN_KPA))
    response = solve_bulge(bulge_body(SPECIMEN, mesh_level("standard")), path)
    thick = 1e3 * SPECIMEN.thickness
    plate = thick * exact.clamped_plate(np.array(SPECIMEN_LOADS))
    solid = 1e3 * response.output("inflation")[0]
    return [*zip(SPECIMEN_KPA, plate.tolist(), solid.tolist(), strict=True)]


# -- beams -----------------------------------------------------------------------------


def cantilever_rows(level: str) -> Iterator[Row]:
    slenderness, along = (100, 40) if level == "standard" else (100, 80)
    for load in (0.5, 1.0, 2.0, 4.0):
        body = bodies.cantilever(slenderness, along, load)
        follower = PathFollower(body)
        tip = follower.point.x[node_at(body, 1.0, 0.0, 0.0)]
        _, u, w = exact.elastica(load)
        unknowns = follower.equations.unknowns
        case = f"P L^2/EI = {load}"
        yield Row(case, "w/L", w, float(tip[2]), unknowns)
        yield Row(case, "u/L", u, float(1 - tip[0]), unknowns)


def following_rows(level: str) -> Iterator[Row]:
    slenderness, along = (100, 40) if level == "standard" else (100, 80)
    body, part = bodies.beam(slenderness, along)
    tip = node_at(body, 1.0, 0.0, 0.0)
    modulus = 2 * 1.48
    unknowns = int((~body.fixed).sum())
    for name, forces, loads, answer in (
        (
            "end load, P L^2/EI",
            following.end_load(part, modulus),
            (0.5, 1.0, 2.0, 4.0),
            lambda load: exact.follower(load, 0.0),
        ),
        (
            "end moment, M L/EI",
            following.end_moment(part, modulus),
            (0.5, 1.0, 2.0, 3.0),
            exact.rolled,
        ),
        (
            "pressure, q L^3/EI",
            following.pressure(part, modulus),
            (1.0, 2.0, 4.0, 8.0),
            lambda load: exact.follower(0.0, load),
        ),
    ):
        shapes = following.follow_forces(body, forces, loads)
        for load, x in zip(loads, shapes, strict=True):
            angle, u, w = answer(load)
            case = f"{name} = {load:g}"
            turned = following.end_angle(part, x)
            yield Row(case, "tip angle", angle, turned, unknowns)
            yield Row(case, "w/L", w, float(x[tip, 2]), unknowns)
            yield Row(case, "u/L", u, float(1 - x[tip, 0]), unknowns)


def bimorph_rows(level: str) -> Iterator[Row]:
    mismatch, along = (1e-3, 10) if level == "standard" else (2.5e-4, 20)
    for upper, ratio in ((0.5, 1.0), (95 / 235, 2.5 / 4.5), (95 / 235, 1.8)):
        lower = 1 - upper
        body = bodies.bimorph(lower, upper, 1 / ratio, mismatch, along)
        follower = PathFollower(body)
        # A circle that leaves the origin level; the lower layer grows, so it bends up.
        x, _, z = follower.point.x[node_at(body, 10.0, 0.0, 0.0)]
        curvature = 2 * z / (x**2 + z**2)
        yield Row(
            f"t1/t2 = {upper / lower:.4f}, E1/E2 = {ratio:.4f}",
            "kappa h / d_eps",
            # Growth along the held direction adds nu times itself: plane strain.
            1.48 * exact.bilayer(upper / lower, ratio),
            curvature / mismatch,
            follower.equations.unknowns,
        )


BENCHMARKS: dict[str, Benchmark] = {
    "sphere": Benchmark(
        "Thick sphere under pressure",
        "An octant of a spherical shell, B/A = k, followed through its limit pressure "
        "and down to la = 3; p/mu against the exact one at the same inner stretch: for "
        "nu = 0.48 the boundary-value problem of the radius, solved to 1e-12, and for "
        "an incompressible law the integral over the wall. There K/mu is 1000 (fine: "
        "10000), which lowers p by 0.1 % to 0.4 % (a tenth of that); ten times as much "
        "with Gent's law, which magnifies a change of volume near its largest stretch.",
        {
            "standard": "3 patches of 2 x 2 elements, 2 through the wall",
            "fine": "3 patches of 4 x 4 elements, 4 through the wall",
        },
        sphere_rows,
    ),
    "tube": Benchmark(
        "Thick tube in plane strain",
        "A quarter of a tube, B/A = 1.5, closed by a fan of flat faces at its far end; "
        "exact answers as for the sphere.",
        {
            "standard": "4 elements around, 2 through the wall",
            "fine": "8 elements around, 4 through the wall",
        },
        tube_rows,
    ),
    "strip": Benchmark(
        "Long clamped strip membrane",
        "Half of a long strip that bulges into an arc of up to 229 degrees, against "
        "membrane theory of the same law. A strip of finite thickness bends at its "
        "clamp over a length of about its thickness H, which takes about H/a from w/a: "
        "the strip is 1/1000 (fine: 1/4000) as thick as it is half wide.",
        {
            "standard": "16 elements along, graded to H at the clamp, 2 through",
            "fine": "24 elements along, graded to H at the clamp, 2 through",
        },
        strip_rows,
    ),
    "plate": Benchmark(
        "Bulge of a clamped rectangular membrane, b/a = 4",
        "A quarter of the bulge specimen's shape, nu = 0.48, against the plate of "
        "Foppl and von Karman, solved by Ritz's method. A solid differs from the plate "
        "by shear, of order 5 (h/a)^2 of w, and by stretch, of order (w/a)^2: 0.2 % "
        "and 0.5 % at most for h/a = 0.02 and these loads. The last rows have the "
        "published specimen's loads and its dimensions in the plane; its deflection is "
        "that of a membrane thin enough for plate theory, times its thickness.",
        {
            "standard": "16 x 14 elements, 2 through, h/a = 0.02",
            "fine": "36 x 24 elements, 1 through, h/a = 0.007",
        },
        plate_rows,
    ),
    "cantilever": Benchmark(
        "Cantilever under a dead end load",
        "A beam of square section, 100 times as long as high, whose root is free to "
        "narrow, against the elastica. Shear and stretch are of order (h/L)^2.",
        {"standard": "40 elements along, 1 through", "fine": "80 along, 1 through"},
        cantilever_rows,
    ),
    "following": Benchmark(
        "Cantilever under loads that turn with it",
        "The same beam under an end load that stays across its end, under an end "
        "moment, and under a pressure that stays across it everywhere, against their "
        "elastica. Such loads are no part of the solver: it carries nodal forces "
        "that are made from its last shape, again and again, until they are those of "
        "the shape that they make (`tests/verification/following.py`).",
        {"standard": "40 elements along, 1 through", "fine": "80 along, 1 through"},
        following_rows,
    ),
    "bimorph": Benchmark(
        "Two layers that grow apart",
        "A free strip in plane strain whose layers grow by +d_eps/2 and -d_eps/2 in "
        "every direction, nu = 0.48, against Timoshenko's curvature times 1 + nu. The "
        "formula is linear in d_eps: the solid differs by about d_eps itself, which is "
        "0.001 (fine: 0.00025).",
        {
            "standard": "10 elements along, 1 through each layer",
            "fine": "20 elements along, 1 through each layer",
        },
        bimorph_rows,
    ),
}


def stiffening() -> list[tuple[float, int, float]]:
    """Sphere, k = 2, near la = 1.1: K/mu, elements through the wall, error of p.

    Against the boundary-value problem of the same K, so that only the mesh counts.
    """
    found = []
    for bulk in (SOFT, STIFF["standard"], STIFF["fine"]):
        for count in (2, 4):
            body = bodies.sphere(2.0, count, count, bulk)
            pressure = exact.radial(1.1, 2.0, 3, bulk)[0]
            follower, points = follow(body, pressure)
            la = (points[-1].volume / follower.first_volume) ** (1 / 3)
            right = exact.radial(la, 2.0, 3, bulk)[0]
            found.append((bulk, count, pressure / right - 1))
    return found


@cache
def run(name: str, level: str) -> tuple[Row, ...]:
    """Rows of one benchmark at a level; computed once a process."""
    return tuple(BENCHMARKS[name].rows(level))
