"""Rows of SUMO's floating car data as arrays, whichever kind of file they come from."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .source import MAX_ROWS

NEEDED = ("time", "id", "x", "y", "angle")
OPTIONAL = ("type", "lane", "z", "speed")
_TEXTS = ("id", "type", "lane")
_NO_POSITION = -(2.0**30)  # SUMO's INVALID_DOUBLE: the vehicle is nowhere, as while it teleports
_LARGEST = 1e10  # metres, degrees, metres a second: squares and sums stay finite
_LONGEST_SHOWN = 40

Values = Sequence[str | float | None]
"""Of one attribute, a value a row, as the file gives them; empty or None where missing."""


@dataclass(frozen=True, slots=True, eq=False)
class FcdChunk:
    """Neighbouring rows of a file.

    Attributes
    ----------
    columns : mapping of str to Values
        By attribute: all of `NEEDED`, and those of `OPTIONAL` that the file has.
    where : callable
        The place of a row of this chunk, counted from 0, as an error names it: ``file:line``.
    left_out : int
        Persons and containers between the rows.
    """

    columns: Mapping[str, Values]
    where: Callable[[int], str]
    left_out: int = 0

    def __len__(self) -> int:
        return len(self.columns["id"])


@dataclass(frozen=True, slots=True, eq=False)
class FcdRows:
    """All rows of a file that are vehicles.

    Attributes
    ----------
    time_ms : ndarray, (n,) int64
        Ascending; SUMO's clock counts whole milliseconds.
    xy_m : ndarray, (n, 2)
        Middle of the front bumper, in the net's coordinates [m].
    angle_deg : ndarray, (n,)
        Clockwise from the net's +y.
    z_m, speed_m_s : ndarray, (n,)
        NaN where the file has none.
    id_code, type_code, lane_code : ndarray, (n,) int64
        Places in the lists below.
    ids, types, lanes : list of str
        In order of first appearance; a missing type or lane is the empty text.
    rows_read : int
        With persons, containers and vehicles that are nowhere.
    left_out : int
        Persons and containers.
    nowhere : int
        Rows of vehicles without a position.
    """

    time_ms: np.ndarray
    xy_m: np.ndarray
    angle_deg: np.ndarray
    z_m: np.ndarray
    speed_m_s: np.ndarray
    id_code: np.ndarray
    type_code: np.ndarray
    lane_code: np.ndarray
    ids: list[str]
    types: list[str]
    lanes: list[str]
    rows_read: int
    left_out: int
    nowhere: int

    def __len__(self) -> int:
        return len(self.time_ms)


def collected(chunks: Iterable[FcdChunk], source: str) -> FcdRows:
    """All rows of a file, checked.

    Raises
    ------
    InputError
        For a missing value, a number that is none, a time that goes back, or a file without a vehicle.
    """
    known: dict[str, dict[str, int]] = {name: {} for name in _TEXTS}
    parts: list[dict[str, np.ndarray]] = []
    rows_read = left_out = 0
    latest_ms = -np.inf
    for chunk in chunks:
        rows_read += len(chunk) + chunk.left_out
        left_out += chunk.left_out
        if rows_read > MAX_ROWS:
            raise InputError(f"{source}: more than {MAX_ROWS:,} rows; split the file")
        if not len(chunk):
            continue
        part = {name: _codes(chunk, name, index) for name, index in known.items()}
        part |= {name: _numbers(chunk, name) for name in ("x", "y", "angle", "z", "speed")}
        part["time"] = _milliseconds(chunk)
        _refuse_going_back(part["time"], latest_ms, chunk)
        latest_ms = part["time"][-1]
        parts.append(part)
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]} if parts else {}
    somewhere = columns["x"] != _NO_POSITION if parts else np.zeros(0, dtype=bool)
    if not somewhere.any():
        raise InputError(f"{source}: no vehicle in {rows_read:,} rows; at least one is needed")
    columns = {name: column[somewhere] for name, column in columns.items()}
    return FcdRows(
        time_ms=columns["time"],
        xy_m=np.column_stack([columns["x"], columns["y"]]),
        angle_deg=columns["angle"],
        z_m=columns["z"],
        speed_m_s=columns["speed"],
        id_code=columns["id"],
        type_code=columns["type"],
        lane_code=columns["lane"],
        ids=list(known["id"]),
        types=list(known["type"]),
        lanes=list(known["lane"]),
        rows_read=rows_read,
        left_out=left_out,
        nowhere=int((~somewhere).sum()),
    )


def _codes(chunk: FcdChunk, name: str, index: dict[str, int]) -> np.ndarray:
    """Places of texts in `index`, which grows, (n,) int64."""
    texts = chunk.columns.get(name)
    if texts is None:
        return np.full(len(chunk), index.setdefault("", len(index)))
    codes = np.array(
        [index.setdefault("" if text is None else str(text), len(index)) for text in texts], dtype=np.int64
    )
    if name == "id" and "" in index:
        raise InputError(f"{chunk.where(int((codes == index['']).argmax()))}: id is missing")
    return codes


def _numbers(chunk: FcdChunk, name: str) -> np.ndarray:
    """Finite numbers, (n,); NaN where an attribute that may be missing is."""
    values = chunk.columns.get(name)
    if values is None:
        return np.full(len(chunk), np.nan)
    try:
        numbers = np.array(values, dtype=np.float64)
        doubtful = any("_" in value for value in values if isinstance(value, str))  # "1_0" is 10 to Python alone
    except (TypeError, ValueError):
        doubtful = True
    if doubtful:
        numbers = _numbers_one_by_one(chunk, name)
    good = (np.abs(numbers) <= _LARGEST) | (np.isnan(numbers) & (name in OPTIONAL))
    if not good.all():
        raise _unusable(chunk, name, int(good.argmin()))
    return numbers


def _numbers_one_by_one(chunk: FcdChunk, name: str) -> np.ndarray:
    """As `_numbers`, for texts among which one may be no number."""
    numbers = np.full(len(chunk), np.nan)
    for row, value in enumerate(chunk.columns[name]):
        try:
            if isinstance(value, str) and "_" in value:
                raise ValueError(value)
            if value not in (None, ""):
                numbers[row] = float(value)
        except (TypeError, ValueError):
            raise _unusable(chunk, name, row) from None
    return numbers


def _milliseconds(chunk: FcdChunk) -> np.ndarray:
    return np.rint(1000.0 * _numbers(chunk, "time")).astype(np.int64)


def _refuse_going_back(time_ms: np.ndarray, latest_ms: float, chunk: FcdChunk) -> None:
    before = np.concatenate([[latest_ms], time_ms[:-1]])
    back = time_ms < before
    if back.any():
        row = int(back.argmax())
        raise InputError(
            f"{chunk.where(row)}: time {time_ms[row] / 1000} s comes after {before[row] / 1000} s; times must ascend"
        )


def _unusable(chunk: FcdChunk, name: str, row: int) -> InputError:
    value = chunk.columns[name][row]
    if value is None or value == "":
        hint = "; SUMO leaves it out if --fcd-output.attributes does" if name in ("x", "y", "angle") else ""
        return InputError(f"{chunk.where(row)}: {name} is missing{hint}")
    text = str(value)
    given = text if len(text) <= _LONGEST_SHOWN else text[:_LONGEST_SHOWN] + "..."
    shown = repr(given) if isinstance(value, str) else given
    hint = " (leave out SUMO's --human-readable-time)" if name == "time" and ":" in str(value) else ""
    allowed = f"{-_LARGEST:g} to {_LARGEST:g}" if _is_finite(value) else "a finite number"
    return InputError(f"{chunk.where(row)}: {name} is {shown}; allowed: {allowed}{hint}")


def _is_finite(value: str | float) -> bool:
    try:
        return bool(np.isfinite(float(value))) and "_" not in str(value)
    except ValueError:
        return False
