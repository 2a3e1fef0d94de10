"""Which model answers: the one in use in the server's workspace, as of this request.

A request takes one look at what is in use and answers from it alone; a version that
comes into use meanwhile serves the next request.  A version that cannot be read is
told, and the one before it goes on answering.
"""

from __future__ import annotations

import logging
import os
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datagen.device import Design
from datagen.errors import PbaError
from discrepancy.version import ModelVersion
from discrepancy.workspace import CURRENT, Workspace

from .answer import Predictor, RangeCheck
from .surrogates import load


@dataclass(frozen=True)
class Refused:
    """The range check of a model without a surrogate: nothing is in its range."""

    reasons: tuple[str, ...]
    in_range: bool = False
    notes: tuple[str, ...] = ()


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
        With the version's effects; None where none was trained.
    """

    name: str
    base: Predictor
    version: ModelVersion | None = None
    surrogate: Predictor | None = None

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

    def check(self, design: Design, pressure: np.ndarray) -> RangeCheck:
        """Whether the surrogate answers this request, and why not."""
        if self.model is not None:
            return self.model.check(design, pressure)
        found = self.base.check(design, pressure)
        why = f"no surrogate was trained with {', '.join(self.effects)} yet"
        return Refused((why, *found.reasons), False, tuple(found.notes))


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
        self._serving = self._base
        self._seen: tuple[object, ...] = ()
        self._inside: object = None
        self._guard = threading.Lock()
        self.problem = ""

    @property
    def base(self) -> Serving:
        """The model without adopted effects."""
        return self._base

    def now(self) -> Serving:
        """What answers a request that begins now."""
        if self._signature() != self._seen:
            with self._guard:
                if self._signature() != self._seen:
                    # Looked at before it is read: what changes meanwhile is read again.
                    chosen = _state(self.workspace.folder / CURRENT)
                    self._inside = None
                    self._serving = self._read()
                    self._seen = (chosen, self._inside)
        return self._serving

    def _signature(self) -> tuple[object, ...]:
        """What changes with the version in use, or when it gets a surrogate."""
        version = self._serving.version
        folder = None if version is None else version.folder
        inside = None if folder is None else _state(folder)
        return _state(self.workspace.folder / CURRENT), inside

    def _read(self) -> Serving:
        try:
            entry = self.workspace.current()
            self.problem = ""
            if entry is None or entry.version is None:
                return self._base
            assert entry.version.folder is not None
            self._inside = _state(entry.version.folder)
            surrogate = load(entry.version)
            return Serving(entry.name, self._base.base, entry.version, surrogate)
        except PbaError as error:
            self.problem = str(error)
            former = self._serving.version
            folder = None if former is None else former.folder
            self._inside = None if folder is None else _state(folder)
            logging.getLogger("pba").error("model in use: %s", error)
            return self._serving


def _state(path: Path) -> tuple[int, ...] | None:
    """What changes when a file is replaced; None where there is none."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size
