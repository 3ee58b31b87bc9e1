"""Reading text files of traffic, plain or gzip: opening, the first lines, CSV rows in chunks, numbers."""

from __future__ import annotations

import csv
import gzip
import io
import math
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain, islice
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import InputError, MissingFileError
from ..files import open_file

MAX_ROWS = 20_000_000
"""The whole NGSIM portal file has 12 million."""
_HEAD_BYTES = 2**17
_CHUNK_ROWS = 5_000  # more fill the processor's cache with short strings
_LONGEST_SHOWN = 40
_WAS_QUOTED = "+"  # numbers may begin with it


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
    try:
        with open_file(path) as file:
            packed = unpack and file.peek(2)[:2] == b"\x1f\x8b"
            yield gzip.GzipFile(fileobj=file) if packed else file
    except (InputError, MissingFileError):  # what reads the file has said so already
        raise
    except FileNotFoundError as error:
        raise MissingFileError(f"{path}: no such file") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: a folder; a file of vehicles is needed") from error
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise InputError(f"{path}: truncated or damaged gzip file ({error})") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error


def table_lines(path: str | Path) -> Iterator[tuple[int, str]]:
    """The first lines of a table and their numbers from 1, without blank lines and comments that start with ``#``.

    Raises
    ------
    MissingFileError, InputError
        As `open_bytes`; and if the file is empty or not text.
    """
    with open_bytes(path) as stream:
        head = stream.read(_HEAD_BYTES)
    if not head.strip():
        raise InputError(f"{path}: empty; a file of vehicles is needed")
    if head.startswith(b"PK\x03\x04"):
        raise InputError(f"{path}: a zip archive; unpack it and give the .txt or .csv file inside")
    if len(head) == _HEAD_BYTES and b"\n" in head:
        head = head[: head.rfind(b"\n") + 1]
    try:
        text = head.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file (UTF-8)") from error
    if "\0" in text:
        raise InputError(f"{path}: not a text file (it holds zero bytes)")
    for number, line in enumerate(text.split("\n"), start=1):
        if line.strip() and not line.startswith("#"):
            yield number, line.rstrip("\r")


def first_line(path: str | Path, needed: str) -> tuple[int, str]:
    """The first of `table_lines`; if there is none, the error says that `needed` is."""
    found = next(table_lines(path), None)
    if found is None:
        raise InputError(f"{path}: no rows; {needed} is needed")
    return found


def fields_of(line: str, delimiter: str = ",") -> list[str]:
    """The fields of one line; a carriage return within it counts as a space."""
    return next(csv.reader([line.replace("\r", " ")], delimiter=delimiter), [])


def column_places(
    names: Sequence[str], needed: Mapping[str, str], optional: Iterable[str], where: str, hint: str = ""
) -> dict[str, int]:
    """Which place among `names`, those of a header, each column has that is needed, or optional and there.

    Parameters
    ----------
    names : sequence of str
        In the file's order.
    needed : mapping of str to str
        Names of columns, and how an error spells them.
    optional : iterable of str
    where, hint : str
        The header's place, and what an error says last.

    Raises
    ------
    InputError
        If a needed column is missing, or one is there twice.
    """
    missing = [spelt for name, spelt in needed.items() if name not in names]
    if missing:
        raise InputError(f"{where}: no column {', '.join(missing)}; needed: {', '.join(needed.values())}{hint}")
    wanted = [*needed, *(name for name in optional if name in names)]
    twice = [needed.get(name, name) for name in wanted if names.count(name) > 1]
    if twice:
        raise InputError(f"{where}: column {twice[0]} is there twice")
    return {name: names.index(name) for name in wanted}


def csv_columns(
    path: str | Path,
    header_line: int,
    width: int,
    delimiter: str | None = ",",
    others: str = "the header has",
    parse: Callable[[list[str]], list[Sequence] | None] = lambda lines: None,
) -> Iterator[tuple[Sequence[int], list[Sequence]]]:
    """The rows below a line that are not blank, a chunk at a time; no `delimiter` stands for any run of white space.

    Parameters
    ----------
    path : path
    header_line, width : int
    delimiter : str, optional
    others : str
        What an error says has `width` fields.
    parse : function of a list of lines
        Returns their columns where it can, such as with `parsed_columns`; where it returns None, as without it, the
        lines are split into rows of texts.

    Yields
    ------
    lines : sequence of int, (n,)
        The numbers of the lines in which the rows begin.
    columns : list of tuples of str, (width, n)
        Or what `parse` returned.

    Raises
    ------
    InputError
        If a row has not `width` fields, as `others` do, or there are more than `MAX_ROWS`.
    """
    with (
        open_bytes(path) as stream,
        io.TextIOWrapper(stream, encoding="utf-8-sig", errors="replace", newline="") as text,
    ):
        below = islice(text, header_line, None)
        first = header_line + 1
        while chunk := list(islice(below, _CHUNK_ROWS)):
            if first + len(chunk) > header_line + 1 + MAX_ROWS:
                raise InputError(f"{path}: more than {MAX_ROWS:,} rows; split the file")
            columns = parse(chunk)
            if columns is not None:
                yield range(first, first + len(chunk)), columns
                first += len(chunk)
                continue
            rows, first = _filled_rows(chunk, below, str(path), first, width, delimiter, others)
            if rows:
                lines, fields = zip(*rows, strict=True)
                yield lines, list(zip(*fields, strict=True))


def _filled_rows(
    chunk: list[str], below: Iterator[str], path: str, first: int, width: int, delimiter: str | None, others: str
) -> tuple[list[tuple[int, list[str]]], int]:
    """The rows that are not blank, each with the number of the line that it begins in, and the next chunk's first line.

    A quoted field may go on in the lines `below`.
    """
    reader = csv.reader(chain(chunk, below), delimiter=delimiter) if delimiter else map(str.split, chunk)
    rows, line = [], first
    try:
        for number, row in enumerate(reader, start=1):
            if len(row) == width:
                rows.append((line, row))
            elif len(row) > 1 or "".join(row).strip():
                raise InputError(f"{path}:{line}: {len(row)} fields; {others} {width}")
            line = first + (reader.line_num if delimiter else number)
            if line >= first + len(chunk):
                break
    except csv.Error as error:
        raise InputError(f"{path}:{line}: {error}") from error
    return rows, line


def parsed_columns(lines: list[str], delimiter: str | None, kinds: Sequence[str]) -> list[np.ndarray] | None:
    """The columns of clean lines, parsed by NumPy in C; None if they are to be split into rows of texts.

    Parameters
    ----------
    lines : list of str
    delimiter : str or None
        None stands for any run of white space.
    kinds : sequence of str, (width,)
        NumPy's types of the columns: ``"f8"`` for numbers, ``"U24"`` for texts, which have to be shorter, ``"U1"`` for
        columns that nobody needs.

    Returns
    -------
    list of ndarray, (width, n), or None
        None also where a line is blank, a number missing or not finite, or a text quoted.
    """
    joined = "".join(lines)
    plain = _unquoted(joined, delimiter) if delimiter and '"' in joined else lines
    if "\0" in joined or not plain or plain[0].isspace():  # NumPy warns where all lines are blank
        return None
    try:
        table = np.loadtxt(plain, ",".join(kinds), comments=None, delimiter=delimiter, ndmin=1, encoding=None)
    except ValueError:
        return None
    columns = [np.ascontiguousarray(table[name]) for name in table.dtype.names]  # no views that hold the table
    for kind, column in zip(kinds, columns, strict=True):
        if kind == "f8":
            clean = np.isfinite(column).all()
        else:
            texts = () if kind == "U1" else set(column.tolist())
            clean = all(len(text) < int(kind[1:]) and text[:1] != _WAS_QUOTED for text in texts)
        if not clean:
            return None
    return columns if len(table) == len(lines) else None


def _unquoted(text: str, delimiter: str) -> list[str]:
    """Lines of CSV without quotes and the separators of thousands within, a plus before each; none if unclear."""
    pieces = f"\n{text}".split('"')
    within = f'"{_WAS_QUOTED}'.join(["", *pieces[1::2]]).replace(",", "")
    ends = (delimiter, "\r", "\n")
    opened = all(piece.endswith(ends) for piece in pieces[:-1:2])
    closed = len(pieces) % 2 and all(piece.startswith(ends) for piece in pieces[2::2])
    if not (opened and closed) or "\n" in within or "\r" in within:
        return []
    pieces[1::2] = within.split('"')[1:]
    return "".join(pieces).split("\n")[1:]


def numbers(texts: Sequence[str | float | None]) -> np.ndarray:
    """Texts as numbers, (n,) float64; NaN where one is none, or missing."""
    try:
        if "_" not in "".join(texts):
            return np.array(texts, dtype=np.float64)
    except (TypeError, ValueError):
        pass
    return np.array([number(text) for text in texts])


def number(text: str | float | None) -> float:
    """A text as a number; NaN if it is none: ``"1_0"`` is 10 to Python alone."""
    try:
        return math.nan if text is None or "_" in str(text) else float(text)
    except ValueError:
        return math.nan


def quoted(value: object) -> str:
    """A value from a file as an error shows it, cut where it is long."""
    text = str(value)
    text = text if len(text) <= _LONGEST_SHOWN else text[:_LONGEST_SHOWN] + "..."
    return repr(text) if isinstance(value, str) else text
