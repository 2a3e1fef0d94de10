"""A dataset from closed forms, about as hard as the real one, for tests.

Roof and floor are arcs whose membrane stiffness depends on how freely the rim is
drawn in; the strip bends under their tension and the thrust on the end walls, and
turns far enough for the tip to lag behind.  None of these forms is the one that
`surrogate.baseline` uses.  As in the real ones, everything depends on p/E and on ratios
of lengths alone, and a strip turned over is the same strip.
"""

from __future__ import annotations

import numpy as np

from datagen.dataset import Dataset
from datagen.device import DESIGN_SPACE, MAX_PRESSURE
from datagen.response import OUTPUT_NAMES
from datagen.space import Space
from datagen.worker import NO_STEP, STEP_STATUS

Array = np.ndarray

STEPS = 20


def synthetic(
    count: int,
    seed: int,
    space: Space = DESIGN_SPACE,
    max_pressure: float = MAX_PRESSURE,
) -> Dataset:
    """Sampled designs and their paths."""
    inputs = space.sample(count, seed)
    pressure = np.full((count, STEPS), np.nan)
    values = np.full((count, STEPS, len(OUTPUT_NAMES)), np.nan)
    status = np.full((count, STEPS), STEP_STATUS.index(NO_STEP), dtype=np.int8)
    limit = np.full(count, np.nan)
    for i, row in enumerate(inputs):
        design = dict(zip(space.names, map(float, row), strict=True))
        steps = STEPS - i % 7
        own, limit[i] = load_steps(design, steps, max_pressure)
        pressure[i, :steps] = own
        values[i, :steps] = response(design, own)
        status[i, :steps] = 0
    met = np.isfinite(limit)
    return Dataset(
        variables=space.names,
        inputs=inputs,
        pressure=pressure,
        outputs=OUTPUT_NAMES,
        values=values,
        status=status,
        path_status=tuple("limit_point" if m else "completed" for m in met),
        message=("",) * count,
        limit_pressure=limit,
        space=space,
        seed=seed,
        level="synthetic",
        effects=tuple(
            dict.fromkeys(p.name.split(".")[0] for p in space if "." in p.name)
        ),
        generator_version="synthetic",
        max_pressure=max_pressure,
    )


def load_steps(
    design: dict[str, float], steps: int, max_pressure: float
) -> tuple[Array, float]:
    """(s,) Pa, denser towards the limit pressure, which is returned where met."""
    along = np.linspace(0, 1, steps + 1)[1:]
    limit = min(arc(design, layer)[0][-1] for layer in ("upper", "lower"))
    if limit < max_pressure:
        return limit * (1 - (1 - along) ** 2), limit
    return max_pressure * along, float("nan")


def arc(design: dict[str, float], layer: str) -> tuple[Array, Array, Array, float]:
    """Pressure, rise and stretch along one balloon's roof or floor up to its limit."""
    d = design
    long = d["balloon_length"] / d["divisions_x"]
    wide = d["balloon_width"] / d["divisions_y"]
    t, mu = d[f"{layer}_thickness"], d[f"{layer}_modulus"] / 2.96
    a, ratio = min(long, wide) / 2 + 0.35 * t, min(long, wide) / max(long, wide)
    theta = np.linspace(0, 2.6, 300)
    x = np.tan(theta / 2)
    sinc = np.sinc(theta / np.pi)
    plate = 8.5 * (1 + 1.1 * ratio**4) / ((a / t) ** 2 + 5)
    freedom = np.log1p(long / wide * a / d["rim"]) / d["divisions_y"]
    membrane = (1 + 0.95 * ratio**3.5) / (1 + freedom * np.exp(-2 * x))
    membrane *= 0.85 / (1 + 0.2 * x * x)
    pressure = (plate * x + membrane * theta * (1 - sinc**4)) * mu * t / a
    falling = np.flatnonzero(np.diff(pressure) <= 0)
    end = int(falling[0]) + 1 if len(falling) else len(theta)
    return pressure[:end], (a * x * (1 + 0.1 * ratio))[:end], 1 / sinc[:end], mu * t


def response(
    design: dict[str, float], pressure: Array, spacer_modulus: float | None = None
) -> Array:
    """(s, 5) outputs, SI, at (s,) pressures up to the limit."""
    d = design
    spacer = spacer_modulus or d["lower_modulus"]
    rise, pull = {}, {}
    long = d["balloon_length"] / d["divisions_x"]
    wide = d["balloon_width"] / d["divisions_y"]
    share = long / (long + wide)
    for layer in ("upper", "lower"):
        p, w, stretch, strength = arc(d, layer)
        rise[layer] = np.interp(pressure, p, w)
        s = np.interp(pressure, p, stretch)
        stress = share * (1 - s**-2) + (1 - share) * (s - s**-3)
        pull[layer] = 0.6 * strength * d["balloon_width"] * stress
    lower, gap, upper = d["lower_thickness"], d["cavity_height"], d["upper_thickness"]
    solid = 2 * d["rim"] + (d["divisions_y"] - 1) * d["wall"]
    soft = {k: solid + d["balloon_width"] / (1 + w / wide) for k, w in rise.items()}
    parts = (
        (d["lower_modulus"] * soft["lower"] * lower, lower, lower / 2),
        (spacer * solid * gap, gap, lower + gap / 2),
        (d["upper_modulus"] * soft["upper"] * upper, upper, lower + gap + upper / 2),
    )
    neutral = sum(k * z for k, _, z in parts) / sum(k for k, _, _ in parts)
    stiffness = sum(k * (t * t / 12 + (z - neutral) ** 2) for k, t, z in parts)
    thrust = pressure * gap * d["balloon_width"]
    moment = (
        thrust * (neutral - lower - gap / 2)
        + pull["upper"] * (lower + gap + upper / 2 - neutral + 0.3 * rise["upper"])
        - pull["lower"] * (neutral - lower / 2 + 0.3 * rise["lower"])
    )
    curvature = 0.5 * moment / stiffness * (1 + 0.2 * gap / (lower + upper))
    angle = curvature * d["balloon_length"]
    angle = 1.5 * np.tanh(angle / 1.5)
    span = d["balloon_length"] + (d["divisions_x"] - 1) * d["wall"]
    tip = span * angle / 2 * np.sinc(angle / 2 / np.pi) + d["tip_margin"] * np.sin(
        angle
    )
    area = d["balloon_length"] * d["balloon_width"]
    volume = 0.55 * area * (rise["upper"] + rise["lower"])
    if "tilt.angle" in d:
        tip, angle = tip + d["tilt.angle"] * span, angle + d["tilt.angle"]
    return np.stack([tip, angle, rise["upper"], rise["lower"], volume], axis=1)
