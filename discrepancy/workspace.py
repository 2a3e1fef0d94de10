"""Workspaces: a folder of model versions, and which of them is in use.

::

    WORKSPACE/
      current.json   the version in use, and those in use before it
      NAME/          a version, see `layout`

A workspace belongs to one lab and its batches: versions of one never serve another.
The one in use changes by renaming one small file, so that a reader sees the old one or
the new one.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from datagen.atomic import TEMPORARY, reason, sync, write_text
from datagen.errors import FileError, InputError

from .layout import BASELINE, is_version, record

if TYPE_CHECKING:
    from .version import ModelVersion

CURRENT = "current.json"

SCHEMA, SCHEMA_VERSION = "pba-workspace", 1

VARIABLE, DEFAULT = "PBA_WORKSPACE", "pba-models"
"""Environment variable that names the workspace, and its folder without one."""

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")

SHORTEST = 4
"""Digits of an id that can stand for it."""

KEPT = 100
"""Versions in use before, as far back as `Workspace.undo` goes."""


def default_workspace() -> Path:
    """Folder named by ``PBA_WORKSPACE``, else ``pba-models`` in the current one."""
    return Path(os.environ.get(VARIABLE) or DEFAULT)


@dataclass(frozen=True)
class Entry:
    """A version of a workspace.

    Parameters
    ----------
    name : str
        Of its folder.
    version : ModelVersion or None
        None where it cannot be read.
    problem : str
        Why not.
    """

    name: str
    version: ModelVersion | None
    problem: str = ""


@dataclass(frozen=True)
class Workspace:
    """A folder of model versions.

    Parameters
    ----------
    folder : Path
        It need not be there yet.
    """

    folder: Path

    # -- what is there -----------------------------------------------------------------

    def entries(self) -> tuple[Entry, ...]:
        """All versions, by date and name; those that cannot be read come last."""
        from .folder import read  # heavy: only where a version is looked at

        found = []
        for path in self._folders():
            try:
                found.append(Entry(path.name, read(path)))
            except FileError as error:
                found.append(Entry(path.name, None, str(error)))
        return tuple(
            sorted(
                found,
                key=lambda one: (
                    one.version is None,
                    one.version.date if one.version else "",
                    one.name,
                ),
            )
        )

    def _folders(self) -> list[Path]:
        if not self.folder.is_dir():
            return []
        return [
            path
            for path in sorted(self.folder.iterdir())
            if NAME.fullmatch(path.name) and is_version(path)
        ]

    def find(self, text: str) -> Entry:
        """A version by its name, its id, or the first digits of its id.

        Raises
        ------
        FileError
            When that version cannot be read.
        InputError
            When there is none, or several ids begin so.
        """
        entries = self.entries()
        found = [one for one in entries if one.name == text]
        if not found and len(text) >= SHORTEST:
            found = [
                one
                for one in entries
                if one.version is not None and one.version.version.startswith(text)
            ]
        if len(found) == 1:
            if found[0].version is None:
                raise FileError(self.folder / found[0].name, _why(found[0]))
            return found[0]
        names = [one.name for one in entries]
        if found:
            names = [one.name for one in found]
        raise InputError("model", text, ", ".join([BASELINE, *names]))

    def current(self) -> Entry | None:
        """The version in use; None for the baseline.

        Raises
        ------
        FileError
            When it or ``current.json`` cannot be read.
        """
        name = self._history()[-1]
        return None if name == BASELINE else self.find(name)

    @property
    def current_name(self) -> str:
        """Name of the version in use, or `layout.BASELINE`."""
        return self._history()[-1]

    # -- what changes it ---------------------------------------------------------------

    def make(self) -> None:
        """Make the folder where it is not there.

        Raises
        ------
        FileError
            When it cannot be made.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FileError(self.folder, f"cannot be made: {reason(error)}") from error

    def use(self, text: str) -> str:
        """Put a version into use, or the baseline; the name of what is in use now.

        Raises
        ------
        FileError, InputError
            When there is no such version, or it is damaged.
        """
        name = BASELINE if text == BASELINE else self.find(text).name
        history = self._history()
        if history[-1] != name:
            self._write([*history, name])
        return name

    def undo(self) -> str:
        """Go back to what was in use before; its name.

        Raises
        ------
        InputError
            When nothing was.
        """
        history = self._history()
        if len(history) < 2:
            raise InputError(
                "undo", history[-1], "a workspace where something was in use before"
            )
        self._write(history[:-1])
        return history[-2]

    def remove(self, text: str, force: bool = False) -> tuple[str, ...]:
        """Delete a version; the lines that say what came of it.

        Parameters
        ----------
        text : str
        force : bool
            Also where it is in use, or the parent of another; the baseline is in use
            then.

        Raises
        ------
        InputError
            When it is in use or a parent, and not forced.
        FileError
            When it cannot be deleted; it is all there then.
        """
        name, identity = self._removable(text)
        children = [
            one.name
            for one in self.entries()
            if one.version is not None
            and one.version.parent == identity
            and one.name != name
        ]
        history = self._history()
        if history[-1] == name and not force:
            raise InputError("model", name, "a version that is not in use, or --force")
        if children and not force:
            raise InputError(
                "model",
                name,
                f"a version that is no parent (of {', '.join(children)}), or --force",
            )
        lines = []
        if history[-1] == name:
            lines.append(f"it was in use; the {BASELINE} is in use now")
            history.append(BASELINE)
        if children:
            lines.append(f"it was the parent of {', '.join(children)}")
        left = _without(history, name)
        if left != self._history():
            self._write(left)
        # Renamed at once, so that nobody sees half of it; then deleted.
        gone = self.folder / f".{name}.{uuid.uuid4().hex}{TEMPORARY}"
        try:
            os.rename(self.folder / name, gone)
            sync(self.folder)
        except OSError as error:
            raise FileError(
                self.folder / name, f"cannot be removed: {reason(error)}"
            ) from error
        shutil.rmtree(gone, ignore_errors=True)
        return tuple(lines)

    def _removable(self, text: str) -> tuple[str, str]:
        """Name and id of a version that may be damaged."""
        if text == BASELINE:
            raise InputError("model", text, "a version; the baseline always stays")
        for one in self.entries():
            if one.name == text and one.version is None:
                return one.name, ""
        found = self.find(text)
        assert found.version is not None
        return found.name, found.version.version

    # -- current.json ------------------------------------------------------------------

    def _history(self) -> list[str]:
        """Names in use, the one in use now last; the baseline where nothing is said."""
        path = self.folder / CURRENT
        try:
            data = record(
                path, SCHEMA, SCHEMA_VERSION, "does not say which version is in use"
            )
        except (FileNotFoundError, NotADirectoryError):
            return [BASELINE]
        before, name = data.get("before"), data.get("current")
        given = [*before, name] if isinstance(before, list) else [None]
        names = [one for one in given if isinstance(one, str) and NAME.fullmatch(one)]
        if len(names) < len(given):
            raise FileError(path, "is damaged: names of versions are expected")
        return names

    def _write(self, history: Sequence[str]) -> None:
        self.make()
        data = {
            "schema": SCHEMA,
            "schema_version": SCHEMA_VERSION,
            "current": history[-1],
            "before": list(history[:-1])[-KEPT:],
        }
        write_text(self.folder / CURRENT, json.dumps(data, indent=1) + "\n")


def _without(history: Sequence[str], name: str) -> list[str]:
    """A history without one version, and without the repeats that leaves."""
    left: list[str] = []
    for one in history:
        if one != name and (not left or left[-1] != one):
            left.append(one)
    return left


def _why(entry: Entry) -> str:
    """A problem without the path before it."""
    return entry.problem.partition(": ")[2] or entry.problem


def is_workspace(folder: Path) -> bool:
    """True for a folder with a version in it, or where one was in use."""
    return bool((folder / CURRENT).is_file() or Workspace(folder)._folders())


def place(out: str, workspace: Path | None = None) -> tuple[Path, Workspace | None]:
    """Where a new version goes, and the workspace it is part of.

    A bare name goes into the workspace; a path goes where it says, and is part of a
    workspace where its folder is one.

    Parameters
    ----------
    out : str
        A name, or a path with a separator in it (``./mine``).
    workspace : Path, optional
        `default_workspace` where it is not given.

    Raises
    ------
    InputError
        When a name in a workspace is not allowed.
    """
    chosen = workspace or default_workspace()
    folder = chosen / out if _bare(out) else Path(out)
    inside = folder.parent.resolve() == chosen.resolve()
    if not inside and not is_workspace(folder.parent):
        return folder, None
    if not NAME.fullmatch(folder.name) or folder.name in (BASELINE, CURRENT):
        raise InputError(
            "--out",
            folder.name,
            f"letters, digits, '.', '_' and '-', not {BASELINE!r} or {CURRENT!r}",
        )
    return folder, Workspace(folder.parent)


def locate(text: str, workspace: Path | None = None) -> Path:
    """Folder of a model: of that path, or the version of that name in the workspace.

    Parameters
    ----------
    text : str
        A folder, or the name or id of a version.
    workspace : Path, optional
        `default_workspace` where it is not given.

    Raises
    ------
    InputError
        When the workspace has no such version.
    """
    known = Workspace(workspace or default_workspace())
    if Path(text).exists() or not _bare(text) or not known.folder.is_dir():
        return Path(text)
    return known.folder / known.find(text).name


def _bare(text: str) -> bool:
    """True for a name without a folder before it."""
    return Path(text).name == text
