"""Frame scorer, compiled: hits found, measured (noise, lost returns), tested for occlusion and marked, in one go.

The arithmetic is that of `FrameScorer`, `MeasurementModel.measured`, `to_vehicle_frame` and `ViewGrids` in NumPy,
operation by operation, so that the digits are the same. What rounding decides is left to these.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..casting import RASTER
from ..casting.culling import ray_directions, reachable_beams
from ..casting.kernels import BoxTree, directions_of, hidden, is_inside, signed_distance, to_world
from ..casting.protocol import MISS
from ..casting.rasterise import rasterise, undecided_beams
from ..casting.tree import EDGE_ON
from ..compiled import compiled, inlined
from ..metrics.compiled_marks import OUTSIDE, cells_at, count_cells, mark
from ..metrics.view_grids import ViewGrids
from ..scene.observation import Observation
from ..sensors.beams import BeamLattice
from ..sensors.imperfections import STATED_REFLECTIVITY, MeasurementModel
from ..sensors.pose import Pose
from ..world.meshes import GLASS, REFLECTIVITY
from .frame_scorer import FrameShapes

_BLOCK = 512  # beams whose places stay in the fastest cache
# Where the columns of a block begin in one array: apart by more than a vector is long, which the compiler has to know.
_X, _Y, _Z, _FACING, _DISTANCE, _AWAY, _TOP, _SIDE, _FRONT = (np.uint64(column * _BLOCK) for column in range(9))
_AT_A_TIME = 64  # layouts, each with grids of its own
_MEASURED_HERE = np.empty(0)
_NONE, _ONE = np.uint64(0), np.uint64(1)


class Targets(NamedTuple):
    """The triangles of a frame: planes (m, 13), rows of their counted vehicles (m,), -1 for none, and surfaces."""

    planes: np.ndarray
    vehicle: np.ndarray
    glass: np.ndarray
    reflectivity: np.ndarray


class PackedBoxes(NamedTuple):
    """The counted vehicles: centre (n, 3) [m], cosine and sine of the heading (n,), cells as in `ViewGrids`."""

    centre: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    half_m: np.ndarray
    cell_m: float
    cells: np.ndarray
    start: np.ndarray
    words: np.ndarray


class FrameLidar(NamedTuple):
    """A LiDAR of the layouts: lattice, beams (3, b), how far these are followed [m], and what `mark_returns` takes."""

    lattice: BeamLattice
    components: np.ndarray
    reach_m: float
    scene: tuple[Targets, MeasurementModel, tuple[BoxTree, ...] | None, PackedBoxes]


class CompiledScorer:
    """Counts what layouts see of the counted vehicles of a frame.

    The LiDARs of a layout set bits in the same grids, so that their cells are united.

    Parameters
    ----------
    shapes : FrameShapes
        The frame, in which at least one vehicle counts, behind a caster other than `exact`.
    grids : ViewGrids
        Of the vehicles that count.
    observation : Observation
        The LiDARs of a layout, and the scenery as it stands in this frame.
    measurements : sequence of MeasurementModel
        Of each LiDAR in this frame.
    """

    def __init__(
        self,
        shapes: FrameShapes,
        grids: ViewGrids,
        observation: Observation,
        measurements: Sequence[MeasurementModel],
    ) -> None:
        caster, vehicles, scenery = shapes.tree, shapes.counted, observation.scenery
        self._caster, self._grids = caster, grids
        self._pieces = shapes.pieces if observation.culled and caster.name != RASTER else None
        surface = shapes.surface[caster.rows]
        vehicle = np.ascontiguousarray(shapes.counted_row[caster.rows])
        targets = Targets(caster.planes, vehicle, surface == GLASS, REFLECTIVITY[surface])
        centre, heading = np.ascontiguousarray(vehicles.centre_m), vehicles.heading_rad
        of_grids = grids.half_m, grids.cell_m, grids.cells, grids.start, grids.words
        boxes = PackedBoxes(centre, np.cos(heading), np.sin(heading), *of_grids)
        standing = [] if scenery is None else scenery.occluders
        occluders = tuple(tree for _, tree in standing) or None
        self._origins = -np.stack([caster.origin, np.zeros(3), *(origin for origin, _ in standing)])
        self._held: tuple[list[Pose | None], tuple[np.ndarray, np.ndarray, bool]] | None = None
        self.lidars = [
            FrameLidar(
                lidar.lattice, lidar.lattice.components.reshape(3, -1), lidar.reach_m, (targets, of, occluders, boxes)
            )
            for lidar, of in zip(observation.lidars, measurements, strict=True)
        ]

    def see(self, layouts: Sequence[Sequence[Pose | None]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points by LiDAR (s, l, n) and marked cells (s, n, 3) of s layouts, and those at which rounding decides.

        What is counted for the latter, rows of `layouts`, is worth nothing.
        """
        points = np.zeros((len(self.lidars), len(layouts), len(self._grids)), dtype=np.int64)
        cells = np.zeros((len(layouts), len(self._grids), 3), dtype=np.int64)
        undecided = np.zeros(len(layouts), dtype=bool)
        for first in range(0, len(layouts), _AT_A_TIME):
            some = slice(first, first + _AT_A_TIME)
            self._see_some(layouts[some], points[:, some], cells[some], undecided[some])
        return points.swapaxes(0, 1), cells, np.flatnonzero(undecided)

    def _see_some(self, layouts, points, cells, undecided):
        """Add what some layouts see to their rows: first all LiDARs that keep their pose, then one after the other."""
        poses = list(zip(*layouts, strict=True))
        moving = [number for number, of in enumerate(poses) if any(pose != of[0] for pose in of)] or [len(poses) - 1]
        bits = self._grids.no_bits(1)
        if len(poses) > 1:
            bits, of_held, certain = self._held_marks([None if k in moving else of[0] for k, of in enumerate(poses)])
            bits = np.repeat(bits, len(layouts), axis=0)  # grids of their own, as other LiDARs follow
            points += of_held
            undecided |= not certain
        for number in moving:
            last = number == moving[-1]
            self._mark_lidar(self.lidars[number], poses[number], bits, points[number], cells, undecided, last)

    def _held_marks(self, held):
        """What LiDARs that keep their pose mark, (1, words), their points (l, 1, n), and whether that is certain.

        It is kept, as a search moves one LiDAR in batch after batch.
        """
        if self._held is None or self._held[0] != held:
            bits, undecided = self._grids.no_bits(1), np.zeros(1, dtype=bool)
            points = np.zeros((len(self.lidars), 1, len(self._grids)), dtype=np.int64)
            none = np.zeros((1, len(self._grids), 3), dtype=np.int64)
            for lidar, pose, of in zip(self.lidars, held, points, strict=True):
                self._mark_lidar(lidar, [pose], bits, of, none, undecided, last=False)
            self._held = held, (bits, points, not undecided[0])
        return self._held[1]

    def _mark_lidar(self, lidar, poses, bits, points, cells, undecided, last):
        """Add what a LiDAR sees from each pose to its row; after the `last` LiDAR the cells are counted."""
        rasterised = self._caster.name == RASTER
        if rasterised and None not in poses:
            self._rasterise(lidar, poses, bits, points, cells, undecided, last)
            return
        for row, pose in enumerate(poses):
            one, grid = slice(row, row + 1), bits[row % len(bits)]
            if pose is not None and rasterised:
                self._rasterise(lidar, [pose], grid[None], points[one], cells[one], undecided[one], last)
                continue
            if pose is not None:
                undecided[row] |= not self._cast(lidar, pose, points[row], grid)
            if last:
                count_cells(grid, self._grids.start, self._grids.words, cells[row])

    def _rasterise(self, lidar, poses, *into):
        """Add what a LiDAR sees from some poses to their rows."""
        origins = np.array([pose.position for pose in poses])[:, None] + self._origins
        rotations = np.array([pose.rotation for pose in poses])
        rotations.flags.writeable = False  # as a pose's own: to Numba that is a type, and all is compiled once
        mountings = origins, rotations, lidar.components
        with self._caster.rasterising(lidar.lattice, len(poses)) as (mesh, _, *needed):
            _see_revolutions(mesh, *needed, lidar.reach_m, *mountings, *lidar.scene, *into)

    def _cast(self, lidar, pose, points, bits):
        """Mark what a LiDAR sees; whether that is certain."""
        if self._pieces is None:
            beams = np.arange(lidar.components.shape[1])
        else:
            beams = reachable_beams(lidar.lattice, self._pieces, pose, lidar.reach_m)
        if not len(beams):
            return True
        origin, reach = pose.position - self._caster.origin, lidar.reach_m
        rays = np.empty((len(beams), 3), dtype=np.float32)
        directions_of(lidar.components, beams, pose.rotation, rays)
        triangle = self._caster.first(origin, rays, reach)
        if triangle is None:
            return False
        doubtful, certain = self.mark(lidar, pose, beams, triangle, None, points, bits)
        if certain and len(doubtful):
            found = self._caster.decide(origin, ray_directions(lidar.lattice, doubtful, pose).T, reach)
            _, certain = self.mark(lidar, pose, doubtful[found.ray], found.triangle, found.distance, points, bits)
        return certain

    def mark(self, lidar, pose, beams, triangles, distance, points, bits) -> tuple[np.ndarray, bool]:
        """`mark_returns` of hits at known distances (k,) [m], or at None of hits that a tree in float32 has found."""
        origins, leaky = pose.position + self._origins, distance is None
        hits = beams, triangles, _MEASURED_HERE if leaky else distance, leaky, lidar.reach_m
        return mark_returns(*hits, origins, pose.rotation, lidar.components, *lidar.scene, bits, points)


@compiled
def mark_returns(
    beams, triangles, decided, leaky, reach, origins, rotation, components, targets, measurement, occluders, boxes,
    bits, count,
):  # fmt: skip
    """Returns from hits, and the cells that they occupy, of one LiDAR (Eqs. 2 to 8).

    Beams are taken in blocks, whose columns stay in the fastest cache.

    Parameters
    ----------
    beams, triangles : ndarray of int, (k,)
        Beams, and the row of `targets` that each met first; `MISS` where nothing. Of rasterised ones `triangles` has a
        row for each beam of the lattice.
    decided : ndarray, (k,) or (0,)
        Distances, where they are not to be measured here [m].
    leaky : bool
        Whether the hits are those of a tree in float32, and doubtful where it may have leaked.
    reach : float
        Hits that are farther away do not count [m].
    origins : ndarray, (2 + o, 3)
        The sensor's place as the targets, the boxes and each of the occluders count it [m].
    rotation, components : ndarray, (3, 3) and (3, b)
        The sensor's orientation, and the lattice's beams.
    targets, measurement, occluders, boxes : Targets, MeasurementModel, o BoxTrees or None, PackedBoxes
    bits : ndarray of uint64
        As for `mark_points`.
    count : ndarray of int64, (n,)
        Points, which are added to.

    Returns
    -------
    doubtful : ndarray of int, (d,)
        Beams that are not counted yet.
    certain : bool
        Whether no occlusion is left to rounding; if one is, what was counted is worth nothing.
    """
    known = len(decided) > 0
    imperfect = (
        len(measurement.noise_m) > 0 or measurement.glass_loss > 0.0 or measurement.range_at_10_percent_m < np.inf
    )
    column, target, beam_of = np.empty(9 * _BLOCK), np.empty(_BLOCK, np.uint32), np.empty(_BLOCK, np.uint32)
    lost = np.empty(_BLOCK, dtype=np.int8)
    doubtful, left = np.empty(len(beams) if leaky else 0, dtype=np.int64), 0
    for first in range(0, len(beams), _BLOCK):
        some = beams[first : first + _BLOCK]
        its = triangles[first : first + _BLOCK] if leaky or known else triangles
        at = decided[first : first + _BLOCK]
        found = _gather(some, its, at, leaky, targets.vehicle, components, beam_of, target, column)
        _measure(found, known, reach, origins[0], rotation, targets.planes, target, column)
        if leaky:
            left = _leave_leaks(found, origins[0], targets, beam_of, target, column, doubtful, left)
        if imperfect:
            _make_imperfect(found, measurement, targets, beam_of, target, column)
        # Alone in its line, so that Numba compiles `_hide` only where something stands.
        if occluders is not None:
            for number in range(len(occluders)):
                if not _hide(found, origins[2 + number], occluders[number], column, lost):
                    return doubtful[:left], False
        _mark(found, measurement, origins[1], targets.vehicle, boxes, target, column, bits, count)
    return doubtful[:left], True


@compiled
def _gather(beams, triangles, decided, leaky, vehicle, components, beam_of, target, column):
    """Write down the beams of a block that met a counted vehicle, or at `leaky` hits anything; how many they are."""
    x, y, z = components[0], components[1], components[2]
    known, found = len(decided) > 0, np.uint64(0)
    by_row = leaky or known
    for k in range(len(beams)):  # without a branch, which nobody could predict
        beam = np.uint32(beams[k])
        met = triangles[k if by_row else beam]
        t = np.uint32(max(met, 0))
        target[found], beam_of[found] = t, beam
        column[_X + found], column[_Y + found], column[_Z + found] = x[beam], y[beam], z[beam]
        column[_DISTANCE + found] = decided[k] if known else 0.0
        found += np.uint64((met != MISS) & (leaky | (vehicle[t] >= 0)))
    return found


@inlined
def _end_of_run(target, begin, found):
    """Where the beams end that met the same triangle: what they share is looked up once."""
    end = begin + _ONE
    while end < found and target[end] == target[begin]:
        end += _ONE
    return end


@compiled
def _measure(found, known, reach, origin, rotation, planes, target, column):
    """Direction in the road frame, cosine of the incidence, distance and measured range [m]: inf where it is lost."""
    begin = _NONE
    while begin < found:
        t, end = target[begin], _end_of_run(target, begin, found)
        nx, ny, nz, missing = planes[t, 0], planes[t, 1], planes[t, 2], signed_distance(planes, t, 0, origin)
        for k in range(begin, end):
            x, y, z = to_world(column[_X + k], column[_Y + k], column[_Z + k], rotation)  # Eq. 2
            facing = nx * x + ny * y + nz * z
            distance = column[_DISTANCE + k] if known else missing / facing
            column[_X + k], column[_Y + k], column[_Z + k], column[_FACING + k] = x, y, z, facing
            column[_DISTANCE + k], column[_AWAY + k] = distance, distance if distance <= reach else np.inf
        begin = end


@compiled
def _leave_leaks(found, origin, targets, beam_of, target, column, doubtful, left):
    """Leave out where a tree in float32 may have leaked, which is noted in `doubtful`, and what does not count."""
    for k in range(found):
        t = target[k]
        x, y, z, distance = column[_X + k], column[_Y + k], column[_Z + k], column[_DISTANCE + k]
        sure = column[_FACING + k] <= -EDGE_ON and is_inside(targets.planes, t, origin, x, y, z, distance)
        if not sure:
            doubtful[left] = beam_of[k]
            left += 1
        if not sure or targets.vehicle[t] < 0:
            column[_AWAY + k] = np.inf
    return left


@compiled
def _make_imperfect(found, measurement, targets, beam_of, target, column):
    """Range noise and lost returns, as `MeasurementModel.measured` has them."""
    noise, chance, glass, reflectivity = measurement.noise_m, measurement.chance, targets.glass, targets.reflectivity
    loss, glass_loss, strength = measurement.loss, measurement.glass_loss, measurement.range_at_10_percent_m
    noisy, lossy, weak, by_chance = len(noise) > 0, glass_loss > 0.0, strength < np.inf, len(chance) > 0
    for k in range(found):
        t, beam, away = target[k], beam_of[k], column[_AWAY + k]
        if noisy:
            away += noise[beam]
        if lossy:
            luck = chance[beam] if by_chance else np.float32(0.0)
            if luck < loss or (glass[t] and luck < glass_loss):
                away = np.inf
        if weak:
            seen = strength * np.sqrt(reflectivity[t] * abs(column[_FACING + k]) / STATED_REFLECTIVITY)
            if not column[_DISTANCE + k] <= seen:
                away = np.inf
        column[_AWAY + k] = away


@compiled
def _hide(found, origin, occluders, column, lost):
    """Lose what stands behind occluders; whether that is certain."""
    for k in range(found):
        if column[_AWAY + k] == np.inf:  # lost already: followed nowhere
            column[_DISTANCE + k] = 0.0
    x, y, z = column[_X : _X + found], column[_Y : _Y + found], column[_Z : _Z + found]
    hidden(origin, x, y, z, column[_DISTANCE : _DISTANCE + found], occluders, lost)
    for k in range(found):
        if lost[k] == 2:
            return False
        if lost[k]:
            column[_AWAY + k] = np.inf
    return True


@compiled
def _mark(found, measurement, origin, vehicle, boxes, target, column, bits, count):
    """Count returns and mark their cells: first numbers of cells, several at a time, then bits."""
    near, far, cell_m = measurement.min_range_m, measurement.max_range_m, boxes.cell_m
    centre, half_m, cells, start = boxes.centre, boxes.half_m, boxes.cells, boxes.start
    px, py, pz = origin[0], origin[1], origin[2]
    begin = _NONE
    while begin < found:
        v, end, returns = vehicle[target[begin]], _end_of_run(target, begin, found), 0
        if v < 0:
            begin = end
            continue
        v = np.uint64(v)
        cx, cy, cz, cosine, sine = centre[v, 0], centre[v, 1], centre[v, 2], boxes.cosine[v], boxes.sine[v]
        half, sides = (half_m[0, v], half_m[1, v], half_m[2, v]), (cells[0, v], cells[1, v], cells[2, v])
        grids = float(start[0, v]), float(start[1, v]), float(start[2, v])
        for k in range(begin, end):
            away = column[_AWAY + k]
            dx, dy = px + away * column[_X + k] - cx, py + away * column[_Y + k] - cy  # Eqs. 2 and 3
            x, y, z = cosine * dx + sine * dy, cosine * dy - sine * dx, pz + away * column[_Z + k] - cz  # Eqs. 4, 5
            top, side, front = cells_at(x, y, z, half, sides, cell_m, grids)
            kept = (away >= near) & (away <= far)
            column[_TOP + k], column[_SIDE + k], column[_FRONT + k] = top if kept else OUTSIDE, side, front
            returns += kept
        count[v] += returns
        for k in range(begin, end):
            if column[_TOP + k] != OUTSIDE:
                mark(bits, column[_TOP + k], column[_SIDE + k], column[_FRONT + k])
        begin = end


@compiled
def _see_revolutions(
    mesh, closed, table, buffer, number, reach, origins, rotations, components, targets, measurement, occluders, boxes,
    bits, points, hit, undecided, last,
):  # fmt: skip
    """Rasterise revolution after revolution, mark cells, and after the last LiDAR of a layout count them in `hit`."""
    nearest, beams = buffer.nearest, buffer.touched
    for s in range(len(origins)):
        if undecided[s]:
            continue
        origin, rotation, grid = origins[s, 0], rotations[s], bits[s % len(bits)]
        near_surface = rasterise(
            mesh, targets.planes, table, components, origin, rotation, reach, closed, number + s, buffer
        )
        undecided[s] = len(undecided_beams(buffer, reach)) > 0 or near_surface
        most = buffer.number[0]
        for k in range(most):
            nearest[beams[k]] = np.inf
        if undecided[s]:
            continue
        _, certain = mark_returns(
            beams[:most], buffer.triangle, np.empty(0), False, reach, origins[s], rotation, components,
            targets, measurement, occluders, boxes, grid, points[s],
        )  # fmt: skip
        if last:
            count_cells(grid, boxes.start, boxes.words, hit[s])
        undecided[s] = not certain
