"""SUMO's floating car data as Parquet: ``sumo --fcd-output run.fcd.parquet``, by pyarrow."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError, MissingExtraError
from .source import MAX_BYTES, MAX_ROWS
from .sumo_columns import chunk_of_vehicles, places_of_columns
from .sumo_rows import FcdChunk, Values

if TYPE_CHECKING:
    import pyarrow

MAGIC = b"PAR1"
_CHUNK_ROWS = 50_000


def parquet_chunks(path: str | Path) -> Iterator[FcdChunk]:
    """The vehicles of a file; persons and containers are counted.

    Raises
    ------
    MissingExtraError
        If pyarrow is not installed, or does not fit this NumPy.
    InputError
        If the file is damaged, lacks a column, or unpacks to more than `MAX_BYTES`.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        reason = "" if isinstance(error, ModuleNotFoundError) else f" ({error})"
        raise MissingExtraError(
            f'{path}: Parquet files need pyarrow: pip install "blender_lidar[parquet]"{reason}'
        ) from error
    try:
        with pyarrow.parquet.ParquetFile(path) as file:
            _refuse_excess(path, file.metadata)
            places = places_of_columns(file.schema_arrow.names, str(path))
            names = [file.schema_arrow.names[place] for place in places.values()]
            first = 1
            for batch in file.iter_batches(batch_size=_CHUNK_ROWS, columns=names):
                columns = {name: _values(batch.column(column)) for name, column in zip(places, names, strict=True)}
                yield chunk_of_vehicles(columns, lambda row, first=first: f"{path}: row {first + row}")
                first += batch.num_rows
    except (pyarrow.ArrowException, OSError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path}: truncated or damaged Parquet file ({reason})") from error


def _refuse_excess(path: str | Path, metadata: pyarrow.parquet.FileMetaData) -> None:
    if metadata.num_rows > MAX_ROWS:
        raise InputError(f"{path}: more than {MAX_ROWS:,} rows; split the file")
    unpacked = sum(metadata.row_group(group).total_byte_size for group in range(metadata.num_row_groups))
    if unpacked > MAX_BYTES:
        raise InputError(f"{path}: more than {MAX_BYTES / 2**30:.0f} GiB unpacked; a recording has less")


def _values(column: pyarrow.Array) -> Values:
    if str(column.type) in ("double", "float"):
        return column.to_numpy(zero_copy_only=False).astype(np.float64)
    return column.to_pylist()
