"""Calibrate the intervals of a run beside a signal: 60 recordings of ten minutes, each with its own answer.

`make_crossing.py` generates the same signalised crossing 60 times with other seeds. `optimise` runs on the approach
from the west as a user's would. The 90 % interval of its gain, in detectable share and in the metric, should hold the
mean of the other 59 gains about nine times in ten, be no wider than their spread asks for, and be missing seldom.

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

from arguments import counting, parser_of, positive, run_script
from blender_lidar.run.folder import RunFolder
from blender_lidar.run.optimise import optimise_site
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.statistics import student_t_95
from blender_lidar.toml_table import to_toml
from make_crossing import LANE_M, LANES, VEHICLE_TYPES, cached_recordings

SETBACK_M, BEFORE_M = 3.0, 25.0  # the mast, from the road's edge and from the middle of the crossing
CYCLE_S = 90


class Quiet:
    """A listener that does nothing."""

    def searching(self, search: object) -> None:
        """Nothing."""

    def mapping(self, points: int) -> None:
        """Nothing."""


def result_of(folder: Path, traffic: Path) -> dict:
    """The result of a run on one recording of the approach from the west, kept in a folder."""
    if not (folder / "result.json").exists():
        tables = {
            "traffic": {"path": str(traffic), "vehicle_types": str(traffic.with_name(VEHICLE_TYPES)), "frames": 40},
            "road": {"setback_m": SETBACK_M, "lanes": LANES, "lane_width_m": LANE_M},
            "sensor": {"name": "RS-16", "range_gate_m": 60.0},
            "region": {"stretches": [{"x_m": [-50.0, 10.0]}]},
            "deployment": {"height_m": [2.0, 6.0], "tilt_x_deg": [0.0, 25.0]},
            "search": {"method": "random", "particles": 20, "iterations": 15},
            "model": {"workers": 1},
        }
        tables["traffic"]["origin_m"] = [-BEFORE_M, -LANES * LANE_M - SETBACK_M]
        scene = folder.parent / f"{folder.name}.toml"
        scene.write_text(to_toml(tables), encoding="utf-8")
        site = prepare(load_scenario(scene))
        with RunFolder(folder).begun() as run:
            optimise_site(site, run, Quiet())
    return json.loads((folder / "result.json").read_text(encoding="utf-8"))


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
    results, paths = [], cached_recordings(args.out, args.recordings, CYCLE_S)
    with counting(len(paths), "runs") as advance:
        for number, path in enumerate(paths):
            results.append(result_of(args.out / f"run_{number:02d}", path))
            advance(1)
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
    maps = [RunFolder(args.out / f"run_{number:02d}").read_score_map() for number in range(args.recordings)]
    row, column = np.unravel_index(
        np.argmax(sum(one.block_objective.sum(axis=-1) for one in maps)), maps[0].per_vehicle.shape
    )
    best = {"height_m": maps[0].height_m[row], "tilt_x_deg": maps[0].tilt_deg[column]}
    for key, value in best.items():
        pairs = [(one["map"]["optimum_interval_90"] or {}).get(key) for one in results]
        held = sum(pair[0] - 1e-9 <= value <= pair[1] + 1e-9 for pair in pairs if pair)
        print(f"best {key} of all recordings together {value:g}: {held} of {sum(map(bool, pairs))} intervals hold it")


if __name__ == "__main__":
    parser = parser_of(__doc__)
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="where traffic and results are kept")
    parser.add_argument("--recordings", type=positive, default=60, help="number of recordings (default 60)")
    asked = parser.parse_args()
    sys.exit(run_script(parser.prog, lambda: calibrate(asked)))
