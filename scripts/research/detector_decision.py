"""Does the mounting that a metric chooses serve a detector as well as the one that the detector itself would choose?

    python scripts/research/detector_decision.py --choose A.csv.gz --judge B.csv.gz --weights one.npz two.npz

Random mountings are scored by every metric and by detectors on the traffic that chooses; the mountings that they choose
are judged by the detectors on other traffic. What a metric's choice loses is the detector's recall at confidence 0.3
(centres within 2 m), or its AP at bird's-eye IoU 0.5, at the detector's own choice less that at the metric's, in the
mean over the trainings of the detector. Intervals resample blocks of a minute, the same for all sensors.

Declared before it was run. Primary: PE-VGOP, free heights, hard world, the mean over the sensors: at most 1 point of
recall and 1 of AP, by the upper 95 % bound. Secondary: view coverage, by the same rule with Bonferroni's correction for
two. All else is told with its interval and proves nothing by itself.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from arguments import SCENES, counting, parser_of, positive, run_script
from blender_lidar.clouds.scan import FrameScan
from blender_lidar.detection.judge import believed, detector_at, hung_off_by
from blender_lidar.detection.scores import CRITERIA, Matches, average_precision, match, recall
from blender_lidar.files import make_folder, whole_file, write_text
from blender_lidar.metrics.catalogue import METRICS, PE_VGOP, VIEW_COVERAGE
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import Site, prepare, scoring_of
from blender_lidar.scoring.frame_scorer import FrameScorer, FrameShapes
from blender_lidar.scoring.scores import VehicleScores, mountings_of
from blender_lidar.scoring.workers import Workers
from blender_lidar.statistics import statistic_interval_90, student_t
from detector_worlds import hard_world

SENSORS = ("RS-16", "RS-32", "RS-80")
HEIGHTS_M, TILTS_DEG = (2.0, 4.5), (0.0, 25.0)
FREE = "free"
BLOCK_S = 60.0
OUTCOMES = ("recall at 0.3", "AP at IoU 0.5")
MOST_LOSS = 0.01
_SEED = 20261125


def main(argv: list[str] | None = None) -> int:
    return run_script("detector_decision", lambda: _study(_arguments(argv)))


def _arguments(argv):
    parser = parser_of(__doc__)
    parser.add_argument("--choose", required=True, metavar="FILE", help="the traffic that chooses")
    parser.add_argument("--judge", required=True, metavar="FILE", help="the traffic that judges")
    parser.add_argument("--weights", nargs="+", required=True, metavar="FILE", help="trainings of the detector")
    parser.add_argument(
        "--out", type=Path, default=Path("detector_decision"), metavar="DIR", help="what is done is kept"
    )
    parser.add_argument("--sensors", nargs="+", default=SENSORS, choices=SENSORS)
    parser.add_argument("--worlds", nargs="+", default=("hard", "clean"), choices=("hard", "clean"))
    parser.add_argument("--heights", nargs="+", default=(FREE, "2", "3", "4", "4.5"), help="free, or metres")
    parser.add_argument("--free", type=positive, default=40, help="mountings at free heights (default 40)")
    parser.add_argument("--fixed", type=positive, default=20, help="mountings at each fixed height (default 20)")
    parser.add_argument("--choose-frames", type=positive, default=90)
    parser.add_argument("--judge-frames", type=positive, default=180)
    parser.add_argument("--workers", type=positive, default=2)
    return parser.parse_args(argv)


# --- Mountings and what is made of them -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Part:
    """A sensor in a world at free heights or at one, on the frames that choose or those that judge."""

    world: str
    sensor: str
    heights: str
    traffic: str
    frames: int
    weights: Sequence[str]
    mounts: Sequence[dict[str, float]]
    with_metrics: bool


def mountings(sensor: str, heights: str, count: int) -> list[dict[str, float]]:
    """Heights and tilts, uniform; at a fixed height tilts alone."""
    rng = np.random.default_rng([_SEED, SENSORS.index(sensor)])
    height = rng.uniform(*HEIGHTS_M, count) if heights == FREE else np.full(count, float(heights))
    tilt = rng.uniform(*TILTS_DEG, count)
    rest = dict.fromkeys(("x_m", "y_m", "tilt_y_deg", "yaw_deg"), 0.0)
    return [{**rest, "height_m": h, "tilt_x_deg": t} for h, t in zip(height.tolist(), tilt.tolist(), strict=True)]


class FrameWork:
    """Scores and detects in one frame of a part after another; each process makes the site for itself."""

    def __init__(self, part: Part) -> None:
        self.part = part

    def __getstate__(self):
        return {"part": self.part}

    @cached_property
    def site(self) -> Site:
        """The scene with the part's sensor, world and frames, all of them searched."""
        settings = {
            ("sensor", "name"): self.part.sensor,
            ("traffic", "path"): str(Path(self.part.traffic).resolve()),
            ("traffic", "frames"): self.part.frames,
            ("traffic", "holdout"): 0.0,
        }
        options = {place: (value, place[1]) for place, value in settings.items()}
        world = hard_world() if self.part.world == "hard" else {}
        return prepare(load_scenario(SCENES / "i80.toml", {**world, **options}))

    @cached_property
    def metrics(self) -> dict[str, VehicleScores]:
        """Every metric of the catalogue, each by what it gives a vehicle, as `optimise --metric` has it."""
        site, scenario = self.site, self.site.scenario
        found = {}
        for name in METRICS:
            loss = scenario.objective.loss if name == PE_VGOP.name else None
            own = replace(scenario, objective=replace(scenario.objective, metric=name, loss=loss))
            found[name] = VehicleScores(scoring_of(own, site.search), site.observation, site.search)
        return found

    @cached_property
    def detectors(self) -> list[list]:
        """For each mounting a detector of each training."""
        return [[detector_at(self.site, mount, path) for path in self.part.weights] for mount in self.part.mounts]

    def __call__(self, row: int) -> tuple[np.ndarray, list[list[list[Matches]]]]:
        """Sums of each metric, (metrics, mountings), and matches by mounting, training and criterion of a frame."""
        site, part = self.site, self.part
        frame = site.search[row]
        shapes = FrameShapes(frame.vehicles, frame.counted, site.observation.detail, site.observation.caster)
        scores = np.zeros((0, len(part.mounts)))
        if part.with_metrics:
            poses = [site.scenario.pose(mount) for mount in part.mounts]
            scorer, around = FrameScorer(frame.vehicles, frame.counted, site.observation, shapes), mountings_of(poses)
            seen = scorer.see(poses, keep_returns=True)
            made = (one.of_seen(frame, scorer, seen, around) for one in self.metrics.values())
            scores = np.array([one.objective.sum(axis=1) for one in made])
        scan = FrameScan(shapes, frame.vehicles, site.observation, ground=site.scenario.world.ground)
        return scores, [self._matched(frame, scan, number) for number in range(len(part.mounts))]

    def _matched(self, frame, scan: FrameScan, number: int) -> list[list[Matches]]:
        """What each training of the detector finds at a mounting, whose error of installation is its own."""
        site, mount = self.site, self.part.mounts[number]
        hangs = hung_off_by(site.scenario, mount, np.random.default_rng([_SEED, number]))
        there, planned = site.scenario.pose(hangs), site.scenario.pose(mount)
        cloud = believed(scan.cloud(there, scan.turn(there)), there, planned)
        at = mount["x_m"], mount["y_m"]
        found = [one.detect(cloud) for one in self.detectors[number]]
        return [[match([boxes], [frame], site.region, at, criterion) for criterion in CRITERIA] for boxes in found]


_OF_DETECTIONS, _OF_VEHICLES = (
    ("confidence", "hit", "frame", "distance_m"),
    ("found", "vehicle_frame", "vehicle_distance_m"),
)


def joined(frames: Sequence[Matches]) -> Matches:
    """Matches of frames, one of each, as those of all."""
    found = {
        name: np.concatenate(
            [getattr(one, name) + (at if name.endswith("frame") else 0) for at, one in enumerate(frames)]
        )
        for name in (*_OF_DETECTIONS, *_OF_VEHICLES)
    }
    return Matches(len(frames), **{**found, "hit": found["hit"] > 0})


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """What was made of a part: sums of the metrics (metrics, mountings), matches by mounting, training, criterion."""

    scores: np.ndarray
    matches: list[list[list[Matches]]]

    def outcome(self, mounting: int, training: int, which: str, weight: np.ndarray | None = None) -> np.ndarray:
        """One of `OUTCOMES`, (r,); `weight` (r, f) is how often each frame counts."""
        by_criterion = self.matches[mounting][training]
        if which == OUTCOMES[0]:
            return recall(by_criterion[0], 0.3, weight)
        return average_precision(by_criterion[1], weight)


def made(part: Part, path: Path, workers: int) -> Made:
    """A part, from its file where it is done."""
    if not path.exists():
        with closing(Workers(FrameWork(part), workers)) as pool, counting(part.frames, path.stem) as advance:
            frames = []
            for one in pool.each(range(part.frames)):
                frames.append(one)
                advance(1)
        scores = np.sum([scores for scores, _ in frames], axis=0)
        arrays = {"scores": scores}
        for mounting in range(len(part.mounts)):
            for training in range(len(part.weights)):
                for row in range(len(CRITERIA)):
                    whole = joined([matches[mounting][training][row] for _, matches in frames])
                    for field in fields(Matches):
                        arrays[f"{mounting}/{training}/{row}/{field.name}"] = getattr(whole, field.name)
        with whole_file(path) as temporary:
            np.savez_compressed(temporary, **arrays)
    with np.load(path, allow_pickle=False) as file:
        held = {name: file[name] for name in file.files}
    names = [field.name for field in fields(Matches)]

    def one(mounting: int, training: int, row: int) -> Matches:
        given = {name: held[f"{mounting}/{training}/{row}/{name}"] for name in names}
        return Matches(**{**given, "frames": int(given["frames"])})

    matches = [
        [[one(m, t, row) for row in range(len(CRITERIA))] for t in range(len(part.weights))]
        for m in range(len(part.mounts))
    ]
    return Made(held["scores"], matches)


# --- The study --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Choices:
    """Which of a sensor's mountings is chosen, and what was made of those on the traffic that judges.

    `of_metric` maps a metric, `of_detector` an outcome and a training, to a mounting; `row` a mounting to its row in
    `judged`. `rank` is Spearman's correlation of each metric with each outcome over all mountings that choose.
    """

    mounts: Sequence[dict[str, float]]
    of_metric: dict[str, int]
    of_detector: dict[tuple[str, int], int]
    row: dict[int, int]
    judged: Made
    rank: dict[tuple[str, str], float]

    def losses(self, metric: str, which: str, weight: np.ndarray | None) -> np.ndarray:
        """What a metric's choice loses of an outcome, in the mean over the trainings, (r,)."""
        trainings = len(self.judged.matches[0])
        own = (self.judged.outcome(self.row[self.of_detector[which, t]], t, which, weight) for t in range(trainings))
        its = (self.judged.outcome(self.row[self.of_metric[metric]], t, which, weight) for t in range(trainings))
        return np.mean([one - other for one, other in zip(own, its, strict=True)], axis=0)


def choices(args, world: str, sensor: str, heights: str) -> Choices:
    """Let metrics and detectors choose, and judge what they chose."""
    mounts = mountings(sensor, heights, args.free if heights == FREE else args.fixed)
    name = f"{world}_{sensor}_{heights}"
    part = Part(world, sensor, heights, args.choose, args.choose_frames, args.weights, mounts, True)
    chosen_by = made(part, args.out / f"{name}_choose.npz", args.workers)
    merit = dict(zip(METRICS, chosen_by.scores, strict=True))
    of_metric = {metric: int(np.argmax(of)) for metric, of in merit.items()}
    trainings = range(len(args.weights))
    outcome = {
        (which, t): np.array([float(chosen_by.outcome(m, t, which)[0]) for m in range(len(mounts))])
        for which in OUTCOMES
        for t in trainings
    }
    of_detector = {key: int(np.argmax(of)) for key, of in outcome.items()}
    rank = {
        (metric, which): float(np.mean([spearman(of, outcome[which, t]) for t in trainings]))
        for metric, of in merit.items()
        for which in OUTCOMES
    }
    union = sorted({*of_metric.values(), *of_detector.values()})
    part = replace(
        part, traffic=args.judge, frames=args.judge_frames, mounts=[mounts[m] for m in union], with_metrics=False
    )
    judged = made(part, args.out / f"{name}_judge.npz", args.workers)
    return Choices(mounts, of_metric, of_detector, {m: row for row, m in enumerate(union)}, judged, rank)


def spearman(one: np.ndarray, other: np.ndarray) -> float:
    """Spearman's rank correlation; 0 where one of both is the same everywhere."""
    ranks = [np.argsort(np.argsort(values)).astype(float) for values in (one, other)]
    if np.ptp(one) == 0.0 or np.ptp(other) == 0.0:
        return 0.0
    return float(np.corrcoef(*ranks)[0, 1])


def _study(args) -> None:
    make_folder(args.out, "--out")
    rows = []
    for world in args.worlds:
        for heights in args.heights:
            found = {sensor: choices(args, world, sensor, heights) for sensor in args.sensors}
            rows += list(_rows(found, world, heights, args.judge_frames))
            write_text(args.out / "decision.json", json.dumps(rows, indent=1) + "\n")
            print(_table(rows, world, heights), flush=True)


def _rows(found: dict[str, Choices], world: str, heights: str, frames: int) -> Iterator[dict]:
    """What each metric's choice loses, of each sensor and in their mean, with its interval."""
    first = next(iter(found.values()))
    every_s = 1800.0 / frames
    block = np.arange(frames) // max(1, round(BLOCK_S / every_s))
    vehicles = np.bincount(block[first.judged.matches[0][0][0].vehicle_frame])
    for metric in METRICS:
        for which in OUTCOMES:
            for sensor in (*found, "mean"):
                of = list(found.values()) if sensor == "mean" else [found[sensor]]

                def loss(weight, of=of, metric=metric, which=which):
                    return np.mean([one.losses(metric, which, weight[:, block]) for one in of], axis=0)

                interval = statistic_interval_90(loss, vehicles, _SEED)
                middle = float(loss(np.ones((1, len(vehicles))))[0])
                blocks = int((vehicles > 0).sum())
                wider = student_t(0.975, blocks - 1) / student_t(0.95, blocks - 1)
                yield {
                    "world": world,
                    "heights": heights,
                    "metric": metric,
                    "outcome": which,
                    "sensor": sensor,
                    "loss": middle,
                    "interval_90": None if interval is None else list(interval),
                    "upper_97.5": None if interval is None else middle + wider * (interval[1] - middle),
                    "spearman": float(np.mean([one.rank[metric, which] for one in of])),
                    "mounting": None if sensor == "mean" else found[sensor].mounts[found[sensor].of_metric[metric]],
                }


def _table(rows: Sequence[dict], world: str, heights: str) -> str:
    """The means over the sensors, in points of per cent."""
    lines = [f"{world} world, heights {heights}: points lost against the detector's own choice, 90 % interval"]
    for row in rows:
        if (row["world"], row["heights"], row["sensor"]) == (world, heights, "mean"):
            low, high = (100.0 * end for end in row["interval_90"])
            said = f"{100.0 * row['loss']:6.2f} ({low:6.2f} to {high:6.2f})  Spearman {row['spearman']:5.2f}"
            lines.append(f"{row['metric']:24s} {row['outcome']:14s} {said}")
    return "\n".join([*lines, *_verdicts(rows, world, heights)])


def _verdicts(rows: Sequence[dict], world: str, heights: str) -> Iterator[str]:
    """What was declared beforehand, held against its rule."""
    if (world, heights) != ("hard", FREE):
        return
    for metric, bound, title in ((PE_VGOP.name, 1, "Primary"), (VIEW_COVERAGE.name, "upper_97.5", "Secondary")):
        mean = [
            row
            for row in rows
            if (row["metric"], row["sensor"], row["heights"], row["world"]) == (metric, "mean", FREE, "hard")
        ]
        uppers = [row["interval_90"][1] if bound == 1 else row[bound] for row in mean]
        holds = "holds" if max(uppers) <= MOST_LOSS else "fails"
        bounds = ", ".join(f"{row['outcome']} {100 * upper:.2f}" for row, upper in zip(mean, uppers, strict=True))
        yield f"{title}: {metric} {holds}; upper bounds: {bounds} points"


if __name__ == "__main__":
    sys.exit(main())
