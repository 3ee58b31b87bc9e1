"""Time whole sites: I-80 and the shipped intersection with 1, 2 and 4 LiDARs.

    python scripts/research/benchmark_site.py [--sensor RS-32] [--frames 30] [--repeats 3] [--json FILE]

For each: milliseconds of a mounting that is moved while the others are held, and of a layout that is moved as a whole
(medians of swarms of 20); seconds of a run with a budget of 20 x 20 evaluations for each LiDAR; peak memory. One
process each, which makes everything anew; times are processor time of it, which other work on the machine does not
count into. The rounds of all sites take turns.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import tempfile
import time
import tomllib
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from statistics import median

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"  # one core

import numpy as np

from arguments import SCENES, Silent, counting, parser_of, positive, run_script
from blender_lidar.files import check_place, write_text
from blender_lidar.run.folder import RunFolder
from blender_lidar.run.optimise import optimise_site
from blender_lidar.scene.mounting import Layout
from blender_lidar.scene.scenario import scenario_of
from blender_lidar.scene.site import Site, prepare
from blender_lidar.scoring.evaluation import Evaluator

SWARM = 20
PLACES = {  # of the LiDARs, in this order
    "i80": [{"x_m": x, "y_m": 0.0} for x in (0.0, 40.0, -40.0, 20.0)],
    "crossing": [{"poles": "crossing_poles.csv", "pole": pole} for pole in ("north_east", "south_west")]
    + [{"poles": "crossing_poles.csv", "pole": pole} for pole in ("north_west", "south_east")],
}
SITES = [("i80", 1), ("i80", 2), ("crossing", 1), ("crossing", 2), ("crossing", 4)]
SEARCHED = {"height_m": [2.0, 4.5], "tilt_x_deg": [0.0, 25.0]}
REGION = {"i80": {"centre_m": [0.0, 0.0], "radius_m": 80.0}}


def main(argv: list[str] | None = None) -> int:
    return run_script("benchmark_site", lambda: _benchmark(_arguments(argv)))


def _arguments(argv):
    parser = parser_of(__doc__)
    parser.add_argument("--sensor", default="RS-32")
    parser.add_argument("--frames", type=positive, default=30, help="searched frames; 30")
    parser.add_argument("--repeats", type=positive, default=3, help="rounds; 3")
    parser.add_argument("--json", metavar="FILE")
    return parser.parse_args(argv)


def site_of(name: str, lidars: int, sensor: str, frames: int) -> Site:
    """A shipped scene with so many LiDARs, in one process."""
    tables = tomllib.loads((SCENES / f"{name}.toml").read_text(encoding="utf-8"))
    del tables["deployment"]
    tables["traffic"] |= {"frames": frames}
    tables["region"] |= REGION.get(name, {})
    tables["sensor"] = {"name": sensor, "range_gate_m": 80.0}
    tables["search"] = {"seed": 1, "particles": 20, "iterations": 20}
    tables["model"] = {"workers": 1}
    tables["lidar"] = [
        {"name": f"lidar{number}", **place, **SEARCHED} for number, place in enumerate(PLACES[name][:lidars], start=1)
    ]
    return prepare(scenario_of(tables, folder=SCENES))


def measured(name: str, lidars: int, sensor: str, frames: int) -> dict[str, float]:
    """What one site takes, in a process of its own."""

    site = site_of(name, lidars, sensor, frames)
    evaluator, rng = Evaluator(site.search, site.observation, site.scoring), np.random.default_rng(1)

    def drawn() -> Layout:
        return tuple(
            lidar.deployment.places[0].mounting([rng.uniform(2.0, 4.5), rng.uniform(0.0, 25.0)])
            for lidar in site.scenario.lidars
        )

    def milliseconds(layouts: list[Layout]) -> float:
        started = time.process_time()
        evaluator.totals(layouts)
        return 1e3 * (time.process_time() - started) / len(layouts)

    first = drawn()
    evaluator.totals([first, drawn()])  # trees are made and code is compiled
    moved = [[(*first[:-1], drawn()[-1]) for _ in range(SWARM)] for _ in range(5)]
    whole = [[drawn() for _ in range(SWARM)] for _ in range(5)]
    found = {"moved_ms": median(map(milliseconds, moved)), "whole_ms": median(map(milliseconds, whole))}
    run, started = RunFolder(Path(tempfile.mkdtemp())), time.process_time()
    with run.begun():
        result = optimise_site(site, run, Silent())
    seconds = time.process_time() - started
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return {**found, "evaluations": result["evaluations"], "run_s": seconds, "memory_mib": memory}


def _benchmark(args) -> None:
    if args.json:
        check_place(args.json, "--json")
    found: dict[tuple[str, int], list[dict[str, float]]] = {one: [] for one in SITES}
    with counting(args.repeats * len(SITES), "sites") as advance:
        for _ in range(args.repeats):
            for name, lidars in SITES:
                with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                    found[name, lidars].append(pool.submit(measured, name, lidars, args.sensor, args.frames).result())
                advance(1)
    rows = [
        {"site": name, "lidars": lidars, **{key: median(one[key] for one in rounds) for key in rounds[0]}}
        for (name, lidars), rounds in found.items()
    ]
    print(f"{args.sensor}, {args.frames} frames, medians of {args.repeats} rounds, processor time of one process")
    print("site      LiDARs  moved one, ms  moved all, ms  evaluations  whole run, s  memory, MiB")
    for row in rows:
        print(
            "{site:<9} {lidars:>6}  {moved_ms:>13.1f}  {whole_ms:>13.1f}  {evaluations:>11,.0f}  {run_s:>12.0f}  "
            "{memory_mib:>11.0f}".format(**row)
        )
    if args.json:
        write_text(args.json, json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    sys.exit(main())
