"""CSV files whose lines messages name: columns of texts, of whole numbers and of shares."""

from __future__ import annotations

import csv
from collections import Counter
from io import TextIOWrapper
from pathlib import Path

import numpy as np

from ..errors import InputError, MissingFileError, printable, unknown_name
from ..input_file import open_file

_LONGEST_NAME = 255  # that of files, which frames are named after
_MOST_COLUMNS = 1_000


class TextTable:
    """A CSV file as texts, column by column, with the line of each row.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError, MissingFileError
        Naming the file, and the line or the column, where it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            with TextIOWrapper(open_file(path), encoding="utf-8-sig", errors="replace", newline="") as stream:
                reader = csv.reader(stream)
                header = [printable(name.strip(), _LONGEST_NAME) for name in next(reader, [])]
                if len(header) > _MOST_COLUMNS:
                    raise InputError(f"{path}: has {len(header):,} columns; allowed: at most {_MOST_COLUMNS:,}")
                rows = [(reader.line_num, row) for row in reader if any(text.strip() for text in row)]
        except FileNotFoundError as error:
            raise MissingFileError(f"{path}: there is no such file") from error
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
        except csv.Error as error:
            raise InputError(f"{path}: is no table ({error})") from error
        twice = [name for name, count in Counter(header).items() if count > 1]
        if twice:
            raise InputError(f"{path}: has two columns {twice[0]!r}")
        if not rows:
            raise InputError(f"{path}: has no row below its header")
        for line, row in rows:
            if len(row) != len(header):
                raise InputError(f"{path}:{line}: {len(row)} fields; the header has {len(header)}")
        self.header = header
        self.lines = [line for line, _ in rows]
        self._columns = dict(zip(header, zip(*(row for _, row in rows), strict=True), strict=True))

    def need(self, name: str) -> None:
        """Refuse a table without that column."""
        if name not in self.header:
            raise unknown_column(name, self.header, str(self.path))

    def texts(self, name: str) -> list[str]:
        """A column of names, none of them empty."""
        texts = [printable(text.strip(), _LONGEST_NAME) for text in self._columns[name]]
        for line, text in zip(self.lines, texts, strict=True):
            if not text:
                raise InputError(f"{self.path}:{line}: {name} is empty")
        return texts

    def whole_numbers(self, name: str) -> np.ndarray:
        """A column of numbers from 0 on that count something."""
        found = []
        for line, text in zip(self.lines, self.texts(name), strict=True):
            if not (text.isascii() and text.isdigit() and len(text) < 10):
                raise InputError(f"{self.path}:{line}: {name} is {text!r}; allowed: a whole number of 0 or more")
            found.append(int(text))
        return np.array(found, dtype=np.int64)

    def shares(self, name: str) -> np.ndarray:
        """A column of numbers from 0 to 1."""
        found = []
        for line, text in zip(self.lines, self.texts(name), strict=True):
            try:
                value = np.nan if "_" in text else float(text)  # "0_1" is 1 to Python alone
            except ValueError:
                value = np.nan
            if not 0.0 <= value <= 1.0:
                raise InputError(f"{self.path}:{line}: {name} is {text!r}; allowed: 0 to 1")
            found.append(value)
        return np.array(found)


def unknown_column(name: str, header: list[str], where: str) -> InputError:
    """An error for a column that is not there, with the nearest one that is."""
    known = unknown_name(name, header, "column")
    _, _, hint = str(known).partition("; ")
    near = hint.partition("? ")[0] + "? " if hint.startswith("did you mean") else ""
    return InputError(f"{where}: has no column {name!r}; {near}it has {listed(header)}")


def listed(header: list[str]) -> str:
    """Names of columns for a message."""
    return ", ".join(header) or "none"
