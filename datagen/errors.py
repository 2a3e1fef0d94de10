"""Errors of the project: one base class, few kinds, each told in one clear line.

Bad input is an error and is raised early.  Numerical failure is not: it is data, kept
as a status with its reason in a :class:`~datagen.response.Response`.
"""

from __future__ import annotations


class PbaError(Exception):
    """Base of every error that this project raises on purpose."""


class InputError(PbaError):
    """A value that the user gave is not allowed.

    Parameters
    ----------
    field : str
        Name of the field, with its unit where it has one (``upper_thickness_um``).
    value : object
        What was given, in the unit of the field.
    allowed : str
        What is allowed, in words ("a number from 5 to 2000").
    unit : str
        Unit of the value, empty where it has none.
    """

    def __init__(self, field: str, value: object, allowed: str, unit: str = "") -> None:
        self.field, self.value, self.allowed, self.unit = field, value, allowed, unit
        shown = f"{value:.6g}" if isinstance(value, float) else repr(value)
        given = f"{shown} {unit}".rstrip()
        super().__init__(f"{field}: {given} is not allowed; allowed: {allowed}")

    def __reduce__(self) -> tuple[object, ...]:
        # The default would rebuild from the message alone, which fails between
        # processes: a worker's error has to reach the user as it was raised.
        return (type(self), (self.field, self.value, self.allowed, self.unit))


class FileError(PbaError):
    """A file is missing, corrupt, or not of the kind or version that is expected."""

    def __init__(self, path: object, reason: str) -> None:
        self.path, self.reason = str(path), reason
        super().__init__(f"{path}: {reason}")

    def __reduce__(self) -> tuple[object, ...]:
        return (type(self), (self.path, self.reason))


class EffectError(PbaError):
    """An effect is unknown, registered twice, or breaks the rules of the door."""


class GenerationError(PbaError):
    """A run that generates a dataset cannot finish; what is finished is kept."""


class Interrupted(GenerationError, KeyboardInterrupt):
    """Ctrl-C during a run that can be resumed; a KeyboardInterrupt for all others."""
