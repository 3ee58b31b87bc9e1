"""Culling of beams by angular bounds: which can reach a vehicle, as the others need not be cast when only these count.

Seen from the sensor, a box covers a range of elevations and a range of azimuths; on the (ring, azimuth slot) lattice
of a rotating LiDAR that is a rectangle. Boxes are cut along their length into pieces first, so that the rectangles of
a long or a near vehicle hug it. The bounds are never too tight: no beam that meets a vehicle is left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise, repeat

import numpy as np

from ..compiled import numba_works
from ..sensors.beams import BeamLattice
from ..sensors.pose import Pose
from ..traffic.vehicles import Vehicles
from ..world.shapes import shape
from ..world.triangles import place, shape_names
from .protocol import Caster, Revolution

PIECE_LENGTH_M = 1.8
_PIECES_AT_A_TIME = 2048  # whose bounds are found together: enough to amortise NumPy's calls, few enough for the cache
_RAYS_AT_A_TIME = 1 << 14  # of several mountings: enough to amortise NumPy's calls, few enough for the cache
_LEAST_COSINE = 0.01  # of the cone about a piece; a wider one is no bound
_TURN = 2.0 * np.pi
_MARGIN_RAD = 1e-9  # for rounding; far below any beam spacing

_CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])  # 0 the lower bound, 1 the upper


@dataclass(frozen=True, slots=True)
class Pieces:
    """Boxes about slices of vehicles, coordinate by coordinate.

    Attributes
    ----------
    corners : ndarray, (3, 8, p)
        Corners of each box [m, road frame].
    middle : ndarray, (3, p)
        Its middle [m, road frame].
    radius : ndarray, (p,)
        Distance from the middle to the farthest corner [m].
    """

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
    corners = np.ascontiguousarray(np.concatenate(corners).transpose(2, 1, 0))
    middle = corners.mean(axis=1)
    radius = np.sqrt(np.square(corners - middle[:, None]).sum(axis=0).max(axis=0))
    return Pieces(corners, middle, radius)


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
    fast = _compiled()
    if fast is not None:
        for pose in poses:
            yield fast.beams_within(
                pieces.corners,
                pieces.middle,
                pieces.radius,
                pose.position,
                pose.rotation,
                float(max_range),
                np.sin(lattice.elevation_rad),
                lattice.slot_azimuth0_rad,
                lattice.step_rad,
                lattice.columns,
                _MARGIN_RAD,
                _LEAST_COSINE,
            )
        return
    yield from _reachable_beams(lattice, pieces, poses, max_range)


def ray_directions(lattice: BeamLattice, beams: np.ndarray, pose: Pose) -> np.ndarray:
    """Directions (3, k) in the road frame of beams given by their flat indices (k,)."""
    components = lattice.components.reshape(3, -1)
    fast = _compiled()
    if fast is not None:
        directions = np.empty((3, len(beams)))
        fast.directions_of(components, beams, pose.rotation, directions.T)
        return directions
    return pose.to_world(np.take(components, beams, axis=1, mode="clip").T).T


def revolutions(
    tree: Caster, lattice: BeamLattice, poses: Sequence[Pose], max_range: float, pieces: Pieces | None = None
) -> Iterator[Revolution]:
    """What the beams of one revolution meet first within `max_range` [m], for each mounting in turn.

    Beams that can reach none of `pieces` are left out, unless that is None; a caster that rasterises takes them along.
    """
    if hasattr(tree, "revolution"):
        yield from (tree.revolution(lattice, pose, max_range) for pose in poses)
        return
    if pieces is None:
        cast = repeat(np.arange(lattice.rings * lattice.columns), len(poses))
    else:
        cast = reachable_beams(lattice, pieces, poses, max_range)
    group, rays = [], 0
    for pose, beams in zip(poses, cast, strict=True):
        if group and rays + len(beams) > _RAYS_AT_A_TIME:
            yield from _revolutions(tree, lattice, group, max_range)
            group, rays = [], 0
        group.append((pose, beams))
        rays += len(beams)
    if group:
        yield from _revolutions(tree, lattice, group, max_range)


def _revolutions(tree, lattice, group, max_range):
    """The same of mountings with the beams of each, cast together."""
    (pose, beams), ends = group[0], np.cumsum([len(beams) for _, beams in group])
    origins, directions = pose.position, ray_directions(lattice, beams, pose)
    if len(group) > 1:
        more = [ray_directions(lattice, beams, pose) for pose, beams in group[1:]]
        directions, beams = np.concatenate([directions, *more], axis=1), np.concatenate([beams for _, beams in group])
        origins = np.repeat(np.array([pose.position for pose, _ in group]).T, np.diff(ends, prepend=0), axis=1).T
    found = tree.meet(origins, directions.T, max_range)
    beams, directions = (np.take(values, found.ray, axis=-1, mode="clip") for values in (beams, directions))
    for first, last in pairwise([0, *np.searchsorted(found.ray, ends).tolist()]):
        mine = slice(first, last)
        yield Revolution(beams[mine], found.triangle[mine], found.distance[mine], directions[:, mine])


@cache
def _compiled():
    """The compiled twin of this module, or None where Numba is not installed."""
    if not numba_works():
        return None
    from . import kernels

    return kernels


def _reachable_beams(lattice, pieces, poses, max_range):
    step = max(_PIECES_AT_A_TIME // max(len(pieces.radius), 1), 1)
    for start in range(0, len(poses), step):
        group = poses[start : start + step]
        near = [np.flatnonzero(_distance(pieces, pose) - pieces.radius <= max_range) for pose in group]
        rectangles = _lattice_rectangles(
            lattice,
            np.concatenate([_in_sensor(pieces.corners, pose, kept) for pose, kept in zip(group, near, strict=True)], 2),
        )
        ends = np.cumsum([len(kept) for kept in near]).tolist()
        for first, last in pairwise([0, *ends]):
            yield _beams_inside(lattice, rectangles[first:last])


def _distance(pieces: Pieces, pose: Pose) -> np.ndarray:
    """From the sensor to the middle of each piece, (p,) [m]."""
    return np.sqrt(np.square(pieces.middle - pose.position[:, None]).sum(axis=0))


def _in_sensor(corners: np.ndarray, pose: Pose, kept: np.ndarray) -> np.ndarray:
    """Corners of the pieces that are kept in the sensor frame, (3, 8, k) [m]."""
    away = np.take(corners, kept, axis=2)
    away -= pose.position[:, None, None]
    return (pose.rotation @ away.reshape(3, -1)).reshape(away.shape)


def _lattice_rectangles(lattice: BeamLattice, corners: np.ndarray) -> np.ndarray:
    """Rings and slots that each piece (3, 8, p), in the sensor frame, covers: from ring, to ring, from slot, to slot.

    Ends are not included; the last slot may lie beyond the turn's end, which is then passed.
    """
    low, high, first, last = _angular_bounds(*corners)
    columns, step = lattice.columns, lattice.step_rad
    sine = np.sin(lattice.elevation_rad)
    ring_from = np.searchsorted(sine, low - _MARGIN_RAD, side="left")
    ring_to = np.searchsorted(sine, high + _MARGIN_RAD, side="right")
    first_azimuth, last_azimuth = lattice.slot_azimuth0_rad.min(), lattice.slot_azimuth0_rad.max()
    slot_from = np.ceil((first - _MARGIN_RAD - last_azimuth) / step).astype(np.int64)
    slot_to = np.floor((last + _MARGIN_RAD - first_azimuth) / step).astype(np.int64) + 1
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


def _angular_bounds(x: np.ndarray, y: np.ndarray, z: np.ndarray):
    """Bounds of the directions to each of p boxes: sine of the elevation, and azimuth [rad].

    Corners in the sensor frame, (8, p) each. The last azimuth is at least the first and may exceed a turn. A piece
    about the sensor gets all directions.
    """
    distance = np.sqrt(x * x + y * y + z * z)
    across, ahead, above = x.sum(axis=0), y.sum(axis=0), z.sum(axis=0)  # towards the middle, whatever the length
    # Every direction to a box is a sum of the directions to its corners with weights of 0 or more. Within a cone of the
    # half-angle r those weights add up to 1 at least and to 1 / cos r at most, and so bound the direction's height.
    with np.errstate(divide="ignore", invalid="ignore"):
        sine = z / distance
        along = (x * across + y * ahead + z * above) / distance
        cosine = along.min(axis=0) / np.sqrt(across * across + ahead * ahead + above * above)
        low, high = sine.min(axis=0), sine.max(axis=0)
        low, high = np.where(low < 0.0, low / cosine, low), np.where(high > 0.0, high / cosine, high)
    centre = np.arctan2(across, ahead)  # clockwise from +y, Eq. 1
    off_centre = np.arctan2(x * ahead - y * across, x * across + y * ahead)
    first, last = off_centre.min(axis=0), off_centre.max(axis=0)
    # A middle on the very axis has no azimuth: all corners would seem to lie at 0.
    about_axis = ~(last - first < np.pi) | ((across == 0.0) & (ahead == 0.0))
    first, last = np.where(about_axis, 0.0, first + centre), np.where(about_axis, _TURN, last + centre)
    about_sensor = ~(cosine > _LEAST_COSINE)
    return (
        np.where(about_sensor, -1.0, low),
        np.where(about_sensor, 1.0, high),
        np.where(about_sensor, 0.0, first),
        np.where(about_sensor, _TURN, last),
    )
