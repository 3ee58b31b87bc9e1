"""Settings, each declared once, and the TOML files that hold them.

A setting is a field of a dataclass, made by `setting`: its annotation is the type, its name ends with the unit, and its
`Setting` says default, limits, option and help. The same declaration serves the reading of a file, the defaults, the
options of the command line, and whatever else shows settings.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import sys
import tomllib
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from types import NoneType
from typing import Any, get_args, get_type_hints

from .errors import InputError, MissingFileError, shown, unknown_name
from .files import read_file

_MAX_BYTES = 1 << 20
_LARGEST_WHOLE = 2**53  # what a float and a CSV column still hold exactly
_LARGEST_FLOAT = sys.float_info.max

# --- Declarations -----------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """The declaration of a setting.

    Attributes
    ----------
    kind : type
        Of its value: a key of `CHECKS`, a dataclass for a table that it declares, or a tuple of such.
    default : object
        Its value where it is left out; without one it may not be.
    low, high, above, below : float
        What numbers are between: `low` and `high` are allowed themselves, `above` and `below` are not.
    allowed : iterable of str
        What a text may be; any where there are none.
    word : str
        A text that may stand in place of a number.
    is_path : bool
        Whether it is a path: in a file it starts from the file's folder, as an option from the working folder.
    option : str
        The option of the command line that gives it; empty where none does.
    rivals : tuple of str
        Keys of the same table that the option puts out of force.
    metavar : str
        What stands for the value in the option's help, where what is allowed is not listed there.
    help : str
        What it is, in one phrase.
    """

    kind: Any = float
    default: Any = ...
    low: float = -math.inf
    high: float = math.inf
    above: float = -math.inf
    below: float = math.inf
    allowed: Iterable[str] = ()
    word: str = ""
    is_path: bool = False
    option: str = ""
    rivals: tuple[str, ...] = ()
    metavar: str = ""
    help: str = ""


def setting(default: Any = ..., **declared: Any) -> Any:
    """A field of a dataclass that is a setting; `declared` are attributes of its `Setting`."""
    given = {} if default is ... else {"default": default}
    return dataclasses.field(**given, metadata={"setting": declared | given}, kw_only=True)


@cache
def settings_of(declared: type) -> dict[str, Setting]:
    """The settings among the fields of a dataclass, by key."""
    hints = get_type_hints(declared)
    return {
        field.name: Setting(kind=_without_none(hints[field.name]), **field.metadata["setting"])
        for field in dataclasses.fields(declared)
        if "setting" in field.metadata
    }


def _without_none(kind):
    kinds = [part for part in get_args(kind) if part is not NoneType]
    return kinds[0] if len(kinds) < len(get_args(kind)) else kind


# --- Values -----------------------------------------------------------------------------------------------


def _number(value, declared, where):
    """A finite number within its limits, or the word that may stand in its place."""
    if declared.word and isinstance(value, str):
        if value != declared.word:
            raise _refused(where, value, f'a number, or "{declared.word}"')
        return value
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _LARGEST_FLOAT:
        raise _refused(where, value, "a number")  # inf and NaN too
    limits = {"more than": declared.above, "at least": declared.low, "at most": declared.high}
    limits["less than"] = declared.below
    if not (declared.low <= value <= declared.high and declared.above < value < declared.below):
        allowed = (f"{word} {limit:g}" for word, limit in limits.items() if math.isfinite(limit))
        raise _refused(where, value, " and ".join(allowed))
    return float(value)


def _whole(value, declared, where):
    if isinstance(value, bool) or not isinstance(value, int):
        raise _refused(where, value, "a whole number")
    low, high = max(declared.low, -_LARGEST_WHOLE), min(declared.high, _LARGEST_WHOLE)
    if not low <= value <= high:
        raise _refused(where, value, f"{low} to {high}")
    return value


def _truth(value, _declared, where):
    if not isinstance(value, bool):
        raise _refused(where, value, "true or false")
    return value


def _text(value, _declared, where):
    if not isinstance(value, str) or not value or "\0" in value:
        raise _refused(where, value, "a text in quotes, not empty")
    return value


def _whole_numbers(value, declared, where):
    if not isinstance(value, list | tuple) or not value:
        raise _refused(where, value, "a list of whole numbers")
    return tuple(_whole(entry, declared, where) for entry in value)


def _numbers(value, declared, where):
    count = len(get_args(declared.kind))
    if not isinstance(value, list | tuple) or len(value) != count:
        raise _refused(where, value, f"a list of {count} numbers")
    return tuple(_number(entry, declared, where) for entry in value)


def _number_or_pair(value, declared, where):
    if not isinstance(value, list | tuple):
        return _number(value, declared, where)
    if len(value) != 2:
        raise _refused(where, value, "a number, or a pair [low, high]")
    low, high = (_number(entry, declared, where) for entry in value)
    if not low < high:
        raise _refused(where, [low, high], "the lower bound first, below the upper")
    return low, high


def _refused(where, value, allowed):
    return InputError(f"{where}: is {shown(value)}; allowed: {allowed}")


CHECKS = {
    float: _number,
    int: _whole,
    bool: _truth,
    str: _text,
    tuple[int, ...]: _whole_numbers,
    tuple[float, float]: _numbers,
    tuple[float, float, float]: _numbers,
    float | tuple[float, float]: _number_or_pair,
}
"""What a value of each kind of setting must be; returns it with numbers as float and lists as tuples."""


# --- Files ------------------------------------------------------------------------------------------------


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
        return tomllib.loads(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: is not UTF-8 text ({error.reason} at byte {error.start}); allowed: a TOML file"
        ) from error
    except (ValueError, RecursionError) as error:  # a number of thousands of digits is a plain ValueError
        raise InputError(f"{path}: is not TOML: {str(error).splitlines()[0]}") from error


class TomlTable:
    """One table of settings; each value is checked where it is read, and what is left over is refused by name.

    Parameters
    ----------
    values : mapping
        The table's keys and values.
    where : str
        What an error names: ``"i80.toml: [sensor]"``.
    origins : mapping, optional
        For keys that did not come from the file: where they came from, e.g. ``{"name": "--sensor"}``.
    folder : path, optional
        Where paths in the file start from.
    """

    def __init__(
        self, values: object, where: str, origins: Mapping[str, str] | None = None, folder: Path = Path()
    ) -> None:
        if not isinstance(values, Mapping):
            raise _refused(where, values, "a table")
        self._values, self._where, self._origins, self._folder = dict(values), where, dict(origins or {}), folder
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

    def folder_of(self, key: str) -> Path:
        """Where a path that is the value of `key` starts from."""
        return Path() if self.overridden(key) else self._folder

    def get(self, key: str, declared: Setting) -> Any:
        """The value of a key as its setting declares it; its default where the key is missing."""
        self._known.append(key)
        if self._values.get(key) is None:  # an option may say none
            if declared.default is ...:
                raise InputError(f"{self._where} {key}: is missing")
            return declared.default
        value, kind, of_each = self._values[key], declared.kind, next(iter(get_args(declared.kind)), None)
        if dataclasses.is_dataclass(kind):
            return self._entry(kind, value, self.nested(key))
        if dataclasses.is_dataclass(of_each):
            if not isinstance(value, list | tuple):
                raise _refused(self.where(key), value, "a list of tables")
            places = (f"{self.where(key)} {number}" for number in itertools.count(1))
            return tuple(self._entry(of_each, entry, where) for entry, where in zip(value, places, strict=False))
        value = CHECKS[kind](value, declared, self.where(key))
        if declared.allowed and value not in declared.allowed:
            raise unknown_name(value, declared.allowed, key, self.where(key))
        return str(self.folder_of(key) / value) if declared.is_path else value

    def read(self, declared: Mapping[str, Setting]) -> dict[str, Any]:
        """The values of settings, by key."""
        return {key: self.get(key, one) for key, one in declared.items()}

    def table(self, key: str) -> TomlTable:
        """A table within this one; empty where the key is missing."""
        self._known.append(key)
        return TomlTable(self._values.get(key, {}), self.nested(key), folder=self._folder)

    def nested(self, key: str) -> str:
        """What an error names: a table within this one."""
        where = f"{self._where[:-1]}.{key}]" if self._where.endswith("]") else f"{self._where}: [{key}]"
        return self._origins.get(key, where)

    def tables(self) -> dict[str, TomlTable]:
        """All tables within this one, whatever their names."""
        names = [key for key, value in self._values.items() if isinstance(value, Mapping)]
        return {name: self.table(name) for name in names}

    def _entry(self, declared: type, value: object, where: str) -> Any:
        """A table within this one, as a dataclass declares it."""
        table = TomlTable(value, where, folder=self._folder)
        found = declared(**table.read(settings_of(declared)))
        table.finish()
        return found

    def finish(self, what: str = "key") -> None:
        """Refuse the keys that nothing asked for; `what` says what they are."""
        for key in self._values:
            if key not in self._known:
                raise unknown_name(key, self._known, what, self._origins.get(key, self._where))


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
