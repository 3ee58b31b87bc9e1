"""Reading NGSIM rows, by the million and from files that mix all sites."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pandas as pd

from ..errors import InputError, unknown_name
from .ngsim_faults import EMPTY, RULES, bad_value, short_row, unreadable
from .ngsim_layout import DIRECTION_COLUMNS, NEEDED, Layout
from .source import MAX_ROWS, open_bytes
from .tracks import TrackRows

FOOT_M = 0.3048
"""International foot, exactly; 0.3084 circulates."""
_CHUNK_ROWS = 400_000
_CHUNK_FIELDS = 10_000_000
_FEW_ODD = 0.01  # of the rows; more, and the column is another one
_ODD = -1


@dataclass(frozen=True, slots=True, eq=False)
class FileRows:
    """The rows of one location.

    Attributes
    ----------
    rows : TrackRows
        In the file's order.
    rows_read : int
        Rows of all locations.
    location : str
        As the file writes it, in lower case; empty if it has no such column.
    locations : tuple of str
        All that the file holds.
    odd_directions : int
        Rows of the location whose Direction or Movement is none that there is; their `rows.direction` is 0. Where they
        are more than a few, it is 0 in all rows.
    """

    rows: TrackRows
    rows_read: int
    location: str
    locations: tuple[str, ...]
    odd_directions: int


def read_rows(path: str | Path, layout: Layout, location: str | None = None) -> FileRows:
    """Read the rows of one location, converted from feet to metres.

    Parameters
    ----------
    path : path
    layout : Layout
        How the file is written.
    location : str, optional
        Which one of a file that mixes several, in any letter case. A file without that column is taken whole.

    Raises
    ------
    InputError
        If a row has too few or too many fields, or a value that cannot be used; if the location is not there, or none
        is chosen and there are several; if there are no rows or more than `MAX_ROWS`.
    """
    wanted = location.strip().lower() if location is not None and layout.has_location else None
    seen: dict[str, None] = {}
    kept: list[TrackRows] = []
    ends_empty: list[np.ndarray] = []
    rows_read = 0
    for table in _tables(path, layout):
        ends_empty.append(rows_read + np.flatnonzero(table.iloc[:, -1].isna().to_numpy()))
        index = np.arange(rows_read, rows_read + len(table))
        rows_read += len(table)
        if rows_read > MAX_ROWS:
            raise InputError(f"{path}: more than {MAX_ROWS:,} rows; split the file by location or period")
        if layout.has_location:
            names = _locations(table)
            seen.update(dict.fromkeys(names.categories))
            if wanted is not None:
                mask = np.asarray(names == wanted)
                table, index = table[mask], index[mask]
            elif len(seen) > 1:
                kept.clear()  # only their names matter now, for the message
                continue
        kept.append(_track_rows(path, layout, table, index))
    fault = short_row(path, layout, np.concatenate(ends_empty)) if ends_empty else None
    if fault is not None:
        raise fault
    locations = tuple(sorted(seen))
    if wanted is None and len(locations) > 1:
        raise InputError(f"{path}: holds {len(locations)} locations; choose one of: {', '.join(locations)}")
    if wanted is not None and wanted not in seen:
        raise unknown_name(location, locations, "location", str(path))
    if not kept:
        raise InputError(f"{path}: no rows; a file of vehicles is needed")
    rows = _joined(kept)
    odd = rows.direction == _ODD
    unknown = odd if odd.mean() <= _FEW_ODD else np.ones(len(rows), dtype=bool)
    return FileRows(
        rows=replace(rows, direction=np.where(unknown, np.int8(0), rows.direction)),
        rows_read=rows_read,
        location=wanted if wanted is not None else "".join(locations),
        locations=locations,
        odd_directions=int(odd.sum()),
    )


def _tables(path: str | Path, layout: Layout) -> Iterator[pd.DataFrame]:
    with open_bytes(path) as stream:
        for _ in range(layout.first_line - 1):
            stream.readline()
        reader = None
        while True:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error", pd.errors.ParserWarning)  # rows longer than the header
                    reader = _reader(stream, layout) if reader is None else reader
                    table = next(reader)
            except (StopIteration, pd.errors.EmptyDataError):
                return
            except InputError:
                raise
            except (ValueError, pd.errors.ParserWarning) as error:
                raise unreadable(path, layout, str(error)) from error
            yield table


def _reader(stream: BinaryIO, layout: Layout) -> Iterator[pd.DataFrame]:
    # Unused columns are read too, under numbers, so that the parser notices rows that are too long.
    used = {*NEEDED, *DIRECTION_COLUMNS, "location"}
    names = [
        name if name in used and layout.columns.index(name) == number else f"unused {number}"
        for number, name in enumerate(layout.columns)
    ]
    types = {"location": "category", **dict.fromkeys(NEEDED, np.float64)}
    return pd.read_csv(
        stream,
        sep=layout.delimiter or r"\s+",
        header=None,
        names=names,
        index_col=False,
        dtype=types,
        thousands="," if layout.delimiter else None,
        keep_default_na=False,
        na_values=list(EMPTY),
        skipinitialspace=True,
        chunksize=max(1, min(_CHUNK_ROWS, _CHUNK_FIELDS // len(names))),
        low_memory=False,
        encoding_errors="replace",
    )


def _locations(table: pd.DataFrame) -> pd.Categorical:
    """The location of every row, in lower case; a missing one is the empty name."""
    given = table["location"].cat
    names = [*(str(name).strip().lower() for name in given.categories), ""]
    codes = given.codes.to_numpy()
    distinct, number = np.unique(names, return_inverse=True)
    return pd.Categorical.from_codes(number[codes], categories=distinct).remove_unused_categories()


def _track_rows(path: str | Path, layout: Layout, table: pd.DataFrame, index: np.ndarray) -> TrackRows:
    """The columns that are used; `index` is each row's number in the file, for messages."""
    columns = {name: table[name].to_numpy(dtype=np.float64) for name in NEEDED}
    bad = np.zeros(len(table), dtype=bool)
    for name, rule in RULES.items():
        bad |= ~rule.accepts(columns[name])
    if bad.any():
        raise bad_value(path, layout, int(index[bad.argmax()]))
    return TrackRows(
        vehicle_id=columns["vehicle_id"].astype(np.int64),
        frame=columns["frame_id"].astype(np.int64),
        time_ms=columns["global_time"],
        local_m=np.stack([columns["local_x"], columns["local_y"]], axis=1) * FOOT_M,
        size_m=np.nan_to_num(np.stack([columns["v_length"], columns["v_width"]], axis=1)) * FOOT_M,
        v_class=columns["v_class"].astype(np.int8),
        lane=np.nan_to_num(columns["lane_id"]).astype(np.int16),
        direction=_directions(table),
    )


def _directions(table: pd.DataFrame) -> np.ndarray:
    """The column Direction, (n,) int8; 0 where it is empty or not there, `_ODD` where it or Movement is none.

    Files are said to exist whose six columns of arterials stand two places later. The column after Direction, Movement,
    would hold other numbers there: it tells whether Direction is what it seems.
    """
    limits = dict(zip(DIRECTION_COLUMNS, (4, 3), strict=True))
    if any(name not in table for name in limits):
        return np.zeros(len(table), dtype=np.int8)
    values = {name: pd.to_numeric(table[name], errors="coerce").to_numpy(np.float64) for name in limits}
    known = np.ones(len(table), dtype=bool)
    for name, limit in limits.items():
        known &= np.isin(values[name], np.arange(limit + 1)) | table[name].isna().to_numpy()
    return np.where(known, np.nan_to_num(values["direction"]), _ODD).astype(np.int8)


def _joined(parts: list[TrackRows]) -> TrackRows:
    if len(parts) == 1:
        return parts[0]
    names = TrackRows.__slots__
    return TrackRows(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
