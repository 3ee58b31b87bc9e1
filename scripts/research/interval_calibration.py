"""Calibrate the intervals of a run beside a signal: 60 recordings of ten minutes, each with its own answer.

SUMO generates the same signalised crossing 60 times with other seeds. `optimise` runs on each approach as a user's
would, and the 90 % interval of its gain, in detectable share and in the metric, should hold the mean of the other 59
gains about nine times in ten, be no wider than their spread asks for, and be missing seldom.

    pip install "blender_lidar[fast,sumo]"
    python scripts/research/interval_calibration.py --out crossing

Traffic and results stay in the folder, so that a run goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from arguments import parser_of, positive, run_script
from blender_lidar.run.folder import RunFolder
from blender_lidar.run.optimise import optimise_site
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.statistics import student_t_95
from blender_lidar.toml_table import to_toml
from make_traffic import run_tool

LANE_M, LANES, STOP_LINE_M, SETBACK_M = 3.2, 2, 290.0, 3.0
WARM_UP_S, SAMPLE_S, STEP_S = 180, 600, 1
FLOWS = {"west": ("w", "e", 700), "east": ("e", "w", 500), "south": ("s", "n", 350), "north": ("n", "s", 350)}


class Quiet:
    """A listener that does nothing."""

    def searching(self, search: object) -> None:
        """Nothing."""

    def mapping(self, points: int) -> None:
        """Nothing."""


def generate(folder: Path, seed: int) -> None:
    """Ten minutes at a crossing of two roads with a signal whose cycle is 90 s: fcd.xml beside types.rou.xml."""
    ends = {"w": (0, 0), "e": (600, 0), "s": (300, -300), "n": (300, 300)}
    nodes = "".join(f'<node id="{name}" x="{x}" y="{y}"/>' for name, (x, y) in ends.items())
    edges = "".join(
        f'<edge id="{name}{way}" from="{a}" to="{b}" numLanes="{LANES}" speed="13.9" width="{LANE_M}"/>'
        for name in ends
        for way, a, b in (("in", name, "x"), ("out", "x", name))
    )
    sizes = {"passenger": (4.5, 1.8, 1.5, 0.8), "delivery": (5.6, 2.0, 2.3, 0.1), "truck": (12.0, 2.5, 3.8, 0.1)}
    types = "".join(
        f'<vType id="{kind}" vClass="{kind}" length="{a}" width="{b}" height="{c}" probability="{share}"/>'
        for kind, (a, b, c, share) in sizes.items()
    )
    until = WARM_UP_S + SAMPLE_S
    flows = "".join(
        f'<flow id="{name}" type="all" from="{a}in" to="{b}out" begin="0" end="{until}" departLane="random" '
        f'departSpeed="max" period="exp({hourly / 3600.0:.4f})"/>'
        for name, (a, b, hourly) in FLOWS.items()
    )
    texts = {
        "x.nod.xml": f'<nodes>{nodes}<node id="x" x="300" y="0" type="traffic_light"/></nodes>',
        "x.edg.xml": f"<edges>{edges}</edges>",
        "types.rou.xml": f'<routes><vTypeDistribution id="all">{types}</vTypeDistribution>{flows}</routes>',
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    run_tool("netconvert", folder, "-n x.nod.xml -e x.edg.xml -o x.net.xml --offset.disable-normalization")
    options = f"-n x.net.xml -r types.rou.xml -e {until} --seed {seed} --fcd-output fcd.xml --no-step-log"
    run_tool("sumo", folder, f"{options} --device.fcd.period {STEP_S} --device.fcd.begin {WARM_UP_S}")


def result_of(folder: Path, seed: int) -> dict:
    """The result of a run on one recording of the approach from the west, kept in a folder."""
    if not (folder / "run" / "result.json").exists():
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / "fcd.xml").exists():
            generate(folder, seed)
        tables = {
            "traffic": {"path": "fcd.xml", "vehicle_types": "types.rou.xml", "frames": 40, "holdout": 0.4},
            "road": {"setback_m": SETBACK_M, "lanes": LANES, "lane_width_m": LANE_M},
            "sensor": {"name": "RS-16", "range_gate_m": 50.0},
            "region": {"stretches": [{"x_m": [-40.0, 10.0]}]},
            "deployment": {"height_m": [2.0, 6.0], "tilt_x_deg": [0.0, 25.0]},
            "search": {"method": "random", "particles": 20, "iterations": 15},
            "model": {"workers": 1},
        }
        tables["traffic"]["origin_m"] = [STOP_LINE_M - 15.0, -LANES * LANE_M - SETBACK_M]
        scene = folder / "scene.toml"
        scene.write_text(to_toml(tables), encoding="utf-8")
        site = prepare(load_scenario(scene))
        with RunFolder(folder / "run").begun() as run:
            optimise_site(site, run, Quiet())
    return json.loads((folder / "run" / "result.json").read_text(encoding="utf-8"))


def told(name: str, gains: np.ndarray, ends: list) -> None:
    """Print how often intervals hold the mean of the others, and how wide they are beside what the spread asks for."""
    given = [number for number, pair in enumerate(ends) if pair]
    held = sum(ends[i][0] <= np.delete(gains, i).mean() <= ends[i][1] for i in given)
    widths = np.array([0.5 * (ends[i][1] - ends[i][0]) for i in given])
    asked = student_t_95(len(gains) - 1) * gains.std(ddof=1)
    print(f"{name}: mean gain {gains.mean():.4f}, spread {gains.std(ddof=1):.4f}; {len(given)} of {len(gains)} have an")
    print(f"  interval, {held} of these hold the mean of the others; half-widths {np.median(widths):.4f} (median), ")
    print(f"  {np.median(widths) / asked:.2f} times what the spread asks for")


def calibrate(args: argparse.Namespace) -> None:
    """Run all recordings and count."""
    results = []
    for number in range(args.recordings):
        results.append(result_of(args.out / f"{number:02d}", 500 + number))
        print(f"\r{number + 1} of {args.recordings}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    judged = [one["cross_fitted"]["optimised"] if one["cross_fitted"] else one["holdout"] for one in results]
    blocks = [one["blocks"] for one in judged]
    print(
        f"{sum(bool(one['cross_fitted']) for one in results)} runs cross-fitted; {min(blocks)} to {max(blocks)} blocks"
    )
    for name, key, ends in (
        ("detectable share", "detectable_share_gain", "detectable_share_gain_interval_90"),
        ("metric", "gain_over_baseline", "interval_90"),
    ):
        told(name, np.array([one[key] for one in judged]), [one[ends] for one in judged])
    best = np.array([(one["deployment"]["height_m"], one["deployment"]["tilt_x_deg"]) for one in results])
    whole = np.median(best, axis=0)
    for axis, key in enumerate(("height_m", "tilt_x_deg")):
        pairs = [(one["map"]["optimum_interval_90"] or {}).get(key) for one in results]
        held = sum(pair[0] <= whole[axis] <= pair[1] for pair in pairs if pair)
        print(f"best {key}: median {whole[axis]:.2f}; {held} of {sum(map(bool, pairs))} intervals hold it")


if __name__ == "__main__":
    parser = parser_of(__doc__)
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="where traffic and results are kept")
    parser.add_argument("--recordings", type=positive, default=60, help="number of recordings (default 60)")
    asked = parser.parse_args()
    sys.exit(run_script(parser.prog, lambda: calibrate(asked)))
