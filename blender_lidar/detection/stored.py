"""Detections in stored clouds: those of one mounting that `scan` wrote, and a data set's, where they are judged."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..clouds.commissioned import Hung
from ..clouds.files import LIDARS, read_cloud
from ..clouds.fit import in_frame
from ..clouds.points import READERS, read_points
from ..clouds.rings import beam_phase, on_beams
from ..clouds.scan import PointCloud
from ..csv_tables import Column
from ..errors import InputError
from ..road.settings import RoadSettings, map_of
from ..scene.mounting import COORDINATES, MOUNTED, mounting_from
from ..scene.provenance import versions
from ..scene.region import Region, region_of, region_within
from ..scene.settings import RegionSettings, SensorSettings
from ..scene.site import lattice_of
from ..sensors.beams import BeamLattice, beam_lattice
from ..sensors.imperfections import Imperfections
from ..sensors.model import load_model, model_names
from ..sensors.pose import Pose
from ..toml_table import Setting, TomlTable
from ..traffic.boxes import Boxes, no_boxes
from ..traffic.vehicles import CLASSES, Recording
from .classical import ClassicalDetector
from .dataset import VAL
from .dataset_files import DATASET, SCANS, UNFINISHED, WHOLE, file_name, read_boxes, read_columns, read_json
from .judge import Detector, Judge, is_ours, of_each, range_image, region_of_alarms, weights_of, within
from .labels import frame_of
from .pillars import PillarsDetector

Progress = Callable[[int], Callable[[int], object]]  # given how many clouds there are, what is called for those done


def coordinates_of(values: Mapping[str, object], where: str, keys: Sequence[str] = COORDINATES) -> dict[str, float]:
    """The coordinates of a mounting or a pose [m, degrees] from a file of ours; `where` it stands.

    Raises
    ------
    InputError
        Where one is missing or no number.
    """
    return TomlTable(values, where).some(dict.fromkeys(keys, Setting(low=-_FARTHEST, high=_FARTHEST)))


_FARTHEST = 1e9


# --- Clouds of one mounting -------------------------------------------------------------------------------------------

_RECORDED_REACH_M, _BESIDE_M = 100.0, 2.0  # how far is looked along, and beside the carriageways
_FEWEST_CLOUDS = 5  # from which a background can be learnt
_CROSSWISE = 50  # of fewer each is judged by a background of the others
AS_RECORDED = Imperfections(dropout=0.1)  # dark surfaces and leaves lose returns here and there
_OF_PHASE = 20  # clouds tell well enough how the columns lie
_OF_HEADERS = {
    "sensor": Setting(kind=str),
    "rotation_hz": Setting(above=0.0),
    "azimuth_step_deg": Setting(above=0.0, high=180.0),
    "range_m": Setting(kind=tuple[float, float], low=0.0),
}


@dataclass(frozen=True, slots=True, eq=False)
class StoredClouds:
    """The clouds of one mounting, by their paths, as the `header` of the `first` describes them.

    `pose` is the LiDAR's in the road frame.
    """

    first: Path
    header: Mapping[str, object]
    sensor: SensorSettings
    lattice: BeamLattice
    pose: Pose

    @classmethod
    def of(cls, path: Path) -> StoredClouds:
        header = read_cloud(path)[1]
        if LIDARS in header:
            raise InputError(
                f"{path}: is of several LiDARs; allowed: the folder of one that scan wrote beside, or detect SCENE"
            )
        where = f"{path}: its header"
        found = TomlTable(header, where).some(_OF_HEADERS)
        name, rate = found["sensor"], found["rotation_hz"]
        if name not in model_names():
            raise InputError(f"{path}: its sensor {name!r} is of a table of its own; detect at its scene")
        columns = round(360.0 / found["azimuth_step_deg"])
        imperfect = header.get("imperfections", {})
        settings = {"name": name, "rotation_hz": rate, "range_gate_m": found["range_m"][1], **imperfect}
        try:
            if columns != load_model(name).columns(rate):
                settings["columns"] = columns
            sensor = TomlTable(settings, where).read_as(SensorSettings)
            lattice = lattice_of(sensor)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
        return cls(path, header, sensor, lattice, Pose.from_table(coordinates_of(header["pose"], f"{where}: pose")))

    def read(self, path: Path) -> tuple[PointCloud, int]:
        """A cloud and its frame; refused where another sensor or mounting made it."""
        cloud, header = read_cloud(path)
        if any(header.get(key) != self.header.get(key) for key in (*_OF_HEADERS, "imperfections", "pose")):
            raise InputError(f"{path}: is of another sensor or mounting than {self.first}; allowed: the same")
        if cloud.ring.max(initial=0) >= self.lattice.rings:
            name = self.lattice.model.name
            raise InputError(f"{path}: has ring {cloud.ring.max()}; the {name} has {self.lattice.rings}")
        return cloud, header["frame"]

    def __call__(self, path: Path) -> PointCloud:
        return self.read(path)[0]


@dataclass(frozen=True, slots=True, eq=False)
class RecordedClouds:
    """The clouds of a recording, by their paths, of which points within a rectangle from `low` to `high` are looked at.

    Vehicles are looked for between the pairs of y of `spans` [m, road frame].
    With a `lattice` and the `phase` of its columns, as of `clouds.rings.beam_phase`, each point has its beam.
    """

    hung: Hung
    low: np.ndarray
    high: np.ndarray
    spans: Sequence[tuple[float, float]]
    lattice: BeamLattice | None = None
    phase: np.ndarray | None = None

    @classmethod
    def of(cls, paths: Sequence[Path], hung: Hung, region: Sequence[float] | None, *, beams: bool) -> RecordedClouds:
        """Those of a `region`, two corners; by default 100 m all round, and vehicles only on carriageways if known.

        What stands in a median, such as a hedge, is then no vehicle.
        """
        at = hung.pose.position[:2]
        low, high = at - _RECORDED_REACH_M, at + _RECORDED_REACH_M
        if hung.carriageways:
            low[1], high[1] = np.min(hung.carriageways) - _BESIDE_M, np.max(hung.carriageways) + _BESIDE_M
        if region is not None:
            low, high = np.array(region[:2]), np.array(region[2:])
        spans = hung.carriageways if hung.carriageways and region is None else [(float(low[1]), float(high[1]))]
        if not beams:
            return cls(hung, low, high, spans)
        lattice, some = beam_lattice(load_model(hung.sensor)), paths[:: len(paths) // _OF_PHASE + 1]
        return cls(hung, low, high, spans, lattice, beam_phase((sensor_points(path, hung) for path in some), lattice))

    def read(self, path: Path) -> tuple[PointCloud, int]:
        """A cloud, of which the points and perhaps the beams are known, and the number at the end of its name."""
        frame = frame_of(path)
        points = sensor_points(path, self.hung)
        xyz = in_frame(points, "rfu", self.hung.at)
        if self.lattice is None:
            cloud = PointCloud(xyz, *np.zeros((9, len(xyz))))
        else:
            cloud = on_beams(points, xyz, self.lattice, self.phase, str(path))
        return cloud.select(((xyz[:, :2] >= self.low) & (xyz[:, :2] <= self.high)).all(axis=1)), frame

    def __call__(self, path: Path) -> PointCloud:
        return self.read(path)[0]


def sensor_points(path: Path, hung: Hung) -> np.ndarray:
    """Points of a recorded cloud from its sensor, x to the right and y ahead, (n, 3) [m]; a zero is no return."""
    points = read_points(path)[0]
    return hung.seen(points[points.any(axis=1)])


class FoundInClouds(NamedTuple):
    """What a detector found in clouds: boxes by frame, and the LiDAR's pose in the road frame.

    It looked within the rectangle from `low` to `high`, x and y [m], between the pairs of y of `spans`.
    """

    boxes: Mapping[int, Boxes]
    pose: Pose
    sensor: str
    low: np.ndarray
    high: np.ndarray
    spans: Sequence[tuple[float, float]]
    notes: Sequence[str]

    @property
    def region(self) -> Region:
        """Where it looked."""
        (x0, _), (x1, _) = self.low, self.high
        return region_within([np.array([(x0, a), (x1, a), (x1, b), (x0, b)]) for a, b in self.spans])


def _look(
    detector: Detector, clouds: StoredClouds | RecordedClouds, images: np.ndarray | None, item: tuple[int, Path]
) -> tuple[int, Boxes, Any]:
    """The frame of a cloud, its detections, and what the notes need; learnt from the range `images` of the others."""
    row, path = item
    if images is not None:
        detector.learn(np.delete(images, row, axis=0))
    cloud, frame = clouds.read(path)
    return frame, *detector.detect(cloud)


def detect_in_clouds(
    folder: Path,
    name: str,
    workers: int,
    progress: Progress,
    hung: Hung | None = None,
    region: Sequence[float] | None = None,
) -> FoundInClouds:
    """What a detector of ours finds in the NPZ clouds of a folder, as ``scan --frame-ids`` writes them.

    With `hung` they are a recording's, of any format, in the frame of its sensor, and it looks at the rectangle of
    `RecordedClouds.of`. The classical detector learns the background from the clouds. It is judged crosswise, each by
    all others, where there are fewer than 50, so that none teaches its own; of more, one hardly matters.

    Raises
    ------
    InputError
        For clouds that cannot be read or are not of one mounting; for the classical detector where the sensor is not
        known, or its rings are not those of a cloud.
    """
    kinds = (".npz",) if hung is None else tuple(READERS)
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in kinds)
    learns = name == ClassicalDetector.name
    if learns and hung is not None and hung.sensor is None:
        raise InputError(f"--detector: {name} needs rings; give --sensor NAME, or --detector {PillarsDetector.name}")
    if len(paths) < (_FEWEST_CLOUDS if learns else 1):
        few = f"has {len(paths)} {', '.join(kinds)} clouds"
        few += ", as scan --frame-ids writes them; a recording needs --pose or --commission" * (hung is None)
        wanted = f"{_FEWEST_CLOUDS} or more, to learn the empty scene from" if learns else "at least one"
        raise InputError(f"{folder}: {few}; allowed: {wanted}")
    if hung is None:
        clouds = StoredClouds.of(paths[0])
        pose, sensor, losses = clouds.pose, clouds.lattice.model.name, clouds.sensor.imperfections
        low, high = (pose.position[:2] + side * clouds.sensor.range_gate_m for side in (-1.0, 1.0))
        spans = [(float(low[1]), float(high[1]))]
    else:
        clouds = RecordedClouds.of(paths, hung, region, beams=learns)
        sensor = "a sensor without a name" if hung.sensor is None else load_model(hung.sensor).name
        pose, losses = hung.pose, AS_RECORDED
        low, high, spans = clouds.low, clouds.high, clouds.spans
    advance, images = progress((1 + learns) * len(paths)), None
    if learns:
        detector = ClassicalDetector(clouds.lattice, tuple(pose.position[:2]), losses)
        images = np.array(of_each(partial(range_image, detector, clouds), paths, workers, advance))
        if len(paths) >= _CROSSWISE:
            detector.learn(images)
            images = None
    else:
        detector = PillarsDetector(sensor, pose, low, high, weights_of(name))
    look = partial(_look, detector, clouds, images)
    frames, boxes, seen = zip(*of_each(look, list(enumerate(paths)), workers, advance), strict=True)
    if len(set(frames)) < len(frames):
        twice = next(frame for row, frame in enumerate(frames) if frame in frames[:row])
        raise InputError(f"{folder}: frame {twice} has several clouds; allowed: one of each frame")
    found = FoundInClouds({}, pose, sensor, low, high, spans, detector.notes(seen))
    if hung is not None:
        boxes = [one.select(found.region.holds(one)) for one in boxes]
    return found._replace(boxes=dict(zip(frames, boxes, strict=True)))


def judge_in_clouds(
    found: FoundInClouds,
    detector: str,
    labels: Recording,
    where: str,
    accept: Sequence[str] | None,
    empty: Sequence[int] = (),
) -> dict[str, object]:
    """What a detector found in clouds, judged by labelled boxes: what `Judge.result` gives.

    Frames that have no boxes are left out. Boxes count where the detector looked, and there what is not labelled is a
    false alarm. For the intervals each frame is a block. `where` names the labels; frames of `empty` were labelled and
    may have no vehicle.

    Raises
    ------
    InputError
        For labels of other frames, or that do not fit unless that is in `accept`.
    """
    numbers = [number for number in found.boxes if number in labels.frames or number in empty]
    if not numbers:
        ends = f"{labels.frames[0]} to {labels.frames[-1]}, and the clouds {min(found.boxes)} to {max(found.boxes)}"
        raise InputError(f"--boxes: {where}: has the frames {ends}; allowed: boxes of frames of the clouds")
    vehicles = [labels.at(number) if number in labels.frames else no_boxes(number) for number in numbers]
    frames = [replace(one, counted=found.region.holds(one)) for one in vehicles]
    judge = Judge(frames, found.region, np.arange(len(numbers)), seed=1)
    boxes, notes = [found.boxes[number] for number in numbers], [*found.notes, _UNLABELLED, _BY_FRAME]
    if left := len(found.boxes) - len(numbers):
        notes.append(f"{left} of the {len(found.boxes)} clouds have no boxes and are not judged")
    judged = judge.judged(boxes, tuple(found.pose.position[:2]), notes=notes, where=where, accept=accept)
    looked = {"low_m": found.low.tolist(), "high_m": found.high.tolist(), "between_y_m": list(map(list, found.spans))}
    about = {"sensor": found.sensor, "region": looked, "versions": versions("")}
    return judge.result(detector, {"given": judged}, about)


_UNLABELLED = "what is not labelled counts as a false alarm"
_BY_FRAME = "intervals resample frames: they are too narrow where frames near in time show the same vehicles"


# --- Data sets --------------------------------------------------------------------------------------------------------

_ABOUT = {
    **dict.fromkeys(("scene", "sensor", "caster"), Setting(kind=str)),
    "region": Setting(kind=RegionSettings),
    "road": Setting(kind=RoadSettings),
    "layouts": Setting(kind=tuple[str, ...]),
    "seed": Setting(kind=int),
    "watched_m": Setting(kind=tuple[tuple[float, float], ...]),
    "warnings": Setting(kind=list),
}
_OF_ROADS = "region", "road"
_OF_SCANS = {
    **dict.fromkeys(("scan", "recording", "block", "mounting"), WHOLE),
    "frame": Column("a whole number", whole=True),
    **dict.fromkeys(MOUNTED, Column("a number", -_FARTHEST, _FARTHEST)),
}


@dataclass(frozen=True, slots=True, eq=False)
class StoredDataset:
    """A data set as its folder tells it.

    Attributes
    ----------
    folder : Path
    about : mapping
        The content of dataset.json.
    region : Region
        Where a box that meets nothing is a false alarm.
    watched : (ndarray, ndarray), (2,) each
        Where detectors of ours look, as for `judge.watched` [m].
    scans : mapping of str to ndarray, (n,)
        Columns of scans.csv.
    poses : sequence of Pose, n
        The planned pose of each scan in the frame of the road.
    judging : ndarray of int, (k,)
        The scans that judge: those that validate, or all where none does.
    """

    folder: Path
    about: Mapping[str, object]
    region: Region
    watched: tuple[np.ndarray, np.ndarray]
    scans: Mapping[str, np.ndarray]
    poses: Sequence[Pose]
    judging: np.ndarray

    @property
    def validates(self) -> bool:
        """Whether the judging scans are those of the split val."""
        return bool((self.scans["split"] == VAL).any())

    def boxes(self, number: int) -> tuple[Boxes, np.ndarray]:
        """The vehicles of a scan, and the returns from each, (v,)."""
        table = read_boxes(self.folder, number)
        vehicles = Boxes(
            frame=int(self.scans["frame"][number]),
            time_s=0.0,
            vehicle_id=table["vehicle_id"],
            class_index=np.array([CLASSES.index(name) for name in table["class"].tolist()], dtype=np.int8),
            centre_m=np.column_stack([table[name] for name in ("x_m", "y_m", "z_m")]),
            size_m=np.column_stack([table[name] for name in ("length_m", "width_m", "height_m")]),
            heading_rad=np.radians(table["heading_deg"]),
            lane=np.zeros(len(table["class"]), dtype=np.int16),
        )
        return replace(vehicles, counted=table["counted"]), table["points"]


def is_dataset(folder: Path) -> bool:
    """Whether `dataset` wrote a folder, or began to."""
    return any((folder / name).exists() for name in (DATASET, UNFINISHED))


def read_dataset(folder: Path) -> StoredDataset:
    """A data set, except for its boxes and clouds.

    Raises
    ------
    MissingFileError, InputError
        If it is not finished, or damaged.
    """
    path = folder / DATASET
    if not path.exists():
        raise InputError(f"{folder}: is an unfinished data set; give the command that began it again")
    about = read_json(path, "the dataset.json of a data set")
    outlines, on_map = about.get("outlines_m"), "net" in (about.get("road") or {})
    if on_map and not outlines:
        raise InputError(f"{path}: is of a map with heights; a detector needs a level map")
    found = TomlTable(about, str(path)).some({key: _ABOUT[key] for key in _ABOUT if not on_map or key not in _OF_ROADS})
    road = map_of(RoadSettings() if on_map else found["road"])  # both level, and masts say which way they face
    if on_map:
        region = region_within([np.array(one) for one in outlines], about["region"]["keep_out"] or ())
    else:
        region = region_of(found["region"], road)
    region = region_of_alarms(region)
    scans = read_columns(folder / SCANS, _OF_SCANS, "split")
    count = len(scans["scan"])
    tables = ({key: scans[key].tolist()[row] for key in MOUNTED} for row in range(count))
    poses = [mounting_from(coordinates_of(table, str(folder), MOUNTED), road).pose for table in tables]
    validating = np.flatnonzero(scans["split"] == VAL)
    watched = tuple(map(np.array, found["watched_m"]))
    return StoredDataset(
        folder, about, region, watched, scans, poses, validating if len(validating) else np.arange(count)
    )


def judge_on_dataset(
    stored: StoredDataset, name: str, workers: int, progress: Progress, accept: Sequence[str] | None = None
) -> tuple[dict[str, object], Mapping[int, Boxes]]:
    """Judge a detector on the judging scans: PointPillars, or a file of detections by the numbers of the scans.

    Returns what `Judge.result` gives, and what was found in each scan.

    Raises
    ------
    MissingFileError, InputError
        For a file that cannot be read, lacks scans or does not fit unless that is in `accept`, a data set without NPZ
        clouds, and for the classical detector.
    """
    numbers, notes, where = stored.judging.tolist(), [], "" if is_ours(name) else name
    frames, points = zip(*map(stored.boxes, numbers), strict=True)
    recording, block = (stored.scans[key][stored.judging] for key in ("recording", "block"))
    judge = Judge(frames, stored.region, block, stored.about["seed"], recording, stored.validates, numbers)
    if where:
        boxes = judge.read(name, stored.poses, f"scans{' of split val' * stored.validates} of the data set")
    else:
        boxes, notes = _detected(stored, name, workers, progress(len(numbers)))
    if not stored.validates:
        text = "the data set has no validation scans: all are used, though the detector may have been trained on them"
        notes = [text, *notes]
    returns = np.concatenate([of[frame.counted] for frame, of in zip(frames, points, strict=True)]) > 0.0
    lidars = np.array([stored.poses[number].position[:2] for number in numbers])
    with_return = float(returns.mean()) if len(returns) else None
    judged = judge.judged(boxes, lidars, with_return, notes, where, accept)
    about = {key: stored.about[key] for key in ("scene", "sensor", "region", "caster", "warnings", "versions")}
    about |= {"dataset": stored.folder.resolve().name}
    return judge.result(name, {"given": judged}, about), dict(zip(numbers, boxes, strict=True))


def check_clouds(stored: StoredDataset, name: str) -> None:
    """Refuse a detector of ours that cannot look at the clouds of a data set."""
    if name == ClassicalDetector.name:
        text = "learns the empty scene from clouds of one mounting, and those of a data set have many"
        raise InputError(f"--detector: {name} {text}; judge it by detect SCENE --detector {name}")
    if is_ours(name) and "npz" not in stored.about["layouts"]:
        text = f"has no NPZ clouds but {', '.join(stored.about['layouts'])}"
        raise InputError(f"{stored.folder}: {text}; allowed: a data set of --layout npz, or --detector FILE")


def _look_at_scan(stored: StoredDataset, detectors: Mapping[int, PillarsDetector], number: int):
    """The detections in a scan, and what the notes need to know of its cloud."""
    cloud, _ = read_cloud(stored.folder / "npz" / f"{file_name(number)}.npz")
    return detectors[int(stored.scans["mounting"][number])].detect(cloud)


def _detected(
    stored: StoredDataset, name: str, workers: int, advance: Callable[[int], object]
) -> tuple[list[Boxes], list[str]]:
    """What PointPillars finds in the judging scans, each from its mounting, and its notes."""
    numbers, mounting = stored.judging.tolist(), stored.scans["mounting"].astype(int).tolist()
    sensor, weights = stored.about["sensor"], weights_of(name)
    detectors = {
        mounting[number]: PillarsDetector(sensor, stored.poses[number], *stored.watched, weights) for number in numbers
    }
    found = of_each(partial(_look_at_scan, stored, detectors), numbers, workers, advance)
    seen = {
        each: [one for number, (_, one) in zip(numbers, found, strict=True) if mounting[number] == each]
        for each in detectors
    }
    notes = [detector.notes(seen[each]) for each, detector in detectors.items()]
    return [within(boxes, *stored.watched) for boxes, _ in found], _gathered(notes)


def _gathered(notes: Sequence[Sequence[str]]) -> list[str]:
    """The notes of many mountings, once each, by how many have them: they differ in their numbers."""
    alike: dict[str, list[str]] = {}
    for note in chain(*notes):
        alike.setdefault(re.sub(r"[0-9.]+", "", note), []).append(note)
    return [f"{some[0]} (the same or similar at {len(some)} of {len(notes)} mountings)" for some in alike.values()]
