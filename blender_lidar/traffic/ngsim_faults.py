"""What a value of an NGSIM file may be, and the one line that says where a file breaks it.

The fast reader only notices that something is wrong; these functions walk the file again to say where.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from ..errors import InputError
from .ngsim_layout import NEEDED, Layout, shown
from .source import open_bytes

EMPTY = ("", "NULL", "null")
"""What stands for a missing number; the text ``nan`` does not."""
_LARGEST_WHOLE = 2.0**53


def _finite(values: np.ndarray) -> np.ndarray:
    return np.isfinite(values)


def _clock(values: np.ndarray) -> np.ndarray:
    return np.abs(values) <= _LARGEST_WHOLE


def _whole(values: np.ndarray) -> np.ndarray:
    return (np.abs(values) <= _LARGEST_WHOLE) & (np.rint(values) == values)


def _size(values: np.ndarray) -> np.ndarray:
    return np.isnan(values) | ((values >= 0) & np.isfinite(values))


def _class(values: np.ndarray) -> np.ndarray:
    return (values == 1) | (values == 2) | (values == 3)


def _lane(values: np.ndarray) -> np.ndarray:
    return np.isnan(values) | ((np.abs(values) < 2**15) & (np.rint(values) == values))


@dataclass(frozen=True, slots=True)
class Rule:
    """Which numbers a column may hold; an empty cell is NaN here."""

    accepts: Callable[[np.ndarray], np.ndarray]
    allowed: str


RULES = {
    "vehicle_id": Rule(_whole, "a whole number"),
    "frame_id": Rule(_whole, "a whole number"),
    "global_time": Rule(_clock, "milliseconds"),
    "local_x": Rule(_finite, "feet"),
    "local_y": Rule(_finite, "feet"),
    "v_length": Rule(_size, "feet, at least 0"),
    "v_width": Rule(_size, "feet, at least 0"),
    "v_class": Rule(_class, "1 (motorcycle), 2 (auto) or 3 (truck)"),
    "lane_id": Rule(_lane, "a whole number"),
}


def unreadable(path: str | Path, layout: Layout, reason: str) -> InputError:
    """The error for the first row that has the wrong number of fields or text in a number.

    `reason` is the parser's own, for what this finds nothing wrong with.
    """
    for line, fields in _rows(path, layout):
        if len(fields) != len(layout.columns):
            return _wrong_count(path, layout, line, fields)
        for column in NEEDED:
            text = fields[layout.columns.index(column)]
            if not _is_number_or_empty(text):
                return _unusable(path, line, column, text)
    return InputError(f"{path}: cannot be read as NGSIM rows ({' '.join(reason.split())})")


def bad_value(path: str | Path, layout: Layout, row: int) -> InputError:
    """The error for a row, counting from 0, that was read but holds a value against `RULES`."""
    line, fields = next(islice(_rows(path, layout), row, None), (0, []))
    if not line:  # lines end elsewhere than where rows do, or the file has changed
        return InputError(f"{path}: cannot be read as NGSIM rows, each in a line of its own")
    if len(fields) != len(layout.columns):
        return _wrong_count(path, layout, line, fields)
    for column, rule in RULES.items():
        text = fields[layout.columns.index(column)]
        if not _is_number_or_empty(text):
            return _unusable(path, line, column, text)
        value = float(text.replace(",", "")) if text not in EMPTY else np.nan
        if not rule.accepts(np.array([value]))[0]:
            return _unusable(path, line, column, text)
    return InputError(f"{path}:{line}: cannot be read as an NGSIM row")


def short_row(path: str | Path, layout: Layout, rows: np.ndarray) -> InputError | None:
    """The error for the first of some rows, counted from 0, whose last field is missing rather than empty."""
    suspects = set(rows.tolist())
    if not suspects:
        return None
    for number, (line, fields) in enumerate(_rows(path, layout)):
        if number in suspects and len(fields) != len(layout.columns):
            return _wrong_count(path, layout, line, fields)
    return None


def _rows(path: str | Path, layout: Layout) -> Iterator[tuple[int, list[str]]]:
    with open_bytes(path) as stream:
        for line, raw in enumerate(stream, start=1):
            text = raw.decode("utf-8", errors="replace").strip("\r\n")
            if line >= layout.first_line and text.strip():
                yield line, layout.split(text)


def _is_number_or_empty(text: str) -> bool:
    if text in EMPTY:
        return True
    try:
        float(text.replace(",", ""))
    except ValueError:
        return False
    return "_" not in text and text.lower().strip("+-") != "nan"


def _wrong_count(path: str | Path, layout: Layout, line: int, fields: list[str]) -> InputError:
    return InputError(f"{path}:{line}: {len(fields)} fields; the other rows have {len(layout.columns)}")


def _unusable(path: str | Path, line: int, column: str, text: str) -> InputError:
    given = repr(text if len(text) <= 40 else text[:40] + "...") if text else "nothing"
    allowed = RULES[column].allowed
    return InputError(f"{path}:{line}: {shown(column)} is {given}; allowed: {allowed}")
