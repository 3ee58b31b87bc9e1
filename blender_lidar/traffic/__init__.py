"""Traffic: recordings of any kind into one `Vehicles` per frame, in metres and in the road frame.

NGSIM files need pandas and SUMO's Parquet files pyarrow, imported when one is read; the rest needs numpy alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from ..errors import InputError, MissingExtraError, unknown_name
from .csv_rows import fields_of
from .frames import FramePlan, plan_frames
from .instants import instants, well_populated_frames
from .overlaps import overlapping_pairs
from .report import RepairReport
from .road import RoadFrame
from .source import table_lines
from .sumo import is_fcd, read_sumo
from .table import is_table_header, read_table
from .vehicles import CLASSES, Recording, Vehicles

__all__ = [
    "CLASSES",
    "FORMATS",
    "FramePlan",
    "Recording",
    "RepairReport",
    "RoadFrame",
    "Vehicles",
    "instants",
    "overlapping_pairs",
    "plan_frames",
    "read_sumo",
    "read_table",
    "read_traffic",
    "well_populated_frames",
]

FORMATS = ("auto", "ngsim", "sumo", "table")
_SETTINGS = {
    "ngsim": ("period", "location", "height_m"),
    "sumo": ("vehicle_types", "origin_m", "heading_deg"),
    "table": ("origin_m", "heading_deg", "time_step_s"),
}


def read_traffic(
    path: str | Path,
    *,
    format: str = "auto",
    road: RoadFrame | None = None,
    period: int | str | None = None,
    location: str | None = None,
    height_m: Mapping[str, float] | None = None,
    x_range_m: tuple[float, float] | None = None,
    origin_m: tuple[float, float] | None = None,
    heading_deg: float | None = None,
    time_step_s: float | None = None,
    vehicle_types: str | Path | None = None,
) -> Recording:
    """Read a recording, whatever its format.

    Parameters
    ----------
    path : path
        Plain or gzip.
    format : {"auto", "ngsim", "sumo", "table"}
        ``"auto"`` looks at the file's beginning.
    road, period, location, height_m
        For NGSIM; see `ngsim.read_ngsim`. `road` is I-80's if left out.
    origin_m, heading_deg
        For SUMO and tables; see `sumo.read_sumo`, `table.read_table`.
    vehicle_types
        For SUMO.
    time_step_s
        For tables.
    x_range_m : (float, float), optional
        Keep boxes whose centre has its x [m, road frame] in this range.

    Raises
    ------
    MissingFileError, InputError
        If the file, one of its values or a setting cannot be used, or a setting is given that the format does not
        have.
    MissingExtraError
        If an NGSIM file is to be read without pandas, or a Parquet file without pyarrow.
    """
    if format not in FORMATS:
        raise unknown_name(format, FORMATS, "traffic format")
    if format == "auto":
        format = _sniff(path)
    settings = {
        "period": period,
        "location": location,
        "height_m": height_m or None,
        "origin_m": origin_m,
        "heading_deg": heading_deg,
        "time_step_s": time_step_s,
        "vehicle_types": vehicle_types,
    }
    given = {name: value for name, value in settings.items() if value is not None}
    for name, value in given.items():
        if name not in _SETTINGS[format]:
            raise InputError(f"{path}: {name} = {value!r} does not apply to traffic of format {format!r}")
    if format == "ngsim":
        return _ngsim_reader(path)(path, road=road or RoadFrame(), x_range_m=x_range_m, **given)
    read = read_sumo if format == "sumo" else read_table
    return read(path, x_range_m=x_range_m, **given)


def _ngsim_reader(path: str | Path) -> Callable[..., Recording]:
    try:
        from .ngsim import read_ngsim
    except ImportError as error:
        if error.name != "pandas":
            raise
        raise MissingExtraError(
            f"{path}: NGSIM files need pandas (pip install pandas); SUMO's and tables of boxes can be read without"
        ) from error
    return read_ngsim


def _sniff(path: str | Path) -> str:
    if is_fcd(path):
        return "sumo"
    _, first = next(table_lines(path), (0, ""))
    return "table" if is_table_header(fields_of(first)) else "ngsim"
