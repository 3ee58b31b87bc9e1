"""Reading text tables of traffic, plain or gzip: encoding, first lines, rows in chunks, and what columns may hold."""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import re
import zlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

import numpy as np

from ..errors import InputError, printable
from ..files import number, open_file, reading

if TYPE_CHECKING:
    from .header import TableLayout

MAX_ROWS = 20_000_000
"""The whole NGSIM portal file has 12 million."""
EMPTY = ("", "NULL", "null", "None")
"""What stands for a missing value; the text ``nan`` does not."""
_HEAD_BYTES = 2**17
_CHUNK_ROWS = 5_000  # more fill the processor's cache with short strings
_TEXT = 24  # characters that the fast parser takes; longer texts are read as rows
_LONGEST_SHOWN = 40
_NAMES_SHOWN = 3
NUMBERED = "vehicles are numbered from 0 by first appearance"
_LARGEST = 2.0**53  # whole numbers are exact up to here

# --- Opening a file, its first lines ----------------------------------------------------------------------


@contextmanager
def open_bytes(path: str | Path, *, unpack: bool = True) -> Iterator[BinaryIO]:
    """Open a file for reading, unpacked if its content (not its name) is gzip.

    Raises
    ------
    MissingFileError
        If there is no such file.
    InputError
        If it is a folder, a pipe or a device, may not be read, or turns out to be damaged while it is read.
    """
    with reading(path, "a file of vehicles"), open_file(path) as file:
        packed = unpack and file.peek(2)[:2] == b"\x1f\x8b"
        try:
            yield gzip.GzipFile(fileobj=file) if packed else file
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise InputError(f"{path}: truncated or damaged gzip file ({error})") from error


_ZIP, _OLD_WORKBOOK = b"PK\x03\x04", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
_OF_WORKBOOKS = (b"[Content_Types].xml", b"docProps/", b"vnd.oasis.opendocument")
_MARKED = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
_NO_TEXT = re.compile(r"[\x00-\x08\x0e-\x1f]")
_LINE_END = re.compile(r"\r\n?|\n")
_NAMES_SEPARATOR = re.compile(r'"?sep=.?"?[;,\t|]*\s*', re.IGNORECASE)  # a first line of Excel's


def _beginning(path: str | Path) -> tuple[str, str]:
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

    Comments start with ``#``.

    Raises
    ------
    MissingFileError, InputError
        As `open_bytes`; and if there is no such line, or the file is not text.
    """
    lines = list(enumerate(_LINE_END.split(_beginning(path)[0]), start=1))
    if _NAMES_SEPARATOR.fullmatch(lines[0][1]):
        del lines[0]
    lines = [(number, line) for number, line in lines if line.strip(" \t;,") and not line.lstrip('"').startswith("#")]
    if not lines:
        raise InputError(f"{path}: no rows; a file of vehicles is needed")
    return lines


# --- Columns of numbers -----------------------------------------------------------------------------------


class Column(NamedTuple):
    """What the numbers of a column may be.

    Attributes
    ----------
    allowed : str
        What an error says is allowed.
    low, high : float
        Limits, themselves allowed.
    whole : bool
        Whether they are whole numbers.
    optional : bool
        Whether cells may be empty, which are NaN then.
    """

    allowed: str
    low: float = -_LARGEST
    high: float = _LARGEST
    whole: bool = False
    optional: bool = False

    def accepts(self, values: np.ndarray) -> np.ndarray:
        """Which numbers are allowed, (n,) bool; NaN is where cells may be empty."""
        good = (values >= self.low) & (values <= self.high)
        if self.whole:
            good &= np.rint(values) == values
        return good | np.isnan(values) if self.optional else good


@dataclass(frozen=True, slots=True)
class Rows:
    """Neighbouring rows of a file.

    Attributes
    ----------
    columns : mapping of str to ndarray, (n,)
        By name: numbers as float64, or as the file gives them: texts, None.
    lines : sequence of int, (n,)
        The number of each row's line.
    place : str
        What stands before it in an error: ``"run.csv:"``.
    """

    columns: Mapping[str, np.ndarray]
    lines: Sequence[int]
    place: str

    def __len__(self) -> int:
        return len(self.lines)

    def where(self, row: int) -> str:
        """The place of a row, counted from 0, as an error names it: ``file:line``."""
        return f"{self.place}{self.lines[row]}"

    def select(self, which: np.ndarray) -> Rows:
        """Those rows that `which`, a (n,) mask, picks."""
        picked = {name: values[which] for name, values in self.columns.items()}
        return Rows(picked, np.array(self.lines)[which], self.place)

    def numbers(self, name: str, column: Column) -> np.ndarray:
        """A column as numbers, (n,) float64; all NaN where the file has none.

        Raises
        ------
        InputError
            For the first cell that holds something else than `column` allows.
        """
        given = self.columns.get(name)
        if given is None:
            return np.full(len(self), np.nan)
        found = numbers(given)
        good = column.accepts(found)
        for row in np.flatnonzero(~good | np.isnan(found) if given.dtype == object else ~good):
            text = str(given[row]).strip()
            if not good[row] or text not in EMPTY:
                seen = "nothing" if text in EMPTY else f"{found[row]:.15g}" if np.isfinite(found[row]) else quoted(text)
                raise InputError(f"{self.where(row)}: {name} is {seen}; allowed: {column.allowed}")
        return found


_MINUS = "\u2212"  # as spreadsheets of some countries write it
_GARBLED = "\ufffd"  # in place of what is not in the encoding of the rest


def numbers(values: np.ndarray) -> np.ndarray:
    """Numbers, texts or None as numbers, (n,) float64; NaN where one is none, or missing."""
    if values.dtype != object:
        return values.astype(np.float64, copy=False)
    try:
        joined = "".join(values)
        if "_" not in joined and joined.isascii():
            return values.astype(np.float64)
    except (TypeError, ValueError):
        pass
    return np.array([number(str(value).replace(_MINUS, "-")) for value in values])


def codes(rows: Rows, name: str, index: dict[str, int]) -> np.ndarray:
    """Places of the texts of a column in `index`, which grows, (n,) int64; what is missing is the empty text."""
    given = rows.columns.get(name)
    texts = [""] * len(rows) if given is None else ["" if text is None else str(text) for text in given.tolist()]
    return np.array([index.setdefault(text, len(index)) for text in texts], dtype=np.int64)


def vehicle_ids(rows: Rows, name: str, index: dict[str, int]) -> np.ndarray:
    """`codes` of a column of vehicles' ids.

    Raises
    ------
    InputError
        For the first row without one, or where the file's encoding garbles it.
    """
    found = codes(rows, name, index)
    for text in (*EMPTY, *(text for text in index if _GARBLED in text or text.strip().lower() in ("", "nan"))):
        if text in index and (row := np.flatnonzero(found == index[text])).size:
            encoding = "is in another encoding than the file's beginning; save it as UTF-8"
            raise InputError(f"{rows.where(row[0])}: {name} {encoding if _GARBLED in text else 'is missing'}")
    return found


def vehicle_numbers(names: Sequence[str]) -> tuple[np.ndarray, list[str]]:
    """The number of each vehicle, (n,) int64, by what the file calls them: their own where all are whole, from 0 on.

    Else they count from 0 by first appearance, and a note says so.
    """
    if all(_WHOLE.fullmatch(name.strip()) for name in names):
        return np.array([float(name) for name in names]).astype(np.int64), []
    return np.arange(len(names)), [f"{NUMBERED}: {listed(names)}"]


_WHOLE = re.compile(r"(?:0|[1-9][0-9]{0,14})(?:\.0*)?")  # below 2**53; with a point, as spreadsheets write them


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


# --- Rows in chunks, parsed in C where they are clean -----------------------------------------------------

# Numbers with commas. In a table with commas one stands in quotes and divides thousands; between semicolons, tabs, bars
# or blanks it is decimal, in a file without decimal points. Where all could be either, the file is refused.
_THOUSANDS = re.compile(r"[+-]?[1-9][0-9]{0,2}(?:,[0-9]{3})+(?:\.[0-9]*)?")
_EITHER = re.compile(r"[+-]?[1-9][0-9]{0,2},[0-9]{3}")
_WITH_COMMA = re.compile(r'(?:^|[\s;|"])([+-]?[0-9]*(?:,[0-9]*)+)(?=[\s;|"]|$)', re.MULTILINE)
_WITH_POINT = re.compile(r'(?:^|[\s;|,"])[+-]?[0-9]*\.[0-9]*(?:[eE][+-]?[0-9]+)?(?=[\s;|,"]|$)', re.MULTILINE)


def _has_decimal_commas(path: str | Path, beginning: str, delimiter: str | None) -> bool:
    """Whether commas are decimal, by the beginning of a file; where they may also divide thousands, it is refused."""
    if _WITH_POINT.search(beginning):
        return False
    found = beginning.split('"')[1::2] if delimiter == "," else _WITH_COMMA.findall(beginning)
    found = [text for text in found if re.search(r"[0-9],[0-9]", text) and not re.search(r"[^0-9,+-]", text)]
    if found and delimiter != ";" and all(map(_EITHER.fullmatch, found)):
        words = "may have a decimal comma or divide thousands; write decimal points"
        raise InputError(f"{path}: {found[0]!r} and its like {words}")
    return bool(found) and delimiter != ","


def read_rows(
    path: str | Path, layout: TableLayout, columns: Mapping[str, Column], texts: Collection[str] = ()
) -> Iterator[Rows]:
    """The rows of a table that are not blank, a chunk at a time, with their decimal commas and thousands read.

    Parameters
    ----------
    path : path
    layout : TableLayout
        How the rows are written.
    columns : mapping of str to Column
        Those that hold numbers, by name.
    texts : collection of str
        Those that hold texts.

    Yields
    ------
    Rows
        With those of these columns that there are.

    Raises
    ------
    InputError
        If a row has not as many fields as the others, there are more than `MAX_ROWS`, or commas in numbers may mean
        decimals or thousands.
    """
    used = {name: layout.columns.index(name) for name in (*columns, *texts) if name in layout.columns}
    beginning, encoding = _beginning(path)
    decimal = _has_decimal_commas(path, beginning, layout.delimiter)
    plain_text = _with_point if decimal else _without_thousands
    with (
        open_bytes(path) as stream,
        io.TextIOWrapper(stream, encoding=encoding, errors="replace", newline="") as text,
    ):
        below = islice(text, layout.first_line - 1, None)
        first = layout.first_line
        while chunk := list(islice(below, _CHUNK_ROWS)):
            if first + len(chunk) > layout.first_line + MAX_ROWS:
                raise InputError(f"{path}: more than {MAX_ROWS:,} rows; split the file")
            if decimal and _WITH_POINT.search("".join(chunk)):
                raise InputError(f"{path}: has numbers with a decimal comma and with a point; allowed: one of them")
            plain = _unquoted(chunk) if layout.delimiter == "," else chunk
            found = None if decimal else _parsed(plain, layout, used, columns.keys())
            lines = range(first, first + len(chunk))
            first += len(chunk)
            if found is None:
                lines, found, first = _split(chain(chunk, below), str(path), layout, used, lines)
                if decimal or layout.delimiter == ",":
                    numeric = [name for name in columns if name in found]
                    found |= {name: np.array(list(map(plain_text, found[name])), dtype=object) for name in numeric}
            if len(lines):
                yield Rows(found, lines, f"{path}:")


def _with_point(text: str) -> str:
    return text.replace(",", ".")


def _without_thousands(text: str) -> str:
    return text.replace(",", "") if _THOUSANDS.fullmatch(text.strip()) else text


def _unquoted(lines: list[str]) -> list[str]:
    """Lines of CSV without quotes and the separators of thousands within, if they are all about numbers."""
    pieces = "".join(lines).split('"')
    within = "\0".join(pieces[1::2])
    if len(pieces) < 2 or len(pieces) % 2 == 0 or not re.fullmatch(r"[0-9.,+\0-]*", within):
        return lines
    if any("," in text and not _THOUSANDS.fullmatch(text) for text in pieces[1::2]):
        return lines
    pieces[1::2] = within.replace(",", "").split("\0")
    return list(io.StringIO("".join(pieces), newline=""))


def _parsed(
    lines: list[str], layout: TableLayout, used: Mapping[str, int], numeric: Collection[str]
) -> dict[str, np.ndarray] | None:
    """The columns of clean lines, parsed by NumPy in C; None if they are to be split into texts.

    They are where a line is blank, a field quoted, a text long, or a number missing or not finite.
    """
    joined = "".join(lines)
    if '"' in joined or "\0" in joined or lines[0].isspace():  # NumPy warns where all lines are blank
        return None
    kinds = ["U1"] * len(layout.columns)  # columns that nobody needs
    for name, place in used.items():
        kinds[place] = "f8" if name in numeric else f"U{_TEXT}"
    try:
        table = np.loadtxt(lines, ",".join(kinds), comments=None, delimiter=layout.delimiter, ndmin=1, encoding=None)
    except ValueError:
        return None
    if len(table) < len(lines):
        return None
    found = {}
    for name, place in used.items():
        values = np.ascontiguousarray(table[table.dtype.names[place]])  # no view that holds the table
        if not (np.isfinite(values).all() if name in numeric else np.char.str_len(values).max() < _TEXT):
            return None
        found[name] = values
    return found


def _split(
    lines: Iterator[str], path: str, layout: TableLayout, used: Mapping[str, int], numbers: range
) -> tuple[list[int], dict[str, np.ndarray], int]:
    """The numbers of the lines of a chunk in which rows begin, their columns as texts, and the next chunk's first line.

    A quoted field may go on in `lines` beyond the chunk, whose lines have these `numbers`.
    """
    width, line, rows, begin = len(layout.columns), numbers[0], [], []
    least = max((place for place, name in enumerate(layout.columns, start=1) if name), default=0)
    reader = csv.reader(lines, delimiter=layout.delimiter) if layout.delimiter else map(str.split, lines)
    try:
        while line in numbers and (row := next(reader, None)) is not None:
            if least <= len(row) and not "".join(row[width:]).strip():  # as spreadsheets end rows
                row = [*row, *[""] * (width - len(row))][:width]
            if not "".join(row).strip():
                pass
            elif len(row) == width:
                rows.append(row)
                begin.append(line)
            else:
                raise InputError(f"{path}:{line}: {len(row)} fields; the first line has {width}")
            line = numbers[0] + reader.line_num if layout.delimiter else line + 1
    except csv.Error as error:
        raise InputError(f"{path}:{line}: {error}") from error
    fields = list(zip(*rows, strict=True)) or [()] * width
    return begin, {name: np.array(fields[place], dtype=object) for name, place in used.items()}, line
