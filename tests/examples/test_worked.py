"""The worked example's parts: the user's effect, and the shell that runs commands."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from datagen.effects import catalogue
from datagen.effects.conformance import check
from examples import worked

LONGEST = 18
"""Lines of the effect's file that are not empty, imports included."""


def test_the_users_effect_is_short_and_passes_every_check() -> None:
    file = worked.EFFECTS / "thin_cure.py"
    code = [line for line in file.read_text().splitlines() if line.strip()]
    report = check(catalogue(worked.EFFECTS)["thin_cure"])
    assert report.passed, report
    assert len(code) <= LONGEST


def test_a_command_that_fails_ends_the_example(tmp_path: Path) -> None:
    shell = worked.Shell(tmp_path)
    assert "cure_mismatch" in shell.run("effects list")
    with pytest.raises(subprocess.CalledProcessError):
        shell.run("rank nowhere.csv")
