"""Columns of SUMO's floating car data in CSV and Parquet files, which call an attribute by several names.

SUMO's own files (since 1.22) name all columns after the first element of the recording, ``vehicle_x`` or ``person_x``,
and put vehicles, persons and containers into the same ones: only vehicles have a lane. ``--output.column-header`` makes
them ``x`` or ``timestep_vehicle_x``. SUMO's tool ``xml2csv.py`` gives each kind of element columns of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from ..errors import InputError
from .sumo_rows import NEEDED, OPTIONAL, FcdChunk, Values

_KINDS = ("vehicle", "person", "container")
_MARKS = ("tag", "person_id", "container_id")  # further columns that tell what a row is


def places_of_columns(header: Sequence[str], where: str) -> dict[str, int]:
    """Which column holds which attribute.

    Parameters
    ----------
    header : sequence of str
        Column names in the file's order.
    where : str
        The header's place, as an error names it.

    Raises
    ------
    InputError
        If an attribute of `NEEDED` has no column, or one has two.
    """
    names = [name.strip().lower().removeprefix("timestep_") for name in header]
    kind = next((kind for kind in _KINDS if f"{kind}_id" in names), "vehicle")
    attributes = [name.removeprefix(f"{kind}_") for name in names]
    missing = [name for name in NEEDED if name not in attributes]
    if missing:
        shown = {name: "timestep_time" if name == "time" else f"vehicle_{name}" for name in NEEDED}
        lacking = ", ".join(shown[name] for name in missing)
        raise InputError(f"{where}: no column {lacking}; needed: {', '.join(shown.values())}")
    wanted = (*NEEDED, *OPTIONAL, *_MARKS)
    twice = [name for name in wanted if attributes.count(name) > 1]
    if twice:
        raise InputError(f"{where}: two columns for {twice[0]}")
    return {name: attributes.index(name) for name in wanted if name in attributes}


def is_fcd_header(header: Sequence[str]) -> bool:
    """Whether these are column names of floating car data, complete or not."""
    names = {name.strip().lower() for name in header}
    return "timestep_time" in names or names >= {"time", "id", "x", "y"}


def chunk_of_vehicles(columns: Mapping[str, Values], where: Callable[[int], str]) -> FcdChunk:
    """Rows without those that are persons, containers or empty timesteps.

    Parameters
    ----------
    columns : mapping of str to Values
        By attribute, as `places_of_columns` finds them.
    where : callable
        The place of a row.
    """
    count = len(columns["id"])
    lanes, tags = columns.get("lane"), columns.get("tag")
    others = [columns[name] for name in _MARKS[1:] if name in columns]
    kept: list[int] = []
    left_out = 0
    for row in range(count):
        if not _is_given(columns["id"][row]) and not _is_given(columns["x"][row]):
            left_out += any(_is_given(ids[row]) for ids in others)
        elif (lanes is not None and not _is_given(lanes[row])) or (tags is not None and tags[row] in _KINDS[1:]):
            left_out += 1
        else:
            kept.append(row)
    vehicles = {name: columns[name] for name in (*NEEDED, *OPTIONAL) if name in columns}
    if len(kept) < count:
        vehicles = {name: [values[row] for row in kept] for name, values in vehicles.items()}
    return FcdChunk(vehicles, lambda row: where(kept[row]), left_out)


def _is_given(value: str | float | None) -> bool:
    return value is not None and value != "" and value == value
