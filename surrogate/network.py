"""Small networks, stacked: all members of an ensemble in one batched product.

Training uses PyTorch, answering uses NumPy: a prediction of one design costs tens of
microseconds and needs no heavy import.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import torch

Array = np.ndarray


@dataclass(frozen=True)
class Stack:
    """M multilayer perceptrons of one shape, with SiLU between the layers.

    Parameters
    ----------
    weights : tuple of (M, a, b) arrays
    biases : tuple of (M, 1, b) arrays
    mean, scale : (f,) arrays
        Inputs are centred and scaled by these first.
    """

    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    mean: Array
    scale: Array

    @property
    def members(self) -> int:
        return int(self.weights[0].shape[0])

    def __call__(self, x: Array) -> Array:
        """(M, N, k) answers at (N, f) inputs."""
        # In double precision: rounding in single precision would make the answer
        # depend on the size of the device in the seventh digit.
        h: Array = (x - self.mean) / self.scale
        last = len(self.weights) - 1
        for i, (w, b) in enumerate(zip(self.weights, self.biases, strict=True)):
            h = np.matmul(h, w) + b
            if i < last:
                h /= 1 + np.exp(-h)
        return h

    def arrays(self) -> dict[str, Array]:
        """Arrays by name, for a file; single precision but for the input scaling."""
        out = {"mean": self.mean, "scale": self.scale}
        for i, (w, b) in enumerate(zip(self.weights, self.biases, strict=True)):
            out[f"weight{i}"] = w.astype(np.float32)
            out[f"bias{i}"] = b.astype(np.float32)
        return out

    @classmethod
    def from_arrays(cls, arrays: dict[str, Array]) -> Stack:
        """Inverse of `arrays`.  A missing array is a `KeyError`."""
        layers = sum(name.startswith("weight") for name in arrays)
        pick = [
            tuple(arrays[f"{kind}{i}"].astype(float) for i in range(max(layers, 1)))
            for kind in ("weight", "bias")
        ]
        return cls(pick[0], pick[1], arrays["mean"], arrays["scale"])


@dataclass(frozen=True)
class FitSettings:
    """How a stack is trained.

    Parameters
    ----------
    hidden : tuple of int
        Widths of the hidden layers.
    steps : int
        Most optimiser steps.
    batch : int
        Rows in one step of one member.
    rate : float
        Largest learning rate (Adam with decoupled weight decay, cosine schedule).
    decay : float
        Weight decay; strong by usual standards, as designs are few.
    check_every : int
        Steps between two looks at the held-out loss.
    patience : int
        Looks without a better held-out loss before training stops.
    """

    hidden: tuple[int, ...] = (96, 96)
    steps: int = 2000
    batch: int = 512
    rate: float = 1e-2
    decay: float = 1.0
    check_every: int = 100
    patience: int = 10


@dataclass(frozen=True)
class Rows:
    """Training rows grouped by design: the unit that is split and weighted.

    Parameters
    ----------
    start, count : (d,) int arrays
        First row and number of rows of each design; rows of a design are adjacent.
    held_out : (M, d) bool array
        Designs that a member must not see; each member holds out at least one.
    """

    start: Array
    count: Array
    held_out: Array


Loss = Callable[["torch.Tensor", "torch.Tensor"], "torch.Tensor"]
"""loss(answers (M, b, k), rows (M, b)) -> (M, b)."""

Progress = Callable[[str, int, int, float], None]
"""progress(stage, step, steps, held-out loss)."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch on one thread: sums then have one order, and runs repeat bit by bit."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def fit(
    x: Array,
    rows: Rows,
    outputs: int,
    loss: Loss,
    settings: FitSettings,
    seed: int,
    stage: str = "",
    progress: Progress | None = None,
) -> tuple[Stack, dict[str, Any]]:
    """Train a stack; each entry of `rows` counts the same, however many rows it has.

    All members advance together and stop together, at the step where the mean loss
    over each one's own held-out designs is least.  One number, the step, is all that
    held-out designs decide, so they stay fit for calibration.

    Parameters
    ----------
    x : (N, f) array
        Inputs.
    rows : Rows
    outputs : int
        k, answers of a network.
    loss : Loss
        Loss of each answer against its row.
    settings : FitSettings
    seed : int
    stage, progress
        Told of the held-out loss at each look.

    Returns
    -------
    Stack and a dict of `step`, `loss`, `train_loss`.
    """
    import torch

    mean, scale = x.mean(axis=0), x.std(axis=0)
    # A column that does not vary carries nothing; its scale must not blow up noise.
    scale = np.where(scale > 1e-9, scale, 1.0)
    inputs = torch.tensor((x - mean) / scale, dtype=torch.float32)
    generator = torch.Generator().manual_seed(seed)
    members = len(rows.held_out)
    sizes = (x.shape[1], *settings.hidden, outputs)
    weights, biases = _start(members, sizes, generator)
    optimiser = torch.optim.AdamW(
        [
            {"params": weights, "weight_decay": settings.decay},
            {"params": biases, "weight_decay": 0.0},
        ],
        lr=settings.rate,
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, settings.rate, total_steps=settings.steps + 1, pct_start=0.1
    )
    draw = _Draw(rows, settings.batch, generator)
    look_rows, look_weight = _held_out_rows(rows)
    best: tuple[float, int, list[torch.Tensor]] = (np.inf, 0, [])
    train_loss, stale = float("nan"), 0
    for step in range(1, settings.steps + 1):
        picked = draw()
        errors = loss(_forward(inputs[picked], weights, biases), picked)
        total = errors.mean(dim=1).sum()
        optimiser.zero_grad()
        total.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
        if step % settings.check_every and step != settings.steps:
            continue
        with torch.no_grad():
            answers = _forward(inputs[look_rows], weights, biases)
            value = float((loss(answers, look_rows) * look_weight).sum() / members)
        train_loss = float(total.detach()) / members
        if value < best[0]:
            best = (value, step, [p.detach().clone() for p in (*weights, *biases)])
            stale = 0
        else:
            stale += 1
        if progress:
            progress(stage, step, settings.steps, value)
        if stale >= settings.patience:
            break
    kept = [p.numpy().astype(float) for p in best[2]]
    stack = Stack(tuple(kept[: len(weights)]), tuple(kept[len(weights) :]), mean, scale)
    return stack, {"step": best[1], "loss": best[0], "train_loss": train_loss}


def _start(
    members: int, sizes: Sequence[int], generator: torch.Generator
) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
    """He-like start; the last layer small, so that training starts from the terms."""
    import torch

    weights, biases = [], []
    for i, (a, b) in enumerate(pairwise(sizes)):
        gain = 0.1 if i == len(sizes) - 2 else 1.4
        values = torch.randn(members, a, b, generator=generator) * gain / a**0.5
        weights.append(values.requires_grad_())
        biases.append(torch.zeros(members, 1, b).requires_grad_())
    return weights, biases


def _forward(
    x: torch.Tensor, weights: list[torch.Tensor], biases: list[torch.Tensor]
) -> torch.Tensor:
    import torch

    last = len(weights) - 1
    for i, (w, b) in enumerate(zip(weights, biases, strict=True)):
        x = torch.baddbmm(b, x, w)
        if i < last:
            x = torch.nn.functional.silu(x)
    return x


class _Draw:
    """Rows for one step: a design uniformly, then one of its rows uniformly."""

    def __init__(self, rows: Rows, batch: int, generator: torch.Generator) -> None:
        import torch

        pools = [np.flatnonzero(~held) for held in rows.held_out]
        most = max(len(pool) for pool in pools)
        self.size = torch.tensor([[len(pool)] for pool in pools])
        self.pool = torch.tensor(np.stack([np.resize(pool, most) for pool in pools]))
        self.start, self.count = torch.tensor(rows.start), torch.tensor(rows.count)
        self.shape, self.generator = (len(pools), batch), generator

    def __call__(self) -> torch.Tensor:
        import torch

        u, v = torch.rand(2, *self.shape, generator=self.generator, dtype=torch.float64)
        design = self.pool.gather(1, (u * self.size).long())
        row: torch.Tensor = self.start[design] + (v * self.count[design]).long()
        return row


def _held_out_rows(rows: Rows) -> tuple[torch.Tensor, torch.Tensor]:
    """(M, r) rows that each member holds out and their weights, padded with weight 0.

    Weights of a member sum to 1, and each design has the same share of them.
    """
    import torch

    index, weight = [], []
    for held in rows.held_out:
        designs = np.flatnonzero(held)
        index.append(
            np.concatenate([rows.start[d] + np.arange(rows.count[d]) for d in designs])
        )
        weight.append(
            np.repeat(1 / (rows.count[designs] * len(designs)), rows.count[designs])
        )
    most = max(len(i) for i in index)
    padded = np.stack([np.pad(i, (0, most - len(i))) for i in index])
    padding = np.stack([np.pad(w, (0, most - len(w))) for w in weight])
    return torch.tensor(padded), torch.tensor(padding, dtype=torch.float32)
