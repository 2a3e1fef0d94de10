from dataclasses import replace

from datagen.effects import effect
from datagen.mesh import UPPER
from datagen.space import Parameter

SOURCE = "thin PDMS is stiffer: Liu et al. 2009, J. Micromech. Microeng. 19 035028"


@effect(
    "material", [Parameter("n", "1", 0, 2, off=0, prior="half-normal", source=SOURCE)]
)
def thin_cure(problem, n):
    """Thin layers cure harder: mu = mu0 (t / 100 um)^-n, t the layer's thickness."""
    upper, lower = problem.design.upper_thickness, problem.design.lower_thickness
    factor = ((problem.mesh.layer == UPPER) * (upper - lower) + lower) / 100e-6
    mu, bulk = problem.shear_modulus * factor**-n, problem.bulk_modulus * factor**-n
    return replace(problem, shear_modulus=mu, bulk_modulus=bulk)
