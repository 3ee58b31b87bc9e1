"""CSV tables beside labelled sweeps: what detectors made of each car, and what is told of each frame.

The cars' columns are ``frame, label_line`` and, for every detector, ``NAME_confidence`` and ``NAME_iou3d`` of the
detection that overlaps the car most, both 0 where it was missed, and perhaps ``NAME_iou_bev`` and ``NAME_in_range``.
The frames' are ``frame`` and perhaps ``split, label_kind, drive``; these may also stand with the cars.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Mapping
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
CONFIDENCE, IOU, IOU_BEV, IN_RANGE = "_confidence", "_iou3d", "_iou_bev", "_in_range"
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
            rows = [(reader.line_num, row) for row in reader if any(text.strip() for text in row)]
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

    def texts(self, name: str) -> np.ndarray:
        """A column of names, none of them empty, (n,)."""
        if name not in self.header:
            near = get_close_matches(name, self.header, n=1, cutoff=0.5)
            hint = f"did you mean {near[0]!r}? " if near else ""
            raise InputError(f"{self.path}: has no column {name!r}; {hint}it has {', '.join(self.header)}")
        texts = [printable(text.strip(), _LONGEST_NAME) for text in self._columns[name]]
        for line, text in zip(self.lines, texts, strict=True):
            if not text:
                raise InputError(f"{self.path}:{line}: {name} is empty")
        return np.array(texts)

    def whole_numbers(self, name: str) -> np.ndarray:
        """A column of numbers from 0 on that count something, (n,)."""
        texts = self.texts(name).tolist()
        for line, text in zip(self.lines, texts, strict=True):
            if not (text.isascii() and text.isdigit() and len(text) < 10):
                raise InputError(f"{self.path}:{line}: {name} is {text!r}; allowed: a whole number of 0 or more")
        return np.array(texts, dtype=np.int64)

    def shares(self, name: str) -> np.ndarray:
        """A column of numbers from 0 to 1, (n,)."""
        found = []
        for line, text in zip(self.lines, self.texts(name).tolist(), strict=True):
            try:
                found.append(np.nan if "_" in text else float(text))  # "0_1" is 1 to Python alone
            except ValueError:
                found.append(np.nan)
            if not 0.0 <= found[-1] <= 1.0:
                raise InputError(f"{self.path}:{line}: {name} is {text!r}; allowed: 0 to 1")
        return np.array(found)

    def rows_by(self, **columns: np.ndarray) -> dict[tuple, int]:
        """Row by the values of some columns, of which there is one row alone."""
        row: dict[tuple, int] = {}
        for number, key in enumerate(zip(*(values.tolist() for values in columns.values()), strict=True)):
            if key in row:
                what = ", ".join(f"{name} {value}" for name, value in zip(columns, key, strict=True))
                raise InputError(f"{self.path}:{self.lines[number]}: {what} is in line {self.lines[row[key]]} already")
            row[key] = number
        return row


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """What detectors made of labelled cars.

    Attributes
    ----------
    path : Path
    table : dict of str to ndarray, (n,)
        Columns with a row for each car: ``line`` (where in the file it stands), ``frame``, ``label_line``, those of
        `about`, and for each detector ``NAME_in_range`` (whether the car lies where the detector looks; others are no
        test of it) and ``NAME_performance``, confidence times IoU, the paper's `Performance`: 0 to 1, 0 where the car
        was missed.
    detectors : tuple of str
        Their names, in the order of their columns.
    about : tuple of str
        Those of `FRAME_COLUMNS` that are told.
    """

    path: Path
    table: dict[str, np.ndarray]
    detectors: tuple[str, ...]
    about: tuple[str, ...]

    def frames(self, split: str | None = None) -> tuple[str, ...]:
        """Names of the sweeps, sorted; of a split those that are told to be of it."""
        if split is not None and "split" not in self.about:
            return ()
        of_all = self.table["frame"]
        return tuple(np.unique(of_all if split is None else of_all[self.table["split"] == split]).tolist())


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
    cars = {"frame": table.texts("frame"), "label_line": table.whole_numbers("label_line")}
    names = [name.removesuffix(CONFIDENCE) for name in table.header if name.endswith(CONFIDENCE) and name != CONFIDENCE]
    if not names:
        raise InputError(f"{path}: no column NAME{CONFIDENCE}; it has {', '.join(table.header)}")
    table.rows_by(**cars)
    about = {name: table.texts(name) for name in FRAME_COLUMNS if name in table.header}
    if frames_table is None and (path.parent / FRAMES_FILE).is_file():
        frames_table = path.parent / FRAMES_FILE
    if frames_table is not None:
        of_frames = _Table(Path(frames_table))
        row = of_frames.rows_by(frame=of_frames.texts("frame"))
        for line, name in zip(table.lines, cars["frame"].tolist(), strict=True):
            if (name,) not in row:
                raise InputError(f"{path}:{line}: frame {name} has no row in {frames_table}")
        rows = [row[name,] for name in cars["frame"].tolist()]
        about |= {name: of_frames.texts(name)[rows] for name in FRAME_COLUMNS if name in of_frames.header}
    columns = {"line": np.array(table.lines), **cars, **about}
    for name in names:
        columns |= {f"{name}_in_range": _in_range(table, name + IN_RANGE)}
        columns |= {f"{name}_performance": table.shares(name + CONFIDENCE) * table.shares(name + IOU)}
        if name + IOU_BEV in table.header:
            table.shares(name + IOU_BEV)  # is not used, but checked
    return Detections(path, columns, tuple(names), tuple(about))


def _in_range(table: _Table, name: str) -> np.ndarray:
    if name not in table.header:
        return np.ones(len(table.lines), dtype=bool)
    share = table.shares(name)
    for row in np.flatnonzero(share % 1.0):
        raise InputError(f"{table.path}:{table.lines[row]}: {name} is {share[row]:g}; allowed: 0 or 1")
    return share > 0.0


@dataclass(frozen=True, slots=True, eq=False)
class FrameList:
    """What a folder's ``frames.csv`` tells of its sweeps.

    Attributes
    ----------
    tuned : frozenset of str or None
        Those that shapes and figures were fitted to, by `RULE`; None where no split is told.
    about : mapping of str to mapping of str to str
        Of the columns ``label_kind`` and ``drive`` that are there, the text of each sweep.
    """

    tuned: frozenset[str] | None
    about: Mapping[str, Mapping[str, str]]

    def of(self, frames: np.ndarray) -> dict[str, np.ndarray]:
        """What is told of each of the frames (n,), by column; a column that leaves one of them out tells nothing."""
        names = frames.tolist()
        return {
            column: np.array([told[name] for name in names], dtype=str)
            for column, told in self.about.items()
            if all(name in told for name in names)
        }


def read_frame_list(folder: Path) -> FrameList:
    """The list of a folder of sweeps; one that tells nothing where there is none.

    Raises
    ------
    InputError
        If that file cannot be used, naming its line or column.
    """
    if not (folder / FRAMES_FILE).is_file():
        return FrameList(None, {})
    table = _Table(folder / FRAMES_FILE)
    frames = table.texts("frame").tolist()
    about = {
        name: dict(zip(frames, table.texts(name).tolist(), strict=True))
        for name in FRAME_COLUMNS
        if name in table.header
    }
    split = about.pop("split", None)
    train = {frame for frame, part in (split or {}).items() if part == TRAINING}
    return FrameList(None if split is None else frozenset(train | _TUNED_BESIDE.intersection(frames)), about)
