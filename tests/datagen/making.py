"""What the tests of generation share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from datagen.dataset import Dataset
from datagen.generate import generate

from .fake_solver import VERSION, Here, solve_fake


def make(out: Path, count: int = 12, seed: int = 3, **options: Any) -> Dataset:
    """Generate with the fake solver, in this process; `options` as of `generate`."""
    given = {"solve": solve_fake, "version": VERSION, "executor": Here()} | options
    return generate(count, seed, out, **given)


def alone(out: Path) -> bool:
    """True when `out` is all there is in its folder."""
    return [path.name for path in out.parent.iterdir()] == [out.name]
