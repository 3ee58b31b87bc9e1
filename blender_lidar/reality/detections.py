"""What detectors made of labelled cars: a table with a row for each car, and one with a row for each sweep.

The cars' columns are ``frame, label_line`` and, for every detector, ``NAME_confidence`` and ``NAME_iou3d`` of the
detection that overlaps the car most, both 0 where it was missed, and perhaps ``NAME_iou_bev`` and ``NAME_in_range``.
The frames' are ``frame`` and perhaps ``split, label_kind, drive``; the first two may also stand with the cars.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import InputError
from .frame_list import FRAMES_FILE
from .text_table import TextTable, listed

CONFIDENCE, IOU, IOU_BEV, IN_RANGE = "_confidence", "_iou3d", "_iou_bev", "_in_range"
FRAME_COLUMNS = ("split", "label_kind", "drive")


@dataclass(frozen=True, slots=True, eq=False)
class Detector:
    """One detector's part of the table, a value for each of its n rows.

    Attributes
    ----------
    name : str
    confidence, iou3d : ndarray, (n,)
        0 to 1; 0 where the car was missed.
    in_range : ndarray of bool, (n,)
        Whether the car lies where the detector looks; others are no test of it.
    """

    name: str
    confidence: np.ndarray
    iou3d: np.ndarray
    in_range: np.ndarray

    @property
    def performance(self) -> np.ndarray:
        """Confidence times IoU, (n,): the paper's `Performance`."""
        return self.confidence * self.iou3d

    def select(self, which: np.ndarray) -> Detector:
        """The rows that `which`, a (n,) mask or an index array, picks."""
        return Detector(self.name, self.confidence[which], self.iou3d[which], self.in_range[which])


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """The tables read.

    Attributes
    ----------
    path : Path
    line : ndarray of int64, (n,)
        Where in the file each row stands.
    frame : ndarray of str, (n,)
    label_line : ndarray of int64, (n,)
    detectors : tuple of Detector
        In the order of their columns.
    about : mapping of str to ndarray of str, (n,)
        Those of `FRAME_COLUMNS` that are told, for the frame of each row.
    """

    path: Path
    line: np.ndarray
    frame: np.ndarray
    label_line: np.ndarray
    detectors: tuple[Detector, ...]
    about: Mapping[str, np.ndarray]

    def select(self, which: np.ndarray) -> Detections:
        """The rows that `which`, a (n,) mask or an index array, picks."""
        return replace(
            self,
            line=self.line[which],
            frame=self.frame[which],
            label_line=self.label_line[which],
            detectors=tuple(one.select(which) for one in self.detectors),
            about={name: values[which] for name, values in self.about.items()},
        )


def read_detections(path: str | Path, frames_table: str | Path | None = None) -> Detections:
    """Read the cars, and what is known of their frames.

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
    table = TextTable(path)
    for name in ("frame", "label_line"):
        table.need(name)
    names = [name.removesuffix(CONFIDENCE) for name in table.header if name.endswith(CONFIDENCE) and name != CONFIDENCE]
    if not names:
        raise InputError(f"{path}: no column NAME{CONFIDENCE}; it has {listed(table.header)}")
    frame, label_line = table.texts("frame"), table.whole_numbers("label_line")
    seen: dict[tuple[str, int], int] = {}
    for line, car in zip(table.lines, zip(frame, label_line.tolist(), strict=True), strict=True):
        if car in seen:
            raise InputError(f"{path}:{line}: frame {car[0]}, label_line {car[1]} is in line {seen[car]} already")
        seen[car] = line
    about = {name: np.array(table.texts(name)) for name in FRAME_COLUMNS if name in table.header}
    if frames_table is None and (path.parent / FRAMES_FILE).is_file():
        frames_table = path.parent / FRAMES_FILE
    if frames_table is not None:
        about |= _about_frames(Path(frames_table), frame, path, table.lines)
    return Detections(
        path=path,
        line=np.array(table.lines),
        frame=np.array(frame),
        label_line=label_line,
        detectors=tuple(_detector(table, name) for name in names),
        about=about,
    )


def _detector(table: TextTable, name: str) -> Detector:
    table.need(name + IOU)
    if name + IOU_BEV in table.header:
        table.shares(name + IOU_BEV)  # is not used, but checked
    in_range = np.ones(len(table.lines), dtype=bool)
    if name + IN_RANGE in table.header:
        share = table.shares(name + IN_RANGE)
        for line, value in zip(table.lines, share.tolist(), strict=True):
            if value not in (0.0, 1.0):
                raise InputError(f"{table.path}:{line}: {name + IN_RANGE} is {value:g}; allowed: 0 or 1")
        in_range = share > 0.0
    return Detector(name, table.shares(name + CONFIDENCE), table.shares(name + IOU), in_range)


def _about_frames(path: Path, frame: list[str], cars: Path, lines: list[int]) -> dict[str, np.ndarray]:
    """What the table of frames tells, for each row of the cars."""
    table = TextTable(path)
    table.need("frame")
    row: dict[str, int] = {}
    for number, name in enumerate(table.texts("frame")):
        if name in row:
            raise InputError(f"{path}:{table.lines[number]}: frame {name} is in line {table.lines[row[name]]} already")
        row[name] = number
    for line, name in zip(lines, frame, strict=True):
        if name not in row:
            raise InputError(f"{cars}:{line}: frame {name} has no row in {path}")
    rows = [row[name] for name in frame]
    return {name: np.array(table.texts(name))[rows] for name in FRAME_COLUMNS if name in table.header}
