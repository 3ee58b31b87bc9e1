"""SUMO's floating car data as CSV: ``sumo --fcd-output run.fcd.csv``, or its tool ``xml2csv.py``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ..errors import InputError
from .csv_rows import csv_columns, fields_of
from .source import table_lines
from .sumo_columns import chunk_of_vehicles, is_fcd_header, places_of_columns
from .sumo_rows import FcdChunk

_DELIMITERS = (";", ",", "\t")


def csv_chunks(path: str | Path) -> Iterator[FcdChunk]:
    """The vehicles of a file whose columns stand in any order; persons and containers are counted.

    Raises
    ------
    MissingFileError, InputError
        If the file cannot be read, lacks a column, or a row has too few or too many fields.
    """
    number, line = next(table_lines(path), (0, ""))
    if not line:
        raise InputError(f"{path}: no rows; a recording of SUMO's is needed")
    delimiter, header = _split(line)
    places = places_of_columns(header, f"{path}:{number}")
    for lines, columns in csv_columns(path, header, number, delimiter):
        yield chunk_of_vehicles(
            {name: columns[place] for name, place in places.items()}, lambda row, lines=lines: f"{path}:{lines[row]}"
        )


def is_fcd_line(line: str) -> bool:
    """Whether a line is the header of floating car data, complete or not."""
    return is_fcd_header(_split(line)[1])


def _split(line: str) -> tuple[str, list[str]]:
    """The delimiter of a header, and its fields."""
    delimiter = max(_DELIMITERS, key=line.count)
    return delimiter, fields_of(line, delimiter)
