"""A small scene with two LiDARs that face each other across the road, one at each end of the region."""

from __future__ import annotations

import tomllib
from pathlib import Path

from blender_lidar.toml_table import to_toml
from tests.small_scene import write_scene

WEST: dict[str, object] = {"name": "west", "x_m": -8.0, "height_m": [2.0, 4.5], "tilt_x_deg": 15.0}
EAST: dict[str, object] = {
    "name": "east",
    "sensor": "RS-32",
    "x_m": 8.0,
    "y_m": 11.0,
    "facing_deg": -90.0,
    "height_m": [2.0, 4.5],
    "tilt_x_deg": 15.0,
}


def write_layout_scene(folder: Path, *lidars: dict[str, object], **changes: dict[str, object]) -> Path:
    """Write ``scene.toml`` with [[lidar]] in place of [deployment]; the two of this file unless others are given."""
    path = write_scene(
        folder, {"region": {"centre_m": [0.0, 6.0], "radius_m": 20.0}, "search": {"iterations": 20}, **changes}
    )
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    del tables["deployment"]
    path.write_text(to_toml({**tables, "lidar": list(lidars or (WEST, EAST))}), encoding="utf-8")
    return path
