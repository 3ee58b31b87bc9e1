"""Does the mounting that a metric chooses serve a detector as well as the one that the detector itself would choose?

    python scripts/research/detector_decision.py --choose A.csv.gz --judge B.csv.gz --weights one.npz two.npz

Random mountings are scored by every metric, by their height and by detectors on the traffic that chooses; the mountings
that they choose are judged by the detectors on other traffic. What a metric's choice loses is the detector's recall at
confidence 0.3 (centres within 2 m), or its AP at bird's-eye IoU 0.5, at the detector's own choice less that at the
metric's, in the mean over the trainings of the detector; a metric to which all mountings are alike chooses none. In the
hard world a LiDAR hangs off its plan by a draw for each frame, the same for all mountings: the detector meets it when
it chooses too, metrics score the plan. Intervals resample blocks of a minute or longer than most transits of a site,
the same for all sensors. Sites, mountings, trainings and what was chosen on the one recording stay as they are: a
detector that chooses on few frames chooses worse, which makes every loss smaller.

Declared before it was run. Primary: PE-VGOP, free heights, hard world, the mean over the sensors: at most 1 point of
recall and 1 of AP, by the upper 95 % bound. Secondary: view coverage, by the same rule with Bonferroni's correction for
two. All else is given with its interval and proves nothing by itself; height came in later, as a control.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from arguments import SCENES, counting, parser_of, positive, run_script
from blender_lidar.casting import resolve
from blender_lidar.clouds.scan import FrameScan
from blender_lidar.detection.judge import believed, detector_at, hung_off_by, region_of_alarms
from blender_lidar.detection.scores import CRITERIA, Matches, average_precision, match, recall
from blender_lidar.errors import InputError
from blender_lidar.files import make_folder, read_file, whole_file, write_text
from blender_lidar.metrics.catalogue import METRICS, PE_VGOP, VIEW_COVERAGE
from blender_lidar.scene.mounting import Mounting
from blender_lidar.scene.provenance import CODE, source_digest, versions
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import Site, prepare, scoring_of
from blender_lidar.scoring.frame_scorer import FrameScorer, FrameShapes, singles
from blender_lidar.scoring.scores import VehicleScores
from blender_lidar.scoring.workers import Workers
from blender_lidar.statistics import statistic_interval_90, student_t
from detector_worlds import Options, hard_world
from scene_metrics import OPTIONS

SENSORS = ("RS-16", "RS-32", "RS-80")
HEIGHTS_M, TILTS_DEG = (2.0, 4.5), (0.0, 25.0)
FREE = "free"
HEIGHTS = (FREE, "2", "3", "4", "4.5")
LEAST_BLOCK_S = 60.0
OUTCOMES = ("recall at 0.3", "AP at IoU 0.5")
MOST_LOSS = 0.01
COUNTS = {"free": 40, "fixed": 20, "choose_frames": 60, "judge_frames": 180}  # unless other ones are asked for
FEWEST_TRAININGS = 2
MEAN = "mean"
HEIGHT = "height"  # the control: who knows nothing but that higher is better
CHOOSERS = (*METRICS, *OPTIONS, HEIGHT)
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
    parser.add_argument("--heights", nargs="+", default=HEIGHTS, choices=HEIGHTS, help="free, or metres")
    parser.add_argument("--free", type=positive, help="mountings at free heights (default 40)")
    parser.add_argument("--fixed", type=positive, help="mountings at each fixed height (default 20)")
    parser.add_argument("--choose-frames", type=positive, help="default 60")
    parser.add_argument("--judge-frames", type=positive, help="default 180")
    parser.set_defaults(**COUNTS)
    parser.add_argument("--workers", type=positive, default=2)
    return parser.parse_args(argv)


# --- Mountings and what is made of them -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Part:
    """A sensor in a world under some mountings, on so many frames of the traffic that chooses or of that which judges.

    Metrics have a say where the traffic chooses.
    """

    world: str
    sensor: str
    traffic: str
    frames: int
    weights: Sequence[str]
    mounts: Sequence[dict[str, float]]
    chooses: bool

    def described(self) -> dict[str, object]:
        """What its file must be of: code, caster, and files by their digests."""
        given = {one.name: getattr(self, one.name) for one in fields(self)}
        given |= {"traffic": _digest(self.traffic), "weights": [*map(_digest, self.weights)]}
        given |= {"world": [*map(str, _world(self.world).items())], "caster": resolve("auto"), CODE: source_digest()}
        return json.loads(json.dumps(given))


def _world(name: str) -> Options:
    return hard_world() if name == "hard" else {}


def _digest(path: str) -> str:
    return hashlib.sha256(read_file(path)).hexdigest()


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
        return prepare(load_scenario(SCENES / "i80.toml", {**_world(self.part.world), **options}))

    @cached_property
    def metrics(self) -> dict[str, VehicleScores]:
        """Every metric of vehicles and of scenes, each by what it gives a vehicle, as `optimise --metric` has it."""
        site, scenario = self.site, self.site.scenario
        found = {}
        for name, option in {**{name: name for name in METRICS}, **OPTIONS}.items():
            loss = scenario.objective.loss if name == PE_VGOP.name else None
            own = replace(scenario, objective=replace(scenario.objective, metric=option, loss=loss))
            found[name] = VehicleScores(scoring_of(own), site.observation, site.search)
        return found

    @cached_property
    def mountings(self) -> list[Mounting]:
        """The part's, as the site's road bears them."""
        return [self.site.scenario.mounting(mount) for mount in self.part.mounts]

    @cached_property
    def detectors(self) -> list[list]:
        """For each mounting a detector of each training."""
        return [[detector_at(self.site, mounting, path) for path in self.part.weights] for mounting in self.mountings]

    def __call__(self, row: int) -> tuple[np.ndarray, list[list[list[Matches]]]]:
        """Sums of each metric, (metrics, mountings), and matches by mounting, training and criterion of a frame."""
        site, part = self.site, self.part
        frame = site.search[row]
        shapes = FrameShapes(frame.vehicles, frame.counted, site.observation.detail, site.observation.caster)
        scores = np.zeros((0, len(part.mounts)))
        if part.chooses:
            layouts = singles(mounting.pose for mounting in self.mountings)
            scorer = FrameScorer(frame.vehicles, frame.counted, site.observation, shapes)
            seen = scorer.see(layouts, keep_returns=True)
            made = (one.of_seen(frame, scorer, seen, layouts) for one in self.metrics.values())
            scores = np.array([one.objective.sum(axis=1) for one in made])
        scan = FrameScan(shapes, frame.vehicles, site.observation, ground=site.scenario.world.ground)
        return scores, [self._matched(row, scan, number) for number in range(len(part.mounts))]

    def _matched(self, row: int, scan: FrameScan, number: int) -> list[list[Matches]]:
        """What each training of the detector finds in a frame at a mounting."""
        site, mounting, frame = self.site, self.mountings[number], self.site.search[row]
        rng = np.random.default_rng([_SEED, self.part.chooses, row])
        there = hung_off_by(site.scenario, mounting, rng).pose
        cloud = believed(scan.cloud(there, scan.turn(there)), there, mounting.pose)
        found = [one.detect(cloud)[0] for one in self.detectors[number]]
        region = region_of_alarms(site.region)
        return [[match([boxes], [frame], region, mounting.xy, criterion) for criterion in CRITERIA] for boxes in found]


_OF_FRAMES = ("frame", "vehicle_frame")


def joined(frames: Sequence[Matches]) -> Matches:
    """Matches of several frames, each given by itself, as those of all."""
    columns = {}
    for name in (column.name for column in fields(Matches) if column.name != "frames"):
        parts = [getattr(one, name) + at if name in _OF_FRAMES else getattr(one, name) for at, one in enumerate(frames)]
        columns[name] = np.concatenate(parts)
    return Matches(len(frames), **columns)


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """What was made of a part.

    Attributes
    ----------
    scores : ndarray, (metrics, mountings)
        Sums of what each metric gives the vehicles.
    matches : list
        By mounting, training and criterion.
    time_s : ndarray, (f,)
        Of the frames [s].
    block_s : float
        The length of a block by the longest transit of the site [s].
    """

    scores: np.ndarray
    matches: list[list[list[Matches]]]
    time_s: np.ndarray
    block_s: float

    known: dict[tuple, np.ndarray] = field(default_factory=dict)

    def outcome(self, mounting: int, training: int, which: str, weight: np.ndarray | None = None) -> np.ndarray:
        """One of `OUTCOMES`, (r,); `weight` (r, f) is how often each frame counts. Kept, as metrics choose alike."""
        place = mounting, training, which, None if weight is None else hash(weight.tobytes())
        if place not in self.known:
            by_criterion = self.matches[mounting][training]
            if which == OUTCOMES[0]:
                self.known[place] = recall(by_criterion[0], 0.3, weight)
            else:
                self.known[place] = average_precision(by_criterion[1], weight)
        return self.known[place]


def made(part: Part, path: Path, workers: int) -> Made:
    """A part, from its file where it is done.

    Raises
    ------
    InputError
        Where the file is of another part.
    """
    described = part.described()
    if not path.exists():
        work = FrameWork(part)
        count = len(work.site.search)
        with closing(Workers(work, workers)) as pool, counting(count, path.stem) as advance:
            frames = []
            for one in pool.each(range(count)):
                frames.append(one)
                advance(1)
        arrays = {
            "part": json.dumps(described),
            "scores": np.sum([scores for scores, _ in frames], axis=0),
            "time_s": np.array([frame.vehicles.time_s for frame in work.site.search]),
            "block_s": work.site.plan.block_s,
        }
        for place in _places(part):
            mounting, training, row = place
            whole = joined([matches[mounting][training][row] for _, matches in frames])
            for column in fields(Matches):
                arrays[_key(place, column.name)] = getattr(whole, column.name)
        with whole_file(path) as temporary:
            np.savez_compressed(temporary, **arrays)
    with np.load(path, allow_pickle=False) as file:
        held = {name: file[name] for name in file.files}
    if json.loads(str(held["part"])) != described:
        raise InputError(f"{path}: is of other code, traffic, weights or mountings; allowed: an --out of its own")
    matches = [[[None] * len(CRITERIA) for _ in part.weights] for _ in part.mounts]
    for place in _places(part):
        mounting, training, row = place
        columns = {column.name: held[_key(place, column.name)] for column in fields(Matches)}
        matches[mounting][training][row] = Matches(**{**columns, "frames": int(columns["frames"])})
    return Made(held["scores"], matches, held["time_s"], float(held["block_s"]))


def _places(part: Part) -> Iterator[tuple[int, int, int]]:
    return itertools.product(range(len(part.mounts)), range(len(part.weights)), range(len(CRITERIA)))


def _key(place: tuple[int, int, int], name: str) -> str:
    return "/".join([*map(str, place), name])


# --- The study --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Choices:
    """Which of a sensor's mountings is chosen, and what was made of those on the traffic that judges.

    `of_metric` maps a metric that chooses, `of_detector` an outcome and a training, to a mounting; `row` a mounting to
    its row in `judged`. `rank` is Spearman's correlation of a metric with an outcome over all mountings that choose.
    """

    mounts: Sequence[dict[str, float]]
    of_metric: dict[str, int]
    of_detector: dict[tuple[str, int], int]
    row: dict[int, int]
    judged: Made
    rank: dict[tuple[str, str], float]

    def outcomes(self, metric: str, which: str, weight: np.ndarray | None = None) -> np.ndarray:
        """An outcome at the detector's own choice and at a metric's, by training, (2, t, r)."""
        trainings = range(len(self.judged.matches[0]))
        chosen = [[self.of_detector[which, t] for t in trainings], [self.of_metric[metric]] * len(trainings)]
        return np.array(
            [
                [self.judged.outcome(self.row[mounting], t, which, weight) for t, mounting in enumerate(side)]
                for side in chosen
            ]
        )

    def loss(self, metric: str, which: str, weight: np.ndarray | None = None) -> np.ndarray:
        """What a metric's choice loses of an outcome, in the mean over the trainings, (r,)."""
        own, its = self.outcomes(metric, which, weight)
        return (own - its).mean(axis=0)


def choices(args, world: str, sensor: str, heights: str) -> Choices:
    """Let metrics and detectors choose, and judge what they chose."""
    mounts = mountings(sensor, heights, args.free if heights == FREE else args.fixed)
    name = f"{world}_{sensor}_{heights}"
    part = Part(world, sensor, args.choose, args.choose_frames, args.weights, mounts, True)
    chosen_by = made(part, args.out / f"{name}_choose.npz", args.workers)
    heights_m = np.array([mount["height_m"] for mount in mounts])
    merit = dict(zip(CHOOSERS, (*chosen_by.scores, heights_m), strict=True))
    merit = {metric: of for metric, of in merit.items() if _differ(of)}
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
    of_union = [mounts[m] for m in union]
    part = replace(part, traffic=args.judge, frames=args.judge_frames, mounts=of_union, chooses=False)
    judged = made(part, args.out / f"{name}_judge.npz", args.workers)
    return Choices(mounts, of_metric, of_detector, {m: row for row, m in enumerate(union)}, judged, rank)


def _differ(merit: np.ndarray) -> bool:
    """Whether there is anything to choose by, but for rounding."""
    return bool(np.ptp(merit) > 1e-9 * np.abs(merit).max())


def spearman(one: np.ndarray, other: np.ndarray) -> float:
    """Spearman's rank correlation; 0 where one of both is the same everywhere."""
    if np.ptp(one) == 0.0 or np.ptp(other) == 0.0:
        return 0.0
    return float(spearmanr(one, other).statistic)


def _study(args) -> None:
    if _digest(args.choose) == _digest(args.judge):
        raise InputError(f"--judge: {args.judge}: is the traffic that chooses; allowed: other traffic")
    make_folder(args.out, "--out")
    values = {"choose": args.choose, "judge": args.judge, "weights": list(args.weights), "caster": resolve("auto")}
    values |= {f"{name}_frames": getattr(args, f"{name}_frames") for name in ("choose", "judge")}
    for world, heights in itertools.product(args.worlds, args.heights):
        found = {sensor: choices(args, world, sensor, heights) for sensor in args.sensors}
        rows = list(rows_of(found, world, heights))
        verdict = list(verdicts(rows)) if _is_declared(args, world, heights) else []
        result = {**values, "versions": versions(values["caster"]), "verdicts": verdict, "rows": rows}
        write_text(args.out / f"decision_{world}_{heights}.json", json.dumps(result, indent=1) + "\n")
        print(_table(rows, world, heights), *verdict, sep="\n", flush=True)


def _is_declared(args, world: str, heights: str) -> bool:
    """Whether this is what was declared, and not a smaller trial."""
    asked = {name: getattr(args, name) for name in COUNTS}
    same = (world, heights, *args.sensors) == ("hard", FREE, *SENSORS) and asked == COUNTS
    return same and len(args.weights) >= FEWEST_TRAININGS


def rows_of(found: Mapping[str, Choices], world: str, heights: str) -> Iterator[dict]:
    """What each metric's choice loses, of each sensor and in their mean, with its interval."""
    every = list(found.values())
    time_s = every[0].judged.time_s
    block_s = max(LEAST_BLOCK_S, *(one.judged.block_s for one in every))
    block = np.unique((time_s - time_s[0]) // block_s, return_inverse=True)[1]
    vehicles = np.bincount(block[every[0].judged.matches[0][0][0].vehicle_frame], minlength=block.max() + 1)
    degrees = int((vehicles > 0).sum()) - 1
    for metric, which, sensor in itertools.product(CHOOSERS, OUTCOMES, (*found, MEAN)):
        of = every if sensor == MEAN else [found[sensor]]
        if not all(metric in one.of_metric for one in of):
            continue

        def loss(weight, of=of, metric=metric, which=which):
            return np.mean([one.loss(metric, which, weight[:, block]) for one in of], axis=0)

        interval = statistic_interval_90(loss, vehicles, _SEED)
        middle = float(loss(np.ones((1, len(vehicles))))[0])
        row = {"world": world, "heights": heights, "metric": metric, "outcome": which, "sensor": sensor}
        row |= {"loss": middle, "interval_90": interval and list(interval), "blocks": len(vehicles), "block_s": block_s}
        wider = interval and student_t(0.975, degrees) / student_t(0.95, degrees)
        row["upper_97.5"] = interval and middle + wider * (interval[1] - middle)
        row["spearman"] = float(np.mean([one.rank[metric, which] for one in of]))
        if sensor != MEAN:
            own, its = of[0].outcomes(metric, which)[..., 0]
            row |= {"of_detectors_choice": own.tolist(), "of_metrics_choice": its.tolist()}
            row["metrics_choice"] = of[0].mounts[of[0].of_metric[metric]]
            row["detectors_choice"] = [of[0].mounts[of[0].of_detector[which, t]] for t in range(len(own))]
        yield row


def _table(rows: Sequence[dict], world: str, heights: str) -> str:
    """The means over the sensors, in points of per cent."""
    lines = [f"{world} world, heights {heights}: points lost against the detector's own choice, 90 % interval"]
    for row in rows:
        if (row["world"], row["heights"], row["sensor"]) == (world, heights, MEAN):
            ends = row["interval_90"] and "{:6.2f} to {:6.2f}".format(*(100.0 * end for end in row["interval_90"]))
            said = f"{100.0 * row['loss']:6.2f} ({ends or 'too few blocks'})  Spearman {row['spearman']:5.2f}"
            lines.append(f"{row['metric']:24s} {row['outcome']:14s} {said}")
    return "\n".join(lines)


def verdicts(rows: Sequence[dict]) -> Iterator[str]:
    """What was declared beforehand, held against its rule."""
    for title, metric, bound_of in (
        ("Primary", PE_VGOP.name, lambda row: row["interval_90"] and row["interval_90"][1]),
        ("Secondary", VIEW_COVERAGE.name, lambda row: row["upper_97.5"]),
    ):
        mine = [row for row in rows if (row["metric"], row["sensor"]) == (metric, MEAN)]
        uppers = {row["outcome"]: bound_of(row) for row in mine}
        if not uppers or None in uppers.values():
            yield f"{title}: {metric}: {'too few blocks for a bound' if uppers else 'chooses nothing'}"
            continue
        bounds = ", ".join(f"{which} {100 * upper:.2f}" for which, upper in uppers.items())
        verdict = "holds" if max(uppers.values()) <= MOST_LOSS else "fails"
        yield f"{title}: {metric} {verdict}; upper bounds: {bounds} points"


if __name__ == "__main__":
    sys.exit(main())
