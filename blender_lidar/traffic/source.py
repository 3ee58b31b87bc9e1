"""Reading text tables of traffic, plain or gzip: opening, header, rows in chunks, and what columns may hold."""

from __future__ import annotations

import csv
import gzip
import io
import re
import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from ..errors import InputError
from ..files import number, open_file, reading

MAX_ROWS = 20_000_000
"""The whole NGSIM portal file has 12 million."""
EMPTY = ("", "NULL", "null", "None")
"""What stands for a missing value; the text ``nan`` does not."""
_HEAD_BYTES = 2**17
_CHUNK_ROWS = 5_000  # more fill the processor's cache with short strings
_TEXT = 24  # characters that the fast parser takes; longer texts are read as rows
_LONGEST_SHOWN = 40
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


def first_lines(path: str | Path) -> list[tuple[int, str]]:
    """The first lines of a text and their numbers from 1, without blank lines and comments that start with ``#``.

    Raises
    ------
    MissingFileError, InputError
        As `open_bytes`; and if there is no such line, or the file is not text.
    """
    with open_bytes(path) as stream:
        head = stream.read(_HEAD_BYTES)
    if head.startswith(b"PK\x03\x04"):
        raise InputError(f"{path}: a zip archive; unpack it and give the .txt or .csv file inside")
    if len(head) == _HEAD_BYTES and b"\n" in head:
        head = head[: head.rfind(b"\n") + 1]
    try:
        text = head.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file (UTF-8)") from error
    lines = [(number, line.rstrip("\r")) for number, line in enumerate(text.split("\n"), start=1)]
    lines = [(number, line) for number, line in lines if line.strip() and not line.startswith("#")]
    if not lines:
        raise InputError(f"{path}: no rows; a file of vehicles is needed")
    return lines


def fields_of(line: str, delimiter: str | None = ",") -> list[str]:
    """The fields of one line, without padding and quotes; no `delimiter` stands for any run of white space."""
    if delimiter is None:
        return line.split()
    return [field.strip() for field in next(csv.reader([line.replace("\r", " ")], delimiter=delimiter), [])]


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

    def check(self, needed: Iterable[str], optional: Iterable[str], where: str) -> list[str]:
        """The columns that are used: the needed ones, and the optional ones that are there.

        Raises
        ------
        InputError
            If the header, which stands at `where`, lacks a needed one or has one twice.
        """
        needed = list(needed)
        missing = [name for name in needed if name not in self.columns]
        if missing:
            listed = f"needed: {', '.join(needed)}; it has {', '.join(self.columns)}"
            raise InputError(f"{where}: no column {', '.join(missing)}; {listed}")
        used = [*needed, *(name for name in optional if name in self.columns)]
        for name in used:
            if self.columns.count(name) > 1:
                raise InputError(f"{where}: column {name} is there twice")
        return used


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
                told = "nothing" if text in EMPTY else f"{found[row]:.15g}" if np.isfinite(found[row]) else quoted(text)
                raise InputError(f"{self.where(row)}: {name} is {told}; allowed: {column.allowed}")
        return found


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
    return np.array([number(str(value)) for value in values])


def quoted(text: str) -> str:
    """A text from a file as an error shows it, cut where it is long."""
    return repr(text if len(text) <= _LONGEST_SHOWN else text[:_LONGEST_SHOWN] + "...")


# --- Rows in chunks, parsed in C where they are clean -----------------------------------------------------


def read_rows(
    path: str | Path, layout: TableLayout, columns: Mapping[str, Column], texts: Collection[str] = ()
) -> Iterator[Rows]:
    """The rows of a table that are not blank, a chunk at a time; quoted numbers lose their separators of thousands.

    Parameters
    ----------
    path : path
    layout : Layout
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
        If a row has not as many fields as the others, or there are more than `MAX_ROWS`.
    """
    used = {name: layout.columns.index(name) for name in (*columns, *texts) if name in layout.columns}
    with (
        open_bytes(path) as stream,
        io.TextIOWrapper(stream, encoding="utf-8-sig", errors="replace", newline="") as text,
    ):
        below = islice(text, layout.first_line - 1, None)
        first = layout.first_line
        while chunk := list(islice(below, _CHUNK_ROWS)):
            if first + len(chunk) > layout.first_line + MAX_ROWS:
                raise InputError(f"{path}: more than {MAX_ROWS:,} rows; split the file")
            if layout.delimiter == ",":
                chunk = _unquoted(chunk)
            found = _parsed(chunk, layout, used, columns.keys())
            lines = range(first, first + len(chunk))
            first += len(chunk)
            if found is None:
                lines, found, first = _split(chain(chunk, below), str(path), layout, used, lines)
                for name in columns if layout.delimiter == "," else ():
                    if name in found:
                        found[name] = np.array([text.replace(",", "") for text in found[name]], dtype=object)
            if len(lines):
                yield Rows(found, lines, f"{path}:")


def _unquoted(lines: list[str]) -> list[str]:
    """Lines of CSV without quotes and the separators of thousands within, if they are all about numbers."""
    pieces = "".join(lines).split('"')
    within = "\0".join(pieces[1::2])
    if len(pieces) < 2 or len(pieces) % 2 == 0 or not re.fullmatch(r"[0-9.,+\0-]*", within):
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
    reader = csv.reader(lines, delimiter=layout.delimiter) if layout.delimiter else map(str.split, lines)
    try:
        while line in numbers and (row := next(reader, None)) is not None:
            if len(row) == width:
                rows.append(row)
                begin.append(line)
            elif len(row) > 1 or "".join(row).strip():
                raise InputError(f"{path}:{line}: {len(row)} fields; the first line has {width}")
            line = numbers[0] + reader.line_num if layout.delimiter else line + 1
    except csv.Error as error:
        raise InputError(f"{path}:{line}: {error}") from error
    fields = list(zip(*rows, strict=True)) or [()] * width
    return begin, {name: np.array(fields[place], dtype=object) for name, place in used.items()}, line
