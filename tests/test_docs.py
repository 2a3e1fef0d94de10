"""The documents tell the truth: code runs, commands exist, numbers are measured."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import urlsplit

import pytest

from docs import corrected

ROOT = Path(__file__).parents[1]
DOCUMENTS = {
    path.relative_to(ROOT).as_posix(): path.read_text()
    for path in (*sorted(ROOT.glob("*.md")), *sorted(ROOT.glob("docs/*.md")))
}
FENCE = re.compile(r"^```([\w-]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PROVIDED = {
    "paths.h5": "surrogate/reference/dataset.h5",
    "bench.csv": "examples/measurements/bench.csv",
}
"""Files of the reader's own that the documents' code opens, and ours in their place."""

NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")


def load_measure() -> ModuleType:
    """docs/measure.py, which is a script and no package's module."""
    spec = importlib.util.spec_from_file_location("measure", ROOT / "docs/measure.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["measure"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


MEASURE = load_measure()


def python_of(text: str) -> str:
    """The ```python blocks of a document, each on the lines where it stands."""
    lines: list[str] = []
    for found in FENCE.finditer(text):
        if found[1] == "python":
            start = text.count("\n", 0, found.start(2))
            lines += [""] * (start - len(lines))
            lines += found[2].splitlines()
    return "\n".join(lines) + "\n"


def commands_of(text: str) -> list[list[str]]:
    """Arguments of every command of a document's shell blocks and code spans."""
    shell = "\n".join(
        found[2].replace("\\\n", " ")
        for found in FENCE.finditer(text)
        if found[1] in ("sh", "bash", "console")
    )
    spans = re.findall(r"`(pba [^`]+)`", FENCE.sub("", text))
    commands = []
    for line in (*shell.splitlines(), *(span.replace("\n", " ") for span in spans)):
        # The lexer joins quoted text and splits at the shell's operators.
        lexer = shlex.shlex(line.removeprefix("$ "), posix=True, punctuation_chars=True)
        lexer.whitespace_split = True
        words: list[str] = []
        for word in lexer:
            if set(word) <= set("|&;<>()"):
                break
            words.append(word)
        if words:
            commands.append(words)
    return commands


PBA = sorted(
    {
        (name, shlex.join(words[1:]))
        for name, text in DOCUMENTS.items()
        for words in commands_of(text)
        if words[0].split("/")[-1] == "pba"
    }
)
CURL = sorted(
    {
        (name, shlex.join(words[1:]))
        for name, text in DOCUMENTS.items()
        for words in commands_of(text)
        if words[0] == "curl"
    }
)


@pytest.mark.parametrize(
    "name", [n for n, text in DOCUMENTS.items() if python_of(text)]
)
def test_python_blocks_run(name: str, tmp_path: Path) -> None:
    for theirs, ours in PROVIDED.items():
        if theirs in DOCUMENTS[name]:
            shutil.copy(ROOT / ours, tmp_path / theirs)
    script = tmp_path / "document.py"
    script.write_text(python_of(DOCUMENTS[name]))
    done = subprocess.run(
        [sys.executable, str(script)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{name}, same lines:\n{done.stderr}"


@pytest.mark.parametrize(("name", "arguments"), PBA)
def test_pba_commands_exist(name: str, arguments: str) -> None:
    """Each names a command that is there and options that it takes."""
    from typer.testing import CliRunner

    from service.cli import app

    words = [word for word in shlex.split(arguments) if word != "..."]
    result = CliRunner().invoke(app, [*words, "--help"])
    assert result.exit_code == 0, f"{name}: pba {arguments}\n{result.output}"


@pytest.mark.parametrize(("name", "arguments"), CURL)
def test_curl_commands_are_answered(name: str, arguments: str, tmp_path: Path) -> None:
    from fastapi.testclient import TestClient

    from service.app import Settings, create_app

    words = shlex.split(arguments)
    address = next(word for word in words if urlsplit(word).netloc)
    sent: dict[str, Any] = {}
    if "-d" in words:
        sent["json"] = json.loads(words[words.index("-d") + 1])
    if "--data-binary" in words:
        file = words[words.index("--data-binary") + 1].removeprefix("@")
        sent["content"] = (ROOT / PROVIDED[file]).read_bytes()
    with TestClient(create_app(Settings(state=tmp_path))) as client:
        answer = client.request(
            "POST" if sent else "GET",
            address[address.index("/", len("http://")) :],
            **sent,
        )
    assert answer.status_code in (200, 201), f"{name}: {answer.text}"


def test_readme_shows_the_way_in() -> None:
    """Two commands, a first prediction by curl, and at most twenty lines of Python."""
    readme = DOCUMENTS["README.md"]
    first = [words for words in commands_of(readme) if words[0] in ("git", "make")][:2]
    assert [words[:2] for words in first] == [["git", "clone"], ["make", "run"]]
    assert any(name == "README.md" for name, _ in CURL)
    code = [line for line in python_of(readme).splitlines() if line.strip()]
    assert 5 <= len(code) <= 20


@pytest.mark.parametrize("name", DOCUMENTS)
def test_links_lead_somewhere(name: str) -> None:
    targets = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", FENCE.sub("", DOCUMENTS[name]))
    missing = [
        target
        for target in targets
        if not urlsplit(target).scheme
        and not (ROOT / name).parent.joinpath(target).exists()
    ]
    assert missing == []


def test_the_page_of_corrected_surrogates_is_of_what_was_measured() -> None:
    assert DOCUMENTS["docs/corrected-accuracy.md"] == corrected.page(corrected.known())


def differences(old: str, new: str) -> list[str]:
    """Where two texts say different things: other words, or numbers apart.

    Numbers may differ by 2 % and by one and a half of the last digit written: other
    processors round differently.
    """
    if NUMBER.split(old) != NUMBER.split(new):
        return ["the words differ"]
    apart = []
    for before, after in zip(NUMBER.findall(old), NUMBER.findall(new), strict=True):
        decimals = len(before.partition(".")[2].partition("e")[0])
        digit = 10.0 ** (-decimals + int(before.partition("e")[2] or 0))
        allowed = 0.02 * abs(float(before)) + 1.5 * digit
        if abs(float(before) - float(after)) > allowed:
            apart.append(f"{before} is now {after}")
    return apart


def quoted() -> dict[str, list[str]]:
    """Every measured block of the documents, as it stands there."""
    found: dict[str, list[str]] = {}
    for text in DOCUMENTS.values():
        for name, body in MEASURE.blocks_of(text).items():
            found.setdefault(name, []).append(body)
    return found


def test_every_table_of_numbers_is_measured() -> None:
    """A README table with a decimal number in it stands in a measured block."""
    assert set(quoted()) == set(MEASURE.BLOCKS)
    free = MEASURE.BLOCK.sub("", DOCUMENTS["README.md"])
    assert [line for line in free.splitlines() if re.match(r"\|.*\d\.\d", line)] == []


@pytest.mark.parametrize("name", MEASURE.BLOCKS)
def test_measured_blocks_are_filled(name: str) -> None:
    for body in quoted()[name]:
        assert len(NUMBER.findall(body)) >= 3
        assert "Measured by `" in body


@pytest.mark.parametrize("name", [n for n, b in MEASURE.BLOCKS.items() if b.repeats])
def test_measured_blocks_are_true(name: str) -> None:
    measured = MEASURE.BLOCKS[name].write()
    for body in quoted()[name]:
        assert differences(body, measured) == [], "run `make docs`"


def test_differences_are_found() -> None:
    old = "| `tip` | 0.71 | 3.2e-05 |\n"
    assert differences(old, old) == []
    assert differences(old, "| `tip` | 0.72 | 3.2e-05 |\n") == []
    assert differences(old, "| `tip` | 0.75 | 3.2e-05 |\n") == ["0.71 is now 0.75"]
    assert differences(old, "| `tip` | 0.71 | 3.6e-05 |\n") == [
        "3.2e-05 is now 3.6e-05"
    ]
    assert differences(old, "| `angle` | 0.71 | 3.2e-05 |\n") == ["the words differ"]


def test_documents_are_read_as_meant() -> None:
    text = (
        "Run `pba effects list`.\n```python\nx = 1\n```\n\n```python\ny = x\n```\n"
        "```sh\n$ pba solve --set a=1 \\\n  --json | jq '.a | .b' # say\n```\n"
    )
    assert python_of(text) == "\n\nx = 1\n\n\n\ny = x\n"
    assert commands_of(text) == [
        ["pba", "solve", "--set", "a=1", "--json"],
        ["pba", "effects", "list"],
    ]


def test_blocks_are_filled_where_they_stand() -> None:
    text = "a\n<!-- begin: x -->\nold\n<!-- end: x -->\nb\n"
    assert MEASURE.blocks_of(text) == {"x": "old\n"}
    filled = MEASURE.fill(text, "x", r"new \1" + "\n")
    assert filled == text.replace("old", r"new \1")
    assert MEASURE.fill(text, "y", "new\n") == text
