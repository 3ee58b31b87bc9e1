"""Traffic: recordings of any kind into one `Boxes` per frame, in metres and in the road frame.

Parquet needs pyarrow, imported when one is read; the rest needs numpy alone.
"""

from __future__ import annotations

import inspect
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

from ..csv_header import first_lines, quoted
from ..errors import InputError, unknown_name
from ..names import TRAFFIC_FORMATS
from ..road import RoadSettings
from .boxes import Boxes
from .frames import FramePlan, instants, joined_plans, joined_recordings, plan_frames, well_populated_frames
from .ngsim import NGSIM_COLUMNS, read_ngsim
from .ngsim import likeness as ngsim_likeness
from .presets import PRESETS, meta_files, preset_of, read_preset
from .sumo import FCD_NEEDED, kind_of_fcd, read_sumo
from .table import BOX_NEEDED, read_table, write_table
from .table import likeness as table_likeness
from .vehicles import CLASSES, Recording, RepairReport, overlapping_pairs, with_overlaps_reported

__all__ = [
    "CLASSES",
    "Boxes",
    "FramePlan",
    "Recording",
    "RepairReport",
    "format_of",
    "instants",
    "joined_plans",
    "joined_recordings",
    "overlapping_pairs",
    "plan_frames",
    "read_table",
    "read_traffic",
    "well_populated_frames",
    "write_table",
]

_READERS = {"ngsim": read_ngsim, "sumo": read_sumo, "table": read_table}
_READERS |= {name: partial(read_preset, preset=name) for name in PRESETS}


def read_traffic(
    path: str | Path, *, format: str = "auto", road: RoadSettings | None = None, **settings: object
) -> Recording:
    """Read a recording of any format.

    Parameters
    ----------
    path : path
        Plain or gzip.
    format : str
        One of `TRAFFIC_FORMATS`;
        ``"auto"`` looks at the file's beginning.
    road : RoadSettings, optional
        For NGSIM; I-80's if left out.
    **settings
        Those of the format, see `ngsim.read_ngsim`, `sumo.read_sumo`, `table.read_table`; None counts as left out.

    Raises
    ------
    MissingFileError, InputError
        If the file, one of its values or a setting cannot be used, or a setting is given that the format does not
        have.
    MissingExtraError
        For Parquet without pyarrow.
    """
    if format not in TRAFFIC_FORMATS:
        raise unknown_name(format, TRAFFIC_FORMATS, "traffic format")
    if format == "auto":
        format = format_of(path)
        if meta_files(path, format):
            raise InputError(f'{path}: has the columns of {format}; say so: [traffic] format = "{format}"')
    read = _READERS[format]
    given = {name: value for name, value in settings.items() if value is not None and value != {}}
    for name, value in given.items():
        if name not in inspect.signature(read).parameters:
            raise InputError(f"{path}: {name} = {value!r} does not apply to traffic of format {format!r}")
    if format == "ngsim":
        given["road"] = road or RoadSettings()
    recording = read(path, **given)
    return with_overlaps_reported(replace(recording, report=replace(recording.report, format=format)))


_FEWEST_ALIKE = 4  # of a format's needed columns, by which a header is known
_MOST_OF_SUMO = 6  # of a table's columns, those that SUMO's own files have or have something like


def format_of(path: str | Path) -> str:
    """The format of a recording, one of `TRAFFIC_FORMATS`, by the file's beginning.

    Raises
    ------
    MissingFileError, InputError
        If it cannot be read, or is of none of them.
    """
    kind = kind_of_fcd(path)
    if kind == "xml":
        return "sumo"
    line, header = first_lines(path)[0]
    if header.lstrip()[:1] in ("{", "["):
        raise InputError(f"{path}: is JSON; write a CSV, a row for each vehicle and frame: {', '.join(BOX_NEEDED)}")
    if {"lat", "lon"} <= set(re.split(r"[\W_]+", header.lower())):
        raise InputError(
            f"{path}:{line}: has longitude and latitude; metres are needed, in a row for each vehicle and frame: "
            f"{', '.join(BOX_NEEDED)}"
        )
    if preset := preset_of(path):
        return preset
    if kind == "table" and table_likeness(header) <= _MOST_OF_SUMO:
        return "sumo"
    ngsim, table = ngsim_likeness(header), table_likeness(header)
    if ngsim >= max(table, _FEWEST_ALIKE):
        return "ngsim"
    if table >= _FEWEST_ALIKE:
        return "table"
    raise InputError(
        f"{path}:{line}: no traffic that is known: it begins with {quoted(header)}; allowed: NGSIM's text or CSV "
        f"({', '.join(NGSIM_COLUMNS)}), SUMO's floating car data ({', '.join(FCD_NEEDED)}), or a table of boxes "
        f"({', '.join(BOX_NEEDED)})"
    )
