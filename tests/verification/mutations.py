"""Deliberate one-line breaks of the solver, and the tests that must catch them.

Each is made in a copy of the package and tested in a fresh process.  The copies' numba
cache is their own: it compiles a file again when its time has changed, and of another
file compiled functions call helpers alone.  A verification test that no break can fail
verifies nothing.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
HERE = "tests/verification"


@dataclass(frozen=True)
class Mutation:
    """One break.

    what : str; in words.
    file : str; of the package datagen.
    old, new : str; `old` stands in the file exactly once.
    caught_by : tuple of str; tests of this folder, each of which must fail.
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
        (*standard("cantilever"), SOLVED),
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
        "rates.py",
        "(change + dw[q] * off[e, q])",
        "change",
        (MOVED,),
    ),
    Mutation(
        "gradients that follow undeformed nodes the wrong way",
        "rates.py",
        "value += dw[q] * p[r] - (",
        "value += dw[q] * p[r] + (",
        (MOVED,),
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


def missed(mutation: Mutation, folder: Path) -> list[str]:
    """Tests that should fail with this mutation and do not, in a copy in `folder`."""
    copy = folder / "copy"
    shutil.rmtree(copy, ignore_errors=True)
    skip = shutil.ignore_patterns("__pycache__")
    for name in ("datagen", HERE):
        shutil.copytree(ROOT / name, copy / name, ignore=skip)
    shutil.copy(ROOT / "pyproject.toml", copy)
    source = copy / "datagen" / mutation.file
    text = source.read_text()
    if text.count(mutation.old) != 1:
        raise ValueError(f"{mutation.what}: not once in {mutation.file}")
    source.write_text(text.replace(mutation.old, mutation.new))
    done = subprocess.run(
        [
            *(sys.executable, "-m", "pytest", "-q", "-rf", "--tb=no"),
            *("-p", "no:cacheprovider"),
            *(f"{HERE}/{name}" for name in mutation.caught_by),
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
    failed = re.findall(rf"^FAILED {HERE}/(\S+)", done.stdout, re.MULTILINE)
    return [
        name
        for name in mutation.caught_by
        if not any(found == name or found.startswith(f"{name}[") for found in failed)
    ]


def survivors(folder: Path | None = None) -> dict[str, list[str]]:
    """Mutations by their words, with the tests that missed them: empty when good."""
    with tempfile.TemporaryDirectory() as made:
        found = {}
        for mutation in MUTATIONS:
            print(f"  {mutation.what}", flush=True)
            if names := missed(mutation, folder or Path(made)):
                found[mutation.what] = names
        return found
