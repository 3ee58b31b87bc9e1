"""Several LiDARs in the add-on: loaded, scored together and live, searched, hung, and built as one layout."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blender_lidar.addon import live, optimising, panels, properties, scenarios
from blender_lidar.clouds.live import LiveFrame
from blender_lidar.run.folder import RunFolder
from blender_lidar.run.optimise import optimise_site
from blender_lidar.scene.mounting import COORDINATES
from blender_lidar.scene.scenario import load_scenario, scenario_of
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Evaluator
from blender_lidar.toml_table import read_toml, to_toml
from blender_lidar.world.blender.objects import SENSOR, lidars, role
from blender_lidar.world.blender.points import cloud_of
from tests.small_scene import REGION, cli, without_times, write_scene

SOUTH = {"name": "south", "height_m": [2.0, 4.5], "tilt_x_deg": 15.0, "x_m": -6.123456789}
NORTH = {"name": "north", "sensor": "RS-32", "x_m": 7.0, "y_m": -0.25, "height_m": 3.0, "tilt_x_deg": [0.0, 20.0]}
NORTH |= {"baseline": {"height_m": 2.5, "tilt_x_deg": 5.0}}


def write_layout(folder: Path, *more: dict, hung=(SOUTH, NORTH), **changes: dict) -> Path:
    """The small scene with several LiDARs, whose order is not that of their names."""
    few = {"traffic": {"frames": 4}, "search": {"particles": 4, "iterations": 8}, **REGION, **changes}
    path = write_scene(folder, few)
    tables = {name: table for name, table in read_toml(path).items() if name != "deployment"}
    path.write_text(to_toml({**tables, "lidar": [*hung, *more]}), encoding="utf-8")
    return path


pytestmark = [pytest.mark.usefixtures("registered_addon"), pytest.mark.versions]


def loaded(path: Path) -> dict[str, object]:
    """A scene file loaded in the open file; its LiDARs by name."""
    bpy.context.scene.blender_lidar.traffic.path = str(path)
    assert bpy.ops.blender_lidar.load() == {"FINISHED"}
    return {lidar.name: lidar for lidar in lidars(bpy.context.scene)}


def layout(here=False):
    scene = bpy.context.scene
    return scenarios.layout_scenario(scene, scenarios.layout_of(scene, scenarios.active_lidar(scene)), here=here)


def moved(lidar=None, **place):
    for key, value in place.items():
        setattr(lidar.blender_lidar, key, value)
    bpy.context.view_layer.update()
    live.update()
    return told()


def told() -> dict:
    text = bpy.context.scene.blender_lidar.fused
    return json.loads(text) if text else {}


def of_the_run(scenario, *layouts):
    """What layouts are worth on the frame that is shown, as a run scores it: objective and detectable share."""
    frame = bpy.context.scene.blender_lidar.frame
    scenario = scenario_of(
        scenario.with_whole_paths(),
        overrides={("traffic", "frame_ids"): ((frame,), "test"), ("traffic", "holdout"): (0.0, "test")},
    )
    site = prepare(scenario, layouts[0])
    with Evaluator(site.search, site.observation, site.scoring) as evaluator:
        totals = evaluator.totals(list(layouts))
    return [
        {"objective": objective, "share": detectable / totals.vehicles[0]}
        for objective, detectable in zip(totals.objective[:, 0], totals.detectable[:, 0], strict=True)
    ]


def run_of(path: Path, folder: Path) -> dict:
    """The result of the command line's search."""
    with RunFolder(folder).begun() as run:
        optimise_site(prepare(load_scenario(path)), run, SimpleNamespace(searching=id, mapping=id))
    return json.loads((folder / "result.json").read_text())


def assert_worth(found, expected):
    assert found["objective"] == pytest.approx(expected["objective"], rel=1e-6)
    assert found["share"] == pytest.approx(expected["share"], rel=1e-6)


def test_a_scene_with_several_lidars_is_loaded_as_it_is_and_written_as_it_was(tmp_path):
    path = write_layout(tmp_path)
    expected, hung = load_scenario(path).as_tables(), loaded(path)
    assert list(hung) == ["north", "south"]
    assert [one.name for one in scenarios.layout_of(bpy.context.scene, hung["north"])] == ["south", "north"]
    assert layout().as_tables() == expected
    loaded(path)
    assert len(lidars(bpy.context.scene)) == 2
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    assert layout().as_tables() == expected
    assert bpy.ops.blender_lidar.export_run(directory=str(tmp_path / "run")) == {"FINISHED"}
    written = load_scenario(tmp_path / "run" / "scene.toml").as_tables()
    assert {name: written[name] for name in ("lidar", "sensor", "region")} == {
        name: expected[name] for name in ("lidar", "sensor", "region")
    }


def test_scan_gives_the_fused_score_of_the_run_and_that_of_each_alone(tmp_path):
    hung = loaded(write_layout(tmp_path, sensor={"dropout": 0.2}))
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    scenario, scene = layout(), bpy.context.scene
    south, north = (properties.mounting_of(hung[name]) for name in ("south", "north"))
    together, base, *alone = of_the_run(scenario, (south, north), scenario.baselines, (south, None), (None, north))
    assert_worth(told()["now"], together)
    assert_worth(told()["baseline"], base)
    for name, worth in zip(("south", "north"), alone, strict=True):
        group = hung[name].blender_lidar
        assert_worth({"objective": group.objective, "share": group.detectable_share}, worth)
    assert together["share"] >= max(one["share"] for one in alone)
    assert cloud_of(hung["south"]) != cloud_of(hung["north"])
    lines = panels.fused_lines(scene, hung["north"])
    assert lines[:2] == ["Layout of 2:", f"Objective {together['objective']:.2f}"]
    assert "Changed since: scan again." not in lines
    hung["south"].blender_lidar.height_m += 0.5
    assert panels.fused_lines(scene, hung["north"])[-1] == "Changed since: scan again."


def test_while_one_is_dragged_the_others_are_not_cast_again_and_the_score_is_that_of_scan(tmp_path, monkeypatch):
    hung = loaded(write_layout(tmp_path))
    hung["north"].blender_lidar.live = True
    before, looks = moved(), []
    held, look = live._state.shown[scenarios.uid_of(hung["south"])].look, LiveFrame.look
    monkeypatch.setattr(LiveFrame, "look", lambda self, *given: looks.append(self) or look(self, *given))
    after = moved(hung["north"], height_m=4.4, tilt_x_deg=0.3)
    assert len(looks) == 1
    assert live._state.shown[scenarios.uid_of(hung["south"])].look is held
    assert after["now"] != before["now"]
    assert after["baseline"] == before["baseline"]
    monkeypatch.undo()
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    assert told() == after
    hung["south"].location.z = -1.0
    assert moved() == {}
    assert "above the ground" in bpy.context.scene.blender_lidar.problem
    assert moved(hung["north"], height_m=4.0) == {}  # one that hangs well does not speak for the other
    assert "above the ground" in bpy.context.scene.blender_lidar.problem
    hung["south"].location.z = 3.0
    assert moved()["now"]["objective"] != 0.0
    assert bpy.context.scene.blender_lidar.problem == ""
    hung["north"].blender_lidar.live = False
    live.update()
    assert not live._state.shown


def test_a_lidar_that_joins_the_layout_counts_in_it_and_one_that_leaves_does_not(tmp_path):
    hung, scene = loaded(write_layout(tmp_path)), bpy.context.scene
    scene.cursor.location = (0.0, -0.5, 3.0)
    assert bpy.ops.blender_lidar.add() == {"FINISHED"}
    added = scenarios.active_lidar(scene)
    assert not added.blender_lidar.in_layout
    assert scenarios.layout_of(scene, added) == [added]
    added.blender_lidar.in_layout, added.name, added.blender_lidar.range_gate_m = True, "the third", 20.0
    added.blender_lidar.rotation_hz, added.blender_lidar.tilt_x_deg_on = hung["south"].blender_lidar.rotation_hz, False
    assert [one.name for one in layout().lidars] == ["south", "north", "the_third"]
    assert layout().lidars[2].baseline.height_m == pytest.approx(scene.blender_lidar.baseline.height_m)
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    assert told()["lidars"] == ["south", "north", "the third"]
    added.blender_lidar.range_gate_m = 15.0
    with pytest.raises(RuntimeError, match=r"LiDAR the third, Range Gate: is 15\.0, but 20\.0 of another in"):
        bpy.ops.blender_lidar.scan()
    added.blender_lidar.in_layout = False
    assert panels.fused_lines(scene, hung["south"]) == []  # it was of another layout
    assert bpy.ops.blender_lidar.set_baseline() == {"FINISHED"}
    before = layout().as_tables()
    bpy.context.view_layer.objects.active = hung["north"]
    assert [one.name for one in layout().lidars] == ["south", "north"]
    assert layout().lidars[1].baseline.height_m == 2.5
    assert before["lidar"][0]["baseline"]["height_m"] == pytest.approx(3.0)
    assert bpy.ops.blender_lidar.set_baseline() == {"FINISHED"}
    assert layout().lidars[1].baseline == properties.mounting_of(hung["north"])
    assert layout().lidars[0].baseline.height_m == 2.0


def test_optimise_is_that_of_the_command_line_and_apply_hangs_every_lidar(tmp_path):
    path = write_layout(tmp_path)
    hung = loaded(path)
    before = {name: properties.mounting_of(lidar).as_table() for name, lidar in hung.items()}
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    assert bpy.ops.blender_lidar.optimize() == {"FINISHED"}
    line = run_of(path, tmp_path / "line")
    folder = Path(bpy.path.abspath(optimising.found_of(hung["north"])["folder"]))
    panel = json.loads((folder / "result.json").read_text())
    apart = ("scene", "site")
    assert {k: v for k, v in without_times(panel).items() if k not in apart} == {
        k: v for k, v in without_times(line).items() if k not in apart
    }
    names = [text.partition(":")[0].partition(", ")[2] for text in optimising.found_lines(hung["north"])]
    assert [name for name in names if name in hung][:2] == ["south", "north"]
    assert bpy.ops.blender_lidar.apply() == {"FINISHED"}
    for row in line["lidars"]:
        place = properties.mounting_of(hung[row["name"]]).as_table()
        assert [place[key] for key in COORDINATES] == pytest.approx(
            [row["deployment"][key] for key in COORDINATES], abs=2e-4
        )
    assert told()["lidars"] == ["south", "north"]
    assert bpy.ops.blender_lidar.revert() == {"FINISHED"}
    for name, lidar in hung.items():
        assert properties.mounting_of(lidar).as_table() == pytest.approx(before[name], abs=2e-4)
    hung["south"].name = "east"
    bpy.context.view_layer.objects.active = hung["north"]
    with pytest.raises(RuntimeError, match="LiDAR south of the layout is gone or renamed"):
        bpy.ops.blender_lidar.apply()


def test_one_is_searched_alone_while_the_others_stay_as_they_hang(tmp_path):
    hung = loaded(write_layout(tmp_path))
    bpy.context.view_layer.objects.active = hung["north"]
    hung["south"].blender_lidar.height_m = 3.75
    assert bpy.ops.blender_lidar.optimize(alone=True) == {"FINISHED"}
    folder = Path(optimising.found_of(hung["north"])["folder"])
    rows = {row["name"]: row for row in json.loads((folder / "result.json").read_text())["lidars"]}
    assert rows["south"]["bounds"] is None
    assert rows["north"]["bounds"] == {"tilt_x_deg": [0.0, 20.0]}
    assert rows["south"]["deployment"]["height_m"] == 3.75
    written = {entry["name"]: entry for entry in read_toml(folder / "scene.toml")["lidar"]}
    assert written["south"]["height_m"] == 3.75
    for key in properties.SEARCHABLE:
        setattr(hung["north"].blender_lidar, f"{key}_on", False)
    with pytest.raises(RuntimeError, match="every coordinate is fixed; switch at least one on"):
        bpy.ops.blender_lidar.optimize(alone=True)


def test_lidars_on_poles_hang_on_different_ones_and_are_held_as_they_face(tmp_path):
    poles = ["name,x_m,y_m", "a,-4.5,0.25", "b,6.25,-0.5", "c,1.0,-1.0"]
    (tmp_path / "poles.csv").write_text("\n".join(poles) + "\n", encoding="utf-8")
    on_poles = {"poles": "poles.csv", "height_m": [2.0, 4.5], "tilt_x_deg": 10.0}
    path = write_layout(tmp_path, hung=[{"name": "one", **on_poles}, {"name": "two", **on_poles}])
    hung, scene = loaded(path), bpy.context.scene
    expected = load_scenario(path).as_tables()
    assert layout().as_tables() == expected | {
        "lidar": [one | {"poles": str(tmp_path / "poles.csv")} for one in expected["lidar"]]
    }
    assert properties.mounting_of(hung["one"]).xy != properties.mounting_of(hung["two"]).xy
    held = scenarios.layout_scenario(scene, list(hung.values()), here=False, held=[hung["two"]])
    assert held.lidars[1].is_held
    assert not held.lidars[0].is_held
    (place,) = held.lidars[1].deployment.places
    np.testing.assert_allclose(place.mounting([]).pose.rotation, properties.mounting_of(hung["two"]).pose.rotation)


def test_what_is_wrong_with_a_lidar_of_a_layout_is_said_by_its_name(tmp_path):
    hung, scene = loaded(write_layout(tmp_path)), bpy.context.scene
    hung["north"].blender_lidar.tilt_x_deg_low, hung["north"].blender_lidar.tilt_x_deg_high = 0.4, 0.2
    with pytest.raises(properties.InputError, match="LiDAR panel: LiDAR north, Tilt X"):
        layout()
    hung["north"].blender_lidar.tilt_x_deg_low = 0.0
    scene.blender_lidar.region.with_gate = True
    with pytest.raises(RuntimeError, match="Road and File, Radius: must be given with several LiDARs"):
        bpy.ops.blender_lidar.scan()
    scene.blender_lidar.region.with_gate = False
    bpy.data.objects["south"].location.y = 4.0
    with pytest.raises(RuntimeError, match=r"south: the mount at .* stands on the carriageway"):
        bpy.ops.blender_lidar.scan()


def test_a_scene_of_one_named_lidar_is_a_layout_of_one(tmp_path):
    path = write_layout(tmp_path, hung=[SOUTH])
    hung = loaded(path)
    assert layout().as_tables() == load_scenario(path).as_tables()
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    assert panels.fused_lines(bpy.context.scene, hung["south"]) == []


def built() -> list[tuple[str, int, set[int]]]:
    """Of each LiDAR that stands in the open file its name, its points, and which number they bear."""
    found = []
    for lidar in lidars(bpy.context.scene):
        mesh = cloud_of(lidar).data
        number = np.empty(len(mesh.vertices), np.int32)
        mesh.attributes["lidar"].data.foreach_get("value", number)
        found.append((lidar.name, len(number), set(number.tolist())))
    return found


def test_build_shows_every_mast_and_the_add_on_goes_on_from_it(tmp_path, capsys):
    path, out = write_layout(tmp_path), tmp_path / "scene.blend"
    words = ["build", path, "--frame", 20, "--lidar", "south,height_m=4,x_m=-5", "--out", out]
    code, said, err = cli(capsys, *words)
    assert code == 0, err
    assert "(RS-16 and RS-32, " in said
    bpy.ops.wm.open_mainfile(filepath=str(out))
    found = built()
    assert [(name, numbers) for name, _, numbers in found] == [("north", {1}), ("south", {0})]
    assert f"{sum(points for _, points, _ in found)} points" in said
    hung = {lidar.name: lidar for lidar in lidars(bpy.context.scene)}
    assert properties.mounting_of(hung["south"]).height_m == pytest.approx(4.0)
    again, expected = layout().as_tables(), load_scenario(path).as_tables()
    assert again["lidar"][1]["baseline"] == expected["lidar"][1]["baseline"]
    assert again["sensor"] == expected["sensor"]
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    assert told()["lidars"] == ["south", "north"]


def test_render_shows_the_layout_and_all_baselines(tmp_path, capsys, monkeypatch):
    from blender_lidar.world.blender import scene as blender

    result = run_of(write_layout(tmp_path), tmp_path / "run")
    shown, build = [], blender.build_scene

    def noted(scene, moment):
        build(scene, moment)
        shown.append({one.name: one.pose.height_m for one in (moment, *moment.further)})
        assert sum(role(item) == SENSOR and item.type == "EMPTY" for item in scene.objects) == 2

    monkeypatch.setattr(blender, "build_scene", noted)
    monkeypatch.setattr(blender, "SIZE", (32, 18))
    monkeypatch.setattr("blender_lidar.commands.scan.write_report", lambda run: run.file("report.html"))
    code, _, err = cli(capsys, "render", tmp_path / "run", "--samples", 1)
    assert code == 0, err
    assert shown[0] == pytest.approx({name: of["height_m"] for name, of in result["baseline"]["deployments"].items()})
    assert shown[1] == pytest.approx({row["name"]: row["deployment"]["height_m"] for row in result["lidars"]})
    assert len(list((tmp_path / "run").glob("render_*.png"))) == 7
    folder = tmp_path / "kitti"
    folder.mkdir()
    code, _, err = cli(capsys, "render", tmp_path / "run", "--detections", folder)
    assert code == 2
    assert "KITTI's labels are of one LiDAR" in err


class _Drawn:
    """Stands for a layout of Blender's, of which it keeps the texts and properties that are drawn."""

    def __init__(self, texts=None):
        self.texts = [] if texts is None else texts

    def __getattr__(self, name):
        def call(*given, text=None, **_):
            self.texts.append(given[1] if name == "prop" else text)
            return _Drawn(self.texts)

        return call


def test_the_panel_shows_the_layout_its_score_and_both_searches(tmp_path):
    hung, scene, drawn = loaded(write_layout(tmp_path)), bpy.context.scene, _Drawn()
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    for panel in (panels.BLENDER_LIDAR_PT_sensor, panels.BLENDER_LIDAR_PT_score, optimising.BLENDER_LIDAR_PT_optimize):
        panel.draw_for(panel, drawn, scene, hung["north"])
    for row in scene.blender_lidar.lidars:
        panels.BLENDER_LIDAR_UL_lidars.draw_item(None, None, drawn, None, row, None, None, None)
    texts = list(filter(None, drawn.texts))
    assert texts.count("in_layout") == 2
    assert {"Optimize Layout", "Optimize north", "north alone:", "Baseline: 2.50 m, tilt 5.0°"} <= set(texts)
    assert "Layout of 2:" in texts
