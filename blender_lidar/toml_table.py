"""Reading a TOML table key by key: each value is checked where it is read, and what is left over is refused by name."""

from __future__ import annotations

import math
import re
import reprlib
import sys
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

from .errors import InputError, MissingFileError, unknown_name
from .input_file import read_file

_MAX_BYTES = 1 << 20
_LARGEST_WHOLE = 2**53  # what a float and a CSV column still hold exactly
_LARGEST_FLOAT = sys.float_info.max
_REQUIRED = object()
_MOST_PARTS = 50
_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?<![\w-])(?:{_PART}[ \t]*+\.[ \t]*+){{{_MOST_PARTS},}}")


def read_toml(path: str | Path) -> dict:
    """The content of a TOML file.

    Raises
    ------
    MissingFileError, InputError
        When there is no such file, or it is a folder, too large, not UTF-8 or not TOML.
    """
    path = Path(path)
    try:
        content = read_file(path, _MAX_BYTES + 1)
    except FileNotFoundError as error:
        raise MissingFileError(f"{path}: there is no such file") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: is a folder; allowed: a TOML file") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    if len(content) > _MAX_BYTES:
        raise InputError(f"{path}: is larger than {_MAX_BYTES} bytes; allowed: a TOML file of settings")
    try:
        return parse_toml(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: is not UTF-8 text ({error.reason} at byte {error.start}); allowed: a TOML file"
        ) from error
    except (ValueError, RecursionError) as error:  # a number of thousands of digits is a plain ValueError
        raise InputError(f"{path}: is not TOML: {str(error).splitlines()[0]}") from error


def parse_toml(text: str) -> dict:
    """The content of a text of TOML.

    Raises
    ------
    ValueError, RecursionError
        When it is not TOML, nests too deep, or has a key of so many parts that the parser would take hours.
    """
    found = _LONG_KEY.search(text)
    if found:
        line = text.count("\n", 0, found.start()) + 1
        raise ValueError(f"a key of more than {_MOST_PARTS} parts (at line {line})")
    return tomllib.loads(text)


class TomlTable:
    """One table of settings.

    Parameters
    ----------
    values : mapping
        The table's keys and values.
    where : str
        What an error names: ``"i80.toml: [sensor]"``.
    origins : mapping, optional
        For keys that did not come from the file: where they came from, e.g. ``{"name": "--sensor"}``.
    """

    def __init__(self, values: object, where: str, origins: Mapping[str, str] | None = None) -> None:
        if not isinstance(values, Mapping):
            raise InputError(f"{where}: is {_shown(values)}; allowed: a table")
        self._values, self._where, self._origins = dict(values), where, dict(origins or {})
        self._known: list[str] = []

    def __str__(self) -> str:
        """What an error names: the table itself."""
        return self._where

    def where(self, key: str) -> str:
        """Where the value of `key` came from, as an error names it."""
        return self._origins.get(key, f"{self._where} {key}")

    def overridden(self, key: str) -> bool:
        """Whether the value of `key` came from elsewhere than the file."""
        return key in self._origins

    def number(self, key, default=_REQUIRED, *, low=-math.inf, high=math.inf, above=-math.inf, below=math.inf):
        """A finite number in [low, high], greater than `above` and less than `below`."""
        value = self._get(key, default)
        if value is None:
            return None
        return self._checked_number(value, key, low, high, above, below)

    def number_or_text(self, key, default, text: str, *, low=-math.inf, high=math.inf):
        """A finite number in [low, high], or this one text."""
        value = self._get(key, default)
        if value is None or value == text:
            return value
        if isinstance(value, str):
            raise InputError(f"{self.where(key)}: is {_shown(value)}; allowed: a number, or {_value(text)}")
        return self._checked_number(value, key, low, high)

    def whole(self, key, default=_REQUIRED, *, low=-_LARGEST_WHOLE, high=_LARGEST_WHOLE):
        """A whole number in [low, high]."""
        value = self._get(key, default)
        return None if value is None else self._checked_whole(value, key, low, high)

    def boolean(self, key, default=_REQUIRED):
        """true or false."""
        value = self._get(key, default)
        if not isinstance(value, bool):
            raise InputError(f"{self.where(key)}: is {_shown(value)}; allowed: true or false")
        return value

    def text(self, key, default=_REQUIRED, *, allowed: Sequence[str] | None = None):
        """A text, one of `allowed` if given."""
        value = self._get(key, default)
        if value is None:
            return None
        if not isinstance(value, str) or not value or "\0" in value:
            raise InputError(f"{self.where(key)}: is {_shown(value)}; allowed: a text in quotes, not empty")
        if allowed is not None and value not in allowed:
            raise unknown_name(value, allowed, key, self.where(key))
        return value

    def numbers(self, key, default=_REQUIRED, *, count: int, largest=math.inf):
        """A list of `count` finite numbers, none beyond `largest` on either side of 0, as a tuple."""
        value = self._get(key, default)
        if value is None:
            return None
        if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != count:
            raise InputError(f"{self.where(key)}: is {_shown(value)}; allowed: a list of {count} numbers")
        return tuple(self._checked_number(entry, key, -largest, largest) for entry in value)

    def number_or_pair(self, key, default, *, low=-math.inf, high=math.inf):
        """A number, or a pair [low, high] with the first below the second."""
        value = self._get(key, default)
        if not isinstance(value, Sequence) or isinstance(value, str):
            return self._checked_number(value, key, low, high)
        if len(value) != 2:
            raise InputError(f"{self.where(key)}: is {_shown(value)}; allowed: a number, or a pair [low, high]")
        first, last = (self._checked_number(entry, key, low, high) for entry in value)
        if not first < last:
            raise InputError(
                f"{self.where(key)}: is [{first}, {last}]; allowed: the lower bound first, below the upper"
            )
        return first, last

    def whole_numbers(self, key, default=_REQUIRED):
        """A list of whole numbers, as a tuple."""
        value = self._get(key, default)
        if value is None:
            return None
        if not isinstance(value, Sequence) or isinstance(value, str) or not value:
            raise InputError(f"{self.where(key)}: is {_shown(value)}; allowed: a list of whole numbers")
        return tuple(self._checked_whole(entry, key, -_LARGEST_WHOLE, _LARGEST_WHOLE) for entry in value)

    def table(self, key) -> TomlTable:
        """A table within this one; empty where the key is missing."""
        self._known.append(key)
        where = f"{self._where[:-1]}.{key}]" if self._where.endswith("]") else f"{self._where}: [{key}]"
        return TomlTable(self._values.get(key, {}), self._origins.get(key, where))

    def optional_table(self, key) -> TomlTable | None:
        """A table within this one; None where the key is missing."""
        table = self.table(key) if self._values.get(key) is not None else None
        self._known.append(key)
        return table

    def tables(self) -> dict[str, TomlTable]:
        """All tables within this one, whatever their names."""
        names = [key for key, value in self._values.items() if isinstance(value, Mapping)]
        return {name: self.table(name) for name in names}

    def table_list(self, key) -> list[TomlTable]:
        """A list of tables within this one; empty where the key is missing."""
        values = self._get(key, [])
        if not isinstance(values, Sequence) or isinstance(values, str):
            raise InputError(f"{self.where(key)}: is {_shown(values)}; allowed: a list of tables")
        return [TomlTable(value, f"{self.where(key)} {number}") for number, value in enumerate(values, start=1)]

    def finish(self, what: str = "key") -> None:
        """Refuse the keys that nothing asked for; `what` says what they are."""
        for key in self._values:
            if key not in self._known:
                raise unknown_name(key, self._known, what, self._origins.get(key, self._where))

    def _get(self, key, default):
        self._known.append(key)
        value = self._values.get(key, default)
        if value is _REQUIRED:
            raise InputError(f"{self._where} {key}: is missing")
        return value

    def _checked_number(self, value, key, low=-math.inf, high=math.inf, above=-math.inf, below=math.inf):
        good = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _LARGEST_FLOAT
        if not good:  # inf and NaN too
            raise InputError(f"{self.where(key)}: is {_shown(value)}; allowed: a number")
        if not (low <= value <= high and above < value < below):
            bounds = [f"more than {above:g}"] if above > -math.inf else []
            bounds += [f"at least {low:g}"] if low > -math.inf else []
            bounds += [f"at most {high:g}"] if high < math.inf else []
            bounds += [f"less than {below:g}"] if below < math.inf else []
            raise InputError(f"{self.where(key)}: is {_shown(value)}; allowed: {' and '.join(bounds)}")
        return float(value)

    def _checked_whole(self, value, key, low, high):
        if isinstance(value, bool) or not isinstance(value, int):
            raise InputError(f"{self.where(key)}: is {_shown(value)}; allowed: a whole number")
        if not low <= value <= high:
            raise InputError(f"{self.where(key)}: is {_shown(value)}; allowed: {low} to {high}")
        return value


def _shown(value: object) -> str:
    """`value` as an error shows it: a value of thousands of characters is cut short."""
    return reprlib.repr(value)


def to_toml(tables: Mapping[str, Mapping]) -> str:
    """Tables of numbers, texts, lists (also of tables) and tables of those as TOML; keys that hold None are left out.

    Raises
    ------
    InputError
        For a value that TOML has no place for.
    """
    lines: list[str] = []
    for name, table in tables.items():
        _append_table(lines, _key(name), table)
    return "\n".join(lines).strip() + "\n"


def _append_table(lines, name, table):
    lines += ["", f"[{name}]"]
    lines += [
        f"{_key(key)} = {_value(value)}"
        for key, value in table.items()
        if value is not None and not isinstance(value, Mapping)
    ]
    for key, value in table.items():
        if isinstance(value, Mapping):
            _append_table(lines, f"{name}.{_key(key)}", value)


def _key(key):
    return key if key.replace("_", "").replace("-", "").isalnum() and key.isascii() else _value(key)


def _value(value):
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + "".join(_escape(c) for c in value) + '"'
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(entry) for entry in value) + "]"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(key)} = {_value(entry)}" for key, entry in value.items()) + " }"
    if isinstance(value, int | float):
        return float.__repr__(value) if isinstance(value, float) else int.__repr__(value)  # NumPy's say np.float64(...)
    raise InputError(f"{value!r}: has no place in a TOML file; allowed: a number, a text, or a list of those")


def _escape(character):
    if character in '"\\':
        return "\\" + character
    if 0xD800 <= ord(character) < 0xE000:  # half a character: a file name that is not UTF-8
        raise InputError(f"{character!r}: has no place in a TOML file; allowed: whole Unicode characters")
    return f"\\u{ord(character):04x}" if ord(character) < 32 or ord(character) == 127 else character
