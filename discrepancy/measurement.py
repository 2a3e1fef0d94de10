"""What was measured: curves of devices and specimens, SI, each with where it is from.

The curve is the unit of everything that follows: readings of one curve share their
device, its mounting and its camera, and are not independent of each other.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from datagen.device import Design
from datagen.errors import InputError
from datagen.response import OUTPUT_NAMES, Path
from datagen.specimens import Bulge, Tensile

Array = np.ndarray

LOADING, UNLOADING = "loading", "unloading"

JITTER = 0.01
"""Of the largest load: smaller loads, and smaller steps back, are a gauge's."""

SPECIMENS: dict[str, type[Design] | type[Bulge] | type[Tensile]] = {
    "actuator": Design,
    "bulge": Bulge,
    "tensile": Tensile,
}
"""Kinds of specimens, and what describes one of each."""

MEASURED = {
    "actuator": OUTPUT_NAMES,
    "bulge": ("inflation",),
    "tensile": ("stress",),
}
"""Quantities that each kind of specimen can give, by SI name."""


@dataclass(frozen=True)
class Tolerances:
    """How far the true values may be from the stated ones, as standard deviations.

    Parameters
    ----------
    modulus : float, 1
        Of each batch, over its stated modulus.
    thickness : float, m
        Of each layer of each device.
    camera_scale : float, 1
        Of every length in a curve, over the stated scale.

    Raises
    ------
    InputError
        When a value is not a number from 0 to its largest.
    """

    modulus: float = 0.05
    thickness: float = 3e-6
    camera_scale: float = 0.005

    def __post_init__(self) -> None:
        for name, unit, scale, largest in (
            ("modulus", "%", 100.0, 0.5),
            ("thickness", "um", 1e6, 100e-6),
            ("camera_scale", "%", 100.0, 0.2),
        ):
            value = getattr(self, name)
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if not number or not 0 <= value <= largest:
                given = float(value) * scale if number else value
                allowed = f"a number from 0 to {largest * scale:g} {unit}"
                raise InputError(f"tolerance of {name}", given, allowed, unit)


def folded(orientation: float) -> float:
    """The angle from 0 to pi, rad, at which gravity acts alike: by its cosine."""
    return abs(math.remainder(orientation, 2 * math.pi))


@dataclass(frozen=True, eq=False)
class Curve:
    """One device, one run, one orientation: load steps in the order applied.

    Parameters
    ----------
    device : str
        Name of the device or specimen.
    run : int
        From 1; a repeated test of the same device has another number.
    orientation : float, rad
        0 with gravity along -z, pi turned over; kept between them, see `folded`.
    design : Design, Bulge or Tensile
        What was tested, as stated; its type is the kind of specimen.
    load : (s,) array
        Gauge pressure, Pa; of a tensile specimen its stretch.
    time : (s,) array, s, or None
        Strictly increasing.
    branch : (s,) array of str
        ``loading`` first, then ``unloading``.
    outputs : tuple of m str
        SI names of the quantities that were measured, of `MEASURED`.
    values : (s, m) array, SI
        NaN where a reading is missing.
    std : (s, m) array, SI
        Standard deviation of the noise; NaN where it is not given.

    Raises
    ------
    InputError
        When arrays do not fit together or hold what they must not.
    """

    device: str
    run: int
    orientation: float
    design: Design | Bulge | Tensile
    load: Array
    time: Array | None
    branch: Array
    outputs: tuple[str, ...]
    values: Array
    std: Array

    def __post_init__(self) -> None:
        if not self.device or self.device != self.device.strip():
            raise InputError("device", self.device, "text without blanks around it")
        if isinstance(self.run, bool) or self.run != int(self.run) or self.run < 1:
            raise InputError("run", self.run, "a whole number of at least 1")
        for name in ("load", "time", "values", "std"):
            if getattr(self, name) is not None:
                array = np.array(getattr(self, name), dtype=float)
                array.setflags(write=False)
                object.__setattr__(self, name, array)
        object.__setattr__(self, "orientation", folded(self.orientation))
        object.__setattr__(self, "branch", np.array(self.branch, dtype="U9"))
        known = MEASURED[self.specimen]
        if not self.outputs or not set(self.outputs) <= set(known):
            raise InputError("outputs", self.outputs, f"some of {', '.join(known)}")
        steps = self.load.shape
        if len(steps) != 1 or steps[0] < 1 or not np.isfinite(self.load).all():
            raise InputError("load", self.load.tolist(), "a list of finite numbers")
        wanted = (*steps, len(self.outputs))
        if self.values.shape != wanted or self.std.shape != wanted:
            raise InputError("values", self.values.shape, f"shape {wanted}")
        if np.isinf(self.values).any() or not np.isfinite(self.values).any():
            raise InputError("values", "no finite number", "at least one reading")
        given = self.std[~np.isnan(self.std)]
        if not (np.isfinite(given) & (given > 0)).all():
            raise InputError("std", given.min(), "numbers above 0")
        if self.time is not None and (
            self.time.shape != steps or not (np.diff(self.time) > 0).all()
        ):
            raise InputError("time", self.time.tolist(), "increasing times", "s")
        down = self.branch == UNLOADING
        if self.branch.shape != steps or not (down | (self.branch == LOADING)).all():
            allowed = f"{LOADING} or {UNLOADING} at every load step"
            raise InputError("branch", self.branch.tolist(), allowed)
        if (np.diff(down.astype(int)) < 0).any():
            raise InputError("branch", self.branch.tolist(), "loading, then unloading")

    @property
    def specimen(self) -> str:
        """``actuator``, ``bulge`` or ``tensile``."""
        return next(n for n, kind in SPECIMENS.items() if isinstance(self.design, kind))

    @property
    def reach(self) -> Array:
        """(s,) distance from rest, signed: pressure in Pa, or stretch less one."""
        reach: Array = (
            self.load - 1.0 if isinstance(self.design, Tensile) else self.load
        )
        return reach

    @property
    def pressure(self) -> Array:
        """Gauge pressure (s,), Pa."""
        if isinstance(self.design, Tensile):
            raise AttributeError(f"{self.device}: a tensile specimen has no pressure")
        return self.load

    @property
    def stretch(self) -> Array:
        """Stretch (s,) of a tensile specimen."""
        if not isinstance(self.design, Tensile):
            raise AttributeError(f"{self.device}: a pressure test has no stretch")
        return self.load

    @property
    def path(self) -> Path:
        """The load path that a forward model follows."""
        return Path(self.pressure, self.time)

    @property
    def readings(self) -> int:
        """Number of values that are there."""
        return int(np.isfinite(self.values).sum())

    def output(self, name: str) -> Array:
        """(s,) array of one quantity, SI."""
        values: Array = self.values[:, self.outputs.index(name)]
        return values

    @property
    def layers(self) -> dict[str, float]:
        """Stated modulus, Pa, of each layer that takes part in the test."""
        if isinstance(self.design, Design):
            return {
                "upper": self.design.upper_modulus,
                "lower": self.design.lower_modulus,
            }
        return {self.design.layer: self.design.modulus}


@dataclass(frozen=True)
class Batch:
    """One batch of material: everything that states the same modulus.

    Parameters
    ----------
    modulus : float, Pa
        As stated.
    members : tuple of (device, layer)
        Layers made of it; layer is ``upper`` or ``lower``.
    """

    modulus: float
    members: tuple[tuple[str, str], ...]


@dataclass(frozen=True, eq=False)
class Measurements:
    """Curves that are judged together.

    Parameters
    ----------
    curves : tuple of Curve
        At least one; no two share device, run and orientation.
    source : str
        Name of the file.
    sha256 : str
        Of its bytes, hexadecimal.
    warnings : tuple of str
        What was read otherwise than it was written, or looks odd; one line each.
    tolerances : Tolerances
        Of the stated values.

    Raises
    ------
    InputError
        When there is no curve, or one twice, or a device has two designs.
    """

    curves: tuple[Curve, ...]
    source: str = ""
    sha256: str = ""
    warnings: tuple[str, ...] = ()
    tolerances: Tolerances = field(default_factory=Tolerances)

    def __post_init__(self) -> None:
        if not self.curves:
            raise InputError("curves", 0, "at least one curve")
        designs: dict[str, object] = {}
        seen = set()
        for curve in self.curves:
            if designs.setdefault(curve.device, curve.design) != curve.design:
                raise InputError("device", curve.device, "one design a device")
            key = (curve.device, curve.run, curve.orientation)
            if key in seen:
                raise InputError("run", curve.run, f"one curve a run of {curve.device}")
            seen.add(key)

    @property
    def devices(self) -> tuple[str, ...]:
        """Names of the devices and specimens, in order of appearance."""
        return tuple(dict.fromkeys(curve.device for curve in self.curves))

    @property
    def readings(self) -> int:
        """Number of values that are there, over all curves."""
        return sum(curve.readings for curve in self.curves)

    def subset(self, devices: Iterable[str]) -> Measurements:
        """The curves of some devices, in their order here.

        Raises
        ------
        InputError
            When a device is unknown.
        """
        wanted = set(devices)
        for name in sorted(wanted - set(self.devices)):
            raise InputError("device", name, ", ".join(self.devices))
        chosen = tuple(curve for curve in self.curves if curve.device in wanted)
        return Measurements(
            chosen, self.source, self.sha256, self.warnings, self.tolerances
        )

    @cached_property
    def batches(self) -> tuple[Batch, ...]:
        """Batches of material, by rising modulus.

        Layers whose stated moduli agree to one part in 1e9 are one batch, whatever
        the device, the kind of specimen and the layer: who mixes once states one
        number.  Two batches of one recipe have to state what was measured of each.
        """
        members: dict[float, list[tuple[str, str]]] = {}
        for curve in self.curves:
            for layer, modulus in curve.layers.items():
                near = (m for m in members if abs(m - modulus) <= 1e-9 * modulus)
                batch = members.setdefault(next(near, modulus), [])
                if (curve.device, layer) not in batch:
                    batch.append((curve.device, layer))
        return tuple(Batch(m, tuple(members[m])) for m in sorted(members))

    def batch_of(self, device: str, layer: str) -> int:
        """Number of the batch in `batches` that a device's layer is made of.

        Raises
        ------
        InputError
            When the device has no such layer.
        """
        for i, batch in enumerate(self.batches):
            if (device, layer) in batch.members:
                return i
        known = ", ".join(f"{d} {side}" for b in self.batches for d, side in b.members)
        raise InputError("layer", f"{device} {layer}", known)
