"""CSV tables beside labelled sweeps: what detectors made of each car, and what is told of each frame.

The cars' columns are ``frame, label_line`` and, for every detector, ``NAME_confidence`` and ``NAME_iou3d`` of the
detection that overlaps the car most, both 0 where it was missed, and perhaps ``NAME_in_range``.
The frames' are ``frame`` and perhaps ``split, label_kind, drive``; these may also stand with the cars.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import InputError, printable
from ...traffic.source import Column, Rows, TableLayout, fields_of, first_lines, read_rows
from . import FRAMES_FILE
from .labelled import joined

FRAME_COLUMNS = ("split", "label_kind", "drive")
TRAINING = "train"
CONFIDENCE, IOU, IN_RANGE, PERFORMANCE = "_confidence", "_iou3d", "_in_range", "_performance"
SETS_RULE = (
    "tuned: what shapes and losses were fitted to, KITTI's train split and seven other frames with object labels; "
    "validation: all other frames, which decided between fits but entered none"
)
# Every second one by name of those that the first comparison had, written down so that no other choice of frames turns
# one that shapes were fitted to into one that judges them.
_TUNED_BESIDE = frozenset(("000001", "000006", "000192", "001985", "002613", "004016", "006542"))
_LONGEST_NAME = 255  # that of files, which frames are named after


_NUMBERS = {
    "label_line": Column("a whole number of 0 or more", 0.0, 1e9, whole=True),
    CONFIDENCE: Column("0 to 1", 0.0, 1.0),
    IOU: Column("0 to 1", 0.0, 1.0),
    IN_RANGE: Column("0 or 1", 0.0, 1.0, whole=True),
}
"""What columns hold numbers, by the ends of their names; all others hold texts."""


def _read_table(
    path: Path, columns: Callable[[list[str]], tuple[Iterable[str], Iterable[str]]], one_row_each: Sequence[str]
) -> dict[str, np.ndarray]:
    """Columns of a CSV file, (n,) each, and the ``line`` that each row stands in; no text is empty.

    Parameters
    ----------
    path : Path
    columns : callable
        Which columns are needed and which are read if they are there, by the names in the header.
    one_row_each : sequence of str
        Columns of which no two rows have the same values.

    Raises
    ------
    InputError, MissingFileError
        Naming the file, and the line or the column.
    """
    line, header = first_lines(path)[0]
    layout = TableLayout([printable(name, _LONGEST_NAME) for name in fields_of(header)], ",", line + 1)
    kinds = {
        name: next((of for end, of in _NUMBERS.items() if name.endswith(end)), None)
        for name in layout.check(*columns(layout.columns), str(path))
    }
    parts = [
        {"line": np.array(rows.lines)} | {name: _values(rows, name, of) for name, of in kinds.items()}
        for rows in read_rows(path, layout, {name: of for name, of in kinds.items() if of}, kinds)
    ]
    if not parts:
        raise InputError(f"{path}: has no row below its header")
    table, before = joined(parts), {}
    for line, *key in zip(*(table[name].tolist() for name in ("line", *one_row_each)), strict=True):
        if before.setdefault(tuple(key), line) != line:
            what = ", ".join(f"{name} {value}" for name, value in zip(one_row_each, key, strict=True))
            raise InputError(f"{path}:{line}: {what} is in line {before[tuple(key)]} already")
    return table


def _values(rows: Rows, name: str, column: Column | None) -> np.ndarray:
    """A column of rows as numbers, or as texts where it holds none."""
    if column is not None:
        found = rows.numbers(name, column)
        return found.astype(np.int64) if column.whole else found
    texts = [printable(text.strip(), _LONGEST_NAME) for text in rows.columns[name].tolist()]
    if "" in texts:
        raise InputError(f"{rows.where(texts.index(''))}: {name} is empty")
    return np.array(texts)


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """What detectors made of labelled cars.

    Attributes
    ----------
    path : Path
    table : dict of str to ndarray, (n,)
        Columns with a row for each car: ``line`` (where in the file it stands), ``frame``, ``label_line``, those of
        `FRAME_COLUMNS` that are told, and for each detector ``NAME_in_range`` (whether the car lies where the detector
        looks; others are no test of it) and ``NAME_performance``, confidence times IoU, the paper's `Performance`: 0 to
        1, 0 where the car was missed.
    detectors : tuple of str
        Their names, in the order of their columns.
    """

    path: Path
    table: dict[str, np.ndarray]
    detectors: tuple[str, ...]

    def frames(self, split: str | None = None) -> list[str]:
        """Names of the sweeps, sorted; of a split those that are told to be of it."""
        frame = self.table["frame"]
        if split is not None:
            frame = frame[self.table["split"] == split] if "split" in self.table else frame[:0]
        return np.unique(frame).tolist()


def read_detections(path: str | Path, frames_table: str | Path | None = None) -> Detections:
    """Read the table of cars, and what is known of their frames.

    Parameters
    ----------
    path : path
        The cars.
    frames_table : path, optional
        The frames; by default ``frames.csv`` beside the cars, where it is there.

    Raises
    ------
    InputError, MissingFileError
        Naming the file, and the line or the column.
    """
    path = Path(path)
    table = _read_table(path, _columns_of_cars, ("frame", "label_line"))
    detectors = _detectors(table)
    if frames_table is None and (path.parent / FRAMES_FILE).is_file():
        frames_table = path.parent / FRAMES_FILE
    if frames_table is not None:
        told = read_frames(Path(frames_table))
        for line, frame in zip(table["line"].tolist(), table["frame"].tolist(), strict=True):
            if frame not in told:
                raise InputError(f"{path}:{line}: frame {frame} has no row in {frames_table}")
        table |= told_of(table["frame"], told)
    for name in detectors:
        table[name + IN_RANGE] = table.get(name + IN_RANGE, np.ones(len(table["line"]))) > 0.0
        table[name + PERFORMANCE] = table.pop(name + CONFIDENCE) * table.pop(name + IOU)
    return Detections(path, table, detectors)


def _detectors(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(name.removesuffix(CONFIDENCE) for name in names if name.endswith(CONFIDENCE))


def _columns_of_cars(header: list[str]) -> tuple[list[str], list[str]]:
    detectors = _detectors(header) or ("NAME",)
    needed = ["frame", "label_line", *(name + what for name in detectors for what in (CONFIDENCE, IOU))]
    return needed, [*FRAME_COLUMNS, *(name + IN_RANGE for name in detectors)]


# --- What is told of frames -------------------------------------------------------------------------------------------


def read_frames(path: Path) -> dict[str, dict[str, str]]:
    """What a table tells of each frame, by its name: the texts of those of `FRAME_COLUMNS` that are there.

    Raises
    ------
    InputError, MissingFileError
        Naming the file, and the line or the column.
    """
    table = _read_table(path, lambda header: (["frame"], FRAME_COLUMNS), ("frame",))
    names = [name for name in FRAME_COLUMNS if name in table]
    return {frame: {name: str(table[name][row]) for name in names} for row, frame in enumerate(table["frame"].tolist())}


def told_of(frames: np.ndarray, told: Mapping[str, Mapping[str, str]]) -> dict[str, np.ndarray]:
    """What is told of frames (n,), by column, (n,) each; nothing where one of them is left out."""
    rows = [told.get(frame) for frame in frames.tolist()]
    return {} if None in rows else {name: np.array([row[name] for row in rows]) for name in rows[0]}


def tuned_frames(told: Mapping[str, Mapping[str, str]]) -> list[str] | None:
    """The frames that shapes and figures were fitted to, by `RULE`; None where no split is told."""
    split = {frame: row["split"] for frame, row in told.items() if "split" in row}
    return [frame for frame, part in split.items() if part == TRAINING or frame in _TUNED_BESIDE] if split else None
