"""Starts generators that are going to be killed.

Imports everything once, then forks a process with a process group of its own for each
line on standard input, and answers with its number.  The lines:

``run OUT``
    generate OUT with two worker processes, resuming what is there;
``crash OUT K``
    the same in one process, which kills itself before its K-th step on the disk and
    ends with status 0 where there is none.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any

COUNT, SEED = 40, 7
FEW = 2
"""Rows of a run with ``crash``."""

DISK = ("mkdir", "fsync", "replace", "unlink", "rmdir")
"""Functions of `os` through which the generator changes the disk."""


def run(out: str) -> None:
    from datagen.generate import generate

    from .fake_solver import VERSION, solve_slowly

    generate(
        COUNT, SEED, out, workers=2, resume=True, solve=solve_slowly, version=VERSION
    )


def crash(out: str, last: int) -> None:
    from datagen.generate import generate

    from .fake_solver import VERSION, Here, solve_fake

    steps = 0

    def counted(function: Callable[..., Any]) -> Callable[..., Any]:
        def step(*args: Any, **options: Any) -> Any:
            nonlocal steps
            steps += 1
            if steps == last:
                os.kill(os.getpid(), signal.SIGKILL)
            return function(*args, **options)

        return step

    for name in DISK:
        setattr(os, name, counted(getattr(os, name)))
    generate(
        FEW, SEED, out, executor=Here(), resume=True, solve=solve_fake, version=VERSION
    )


def main() -> None:
    for name in ("h5py", "scipy.stats", "threadpoolctl", "datagen.generate"):
        import_module(name)  # once, here
    for line in sys.stdin:
        command, out, *rest = line.split()
        process = os.fork()
        if process:
            print(process, flush=True)
            _, status = os.waitpid(process, 0)
            print(os.waitstatus_to_exitcode(status), flush=True)
            continue
        os.setsid()
        if command == "run":
            run(out)
        else:
            crash(out, int(*rest))
        os._exit(0)


if __name__ == "__main__":
    main()
