"""NGSIM trajectories to boxes in the road frame, with the defects of the recordings handled on the way.

US DOT FHWA, Next Generation Simulation Vehicle Trajectories and Supporting Data, DOI 10.21949/1504477.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import InputError
from .headings import fitted_velocity, held_heading, lane_changing, limited
from .ngsim_layout import Layout, sniff_layout
from .ngsim_periods import choose_period, find_periods, time_step_ms
from .ngsim_rows import FileRows, read_rows
from .overlaps import with_overlaps_reported
from .report import RepairReport
from .road import RoadFrame, within_x
from .sizes import checked_heights, class_index, heights, repaired_sizes
from .tracks import TrackRows, drop_repeats, fill_gaps, segments
from .vehicles import Recording

FREEWAYS = ("i-80", "us-101")
_BOUND_FOR_RAD = np.radians([0.0, -90.0, 0.0, 90.0, 180.0])
"""Headings by Direction: unknown, east, north, west, south. Local_Y, the road frame's x, runs north on arterials."""
_OFF_MAP_M = 2000.0
"""No section is longer than 700 m."""


def read_ngsim(
    path: str | Path,
    *,
    road: RoadFrame,
    period: int | str | None = None,
    location: str | None = None,
    height_m: Mapping[str, float] | None = None,
    x_range_m: tuple[float, float] | None = None,
) -> Recording:
    """Read one period of one location of an NGSIM recording.

    The file may be the native text of 18 or 24 columns, the portal's CSV, its API's, or any table with a header that
    has their columns; plain or gzip.

    Parameters
    ----------
    path : path
    road : RoadFrame
        Where the road frame lies in the recording's local coordinates.
    period : int or str, optional
        Number, from 1, or name such as ``"0400-0415"``; the first if left out, and the report says so. Periods are
        never merged: they number different vehicles alike.
    location : str, optional
        Which site of a file that mixes several, such as ``"i-80"``.
    height_m : mapping, optional
        Heights [m] that replace those of `sizes.HEIGHTS_M`; its keys: car, van, truck, long_truck, bus, motorcycle.
    x_range_m : (float, float), optional
        Keep boxes whose centre has its x [m, road frame] in this range.

    Returns
    -------
    Recording
        Times count from frame number 0. On freeways headings lie within 6 degrees of the road, 15 during lane
        changes; at sites with intersections they are free, and a vehicle that never moves faster than 2 m/s points
        where the column Direction has it bound for.

    Raises
    ------
    MissingFileError, InputError
        If the file or one of its values cannot be used; the text names the line and the column.
    """
    checked_heights(height_m or {})
    layout = sniff_layout(path)
    file = read_rows(path, layout, location)
    step_ms = time_step_ms(file.rows, str(path))
    periods = find_periods(file.rows, step_ms)
    chosen = choose_period(periods, period, str(path))
    rows = file.rows if len(periods.names) == 1 else file.rows.take(periods.of_row == chosen)
    notes = (*_notes(layout, location, period, periods.names), *_direction_notes(layout, file))
    on_map = (np.abs(rows.local_m) <= _OFF_MAP_M).all(axis=1)
    kept, duplicates, repeated = _without_repeats(rows.take(on_map))
    if not len(kept):
        raise InputError(f"{path}: no vehicles left; every row is more than {_OFF_MAP_M:.0f} m off the section")
    report = RepairReport(
        rows_read=file.rows_read,
        location=file.location,
        locations=file.locations,
        period=periods.names[chosen],
        periods=periods.names,
        duplicates=duplicates,
        repeated=repeated,
        off_map=int((~on_map).sum()),
        notes=notes,
    )
    recording = _boxes(kept, step_ms / 1000, road, _follows_road(layout, file), height_m, x_range_m, str(path), report)
    return with_overlaps_reported(recording)


def _without_repeats(rows: TrackRows) -> tuple[TrackRows, int, int]:
    values = np.column_stack([rows.time_ms, rows.local_m, rows.size_m, rows.v_class, rows.lane])
    kept, duplicates, repeated = drop_repeats(rows.vehicle_id, rows.frame, values)
    return rows.take(kept), duplicates, repeated


def _follows_road(layout: Layout, file: FileRows) -> bool:
    """Whether Local_Y follows the direction of travel everywhere: on freeways, not where there are intersections."""
    return file.location in FREEWAYS if file.location else not layout.arterial


def _notes(layout: Layout, location: str | None, period: int | str | None, periods: tuple[str, ...]) -> tuple[str, ...]:
    notes = []
    if location is not None and not layout.has_location:
        notes.append(f"the file has no Location column: taken to be {location}")
    if period is None and len(periods) > 1:
        notes.append(f"{len(periods)} periods found ({', '.join(periods)}); none was chosen, so the first is used")
    return tuple(notes)


def _direction_notes(layout: Layout, file: FileRows) -> Iterator[str]:
    if file.odd_directions and not _follows_road(layout, file):
        outcome = "theirs is unknown" if file.rows.direction.any() else "the column is left aside"
        yield f"Direction or Movement is none in {file.odd_directions:,} of {len(file.rows):,} rows: {outcome}"


def _boxes(
    rows: TrackRows,
    time_step_s: float,
    road: RoadFrame,
    follows_road: bool,
    height_m: Mapping[str, float] | None,
    x_range_m: tuple[float, float] | None,
    source: str,
    report: RepairReport,
) -> Recording:
    """Rows of one period, sorted by (vehicle, frame) without repeats, as boxes in the road frame."""
    rows, added = fill_gaps(rows, time_step_s)
    segment, split = segments(rows.vehicle_id, rows.frame, time_step_s)
    time_s = rows.frame * time_step_s
    front = road.from_local(rows.local_m)
    at_rest = 0.0 if follows_road else _BOUND_FOR_RAD[rows.direction]
    motion, held = held_heading(rows.vehicle_id, fitted_velocity(segment, time_s, front), at_rest)
    heading = limited(motion, lane_changing(rows.vehicle_id, time_s, rows.lane)) if follows_road else motion
    size, resized = repaired_sizes(rows.v_class, rows.size_m)
    length = size[:, 0]
    index = class_index(rows.v_class, length)
    height = heights(index, length, height_m)
    forward = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    # NGSIM records the front centre.
    centre = np.column_stack([front - length[:, None] / 2 * forward, height / 2])
    inside = within_x(centre, x_range_m, source)
    return Recording.from_rows(
        frame=rows.frame[inside],
        time_s=time_s[inside],
        vehicle_id=rows.vehicle_id[inside],
        class_index=index[inside],
        centre_m=centre[inside],
        size_m=np.column_stack([size, height])[inside],
        heading_rad=heading[inside],
        lane=rows.lane[inside],
        time_step_s=time_step_s,
        source=source,
        report=replace(
            report,
            rows_used=int((inside & ~added).sum()),
            interpolated=int((inside & added).sum()),
            tracks_split=split,
            sizes_repaired=len(np.unique(rows.vehicle_id[inside & resized])),
            headings_held=int((inside & held).sum()),
            headings_clamped=int((inside & (heading != motion)).sum()),
        ),
    )
