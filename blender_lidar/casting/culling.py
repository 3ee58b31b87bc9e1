"""Culling of beams by angular bounds: which can reach a vehicle, as the others need not be cast when only these count.

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

from ..compiled import compiled, numba_works
from ..sensors.beams import BeamLattice
from ..sensors.pose import Pose
from ..traffic.boxes import Boxes
from ..world.shapes import shape
from ..world.triangles import place, shape_names
from .protocol import Caster, Revolution, take

PIECE_LENGTH_M = 1.8
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


def cut_vehicles(vehicles: Boxes, detail: str, own: np.ndarray | None = None) -> Pieces:
    """Cut each vehicle's shape at the level of detail `detail` along its length, into pieces of `PIECE_LENGTH_M`.

    Of those that are `own`, (n,) bool, the box is cut: they have a mesh of the user's.
    """
    shapes, own = shape_names(vehicles), np.zeros(len(vehicles), dtype=bool) if own is None else own
    pieces = np.maximum(np.ceil(vehicles.size_m[:, 0] / PIECE_LENGTH_M), 1).astype(int)
    corners = [np.empty((0, 8, 3))]
    for name, number, boxed in sorted(set(zip(shapes.tolist(), pieces.tolist(), own.tolist(), strict=True))):
        rows = np.flatnonzero((shapes == name) & (pieces == number) & (own == boxed))
        unit = _unit_corners(name, "box" if boxed else detail, number).reshape(-1, 3)
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
    start, end = (made.vertices[np.concatenate(made.faces[:, pairs].T)] for pairs in ([0, 1, 2], [1, 2, 0]))
    step = end - start
    run = np.where(step[:, 0] == 0.0, np.finfo(float).tiny, step[:, 0])
    bounds = []
    for first, last in pairwise(np.linspace(-0.5, 0.5, pieces + 1)):
        # Within a slice the surface takes its extremes at vertices, or where an edge crosses the slice's ends.
        there = (np.minimum(start, end)[:, 0] <= last) & (np.maximum(start, end)[:, 0] >= first)
        share = np.clip((np.array([[first], [last]]) - start[there, 0]) / run[there], 0.0, 1.0)
        points = start[there] + share[..., None] * step[there]
        low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
        low[0], high[0] = first, last
        bounds.append((low, high))
    return np.take_along_axis(np.array(bounds), _CORNERS[None], axis=1)


def reachable_beams(lattice: BeamLattice, pieces: Pieces, pose: Pose, max_range: float) -> np.ndarray:
    """Beams of a mounting that may meet one of the boxes within `max_range` [m].

    Returns
    -------
    ndarray of int64, (k,)
        Flat indices into the lattice, ``ring * columns + slot``, ascending.
    """
    away = np.sqrt(np.square(pieces.middle - pose.position[:, None]).sum(axis=0))
    near = np.flatnonzero(away - pieces.radius <= max_range)
    angular_bounds, beams_inside = _fastest()
    with np.errstate(divide="ignore", invalid="ignore"):
        bounds = angular_bounds(np.take(pieces.corners, near, axis=2), pose.position, pose.rotation)
    sine = np.sin(lattice.elevation_rad)
    return np.flatnonzero(beams_inside(*bounds, sine, lattice.slot_azimuth0_rad, lattice.step_rad, lattice.columns))


@cache
def _fastest():
    """The functions below, compiled where Numba is installed."""
    return tuple(map(compiled, (_angular_bounds, _beams_inside))) if numba_works() else (_angular_bounds, _beams_inside)


def _angular_bounds(corners, origin, rotation):
    """Bounds of the directions to each of p boxes (3, 8, p): sine of the elevation, and azimuth [rad].

    The last azimuth is at least the first and may exceed a turn. A piece about the sensor gets all directions.
    """
    east, north, up = corners[0] - origin[0], corners[1] - origin[1], corners[2] - origin[2]
    x = rotation[0, 0] * east + rotation[0, 1] * north + rotation[0, 2] * up
    y = rotation[1, 0] * east + rotation[1, 1] * north + rotation[1, 2] * up
    z = rotation[2, 0] * east + rotation[2, 1] * north + rotation[2, 2] * up
    across, ahead, above = x.sum(axis=0), y.sum(axis=0), z.sum(axis=0)  # towards the middle, of any length
    # Every direction to a box is a sum of the directions to its corners with weights of 0 or more. Within a cone of the
    # half-angle r those weights add up to 1 at least and to 1 / cos r at most, and so bound the direction's height.
    distance = np.sqrt(x * x + y * y + z * z)
    sine, along = z / distance, (x * across + y * ahead + z * above) / distance
    off_centre = np.arctan2(x * ahead - y * across, x * across + y * ahead)
    low, high, cosine, first, last = sine[0], sine[0], along[0], off_centre[0], off_centre[0]
    for corner in range(1, 8):
        low, high = np.minimum(low, sine[corner]), np.maximum(high, sine[corner])
        first, last = np.minimum(first, off_centre[corner]), np.maximum(last, off_centre[corner])
        cosine = np.minimum(cosine, along[corner])
    cosine = cosine / np.sqrt(across * across + ahead * ahead + above * above)
    low, high = np.where(low < 0.0, low / cosine, low), np.where(high > 0.0, high / cosine, high)
    about_sensor = ~(cosine > _LEAST_COSINE)  # also where it is no number: at a corner, or in the very middle
    # A middle on the very axis has no azimuth: all corners would seem to lie at 0.
    all_ways = about_sensor | ~(last - first < np.pi) | ((across == 0.0) & (ahead == 0.0))
    centre = np.arctan2(across, ahead)  # clockwise from +y, Eq. 1
    return (
        np.where(about_sensor, -1.0, low),
        np.where(about_sensor, 1.0, high),
        np.where(all_ways, 0.0, first + centre),
        np.where(all_ways, _TURN, last + centre),
    )


def _beams_inside(low, high, first, last, sine, azimuth0, step, columns):
    """Which beams (rings, columns) lie within any of the bounds on the lattice: a rectangle of rings and slots each."""
    ring_from = np.searchsorted(sine, low - _MARGIN_RAD)
    ring_to = np.searchsorted(sine, high + _MARGIN_RAD, side="right")
    slot_from = np.ceil((first - _MARGIN_RAD - azimuth0.max()) / step).astype(np.int64)
    slots = np.floor((last + _MARGIN_RAD - azimuth0.min()) / step).astype(np.int64) + 1 - slot_from
    mask = np.zeros((len(sine), columns), dtype=np.bool_)
    for piece in range(len(low)):
        rings = mask[ring_from[piece] : ring_to[piece]]
        start = slot_from[piece] % columns if slots[piece] < columns else 0
        end = start + min(slots[piece], columns)
        rings[:, start:end] = True
        if end > columns:  # across azimuth zero
            rings[:, : end - columns] = True
    return mask


def ray_directions(lattice: BeamLattice, beams: np.ndarray, pose: Pose) -> np.ndarray:
    """Directions (3, k) in the road frame of beams given by their flat indices (k,)."""
    components = lattice.components.reshape(3, -1)
    if not numba_works():
        return pose.to_world(take(components, beams, axis=1).T).T
    from .kernels import directions_of

    directions = np.empty((3, len(beams)))
    directions_of(components, beams, pose.rotation, directions.T)
    return directions


def revolutions(
    tree: Caster, lattice: BeamLattice, poses: Sequence[Pose], max_range: float, pieces: Pieces | None = None
) -> Iterator[Revolution]:
    """What the beams of one revolution meet first within `max_range` [m], for each mounting in turn.

    Beams that can reach none of `pieces` are left out, unless that is None; a caster that rasterises takes them along.
    """
    group, rays = [], 0  # of mountings that are cast together, each with its beams and their directions
    for pose in poses:
        if hasattr(tree, "revolution"):
            yield tree.revolution(lattice, pose, max_range)
            continue
        if pieces is None:
            beams = np.arange(lattice.rings * lattice.columns)
        else:
            beams = reachable_beams(lattice, pieces, pose, max_range)
        if group and rays + len(beams) > _RAYS_AT_A_TIME:
            yield from _cast_together(tree, group, max_range)
            group, rays = [], 0
        group.append((pose.position, beams, ray_directions(lattice, beams, pose)))
        rays += len(beams)
    if group:
        yield from _cast_together(tree, group, max_range)


def _cast_together(tree, group, max_range):
    origins, beams, directions = zip(*group, strict=True)
    ends = np.cumsum([len(some) for some in beams])
    origin = origins[0] if len(group) == 1 else np.repeat(np.array(origins).T, np.diff(ends, prepend=0), axis=1).T
    beams, directions = np.concatenate(beams), np.concatenate(directions, axis=1)
    found = tree.meet(origin, directions.T, max_range)
    beams, directions = (take(values, found.ray, axis=-1) for values in (beams, directions))
    for first, last in pairwise([0, *np.searchsorted(found.ray, ends).tolist()]):
        mine = slice(first, last)
        yield Revolution(beams[mine], found.triangle[mine], found.distance[mine], directions[:, mine])
