"""The errors that a user meets. Each text says what was given, what is allowed, and where it came from."""

from __future__ import annotations

import difflib
import errno
import reprlib
from collections.abc import Iterable

_LONGEST_LINE = 2_000
_LONGEST_NAME = 200
_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = _LONGEST_NAME
_SHORT.maxlist = _SHORT.maxdict = 50


class BlenderLidarError(Exception):
    """Base of them all; the command line prints one as a line and exits with the code."""

    exit_code = 2

    def __str__(self) -> str:
        """The text as one line of bearable length, even with long names and values of a file in it."""
        text = super().__str__()
        return text if text.isprintable() and len(text) <= _LONGEST_LINE else one_line(text)


class InputError(BlenderLidarError, ValueError):
    """A value, key or table that cannot be used."""


class MissingFileError(BlenderLidarError, FileNotFoundError):
    """A file or folder that is not there."""


class MissingExtraError(BlenderLidarError, ImportError):
    """An optional library that is not installed."""


class OutputError(BlenderLidarError, OSError):
    """A file or folder that cannot be written."""


class WriteError(OutputError):
    """A file or folder that could not be written by no fault of the input's, as on a full disk."""

    exit_code = 1


class WorkerError(BlenderLidarError, RuntimeError):
    """A worker process that did not start or ended abruptly: no fault of the input's."""

    exit_code = 1


_NO_FAULT_OF_THE_INPUT = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EMFILE, errno.ENFILE}


def output_error(text: str, error: OSError) -> OutputError:
    """An error for what cannot be written: `text`, and why; a `WriteError` where the place is good but the disk full.

    Parameters
    ----------
    text : str
        The file or folder and what cannot be done: ``"a.csv: cannot be written"``.
    error : OSError
        What the system said.
    """
    kind = WriteError if error.errno in _NO_FAULT_OF_THE_INPUT else OutputError
    return kind(f"{text}: {error.strerror or error}")


def one_line(text: str) -> str:
    """A text as one line that a terminal may show, its middle left out where it is very long."""
    line = printable(" ".join(text.split()))
    return line if len(line) <= _LONGEST_LINE else f"{line[: _LONGEST_LINE - 500]} ... {line[-400:]}"


def printable(text: str, longest: int | None = None) -> str:
    """A text from a file as a line on a terminal may hold it.

    Control characters, which a terminal would obey, become their escapes; what is longer than `longest` is cut.
    """
    cut = text if longest is None or len(text) <= longest else text[:longest] + "..."
    return "".join(sign if sign.isprintable() else sign.encode("unicode_escape").decode() for sign in cut)


def unknown_name(
    given: object, allowed: Iterable[str], what: str, where: str = "", alike: Iterable[str] | None = None
) -> InputError:
    """An error for a name that is not one of `allowed`, with the nearest known one.

    Parameters
    ----------
    given : object
        What the user wrote.
    allowed : iterable of str
        The names that would have been accepted.
    what : str
        The kind of thing named: ``"sensor"``, ``"key"``.
    where : str
        ``file:key`` or the option it came from; left out when empty.
    alike : iterable of str, optional
        Those of `allowed` that may be proposed; any unless said.
    """
    given = str(given) if isinstance(given, str) else given  # NumPy 2 shows texts of its own as np.str_('car')
    names = [str(name) for name in allowed]
    by_lower = {name.lower(): name for name in (names if alike is None else alike)}
    near = difflib.get_close_matches(str(given).lower()[:_LONGEST_NAME], list(by_lower), n=1, cutoff=0.5)
    hint = f"did you mean {by_lower[near[0]]!r}? " if near else ""
    prefix = f"{where}: " if where else ""
    return InputError(f"{prefix}unknown {what} {shown(given)}; {hint}allowed: {', '.join(names)}")


def shown(value: object) -> str:
    """A value of a file, of any size and however deep it nests, as an error shows it."""
    return _SHORT.repr(value)
