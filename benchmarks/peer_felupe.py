"""FElupe on a question: ``peer_felupe QUESTION ANSWER [--linear pardiso]``.

Runs in an environment of its own (`requirements.txt`).  Twenty-node hexahedra with
2 x 2 x 2 points, 3 x 3 points on the faces under pressure, FElupe's own law, boundary
pressure (load stiffness included) and Newton's method, each load step from the last
solution.
"""

from __future__ import annotations

import argparse
import time
from importlib import metadata
from pathlib import Path
from typing import Any

import felupe as fem
import numpy as np

from .exchange import FACE_EDGES, FACES, FORCE, LENGTH, Answer, Cost, Question

TOLERANCE = 1e-6
"""Norm of the residual over that of the reactions.

The last correction is then below 1e-6 of the deflection; FElupe's default costs an
iteration a step more.
"""

ITERATIONS = 16
SMALLEST = 1 / 64
"""Of a load step, before the path is given up."""

FAILURES = (fem.NewtonConvergenceError, RuntimeError, np.linalg.LinAlgError)
"""Of a step that was too long; SuperLU says so by a `RuntimeError`."""


class PeerFailed(RuntimeError):
    """The program did not get to the last pressure; the text says why."""


assert LENGTH**2 == FORCE, "stress stays in Pa"


def linear_solver(name: str) -> Any:
    """A function of a sparse matrix and a right-hand side."""
    if name == "pardiso":
        from pypardiso import spsolve as pardiso

        return pardiso
    from scipy.sparse.linalg import spsolve as superlu

    return superlu


def law_of(shear: float, bulk: float, question: Question) -> Any:
    """FElupe's own neo-Hookean law, or an energy that it differentiates itself."""
    if question.second == question.inverse_limit == 0:
        return fem.NeoHooke(mu=shear, bulk=bulk)
    import tensortrax.math as tm

    def energy(c: Any) -> Any:
        volume = tm.sqrt(tm.linalg.det(c))
        first = tm.trace(c) * volume ** (-2 / 3) - 3
        if question.inverse_limit:
            limit = 1 / question.inverse_limit
            shape = -shear * limit / 2 * tm.log(1 - first / limit)
        else:
            twice = (tm.trace(c) ** 2 - tm.trace(c @ c)) / 2
            second = twice * volume ** (-4 / 3) - 3
            both = first + question.second * second
            shape = shear / 2 / (1 + question.second) * both
        return shape + bulk / 2 * (volume - 1) ** 2

    return fem.Hyperelastic(energy)


def build(question: Question) -> tuple[Any, list[Any], Any]:
    """Field, bodies of the two layers, and the pressure on the cavity's walls."""
    nodes = question.nodes * LENGTH
    whole = fem.Mesh(nodes, question.cells, "hexahedron20")
    points = fem.GaussLegendre(order=1, dim=3)

    def field_on(mesh: Any) -> Any:
        region = fem.RegionQuadraticHexahedron(mesh, quadrature=points)
        return fem.FieldContainer([fem.Field(region, dim=3)])

    bodies = []
    for shear in np.unique(question.shear):
        chosen = question.shear == shear
        bulk = float(question.bulk[chosen][0])
        part = fem.Mesh(nodes, question.cells[chosen], "hexahedron20")
        law = law_of(float(shear), bulk, question)
        bodies.append(fem.SolidBody(law, field_on(part)))
    if question.weight:
        force = [0.0, 0.0, -question.weight * FORCE / LENGTH**3]
        bodies.append(fem.SolidBodyForce(field_on(whole), values=force))
    on_wall = np.zeros(len(nodes), dtype=bool)
    for face, (corners, edges) in enumerate(zip(FACES, FACE_EDGES, strict=True)):
        on_wall[question.cells[question.wet[:, face]][:, [*corners, *edges]]] = True
    wall = fem.RegionQuadraticHexahedronBoundary(whole, mask=on_wall)
    if len(wall.mesh.cells) != int(question.wet.sum()):
        raise ValueError("FElupe found other cavity walls than those asked for")
    pressure = fem.SolidBodyPressure(fem.FieldContainer([fem.Field(wall, dim=3)]))
    return field_on(whole), bodies, pressure


def solve(question: Question, linear: str = "superlu") -> Answer:
    """Follow the path, with half the step again wherever Newton's method fails.

    Raises
    ------
    PeerFailed
        When a step of `SMALLEST` of the wanted one fails.
    """
    began, busy = time.perf_counter(), time.process_time()
    field, bodies, wall = build(question)
    held = np.flatnonzero(question.fixed.ravel())
    free = np.flatnonzero(~question.fixed.ravel())
    reached, iterations, found = 0.0, 0, []
    for target in question.pressure:
        step = whole = float(target) - reached
        while reached < target:
            goal = min(reached + step, float(target))
            wall.update(goal)
            try:
                result = fem.newtonraphson(
                    x0=field.copy(),
                    items=[*bodies, wall],
                    dof0=held,
                    dof1=free,
                    ext0=np.zeros(len(held)),
                    solver=linear_solver(linear),
                    tol=TOLERANCE,
                    maxiter=ITERATIONS,
                    verbose=0,
                )
            except FAILURES as error:
                iterations += ITERATIONS
                step /= 2
                if step < SMALLEST * whole:
                    reason = " ".join(str(error).split())
                    raise PeerFailed(
                        f"failed past {reached / 1e3:.4g} kPa: {reason}"
                    ) from error
                continue
            iterations += result.iterations
            field, reached = result.x, goal
        found.append(field[0].values / LENGTH)
    packages = ["felupe", "numpy", "scipy"]
    packages += ["pypardiso", "mkl"] if linear == "pardiso" else []
    packages += ["tensortrax"] if question.second or question.inverse_limit else []
    return Answer(
        np.stack(found),
        Cost(
            seconds=time.perf_counter() - began,
            processor=time.process_time() - busy,
            iterations=iterations,
            factorisations=iterations,
            unknowns=question.unknowns,
            versions={name: metadata.version(name) for name in packages},
        ),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("question", type=Path)
    parser.add_argument("answer", type=Path)
    parser.add_argument("--linear", choices=("superlu", "pardiso"), default="superlu")
    given = parser.parse_args()
    try:
        answer = solve(Question.read(given.question), given.linear)
    except PeerFailed as failure:
        raise SystemExit(str(failure)) from failure
    answer.write(given.answer)


if __name__ == "__main__":
    main()
