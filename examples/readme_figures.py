"""Draw the pictures of the README: the inflated actuator, and the four cases.

``make figures`` runs it as ``python -m examples.readme_figures``; it writes
``actuator.png`` and ``cases.png`` to docs/images.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np

from datagen.device import CASES, named_device
from datagen.mesh import UPPER, StripMesh
from datagen.model import Model
from datagen.response import Path
from examples.render import Camera, Patches, boundary_faces, render

Array = np.ndarray

IMAGES = FilePath(__file__).parents[1] / "docs/images"
QUANTITIES = {"tip_deflection": "tip deflection, um", "inflation": "inflation, um"}
LAYER_COLOURS = np.array([[0.45, 0.49, 0.56], [0.80, 0.76, 0.68]])
"""Lower and upper material on the cut face."""

COVERAGE = 0.9


def actuator_patches(
    mesh: StripMesh, displacement: Array, colour_map: object
) -> Patches:
    """Deformed faces of the half strip, coloured by how far they moved.

    Parameters
    ----------
    mesh : StripMesh
    displacement : (n, 3) array, m
    colour_map : callable
        From an array in 0..1 to red, green, blue and opacity.

    Returns
    -------
    Patches
        Faces on the symmetry plane carry the colour of their material.
    """
    faces, owners = boundary_faces(mesh.cells)
    moved = np.linalg.norm(displacement, axis=1)
    colours = colour_map(moved / moved.max())[:, :3][faces]  # type: ignore[operator]
    cut = np.isin(faces, mesh.mid_plane).all(axis=1)
    upper = (mesh.layer[owners[cut]] == UPPER).astype(int)
    colours[cut] = LAYER_COLOURS[upper][:, None, :]
    return Patches((mesh.nodes + displacement)[faces], colours)


def draw_actuator(
    file: FilePath, mesh: StripMesh, displacement: Array, title: str
) -> None:
    """Picture of the half strip, cut at the symmetry plane so the cavity shows.

    Parameters
    ----------
    file : path of a PNG
    mesh : StripMesh
    displacement : (n, 3) array, m
    title : str
    """
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    colours = colormaps["viridis"]
    picture = render(actuator_patches(mesh, displacement, colours), Camera())
    height, width = picture.shape[:2]
    inches = 10.0
    figure = Figure(figsize=(inches, inches * height / width + 0.3), dpi=140)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1 - 0.3 / figure.get_figheight()))
    axes.imshow(picture)
    axes.set_axis_off()
    figure.suptitle(title, fontsize=11, y=1 - 0.08 / figure.get_figheight(), va="top")
    furthest = float(np.linalg.norm(displacement, axis=1).max()) * 1e6
    bar = figure.colorbar(
        ScalarMappable(Normalize(0, furthest), colours),
        cax=figure.add_axes((0.06, 0.17, 0.26, 0.03)),
        orientation="horizontal",
    )
    bar.set_label("displacement, um", fontsize=9)
    bar.ax.tick_params(labelsize=8)
    figure.savefig(file, facecolor="white")


@dataclass(frozen=True)
class Curve:
    """One case: finite elements as lines, the surrogate's interval as a band.

    Parameters
    ----------
    label : str
    pressure : (s,) array, Pa
    fem : dict of quantity to (s,) array, m
    low, high : dict of quantity to (s,) array, m
        Ends of the surrogate's interval; empty without a surrogate.
    """

    label: str
    pressure: Array
    fem: Mapping[str, Array]
    low: Mapping[str, Array]
    high: Mapping[str, Array]


def draw_cases(file: FilePath, curves: list[Curve]) -> None:
    """Tip deflection and inflation of every case against pressure."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4), dpi=140, layout="constrained")
    panels = figure.subplots(1, len(QUANTITIES))
    for axes, (name, label) in zip(panels, QUANTITIES.items(), strict=True):
        for number, curve in enumerate(curves):
            kilopascal, colour = curve.pressure / 1e3, f"C{number}"
            axes.plot(
                kilopascal, curve.fem[name] * 1e6, color=colour, label=curve.label
            )
            if name in curve.low:
                axes.fill_between(
                    kilopascal,
                    curve.low[name] * 1e6,
                    curve.high[name] * 1e6,
                    color=colour,
                    alpha=0.2,
                    linewidth=0,
                )
        axes.axhline(0, color="0.6", linewidth=0.6)
        axes.set_xlabel("pressure, kPa")
        axes.set_ylabel(label)
        axes.set_xlim(0, float(curves[0].pressure.max()) / 1e3)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    panels[-1].legend(frameon=False, fontsize=9, loc="lower right")
    figure.savefig(file, facecolor="white")


def case_curves(level: str, pressure: Array) -> list[Curve]:
    """The four published cases of S1 by finite elements and by the surrogate.

    Parameters
    ----------
    level : str
        Mesh level of the finite elements.
    pressure : (s,) array, Pa
    """
    from surrogate.ensemble import reference_model

    designs = [named_device("S1", case) for case in CASES]
    paths = [Path(pressure)] * len(designs)
    fem = Model(level=level)(designs, paths)
    prediction = reference_model().predict(designs, paths, coverage=COVERAGE)
    column = {name: prediction.response.outputs.index(name) for name in QUANTITIES}
    return [
        Curve(
            f"case {case}: {upper} over {lower}",
            pressure,
            {name: fem.output(name)[i] for name in QUANTITIES},
            {name: prediction.low[i, :, k] for name, k in column.items()},
            {name: prediction.high[i, :, k] for name, k in column.items()},
        )
        for i, (case, (upper, lower)) in enumerate(CASES.items())
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=FilePath, default=IMAGES)
    parser.add_argument("--level", default="standard", help="mesh level")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)

    pressure = 100e3
    problem, deformed = Model(level=given.level).deformed(
        named_device("S1", 1), pressure
    )
    title = f"S1, case 1, at {pressure / 1e3:g} kPa, to scale; cut at mid-width"
    draw_actuator(
        given.out / "actuator.png", problem.mesh, deformed - problem.nodes, title
    )
    draw_cases(
        given.out / "cases.png", case_curves(given.level, np.linspace(0, 60e3, 25))
    )


if __name__ == "__main__":
    main()
