"""Generate dense stop-and-go traffic that looks like NGSIM I-80 0400-0415, with SUMO: the shipped default traffic.

The output has the layout of the NGSIM portal's CSV (feet, front centres, lane 1 leftmost) and says in every row, by
``Location = synthetic-i80``, that no vehicle in it was ever observed. NGSIM data themselves are never copied.

    pip install "blender_lidar[sumo]"
    python scripts/make_traffic.py --out scenes/i80_sample.csv.gz

Same seed and same version of SUMO, same file (the shipped one: seed 42, SUMO 1.28.0). Global_X/Y are the local frame
turned by the road's bearing at the entry; the road is straight, where the real one bends by 2 degrees.
"""

from __future__ import annotations

import argparse
import gzip
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from blender_lidar.errors import BlenderLidarError, InputError, MissingExtraError, OutputError

FOOT_M = 0.3048
LANES, LANE_M = 6, 12 * FOOT_M
SECTION_M = 1650 * FOOT_M
GORE_M, MERGE_END_M = 117.8, 202.3  # the Powell Street on-ramp's gore and the end of its acceleration lane
NODES_M = {"start": -1000.0, "gore": GORE_M, "merge": MERGE_END_M, "signs": 650.0, "out": 900.0, "end": 1200.0}
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
SHARE = {MOTORCYCLE: 0.015, CAR: 0.945, TRUCK: 0.04}
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
YIELDING = 0.35  # share of drivers that brake to let others in; when all do, the ramp starves lane 6
# SUMO's vehicles follow the lane's centre. Ours keep off it, and weave by the distance driven (never while standing).
OFFSET_M, WEAVE_M, WEAVE_LENGTH_M, LANE_MARGIN_M = 0.3, 0.15, (60.0, 130.0), 0.1


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
    "jammed": Level(7700, 450, 16.5, 9.0, (30.0, 14.0, 14.0, 12.5, 10.0, 4.5), warm_up_s=900),
    "free": Level(3000, 150, SPEED_LIMIT, 20.0, (), warm_up_s=120),
}


@dataclass(frozen=True, slots=True)
class Vehicle:
    """A driver and vehicle that wants to enter on `lane` (7: the ramp)."""

    depart_s: float
    lane: int
    kind: int
    length_m: float
    width_m: float
    headway_s: float
    speed_factor: float
    yields: bool
    offset_m: float
    weave_length_m: float
    weave_phase: float


class SumoError(Exception):
    """SUMO itself failed."""


def find_tool(name: str) -> str:
    """A SUMO program's path: in the eclipse-sumo package, else in ``SUMO_HOME``, else on the path."""
    homes = [os.environ.get("SUMO_HOME")]
    try:
        import sumo

        homes.insert(0, getattr(sumo, "SUMO_HOME", None))
    except ImportError:
        pass
    folders = [str(Path(home) / "bin") for home in homes if home]
    found = shutil.which(name, path=os.pathsep.join([*folders, os.environ.get("PATH", "")]))
    if not found:
        raise MissingExtraError(f'SUMO ({name}) is not installed: pip install "blender_lidar[sumo]"')
    return found


def draw_vehicles(rng: np.random.Generator, level: Level, end_s: float) -> list[Vehicle]:
    """The vehicles that want to enter until `end_s`, by departure."""
    n_main, n_ramp = (round(flow * end_s / 3600) for flow in (level.main_per_h, level.ramp_per_h))
    entries = [(t, int(rng.choice(LANES, p=DEMAND_SHARE)) + 1) for t in rng.uniform(0, end_s, n_main)]
    entries += [((k + 0.6 * rng.random()) * end_s / n_ramp, LANES + 1) for k in range(n_ramp)]  # metered: evenly
    return [draw_vehicle(rng, depart_s, lane) for depart_s, lane in sorted(entries)]


def draw_vehicle(rng: np.random.Generator, depart_s: float, lane: int) -> Vehicle:
    kind = int(rng.choice(list(SHARE), p=list(SHARE.values())))
    if kind == TRUCK and lane <= 3:  # closed to trucks
        lane = int(rng.integers(4, LANES + 1))
    # Rounded as NGSIM does before SUMO sees them, so that its gaps are the file's.
    sizes = (np.interp(rng.random(), QUANTILES, table[kind]) for table in (LENGTH_M, WIDTH_M))
    length_m, width_m = (round(float(size) / FOOT_M, 1) * FOOT_M for size in sizes)
    headway_s = HEADWAY_S[min(lane, LANES) - 1] * (1.2 if kind == TRUCK else 1.0) * (1 + 0.15 * rng.standard_normal())
    room_m = (LANE_M - width_m) / 2 - LANE_MARGIN_M - WEAVE_M
    return Vehicle(
        depart_s=depart_s,
        lane=lane,
        kind=kind,
        length_m=length_m,
        width_m=width_m,
        headway_s=max(0.8, headway_s),
        speed_factor=float(np.clip(1 + 0.1 * rng.standard_normal(), 0.8, 1.2)),
        yields=bool(lane > LANES or rng.random() < YIELDING),
        offset_m=float(np.clip(OFFSET_M * rng.standard_normal(), -room_m, room_m)),
        weave_length_m=float(rng.uniform(*WEAVE_LENGTH_M)),
        weave_phase=float(rng.uniform(0, 2 * math.pi)),
    )


def write_xml(path: Path, root: str, rows: list[str]) -> None:
    path.write_text(f"<{root}>\n" + "\n".join(rows) + f"\n</{root}>\n", encoding="utf-8")


def write_network(folder: Path, level: Level) -> None:
    """Build the road: straight, so that no edge joint bends a path, with the carriageway's left edge on y = 0."""
    ramp_x = np.array([-300.0, -200.0, -100.0, -50.0, 0.0, 40.0, 80.0, GORE_M])
    ramp_y = -LANES * LANE_M - RAMP_SPREAD * (GORE_M - ramp_x) ** 2
    ramp_shape = " ".join(f"{x:.2f},{y:.3f}" for x, y in zip(ramp_x, ramp_y, strict=True))
    slow = f'<lane index="0" speed="{level.ramp_limit}"/>'

    def reserved(lanes: int) -> str:  # SUMO's lane 0 is the rightmost
        hov = f'<lane index="{lanes - 1}" allow="hov motorcycle" speed="{level.hov_limit}"/>'
        return hov + "".join(f'<lane index="{lanes - k}" disallow="truck"/>' for k in (2, 3))

    edges = [("on_ramp", "ramp", "gore", 1, slow, f'shape="{ramp_shape}"')]
    edges += [("acceleration", "gore", "merge", LANES + 1, slow + reserved(LANES + 1), "")]
    ends = {"run_in": "start gore", "section": "merge signs", "bottleneck": "signs out", "run_out": "out end"}
    edges += [(name, *pair.split(), LANES, reserved(LANES), "") for name, pair in ends.items()]
    links = [("on_ramp", 0, "acceleration", 0)]
    for k in range(LANES):
        links += [("run_in", k, "acceleration", k + 1), ("acceleration", k + 1, "section", k)]
        links += [("section", k, "bottleneck", k), ("bottleneck", k, "run_out", k)]

    nodes = [f'<node id="{name}" x="{x}" y="0" type="priority"/>' for name, x in NODES_M.items()]
    nodes += [f'<node id="ramp" x="{ramp_x[0]}" y="{ramp_y[0]:.3f}"/>']
    common = f'speed="{SPEED_LIMIT}" width="{LANE_M}" spreadType="right"'
    edges = [
        f'<edge id="{name}" from="{start}" to="{end}" numLanes="{lanes}" {common} {shape}>{inner}</edge>'
        for name, start, end, lanes, inner, shape in edges
    ]
    links = [f'<connection from="{a}" fromLane="{i}" to="{b}" toLane="{j}"/>' for a, i, b, j in links]
    for root, rows in (("nodes", nodes), ("edges", edges), ("connections", links)):
        write_xml(folder / f"{root}.xml", root, rows)
    inputs = ["--node-files=nodes.xml", "--edge-files=edges.xml", "--connection-files=connections.xml"]
    options = ["--output-file=net.xml", "--offset.disable-normalization", "--no-turnarounds", "--xml-validation=never"]
    command = [find_tool("netconvert"), *inputs, *options]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SumoError(f"netconvert failed: {last_line(done.stderr)}")


def write_routes(folder: Path, vehicles: list[Vehicle]) -> None:
    """One type per vehicle. Car following is the intelligent driver model with a and b of Treiber et al. (2000), which
    lets waves grow; lateral speed is bounded by the vehicle's own, so that nobody moves crabwise."""
    rest = "acceleration section bottleneck run_out"
    rows = [f'<route id="main" edges="run_in {rest}"/>', f'<route id="ramp" edges="on_ramp {rest}"/>']
    for number, v in enumerate(vehicles):
        ramp = v.lane > LANES
        sumo_class = "hov" if v.kind == CAR and v.lane == 1 else SUMO_CLASS[v.kind]
        rows.append(
            f'<vType id="t{number}" vClass="{sumo_class}" length="{v.length_m:.4f}" width="{v.width_m:.4f}" '
            f'minGap="2.5" carFollowModel="IDM" accel="{0.44 if v.kind == TRUCK else 0.73}" decel="1.67" '
            f'tau="{v.headway_s:.3f}" speedFactor="{v.speed_factor:.3f}" speedDev="0" lcKeepRight="0" '
            f'lcSpeedGain="0.3" lcCooperative="{int(v.yields)}" lcAssertive="{4 if ramp else 2}" '
            'lcMaxSpeedLatStanding="0.4" lcMaxSpeedLatFactor="0.2"/>'
            f'<vehicle id="{number}" type="t{number}" route="{"ramp" if ramp else "main"}" depart="{v.depart_s:.1f}" '
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
    command = [find_tool("sumo"), *options.split()]
    with (folder / "sumo.log").open("w+", encoding="utf-8") as log:
        with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=log, text=True) as process:
            for line in process.stdout:  # SUMO's progress lines end in a carriage return, a line's end in text mode
                if step := re.match(r"Step #(\d+)", line):
                    print(f"\rsimulated {step[1]} of {end_s:.0f} s", end="", file=sys.stderr, flush=True)
        print(file=sys.stderr)
        log.seek(0)
        if process.returncode:
            raise SumoError(f"sumo failed: {last_line(log.read())}")


def last_line(text: str) -> str:
    """The last line that gives a reason; SUMO closes with "Quitting (on error)."."""
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith("Quitting")]
    return lines[-1] if lines else "no reason given"


def read_fcd(path: Path, frames: dict[int, int]) -> np.ndarray:
    """Rows (frame, vehicle, x, y, speed, acceleration) of the fronts inside the section, SUMO's frame [m, s].

    `frames` maps the simulation step to the frame it becomes; other steps are skipped.
    """
    rows, frame = [], None
    for event, element in ET.iterparse(path, events=("start", "end")):
        if element.tag == "timestep" and event == "start":
            frame = frames.get(round(float(element.get("time")) / STEP_S))
        elif element.tag == "timestep":
            element.clear()
        elif element.tag == "vehicle" and event == "end" and frame is not None:
            state = [float(element.get(key)) for key in ("x", "y", "speed", "acceleration")]
            if 0 <= state[0] <= SECTION_M:
                rows.append((frame, int(element.get("id")), *state))
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


def to_ngsim(rows: np.ndarray, vehicles: list[Vehicle]) -> pd.DataFrame:
    """The rows of `read_fcd` as an NGSIM table, by frame and vehicle, whose ids ascend by entry into the section."""
    rows = rows[np.lexsort((-rows[:, 2], rows[:, 0]))]
    frame, number, x_m, y_m, speed, acceleration = rows.T
    drivers = [vehicles[int(k)] for k in number]
    habit = np.array([(v.offset_m, v.weave_length_m, v.weave_phase, v.length_m, v.width_m, v.kind) for v in drivers])
    offset_m, weave_length_m, weave_phase, length_m, width_m, kind = habit.T
    y_m = y_m + offset_m + WEAVE_M * np.sin(2 * math.pi * x_m / weave_length_m + weave_phase)
    local_x, local_y = -y_m / FOOT_M, x_m / FOOT_M
    table = pd.DataFrame(
        {
            "Vehicle_ID": pd.factorize(number)[0] + 1,
            "Frame_ID": frame.astype(int),
            "Total_Frames": pd.Series(number).groupby(number).transform("size"),
            "Global_Time": GLOBAL_TIME_MS + 100 * frame.astype(int),
            "Local_X": local_x.round(2),
            "Local_Y": local_y.round(2),
            "Global_X": (GLOBAL_ORIGIN_FT[0] + local_x * math.cos(BEARING) + local_y * math.sin(BEARING)).round(2),
            "Global_Y": (GLOBAL_ORIGIN_FT[1] - local_x * math.sin(BEARING) + local_y * math.cos(BEARING)).round(2),
            "v_Length": (length_m / FOOT_M).round(1),
            "v_Width": (width_m / FOOT_M).round(1),
            "v_Class": kind.astype(int),
            "v_Vel": (speed / FOOT_M).round(2),
            "v_Acc": (acceleration / FOOT_M).round(2),
            "Lane_ID": lane_of(local_x, local_y),
            **dict.fromkeys(("Preceding", "Following", "Space_Headway", "Time_Headway"), 0),
            "Location": LOCATION,
        }
    )
    return add_neighbours(table).sort_values(["Frame_ID", "Vehicle_ID"], kind="stable")


def write_csv(table: pd.DataFrame, path: Path) -> None:
    """Write the table whole or not at all; gzip carries no time stamp, so that equal tables give equal files."""
    data = table.to_csv(index=False, lineterminator="\n").encode()
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_bytes(gzip.compress(data, mtime=0) if path.suffix == ".gz" else data)
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise OutputError(f"{path}: cannot be written ({error.strerror})") from error


def whole_steps(value_s: float, option: str) -> int:
    steps = round(value_s / STEP_S) if math.isfinite(value_s) else -1
    if steps < 0 or abs(steps * STEP_S - value_s) > 1e-6:
        raise InputError(f"{option} {value_s:g}: allowed are multiples of {STEP_S} s, from 0 on")
    return steps


def make_traffic(level: Level, seed: int, minutes: float, every_s: float, neighbour_s: float) -> pd.DataFrame:
    """NGSIM table of an instant every `every_s` and, `neighbour_s` before and after it, its two neighbours."""
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
    rng = np.random.default_rng(seed)
    vehicles = draw_vehicles(rng, level, end_s)
    with tempfile.TemporaryDirectory(prefix="make_traffic_") as name:
        folder = Path(name)
        write_network(folder, level)
        write_routes(folder, vehicles)
        write_signs(folder, rng, level, end_s)
        simulate(folder, seed, level.warm_up_s, end_s, math.gcd(every, neighbour) * STEP_S)
        return to_ngsim(read_fcd(folder / "fcd.xml", frames), vehicles)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("scenes/i80_sample.csv.gz"), help="CSV; .gz compresses it")
    parser.add_argument("--seed", type=int, default=42)
    parser.add_argument("--minutes", type=float, default=15.0, help="recorded, after the warm-up")
    parser.add_argument("--every-s", type=float, default=10.0, help="time between instants")
    parser.add_argument("--neighbour-s", type=float, default=0.5, help="time to an instant's neighbours, for headings")
    parser.add_argument("--level", choices=LEVELS, default="jammed", help="jammed is like I-80 0400-0415")
    args = parser.parse_args(argv)
    try:
        if args.out.is_dir() or not args.out.resolve().parent.is_dir():
            raise OutputError(f"--out {args.out}: allowed is a file in a folder that exists")
        table = make_traffic(LEVELS[args.level], args.seed, args.minutes, args.every_s, args.neighbour_s)
        write_csv(table, args.out)
    except (BlenderLidarError, SumoError) as error:
        print(f"make_traffic: {error}", file=sys.stderr)
        return 2 if isinstance(error, BlenderLidarError) else 1
    count, speed = table.groupby("Frame_ID").size(), table["v_Vel"].mean() * FOOT_M
    summary = (
        f"{count.size} frames, {count.mean():.0f} vehicles a frame ({count.min()} to {count.max()}), {speed:.1f} m/s"
    )
    print(f"{args.out}: {summary}, {args.out.stat().st_size / 1e6:.2f} MB", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
