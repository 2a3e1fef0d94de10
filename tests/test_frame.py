"""The frame holds: targets, pins, file sizes, and words that do not belong."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
PACKAGES = ("datagen", "surrogate", "discrepancy", "service")
TEXT = {".py", ".md", ".toml", ".txt", ".sh", ".js", ".css", ".html", ".yml", ""}
SKIPPED = {
    "build",
    "dist",
    "runs",
    "workspaces",
    "pba-models",
    "node_modules",
    "__pycache__",
}

PINS = {
    canonicalize_name(name): version
    for name, version in re.findall(
        r"^([\w.-]+)==(\S+)$", (ROOT / "constraints.txt").read_text(), re.MULTILINE
    )
}


def project_files() -> list[Path]:
    """Text files of the project: nothing hidden, built or installed."""
    found = []
    for folder, folders, files in os.walk(ROOT):
        folders[:] = [
            name
            for name in folders
            if name not in SKIPPED
            and not name.endswith(".egg-info")
            and (name == ".ci" or not name.startswith("."))
        ]
        found += [Path(folder, name) for name in files]
    return sorted(path for path in found if path.suffix in TEXT)


def requirements() -> list[Requirement]:
    """Every requirement of pyproject.toml, those of the extras too."""
    extras = PROJECT["optional-dependencies"].values()
    texts = [*PROJECT["dependencies"], *(text for extra in extras for text in extra)]
    return [Requirement(text) for text in texts]


@pytest.mark.parametrize(
    "target",
    [
        "run",
        "test",
        "lint",
        "format",
        "docs",
        "verification",
        "figures",
        "refinement",
        "mesh-error",
        "recovery",
        "reference",
        "corrected",
        "bench-fem",
    ],
)
def test_make_knows_the_target(target: str) -> None:
    done = subprocess.run(
        ["make", "--dry-run", target],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_ci_runs_make_test() -> None:
    script = ROOT / ".ci/run"
    assert os.access(script, os.X_OK)
    assert script.read_text().rstrip().endswith("make --no-print-directory test")


def test_torch_is_pinned() -> None:
    assert PINS["torch"] == "2.13.0"


def test_every_requirement_is_pinned_in_its_range() -> None:
    for requirement in requirements():
        if requirement.name == PROJECT["name"]:
            assert requirement.extras <= set(PROJECT["optional-dependencies"])
            continue
        pin = PINS.get(canonicalize_name(requirement.name))
        assert pin is not None, f"constraints.txt does not pin {requirement.name}"
        assert requirement.specifier.contains(pin), f"{requirement}: pinned to {pin}"


def test_what_requirements_need_is_pinned() -> None:
    """Walks the installed packages' own requirements from ours."""
    waiting = [(r.name, r.extras) for r in requirements()]
    seen: set[tuple[str, frozenset[str]]] = set()
    missing = set()
    while waiting:
        name, extras = waiting.pop()
        key = (canonicalize_name(name), frozenset(extras))
        if key in seen or key[0] == PROJECT["name"]:
            continue
        seen.add(key)
        try:
            needs = metadata.requires(name) or []
        except metadata.PackageNotFoundError:
            continue  # not for this platform, as mkl off x86-64
        if key[0] not in PINS:
            missing.add(key[0])
        for need in map(Requirement, needs):
            wanted = [{"extra": extra} for extra in ("", *extras)]
            if need.marker is None or any(map(need.marker.evaluate, wanted)):
                waiting.append((need.name, need.extras))
    assert missing == set()
    assert len(seen) > 50


LOADED_OTHERWISE = {"mkl", "plotly", "python-multipart"}
"""Needed for what is in them: a shared library, the page's JavaScript, and what
fastapi reads forms with."""


def imported_packages() -> set[str]:
    """Distributions that the packages import, wherever in a file."""
    homes = metadata.packages_distributions()
    files = [path for name in PACKAGES for path in (ROOT / name).rglob("*.py")]
    names = {
        name
        for path in files
        for node in ast.walk(ast.parse(path.read_text()))
        for name in (
            [alias.name for alias in node.names]
            if isinstance(node, ast.Import)
            else [node.module or ""]
            if isinstance(node, ast.ImportFrom) and node.level == 0
            else []
        )
    }
    roots = {name.split(".")[0] for name in names} - set(PACKAGES)
    return {canonicalize_name(home) for root in roots for home in homes.get(root, [])}


def test_what_is_imported_is_required() -> None:
    run = {canonicalize_name(Requirement(t).name) for t in PROJECT["dependencies"]}
    extra = {canonicalize_name(requirement.name) for requirement in requirements()}
    # Parts of fastapi and pydantic that they document as importable.
    part = {"starlette", "pydantic-core"}
    assert imported_packages() - extra - part == set()
    assert run - imported_packages() - LOADED_OTHERWISE == set()


def test_no_package_file_is_long() -> None:
    long = {
        path.relative_to(ROOT).as_posix(): lines
        for path in project_files()
        if path.relative_to(ROOT).parts[0] in PACKAGES and path.suffix == ".py"
        if (lines := len(path.read_text().splitlines())) > 600
    }
    assert long == {}


MACHINE = re.compile(rf"{re.escape(str(ROOT))}\b|(?<![\w.])/(home|root|Users)/\w+")
# The brackets keep this file from finding itself.
UNFINISHED = re.compile(r"\b(T[O]DO|F[I]XME|X[X]X|NotImplemented[E]rror)\b")


def test_no_file_names_a_machine_or_unfinished_work() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for path in project_files()
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if MACHINE.search(line) or UNFINISHED.search(line)
    ]
    assert found == []


def test_the_words_are_found() -> None:
    assert MACHINE.search(f"open('{ROOT}/file')")
    assert MACHINE.search("see /{}/anna/pba".format("home"))
    assert not MACHINE.search("https://host/home/page")
    assert UNFINISHED.search("# TO{}".format("DO later"))
