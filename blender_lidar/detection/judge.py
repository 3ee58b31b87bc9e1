"""Detectors judged: the one judge of scenes, data sets and recorded clouds; and what they find at mountings of a scene.

A detector sees whole point clouds and knows nothing of what made them.
"""

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
from .scores import CRITERIA, Matches, by_approach, by_distance, intervals, match, measured, paired_intervals


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


# --- The judge --------------------------------------------------------------------------------------------------------


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

    @property
    def farthest_m(self) -> float:
        """Distance of the farthest vehicle, hit or false alarm from the LiDAR [m]."""
        every = (away for one in self.matches for away in (one.distance_m, one.vehicle_distance_m))
        return max(float(away.max(initial=0.0)) for away in every)


@dataclass(frozen=True, slots=True, eq=False)
class Judge:
    """What detections of f frames are judged by, of a scene, a data set or recorded clouds.

    Attributes
    ----------
    frames : sequence of Boxes, f
        Whose `counted` vehicles are to be found.
    region : Region
        Where a detection that meets nothing is a false alarm.
    block, recording : ndarray, (f,)
        Block of time of each frame, which intervals resample, and its recording, None where there is one.
    seed : int
        For the resampling.
    held_out : bool
        Whether these frames chose and taught nothing.
    scan_ids : sequence of int, f, or None
        Of a data set, whose frames are scans: their numbers, which detections bear.
    """

    frames: Sequence[Boxes]
    region: Region
    block: np.ndarray
    seed: int
    recording: np.ndarray | None = None
    held_out: bool = False
    scan_ids: Sequence[int] | None = None

    @property
    def numbers(self) -> Sequence[int]:
        """What detections of each frame are numbered by."""
        return [frame.frame for frame in self.frames] if self.scan_ids is None else self.scan_ids

    def judged(
        self,
        boxes: Sequence[Boxes],
        lidar_xy: tuple[float, float] | np.ndarray,
        with_return: float | None = None,
        notes: Sequence[str] = (),
        where: str = "",
        accept: Sequence[str] | None = None,
    ) -> JudgedDetector:
        """Detections of the frames, matched by each of `CRITERIA`, all and of each kind; `lidar_xy` as for `match`.

        Those of a file, `where`, or that files are judged by, are refused where they do not fit unless that is in
        `accept`.

        Raises
        ------
        InputError
        """
        warnings = accepted(detections_misfit(boxes, self.frames), where, accept) if where else []
        of_all, *of_kinds = (
            [match(boxes, self.frames, self.region, lidar_xy, criterion, kind) for criterion in CRITERIA]
            for kind in (None, *range(len(KINDS)))
        )
        return JudgedDetector(boxes, of_all, of_kinds, with_return, notes, warnings)

    def read(self, path: str | Path, poses: Poses, what: str) -> list[Boxes]:
        """The detections of one's own detector from a file, as `read_detected` reads it; `what` the frames are called.

        Raises
        ------
        MissingFileError, InputError
            If it cannot be read, or lacks frames; a CSV file has no rows of frames without boxes, but must have some.
        """
        of_frame, numbers = read_detected(path, poses), self.numbers
        missing = [number for number in numbers if number not in of_frame]
        if len(missing) == len(numbers) or (missing and Path(path).is_dir()):
            few = ", ".join(map(str, missing[:3]))
            raise InputError(f"{path}: lacks {len(missing)} of the {len(numbers)} {what}, such as {few}")
        return [of_frame.get(number, no_boxes()) for number in numbers]

    def result(self, detector: str, judged: Mapping[str, JudgedDetector], about: Mapping[str, object]) -> dict:
        """The content of detection.json: `about` what was judged, with notes and warnings of its own, and how.

        `judged` is by mounting: "given"; before it perhaps the "baseline" of all, and of several LiDARs each alone and
        other fusions, which "given" is set `over`.
        """
        given, farthest_m, mountings = judged["given"], max(one.farthest_m for one in judged.values()), {}
        for name, one in judged.items():
            mountings[name] = self._measured(one, farthest_m)
            if "baseline" in judged and name != "baseline":
                mountings[name]["over_baseline"] = self.over(one, judged["baseline"])
        if others := [name for name in judged if name not in ("baseline", "given")]:
            mountings["given"]["over"] = {name: self.over(given, judged[name]) for name in others}
        numbers = {"frames": len(self.frames), "frame_ids": self.numbers}
        if self.scan_ids is not None:
            frames = len({frame.frame for frame in self.frames})
            numbers = {"scans": len(self.frames), "scan_ids": self.numbers, "frames": frames}
        return {
            **about,
            "criteria": [criterion.name for criterion in CRITERIA],
            "detector": detector,
            **numbers,
            "held_out": self.held_out,
            "blocks": len(np.unique(self.block)),
            "mountings": mountings,
            "warnings": [*about.get("warnings", ()), *given.warnings],
            "notes": [*about.get("notes", ()), *given.notes],
        }

    def over(self, one: JudgedDetector, other: JudgedDetector) -> dict[str, dict[str, object]]:
        """How much better one is than another, with paired intervals."""
        return paired_intervals(one.matches, other.matches, self.block, self.seed, self.recording)

    def _measured(self, one: JudgedDetector, farthest_m: float) -> dict[str, object]:
        """Of one mounting: of all vehicles with intervals, by distance up to the farthest, by kind and by approach."""
        blocks = self.block, self.seed, self.recording
        found = {
            "with_return": one.with_return,
            "without_boxes": sum(not len(boxes) for boxes in one.boxes),
            **measured(one.matches),
            "interval_90": intervals(one.matches, *blocks),
            "by_distance": by_distance(one.matches, farthest_m),
            "by_kind": {kind: measured(matches) for kind, matches in zip(KINDS, one.of_kinds, strict=True)},
        }
        if self.frames and self.frames[0].approach is not None:
            approach = np.concatenate([frame.approach[frame.counts] for frame in self.frames])
            found["by_approach"] = by_approach(one.matches[0], approach, *blocks)
        return found


def region_of_alarms(region: Region) -> Region:
    """Where false alarms count: in the region where vehicles count, but a stretch of lanes in all lanes."""
    return replace(region, stretches=[(s, None) for s, _ in region.stretches])


# --- Of a scene -------------------------------------------------------------------------------------------------------


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


def site_judge(site: Site) -> Judge:
    """What detectors are judged by at the mountings of a scene: its held-out frames, or all where none is."""
    plan, region, seed = site.plan, region_of_alarms(site.region), site.scenario.search.seed
    if len(site.holdout):
        return Judge(site.holdout, region, plan.holdout_block, seed, plan.holdout_recording, held_out=True)
    return Judge(site.search, region, plan.search_block, seed, plan.search_recording)


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
    judge, searched = site_judge(site), site.search
    clouds = [clouds_at(site.with_lidar(number), one) for number, one in enumerate(layout)]
    for detector, of in zip(detectors, clouds, strict=True):
        if detector.learns:
            detector.learn(of_each(partial(range_image, detector, of), searched, workers, advance))
    alone, early, returned = zip(
        *of_each(partial(_look, detectors, clouds), judge.frames, workers, advance), strict=True
    )
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
    (low, high), xy, judged = watched(site), np.array([[one.xy for one in layout]]), {}
    for name, (boxes, by) in found.items():
        with_return = float(by.mean()) if len(by) else None
        judged[name] = judge.judged([within(one, low, high) for one in boxes], xy, with_return, notes)
    return judged


def judged_from_file(site: Site, layout: Layout, path: str) -> JudgedDetector:
    """The detections of one's own detector in the judging frames, from a file; KITTI's are of the first LiDAR.

    Raises
    ------
    MissingFileError, InputError
        If it cannot be read, lacks frames, or does not fit the traffic unless that is accepted.
    """
    judge, xy = site_judge(site), np.array([[one.xy for one in layout]])
    boxes = judge.read(path, layout[0].pose, "judging frames")
    return judge.judged(boxes, xy, where=path, accept=site.scenario.recordings[0].accept)
