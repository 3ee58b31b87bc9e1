"""CSV tables beside labelled sweeps: what detectors made of each car, and what is told of each frame.

The cars' columns are ``frame, label_line`` and, for every detector, ``NAME_confidence`` and ``NAME_iou3d`` of the
detection that overlaps the car most, both 0 where it was missed, and perhaps ``NAME_in_range``.
The frames' are ``frame`` and perhaps ``split, label_kind, drive``; these may also stand with the cars.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import InputError, printable
from ...traffic.source import Layout, fields_of, first_lines, numbers, read_rows

FRAMES_FILE = "frames.csv"
FRAME_COLUMNS = ("split", "label_kind", "drive")
TRAINING = "train"
CONFIDENCE, IOU, IN_RANGE, PERFORMANCE = "_confidence", "_iou3d", "_in_range", "_performance"
RULE = (
    "tuned: what shapes and losses were fitted to, KITTI's train split and seven other frames with object labels; "
    "validation: all other frames, which decided between fits but entered none"
)
# Every second one by name of those that the first comparison had, written down so that no other choice of frames turns
# one that shapes were fitted to into one that judges them.
_TUNED_BESIDE = frozenset(("000001", "000006", "000192", "001985", "002613", "004016", "006542"))
_LONGEST_NAME = 255  # that of files, which frames are named after


class _Table:
    """Columns of a CSV file as texts, none of them empty; what it refuses names the file and the line.

    Parameters
    ----------
    path : Path
    columns : callable
        Which columns are needed and which are read if they are there, by the names in the header.
    """

    def __init__(self, path: Path, columns: Callable[[list[str]], tuple[Iterable[str], Iterable[str]]]) -> None:
        line, header = first_lines(path)[0]
        layout = Layout([printable(name, _LONGEST_NAME) for name in fields_of(header)], ",", line + 1)
        used = layout.check(*columns(layout.columns), str(path))
        self.path, self.lines, self.texts = path, [], {name: [] for name in used}
        for rows in read_rows(path, layout, {}, used):
            self.lines += rows.lines
            for name in used:
                self.texts[name] += [printable(text.strip(), _LONGEST_NAME) for text in rows.columns[name].tolist()]
        if not self.lines:
            raise InputError(f"{path}: has no row below its header")
        for name, texts in self.texts.items():
            if "" in texts:
                raise InputError(f"{path}:{self.lines[texts.index('')]}: {name} is empty")

    def shares(self, name: str, allowed: str = "0 to 1", most: float = 1.0, *, whole: bool = False) -> np.ndarray:
        """A column of numbers from 0 to 1, or to another limit, (n,)."""
        values = numbers(np.array(self.texts[name], dtype=object))
        fits = (values >= 0.0) & (values <= most) & ((values == np.floor(values)) | (not whole))
        for row in np.flatnonzero(~fits):
            raise InputError(f"{self.path}:{self.lines[row]}: {name} is {self.texts[name][row]!r}; allowed: {allowed}")
        return values

    def whole_numbers(self, name: str) -> np.ndarray:
        """A column of numbers from 0 on that count something, (n,)."""
        return self.shares(name, "a whole number of 0 or more", 1e9, whole=True).astype(np.int64)

    def flags(self, name: str) -> np.ndarray:
        """A column of 0 and 1, (n,) bool."""
        return self.shares(name, "0 or 1", whole=True) > 0.0

    def check_one_row_each(self, **columns: np.ndarray) -> None:
        """Refuse a table two rows of which have the same values in some columns."""
        before: dict[tuple, int] = {}
        for line, *key in zip(self.lines, *(values.tolist() for values in columns.values()), strict=True):
            if before.setdefault(tuple(key), line) != line:
                what = ", ".join(f"{name} {value}" for name, value in zip(columns, key, strict=True))
                raise InputError(f"{self.path}:{line}: {what} is in line {before[tuple(key)]} already")


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
    table = _Table(path, _columns_of_cars)
    frames, entry = np.array(table.texts["frame"]), table.whole_numbers("label_line")
    table.check_one_row_each(frame=frames, label_line=entry)
    about = {name: np.array(table.texts[name]) for name in FRAME_COLUMNS if name in table.texts}
    if frames_table is None and (path.parent / FRAMES_FILE).is_file():
        frames_table = path.parent / FRAMES_FILE
    if frames_table is not None:
        told = read_frames(Path(frames_table))
        for line, frame in zip(table.lines, table.texts["frame"], strict=True):
            if frame not in told:
                raise InputError(f"{path}:{line}: frame {frame} has no row in {frames_table}")
        about |= told_of(frames, told)
    columns = {"line": np.array(table.lines), "frame": frames, "label_line": entry, **about}
    detectors = _detectors(table.texts)
    for name in detectors:
        told = name + IN_RANGE in table.texts
        columns[name + IN_RANGE] = table.flags(name + IN_RANGE) if told else np.ones(len(frames), dtype=bool)
        columns[name + PERFORMANCE] = table.shares(name + CONFIDENCE) * table.shares(name + IOU)
    return Detections(path, columns, detectors)


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
    table = _Table(path, lambda header: (["frame"], FRAME_COLUMNS))
    table.check_one_row_each(frame=np.array(table.texts["frame"]))
    rows = (dict(zip(table.texts, texts, strict=True)) for texts in zip(*table.texts.values(), strict=True))
    return {row.pop("frame"): row for row in rows}


def told_of(frames: np.ndarray, told: Mapping[str, Mapping[str, str]]) -> dict[str, np.ndarray]:
    """What is told of frames (n,), by column, (n,) each; nothing where one of them is left out."""
    rows = [told.get(frame) for frame in frames.tolist()]
    return {} if None in rows else {name: np.array([row[name] for row in rows]) for name in rows[0]}


def tuned_frames(told: Mapping[str, Mapping[str, str]]) -> list[str] | None:
    """The frames that shapes and figures were fitted to, by `RULE`; None where no split is told."""
    split = {frame: row["split"] for frame, row in told.items() if "split" in row}
    return [frame for frame, part in split.items() if part == TRAINING or frame in _TUNED_BESIDE] if split else None
