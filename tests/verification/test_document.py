"""The list of mutations fits the sources, and the document tells of everything."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from docs import verify
from docs.verify import ROW, SECTIONS, told

from .benchmarks import BENCHMARKS, Row
from .mutations import MUTATIONS, ROOT, Caught, Mutation

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


OF_DEVICES = ("history", "journey", "continuation", "chart", "observe", "overlap")
OF_DEVICES += ("adjoint", "sensitivity", "surfaces", "mesh_error")
"""Files of the solver whose tests are in tests/datagen."""


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.what)
def test_mutations_can_be_made(mutation: Mutation) -> None:
    source = (ROOT / "datagen" / mutation.file).read_text()
    assert source.count(mutation.old) == 1
    assert mutation.new != mutation.old
    assert mutation.caught_by


def test_every_test_of_the_solver_has_a_mutation_that_fails_it() -> None:
    tests = set().union(*(names_in(HERE / f"test_{n}.py") for n in OF_THE_SOLVER))
    caught = {name.partition("[")[0] for m in MUTATIONS for name in m.caught_by}
    of_devices = {name for name in caught if name.startswith("datagen/")}
    assert caught - of_devices == tests
    for name in of_devices:
        file = ROOT / "tests" / name.partition("::")[0]
        assert name.removeprefix("datagen/") in names_in(file)


def test_files_whose_tests_are_elsewhere_have_mutations() -> None:
    assert {f"{name}.py" for name in OF_DEVICES} <= {m.file for m in MUTATIONS}


def test_every_benchmark_has_a_mutation_that_fails_it() -> None:
    caught = {name for mutation in MUTATIONS for name in mutation.caught_by}
    prefix = "test_benchmarks.py::test_standard_mesh"
    assert {f"{prefix}[{name}]" for name in BENCHMARKS} <= caught


def test_the_document_tells_of_everything() -> None:
    text = DOCUMENT.read_text()
    titles = [title for title, _ in SECTIONS.values()]
    assert [title for title in titles if f"\n## {title}\n\n" not in text] == []
    assert "Not run yet" not in text


def test_the_document_says_of_every_mutation_which_tests_fail() -> None:
    rows = {found[1]: found[0] for found in ROW.finditer(DOCUMENT.read_text())}
    assert list(rows) == [mutation.what for mutation in MUTATIONS]
    for mutation in MUTATIONS:
        row = rows[mutation.what]
        assert f"| `{mutation.file}` |" in row
        named = [name.partition("::")[2] for name in mutation.caught_by]
        assert re.findall(r"`(test_[^`]+)`", row) == named


def test_nothing_is_missed() -> None:
    """A bar not met, or a break that no test sees, would stand in the document."""
    assert [line for line in DOCUMENT.read_text().splitlines() if told(line)] == []


def test_the_command_fails_where_something_is_missed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """And leaves alone what it was not asked for."""
    copy = tmp_path / "verification.md"
    copy.write_text(DOCUMENT.read_text())
    monkeypatch.setattr(verify, "DOCUMENT", copy)
    monkeypatch.setattr(
        verify, "caught", lambda *_: {"test_a.py::test_a": Caught(0, 1)}
    )
    assert verify.main(["--only", "bricks.py"]) == 1
    changed = set(copy.read_text().splitlines()) - set(
        DOCUMENT.read_text().splitlines()
    )
    (row, count) = sorted(changed, reverse=True)
    assert row.endswith("| `bricks.py` | `test_a` MISSED IT |")
    assert f"{len(MUTATIONS) - 1} of {len(MUTATIONS)} breaks" in count


def test_a_bar_that_is_not_met_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    off = (Row("case", "quantity", 1.0, 1.006, 3),)
    monkeypatch.setattr(verify, "run", lambda *_: off)
    text = verify.benchmark("sphere", BENCHMARKS["sphere"])
    assert sum(map(told, text.splitlines())) == 2
