"""Curves of made-up devices, with errors of known size and no finite elements."""

from __future__ import annotations

import math

import numpy as np

from discrepancy.evidence import Fit, fit
from discrepancy.missing import Kind, Labels
from discrepancy.noise import Readings
from discrepancy.study import Null
from discrepancy.target import Prediction

Array = np.ndarray

STEPS = 7
KPA = 1e3
INFLATION = Kind("actuator", "inflation", 0.0, "loading")


def smooth(kind: str, place: Array, rng: np.random.Generator) -> Array:
    """One smooth error (s,) of standard deviation 1; not of the kernel fitted."""
    if kind == "gaussian":
        apart = place[:, None] - place[None, :]
        kernel = np.exp(-0.5 * (apart / 0.3) ** 2) + 1e-10 * np.eye(len(place))
        error: Array = np.linalg.cholesky(kernel) @ rng.standard_normal(len(place))
        return error
    if kind == "slope":
        return np.asarray(place * rng.standard_normal())
    turns = rng.uniform(0.3, 1.5)
    return np.asarray(
        np.sqrt(2) * np.sin(2 * np.pi * (place * turns + rng.uniform(0, 1)))
    )


def devices(
    rng: np.random.Generator,
    count: int,
    *,
    effect: float = 0.0,
    begin: float = 0.0,
    thin: int | None = None,
    errors: str = "gaussian",
    calibrated: bool = True,
    modulus: float | None = None,
) -> tuple[Fit, Labels]:
    """Fit of the baseline to devices with 1 % smooth error and 0.3 % noise.

    Parameters
    ----------
    count : int
        Devices; each has one curve.
    effect : float
        What is missing, as a share of the curve's maximum at the largest pressure; it
        grows from the share `begin` of that pressure.
    thin : int, optional
        Only the first ones have it, all by default.
    calibrated : bool
        Whether the modulus, every thickness and every camera are calibrated.
    modulus : float, optional
        True modulus, in tolerances from the stated one; drawn by default.
    """
    device = np.repeat(np.arange(count), STEPS)
    step = np.tile(np.linspace(1 / STEPS, 1, STEPS), count)
    scale = np.repeat(1 + 0.3 * np.arange(count) / count, STEPS)
    base = scale * np.sqrt(step)
    own = (device[:, None] == np.arange(count)).astype(float)
    columns = np.concatenate(
        [
            -0.025 * base[:, None],
            0.03 * (base * (1.3 - 0.6 * step))[:, None] * own,
            0.005 * base[:, None] * own,
        ],
        axis=1,
    )
    columns = columns[:, : (None if calibrated else 0)]
    truth = rng.standard_normal(columns.shape[1])
    if modulus is not None:
        truth[0] = modulus
    error = np.concatenate([smooth(errors, step[:STEPS], rng) for _ in range(count)])
    hit = device < (count if thin is None else thin)
    grown = np.clip((step - begin) / (1 - begin), 0, None)
    noise = 0.003 * scale
    value = base + columns @ truth + 0.01 * scale * error + effect * scale * hit * grown
    value = value + noise * rng.standard_normal(len(value))
    zero = np.zeros(len(value), dtype=int)
    readings = Readings(
        value=value,
        group=zero,
        curve=device,
        place=step,
        noise=noise,
        stated=np.ones(len(value), dtype=bool),
        device=device,
        scale=scale,
    )
    pulls = np.zeros((columns.shape[1], 3 if calibrated else 0))
    if calibrated:
        pulls[0, 0] = 1
        pulls[1 : 1 + count, 1] = pulls[1 + count :, 2] = count**-0.5
    labels = Labels(
        kinds=(INFLATION,),
        kind=zero,
        load=50 * KPA * step,
        traits={
            "upper_thickness": np.linspace(60e-6, 120e-6, count),
            "length": np.linspace(6e-3, 9e-3, count),
            "width": np.full(count, 2e-3),
        },
        pulls=pulls,
    )
    nothing = Null("nothing", Prediction(base, np.zeros((len(base), 0)), columns))
    return fit(readings, nothing, evidence=False), labels


def residuals(
    spread: tuple[float, ...], count: int, rng: np.random.Generator
) -> tuple[list[Array], Array]:
    """Of models with errors `spread` on `count` devices, some hard for all models.

    Devices differ by a factor of exp(0.3), one standard deviation.  The readings of one
    device are 8; models share most of their residuals.
    """
    device = np.repeat(np.arange(count), 8)
    hard = np.exp(0.3 * rng.standard_normal(count) - 0.09)[device]
    common = rng.standard_normal(len(device))
    own = 0.3 * rng.standard_normal((len(spread), len(device)))
    return [
        s * hard * (common + o) / math.hypot(1, 0.3)
        for s, o in zip(spread, own, strict=True)
    ], device
