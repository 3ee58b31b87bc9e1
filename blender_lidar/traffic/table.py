"""A table of boxes: the plain CSV for traffic from anywhere else, read with numpy alone.

One row per vehicle and frame under a header; columns in any order, further ones ignored:

=========================  ==========================================================
``frame``                  whole number
``vehicle_id``             whole number, 0 or more, or a text; the same vehicle in every frame
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
Spreadsheets may have written it: with semicolons, tabs and decimal commas, as UTF-8, UTF-16 or Windows-1252.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from ..errors import InputError, unknown_name
from ..files import number
from .header import TableLayout, header_names, laid_out
from .source import Column, Rows, first_lines, quoted, read_rows, vehicle_ids, vehicle_numbers
from .tracks import drop_repeats
from .vehicles import CLASSES, Placing, Recording, RepairReport, ground_of

_LENGTHS = ("length_m", "width_m", "height_m")
OPTIONAL = ("z_m", "time_s", "lane")
_FAR = Column("a number, -1e9 to 1e9", -1e9, 1e9)  # sums and squares stay finite
BOX_COLUMNS = {
    "frame": Column("a whole number", whole=True),
    **dict.fromkeys(("x_m", "y_m", "z_m", "heading_deg"), _FAR),
    **dict.fromkeys(_LENGTHS, Column("more than 0, 0.001 to 1000", 1e-3, 1e3)),
    "time_s": Column("a number of seconds", -1e12, 1e12),
    "lane": Column("a whole number", 1 - 2**15, 2**15 - 1, whole=True),
}
BOX_NEEDED = ("frame", "vehicle_id", "class", "x_m", "y_m", *_LENGTHS, "heading_deg")
_WORDS = {
    "frame": {"frame"},
    "vehicle_id": {"id", "vehicle", "veh", "track"},
    "class": {"class", "type", "category", "kind"},
    "x_m": {"x"},
    "y_m": {"y"},
    "length_m": {"length", "len", "l"},
    "width_m": {"width", "w"},
    "height_m": {"height", "h"},
    "heading_deg": {"heading", "yaw", "angle", "orientation", "course"},
}
"""What a column may be called that is meant."""
_TIME_STEP_LIMITS_S = (1e-3, 1e6)
_SAME_TIME_S = 1e-6
_ASSUMED_TIME_STEP_S = 0.1


def read_table(
    path: str | Path | Mapping,
    *,
    origin_m: tuple[float, float] = (0.0, 0.0),
    heading_deg: float = 0.0,
    time_step_s: float | None = None,
) -> Recording:
    """Read a table of boxes.

    Parameters
    ----------
    path : path, or mapping of str to (n,) values
        The file, or the table itself: a DataFrame or a dictionary of its columns.
    origin_m : (float, float)
        The road frame's origin in the table's coordinates [m].
    heading_deg : float
        Direction of the road's x axis in the table's frame [degrees], counter-clockwise.
    time_step_s : float, optional
        Time between consecutive frame numbers [s], instead of a column ``time_s``; 0.1 s if there is neither.

    Raises
    ------
    MissingFileError, InputError
        If the file or one of its values cannot be used; the text names the line and the column.
    """
    table, path = path, path if isinstance(path, str | Path) else "boxes"
    placing = Placing(origin_m, heading_deg)
    low, high = _TIME_STEP_LIMITS_S
    if time_step_s is not None and not low <= time_step_s <= high:
        raise InputError(f"time_step_s is {time_step_s}; allowed: {low:g} to {high:g}")
    columns, numbering = _columns(table)
    rows_read = len(columns["frame"])
    values = np.column_stack([column for name, column in columns.items() if name not in ("frame", "vehicle_id")])
    kept, duplicates, repeated = drop_repeats(columns["vehicle_id"], columns["frame"], values)
    columns = {name: column[kept] for name, column in columns.items()}
    time_s, step_s, assumed = _times(path, columns, time_step_s)
    plane = placing.points(np.column_stack([columns["x_m"], columns["y_m"]]))
    return Recording.from_rows(
        frame=columns["frame"],
        time_s=time_s,
        vehicle_id=columns["vehicle_id"],
        class_index=columns["class"],
        centre_m=np.column_stack([plane, columns.get("z_m", columns["height_m"] / 2)]),
        size_m=np.column_stack([columns[name] for name in _LENGTHS]),
        heading_rad=placing.headings(np.radians(columns["heading_deg"])),
        lane=columns.get("lane", np.zeros(len(kept))),
        time_step_s=step_s,
        source=str(path),
        report=RepairReport(
            rows_read,
            len(kept),
            duplicates=duplicates,
            repeated=repeated,
            notes=tuple(numbering),
            assumed=assumed,
            ground=ground_of(plane, columns.get("z_m", columns["height_m"] / 2) - columns["height_m"] / 2),
        ),
    )


def likeness(header: str) -> int:
    """How many of the needed columns a header has, or has something like."""
    return len(_nearest_names(BOX_NEEDED, header_names(header, (*BOX_NEEDED, *OPTIONAL))[0]))


def _nearest_names(wanted: Iterable[str], present: Iterable[str]) -> dict[str, str]:
    """Which of the `present` names of columns may be meant by those that are `wanted`, each for one at most.

    One is if it has one of the `_WORDS` for a name in it, or is spelt much alike.
    """
    left, found = [name for name in present if name], {}
    for name in wanted:
        of_words = (one for one in left if _WORDS.get(name, set()) & set(re.split(r"[\W_]+", one.lower())))
        near = next(of_words, None) or next(iter(difflib.get_close_matches(name, left, 1, 0.75)), None)
        if near is not None:
            found[name] = near
            left.remove(near)
    return found


def _chunks(table: str | Path | Mapping) -> Iterable[Rows]:
    """The rows of a file, chunk by chunk, or of a table in memory, after its columns were checked."""
    if isinstance(table, str | Path):
        layout = laid_out(table, BOX_NEEDED, OPTIONAL, _nearest_names)
        return read_rows(table, layout, BOX_COLUMNS, ["class", "vehicle_id"])
    TableLayout(list(map(str, table)), None, 0).check(BOX_NEEDED, OPTIONAL, "boxes", _nearest_names)
    columns = {name: np.asarray(table[name]) for name in (*BOX_NEEDED, *OPTIONAL) if name in table}
    if len({column.shape for column in columns.values()}) > 1 or columns["frame"].ndim != 1:
        shapes = ", ".join(f"{name} {column.shape}" for name, column in columns.items())
        raise InputError(f"boxes: columns have shapes {shapes}; allowed: (n,), all of one length")
    for name, column in columns.items():
        if name == "vehicle_id" or column.dtype.kind not in "iuf":
            columns[name] = np.array([str(value) for value in column.tolist()], dtype=object)
    rows = Rows(columns, range(1, 1 + len(columns["frame"])), "boxes: row ")
    return [rows] if len(rows) else []


def _columns(table: str | Path | Mapping) -> tuple[dict[str, np.ndarray], list[str]]:
    """The columns that are used, by name, classes as indices, the others as numbers; and a note if ids are texts."""
    parts, ids, path = [], {}, table if isinstance(table, str | Path) else "boxes"
    for rows in _chunks(table):
        part = {name: rows.numbers(name, BOX_COLUMNS[name]) for name in rows.columns if name in BOX_COLUMNS}
        parts.append(part | {"vehicle_id": vehicle_ids(rows, "vehicle_id", ids), "class": _class_indices(rows)})
    if not parts:
        below = "" if table is not path else f" below the header in line {first_lines(path)[0][0]}"
        raise InputError(f"{path}: no rows{below}")
    for name in ids:
        if not np.isnan(number(name)) and not (number(name) >= 0 and number(name) % 1 == 0):  # -1: no vehicle
            raise InputError(f"{path}: vehicle_id is {quoted(name)}; allowed: a whole number of at least 0, or a text")
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    vehicle, notes = vehicle_numbers(list(ids))
    return columns | {"vehicle_id": vehicle[columns["vehicle_id"]]}, notes


def _class_indices(rows: Rows) -> np.ndarray:
    index = {name: number for number, name in enumerate(CLASSES)}
    texts = map(str, rows.columns["class"].tolist())
    found = np.array([index.get(text.strip().lower(), -1) for text in texts], dtype=np.int8)
    if (found < 0).any():
        row = int(found.argmin())
        raise unknown_name(rows.columns["class"][row], CLASSES, "class", rows.where(row))
    return found


def _times(
    path: str | Path, columns: dict[str, np.ndarray], time_step_s: float | None
) -> tuple[np.ndarray, float, tuple[str, ...]]:
    """Time of every row [s], time per frame number [s], and what had to be assumed."""
    frame = columns["frame"]
    if time_step_s is not None:
        return frame * time_step_s, time_step_s, ()
    if "time_s" not in columns:
        assumed = f"Time: {_ASSUMED_TIME_STEP_S} s from frame to frame, as there is neither time_s nor time_step_s"
        return frame * _ASSUMED_TIME_STEP_S, _ASSUMED_TIME_STEP_S, (assumed,)
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
