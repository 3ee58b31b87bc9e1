"""Generate traffic at a signalised crossing with SUMO: recordings by which intervals at a signal are judged.

Four arms of two lanes, a fixed cycle, Poisson arrivals; the approach from the west is where a LiDAR would hang. Each
seed is fresh traffic of the same kind. Floating car data of every vehicle within 150 m of the middle, each second.

    pip install "blender_lidar[sumo]"
    python scripts/research/make_crossing.py --out cache --recordings 60 --cycle 90
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from arguments import counting, parser_of, positive, run_script
from blender_lidar.errors import InputError
from blender_lidar.files import write_bytes
from make_traffic import run_tool, write_xml

ARM_M = 400.0
LANES, LANE_M = 2, 3.5
SPEED_LIMIT = 13.9
YELLOW_S = 4
WARM_UP_S = 300
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


def cached_recordings(folder: Path, recordings: int, cycle_s: int, minutes: float = 10.0) -> list[Path]:
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


def main(argv: list[str] | None = None) -> int:
    return run_script("make_crossing", lambda: _make(_arguments(argv)))


def _arguments(argv):
    parser = parser_of(__doc__)
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="recordings that are there are kept")
    parser.add_argument("--recordings", type=positive, default=60)
    parser.add_argument("--cycle", type=positive, default=90, metavar="S", help="cycle of the signal")
    parser.add_argument("--minutes", type=float, default=10.0)
    return parser.parse_args(argv)


def _make(args) -> None:
    if args.cycle < 4 * YELLOW_S:
        raise InputError(f"--cycle {args.cycle}: allowed is {4 * YELLOW_S} s or more")
    cached_recordings(args.out, args.recordings, args.cycle, args.minutes)


if __name__ == "__main__":
    sys.exit(main())
