"""The sites on which answers are judged as hung: straight roads, signalised crossings, and nets of the user's own.

Nothing was tuned on them. Each makes fresh traffic of a seed by SUMO, and has a scene with one place for a LiDAR.
`installation_judgement.py` runs them.
"""

from __future__ import annotations

import csv
import math
import shutil
import sys
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import NamedTuple

import numpy as np

from blender_lidar.cli import main as command_line
from blender_lidar.errors import BlenderLidarError
from blender_lidar.scene.scenario import Scenario, scenario_of
from blender_lidar.toml_table import read_toml
from blender_lidar.traffic.sumo_types import read_config
from make_crossing import TYPES, YELLOW_S
from make_traffic import run_tool, write_xml
from stability_calibration import LANE_M, MIDDLE_M, SAMPLE_S, TIMES, WARM_UP_S, Road, generate, roads

ROADS_SEED, CROSSINGS_SEED = 83, 84
FRAMES = 24
ARM_M, NEAR_M, SPEED_M_S, CORNER_M = 300.0, 120.0, 13.9, 3.0  # the last: from the pole to the lanes of both arms
FLEETS = {"identical": {"car": ("passenger", 4.3, 1.8, 1.5, 1.0)}, "mixed": TYPES}
SHAPES = ((0, 180, 270), (0, 90, 180, 270), (0, 90, 180, 270), (0, 60, 180, 240), (0, 90, 180, 270))


class Crossing(NamedTuple):
    """A signalised crossing: where its arms lead to, lanes of each, and who drives there."""

    bearings_deg: tuple[float, ...]
    lanes: int
    fleet: str
    vehicles_per_hour_and_arm: int
    cycle_s: int
    corner: int
    sensor: str
    gate_m: float

    @property
    def pole_xy(self) -> tuple[float, float]:
        """A place beside the lanes of two arms that follow one another."""
        first, second = (self.bearings_deg * 2)[self.corner : self.corner + 2]
        half = 0.5 * math.radians((second - first) % 360.0)
        reach = (self.lanes * LANE_M + CORNER_M) / math.sin(half)
        middle = math.radians(first) + half
        return round(reach * math.cos(middle), 2), round(reach * math.sin(middle), 2)

    def generate(self, folder: Path, seconds: float, seed: int) -> None:
        """Its traffic, by SUMO: fcd.xml.gz beside net.xml and types.xml; everyone may turn."""
        ends, rows = range(len(self.bearings_deg)), []
        turns = np.radians(self.bearings_deg)
        nodes = ['<node id="middle" x="0" y="0" type="traffic_light"/>']
        for k, x, y in zip(ends, ARM_M * np.cos(turns), ARM_M * np.sin(turns), strict=True):
            nodes.append(f'<node id="{k}" x="{x:.2f}" y="{y:.2f}" type="priority"/>')
            common = f'numLanes="{self.lanes}" width="{LANE_M}" speed="{SPEED_M_S}"'
            rows.append(f'<edge id="from_{k}" from="{k}" to="middle" {common}/>')
            rows.append(f'<edge id="to_{k}" from="middle" to="{k}" {common}/>')
        types = [
            f'<vType id="{name}" vClass="{kind}" length="{length}" width="{width}" height="{height}" '
            f'probability="{share}"/>'
            for name, (kind, length, width, height, share) in FLEETS[self.fleet].items()
        ]
        begin_s = WARM_UP_S + seed % self.cycle_s  # anywhere in the cycle
        rate = self.vehicles_per_hour_and_arm / 3600.0 / (len(ends) - 1)
        flows = [
            f'<flow id="{start}_{end}" type="all" from="from_{start}" to="to_{end}" begin="0" departLane="best" '
            f'departSpeed="max" end="{begin_s + seconds}" period="exp({rate:.5f})"/>'
            for start in ends
            for end in ends
            if start != end
        ]
        corners = " ".join(f"{x * NEAR_M},{y * NEAR_M}" for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
        for name, root, content in (
            ("nodes", "nodes", nodes),
            ("edges", "edges", rows),
            ("types", "routes", ['<vTypeDistribution id="all">', *types, "</vTypeDistribution>", *flows]),
            ("near", "additional", [f'<poly id="near" shape="{corners}"/>']),
        ):
            write_xml(folder / f"{name}.xml", root, content)
        options = f"""--node-files=nodes.xml --edge-files=edges.xml --output-file=net.xml --no-turnarounds
            --tls.cycle.time={self.cycle_s} --tls.yellow.time={YELLOW_S} --offset.disable-normalization"""
        run_tool("netconvert", folder, options)
        options = f"-n net.xml -r types.xml -a near.xml -b 0 --fcd-output.filter-shapes near {recorded(begin_s, seed)}"
        run_tool("sumo", folder, f"{options} -e {begin_s + seconds}")

    def tables(self, folders: Sequence[Path]) -> dict:
        """Its scene with the traffic of a folder."""
        (folder,) = map(str, folders)
        x_m, y_m = self.pole_xy
        return {
            "traffic": [{"path": f"{folder}/fcd.xml.gz", "vehicle_types": f"{folder}/types.xml"}],
            "road": {"net": f"{folder}/net.xml"},
            "region": {"junction": "middle", "approach_m": 40.0},
            "sensor": {"name": self.sensor, "range_gate_m": self.gate_m},
            "deployment": {"x_m": x_m, "y_m": y_m, "height_m": [2.0, 6.0], "tilt_x_deg": [0.0, 25.0]},
        }


class Straight(NamedTuple):
    """A straight road of `stability_calibration`."""

    road: Road

    def generate(self, folder: Path, seconds: int, seed: int) -> None:
        """Its traffic."""
        generate(folder, self.road, seconds, seed)

    def tables(self, folders: Sequence[Path]) -> dict:
        """Its scene with the traffic of a folder."""
        (folder,), road = map(str, folders), self.road
        origin_m = [MIDDLE_M, -road.lanes * LANE_M - road.setback_m]
        types = f"{folder}/types.rou.xml"
        return {
            "traffic": [{"path": f"{folder}/fcd.xml", "vehicle_types": types, "origin_m": origin_m}],
            "road": {"setback_m": road.setback_m, "lanes": road.lanes, "lane_width_m": LANE_M},
            "sensor": {"name": road.sensor, "range_gate_m": road.gate_m},
            "deployment": {"height_m": [2.0, road.highest_m], "tilt_x_deg": [0.0, 25.0]},
        }


class Net(NamedTuple):
    """A net of the user's own, whose demand sets out at other times in each recording."""

    config: Path

    def generate(self, folder: Path, seconds: int, seed: int) -> None:
        """Its traffic; one that is ten times as long is as many recordings, as demands end."""
        begin = ET.parse(self.config).find(".//begin")
        begin_s = WARM_UP_S + SAMPLE_S + float(0.0 if begin is None else begin.get("value"))
        for part in range(round(seconds / SAMPLE_S)):
            own = folder / f"{part}"
            own.mkdir()
            options = f"-c {self.config.resolve()} -e {begin_s + SAMPLE_S} --random-depart-offset {SAMPLE_S}"
            run_tool("sumo", own, f"{options} {recorded(begin_s, TIMES * seed + part)}")

    def tables(self, folders: Sequence[Path]) -> dict:
        """The scene that `init` proposes, with the traffic of folders, at its first pole."""
        (folder,), named = folders, read_config(self.config)
        scene, data = folder.parent / "1_scene", sorted(str(path) for path in folder.glob("*/fcd.xml.gz"))
        if not (scene / "scene.toml").exists():
            types = [word for path in named.types[:1] for word in ("--vehicle-types", str(path.resolve()))]
            asked = ["init", str(scene), "--from", "sumo", data[0], "--net", str(named.net.resolve()), *types]
            with redirect_stdout(sys.stderr):
                if command_line(asked):
                    raise BlenderLidarError(f"{self.config}: init proposes no site there")
        tables = read_toml(scene / "scene.toml")
        with (scene / tables["deployment"].pop("poles")).open(encoding="utf-8") as file:
            pole = next(csv.DictReader(file))
        tables["traffic"] = [{**tables["traffic"], "path": path, "name": Path(path).parent.name} for path in data]
        tables["deployment"] |= {key: float(pole[key]) for key in ("x_m", "y_m")}
        return tables


TrafficSite = Straight | Crossing | Net


def recorded(begin_s: float, seed: int) -> str:
    """SUMO's options for a recording of positions."""
    return f"""--seed {seed} --fcd-output fcd.xml.gz --fcd-output.attributes x,y,angle,type,speed,pos,lane,slope
        --device.fcd.period 1 --device.fcd.begin {begin_s} --xml-validation never --no-step-log --no-warnings"""


def crossings() -> list[Crossing]:
    """The crossings, the same each time."""
    rng, found = np.random.default_rng(CROSSINGS_SEED), []
    for number, bearings in enumerate(SHAPES):
        lanes, fleet = (1, 1, 2, 2, 1)[number], ("identical", "identical", "identical", "mixed", "mixed")[number]
        flow, cycle_s = int(rng.integers(8, 15)) * 25 * lanes, int(rng.choice([60, 75, 90]))
        sensor = "RS-16" if fleet == "identical" else str(rng.choice(["RS-16", "RS-32", "OS1-32"]))  # rings far apart
        corner = int(rng.integers(len(bearings)))
        found.append(Crossing(bearings, lanes, fleet, flow, cycle_s, corner, sensor, 80.0))
    return found


def sites(nets: Path | None) -> dict[str, TrafficSite]:
    """All sites by name."""
    named = {f"straight_{k}": Straight(road) for k, road in enumerate(roads(5, ROADS_SEED))}
    named |= {f"crossing_{k}": crossing for k, crossing in enumerate(crossings())}
    return named | {path.stem: Net(path) for path in sorted(nets.rglob("*.sumocfg") if nets else ())}


def scene_of(site: TrafficSite, folder: Path, times: int, seed: int, **changed: dict) -> Scenario:
    """A scene with its traffic, which is made where it is not there yet."""
    if not folder.exists():
        part = folder.with_suffix(".part")
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        site.generate(part, times * SAMPLE_S, seed)
        part.rename(folder)
    tables = site.tables([folder])
    frames = FRAMES * times // len(tables["traffic"])
    tables["traffic"] = [{**one, "frames": frames} for one in tables["traffic"]]
    tables |= {name: {**tables.get(name, {}), **values} for name, values in changed.items()}
    return scenario_of(tables, source=folder.parent.name, folder=folder.parent / "1_scene")
