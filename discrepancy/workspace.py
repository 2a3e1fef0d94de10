"""Workspaces: a folder of model versions, and which of them is in use.

::

    WORKSPACE/
      current.json   the version in use, and those in use before it
      NAME/          a version, see `layout`
      .lock          held by whoever changes what is in use, or removes a version

A workspace belongs to one lab and its batches: versions of one never serve another.
The one in use changes by renaming one small file, so that a reader sees the old one or
the new one.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from datagen.atomic import TEMPORARY, reason, sync, write_text
from datagen.errors import FileError, InputError

from .layout import BASELINE, DamagedError, is_version, record

if TYPE_CHECKING:
    from .version import ModelVersion

CURRENT, LOCK = "current.json", ".lock"

SCHEMA, SCHEMA_VERSION = "pba-workspace", 1

VARIABLE, DEFAULT = "PBA_WORKSPACE", "pba-models"
"""Environment variable that names the workspace, and its folder without one."""

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")

SHORTEST = 4
"""Digits of an id that can stand for it."""

KEPT = 100
"""Versions in use before, as far back as `Workspace.undo` goes."""

Ready = Callable[["ModelVersion"], object]
"""Called with a version before it comes into use; by raising it forbids that."""


class UnknownModel(InputError):
    """A workspace has no model of this name or id."""


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
            if self.folder.exists():
                raise FileError(self.folder, "is no folder, and so no workspace")
            return []
        return [
            path
            for path in sorted(self.folder.iterdir())
            if NAME.fullmatch(path.name) and is_version(path)
        ]

    def find(self, text: str, field: str = "model") -> Entry:
        """A version by its name, its id, or the first digits of its id.

        Parameters
        ----------
        text : str
        field : str
            Name of what holds it, for errors.

        Raises
        ------
        FileError
            When that version cannot be read.
        UnknownModel
            When there is none.
        InputError
            When several ids begin so.
        """
        entries = self.entries()
        found = [one for one in entries if one.name == text]
        if not found and len(text) >= SHORTEST:
            found = [
                one
                for one in entries
                if one.version is not None and one.version.version.startswith(text)
            ]
        if not found:
            names = ", ".join([BASELINE, *(one.name for one in entries)])
            raise UnknownModel(field, text, names)
        if found[0].version is None:
            raise FileError(self.folder / found[0].name, _why(found[0]))
        # Folders with one id are the same model: either will do.
        if len({one.version.version for one in found if one.version}) > 1:
            raise InputError(field, text, ", ".join(one.name for one in found))
        return found[0]

    def current(self) -> Entry | None:
        """The version in use; None for the baseline.

        Raises
        ------
        FileError
            When it or ``current.json`` cannot be read.
        """
        name = self._history()[-1]
        if name == BASELINE:
            return None
        for one in self.entries():
            if one.name == name and one.version is None:
                raise FileError(self.folder / name, _why(one))
            if one.name == name:
                return one
        # Not `find`: no other whose id begins so.
        words = "was in use, and is no version any more; pba models use or undo"
        raise FileError(self.folder / name, words)

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

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """Alone in changing what is in use, among all threads and processes.

        Raises
        ------
        FileError
            When the lock cannot be opened.
        """
        if not self.folder.is_dir():  # there is nothing in it to be changed
            yield
            return
        try:
            lock = (self.folder / LOCK).open("a")
        except OSError as error:
            raise FileError(
                self.folder / LOCK, f"cannot be opened: {reason(error)}"
            ) from error
        with lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield

    def use(self, text: str, ready: Ready | None = None) -> str:
        """Put a version into use, or the baseline; the name of what is in use now.

        What was in use before is forgotten where ``current.json`` is damaged.

        Parameters
        ----------
        text : str
        ready : callable, optional
            As `Ready`.

        Raises
        ------
        FileError, InputError
            When there is no such version, or it is damaged.
        """
        with self._locked():
            name = BASELINE if text == BASELINE else self._usable(text, ready)
            try:
                history = self._history()
            except DamagedError:  # what is put into use repairs it
                history = [BASELINE]
                self._write(history)
            if history[-1] != name:
                self._write([*history, name])
            return name

    def undo(self, ready: Ready | None = None) -> str:
        """Go back to what was in use before and is still there; its name.

        Parameters
        ----------
        ready : callable, optional
            As `Ready`.

        Raises
        ------
        FileError, InputError
            When nothing was, or it is damaged.
        """
        with self._locked():
            history = self._history()
            if len(history) < 2:
                raise InputError(
                    "undo", history[-1], "a workspace where something was in use before"
                )
            left = history[:-1]
            while left and not self._there(left[-1]):
                left.pop()  # deleted by hand: what was in use before that
            left = left or [BASELINE]
            if left[-1] != BASELINE:
                self._usable(left[-1], ready)
            self._write(left)
            return left[-1]

    def _there(self, name: str) -> bool:
        return name == BASELINE or os.path.lexists(self.folder / name)

    def _usable(self, text: str, ready: Ready | None) -> str:
        """Name of a version that is whole."""
        found = self.find(text)
        assert found.version is not None
        if ready is not None:
            ready(found.version)
        return found.name

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
        with self._locked():
            return self._remove(text, force)

    def _remove(self, text: str, force: bool) -> tuple[str, ...]:
        name, identity = self._removable(text)
        others = {
            one.name: one.version
            for one in self.entries()
            if one.version is not None and one.name != name
        }
        children = [
            one for one, version in others.items() if version.parent == identity
        ]
        if any(version.version == identity for version in others.values()):
            children = []  # another folder holds the same model
        history = self._history()
        if history[-1] == name and not force:
            raise InputError("model", name, "a version that is not in use, or --force")
        if children and not force:
            raise InputError(
                "model",
                name,
                f"a version that is no parent (of {', '.join(children)}), or --force",
            )
        if not force and self._trained(name):
            raise InputError("model", name, "a version that is not in training")
        lines = [] if text == name else [f"its folder was {name}"]
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

    def _trained(self, name: str) -> bool:
        """Whether a surrogate is being learned in a version, which holds its folder."""
        try:
            folder = os.open(self.folder / name, os.O_RDONLY)
        except OSError:
            return False
        try:
            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
        finally:
            os.close(folder)
        return False

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
        except NotADirectoryError as error:
            words = "is no folder, and so no workspace"
            raise FileError(self.folder, words) from error
        except FileNotFoundError:
            return [BASELINE]
        before, name = data.get("before"), data.get("current")
        given = [*before, name] if isinstance(before, list) else [None]
        names = [one for one in given if isinstance(one, str) and NAME.fullmatch(one)]
        if len(names) < len(given):
            raise DamagedError(path, "is damaged: names of versions are expected")
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


def place(
    out: str, workspace: Path | None = None, field: str = "--out"
) -> tuple[Path, Workspace | None]:
    """Where a new version goes, and the workspace where it is to come into use.

    A bare name goes into the workspace.  A path goes where it says; only in the folder
    of the workspace is it one of its versions, so that no other folder comes to be a
    workspace with something in use by a version that was written there.

    Parameters
    ----------
    out : str
        A name, or a path with a separator in it (``./mine``).
    workspace : Path, optional
        `default_workspace` where it is not given.
    field : str
        Name of what holds `out`, for errors.

    Raises
    ------
    InputError
        When a name in a workspace is not allowed.
    """
    chosen = workspace or default_workspace()
    if not Path(out).name:
        raise InputError(field, out, "a name, or the path of a new folder")
    folder = chosen / out if _bare(out) else Path(out)
    if folder.parent.resolve() != chosen.resolve():
        return folder, None
    if not NAME.fullmatch(folder.name) or folder.name in (BASELINE, CURRENT):
        raise InputError(
            field,
            folder.name,
            "up to 100 letters, digits, '.', '_' and '-', the first a letter or digit, "
            f"not {BASELINE!r} or {CURRENT!r}",
        )
    return folder, Workspace(folder.parent)


def locate(text: str, workspace: Path | None = None, field: str = "model") -> Path:
    """Folder of a model: the version of that name in the workspace, or that path.

    A bare name means the workspace first, as in `Workspace.use`.

    Parameters
    ----------
    text : str
        The name or id of a version, or a folder.
    workspace : Path, optional
        `default_workspace` where it is not given.
    field : str
        Name of what holds `text`, for errors.

    Raises
    ------
    FileError
        When that version cannot be read.
    InputError
        When there is neither such a version nor such a folder, or several ids begin
        so.
    """
    known = Workspace(workspace or default_workspace())
    if not _bare(text) or not known.folder.is_dir():
        return Path(text)
    try:
        return known.folder / known.find(text, field).name
    except UnknownModel:
        if Path(text).exists():
            return Path(text)
        raise


def _bare(text: str) -> bool:
    """True for a name without a folder before it."""
    return Path(text).name == text
