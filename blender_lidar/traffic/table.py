"""A table of boxes: the plain CSV for traffic from anywhere else, read with numpy alone.

One row per vehicle and frame under a header; columns in any order, further ones ignored:

=========================  ==========================================================
``frame``                  whole number
``vehicle_id``             whole number, 0 or more; the same vehicle in every frame
``class``                  car, van, truck, bus or motorcycle
``x_m``, ``y_m``           box centre [m]
``length_m``, ``width_m``  box size [m], more than 0
``height_m``               box height [m], more than 0
``heading_deg``            counter-clockwise from the table's x axis
``z_m`` (optional)         box centre above the road [m]; half the height if left out
``time_s`` (optional)      time of the frame [s]
``lane`` (optional)        whole number
=========================  ==========================================================

``vehicles.csv`` of a run is such a table. It may be packed with gzip, and begin with lines that start with ``#``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import InputError, unknown_name
from .csv_rows import csv_columns, fields_of
from .overlaps import with_overlaps_reported
from .report import RepairReport
from .road import Placing, within_x
from .source import table_lines
from .tracks import drop_repeats
from .vehicles import CLASSES, Recording

NEEDED = ("frame", "vehicle_id", "class", "x_m", "y_m", "length_m", "width_m", "height_m", "heading_deg")
OPTIONAL = ("z_m", "time_s", "lane")
_WHOLE = {"frame": 2**53, "vehicle_id": 2**53, "lane": 2**15 - 1}
_NOT_NEGATIVE = ("vehicle_id",)  # -1 is what is no vehicle
_POSITIVE = ("length_m", "width_m", "height_m")
_SIDE_LIMITS_M = (1e-3, 1e3)
_LARGEST = {"x_m": 1e9, "y_m": 1e9, "z_m": 1e9, "heading_deg": 1e9, "time_s": 1e12}  # sums and squares stay finite
_TIME_STEP_LIMITS_S = (1e-3, 1e6)
_SAME_TIME_S = 1e-6
_LONGEST_SHOWN = 40
_ASSUMED_TIME_STEP_S = 0.1


def read_table(
    path: str | Path,
    *,
    origin_m: tuple[float, float] = (0.0, 0.0),
    heading_deg: float = 0.0,
    time_step_s: float | None = None,
    x_range_m: tuple[float, float] | None = None,
) -> Recording:
    """Read a table of boxes.

    Parameters
    ----------
    path : path
    origin_m : (float, float)
        The road frame's origin in the table's coordinates [m].
    heading_deg : float
        Direction of the road's x axis in the table's frame [degrees], counter-clockwise.
    time_step_s : float, optional
        Time between consecutive frame numbers [s], instead of a column ``time_s``; 0.1 s if there is neither.
    x_range_m : (float, float), optional
        Keep boxes whose centre has its x [m, road frame] in this range.

    Raises
    ------
    MissingFileError, InputError
        If the file or one of its values cannot be used; the text names the line and the column.
    """
    placing = Placing(origin_m, heading_deg)
    if time_step_s is not None and not 0 < time_step_s < math.inf:
        raise InputError(f"time_step_s is {time_step_s}; more than 0 is needed")
    low, high = _TIME_STEP_LIMITS_S
    if time_step_s is not None and not low <= time_step_s <= high:
        raise InputError(f"time_step_s is {time_step_s}; allowed: {low:g} to {high:g}")
    columns = _columns(path)
    rows_read = len(columns["frame"])
    values = np.column_stack([column for name, column in columns.items() if name not in ("frame", "vehicle_id")])
    kept, duplicates, repeated = drop_repeats(columns["vehicle_id"], columns["frame"], values)
    columns = {name: column[kept] for name, column in columns.items()}
    time_s, step_s, notes = _times(path, columns, time_step_s)
    plane = placing.points(np.column_stack([columns["x_m"], columns["y_m"]]))
    centre = np.column_stack([plane, columns.get("z_m", columns["height_m"] / 2)])
    inside = within_x(centre, x_range_m, str(path))
    recording = Recording.from_rows(
        frame=columns["frame"][inside],
        time_s=time_s[inside],
        vehicle_id=columns["vehicle_id"][inside],
        class_index=columns["class"][inside],
        centre_m=centre[inside],
        size_m=np.column_stack([columns[name] for name in _POSITIVE])[inside],
        heading_rad=placing.headings(np.radians(columns["heading_deg"]))[inside],
        lane=columns.get("lane", np.zeros(len(centre)))[inside],
        time_step_s=step_s,
        source=str(path),
        report=RepairReport(
            rows_read=rows_read,
            rows_used=int(inside.sum()),
            duplicates=duplicates,
            repeated=repeated,
            notes=notes,
        ),
    )
    return with_overlaps_reported(recording)


def is_table_header(fields: list[str]) -> bool:
    """Whether a file's first fields are those of a table of boxes, complete or not."""
    return len({field.strip().lower() for field in fields} & {"x_m", "y_m", "heading_deg", "length_m"}) > 1


def _columns(path: str | Path) -> dict[str, np.ndarray]:
    """The columns that are used, by name: classes as indices, the others as float64."""
    header, header_line = _header(path)
    wanted = [name for name in (*NEEDED, *OPTIONAL) if name in header]
    parts: dict[str, list[np.ndarray]] = {name: [] for name in wanted}
    for lines, fields in csv_columns(path, header, header_line):
        texts = dict(zip(header, fields, strict=True))
        for name in wanted:
            read = _class_indices if name == "class" else _numbers
            parts[name].append(read(path, name, texts[name], lines))
    if not parts["frame"]:
        raise InputError(f"{path}: no rows below the header in line {header_line}")
    return {name: np.concatenate(part) for name, part in parts.items()}


def _header(path: str | Path) -> tuple[list[str], int]:
    """The column names, in lower case, and the number of their line."""
    number, line = next(table_lines(path), (0, ""))
    if not line:
        raise InputError(f"{path}: no rows; a table of boxes is needed")
    header = [field.strip().lower() for field in fields_of(line)]
    missing = [name for name in NEEDED if name not in header]
    if missing:
        raise InputError(f"{path}:{number}: no column {', '.join(missing)}; needed: {', '.join(NEEDED)}")
    twice = [name for name in (*NEEDED, *OPTIONAL) if header.count(name) > 1]
    if twice:
        raise InputError(f"{path}:{number}: column {twice[0]} is there twice")
    return header, number


def _numbers(path: str | Path, name: str, texts: tuple[str, ...], lines: Sequence[int]) -> np.ndarray:
    try:
        values = np.array(texts, dtype=np.float64)
        good = _accepted(name, values)
        doubtful = "_" in "".join(texts)  # "1_0" is 10 to Python alone
    except ValueError:
        doubtful = True
    if doubtful:
        good = np.array([_is_accepted(name, text) for text in texts])
    if not good.all():
        at = int(good.argmin())
        text = texts[at] if len(texts[at]) <= _LONGEST_SHOWN else texts[at][:_LONGEST_SHOWN] + "..."
        raise InputError(f"{path}:{lines[at]}: {name} is {text!r}; allowed: {_allowed(name, texts[at])}")
    return values


def _allowed(name: str, text: str) -> str:
    if name in _WHOLE:
        return "a whole number of at least 0" if name in _NOT_NEGATIVE else "a whole number"
    try:
        value = math.nan if "_" in text else float(text)
    except ValueError:
        value = math.nan
    if name in _POSITIVE:
        return f"{_SIDE_LIMITS_M[0]:g} to {_SIDE_LIMITS_M[1]:g}" if 0 < value < math.inf else "more than 0"
    return f"{-_LARGEST[name]:g} to {_LARGEST[name]:g}" if math.isfinite(value) else "a finite number"


def _accepted(name: str, values: np.ndarray) -> np.ndarray:
    if name in _WHOLE:
        lowest = 0 if name in _NOT_NEGATIVE else -_WHOLE[name]
        return (values >= lowest) & (values <= _WHOLE[name]) & (np.rint(values) == values)
    low, high = _SIDE_LIMITS_M if name in _POSITIVE else (-_LARGEST[name], _LARGEST[name])
    return (values >= low) & (values <= high)


def _is_accepted(name: str, text: str) -> bool:
    try:
        return "_" not in text and bool(_accepted(name, np.array([float(text)]))[0])
    except ValueError:
        return False


def _class_indices(path: str | Path, name: str, texts: tuple[str, ...], lines: Sequence[int]) -> np.ndarray:
    distinct = {text: text.strip().lower() for text in set(texts)}
    if not set(distinct.values()) <= set(CLASSES):
        at = next(row for row, text in enumerate(texts) if distinct[text] not in CLASSES)
        raise unknown_name(texts[at], CLASSES, name, f"{path}:{lines[at]}")
    index = {text: CLASSES.index(known) for text, known in distinct.items()}
    return np.array([index[text] for text in texts], dtype=np.int8)


def _times(
    path: str | Path, columns: dict[str, np.ndarray], time_step_s: float | None
) -> tuple[np.ndarray, float, tuple[str, ...]]:
    """Time of every row [s], time per frame number [s], and what had to be assumed."""
    frame = columns["frame"]
    if time_step_s is not None:
        return frame * time_step_s, time_step_s, ()
    if "time_s" not in columns:
        note = f"neither a column time_s nor a time step was given: {_ASSUMED_TIME_STEP_S} s per frame is assumed"
        return frame * _ASSUMED_TIME_STEP_S, _ASSUMED_TIME_STEP_S, (note,)
    time_s = columns["time_s"]
    frames, first, of_row = np.unique(frame, return_index=True, return_inverse=True)
    at = time_s[first]
    astray = np.flatnonzero(np.abs(time_s - at[of_row]) > _SAME_TIME_S)
    if len(astray):
        raise InputError(f"{path}: frame {frame[astray[0]]:.0f} has more than one time_s")
    if len(frames) == 1:
        return time_s, _ASSUMED_TIME_STEP_S, ()
    late = np.diff(at) < _SAME_TIME_S
    if late.any():
        late = frames[1:][late][0]
        raise InputError(f"{path}: time_s of frame {late:.0f} is not later than that of the frame before")
    return time_s, float(np.median(np.diff(at) / np.diff(frames))), ()
