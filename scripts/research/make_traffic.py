"""Generate dense stop-and-go traffic that looks like NGSIM I-80 0400-0415, with SUMO: the shipped default traffic.

The output has the layout of the NGSIM portal's CSV (feet, front centres, lane 1 leftmost) and says in every row, by
``Location = synthetic-i80``, that no vehicle in it was ever observed. NGSIM data themselves are never copied.

    pip install "blender_lidar[sumo]"
    python scripts/research/make_traffic.py --out scenes/i80_sample.csv.gz
    python scripts/research/make_traffic.py --dense-s 250 270 --out scenes/i80_drive.csv.gz

The second is 20 s of the same simulation, an instant every 0.5 s: what the add-on plays in its example.

Same seed and same version of SUMO, same file (the shipped one: seed 42, SUMO 1.28.0). Global_X/Y are the local frame
turned by the road's bearing at the entry; the road is straight, where the real one bends by 2 degrees.
"""

from __future__ import annotations

import contextlib
import gzip
import importlib
import io
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd

from arguments import SCENES, parser_of, run_script
from blender_lidar.errors import BlenderLidarError, InputError, MissingExtraError
from blender_lidar.files import check_place, write_bytes

FOOT_M = 0.3048
LANES, LANE_M = 6, 12 * FOOT_M
SECTION_M = 1650 * FOOT_M
GORE_M, MERGE_END_M = 117.8, 202.3  # the Powell Street on-ramp's gore and the end of its acceleration lane
NODES_M = {"start": -1000.0, "gore": GORE_M, "merge": MERGE_END_M, "signs": 650.0, "out": 900.0, "end": 1200.0}
MAIN = ("run_in", "acceleration", "section", "bottleneck", "run_out")  # the edges between them
RAMP_SPREAD = 1.27e-4  # the ramp lies this times (gore - x)^2 metres off the carriageway: a slope of 3 % at x = 0
SPEED_LIMIT = 29.0  # 65 mph
STEP_S = 0.1  # NGSIM's frame

LOCATION = "synthetic-i80"
GLOBAL_TIME_MS = 1113433200000  # 2005-04-13 16:00:00 PDT, at frame 0
GLOBAL_ORIGIN_FT = (6042831.32, 2133067.73)  # of local (0, 0), EPSG:2227
BEARING = math.radians(-7.1)  # of the direction of travel, clockwise from grid north

# By v_Class: share of the vehicles, and quantiles of length and width [m] as measured on I-80 (car widths capped at
# 8.5 ft, as there). Motorcycles have their true width: the 1.55 m of NGSIM come from the video's blobs.
MOTORCYCLE, CAR, TRUCK = 1, 2, 3
SHARE = {MOTORCYCLE: 0.015, CAR: 0.95, TRUCK: 0.035}
QUANTILES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
LENGTH_M = {
    MOTORCYCLE: (1.8, 1.9, 2.1, 2.2, 2.3, 2.4, 2.5),
    CAR: (2.9, 3.66, 4.21, 4.51, 4.82, 5.55, 6.04),
    TRUCK: (7.4, 7.6, 8.9, 12.7, 18.3, 22.6, 23.0),
}
WIDTH_M = {
    MOTORCYCLE: (0.7, 0.7, 0.8, 0.8, 0.8, 0.9, 0.9),
    CAR: (1.5, 1.65, 1.92, 2.10, 2.29, 2.59, 2.59),
    TRUCK: (2.4, 2.49, 2.55, 2.59, 2.59, 2.59, 2.59),
}
SUMO_CLASS = {MOTORCYCLE: "motorcycle", CAR: "passenger", TRUCK: "truck"}

# Lanes 1 to 6, fitted so that densities, flows and speeds come near those published for I-80 0400-0415.
DEMAND_SHARE = (0.18, 0.17, 0.15, 0.16, 0.17, 0.17)
HEADWAY_S = (1.51, 1.51, 1.61, 1.40, 1.33, 1.12)
YIELDING = 0.5  # share of drivers that brake to let others in; when all do, the ramp starves lane 6
# SUMO's vehicles follow the lane's centre. Ours keep off it, and weave by the distance driven (never while standing).
OFFSET_M, WEAVE_M, WEAVE_LENGTH_M, LANE_MARGIN_M = 0.3, 0.2, (40.0, 110.0), 0.1


@dataclass(frozen=True, slots=True)
class Level:
    """How full the road is: demand, speed limits [m/s] of the HOV lane and the ramp, and the mean limits on the signs
    of lanes 1 to 6 beyond the section (none: no signs), whose slow swing sends waves up the road."""

    main_per_h: float
    ramp_per_h: float
    hov_limit: float
    ramp_limit: float
    sign_limits: tuple[float, ...]
    warm_up_s: int


LEVELS = {
    "jammed": Level(7700, 400, 16.5, 9.0, (30.0, 14.5, 14.5, 13.0, 10.5, 4.7), warm_up_s=900),
    "free": Level(3000, 150, SPEED_LIMIT, 20.0, (), warm_up_s=120),
}


class SumoError(BlenderLidarError):
    """SUMO itself failed."""

    exit_code = 1


def find_tool(name: str) -> str:
    """A SUMO program's path: in the eclipse-sumo package, else in ``SUMO_HOME``, else on the path."""
    homes = [os.environ.get("SUMO_HOME", "")]
    with contextlib.suppress(ImportError):
        homes.insert(0, getattr(importlib.import_module("sumo"), "SUMO_HOME", ""))
    folders = [str(Path(home) / "bin") for home in homes if home]
    found = shutil.which(name, path=os.pathsep.join([*folders, os.environ.get("PATH", "")]))
    if not found:
        raise MissingExtraError(f'SUMO ({name}) is not installed: pip install "blender_lidar[sumo]"')
    return found


def draw_vehicles(rng: np.random.Generator, level: Level, end_s: float) -> pd.DataFrame:
    """The vehicles that want to enter until `end_s`, one a row, by departure; `lane` 7 is the ramp."""
    n_main, n_ramp = (round(flow * end_s / 3600) for flow in (level.main_per_h, level.ramp_per_h))
    count = n_main + n_ramp
    metered_s = (np.arange(n_ramp) + 0.6 * rng.random(n_ramp)) * end_s / n_ramp
    depart_s = np.concatenate([rng.uniform(0, end_s, n_main), metered_s])
    lane = np.concatenate([rng.choice(LANES, n_main, p=DEMAND_SHARE) + 1, np.full(n_ramp, LANES + 1)])
    kind = rng.choice(list(SHARE), count, p=list(SHARE.values()))
    lane = np.where(
        (kind == TRUCK) & (lane <= 3), rng.integers(4, LANES + 1, count), lane
    )  # 1 to 3 are closed to trucks

    length_m, width_m = draw_sizes(rng, kind, LENGTH_M), draw_sizes(rng, kind, WIDTH_M)
    room_m = (LANE_M - width_m) / 2 - LANE_MARGIN_M - WEAVE_M
    headway_s = np.array(HEADWAY_S)[np.minimum(lane, LANES) - 1] * np.where(kind == TRUCK, 1.2, 1.0)
    table = pd.DataFrame(
        {
            "depart_s": depart_s,
            "lane": lane,
            "kind": kind,
            "length_m": length_m,
            "width_m": width_m,
            "headway_s": np.maximum(0.8, headway_s * (1 + 0.15 * rng.standard_normal(count))),
            "speed_factor": np.clip(1 + 0.1 * rng.standard_normal(count), 0.8, 1.2),
            "yields": (lane > LANES) | (rng.random(count) < YIELDING),
            "offset_m": np.clip(OFFSET_M * rng.standard_normal(count), -room_m, room_m),
            "weave_length_m": rng.uniform(*WEAVE_LENGTH_M, count),
            "weave_phase": rng.uniform(0, 2 * math.pi, count),
        }
    )
    return table.sort_values("depart_s", ignore_index=True)


def draw_sizes(rng: np.random.Generator, kind: np.ndarray, quantiles: dict[int, tuple[float, ...]]) -> np.ndarray:
    """Sizes [m], whole in 0.1 ft as NGSIM's, so that the file's boxes are those between which SUMO keeps its gaps."""
    level = rng.random(kind.size)
    size_m = np.select([kind == k for k in SHARE], [np.interp(level, QUANTILES, quantiles[k]) for k in SHARE])
    return (size_m / FOOT_M).round(1) * FOOT_M


def write_xml(path: Path, root: str, rows: list[str]) -> None:
    path.write_text(f"<{root}>\n" + "\n".join(rows) + f"\n</{root}>\n", encoding="utf-8")


def write_network(folder: Path, level: Level) -> None:
    """Build the road: straight, so that no edge joint bends a path, with the carriageway's left edge on y = 0."""
    ramp_x = np.array([-300.0, -200.0, -100.0, -50.0, 0.0, 40.0, 80.0, GORE_M])
    ramp_y = -LANES * LANE_M - RAMP_SPREAD * (GORE_M - ramp_x) ** 2
    shape = " ".join(f"{x:.2f},{y:.3f}" for x, y in zip(ramp_x, ramp_y, strict=True))
    nodes = [f'<node id="{name}" x="{x}" y="0" type="priority"/>' for name, x in NODES_M.items()]
    nodes += [f'<node id="ramp" x="{ramp_x[0]}" y="{ramp_y[0]:.3f}"/>']

    common = f'speed="{SPEED_LIMIT}" width="{LANE_M}" spreadType="right"'
    slow = f'<lane index="0" speed="{level.ramp_limit}"/>'  # SUMO counts lanes from the right
    edges = [f'<edge id="on_ramp" from="ramp" to="gore" numLanes="1" {common} shape="{shape}">{slow}</edge>']
    for name, (start, end) in zip(MAIN, pairwise(NODES_M), strict=True):
        lanes, limits = (LANES + 1, slow) if name == "acceleration" else (LANES, "")
        limits += f'<lane index="{lanes - 1}" allow="hov motorcycle" speed="{level.hov_limit}"/>'
        limits += "".join(f'<lane index="{lanes - lane}" disallow="truck"/>' for lane in (2, 3))
        edges.append(f'<edge id="{name}" from="{start}" to="{end}" numLanes="{lanes}" {common}>{limits}</edge>')

    links = [("on_ramp", 0, "acceleration", 0)]
    for start, end in pairwise(MAIN):
        links += [(start, k + (start == "acceleration"), end, k + (end == "acceleration")) for k in range(LANES)]
    links = [f'<connection from="{a}" fromLane="{i}" to="{b}" toLane="{j}"/>' for a, i, b, j in links]

    for root, rows in (("nodes", nodes), ("edges", edges), ("connections", links)):
        write_xml(folder / f"{root}.xml", root, rows)
    options = """--node-files=nodes.xml --edge-files=edges.xml --connection-files=connections.xml --output-file=net.xml
        --offset.disable-normalization --no-turnarounds --xml-validation=never"""
    run_tool("netconvert", folder, options)


def write_routes(folder: Path, vehicles: pd.DataFrame) -> None:
    """One type per vehicle. Car following is the intelligent driver model with a and b of Treiber et al. (2000), which
    lets waves grow; lateral speed is bounded by the vehicle's own, so that nobody moves crabwise."""
    rest = "acceleration section bottleneck run_out"
    rows = [f'<route id="main" edges="run_in {rest}"/>', f'<route id="ramp" edges="on_ramp {rest}"/>']
    for v in vehicles.itertuples():
        ramp = v.lane > LANES
        sumo_class = "hov" if v.kind == CAR and v.lane == 1 else SUMO_CLASS[v.kind]
        accel, sideways = (0.44, 0.1) if v.kind == TRUCK else (0.73, 0.2)
        rows.append(
            f'<vType id="t{v.Index}" vClass="{sumo_class}" length="{v.length_m:.4f}" width="{v.width_m:.4f}" '
            f'minGap="2.5" carFollowModel="IDM" accel="{accel}" decel="1.67" '
            f'tau="{v.headway_s:.3f}" speedFactor="{v.speed_factor:.3f}" speedDev="0" lcKeepRight="0" '
            f'lcSpeedGain="0.3" lcCooperative="{int(v.yields)}" lcAssertive="{4 if ramp else 2}" '
            f'lcMaxSpeedLatStanding="{sideways}" lcMaxSpeedLatFactor="{sideways}"/>'
            f'<vehicle id="{v.Index}" type="t{v.Index}" route="{"ramp" if ramp else "main"}" depart="{v.depart_s:.1f}" '
            f'departLane="{0 if ramp else LANES - v.lane}" departSpeed="avg"/>'
        )
    write_xml(folder / "routes.xml", "routes", rows)


def write_signs(folder: Path, rng: np.random.Generator, level: Level, end_s: float) -> None:
    """Speed limits that swing by factors of e^-0.5 to e^0.5 about every 75 s, nearly in step over the lanes."""
    times = np.arange(0.0, end_s, 4.0)
    phase = np.cumsum(2 * math.pi * 4.0 / 75.0 * rng.uniform(0.4, 1.6, times.size))
    rows = []
    for lane, mean in enumerate(level.sign_limits, start=1):
        limits = mean * np.exp(0.5 * np.sin(phase + rng.uniform(-0.5, 0.5)))
        steps = "".join(f'<step time="{t:.0f}" speed="{v:.2f}"/>' for t, v in zip(times, limits, strict=True))
        rows.append(f'<variableSpeedSign id="sign{lane}" lanes="bottleneck_{LANES - lane}">{steps}</variableSpeedSign>')
    write_xml(folder / "signs.xml", "additional", rows)


def simulate(folder: Path, seed: int, begin_s: float, end_s: float, period_s: float) -> None:
    """Run SUMO on the folder's files; ``fcd.xml`` records every vehicle each `period_s` from `begin_s` on."""
    options = f"""--net-file=net.xml --route-files=routes.xml --additional-files=signs.xml --xml-validation=never
        --seed={seed} --step-length={STEP_S} --end={end_s:.1f} --max-depart-delay=60 --lanechange.duration=4
        --time-to-teleport=-1 --collision.action=warn --step-log.period=100
        --fcd-output=fcd.xml --fcd-output.attributes=x,y,speed,acceleration --fcd-output.acceleration --precision=3
        --device.fcd.begin={begin_s:.1f} --device.fcd.period={period_s:.1f}"""
    run_tool("sumo", folder, options, end_s)


def run_tool(name: str, folder: Path, options: str, end_s: float = 0.0) -> None:
    """Run a SUMO program in `folder`, with its progress towards `end_s`, and raise with its own reason if it fails."""
    command = [find_tool(name), *options.split()]
    with (folder / f"{name}.log").open("w+", encoding="utf-8") as log:
        with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=log, text=True) as process:
            for line in process.stdout:  # SUMO's progress lines end in a carriage return, a line's end in text mode
                if step := re.match(r"Step #(\d+)", line):
                    print(f"\rsimulated {step[1]} of {end_s:.0f} s", end="", file=sys.stderr, flush=True)
        if end_s:
            print(file=sys.stderr)
        if process.returncode:
            log.seek(0)
            reasons = [line.strip() for line in log if line.strip() and not line.startswith("Quitting")]
            raise SumoError(f"{name} failed: {reasons[-1] if reasons else 'it gave no reason'}")


def read_fcd(path: Path, frames: dict[int, int]) -> np.ndarray:
    """Rows (frame, vehicle, x, y, speed, acceleration) of the fronts inside the section, in SUMO's frame [m, s].

    `frames` maps the simulation step to the frame it becomes; other steps are skipped.
    """
    rows = []
    for _, element in ET.iterparse(path):
        if element.tag != "timestep":
            continue
        frame = frames.get(round(float(element.get("time")) / STEP_S))
        for vehicle in element if frame is not None else ():
            state = [float(vehicle.get(key)) for key in ("x", "y", "speed", "acceleration")]
            if 0 <= state[0] <= SECTION_M:
                rows.append((frame, int(vehicle.get("id")), *state))
        element.clear()
    if not rows:
        raise SumoError("sumo recorded no vehicle in the section")
    return np.array(rows)


def lane_of(local_x: np.ndarray, local_y: np.ndarray) -> np.ndarray:
    """NGSIM lane of front centres [ft]: 1 is leftmost, 7 the ramp and its acceleration lane."""
    last = np.where(local_y * FOOT_M < MERGE_END_M, LANES + 1, LANES)
    return np.clip(np.floor(local_x * FOOT_M / LANE_M).astype(int) + 1, 1, last)


def add_neighbours(table: pd.DataFrame) -> pd.DataFrame:
    """Fill in Preceding, Following (0: none), Space_Headway [ft] and Time_Headway [s; 9999.99: stopped], as NGSIM."""
    table = table.sort_values(["Frame_ID", "Lane_ID", "Local_Y"], kind="stable")
    lane = table.groupby(["Frame_ID", "Lane_ID"], sort=False)
    gap = (lane["Local_Y"].shift(-1) - table["Local_Y"]).fillna(0.0)
    moving = table["v_Vel"] > 0
    time = (gap / table["v_Vel"].where(moving, 1.0)).where(moving | (gap == 0), 9999.99)
    return table.assign(
        Preceding=lane["Vehicle_ID"].shift(-1, fill_value=0),
        Following=lane["Vehicle_ID"].shift(1, fill_value=0),
        Space_Headway=gap.round(2),
        Time_Headway=time.clip(upper=9999.99).round(2),
    )


def to_ngsim(rows: np.ndarray, vehicles: pd.DataFrame, whole: np.ndarray | None = None) -> pd.DataFrame:
    """The rows of `read_fcd` as an NGSIM table, by frame and vehicle, whose ids ascend by entry into the section.

    With `whole`, the rows of another table of the same simulation, vehicles have the ids that they have in that.
    """
    rows, whole = (of[np.lexsort((-of[:, 2], of[:, 0]))] for of in (rows, rows if whole is None else whole))
    frame, number, x_m, y_m, speed, acceleration = rows.T
    order = pd.unique(np.concatenate([whole[:, 1], number]))
    driver = vehicles.loc[number].reset_index(drop=True)
    y_m = y_m + driver.offset_m + WEAVE_M * np.sin(2 * math.pi * x_m / driver.weave_length_m + driver.weave_phase)
    local_x, local_y = -y_m / FOOT_M, pd.Series(x_m / FOOT_M)
    table = pd.DataFrame(
        {
            "Vehicle_ID": pd.Index(order).get_indexer(number) + 1,
            "Frame_ID": frame.astype(int),
            "Total_Frames": pd.Series(number).groupby(number).transform("size"),
            "Global_Time": GLOBAL_TIME_MS + 100 * frame.astype(int),
            "Local_X": local_x.round(2),
            "Local_Y": local_y.round(2),
            "Global_X": (GLOBAL_ORIGIN_FT[0] + local_x * math.cos(BEARING) + local_y * math.sin(BEARING)).round(2),
            "Global_Y": (GLOBAL_ORIGIN_FT[1] - local_x * math.sin(BEARING) + local_y * math.cos(BEARING)).round(2),
            "v_Length": (driver.length_m / FOOT_M).round(1),
            "v_Width": (driver.width_m / FOOT_M).round(1),
            "v_Class": driver.kind,
            "v_Vel": (speed / FOOT_M).round(2),
            "v_Acc": (acceleration / FOOT_M).round(2),
            "Lane_ID": lane_of(local_x, local_y),
            **dict.fromkeys(("Preceding", "Following", "Space_Headway", "Time_Headway"), 0),
            "Location": LOCATION,
        }
    )
    return add_neighbours(table).sort_values(["Frame_ID", "Vehicle_ID"], kind="stable")


def write_csv(table: pd.DataFrame, path: Path) -> None:
    """Write the table whole or not at all; gzip carries no name or time, so that equal tables give equal files."""
    data = table.to_csv(index=False, lineterminator="\n").encode()
    if path.suffix == ".gz":
        packed = io.BytesIO()
        with gzip.GzipFile(filename="", fileobj=packed, mode="wb", mtime=0) as file:
            file.write(data)
        data = packed.getvalue()
    write_bytes(path, data)


def whole_steps(value_s: float, option: str) -> int:
    steps = round(value_s / STEP_S) if math.isfinite(value_s) else -1
    if steps < 0 or abs(steps * STEP_S - value_s) > 1e-6:
        raise InputError(f"{option} {value_s:g}: allowed are multiples of {STEP_S} s, from 0 on")
    return steps


def make_traffic(
    level: Level,
    seed: int,
    minutes: float,
    every_s: float,
    neighbour_s: float,
    dense_s: tuple[float, float] | None = None,
) -> pd.DataFrame:
    """NGSIM table of an instant every `every_s` and, `neighbour_s` before and after it, its two neighbours.

    With `dense_s` it is of the instants between those two times alone, one every `neighbour_s`, of the same simulation;
    vehicles have the same ids.
    """
    every, neighbour = whole_steps(every_s, "--every-s"), whole_steps(neighbour_s, "--neighbour-s")
    length = whole_steps(minutes * 60, "--minutes, in seconds,")
    if not 2 * neighbour < every <= length:
        raise InputError(f"--every-s {every_s:g}: allowed is more than twice --neighbour-s, and up to --minutes")
    if not 0 <= seed < 2**31:
        raise InputError(f"--seed {seed}: allowed is 0 to {2**31 - 1}")
    warm_up = round(level.warm_up_s / STEP_S)
    end_s = (warm_up + length + neighbour) * STEP_S + 1.0
    shifts = (-neighbour, 0, neighbour)
    frames = {warm_up + k + shift: k + shift for k in range(every, length + 1, every) for shift in shifts}
    dense = {}
    if dense_s is not None:
        first, last = (whole_steps(value, "--dense-s") for value in dense_s)
        if not 0 < neighbour <= last - first <= last <= length:
            raise InputError(
                f"--dense-s {dense_s[0]:g} {dense_s[1]:g}: allowed are two times up to --minutes, the first first"
            )
        dense = {warm_up + k: k for k in range(first, last + 1, neighbour)}
    rng = np.random.default_rng(seed)
    vehicles = draw_vehicles(rng, level, end_s)
    with tempfile.TemporaryDirectory(prefix="make_traffic_") as name:
        folder = Path(name)
        write_network(folder, level)
        write_routes(folder, vehicles)
        write_signs(folder, rng, level, end_s)
        simulate(folder, seed, level.warm_up_s, end_s, math.gcd(every, neighbour) * STEP_S)
        rows = read_fcd(folder / "fcd.xml", frames)
        return to_ngsim(read_fcd(folder / "fcd.xml", dense), vehicles, rows) if dense else to_ngsim(rows, vehicles)


def main(argv: list[str] | None = None) -> int:
    return run_script("make_traffic", lambda: _make(_arguments(argv)))


def _arguments(argv):
    parser = parser_of(__doc__)
    parser.add_argument("--out", type=Path, default=SCENES / "i80_sample.csv.gz", help="CSV; .gz compresses it")
    parser.add_argument("--seed", type=int, default=42)
    parser.add_argument("--minutes", type=float, default=15.0, help="recorded, after the warm-up")
    parser.add_argument("--every-s", type=float, default=10.0, help="time between instants")
    parser.add_argument("--neighbour-s", type=float, default=0.5, help="time to an instant's neighbours, for headings")
    parser.add_argument("--dense-s", type=float, nargs=2, help="only the instants between these times, all of them")
    parser.add_argument("--level", choices=LEVELS, default="jammed", help="jammed is like I-80 0400-0415")
    return parser.parse_args(argv)


def _make(args) -> None:
    check_place(args.out, "--out")
    table = make_traffic(LEVELS[args.level], args.seed, args.minutes, args.every_s, args.neighbour_s, args.dense_s)
    write_csv(table, args.out)
    count, speed = table.groupby("Frame_ID").size(), table["v_Vel"].mean() * FOOT_M
    per_frame = f"{count.mean():.0f} vehicles a frame ({count.min()} to {count.max()})"
    size_mb = args.out.stat().st_size / 1e6
    print(f"{args.out}: {count.size} frames, {per_frame}, {speed:.1f} m/s, {size_mb:.2f} MB", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
