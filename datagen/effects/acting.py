"""An effect put into a problem, whatever its author may have got wrong."""

from __future__ import annotations

import inspect
import re
import sys
import traceback
from collections.abc import Mapping
from contextlib import redirect_stdout
from dataclasses import fields, replace
from typing import Any, TypeVar, cast

import numpy as np

from ..errors import EffectError, PbaError
from ..mesh import Mesh
from ..problem import Body, Problem
from .door import AUTHORS_ERRORS, Effect

Array = np.ndarray
B = TypeVar("B", bound=Body)


def act(effect: Effect, body: B, values: Mapping[str, float]) -> B:
    """The problem with an effect in it; the same object at `off`.

    The author's code gets arrays of its own to write into: others share the given ones.
    What it leaves as it was comes back as the given array itself.

    Parameters
    ----------
    effect : Effect
    body : Problem or Body
    values : mapping of str to float, SI

    Raises
    ------
    EffectError
        When the author's code fails, or gives what is no such problem, an array of
        another shape, or a number that is not finite.
    InputError
        When a value is outside its range.
    AttributeError
        When it asks for parts of a device that a specimen has not got.
    """
    full = effect.check(values)
    if full == effect.off:
        return body
    given = {
        one.name: value
        for one in fields(body)
        if isinstance(value := getattr(body, one.name), np.ndarray)
    }
    copies = {name: value.copy() for name, value in given.items()}
    try:
        with redirect_stdout(sys.stderr):  # what it prints is no part of an answer
            found: object = effect.change(_with(body, copies), **full)
    except PbaError:
        raise
    except AUTHORS_ERRORS as error:
        asked = isinstance(error, AttributeError) and isinstance(error.obj, Body | Mesh)
        if asked and not isinstance(body, Problem):
            raise
        raise EffectError(f"effect {effect.name}: {told(effect, error)}") from error
    wrong = fault(body, found)
    if wrong:
        at = ", ".join(f"{name}={value:.6g}" for name, value in full.items())
        raise EffectError(f"effect {effect.name}: {wrong}, at {at}")
    return _sharing(cast("B", found), given, copies)


def fault(body: Body, found: object) -> str:
    """Why what came back from an effect is no such problem, or nothing."""
    if type(found) is not type(body):
        return f"gives a {type(found).__name__}, not a {type(body).__name__}"
    assert isinstance(found, Body)
    if found.mesh is not body.mesh:
        return "the mesh is another one; move its points by `nodes` instead"
    for one in fields(found):
        was, value = getattr(body, one.name), getattr(found, one.name)
        if isinstance(was, np.ndarray) and np.shape(value) != was.shape:
            return f"{one.name} has shape {np.shape(value)}, not {was.shape}"
        if isinstance(value, np.ndarray | float) and not np.isfinite(value).all():
            return f"{one.name} is not finite"
    return ""


def _sharing(found: B, given: Mapping[str, Array], copies: Mapping[str, Array]) -> B:
    """The given arrays in place of copies of them that nobody has written into."""
    same = {
        id(copies[name]): value
        for name, value in given.items()
        if np.array_equal(copies[name], value)
    }
    back: dict[str, Array] = {}
    for one in fields(found):
        value = getattr(found, one.name)
        if id(value) in same:
            back[one.name] = same[id(value)]
    return _with(found, back)


def _with(body: B, arrays: Mapping[str, Array]) -> B:
    """The body with some of its arrays replaced."""
    return cast("B", cast("Any", replace)(body, **arrays))


def told(effect: Effect, error: BaseException) -> str:
    """An error and where in the author's file it came from, in one line."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if f.filename == inspect.getsourcefile(effect.change)]
    last = (own or frames)[-1]
    file = re.split(r"[\\/]", last.filename)[-1]
    what = f"{type(error).__name__}: {error}".rstrip(": ")
    return f"{what} ({file}, line {last.lineno})"
