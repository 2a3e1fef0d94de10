"""The list of mutations fits the sources, and the document tells of everything."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from .benchmarks import BENCHMARKS
from .mutations import MUTATIONS, ROOT, Mutation

HERE = Path(__file__).parent
DOCUMENT = ROOT / "docs/verification.md"
OF_THE_SOLVER = ("benchmarks", "convergence", "laws", "patch", "rates")


def names_in(file: Path) -> set[str]:
    """Names of a file's tests, ``file::test``."""
    tree = ast.parse(file.read_text())
    return {
        f"{file.name}::{node.name}"
        for node in tree.body
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    }


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.what)
def test_mutations_can_be_made(mutation: Mutation) -> None:
    source = (ROOT / "datagen" / mutation.file).read_text()
    assert source.count(mutation.old) == 1
    assert mutation.new != mutation.old
    assert mutation.caught_by


def test_every_test_of_the_solver_has_a_mutation_that_fails_it() -> None:
    tests = set().union(*(names_in(HERE / f"test_{n}.py") for n in OF_THE_SOLVER))
    caught = {name.partition("[")[0] for m in MUTATIONS for name in m.caught_by}
    assert caught == tests


def test_every_benchmark_has_a_mutation_that_fails_it() -> None:
    caught = {name for mutation in MUTATIONS for name in mutation.caught_by}
    prefix = "test_benchmarks.py::test_standard_mesh"
    assert {f"{prefix}[{name}]" for name in BENCHMARKS} <= caught


def test_the_document_tells_of_everything() -> None:
    text = DOCUMENT.read_text()
    titles = [benchmark.title for benchmark in BENCHMARKS.values()]
    words = [mutation.what for mutation in MUTATIONS]
    assert [part for part in titles + words if part not in text] == []
