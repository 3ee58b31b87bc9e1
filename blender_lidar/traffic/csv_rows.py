"""Rows of a CSV file by the thousand, with the numbers of their lines."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

from ..errors import InputError
from .source import MAX_COLUMNS, MAX_ROWS, open_bytes

_CHUNK_ROWS = 5_000  # more fill the processor's cache with short strings


def fields_of(line: str, delimiter: str = ",") -> list[str]:
    """The fields of one line; those of a line that is no CSV, as it holds a carriage return, with their quotes."""
    try:
        return next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:
        return line.split(delimiter)


def csv_columns(
    path: str | Path, header: Sequence[str], header_line: int, delimiter: str = ","
) -> Iterator[tuple[Sequence[int], list[tuple[str, ...]]]]:
    """The rows below a header that are not blank, a chunk at a time.

    Yields
    ------
    lines : sequence of int, (n,)
        The rows' line numbers.
    columns : list of tuples of str, (len(header), n)

    Raises
    ------
    InputError
        If a row has another number of fields than the header, or there are more than `MAX_ROWS` or `MAX_COLUMNS`.
    """
    if len(header) > MAX_COLUMNS:
        raise InputError(f"{path}:{header_line}: {len(header):,} columns; allowed: at most {MAX_COLUMNS:,}")
    with io.TextIOWrapper(open_bytes(path), encoding="utf-8", errors="replace", newline="") as text:
        reader = csv.reader(islice(text, header_line, None), delimiter=delimiter)
        rows = _filled_rows(reader, len(header), str(path), header_line)
        try:
            while chunk := list(islice(rows, _CHUNK_ROWS)):
                lines, fields = zip(*chunk, strict=True)
                yield lines, list(zip(*fields, strict=True))
        except csv.Error as error:
            raise InputError(f"{path}:{header_line + reader.line_num}: {error}") from error


def _filled_rows(reader, width: int, path: str, header_line: int) -> Iterator[tuple[int, list[str]]]:
    """The rows that are not blank, each with the number of the line that it begins in."""
    line = header_line + 1
    for number, row in enumerate(reader):
        if number == MAX_ROWS:  # of which blank ones take time too
            raise InputError(f"{path}: more than {MAX_ROWS:,} rows; split the file")
        if len(row) == width:
            yield line, row
        elif len(row) > 1 or "".join(row).strip():
            raise InputError(f"{path}:{line}: {len(row)} fields; the header has {width}")
        line = header_line + reader.line_num + 1
