"""Which of NGSIM's dialects a file speaks: native text, the portal's CSV or its API's.

Columns: NGSIM trajectory data dictionary (US DOT FHWA, DOI 10.21949/1504477).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from ..errors import InputError
from .csv_rows import fields_of
from .source import MAX_COLUMNS, table_lines

NEEDED = (
    "vehicle_id",
    "frame_id",
    "global_time",
    "local_x",
    "local_y",
    "v_length",
    "v_width",
    "v_class",
    "lane_id",
)
"""The columns that are used, in lower case as the portal's API writes them."""

DIRECTION_COLUMNS = ("direction", "movement")
"""Of arterials: where a vehicle is bound for, and whether it goes straight on or turns."""
_SHOWN = dict(
    zip(
        NEEDED,
        ["Vehicle_ID", "Frame_ID", "Global_Time", "Local_X", "Local_Y", "v_Length", "v_Width", "v_Class", "Lane_ID"],
        strict=True,
    )
)
_FIRST_14 = [
    *("vehicle_id", "frame_id", "total_frames", "global_time", "local_x", "local_y", "global_x", "global_y"),
    *("v_length", "v_width", "v_class", "v_vel", "v_acc", "lane_id"),
]
_LAST_4 = ["preceding", "following", "space_headway", "time_headway"]
_ARTERIAL = ["o_zone", "d_zone", "int_id", "section_id", "direction", "movement"]
# The six columns of arterials come after column 14 (the data dictionaries of Lankershim and Peachtree); it is said, of
# files not seen, after 16. Of them, and of what they shift, Direction alone is used.
_WITHOUT_HEADER = {
    18: [*_FIRST_14, *_LAST_4],
    24: [*_FIRST_14, *_ARTERIAL, *_LAST_4],
    25: [*_FIRST_14, *_ARTERIAL, *_LAST_4, "location"],
}


@dataclass(frozen=True, slots=True)
class Layout:
    """How the rows of one file are written.

    Attributes
    ----------
    columns : tuple of str
        Lower-case column names in the file's order.
    delimiter : str or None
        None stands for any run of spaces and tabs.
    first_line : int
        Number of the first data line, counting from 1.
    """

    columns: tuple[str, ...]
    delimiter: str | None
    first_line: int

    @property
    def has_location(self) -> bool:
        return "location" in self.columns

    @property
    def arterial(self) -> bool:
        """Whether this is the native text of a site with intersections, 24 columns wide."""
        return "location" not in self.columns and "int_id" in self.columns

    def split(self, line: str) -> list[str]:
        """The fields of one line, without quotes and padding."""
        if self.delimiter is None:
            return line.split()
        return [field.strip() for field in fields_of(line, self.delimiter)]


def shown(column: str) -> str:
    """A column's name as NGSIM writes it."""
    return _SHOWN.get(column, column)


def sniff_layout(path: str | Path) -> Layout:
    """Find out how a file of NGSIM trajectories is written.

    Lines before the table that are blank or start with ``#`` are skipped.

    Raises
    ------
    MissingFileError
        If there is no such file.
    InputError
        If the file is empty, is not text, has a header without one of the needed columns, or has no header and
        neither 18, 24 nor 25 columns.
    """
    lines = list(islice(table_lines(path), 2))
    if not lines:
        raise InputError(f"{path}: no rows; a file of vehicles is needed")
    number, line = lines[0]
    delimiter = next((mark for mark in (",", ";") if mark in line), None)
    if _is_number(Layout((), delimiter, number).split(line)[0]):
        return _without_header(path, line, delimiter, number)
    if delimiter is None and "\t" in line:
        delimiter = "\t"  # under a header, cells may be empty: every tab counts
    layout = _with_header(path, line, delimiter, number)
    if len(lines) < 2:
        raise InputError(f"{path}: no rows below the header in line {number}")
    return layout


def _without_header(path: str | Path, line: str, delimiter: str | None, number: int) -> Layout:
    fields = Layout((), delimiter, number).split(line)
    trailing = [""] if fields[-1] == "" else []  # a delimiter at the line's end
    columns = _WITHOUT_HEADER.get(len(fields) - len(trailing))
    if columns is None:
        raise InputError(f"{path}:{number}: {len(fields)} fields; NGSIM rows have 18 or 24, the portal's 25")
    return Layout((*columns, *trailing), delimiter, number)


def _with_header(path: str | Path, line: str, delimiter: str | None, number: int) -> Layout:
    columns = [field.lower().replace(" ", "_") for field in Layout((), delimiter, number).split(line)]
    if len(columns) > MAX_COLUMNS:
        raise InputError(f"{path}:{number}: {len(columns):,} columns; allowed: at most {MAX_COLUMNS:,}")
    missing = [shown(column) for column in NEEDED if column not in columns]
    if missing:
        raise InputError(
            f"{path}:{number}: no column {', '.join(missing)}; needed: {', '.join(_SHOWN.values())} (any letter case)"
        )
    twice = [shown(column) for column in NEEDED if columns.count(column) > 1]
    if twice:
        raise InputError(f"{path}:{number}: column {twice[0]} is there twice")
    return Layout(tuple(columns), delimiter, number + 1)


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", ""))
    except ValueError:
        return False
    return True
