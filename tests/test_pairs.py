"""Features in pairs: six scenes that users have, each through every verb, and what one verb leaves through the next."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import blender_lidar as bl
from blender_lidar.casting import is_available
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.toml_table import to_toml
from tests.small_scene import HEADER, SETTINGS, cli, traffic_rows, without_charts, write_scene, write_table
from tests.sumo_samples import row as sumo_row
from tests.sumo_samples import xml as sumo_xml

UTM = (691_000.25, 5_334_000.75)  # an easting and a northing, whose float32 steps by half a metre
TILT = {"tilt_x_deg": [0.0, 25.0]}
ONE = ("--workers", 1)
WORKS_LONG = ("--frames", 3, *ONE)


def circle(folder: Path) -> Path:
    return write_scene(folder, {"region": {"centre_m": [0.0, 5.0], "radius_m": 18.0}, "deployment": TILT})


def stretches_of_init(folder: Path) -> Path:
    """What `init` writes for a recording."""
    folder.mkdir(parents=True)
    rows = traffic_rows(frames=80, vehicles=60)
    path = write_table(folder / "own.csv", rows, HEADER)
    assert cli_quietly("init", folder / "proposed", "--from", "table", path) == 0
    return folder / "proposed" / "scene.toml"


def utm_from_sumo(folder: Path) -> Path:
    """Floating car data in UTM on a road that runs to the north-east, with an outline as region."""
    folder.mkdir(parents=True)
    turn, rows = np.radians(30.0), []
    along, left = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    for _frame, number, kind, x, y, *_sizes, _heading, time_s in traffic_rows():
        place = np.array(UTM) + x * along + (y - 2.0 - 1.75) * left
        front = place + 0.5 * (4.4 if kind == "car" else 5.2 if kind == "van" else 11.0) * along  # SUMO's places
        sizes = {"id": f"v{number}", "x": f"{front[0]:.3f}", "y": f"{front[1]:.3f}", "angle": 60.0, "speed": 10.0}
        rows.append(sumo_row(time_s, **sizes, type={"car": "car", "van": "delivery", "truck": "truck"}[kind]))
    (folder / "run.fcd.xml").write_text(sumo_xml(rows), encoding="utf-8")
    foot = np.array(UTM) - 3.75 * left
    traffic = {"path": "run.fcd.xml", "format": "sumo", "origin_m": foot.round(3).tolist(), "heading_deg": 30.0}
    outline = [[-15.0, 2.0], [15.0, 2.0], [15.0, 9.0], [-15.0, 9.0]]
    return write_scene(folder, {"traffic": traffic, "region": {"polygon_m": outline}, "deployment": TILT})


def sloping(folder: Path) -> Path:
    road = {"grade_percent": 5.0, "cross_fall_percent": 2.0, "crown_percent": 2.5}
    return write_scene(folder, {"road": road, "world": {"variety": 1.0}, "deployment": TILT})


def two_recordings_with_poles(folder: Path) -> Path:
    folder.mkdir(parents=True)
    for name, seed in (("morning", 1), ("evening", 2)):
        write_table(folder / f"{name}.csv", traffic_rows(seed=seed), HEADER)
    (folder / "poles.csv").write_text("name,x_m,y_m,foot_z_m\nlamp,0,0,0.5\nmast,-6,-1,\n", encoding="utf-8")
    tables = {name: dict(table) for name, table in SETTINGS.items() if name != "traffic"}
    tables["traffic"] = [
        {"name": name, "path": f"{name}.csv", "weight": weight, "frames": 3, "block_s": 10.0}
        for name, weight in (("morning", 1.0), ("evening", 2.0))
    ]
    tables["region"] = {"centre_m": [0.0, 5.0], "radius_m": 18.0}
    tables["deployment"] = {"poles": "poles.csv", "height_m": [2.0, 4.5], "tilt_x_deg": 15.0}
    path = folder / "scene.toml"
    path.write_text(to_toml(tables), encoding="utf-8")
    return path


def weighted_and_tolerant(folder: Path) -> Path:
    near = {"name": "near lane", "polygon_m": [[-40.0, 2.0], [40.0, 2.0], [40.0, 5.5], [-40.0, 5.5]], "weight": 3.0}
    objective = {"zones": [near], "class_weights": {"truck": 2.0}, "tolerance": {"tilt_deg": 1.0, "height_m": 0.05}}
    return write_scene(folder, {"objective": objective, "deployment": TILT})


SCENES = {
    "circle": circle,
    "stretches of init": stretches_of_init,
    "UTM from SUMO": utm_from_sumo,
    "slope and crown": sloping,
    "two recordings with poles": two_recordings_with_poles,
    "weights, zones and tolerance": weighted_and_tolerant,
}


def cli_quietly(*words: object) -> int:
    from blender_lidar.cli import main

    return main([str(word) for word in words])


class Ran:
    """A scene, and the folder of its search."""

    def __init__(self, scene: Path, folder: Path) -> None:
        self.scene, self.folder = scene, folder
        self.result = json.loads((folder / "result.json").read_text(encoding="utf-8"))

    @property
    def frames(self) -> tuple[object, ...]:
        """The options that keep it small."""
        several = len(load_scenario(self.scene).recordings) > 1
        return () if several else WORKS_LONG[:2]

    @property
    def mounting(self) -> tuple[object, ...]:
        """Its answer as options."""
        words = [("--height", "height_m"), ("--tilt-x", "tilt_x_deg"), ("--tilt-y", "tilt_y_deg"), ("--yaw", "yaw_deg")]
        pole = self.result["pole"]
        place = [("--x", "x_m"), ("--y", "y_m")] if pole is None else []
        given = [word for option, key in (*place, *words) for word in (option, repr(self.result["deployment"][key]))]
        return (*given, *(() if pole is None else ("--pole", pole["name"])))

    def vehicles(self) -> list[dict[str, str]]:
        with (self.folder / "vehicles.csv").open(encoding="utf-8", newline="") as stream:
            return list(csv.DictReader(stream))


@pytest.fixture(scope="module", params=SCENES, ids=lambda name: name.replace(" ", "-").replace(",", ""))
def ran(request, tmp_path_factory) -> Ran:
    """The scene, and its search."""
    folder = tmp_path_factory.mktemp("pairs") / "site"
    scene = SCENES[request.param](folder)
    options = ("--particles", 4, "--iterations", 3, *ONE, "--out", folder / "run")
    frames = () if request.param == "two recordings with poles" else WORKS_LONG[:2]
    with pytest.MonkeyPatch.context() as patch:
        without_charts(patch)
        assert cli_quietly("optimise", scene, *frames, *options) == 0
    return Ran(scene, folder / "run")


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    without_charts(monkeypatch)


def verb(capsys, *words: object) -> tuple[dict, str]:
    """What a verb that succeeds prints with --json, and what it says."""
    code, out, err = cli(capsys, *words, "--json")
    assert code == 0, err
    return json.loads(out), err


def test_the_answer_lies_within_its_bounds_and_every_file_is_written(ran):
    for key, (low, high) in ran.result["bounds"].items():
        assert low - 1e-9 <= ran.result["deployment"][key] <= high + 1e-9
    for name in (
        "vehicles.csv",
        "vehicles_baseline.csv",
        "history.csv",
        "report.html",
        "installation.txt",
        "scene.toml",
    ):
        assert (ran.folder / name).stat().st_size > 0, name
    counted = [row for row in ran.vehicles() if row["split"] == "search"]
    assert len(counted) == ran.result["vehicles"]


def test_evaluate_finds_the_score_of_the_search(ran, tmp_path, capsys):
    found, _ = verb(capsys, "evaluate", ran.scene, *ran.frames, *ONE, *ran.mounting, "--out", tmp_path / "run")
    for key in ("objective", "objective_per_vehicle", "detectable_share", "vehicles", "holdout", "baseline"):
        assert found[key] == pytest.approx(ran.result[key], rel=1e-9, nan_ok=True) if key != "holdout" else True, key
    for key in ("objective_per_vehicle", "detectable_share"):
        if ran.result["holdout"]:
            assert found["holdout"][key] == pytest.approx(ran.result["holdout"][key], abs=1e-9)


def test_the_scene_that_a_run_leaves_is_the_scene_that_it_ran(ran, tmp_path, capsys):
    left = ran.folder / "scene.toml"
    assert (
        load_scenario(left).with_whole_paths()
        == load_scenario(
            ran.scene,
            {("search", "particles"): (4, "x"), ("search", "iterations"): (3, "x"), ("model", "workers"): (1, "x")}
            | ({("traffic", "frames"): (3, "x")} if ran.frames else {}),
        ).with_whole_paths()
    )
    found, _ = verb(capsys, "evaluate", left, *ran.mounting, "--out", tmp_path / "run")
    assert found["objective"] == pytest.approx(ran.result["objective"], rel=1e-9)


def test_a_run_that_has_ended_is_not_run_again(ran, capsys):
    options = ("--particles", 4, "--iterations", 3, *ONE, "--out", ran.folder, "--resume")
    found, _ = verb(capsys, "optimise", ran.scene, *ran.frames, *options)
    assert found == ran.result


def test_two_workers_find_what_one_finds(ran, tmp_path, capsys):
    words = (*ran.frames, *ran.mounting, "--workers", 2, "--out", tmp_path / "run")
    found, _ = verb(capsys, "evaluate", ran.scene, *words)
    assert found["objective"] == pytest.approx(ran.result["objective"], rel=1e-9)


def test_python_finds_the_score_of_the_command_line(ran):
    site = bl.load_scene(str(ran.folder / "scene.toml"))
    table = {key: value for key, value in ran.result["deployment"].items() if value is not None}
    score = bl.score_mounting(site, **table)
    assert score.objective == pytest.approx(ran.result["objective"], rel=1e-9)


def test_a_cloud_of_a_frame_has_the_points_that_the_run_counted(ran, tmp_path, capsys):
    rows = [row for row in ran.vehicles() if row["split"] == "search"]
    frame = rows[0]["frame"]
    rows = [row for row in rows if row["frame"] == frame]
    cloud = tmp_path / "cloud.npz"
    code, _, err = cli(capsys, "scan", ran.scene, "--frame", frame, *ran.mounting, "--out", cloud)
    assert code == 0, err
    with np.load(cloud, allow_pickle=False) as stored:
        ids = stored["vehicle_id"]
    assert [int((ids == int(row["vehicle_id"])).sum()) for row in rows] == [int(row["points"]) for row in rows]
    boxes = tmp_path / "boxes.csv"
    with boxes.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    code, out, err = cli(capsys, "score", "--points", cloud, "--boxes", boxes, "--json")
    assert code == 0, err
    mean = np.mean([float(row["entropy_bits"]) for row in rows])
    assert json.loads(out)["pe_vgop_mean"] == pytest.approx(mean, abs=1e-6) if "pe_vgop_mean" in out else True


def test_a_detector_is_judged_on_the_vehicles_that_count(ran, tmp_path, capsys):
    found, _ = verb(capsys, "detect", ran.scene, *ran.frames, *ONE, *ran.mounting, "--out", tmp_path / "found")
    held_out = [row for row in ran.vehicles() if row["split"] == "holdout"]
    assert json.dumps(found).count("recall") > 0
    assert len(held_out) > 0


def test_a_data_set_of_the_scene_is_one_that_a_detector_is_judged_on(ran, tmp_path, capsys):
    folder = tmp_path / "set"
    verb(capsys, "dataset", ran.scene, *ran.frames, *ONE, "--mountings", 2, "--scans", 4, "--out", folder)
    found, _ = verb(capsys, "detect", folder, *ONE, "--out", tmp_path / "found")
    assert json.dumps(found).count("recall") > 0


@pytest.mark.skipif(not is_available("bvh"), reason="needs bpy")
def test_the_blend_file_holds_the_vehicles_of_its_frame(ran, tmp_path, capsys):
    import bpy

    frame = ran.vehicles()[0]["frame"]
    out = tmp_path / "scene.blend"
    code, _, err = cli(capsys, "build", ran.scene, "--frame", frame, *ran.mounting, "--out", out)
    assert code == 0, err
    bpy.ops.wm.open_mainfile(filepath=str(out))
    vehicles = [one for one in bpy.data.objects if "vehicle_id" in one]
    assert len(vehicles) >= len([row for row in ran.vehicles() if row["frame"] == frame])
