"""A detector judged at mountings of a scene: it sees whole point clouds and knows nothing of what made them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ..clouds.fit import accepted, detections_misfit
from ..clouds.scan import PointCloud
from ..clouds.snapshot import MountedSensor
from ..errors import InputError
from ..scene.installation import installed
from ..scene.mounting import Layout, Mounting
from ..scene.region import Region
from ..scene.scenario import Scenario
from ..scene.site import Site
from ..scoring.workers import Workers
from ..sensors.pose import Pose
from ..traffic.boxes import KINDS, Boxes, late_fusion, no_boxes
from .classical import ClassicalDetector, early_fusion
from .files import Poses, read_detected
from .pillars import SHIPPED, PillarsDetector
from .scores import CRITERIA, Matches, by_approach, by_distance, match, measured, paired_intervals


class Detector(Protocol):
    """What finds vehicles in the clouds of one mounting; one that learns has `range_image` and `learn` besides."""

    name: str
    learns: bool

    def detect(self, cloud: PointCloud) -> tuple[Boxes, Any]:
        """The vehicles of one frame, and what `notes` needs to know of it."""

    def notes(self, seen: Sequence[Any]) -> Sequence[str]:
        """What was unlike what it is made for in the frames that were `seen`, as sentences."""


EARLY = "early fusion"
DETECTORS = (PillarsDetector.name, ClassicalDetector.name)
_ASIDE_M = 8.0
CLOUDS_A_PROCESS = 12  # fewer are done before another process has started


def is_weights(detector: str) -> bool:
    """Whether it is a file of weights, and so a detector of ours."""
    return Path(detector).suffix.lower() == ".npz"


def is_ours(detector: str) -> bool:
    """Whether it looks at clouds; else it is a file of detections."""
    return detector in DETECTORS or is_weights(detector)


def weights_of(detector: str) -> str | Path:
    """The file of weights of PointPillars that a name stands for: those that ship, or its own."""
    return SHIPPED if detector == PillarsDetector.name else detector


def detector_at(site: Site, mounting: Mounting, name: str) -> Detector:
    """A detector of ours for a mounting of a site: by a name of `DETECTORS`, or PointPillars with weights of one's own.

    Raises
    ------
    MissingExtraError
        When the detector needs a library that is not installed.
    MissingFileError, InputError
        When the weights cannot be used.
    """
    seen = site.observation
    if name == ClassicalDetector.name:
        return ClassicalDetector(seen.lattice, mounting.xy, seen.lidar.imperfections)
    found = PillarsDetector(seen.lattice.model.name, mounting.pose, *watched(site), weights_of(name))
    heading = np.concatenate([frame.heading_rad[frame.counted] for frame in site.search])
    found.check_headings(heading)
    return found


def watched(site: Site) -> tuple[np.ndarray, np.ndarray]:
    """Where detectors of ours look: the lower and the upper corner of a rectangle, x and y [m, road frame].

    It is that of the region, but across a straight road no farther than 8 m beside the carriageway where all vehicles
    that count in the searched frames keep to that.
    """
    region = site.region
    if not site.scenario.road_map.endless:
        corners = np.concatenate(region.outlines)
        return corners.min(axis=0), corners.max(axis=0)
    low, high = (np.array(region.centre_xy) + side * region.radius_m for side in (-1.0, 1.0))
    road, xy = site.scenario.road_map, [frame.centre_m[frame.counted, :2] for frame in site.search]
    (right, left), t = road.edges_t, road.locate(np.concatenate(xy)).t_m
    if right - _ASIDE_M <= t.min(initial=np.inf) and t.max(initial=-np.inf) <= left + _ASIDE_M:
        s = road.stations(road.stretch(region.centre_xy, region.radius_m))
        beside = np.concatenate([road.at(s, t) for t in (right - _ASIDE_M, left + _ASIDE_M)])
        low, high = np.maximum(low, beside.min(axis=0)), np.minimum(high, beside.max(axis=0))
    return low, high


def within(boxes: Boxes, low: np.ndarray, high: np.ndarray) -> Boxes:
    """The boxes whose middles lie in the rectangle between two corners, (2,) each [m]."""
    xy = boxes.centre_m[:, :2]
    return boxes.select(((xy >= low) & (xy <= high)).all(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class JudgedDetector:
    """What a detector made of the judging frames at one mounting.

    Attributes
    ----------
    boxes : sequence of Boxes, f
        Its detections of each frame.
    matches : sequence of Matches
        By each of `CRITERIA`.
    of_kinds : sequence of sequence of Matches
        The same of each of `KINDS` alone.
    with_return : float or None
        Share of the vehicles with at least one return, which no detector can exceed by much; None where the clouds are
        not ours.
    notes : sequence of str
        What was unlike what the detector is made for.
    warnings : sequence of dict
        What does not fit of a file of detections and was accepted, for a result file.
    """

    boxes: Sequence[Boxes]
    matches: Sequence[Matches]
    of_kinds: Sequence[Sequence[Matches]]
    with_return: float | None
    notes: Sequence[str] = ()
    warnings: Sequence[Mapping[str, str]] = ()


def judging_frames(site: Site) -> tuple[Sequence[Boxes], np.ndarray, np.ndarray]:
    """The frames that judge, their blocks of time and their recordings: the held-out ones, or all where none is."""
    plan = site.plan
    if len(site.holdout):
        return site.holdout, plan.holdout_block, plan.holdout_recording
    return site.search, plan.search_block, plan.search_recording


def hung_off(site: Site, mounting: Mounting) -> Mounting:
    """Where a LiDAR hangs by one draw within the scene's pose error, by its seed and the LiDAR's name."""
    rng = np.random.default_rng([site.scenario.search.seed, *site.observation.lidar.key])
    return hung_off_by(site.scenario, mounting, rng)


def hung_off_by(scenario: Scenario, mounting: Mounting, rng: np.random.Generator) -> Mounting:
    """The same by a draw of `rng`."""
    if scenario.model.pose_error is None:
        return mounting
    widths = scenario.model.pose_error.half_widths
    return installed(mounting, np.array([width and rng.uniform(-width, width) for width in widths]))


def believed(cloud: PointCloud, hangs: Pose, planned: Pose) -> PointCloud:
    """A cloud in the road frame that follows from the planned pose, of a LiDAR that hangs in another one."""
    measured = (cloud.xyz - hangs.position) @ hangs.rotation.T
    return replace(cloud, xyz=planned.position + measured @ planned.rotation)


def sensor_at(site: Site, mounting: Mounting) -> MountedSensor:
    """The site's sensor at a mounting."""
    seen = site.observation
    return MountedSensor(site.scenario, mounting, seen.lattice, seen.caster, seen.scenery, seen.bodies)


Clouds = Callable[[Boxes], PointCloud]


def clouds_at(site: Site, mounting: Mounting) -> Clouds:
    """What a detector is given of a frame's vehicles at a mounting, which hangs off its plan by the pose error."""
    return partial(_planned_scan, sensor_at(site, hung_off(site, mounting)), mounting.pose)


def _planned_scan(sensor: MountedSensor, planned: Pose, vehicles: Boxes) -> PointCloud:
    return believed(sensor.scan(vehicles), sensor.mounting.pose, planned)


def of_each(
    make: Callable[[Any], Any], items: Sequence[Any], workers: int, advance: Callable[[int], object]
) -> list[Any]:
    """What `make` makes of each item, in their order, by up to so many processes; `advance` is given 1 for each."""
    made = []
    with closing(Workers(make, max(1, min(workers, len(items) // CLOUDS_A_PROCESS)))) as pool:
        for one in pool.each(items):
            made.append(one)
            advance(1)
    return made


def range_image(detector: ClassicalDetector, clouds: Callable[[Any], PointCloud], item: Any) -> np.ndarray:
    """What a detector that learns takes from one of its clouds."""
    return detector.range_image(clouds(item))


def _look(detectors: Sequence[Detector], clouds: Sequence[Clouds], frame: Boxes):
    """A frame's detections by each LiDAR's detector, with what the notes need; those of the fused cloud, where the
    detectors can; and which of the n counted vehicles have a return of each of l LiDARs, (l, n).
    """
    seen, ids = [of(frame) for of in clouds], frame.vehicle_id[frame.counted]
    returned = np.array([np.isin(ids, cloud.vehicle_id) for cloud in seen])
    each = list(zip(detectors, seen, strict=True))
    if len(clouds) == 1 or not all(isinstance(detector, ClassicalDetector) for detector in detectors):
        return [detector.detect(cloud) for detector, cloud in each], None, returned
    parts = [detector.foreground(cloud) for detector, cloud in each]
    found = [(early_fusion([detector], [part]), None) for detector, part in zip(detectors, parts, strict=True)]
    return found, early_fusion(detectors, parts), returned


_NO_GROUND = "the scene has no ground, which detectors need to level each cloud: they find fewer vehicles, less exactly"


def judge_detectors(
    site: Site,
    layout: Layout,
    detectors: Sequence[Detector],
    workers: int = 1,
    advance: Callable[[int], object] = lambda done: None,
) -> dict[str, JudgedDetector]:
    """Let each LiDAR's detector find the vehicles of the judging frames within `watched`, and merge their boxes.

    Those that learn see the searched frames first. Where the scene has a pose error, a LiDAR hangs off its plan, which
    its detector believes in. Clouds are cast by so many processes; `advance` is given 1 for each frame.

    Returns
    -------
    dict
        "given", by `late_fusion`; before it, of several LiDARs, each one alone, "NAME alone", and the `early_fusion` of
        classical detectors. Distances are from the nearest LiDAR of the layout in all, so that bands hold the same.
    """
    frames, searched = judging_frames(site)[0], site.search
    clouds = [clouds_at(site.with_lidar(number), one) for number, one in enumerate(layout)]
    for detector, of in zip(detectors, clouds, strict=True):
        if detector.learns:
            detector.learn(of_each(partial(range_image, detector, of), searched, workers, advance))
    alone, early, returned = zip(*of_each(partial(_look, detectors, clouds), frames, workers, advance), strict=True)
    returned, several, found, notes = np.concatenate(returned, axis=1), len(layout) > 1, {}, []
    lidars = zip(site.scenario.lidars, detectors, zip(*alone, strict=True), returned, strict=True)
    for lidar, detector, of, by in lidars:
        boxes, seen = zip(*of, strict=True)
        notes += [f"{lidar.name}: {note}" if several else note for note in detector.notes(seen)]
        found |= {f"{lidar.name} alone": (boxes, by)} if several else {}
    if early[0] is not None:
        found[EARLY] = early, returned.any(axis=0)
    found["given"] = [late_fusion([boxes for boxes, _ in of]) for of in alone], returned.any(axis=0)
    notes += [] if site.scenario.world.ground else [_NO_GROUND]
    region, (low, high), xy = region_of_alarms(site.region), watched(site), np.array([[one.xy for one in layout]])
    judged = {}
    for name, (boxes, by) in found.items():
        with_return = float(by.mean()) if len(by) else None
        judged[name] = judged_boxes([within(one, low, high) for one in boxes], frames, region, xy, with_return, notes)
    return judged


def judged_boxes(
    boxes: Sequence[Boxes],
    frames: Sequence[Boxes],
    region: Region,
    lidar_xy: tuple[float, float] | np.ndarray,
    with_return: float | None,
    notes: Sequence[str] = (),
    warnings: Sequence[Mapping[str, str]] = (),
) -> JudgedDetector:
    """Detections of frames, matched by each of `CRITERIA`, all and of each of `KINDS`; `lidar_xy` as for `match`."""
    of_all, *of_kinds = (
        [match(boxes, frames, region, lidar_xy, criterion, kind) for criterion in CRITERIA]
        for kind in (None, *range(len(KINDS)))
    )
    return JudgedDetector(boxes, of_all, of_kinds, with_return, notes, warnings)


def region_of_alarms(region: Region) -> Region:
    """Where false alarms count: in the region where vehicles count, but a stretch of lanes in all lanes."""
    return replace(region, stretches=[(s, None) for s, _ in region.stretches])


def judged_from_file(site: Site, layout: Layout, path: str) -> JudgedDetector:
    """The detections of one's own detector, from a file that `files.read_detected` reads; KITTI's of the first LiDAR.

    Raises
    ------
    MissingFileError, InputError
        If it cannot be read, or lacks judging frames; a CSV file has no rows of frames without boxes, but must have
        some. If they do not fit the traffic, unless that is accepted.
    """
    frames = judging_frames(site)[0]
    boxes = boxes_from_file(path, layout[0].pose, [frame.frame for frame in frames], "judging frames")
    misfit = detections_misfit(boxes, frames)
    warnings = accepted(misfit, path, site.scenario.recordings[0].accept)
    xy = np.array([[one.xy for one in layout]])
    return judged_boxes(boxes, frames, region_of_alarms(site.region), xy, None, warnings=warnings)


def boxes_from_file(path: str | Path, poses: Poses, numbers: Sequence[int], what: str) -> list[Boxes]:
    """The boxes of some frames from a file, as for `judged_from_file`; `what` these numbers are of."""
    of_frame = read_detected(path, poses)
    missing = [number for number in numbers if number not in of_frame]
    whole = Path(path).is_dir() or Path(path).suffix.lower() == ".json"
    if len(missing) == len(numbers) or (missing and whole):
        few = ", ".join(map(str, missing[:3]))
        raise InputError(f"{path}: lacks {len(missing)} of the {len(numbers)} {what}, such as {few}")
    return [of_frame.get(number, no_boxes()) for number in numbers]


def detection_result(site: Site, name: str, judged: Mapping[str, JudgedDetector]) -> dict[str, object]:
    """What was found at each of some mountings, for a result file; the first is the baseline of the others.

    `name` is the detector's. Of several LiDARs the last, which fuses, is set `over` each alone and the fused cloud.
    """
    frames, block, recording = judging_frames(site)
    mountings, (first, baseline) = {}, next(iter(judged.items()))
    several = site.scenario.is_layout
    farthest = max(map(farthest_m, judged.values()), default=0.0)
    for mounting, one in judged.items():
        mountings[mounting] = measured_groups(one, farthest)
        if frames and frames[0].approach is not None:
            approach = np.concatenate([frame.approach[frame.counted] for frame in frames])
            found = by_approach(one.matches[0], approach, block, site.scenario.search.seed, recording)
            mountings[mounting]["by_approach"] = found
        over = partial(paired_intervals, one.matches, block=block, seed=site.scenario.search.seed, recording=recording)
        if one is not baseline and (first == "baseline" or not several):
            mountings[mounting]["over_baseline"] = over(baseline.matches)
        if several and mounting == "given":
            others = {key: other for key, other in judged.items() if key not in ("baseline", "given")}
            mountings[mounting]["over"] = {key: over(other.matches) for key, other in others.items()}
    return {
        "detector": name,
        "frames": len(frames),
        "frame_ids": [frame.frame for frame in frames],
        "held_out": bool(len(site.holdout)),
        "blocks": len(np.unique(block)),
        "mountings": mountings,
    }


def farthest_m(judged: JudgedDetector) -> float:
    """Distance of the farthest vehicle, hit or false alarm from the LiDAR [m]."""
    every = (away for one in judged.matches for away in (one.distance_m, one.vehicle_distance_m))
    return max(float(away.max(initial=0.0)) for away in every)


def measured_groups(judged: JudgedDetector, farthest: float) -> dict[str, object]:
    """All results of one mounting: of all vehicles, by distance up to the `farthest` [m], and by kind."""
    return {
        "with_return": judged.with_return,
        "without_boxes": sum(not len(boxes) for boxes in judged.boxes),
        **measured(judged.matches),
        "by_distance": by_distance(judged.matches, farthest),
        "by_kind": {kind: measured(matches) for kind, matches in zip(KINDS, judged.of_kinds, strict=True)},
    }
