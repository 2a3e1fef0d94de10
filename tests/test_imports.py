"""Imports run one way: datagen <- surrogate <- discrepancy <- service."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

LAYERS = ("datagen", "surrogate", "discrepancy", "service")
"""From the bottom up: a package may import those before it, never one after it."""

WEB = {"fastapi", "starlette", "uvicorn", "pydantic", "httpx", "dbos"}
FRONT = {"typer", "click", "plotly", "matplotlib"}
LEARNING = {"torch", "safetensors", "sklearn"}
BARRED = {
    "datagen": WEB | FRONT | LEARNING,
    "surrogate": WEB | FRONT,
    "discrepancy": WEB | FRONT,
    "service": set(),
}
"""Third-party packages that a layer must not need, wherever in a file."""


def imported_names(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and top-level package of every absolute import, dynamic ones included."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name.split(".")[0]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.lineno, node.module.split(".")[0]
        elif isinstance(node, ast.Call) and node.args:
            called = node.func
            name = called.attr if isinstance(called, ast.Attribute) else None
            name = called.id if isinstance(called, ast.Name) else name
            first = node.args[0]
            if (
                name in ("import_module", "__import__")
                and isinstance(first, ast.Constant)
                and isinstance(first.value, str)
            ):
                yield node.lineno, first.value.split(".")[0]


def offences(root: Path) -> list[str]:
    """Every import under `root` that runs the wrong way, as ``file:line: what``."""
    found = []
    for level, layer in enumerate(LAYERS):
        barred = {*LAYERS[level + 1 :], *BARRED[layer], "tests", "examples"}
        for file in sorted((root / layer).rglob("*.py")):
            for line, name in imported_names(ast.parse(file.read_text())):
                if name in barred:
                    where = file.relative_to(root).as_posix()
                    found.append(f"{where}:{line}: {layer} must not import {name}")
    return found


def test_imports_run_one_way() -> None:
    assert offences(ROOT) == []


def test_every_package_is_walked() -> None:
    packages = {init.parent.name for init in ROOT.glob("*/__init__.py")}
    assert packages == set(LAYERS)


@pytest.mark.parametrize(
    ("file", "source", "offence"),
    [
        ("datagen/a.py", "from surrogate.ensemble import Ensemble", "surrogate"),
        ("datagen/deep/b.py", "def f():\n    import torch.nn as nn", "torch"),
        ("datagen/c.py", "import fastapi", "fastapi"),
        ("surrogate/d.py", "import importlib\nimportlib.import_module('service')", ""),
        ("surrogate/e.py", "if True:\n    from discrepancy import rank", ""),
        ("discrepancy/f.py", "__import__('service.app')", ""),
        ("service/g.py", "from tests.helpers import device", ""),
    ],
)
def test_the_walk_finds_an_offence(
    tmp_path: Path, file: str, source: str, offence: str
) -> None:
    path = tmp_path / file
    path.parent.mkdir(parents=True)
    path.write_text(source)
    assert len(offences(tmp_path)) == 1
    assert offences(tmp_path)[0].startswith(f"{file}:")
    assert offence in offences(tmp_path)[0]


def test_the_walk_allows_the_right_way(tmp_path: Path) -> None:
    for layer in LAYERS:
        (tmp_path / layer).mkdir()
    (tmp_path / "service/a.py").write_text("import fastapi, discrepancy, torch")
    (tmp_path / "surrogate/b.py").write_text("from datagen.space import Space")
    (tmp_path / "datagen/c.py").write_text("from .service import x\nimport numpy")
    assert offences(tmp_path) == []


@pytest.mark.parametrize(
    ("module", "heavy"),
    [
        ("datagen.device", {"torch", "h5py", "skfem", "numba", "dask"}),
        ("datagen.dataset", {"torch", "dask", "distributed", "xarray"}),
        ("service.cli", {"torch", "fastapi", "uvicorn", "plotly", "dask", "numba"}),
    ],
)
def test_heavy_packages_wait_until_they_are_used(module: str, heavy: set[str]) -> None:
    code = f"import sys, {module}; print(*sorted({heavy!r} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == []
