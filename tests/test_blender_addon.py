"""A scene file that is loaded in the add-on is the scene of the command line, whatever the panel has fields for."""

from __future__ import annotations

import ast
import json
import math
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blender_lidar.addon import gizmos, live, optimising, properties, scenarios, session
from blender_lidar.cli import main as command_line
from blender_lidar.document import document_from
from blender_lidar.report.text import short_lines
from blender_lidar.run.answer import doubt
from blender_lidar.run.verdict import POINTS
from blender_lidar.scene.mounting import COORDINATES
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.toml_table import read_toml, to_toml
from blender_lidar.world.blender.objects import lidars
from tests.six_scenes import SCENES
from tests.small_scene import REGION, without_times, write_scene
from tests.test_heights import SLOPE
from tests.test_heights import scene as height_scene
from tests.test_sides import scene as two_way

pytestmark = [pytest.mark.usefixtures("registered_addon"), pytest.mark.versions]


def loaded(path: Path):
    """A scene file loaded in the open file; the LiDAR that hangs there then."""
    bpy.context.scene.blender_lidar.traffic.path = str(path)
    assert bpy.ops.blender_lidar.load() == {"FINISHED"}
    return lidars(bpy.context.scene)[0]


def scenario():
    scene = bpy.context.scene
    return scenarios.scenario_from(scene, lidars(scene)[0], here=False)


def saved_and_opened(folder: Path):
    """The open file saved beside the scene and opened again; its LiDAR."""
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "saved.blend"))
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(folder / "saved.blend"))
    return lidars(bpy.context.scene)[0]


def result_of(folder) -> dict:
    """The result of a run but for what it is called and how long it took."""
    result = json.loads((Path(folder) / "result.json").read_text(encoding="utf-8"))
    return {key: value for key, value in without_times(result).items() if key not in ("scene", "site")}


def in_the_median(folder: Path) -> Path:
    """Two carriageways, of left-hand traffic, and a mast between them that faces the one that comes the other way."""
    return two_way(folder, turned=True, road={"drives_on": "left"}, deployment={"side": "median", "facing_deg": 270.0})


def at_an_intersection(folder: Path) -> Path:
    """The corner of a crossing by its net; the mast faces the middle."""
    pytest.importorskip("sumolib", reason="sumolib, of the extra maps, is not installed")
    scenes = Path(__file__).parents[1] / "scenes"
    path = folder / "corner.toml"
    settings = {
        "traffic": {"path": str(scenes / "crossing_sample.xml.gz"), "format": "sumo", "frames": 3, "block_s": 90.0},
        "road": {"net": str(scenes / "crossing.net.xml.gz")},
        "region": {"junction": "middle"},
        "sensor": {"name": "RS-16", "range_gate_m": 60.0},
        "deployment": {"x_m": 19.0, "y_m": 19.0, "height_m": [2.0, 6.0], "tilt_x_deg": 10.0, "installer": False},
        "search": {"particles": 4, "iterations": 2},
    }
    path.write_text(to_toml(settings))
    return path


def on_a_slope(folder: Path) -> Path:
    """A map with heights: a mast at 62 m."""
    scene = height_scene(folder, SLOPE, caster="bvh", height_m=[3.0, 5.0], tilt_x_deg=10.0, installer=False)
    path, tables = folder / "slope.toml", scene.with_whole_paths()
    path.write_text(to_toml({**tables, "search": {**tables["search"], "particles": 4, "iterations": 2}}))
    return path


MADE = {**SCENES, "in the median": in_the_median, "at an intersection": at_an_intersection, "on a slope": on_a_slope}


@pytest.mark.parametrize("made", MADE.values(), ids=MADE)
def test_optimise_and_scan_are_those_of_the_command_line(made, tmp_path):
    path = made(tmp_path)
    lidar = loaded(path)
    table = properties.mounting_of(lidar).as_table()
    place = {key: table[key] for key in COORDINATES}
    assert bpy.ops.blender_lidar.export_cloud(filepath=str(tmp_path / "panel.npz")) == {"FINISHED"}
    frame = bpy.context.scene.blender_lidar.frame
    options = [f"--{key.rpartition('_')[0].replace('_', '-')}={value}" for key, value in place.items()]
    words = ["scan", str(path), "--frame", str(frame), "--out", str(tmp_path / "line.npz"), *options]
    assert command_line(words) == 0
    with np.load(tmp_path / "panel.npz") as panel, np.load(tmp_path / "line.npz") as line:
        for name in set(line) - {"header"}:
            np.testing.assert_array_equal(panel[name], line[name], err_msg=name)
    lidar = saved_and_opened(tmp_path)
    assert bpy.ops.blender_lidar.optimize() == {"FINISHED"}
    assert command_line(["optimise", str(path), "--out", str(tmp_path / "line")]) == 0
    assert result_of(bpy.path.abspath(optimising.found_of(lidar)["folder"])) == result_of(tmp_path / "line")


@pytest.mark.parametrize("made", SCENES.values(), ids=SCENES)
def test_what_is_loaded_survives_saving_and_undo_and_is_scored_live(made, tmp_path):
    path = made(tmp_path)
    expected = load_scenario(path).as_tables()
    loaded(path)
    assert scenario().as_tables() == expected
    bpy.ops.ed.undo_push(message="loaded")
    bpy.context.scene.blender_lidar.search.seed += 1
    bpy.ops.ed.undo_push(message="changed")
    assert scenario().as_tables()["search"] == expected["search"] | {"seed": expected["search"]["seed"] + 1}
    bpy.ops.ed.undo()
    assert scenario().as_tables() == expected
    lidar = saved_and_opened(tmp_path)
    assert scenario().as_tables() == expected
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    scanned = lidar.blender_lidar.objective, lidar.blender_lidar.points
    lidar.blender_lidar.live = True
    bpy.context.view_layer.update()
    live.update()
    assert bpy.context.scene.blender_lidar.problem == ""
    assert (lidar.blender_lidar.objective, lidar.blender_lidar.points) == scanned


def test_a_field_that_is_changed_replaces_the_files_setting_and_nothing_else(tmp_path):
    path = SCENES["utm_polygon"](tmp_path)
    lidar, group, expected = loaded(path), bpy.context.scene.blender_lidar, load_scenario(path).as_tables()
    group.traffic.frames, group.traffic.origin_m = 7, "565432.5, 5812345.625"
    lidar.blender_lidar.y_m, lidar.blender_lidar.height_m_high = -0.5, 5.0
    found = scenario().as_tables()
    assert found["traffic"] == expected["traffic"] | {"frames": 7, "origin_m": (565432.5, 5812345.625)}
    assert found["lidar"][0] == expected["lidar"][0] | {"y_m": -0.5, "height_m": (2.0, 5.0)}
    assert found["region"] == expected["region"]
    group.traffic.origin_m = "east"
    with pytest.raises(properties.InputError, match="LiDAR panel: Traffic, Origin: is 'east'; allowed: a list of 2"):
        scenario()


def test_a_file_that_says_little_leaves_the_rest_to_the_defaults(tmp_path):
    path = write_scene(tmp_path, REGION)
    kept = [part for part in path.read_text().split("\n[") if part.partition("]")[0] in ("[traffic", "road", "region")]
    path.write_text("\n[".join(kept), encoding="utf-8")
    loaded(path)
    assert scenario().as_tables() == load_scenario(path).as_tables()
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}


def test_another_place_model_or_metric_leaves_open_what_the_file_left_open(tmp_path):
    path = write_scene(tmp_path, REGION | {"sensor": {"range_gate_m": None, "range_noise_m": "datasheet"}})
    lidar, scene = loaded(path), bpy.context.scene
    before = scenario()
    lidar.blender_lidar.name_, scene.blender_lidar.metric = "VLP-16", "detectable"
    for key in ("height_m", "tilt_x_deg", "tilt_y_deg", "x_m"):
        setattr(lidar.blender_lidar, f"{key}_on", True)
    given = {("sensor", "name"): ("VLP-16", "--sensor"), ("objective", "metric"): ("detectable", "--metric")}
    line = load_scenario(path, given)
    assert scenario().lidar.sensor.range_noise_m == line.lidar.sensor.range_noise_m != before.lidar.sensor.range_noise_m
    assert scenario().objective == line.objective != before.objective
    assert scenario().search.seeds == 3 != before.search.seeds


def test_what_several_recordings_cannot_share_is_refused_by_name(tmp_path):
    loaded(SCENES["two_recordings_with_poles"](tmp_path))
    group = bpy.context.scene.blender_lidar
    group.traffic.path = str(tmp_path / "evening.csv")
    with pytest.raises(RuntimeError, match="LiDAR panel: Traffic, File: is of one recording, but the scene has 2"):
        bpy.ops.blender_lidar.load()


def test_a_setting_without_a_field_is_shown_and_an_error_in_it_names_the_file(tmp_path):
    path = SCENES["weights_zones_and_installer"](tmp_path)
    lidar, scene = loaded(path), bpy.context.scene
    shown = scenarios.without_field(scene, lidar)
    assert {"[objective] classes, class_weights, zones, loss, view", "[deployment] installer"} <= set(shown)
    assert scenario().installers == load_scenario(path).installers
    kept = properties.kept_of(scene.blender_lidar)
    tables = {**kept.tables, "objective": {"loss": 2e9}}
    properties.keep_tables(scene.blender_lidar, tables, kept.folder, scenarios.fields_of(scene))
    with pytest.raises(properties.InputError, match=r"scene.toml: \[objective\] loss: is 2000000000.0; allowed: "):
        scenario()


def test_keys_of_a_road_that_has_no_fields_are_kept_and_shown(tmp_path):
    scene, given = bpy.context.scene, {"net": "town.net.xml", "origin_m": [100.0, 200.0]}
    properties.keep_tables(scene.blender_lidar, {"road": given}, "", scenarios.fields_of(scene))
    assert properties.road_table(scene) == given
    assert "[road] net, origin_m" in scenarios.without_field(scene, None)
    scene.blender_lidar.road.lanes = 3
    assert properties.road_table(scene) == given | {"lanes": 3}


def test_the_crown_is_there_wherever_a_live_lidar_is_dragged(tmp_path):
    lidar = loaded(SCENES["slope_and_crown"](tmp_path))
    lidar.blender_lidar.live = True
    for x_m in (0.0, 50.0, 130.0, 131.0):
        lidar.blender_lidar.x_m = x_m
        bpy.context.view_layer.update()
        live.update()
        xyz = live._state.shown[scenarios.uid_of(lidar)].look.cloud.xyz
        assert bpy.ops.blender_lidar.export_cloud(filepath=str(tmp_path / "cloud.npz")) == {"FINISHED"}
        with np.load(tmp_path / "cloud.npz") as line:
            np.testing.assert_allclose(xyz, line["xyz"], rtol=0.0, atol=1e-9, err_msg=str(x_m))
            assert ((line["vehicle_id"] < 0) & (line["xyz"][:, 2] > 0.01)).sum() > 50, x_m


def test_a_run_stays_beside_a_saved_file_and_its_report_opens(tmp_path, monkeypatch):
    path = SCENES["circle"](tmp_path)
    loaded(path)
    lidar = saved_and_opened(tmp_path)
    assert bpy.ops.blender_lidar.optimize() == {"FINISHED"}
    assert optimising.run_of(lidar) == tmp_path / "saved_runs" / "LiDAR_1"
    assert (tmp_path / "saved_runs" / "LiDAR_1" / "report.html").is_file()
    opened = []
    monkeypatch.setattr("bpy.ops.wm.url_open", lambda url: opened.append(url), raising=False)
    saved_and_opened(tmp_path)
    assert bpy.ops.blender_lidar.open_report() == {"FINISHED"}


@pytest.mark.parametrize("name", ["circle", "slope_and_crown"])
def test_the_panel_doubts_what_the_page_doubts_and_speaks_of_a_lean_where_the_scene_does(name, tmp_path):
    command_line(["optimise", str(SCENES[name](tmp_path)), "--out", str(tmp_path / "run")])
    result = json.loads((tmp_path / "run" / "result.json").read_text(encoding="utf-8"))
    lines, why = short_lines(document_from(result["document"])), doubt(result)
    assert why  # few vehicles
    assert f"{why}." in lines
    assert why in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    place = next(line for line in lines if line.startswith("Best found: "))
    assert ("leaning" in place, "tilted" in place) == (name == "slope_and_crown", name == "circle")


def test_how_long_it_takes_is_said_from_the_searchs_own_rate(tmp_path, monkeypatch):
    loaded(SCENES["circle"](tmp_path))
    scene = bpy.context.scene
    job = optimising.begin(scene, bpy.context.view_layer, lidars(scene)[0])
    try:
        assert job.total == 4 * 2 + math.prod(POINTS)
        clock = iter([0.0, 1.0, 3.0, 3.0, 4.0])
        monkeypatch.setattr(optimising.time, "monotonic", lambda: next(clock))
        assert job.outlook == "Reading traffic and preparing."
        for done in (10, 20, 40):
            job._hear({"done": done, "best": 1.0})
            assert done == 40 or job.outlook == ""
        assert job.outlook == f"About {(job.total - 40) / 10.0:.0f} s left"
        job._hear({"done": job.total, "best": 1.0})
        assert job.outlook.startswith("Judging")  # not "0 s left"
    finally:
        monkeypatch.undo()
        job.stop()


# --- Python files, vehicles left out, and runs of files that were not saved -------------------------------------------

OWN = """
import pathlib
from blender_lidar import metric
pathlib.Path(__file__).with_name("ran").touch()

@metric(label="hits")
def hits(vehicles):
    return vehicles.count
"""


def test_a_scene_runs_its_python_file_only_after_a_yes_and_again_only_as_it_was(tmp_path):
    path, own, ran = SCENES["circle"](tmp_path), tmp_path / "own.py", tmp_path / "ran"
    tables = read_toml(path)
    tables.setdefault("objective", {})["metric"] = "own.py:hits"
    path.write_text(to_toml(tables))
    own.write_text(OWN)
    scene = bpy.context.scene
    scene.blender_lidar.traffic.path = str(path)
    with pytest.raises(RuntimeError, match=r"is Python code that the scene runs; allowed after Run own\.py"):
        bpy.ops.blender_lidar.load()
    assert scenarios.untrusted(scene) == [own]
    assert not ran.exists()
    assert bpy.ops.blender_lidar.run_file(filepath=str(own)) == {"FINISHED"}
    loaded(path)
    assert scenarios.untrusted(scene) == []
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    assert ran.exists()
    ran.unlink()
    own.write_text(OWN + "# changed")
    saved_and_opened(tmp_path)
    assert scenarios.untrusted(bpy.context.scene) == [own]
    with pytest.raises(RuntimeError, match=r"allowed after Run own\.py"):
        bpy.ops.blender_lidar.scan()
    assert not ran.exists()


def test_vehicles_that_are_left_out_are_neither_there_nor_counted(tmp_path):
    lidar, scene = loaded(SCENES["circle"](tmp_path)), bpy.context.scene
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    before, ids = lidar.blender_lidar.vehicles, session.vehicles_of(scene).vehicle_id
    counted = session.live_frame(scene, lidar).frame
    out = int(counted.vehicle_id[counted.counted][0])
    scene.blender_lidar.traffic.leave_out = f"{out}"
    assert scenarios.scenario_from(scene).recordings[0].leave_out == (out,)
    assert set(session.vehicles_of(scene).vehicle_id) == set(ids) - {out}
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    assert lidar.blender_lidar.vehicles == before - 1
    scene.blender_lidar.traffic.leave_out = "987654321"
    with pytest.raises(RuntimeError, match=r"Traffic, Leave Out: .* has no vehicle 987654321"):
        bpy.ops.blender_lidar.scan()


def test_the_run_of_an_unsaved_file_is_moved_beside_it_when_it_is_saved(tmp_path):
    lidar = loaded(SCENES["circle"](tmp_path))
    lidar.blender_lidar.found = ""
    assert bpy.ops.blender_lidar.optimize() == {"FINISHED"}
    before = optimising.run_of(lidar)
    assert before.is_dir()
    lidar = saved_and_opened(tmp_path)
    assert not before.exists()
    assert optimising.run_of(lidar).parent == tmp_path / "saved_runs"
    assert (optimising.run_of(lidar) / "report.html").is_file()


def test_nothing_of_ours_is_translated_by_halves():
    for name in dir(bpy.types):
        if name.startswith("BLENDER_LIDAR_"):
            made = getattr(bpy.types, name)
            assert made.bl_translation_context == properties.CONTEXT, name
            kind, _, called = name.removeprefix("BLENDER_LIDAR_").partition("_")
            rna = getattr(bpy.ops.blender_lidar, called).get_rna_type() if kind == "OT" else made.bl_rna
            own = [one for one in rna.properties if one.identifier in getattr(made, "__annotations__", ())]
            assert all(one.translation_context == properties.CONTEXT for one in own), name
    folder = Path(optimising.__file__).parent
    for path in folder.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "attr", "") in ("label", "prop", "operator", "menu"):
                given = {word.arg: word.value for word in node.keywords}
                assert not getattr(given.get("translate"), "value", True), (path.name, node.lineno)
                if node.func.attr in ("prop", "label"):  # a property's own name Blender 3.4 translates all the same
                    assert "text" in given, (path.name, node.lineno)


def test_presets_keep_a_sensor_with_its_noise(tmp_path, monkeypatch):
    monkeypatch.setattr("bpy.utils.user_resource", lambda *_, **__: str(tmp_path))
    group = loaded(SCENES["circle"](tmp_path)).blender_lidar
    group.name_, group.dropout, group.range_gate_m = "VLP-16", 0.25, 40.0
    assert bpy.ops.blender_lidar.add_preset(name="Old VLP") == {"FINISHED"}
    (kept,) = tmp_path.rglob("*.py")
    group.name_, group.dropout, group.range_gate_m = "RS-16", 0.0, 60.0
    exec(kept.read_text())
    assert (group.name_, group.dropout, group.range_gate_m) == ("VLP-16", 0.25, 40.0)


def test_gizmos_read_and_write_the_fields_of_the_active_lidar(tmp_path):
    lidar = loaded(SCENES["circle"](tmp_path))
    for key, value in (("height_m", 3.5), ("tilt_x_deg", 0.25), ("range_gate_m", 42.0)):
        gizmos._set(key, value)
        bpy.context.view_layer.update()
        assert gizmos._value(key) == pytest.approx(value, abs=1e-4)
    assert properties.mounting_of(lidar).height_m == pytest.approx(3.5)
    gizmos._set("range_gate_m", -3.0)
    assert lidar.blender_lidar.range_gate_m == pytest.approx(0.1)
    bpy.data.objects.remove(lidar)  # in a drag
    gizmos._set("height_m", 4.0)
    assert gizmos._value("height_m") == 0.0
