"""Scene files as texts: the shortest that is one, writing them, and what they are refused with."""

from __future__ import annotations

from pathlib import Path

import pytest

from blender_lidar.errors import InputError
from blender_lidar.scene.scenario import load_scenario

MINIMAL = '[traffic]\npath = "traffic.csv"\n'


def scene(folder: Path, text: str) -> Path:
    path = folder / "site.toml"
    path.write_text(text, encoding="utf-8")
    return path


def refusal(folder: Path, text: str, overrides=None, error=InputError) -> str:
    """What a scene file is refused with, the file's name taken off."""
    path = scene(folder, text)
    with pytest.raises(error) as caught:
        load_scenario(path, overrides)
    text = str(caught.value)
    assert "\n" not in text
    return text.removeprefix(f"{path}: ")


def own_sensor(path: Path, range_max_m: float) -> Path:
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"range_max_m = {range_max_m}\nbeams = [[0, -10.0], [1, 0.0]]\n")
    return path
