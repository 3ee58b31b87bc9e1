"""Reading NGSIM trajectories: dialects, periods, locations and known defects, to boxes in the road frame.

US DOT FHWA, Next Generation Simulation Vehicle Trajectories and Supporting Data, DOI 10.21949/1504477.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..csv_header import TableLayout, fields_of, first_lines, header_names, laid_out
from ..csv_tables import EMPTY, Column, Rows, read_rows
from ..errors import InputError, unknown_name
from ..files import number
from ..road import RoadSettings
from .tracks import (
    WINDOW_S,
    class_index,
    drop_repeats,
    fitted_velocity,
    heights,
    held_heading,
    lane_changing,
    limited,
    repaired_sizes,
)
from .vehicles import DIMENSIONS, Recording, RepairReport

FOOT_M = 0.3048
"""International foot, exactly; 0.3084 circulates."""
FREEWAYS = ("i-80", "us-101")
_OFF_MAP_M = 2000.0
"""No section is longer than 700 m."""


def read_ngsim(
    path: str | Path,
    *,
    road: RoadSettings,
    period: int | str | None = None,
    location: str | None = None,
    height_m: Mapping[str, float] | None = None,
) -> Recording:
    """Read one period of one location of an NGSIM recording.

    The file may be the native text of 18 or 24 columns, the portal's CSV, its API's, or any table with a header that
    has their columns; plain or gzip.

    Parameters
    ----------
    path : path
    road : RoadSettings
        Where the road frame lies in the recording's local coordinates.
    period : int or str, optional
        Number, from 1, or name such as ``"0400-0415"``; the first if left out, and the report says so. Periods are
        never merged: they number different vehicles alike.
    location : str, optional
        Which site of a file that mixes several, such as ``"i-80"``.
    height_m : mapping, optional
        Heights [m] that replace those of `vehicles.HEIGHTS_M`, by its keys.

    Returns
    -------
    Recording
        Times count from frame number 0. On freeways headings lie within 6 degrees of the road, 15 during lane
        changes; at sites with intersections they are free.

    Raises
    ------
    MissingFileError, InputError
        If the file or one of its values cannot be used; the text names the line and the column.
    """
    layout = sniff_layout(path)
    rows, report = read_location(path, layout, location)
    step_ms = _time_step_ms(rows, path)
    periods, of_row = _periods(rows, step_ms)
    chosen = _chosen(periods, period, path)
    # Local_Y follows the direction of travel everywhere on freeways, not where there are intersections.
    arterial = "Int_ID" in layout.columns and "Location" not in layout.columns
    follows_road = report.location in FREEWAYS if report.location else not arterial
    notes = []
    if location is not None and "Location" not in layout.columns:
        notes.append(f"the file has no Location column: taken to be {location}")
    if period is None and len(periods) > 1:
        notes.append(f"{len(periods)} periods found ({', '.join(periods)}); none was chosen, so the first is used")
    in_period = of_row == chosen
    on_map = (np.abs(rows["local_m"]) <= _OFF_MAP_M).all(axis=1)
    rows = _taken(rows, in_period & on_map)
    content = np.column_stack([rows[name] for name in ("time_ms", "local_m", "size_m", "v_class", "lane")])
    kept, duplicates, repeated = drop_repeats(rows["vehicle_id"], rows["frame"], content)
    if not len(kept):
        raise InputError(f"{path}: no vehicles left; every row is more than {_OFF_MAP_M:.0f} m off the section")
    report = replace(
        report,
        period=periods[chosen],
        periods=periods,
        duplicates=duplicates,
        repeated=repeated,
        off_map=int((in_period & ~on_map).sum()),
        notes=tuple(notes),
    )
    return _boxes(_taken(rows, kept), step_ms / 1000, road, follows_road, height_m, str(path), report)


def _taken(rows: dict[str, np.ndarray], which: np.ndarray) -> dict[str, np.ndarray]:
    return {name: column[which] for name, column in rows.items()}


def _boxes(
    rows: dict[str, np.ndarray],
    time_step_s: float,
    road: RoadSettings,
    follows_road: bool,
    height_m: Mapping[str, float] | None,
    source: str,
    report: RepairReport,
) -> Recording:
    """Rows of one period, sorted by (vehicle, frame) without repeats, as boxes in the road frame."""
    vehicle, frame, lane, v_class = (rows[name] for name in ("vehicle_id", "frame", "lane", "v_class"))
    time_s = frame * time_step_s
    front = road.T_site_ngsim.points(rows["local_m"])
    since_s = np.diff(time_s, prepend=time_s[0])
    track = np.cumsum((np.diff(vehicle, prepend=vehicle[0]) != 0) | (since_s > WINDOW_S))  # short ones sum exactly
    motion, held = held_heading(vehicle, fitted_velocity(track, time_s, front))
    heading = limited(motion, lane_changing(vehicle, time_s, lane)) if follows_road else motion
    size, resized = repaired_sizes(v_class, rows["size_m"])
    length = size[:, 0]
    index = class_index(v_class, length)
    height = heights(index, length, height_m)
    forward = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    # NGSIM records the front centre.
    centre = np.column_stack([front - length[:, None] / 2 * forward, height / 2])
    return Recording.from_rows(
        frame=frame,
        time_s=time_s,
        vehicle_id=vehicle,
        class_index=index,
        centre_m=centre,
        size_m=np.column_stack([size, height]),
        heading_rad=heading,
        lane=lane,
        time_step_s=time_step_s,
        source=source,
        report=replace(
            report,
            rows_used=len(frame),
            sizes_repaired=len(np.unique(vehicle[resized])),
            assumed_sizes=DIMENSIONS[2:],
            headings_held=int(held.sum()),
            headings_clamped=int((heading != motion).sum()),
        ),
    )


# --- Which of NGSIM's dialects a file speaks: native text, the portal's CSV or its API's ------------------

_SIZE = Column("feet, at least 0", low=0.0, optional=True)
NGSIM_COLUMNS = {
    "Vehicle_ID": Column("a whole number of at least 0", low=0, whole=True),
    "Frame_ID": Column("a whole number", whole=True),
    "Global_Time": Column("milliseconds"),
    "Local_X": Column("feet"),
    "Local_Y": Column("feet"),
    "v_Length": _SIZE,
    "v_Width": _SIZE,
    "v_Class": Column("1 (motorcycle), 2 (auto) or 3 (truck)", 1, 3, whole=True),
    "Lane_ID": Column("a whole number", 1 - 2**15, 2**15 - 1, whole=True, optional=True),
}
"""The columns of numbers that are needed, in NGSIM's spelling; files may have them in any letter case."""
_OPTIONAL = ("Location", "Int_ID")
_FIRST_14 = [
    *("Vehicle_ID", "Frame_ID", "total_frames", "Global_Time", "Local_X", "Local_Y", "global_x", "global_y"),
    *("v_Length", "v_Width", "v_Class", "v_vel", "v_acc", "Lane_ID"),
]
_LAST_4 = ["preceding", "following", "space_headway", "time_headway"]
_ARTERIAL = ["o_zone", "d_zone", "Int_ID", "section_id", "Direction", "Movement"]
# The six columns of arterials come after column 14 (the data dictionaries of Lankershim and Peachtree).
_WITHOUT_HEADER = {
    18: [*_FIRST_14, *_LAST_4],
    24: [*_FIRST_14, *_ARTERIAL, *_LAST_4],
    25: [*_FIRST_14, *_ARTERIAL, *_LAST_4, "Location"],
}


def _divided(line: str) -> tuple[str | None, list[str]]:
    """What divides the fields of the first line, None being white space, and those fields."""
    delimiter = max(";", ",", key=line.count) if {";", ","} & set(line) else None
    words = line.split()
    if _is_row(words) and len(words) in _WITHOUT_HEADER and all(word == word.strip(",;") for word in words):
        delimiter = None  # where commas are decimal
    return delimiter, fields_of(line, delimiter)


def _is_row(fields: Sequence[str]) -> bool:
    """Whether a first line is a row of numbers already."""
    return bool(fields) and not np.isnan(number(fields[0].replace(",", "")))


def likeness(line: str) -> float:
    """How many of the needed columns a header has; endless for a row without a header, as only NGSIM has."""
    if _is_row(_divided(line)[1]):
        return np.inf
    return len(set(header_names(line, NGSIM_COLUMNS)[0]) & set(NGSIM_COLUMNS))


def sniff_layout(path: str | Path) -> TableLayout:
    """Find the dialect of a file of NGSIM trajectories; lines before the table that are blank or comments are skipped.

    Raises
    ------
    MissingFileError
        If there is no such file.
    InputError
        If the file is empty, is not text, has a header without one of the needed columns, or has no header and
        neither 18, 24 nor 25 columns.
    """
    lines = first_lines(path)
    line, text = lines[0]
    delimiter, fields = _divided(text)
    if _is_row(fields):
        trailing = [""] if fields[-1] == "" else []  # a delimiter at the line's end
        columns = _WITHOUT_HEADER.get(len(fields) - len(trailing))
        if columns is None:
            allowed = "NGSIM rows have 18 or 24, the portal's 25; other traffic needs a first line of column names"
            raise InputError(f"{path}:{line}: {len(fields)} fields; {allowed}")
        return TableLayout((*columns, *trailing), delimiter, line)
    layout = laid_out(path, NGSIM_COLUMNS, _OPTIONAL)
    if len(lines) < 2 and line:
        raise InputError(f"{path}: no rows below the header in line {line}")
    return layout


# --- Reading NGSIM rows, by the million and from files that mix all sites ---------------------------------


def read_location(
    path: str | Path, layout: TableLayout, location: str | None
) -> tuple[dict[str, np.ndarray], RepairReport]:
    """Read the rows of one location in the file's order, converted from feet to metres.

    Parameters
    ----------
    path : path
    layout : TableLayout
        How the file is written.
    location : str, optional
        Which one of a file that mixes several, in any letter case. A file without that column is taken whole.

    Returns
    -------
    rows : dict of str to ndarray, (n,) or (n, 2)
        vehicle_id, frame, time_ms, local_m (Local_X and Local_Y of the front centre), size_m (length and width; 0 where
        missing), v_class, lane.
    report : RepairReport
        Rows read and locations.

    Raises
    ------
    InputError
        If a row has too few or too many fields, or a value that cannot be used; if the location is not there, or none
        is chosen and there are several; if there are no or too many rows.
    """
    wanted = location.strip().lower() if location is not None and "Location" in layout.columns else None
    seen: set[str] = set()
    parts: list[dict[str, np.ndarray]] = []
    rows_read = 0
    for rows in read_rows(path, layout, NGSIM_COLUMNS, ["Location"]):
        rows_read += len(rows)
        if "Location" in rows.columns:
            texts = rows.columns["Location"].tolist()
            names = {text: "" if text in EMPTY else text.strip().lower() for text in set(texts)}
            seen.update(names.values())
            if wanted is None and len(seen) > 1:
                parts.clear()  # only their names matter now, for the message
                continue
            if wanted is not None:
                rows = rows.select(np.array([names[text] == wanted for text in texts]))
        parts.append(_metric(rows))
    locations = tuple(sorted(seen))
    if wanted is None and len(locations) > 1:
        raise InputError(f"{path}: holds {len(locations)} locations; choose one of: {', '.join(locations)}")
    if wanted is not None and wanted not in seen:
        raise unknown_name(location, locations, "location", str(path))
    found = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    report = RepairReport(rows_read, location="".join(locations) if wanted is None else wanted, locations=locations)
    return found, report


def _metric(rows: Rows) -> dict[str, np.ndarray]:
    """The columns that are used, in metres."""
    values = {name: rows.numbers(name, column) for name, column in NGSIM_COLUMNS.items()}
    return {
        "vehicle_id": values["Vehicle_ID"].astype(np.int64),
        "frame": values["Frame_ID"].astype(np.int64),
        "time_ms": values["Global_Time"],
        "local_m": np.stack([values["Local_X"], values["Local_Y"]], axis=1) * FOOT_M,
        "size_m": np.nan_to_num(np.stack([values["v_Length"], values["v_Width"]], axis=1)) * FOOT_M,
        "v_class": values["v_Class"].astype(np.int8),
        "lane": np.nan_to_num(values["Lane_ID"]).astype(np.int16),
    }


# --- The recording periods of an NGSIM file, each of which numbers vehicles and frames from 1 again -------
# Two of I-80's three even overlap in time, so that a row belongs to the period whose clock its frame number fits:
# ``Global_Time - step * Frame_ID`` is constant within one.

_SAME_PERIOD_S = 60.0
_STEP_LIMITS_MS = (10.0, 60_000.0)
_USUAL_STEP_MS = 100.0
# Nominal starts in Pacific Daylight Time, by a clock of twelve hours from six in the morning on; recording began up to
# 2 min 15 s earlier.
_PACIFIC_H = -7
_NOMINAL = ["0400-0415", "0500-0515", "0515-0530", "0750-0805", "0805-0820", "0820-0835", "0828-0845", "0845-0900"]
_NOMINAL_S = {name: 3600 * ((int(name[:2]) + 6) % 12 + 6) + 60 * int(name[2:4]) for name in _NOMINAL}
_NOMINAL_TOLERANCE_S = 180
_FIRST_REAL_TIME_MS = 1e12  # Peachtree's 10-digit times are no times of day


def _time_step_ms(rows: dict[str, np.ndarray], path: str | Path) -> float:
    """Milliseconds per frame number: the median over neighbouring rows of each vehicle; 100 if none has two."""
    vehicle, frame, time_ms = rows["vehicle_id"], rows["frame"], rows["time_ms"]
    order = np.lexsort((time_ms, vehicle))
    frames = np.diff(frame[order])
    usable = (np.diff(vehicle[order]) == 0) & (frames != 0)
    step = float(np.median(np.diff(time_ms[order])[usable] / frames[usable])) if usable.any() else _USUAL_STEP_MS
    if step <= 0:
        return _USUAL_STEP_MS
    low, high = _STEP_LIMITS_MS
    if not low <= step <= high:
        raise InputError(
            f"{path}: Global_Time grows by {step:g} ms from one Frame_ID to the next; allowed: {low:g} to {high:g}"
        )
    return step


def _periods(rows: dict[str, np.ndarray], step_ms: float) -> tuple[tuple[str, ...], np.ndarray]:
    """The periods in order of time, rows whose clocks agree within `_SAME_PERIOD_S`, and each row's, (n,), from 0.

    They are called as the recording calls them (``"0400-0415"``), else by their number, from ``"1"``.
    """
    origin_s = np.rint((rows["time_ms"] - step_ms * rows["frame"]) / 1000.0)
    distinct, of_row = np.unique(origin_s, return_inverse=True)
    starts = np.append(True, np.diff(distinct) > _SAME_PERIOD_S)
    names = [_nominal(origin) for origin in distinct[starts]]
    called = [name if name and names.count(name) == 1 else str(place) for place, name in enumerate(names, start=1)]
    return tuple(called), (np.cumsum(starts) - 1)[of_row.reshape(-1)]


def _nominal(origin_s: float) -> str | None:
    """The name of the period that begins at a time [s since 1970], if it is a known one."""
    if origin_s * 1000 < _FIRST_REAL_TIME_MS:
        return None
    of_day = (origin_s + _PACIFIC_H * 3600) % 86400
    name = min(_NOMINAL_S, key=lambda known: abs(_NOMINAL_S[known] - of_day))
    return name if abs(_NOMINAL_S[name] - of_day) <= _NOMINAL_TOLERANCE_S else None


def _chosen(periods: tuple[str, ...], period: int | str | None, path: str | Path) -> int:
    """The number, from 0, of the period asked for by number (from 1) or name; the first if none is."""
    if period is None:
        return 0
    asked = str(period).strip().replace(":", "")
    if asked in periods:
        return periods.index(asked)
    if asked.isdecimal() and 1 <= int(asked) <= len(periods):
        return int(asked) - 1
    known = (f"{place}" if name == str(place) else f"{place} ({name})" for place, name in enumerate(periods, 1))
    raise InputError(f"{path}: no period {period!r}; the recording has: {', '.join(known)}")
