"""Ours by stage: culling, casting the survivors, scoring, the whole; drawing a turn where whole turns are drawn."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from ..casting import RASTER, caster_class
from ..metrics.vgop import entropy, pe_vgop
from ..metrics.view_grids import PlacedGrids
from ..sensors.pose import Pose
from ..study.frame_scorer import FrameScorer
from .case import FrameCase
from .timing import Entry

GROUP, METRIC_GROUP = "ours", "metric"
SWARM = 20  # mountings that a search of the paper's size scores at a time
KITTI_CARS, POINTS_EACH = 14_357, 400  # the paper's section IV: 18 s for its cars, from file to score
CULLING, TURNING = "culling", "directions of the survivors"


def whole_of(caster: str) -> str:
    """Name of the entry of a whole frame."""
    return f"{caster}: the whole"


def casting_of(caster: str) -> str:
    """Name of the entry of casting alone."""
    return f"{caster}: drawing a turn" if caster == RASTER else f"{caster}: casting the survivors"


def stage_entries(case: FrameCase, casters: Sequence[str]) -> list[Entry]:
    """Every stage of one frame with each caster."""
    entries = [Entry(whole_of(name), partial(_whole, _scorer(case, name), [case.pose]), GROUP) for name in casters]
    swarm = swarm_about(case.pose)
    entries += [
        Entry(
            f"{name}: a mounting of a swarm of {SWARM}",
            partial(_whole, _scorer(case, name), swarm),
            GROUP,
            1.0 / SWARM,
        )
        for name in casters
    ]
    if set(casters) - {RASTER}:
        entries += [Entry(CULLING, case.cull, GROUP), Entry(TURNING, case.turn_survivors, GROUP)]
    for name in casters:
        entries += _stages(case, name)
    return entries


def metric_entry() -> Entry:
    """The metric alone, on as many cars as the paper's KITTI split has."""
    rng = np.random.default_rng(0)
    size = rng.uniform(0.9, 1.1, (KITTI_CARS, 3)) * [4.5, 1.8, 1.5]
    vehicle = np.repeat(np.arange(KITTI_CARS), POINTS_EACH)
    points = rng.uniform(-0.5, 0.5, (len(vehicle), 3)) * size[vehicle]
    name = f"the metric alone: {KITTI_CARS:,} vehicles x {POINTS_EACH} points"
    return Entry(name, partial(pe_vgop, points, vehicle, size), METRIC_GROUP)


def swarm_about(pose: Pose) -> list[Pose]:
    """Mountings at the place of another, within the heights and tilts that are searched."""
    rng = np.random.default_rng(1)
    heights, tilts = rng.uniform(2.0, 4.5, SWARM), np.radians(rng.uniform(0.0, 25.0, SWARM))
    return [Pose(pose.x_m, pose.y_m, z, tilt) for z, tilt in zip(heights.tolist(), tilts.tolist(), strict=True)]


def _scorer(case: FrameCase, caster: str) -> FrameScorer:
    return FrameScorer(case.vehicles, case.counted, case.observation(caster))


def _whole(scorer: FrameScorer, poses: Sequence[Pose]) -> np.ndarray:
    """Bits of every vehicle and mounting."""
    return entropy(scorer.see(poses).occupancy).sum(axis=2)


def _stages(case: FrameCase, name: str) -> list[Entry]:
    """Casting and scoring, each by itself."""
    caster = caster_class(name)(case.triangles.corners, closed=True)
    if name == RASTER:
        cast = partial(caster.turn, case.lattice, case.pose, case.gate_m)
        found = cast()
        returns = found.directions, found.triangle, found.distance
    else:
        rays = case.turn_survivors()
        cast = partial(caster.meet, case.pose.position, rays.T, case.gate_m)
        met = cast()
        returns = np.take(rays, met.ray, axis=1), met.triangle, met.distance
    return [
        Entry(casting_of(name), cast, GROUP),
        Entry(f"{name}: scoring", partial(_score, case, _grids(case), *returns), GROUP),
    ]


def _grids(case: FrameCase) -> PlacedGrids:
    vehicles = case.vehicles.select(case.counted)
    return PlacedGrids(vehicles.centre_m, vehicles.size_m, vehicles.heading_rad, case.cell_m)


def _score(case: FrameCase, grids: PlacedGrids, directions, triangle, distance) -> np.ndarray:
    """Bits of every counted vehicle, from what the beams met."""
    row = np.where(case.counted, np.cumsum(case.counted) - 1, -1)[case.triangles.owner[triangle]]
    wanted = np.flatnonzero((row >= 0) & (distance <= case.gate_m))
    shares = grids.returns_occupancy(
        case.pose.position[None], None, np.take(directions, wanted, axis=1), distance[wanted], row[wanted]
    )
    return entropy(shares[0]).sum(axis=1)
