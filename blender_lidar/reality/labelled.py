"""Labelled point clouds of real LiDARs: sweeps, and the boxes that people drew around what is in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

NOT_TOLD = -1


@dataclass(frozen=True, slots=True, eq=False)
class LabelledBoxes:
    """The boxes of one sweep.

    Attributes
    ----------
    label_line : ndarray of int64, (n,)
        Which entry of the label file each is, counted from 0.
    label : ndarray of str, (n,)
        What each is, in the data set's own words: ``"Car"``, ``"Van"``, ``"Pedestrian"``.
    centre_m, size_m : ndarray, (n, 3)
        Box centres; length, width and height [m, sensor frame].
    heading_rad : ndarray, (n,)
        Counter-clockwise from +x [rad].
    occlusion : ndarray of int8, (n,)
        KITTI's: 0 wholly visible, 1 partly, 2 largely hidden, 3 unknown; `NOT_TOLD` where the layout has none.
    truncation : ndarray, (n,)
        Share that lies outside the camera's picture; NaN where the layout has none.
    """

    label_line: np.ndarray
    label: np.ndarray
    centre_m: np.ndarray
    size_m: np.ndarray
    heading_rad: np.ndarray
    occlusion: np.ndarray
    truncation: np.ndarray

    def __len__(self) -> int:
        return len(self.label)

    @property
    def distance_m(self) -> np.ndarray:
        """Horizontal distance of each box centre from the sensor, (n,) [m]."""
        return np.hypot(self.centre_m[:, 0], self.centre_m[:, 1])

    @classmethod
    def joined(cls, parts: Sequence[LabelledBoxes]) -> LabelledBoxes:
        """The boxes of one or more sweeps in a row."""
        columns = {field.name: [getattr(part, field.name) for part in parts] for field in fields(cls)}
        return cls(**{name: np.concatenate(values) for name, values in columns.items()})

    def select(self, which: np.ndarray) -> LabelledBoxes:
        """The boxes that `which`, a (n,) mask or an index array, picks."""
        return replace(self, **{field.name: getattr(self, field.name)[which] for field in fields(self)})


@dataclass(frozen=True, slots=True, eq=False)
class LabelledSweep:
    """One revolution of a real LiDAR.

    Attributes
    ----------
    frame : str
        Its name: that of its files, without a suffix.
    points : ndarray, (n, 3)
        Returns in the sensor's own, levelled frame: origin at its optical centre, z up; in the order of the file [m].
    boxes : LabelledBoxes
        What is in it.
    """

    frame: str
    points: np.ndarray
    boxes: LabelledBoxes


@dataclass(frozen=True, slots=True)
class LabelledClouds:
    """A folder of labelled sweeps, read one at a time.

    Attributes
    ----------
    folder : Path
    layout : str
        ``"KITTI"`` or ``"SUSTechPOINTS"``.
    frames : tuple of str
        Names of the sweeps that have both a cloud and labels, sorted.
    unpaired : int
        Files left aside because their partner is missing.
    reader : callable
        Reads the sweep of a name.
    """

    folder: Path
    layout: str
    frames: tuple[str, ...]
    unpaired: int
    reader: Callable[[str], LabelledSweep]

    def __len__(self) -> int:
        return len(self.frames)

    def read(self, frame: str) -> LabelledSweep:
        """One sweep.

        Raises
        ------
        InputError, MissingFileError
            Naming the file, and the line where there is one.
        """
        return self.reader(frame)
