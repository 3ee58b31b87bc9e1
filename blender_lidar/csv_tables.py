"""CSV tables of users: header, delimiter, encoding, rows in chunks by NumPy, and what columns may hold.

NumPy's `loadtxt` reads what is plain: UTF-8 with decimal points, whatever divides the columns. pandas reads the rest,
and is imported for it alone: other encodings, decimal commas, Parquet.
"""

from __future__ import annotations

import codecs
import csv
import difflib
import io
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .errors import InputError, MissingExtraError, printable
from .files import number, open_bytes

MAX_ROWS = 20_000_000
"""The whole NGSIM portal file has 12 million."""
EMPTY = ("", "NULL", "null", "None")
"""What stands for a missing value; the text ``nan`` does not."""
_HEAD_BYTES = 2**17
_CHUNK_ROWS = 5_000  # more fill the processor's cache with short strings
_TEXT = 24  # characters that the fast parser takes; longer texts are read as rows
_LONGEST_SHOWN, _NAMES_SHOWN = 40, 3
_BEHIND = 16  # empty columns that spreadsheets may write behind the last one
_LARGEST = 2.0**53  # whole numbers are exact up to here

# --- The first lines of a file ----------------------------------------------------------------------------

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

    Comments start with ``#``. Of a Parquet file there is one, of number 0: the names of its columns.

    Raises
    ------
    MissingFileError, InputError
        As `open_bytes`; and if there is no such line, or the file is not text.
    MissingExtraError
        For Parquet without pyarrow.
    """
    if is_parquet(path):
        return [(0, ",".join(_parquet(path)))]
    lines = list(enumerate(_LINE_END.split(_beginning(path)[0]), start=1))
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


# --- Rows, by whoever can read them -----------------------------------------------------------------------

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


def foreign(path: str | Path, delimiter: str | None) -> str | None:
    """What of a table NumPy does not read, so that pandas is needed; None for a plain one.

    Raises
    ------
    MissingFileError, InputError
        As `first_lines`; and if commas in numbers may mean decimals or thousands.
    """
    if is_parquet(path):
        return "Parquet"
    beginning, encoding = _beginning(path)
    if _has_decimal_commas(path, beginning, delimiter):
        return "decimal commas"
    return None if encoding.startswith("utf-8") else f"the encoding {encoding}"


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
        If pandas or pyarrow is needed and not there.
    """
    used = {name: layout.columns.index(name) for name in (*columns, *texts) if name in layout.columns}
    why = foreign(path, layout.delimiter)
    if why is not None:
        rows = _rows_by_pandas(path, layout, used, columns, why)
        if len(rows) > MAX_ROWS:
            raise InputError(f"{path}: more than {MAX_ROWS:,} rows; split the file")
        if len(rows):
            yield rows
        return
    with open_bytes(path) as stream, io.TextIOWrapper(stream, "utf-8-sig", errors="replace", newline="") as text:
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
            if '"' in joined and layout.delimiter == ",":
                lines = _unquoted(joined, lines)
            begin, found = range(first, first + len(lines)), _parsed(lines, layout, used, columns.keys())
            first += len(lines)
            if found is None:
                begin, found = _split(lines, path, layout, used, begin[0])
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


# --- pandas, for what NumPy does not read ------------------------------------------------------------------


def is_parquet(path: str | Path) -> bool:
    """Whether a file is Parquet, by its first bytes."""
    with open_bytes(path, unpack=False) as stream:
        return stream.read(4) == b"PAR1"


def _parquet(path: str | Path, columns: Sequence[int] | None = None) -> Any:
    """Of a Parquet file the columns at these places, as a DataFrame by place, or the names of all.

    Raises
    ------
    InputError
        If it cannot be read.
    MissingExtraError
        Without pandas or pyarrow.
    """
    pandas = _pandas(path, "Parquet")
    try:
        from pyarrow import parquet

        names = parquet.read_schema(path).names
        if columns is None:
            return names
        frame = pandas.read_parquet(path, engine="pyarrow", columns=[names[place] for place in columns])
    except ImportError as error:
        text = f'{path}: Parquet files need pyarrow: pip install "blender_lidar[parquet]"'
        raise MissingExtraError(text) from error
    except Exception as error:  # of many kinds, by pyarrow and pandas
        raise InputError(f"{path}: truncated or damaged Parquet file ({str(error).partition(chr(10))[0]})") from error
    frame.columns, frame.index = columns, range(1, 1 + len(frame))
    return frame


def _pandas(path: str | Path, why: str) -> Any:
    try:
        import pandas
    except ImportError as error:
        text = f"needs pandas, for {why}: pip install pandas; inside Blender, which lacks it, give the table that"
        raise MissingExtraError(f"{path}: {text} blender-lidar init writes of it outside") from error
    return pandas


def _rows_by_pandas(
    path: str | Path, layout: TableLayout, used: Mapping[str, int], columns: Mapping[str, Column], why: str
) -> Rows:
    """All rows of a foreign table; what a column of numbers lacks is NaN, or None where it holds texts too."""
    if why == "Parquet":
        frame, place = _parquet(path, [*used.values()]), f"{path}: row "
    else:
        texts = [at for name, at in used.items() if name not in columns]
        frame, place = _csv_by_pandas(path, layout, texts, why), f"{path}:"
    found = {}
    for name, at in used.items():
        series = frame[at]
        is_number = name in columns and series.dtype.kind in "iuf"
        if is_number and (columns[name].optional or not series.isna().any()):
            found[name] = series.to_numpy(dtype=np.float64)
            continue
        values = series.astype(object).where(series.notna(), None).to_numpy()
        if name in columns and why == "decimal commas" and not is_number:
            if _WITH_POINT.search(" ".join(text for text in values if text is not None)):
                raise InputError(f"{path}: has numbers with a decimal comma and with a point; allowed: one of them")
            values = np.array([text if text is None else text.replace(",", ".") for text in values], dtype=object)
        found[name] = values
    return Rows(found, frame.index.to_numpy(), place)


def _csv_by_pandas(path: str | Path, layout: TableLayout, texts: Sequence[int], why: str) -> Any:
    """A foreign table of text as a DataFrame, its columns numbered from 0, its rows by their lines."""
    width, pandas, encoding = len(layout.columns), _pandas(path, why), _beginning(path)[1]
    how = {"decimal": "," if why == "decimal commas" else ".", "float_precision": "round_trip", "low_memory": False}
    how |= {"keep_default_na": False, "na_values": list(EMPTY), "dtype": {str(place): str for place in texts}}
    how |= {"skip_blank_lines": False, "skipinitialspace": True, "sep": layout.delimiter or r"\s+"}
    header = (layout.delimiter or " ").join(map(str, range(width + _BEHIND)))
    with open_bytes(path) as stream, io.TextIOWrapper(stream, encoding, errors="replace", newline="") as text:
        try:
            below = io.StringIO("".join([header, "\n", *islice(text, layout.first_line - 1, None)]), newline="")
            frame = pandas.read_csv(below, index_col=False, **how)
        except (ValueError, UnicodeError) as error:
            raise InputError(f"{path}: {str(error).partition(chr(10))[0]}") from error
    frame.columns, frame.index = range(frame.shape[1]), range(layout.first_line, layout.first_line + len(frame))
    frame = frame[frame.notna().any(axis=1)]
    beyond = frame.index[frame.iloc[:, width:].notna().any(axis=1)]
    if len(beyond):
        raise InputError(f"{path}:{beyond[0]}: more than {width} fields; the first line has {width}")
    return frame
