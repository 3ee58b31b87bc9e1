"""The README, the scene files and the package say the same."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from blender_lidar import __version__
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.sensors.model import model_names

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
SCENES = sorted((ROOT / "scenes").glob("*.toml"))


@pytest.mark.parametrize("scene", SCENES, ids=lambda path: path.name)
def test_a_shipped_scene_can_be_read_and_its_traffic_is_there(scene):
    scenario = load_scenario(scene)
    assert Path(scenario.traffic.path).is_file()


def test_the_paper_scene_holds_the_papers_settings():
    scenario = load_scenario(ROOT / "scenes" / "paper.toml")
    assert dict(scenario.deployment.bounds) == {"height_m": (2.0, 4.5), "tilt_x_deg": (0.0, 25.0)}
    search = scenario.search
    assert (search.particles, search.iterations) == (20, 100)
    assert (search.inertia, search.differential_weight, search.cognitive, search.social) == (0.7, 0.5, 0.3, 0.2)
    assert search.differential_threshold == 0.1
    objective = scenario.objective
    assert (objective.cell_m, objective.threshold, objective.loss) == (0.05, 0.005, -1.0)
    gates = {}
    for sensor in ("RS-16", "RS-32", "RS-80"):
        overrides = {("sensor", "name"): (sensor, "--sensor")}
        gates[sensor] = load_scenario(ROOT / "scenes" / "paper.toml", overrides).sensor.range_gate_m
    assert gates == {"RS-16": 50.0, "RS-32": 80.0, "RS-80": 150.0}  # Table I


def test_the_readme_explains_every_key_of_a_scene():
    tables = load_scenario(ROOT / "scenes" / "paper.toml").as_tables()
    section = README[README.index("## The scene file") : README.index("## Traffic")]
    unexplained = [f"[{table}] {key}" for table, keys in tables.items() for key in keys if f"{key}" not in section]
    assert unexplained == []


def test_the_readme_names_every_sensor():
    assert [name for name in model_names() if name not in README] == []


def test_the_links_of_the_readme_lead_somewhere():
    links = re.findall(r"\]\(([^)#:]+)\)", README)
    assert links
    assert [link for link in links if not (ROOT / link).exists()] == []


def test_the_readme_is_complete():
    assert "@@" not in README


def test_versions_agree():
    assert f'version = "{__version__}"' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")
