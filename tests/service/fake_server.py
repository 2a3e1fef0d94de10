"""The real server on fake parts: ``python -m tests.service.fake_server STATE PORT``.

Worker processes import this module again, as they do with any main module; what the
server alone needs is therefore imported where it is used.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from service.app import Settings


def settings(state: Path, wait: float = 20.0) -> Settings:
    """Settings of a server whose jobs are the fake ones."""
    from service.app import Settings
    from service.jobs import Kind
    from tests.service import fakes

    kinds = {name: Kind(task) for name, task in fakes.KINDS.items()}
    return Settings(
        state,
        wait=wait,
        workspace=state / "models",
        kinds=kinds,
        fem_version=lambda level: f"fake-{level}",
    )


def main(state: Path, port: int) -> None:
    """Serve until stopped."""
    from service.serve import run
    from tests.service.fakes import FakeSurrogate

    run(settings(state), port=port, load_model=lambda _folder: FakeSurrogate())


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
