"""What a metric can learn from a scene: its traffic as boxes, its beams, and from where they look.

Beams and places follow the package's conventions: points are ``origin + distance * (directions @ rotation)``, in the
road frame, as are the boxes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True, eq=False)
class FrameBoxes:
    """All vehicles of one frame: those that count and those that only hide them.

    Attributes
    ----------
    frame : int
        Its number in the recording.
    centre_m : ndarray, (v, 3)
        Box centres [m].
    size_m : ndarray, (v, 3)
        Length, width and height [m].
    heading_rad : ndarray, (v,)
        Counter-clockwise from +x [rad].
    counted : ndarray of bool, (v,)
        Those that are scored: their rows, in this order, are the n rows that a metric is given under one mounting.
    """

    frame: int
    centre_m: np.ndarray
    size_m: np.ndarray
    heading_rad: np.ndarray
    counted: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Mountings:
    """Where s LiDARs of one model hang, each alone.

    One object serves all frames that are scored under the same mountings: what depends on these alone can be kept for
    as long as the same object comes again.

    Attributes
    ----------
    origin_m : ndarray, (s, 3)
        Optical centres [m].
    rotation : ndarray, (s, 3, 3)
        Turns rows of directions from the sensor's frame into the road frame: ``directions @ rotation``.
    """

    origin_m: np.ndarray
    rotation: np.ndarray

    def __len__(self) -> int:
        return len(self.origin_m)


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One frame's counted vehicles under s mountings: rows of a metric, mounting after mounting.

    Attributes
    ----------
    mountings : Mountings
        From where they are looked at.
    boxes : FrameBoxes
        The frame.
    """

    mountings: Mountings
    boxes: FrameBoxes

    def to_rows(self, value: np.ndarray) -> np.ndarray:
        """A value of each mounting (s,), for a metric of a whole scene, as the value of each of its vehicles (s n,)."""
        return np.repeat(value, np.count_nonzero(self.boxes.counted))


@dataclass(frozen=True, slots=True)
class Field:
    """The part of the carriageway that a LiDAR is asked to see, the same for every mounting.

    Attributes
    ----------
    centre_xy_m : tuple of float
        Middle of the region whose vehicles count [m].
    radius_m : float
        Its radius [m].
    y_m : tuple of float
        The carriageway's right and left edge [m].
    """

    centre_xy_m: tuple[float, float]
    radius_m: float
    y_m: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class SceneContext:
    """What a metric learns from before it scores anything.

    Attributes
    ----------
    frames : tuple of FrameBoxes
        The frames that it will score: the searched ones, or those held out, never both, so that what chose a mounting
        does not judge it.
    directions : ndarray, (rings, columns, 3)
        Beams of one revolution in the sensor's frame, unit vectors, those of each ring in the order of their azimuth.
    min_range_m, max_range_m : float
        Returns from nearer or farther away are lost [m].
    field : Field
        Where to look.
    """

    frames: tuple[FrameBoxes, ...]
    directions: np.ndarray
    min_range_m: float
    max_range_m: float
    field: Field
