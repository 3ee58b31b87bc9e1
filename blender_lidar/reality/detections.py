"""What detectors made of labelled cars: a table with a row for each car, and one with a row for each sweep.

The cars' columns are ``frame, label_line`` and, for every detector, ``NAME_confidence`` and ``NAME_iou3d`` of the
detection that overlaps the car most, both 0 where it was missed, and perhaps ``NAME_iou_bev`` and ``NAME_in_range``.
The frames' are ``frame`` and perhaps ``split, label_kind, drive``; the first two may also stand with the cars.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import InputError, MissingFileError, printable, unknown_name

CONFIDENCE, IOU, IOU_BEV, IN_RANGE = "_confidence", "_iou3d", "_iou_bev", "_in_range"
FRAME_COLUMNS = ("split", "label_kind", "drive")
_LONGEST_NAME = 40


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
    table = _Table(path)
    for name in ("frame", "label_line"):
        table.need(name)
    names = [name.removesuffix(CONFIDENCE) for name in table.header if name.endswith(CONFIDENCE) and name != CONFIDENCE]
    if not names:
        raise InputError(f"{path}: no column NAME{CONFIDENCE}; it has {_listed(table.header)}")
    frame, label_line = table.texts("frame"), table.whole_numbers("label_line")
    seen: dict[tuple[str, int], int] = {}
    for line, car in zip(table.lines, zip(frame, label_line.tolist(), strict=True), strict=True):
        if car in seen:
            raise InputError(f"{path}:{line}: frame {car[0]}, label_line {car[1]} is in line {seen[car]} already")
        seen[car] = line
    about = {name: np.array(table.texts(name)) for name in FRAME_COLUMNS if name in table.header}
    if frames_table is None and (path.parent / "frames.csv").is_file():
        frames_table = path.parent / "frames.csv"
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


def _detector(table: _Table, name: str) -> Detector:
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
    table = _Table(path)
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


class _Table:
    """A CSV file as texts, column by column, with the line of each row."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            with path.open(encoding="utf-8-sig", errors="replace", newline="") as stream:
                reader = csv.reader(stream)
                header = [printable(name.strip(), _LONGEST_NAME) for name in next(reader, [])]
                rows = [(reader.line_num, row) for row in reader if any(text.strip() for text in row)]
        except FileNotFoundError as error:
            raise MissingFileError(f"{path}: there is no such file") from error
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
        except csv.Error as error:
            raise InputError(f"{path}: is no table ({error})") from error
        twice = [name for number, name in enumerate(header) if name in header[:number]]
        if twice:
            raise InputError(f"{path}: has two columns {twice[0]!r}")
        if not rows:
            raise InputError(f"{path}: has no row below its header")
        for line, row in rows:
            if len(row) != len(header):
                raise InputError(f"{path}:{line}: {len(row)} fields; the header has {len(header)}")
        self.header = header
        self.lines = [line for line, _ in rows]
        self._columns = dict(zip(header, zip(*(row for _, row in rows), strict=True), strict=True))

    def need(self, name: str) -> None:
        """Refuse a table without that column."""
        if name not in self.header:
            raise unknown_column(name, self.header, str(self.path))

    def texts(self, name: str) -> list[str]:
        """A column of names, none of them empty."""
        texts = [printable(text.strip(), _LONGEST_NAME) for text in self._columns[name]]
        for line, text in zip(self.lines, texts, strict=True):
            if not text:
                raise InputError(f"{self.path}:{line}: {name} is empty")
        return texts

    def whole_numbers(self, name: str) -> np.ndarray:
        """A column of numbers from 0 on that count something."""
        found = []
        for line, text in zip(self.lines, self.texts(name), strict=True):
            if not (text.isascii() and text.isdigit() and len(text) < 10):
                raise InputError(f"{self.path}:{line}: {name} is {text!r}; allowed: a whole number of 0 or more")
            found.append(int(text))
        return np.array(found, dtype=np.int64)

    def shares(self, name: str) -> np.ndarray:
        """A column of numbers from 0 to 1."""
        found = []
        for line, text in zip(self.lines, self.texts(name), strict=True):
            try:
                value = float(text)
            except ValueError:
                value = np.nan
            if not 0.0 <= value <= 1.0:
                raise InputError(f"{self.path}:{line}: {name} is {text!r}; allowed: 0 to 1")
            found.append(value)
        return np.array(found)


def unknown_column(name: str, header: list[str], where: str) -> InputError:
    """An error for a column that is not there, with the nearest one that is."""
    known = unknown_name(name, header, "column")
    _, _, hint = str(known).partition("; ")
    near = hint.partition("? ")[0] + "? " if hint.startswith("did you mean") else ""
    return InputError(f"{where}: has no column {name!r}; {near}it has {_listed(header)}")


def _listed(header: list[str]) -> str:
    return ", ".join(header) or "none"
