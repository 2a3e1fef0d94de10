"""Deliberate one-line breaks of the solver, and the tests that must catch them.

Each is made in a copy of the package and tested in a fresh process.  The copies' numba
cache is their own: it compiles a file again when its time has changed, and of another
file compiled functions call helpers alone.  A verification test that no break can fail
verifies nothing.

A parametrised test stands for all of its kinds: how many of them fail is counted, as a
break of one law fails the kinds of that law alone.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
FOLDERS = ("tests/verification", "tests/datagen")


@dataclass(frozen=True)
class Mutation:
    """One break.

    what : str; in words.
    file : str; of the package datagen.
    old, new : str; `old` stands in the file exactly once.
    caught_by : tuple of str; tests, each of which must fail: ``file::test`` of this
        folder, ``datagen/file::test`` of the other one.
    """

    what: str
    file: str
    old: str
    new: str
    caught_by: tuple[str, ...]


def standard(*names: str) -> tuple[str, ...]:
    """The benchmarks' tests at the standard mesh."""
    return tuple(f"test_benchmarks.py::test_standard_mesh[{name}]" for name in names)


FORCES = "test_patch.py::test_nodal_forces_of_a_uniform_state_are_exact"
GROWN = "test_patch.py::test_initial_strain_of_any_size_gives_its_stress"
RIGID = "test_patch.py::test_rigid_rotation_gives_no_stress"
SOLVED = "test_patch.py::test_solved_patch_takes_the_uniform_state"
TANGENT = "test_patch.py::test_tangent_is_the_derivative_of_the_residual"
TENSION = "test_laws.py::test_tension"
DERIVED = "test_laws.py::test_stress_and_tangent_are_derivatives"
ORDERS = "test_convergence.py::test_orders"
VOLUME = "test_benchmarks.py::test_closed_cavities_have_their_volume"
LIMIT = "test_benchmarks.py::test_sphere_goes_through_its_limit_pressure"
STABLE = "test_benchmarks.py::test_stability_is_lost_at_the_limit"
FINE = "test_benchmarks.py::test_fine_mesh"
PRODUCTS = "test_rates.py::test_products_are_those_of_the_assembled_tangent"
MANY = "test_rates.py::test_many_fields_are_as_each_alone"
LINES = "test_rates.py::test_products_of_lines_are_the_reference_element"
MOVED = "test_rates.py::test_moved_nodes_against_central_differences"

MUTATIONS = (
    Mutation(
        "a fifth for the sixth in the tensor of a face's volume",
        "cavity.py",
        "(even - odd) / 6",
        "(even - odd) / 5",
        (*standard("sphere", "tube", "strip", "plate"), VOLUME, FINE),
    ),
    Mutation(
        "two for three in the gradient of the volume, along x",
        "cavity.py",
        "gradient[node, 0] += 3 * v0",
        "gradient[node, 0] += 2 * v0",
        (*standard("sphere", "tube"), LIMIT, TANGENT),
    ),
    Mutation(
        "three for six in the second derivative of the volume",
        "cavity.py",
        "data[where] -= 6 * pressure",
        "data[where] -= 3 * pressure",
        (TANGENT,),
    ),
    Mutation(
        "the load stiffness with the wrong sign",
        "cavity.py",
        "data[where] -= 6 * pressure",
        "data[where] += 6 * pressure",
        (TANGENT,),
    ),
    Mutation(
        "a sign in one entry of the cofactor",
        "elements.py",
        "c[5] = a[1] * a[6] - a[0] * a[7]",
        "c[5] = a[1] * a[6] + a[0] * a[7]",
        (*standard("sphere"), FORCES, RIGID),
    ),
    Mutation(
        "the inverse Jacobian transposed",
        "elements.py",
        "c[3 * k + i] / det",
        "c[3 * i + k] / det",
        (*standard("sphere", "tube"), FORCES),
    ),
    Mutation(
        "quadrature weights in place of volumes in the projection",
        "elements.py",
        "mass[e, m, n] += w * basis[q, m]",
        "mass[e, m, n] += point_weight[q] * basis[q, m]",
        (*standard("sphere", "tube"), FORCES, SOLVED),
    ),
    Mutation(
        "the pressure constant in an element where it should be linear",
        "elements.py",
        "for i in range(4):\n                p += basis[q, i] * theta[i]",
        "for i in range(1):\n                p += basis[q, i] * theta[i]",
        (ORDERS,),
    ),
    Mutation(
        "the local share of the volumetric energy counted twice",
        "elements.py",
        "((1.0 - local) * p + local * (dets[q] - 1.0))",
        "(p + local * (dets[q] - 1.0))",
        (FORCES, ORDERS),
    ),
    Mutation(
        "the geometric stiffness of the pressure with the wrong sign",
        "elements.py",
        "factor = pressure[e, q] / det",
        "factor = -pressure[e, q] / det",
        (TANGENT,),
    ),
    Mutation(
        "Fg in place of its inverse",
        "elements.py",
        "@ np.linalg.inv(growth)[:, None]",
        "@ growth[:, None]",
        (*standard("bimorph"), GROWN),
    ),
    Mutation(
        "volumes without the factor det Fg",
        "elements.py",
        "weight = weight * change[:, None]",
        "weight = weight * 1.0",
        (GROWN,),
    ),
    Mutation(
        "moduli of the layers left out",
        "equilibrium.py",
        "self._mu = np.repeat(problem.shear_modulus, 27)",
        "self._mu = np.repeat(problem.shear_modulus, 27) * 0 + 1",
        standard("bimorph"),
    ),
    Mutation(
        "dead forces with the wrong sign",
        "equilibrium.py",
        "body += share * problem.forces",
        "body -= share * problem.forces",
        (*standard("cantilever", "following"), SOLVED),
    ),
    Mutation(
        "the path turns back at its limit point",
        "corrector.py",
        "length = -length  # past",
        "length = +length  # past",
        (*standard("sphere"), LIMIT),
    ),
    Mutation(
        "negative eigenvalues not reported",
        "corrector.py",
        "negative=self.solver.negative",
        "negative=0",
        (STABLE,),
    ),
    Mutation(
        "the local share left out of the linearised residual",
        "rates.py",
        "stiff = over + w * local * bulk[e]",
        "stiff = over",
        (PRODUCTS, MOVED),
    ),
    Mutation(
        "volumes that do not change where undeformed nodes move",
        "drawn.py",
        "+ dw[q, c] * left",
        "+ 0.0 * left",
        (MOVED,),
    ),
    Mutation(
        "gradients that follow undeformed nodes the wrong way",
        "drawn.py",
        "- p0 * u_q[3 * k, c]",
        "+ p0 * u_q[3 * k, c]",
        (MOVED,),
    ),
    Mutation(
        "functions where slopes belong in the forces of moved nodes",
        "drawn.py",
        "+ d0 * two[r, w]\n",
        "+ n0 * two[r, w]\n",
        (MOVED, MANY, LINES),
    ),
    Mutation(
        "as large a local share however stiff the volume",
        "elements.py",
        "min(LOCAL_SHARE, float((LOCAL_SHEAR * shear / bulk).min()))",
        "LOCAL_SHARE",
        standard("sphere"),
    ),
    Mutation(
        "growth and dead loads led in only half",
        "continuation.py",
        "while share < 1:",
        "while share < 0.4:",
        (*standard("cantilever", "bimorph"), SOLVED),
    ),
    Mutation(
        "the limit point not looked for between the last two points",
        "continuation.py",
        "scale = abs(a.slope) + abs(b.slope)",
        "return best",
        (LIMIT,),
    ),
    Mutation(
        "the pressure's slope misjudged where the path turns",
        "chart.py",
        "rise = b.pressure - a.pressure",
        "rise = a.pressure - b.pressure",
        (LIMIT,),
    ),
    Mutation(
        "the wrong way to a lower pressure",
        "continuation.py",
        "self._turn(1.0 if up == (self.point.slope > 0) else -1.0)",
        "self._turn(1.0)",
        ("datagen/test_history.py::test_the_baseline_unloads_along_its_loading_path",),
    ),
    Mutation(
        "lost stability not told from a step that fails",
        "continuation.py",
        "return close and lost and not self._past_limits",
        "return False",
        ("datagen/test_solver.py::test_balloons_that_part_ways_end_a_path",),
    ),
    Mutation(
        "every step as long in time as the whole load step",
        "continuation.py",
        "dt *= min(1.0, abs(goal - here.pressure) / whole)",
        "dt *= 1.0",
        (
            "datagen/test_history.py::"
            "test_the_follower_takes_time_in_steps_that_are_short_enough",
        ),
    ),
    Mutation(
        "paths that go on through a closed cavity",
        "journey.py",
        "if not touching(follower.point.x):",
        "if True:",
        (
            "datagen/test_solver.py::test_touching_roof_and_floor_stops_the_path",
            "datagen/test_solver.py::"
            "test_the_pressure_of_contact_is_no_matter_of_the_steps",
        ),
    ),
    Mutation(
        "paths that end at their limit point whatever is asked",
        "journey.py",
        "if go_on is None:",
        "if True:",
        ("datagen/test_solver.py::test_a_path_goes_on_past_its_limit_point", LIMIT),
    ),
    Mutation(
        "strips followed until they have turned by less",
        "solver.py",
        "FAR_TURN = np.radians(120)",
        "FAR_TURN = np.radians(100)",
        ("datagen/test_solver.py::test_a_path_goes_on_past_its_limit_point",),
    ),
    Mutation(
        "the memory of a stress of first order in time",
        "history.py",
        "np.exp(-decay), weight * np.exp(-decay / 2)",
        "np.exp(-decay), weight * np.exp(-decay)",
        ("datagen/test_history.py::test_convolution_of_a_ramp_in_stretch",),
    ),
    Mutation(
        "the memory's own stress with the wrong sign",
        "history.py",
        "total, slope = grown * base.stress, grown * base.tangent",
        "total, slope = (2 - grown) * base.stress, grown * base.tangent",
        (
            "datagen/test_history.py::test_viscoelastic_ramp",
            "datagen/test_history.py::test_tangents_are_derivatives_in_the_middle_of_a_history",
        ),
    ),
    Mutation(
        "softening that forgets the largest energy",
        "history.py",
        "largest[q] = max(before[q], energy[q])",
        "largest[q] = energy[q]",
        (
            "datagen/test_history.py::test_ogden_roxburgh_unloading",
            "datagen/test_history.py::test_softening_unloads_lower_and_reloads_as_it_unloaded",
        ),
    ),
    Mutation(
        "inflation measured across the strip at rest",
        "observe.py",
        "height[i] = side * (tx * pz - tz * px)",
        "height[i] = side * pz",
        (
            "datagen/test_observe.py::"
            "test_a_bulge_is_measured_along_the_normal_of_the_bent_strip",
        ),
    ),
    Mutation(
        "turns counted along a line that folds",
        "observe.py",
        '_curve(x[mesh.lines["rim"]][:, [0, 2]])',
        '_curve(x[mesh.lines["bottom"]][:, [0, 2]])',
        ("datagen/test_observe.py::test_a_fold_under_a_wall_is_no_turn_of_the_strip",),
    ),
    Mutation(
        "turns of more than half a circle not counted",
        "observe.py",
        "return angle + 2 * np.pi * round((mean - angle) / (2 * np.pi))",
        "return angle",
        ("datagen/test_observe.py::test_an_arc_has_its_own_tip_and_angle",),
    ),
    Mutation(
        "crossings looked for between near segments of a row alone",
        "overlap.py",
        "for j in range(i + 2, len(row) - 1):",
        "for j in range(i + 2, i + 3):",
        ("datagen/test_overlap.py::test_bulbs_that_lean_over_their_walls_overlap",),
    ),
    Mutation(
        "the pressure's share of a derivative with the wrong sign",
        "adjoint.py",
        "residuals[:, k] -= more / one.step * load",
        "residuals[:, k] += more / one.step * load",
        ("datagen/test_sensitivity.py::test_load_parameters",),
    ),
    Mutation(
        "held nodes that stay where undeformed ones are moved",
        "adjoint.py",
        "dx[held] = undeformed[held]",
        "dx[held] = 0.0",
        ("datagen/test_sensitivity.py::test_design_fields[upper_thickness]",),
    ),
    Mutation(
        "derivatives that forget the history of a law",
        "sensitivity.py",
        "ahead.history = ahead.evaluate(x, pressure, dt).history",
        "ahead.evaluate(x, pressure, dt)",
        ("datagen/test_sensitivity.py::test_the_history_of_a_law_is_followed",),
    ),
    Mutation(
        "derivatives at off that forget the history of a law",
        "adjoint.py",
        "one.history = one.respond(f, dt, False)[2]",
        "one.respond(f, dt, False)",
        ("datagen/test_history.py::test_derivatives_at_off_follow_the_history",),
    ),
    Mutation(
        "memories that see the points of a path alone",
        "continuation.py",
        "passed = now",
        "passed = passed",
        (
            "datagen/test_history.py::"
            "test_derivatives_at_off_look_between_the_points_of_the_path",
        ),
    ),
    Mutation(
        "an elastic support as stiff across a face as along it",
        "surfaces.py",
        "k = (normal - tangential) * n[i] * n[j]",
        "k = 0.0",
        ("datagen/test_surfaces.py::test_an_inclined_face_feels_its_own_normal",),
    ),
    Mutation(
        "a skin that does not resist its own area",
        "surfaces.py",
        "s[i, j] = k * (up[i, j] - c * low[i, j])",
        "s[i, j] = k * up[i, j]",
        (
            "datagen/test_surfaces.py::"
            "test_forces_of_a_skin_are_derivatives_of_its_energy",
            "datagen/test_surfaces.py::"
            "test_matrices_of_a_skin_are_derivatives_of_its_forces",
        ),
    ),
    Mutation(
        "a mesh error that shrinks where two meshes cross",
        "mesh_error.py",
        "np.maximum.accumulate(np.abs(values - coarse), axis=0)",
        "np.abs(values - coarse)",
        ("datagen/test_mesh_error.py::test_bracket_on_numbers_by_hand",),
    ),
    Mutation(
        "half the derivative of the first invariant",
        "materials.py",
        "d1[k] = 2 * j23 * (a[k] - trace / 3 * h[k])",
        "d1[k] = j23 * (a[k] - trace / 3 * h[k])",
        (*standard("sphere", "plate"), TENSION, DERIVED),
    ),
    Mutation(
        "isochoric stress with a pressure in it",
        "materials.py",
        "d1[k] = 2 * j23 * (a[k] - trace / 3 * h[k])",
        "d1[k] = 2 * j23 * (a[k] - trace / 2 * h[k])",
        (DERIVED, RIGID),
    ),
    Mutation(
        "a sign in the derivative of the second invariant",
        "materials.py",
        "g = trace * a[k] - fc[k]",
        "g = trace * a[k] + fc[k]",
        (*standard("tube"), TENSION, DERIVED),
    ),
    Mutation(
        "a term missing in the tangent of the second invariant",
        "materials.py",
        "value -= b[3 * i + k]",
        "value -= 0.0",
        (DERIVED, TANGENT),
    ),
    Mutation(
        "Gent's second derivative without its factor",
        "materials.py",
        "s * slope / room",
        "slope / room",
        (DERIVED, TANGENT),
    ),
    Mutation(
        "Gent's law a little stiff where it is off",
        "materials.py",
        "room = 1 - used",
        "room = 1 - used - 1e-6 * (i1 - 3)",
        ("test_laws.py::test_off_is_neo_hookean_to_the_last_bit",),
    ),
    Mutation(
        "Gent's law goes on past its largest stretch",
        "materials.py",
        "np.where(used < 1, used, np.nan)",
        "np.minimum(used, 2 - used)",
        ("test_laws.py::test_gent_has_no_answer_past_its_largest_stretch",),
    ),
    Mutation(
        "Yeoh's cubic term with the factor of the square one",
        "materials.py",
        "(1 + x * (2 * a + 3 * b * x))",
        "(1 + x * (2 * a + 2 * b * x))",
        (TENSION, DERIVED),
    ),
    Mutation(
        "Mooney's second term twice",
        "materials.py",
        "c2 * (i2 - 3), c1, c2, zero",
        "c2 * (i2 - 3), c1, 2 * c2, zero",
        (*standard("tube"), TENSION, DERIVED),
    ),
    Mutation(
        "the fan at a cavity's end inside out",
        "bricks.py",
        "edges[:, ::-1]",
        "edges",
        (*standard("tube", "strip"), VOLUME),
    ),
)


class Caught(NamedTuple):
    """How many kinds of a test a mutation fails, and how many the test has."""

    failed: int
    kinds: int


def where(name: str) -> str:
    """Path and name of a test as pytest takes them."""
    return f"tests/{name}" if "/" in name else f"{FOLDERS[0]}/{name}"


def caught(mutation: Mutation, folder: Path) -> dict[str, Caught]:
    """Its tests, and what a mutation does to them in a copy of the package."""
    copy = folder / "copy"
    shutil.rmtree(copy, ignore_errors=True)
    skip = shutil.ignore_patterns("__pycache__")
    for name in ("datagen", *FOLDERS):
        shutil.copytree(ROOT / name, copy / name, ignore=skip)
    shutil.copy(ROOT / "pyproject.toml", copy)
    source = copy / "datagen" / mutation.file
    text = source.read_text()
    if text.count(mutation.old) != 1:
        raise ValueError(f"{mutation.what}: not once in {mutation.file}")
    source.write_text(text.replace(mutation.old, mutation.new))
    done = subprocess.run(
        [
            *(sys.executable, "-m", "pytest", "-q", "-rfEp", "--tb=no"),
            *("-p", "no:cacheprovider"),
            *map(where, mutation.caught_by),
        ],
        cwd=copy,
        env={
            **os.environ,
            "PYTHONPATH": str(copy),
            "NUMBA_CACHE_DIR": str(folder / "numba"),
            "PYTHONDONTWRITEBYTECODE": "1",
        },
        capture_output=True,
        text=True,
        check=False,
    )
    lines = re.findall(r"^(FAILED|ERROR|PASSED) (\S+)", done.stdout, re.MULTILINE)
    found = {}
    for name in mutation.caught_by:
        path = where(name)
        ends = [word for word, at in lines if at == path or at.startswith(f"{path}[")]
        found[name] = Caught(sum(word != "PASSED" for word in ends), len(ends))
    return found
