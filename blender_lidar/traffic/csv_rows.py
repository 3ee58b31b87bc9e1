"""Rows of a CSV file by the thousand, with the numbers of their lines."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

from ..errors import InputError
from .source import MAX_ROWS, open_bytes

_CHUNK_ROWS = 5_000  # more fill the processor's cache with short strings


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
        If a row has another number of fields than the header, or there are more than `MAX_ROWS`.
    """
    rows_read = 0
    for lines, rows in _chunks(path, header_line, delimiter):
        rows_read += len(rows)
        if rows_read > MAX_ROWS:
            raise InputError(f"{path}: more than {MAX_ROWS:,} rows; split the file")
        if set(map(len, rows)) != {len(header)}:
            line, found = next(
                (line, len(row)) for line, row in zip(lines, rows, strict=True) if len(row) != len(header)
            )
            raise InputError(f"{path}:{line}: {found} fields; the header has {len(header)}")
        yield lines, list(zip(*rows, strict=True))


def _chunks(path: str | Path, header_line: int, delimiter: str) -> Iterator[tuple[Sequence[int], list[list[str]]]]:
    with io.TextIOWrapper(open_bytes(path), encoding="utf-8", errors="replace", newline="") as text:
        reader = csv.reader(islice(text, header_line, None), delimiter=delimiter)
        line = header_line + 1
        try:
            while rows := list(islice(reader, _CHUNK_ROWS)):
                lines: Sequence[int] = range(line, line + len(rows))
                line += len(rows)
                filled = [number for number, row in enumerate(rows) if len(row) > 1 or "".join(row).strip()]
                if len(filled) < len(rows):
                    lines, rows = [lines[number] for number in filled], [rows[number] for number in filled]
                if rows:
                    yield lines, rows
        except csv.Error as error:
            raise InputError(f"{path}:{header_line + reader.line_num}: {error}") from error
