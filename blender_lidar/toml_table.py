"""Settings, each declared once, and the TOML files that hold them.

A setting is a field of a dataclass, made by `setting`: its annotation is the type, its name ends with the unit, its
`Setting` says default, limits and option, and what the docstring of the class says of it is its help. The same
declaration serves the reading of a file, the defaults, the options of the command line, and all else that shows
settings.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import re
import sys
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

from .errors import InputError, shown, unknown_name
from .files import read_file, reading
from .plugins import IN_A_FILE, is_plugin, located

_MAX_BYTES = 1 << 20
_LARGEST_WHOLE = 2**53  # what a float and a CSV column still hold exactly

# --- Declarations -----------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """The declaration of a setting.

    Attributes
    ----------
    kind : type
        Of its value: float, int, bool, str or list; a tuple of one of them; a number or its bounds, the lower first; a
        dataclass for a table that it declares, or a tuple of such; a mapping for a table of numbers or texts that are
        called as is `allowed`.
    default : object
        Its value where it is left out; without one it may not be.
    low, high, above, below : float
        What numbers are between: `low` and `high` are allowed themselves, `above` and `below` are not.
    allowed : iterable of str
        What a text may be; any where there are none.
    plugins : bool
        Whether a text may name a function or class in a file besides: see `plugins`.
    word : str
        A text that may stand in place of a number.
    off : object
        What false stands for in place of a table; none where it may not.
    fits : callable
        Whether a value that is all of that may be used; none asks for no more.
    form : str
        What `fits` asks for, in words.
    is_path : bool
        Whether it is a path: in a file it starts from the file's folder, as an option from the working folder.
    option : str
        The option of the command line that gives it, or the name of its place there; empty where none does.
    group : str or None
        Title of the options from this one on in the help of a verb; None goes on with the one before.
    read : callable
        What makes the value of the option's text and its name, where that is no plain number or text, and checks it.
    rivals : tuple of str
        Keys of the same table that the option puts out of force.
    metavar : str
        What stands for the value in the option's help, where what is allowed is not listed there.
    help : str
        What it is, in one phrase; unless said what the docstring of the class says of the attribute.
    """

    kind: Any = float
    default: Any = ...
    low: float = -math.inf
    high: float = math.inf
    above: float = -math.inf
    below: float = math.inf
    allowed: Iterable[str] = ()
    plugins: bool = False
    word: str = ""
    off: Any = None
    fits: Callable[[Any], object] | None = None
    form: str = ""
    is_path: bool = False
    option: str = ""
    group: str | None = None
    read: Callable[[str, str], Any] | None = None
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
    hints, helps = get_type_hints(declared), _attributes(declared)
    return {
        field.name: Setting(
            kind=_without_none(hints[field.name]), **{"help": helps.get(field.name, ""), **field.metadata["setting"]}
        )
        for field in dataclasses.fields(declared)
        if "setting" in field.metadata
    }


def _attributes(declared: type) -> dict[str, str]:
    """What the docstring of a class says of each of its attributes, as a phrase."""
    entries = re.findall(r"^(\w+(?:, \w+)*)(?: : .*)?\n((?: {4}.*\n?)+)", inspect.getdoc(declared) or "", re.MULTILINE)
    phrases = {}
    for names, text in entries:
        phrase = " ".join(text.split()).removesuffix(".")
        first = phrase[0].lower() if re.match(r"[A-Z][a-z]*\b", phrase) else phrase[0]  # except for names such as NGSIM
        phrases |= dict.fromkeys(names.split(", "), first + phrase[1:])
    return phrases


def _without_none(kind):
    kinds = [part for part in get_args(kind) if part is not NoneType]
    return kinds[0] if len(kinds) < len(get_args(kind)) else kind


# --- Values -----------------------------------------------------------------------------------------------

_KINDS = {float: "a number", int: "a whole number", bool: "true or false", str: "a text in quotes, not empty"}
_KINDS[list] = "a list"


def checked(value: object, declared: Setting, where: str) -> Any:
    """A value as its setting declares it, numbers as float or int and lists as tuples; `where` it came from.

    Raises
    ------
    InputError
        When it is something else, with what is allowed.
    """
    found = _of_kind(value, declared.kind, declared, where)
    for one in found if isinstance(found, tuple) and declared.allowed else (found,):
        if declared.allowed and one not in declared.allowed and not (declared.plugins and is_plugin(one)):
            known = (*declared.allowed, *([IN_A_FILE] if declared.plugins else []))
            raise unknown_name(one, known, where.rpartition(" ")[2].lstrip("-"), where)
    if declared.fits is not None and not declared.fits(found):
        raise _refused(where, value, declared.form)
    return found


def _of_kind(value, kind, declared, where):
    is_list, parts = isinstance(value, list | tuple), get_args(kind)
    if get_origin(kind) is UnionType:
        if is_list and len(value) != 2:
            raise _refused(
                where, value, "a number, or a pair [low, high]" + (f"; {declared.form}" if declared.form else "")
            )
        found = _of_kind(value, parts[is_list], declared, where)
        if is_list and not found[0] < found[1]:
            raise _refused(where, value, "the lower bound first, below the upper")
        return found
    if get_origin(kind) is tuple:
        count = None if ... in parts else len(parts)
        if declared.is_path and isinstance(value, str):
            value, is_list = [value], True
        if not is_list or not value or (count and len(value) != count):
            each = _KINDS.get(parts[0], "a list")
            raise _refused(where, value, f"a list of {count} numbers" if count else f"a list, each {each}")
        return tuple(_of_kind(entry, parts[0], declared, where) for entry in value)
    if declared.word and value == declared.word:
        return value
    if not _is_a(kind, value):
        raise _refused(where, value, _KINDS[kind] + (f', or "{declared.word}"' if declared.word else ""))
    return _within(value, kind, declared, where) if kind in (float, int) else value


def _is_a(kind, value):
    if kind is list:
        return isinstance(value, list)
    if kind is str:
        return isinstance(value, str) and value and "\0" not in value
    if kind is bool or isinstance(value, bool):  # to Python a bool is an int
        return kind is bool and isinstance(value, bool)
    return isinstance(value, kind | int) and abs(value) <= sys.float_info.max  # which inf and NaN are not


def _within(value, kind, declared, where):
    """The number as its kind, if it is within its limits."""
    if not (declared.low <= value <= declared.high and declared.above < value < declared.below):
        raise _refused(where, value, limits_text(declared, kind))
    if kind is int and abs(value) > _LARGEST_WHOLE:
        raise _refused(where, value, f"{-_LARGEST_WHOLE} to {_LARGEST_WHOLE}")
    return kind(value)


def limits_text(declared: Setting, kind: type = float) -> str:
    """What numbers are between, in words: "0 to 25", "more than 0 and at most 10"; empty without limits."""
    low, high, show = declared.low, declared.high, str if kind is int else "{:g}".format
    if math.isfinite(low) and math.isfinite(high):
        return f"{show(low)} to {show(high)}"
    limits = {"more than": declared.above, "at least": low, "at most": high, "less than": declared.below}
    return " and ".join(f"{word} {show(limit)}" for word, limit in limits.items() if math.isfinite(limit))


def _refused(where, value, allowed):
    return InputError(f"{where}: is {shown(value)}; allowed: {allowed}")


# --- Files ------------------------------------------------------------------------------------------------


def read_toml(path: str | Path) -> dict:
    """The content of a TOML file.

    Raises
    ------
    MissingFileError, InputError
        When there is no such file, or it is a folder, too large, not UTF-8 or not TOML.
    """
    with reading(path, "a TOML file"):
        content = read_file(path, _MAX_BYTES + 1)
    if len(content) > _MAX_BYTES:
        raise InputError(f"{path}: is larger than {_MAX_BYTES} bytes; allowed: a TOML file of settings")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if 0 in content and content[:2] not in (b"\xff\xfe", b"\xfe\xff"):
            raise InputError(f"{path}: is no text; allowed: a TOML file of settings") from error
        encoding = "UTF-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "another encoding"
        raise InputError(f"{path}: is text in {encoding}; allowed: UTF-8, so save it as that") from error
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # a number of thousands of digits too
        words = str(error).splitlines()[0]
        raise InputError(f"{path}: is not TOML: {words}{_backslash_hint(content, words)}") from error


_OF_PATHS = "in double quotes a backslash begins an escape: write paths in single quotes or with forward slashes"


def _backslash_hint(content: bytes, message: str) -> str:
    """What to do about a backslash in double quotes in the line that an error tells of, as in paths of Windows."""
    line = re.search(r"at line (\d+)", message)
    text = content.decode(errors="replace").splitlines()[int(line[1]) - 1 :][:1] if line else []
    return f"; {_OF_PATHS}" if text and re.search(r'"[^"]*\\', text[0]) else ""


class TomlTable:
    """One table of settings, and where its values came from.

    Parameters
    ----------
    values : mapping
        The table's keys and values.
    name : str
        What an error names: ``"i80.toml: [sensor]"``.
    origins : mapping, optional
        For keys that did not come from the file: where they came from, e.g. ``{"name": "--sensor"}``.
    folder : path, optional
        Where paths in the file start from.
    called : callable, optional
        What an error calls a key's value that has no other origin, as a panel's field; `name` and the key unless said.

    Raises
    ------
    InputError
        When `values` is no table.
    """

    def __init__(
        self,
        values: object,
        name: str,
        origins: Mapping[str, str] | None = None,
        folder: Path = Path(),
        called: Callable[[str], str] | None = None,
    ) -> None:
        if not isinstance(values, Mapping):
            raise _refused(name, values, "a table")
        self.values, self.name, self.origins, self.folder = values, name, origins or {}, folder
        self.called = called

    def where(self, key: str) -> str:
        """Where the value of `key` came from, as an error names it."""
        return self.origins.get(key) or (self.called(key) if self.called else f"{self.name} {key}")

    def path(self, key: str, value: str) -> str:
        """A path that is the value of `key`, from the folder on where it starts."""
        return str(value if key in self.origins else self.folder / value)

    def table(self, key: str) -> TomlTable:
        """A table within this one; empty where the key is missing."""
        name = self.called(key) if self.called else f"{self.name}: [{key}]"
        if self.name.endswith("]"):
            name = f"{self.name[:-1]}.{key}]"
        return TomlTable(self.values.get(key, {}), self.origins.get(key, name), folder=self.folder)

    def read(self, declared: Mapping[str, Setting]) -> dict[str, Any]:
        """The values of settings, by key, the default where one is left out.

        Raises
        ------
        InputError
            For a value that is not as its setting declares it, and a key that none declares.
        """
        for key in self.values:
            if key not in declared:
                raise unknown_name(key, declared, "key", self.origins.get(key, self.name))
        return {key: self._value(key, one) for key, one in declared.items()}

    def some(self, declared: Mapping[str, Setting]) -> dict[str, Any]:
        """The same of a table that may hold more than is declared."""
        return TomlTable({key: self.values[key] for key in declared if key in self.values}, self.name).read(declared)

    def read_as(self, declared: type) -> Any:
        """The table as a dataclass declares it."""
        return declared(**self.read(settings_of(declared)))

    def _value(self, key, declared):
        value, kind = self.values.get(key), declared.kind
        entry = next(iter(get_args(kind)), None)
        if get_origin(kind) is Mapping:
            one = dataclasses.replace(declared, kind=get_args(kind)[1], default=None, allowed=())
            found = self.table(key).read(dict.fromkeys(declared.allowed, one))
            return {name: value for name, value in found.items() if value is not None}
        if value is None:  # which an option may say
            if declared.default is ...:
                raise InputError(f"{self.where(key)}: is missing")
            return declared.default
        if dataclasses.is_dataclass(kind):
            if declared.off is not None and not isinstance(value, Mapping):
                if value is not False:
                    raise _refused(self.where(key), value, "a table, or false")
                return declared.off
            return self.table(key).read_as(kind)
        if dataclasses.is_dataclass(entry):
            if not isinstance(value, list | tuple):
                raise _refused(self.where(key), value, "a list of tables")
            places = enumerate(value, start=1)
            tables = (TomlTable(one, f"{self.where(key)} {at}", folder=self.folder) for at, one in places)
            return tuple(table.read_as(entry) for table in tables)
        found = checked(value, declared, self.where(key))
        paths = (found if isinstance(found, tuple) else (found,)) if declared.is_path else ()
        if key not in self.origins and any(re.search(r"[\b\t\n\f\r]", one) for one in paths):
            raise InputError(f"{self.where(key)}: is {shown(found)}, no path; {_OF_PATHS}")
        if declared.plugins:
            return located(found, Path() if key in self.origins else self.folder)
        if isinstance(found, tuple):
            return tuple(self.path(key, one) for one in paths) if paths else found
        return self.path(key, found) if paths else found


def to_toml(tables: Mapping[str, Mapping | Sequence[Mapping]]) -> str:
    """Tables, and lists of tables, of numbers, texts, lists and tables of those as TOML; keys of None are left out.

    Raises
    ------
    InputError
        For a value that TOML has no place for.
    """
    heads = (
        (f"[{_key(name)}]" if table is found else f"[[{_key(name)}]]", table)
        for name, found in tables.items()
        for table in ([found] if isinstance(found, Mapping) else found)
    )
    return "\n".join(f"{head}\n" + "".join(f"{line}\n" for line in _lines(table)) for head, table in heads)


def _lines(table):
    return [f"{_key(key)} = {_value(value)}" for key, value in table.items() if value is not None]


def _key(key):
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _value(key)


def _value(value):
    if isinstance(value, str) and value == value.encode(errors="replace").decode():
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool | int):
        return json.dumps(value)
    if isinstance(value, float):
        return float.__repr__(value)  # NumPy's own says np.float64(...)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(_lines(value)) + " }"
    raise InputError(f"{value!r}: has no place in a TOML file; allowed: a number, a text, or a list of those")
