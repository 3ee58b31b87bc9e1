"""Recorded clouds: their points, labelled boxes and rays, those without a return as well."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..clouds.commissioned import Hung
from ..clouds.points import read_points
from ..clouds.rings import Rings
from ..detection.labels import frame_of, places_alone, read_labels
from ..errors import InputError
from ..metrics.vgop import to_vehicle_frame
from ..sensors.pose import Pose
from ..traffic.boxes import Boxes
from ..world.triangles import shape_names

NO_POINT = -1
PLACE_ALONE = "place alone"  # the label of a box of a guessed size
_TURN = 2.0 * math.pi

# --- Points and boxes -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LabelledBoxes(Boxes):
    """The bounding boxes of one recorded cloud, in its frame.

    Attributes
    ----------
    label : ndarray of str, (n,)
        What each is, in the words of the file.
    shape : ndarray of str, (n,)
        The shape of `world.shapes` that stands for each; empty for what only hides others, a plain box.
    """

    label: np.ndarray
    shape: np.ndarray

    def of_class(self, classes: Sequence[str] | None) -> np.ndarray:
        """Which boxes bear one of the labels, capitals or not, or have a shape where none is given; (n,) bool."""
        if classes is None:
            return self.shape != ""
        return np.isin(np.char.lower(self.label.astype(str)), [name.lower() for name in classes])


@dataclass(frozen=True, slots=True, eq=False)
class RecordedFrame:
    """One revolution of a real LiDAR and the boxes of what is in it.

    Attributes
    ----------
    name : str
        Of the frame, its number in the table.
    where : str
        For messages: the file.
    points : ndarray, (n, 3)
        Returns in the frame of the boxes, z up [m].
    boxes : LabelledBoxes
    """

    name: str
    where: str
    points: np.ndarray
    boxes: LabelledBoxes


def labelled_frames(
    clouds: Sequence[str], labels: str, frames: Sequence[int] | None, hung: Hung | None = None
) -> Iterator[RecordedFrame]:
    """Clouds, each with the boxes of one frame of some labels.

    Parameters
    ----------
    clouds : sequence of path
        As `read_points` takes them.
    labels : path
        As `read_labels` takes them; a table's are in the frame of the clouds. Boxes of which only the place is known
        hide others, and are not compared.
    frames : sequence of int, optional
        For each cloud its frame in the labels; by default the number that its name ends with, or the only frame.
    hung : Hung, optional
        Brings the clouds from the sensor's own frame to that of the road, which a table's boxes are in then.

    Raises
    ------
    InputError, MissingFileError
        Naming the file, and the line where there is one.
    """
    recording = read_labels(labels, hung).vehicles_alone
    known = recording.frames
    if frames is None:
        frames = known[:1] if len(clouds) == len(known) == 1 else _named(clouds)
        if not np.isin(frames, known).all():
            raise InputError(
                f"--boxes: {labels}: holds {len(known)} frames, {known[0]} to {known[-1]}, for {len(clouds)} "
                "clouds, whose names end with others or none; give --frame with a number for each cloud"
            )
    if len(frames) != len(clouds):
        raise InputError(f"--frame: {len(frames)} numbers; allowed: one for each of the {len(clouds)} clouds")
    alone = places_alone(labels)
    for cloud, frame in zip(clouds, frames, strict=True):
        vehicles = recording.at(int(frame))
        guessed = [(int(frame), own) in alone for own in vehicles.vehicle_id.tolist()]
        boxes = LabelledBoxes(
            **vehicles.columns() | {"frame": vehicles.frame, "time_s": vehicles.time_s},
            label=np.where(guessed, PLACE_ALONE, vehicles.class_name),
            shape=np.where(guessed, "", shape_names(vehicles)),
        )
        points = read_points(cloud)[0]
        yield RecordedFrame(str(int(frame)), str(cloud), points if hung is None else hung.placed(points), boxes)


def _named(clouds: Sequence[str]) -> list[int]:
    """The numbers that the names of clouds end with, -1 for those that have none."""
    found = []
    for cloud in clouds:
        try:
            found.append(frame_of(Path(cloud)))
        except InputError:
            found.append(-1)
    return found


# --- Rays -------------------------------------------------------------------------------------------------------------


class Rays(NamedTuple):
    """Rays of one revolution.

    Attributes
    ----------
    origin, direction : ndarray, (k, 3)
        Where each starts [m, frame of the cloud], and its unit vector; through the point where it returned.
    point : ndarray of int64, (k,)
        Row of the cloud's point that it returned as; `NO_POINT` where it did not return.
    range_m : ndarray, (k,)
        How far away that point is along the ray [m]; inf where there is none.
    """

    origin: np.ndarray
    direction: np.ndarray
    point: np.ndarray
    range_m: np.ndarray


class Firings:
    """What a sensor fired during one revolution: what returned, and the firings between that did not.

    Parameters
    ----------
    points : ndarray, (n, 3)
        The returns [m, frame of the cloud].
    rings : Rings
        Their rings, of the points in the sensor's frame, ``pose.to_sensor(points)``.
    pose : Pose
        Of the sensor in the frame of the cloud.
    """

    def __init__(self, points: np.ndarray, rings: Rings, pose: Pose) -> None:
        self._points, self._rings, self._pose = points, rings, pose
        local = pose.to_sensor(points)
        rho = np.hypot(local[:, 0], local[:, 1])
        parallax = np.arcsin(np.clip(rings.lateral_m[rings.ring] / np.maximum(rho, 1e-9), -1.0, 1.0))
        azimuth = np.mod(np.arctan2(local[:, 1], local[:, 0]) - parallax, _TURN)
        order = np.lexsort((azimuth, rings.ring))
        ring, azimuth = rings.ring[order], azimuth[order]
        first = np.searchsorted(ring, ring)  # of its ring
        last = np.append(ring[1:] != ring[:-1], True)
        gap = np.where(last, azimuth[first] + _TURN, np.roll(azimuth, -1)) - azimuth
        # Firings without a return are spread evenly over the gap between two that returned.
        lacking = np.maximum(np.round(gap / rings.step_rad).astype(int) - 1, 0)
        number = np.arange(lacking.sum()) - np.repeat(np.cumsum(lacking) - lacking, lacking) + 1
        between = np.mod(np.repeat(azimuth, lacking) + np.repeat(gap / (lacking + 1), lacking) * number, _TURN)
        dark = np.setdiff1d(np.arange(len(rings)), ring)  # nothing returned on these
        turn = np.arange(0.0, _TURN, rings.step_rad)
        self._azimuth = np.concatenate([azimuth, between, np.tile(turn, len(dark))])
        self._ring = np.concatenate([ring, np.repeat(ring, lacking), np.repeat(dark, len(turn))])
        self._point = np.full(len(self._ring), NO_POINT)
        self._point[: len(order)] = order

    def towards(self, centre: np.ndarray, size: np.ndarray, heading: float) -> tuple[Rays, np.ndarray]:
        """All rays that meet a box, and how far along each it enters the box.

        They go ring by ring, first those that returned, each with the azimuth rising.

        Parameters
        ----------
        centre, size : ndarray, (3,)
            Box centre; length, width and height [m, frame of the cloud].
        heading : float
            Counter-clockwise from +x [rad].
        """
        x, y, _ = self._pose.to_sensor(centre)
        away, reach = math.hypot(x, y), 0.5 * float(np.linalg.norm(size)) + np.abs(self._rings.lateral_m).max()
        bearing, widest = math.atan2(y, x) % _TURN, math.asin(reach / away) if reach < away else math.pi
        aside = np.mod(self._azimuth - bearing + math.pi, _TURN) - math.pi
        near = np.flatnonzero(np.abs(aside) <= widest)
        near = near[np.lexsort((aside[near], self._point[near] == NO_POINT, self._ring[near]))]
        rays = self._rays(self._azimuth[near], self._point[near], self._ring[near])
        entry, leave = crossing(rays, centre, size, heading)
        meets = (leave >= entry) & (leave > 0.0)
        return Rays(*(values[meets] for values in rays)), entry[meets]

    def _rays(self, azimuth: np.ndarray, point: np.ndarray, ring: np.ndarray) -> Rays:
        """Rays of rings at azimuths counter-clockwise from the sensor's +x, and the points they returned as."""
        lateral, elevation = self._rings.lateral_m[ring], self._rings.elevation_rad[ring]
        cos, sin, level = np.cos(azimuth), np.sin(azimuth), np.cos(elevation)
        start = np.column_stack([-lateral * sin, lateral * cos, self._rings.height_m[ring]])
        origin = self._pose.position + self._pose.to_world(start)
        direction = self._pose.to_world(np.column_stack([cos * level, sin * level, np.sin(elevation)]))
        returned = point != NO_POINT
        way = self._points[point[returned]] - origin[returned]
        distance = np.full(len(point), np.inf)
        distance[returned] = np.linalg.norm(way, axis=1)
        direction[returned] = way / distance[returned, None]
        return Rays(origin, direction, point, distance)


def crossing(rays: Rays, centre: np.ndarray, size: np.ndarray, heading: float) -> tuple[np.ndarray, np.ndarray]:
    """How far along each ray it enters and leaves a box, (k,) each [m]; it meets the box where it leaves it later."""
    start = to_vehicle_frame(rays.origin, centre, heading)
    way = to_vehicle_frame(rays.direction, np.zeros(3), heading)
    with np.errstate(divide="ignore"):
        inverse = 1.0 / np.where(way == 0.0, 1e-300, way)
    near, far = (-0.5 * size - start) * inverse, (0.5 * size - start) * inverse
    return np.minimum(near, far).max(axis=1), np.maximum(near, far).min(axis=1)
