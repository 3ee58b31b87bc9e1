"""A scene so small that a whole run takes a second: a handful of vehicles driving past on two lanes.

Only the height is searched, which saves the map of heights and tilts; `MAPPED` has it.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np

from blender_lidar.casting import is_available
from blender_lidar.cli import main
from blender_lidar.road.settings import RoadSettings, map_of
from blender_lidar.scene.deployment import Facing, Place, Pole
from blender_lidar.scene.mounting import Mounting, mounting_from
from blender_lidar.toml_table import to_toml

HEADER = ("frame", "vehicle_id", "class", "x_m", "y_m", "length_m", "width_m", "height_m", "heading_deg", "time_s")
FRAME_STEP_S = 2.0
GATE_M = 20.0
CASTER = "embree" if is_available("embree") else "exact"

SETTINGS: dict[str, dict[str, object]] = {
    "traffic": {"path": "traffic.csv", "frames": 6, "holdout": 0.4},
    "road": {"setback_m": 2.0, "lanes": 2, "lane_width_m": 3.5},
    "sensor": {"name": "RS-16", "rotation_hz": 20.0, "range_gate_m": GATE_M},
    "deployment": {"height_m": [2.0, 4.5], "tilt_x_deg": 15.0, "installer": False},  # as quick, and as planned
    "search": {"particles": 4, "iterations": 3, "seed": 1},
    "model": {"caster": CASTER, "workers": 1},
}
REGION: dict[str, dict[str, object]] = {"region": {"centre_m": [0.0, 0.0], "radius_m": GATE_M}}
MAPPED: dict[str, dict[str, object]] = {"deployment": {"tilt_x_deg": [0.0, 25.0]}}


def traffic_rows(frames: int = 60, vehicles: int = 40, seed: int = 1) -> list[list[object]]:
    """Rows of a table of boxes under `HEADER`: vehicles on two lanes at 10 m/s, seen every 2 s for two minutes."""
    rng = np.random.default_rng(seed)
    sizes = {"car": (4.4, 1.8, 1.5), "van": (5.2, 2.0, 1.9), "truck": (11.0, 2.5, 3.6)}
    kind = rng.choice(list(sizes), vehicles, p=[0.6, 0.25, 0.15])
    gone_m = 10.0 * FRAME_STEP_S * frames  # a vehicle's way during the recording
    start_m = np.linspace(-gone_m, 40.0, vehicles)
    lane = np.arange(vehicles) % 2
    rows: list[list[object]] = []
    for frame in range(frames):
        time_s = FRAME_STEP_S * frame
        for number in range(vehicles):
            x_m = start_m[number] + 10.0 * time_s
            if abs(x_m) < 40.0:
                y_m = 2.0 + 3.5 * (lane[number] + 0.5)
                row = [frame, number + 1, kind[number], round(x_m, 3), y_m, *sizes[kind[number]], 0.0, time_s]
                rows.append(row)
    return rows


def write_table(path: Path, rows: list[list[object]], header: tuple[str, ...] = HEADER) -> Path:
    """Write rows as the CSV that `blender_lidar.traffic` calls a table."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(header)
        writer.writerows(rows)
    return path


def write_scene(folder: Path, changes: dict[str, dict[str, object]] | None = None) -> Path:
    """Write ``scene.toml`` and, unless it is there, ``traffic.csv``; a change to None leaves a key out."""
    folder.mkdir(parents=True, exist_ok=True)
    tables = {name: dict(table) for name, table in SETTINGS.items()}
    for name, table in (changes or {}).items():
        if isinstance(table, list):
            tables[name] = table
        else:
            tables.setdefault(name, {}).update(table)
    if "lidar" in tables:
        tables.pop("deployment", None)
    if not (folder / "traffic.csv").exists():
        write_table(folder / "traffic.csv", traffic_rows())
    path = folder / "scene.toml"
    path.write_text(to_toml(tables), encoding="utf-8")
    return path


def without_charts(monkeypatch) -> None:
    """Let matplotlib look as if it were not installed: charts take longer than the runs."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)


def mounting(coordinates: dict[str, float], **changes: float) -> Mounting:
    """The mounting beside a level road that coordinates give [m, degrees]; at the origin, 2 m high unless said."""
    return mounting_from({**coordinates, **changes}, map_of(RoadSettings()))


def place_of(
    fixed: dict[str, float], bounds: dict[str, tuple[float, float]], pole: Pole | None = None, **road: object
) -> Place:
    """A place beside a level road, which faces +y."""
    return Place(fixed, bounds, Facing(90.0), map_of(RoadSettings(**road)), pole)


def cli(capsys, *words: object) -> tuple[int, str, str]:
    """Run the command line in this process: exit code, stdout, stderr."""
    capsys.readouterr()
    code = main([str(word) for word in words])
    out, err = capsys.readouterr()
    return code, out, err


def done(capsys, *words: object) -> tuple[str, str]:
    """What a command that succeeds prints: stdout, stderr."""
    code, out, err = cli(capsys, *words)
    assert code == 0, err
    return out, err


def without_times(result: dict) -> dict:
    """A result but for what may differ between two runs that ought to agree: times, versions, the name of the site."""
    kept = {key: value for key, value in result.items() if key not in ("seconds", "versions")}
    if "document" in kept:
        title = kept["document"]["title"].partition(": ")[2]
        kept["document"] = {**kept["document"], "title": title, "settings": {}}
    return kept
