"""Trajectory data sets as tables: highD, inD and its kin, INTERACTION and K733, TGSIM; columns, axes, meta files.

Sources: drone-dataset-tools of levelXdata (highD's x and y are a box's upper left corner, y points down, and its width
is the length); the INTERACTION dataset's readme; TGSIM's data dictionary.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..csv_header import TableLayout, fields_of, first_lines, laid_out
from ..csv_tables import Column, read_whole
from ..errors import InputError, MissingFileError
from .table import READ_COLUMNS, read_table
from .vehicles import Recording


class Preset(NamedTuple):
    """A data set's table.

    Attributes
    ----------
    columns : mapping of str to str
        Ours, or ``time_ms`` and ``run``, by the data set's.
    has_meta : bool
        Whether a file beside it, ``_tracksMeta`` in place of ``_tracks``, has the classes.
    is_corner, y_down : bool
        Whether x and y are the corner with the least of both, and y points down.
    rate_hz : float or None
        Frames a second, unless a file of the recording says it; None where the table has times.
    """

    columns: Mapping[str, str]
    has_meta: bool = False
    is_corner: bool = False
    y_down: bool = False
    rate_hz: float | None = None


_PLACE = {"x": "x_m", "y": "y_m"}
PRESETS = {
    "highd": Preset(
        {"frame": "frame", "id": "vehicle_id", **_PLACE, "width": "length_m", "height": "width_m", "laneId": "lane"},
        has_meta=True,
        is_corner=True,
        y_down=True,
        rate_hz=25.0,
    ),
    "ind": Preset(
        {"frame": "frame", "trackId": "vehicle_id", "xCenter": "x_m", "yCenter": "y_m"}
        | {"heading": "heading_deg", "width": "width_m", "length": "length_m"},
        has_meta=True,
        rate_hz=25.0,
    ),
    "k733": Preset(  # psi_rad is 0 at standstill, and frames do not count time: headings and frames are inferred
        {"track_id": "vehicle_id", "timestamp_ms": "time_ms", "agent_type": "class", **_PLACE}
        | {"length": "length_m", "width": "width_m"},
    ),
    "tgsim": Preset(
        {"id": "vehicle_id", "time": "time_s", "xloc-kf": "x_m", "yloc-kf": "y_m", "lane-kf": "lane"}
        | {"length-smoothed": "length_m", "width-smoothed": "width_m", "type-most-common": "class", "run-index": "run"},
        y_down=True,
    ),
}
_MOST_NAMED = 8
_HIGHD_WAYS = {1: 180.0, 2: 0.0}  # drivingDirection: 1 along the upper lanes, to the left
_WHOLE = Column("a whole number", whole=True)
_READ = {**READ_COLUMNS, "time_ms": Column("milliseconds"), "run": _WHOLE}
_OF_TRACKS = {"id": _WHOLE, "trackId": _WHOLE, "drivingDirection": _WHOLE}
_OF_RECORDING = {"frameRate": Column("more than 0, up to 1000 Hz", 1e-3, 1e3)}


def preset_of(path: str | Path) -> str | None:
    """The data set whose columns a file's header has; None for none."""
    _, header = first_lines(path)[0]
    names = {name.strip().lower() for name in fields_of(header)}
    return next((name for name, one in PRESETS.items() if {key.lower() for key in one.columns} <= names), None)


def meta_files(path: str | Path, preset: str) -> list[Path]:
    """The files beside a recording that its data set needs, those that are there."""
    if preset not in PRESETS or not PRESETS[preset].has_meta:
        return []
    path = Path(path)
    stem = path.name.partition("_tracks")[0]
    beside = (path.with_name(f"{stem}{what}.csv") for what in ("_tracksMeta", "_recordingMeta"))
    return [one for one in beside if one.exists()]


def read_preset(
    path: str | Path,
    *,
    preset: str,
    origin_m: tuple[float, float] = (0.0, 0.0),
    heading_deg: float = 0.0,
    height_m: Mapping[str, float] | None = None,
) -> Recording:
    """Read a recording of a data set; parameters as of `table.read_table`.

    Raises
    ------
    MissingFileError, InputError
        As `read_table`; and where a file with the classes is not beside it.
    """
    known = PRESETS[preset]
    line, header = first_lines(path)[0]
    ours = {key.lower(): name for key, name in known.columns.items()}
    ours.setdefault("class", "class")  # where somebody has joined it
    names = [ours.get(name.strip().lower(), "") for name in fields_of(header)]
    layout = TableLayout(names, ",", line + 1)
    layout.check(known.columns.values(), (), path)
    table = dict(read_whole(path, layout, _READ, ["class", "vehicle_id"]).columns)
    if not len(table["x_m"]):
        raise InputError(f"{path}: no rows below the header in line {line}")
    runs, rows_read = np.unique(table["run"]) if "run" in table else np.zeros(0), len(table["x_m"])
    if len(runs):
        table = {name: column[table["run"] == runs[0]] for name, column in table.items()}
    if "time_ms" in table:
        table["time_s"] = table.pop("time_ms") / 1000.0
    if known.has_meta:
        _join(path, preset, table)
    if known.is_corner:
        table["x_m"], table["y_m"] = table["x_m"] + table["length_m"] / 2, table["y_m"] + table["width_m"] / 2
    if known.y_down:
        table["y_m"] = -table["y_m"]
    table.pop("run", None)
    read = read_table(table, origin_m=origin_m, heading_deg=heading_deg, height_m=height_m, source=str(path))
    if len(runs) < 2:
        return read
    named = ", ".join(f"{run:g}" for run in runs[:_MOST_NAMED]) + ", ..." * (len(runs) > _MOST_NAMED)
    note = (
        f"{len(runs)} runs found (run-index {named}); the first is used: for another leave its rows alone in a file, "
        "which [[traffic]] may name beside this one"
    )
    return replace(read, report=replace(read.report, rows_read=rows_read, notes=(note, *read.report.notes)))


def _join(path: str | Path, preset: str, table: dict[str, np.ndarray]) -> None:
    """Add what the meta files of a recording say: classes, the direction of travel, and times."""
    files = {one.stem.rpartition("_")[2]: one for one in meta_files(path, preset)}
    rate = PRESETS[preset].rate_hz
    if "recordingMeta" in files:
        said = _meta(files["recordingMeta"], (), _OF_RECORDING)
        rate = said.get("frameRate", np.array([rate]))[0]
    table["time_s"] = table["frame"] / rate
    if "class" in table:
        return
    if "tracksMeta" not in files:
        raise MissingFileError(f"{path}: its tracksMeta.csv, which has the classes, is not beside it")
    tracks = _meta(files["tracksMeta"], ("class",), _OF_TRACKS)
    key = "id" if "id" in tracks else "trackId"
    rows = {number: row for row, number in enumerate(tracks[key].tolist())}
    at = np.array([rows.get(float(one), -1) for one in table["vehicle_id"].tolist()])
    if (at < 0).any():
        stranger = table["vehicle_id"][at.argmin()]
        raise InputError(f"{files['tracksMeta']}: has no vehicle {stranger}, which {path} has")
    table["class"] = tracks["class"][at]
    if "drivingDirection" in tracks:
        table["heading_deg"] = np.array([_HIGHD_WAYS.get(int(way), 0.0) for way in tracks["drivingDirection"]])[at]


def _meta(path: Path, texts: tuple[str, ...], columns: Mapping[str, Column]) -> dict[str, np.ndarray]:
    """The columns of a meta file that there are."""
    rows = read_whole(path, laid_out(path, texts, columns), columns, texts)
    if not len(rows):
        raise InputError(f"{path}: no rows below the header")
    return rows.columns
