"""Traffic: recordings of any kind into one `Vehicles` per frame, in metres and in the road frame.

SUMO's Parquet files need pyarrow, imported when one is read; the rest needs numpy alone.
"""

from __future__ import annotations

import inspect
from pathlib import Path

from ..errors import InputError, unknown_name
from ..names import TRAFFIC_FORMATS
from ..road import RoadFrame
from .frames import FramePlan, instants, plan_frames, well_populated_frames
from .ngsim import read_ngsim
from .source import fields_of, first_lines
from .sumo import kind_of_fcd, read_sumo
from .table import is_table_header, read_table
from .vehicles import CLASSES, Recording, RepairReport, Vehicles, overlapping_pairs

__all__ = [
    "CLASSES",
    "FramePlan",
    "Recording",
    "RepairReport",
    "RoadFrame",
    "Vehicles",
    "format_of",
    "instants",
    "overlapping_pairs",
    "plan_frames",
    "read_sumo",
    "read_table",
    "read_traffic",
    "well_populated_frames",
]

_READERS = dict(zip(TRAFFIC_FORMATS[1:], (read_ngsim, read_sumo, read_table), strict=True))


def read_traffic(
    path: str | Path, *, format: str = "auto", road: RoadFrame | None = None, **settings: object
) -> Recording:
    """Read a recording, whatever its format.

    Parameters
    ----------
    path : path
        Plain or gzip.
    format : {"auto", "ngsim", "sumo", "table"}
        ``"auto"`` looks at the file's beginning.
    road : RoadFrame, optional
        For NGSIM; I-80's if left out.
    **settings
        Those of the format, see `ngsim.read_ngsim`, `sumo.read_sumo`, `table.read_table`; None counts as left out.

    Raises
    ------
    MissingFileError, InputError
        If the file, one of its values or a setting cannot be used, or a setting is given that the format does not
        have.
    MissingExtraError
        If a Parquet file is to be read without pyarrow.
    """
    if format not in TRAFFIC_FORMATS:
        raise unknown_name(format, TRAFFIC_FORMATS, "traffic format")
    if format == "auto":
        format = format_of(path)
    read = _READERS[format]
    given = {name: value for name, value in settings.items() if value is not None and value != {}}
    for name, value in given.items():
        if name not in inspect.signature(read).parameters:
            raise InputError(f"{path}: {name} = {value!r} does not apply to traffic of format {format!r}")
    if format == "ngsim":
        given["road"] = road or RoadFrame()
    return read(path, **given)


def format_of(path: str | Path) -> str:
    """The format of a recording, ``"ngsim"``, ``"sumo"`` or ``"table"``, by the file's beginning."""
    if kind_of_fcd(path):
        return "sumo"
    return "table" if is_table_header(fields_of(first_lines(path)[0][1])) else "ngsim"
