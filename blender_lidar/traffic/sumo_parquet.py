"""SUMO's floating car data as Parquet: ``sumo --fcd-output run.fcd.parquet``, by pyarrow."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError, MissingExtraError, printable
from ..input_file import most_records
from .source import MAX_BYTES, MAX_ROWS
from .sumo_columns import chunk_of_vehicles, places_of_columns
from .sumo_rows import FcdChunk, Values

if TYPE_CHECKING:
    import pyarrow

MAGIC = b"PAR1"
_CHUNK_ROWS = 50_000
_LONGEST_TEXT = 1_000
_PAGE_BYTES = 2**20  # more than the headers of a column's pages take
_NUMBERS = (
    "double",
    "float",
    "halffloat",
    "null",
    *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)),
)


def parquet_chunks(path: str | Path) -> Iterator[FcdChunk]:
    """The vehicles of a file; persons and containers are counted.

    Raises
    ------
    MissingExtraError
        If pyarrow is not installed, or does not fit this NumPy.
    InputError
        If the file is damaged, lacks a column, has one of neither numbers nor texts or with a text of more than
        `_LONGEST_TEXT` characters, or unpacks to more than `MAX_BYTES`.
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
            schema, metadata = file.schema_arrow, file.metadata
        places = places_of_columns(schema.names, str(path))
        names = {attribute: schema.names[place] for attribute, place in places.items()}
        texts = [name for name in names.values() if _is_text(_refuse_other(path, schema.field(name)))]
        _refuse_bulk(path, metadata, texts)
        # A text that all rows share stands in the file once, and would in memory be there for each of them.
        with pyarrow.parquet.ParquetFile(path, read_dictionary=texts) as file:
            first = 1
            for batch in file.iter_batches(batch_size=_CHUNK_ROWS, columns=[*names.values()]):
                columns = {attribute: _values(path, name, batch.column(name)) for attribute, name in names.items()}
                yield chunk_of_vehicles(columns, lambda row, first=first: f"{path}: row {first + row}")
                first += batch.num_rows
    except InputError:  # a ValueError too
        raise
    except (pyarrow.ArrowException, OSError, ValueError, LookupError) as error:  # some of them of places beyond the end
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path}: truncated or damaged Parquet file ({reason})") from error


def _refuse_excess(path: str | Path, metadata: pyarrow.parquet.FileMetaData) -> None:
    if metadata.num_rows > MAX_ROWS:
        raise InputError(f"{path}: more than {MAX_ROWS:,} rows; split the file")
    size = Path(path).stat().st_size
    if metadata.num_rows > most_records(size):
        raise InputError(f"{path}: {metadata.num_rows:,} rows in a file of {size:,} bytes are no recording")
    unpacked = sum(metadata.row_group(group).total_byte_size for group in range(metadata.num_row_groups))
    if unpacked > MAX_BYTES:
        raise InputError(f"{path}: more than {MAX_BYTES / 2**30:.0f} GiB unpacked; a recording has less")


def _refuse_bulk(path: str | Path, metadata: pyarrow.parquet.FileMetaData, texts: Sequence[str]) -> None:
    """Refuse, before unpacking them, columns of texts that cannot all be short ones."""
    for group in range(metadata.num_row_groups):
        row_group = metadata.row_group(group)
        for column in (row_group.column(place) for place in range(row_group.num_columns)):
            most = _PAGE_BYTES + (4 * _LONGEST_TEXT + 8) * column.num_values  # four bytes a character
            if column.path_in_schema in texts and column.total_uncompressed_size > most:
                name = printable(column.path_in_schema, 40)
                raise InputError(f"{path}: column {name} holds texts of more than {_LONGEST_TEXT:,} characters")


def _is_text(kind: pyarrow.DataType) -> bool:
    return str(kind) in ("string", "large_string")


def _refuse_other(path: str | Path, field: pyarrow.Field) -> pyarrow.DataType:
    """The type of a column's values, if they are numbers, texts, or missing throughout."""
    kind = getattr(field.type, "value_type", field.type) if str(field.type).startswith("dictionary") else field.type
    if not (_is_text(kind) or str(kind) in _NUMBERS):
        raise InputError(
            f"{path}: column {printable(field.name, 40)} holds {printable(str(kind), 40)}; allowed: numbers or texts"
        )
    return kind


def _values(path: str | Path, name: str, column: pyarrow.Array) -> Values:
    """The values of a column, equal texts as one and the same object."""
    if str(column.type) in ("double", "float"):
        return column.to_numpy(zero_copy_only=False).astype(np.float64)
    if not hasattr(column, "dictionary"):
        return column.to_pylist()
    codes, of_row = np.unique(column.indices.fill_null(-1).to_numpy(), return_inverse=True)
    words = [None if code < 0 else column.dictionary[int(code)].as_py() for code in codes]
    longest = max((len(word) for word in words if isinstance(word, str)), default=0)
    if longest > _LONGEST_TEXT:
        raise InputError(
            f"{path}: column {printable(name, 40)} holds a text of {longest:,} characters; allowed: {_LONGEST_TEXT:,}"
        )
    return [words[place] for place in of_row.tolist()]
