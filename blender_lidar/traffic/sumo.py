"""SUMO's floating car data to boxes in the road frame.

Facts of the format: https://sumo.dlr.de/docs/Simulation/Output/FCDOutput.html; that x and y are the middle of the front
bumper, say SUMO's developers (sumo-user list, msg01529).
"""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import InputError, printable
from .overlaps import with_overlaps_reported
from .report import RepairReport
from .road import Placing, within_x
from .source import first_bytes, table_lines
from .sumo_csv import csv_chunks, is_fcd_line
from .sumo_degrees import refuse_degrees
from .sumo_parquet import MAGIC, parquet_chunks
from .sumo_rows import FcdChunk, FcdRows, collected
from .sumo_steps import frames_of
from .sumo_types import VehicleType, assumed_type, quoted, read_types, type_named
from .sumo_xml import xml_chunks
from .tracks import drop_repeats
from .vehicles import CLASSES, Recording

_WHOLE = re.compile("0|[1-9][0-9]{0,14}", re.ASCII)  # below 2**53
_LARGEST_LANE = 2**15 - 2
_FLAT_WITHIN_M = 0.1
_NAMES_SHOWN = 3
_LONGEST_SHOWN = 40


def read_sumo(
    path: str | Path,
    *,
    vehicle_types: str | Path | None = None,
    origin_m: tuple[float, float] | None = None,
    heading_deg: float | None = None,
    x_range_m: tuple[float, float] | None = None,
) -> Recording:
    """Read floating car data, ``sumo --fcd-output``: XML or CSV, plain or gzip, or Parquet.

    Frame numbers count time steps, as `sumo_steps.frames_of` finds them. Vehicles whose ids are all whole numbers keep
    them; else they are numbered from 0 by first appearance. Lanes count from 1, the rightmost: SUMO's index plus one.
    Headings are SUMO's own, neither smoothed nor limited.

    Parameters
    ----------
    path : path
    vehicle_types : path, optional
        A route or additional file with the ``<vType>`` that the recording names. Without it a type that is called as
        one of SUMO's vehicle classes gets that one's default size, any other a passenger car's; the report says so.
    origin_m : (float, float), optional
        The road frame's origin in the net's coordinates [m].
    heading_deg : float, optional
        Direction of the road's x axis in the net [degrees], counter-clockwise from +x.
    x_range_m : (float, float), optional
        Keep boxes whose centre has its x [m, road frame] in this range.

    Raises
    ------
    MissingFileError, InputError
        If a file or one of its values cannot be used; the text names the line.
    MissingExtraError
        For Parquet without pyarrow.
    """
    placing = Placing(origin_m or (0.0, 0.0), heading_deg or 0.0)
    defined = None if vehicle_types is None else read_types(vehicle_types)
    rows = collected(_chunks(path), str(path))
    refuse_degrees(rows, str(path))
    types = _types(rows.types, defined, str(path), vehicle_types)
    frame, step_s, uneven = frames_of(rows.time_ms)
    told_apart = np.column_stack([rows.xy_m, rows.angle_deg, rows.type_code, rows.lane_code])
    kept, duplicates, repeated = drop_repeats(rows.id_code, frame, told_apart)
    on_road = np.array([found.class_name is not None for found in types])[rows.type_code[kept]]
    strangers = Counter(types[code].vehicle_class for code in rows.type_code[kept[~on_road]])
    if not on_road.any():
        raise InputError(f"{path}: no vehicle on a road; all are {', '.join(sorted(strangers))}")
    notes = [*_placing_notes(origin_m, heading_deg), *uneven, *_row_notes(rows, strangers)]
    if defined is None:
        notes.append(_assumed(rows.types))
    report = RepairReport(
        rows_read=rows.rows_read,
        duplicates=duplicates,
        repeated=repeated,
        off_map=rows.nowhere,
        left_out=rows.left_out + sum(strangers.values()),
        notes=tuple(notes),
    )
    recording = _boxes(rows, kept[on_road], types, frame, step_s, placing, x_range_m, str(path), report)
    return with_overlaps_reported(recording)


def is_fcd(path: str | Path) -> bool:
    """Whether a file looks like floating car data: Parquet, any XML, or CSV with SUMO's column names.

    Raises
    ------
    MissingFileError, InputError
        If it cannot be opened, is empty or neither text nor Parquet.
    """
    if first_bytes(path, len(MAGIC)) == MAGIC:
        return True
    line = next(table_lines(path), (0, ""))[1]
    return _is_xml(line) or is_fcd_line(line)


def _is_xml(line: str) -> bool:
    return line.lstrip().startswith("<")


def _chunks(path: str | Path) -> Iterator[FcdChunk]:
    if first_bytes(path, len(MAGIC)) == MAGIC:
        return parquet_chunks(path)
    return xml_chunks(path) if _is_xml(next(table_lines(path), (0, ""))[1]) else csv_chunks(path)


def _boxes(
    rows: FcdRows,
    kept: np.ndarray,
    types: list[VehicleType],
    frame: np.ndarray,
    time_step_s: float,
    placing: Placing,
    x_range_m: tuple[float, float] | None,
    source: str,
    report: RepairReport,
) -> Recording:
    """The rows at the places `kept` as boxes in the road frame; `types` are those of the rows' type codes."""
    size = np.array([found.size_m for found in types])[rows.type_code[kept]]
    heading = np.radians(90.0 - rows.angle_deg[kept])
    forward = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    # SUMO records the front centre.
    centre = placing.points(rows.xy_m[kept] - size[:, :1] / 2 * forward)
    inside = within_x(centre, x_range_m, source)
    kept, size = kept[inside], size[inside]
    return Recording.from_rows(
        frame=frame[kept],
        time_s=rows.time_ms[kept] / 1000,
        vehicle_id=_numbered(rows.ids)[rows.id_code[kept]],
        class_index=_class_indices(types)[rows.type_code[kept]],
        centre_m=np.column_stack([centre[inside], size[:, 2] / 2]),
        size_m=size,
        heading_rad=placing.headings(heading[inside]),
        lane=_lane_numbers(rows.lanes)[rows.lane_code[kept]],
        time_step_s=time_step_s,
        source=source,
        report=replace(report, rows_used=len(kept)),
    )


def _numbered(ids: list[str]) -> np.ndarray:
    """A number for every id, (k,) int64."""
    if all(_WHOLE.fullmatch(text) for text in ids):
        return np.array(ids, dtype=np.int64)
    return np.arange(len(ids))


def _lane_numbers(lanes: list[str]) -> np.ndarray:
    """Lane number of every lane id, (k,): ``"edge_0"`` is 1; 0 where it tells no index."""
    index = [lane.rpartition("_")[2] for lane in lanes]
    whole = [int(text) if text.isdecimal() and text.isascii() and len(text) < 6 else -1 for text in index]
    return np.array([number + 1 if number <= _LARGEST_LANE else 0 for number in whole])


def _class_indices(types: list[VehicleType]) -> np.ndarray:
    """Index into `CLASSES` of every type, (k,); -1 for what is not on a road."""
    return np.array([-1 if found.class_name is None else CLASSES.index(found.class_name) for found in types])


def _types(
    names: list[str], defined: dict[str, VehicleType] | None, source: str, file: str | Path | None
) -> list[VehicleType]:
    """The type behind each name: one of those that `file` defines, or one assumed where there is no such file."""
    if defined is None:
        return [assumed_type(name)[0] for name in names]
    found = [type_named(name, defined) for name in names]
    if None in found:
        name = names[found.index(None)]
        if not name:
            whose = "a vehicle has" if any(names) else "the vehicles have"
            raise InputError(
                f"{source}: {whose} no type, by which {file} could say the size; SUMO writes types unless "
                "--fcd-output.attributes leaves them out: name type there, or do without vehicle_types"
            )
        near = difflib.get_close_matches(name[:_LONGEST_SHOWN], list(defined), n=1, cutoff=0.5)
        hint = f"; did you mean {quoted(near[0])}?" if near else ""
        raise InputError(f"{source}: type {quoted(name)} is none of the {len(defined)} that {file} defines{hint}")
    return found


def _assumed(names: list[str]) -> str:
    unknown = [name or "no type" for name in names if not assumed_type(name)[1]]
    cars = f", a passenger car's for {_listed(unknown)}" if unknown else ""
    return f"no vehicle_types: sizes are SUMO's defaults for the type's vehicle class{cars}"


def _placing_notes(origin_m: object, heading_deg: object) -> Iterator[str]:
    if origin_m is None and heading_deg is None:
        yield "neither origin_m nor heading_deg: the road's origin and x axis are the net's own"


def _row_notes(rows: FcdRows, strangers: Counter[str]) -> Iterator[str]:
    if strangers:
        counts = ", ".join(f"{count:,} of {name}" for name, count in sorted(strangers.items()))
        yield f"rows of vehicles on no road: {counts}"
    if rows.ids != [str(number) for number in _numbered(rows.ids)]:
        yield f"vehicles are numbered from 0 by first appearance: {_listed(rows.ids)}"
    z = rows.z_m[~np.isnan(rows.z_m)]
    if len(z) and z.max() - z.min() > _FLAT_WITHIN_M:
        yield f"z from {z.min():.1f} to {z.max():.1f} m is left aside: all vehicles stand on a flat road"


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _NAMES_SHOWN:,} more" if len(names) > _NAMES_SHOWN else ""
    return ", ".join(printable(name, _LONGEST_SHOWN) for name in names[:_NAMES_SHOWN]) + more
