"""CSV tables beside labelled sweeps: what detectors made of each car, and what is told of each frame.

The cars' columns are ``frame, label_line`` and, for every detector, ``NAME_confidence`` and ``NAME_iou3d`` of the
detection that overlaps the car most, both 0 where it was missed, and perhaps ``NAME_in_range``.
The frames' are ``frame`` and perhaps ``split, label_kind, drive``; these may also stand with the cars.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from io import StringIO
from pathlib import Path

import numpy as np

from ...errors import InputError, printable
from .labelled import read_content

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
    """A CSV file as texts, column by column, with the line of each row; what it refuses names the file and the line."""

    def __init__(self, path: Path) -> None:
        self.path = path
        text = read_content(path).decode("utf-8-sig", errors="replace")
        try:
            reader = csv.reader(StringIO(text, newline=""))
            self.header = [printable(name.strip(), _LONGEST_NAME) for name in next(reader, [])]
            rows = [(reader.line_num, row) for row in reader if any(map(str.strip, row))]
        except csv.Error as error:
            raise InputError(f"{path}: is no table ({error})") from error
        twice = [name for name, count in Counter(self.header).items() if count > 1]
        if twice:
            raise InputError(f"{path}: has two columns {twice[0]!r}")
        if not rows:
            raise InputError(f"{path}: has no row below its header")
        for line, row in rows:
            if len(row) != len(self.header):
                raise InputError(f"{path}:{line}: {len(row)} fields; the header has {len(self.header)}")
        self.lines = [line for line, _ in rows]
        self._columns = dict(zip(self.header, zip(*(row for _, row in rows), strict=True), strict=True))

    def column(self, name: str, value: Callable[[str], object] = str, allowed: str = "") -> np.ndarray:
        """A column without empty fields, (n,); `value` makes numbers of texts and raises ValueError for others."""
        if name not in self.header:
            near = get_close_matches(name, self.header, n=1, cutoff=0.5)
            hint = f"did you mean {near[0]!r}? " if near else ""
            raise InputError(f"{self.path}: has no column {name!r}; {hint}it has {', '.join(self.header)}")
        found = []
        for line, field in zip(self.lines, self._columns[name], strict=True):
            text = printable(field.strip(), _LONGEST_NAME)
            if not text:
                raise InputError(f"{self.path}:{line}: {name} is empty")
            try:
                found.append(value(text))
            except ValueError:
                raise InputError(f"{self.path}:{line}: {name} is {text!r}; allowed: {allowed}") from None
        return np.array(found)

    def shares(self, name: str) -> np.ndarray:
        """A column of numbers from 0 to 1, (n,)."""
        return self.column(name, _share, "0 to 1")

    def check_one_row_each(self, **columns: np.ndarray) -> None:
        """Refuse a table two rows of which have the same values in some columns."""
        before: dict[tuple, int] = {}
        for line, *key in zip(self.lines, *(values.tolist() for values in columns.values()), strict=True):
            if tuple(key) in before:
                what = ", ".join(f"{name} {value}" for name, value in zip(columns, key, strict=True))
                raise InputError(f"{self.path}:{line}: {what} is in line {before[tuple(key)]} already")
            before[tuple(key)] = line


def _count(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise ValueError(text)
    return int(text)


def _share(text: str) -> float:
    share = float(text)
    if "_" in text or not 0.0 <= share <= 1.0:  # "0_1" is 1 to Python alone
        raise ValueError(text)
    return share


def _flag(text: str) -> bool:
    if _share(text) % 1.0:
        raise ValueError(text)
    return _share(text) > 0.0


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
    table = _Table(path)
    lines = table.column("label_line", _count, "a whole number of 0 or more")
    cars = {"frame": table.column("frame"), "label_line": lines}
    detectors = [name.removesuffix(CONFIDENCE) for name in table.header if name.endswith(CONFIDENCE)]
    if not detectors:
        raise InputError(f"{path}: no column NAME{CONFIDENCE}; it has {', '.join(table.header)}")
    table.check_one_row_each(**cars)
    about = {name: table.column(name) for name in FRAME_COLUMNS if name in table.header}
    if frames_table is None and (path.parent / FRAMES_FILE).is_file():
        frames_table = path.parent / FRAMES_FILE
    if frames_table is not None:
        told = read_frames(Path(frames_table))
        for line, frame in zip(table.lines, cars["frame"].tolist(), strict=True):
            if frame not in told:
                raise InputError(f"{path}:{line}: frame {frame} has no row in {frames_table}")
        about |= told_of(cars["frame"], told)
    columns = {"line": np.array(table.lines), **cars, **about}
    for name in detectors:
        everywhere = np.ones(len(table.lines), dtype=bool)
        looks = name + IN_RANGE in table.header
        columns[name + IN_RANGE] = table.column(name + IN_RANGE, _flag, "0 or 1") if looks else everywhere
        columns[name + PERFORMANCE] = table.shares(name + CONFIDENCE) * table.shares(name + IOU)
    return Detections(path, columns, tuple(detectors))


# --- What is told of frames -------------------------------------------------------------------------------------------


def read_frames(path: Path) -> dict[str, dict[str, str]]:
    """What a table tells of each frame, by its name: the texts of those of `FRAME_COLUMNS` that are there.

    Raises
    ------
    InputError, MissingFileError
        Naming the file, and the line or the column.
    """
    table = _Table(path)
    frames = table.column("frame")
    table.check_one_row_each(frame=frames)
    columns = {name: table.column(name).tolist() for name in FRAME_COLUMNS if name in table.header}
    return {
        frame: dict(zip(columns, texts, strict=True))
        for frame, *texts in zip(frames.tolist(), *columns.values(), strict=True)
    }


def told_of(frames: np.ndarray, told: Mapping[str, Mapping[str, str]]) -> dict[str, np.ndarray]:
    """What is told of frames (n,), by column, (n,) each; nothing where one of them is left out."""
    rows = [told.get(frame) for frame in frames.tolist()]
    return {} if None in rows else {name: np.array([row[name] for row in rows]) for name in rows[0]}


def tuned_frames(told: Mapping[str, Mapping[str, str]]) -> list[str] | None:
    """The frames that shapes and figures were fitted to, by `RULE`; None where no split is told."""
    split = {frame: row["split"] for frame, row in told.items() if "split" in row}
    return [frame for frame, part in split.items() if part == TRAINING or frame in _TUNED_BESIDE] if split else None
