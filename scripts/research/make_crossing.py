"""Generate traffic at a signalised crossing with SUMO: recordings by which intervals are judged, and the shipped one.

The recordings: four arms of two lanes, a fixed cycle, Poisson arrivals; the approach from the west is where a LiDAR
would hang. Each seed is fresh traffic of the same kind. Floating car data of every vehicle within 150 m of the middle,
each second. Nobody turns.

    pip install "blender_lidar[sumo]"
    python scripts/research/make_crossing.py --out cache --recordings 60 --cycle 90

The shipped intersection has two lanes and one for turning left on each approach, islands, bicycle lanes, sidewalks,
crossings; 1,800 vehicles an hour of which 15 % turn left and 15 % right, bicycles and persons; a fixed cycle of 90 s.
Its files are the net, half an hour of floating car data within 120 m of the middle each half second, the types of the
vehicles with their sizes, and places for poles. No vehicle in it was ever observed. Same version of SUMO, same files
(the shipped ones: SUMO 1.28.0).

    python scripts/research/make_crossing.py --sample scenes

With another --seed it is fresh traffic at the same intersection, such as detectors are trained on.
"""

from __future__ import annotations

import gzip
import sys
import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from arguments import counting, parser_of, positive, run_script
from blender_lidar.errors import InputError
from blender_lidar.files import make_folder, to_csv, write_bytes, write_text
from make_traffic import run_tool, write_xml

ARM_M = 400.0
LANES, LANE_M = 2, 3.5
SPEED_LIMIT = 13.9
YELLOW_S = 4
WARM_UP_S, MINUTES = 300, 10.0
VEHICLES_PER_H = {"west": 1400, "east": 1100, "north": 800, "south": 800}  # the west fills 85 % of its green
ARMS = {"west": (-ARM_M, 0.0), "east": (ARM_M, 0.0), "north": (0.0, ARM_M), "south": (0.0, -ARM_M)}
ACROSS = {
    "west": "east",
    "east": "west",
    "north": "south",
    "south": "north",
}  # nobody turns, or is in the way
TYPES = {"car": ("passenger", 4.5, 1.8, 1.5, 0.85), "van": ("delivery", 5.6, 2.0, 2.1, 0.1)}
TYPES |= {"lorry": ("truck", 10.0, 2.5, 3.6, 0.05)}
VEHICLE_TYPES = "types.add.xml"


def write_network(folder: Path, cycle_s: int) -> None:
    """The net of a crossing: the roads from west and east are green together, then those from north and south."""
    nodes = [f'<node id="{name}" x="{x}" y="{y}" type="priority"/>' for name, (x, y) in ARMS.items()]
    nodes.append('<node id="middle" x="0" y="0" type="traffic_light"/>')
    common = f'numLanes="{LANES}" width="{LANE_M}" speed="{SPEED_LIMIT}"'
    edges, links = [], []
    for name, opposite in ACROSS.items():
        edges.append(f'<edge id="from_{name}" from="{name}" to="middle" {common}/>')
        edges.append(f'<edge id="to_{name}" from="middle" to="{name}" {common}/>')
        for lane in range(LANES):
            ends = f'from="from_{name}" to="to_{opposite}" fromLane="{lane}" toLane="{lane}"'
            links.append(f"<connection {ends}/>")
    for root, content in {"nodes": nodes, "edges": edges, "connections": links}.items():
        write_xml(folder / f"{root}.xml", root, content)
    options = f"""--node-files=nodes.xml --edge-files=edges.xml --connection-files=connections.xml
        --tls.cycle.time={cycle_s} --tls.yellow.time={YELLOW_S} --output-file=net.xml
        --offset.disable-normalization --no-turnarounds --xml-validation=never"""
    run_tool("netconvert", folder, options)


def type_rows() -> list[str]:
    """SUMO's vehicle types with their sizes [m]."""
    return [
        f'<vType id="{name}" vClass="{kind}" length="{length}" width="{width}" height="{height}"/>'
        for name, (kind, length, width, height, _) in TYPES.items()
    ]


def write_routes(folder: Path, rng: np.random.Generator, end_s: float) -> None:
    """Vehicles that arrive independently of one another on each arm."""
    rows = []
    for name, flow in VEHICLES_PER_H.items():
        count = rng.poisson(flow * end_s / 3600.0)
        depart_s = rng.uniform(0.0, end_s, count)
        kind = rng.choice(list(TYPES), count, p=[row[-1] for row in TYPES.values()])
        rows += [(one, name, ACROSS[name], of) for one, of in zip(depart_s, kind, strict=True)]
    vehicles = [
        f'<vehicle id="{number}" type="{kind}" depart="{depart_s:.1f}" departLane="best" departSpeed="max">'
        f'<route edges="from_{start} to_{end}"/></vehicle>'
        for number, (depart_s, start, end, kind) in enumerate(sorted(rows))
    ]
    write_xml(folder / "routes.xml", "routes", [*type_rows(), *vehicles])


def make_recording(seed: int, cycle_s: int, minutes: float, path: Path) -> None:
    """Simulate fresh traffic of a seed and write its floating car data."""
    end_s = WARM_UP_S + seed % cycle_s + 60.0 * minutes  # it begins anywhere in the cycle
    with tempfile.TemporaryDirectory(prefix="make_crossing_") as name:
        folder = Path(name)
        write_network(folder, cycle_s)
        write_routes(folder, np.random.default_rng(seed), end_s)
        shape = " ".join(f"{x},{y}" for x, y in ((-150, -150), (150, -150), (150, 150), (-150, 150)))
        write_xml(folder / "near.xml", "additional", [f'<poly id="near" shape="{shape}"/>'])
        options = f"""--net-file=net.xml --route-files=routes.xml --additional-files=near.xml --xml-validation=never
            --seed={seed} --step-length=0.5 --end={end_s:.1f} --fcd-output=fcd.xml.gz --fcd-output.filter-shapes=near
            --fcd-output.attributes=x,y,angle,type,speed,pos,lane,slope --device.fcd.period=1
            --device.fcd.begin={end_s - 60.0 * minutes:.1f} --time-to-teleport=-1 --step-log.period=1000"""
        run_tool("sumo", folder, options)
        write_bytes(path, (folder / "fcd.xml.gz").read_bytes())


def cached_recordings(folder: Path, recordings: int, cycle_s: int, minutes: float = MINUTES) -> list[Path]:
    """Paths of so many recordings, those that are not there yet made first; seeds from 1."""
    folder.mkdir(parents=True, exist_ok=True)
    write_xml(folder / VEHICLE_TYPES, "additional", type_rows())
    paths = [folder / f"crossing_{cycle_s}s_{minutes:g}min_{seed}.fcd.xml.gz" for seed in range(1, recordings + 1)]
    missing = [(seed, path) for seed, path in enumerate(paths, start=1) if not path.exists()]
    with counting(len(missing), "recordings") as advance:
        for seed, path in missing:
            make_recording(seed, cycle_s, minutes, path)
            advance(1)
    return paths


# --- The shipped intersection: all turns, bicycles and persons --------------------------------------------

SAMPLE_SEED, SAMPLE_CYCLE_S = 42, 90
SAMPLE_M, SAMPLE_MINUTES, SAMPLE_STEP_S = 120.0, 30.0, 0.5  # ten minutes hold two blocks to judge by, too few
SAMPLE_FILES = ("crossing.net.xml.gz", "crossing_sample.xml.gz", "crossing_types.xml", "crossing_poles.csv")
MADE_BY = "<!-- synthetic: scripts/research/make_crossing.py made it with SUMO; no vehicle in it was ever observed -->"
DIRECTIONS = {"north": (0.0, 1.0), "east": (1.0, 0.0), "south": (0.0, -1.0), "west": (-1.0, 0.0)}  # clockwise
END_M, WIDENS_M = 320.0, 90.0  # ends of the arms, and of the lanes for turning left, from the middle
VEHICLE_LANE_M, BICYCLE_LANE_M, SIDEWALK_M, CROSSING_M = 3.25, 1.5, 2.5, 4.0
THROUGH_M = 4.0  # from an arm's axis to its lanes that go ahead; within it lie the island and the lane to the left
CORNER_RADIUS_M = 9.0
SAMPLE_PER_H = {"north": 350, "east": 550, "south": 350, "west": 550}
BICYCLES_PER_H, PERSONS_PER_H = 160, 300
TURNS = {"right": 0.15, "ahead": 0.70, "left": 0.15}
# Class, length, width, height [m] and share among the vehicles; long ones go ahead.
SAMPLE_TYPES = {
    "car_small": ("passenger", 3.9, 1.7, 1.5, 0.22),
    "car": ("passenger", 4.5, 1.82, 1.48, 0.36),
    "car_suv": ("passenger", 4.7, 1.9, 1.68, 0.20),
    "van": ("delivery", 5.8, 2.05, 2.4, 0.10),
    "motorcycle": ("motorcycle", 2.2, 0.8, 1.5, 0.025),
    "lorry": ("truck", 8.5, 2.5, 3.5, 0.05),
    "semitrailer": ("trailer", 16.5, 2.55, 4.0, 0.03),
    "bus": ("bus", 12.0, 2.55, 3.1, 0.015),
    "bicycle": ("bicycle", 1.8, 0.65, 1.7, 0.0),
    "pedestrian": ("pedestrian", 0.5, 0.6, 1.7, 0.0),
}
GO_AHEAD = ("semitrailer", "bus")
COLUMNS = ("id", "x", "y", "angle", "type", "lane")  # of floating car data, those that are read


def exits(arm: str) -> dict[str, str]:
    """The arm that each turn leads to from another."""
    names = list(DIRECTIONS)
    number = names.index(arm)
    return {turn: names[(number + step) % 4] for turn, step in (("left", 1), ("ahead", 2), ("right", 3))}


def shape_along(arm: str, outwards: bool, off_m: float, near_m: float, far_m: float) -> str:
    """A line along an arm in the direction of travel, so far to the right of its axis."""
    out = np.array(DIRECTIONS[arm])
    right = np.array([out[1], -out[0]]) if outwards else np.array([-out[1], out[0]])
    ends = (near_m, far_m) if outwards else (far_m, near_m)
    return " ".join(f"{x:.2f},{y:.2f}" for x, y in (along * out + off_m * right for along in ends))


def write_sample_network(folder: Path) -> None:
    """The net of the shipped intersection; lanes count from the right: sidewalk, bicycle lane, then those of vehicles.

    The lane for turning left and the island beside it lie between the lanes that go ahead, which are in line across.
    """
    nodes = [f'<node id="middle" x="0" y="0" type="traffic_light" radius="{CORNER_RADIUS_M}"/>']
    slow = f'<lane index="0" width="{SIDEWALK_M}" allow="pedestrian"/>'
    slow += f'<lane index="1" width="{BICYCLE_LANE_M}" allow="bicycle"/>'
    fast = [f'<lane index="{lane}" width="{VEHICLE_LANE_M}" disallow="pedestrian bicycle"/>' for lane in (2, 3, 4)]
    edges, links = [], []
    for arm, (x, y) in DIRECTIONS.items():
        nodes += [f'<node id="{arm}" x="{END_M * x}" y="{END_M * y}" type="priority"/>']
        nodes += [f'<node id="{arm}_widens" x="{WIDENS_M * x}" y="{WIDENS_M * y}" type="priority"/>']
        for name, ends, lanes, shape in (
            ("into", (arm, f"{arm}_widens"), 2, (False, THROUGH_M, WIDENS_M, END_M)),
            ("from", (f"{arm}_widens", "middle"), 3, (False, THROUGH_M - VEHICLE_LANE_M, 0.0, WIDENS_M)),
            ("to", ("middle", arm), 2, (True, THROUGH_M, 0.0, END_M)),
        ):
            where = f'from="{ends[0]}" to="{ends[1]}" shape="{shape_along(arm, *shape)}" spreadType="right"'
            content = f'numLanes="{2 + lanes}" speed="{SPEED_LIMIT}">{slow}{"".join(fast[:lanes])}'
            edges.append(f'<edge id="{name}_{arm}" {where} {content}</edge>')
        ahead = {f"into_{arm}": {f"from_{arm}": ((1, 1), (2, 2), (3, 3), (3, 4))}}
        lanes = {"right": ((1, 1), (2, 2)), "ahead": ((1, 1), (2, 2), (3, 3)), "left": ((1, 1), (4, 3))}
        ahead[f"from_{arm}"] = {f"to_{to}": lanes[turn] for turn, to in exits(arm).items()}
        for start, leads in ahead.items():
            for end, pairs in leads.items():
                ends = f'<connection from="{start}" to="{end}"'
                links += [f'{ends} fromLane="{one}" toLane="{other}"/>' for one, other in pairs]
        crossed = f'edges="from_{arm} to_{arm}" width="{CROSSING_M}" priority="true"'
        links.append(f'<crossing node="middle" {crossed}/>')
    for root, content in {"nodes": nodes, "edges": edges, "connections": links}.items():
        write_xml(folder / f"{root}.xml", root, content)
    options = f"""--node-files=nodes.xml --edge-files=edges.xml --connection-files=connections.xml --output-file=net.xml
        --tls.cycle.time={SAMPLE_CYCLE_S} --tls.yellow.time={YELLOW_S} --tls.allred.time=2 --tls.left-green.time=9
        --tls.crossing-clearance.time=12 --offset.disable-normalization --no-turnarounds --walkingareas
        --xml-validation=never"""
    run_tool("netconvert", folder, options)
    net = ET.parse(folder / "net.xml")
    from_left = [link for link in net.iter("connection") if link.get("tl") and link.get("fromLane") == "4"]
    left = {int(link.get("linkIndex")) for link in from_left}
    for phase in net.iter("phase"):  # they wait for their own green, not within the junction where others pass
        signals = enumerate(phase.get("state"))
        phase.set("state", "".join("r" if link in left and signal == "g" else signal for link, signal in signals))
    net.write(folder / "net.xml", encoding="utf-8")


def sample_type_rows() -> list[str]:
    """SUMO's types of what travels at the shipped intersection."""
    return [
        f'<vType id="{name}" vClass="{kind}" length="{length}" width="{width}" height="{height}"/>'
        for name, (kind, length, width, height, _) in SAMPLE_TYPES.items()
    ]


def write_sample_routes(folder: Path, rng: np.random.Generator, end_s: float) -> None:
    """Vehicles, bicycles and persons that come independently of one another, by their departures."""
    share = {name: row[-1] for name, row in SAMPLE_TYPES.items()}
    rows = []
    for arm, flow in SAMPLE_PER_H.items():
        cycling = BICYCLES_PER_H / len(DIRECTIONS)
        for per_h, types, shares in ((flow, list(share), list(share.values())), (cycling, ["bicycle"], [1.0])):
            for depart_s in rng.uniform(0.0, end_s, rng.poisson(per_h * end_s / 3600.0)):
                kind, turn = rng.choice(types, p=shares), rng.choice(list(TURNS), p=list(TURNS.values()))
                to = exits(arm)["ahead" if kind in GO_AHEAD else turn]
                route = f'<route edges="into_{arm} from_{arm} to_{to}"/>'
                rows.append((depart_s, "vehicle", f'type="{kind}" departLane="best" departSpeed="max"', route))
    for depart_s in rng.uniform(0.0, end_s, rng.poisson(PERSONS_PER_H * end_s / 3600.0)):
        start, end = rng.choice(list(DIRECTIONS), 2, replace=False)
        ways = [f"{rng.choice(['from', 'to'])}_{arm}" for arm in (start, end)]
        places = rng.uniform(5.0, WIDENS_M - CORNER_RADIUS_M - 30.0, 2)
        walk = f'<walk from="{ways[0]}" to="{ways[1]}" arrivalPos="{places[1]:.1f}"/>'
        rows.append((depart_s, "person", f'type="pedestrian" departPos="{places[0]:.1f}"', walk))
    travellers = [
        f'<{what} id="{number}" depart="{depart_s:.1f}" {how}>{way}</{what}>'
        for number, (depart_s, what, how, way) in enumerate(sorted(rows))
    ]
    write_xml(folder / "routes.xml", "routes", [*sample_type_rows(), *travellers])


def trimmed(path: Path, begin_s: float) -> str:
    """Floating car data without the columns that are not read and what is far from the middle; it begins at 0 s."""
    lines = [MADE_BY, "<fcd-export>"]
    for _, step in ET.iterparse(path):
        if step.tag != "timestep":
            continue
        lines.append(f'<timestep time="{float(step.get("time")) - begin_s:.2f}">')
        for one in step:
            if np.hypot(float(one.get("x")), float(one.get("y"))) <= SAMPLE_M:
                values = " ".join(f'{key}="{one.get(key)}"' for key in COLUMNS if one.get(key) is not None)
                lines.append(f"<{one.tag} {values}/>")
        lines.append("</timestep>")
        step.clear()
    return "\n".join([*lines, "</fcd-export>", ""])


def pole_places() -> dict[str, tuple[float, float]]:
    """Where poles may stand: behind the sidewalk at each corner, and on the island of each arm."""
    edge = THROUGH_M + 2 * VEHICLE_LANE_M + BICYCLE_LANE_M + SIDEWALK_M
    corner, island = edge + 4.5, edge + CORNER_RADIUS_M + 4.0
    places = {f"{y}_{x}": (DIRECTIONS[x][0], DIRECTIONS[y][1]) for y in ("north", "south") for x in ("east", "west")}
    poles = {name: (corner * x, corner * y) for name, (x, y) in places.items()}
    for arm, (x, y) in DIRECTIONS.items():
        right = 0.5 * VEHICLE_LANE_M  # the middle of the island, seen outwards
        poles[f"island_{arm}"] = (island * x + right * y, island * y - right * x)
    return poles


def packed(text: str) -> bytes:
    """Gzip without a name or time, so that equal texts give equal files."""
    return gzip.compress(text.encode(), mtime=0)


def make_sample(out: Path, minutes: float = SAMPLE_MINUTES, seed: int = SAMPLE_SEED) -> None:
    """Simulate the shipped intersection and write its files."""
    begin_s = float(WARM_UP_S)
    end_s = begin_s + 60.0 * minutes
    with tempfile.TemporaryDirectory(prefix="make_crossing_") as name:
        folder = Path(name)
        write_sample_network(folder)
        write_sample_routes(folder, np.random.default_rng(seed), end_s)
        options = f"""--net-file=net.xml --route-files=routes.xml --xml-validation=never --seed={seed}
            --step-length={SAMPLE_STEP_S} --end={end_s:.1f} --fcd-output=fcd.xml --device.fcd.begin={begin_s:.1f}
            --fcd-output.attributes=x,y,angle,type,lane --time-to-teleport=-1 --step-log.period=100"""
        run_tool("sumo", folder, options, end_s)
        net = (folder / "net.xml").read_text(encoding="utf-8")
        write_bytes(out / SAMPLE_FILES[0], packed(f"{MADE_BY}\n{net}\n"))
        write_bytes(out / SAMPLE_FILES[1], packed(trimmed(folder / "fcd.xml", begin_s)))
    write_xml(out / SAMPLE_FILES[2], "additional", [MADE_BY, *sample_type_rows()])
    rows = [(name, f"{x:.2f}", f"{y:.2f}") for name, (x, y) in pole_places().items()]
    write_text(out / SAMPLE_FILES[3], to_csv(("name", "x_m", "y_m"), rows))


def main(argv: list[str] | None = None) -> int:
    return run_script("make_crossing", lambda: _make(_arguments(argv)))


def _arguments(argv):
    parser = parser_of(__doc__)
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--out", type=Path, metavar="FOLDER", help="recordings that are there are kept")
    what.add_argument("--sample", type=Path, metavar="FOLDER", help="make the shipped intersection")
    parser.add_argument("--recordings", type=positive, default=60)
    parser.add_argument("--cycle", type=positive, default=90, metavar="S", help="cycle of the recordings' signal")
    parser.add_argument("--seed", type=int, default=SAMPLE_SEED, help="of the shipped intersection (default 42)")
    parser.add_argument("--minutes", type=float, help="10 of a recording, 30 of the shipped intersection")
    return parser.parse_args(argv)


def _make(args) -> None:
    if args.sample:
        make_folder(args.sample, "--sample")
        make_sample(args.sample, args.minutes or SAMPLE_MINUTES, args.seed)
        return
    if args.cycle < 4 * YELLOW_S:
        raise InputError(f"--cycle {args.cycle}: allowed is {4 * YELLOW_S} s or more")
    cached_recordings(args.out, args.recordings, args.cycle, args.minutes or MINUTES)


if __name__ == "__main__":
    sys.exit(main())
