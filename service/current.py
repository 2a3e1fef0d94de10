"""Which model answers: the one in use in the server's workspace, as of this request.

A request takes one look at what is in use and answers from it alone; a version that
comes into use meanwhile serves the next request.  No other physics answers without a
word: where the version in use cannot be read the one before goes on and says so, or,
at the start, nothing answers; where only its surrogate is damaged its own finite
elements answer.  Both are tried again when the files change.
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from datagen.device import Design
from datagen.errors import PbaError
from discrepancy.folder import own_files
from discrepancy.layout import BASELINE, is_version
from discrepancy.version import ModelVersion
from discrepancy.workspace import CURRENT, Workspace

from .answer import Predictor, RangeCheck
from .surrogates import load
from .versions import left_open


class ModelNotFound(PbaError):
    """The workspace has no version of this name or id."""


class NoModel(PbaError):
    """The version in use cannot be read, and this server has had no other in use."""


@dataclass(frozen=True)
class Checked:
    """A range check with what this server has to add to it."""

    in_range: bool
    reasons: tuple[str, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Serving:
    """What answers one request.

    Parameters
    ----------
    name : str
        Of the version in its workspace, or of the base model.
    base : Predictor
        The model without adopted effects.
    version : ModelVersion or None
        None where the base answers.
    surrogate : Predictor or None
        With the version's effects; None where none was trained, or it is damaged.
    own : mapping of str to str
        The version's own effect files, see `folder.own_files`.
    damaged : bool
        Whether there is a surrogate that cannot be read.
    problem : str
        Why this is not the model that should answer, or not its surrogate.
    """

    name: str
    base: Predictor
    version: ModelVersion | None = None
    surrogate: Predictor | None = None
    own: Mapping[str, str] = field(default_factory=dict)
    damaged: bool = False
    problem: str = ""

    @property
    def model(self) -> Predictor | None:
        """The surrogate that answers, None where the finite elements have to."""
        return self.base if self.version is None else self.surrogate

    @property
    def effects(self) -> tuple[str, ...]:
        return () if self.version is None else self.version.effects

    @property
    def model_version(self) -> str:
        """What predictions name."""
        return self.base.version if self.version is None else self.version.version

    @property
    def notes(self) -> tuple[str, ...]:
        """What every answer has to say."""
        return (self.problem,) if self.problem else ()

    @property
    def adopted(self) -> dict[str, Any] | None:
        """All that finite elements need of the version, as JSON: a job that was
        accepted computes with it whatever becomes of its folder."""
        if self.version is None:
            return None
        return {
            "version": self.version.version,
            "effects": list(self.version.effects),
            "parameters": self.version.parameters(),
            "left_open": left_open(self.version),
            "own": dict(self.own),
        }

    def check(self, design: Design, pressure: np.ndarray) -> RangeCheck:
        """Whether the surrogate answers this request, and why not."""
        asked = self.base if self.model is None else self.model
        found = asked.check(design, pressure)
        reasons = tuple(found.reasons)
        if self.model is None:
            effects = ", ".join(self.effects)
            why = f"no surrogate was trained with {effects} yet"
            if self.damaged:
                why = f"the surrogate with {effects} cannot be read"
            reasons = (why, *reasons)
        return Checked(
            self.model is not None and found.in_range,
            reasons,
            (*found.notes, *self.notes),
        )


class Switch:
    """The model in use, read again whenever the workspace says another one.

    Parameters
    ----------
    base : Predictor
    name : str
        Of the base model.
    workspace : Workspace
    """

    def __init__(self, base: Predictor, name: str, workspace: Workspace) -> None:
        self.workspace = workspace
        self._base = Serving(name, base)
        self._serving: Serving | None = None
        self._seen: dict[Path, object] = {workspace.folder / CURRENT: "never"}
        self._guard = threading.Lock()
        self.problem = ""

    @property
    def base(self) -> Serving:
        """The model without adopted effects."""
        return self._base

    def is_base(self, text: str) -> bool:
        """Whether a name is one of the base model's: ``baseline``, or its own unless a
        version has that."""
        own = text == self._base.name and not is_version(self.workspace.folder / text)
        return own or text == BASELINE

    def now(self) -> Serving:
        """What answers a request that begins now.

        Raises
        ------
        NoModel
            When nothing does.
        """
        found = self.look()
        if found is None:
            raise NoModel(self.problem)
        return found

    def look(self) -> Serving | None:
        """As `now`, None when nothing answers."""
        if self._stale():
            with self._guard:
                if self._stale():
                    self._read()
        return self._serving

    def use(self, text: str) -> None:
        """Put a version into use, or the baseline; one that can answer alone.

        Raises
        ------
        FileError, InputError
            When there is no such version, or it or its surrogate is damaged.
        """
        self.workspace.use(BASELINE if self.is_base(text) else text, load)

    def undo(self) -> None:
        """Go back to what was in use before.

        Raises
        ------
        FileError, InputError
            When nothing was, or it or its surrogate is damaged.
        """
        self.workspace.undo(load)

    def _stale(self) -> bool:
        """Whether anything has changed since that decides what answers."""
        return any(_state(path) != state for path, state in self._seen.items())

    def _read(self) -> None:
        # Looked at before it is read: what changes meanwhile is read again.
        current = self.workspace.folder / CURRENT
        seen: dict[Path, object] = {current: _state(current)}
        problem, whole = "", {}
        try:
            folder = self.workspace.folder / self.workspace.current_name
            seen[folder] = _state(folder)
            whole = _inside(folder)
            entry = self.workspace.current()
            serving: Serving | None = self._base
            if entry is not None and entry.version is not None:
                serving = self._with(entry.name, entry.version)
                problem = serving.problem
        except (PbaError, OSError) as error:  # also what goes while it is read
            problem, serving = f"the model in use cannot be read: {error}", None
            if self._serving is not None:
                problem += f"; {self._serving.name} goes on answering"
                serving = replace(self._serving, problem=problem)
        if problem:  # repaired by whatever changes inside
            seen |= whole
            logging.getLogger("pba").error("%s", problem)
        self._serving, self.problem, self._seen = serving, problem, seen

    def _with(self, name: str, version: ModelVersion) -> Serving:
        """A version with its surrogate, or without one that is damaged."""
        own = own_files(version)
        try:
            surrogate, problem = load(version), ""
        except PbaError as error:
            surrogate = None
            problem = (
                f"the surrogate of {name} cannot be read: {error}; its finite elements "
                "answer"
            )
        return Serving(
            name,
            self._base.base,
            version,
            surrogate,
            own,
            bool(problem),
            problem,
        )


def _inside(folder: Path) -> dict[Path, object]:
    """`_state` of all that is in a folder; what goes meanwhile may be in it or not."""
    return {
        Path(at, name): _state(Path(at, name))
        for at, folders, files in os.walk(folder)
        for name in (*folders, *files)
    }


def _state(path: Path) -> tuple[int, ...] | None:
    """What changes when a file is replaced; None where there is none."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size
