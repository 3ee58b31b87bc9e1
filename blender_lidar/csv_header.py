"""The beginning of a table of a user's: encoding, first lines, what divides the columns, and what their names mean.

Of a Parquet file the names of its columns stand for the header; reading it needs pyarrow.
"""

from __future__ import annotations

import codecs
import csv
import difflib
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from .errors import InputError, MissingExtraError, printable
from .files import open_bytes

_HEAD_BYTES = 2**17
_LONGEST_SHOWN, _NAMES_SHOWN = 40, 3

# --- The first lines of a file ----------------------------------------------------------------------------

_ZIP, _OLD_WORKBOOK = b"PK\x03\x04", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
_OF_WORKBOOKS = (b"[Content_Types].xml", b"docProps/", b"vnd.oasis.opendocument")
_MARKED = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
_NO_TEXT = re.compile(r"[\x00-\x08\x0e-\x1f]")
_LINE_END = re.compile(r"\r\n?|\n")
_NAMES_SEPARATOR = re.compile(r'"?sep=.?"?[;,\t|]*\s*', re.IGNORECASE)  # a first line of Excel's


def beginning(path: str | Path) -> tuple[str, str]:
    """The first lines of a file as one text, and the encoding that spreadsheets or others wrote it in.

    By its byte order mark UTF-8 or UTF-16; without one UTF-8, UTF-16 if every other byte is 0, or Windows-1252.
    """
    with open_bytes(path) as stream:
        head = stream.read(_HEAD_BYTES)
    zipped = head.startswith(_ZIP)
    if head.startswith(_OLD_WORKBOOK) or (zipped and any(mark in head for mark in _OF_WORKBOOKS)):
        raise InputError(f"{path}: a workbook of a spreadsheet; save the sheet as CSV")
    if zipped:
        raise InputError(f"{path}: a zip archive; unpack it and give the .txt or .csv file inside")
    marked = next((encoding for mark, encoding in _MARKED.items() if head.startswith(mark)), None)
    halves = {"utf-16-le": head[1::2], "utf-16-be": head[::2]}
    zeros = [encoding for encoding, half in halves.items() if any(head) and half and not any(half)]
    for encoding in [marked] if marked else zeros or ["utf-8", "cp1252"]:
        try:
            text = codecs.getincrementaldecoder(encoding)().decode(head, final=len(head) < _HEAD_BYTES)
        except UnicodeDecodeError:
            continue
        if encoding == "cp1252" and _NO_TEXT.search(text):
            break
        if len(head) == _HEAD_BYTES and (ends := list(_LINE_END.finditer(text))):
            text = text[: ends[-1].end()]
        return text, encoding
    raise InputError(f"{path}: not a text file (UTF-8, UTF-16 or Windows-1252)")


def first_lines(path: str | Path) -> list[tuple[int, str]]:
    """The first lines of a text and their numbers from 1, without blank lines, comments, and Excel's ``sep=;``.

    Comments start with ``#``. Of a Parquet file there is one, of number 0: the names of its columns.

    Raises
    ------
    MissingFileError, InputError
        As `open_bytes`; and if there is no such line, or the file is not text.
    MissingExtraError
        For Parquet without pyarrow.
    """
    if is_parquet(path):
        return [(0, ",".join(read_parquet(path).names))]
    lines = list(enumerate(_LINE_END.split(beginning(path)[0]), start=1))
    if _NAMES_SEPARATOR.fullmatch(lines[0][1]):
        del lines[0]
    lines = [(number, line) for number, line in lines if line.strip(" \t;,") and not line.lstrip('"').startswith("#")]
    if not lines:
        raise InputError(f"{path}: no rows; a table is needed")
    return lines


# --- The header: what divides its names, columns in any spelling, and those that are needed ---------------


def fields_of(line: str, delimiter: str | None = ",") -> list[str]:
    """The fields of one line, without padding and quotes; no `delimiter` stands for any run of white space."""
    if delimiter is None:
        return line.split()
    return [field.strip() for field in next(csv.reader([line.replace("\r", " ")], delimiter=delimiter), [])]


def delimiter_of(header: str, known: Collection[str]) -> str | None:
    """What divides the names of a header: comma, semicolon, tab, bar or, as None, any run of white space.

    It is the one by which most of the names are `known`.
    """

    def found(mark: str | None) -> tuple[int, bool, bool, int]:
        names, count = known_names(fields_of(header, mark), known), header.count(mark or " ")
        return len(set(names) & set(known)), count > 0, mark is not None, count

    return max((",", ";", "\t", "|", None), key=found)


def header_names(header: str, known: Collection[str]) -> tuple[list[str], str | None]:
    """The names of a header, as `known_names` spells them, and what divides them, as `delimiter_of` finds it."""
    delimiter = delimiter_of(header, known)
    return known_names(fields_of(header, delimiter), known), delimiter


def known_names(names: Iterable[str], known: Iterable[str]) -> list[str]:
    """Names of columns in small letters, spelt as the `known` ones: ``"X [m]"`` as ``"x_m"``."""
    spelt = {_letters(name): name for name in known}
    return [spelt.get(_letters(name), name.strip().lower()) for name in names]


def _letters(name: str) -> str:
    return re.sub(r"[\W_]+", "", name.lower().replace("°", "deg"))


Words = Mapping[str, Collection[str]]
"""By the name of a column, words in another name by which it is meant: ``{"x_m": {"x", "east"}}``."""


def column_meant(name: str, words: Words) -> str | None:
    """The first column of `words` that has one in common with a name; None for none."""
    parts = set(re.split(r"[\W\d_]+", name.lower()))
    return next((column for column, known in words.items() if parts & set(known)), None)


def nearest_names(wanted: Iterable[str], present: Iterable[str], words: Words) -> dict[str, str]:
    """Which of the `present` names of columns may be meant by those that are `wanted`, each for one at most.

    One is if it has one of the `words` for a name in it, or is spelt much alike.
    """
    left, found = [name for name in present if name], {}
    for name in wanted:
        of_words = (one for one in left if column_meant(one, {name: words.get(name, ())}))
        near = next(of_words, None) or next(iter(difflib.get_close_matches(name, left, 1, 0.75)), None)
        if near is not None:
            found[name] = near
            left.remove(near)
    return found


class TableLayout(NamedTuple):
    """How the rows of one file are written.

    Attributes
    ----------
    columns : sequence of str
        Their names in the file's order.
    delimiter : str or None
        None stands for any run of white space.
    first_line : int
        Number of the first data line, counting from 1.
    """

    columns: Sequence[str]
    delimiter: str | None
    first_line: int

    def check(self, needed: Iterable[str], optional: Iterable[str], path: str | Path, words: Words | None = None):
        """Refuse a header that lacks a needed column, or has one twice.

        Raises
        ------
        InputError
            Naming what the missing ones may be called there; without `words` for them no guess is made.
        """
        needed = list(needed)
        where = f"{path}:{self.first_line - 1}" if self.first_line > 1 else str(path)
        if missing := [name for name in needed if name not in self.columns]:
            names = [short(name) for name in self.columns if name]
            listed = f"needed: {', '.join(needed)}; it has {', '.join(names)}"
            others = [name for name in names if name not in needed]
            near = {} if words is None else nearest_names(missing, others, words)
            listed += f"; nearest: {', '.join(f'{one} to {name}' for name, one in near.items())}" if near else ""
            raise InputError(f"{where}: no column {', '.join(missing)}; {listed}")
        if twice := [name for name in (*needed, *optional) if self.columns.count(name) > 1]:
            raise InputError(f"{where}: column {twice[0]} is there twice")


def laid_out(path: str | Path, needed: Iterable[str], optional: Iterable[str] = ()) -> TableLayout:
    """How the rows of a table are written, by its header; names of columns as `known_names` finds them.

    Raises
    ------
    MissingFileError, InputError
        As `first_lines` and `TableLayout.check`.
    """
    line, header = first_lines(path)[0]
    layout = TableLayout(*header_names(header, (*needed, *optional)), line + 1)
    layout.check(needed, optional, path)
    return layout


# --- Names and texts from a file, as messages show them ---------------------------------------------------


def short(name: str) -> str:
    """A name from a file as a message shows it."""
    return printable(name, _LONGEST_SHOWN)


def listed(names: Sequence[str]) -> str:
    """Some names from a file, and how many more there are."""
    more = f" and {len(names) - _NAMES_SHOWN:,} more" if len(names) > _NAMES_SHOWN else ""
    return ", ".join(map(short, names[:_NAMES_SHOWN])) + more


def quoted(text: str) -> str:
    """A text from a file as an error shows it, cut where it is long."""
    return repr(text if len(text) <= _LONGEST_SHOWN else text[:_LONGEST_SHOWN] + "...")


# --- Parquet, whose columns have names and no header ----------------------------------------------------------


def is_parquet(path: str | Path) -> bool:
    """Whether a file is Parquet, by its first bytes."""
    with open_bytes(path, unpack=False) as stream:
        return stream.read(4) == b"PAR1"


def read_parquet(path: str | Path, columns: Sequence[int] | None = None) -> Any:
    """A Parquet file as a table of pyarrow's, of the columns at these places alone, or its schema.

    Raises
    ------
    InputError
        If it cannot be read.
    MissingExtraError
        Without pyarrow.
    """
    try:
        from pyarrow import parquet

        schema = parquet.read_schema(path)
        return schema if columns is None else parquet.ParquetFile(path).read([schema.names[at] for at in columns])
    except ImportError as error:
        text = f'{path}: Parquet files need pyarrow: pip install "blender_lidar[parquet]"'
        raise MissingExtraError(text) from error
    except Exception as error:  # of many kinds, by pyarrow
        raise InputError(f"{path}: truncated or damaged Parquet file ({str(error).partition(chr(10))[0]})") from error
