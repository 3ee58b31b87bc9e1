"""The surface: every verb, option, scene key, file, column and JSON key that users can rely on still works.

`surface.json` lists what there is. More may come; what goes must be named in `REMOVED` with its reason. All of it is
asked of the command line, whatever the modules behind it are called. ``python -m tests.test_surface`` writes the list
anew.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import importlib
import inspect
import io
import json
import re
import tempfile
import tomllib
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.cli import main
from blender_lidar.names import SEARCHES
from blender_lidar.toml_table import to_toml
from tests.labelled_samples import sample_cars, write_detections
from tests.labelled_samples import write_kitti as write_labelled
from tests.real_sweeps import cloud_of, street
from tests.real_sweeps import write_kitti as write_sweep
from tests.report_samples import Page, png
from tests.small_scene import CASTER, HEADER, traffic_rows, without_charts, write_scene, write_table

LIST = Path(__file__).with_name("surface.json")

# What is no longer there, and why: "section: entry" as it stands in the list, or how all of a group begin.
_ATTACKS = "they try the casters, whatever the scene: scripts/research/caster_attacks.py prints what comes of them"
REMOVED: dict[str, str] = {
    "stability: report.md headings: ## Casters, against the float64 oracle": _ATTACKS,
    **{f"stability: stability.json keys: findings[].numbers.{name}": _ATTACKS for name in ("raster", "embree", "bvh")},
    "stability: stability.csv rows: casters, ": _ATTACKS,
    "optimise: page parts: th: pandas": "nothing in the package imports it",
    "evaluate, every key set: page parts: h3: Expected, on the traffic that chose": "none chose a given mounting",
    "options of chart: chart --tolerance": "is --max-regret: a tolerance is an installer's error",
    "scene keys: deployment.yaw_deg accepted: [-360.0, 360.0]": "a full circle is 360 degrees",
    **{f"scene keys: deployment.{key} accepted: [-100000.0, 100000.0]": "needs a [region]" for key in ("x_m", "y_m")},
    "options of chart: chart --paired": "is --paired-errors: --paired is a flag of compare",
}

OWN_SENSOR = {
    "name": "own",
    "description": "four rings",
    "source": "made up",
    "confidence": "none",
    "aliases": ["mine"],
    "rotation_hz": [10.0, 20.0],
    "default_rotation_hz": 20.0,
    "block_time_us": 500.0,
    "columns_a_turn": [100, 200],
    "default_columns": 100,
    "range_min_m": 0.4,
    "range_max_m": 25.0,
    "range_noise_m": 0.02,
    "range_at_10_percent_m": 20.0,
    "beams": [[0, -25.0, 0.0, 0.0], [1, -15.0, 1.0, 5.0], [2, -8.0, 0.0], [3, 0.0]],
}
CSV_SENSOR = "ring,elevation_deg,azimuth_offset_deg,fire_offset_us\n0,-10,0,0\n1,0,1,5\n"
# What another key needs beside it to be accepted.
BESIDE = {
    "objective.tolerance": {"tilt_deg": 1.0},
    "world.boxes": {"centre_m": [0.0, 9.0, 1.0], "size_m": [1.0, 1.0, 1.0]},
    "world.barriers": {"kind": "concrete", "y_m": 1.0},
    "objective.zones": {"name": "merge", "polygon_m": [[0.0, 0.0], [9.0, 0.0], [9.0, 9.0]], "weight": 2.0},
}
OF_THE_TEST = ("sensor.name", "model.caster")
DE_PSO_ALONE = ("inertia", "differential_weight", "cognitive", "social", "differential_threshold")
# A scene with every key that goes with a table of boxes, and what is read back must be what was written.
EVERY_KEY = {
    "traffic": {
        "path": "traffic.csv",
        "format": "table",
        "origin_m": [1.0, 0.5],
        "heading_deg": 2.0,
        "lanes": [1, 2],
        "frames": 3,
        "time_step_s": 2.0,
        "spacing_s": 4.0,
        "holdout": 0.3,
        "block_s": 20.0,
    },
    "road": {"station_m": 10.0, "right_edge_m": 3.0, "setback_m": 1.5, "lanes": 3, "lane_width_m": 3.4},
    "world": {
        "detail": "box",
        "ground": False,
        "origin_m": [1.0, 2.0, 0.0],
        "heading_deg": 5.0,
        "boxes": [{"name": "sign", "centre_m": [3.0, 0.5, 2.0], "size_m": [0.3, 0.2, 1.0], "heading_deg": 10.0}],
        "barriers": [{"kind": "guard_rail", "y_m": 1.0, "x_m": [-20.0, 20.0]}],
    },
    "sensor": {
        "name": "own.toml",
        "rotation_hz": 20.0,
        "columns": 100,
        "range_gate_m": 20.0,
        "range_noise_m": 0.01,
        "dropout": 0.1,
        "glass_dropout": 0.5,
        "range_at_10_percent_m": 90.0,
        "unit_spread_deg": 0.1,
        "unit": 3,
        "noise_seed": 4,
    },
    "deployment": {
        "x_m": 0.5,
        "y_m": 0.1,
        "height_m": [2.0, 4.5],
        "tilt_x_deg": [0.0, 25.0],
        "tilt_y_deg": 1.0,
        "yaw_deg": 2.0,
    },
    "baseline": {"x_m": 0.2, "y_m": 0.3, "height_m": 2.5, "tilt_x_deg": 1.0, "tilt_y_deg": 0.5, "yaw_deg": 3.0},
    "objective": {
        "metric": "points",
        "reading": "paper",
        "cell_m": 0.1,
        "threshold": 0.01,
        "view": "max",
        "loss": -2.0,
        "tolerance": {"height_m": 0.05, "tilt_deg": 1.0, "yaw_deg": 1.0, "aim": "low"},
    },
    "search": {
        "method": "de-pso",
        "fidelity": "full",
        "seed": 3,
        "particles": 4,
        "iterations": 2,
        "inertia": 0.6,
        "differential_weight": 0.4,
        "cognitive": 0.2,
        "social": 0.1,
        "differential_threshold": 0.2,
    },
    "model": {"caster": "exact", "workers": 1},
}


# --- asking the program -----------------------------------------------------------------------------------------------


def ask(*words: object) -> tuple[int, str, str]:
    """Run the command line in this process: exit code, stdout, stderr."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(word) for word in words])
    return code, out.getvalue(), err.getvalue()


def done(*words: object) -> str:
    """What a command that succeeds prints on stdout."""
    code, out, err = ask(*words)
    assert code == 0, f"{' '.join(map(str, words))}: {err}"
    return out


def parser_of(*words: str) -> argparse.ArgumentParser:
    """The parser that answers ``--help`` after these words."""
    caught = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(argparse.ArgumentParser, "print_help", lambda self, file=None: caught.append(self))
        ask(*words, "--help")
    return caught[-1]


def verbs() -> list[str]:
    return [verb for action in parser_of()._actions for verb in action.choices or ()]


def options(verb: str) -> list[str]:
    """Every option with what it takes, its choices and its default."""
    found = []
    for action in parser_of(verb)._actions:
        name = "/".join(action.option_strings) or action.metavar or action.dest
        count = "flag" if action.nargs == 0 else f"takes {action.nargs or 1}"
        found.append(f"{verb} {name} {count}{', required' if action.required else ''}")
        choices = SEARCHES if name == "--search" else action.choices or ()  # which may be one's own besides
        found += [f"{verb} {name} = {choice}" for choice in choices]
        if action.default not in (None, False, argparse.SUPPRESS, []):
            found.append(f"{verb} {name} default {action.default}")
    return found


def keys(content: object, path: str = "") -> set[str]:
    """Paths of everything in a JSON document; entries of lists are alike."""
    if isinstance(content, dict):
        return {one for key, value in content.items() for one in keys(value, f"{path}.{key}" if path else key)}
    if isinstance(content, list) and any(isinstance(value, dict | list) for value in content):
        return {one for value in content for one in keys(value, f"{path}[]")}
    return set() if re.search(r"versions\.(bpy|embreex|numba)$", path) else {path}  # of what is installed


def left_in(folder: Path, name: str) -> dict[str, list[str]]:
    """Files that a verb has left, columns of its tables, keys of its documents, headings of its reports."""
    files = sorted(path.name for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    found = {f"{name}: files": files}
    for path in map(folder.joinpath, files):
        if path.suffix == ".csv":
            found[f"{name}: {path.name} columns"] = next(csv.reader(path.open(encoding="utf-8")))
        elif path.suffix == ".json" and path.name != "study.json":
            found[f"{name}: {path.name} keys"] = sorted(keys(json.loads(path.read_text())))
        elif path.suffix == ".md":
            found[f"{name}: {path.name} headings"] = re.findall(r"^#+ .*", path.read_text(), re.MULTILINE)
        elif path.name == "report.html":
            page = Page(path.read_text(encoding="utf-8"))
            found[f"{name}: page parts"] = [
                f"{tag}: {page.text(number)}" for tag in ("h2", "h3", "th") for number in page.find(tag)
            ] + [f"img: {page.elements[number][1].get('alt')}" for number in page.find("img")]
    return found


# --- scenes -----------------------------------------------------------------------------------------------------------


def write_inputs(folder: Path) -> Path:
    """A small scene with a sensor of four rings, in `folder`; returns the scene file."""
    rows = [[*row, 1 + int(row[4] > 5.0)] for row in traffic_rows()]
    write_table(folder / "traffic.csv", rows, (*HEADER, "lane"))
    (folder / "own.toml").write_text(to_toml({"x": OWN_SENSOR})[4:], encoding="utf-8")
    (folder / "own.csv").write_text(CSV_SENSOR, encoding="utf-8")
    changes = {
        "traffic": {"frames": 2},
        "deployment": {"tilt_x_deg": [0.0, 25.0]},
        "sensor": {"name": "own.toml"},
    }
    return write_scene(folder, changes)


def scene_text(key: str, value: object, name: str | None = None) -> str:
    """A scene without traffic in which a key, here perhaps called otherwise, has a value."""
    tables: dict = {"traffic": {"path": "none.csv"}, "model": {"caster": "exact"}}
    table, _, key = key.rpartition(".")
    outer, _, inner = table.partition(".")
    entry = {**BESIDE.get(table, {}), name or key: value}
    if key in DE_PSO_ALONE:
        entry["method"] = "de-pso"
    if inner in ("boxes", "barriers", "zones"):
        entry = {inner: [entry]}
    elif inner:
        entry = {inner: entry}
    tables.setdefault(outer, {}).update(entry)
    return to_toml(tables)


def said_to(folder: Path, text: str) -> str:
    """What `evaluate` says of a scene whose traffic is not there, if nothing else is wrong with it."""
    (folder / "asked.toml").write_text(text, encoding="utf-8")
    code, _, err = ask("evaluate", folder / "asked.toml", "--out", folder / "never")
    assert code == 2, text
    assert err.count("\n") == 1, err
    return err


def is_accepted(folder: Path, key: str, value: object) -> bool:
    said = said_to(folder, scene_text(key, value))
    return any(text in said for text in ("none.csv", "site.blend", "site.obj", "install"))


def is_refused(folder: Path, key: str, value: object, name: str | None = None) -> bool:
    said = said_to(folder, scene_text(key, value, name))
    return (name or key.rpartition(".")[2]) in said and "none.csv" not in said


def scene_keys(folder: Path, listed: dict) -> dict:
    """Of the keys and values that are listed, those that are accepted, or refused, as the list says."""
    asked = {"accepted": is_accepted, "refused": is_refused}
    return {
        key: {
            answer: [value for value in values[answer] if holds(folder, key, value)] for answer, holds in asked.items()
        }
        for key, values in listed.items()
    }


# --- runs of every verb -----------------------------------------------------------------------------------------------


def of_runs(folder: Path) -> dict[str, list[str]]:
    """What `optimise` and `evaluate` leave."""
    scene, out = folder / "scene.toml", folder / "optimise"
    result = json.loads(done("optimise", scene, "--out", out, "--json"))
    assert result == json.loads((out / "result.json").read_text())
    for name in ("baseline_above", "baseline_pole", "optimised_above", "optimised_pole"):
        (out / f"render_{name}.png").write_bytes(png(8, 5, 20))
    done("optimise", scene, "--out", out, "--resume")  # it has ended: its page is made again
    found = left_in(out, "optimise")
    settings = {path: value for path, value in settings_in(out / "scene.toml") if path not in OF_THE_TEST}
    found["scene.toml: defaults"] = [f"{path} = {value}" for path, value in settings.items()]
    with pytest.MonkeyPatch.context() as patch:
        without_charts(patch)
        few = ("--particles", 3, "--iterations", 2)
        done("optimise", scene, "--out", folder / "tolerance", "--tolerance", "tilt_deg=1,height_m=0.05", *few)
        found |= left_in(folder / "tolerance", "optimise --tolerance")
        done("optimise", scene, "--out", folder / "auto", "--fidelity", "auto", "--frames", 6, *few)
        found |= left_in(folder / "auto", "optimise --fidelity auto")
        (folder / "every_key.toml").write_text(to_toml(EVERY_KEY), encoding="utf-8")
        done("evaluate", folder / "every_key.toml", "--height", 4, "--tilt-x", 10, "--out", folder / "evaluate")
        found |= left_in(folder / "evaluate", "evaluate, every key set")
    return found


def settings_in(path: Path) -> list[tuple[str, object]]:
    """Dotted keys of a scene file and their values."""
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    return [
        (f"{table}.{key}", value)
        for table, entries in tables.items()
        for key, value in entries.items()
        if (table, key) != ("traffic", "path")
    ]


def of_studies(folder: Path) -> dict[str, list[str]]:
    """What `stability` and `chart` leave."""
    found = {}
    for verb, more in (("stability", ()), ("chart", ("--other-sensor", "RS-16"))):
        out = done(verb, folder / "scene.toml", "--quick", "--out", folder / verb, "--json", *more)
        found |= left_in(folder / verb, verb)
        for name in ("stability.csv", "chart.csv", "ablation.csv"):  # what is varied
            if (folder / verb / name).exists():
                rows = csv.DictReader((folder / verb / name).open(encoding="utf-8"))
                told = [[row[key] for key in ("section", "name", "what", "value") if row.get(key)] for row in rows]
                found[f"{verb}: {name} rows"] = list(dict.fromkeys(", ".join(words) for words in told))
        assert json.loads(out) == json.loads((folder / verb / f"{verb}.json").read_text())
    return found


def of_comparisons(folder: Path) -> dict[str, list[str]]:
    """What both halves of `compare` leave."""
    (folder / "sweeps").mkdir()
    for seed in (1, 2, 3):
        vehicles = street(seed)
        write_sweep(folder / "sweeps", f"00000{seed}", cloud_of(vehicles)[1], vehicles)
    out = folder / "paired"
    done("compare", "--kitti", folder / "sweeps", "--paired", "--caster", CASTER, "--details", "box,body", "--out", out)
    found = left_in(out, "compare --paired")
    if not find_spec("scipy"):
        return found
    cars = sample_cars()
    write_labelled(folder / "labelled", cars)
    write_detections(folder / "detections.csv", cars)
    words = ("--kitti", folder / "labelled", "--detections", folder / "detections.csv", "--out", folder / "detected")
    done("compare", *words, "--metrics", "pe-vgop,points,distance")
    return found | left_in(folder / "detected", "compare --detections")


def of_clouds(folder: Path) -> dict[str, list[str]]:
    """What `scan` and `score` write."""
    at = (folder / "scene.toml", "--frame", 0, "--height", 4, "--tilt-x", 10)
    suffixes = ["npz", "pcd", "ply", "bin", *(["las", "laz"] if find_spec("laspy") else [])]
    for suffix in suffixes:
        done("scan", *at, "--out", folder / f"cloud.{suffix}")
    found = {"scan: cloud files": sorted(path.name for path in folder.glob("cloud.*"))}
    with np.load(folder / "cloud.npz") as cloud:
        kinds = [(name, cloud[name].dtype, cloud[name].ndim) for name in cloud.files]
        sizes = [f"{name} {of.kind}{of.itemsize if of.kind in 'fiu' else ''} {axes}-d" for name, of, axes in kinds]
        found["scan: cloud.npz arrays"] = sizes
        found["scan: cloud.npz header"] = sorted(keys(json.loads(str(cloud["header"]))))
    pcd, ply = (folder / f"cloud.{kind}" for kind in ("pcd", "ply"))
    lines = pcd.read_bytes().split(b"DATA")[0].decode().splitlines()
    found["scan: cloud.pcd header"] = [line for line in lines if line.split()[0] in ("FIELDS", "SIZE", "TYPE", "COUNT")]
    lines = ply.read_bytes().split(b"end_header")[0].decode().splitlines()
    found["scan: cloud.ply header"] = [line for line in lines if line.startswith(("format", "property"))]
    if "las" in suffixes:
        import laspy

        found["scan: cloud.las dimensions"] = list(laspy.read(folder / "cloud.las").point_format.dimension_names)
    for kind in [*suffixes, "sustechpoints"]:
        done("scan", folder / "scene.toml", "--frame-ids", "0,1", "--format", kind, "--out", folder / f"many_{kind}")
        files = sorted(path for path in (folder / f"many_{kind}").rglob("*") if path.is_file())
        found[f"scan --format {kind}: files"] = [str(path.relative_to(folder / f"many_{kind}")) for path in files]
    label = json.loads((folder / "many_sustechpoints" / "label" / "000000.json").read_text())
    found["scan: label keys"] = sorted(keys(label))
    boxes = ("--points", folder / "cloud.npz", "--boxes", folder / "traffic.csv", "--frame", 0)
    words = (*boxes, "--metric", "all", "--lidar", 0, 0, "--out", folder / "scores.csv", "--json")
    found["score --json: keys"] = sorted(keys(json.loads(done("score", *words))))
    found["score: columns"] = next(csv.reader((folder / "scores.csv").open()))
    done("score", *boxes[:1], folder / "cloud.pcd", *boxes[2:], "--assign", "box")
    return found


def of_the_rest(folder: Path) -> dict[str, list[str]]:
    """What `sensors`, `init`, `doctor` and `build` say and write, and the door for Python."""
    models = json.loads(done("sensors", "--json"))
    if find_spec("matplotlib"):
        done("sensors", "RS-16", "--out", folder / "fan.png")
    done("init", folder / "proposed", folder / "traffic.csv")
    own = json.loads(done("sensors", folder / "own.toml", "--json"))
    found = {
        "sensors: names": [name for model in models for name in (model["name"], *model["aliases"])],
        "sensors --json: keys": sorted(keys(models)),
        "sensors NAME --json: keys": sorted(keys(own)),
        "sensors: files": sorted(path.name for path in folder.glob("fan.*")),
        "init: files": sorted(path.name for path in (folder / "proposed").iterdir()),
        "doctor: lines": re.findall(r"^(?:  |caster )[\w-]+", ask("doctor")[1], re.MULTILINE),
    }
    assert all(own[key] == OWN_SENSOR[key] for key in own.keys() & OWN_SENSOR.keys() - {"beams"})
    assert len(json.loads(done("sensors", folder / "own.csv", "--json"))["beams"]) == 2
    for key in OWN_SENSOR:
        (folder / "odd.toml").write_text(
            to_toml({"x": {f"{name}{'_' * (name == key)}": value for name, value in OWN_SENSOR.items()}})[4:]
        )
        code, _, err = ask("sensors", folder / "odd.toml")
        assert code == 2, key
        assert f"{key}_" in err
    if find_spec("bpy"):
        done("build", folder / "scene.toml", "--frame-ids", "0,1", "--height", 4, "--out", folder / "site.blend")
        found["build: files"] = sorted(path.name for path in folder.glob("site.blend"))
    for name in PYTHON:
        module, _, function = name.rpartition(".")
        signature = inspect.signature(getattr(importlib.import_module(f"blender_lidar.{module}"), function))
        found[f"python: {name}"] = [
            f"{one.name}" + (f" = {one.default}" if one.default is not one.empty else "")
            for one in signature.parameters.values()
        ]
    return found


PYTHON = (
    *(f"metrics.vgop.{name}" for name in ("to_vehicle_frame", "occupancy", "entropy", "pe_vgop")),
    "optimise.de_pso",
    "optimise.maximise",
)
PARTS = (of_runs, of_studies, of_comparisons, of_clouds, of_the_rest)


# --- the tests --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def listed() -> dict:
    return json.loads(LIST.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("surface")
    write_inputs(folder)
    return folder


def missing(section: str, wanted: list, present: list) -> list[str]:
    """What is listed in a section and no longer there, but for what is removed on purpose."""
    gone = [f"{section}: {entry}" for entry in wanted if entry not in present]
    return [entry for entry in gone if not any(entry.startswith(removed) for removed in REMOVED)]


def can_be_there(section: str, entry: str) -> bool:
    """Whether the extra that an entry of the list needs is installed."""
    needs = {
        "laspy": r"\blas|\blaz",
        "bpy": "build: |: bpy$",
        "matplotlib": r"\.png|img: Chart|h2: (How sure|What the beams)",
        "scipy": ": scipy$|compare --detections",
        "embreex": ": embreex$",
    }
    return all(find_spec(name) for name, pattern in needs.items() if re.search(pattern, f"{section}: {entry}"))


def test_every_verb_and_option_is_there(listed):
    assert not missing("verbs", listed["verbs"], verbs())
    for verb in listed["verbs"]:
        section = f"options of {verb}"
        assert not missing(section, listed[section], options(verb))


def test_every_scene_key_takes_what_it_took_and_refuses_what_it_refused(listed, folder):
    wanted = listed["scene keys"]
    found = scene_keys(folder, wanted)
    for key, values in wanted.items():
        for answer, given in values.items():
            assert not missing(f"scene keys: {key} {answer}", given, found[key][answer])


def test_an_unknown_scene_key_is_refused_by_name(listed, folder):
    tables = {}
    for key, values in listed["scene keys"].items():
        tables.setdefault(key.rpartition(".")[0], (key, values["accepted"][0]))
    for key, value in tables.values():
        assert is_refused(folder, key, value, name=f"{key.rpartition('.')[2]}x"), key
    assert "nonsense" in said_to(folder, '[traffic]\npath = "none.csv"\n[nonsense]\n')


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.__name__)
def test_everything_that_a_verb_leaves_is_there(listed, folder, part):
    if part is of_studies and CASTER == "exact":
        pytest.skip("no fast caster is installed")
    found = part(folder)
    for section, wanted in listed["leaves"][part.__name__].items():
        wanted = [entry for entry in wanted if can_be_there(section, entry)]
        assert not missing(section, wanted, found.get(section, []))


def test_a_run_keeps_every_setting_that_its_scene_gives(folder):
    if not (folder / "evaluate").exists():
        of_runs(folder)
    kept = dict(settings_in(folder / "evaluate" / "scene.toml"))
    for path, value in settings_in(folder / "every_key.toml"):
        if path != "sensor.name":
            assert kept[path] == value, path


# --- writing the list -------------------------------------------------------------------------------------------------


def write_list(folder: Path) -> None:
    """Write the list anew; the values that scene keys take are kept as they stand there."""
    write_inputs(folder)
    old = json.loads(LIST.read_text(encoding="utf-8"))
    content = {
        "verbs": verbs(),
        **{f"options of {verb}": options(verb) for verb in verbs()},
        "scene keys": scene_keys(folder, old["scene keys"]),
        "leaves": {part.__name__: part(folder) for part in PARTS},
    }
    runs = content["leaves"]["of_runs"]
    for section, entries in list(runs.items()):  # what the usual run has too is listed once
        usual = runs.get(f"optimise: {section.partition(': ')[2]}", [])
        if not section.startswith("optimise: "):
            runs[section] = [entry for entry in entries if entry not in usual]
        if not runs[section]:
            del runs[section]
    LIST.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        write_list(Path(place))
