"""A data set for detectors: which scans there are, and each as a labelled point cloud; nothing here knows of files.

A scan is a frame of the traffic under a random mounting. The traffic may be moved along the road, as if the site stood
at another station of it, and mirrored along it, so that it comes from the other side: left-hand traffic seen from the
same kerb.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..casting.culling import Pieces, reachable_beams
from ..casting.protocol import StandingScenery
from ..clouds.scan import FrameScan, PointCloud, Turn
from ..road.road_map import Flat, RoadMap
from ..scene import usual
from ..scene.mounting import Mounting
from ..scene.observation import Observation, of_scored_class
from ..scene.provenance import versions
from ..scene.region import Region
from ..scene.scenario import Scenario
from ..scene.site import Site, standing_scenery
from ..scoring.frame_scorer import FrameShapes
from ..scoring.workers import Workers
from ..sensors.beams import BeamLattice
from ..sensors.pose import Pose
from ..traffic.boxes import Boxes
from ..traffic.vehicles import PEDESTRIAN, rectangles_overlap
from ..world.triangles import place
from .judge import believed, hung_off_by

TRAIN, VAL = "train", "val"
_GOLDEN = (5.0**0.5 - 1.0) / 2.0  # multiples of it are spread evenly, any run of them
_COVERED = (1.0, 99.0)  # percentiles of the vehicles' places along the road between which a recording has traffic
_ALONG, _ALONG_SHARE = math.radians(15.0), 0.95  # of the vehicles, on a straight road
_MOST_DRAWS = 50  # of a station at which the LiDAR stands beside the traffic
_TOUCHING_M = 1e-6  # what touches a pole is in its way
_MOUNTINGS, _SCANS = range(2)  # streams of random numbers


@dataclass(frozen=True, slots=True)
class PlannedScan:
    """One scan of a data set.

    Attributes
    ----------
    number : int
        From 0 on.
    split : {"train", "val"}
    frame : int
        Row in `DatasetPlan.frames`.
    mounting : int
        Row in `DatasetPlan.mounts`.
    mount, hangs : Mounting
        The six coordinates that are planned, and those at which the LiDAR hangs [m, degrees].
    station_m : float
        How far along the straight road of the recording the site's origin lies [m].
    mirrored : bool
        Whether the traffic is then reflected there, so that it comes from the other side.
    seed : int
        Of the clutter and of the sensor's imperfections.
    """

    number: int
    split: str
    frame: int
    mounting: int
    mount: Mounting
    hangs: Mounting
    station_m: float
    mirrored: bool
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class DatasetPlan:
    """Which scans a data set has.

    Attributes
    ----------
    scenario : Scenario
    observation : Observation
        Sensor, range gate, caster and detail; what stands still, except for clutter, which each scan draws.
    region : Region
        Where vehicles count.
    reach_m : float
        How far from its middle vehicles are looked at [m].
    frames : tuple of Boxes
        The searched and the held-out frames, as recorded.
    blocks, recordings : ndarray of int64, (f,)
        Block of time of each frame, of which each split counts its own, and its recording, from 0.
    mounts : tuple of Mounting
    scans : tuple of PlannedScan
    taught_ids : ndarray of int64, (j,)
        Vehicles that any training scan labels, ascending: validating scans do not.
    seed : int
    notes : tuple of str
        What could not be had, as sentences.
    versions : mapping of str to str
        Of what the clouds depend on, in whichever process they are made.
    """

    scenario: Scenario
    observation: Observation
    region: Region
    reach_m: float
    frames: tuple[Boxes, ...]
    blocks: np.ndarray
    recordings: np.ndarray
    mounts: tuple[Mounting, ...]
    scans: tuple[PlannedScan, ...]
    taught_ids: np.ndarray
    seed: int
    notes: tuple[str, ...]
    versions: Mapping[str, str]

    def __len__(self) -> int:
        return len(self.scans)


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """A labelled point cloud.

    Attributes
    ----------
    scan : PlannedScan
        What was scanned, from where, and whether it trains or validates.
    pose : Pose
        The planned pose in the frame of the road.
    cloud : PointCloud
        In the road frame; where the LiDAR hangs off its plan, in the one that follows from the plan.
    vehicles : Boxes
        All v within reach, moved and mirrored as the cloud is; those with `counted`, in the region and labelled, are
        what a detector is judged by.
    labelled : ndarray of bool, (v,)
        Those to learn from: in the region or within the range gate and, in a validating scan, of none that trains. The
        others are neither hits nor false alarms.
    points : ndarray of int64, (v,)
        Returns from each vehicle.
    visibility : ndarray, (v,)
        Share of the beams towards each vehicle's box, within the range gate, that nothing nearer stops; 0 where there
        is no such beam.
    """

    scan: PlannedScan
    pose: Pose
    cloud: PointCloud
    vehicles: Boxes
    labelled: np.ndarray
    points: np.ndarray
    visibility: np.ndarray


# --- The plan ---------------------------------------------------------------------------------------------------------


def plan_dataset(
    site: Site, mountings: int, scans: int | None = None, seed: int = 1, *, as_recorded: bool = False
) -> DatasetPlan:
    """Choose mountings, stations and which scans are mirrored; searched frames train, held-out ones validate.

    What a scan draws depends on the seed and its number alone.

    Parameters
    ----------
    site : Site
    mountings : int
        How many, uniform between the bounds of [deployment], on its poles in turn.
    scans : int, optional
        How many; each frame at each mounting once when left out. Fewer are spread evenly over frames and mountings.
    seed : int
    as_recorded : bool
        Neither move nor mirror the traffic.
    """
    frames = tuple(map(site.recording.at, (*site.plan.search.tolist(), *site.plan.holdout.tolist())))
    scans = len(frames) * mountings if scans is None else scans
    mounts = tuple(_mount(site.scenario, seed, number) for number in range(mountings))
    notes, axis = [] if len(site.plan.holdout) else ["no frame is held out, so there are no validation scans"], None
    if not as_recorded:
        axis = _axis(frames, site.scenario.road_map)
        if axis is None:
            notes.append("the traffic does not drive along a straight road: it is neither moved nor mirrored")
    stations = None if axis is None else _Stations(site, frames, axis)
    if stations and stations.is_one:
        notes.append("the recording covers no more of the road than the site sees: the traffic is not moved along it")
    order = np.argsort(np.arange(len(frames)) * _GOLDEN % 1.0, kind="stable").tolist()  # few scans are of any time
    planned = []
    for number in range(scans):
        turn, at = divmod(number, len(frames))
        frame, mounting = order[at], (turn + at) % mountings
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_SCANS, number)))
        mount = mounts[mounting]
        hangs = hung_off_by(site.scenario, mount, rng)
        scan_seed = int(rng.integers(2**31))
        station, mirrored = stations.draw(mount, rng) if stations else (0.0, False)
        split = TRAIN if frame < len(site.plan.search) else VAL
        planned.append(PlannedScan(number, split, frame, mounting, mount, hangs, station, mirrored, scan_seed))
    world = site.scenario.world
    bare = replace(site.scenario, world=replace(world, clutter=0.0))
    observation = site.observation
    if world.clutter:
        observation = replace(observation, scenery=standing_scenery(bare, observation.caster))
    nobody = np.zeros(0, dtype=np.int64)
    blocks = np.concatenate([site.plan.search_block, site.plan.holdout_block])
    recordings = np.concatenate([site.plan.search_recording, site.plan.holdout_recording])
    seen = site.scenario, observation, site.region, site.reach_m, frames, blocks, recordings
    plan = DatasetPlan(*seen, mounts, tuple(planned), nobody, seed, tuple(notes), versions(observation.caster))
    taught = [nobody]
    for scan in planned:
        if scan.split == TRAIN:
            vehicles, labelled = _traffic(plan, scan)
            taught.append(vehicles.vehicle_id[labelled])
    return replace(plan, taught_ids=np.unique(np.concatenate(taught)))


def _mount(scenario: Scenario, seed: int, number: int) -> Mounting:
    """The mounting of a number: uniform between the bounds of [deployment], on its poles in turn."""
    spaces = scenario.lidar.deployment.spaces
    chosen = spaces[number % len(spaces)]
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_MOUNTINGS, number)))
    (mounting,) = chosen.layout(rng.uniform(chosen.lower, chosen.upper))
    return mounting


def _axis(frames: Iterable[Boxes], road: RoadMap) -> np.ndarray | None:
    """Unit vector (2,) along a straight road, where nearly all drive along it, one way or the other; else None."""
    if (axis := road.axis) is None:
        return None
    heading = np.concatenate([vehicles.heading_rad for vehicles in frames])
    off = axis[0] * np.sin(heading) - axis[1] * np.cos(heading)
    return axis if (np.abs(off) < math.sin(_ALONG)).mean() >= _ALONG_SHARE else None


def _mirror(axis: np.ndarray) -> np.ndarray:
    """Reflection that turns an axis (2,) into its opposite, (2, 2)."""
    return np.eye(2) - 2.0 * np.outer(axis, axis)


class _Stations:
    """Where along a straight road the site may stand: with traffic all over it, and none where the LiDAR's pole is."""

    def __init__(self, site: Site, frames: Iterable[Boxes], axis: np.ndarray) -> None:
        region, self._axis = site.region, axis
        self._boxes = [
            np.concatenate([getattr(vehicles, name) for vehicles in frames])
            for name in ("centre_m", "size_m", "heading_rad")
        ]
        self._frame = np.array([axis, (-axis[1], axis[0])])  # rows: along the road, and across it
        self._places = self._boxes[0][:, :2] @ self._frame.T
        along, self._reach = self._places[:, 0], self._boxes[1][:, :2].max(axis=1, initial=0.0)
        first, last = np.percentile(along, _COVERED) if len(along) else (0.0, 0.0)
        reach = max(region.radius_m, site.observation.lidar.max_range_m)
        self._middle, self._low, self._high = float(axis @ region.centre_xy), first + reach, last - reach
        self._over_lanes = site.scenario.road_map.within

    @property
    def is_one(self) -> bool:
        """Whether there is no choice."""
        return self._low >= self._high

    def draw(self, mount: Mounting, rng: np.random.Generator) -> tuple[float, bool]:
        """Station [m], and whether the traffic is mirrored."""
        mirrored = bool(rng.random() < 0.5)
        middle = -self._middle if mirrored else self._middle
        draws = 0 if self.is_one else _MOST_DRAWS
        stations = (self._low - middle + (self._high - self._low) * rng.random(draws)).tolist()
        return next(((s, mirrored) for s in (*stations, 0.0) if self._is_clear(mount, s, mirrored)), (0.0, False))

    def _is_clear(self, mount: Mounting, station_m: float, mirrored: bool) -> bool:
        """Whether no vehicle of any frame passes where the LiDAR hangs, or has just passed or is about to."""
        pole = station_m * self._axis + (mount.xy @ _mirror(self._axis) if mirrored else mount.xy)
        centre, size, heading = self._boxes
        along, across = np.abs(self._places - self._frame @ pole).T
        near = np.flatnonzero((across <= self._reach) & (along <= self._reach + usual.ABREAST_M))
        if self._over_lanes([mount.xy])[0]:  # on a gantry: what is lower than the LiDAR passes below it
            near = near[centre[near, 2] + 0.5 * size[near, 2] >= mount.pose.height_m]
        passing = pole, np.array([usual.ABREAST_M, 0.0]) + _TOUCHING_M, math.atan2(self._axis[1], self._axis[0])
        return not rectangles_overlap(centre[near, :2], 0.5 * size[near, :2], heading[near], *passing).any()


def _moved(vehicles: Boxes, station_m: float, mirrored: bool, axis: np.ndarray | None) -> Boxes:
    """A frame seen from a station of a straight road, and mirrored there: along x, a heading h becomes pi - h."""
    if not (station_m or mirrored):
        return vehicles
    xy, heading = vehicles.centre_m[:, :2] - station_m * axis, vehicles.heading_rad
    if mirrored:
        xy = xy @ _mirror(axis)
        ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1) @ _mirror(axis)
        heading = np.arctan2(ahead[:, 1], ahead[:, 0])
    return replace(vehicles, centre_m=np.column_stack([xy, vehicles.centre_m[:, 2]]), heading_rad=heading)


def _traffic(plan: DatasetPlan, scan: PlannedScan) -> tuple[Boxes, np.ndarray]:
    """The vehicles of a scan within reach, those that count, and which of them are labelled."""
    axis = plan.scenario.road_map.axis
    vehicles = _moved(plan.frames[scan.frame], scan.station_m, scan.mirrored, axis)
    vehicles = vehicles.select(plan.region.distance(vehicles) <= plan.reach_m)
    away = np.hypot(*(vehicles.centre_m[:, :2] - scan.mount.xy).T)
    inside = plan.region.holds(vehicles) & of_scored_class(vehicles, plan.scenario.objective)
    inside &= vehicles.class_index != PEDESTRIAN  # whom detectors of vehicles are not judged by
    labelled = plan.region.holds(vehicles) | (away <= plan.observation.lidar.max_range_m)
    if scan.split == VAL:
        labelled &= ~np.isin(vehicles.vehicle_id, plan.taught_ids)
    return replace(vehicles, counted=inside & labelled), labelled


# --- Samples ----------------------------------------------------------------------------------------------------------


def sample(plan: DatasetPlan, number: int) -> Sample:
    """The sample of a number: the same in every order and process."""
    scan = plan.scans[number]
    vehicles, labelled = _traffic(plan, scan)
    seen = replace(
        plan.observation.with_lidar(imperfections=replace(plan.observation.lidar.imperfections, seed=scan.seed)),
        scenery=_scenery(plan, scan),
    )
    shapes = FrameShapes(vehicles, seen.detail, seen.caster, seen.bodies)
    frame = FrameScan(shapes, vehicles, seen, ground=plan.scenario.plane_returns)
    hangs = scan.hangs.pose
    turn = frame.turn(hangs)
    cloud = frame.cloud(hangs, turn)
    visibility = visible_share(vehicles, seen.lattice, hangs, turn, seen.lidar.max_range_m)
    points = np.bincount(vehicles.rows_of(cloud.vehicle_id[cloud.vehicle_id >= 0]), minlength=len(vehicles))
    if scan.hangs != scan.mount:
        cloud = believed(cloud, hangs, scan.mount.pose)
    return Sample(scan, scan.mount.pose, cloud, vehicles, labelled, points, visibility)


def samples(plan: DatasetPlan, numbers: Iterable[int] | None = None, workers: int = 1) -> Iterator[Sample]:
    """Samples by their numbers, all when left out, one after another in that order, by so many processes."""
    numbers = range(len(plan)) if numbers is None else numbers
    with closing(Workers(partial(sample, plan), workers)) as pool:
        yield from pool.each(numbers)


def _scenery(plan: DatasetPlan, scan: PlannedScan) -> StandingScenery | None:
    """What stands still about a scan: each draws its clutter, so that a detector does not learn where it stands."""
    scenery, world = plan.observation.scenery, plan.scenario.world
    if not world.clutter:
        return scenery
    nothing = {"blend": None, "mesh": None, "boxes": (), "barriers": (), "clutter_seed": scan.seed}
    flat = replace(plan.scenario.road_map, surface=Flat())  # it stands there already
    scenario = replace(plan.scenario, world=replace(world, **nothing), road_map=flat)
    return standing_scenery(scenario, plan.observation.caster, more=None if scenery is None else scenery.scenery)


# --- Visibility -------------------------------------------------------------------------------------------------------

_HALF = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_ROUNDING_M = 1e-6


def visible_share(vehicles: Boxes, lattice: BeamLattice, pose: Pose, turn: Turn, max_range_m: float) -> np.ndarray:
    """How much of each vehicle nothing hides, (v,), 0 to 1.

    Of the beams that would enter its box within `max_range_m`, the share that meets nothing before; 0 without such a
    beam. It is found from the revolution that was cast anyway: a beam that passes through a corner of the box above the
    bonnet is one that sees it.
    """
    first = np.full(len(turn.directions), np.inf)
    first[turn.vehicles.beam] = turn.vehicles.distance
    for beam, away, *_ in turn.standing:
        first[beam] = np.minimum(first[beam], away)
    corners = place(_HALF, vehicles.centre_m, vehicles.size_m, vehicles.heading_rad).transpose(0, 2, 1)
    radius = 0.5 * np.linalg.norm(vehicles.size_m, axis=1)
    away, half = pose.position - vehicles.centre_m, 0.5 * vehicles.size_m
    cos, sin = np.cos(vehicles.heading_rad), np.sin(vehicles.heading_rad)
    share = np.zeros(len(vehicles))
    for row in np.flatnonzero(np.linalg.norm(away, axis=1) - radius <= max_range_m):
        piece = Pieces(corners[row, :, :, None], vehicles.centre_m[row, :, None], radius[row : row + 1])
        beams = reachable_beams(lattice, piece, pose, max_range_m)
        turned = np.array([[cos[row], -sin[row], 0.0], [sin[row], cos[row], 0.0], [0.0, 0.0, 1.0]])
        enters = _entry(away[row] @ turned, turn.directions[beams] @ turned, half[row])
        towards = enters <= max_range_m
        if towards.any():
            share[row] = (first[beams[towards]] >= enters[towards] - _ROUNDING_M).mean()
    return share


def _entry(origin: np.ndarray, directions: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Where rays from an origin (3,) along `directions` (k, 3) enter a box about 0, (k,) [m]; inf where they miss."""
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (-half - origin) / directions, (half - origin) / directions
    enters = np.fmin(one, other).max(axis=1)
    leaves = np.fmax(one, other).min(axis=1)
    return np.where(leaves >= np.maximum(enters, 0.0), np.maximum(enters, 0.0), np.inf)
