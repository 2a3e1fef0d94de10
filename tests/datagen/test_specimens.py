"""Specimens against closed forms, and with a device's effects in them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest

from datagen.device import POISSON
from datagen.effects import Effect, catalogue
from datagen.errors import InputError
from datagen.levels import mesh_level
from datagen.materials import (
    Energy,
    Gent,
    Hyperelastic,
    Law,
    LawResult,
    MooneyRivlin,
    NeoHookean,
    Yeoh,
)
from datagen.model import Model
from datagen.problem import lame
from datagen.response import Path
from datagen.specimens import (
    MODES,
    SPECIMEN_STAGES,
    Bulge,
    Tensile,
    bulge_body,
    solve_bulge,
    tensile_body,
    tensile_stress,
    with_effects,
)
from tests.verification import closed_forms as exact

Array = np.ndarray

EFFECTS = '''
from dataclasses import replace

import numpy as np

from datagen.effects import effect
from datagen.materials import Gent, Hyperelastic
from datagen.mesh import UPPER
from datagen.space import Parameter


@effect("material", [Parameter("inverse", "1", 0, 0.5, off=0, source="test")])
def firmer(problem, inverse):
    """Gent's law in the upper layer."""
    return replace(problem, laws=(problem.laws[0], Hyperelastic(Gent(inverse))))


@effect("material", [Parameter("factor", "1", 0.5, 2, off=1, source="test")])
def stiffer(problem, factor):
    """The upper layer's moduli times a factor."""
    scale = np.where(problem.mesh.layer == UPPER, factor, 1.0)
    return replace(
        problem,
        shear_modulus=scale * problem.shear_modulus,
        bulk_modulus=scale * problem.bulk_modulus,
    )


@effect("load", [Parameter("gain", "1", 0.5, 2, off=1, source="test")])
def gain(problem, gain):
    """Cavity pressure over gauge pressure."""
    return replace(problem, pressure_gain=gain)


@effect("geometry", [Parameter("share", "1", 0, 0.1, off=0, source="test")])
def longer(problem, share):
    """The whole device stretched along x."""
    return replace(problem, nodes=problem.nodes * [1 + share, 1, 1])


@effect("material", [Parameter("share", "1", 0, 1, off=0, source="test")])
def of_the_root(problem, share):
    """Softer where the device is clamped, which a specimen is not."""
    at_root = np.isin(problem.mesh.cells, problem.mesh.root).any(axis=1)
    return replace(problem, shear_modulus=problem.shear_modulus * (1 - share * at_root))
'''


@pytest.fixture(scope="module")
def effects_dir(tmp_path_factory: pytest.TempPathFactory) -> FilePath:
    folder = tmp_path_factory.mktemp("effects")
    (folder / "own.py").write_text(EFFECTS)
    return folder


# -- tension ---------------------------------------------------------------------------

GENT = {  # mu = 1, Jm = 10; stretch: uniaxial, equibiaxial, planar
    1.5: (1.120944, 1.648079, 1.293532),
    2.0: (2.1875, 3.987342, 2.419355),
}


@pytest.mark.parametrize("i", range(3), ids=MODES)
def test_gent_table(i: int) -> None:
    stress = tensile_stress(Hyperelastic(Gent(0.1)), 1.0, np.array([*GENT]), MODES[i])
    assert stress == pytest.approx([row[i] for row in GENT.values()], abs=1e-6)


@pytest.mark.parametrize(
    ("energy", "w1", "w2"),
    [
        (NeoHookean(), lambda x: 0.5, 0.0),
        (MooneyRivlin(0.2), lambda x: 0.5, 0.1),
        (Yeoh(0.08, 0.006), lambda x: 0.5 * (1 + 0.16 * x + 0.018 * x**2), 0.0),
    ],
    ids=["neo-hookean", "mooney", "yeoh"],
)
@pytest.mark.parametrize(
    ("mode", "kind"), [*zip(MODES, ("UT", "ET", "PS"), strict=True)], ids=MODES
)
def test_tension_is_the_textbooks(
    energy: Energy, w1: object, w2: float, mode: str, kind: str
) -> None:
    stretch = np.array([0.7, 1.0, 1.3, 2.5])
    expected = [exact.nominal_stress(kind, s, w1, w2) for s in stretch]  # type: ignore[arg-type]
    found = tensile_stress(Hyperelastic(energy), 1.0, stretch, mode)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(
    ("mode", "stiffness"),
    [
        ("uniaxial", 1.0),
        ("equibiaxial", 1 / (1 - POISSON)),
        ("planar", 1 / (1 - POISSON**2)),
    ],
)
def test_small_strain_has_youngs_modulus(mode: str, stiffness: float) -> None:
    """Hooke's law of a compressible material; it has no other modulus than E."""
    modulus, strain = 2e6, 1e-6
    shear, bulk = lame(np.array(modulus))
    stress = tensile_stress(
        Hyperelastic(), float(shear), np.array([1 + strain]), mode, float(bulk)
    )
    assert stress[0] / strain == pytest.approx(stiffness * modulus, rel=1e-5)


@pytest.mark.parametrize("mode", MODES)
def test_a_large_bulk_modulus_is_incompressible(mode: str) -> None:
    law, stretch = Hyperelastic(MooneyRivlin(0.2)), np.array([0.8, 1.5, 3.0])
    stiff = tensile_stress(law, 1.0, stretch, mode, 1e6)
    none = tensile_stress(law, 1.0, stretch, mode)
    assert stiff == pytest.approx(none, rel=2e-5)
    soft = tensile_stress(law, 1.0, stretch, mode, 25.0)
    assert np.abs(soft / none - 1).max() > 1e-3


def test_past_the_longest_chains_there_is_no_stress() -> None:
    stress = tensile_stress(Hyperelastic(Gent(0.1)), 1.0, np.array([2.0, 5.0]))
    assert np.isfinite(stress).tolist() == [True, False]
    stress = tensile_stress(
        Hyperelastic(Gent(0.1)), 1.0, np.array([2.0, 5.0]), "uniaxial", 25.0
    )
    assert np.isfinite(stress).tolist() == [True, False]


class Relaxing:
    """Neo-Hookean, its stress fading from step to step: one number of history."""

    history_size = 1

    def respond(
        self, f: Array, mu: Array, history: Array, dt: float, tangent: bool
    ) -> LawResult:
        answer = Hyperelastic().respond(f, mu, history, dt, tangent)
        age = history + dt
        fading = np.exp(-age)
        return LawResult(fading * answer.stress, fading * answer.tangent, age)


def test_history_is_handed_on() -> None:
    law: Law = Relaxing()
    stretch = np.array([1.2, 1.5, 1.2])
    elastic = tensile_stress(Hyperelastic(), 1.0, stretch)
    by_step = tensile_stress(law, 1.0, stretch)
    assert by_step == pytest.approx(elastic * np.exp([-1.0, -2.0, -3.0]))
    times = np.array([0.5, 1.5, 4.0])
    ages = [1.0, 2.0, 4.5]  # it began at -0.5 s: the first step takes a second at least
    by_time = tensile_stress(law, 1.0, stretch, time=times)
    assert by_time == pytest.approx(elastic * np.exp(-np.array(ages)))
    late = tensile_stress(law, 1.0, stretch, time=times + 2)
    assert late == pytest.approx(elastic * np.exp(-(times + 2)))


@pytest.mark.parametrize(
    ("stretch", "mode", "field"),
    [([1.0], "shear", "mode"), ([0.0], "planar", "stretch"), ([np.nan], "", "mode")],
)
def test_bad_tension(stretch: list[float], mode: str, field: str) -> None:
    with pytest.raises(InputError) as caught:
        tensile_stress(Hyperelastic(), 1.0, np.array(stretch), mode)
    assert caught.value.field == field


# -- bulge -----------------------------------------------------------------------------


def test_bulge_is_the_plate_of_foppl_and_von_karman() -> None:
    """Side ratio 4, nu = 0.48: w/h of the project's table, h/a = 0.02.

    Small loads only bend the plate, where the draft mesh is 3 % stiff.  From w = h on
    tension rules; a solid then differs by shear, of order 5 (h/a)^2 = 0.2 %, and by
    its finite stretch, of order (w/a)^2 = 0.2 %.
    """
    table = {0.1: 0.0385, 1: 0.353, 5: 1.059, 10: 1.4818, 20: 1.988}
    h, modulus = 20e-6, 4.5e6
    path = Path(np.array([*table]) * modulus * (h / 1e-3) ** 4)
    response = solve_bulge(
        bulge_body(Bulge(8e-3, 2e-3, h, modulus), mesh_level("draft")), path
    )
    assert response.path_status == ("completed",)
    found = response.output("inflation")[0] / h
    assert found[:2] == pytest.approx([*table.values()][:2], rel=0.035)
    assert found[2:] == pytest.approx([*table.values()][2:], rel=0.01)


def test_a_long_hole_is_the_exact_strip() -> None:
    """Plane strain of a membrane without bending, up to 31 % of stretch at the last.

    Bending holds the membrane back along its clamped edge, over a length
    sqrt(D / tension), D = E h^3 / (12 (1 - nu^2)); w is smaller by at most its share.
    """
    h, half, modulus = 10e-6, 1e-3, 2.5e6
    shear, bulk = lame(np.array(modulus))
    angle = np.array([0.5, 0.75, 1.0, 1.25])
    rows = [exact.strip_membrane(th, bulk=float(bulk / shear)) for th in angle]
    w, load = np.array(rows).T
    path = Path(load * float(shear) * h / half)
    body = bulge_body(Bulge(12 * half, 2 * half, h, modulus), mesh_level("draft"))
    found = solve_bulge(body, path).output("inflation")[0] / half
    tension = path.pressure * half / np.sin(angle)
    edge = np.sqrt(modulus * h**3 / (12 * (1 - POISSON**2)) / tension) / half
    assert (found < w).all()
    assert (found > w * (1 - edge)).all()
    assert edge[-1] < 0.007


def test_published_specimen() -> None:
    """2 x 8 mm, 140 um, 4.5 MPa: the plate's numbers are those of a stiffer body.

    At h/a = 0.14 shear is worth 5 (h/a)^2 = 10 %, and at 50 kPa stretch (w/a)^2 is
    10 % more; the solid, which has both, deflects further by as much.
    """
    pressure = np.array([2.0, 10.0, 50.0]) * 1e3
    plate = np.array([0.0559, 0.1599, 0.3219]) * 1e-3
    response = Model(level="draft").bulge(
        Bulge(8e-3, 2e-3, 140e-6, 4.5e6), Path(pressure)
    )
    excess = response.output("inflation")[0] / plate - 1
    assert (excess > 0.04).all() and (excess < [0.10, 0.12, 0.22]).all()


def test_sides_in_any_order_and_unloading() -> None:
    model = Model(level="draft")
    path = Path(np.array([5e3, 20e3, 5e3]))
    one = model.bulge(Bulge(3e-3, 2e-3, 100e-6, 2e6), path).output("inflation")[0]
    other = model.bulge(Bulge(2e-3, 3e-3, 100e-6, 2e6), path).output("inflation")[0]
    assert (one == other).all()
    assert one[2] == pytest.approx(one[0], rel=1e-7)


# -- effects ---------------------------------------------------------------------------


def test_material_and_load_effects_act_on_specimens(effects_dir: FilePath) -> None:
    """A common factor of modulus and pressure changes nothing; one alone does."""
    bulge, path = Bulge(4e-3, 1e-3, 95e-6, 2.5e6), Path(np.array([20e3]))

    def rise(specimen: Bulge = bulge, **parameters: dict[str, float]) -> float:
        model = Model(tuple(parameters), "draft", parameters, effects_dir)
        return float(model.bulge(specimen, path).values[0, 0, 0])

    plain = rise()
    both = rise(stiffer={"factor": 1.3}, gain={"gain": 1.3})
    assert both == pytest.approx(plain, rel=1e-7)
    assert rise(stiffer={"factor": 1.3}) < 0.95 * plain
    assert rise(firmer={"inverse": 0.5}) < 0.995 * plain
    assert rise(longer={"share": 0.1}) == plain
    assert rise(replace(bulge, layer="lower"), stiffer={"factor": 1.3}) == plain


def test_material_effects_act_on_tension(effects_dir: FilePath) -> None:
    parameters = {"firmer": {"inverse": 0.1}, "stiffer": {"factor": 1.5}}
    model = Model(("firmer", "stiffer"), "draft", parameters, effects_dir)
    stretch = np.array([1.5, 2.0])
    shear, _ = lame(np.array(1.5 * 2e6))
    expected = tensile_stress(Hyperelastic(Gent(0.1)), float(shear), stretch, "planar")
    found = model.tensile(Tensile(2e6, "planar"), stretch)
    assert found == pytest.approx(expected, rel=1e-12)
    other_layer = model.tensile(Tensile(2e6, "planar", "lower"), stretch)
    plain = Model(level="draft").tensile(Tensile(2e6, "planar"), stretch)
    assert (other_layer == plain).all()


OF_MATERIAL = [
    one
    for one in catalogue().values()
    if one.stage in SPECIMEN_STAGES and one.stage != "initial strain"
]


@pytest.mark.parametrize("effect", OF_MATERIAL, ids=lambda one: one.name)
def test_every_effect_of_material_or_load_acts_on_specimens(effect: Effect) -> None:
    """All that need no device change a membrane; new laws and moduli tension, too."""
    values = {p.name: (p.upper + float(p.off or 0)) / 2 for p in effect.parameters}
    body = bulge_body(Bulge(4e-3, 1e-3, 95e-6, 2.5e6), mesh_level("draft"))
    changed = with_effects(body, [(effect, values)])
    assert (changed is body) == (effect.name == "air_channel")
    of_bulk = effect.stage == "material" and not changed.skins
    stretch = np.array([1.5, 2.0, 1.5])
    model = Model((effect.name,), "draft", {effect.name: values})
    found = model.tensile(Tensile(2e6), stretch)
    plain = Model(level="draft").tensile(Tensile(2e6), stretch)
    assert np.isfinite(found).all()
    assert (found != plain).any() == of_bulk


def test_a_warm_specimen_is_stiffer_and_does_not_grow() -> None:
    """It grows before it is clamped; mismatch and swelling leave it what it is."""
    stretch, path = np.array([1.2, 1.6]), Path(np.array([5e3, 10e3]))
    bulge, strip = Bulge(4e-3, 1e-3, 95e-6, 2.5e6), Tensile(2e6)
    plain, warm = (
        Model(tuple(one), "draft", one)
        for one in ({}, {"temperature": {"change": 40.0}})
    )
    factor = warm.tensile(strip, stretch) / plain.tensile(strip, stretch)
    assert factor == pytest.approx(1 + 40 * 1.2e-3, rel=1e-9)
    stiff = replace(bulge, modulus=1.048 * bulge.modulus)
    expected = plain.bulge(stiff, path).values
    assert warm.bulge(bulge, path).values == pytest.approx(expected, rel=1e-6)
    other = {"cure_mismatch": {"difference": 0.01}}
    mismatch = Model(("cure_mismatch",), "draft", other)
    assert (mismatch.tensile(strip, stretch) == plain.tensile(strip, stretch)).all()


def test_an_effect_of_the_device_alone_leaves_specimens(effects_dir: FilePath) -> None:
    known: dict[str, Effect] = catalogue(effects_dir)
    body = tensile_body(Tensile(2e6))
    assert with_effects(body, [(known["of_the_root"], {"share": 0.5})]) is body


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: Bulge(8e-3, 2e-3, 140e-6, 4.5), "upper_modulus_MPa"),
        (lambda: Bulge(8e-3, 2e-3, 0.14, 4.5e6, "lower"), "lower_thickness_um"),
        (lambda: Bulge(8.0, 2e-3, 140e-6, 4.5e6), "balloon_length_mm"),
        (lambda: Tensile(1e6, "shear"), "mode"),
        (lambda: Tensile(1e6, layer="middle"), "layer"),
    ],
)
def test_bad_specimens(make: object, field: str) -> None:
    with pytest.raises(InputError) as caught:
        make()  # type: ignore[operator]
    assert caught.value.field == field
