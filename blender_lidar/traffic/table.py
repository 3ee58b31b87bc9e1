"""A table of boxes: the plain CSV for traffic from anywhere else, read with numpy alone.

One row per vehicle and frame under a header; columns in any order, further ones ignored:

=========================  ====================================================================
``vehicle_id``             whole number, 0 or more, or a text; the same vehicle in every frame
``x_m``, ``y_m``           box centre [m]
``frame``                  whole number; from ``time_s`` if left out
``time_s``                 time of the frame [s]; from ``frame`` if left out
``class``                  car, van, truck, bus, motorcycle, bicycle or pedestrian, or a word for one; by length
                           if left out
``length_m``, ``width_m``  box size [m], more than 0; by class if left out
``height_m``               box height [m], more than 0; by class if left out
``heading_deg``            counter-clockwise from the table's x axis; that of motion if left out
``z_m`` (optional)         box centre above the road [m]; half the height if left out
``lane`` (optional)        whole number
=========================  ====================================================================

Frame or time, and class or size, must be there. A bicycle or pedestrian without length or width has its class's; what
is on no road, such as a container, is left out and counted.

``vehicles.csv`` of a run is such a table, and so is what ``init`` writes of a recording in Parquet. It
may be packed with gzip, and begin with lines that start with ``#``. Spreadsheets may have written it: with semicolons,
tabs and decimal commas, as UTF-8, UTF-16 or Windows-1252.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..csv_header import TableLayout, first_lines, header_names, nearest_names, quoted
from ..csv_tables import Column, Rows, read_whole
from ..errors import InputError, unknown_name
from ..files import number, open_bytes, write_columns
from ..rigid import Rigid
from .sumo import frames_of
from .sumo_types import DEFAULT_TYPES, class_in_name
from .tracks import SLOWEST_M_S, drop_repeats, fitted_velocity, heights, held_heading, vehicle_ids, vehicle_numbers
from .vehicles import CLASSES, DIMENSIONS, PEDESTRIAN, Recording, RepairReport, ground_sample

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
_SIDES = ("length_m", "width_m")
_SIDE = BOX_COLUMNS["length_m"]
# A heading that is not known is that of motion; a size, which bicycles and pedestrians may lack, is the class's.
READ_COLUMNS = BOX_COLUMNS | dict.fromkeys(_LENGTHS, _SIDE._replace(low=0.0, optional=True))
READ_COLUMNS |= {"heading_deg": _FAR._replace(optional=True)}
_SIZES_M = {"car": (4.5, 1.8), "van": (5.2, 2.0), "truck": (8.0, 2.5), "bus": (12.0, 2.55), "motorcycle": (2.2, 0.8)}
# KITTI's mean with the rider; of who walks its width, and a short step: its mean length, 0.8 m, is a whole stride.
_SIZES_M |= {"bicycle": (1.76, 0.6), "pedestrian": (0.5, 0.6)}
_TRUCK_FROM_M = 7.0
_SLOWEST_WALK_M_S = 0.5
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
    "heading_deg": {"heading", "yaw", "angle", "orientation", "course", "psi"},
}
"""What a column may be called that is meant."""
_TIME_STEP_LIMITS_S = (1e-3, 1e6)
_SAME_TIME_S = 1e-6
_ASSUMED_TIME_STEP_S = 0.1
_LONGEST_REPORT = 2**17


def read_table(
    path: str | Path | Mapping,
    *,
    origin_m: tuple[float, float] = (0.0, 0.0),
    heading_deg: float = 0.0,
    time_step_s: float | None = None,
    height_m: Mapping[str, float] | None = None,
    source: str | None = None,
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
    height_m : mapping, optional
        Heights [m] by the keys of `vehicles.HEIGHTS_M`, for a table that has none.
    source : str, optional
        What a table in memory was read from.

    Raises
    ------
    MissingFileError, InputError
        If the file or one of its values cannot be used; the text names the line and the column.
    """
    table, path = path, path if isinstance(path, str | Path) else source or "boxes"
    T_site_file = Rigid.about_z(math.radians(heading_deg), origin_m).inverse
    low, high = _TIME_STEP_LIMITS_S
    if time_step_s is not None and not low <= time_step_s <= high:
        raise InputError(f"time_step_s is {time_step_s}; allowed: {low:g} to {high:g}")
    columns, left_out, notes = _columns(table)
    rows_read, assumed = len(columns["x_m"]) + left_out, []
    if "frame" not in columns:
        columns["frame"], _, uneven = frames_of(np.rint(1000.0 * columns["time_s"]).astype(np.int64))
        notes += uneven
    if "class" not in columns:
        columns["class"] = np.where(columns["length_m"] >= _TRUCK_FROM_M, CLASSES.index("truck"), 0).astype(np.int8)
        assumed.append(f"Class: truck from {_TRUCK_FROM_M:g} m of length on, else car, as the table has none")
    sized, assumed_sizes = _size_by_class(columns), ()
    if sized is not None:
        assumed_sizes = DIMENSIONS[:2]
        assumed.append("Sizes: by class, " + ("as the table has none" if sized.all() else "where the table has none"))
    if "height_m" not in columns:
        columns["height_m"] = heights(columns["class"], columns["length_m"], height_m)
        assumed.append("Heights: by class, as the table has none")
        assumed_sizes += DIMENSIONS[2:]
    else:
        if height_m:
            raise InputError(f"{path}: [traffic] height_m is for traffic without heights, and the table has height_m")
        usual = heights(columns["class"], columns["length_m"], None)
        columns["height_m"] = np.where(columns["height_m"] > 0.0, columns["height_m"], usual)
    others = [columns[name] for name in columns if name not in ("frame", "vehicle_id")]
    values = np.nan_to_num(np.column_stack(others), nan=np.inf)
    kept, duplicates, repeated = drop_repeats(columns["vehicle_id"], columns["frame"], values)
    columns = {name: column[kept] for name, column in columns.items()}
    time_s, step_s, of_time = _times(path, columns, time_step_s)
    plane = T_site_file.points(np.column_stack([columns["x_m"], columns["y_m"]]))
    heading, held = _headings(columns, time_s, plane, T_site_file)
    if held is not None and len(np.unique(columns["frame"])) == 1:
        raise InputError(f"{path}: has no heading_deg, and one frame shows no motion to take it from")
    if held is not None:
        assumed.append("Headings: those of motion, as the table has none")
    report = RepairReport(
        rows_read,
        len(kept),
        duplicates=duplicates,
        repeated=repeated,
        left_out=left_out,
        headings_held=0 if held is None else int(held.sum()),
        notes=tuple(notes),
        assumed=(*of_time, *assumed),
        assumed_sizes=assumed_sizes,
        ground=ground_sample(plane, columns.get("z_m", columns["height_m"] / 2) - columns["height_m"] / 2),
    )
    return Recording.from_rows(
        frame=columns["frame"],
        time_s=time_s,
        vehicle_id=columns["vehicle_id"],
        class_index=columns["class"],
        centre_m=np.column_stack([plane, columns.get("z_m", columns["height_m"] / 2)]),
        size_m=np.column_stack([columns[name] for name in _LENGTHS]),
        heading_rad=heading,
        lane=columns.get("lane", np.zeros(len(kept))),
        time_step_s=step_s,
        source=str(path),
        report=replace(report, **_told(path)) if table is path else report,
    )


_REPORT = "# read before: "
_TOLD = ("rows_read", "duplicates", "repeated", "off_map", "left_out", "types_unknown", "sizes_repaired")
_TOLD += ("headings_held", "headings_clamped", "notes", "assumed", "assumed_sizes")


def write_table(path: str | Path, recording: Recording) -> None:
    """Write a recording as a table of boxes: reading it gives the same boxes, and the same report of what was assumed.

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    columns = recording.table() | {"time_s": recording.time_s, "lane": recording.lane}
    told = {name: getattr(recording.report, name) for name in _TOLD}
    write_columns(path, columns, head=f"{_REPORT}{json.dumps(told)}\n")


def _told(path: str | Path) -> dict[str, object]:
    """What the first line of a table says of the recording that it was made of."""
    with open_bytes(path) as stream:
        line = stream.readline(_LONGEST_REPORT)
    if not line.startswith(_REPORT.encode()):
        return {}
    try:
        told = json.loads(line[len(_REPORT) :])
        return {name: tuple(map(str, told[name])) if name in _TOLD[-3:] else int(told[name]) for name in _TOLD}
    except (ValueError, TypeError, LookupError) as error:
        raise InputError(f"{path}:1: is damaged; leave the line out ({error})") from error


def _size_by_class(columns: dict[str, np.ndarray]) -> np.ndarray | None:
    """Give boxes without length or width their class's, and say which, (n,) bool; None where all have their own."""
    missing = np.ones(len(columns["x_m"]), dtype=bool)
    if all(name in columns for name in _SIDES):
        missing = ~(np.column_stack([columns[name] for name in _SIDES]) > 0.0).all(axis=1)
    if not missing.any():
        return None
    sizes = np.array([_SIZES_M[name] for name in CLASSES])[columns["class"]]
    for side, name in enumerate(_SIDES):
        columns[name] = np.where(missing, sizes[:, side], columns.get(name, np.nan))
    return missing


def _headings(
    columns: dict[str, np.ndarray], time_s: np.ndarray, plane: np.ndarray, T_site_file: Rigid
) -> tuple[np.ndarray, np.ndarray | None]:
    """Headings in the road frame [rad], and where those of motion are held; None where the table has them."""
    given = columns.get("heading_deg", np.full(len(plane), np.nan))
    heading, missing = T_site_file.headings(np.radians(given)), np.isnan(given)
    if not missing.any():
        return heading, None
    velocity = fitted_velocity(columns["vehicle_id"], time_s, plane)
    slowest = np.where(columns["class"] == PEDESTRIAN, _SLOWEST_WALK_M_S, SLOWEST_M_S)
    motion, held = held_heading(columns["vehicle_id"], velocity, slowest_m_s=slowest)
    return np.where(missing, motion, heading), held & missing


def likeness(header: str) -> int:
    """How many columns of a table a header has, or has something like."""
    names = header_names(header, (*BOX_NEEDED, *OPTIONAL))[0]
    return len(nearest_names(BOX_NEEDED, names, _WORDS)) + ("time_s" in names)


def _needed(present: Sequence[str]) -> list[str]:
    """The columns that cannot be inferred from those that are there, or have a name there that is nearly right."""
    needed = {"vehicle_id", "x_m", "y_m", *([] if "time_s" in present else ["frame"])}
    needed |= set() if {"length_m", "width_m"} <= {*present} else {"class"}
    missing = [name for name in BOX_NEEDED if name not in present]
    near = nearest_names(missing, [name for name in present if name not in (*BOX_NEEDED, *OPTIONAL)], _WORDS)
    return [name for name in BOX_NEEDED if name in needed or name in near]


def _rows(table: str | Path | Mapping) -> Rows:
    """The rows of a file or of a table in memory, its columns checked; classes and ids are texts."""
    if isinstance(table, str | Path):
        line, header = first_lines(table)[0]
        layout = TableLayout(*header_names(header, (*BOX_NEEDED, *OPTIONAL)), line + 1)
        layout.check(_needed(layout.columns), (*BOX_NEEDED, *OPTIONAL), table, _WORDS)
        return read_whole(table, layout, READ_COLUMNS, ["class", "vehicle_id"])
    names = list(map(str, table))
    TableLayout(names, None, 0).check(_needed(names), (*BOX_NEEDED, *OPTIONAL), "boxes", _WORDS)
    columns = {name: np.asarray(table[name]) for name in (*BOX_NEEDED, *OPTIONAL) if name in table}
    if len({column.shape for column in columns.values()}) > 1 or columns["x_m"].ndim != 1:
        shapes = ", ".join(f"{name} {column.shape}" for name, column in columns.items())
        raise InputError(f"boxes: columns have shapes {shapes}; allowed: (n,), all of one length")
    for name, column in columns.items():
        if name == "vehicle_id" or column.dtype.kind not in "iuf":
            columns[name] = np.array([str(value) for value in column.tolist()], dtype=object)
    return Rows(columns, range(1, 1 + len(columns["x_m"])), "boxes: row ").checked(READ_COLUMNS)


def _columns(table: str | Path | Mapping) -> tuple[dict[str, np.ndarray], int, list[str]]:
    """The columns that are used, by name, classes as indices, the others as numbers; rows left out; notes on ids."""
    rows, ids, path = _rows(table), {}, table if isinstance(table, str | Path) else "boxes"
    kind, rows_read = _class_indices(rows), len(rows)
    if kind is not None:
        rows, kind = rows.select(kind != _ON_NO_ROAD), kind[kind != _ON_NO_ROAD]
        if (kind < 0).any():
            row = int(kind.argmin())
            raise unknown_name(rows.columns["class"][row], CLASSES, "class", rows.where(row))
    if not len(rows):
        below = "" if table is not path else f" below the header in line {first_lines(path)[0][0]}"
        raise InputError(f"{path}: no vehicle in {rows_read:,} rows" if rows_read else f"{path}: no rows{below}")
    _check_sizes(rows, kind)
    vehicle = vehicle_ids(rows, "vehicle_id", ids)
    for name in ids:
        if not np.isnan(number(name)) and not (number(name) >= 0 and number(name) % 1 == 0):  # -1: no vehicle
            raise InputError(f"{path}: vehicle_id is {quoted(name)}; allowed: a whole number of at least 0, or a text")
    numbers, notes = vehicle_numbers(list(ids))
    columns = {**rows.columns, "vehicle_id": numbers[vehicle]} | ({} if kind is None else {"class": kind})
    return columns, rows_read - len(rows), notes


def _check_sizes(rows: Rows, kind: np.ndarray | None) -> None:
    """Refuse a size that is none; bicycles and pedestrians may have none at all."""
    may_lack = np.zeros(len(rows), dtype=bool) if kind is None else np.isin(kind, _MAY_LACK_SIZE)
    for name in _LENGTHS:
        sizes = rows.columns.get(name, np.ones(len(rows)))
        wrong = np.flatnonzero(~(sizes >= _SIDE.low) & ~(may_lack & ~(sizes > 0.0)))
        if len(wrong):
            seen = "nothing" if np.isnan(sizes[wrong[0]]) else f"{sizes[wrong[0]]:.15g}"
            raise InputError(f"{rows.where(wrong[0])}: {name} is {seen}; allowed: {_SIDE.allowed}")


_MAY_LACK_SIZE = CLASSES.index("bicycle"), PEDESTRIAN
_ON_NO_ROAD = -2
_ALSO = {"truck_bus": "truck", "large-vehicle": "truck", "small-vehicle": "passenger"}  # in inD, in TGSIM


def _class_indices(rows: Rows) -> np.ndarray | None:
    """Indices into `CLASSES`, `_ON_NO_ROAD` for containers and such, -1 if unknown; None without a column."""
    if "class" not in rows.columns:
        return None
    texts = list(map(str, rows.columns["class"].tolist()))
    index = {text: _class_index(text) for text in set(texts)}
    return np.array([index[text] for text in texts], dtype=np.int8)


def _class_index(text: str) -> int:
    """Of one class, or of a word for it; -1 for no known one."""
    name = text.strip().lower()
    if name in CLASSES:
        return CLASSES.index(name)
    if "pedestrian" in name:  # also in "pedestrian/bicycle", INTERACTION's class of both
        return PEDESTRIAN
    kind = DEFAULT_TYPES.get(_ALSO.get(name) or class_in_name(text) or "")
    return -1 if kind is None else _ON_NO_ROAD if kind.class_name is None else CLASSES.index(kind.class_name)


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
