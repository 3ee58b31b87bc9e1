"""Train the detector that ships, `detection.pillars`, in JAX: from simulated roadsides to a file of weights.

    pip install -e ".[fast,detect,plots,sumo]"
    make() { python scripts/research/make_traffic.py --every-s 5 "$@"; }
    make --seed 101 --minutes 30 --out jammed.csv.gz
    make --seed 404 --minutes 20 --level free --out free.csv.gz
    python scripts/research/make_crossing.py --sample crossing_7 --seed 7 --minutes 20
    python scripts/research/train_detector.py --traffic jammed.csv.gz free.csv.gz \\
        --crossings crossing_7/crossing_sample.xml.gz --out pillars.npz

Every site of the training has its own slopes, clutter, reflectivities, mountings and errors of installation; the road
lies to either side of the LiDAR (`pillar_training.shown` flips). Two sites of five have two carriageways, whose LiDAR
hangs in the median or beside the road. With --crossings one of five is at the shipped intersection, each scan turned by
any angle, with vehicles that turn and people who walk and are none of the boxes. Stopped and started again it goes on
where it was: clouds and checkpoints are kept in --work. The weights that ship are older, and saw single carriageways
alone (docs/evidence/detection.md). The same seed gives the same weights on the same machine with the same number of
threads; elsewhere sums are added up in another order.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import partial
from itertools import product
from pathlib import Path

try:
    import jax.numpy as jnp
except ModuleNotFoundError:
    sys.exit('train_detector: needs JAX: pip install -e ".[fast,detect,plots,sumo]"')
import numpy as np

from arguments import SCENES, counting, parser_of, positive, run_script
from blender_lidar.detection.dataset import TRAIN, Sample, plan_dataset, samples
from blender_lidar.detection.ground import fit_ground
from blender_lidar.detection.pillars import PILLAR_M, Area, density
from blender_lidar.errors import InputError
from blender_lidar.files import check_place, make_folder, read_file, whole_file, write_text
from blender_lidar.road.road_map import wrap_angle
from blender_lidar.scene.deployment import MOUNTING
from blender_lidar.scene.scenario import Scenario, load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.workers import Workers
from blender_lidar.studies.candidates import at_one_place
from blender_lidar.traffic.vehicles import PEDESTRIAN
from blender_lidar.world.meshes import GLASS, PAINT, REFLECTIVITY
from detector_worlds import LANE_M, TWO_WAY_LANES, Options, crossing_world, hard_world, two_way_world, write_two_way
from pillar_training import BATCH, WINDOW, Window, batch_of, fresh_weights, rate_at, shown, train_step

MOST_POINTS = {"RS-16": 4096, "RS-32": 8192, "RS-80": 16384, "RS-Ruby-Lite-V2R": 16384}  # above the ground, of a window
SENSORS = tuple(MOST_POINTS)
GATES_M = dict(zip(SENSORS, (50.0, 80.0, 150.0, 150.0), strict=True))
_DRAWN = {  # by site, or within it by scan: from where to where
    "y_m": (-4.0, 0.0),
    "height_m": (1.8, 5.5),
    "tilt_x_deg": (0.0, 30.0),
    "tilt_y_deg": (-3.0, 3.0),
    "clutter": (0.0, 2.0),
    "grade_percent": (-4.0, 4.0),
    "cross_fall_percent": (-3.0, 3.0),
    "crown_percent": (0.0, 2.5),
    "variety_seed": "the number of the site",
    "paint": (0.2, 0.5),  # reflectivities
    "glass": (0.03, 0.1),
}
_IN_MEDIAN = {"median_m": (2.0, 10.0), "height_m": (1.8, 5.5), "tilt_x_deg": (-3.0, 12.0), "tilt_y_deg": (-3.0, 3.0)}
ONE_WAY, TWO_WAY, CROSSING = "one carriageway", "two carriageways", "crossing"
SITES = (ONE_WAY, TWO_WAY, ONE_WAY, TWO_WAY, CROSSING)  # in turn; one carriageway where no crossing is recorded
_AT_CROSSING = ("height_m", "tilt_x_deg", "tilt_y_deg")  # of `_DRAWN`: its poles stand where they stand
_BY_SITE = ("clutter", "grade_percent", "cross_fall_percent", "crown_percent")
MOUNTINGS = 60  # of a site
CHECKPOINT_S = 60.0


def main(argv: list[str] | None = None) -> int:
    return run_script("train_detector", lambda: _train(_arguments(argv)))


def _arguments(argv):
    parser = parser_of(__doc__)
    parser.add_argument("--traffic", nargs="+", required=True, metavar="FILE", help="recordings, NGSIM's columns")
    parser.add_argument(
        "--crossings", nargs="+", default=[], metavar="FILE", help="recordings of make_crossing.py --sample"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.npz", help="the weights")
    parser.add_argument(
        "--work", type=Path, default=Path("train_detector"), help="where clouds and checkpoints are kept"
    )
    parser.add_argument("--sites", type=positive, default=14, help="of each sensor (default 14)")
    parser.add_argument("--scans", type=positive, default=120, help="of each site (default 120)")
    parser.add_argument("--steps", type=positive, default=2400, help="of four windows each (default 2400)")
    parser.add_argument("--seed", type=int, default=1, help="of the weights and the order; the clouds stay the same")
    parser.add_argument("--workers", type=positive, default=2, help="processes that make clouds (default 2)")
    return parser.parse_args(argv)


def _train(args) -> None:
    check_place(args.out, "--out")
    make_folder(args.work, "--work")
    made_of = {
        "traffic": _digests(args.traffic),
        "world": _told(hard_world()),
        "drawn": _DRAWN,
    }
    made_of |= {"sites": SITES, "in_median": _IN_MEDIAN}
    if args.crossings:
        made_of |= {"crossings": _digests(args.crossings), "world_there": _told(crossing_world())}
    _check_work(args.work, made_of)
    windows = _windows(args)
    kept = args.work / f"checkpoint_{args.seed}_{args.steps}_{args.sites}_{args.scans}.npz"
    with counting(args.steps, "steps") as advance:
        weights = train(windows, args.seed, args.steps, kept, advance)
    card = {
        "trained_on": _ranges(windows),
        **made_of,
        "sites_a_sensor": args.sites,
        "scans": {sensor: len(of_sensor) for sensor, of_sensor in windows.items()},
        "points_left_out": {sensor: _left_out(of_sensor, MOST_POINTS[sensor]) for sensor, of_sensor in windows.items()},
        "steps": args.steps,
        "windows_a_step": BATCH,
        "seed": args.seed,
    }
    halves = {name: array.astype(np.float16) for name, array in weights.items()}
    with whole_file(args.out) as temporary:
        np.savez_compressed(temporary, card=json.dumps(card), **halves)
    print(f"{args.out}: {args.out.stat().st_size / 1e6:.2f} MB", file=sys.stderr)


def _digests(paths: Sequence[str]) -> dict[str, str]:
    """SHA-256 of recordings by their names."""
    return {Path(path).name: hashlib.sha256(read_file(path)).hexdigest() for path in paths}


def _told(world: Options) -> dict[str, object]:
    """The settings of a world that no site draws."""
    return {name: value for (_, name), (value, _) in world.items() if name not in _DRAWN}


def _check_work(folder: Path, made_of: Mapping) -> None:
    """Refuse a folder whose clouds are of other traffic or worlds."""
    path, text = folder / "made_of.json", json.dumps(made_of, indent=1)
    if path.exists() and path.read_text(encoding="utf-8") != text:
        raise InputError(f"--work: {folder}: its clouds are of other traffic or worlds; allowed: a folder of its own")
    write_text(path, text)


# --- Clouds -----------------------------------------------------------------------------------------------------------


def _windows(args) -> dict[str, list[Window]]:
    """The windows of each sensor; those of a site are in a file of its own, which is kept."""
    jobs = [(sensor, number) for sensor in SENSORS for number in range(args.sites)]
    paths = [args.work / f"{sensor}_{number}_{args.scans}.npz" for sensor, number in jobs]
    left = [at for at, path in enumerate(paths) if not path.exists()]
    make = partial(_make_site, jobs, paths, args.traffic, args.crossings, args.scans)
    with counting(max(len(left), 1), "sites") as advance, closing(Workers(make, args.workers)) as pool:
        for _ in pool.each(left):
            advance(1)
    found: dict[str, list[Window]] = {sensor: [] for sensor in SENSORS}
    for (sensor, _), path in zip(jobs, paths, strict=True):
        found[sensor] += _from_arrays(path)
    return found


def _make_site(jobs, paths, traffic: Sequence[str], crossings: Sequence[str], scans: int, at: int) -> None:
    """The windows of one of the jobs, in its file."""
    table = paths[at].with_suffix(".csv")
    made = list(site_windows(*jobs[at], traffic, crossings, scans, table))
    table.unlink(missing_ok=True)
    with whole_file(paths[at]) as temporary:
        np.savez(temporary, **_as_arrays(made))


def site_windows(
    sensor: str, number: int, traffic: Sequence[str], crossings: Sequence[str], scans: int, table: Path
) -> Iterator[Window]:
    """Windows of one site: its slopes and clutter are drawn by its number, each scan's mounting within its bounds.

    `table` is where traffic of two carriageways may be written.
    """
    rng = np.random.default_rng([SENSORS.index(sensor), number])
    kind = SITES[number % len(SITES)]
    crossed, two_way = bool(crossings) and kind == CROSSING, kind == TWO_WAY
    recordings, drawn = (crossings, _AT_CROSSING) if crossed else (traffic, MOUNTING)
    paint, glass = rng.uniform(*np.transpose([_DRAWN["paint"], _DRAWN["glass"]]))
    settings = {
        ("sensor", "name"): sensor,
        ("sensor", "range_gate_m"): GATES_M[sensor],
        ("traffic", "path"): str(Path(recordings[number % len(recordings)]).resolve()),
        ("traffic", "frames"): 60,
        ("traffic", "holdout"): 0.0,
        **{("deployment", name): limits for name, limits in _DRAWN.items() if name in drawn},
        ("search", "seeds"): 1,
        ("world", "variety_seed"): number,
    }
    for name in () if crossed else _BY_SITE:
        settings["world" if name == "clutter" else "road", name] = float(rng.uniform(*_DRAWN[name]))
    if two_way:
        median_m, pairs = float(rng.uniform(*_IN_MEDIAN["median_m"])), list(product(traffic, repeat=2))
        write_two_way(table, pairs[int(rng.integers(len(pairs)))], median_m)
        settings[("traffic", "path")] = str(table.resolve())
        if number % len(SITES) == SITES.index(TWO_WAY):
            middle = 2.0 + TWO_WAY_LANES * LANE_M + 0.5 * median_m
            settings |= {("deployment", name): _IN_MEDIAN[name] for name in drawn if name in _IN_MEDIAN}
            settings |= {("deployment", "y_m"): (middle - 0.3 * median_m, middle + 0.3 * median_m)}
            settings |= {("deployment", "facing_deg"): 90.0}
    options = {place: (value, place[1]) for place, value in settings.items()}
    if two_way:
        options |= two_way_world(rng, median_m)
    if crossed:
        site = prepare(_at_crossing(number // len(SITES), options))
    else:
        site = prepare(load_scenario(SCENES / "i80.toml", {**hard_world(), **options}))
    plan = plan_dataset(site, MOUNTINGS, scans, seed=number + 1)
    gate_m, left_m = site.observation.lidar.max_range_m, site.scenario.road_map.edges_t[1] if two_way else 17.4
    with _reflectivities(paint, glass):
        for one in samples(plan):
            if one.scan.split == TRAIN:
                yield window_of(one, gate_m, rng, left_m, crossed)


@contextmanager
def _reflectivities(paint: float, glass: float) -> Iterator[None]:
    """Vehicles of other reflectivities, in this process."""
    before = REFLECTIVITY.copy()
    REFLECTIVITY[[PAINT, GLASS]] = paint, glass
    try:
        yield
    finally:
        REFLECTIVITY[:] = before


def _at_crossing(number: int, options: Options) -> Scenario:
    """The scene of one of the poles of the shipped intersection."""
    scenario = load_scenario(SCENES / "crossing.toml", {**crossing_world(), **options})
    poles = [place.pole.name for place in scenario.lidar.deployment.places]
    return at_one_place(scenario, poles[number % len(poles)])


def window_of(sample: Sample, gate_m: float, rng: np.random.Generator, left_m: float, crossed: bool = False) -> Window:
    """A part of a scan as large as `WINDOW`, within the range gate: across a road, anywhere at a crossing.

    A road reaches to y = `left_m` or a little farther. At a crossing the scan is turned about the mast by any angle.
    """
    pose = sample.pose
    foot, size = np.array([pose.x_m, pose.y_m, 0.0]), PILLAR_M * np.array(WINDOW)
    low = np.array([-gate_m - 4.0, -13.0 - pose.y_m])
    high = np.maximum([gate_m + 4.0 - size[0], left_m + 13.0 - size[1] - pose.y_m], low)
    turn = 0.0
    if crossed:
        low, high, turn = np.full(2, -gate_m - 4.0), gate_m + 4.0 - size, rng.uniform(-math.pi, math.pi)
    first = PILLAR_M * np.rint(rng.uniform(low, high) / PILLAR_M)
    cos, sin = math.cos(turn), math.sin(turn)
    about = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])  # for rows
    from_lidar = (sample.cloud.xyz - foot) @ about
    inside = ((from_lidar[:, :2] >= first) & (from_lidar[:, :2] < first + size)).all(axis=1)
    vehicles, labelled = sample.vehicles, sample.labelled
    boxes = np.column_stack(
        [
            (vehicles.centre_m - foot) @ about,
            vehicles.size_m,
            wrap_angle(vehicles.heading_rad + turn),
            vehicles.kind,
            np.where(labelled, sample.points, 0),
        ]
    )[vehicles.class_index != PEDESTRIAN]
    lean = np.degrees(np.arccos(min(1.0, pose.rotation[2, 2])))
    area = Area(tuple(first.tolist()), *WINDOW)
    return Window(from_lidar[inside].astype(np.float32), boxes, pose.height_m, float(lean), area)


def _as_arrays(windows: Sequence[Window]) -> dict[str, np.ndarray]:
    return {
        "points": np.concatenate([one.points for one in windows]),
        "boxes": np.concatenate([one.boxes for one in windows]),
        "counts": np.array([(len(one.points), len(one.boxes)) for one in windows]),
        "mounts": np.array([(one.lidar_m, one.lean_deg, *one.area.first_m) for one in windows]),
    }


def _from_arrays(path: Path) -> list[Window]:
    with np.load(path, allow_pickle=False) as file:
        points, boxes, counts, mounts = (file[name] for name in ("points", "boxes", "counts", "mounts"))
    ends = np.cumsum(counts, axis=0)[:-1]
    parts = zip(np.split(points, ends[:, 0]), np.split(boxes, ends[:, 1]), mounts.tolist(), strict=True)
    return [Window(one, other, height, lean, Area((x, y), *WINDOW)) for one, other, (height, lean, x, y) in parts]


def _left_out(windows: Sequence[Window], most: int) -> float:
    """Share of the points above the ground that are more than a window may have."""
    rng = np.random.default_rng(0)
    some = windows[:: max(1, len(windows) // 100)]
    counts = np.array([len(shown(one, (False, False), sys.maxsize, rng)[0].cell) for one in some])
    return float(np.maximum(counts - most, 0).sum() / max(counts.sum(), 1))


def _ranges(windows: Mapping[str, Sequence[Window]]) -> dict[str, object]:
    """What the training covered: sensors, and from where to where mountings, ground and density went."""
    every = [one for of_sensor in windows.values() for one in of_sensor]
    rng = np.random.default_rng(0)
    some = every[:: max(1, len(every) // 300)]
    grounds = [fit_ground(one.points.astype(float)).residual_m for one in some]
    filled = [density(shown(one, (False, False), sys.maxsize, rng)[0]) for one in some]
    filled = [points for points in filled if points > 0.0]  # far windows may be empty
    return {
        "sensors": list(windows),
        "height_m": [min(one.lidar_m for one in every), max(one.lidar_m for one in every)],
        "lean_deg": [0.0, max(one.lean_deg for one in every)],
        "residual_m": [0.0, float(np.nanquantile(grounds, 0.95))],
        "density": np.quantile(filled, [0.01, 0.99]).tolist(),
    }


# --- Training ---------------------------------------------------------------------------------------------------------


def train(windows: dict[str, Sequence[Window]], seed: int, steps: int, kept: Path, advance) -> dict[str, np.ndarray]:
    """Train from the last checkpoint on; returns the weights.

    Each step draws from a generator of its own, so that a run that was stopped goes on as it would have.
    """
    weights, mean, square, begun = _checkpoint(kept, seed)
    advance(begun)
    sensors, saved = sorted(windows), time.monotonic()
    for step in range(begun + 1, steps + 1):
        rng = np.random.default_rng([seed, step])
        sensor = sensors[rng.integers(len(sensors))]
        most = MOST_POINTS[sensor]
        chosen = rng.choice(len(windows[sensor]), BATCH)
        items = [shown(windows[sensor][row], tuple(rng.random(2) < 0.5), most, rng) for row in chosen]
        frames, targets = batch_of(items, most)
        rate = rate_at(step, steps)
        weights, mean, square, parts = train_step(weights, mean, square, float(step), rate, frames, targets)
        if step % 50 == 0 or step == steps:
            advance(step % 50 or 50, "heat {:.3f}, boxes {:.3f}".format(*map(float, parts)))
        if time.monotonic() - saved > CHECKPOINT_S or step == steps:
            _keep(kept, weights, mean, square, step)
            saved = time.monotonic()
    return {name: np.asarray(array) for name, array in weights.items()}


def _checkpoint(path: Path, seed: int):
    """Weights, both moments and the number of steps of a run that was stopped, or fresh ones."""
    fresh = fresh_weights(seed)
    if not path.exists():
        zeros = ({name: jnp.zeros_like(array) for name, array in fresh.items()} for _ in range(2))
        return fresh, *zeros, 0
    with np.load(path, allow_pickle=False) as file:
        parts = [
            {name: jnp.asarray(file[f"{part}/{name}"]) for name in fresh} for part in ("weights", "mean", "square")
        ]
        return *parts, int(file["step"])


def _keep(path: Path, weights, mean, square, step: int) -> None:
    parts = {"weights": weights, "mean": mean, "square": square}
    arrays = {f"{part}/{name}": np.asarray(array) for part, held in parts.items() for name, array in held.items()}
    with whole_file(path) as temporary:
        np.savez(temporary, step=step, **arrays)


if __name__ == "__main__":
    sys.exit(main())
