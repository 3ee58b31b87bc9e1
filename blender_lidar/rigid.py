"""Rigid transform: where one frame lies in another. Rows times matrices, as everywhere."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True, eq=False)
class Rigid:
    """Rigid transform between two frames, by a rotation and one place that is known in both.

    It is called by both, ``T_site_recording``: ``T_site_recording.points(p)`` takes places of the recording to the
    site, and ``T_site_map @ T_map_sensor`` is ``T_site_sensor``. Places are taken off before they are turned, so that
    coordinates of projected maps, of millions of metres, lose nothing.

    Attributes
    ----------
    rotation : ndarray, (3, 3)
        Axes of the frame that is left, in the other one, a row each: ``direction @ rotation``.
    from_m, to_m : ndarray, (3,)
        The place in the frame that is left, and in the other one [m].
    """

    rotation: np.ndarray
    from_m: np.ndarray
    to_m: np.ndarray

    @classmethod
    def about_z(cls, angle_rad: float, origin_m: Sequence[float]) -> Rigid:
        """From a frame whose x axis lies at an angle in the other one, counter-clockwise [rad], and its origin, x and y
        or x, y and z, there [m].
        """
        cos, sin = math.cos(angle_rad), math.sin(angle_rad)
        origin = np.array([*origin_m, 0.0][:3], dtype=float)
        return cls(np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]), np.zeros(3), origin)

    @property
    def inverse(self) -> Rigid:
        """The way back."""
        return Rigid(self.rotation.T, self.to_m, self.from_m)

    def __matmul__(self, first: Rigid) -> Rigid:
        """What `first` does, and then this."""
        return Rigid(_turned(first.rotation, self.rotation), first.from_m, self.points(first.to_m))

    def points(self, places: np.ndarray) -> np.ndarray:
        """Places (..., 3), or in the plane (..., 2), of the one frame in the other [m]."""
        places = np.asarray(places, dtype=float)
        size = places.shape[-1]
        return _turned(places - self.from_m[:size], self.rotation[:size, :size]) + self.to_m[:size]

    def directions(self, directions: np.ndarray) -> np.ndarray:
        """Directions (..., 3), or in the plane (..., 2), likewise."""
        size = np.shape(directions)[-1]
        return _turned(np.asarray(directions, dtype=float), self.rotation[:size, :size])

    def headings(self, heading_rad: np.ndarray) -> np.ndarray:
        """Headings (n,) [rad], counter-clockwise from +x of the one frame, in the other, within half a turn of 0."""
        turned = heading_rad + self.turn_rad
        return np.arctan2(np.sin(turned), np.cos(turned))

    @property
    def turn_rad(self) -> float:
        """Which way the x axis of the frame that is left points in the other one, counter-clockwise [rad]."""
        return math.atan2(self.rotation[0, 1], self.rotation[0, 0])


def _turned(rows: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """``rows @ rotation``, added up in one order, to the last digit the same in every process, unlike BLAS."""
    columns = [sum(rows[..., k] * part for k, part in enumerate(column)) for column in rotation.T.tolist()]
    return np.stack(columns, axis=-1)
