"""CSV tables of users: their rows, in chunks by NumPy, and what the numbers of a column may be.

NumPy's `loadtxt` parses what is clean: no quotes, no blank or missing cells, decimal points. Other chunks are split
into texts. pyarrow reads Parquet.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .csv_header import TableLayout, beginning, is_parquet, quoted, read_parquet
from .errors import InputError
from .files import number, open_bytes

MAX_ROWS = 20_000_000
"""The whole NGSIM portal file has 12 million."""
EMPTY = ("", "NULL", "null", "None")
"""What stands for a missing value; the text ``nan`` does not."""
_CHUNK_ROWS = 5_000  # more fill the processor's cache with short strings
_TEXT = 24  # characters that the fast parser takes; longer texts are read as rows
_LARGEST = 2.0**53  # whole numbers are exact up to here

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

    def checked(self, columns: Mapping[str, Column]) -> Rows:
        """The same rows with those of the `columns` that there are as numbers; errors as of `numbers`."""
        checked = {name: self.numbers(name, columns[name]) for name in self.columns if name in columns}
        return replace(self, columns={**self.columns, **checked})

    def texts(self, name: str) -> list[str]:
        """A column as texts; what is missing is the empty text, and so are all where the file has none."""
        given = self.columns.get(name)
        return [""] * len(self) if given is None else ["" if one is None else str(one) for one in given.tolist()]

    def codes(self, name: str, index: dict[str, int]) -> np.ndarray:
        """Places of the texts of a column in `index`, which grows, (n,) int64."""
        return np.array([index.setdefault(text, len(index)) for text in self.texts(name)], dtype=np.int64)


_MINUS = "\u2212"  # as spreadsheets of some countries write it


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


# --- Rows, by whoever can read them -----------------------------------------------------------------------

# Numbers with commas. In a table with commas one stands in quotes and divides thousands; between semicolons, tabs, bars
# or blanks it is decimal, in a file without decimal points. Where all could be either, the file is refused.
_THOUSANDS = re.compile(r"[+-]?[1-9][0-9]{0,2}(?:,[0-9]{3})+(?:\.[0-9]*)?")
_EITHER = re.compile(r"[+-]?[1-9][0-9]{0,2},[0-9]{3}")
_WITH_COMMA = re.compile(r'(?:^|[\s;|"])([+-]?[0-9]*(?:,[0-9]*)+)(?=[\s;|"]|$)', re.MULTILINE)
_WITH_POINT = re.compile(r'(?:^|[\s;|,"])[+-]?[0-9]*\.[0-9]*(?:[eE][+-]?[0-9]+)?(?=[\s;|,"]|$)', re.MULTILINE)


def _has_decimal_commas(path: str | Path, text: str, delimiter: str | None) -> bool:
    """Whether commas are decimal, by the beginning of a file; where they may divide thousands too, it is refused."""
    if _WITH_POINT.search(text):
        return False
    found = text.split('"')[1::2] if delimiter == "," else _WITH_COMMA.findall(text)
    found = [one for one in found if re.search(r"[0-9],[0-9]", one) and not re.search(r"[^0-9,+-]", one)]
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
    MissingExtraError
        For Parquet without pyarrow.
    """
    used = {name: layout.columns.index(name) for name in (*columns, *texts) if name in layout.columns}
    if is_parquet(path):
        rows = _rows_of_parquet(path, used, columns)
        if len(rows) > MAX_ROWS:
            raise InputError(f"{path}: more than {MAX_ROWS:,} rows; split the file")
        if len(rows):
            yield rows
        return
    head, encoding = beginning(path)
    decimal = _has_decimal_commas(path, head, layout.delimiter)
    plain_text = _with_point if decimal else _without_thousands
    with open_bytes(path) as stream, io.TextIOWrapper(stream, encoding, errors="replace", newline="") as text:
        below = islice(text, layout.first_line - 1, None)
        first = layout.first_line
        while lines := list(islice(below, _CHUNK_ROWS)):
            if first + len(lines) > layout.first_line + MAX_ROWS:
                raise InputError(f"{path}: more than {MAX_ROWS:,} rows; split the file")
            joined = "".join(lines)
            if joined.count('"') % 2:  # a quoted field goes on
                for line in below:
                    lines.append(line)
                    if line.count('"') % 2:
                        break
                joined = "".join(lines)
            if decimal and _WITH_POINT.search(joined):
                raise InputError(f"{path}: has numbers with a decimal comma and with a point; allowed: one of them")
            plain = _unquoted(joined, lines) if '"' in joined and layout.delimiter == "," else lines
            begin = range(first, first + len(lines))
            found = None if decimal else _parsed(plain, layout, used, columns.keys())
            first += len(lines)
            if found is None:
                begin, found = _split(lines, path, layout, used, begin[0])
                if decimal or layout.delimiter == ",":
                    numeric = [name for name in columns if name in found]
                    found |= {name: np.array(list(map(plain_text, found[name])), dtype=object) for name in numeric}
            if len(begin):
                yield Rows(found, begin, f"{path}:")


def read_whole(
    path: str | Path, layout: TableLayout, columns: Mapping[str, Column], texts: Collection[str] = ()
) -> Rows:
    """All rows of a table in one, numbers checked; parameters and errors as of `read_rows` and `Rows.numbers`."""
    parts, shared, place = [], {}, f"{path}:"
    for rows in read_rows(path, layout, columns, texts):
        place = rows.place
        part = rows.checked(columns).columns
        words = {name: [shared.setdefault(text, text) for text in rows.texts(name)] for name in part if name in texts}
        parts.append(part | {name: np.array(column, dtype=object) for name, column in words.items()} | {"": rows.lines})
    names = parts[0] if parts else {"": ()} | dict.fromkeys((*columns, *texts), ())
    found = {name: np.concatenate([part[name] for part in parts] or [np.zeros(0)]) for name in names}
    return Rows(found, found.pop("").astype(np.int64), place)


def _with_point(text: str) -> str:
    return text.replace(",", ".")


def _without_thousands(text: str) -> str:
    return text.replace(",", "") if _THOUSANDS.fullmatch(text.strip()) else text


def _unquoted(joined: str, lines: list[str]) -> list[str]:
    """Lines of CSV without quotes and the separators of thousands within, if they are all about numbers."""
    pieces = joined.split('"')
    within = "\0".join(pieces[1::2])
    if not re.fullmatch(r"[0-9.,+\0-]*", within):
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
        table = np.loadtxt(
            lines, [("", kind) for kind in kinds], comments=None, delimiter=layout.delimiter, ndmin=1, encoding=None
        )
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
    lines: list[str], path: str | Path, layout: TableLayout, used: Mapping[str, int], first: int
) -> tuple[list[int], dict[str, np.ndarray]]:
    """The numbers of the lines of a chunk in which rows begin, and their columns as texts; the `first` line's number.

    Raises
    ------
    InputError
        If a row has not as many fields as there are columns.
    """
    width, line, rows, begin = len(layout.columns), first, [], []
    least = max((place for place, name in enumerate(layout.columns, start=1) if name), default=0)
    reader = csv.reader(lines, delimiter=layout.delimiter) if layout.delimiter else map(str.split, lines)
    try:
        for row in reader:
            if least <= len(row) and not "".join(row[width:]).strip():  # as spreadsheets end rows
                row = [*row, *[""] * (width - len(row))][:width]
            if "".join(row).strip():
                if len(row) != width:
                    raise InputError(f"{path}:{line}: {len(row)} fields; the first line has {width}")
                rows.append(row)
                begin.append(line)
            line = first + reader.line_num if layout.delimiter else line + 1
    except csv.Error as error:
        raise InputError(f"{path}:{line}: {error}") from error
    fields = list(zip(*rows, strict=True)) or [()] * width
    return begin, {name: np.array(fields[place], dtype=object) for name, place in used.items()}


def _rows_of_parquet(path: str | Path, used: Mapping[str, int], columns: Mapping[str, Column]) -> Rows:
    """All rows of a Parquet file; what a column lacks is None, or NaN where cells of numbers may be empty."""
    table, found = read_parquet(path, [*used.values()]), {}
    for place, name in enumerate(used):
        values, missing = table.column(place).to_numpy(), table.column(place).is_null().to_numpy()
        if name in columns and values.dtype.kind in "iuf" and (columns[name].optional or not missing.any()):
            found[name] = values.astype(np.float64)
        else:
            found[name] = np.where(missing, None, values.astype(object))
    return Rows(found, range(1, 1 + len(table)), f"{path}: row ")
