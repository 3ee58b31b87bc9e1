"""CSV tables: a header line, then rows; numbers with the digits that matter."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from .atomic import write_text


def write_columns(
    path: str | Path, columns: Mapping[str, np.ndarray], decimals: Mapping[str, int] | None = None
) -> None:
    """Write columns of equal length as CSV.

    Parameters
    ----------
    path : path
        The file; written whole or not at all.
    columns : mapping of str to ndarray, (n,)
        Names and values; True and False become 1 and 0.
    decimals : mapping of str to int, optional
        Digits after the point for a column of floats; others are written so that reading gives the same float.
    """
    decimals = decimals or {}
    texts = [_texts(np.asarray(values), decimals.get(name)) for name, values in columns.items()]
    write_text(path, to_csv(list(columns), zip(*texts, strict=True)))


def to_csv(header: Sequence[str], rows) -> str:
    """A header and rows as the text of a CSV file."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return stream.getvalue()


def _texts(values, decimals):
    if values.dtype == bool:
        values = values.astype(int)
    if decimals is not None:
        return [f"{value:.{decimals}f}" for value in values.tolist()]
    return [repr(value) if isinstance(value, float) else str(value) for value in values.tolist()]
