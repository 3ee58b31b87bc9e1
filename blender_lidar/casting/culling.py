"""Which beams can reach a vehicle at all: the others need not be cast when only vehicles count.

Seen from the sensor, a box covers a range of elevations and a range of azimuths; on the (ring, azimuth slot) lattice
of a rotating LiDAR that is a rectangle. Boxes are cut along their length into pieces first, so that the rectangles of
a long or a near vehicle hug it. The bounds are never too tight: no beam that meets a vehicle is left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np

from ..sensors.beams import BeamLattice
from ..sensors.pose import Pose
from ..traffic.vehicles import Vehicles
from ..world.shapes import shape
from ..world.triangles import place, shape_names

PIECE_LENGTH_M = 1.8
_PIECES_AT_A_TIME = 2048  # whose bounds are found together: enough to amortise NumPy's calls, few enough for the cache
_LEAST_COSINE = 0.01  # of the cone about a piece; a wider one is no bound
_TURN = 2.0 * np.pi
_MARGIN_RAD = 1e-5  # a float32 caster may let a beam touch what it passes by this closely; far below any beam spacing

_CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])  # 0 the lower bound, 1 the upper


@dataclass(frozen=True, slots=True)
class Pieces:
    """Boxes about slices of vehicles [m, road frame]: corners (p, 8, 3), middles (p, 3), bounding radii (p,)."""

    corners: np.ndarray
    middle: np.ndarray
    radius: np.ndarray


def cut_vehicles(vehicles: Vehicles, detail: str) -> Pieces:
    """Cut each vehicle's shape at the level of detail `detail` along its length, into pieces of `PIECE_LENGTH_M`."""
    shapes = shape_names(vehicles)
    pieces = np.maximum(np.ceil(vehicles.size_m[:, 0] / PIECE_LENGTH_M), 1).astype(int)
    corners = [np.empty((0, 8, 3))]
    for name, number in sorted(set(zip(shapes.tolist(), pieces.tolist(), strict=True))):
        rows = np.flatnonzero((shapes == name) & (pieces == number))
        unit = _unit_corners(name, detail, number).reshape(-1, 3)
        placed = place(unit, vehicles.centre_m[rows], vehicles.size_m[rows], vehicles.heading_rad[rows])
        corners.append(placed.reshape(-1, 8, 3))
    corners = np.concatenate(corners)
    middle = corners.mean(axis=1)
    return Pieces(corners, middle, np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1, initial=0.0))


@cache
def _unit_corners(name: str, detail: str, pieces: int) -> np.ndarray:
    """Corners (pieces, 8, 3) of the boxes about slices of a unit shape, equally long."""
    made = shape(name, detail)
    edge = made.vertices[np.concatenate([made.faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])]
    bounds = []
    for first, last in pairwise(np.linspace(-0.5, 0.5, pieces + 1)):
        # Within a slice the surface takes its extremes at vertices, or where an edge crosses the slice's ends.
        inside = made.vertices[(made.vertices[:, 0] >= first) & (made.vertices[:, 0] <= last)]
        points = np.concatenate([inside, *(_crossings(edge, x) for x in (first, last))])
        low, high = points.min(axis=0), points.max(axis=0)
        low[0], high[0] = first, last
        bounds.append((low, high))
    return np.take_along_axis(np.array(bounds), _CORNERS[None], axis=1)


def _crossings(edge: np.ndarray, x: float) -> np.ndarray:
    """Where edges (e, 2, 3) cross the plane at `x`."""
    start, end = edge[:, 0], edge[:, 1]
    crossing = (start[:, 0] < x) & (end[:, 0] > x) | (start[:, 0] > x) & (end[:, 0] < x)
    start, end = start[crossing], end[crossing]
    return start + ((x - start[:, 0]) / (end[:, 0] - start[:, 0]))[:, None] * (end - start)


def reachable_beams(
    lattice: BeamLattice, pieces: Pieces, poses: Sequence[Pose], max_range: float
) -> Iterator[np.ndarray]:
    """Beams that may meet one of the boxes within `max_range` [m], for each mounting in turn.

    Yields
    ------
    ndarray of int64, (k,)
        Flat indices into the lattice, ``ring * columns + slot``, ascending.
    """
    step = max(_PIECES_AT_A_TIME // max(len(pieces.radius), 1), 1)
    for start in range(0, len(poses), step):
        group = poses[start : start + step]
        near = [np.linalg.norm(pieces.middle - pose.position, axis=1) - pieces.radius <= max_range for pose in group]
        corners = np.concatenate([pose.to_sensor(pieces.corners[kept]) for pose, kept in zip(group, near, strict=True)])
        rectangles = _lattice_rectangles(lattice, corners)
        ends = np.cumsum([np.count_nonzero(kept) for kept in near]).tolist()
        for first, last in pairwise([0, *ends]):
            yield _beams_inside(lattice, rectangles[first:last])


def _lattice_rectangles(lattice: BeamLattice, corners: np.ndarray) -> np.ndarray:
    """Rings and slots that each piece (p, 8, 3), in the sensor frame, covers: from ring, to ring, from slot, to slot.

    Ends are not included; the last slot may lie beyond the turn's end, which is then passed.
    """
    low, high, first, last = _angular_bounds(corners)
    columns = lattice.columns
    sine = np.sin(lattice.elevation_rad)
    ring_from = np.searchsorted(sine, low - _MARGIN_RAD, side="left")
    ring_to = np.searchsorted(sine, high + _MARGIN_RAD, side="right")
    # Slot s of a ring lies at an azimuth in [s, s + 1) steps.
    slot_from = np.ceil((first - _MARGIN_RAD) / lattice.step_rad).astype(np.int64) - 1
    slot_to = np.floor((last + _MARGIN_RAD) / lattice.step_rad).astype(np.int64) + 1
    whole = slot_to - slot_from >= columns
    slot_from[whole], slot_to[whole] = 0, columns
    turns = slot_from // columns * columns
    return np.stack([ring_from, ring_to, slot_from - turns, slot_to - turns], axis=1)


def _beams_inside(lattice: BeamLattice, rectangles: np.ndarray) -> np.ndarray:
    """Flat indices of the beams in any of the rectangles."""
    mask = np.zeros((lattice.rings, lattice.columns), dtype=bool)
    for ring_from, ring_to, slot_from, slot_to in rectangles.tolist():
        mask[ring_from:ring_to, slot_from:slot_to] = True
        if slot_to > lattice.columns:  # across azimuth zero
            mask[ring_from:ring_to, : slot_to - lattice.columns] = True
    return np.flatnonzero(mask)


def _angular_bounds(corners: np.ndarray):
    """Bounds of the directions to each piece (p, 8, 3) in the sensor frame: sine of the elevation, and azimuth [rad].

    The last azimuth is at least the first and may exceed a turn. A piece about the sensor gets all directions.
    """
    distance = np.sqrt(np.einsum("pci,pci->pc", corners, corners))
    middle = corners.mean(axis=1)
    # Every direction to a box is a sum of the directions to its corners with weights of 0 or more. Within a cone of the
    # half-angle r those weights add up to 1 at least and to 1 / cos r at most, and so bound the direction's height.
    with np.errstate(divide="ignore", invalid="ignore"):
        sine = corners[..., 2] / distance
        along = np.einsum("pci,pi->pc", corners, middle) / distance
        cosine = along.min(axis=1) / np.sqrt(np.einsum("pi,pi->p", middle, middle))
        low, high = sine.min(axis=1), sine.max(axis=1)
        low, high = np.where(low < 0.0, low / cosine, low), np.where(high > 0.0, high / cosine, high)
    centre = np.arctan2(middle[:, 0], middle[:, 1])  # clockwise from +y, Eq. 1
    off_centre = np.arctan2(corners[..., 0], corners[..., 1]) - centre[:, None]
    off_centre -= _TURN * np.round(off_centre / _TURN)
    first, last = off_centre.min(axis=1), off_centre.max(axis=1)
    about_axis = ~(last - first < np.pi)
    first, last = np.where(about_axis, 0.0, first + centre), np.where(about_axis, _TURN, last + centre)
    about_sensor = ~(cosine > _LEAST_COSINE)
    return (
        np.where(about_sensor, -1.0, low),
        np.where(about_sensor, 1.0, high),
        np.where(about_sensor, 0.0, first),
        np.where(about_sensor, _TURN, last),
    )
