"""Boxes fitted to the vehicles in recorded clouds of one mounting, in the columns of vehicles.csv and the road frame.

What rises from a carriageway before the background of its beams is clustered. A dimension is measured where the sides
that bound it are seen, else it is usual for the class, and lies away from the LiDAR. Vehicles are not followed from
frame to frame, as clouds do not tell their times.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from ..clouds.scan import PointCloud
from .classical import ClassicalDetector
from .ground import fit_ground
from .l_shape import LONG_M, USUAL_M, LShape, l_shape_heading

_COLUMNS = ("frame", "class", "x_m", "y_m", "z_m", "length_m", "width_m", "height_m", "heading_deg", "points")
_COLUMNS += ("measured", "confidence")
_KINDS = dict.fromkeys(("class", "measured", "confidence"), str) | dict.fromkeys(("frame", "points"), int)
_VAN_M, _TRUCK_M = 1.85, 2.5  # heights
_HEIGHTS_M, _SURFACE_M = (0.18, 4.5), 60.0  # of a vehicle's points above the surface, which is fitted so far along
_ALONG = 0.5  # of distances along the road when clustering: 1.8 m there are as near as 0.9 m across
_FEWEST, _LOWEST_M = 5, 0.5  # points of a vehicle, and their top
_TURNED_POINTS, _MOST_TURNED_RAD = 60, math.radians(5.0)  # with fewer it heads as the road does
# Shorter, narrower or lower ones are not seen whole; nor are tops beyond, as rings lie too far apart.
_SHORTEST_M, _NARROWEST_M, _LOWEST_TOP_M, _TOP_SEEN_M = 3.3, 1.5, 1.25, 80.0
_MEDIAN_M = 1.0  # between two directions
_ON_SIDE_M, _GAP_M, _BEFORE_M = 0.4, 0.8, 0.5  # a side has no longer gap; an end is seen from so far before it


def fit_boxes(
    clouds: Sequence[PointCloud],
    detector: ClassicalDetector,
    carriageways_y: Sequence[tuple[float, float]],
    drives_on: str = "right",
) -> dict[str, np.ndarray]:
    """Fit boxes to the vehicles of clouds.

    Parameters
    ----------
    clouds : sequence of PointCloud
        With beams, as of `clouds.rings.on_beams`, in the road frame; their frames are counted from 0.
    detector : ClassicalDetector
        Of their sensor; it learns the background of each cloud from the others.
    carriageways_y : sequence of (float, float)
        From which y to which each lies [m].
    drives_on : {"right", "left"}
        The side of traffic, which of two carriageways with a median between tells the way that each heads; on one all
        are taken to head along x.

    Returns
    -------
    dict of str to ndarray, (n,)
        Columns that `traffic.read_table` reads; ``points``; ``measured``, those of H, L and W that are; ``confidence``:
        A, all three and 100 points; B, two and 40; C, 15 points; D, the place alone.
    """
    lidar, images = np.array([*detector.lidar_xy, 0.0]), np.array([detector.range_image(cloud) for cloud in clouds])
    everywhere, rows = np.concatenate([cloud.xyz for cloud in clouds]) - lidar, []
    foreground = []
    for frame, cloud in enumerate(clouds):
        detector.learn(np.delete(images, frame, axis=0))
        foreground.append(cloud.xyz[detector.nearer(cloud)])
    ends = sorted(carriageways_y)
    parted = any(later[0] - earlier[1] >= _MEDIAN_M for earlier, later in pairwise(ends))  # else two sides of a crown
    for span in carriageways_y:
        low, high = np.array(span) - lidar[1]
        near = (everywhere[:, 1] > low) & (everywhere[:, 1] < high) & (np.abs(everywhere[:, 0]) < _SURFACE_M)
        surface = fit_ground(everywhere[near])
        back = parted and (np.mean(span) > np.mean(carriageways_y)) == (drives_on == "right")
        for frame, points in enumerate(foreground):
            points = points - lidar
            points[:, 2] = surface.above(points)
            mine = (points[:, 1:] > [low, _HEIGHTS_M[0]]) & (points[:, 1:] < [high, _HEIGHTS_M[1]])
            for cluster in _clusters(points[mine.all(axis=1)], detector):
                kind, centre, size, turn, measured = _box(cluster)
                count, known = len(cluster), len(measured)
                sure = "A" if known == 3 and count >= 100 else "B" if known >= 2 and count >= 40 else "C"
                sure = "D" if count < 15 else sure
                z = surface.height(centre[None])[0] + 0.5 * size[2]
                heading = math.degrees(turn) + 180.0 * back
                rows.append((frame, kind, *(centre + lidar[:2]), z, *size, heading, count, measured, sure))
    rows.sort(key=lambda row: row[0])
    columns = {name: np.array([row[at] for row in rows], dtype=_KINDS.get(name)) for at, name in enumerate(_COLUMNS)}
    return {"vehicle_id": np.arange(len(rows)), **columns}


def _clusters(points: np.ndarray, detector: ClassicalDetector) -> Iterator[np.ndarray]:
    """The points (k, 3) of each vehicle among some that rise from the road, (n, 3) [m]."""
    label = detector.cluster.fit_predict(points[:, :2] * [_ALONG, 1.0]) if len(points) else np.zeros(0)
    for number in range(int(label.max(initial=-1)) + 1):
        mine = points[label == number]
        if len(mine) >= _FEWEST and mine[:, 2].max() >= _LOWEST_M:
            yield mine


def _box(points: np.ndarray) -> tuple[str, np.ndarray, tuple[float, float, float], float, str]:
    """Class, centre (2,) and size [m], heading from the road's [rad], and what was measured, from the LiDAR at 0."""
    turned = len(points) >= _TURNED_POINTS and np.ptp(points[:, 0]) > _SHORTEST_M
    heading = l_shape_heading(points[:, :2]) if turned else 0.0
    if abs(heading) > _MOST_TURNED_RAD:  # no side of a vehicle that follows the road
        heading = 0.0
    shape, top, lidar = LShape.about(points[:, :2], heading), float(points[:, 2].max()), np.zeros((1, 2))
    (low, high), seen = (shape.low, shape.high), shape.seen
    local, side = points[:, :2] @ shape.turn, (low, high)[int(shape.facing(lidar)[1] > 0)][1]
    along = np.sort(local[np.abs(local[:, 1] - side) < _ON_SIDE_M, 0])
    gap = np.diff(along, prepend=low[0], append=high[0]).max()
    found = {
        "H": top >= _LOWEST_TOP_M and np.hypot(*(low + high)) < 2.0 * _TOP_SEEN_M,
        "L": seen[0] >= _SHORTEST_M and gap <= _GAP_M,
        "W": seen[1] >= _NARROWEST_M and max(low[0], -high[0]) > _BEFORE_M,
    }
    kind = "truck" if top > _TRUCK_M or seen[0] > LONG_M else "van" if top > _VAN_M else "car"
    length, width, height = (
        value if found[key] else max(value, usual)
        for key, value, usual in zip("LWH", (*seen.tolist(), top), USUAL_M[kind], strict=True)
    )
    measured = "".join(key for key in found if found[key])
    return kind, shape.centre((length, width), lidar), (length, width, height), heading, measured
