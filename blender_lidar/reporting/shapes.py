"""Whether a file's content has the shape that its reader counts on; what has not is named by its key."""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from ..errors import InputError

_SHORT = reprlib.Repr()
_LARGEST = 1e300  # beyond, a number cannot be a measurement, and a whole one may not fit a float


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of value: what it is called, and a test for it."""

    words: str
    fits: Callable[[object], bool]


@dataclass(frozen=True, slots=True)
class Nullable:
    """Null, or a table of this shape."""

    shape: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class MayLack:
    """A key that earlier versions did not write; where it is there, its value is of this kind or shape."""

    kind: Kind | Nullable | Mapping[str, object]


def is_number(value: object) -> bool:
    """Whether a value is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _LARGEST


def or_null(kind: Kind) -> Kind:
    """The same kind, or null."""
    return Kind(f"{kind.words} or null", lambda value: value is None or kind.fits(value))


def one_of(names: Sequence[str]) -> Kind:
    """One of a few names."""
    return Kind(", ".join(names), lambda value: isinstance(value, str) and value in names)


NUMBER = Kind("a number", is_number)
COUNT = Kind("a whole number, 0 or more", lambda value: is_number(value) and isinstance(value, int) and value >= 0)
TEXT = Kind("a text", lambda value: isinstance(value, str))
TEXTS = Kind(
    "a list of texts", lambda value: isinstance(value, list) and all(isinstance(entry, str) for entry in value)
)
PAIR = Kind(
    "two numbers",
    lambda value: isinstance(value, list) and len(value) == 2 and all(is_number(entry) for entry in value),
)
PAIR_TABLE = Kind(
    "a table of pairs of numbers",
    lambda value: isinstance(value, dict) and all(PAIR.fits(entry) for entry in value.values()),
)
NUMBER_OR_PAIR = Kind("a number or two", lambda value: NUMBER.fits(value) or PAIR.fits(value))
TEXT_TABLE = Kind(
    "a table of texts",
    lambda value: isinstance(value, dict) and all(isinstance(entry, str) for entry in value.values()),
)
RUNGS = Kind(
    "a list of rungs, each a table of detail, stride, frames and candidates",
    lambda value: isinstance(value, list) and all(map(_is_rung, value)),
)


def _is_rung(value: object) -> bool:
    counts = ("stride", "frames", "candidates")
    return (
        isinstance(value, dict) and TEXT.fits(value.get("detail")) and all(COUNT.fits(value.get(key)) for key in counts)
    )


def check_shape(value: object, shape: Mapping | Kind | Nullable, file: str, *keys: str) -> None:
    """Refuse a value that has another shape.

    Parameters
    ----------
    value : object
        What was read.
    shape : mapping, Kind or Nullable
        A mapping asks for a table with at least its keys.
    file : str
        The file that it was read from.
    *keys : str
        The keys that led to it.

    Raises
    ------
    InputError
        Naming the file and the key.
    """
    if isinstance(shape, Nullable):
        if value is None:
            return
        shape = shape.shape
    where = f"{file}: {'.'.join(keys)}" if keys else file
    if isinstance(shape, Kind):
        if not shape.fits(value):
            raise InputError(f"{where}: is {_SHORT.repr(value)}; allowed: {shape.words}")
        return
    if not isinstance(value, Mapping):
        raise InputError(f"{where}: is {_SHORT.repr(value)}; allowed: a table")
    for key, inner in shape.items():
        if isinstance(inner, MayLack):
            if key not in value:
                continue
            inner = inner.kind
        if key not in value:
            raise InputError(f"{where}: there is no key {key!r}")
        check_shape(value[key], inner, file, *keys, key)
