"""The traffic as the rest of the package sees it: boxes in the road frame, by frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..errors import InputError
from .report import RepairReport

CLASSES = ("car", "van", "truck", "bus", "motorcycle")
"""Vehicle classes; `class_index` counts into them. A van is any car longer than 4.9 m: van, SUV or pick-up."""


@dataclass(frozen=True, slots=True, eq=False)
class Vehicles:
    """The vehicles of one frame.

    Attributes
    ----------
    frame : int
        Frame number, as the recording counts them.
    time_s : float
        Time of the frame [s], from the recording's own zero.
    vehicle_id : ndarray, (n,) int64
    class_index : ndarray, (n,) int8
        Index into `CLASSES`.
    centre_m : ndarray, (n, 3) float64
        Box centres [m, road frame].
    size_m : ndarray, (n, 3) float64
        Length, width and height [m].
    heading_rad : ndarray, (n,) float64
        Counter-clockwise from +x [rad].
    lane : ndarray, (n,) int16
        Lane number of the source; 0 where unknown.
    """

    frame: int
    time_s: float
    vehicle_id: np.ndarray
    class_index: np.ndarray
    centre_m: np.ndarray
    size_m: np.ndarray
    heading_rad: np.ndarray
    lane: np.ndarray

    def __len__(self) -> int:
        return len(self.vehicle_id)

    @property
    def class_name(self) -> np.ndarray:
        """Class names, (n,) str."""
        return np.array(CLASSES)[self.class_index]

    def select(self, which: np.ndarray) -> Vehicles:
        """The same frame with the vehicles that `which`, a (n,) mask or an index array, picks."""
        return replace(
            self,
            vehicle_id=self.vehicle_id[which],
            class_index=self.class_index[which],
            centre_m=self.centre_m[which],
            size_m=self.size_m[which],
            heading_rad=self.heading_rad[which],
            lane=self.lane[which],
        )


@dataclass(frozen=True, eq=False)
class Recording:
    """A whole recording: one row per vehicle and frame, sorted by (frame, vehicle_id). Its arrays are read-only.

    Attributes
    ----------
    frame : ndarray, (n,) int64
        Frame number of every row; the other columns are those of `Vehicles`.
    frames : ndarray, (k,) int64
        The distinct frame numbers, ascending.
    frame_time_s : ndarray, (k,) float64
        Their times [s].
    time_step_s : float
        Time between consecutive frame numbers [s].
    source : str
        Where it came from, for messages.
    report : RepairReport
        What reading it repaired.
    """

    frame: np.ndarray
    vehicle_id: np.ndarray
    class_index: np.ndarray
    centre_m: np.ndarray
    size_m: np.ndarray
    heading_rad: np.ndarray
    lane: np.ndarray
    frames: np.ndarray
    frame_time_s: np.ndarray
    time_step_s: float
    source: str
    report: RepairReport

    @classmethod
    def from_rows(
        cls,
        *,
        frame: np.ndarray,
        time_s: np.ndarray,
        vehicle_id: np.ndarray,
        class_index: np.ndarray,
        centre_m: np.ndarray,
        size_m: np.ndarray,
        heading_rad: np.ndarray,
        lane: np.ndarray,
        time_step_s: float,
        source: str,
        report: RepairReport,
    ) -> Recording:
        """Build one from rows in any order, (n,) or (n, 3) each; `time_s` is every row's time [s]."""
        order = np.lexsort((vehicle_id, frame))
        frame = np.asarray(frame, dtype=np.int64)[order]
        frames, first = np.unique(frame, return_index=True)
        columns = {
            "frame": frame,
            "vehicle_id": np.asarray(vehicle_id, dtype=np.int64)[order],
            "class_index": np.asarray(class_index, dtype=np.int8)[order],
            "centre_m": np.asarray(centre_m, dtype=np.float64)[order],
            "size_m": np.asarray(size_m, dtype=np.float64)[order],
            "heading_rad": np.asarray(heading_rad, dtype=np.float64)[order],
            "lane": np.asarray(lane, dtype=np.int16)[order],
            "frames": frames,
            "frame_time_s": np.asarray(time_s, dtype=np.float64)[order[first]],
        }
        for column in columns.values():
            column.flags.writeable = False
        return cls(**columns, time_step_s=float(time_step_s), source=source, report=report)

    def where(self, which: np.ndarray) -> Recording:
        """The same recording with the rows that `which`, a (n,) mask, picks; frames left without one disappear.

        Raises
        ------
        InputError
            When no row is left.
        """
        if not which.any():
            raise InputError(f"{self.source}: no vehicle is left of {len(self)} boxes")
        names = ("frame", "vehicle_id", "class_index", "centre_m", "size_m", "heading_rad", "lane")
        return Recording.from_rows(
            **{name: getattr(self, name)[which] for name in names},
            time_s=self.frame_time_s[np.searchsorted(self.frames, self.frame[which])],
            time_step_s=self.time_step_s,
            source=self.source,
            report=self.report,
        )

    def __len__(self) -> int:
        """Rows: boxes over all frames."""
        return len(self.frame)

    @cached_property
    def _bounds(self) -> np.ndarray:
        """Row at which each frame starts, and the number of rows at the end: (k + 1,) int64."""
        return np.append(np.searchsorted(self.frame, self.frames), len(self.frame))

    @cached_property
    def counts(self) -> np.ndarray:
        """Vehicles in each of `frames`, (k,) int64."""
        return np.diff(self._bounds)

    def vehicles(self, frame: int) -> Vehicles:
        """The vehicles of one frame, as views into the recording.

        Raises
        ------
        InputError
            For a frame that the recording does not have.
        """
        at = int(np.searchsorted(self.frames, frame))
        if at == len(self.frames) or self.frames[at] != frame:
            raise unknown_frame(frame, self)
        rows = slice(self._bounds[at], self._bounds[at + 1])
        return Vehicles(
            frame=int(frame),
            time_s=float(self.frame_time_s[at]),
            vehicle_id=self.vehicle_id[rows],
            class_index=self.class_index[rows],
            centre_m=self.centre_m[rows],
            size_m=self.size_m[rows],
            heading_rad=self.heading_rad[rows],
            lane=self.lane[rows],
        )


def unknown_frame(frame: object, recording: Recording) -> InputError:
    """The error for a frame number that `recording` does not have."""
    frames = recording.frames
    return InputError(
        f"{recording.source}: no frame {frame}; the recording has {len(frames)} frames from {frames[0]} to {frames[-1]}"
    )
