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
from ..casting.kernels import NO_BOXES, directions_of, hidden, is_inside, measured, to_world
from ..casting.protocol import MISS
from ..casting.rasterise import rasterise, undecided_beams
from ..casting.tree import EDGE_ON
from ..compiled import compiled
from ..metrics.compiled_marks import mark_points
from ..metrics.view_grids import ViewGrids
from ..scene.observation import Observation
from ..sensors.imperfections import STATED_REFLECTIVITY, MeasurementModel
from ..sensors.pose import Pose
from ..world.meshes import GLASS, REFLECTIVITY
from .frame_scorer import FrameShapes

_AT_A_TIME = 64  # mountings; their marks have to differ
_MEASURED_HERE = np.empty(0)


class Targets(NamedTuple):
    """The triangles of a frame: planes (m, 13), rows of their counted vehicles (m,), -1 for none, and surfaces."""

    planes: np.ndarray
    vehicle: np.ndarray
    glass: np.ndarray
    reflectivity: np.ndarray


class Boxes(NamedTuple):
    """The counted vehicles: centre (n, 3) [m], cosine and sine of the heading (n,), and what `mark_points` needs."""

    centre: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    half_m: np.ndarray
    cell_m: float
    cells: np.ndarray
    start: np.ndarray


class CompiledScorer:
    """Counts what mountings see of the counted vehicles of a frame.

    Parameters
    ----------
    shapes : FrameShapes
        The frame, in which at least one vehicle counts, behind a caster other than `exact`.
    grids : ViewGrids
        Of the vehicles that count.
    observation : Observation
    measurement : MeasurementModel
        Of this frame.
    reach_m : float
        How far beams are followed [m]: beyond the range gate, as noise carries returns across it.
    """

    def __init__(
        self,
        shapes: FrameShapes,
        grids: ViewGrids,
        observation: Observation,
        measurement: MeasurementModel,
        reach_m: float,
    ) -> None:
        caster, vehicles, scenery = shapes.tree, shapes.counted, observation.scenery
        self._caster, self._grids, self._lattice, self._reach_m = caster, grids, observation.lattice, reach_m
        self._pieces = shapes.pieces if observation.culled and caster.name != RASTER else None
        self._components = self._lattice.components.reshape(3, -1)
        surface = shapes.surface[caster.rows]
        vehicle = np.ascontiguousarray(shapes.counted_row[caster.rows])
        targets = Targets(caster.planes, vehicle, surface == GLASS, REFLECTIVITY[surface])
        centre, heading = np.ascontiguousarray(vehicles.centre_m), vehicles.heading_rad
        boxes = Boxes(centre, np.cos(heading), np.sin(heading), grids.half_m, grids.cell_m, grids.cells, grids.start)
        occluder_origin, occluders = (caster.origin, NO_BOXES) if scenery is None else scenery.occluders
        self._origins = -np.stack([caster.origin, np.zeros(3), occluder_origin])
        self._scene = targets, measurement, occluders, boxes

    def see(self, poses: Sequence[Pose]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points (s, n) and marked cells (s, n, 3) of s mountings, and those of them at which rounding decides.

        What is counted for the latter, rows of `poses`, is worth nothing.
        """
        points = np.zeros((len(poses), len(self._grids)), dtype=np.int64)
        cells = np.zeros((len(poses), len(self._grids), 3), dtype=np.int64)
        undecided = np.zeros(len(poses), dtype=bool)
        if self._caster.name == RASTER:
            for first in range(0, len(poses), _AT_A_TIME):
                some = slice(first, first + _AT_A_TIME)
                self._rasterise(poses[some], points[some], cells[some], undecided[some])
        else:
            for row, pose in enumerate(poses):
                undecided[row] = not self._cast(pose, points[row], cells[row])
        return points, cells, np.flatnonzero(undecided)

    def _rasterise(self, poses, points, cells, undecided):
        """Add what some mountings see to their rows."""
        origins = np.array([pose.position for pose in poses])[:, None] + self._origins
        mountings = origins, np.array([pose.rotation for pose in poses]), self._components
        into = *self._grids.take_marks(len(poses)), points, cells, undecided
        with self._caster.rasterising(self._lattice, len(poses)) as (mesh, _, *needed):
            _see_revolutions(mesh, *needed, self._reach_m, *mountings, *self._scene, *into)

    def _cast(self, pose, points, cells):
        """Add what a mounting sees to its rows; whether that is certain."""
        if self._pieces is None:
            beams = np.arange(self._components.shape[1])
        else:
            beams = reachable_beams(self._lattice, self._pieces, pose, self._reach_m)
        if not len(beams):
            return True
        origin, reach = pose.position - self._caster.origin, self._reach_m
        rays = np.empty((len(beams), 3), dtype=np.float32)
        directions_of(self._components, beams, pose.rotation, rays)
        triangle = self._caster.first(origin, rays, reach)
        if triangle is None:
            return False
        into = points, cells, *self._grids.take_marks(1)
        doubtful, certain = self.count(pose, beams, triangle, None, *into)
        if certain and len(doubtful):
            found = self._caster.decide(origin, ray_directions(self._lattice, doubtful, pose).T, reach)
            _, certain = self.count(pose, doubtful[found.ray], found.triangle, found.distance, *into)
        return certain

    def count(self, pose, beams, triangles, distance, points, cells, marks, mark) -> tuple[np.ndarray, bool]:
        """`count_returns` of hits at known distances (k,) [m], or at None of hits that a tree in float32 has found."""
        origins, leaky = pose.position + self._origins, distance is None
        hits = beams, triangles, _MEASURED_HERE if leaky else distance, leaky, self._reach_m
        return count_returns(*hits, origins, pose.rotation, self._components, *self._scene, marks, mark, points, cells)


@compiled
def count_returns(
    beams, triangles, decided, leaky, reach, origins, rotation, components, targets, measurement, occluders, boxes,
    marks, mark, count, hit,
):  # fmt: skip
    """Returns from hits, and the cells that they occupy, of one mounting (Eqs. 2 to 8).

    Parameters
    ----------
    beams, triangles : ndarray of int, (k,)
        Beams, and the row of `targets` that each met first; `MISS` where nothing.
    decided : ndarray, (k,) or (0,)
        Distances, where they are not to be measured here [m].
    leaky : bool
        Whether the hits are those of a tree in float32, and doubtful where it may have leaked.
    reach : float
        Hits that are farther away do not count [m].
    origins : ndarray, (3, 3)
        The sensor's place as the targets, the boxes and the occluders count it [m].
    rotation, components : ndarray, (3, 3) and (3, b)
        The sensor's orientation, and the lattice's beams.
    targets, measurement, occluders, boxes : Targets, MeasurementModel, BoxTree, Boxes
    marks, mark : ndarray, int
        As for `mark_points`.
    count, hit : ndarray of int64, (n,) and (n, 3)
        Points and marked cells, which are added to.

    Returns
    -------
    doubtful : ndarray of int, (d,)
        Beams that are not counted yet.
    certain : bool
        Whether no occlusion is left to rounding; if so nothing is counted.
    """
    planes, vehicle, glass, reflectivity = targets.planes, targets.vehicle, targets.glass, targets.reflectivity
    near, far, noise, chance = measurement.min_range_m, measurement.max_range_m, measurement.noise_m, measurement.chance
    loss, glass_loss, strength = measurement.loss, measurement.glass_loss, measurement.range_at_10_percent_m
    centre, cosine, sine = boxes.centre, boxes.cosine, boxes.sine
    noisy, lossy, weak, by_chance = len(noise) > 0, glass_loss > 0.0, strength < np.inf, len(chance) > 0
    origin, hides, known = (origins[0, 0], origins[0, 1], origins[0, 2]), len(occluders.order) > 0, len(decided) > 0
    by_beam = not (leaky or known)
    px, py, pz = origins[1, 0], origins[1, 1], origins[1, 2]
    local, row, found = np.empty((len(beams), 3)), np.empty(len(beams), dtype=np.int64), 0
    rays, ranges = np.empty((len(beams) if hides else 0, 3)), np.empty(len(beams) if hides else 0)
    doubtful, left = np.empty(len(beams) if leaky else 0, dtype=np.int64), 0
    for k in range(len(beams)):
        beam = beams[k]
        t = triangles[beam] if by_beam else triangles[k]
        if t == MISS or not (leaky or vehicle[t] >= 0):
            continue
        x, y, z = to_world(components[0, beam], components[1, beam], components[2, beam], rotation)  # Eq. 2
        facing = planes[t, 0] * x + planes[t, 1] * y + planes[t, 2] * z
        distance = decided[k] if known else measured(planes, t, origin, x, y, z)
        if leaky and not (facing <= -EDGE_ON and is_inside(planes, t, origin, x, y, z, distance)):
            doubtful[left] = beam
            left += 1
            continue
        v, away = vehicle[t], distance
        if v < 0:
            continue
        # As `MeasurementModel.measured` has it.
        if noisy:
            away += noise[beam]
        if lossy:
            luck = chance[beam] if by_chance else np.float32(0.0)
            if luck < loss or (glass[t] and luck < glass_loss):
                continue
        if weak and not distance <= strength * np.sqrt(reflectivity[t] * abs(facing) / STATED_REFLECTIVITY):
            continue
        if not (near <= away <= far and distance <= reach):
            continue
        dx, dy = px + away * x - centre[v, 0], py + away * y - centre[v, 1]  # Eqs. 2 and 3
        local[found, 0], local[found, 1] = cosine[v] * dx + sine[v] * dy, cosine[v] * dy - sine[v] * dx  # Eqs. 4, 5
        local[found, 2], row[found] = pz + away * z - centre[v, 2], v
        if hides:
            rays[found, 0], rays[found, 1], rays[found, 2], ranges[found] = x, y, z, distance
        else:
            count[v] += 1
        found += 1
    if hides:
        lost, shown = hidden(origins[2], rays[:found], ranges[:found], occluders), 0
        for k in range(found):
            if lost[k] == 2:
                return doubtful[:left], False
            if not lost[k]:
                local[shown, 0], local[shown, 1], local[shown, 2] = local[k, 0], local[k, 1], local[k, 2]
                row[shown] = row[k]
                count[row[k]] += 1
                shown += 1
        found = shown
    mark_points(local[:found], row[:found], boxes.half_m, boxes.cell_m, boxes.cells, boxes.start, marks, mark, hit)
    return doubtful[:left], True


@compiled
def _see_revolutions(
    mesh, closed, table, buffer, number, reach, origins, rotations, components, targets, measurement, occluders, boxes,
    marks, first_mark, points, hit, undecided,
):  # fmt: skip
    """Rasterise revolution after revolution and add up `points` and `hit`."""
    nearest, beams = buffer.nearest, buffer.touched
    for s in range(len(origins)):
        origin, rotation = origins[s, 0], rotations[s]
        near_surface = rasterise(
            mesh, targets.planes, table, components, origin, rotation, reach, closed, number + s, buffer
        )
        undecided[s] = len(undecided_beams(buffer, reach)) > 0 or near_surface
        most = buffer.number[0]
        for k in range(most):
            nearest[beams[k]] = np.inf
        if undecided[s]:
            continue
        _, certain = count_returns(
            beams[:most], buffer.triangle, np.empty(0), False, reach, origins[s], rotation, components,
            targets, measurement, occluders, boxes, marks, first_mark + s, points[s], hit[s],
        )  # fmt: skip
        undecided[s] = not certain
