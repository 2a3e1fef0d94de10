"""Write a measurement file as a bench would: true devices, an instrument, and noise.

    python -m examples.bench [FILE]

The true devices are those of the finite-element model with one effect in it that the
baseline lacks.  Their moduli and thicknesses are not quite the stated ones, the camera
has a scale of its own in every run, and every reading has noise.  The file states the
nominal values, as a lab would.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from datagen.device import Design, named_device
from datagen.model import Model
from datagen.response import Path as LoadPath
from datagen.specimens import Bulge, Tensile
from discrepancy.measurement import (
    LOADING,
    UNLOADING,
    Curve,
    Measurements,
    Tolerances,
)
from discrepancy.writing import write_measurements

Array = np.ndarray

FILE = Path(__file__).parent / "measurements" / "bench.csv"

HIDDEN = {"cure_mismatch": {"difference": -0.0005}}
"""What the shipped file has in it."""

KPA = 1e3
UP = np.array([5, 10, 15, 20, 30, 40, 50]) * KPA
DOWN = np.array([40, 30, 20, 10]) * KPA

NOISE = {
    "tip_deflection": 3e-6,
    "bending_angle": np.radians(0.1),
    "inflation": 2e-6,
    "stress": 5e3,
}
"""Standard deviation of the instruments, SI."""

DIGIT = {
    "tip_deflection": 1e-7,
    "bending_angle": np.radians(1e-3),
    "inflation": 1e-7,
    "stress": 1e2,
}
"""Last digit that the instruments write, SI."""

DEVICES: dict[str, Design | Bulge | Tensile] = {
    "S1 case 1": named_device("S1", 1),
    "S1 case 2": named_device("S1", 2),
    "D8-1x1": named_device("D8-1x1", 1),
    "D8-2x1": named_device("D8-2x1", 1),
    "membrane A": Bulge(8e-3, 2e-3, 140e-6, 4.5e6, "lower"),
    "strip B": Tensile(2.5e6, "uniaxial", "upper"),
}


class Bench:
    """One laboratory: its batches of material, its camera, its noise.

    Parameters
    ----------
    hidden : mapping of str to mapping of str to float, SI
        Effects and their parameters that act on every device.
    seed : int
    tolerances : Tolerances
        How far the true values are from the stated ones.
    """

    def __init__(
        self,
        hidden: Mapping[str, Mapping[str, float]],
        seed: int,
        tolerances: Tolerances,
    ) -> None:
        self.model = Model(tuple(hidden), "draft", hidden)
        self.random = np.random.default_rng(seed)
        self.tolerances = tolerances
        self.batches: dict[float, float] = {}

    def modulus(self, stated: float) -> float:
        """True modulus, Pa; one for all that state the same."""
        if stated not in self.batches:
            error = self.tolerances.modulus * self.random.standard_normal()
            self.batches[stated] = stated * (1 + error)
        return self.batches[stated]

    def thickness(self, stated: float) -> float:
        """True thickness of a layer, m."""
        return stated + self.tolerances.thickness * float(self.random.standard_normal())

    def true(self, stated: Design | Bulge | Tensile) -> Design | Bulge | Tensile:
        """The device as it was made."""
        if isinstance(stated, Design):
            return stated.with_values(
                upper_modulus=self.modulus(stated.upper_modulus),
                lower_modulus=self.modulus(stated.lower_modulus),
                upper_thickness=self.thickness(stated.upper_thickness),
                lower_thickness=self.thickness(stated.lower_thickness),
            )
        if isinstance(stated, Bulge):
            return replace(
                stated,
                modulus=self.modulus(stated.modulus),
                thickness=self.thickness(stated.thickness),
            )
        return replace(stated, modulus=self.modulus(stated.modulus))

    def answer(
        self, made: Design | Bulge | Tensile, load: Array
    ) -> tuple[tuple[str, ...], Array]:
        """Quantities that the instruments read, and their true values (s, m), SI."""
        if isinstance(made, Tensile):
            return ("stress",), self.model.tensile(made, load)[:, None]
        if isinstance(made, Bulge):
            response = self.model.bulge(made, LoadPath(load))
            return response.outputs, response.values[0]
        response = self.model([made], [LoadPath(load)])
        names = ("tip_deflection", "bending_angle", "inflation")
        return names, np.stack([response.output(name)[0] for name in names], axis=1)

    def test(
        self,
        name: str,
        stated: Design | Bulge | Tensile,
        made: Design | Bulge | Tensile,
        load: Array,
        run: int,
    ) -> Curve:
        """One run of one device; pressure falls on the unloading branch."""
        outputs, values = self.answer(made, load)
        scale = 1 + self.tolerances.camera_scale * self.random.standard_normal()
        lengths = np.array(
            [name in ("tip_deflection", "inflation") for name in outputs]
        )
        values = np.where(lengths, scale, 1.0) * values
        std = np.array([NOISE[one] for one in outputs])
        values = values + std * self.random.standard_normal(values.shape)
        digit = np.array([DIGIT[one] for one in outputs])
        top = int(np.argmax(load))
        steps = np.arange(len(load))
        return Curve(
            device=name,
            run=run,
            orientation=0.0,
            design=stated,
            load=load,
            time=None,
            branch=np.where(steps <= top, LOADING, UNLOADING),
            outputs=outputs,
            values=np.round(values / digit) * digit,
            std=np.broadcast_to(std, values.shape),
        )


def make(
    hidden: Mapping[str, Mapping[str, float]],
    seed: int,
    devices: Mapping[str, Design | Bulge | Tensile] = DEVICES,
) -> Measurements:
    """Measure every device once, and the first one a second time, down again, too."""
    bench = Bench(hidden, seed, Tolerances())
    curves = []
    for i, (name, stated) in enumerate(devices.items()):
        made = bench.true(stated)
        load = np.linspace(1.1, 2.0, 10) if isinstance(stated, Tensile) else UP
        curves.append(bench.test(name, stated, made, load, 1))
        if i == 0:
            again = np.concatenate([load, DOWN])
            curves.append(bench.test(name, stated, made, again, 2))
    return Measurements(tuple(curves))


if __name__ == "__main__":
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else FILE
    write_measurements(make(HIDDEN, seed=1), out)
    print(f"wrote {out}")
