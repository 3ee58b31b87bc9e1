"""Calibrate the verdicts of `stability`: how many are false beside ten times the traffic.

SUMO generates straight roads that differ in lanes, flow, lorries, speed, pole, sensor and heights. `stability` judges
the mounting that it finds from ten minutes of each; the same study of that mounting from a hundred other minutes, with
ten times the frames, tells what it really loses to the rival. A verdict is false where the known loss, with its own
90 % interval, lies outside the class that was told.

    pip install "blender_lidar[fast,sumo]"
    python scripts/research/stability_calibration.py --out calibration

Traffic and finished studies stay in the folder, so that a run goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from arguments import parser_of, positive, run_script
from blender_lidar.commands.progress import Progress
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.studies.driver import StudyFolder
from blender_lidar.studies.findings import LOSS_CLASSES, SHARE_LIMITS, UNDECIDED, VERDICTS
from blender_lidar.studies.stability import QUICK_STABILITY, study_identity, study_stability
from blender_lidar.toml_table import to_toml
from make_traffic import run_tool

ROAD_M, MIDDLE_M, LANE_M = 800.0, 500.0, 3.2
WARM_UP_S, SAMPLE_S, TIMES = 120, 600, 10
PERIOD_S = 2
KNOWN = replace(QUICK_STABILITY, frames=None, varied_frames=TIMES * QUICK_STABILITY.varied_frames, heights=4, tilts=13)
KNOWN = replace(KNOWN, seeds=1, budget=0.1)


class Road(NamedTuple):
    """One generated scene."""

    lanes: int
    vehicles_per_hour_and_lane: int
    lorry_share: float
    speed_m_s: float
    setback_m: float
    sensor: str
    gate_m: float
    highest_m: float


def roads(number: int, seed: int = 31) -> list[Road]:
    """Scenes of many kinds, the same each time."""
    rng = np.random.default_rng(seed)
    return [
        Road(
            1 + k % 4,
            int(rng.integers(3, 17)) * 100,
            float(rng.choice([0.0, 0.1, 0.3])),
            float(rng.choice([14.0, 22.0, 30.0])),
            float(rng.choice([2.0, 4.0, 8.0])),
            str(rng.choice(["RS-16", "RS-32", "OS1-32"])),
            float(rng.choice([40.0, 60.0])),
            float(rng.choice([4.5, 6.0, 8.0])),
        )
        for k in range(number)
    ]


def generate(folder: Path, road: Road, seconds: int, seed: int) -> None:
    """Traffic of a road, by SUMO: fcd.xml beside types.rou.xml."""
    nodes = f'<nodes><node id="a" x="0" y="0"/><node id="b" x="{ROAD_M}" y="0"/></nodes>'
    edge = f'<edge id="e" from="a" to="b" numLanes="{road.lanes}" speed="{road.speed_m_s}" width="{LANE_M}"/>'
    cars = 1.0 - road.lorry_share
    shares = {"passenger": 0.8 * cars, "delivery": 0.2 * cars, "truck": road.lorry_share}
    sizes = {"passenger": (4.5, 1.8, 1.5), "delivery": (5.6, 2.0, 2.3), "truck": (12.0, 2.5, 3.8)}
    types = "".join(
        '<vType id="{0}" vClass="{0}" length="{2}" width="{3}" height="{4}" probability="{1:.3f}"/>'.format(
            kind, share, *sizes[kind]
        )
        for kind, share in shares.items()
        if share
    )
    types = f'<vTypeDistribution id="all">{types}</vTypeDistribution>'
    rate = road.lanes * road.vehicles_per_hour_and_lane / 3600.0
    flow = f'<flow id="f" type="all" from="e" to="e" begin="0" end="{WARM_UP_S + seconds}" period="exp({rate:.4f})"'
    flow += ' departLane="random" departSpeed="max"/>'
    texts = {"road.nod.xml": nodes, "road.edg.xml": f"<edges>{edge}</edges>", "types.rou.xml": f"<routes>{types}{flow}"}
    for name, text in texts.items():
        (folder / name).write_text(f"{text}</routes>" if "rou" in name else text, encoding="utf-8")
    run_tool("netconvert", folder, "-n road.nod.xml -e road.edg.xml -o road.net.xml")
    options = f"-n road.net.xml -r types.rou.xml -e {WARM_UP_S + seconds} --seed {seed} --fcd-output fcd.xml"
    run_tool("sumo", folder, f"{options} --device.fcd.period {PERIOD_S} --device.fcd.begin {WARM_UP_S} --no-step-log")


def scene_of(folder: Path, road: Road, times: int, workers: int) -> Path:
    """Write the scene of a road, with `times` as many frames as usual."""
    tables = {
        "traffic": {"path": "fcd.xml", "vehicle_types": "types.rou.xml", "frames": 30 * times, "holdout": 0.4},
        "road": {"setback_m": road.setback_m, "lanes": road.lanes, "lane_width_m": LANE_M},
        "sensor": {"name": road.sensor, "range_gate_m": road.gate_m},
        "deployment": {"height_m": [2.0, road.highest_m], "tilt_x_deg": [0.0, 25.0]},
        "model": {"workers": workers},
    }
    tables["traffic"]["origin_m"] = [MIDDLE_M, -road.lanes * LANE_M - road.setback_m]
    path = folder / "scene.toml"
    path.write_text(to_toml(tables), encoding="utf-8")
    return path


def studied(folder: Path, road: Road, times: int, seed: int, workers: int, mounting: Mapping | None = None) -> dict:
    """The study of a road, kept in a folder."""
    kept = folder / "stability.json"
    if kept.exists():
        return json.loads(kept.read_text(encoding="utf-8"))
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "fcd.xml").exists():
        generate(folder, road, times * SAMPLE_S, seed)
    scenario = load_scenario(scene_of(folder, road, times, workers))
    layout = (scenario.lidar.mounting(mounting),) if mounting else None
    effort = QUICK_STABILITY if times == 1 else KNOWN
    site = prepare(scenario, layout or ())
    study = StudyFolder(folder / "study", study_identity(site, effort, layout), Progress)
    with study.locked(resume=(folder / "study").exists()):
        result = study_stability(site, effort, study, layout)
    kept.write_text(json.dumps(result), encoding="utf-8")
    return result


def class_of(loss: float) -> str:
    """The class of a known loss, by the rule of the verdicts."""
    return LOSS_CLASSES[int(np.searchsorted(SHARE_LIMITS, loss))]


def compared(told: dict, known: dict) -> Iterator[tuple[str, str, str, bool]]:
    """Each line with a verdict on a loss: what, the verdict, the class of the known loss, and whether it is false."""
    truth = {(one["section"], one["what"], one["value"]): one["numbers"] for one in known["findings"]}
    for one in told["findings"]:
        true = truth.get((one["section"], one["what"], one["value"]), {})
        if "detectable_share_lost" not in one["numbers"] or true.get("detectable_share_lost_interval_90") is None:
            continue
        classes = [
            class_of(loss) for loss in (true["detectable_share_lost"], *true["detectable_share_lost_interval_90"])
        ]
        is_false = one["verdict"] != UNDECIDED and not set(one["verdict"].split(" or ")) & set(classes)
        yield f"{one['what']} {one['value']}".strip(), one["verdict"], classes[0], is_false


def calibrate(args: argparse.Namespace) -> None:
    """Study all roads, and count false verdicts."""
    counts, false = Counter(), []
    for number, road in enumerate(roads(args.scenes)):
        if args.only is not None and number != args.only:
            continue
        folder = args.out / f"{number:02d}"
        told = studied(folder / "sample", road, 1, 100 + number, args.workers)
        known = studied(folder / "known", road, TIMES, 200 + number, args.workers, told["mounting"])
        lines = list(compared(told, known))
        counts.update((verdict, true) for _, verdict, true, _ in lines)
        wrong = [line for line in lines if line[-1]]
        false += wrong
        print(f"{number:2d} {road}: {len(lines)} lines, {len(wrong)} false", flush=True)
        for what, verdict, true, _ in wrong:
            print(f"     {what}: {verdict}, is {true}")
    lines, decided = counts.total(), sum(n for (verdict, _), n in counts.items() if verdict != UNDECIDED)
    print(f"{lines} lines, {decided} with a verdict, {len(false)} false: {100 * len(false) / max(decided, 1):.1f} %")
    for verdict in VERDICTS:
        row = {true: counts[verdict, true] for true in LOSS_CLASSES}
        print(f"{verdict:<10} {row}")


if __name__ == "__main__":
    parser = parser_of(__doc__)
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="where traffic and studies are kept")
    parser.add_argument("--scenes", type=positive, default=10, help="number of roads (default 10)")
    parser.add_argument("--only", type=int, help="this road alone")
    parser.add_argument("--workers", type=positive, default=2, help="processes (default 2)")
    asked = parser.parse_args()
    sys.exit(run_script(parser.prog, lambda: calibrate(asked)))
