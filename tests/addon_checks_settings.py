"""Checks that the panel is the command line: scores and runs, fields, refusals, and registering."""

from __future__ import annotations

import json
import math
import re
import shutil
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

import blender_lidar
from blender_lidar.addon import handlers, live, operators, optimising, panels, properties, scenarios, session, words
from blender_lidar.cli import main as command_line
from blender_lidar.scene.deployment import MOUNTING_OR_LEAN
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.settings import DECLARED
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Evaluator
from blender_lidar.world.blender.objects import lidars
from blender_lidar.world.blender.points import cloud_of
from tests.addon_sample import (
    FOLDER,
    FRAME,
    OPTIONS,
    POSE,
    assert_alike,
    choose,
    coordinates_of,
    evaluated,
    example,
    loaded,
    new_file,
    refused,
)
from tests.small_scene import mounting, without_times

# --- The same as the command line -------------------------------------------------------------------------------------


def check_a_scan_and_a_score_are_those_of_the_command_line():
    scene, lidar = loaded(sensor={"range_noise_m": 0.02, "dropout": 0.1, "noise_seed": 3})
    path = FOLDER / "scene" / "scene.toml"
    assert bpy.ops.blender_lidar.export_cloud(filepath=str(FOLDER / "panel.npz")) == {"FINISHED"}
    words = ["scan", str(path), "--frame", str(FRAME), "--out", str(FOLDER / "line.npz"), *OPTIONS]
    assert command_line(words) == 0
    with np.load(FOLDER / "panel.npz") as panel, np.load(FOLDER / "line.npz") as line:
        assert set(panel) == set(line)
        for name in set(line) - {"header"}:
            np.testing.assert_array_equal(panel[name], line[name], err_msg=name)
        one, other = json.loads(str(panel["header"])), json.loads(str(line["header"]))
        assert one.keys() == other.keys()
        points = line["xyz"]
        differ = {key for key in one if one[key] != other[key]}
        assert differ <= {"scene"}, (differ, one, other)
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    np.testing.assert_allclose(evaluated(cloud_of(lidar)), points, atol=2e-5)

    scenario = scenarios.scenario_from(scene, lidar)
    site = prepared(scenario, mounting(POSE))
    assert [frame.frame for frame in site.search] == [FRAME]
    with Evaluator(site.search, site.observation, site.scoring) as evaluator:
        totals = evaluator.totals([(mounting(POSE),), (scenario.lidar.baseline,)])
    group, vehicles = lidar.blender_lidar, int(totals.vehicles[0])
    assert vehicles > 0
    assert group.vehicles == vehicles
    objectives, shares = totals.objective[:, 0], totals.detectable[:, 0] / vehicles
    for shown, expected in (
        (group.objective, objectives[0]),
        (group.baseline_objective, objectives[1]),
        (group.detectable_share, shares[0]),
        (group.baseline_share, shares[1]),
    ):
        assert abs(shown - expected) <= 1e-6 * abs(expected), (shown, expected)


def prepared(scenario, hangs):
    """The one frame that the panel shows, as a run has it."""
    traffic = replace(scenario.recordings[0], frame_ids=(FRAME,), frames=None, holdout=0.0)
    return prepare(replace(scenario, recordings=(traffic,)), [hangs])


def check_an_exported_run_is_that_of_evaluate():
    loaded()
    out, line = FOLDER / "run", FOLDER / "line"
    assert bpy.ops.blender_lidar.export_run(directory=str(out)) == {"FINISHED"}
    words = ["evaluate", str(FOLDER / "scene" / "scene.toml"), "--out", str(line), *OPTIONS]
    assert command_line(words) == 0
    assert {path.name for path in out.iterdir()} <= {path.name for path in line.iterdir()}
    one, other = (without_times(json.loads((folder / "result.json").read_text())) for folder in (out, line))
    for name in ("scene", "site"):
        assert one.pop(name) != other.pop(name)  # what it is called
    for result in (one, other):  # where a scene would search, the panel says where the LiDAR hangs
        result["identity"] = {key: value for key, value in result["identity"].items() if "[lidar]" not in key}
    for key in other:
        assert one[key] == other[key], (key, one[key], other[key])
    assert (out / "vehicles.csv").read_text() == (line / "vehicles.csv").read_text()
    assert "run" in refused(bpy.ops.blender_lidar.export_run, directory=str(out))


def check_an_optimisation_is_that_of_the_command_line():
    scene = new_file()
    scene.blender_lidar.traffic.path = str(example())
    assert bpy.ops.blender_lidar.load() == {"FINISHED"}
    (lidar,) = lidars(scene)
    assert bpy.ops.blender_lidar.optimize() == {"FINISHED"}
    line = FOLDER / "line"
    assert command_line(["optimise", str(FOLDER / "scene" / "scene.toml"), "--out", str(line)]) == 0
    folders = Path(optimising.found_of(lidar)["folder"]), line
    one, other = (without_times(json.loads((folder / "result.json").read_text())) for folder in folders)
    for name in ("scene", "site"):
        assert one.pop(name) != other.pop(name)  # what it is called
    assert_alike(one, other)
    before = coordinates_of(lidar)
    assert bpy.ops.blender_lidar.apply() == {"FINISHED"}
    assert coordinates_of(lidar)["height_m"] == round(other["deployment"]["height_m"], 4)
    assert bpy.ops.blender_lidar.revert() == {"FINISHED"}
    assert coordinates_of(lidar) == before
    shutil.rmtree(folders[0])


# --- Settings ---------------------------------------------------------------------------------------------------------

TYPED = {
    "traffic": {"frames": 7, "holdout": 0.35, "block_s": 12.3, "time_step_s": 0.1, "origin_m": [0.1, -0.7]},
    "road": {"right_edge_m": 1.23, "setback_m": 2.7, "lanes": 3, "lane_width_m": 3.65, "station_m": 12.7},
    "world": {"detail": "box", "ground": False},
    "objective": {"threshold": 0.07, "cell_m": 0.15, "metric": "vgop"},
    "search": {"particles": 5, "iterations": 4, "seed": 11},
    "sensor": {"rotation_hz": 20.0, "range_gate_m": 47.3, "dropout": 0.05, "glass_dropout": 0.3, "unit": 3}
    | {"range_noise_m": 0.023, "range_at_10_percent_m": 81.7, "noise_seed": 9, "unit_spread_deg": 0.07},
    "baseline": {"height_m": 4.1, "tilt_x_deg": 13.7, "x_m": 0.3},
    "region": {"centre_m": [1.1, -2.3], "radius_m": 33.3},
}


def check_every_field_of_the_panel_comes_back_as_it_was_typed():
    scene = new_file()
    known = {
        name: {key: value for key, value in table.items() if key in DECLARED[name]} for name, table in TYPED.items()
    }
    missing = {name: set(TYPED[name]) - set(known[name]) for name in TYPED}
    assert not any(missing.values()), missing
    metric = DECLARED["objective"]["metric"].default
    known["objective"]["metric"] = metric
    known["road"].pop("setback_m")
    path = example(**known)
    first = load_scenario(path)
    tables = first.with_whole_paths()
    scenarios.fill_scene(scene, tables, "", first)
    lidar = operators.add_lidar(scene, mounting(POSE).pose)
    scenarios.fill_lidar(lidar, tables, "", first)
    for group in (scene.blender_lidar, lidar.blender_lidar):  # nothing is kept of the file, so that the fields say all
        assert group.kept
        group.kept = ""
    fields = scenarios.fields_of(scene) | {"sensor": scenarios.sensor_table(lidar)}
    for name, table in known.items():
        for key, value in table.items():
            assert fields[name][key] == value, (name, key, value, fields[name][key])
    scenario = scenarios.scenario_from(scene, lidar).as_tables()
    for name in ("road", "objective", "region", "baseline", "world", "sensor"):
        assert scenario[name] == first.as_tables()[name], name
    assert scenario["lidar"][0]["height_m"] == (2.0, 4.5)


def check_every_property_is_as_its_setting_is_declared():
    scene, lidar = loaded()
    groups = {name: (getattr(scene.blender_lidar, name), keys) for name, keys in properties.TABLES.items()}
    hung = {key: declared for key, declared in MOUNTING_OR_LEAN.items() if key != "facing_deg"}  # the file's stays
    groups |= {"sensor": (lidar.blender_lidar, properties.SENSOR), "deployment": (lidar.blender_lidar, hung)}
    groups |= {"baseline": (scene.blender_lidar.baseline, properties.SIX)}
    units = {"m": "LENGTH", "deg": "ROTATION", "s": "TIME"}
    for name, (group, keys) in groups.items():
        for key, declared in keys.items():
            found, case = group.bl_rna.properties[key], (name, key)
            told = words.TOOLTIPS.get(key, declared.help)
            assert found.description.lower() == told.lower(), case
            assert not re.search(r"`|_[a-z]+\b|that file|in place of the scene|unless \w+_", told), (case, told)
            assert found.name, case
            scale = math.radians(1.0) if key.endswith("_deg") else 1.0
            if declared.kind is float:
                assert found.unit == units.get(key.rpartition("_")[2], "NONE"), case
            if declared.kind in (int, float):
                low, high = max(declared.low, declared.above), min(declared.high, declared.below)
                assert not math.isfinite(low) or abs(found.hard_min - scale * low) <= 1e-6 * max(1, abs(low)), case
                assert not math.isfinite(high) or abs(found.hard_max - scale * high) <= 1e-6 * high or high > 2**31, (
                    case
                )
            if declared.default not in (None, ...) and declared.kind in (int, float) and name != "deployment":
                assert abs(found.default - scale * declared.default) < 1e-6 * max(1, abs(declared.default)), case
            if declared.allowed:
                assert [item.identifier for item in found.enum_items] == list(declared.allowed), case


# --- Wrong input ------------------------------------------------------------------------------------------------------


def check_wrong_input_is_one_line_and_changes_nothing():
    scene = new_file()
    scene.blender_lidar.traffic.path = "/nowhere/traffic.csv"
    assert "/nowhere/traffic.csv" in refused(bpy.ops.blender_lidar.load)
    scene.blender_lidar.traffic.path = "/nowhere/scene.toml"
    assert "/nowhere/scene.toml" in refused(bpy.ops.blender_lidar.load)
    scene.blender_lidar.traffic.path = ""
    refused(bpy.ops.blender_lidar.load)
    assert not bpy.ops.blender_lidar.scan.poll()
    scene = new_file()
    scene.unit_settings.scale_length = 0.01
    scene.blender_lidar.traffic.path = str(example())
    assert "unit scale 0.01" in refused(bpy.ops.blender_lidar.load)
    assert "unit scale 0.01" in refused(bpy.ops.blender_lidar.load_example)
    assert "unit scale 0.01" in refused(bpy.ops.blender_lidar.add)
    scene, lidar = loaded()
    choose(lidar)
    (held,) = (one for one in bpy.context.view_layer.layer_collection.children if lidar in list(one.collection.objects))
    held.exclude = True
    assert "excluded" in refused(bpy.ops.blender_lidar.add)
    held.exclude = False
    choose(lidar)
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    operations = {
        bpy.ops.blender_lidar.scan: {},
        bpy.ops.blender_lidar.export_cloud: {"filepath": str(FOLDER / "refused.npz")},
        bpy.ops.blender_lidar.export_labelled: {"directory": str(FOLDER / "refused")},
        bpy.ops.blender_lidar.export_run: {"directory": str(FOLDER / "refused")},
    }
    lidar.blender_lidar.y_m = 5.0  # in a lane
    for operation, given in operations.items():
        assert "LiDAR" in refused(operation, **given)
    lidar.blender_lidar.y_m = 0.0
    lidar.scale.x = -1.0
    bpy.context.view_layer.update()
    for operation, given in operations.items():
        assert "mirrored" in refused(operation, **given)
    lidar.scale.x = 1.0
    bpy.context.view_layer.update()
    table = FOLDER / "beams.toml"
    table.write_text("rings = 3\n", encoding="utf-8")
    lidar.blender_lidar.table_path = str(table)
    lidar.blender_lidar.name_ = "own"
    assert scene.blender_lidar.problem
    assert "\n" not in scene.blender_lidar.problem
    for operation, given in operations.items():
        assert "beams.toml" in refused(operation, **given)
    lidar.blender_lidar.table_path = str(FOLDER / "no_beams.toml")
    for operation, given in operations.items():
        assert "no_beams.toml" in refused(operation, **given)
    lidar.blender_lidar.name_ = "RS-16"
    assert not scene.blender_lidar.problem
    scene.blender_lidar.frame = 99999  # typed: the nearest there is
    assert scene.blender_lidar.frame == 59
    assert not list(FOLDER.glob("refused*"))
    bpy.data.batch_remove([*lidar.children, lidar])
    assert not bpy.ops.blender_lidar.scan.poll()


def check_a_score_is_stale_once_any_setting_that_it_was_made_with_is_another():
    scene, lidar = loaded()
    group, shared = lidar.blender_lidar, scene.blender_lidar
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    assert not panels.is_stale(scene, lidar)
    shared.search.particles, shared.traffic.frames, group.colour_by = 7, 3, "ring"  # no score depends on these
    assert not panels.is_stale(scene, lidar)
    for of, key, value in (
        (shared, "metric", "detectable"),
        (group, "name_", "RS-80"),
        (group, "dropout", 0.5),
        (group, "baseline", '{"height_m": 3.0}'),
        (shared.objective, "threshold", 0.9),
        (shared.world, "ground", False),
        (shared.region, "radius_m", 11.0),
    ):
        before = getattr(of, key)
        setattr(of, key, value)
        assert panels.is_stale(scene, lidar), key
        setattr(of, key, before)
        assert not panels.is_stale(scene, lidar), key
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "scanned.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(FOLDER / "scanned.blend"))
    assert not panels.is_stale(bpy.context.scene, lidars(bpy.context.scene)[0])


# --- Registering ------------------------------------------------------------------------------------------------------


def registered():
    """All of Blender's that an add-on may add to."""
    names = {name for name in dir(bpy.types) if "LIDAR" in name.upper()}
    handlers_ = {
        (name, str(call))
        for name in dir(bpy.app.handlers)
        if isinstance(getattr(bpy.app.handlers, name), list)
        for call in getattr(bpy.app.handlers, name)
    }
    on_types = {(kind, name) for kind in ("Scene", "Object") for name in dir(getattr(bpy.types, kind))}
    menus = {str(call) for call in bpy.types.VIEW3D_MT_add._dyn_ui_initialize()}
    timers = {call.__name__ for call in (handlers.adopt_all, live.update) if bpy.app.timers.is_registered(call)}
    return names, handlers_, on_types, menus, timers, list(properties.ON_CHANGE), live._state.drawing


def check_registering_twice_leaves_nothing():
    blender_lidar.unregister()
    before = registered()
    assert not before[0], before[0]
    for _ in range(2):
        blender_lidar.register()
        assert registered() != before
        loaded()
        assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
        blender_lidar.unregister()
        after = registered()
        for one, other in zip(before, after, strict=True):
            assert one == other, one ^ other if isinstance(one, set) else (one, other)
        assert not session._RECORDINGS
        assert not session._FRAMES
    blender_lidar.unregister()  # once more does no harm
    blender_lidar.register()


def check_fields_of_another_model_are_what_its_scene_file_says_of_it():
    new_file()
    bpy.ops.blender_lidar.load_example()
    group = scenarios.active_lidar(bpy.context.scene).blender_lidar
    for model, gate_m in (("RS-80", 150.0), ("RS-32", 80.0), ("RS-16", 50.0)):
        group.name_ = model
        assert group.range_gate_m == scenarios.sensor_of(group.id_data).range_gate_m == gate_m, model
    group.range_gate_m = 70.0
    group.name_ = "RS-80"
    assert group.range_gate_m == scenarios.sensor_of(group.id_data).range_gate_m == 70.0
