"""Reading a TOML table key by key: each value is checked where it is read, and what is left over is refused by name."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

from .errors import BlenderLidarError, InputError, MissingFileError, unknown_name

_MAX_BYTES = 1 << 20
_REQUIRED = object()


def read_toml(path: str | Path) -> dict:
    """The content of a TOML file.

    Raises
    ------
    MissingFileError, InputError
        When there is no such file, or it is a folder, too large, not UTF-8 or not TOML.
    """
    path = Path(path)
    if not path.exists():
        raise MissingFileError(f"{path}: there is no such file")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; allowed: a TOML file")
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InputError(f"{path}: is larger than {_MAX_BYTES} bytes; allowed: a TOML file of settings")
        return tomllib.loads(path.read_bytes().decode("utf-8"))
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: is not UTF-8 text ({error.reason} at byte {error.start}); allowed: a TOML file"
        ) from error
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"{path}: is not TOML: {str(error).splitlines()[0]}") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error


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
            raise InputError(f"{where}: is {values!r}; allowed: a table")
        self._values, self._where, self._origins = dict(values), where, dict(origins or {})
        self._known: list[str] = []

    def where(self, key: str) -> str:
        """Where the value of `key` came from, as an error names it."""
        return self._origins.get(key, f"{self._where} {key}")

    def overridden(self, key: str) -> bool:
        """Whether the value of `key` came from elsewhere than the file."""
        return key in self._origins

    def number(self, key, default=_REQUIRED, *, low=-math.inf, high=math.inf, above=-math.inf):
        """A finite number in [low, high] and greater than `above`."""
        value = self._get(key, default)
        if value is None:
            return None
        return self._checked_number(value, key, low, high, above)

    def whole(self, key, default=_REQUIRED, *, low=-math.inf, high=math.inf):
        """A whole number in [low, high]."""
        value = self._get(key, default)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int):
            raise InputError(f"{self.where(key)}: is {value!r}; allowed: a whole number")
        return int(self._checked_number(value, key, low, high, -math.inf))

    def text(self, key, default=_REQUIRED, *, allowed: Sequence[str] | None = None):
        """A text, one of `allowed` if given."""
        value = self._get(key, default)
        if value is None:
            return None
        if not isinstance(value, str) or not value:
            raise InputError(f"{self.where(key)}: is {value!r}; allowed: a text")
        if allowed is not None and value not in allowed:
            raise unknown_name(value, allowed, key, self.where(key))
        return value

    def numbers(self, key, default=_REQUIRED, *, count: int):
        """A list of `count` finite numbers, as a tuple."""
        value = self._get(key, default)
        if value is None:
            return None
        if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != count:
            raise InputError(f"{self.where(key)}: is {value!r}; allowed: a list of {count} numbers")
        return tuple(self._checked_number(entry, key, -math.inf, math.inf, -math.inf) for entry in value)

    def number_or_pair(self, key, default, *, low=-math.inf, high=math.inf):
        """A number, or a pair [low, high] with the first below the second."""
        value = self._get(key, default)
        if not isinstance(value, Sequence) or isinstance(value, str):
            return self._checked_number(value, key, low, high, -math.inf)
        if len(value) != 2:
            raise InputError(f"{self.where(key)}: is {list(value)!r}; allowed: a number, or a pair [low, high]")
        first, last = (self._checked_number(entry, key, low, high, -math.inf) for entry in value)
        if not first < last:
            raise InputError(
                f"{self.where(key)}: is [{first:g}, {last:g}]; allowed: the lower bound first, below the upper"
            )
        return first, last

    def whole_numbers(self, key, default=_REQUIRED):
        """A list of whole numbers, as a tuple."""
        value = self._get(key, default)
        if value is None:
            return None
        good = isinstance(value, Sequence) and not isinstance(value, str) and len(value) > 0
        if not good or any(isinstance(entry, bool) or not isinstance(entry, int) for entry in value):
            raise InputError(f"{self.where(key)}: is {value!r}; allowed: a list of whole numbers")
        return tuple(value)

    def table(self, key) -> TomlTable:
        """A table within this one; empty where the key is missing."""
        self._known.append(key)
        return TomlTable(
            self._values.get(key, {}),
            f"{self._where[:-1]}.{key}]" if self._where.endswith("]") else f"{self._where} [{key}]",
        )

    def tables(self) -> dict[str, TomlTable]:
        """All tables within this one, whatever their names."""
        names = [key for key, value in self._values.items() if isinstance(value, Mapping)]
        return {name: self.table(name) for name in names}

    def finish(self) -> None:
        """Refuse the keys that nothing asked for."""
        for key in self._values:
            if key not in self._known:
                raise unknown_name(key, self._known, "key", self._origins.get(key, self._where))

    def _get(self, key, default):
        self._known.append(key)
        value = self._values.get(key, default)
        if value is _REQUIRED:
            raise InputError(f"{self._where} {key}: is missing")
        return value

    def _checked_number(self, value, key, low, high, above):
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise InputError(f"{self.where(key)}: is {value!r}; allowed: a number")
        if not (low <= value <= high and value > above):
            bounds = [f"more than {above:g}"] if above > -math.inf else []
            bounds += [f"at least {low:g}"] if low > -math.inf else []
            bounds += [f"at most {high:g}"] if high < math.inf else []
            raise InputError(f"{self.where(key)}: is {value:g}; allowed: {' and '.join(bounds)}")
        return float(value)


def to_toml(tables: Mapping[str, Mapping]) -> str:
    """Tables of numbers, texts, lists and tables of those as TOML; keys whose value is None are left out."""
    lines: list[str] = []
    for name, table in tables.items():
        _append_table(lines, name, table)
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
    if isinstance(value, int | float):
        return repr(value)
    raise BlenderLidarError(f"{value!r} has no place in a TOML file")


def _escape(character):
    if character in '"\\':
        return "\\" + character
    return f"\\u{ord(character):04x}" if ord(character) < 32 or ord(character) == 127 else character
