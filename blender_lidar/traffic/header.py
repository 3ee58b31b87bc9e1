"""The header of a table: what divides its names, columns in any spelling, and those that are needed."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from ..errors import InputError
from .source import first_lines, short


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

    def check(
        self,
        needed: Iterable[str],
        optional: Iterable[str],
        where: str,
        nearest: Callable[[Iterable[str], Iterable[str]], dict[str, str]] = lambda wanted, present: {},
    ) -> list[str]:
        """The columns that are used: the needed ones, and the optional ones that are there.

        An error names those that may be meant: `nearest` finds them for missing names among those that are present.

        Raises
        ------
        InputError
            If the header, which stands at `where`, lacks a needed one or has one twice.
        """
        needed = list(needed)
        missing = [name for name in needed if name not in self.columns]
        if missing:
            names = [short(name) for name in self.columns if name]
            listed = f"needed: {', '.join(needed)}; it has {', '.join(names)}"
            near = nearest(missing, [name for name in names if name not in needed])
            listed += f"; nearest: {', '.join(f'{one} to {name}' for name, one in near.items())}" if near else ""
            raise InputError(f"{where}: no column {', '.join(missing)}; {listed}")
        used = [*needed, *(name for name in optional if name in self.columns)]
        for name in used:
            if self.columns.count(name) > 1:
                raise InputError(f"{where}: column {name} is there twice")
        return used


def laid_out(
    path: str | Path,
    needed: Iterable[str],
    optional: Iterable[str] = (),
    nearest: Callable[[Iterable[str], Iterable[str]], dict[str, str]] = lambda wanted, present: {},
) -> TableLayout:
    """How the rows of a table are written, by its header; names of columns as `known_names` finds them.

    Raises
    ------
    MissingFileError, InputError
        As `first_lines` and `TableLayout.check`.
    """
    line, header = first_lines(path)[0]
    layout = TableLayout(*header_names(header, (*needed, *optional)), line + 1)
    layout.check(needed, optional, f"{path}:{line}", nearest)
    return layout
