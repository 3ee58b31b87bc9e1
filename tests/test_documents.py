"""The README, the documents, the scene files and the package say the same.

``python -m tests.test_documents`` writes the tables of the reference that are made from the declarations.
"""

from __future__ import annotations

import argparse
import dataclasses
import re
import tomllib
from collections.abc import Mapping
from itertools import chain, groupby
from pathlib import Path
from types import UnionType
from typing import get_args, get_origin

import pytest

from blender_lidar import __version__
from blender_lidar.commands.parsers import add_verbs
from blender_lidar.commands.verbs import VERBS
from blender_lidar.errors import InputError, MissingFileError
from blender_lidar.scene.lidars import LIDAR
from blender_lidar.scene.scenario import load_scenario, numbered_tables
from blender_lidar.scene.settings import DECLARED
from blender_lidar.sensors.model import model_names
from blender_lidar.toml_table import limits_text

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
SCENES = sorted((ROOT / "scenes").glob("*.toml"))


@pytest.mark.parametrize("scene", SCENES, ids=lambda path: path.name)
def test_a_shipped_scene_can_be_read_and_its_traffic_is_there(scene):
    scenario = load_scenario(scene)
    assert Path(scenario.recordings[0].path).is_file()


def test_a_shipped_scene_is_found_by_its_name_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert Path(load_scenario("i80").recordings[0].path).is_file()
    shipped = "there is no such file; .*: crossing, crossing_two, i80, paper$"
    with pytest.raises(MissingFileError, match=f"^i81: {shipped}"):
        load_scenario("i81")
    with pytest.raises(
        MissingFileError, match=r"^scenes/i80.toml: there is no such file; .*: crossing, crossing_two, i80, paper$"
    ):
        load_scenario("scenes/i80.toml")
    (tmp_path / "i80").mkdir()  # a folder of results called so hides no scene
    assert Path(load_scenario("i80").recordings[0].path).is_file()
    (tmp_path / "results").mkdir()
    with pytest.raises(InputError, match="results: is a folder"):
        load_scenario("results")


def test_the_distribution_lists_every_package_and_the_citation_its_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    packages = {path.parent.relative_to(ROOT).as_posix() for path in (ROOT / "blender_lidar").rglob("__init__.py")}
    listed = {name.replace(".", "/") for name in project["tool"]["setuptools"]["packages"]}
    assert listed == packages | {"blender_lidar/scenes"}
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {__version__}\n" in citation
    assert project["project"]["version"] == __version__


def test_the_paper_scene_holds_the_papers_settings():
    scenario = load_scenario(ROOT / "scenes" / "paper.toml")
    assert dict(scenario.lidar.deployment.places[0].bounds) == {"height_m": (2.0, 4.5), "tilt_x_deg": (0.0, 25.0)}
    search = scenario.search
    assert (search.particles, search.iterations) == (20, 100)
    assert (search.inertia, search.differential_weight, search.cognitive, search.social) == (0.7, 0.5, 0.3, 0.2)
    assert search.differential_threshold == 0.1
    objective = scenario.objective
    assert (objective.cell_m, objective.threshold, objective.loss) == (0.05, 0.005, -1.0)
    gates = {}
    for sensor in ("RS-16", "RS-32", "RS-80"):
        overrides = {("sensor", "name"): (sensor, "--sensor")}
        gates[sensor] = load_scenario(ROOT / "scenes" / "paper.toml", overrides).lidar.sensor.range_gate_m
    assert gates == {"RS-16": 50.0, "RS-32": 80.0, "RS-80": 150.0}  # Table I


def test_the_reference_explains_every_key_of_a_scene():
    tables = load_scenario(ROOT / "scenes" / "paper.toml").as_tables()
    tables = numbered_tables(tables)
    reference = (ROOT / "docs" / "reference" / "scene_file.md").read_text(encoding="utf-8")
    unexplained = [f"[{table}] {key}" for table, keys in tables.items() for key in keys if key not in reference]
    assert unexplained == []


def test_the_documents_name_every_sensor():
    documents = (ROOT / "docs" / "howto.md").read_text(encoding="utf-8")
    assert [name for name in model_names() if name not in documents] == []


def test_the_readme_is_read_to_its_end():
    assert len(README.split()) <= 1200


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_every_link_of_the_documents_leads_to_a_file_and_a_heading(page):
    broken = []
    for link in re.findall(r"\]\(([^)]+)\)", page.read_text(encoding="utf-8")):
        if link.startswith("http"):
            continue
        path, _, heading = link.partition("#")
        file = page.parent / path if path else page
        if not file.exists() or (heading and heading not in headings(file)):
            broken.append(link)
    assert broken == []


def headings(page: Path) -> set[str]:
    """The anchors of a page's headings, made as the hosts of code make them."""
    found = re.findall(r"(?m)^#+ (.+)$", page.read_text(encoding="utf-8"))
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in found}


def test_versions_agree():
    assert f'version = "{__version__}"' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")


# --- The tables of the reference that are made from the declarations --------------------------------------------------

MADE = "<!-- made from the declarations by `python -m tests.test_documents`; do not edit below -->\n"


def cells(*texts: str) -> str:
    return "| " + " | ".join(text.replace("|", "\\|").replace("<", "&lt;") for text in texts) + " |"


def option_rows(actions) -> list[str]:
    rows = []
    for action in actions:
        if action.help in (None, argparse.SUPPRESS) or action.dest == "help":
            continue
        name, value = (action.option_strings or [action.metavar])[0], action.metavar if action.option_strings else ""
        value = "\\|".join(action.choices) if action.choices else " ".join(value) if isinstance(value, tuple) else value
        text = action.help.replace("%%", "%")
        rows.append(f"| `{name}{f' {value}' if value and action.nargs != 0 else ''}` | {text.replace('<', '&lt;')} |")
    return rows


def options_table() -> str:
    """Every option once: those that replace a scene's keys, those that several verbs have, and each verb's own."""
    parser = argparse.ArgumentParser(prog="blender-lidar")
    subparsers = parser.add_subparsers()
    add_verbs(subparsers, VERBS)
    declared = ((one.option, table, key) for table, keys in DECLARED.items() for key, one in keys.items() if one.option)
    keys_of: dict[str, str] = {}
    for option, table, key in declared:
        keys_of.setdefault(option, f"[{table}] {key}")  # --height is the key of [deployment], not of [baseline]
    parts = ["## Every option", "", "### Options that replace a scene's keys", ""]
    listed = ", ".join(f"`{option}` for `{key}`" for option, key in keys_of.items())
    parts += [f"{listed}; [every key](scene_file.md#every-key) has its meaning."]
    rows = {}  # of each verb that is left, though it may have two names
    for verb in dict.fromkeys(subparsers.choices.values()):
        has_scene = any(action.dest == "scene" for action in verb._actions)
        own = (one for one in verb._actions if not (has_scene and keys_of.keys() & set(one.option_strings)))
        rows[verb.prog.split()[-1]] = option_rows(own)
    several = {row for row in chain(*rows.values()) if sum(row in others for others in rows.values()) > 1}
    parts += ["", "### Options of several verbs", "", "| option | meaning | verbs |", "|---|---|---|"]
    for row in dict.fromkeys(row for row in chain(*rows.values()) if row in several):
        parts.append(f"{row} {', '.join(name for name, of_verb in rows.items() if row in of_verb)} |")
    for name, of_verb in rows.items():
        own = [row for row in of_verb if row not in several]
        parts += ["", f"### {name}", "", "| option | meaning |", "|---|---|", *own] if own else []
    return "\n".join([*parts, ""])


def kind_text(declared) -> str:
    """What is no plain number or text."""
    names = {float: "number", int: "whole number", str: "text"}
    kind, parts = declared.kind, get_args(declared.kind)
    if get_origin(kind) is UnionType:
        return "number or pair"
    if get_origin(kind) is tuple:
        first = names.get(parts[0], "list" if get_origin(parts[0]) is tuple else "table")
        return f"list of {first}s" if ... in parts else f"list of {len(parts)} {first}s"
    if dataclasses.is_dataclass(kind):
        return "table" if declared.off is None else "table, or false"
    return {bool: "true or false"}.get(kind, "")


def default(declared) -> str:
    if get_origin(declared.kind) is Mapping:
        return ""
    return {...: "required", None: "", (): ""}.get(declared.default, toml_value(declared.default))


def allowed(declared) -> str:
    limits = limits_text(declared, int if declared.kind is int else float)
    text = ", ".join(declared.allowed) or limits or declared.form
    text += f', or "{declared.word}"' if declared.word else ""
    return ": ".join(filter(None, (kind_text(declared), text)))


def keys_table() -> str:
    """Every key of a scene file, table by table; those of [baseline] and of [[lidar]] are those of [deployment]."""
    parts = ["## Every key"]
    for table, settings in DECLARED.items():
        if table == "baseline":
            continue
        called = f"[{table}]"
        if table == "lidar":
            called, settings = "[[lidar]]", {key: settings[key] for key in LIDAR}
        parts += ["", f"### {called}", "", "| key | default | allowed | meaning |", "|---|---|---|---|"]
        for meaning, keys in groupby(settings.items(), lambda item: item[1].help):  # some are explained together
            names, declared = zip(*keys, strict=True)
            columns = [map("`{}`".format, names), *(map(text, declared) for text in (default, allowed))]
            parts.append(cells(*("; ".join(filter(None, dict.fromkeys(one))) for one in columns), meaning))
    return "\n".join([*parts, ""])


def toml_value(value: object) -> str:
    if dataclasses.is_dataclass(value):
        return f"{{ {', '.join(f'{key} = {toml_value(one)}' for key, one in dataclasses.asdict(value).items())} }}"
    if isinstance(value, tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value).lower() if isinstance(value, bool) else str(value)


REFERENCE = {"command_line.md": options_table, "scene_file.md": keys_table}


@pytest.mark.parametrize("name", REFERENCE)
def test_the_reference_is_what_is_declared(name):
    page = (ROOT / "docs" / "reference" / name).read_text(encoding="utf-8")
    assert page.partition(MADE)[2] == "\n" + REFERENCE[name]()


if __name__ == "__main__":
    for name, made in REFERENCE.items():
        path = ROOT / "docs" / "reference" / name
        written = path.read_text(encoding="utf-8").partition(MADE)[0].rstrip()
        path.write_text(f"{written}\n\n{MADE}\n{made()}", encoding="utf-8")
