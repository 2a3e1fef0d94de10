"""The kill test itself: it passes on what is sound and fails on what is not."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

import pytest

from examples import kill_generate

FEW = Namespace(kills=1, designs=2, seed=3, level="draft", workers=1, max_pressure=2.0)


def test_a_killed_run_is_finished_and_equal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kills = kill_generate.compare(tmp_path, FEW)
    assert f"equal after {kills} kills" in capsys.readouterr().out


@pytest.fixture
def no_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs that take no time; every kill strikes."""
    monkeypatch.setattr(kill_generate.subprocess, "run", lambda *_, **__: None)
    monkeypatch.setattr(kill_generate, "kill_once", lambda *_, **__: True)


@pytest.mark.usefixtures("no_processes")
def test_a_lost_path_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    counts = iter([5, 4])
    monkeypatch.setattr(kill_generate, "finished", lambda _: next(counts))
    with pytest.raises(SystemExit, match="1 finished paths were lost"):
        kill_generate.compare(tmp_path, FEW)


@pytest.mark.usefixtures("no_processes")
def test_another_value_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class File:
        def __init__(self, path: Path) -> None:
            self.path = path

        def digest(self) -> str:
            return self.path.name

    monkeypatch.setattr(kill_generate.Dataset, "read", File)
    with pytest.raises(SystemExit, match="differs"):
        kill_generate.compare(tmp_path, FEW)
