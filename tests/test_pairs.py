"""Features in pairs: six scenes through every verb; what two verbs say of the same thing is the same.

What the add-on makes of these scenes is in `tests.test_blender_addon`.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import blender_lidar as bl
from blender_lidar.casting import is_available
from blender_lidar.cli import main
from blender_lidar.commands.progress import RunProgress
from blender_lidar.run.folder import RunFolder
from blender_lidar.scene.mounting import COORDINATES
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.studies.chart import ChartEffort
from blender_lidar.studies.stability import StabilityEffort
from tests.six_scenes import SCENES
from tests.small_scene import CASTER, cli, without_charts, without_times

pytestmark = pytest.mark.usefixtures("quick")

PERFECT = ("--dropout", 0, "--range-noise", 0, "--clutter", 0)  # nothing that each verb draws for itself
TINY_CHART = ChartEffort(None, 4, 4, 1, phases=1, rounds=1, quick=True)
TINY_STABILITY = StabilityEffort(None, 2, heights=2, tilts=2, fine_tilts=2, seeds=1, budget=0.5, draws=1, quick=True)
Rows = list[dict[str, str]]


def table(path: Path) -> Rows:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


class Searched:
    """A scene, and the folder that `optimise` left of it."""

    def __init__(self, scene: Path, folder: Path) -> None:
        self.scene, self.folder, self.settings = scene, folder, load_scenario(scene)
        self.result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
        self.rows = table(folder / "vehicles.csv")

    @property
    def mounting(self) -> tuple[object, ...]:
        """The answer as options."""
        return self.hung(
            self.result["deployment"], None if self.result["pole"] is None else self.result["pole"]["name"]
        )

    def hung(self, coordinates: Mapping[str, float], pole: str | None = None) -> tuple[object, ...]:
        """A mounting as options."""
        keys = [*(("x_m", "y_m") if pole is None else ()), "height_m", "tilt_x_deg", "tilt_y_deg", "yaw_deg"]
        given = [f"--{key.rpartition('_')[0].replace('_', '-')}={coordinates[key]!r}" for key in keys]
        return (*given, *(() if pole is None else ("--pole", pole)))

    def of(self, split: str, frame: str | None = None) -> Rows:
        """Rows of the counted vehicles of the searched or the held-out frames, or of one."""
        return [row for row in self.rows if row["split"] == split and frame in (None, row["frame"])]

    @property
    def frames(self) -> list[str]:
        return list(dict.fromkeys(row["frame"] for row in self.rows))


@pytest.fixture(scope="module", params=SCENES)
def ran(request, tmp_path_factory) -> Searched:
    folder = tmp_path_factory.mktemp("pairs") / "site"
    scene = SCENES[request.param](folder)
    with pytest.MonkeyPatch.context() as patch:
        without_charts(patch)
        assert main(["optimise", str(scene), "--out", str(folder / "run")]) == 0
    return Searched(scene, folder / "run")


def verb(capsys, *words: object) -> dict:
    """What a verb that succeeds prints with --json."""
    code, out, err = cli(capsys, *words, "--json")
    assert code == 0, err
    return json.loads(out)


def scores(result: Mapping) -> dict:
    """What was found of a mounting, and of its baseline: all numbers that a search and an evaluation must share.

    Frames that have chosen a mounting give no intervals, and those of a given one do.
    """
    keys = ("objective", "objective_per_vehicle", "detectable_share", "holdout", "recordings", "vehicles", "frames")
    sides = {"found": result, "baseline": result["baseline"]}
    return {name: {key: side[key] for key in keys if key in side} for name, side in sides.items()}


def numbers(rows: Rows, *keys: str) -> list[tuple[float, ...]]:
    return [tuple(float(row[key]) for key in keys) for row in rows]


# --- One mounting, said by many ---------------------------------------------------------------------------------------


def test_the_objective_is_the_weighted_sum_over_the_table_of_vehicles(ran):
    objective, searched = ran.settings.objective, ran.of("search")
    assert len(searched) == ran.result["vehicles"]
    assert len(ran.of("holdout")) == ran.result["holdout"]["vehicles"]
    for key, (low, high) in ran.result["bounds"].items():
        assert low <= ran.result["deployment"][key] <= high
    for rows, found in ((searched, ran.result), (ran.of("holdout"), ran.result["holdout"])):
        weight = np.array([float(row.get("weight", 1.0)) for row in rows])
        value = np.array([float(row["entropy_bits"]) if row["detectable"] == "1" else objective.loss for row in rows])
        seen = np.array([row["detectable"] == "1" for row in rows])
        assert found["objective_per_vehicle"] == pytest.approx(weight @ value / weight.sum(), abs=1e-6)
        assert found["detectable_share"] == pytest.approx(seen.mean(), abs=1e-12)  # without weights
        if rows is searched:
            assert found["objective"] == pytest.approx(weight @ value, abs=1e-5)


def test_evaluate_scores_the_answer_as_the_search_did(ran, tmp_path, capsys):
    found = verb(capsys, "evaluate", ran.scene, *ran.mounting, "--out", tmp_path / "run")
    assert scores(found) == scores(ran.result)
    for name in ("vehicles.csv", "vehicles_baseline.csv"):
        assert (tmp_path / "run" / name).read_bytes() == (ran.folder / name).read_bytes()


def test_the_scene_that_a_run_leaves_is_the_one_that_it_ran(ran, tmp_path, capsys):
    left = ran.folder / "scene.toml"
    assert load_scenario(left).with_whole_paths() == ran.settings.with_whole_paths()
    again = verb(capsys, "optimise", left, "--out", tmp_path / "run")
    assert without_times(again) == without_times(ran.result)


def test_python_finds_what_the_command_line_finds(ran, tmp_path):
    site = bl.load_scene(ran.scene)
    best = bl.best_mounting(site, tmp_path / "run")
    left = json.loads((tmp_path / "run" / "result.json").read_text(encoding="utf-8"))
    assert without_times(left) == without_times(ran.result)
    planned = {key: best.mounting[key] for key in COORDINATES}
    for held_out, found in ((False, ran.result), (True, ran.result["holdout"])):
        score = bl.score_mounting(site, held_out=held_out, **planned)
        assert score.objective_per_vehicle == pytest.approx(found["objective_per_vehicle"], rel=1e-12)
        assert score.detectable_share == found["detectable_share"]


def test_a_run_that_was_stopped_goes_on_to_the_same_and_one_that_has_ended_is_not_run_again(
    ran, tmp_path, capsys, monkeypatch
):
    heard, searching = [], RunProgress.searching

    def stopped(self, search):
        heard.append(search.evaluations)
        searching(self, search)
        if len(heard) == 2:
            raise KeyboardInterrupt

    words = ("optimise", ran.scene, "--out", tmp_path / "run")
    with monkeypatch.context() as patch:
        patch.setattr(RunProgress, "searching", stopped)
        code, _, err = cli(capsys, *words)
    assert (code, "--resume" in err) == (1, True)
    for _ in range(2):
        assert without_times(verb(capsys, *words, "--resume")) == without_times(ran.result)
    for name in ("history.csv", "vehicles.csv", "vehicles_baseline.csv", "scene.toml"):
        assert (tmp_path / "run" / name).read_bytes() == (ran.folder / name).read_bytes(), name


@pytest.mark.parametrize("ran", ["slope_and_crown", "two_recordings_with_poles"], indirect=True)
def test_two_processes_find_what_one_finds(ran, tmp_path, capsys):
    found = verb(capsys, "evaluate", ran.scene, *ran.mounting, "--workers", 2, "--out", tmp_path / "run")
    assert scores(found) == scores(ran.result)


def test_a_table_counts_the_boxes_that_the_run_counted_or_says_why_there_is_none(ran, tmp_path, capsys):
    words = ("table", ran.scene, "--setback", 2, "--height", "3,4", "--out", tmp_path / "table")
    if ran.settings.lidar.deployment.poles:
        code, _, err = cli(capsys, *words)
        assert code == 2
        assert "a study is about one" in err
        return
    cells = verb(capsys, *words)["cells"]
    assert [cell["height_m"] for cell in cells] == [3.0, 4.0]
    assert {cell["boxes"] for cell in cells} == {ran.result["holdout"]["boxes"]}


# --- Clouds -----------------------------------------------------------------------------------------------------------


def test_clouds_have_the_points_and_the_bits_that_the_run_counted(ran, tmp_path, capsys):
    objective, clouds = ran.settings.objective, tmp_path / "clouds"
    words = ("--frame-ids", ",".join(ran.frames), *ran.mounting, "--out", clouds)
    assert cli(capsys, "scan", ran.scene, *words)[0] == 0
    site, place = bl.load_scene(ran.scene), {key: ran.result["deployment"][key] for key in COORDINATES}
    keys = ("p_top", "p_side", "p_front", "entropy_bits")
    for frame in ran.frames:
        expected = [row for row in ran.rows if row["frame"] == frame]
        points = [(int(row["vehicle_id"]), int(row["points"]), row["detectable"] == "1") for row in expected]
        cloud, boxes = clouds / f"{int(frame):06d}.npz", ("--boxes", ran.folder / "vehicles.csv", "--frame", frame)
        judged = ("--threshold", objective.threshold, "--view", objective.view)
        found = verb(capsys, "score", "--points", cloud, *boxes, *judged)["vehicles"]
        assert [(one["vehicle_id"], one["points"], one["detectable"]) for one in found] == points
        np.testing.assert_allclose(numbers(found, *keys), numbers(expected, *keys), rtol=0.0, atol=1e-6)
        scan = bl.scan_frame(site, int(frame), **place)
        exact = bl.score_cloud(scan)
        counted = np.isin(exact["vehicle_id"], [one[0] for one in points])
        assert np.asarray(exact["points"])[counted].tolist() == [one[1] for one in points]
        for key in keys:
            values = np.asarray(exact[key])[counted]
            np.testing.assert_allclose(values, np.ravel(numbers(expected, key)), rtol=0.0, atol=1e-6, err_msg=key)
        with np.load(cloud, allow_pickle=False) as stored:
            np.testing.assert_array_equal(stored["vehicle_id"], scan.cloud.vehicle_id)
            np.testing.assert_allclose(stored["xyz"], scan.cloud.xyz, rtol=0.0, atol=1e-4)


def test_a_perfect_cloud_beside_its_own_simulation_differs_by_nothing(ran, tmp_path, capsys):
    frame = min(ran.rows, key=lambda row: float(row["distance_m"]))["frame"]
    within = ran.settings.lidar.sensor.range_gate_m - 6.0  # whole vehicles, as `compare` has no gate
    cloud = tmp_path / "cloud.npz"
    code, _, err = cli(capsys, "scan", ran.scene, "--frame", frame, *ran.mounting, *PERFECT, "--out", cloud)
    assert code == 0, err
    with np.load(cloud, allow_pickle=False) as stored:
        pose = json.loads(str(stored["header"]))["pose"]
    sensor = (
        "--sensor",
        ran.settings.lidar.sensor.name,
        "--rotation",
        ran.settings.lidar.sensor.rotation_hz,
        *ran.hung(pose),
    )
    boxes = ("--boxes", ran.folder / "vehicles.csv", "--frame", frame, "--distance", 0, within)
    words = ("--points", cloud, *boxes, *sensor, "--caster", CASTER, "--out", tmp_path / "beside")
    found = verb(capsys, "compare", *words)
    (body,) = found["variants"]
    points = body["points"]
    near = [row for row in ran.rows if row["frame"] == frame and float(row["distance_m"]) <= within]
    assert body["vehicles"] == len(near)
    assert points["both"] == points["real"] > 0
    standing = ran.settings.world.boxes or ran.settings.world.barriers  # which `compare` does not know
    assert points["simulated"] >= points["real"] if standing else points["simulated"] == points["real"]
    assert body["range_error_m"] == pytest.approx(0.0, abs=1e-5)
    assert standing or body["absolute_error_bits"]["median"] == pytest.approx(0.0, abs=2e-3)


@pytest.mark.skipif(not is_available("bvh"), reason="needs bpy")
def test_the_blend_file_shows_the_cloud_and_the_vehicles_of_its_frame(ran, tmp_path, capsys):
    import bpy

    from blender_lidar.world.blender.objects import CLOUD, role

    frame = ran.frames[0]
    words = (ran.scene, "--frame", frame, *ran.mounting, "--out")
    for one, name in (("scan", "cloud.npz"), ("build", "scene.blend")):
        code, _, err = cli(capsys, one, *words, tmp_path / name)
        assert code == 0, err
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    instances = bpy.context.evaluated_depsgraph_get().object_instances
    shown = np.array([one.matrix_world.translation[:2] for one in instances if one.is_instance])
    for row in (row for row in ran.rows if row["frame"] == frame):
        place = float(row["x_m"]), float(row["y_m"])
        assert np.hypot(*(shown - place).T).min() < 3e-3
    (item,) = (item for item in bpy.data.objects if role(item) == CLOUD)
    xyz = np.empty(3 * len(item.data.vertices), np.float32)
    item.data.vertices.foreach_get("co", xyz)
    placed = np.array(item.matrix_world)
    with np.load(tmp_path / "cloud.npz", allow_pickle=False) as stored:
        found = xyz.reshape(-1, 3) @ placed[:3, :3].T + placed[:3, 3]
        np.testing.assert_allclose(found, stored["xyz"], rtol=0.0, atol=1e-3)


# --- Detectors --------------------------------------------------------------------------------------------------------


def measured(result: Mapping) -> dict[str, float]:
    """What a detector reached at the mounting in question, over all vehicles."""
    given = result["mountings"]["given"]
    return {key: value for key, value in given.items() if not isinstance(value, dict)}


@pytest.mark.parametrize("ran", ["stretches", "two_recordings_with_poles", "utm_polygon"], indirect=True)
def test_a_data_set_and_a_detector_have_the_vehicles_and_the_judgement_of_their_scene(ran, tmp_path, capsys):
    """One mounting of a data set: its scans that validate are the held-out frames, seen from there."""
    folder = tmp_path / "set"
    planned = PERFECT
    made = verb(capsys, "dataset", ran.scene, *planned, "--mountings", 1, "--as-recorded", "--out", folder)
    judging = [row for row in table(folder / "scans.csv") if row["split"] == "val"]
    poles = {(pole.x_m, pole.y_m): pole.name for pole in ran.settings.lidar.deployment.poles}
    place = {key: float(judging[0][key]) for key in COORDINATES}
    words = (ran.scene, *ran.hung(place, poles.get((place["x_m"], place["y_m"]))), *planned)
    of_set = verb(capsys, "detect", folder, "--out", tmp_path / "of_set")
    of_scene = verb(capsys, "detect", *words, "--out", tmp_path / "of_scene")
    assert made["val"]["scans"] == of_set["scans"] == of_scene["frames"] == ran.result["holdout"]["frames"]
    assert sorted(int(row["frame"]) for row in judging) == sorted(of_scene["frame_ids"])
    assert measured(of_set) == pytest.approx(measured(of_scene), nan_ok=True)

    verb(capsys, "evaluate", *words, "--out", tmp_path / "run")
    held_out = [row for row in table(tmp_path / "run" / "vehicles.csv") if row["split"] == "holdout"]
    found = of_scene["mountings"]["given"]
    assert found["vehicles"] == of_scene["mountings"]["baseline"]["vehicles"] == len(held_out)
    assert found["with_return"] == sum(int(row["points"]) > 0 for row in held_out) / len(held_out)
    points = {(row["frame"], row["vehicle_id"]): row["points"] for row in held_out}
    for scan in judging:
        number = f"{int(scan['scan']):06d}"
        boxes = folder / "boxes" / f"{number}.csv"
        scored = verb(capsys, "score", "--points", folder / "npz" / f"{number}.npz", "--boxes", boxes)["vehicles"]
        rows = table(boxes)
        assert [(one["vehicle_id"], one["points"]) for one in scored] == [
            (int(row["vehicle_id"]), int(row["points"])) for row in rows
        ]
        counted = {(scan["frame"], row["vehicle_id"]): row["points"] for row in rows if row["counted"] == "1"}
        assert counted == {key: value for key, value in points.items() if key[0] == scan["frame"]}


@pytest.mark.parametrize("ran", ["circle", "slope_and_crown"], indirect=True)
def test_detections_are_judged_from_their_files_as_they_were_found(ran, tmp_path, capsys):
    words = ("detect", ran.scene, *ran.mounting, "--detector")
    expected = measured(verb(capsys, *words, "pillars", "--out", tmp_path / "found"))
    assert expected["recall_0.1"] > 0.0
    for name in ("detections.csv", "label_2"):
        again = verb(capsys, *words, tmp_path / "found" / name, "--out", tmp_path / name)
        assert measured(again) == expected | {"with_return": None}


# --- Studies, and proposals -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ran", ["stretches", "two_recordings_with_poles", "utm_polygon"], indirect=True)
def test_studies_start_from_the_scores_of_evaluate_or_say_what_they_are_about(ran, tmp_path, capsys, monkeypatch):
    pytest.importorskip("scipy", reason="studies need SciPy")
    monkeypatch.setattr("blender_lidar.commands.studies.QUICK_CHART", TINY_CHART)
    monkeypatch.setattr("blender_lidar.commands.studies.QUICK_STABILITY", TINY_STABILITY)
    words = {"chart": ("--quick",), "stability": ("--quick", *ran.hung(ran.result["deployment"]))}
    if len(ran.settings.recordings) > 1:
        for name, more in words.items():
            code, _, err = cli(capsys, name, ran.scene, *more, "--out", tmp_path / name)
            assert (code, err.count("\n")) == (2, 1)
            assert "a study is about one: [traffic]" in err
        return
    few = ("--detail", "detailed", *(("--frames", 2) if ran.settings.recordings[0].spacing_s is None else ()))
    found = verb(capsys, "evaluate", ran.scene, *ran.mounting, *few, "--out", tmp_path / "run")
    baseline = found["baseline"]
    stability = verb(capsys, "stability", ran.scene, *words["stability"], *few, "--out", tmp_path / "stability")
    assert stability["mounting"] == pytest.approx(found["deployment"])
    assert stability["baseline"] == pytest.approx(baseline["deployment"])
    assert stability["objective_per_vehicle"] == pytest.approx(found["objective_per_vehicle"], rel=1e-9)
    chart = verb(capsys, "chart", ran.scene, *words["chart"], *few, "--out", tmp_path / "chart")
    for study in (stability, chart):
        assert study["vehicles"] == found["vehicles"]
        assert study["baseline_per_vehicle"] == pytest.approx(baseline["objective_per_vehicle"], rel=1e-9)


def centres(path: Path) -> dict[int, np.ndarray]:
    """Box centres (n, 2) of each frame of a recording of these scenes, in its own metres."""
    found: dict[int, list] = {}
    if path.suffix == ".csv":
        for row in table(path):
            found.setdefault(int(row["frame"]), []).append((float(row["x_m"]), float(row["y_m"])))
    else:
        for number, step in enumerate(ElementTree.parse(path).getroot().iter("timestep")):
            for one in step.iter("vehicle"):
                angle, length = np.radians(float(one.get("angle"))), {"car": 4.4, "lorry": 11.0}[one.get("type")]
                back = 0.5 * length * np.array([np.sin(angle), np.cos(angle)])  # of its front
                found.setdefault(number, []).append(np.array([float(one.get("x")), float(one.get("y"))]) - back)
    return {frame: np.array(rows) for frame, rows in found.items()}


@pytest.mark.parametrize("ran", ["circle", "utm_polygon"], indirect=True)
def test_a_proposed_scene_counts_the_vehicles_of_its_stretch(ran, tmp_path, capsys):
    traffic = ran.settings.recordings[0]
    types = () if traffic.vehicle_types is None else ("--vehicle-types", *traffic.vehicle_types)
    code, _, err = cli(capsys, "init", tmp_path / "own", "--from", "auto", traffic.path, *types)
    assert code == 0, err
    proposed = load_scenario(tmp_path / "own" / "scene.toml")
    words = ("--height", 4, "--tilt-x", 15, "--workers", 1, "--caster", CASTER)
    result = verb(capsys, "evaluate", tmp_path / "own" / "scene.toml", *words, "--out", tmp_path / "run")
    own, turn = proposed.recordings[0], np.radians(proposed.recordings[0].heading_deg)
    ((low, high),) = (one.x_m for one in proposed.region.stretches)
    right, left = proposed.road_map.edges_t
    counted, rows = 0, table(tmp_path / "run" / "vehicles.csv")
    for frame, xy in centres(Path(traffic.path)).items():
        if str(frame) not in {row["frame"] for row in rows}:
            continue
        x, y = ((xy - own.origin_m) @ np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])).T
        inside = (low <= x) & (x <= high) & (right <= y) & (y <= left)
        found = sorted(numbers([row for row in rows if row["frame"] == str(frame)], "x_m", "y_m"))
        np.testing.assert_allclose(found, sorted(zip(x[inside], y[inside], strict=True)), atol=6e-4)
        counted += int(inside.sum())
    assert counted == result["vehicles"] + result["holdout"]["vehicles"] > 0


def test_a_rendered_frame_is_the_fullest_of_the_run(tmp_path, capsys, monkeypatch):
    """One scene, because pictures take long: poles, and two recordings."""
    pytest.importorskip("bpy")
    scene = SCENES["two_recordings_with_poles"](tmp_path)
    verb(capsys, "evaluate", scene, "--pole", "south", "--height", 3.5, "--out", tmp_path / "run")
    monkeypatch.setattr("blender_lidar.world.blender.scene.SIZE", (32, 18))
    code, out, err = cli(capsys, "render", tmp_path / "run", "--samples", 1)
    assert code == 0, err
    frames = [row["frame"] for row in table(tmp_path / "run" / "vehicles.csv") if row["split"] == "search"]
    fullest = max(dict.fromkeys(frames), key=frames.count)
    assert out.startswith(f"frame {fullest}: ")
    assert RunFolder(tmp_path / "run").result["pole"]["name"] == "south"
