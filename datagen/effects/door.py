"""The one extension point: how an effect is declared, checked and found.

An effect is a function whose first argument is a `Problem` and whose other arguments
are its parameters; it returns a changed copy::

    @effect("load", [Parameter("offset", "Pa", -2e3, 2e3, off=0.0, ...)])
    def pressure_offset(problem, offset):
        "Cavity pressure = gauge pressure + offset."
        return replace(problem, pressure_offset=problem.pressure_offset + offset)

Built-in effects use the same door as a user's file.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import pkgutil
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass
from importlib import import_module, metadata
from pathlib import Path
from types import ModuleType

from ..errors import EffectError, FileError, PbaError
from ..problem import STAGES, Problem
from ..space import Parameter, Space

ENTRY_POINTS = "pba.effects"
"""Entry-point group of installed packages that bring effects."""

MACHINERY = frozenset({"acting", "door", "conformance", "trial"})
"""Modules of this package that serve effects and hold none."""

SHA256 = "__pba_sha256__"
"""Name in a user's module of the hash of the file that it was made from."""

NOTHING_DECLARED = "declares no effect; see docs/writing-an-effect.md"

AUTHORS_ERRORS = (Exception, SystemExit)
"""What a mistake in an author's code raises; it is told to the author in one line."""


@dataclass(frozen=True)
class Effect:
    """A named change of the problem at one stage.

    Parameters
    ----------
    name : str
        Name of the function.
    stage : str
        One of `STAGES`; fixes the order in which effects act.
    space : Space
        Parameters, each with a finite `off` value at which the effect vanishes.
    change : callable
        ``change(problem, **values) -> Problem``.
    doc : str
        What the effect is, with its equation.
    """

    name: str
    stage: str
    space: Space
    change: Callable[..., Problem]
    doc: str

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.space.parameters

    @property
    def off(self) -> dict[str, float]:
        """Values at which the effect vanishes."""
        return {p.name: float(p.off) for p in self.parameters if p.off is not None}

    def check(self, values: Mapping[str, float]) -> dict[str, float]:
        """All parameters as floats: those given, the others at `off`.

        Raises
        ------
        EffectError
            When a name is unknown.
        InputError
            When a value is outside its range.
        """
        for name in values:
            if name not in self.space.names:
                raise EffectError(
                    f"effect {self.name}: unknown parameter {name!r}; "
                    f"allowed: {', '.join(self.space.names)}"
                )
        return self.off | {n: self.space[n].check(v) for n, v in values.items()}

    def apply(self, problem: Problem, values: Mapping[str, float]) -> Problem:
        """The problem with this effect in it; the same object at `off`.

        Bare, as its author wrote it, for the checks; models use `acting.act`.
        """
        full = self.check(values)
        return problem if full == self.off else self.change(problem, **full)


def effect(
    stage: str, parameters: Iterable[Parameter]
) -> Callable[[Callable[..., Problem]], Effect]:
    """Declare an effect; use as a decorator.

    Parameters
    ----------
    stage : str
        One of `STAGES`.
    parameters : iterable of Parameter
        In the order of the function's arguments after the problem.

    Raises
    ------
    EffectError
        When the stage is unknown, the signature does not match the parameters, a
        parameter lacks its off value or source, or the function has no docstring.
    """
    space = Space(tuple(parameters))

    def declare(change: Callable[..., Problem]) -> Effect:
        name = change.__name__
        if stage not in STAGES:
            raise EffectError(
                f"effect {name}: unknown stage {stage!r}; allowed: {', '.join(STAGES)}"
            )
        taken = tuple(inspect.signature(change).parameters)
        if taken[1:] != space.names:
            raise EffectError(
                f"effect {name}: takes {taken[1:]} after the problem, but declares "
                f"{space.names}"
            )
        for parameter in space:
            if parameter.off is None:
                raise EffectError(f"effect {name}: {parameter.name} has no off value")
            if not parameter.contains(parameter.off):
                raise EffectError(
                    f"effect {name}: {parameter.name} is off outside its range"
                )
            if not parameter.source:
                raise EffectError(f"effect {name}: {parameter.name} has no source")
        if not space.parameters:
            raise EffectError(f"effect {name}: declares no parameters")
        doc = inspect.getdoc(change)
        if not doc:
            raise EffectError(f"effect {name}: has no docstring")
        return Effect(name, stage, space, change, doc)

    return declare


def _effects_in(module: ModuleType) -> list[Effect]:
    return [value for value in vars(module).values() if isinstance(value, Effect)]


def _load_file(path: Path) -> ModuleType:
    """Run a user's effect file as a module of its own."""
    if not path.is_file():
        raise FileError(path, "no such file of effects")
    spec = importlib.util.spec_from_file_location(f"pba_effects_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise EffectError(f"{path}: not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    try:
        code = path.read_bytes()
        # What is run is what is hashed, though the file may be edited meanwhile.
        vars(module)[SHA256] = hashlib.sha256(code).hexdigest()
        with redirect_stdout(sys.stderr):  # what it prints is no part of an answer
            exec(compile(code, str(path), "exec", dont_inherit=True), vars(module))
    except AUTHORS_ERRORS as error:
        del sys.modules[spec.name]
        what = "" if isinstance(error, PbaError) else f"{type(error).__name__}: "
        raise EffectError(f"{path}: {what}{error}") from error
    return module


def effects_of_file(path: Path) -> list[Effect]:
    """The effects that a user's file declares, none of them known by name already.

    Raises
    ------
    FileError
        When there is no such file.
    EffectError
        When the file cannot be run, declares no effect or takes a name that is taken.
    """
    known = catalogue()
    own = [e for e in _effects_in(_load_file(path)) if known.get(e.name) is not e]
    if not own:
        raise EffectError(f"{path}: {NOTHING_DECLARED}")
    for one in own:
        if one.name in known:
            raise EffectError(f"{path}: an effect named {one.name!r} exists already")
    return own


def effects_of_folder(folder: Path) -> list[Effect]:
    """The effects that the files of a user's folder declare.

    Raises
    ------
    EffectError
        When a file cannot be run or declares none, or a name is taken twice.
    """
    lost = without_effects(folder)
    if lost:
        raise EffectError(f"{lost[0]}: {NOTHING_DECLARED}")
    known = catalogue()
    own = [e for e in catalogue(folder).values() if known.get(e.name) is not e]
    if not own:
        raise EffectError(f"{folder}: no file of effects in it")
    return own


def without_effects(folder: Path) -> list[Path]:
    """Files of a folder of effects that declare none: a forgotten decorator, perhaps.

    Raises
    ------
    EffectError
        When one cannot be run.
    """
    files = sorted(folder.glob("*.py"))
    return [path for path in files if not _effects_in(_load_file(path))]


def catalogue(effects_dir: Path | None = None) -> dict[str, Effect]:
    """Every effect that can be named: built in, installed, and in a user's folder.

    Parameters
    ----------
    effects_dir : Path, optional
        Folder of Python files with effects.

    Returns
    -------
    dict of str to Effect, sorted by name

    Raises
    ------
    EffectError
        When a file cannot be run or a name is taken twice.
    """
    package = import_module("datagen.effects")
    found: list[tuple[str, Effect]] = []
    for info in pkgutil.iter_modules(package.__path__):
        if info.name not in MACHINERY:
            module = import_module(f"datagen.effects.{info.name}")
            found += [(info.name, one) for one in _effects_in(module)]
    for entry in metadata.entry_points(group=ENTRY_POINTS):
        loaded = entry.load()
        if not isinstance(loaded, Effect):
            raise EffectError(f"entry point {entry.name}: not an effect")
        found.append((f"entry point {entry.name}", loaded))
    if effects_dir is not None:
        if not effects_dir.is_dir():
            raise EffectError(f"{effects_dir}: no such folder of effects")
        for path in sorted(effects_dir.glob("*.py")):
            found += [(str(path), one) for one in _effects_in(_load_file(path))]
    names: dict[str, Effect] = {}
    for place, one in found:
        if names.get(one.name, one) is not one:  # an imported one is the same one
            raise EffectError(f"{place}: an effect named {one.name!r} exists already")
        names[one.name] = one
    return dict(sorted(names.items()))
