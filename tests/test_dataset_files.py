"""Data sets as files: readers of each layout, written for these tests alone, count the points in every box again."""

from __future__ import annotations

import csv
import hashlib
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.clouds.files import read_cloud
from blender_lidar.commands import dataset as verb
from blender_lidar.detection import dataset_files
from blender_lidar.detection.dataset import plan_dataset, sample
from blender_lidar.detection.scores import MEASURES
from blender_lidar.names import DATASET_LAYOUTS
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.workers import Workers
from tests.nuscenes_devkit_check import MARGIN_M
from tests.refusals import refused
from tests.small_scene import cli, done, traffic_rows, write_scene, write_table
from tests.waiting import WAIT_S

LAYOUTS = [word for layout in DATASET_LAYOUTS for word in ("--layout", layout)]
SCANS = 24


def scene_in(folder: Path) -> Path:
    """Without ground every point is a vehicle's, so that counts must agree to the last one."""
    kinds = {"car": ("motorcycle", 2.1, 0.8, 1.4), "truck": ("bus", 11.0, 2.5, 3.2)}  # of some: all classes are there
    rows = traffic_rows(vehicles=150)
    for row in rows:
        if row[1] % 3 == 0 and row[2] in kinds:
            row[2], *row[5:8] = kinds[row[2]]
    write_table(folder / "traffic.csv", rows)
    changes = {
        "world": {"ground": False},
        "road": {"grade_percent": 4.0, "cross_fall_percent": -3.0},
        "region": {"centre_m": [0.0, 0.0], "radius_m": 12.0},
        "sensor": {"range_gate_m": 15.0},
        "deployment": {"height_m": [2.0, 4.5], "tilt_x_deg": [0.0, 25.0], "y_m": [-1.0, 0.0], "yaw_deg": [-40.0, 40.0]},
    }
    return write_scene(folder, changes)


def words(scene: Path, out: Path) -> tuple:
    return ("dataset", scene, "--mountings", 4, "--scans", SCANS, *LAYOUTS, "--out", out)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    assert verb_run(words(scene_in(folder), folder / "set")) == 0
    return folder / "set"


def verb_run(asked) -> int:
    from blender_lidar.cli import main

    return main([str(word) for word in asked])


def digests(folder: Path) -> dict[str, str]:
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def boxes_of(folder: Path, number: int, *, seen: bool = False) -> list[dict[str, str]]:
    with (folder / "boxes" / f"{number:06d}.csv").open(newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if row["labelled"] == "1"]
    return [row for row in rows if not seen or int(row["points"]) > 0]


def scans_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "scans.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


def counted(points: np.ndarray, centre, size, heading: float) -> int:
    """Points in a box that is turned about z, grown by a margin as points lie on its sides."""
    away = points - np.asarray(centre, dtype=float)
    cos, sin = np.cos(heading), np.sin(heading)
    local = np.column_stack([cos * away[:, 0] + sin * away[:, 1], cos * away[:, 1] - sin * away[:, 0], away[:, 2]])
    return int((np.abs(local) <= 0.5 * np.asarray(size, dtype=float) + MARGIN_M).all(axis=1).sum())


# --- One reader for each layout: number of the scan -> points in each of its boxes ------------------------------------


def from_npz(folder: Path, number: int) -> list[int]:
    with np.load(folder / "npz" / f"{number:06d}.npz") as stored:
        box = {name: stored[f"box_{name}"] for name in ("centre_m", "size_m", "heading_deg", "labelled", "points")}
        found = [
            counted(stored["xyz"], *row)
            for row in zip(box["centre_m"], box["size_m"], np.radians(box["heading_deg"]), strict=True)
        ]
    assert found == box["points"].tolist()
    return [count for count, labelled in zip(found, box["labelled"], strict=True) if labelled]


def from_kitti(folder: Path, number: int) -> list[int]:
    training = folder / "kitti" / "training"
    points = np.fromfile(training / "velodyne" / f"{number:06d}.bin", "<f4").reshape(-1, 4)
    assert ((points[:, 3] >= 0.0) & (points[:, 3] <= 1.0)).all()
    lines = (line.partition(":") for line in (training / "calib" / f"{number:06d}.txt").read_text().splitlines())
    calib = {name: np.array(values.split(), dtype=float) for name, _, values in lines}
    to_camera = calib["Tr_velo_to_cam"].reshape(3, 4)
    rectified = calib["R0_rect"].reshape(3, 3)
    camera = (points[:, :3] @ to_camera[:, :3].T + to_camera[:, 3]) @ rectified.T
    found = []
    for line in (training / "label_2" / f"{number:06d}.txt").read_text().splitlines():
        kind, truncated, occluded, alpha, *_, height, width, length, x, y, z, turn = line.split()
        assert len(line.split()) == 15
        assert (kind in ("Car", "Van", "Truck", "Cyclist"), truncated, occluded in "012") == (True, "0.00", True)
        ray = float(turn) - np.arctan2(float(x), float(z))
        assert np.cos(ray - float(alpha)) > 1.0 - 1e-6
        # In the camera's frame x is right, y down, z ahead; rotation_y turns from x towards -z.
        upright = np.column_stack([camera[:, 0], -camera[:, 2], -camera[:, 1]])
        middle = float(x), -float(z), 0.5 * float(height) - float(y)
        found.append(counted(upright, middle, (float(length), float(width), float(height)), float(turn)))
    return found


def rotated(quaternion, points: np.ndarray) -> np.ndarray:
    w, *vector = quaternion
    twice = 2.0 * np.cross(vector, points)
    return points + w * twice + np.cross(vector, twice)


def from_nuscenes(folder: Path, number: int) -> list[int]:
    tables = {
        path.stem: json.loads(path.read_text()) for path in (folder / "nuscenes" / "v1.0-trainval").glob("*.json")
    }
    by_token = {name: {row["token"]: row for row in rows} for name, rows in tables.items() if name != "splits"}
    data = tables["sample_data"][number]
    points = np.fromfile(folder / "nuscenes" / data["filename"], "<f4").reshape(-1, 5)[:, :3].astype(float)
    for name in ("calibrated_sensor", "ego_pose"):
        frame = by_token[name][data[f"{name}_token"]]
        points = rotated(frame["rotation"], points) + frame["translation"]
    found = []
    for row in tables["sample_annotation"]:
        if row["sample_token"] == data["sample_token"]:
            (width, length, height), (w, _, _, k) = row["size"], row["rotation"]
            heading = 2.0 * np.arctan2(k, w)
            found.append(counted(points, row["translation"], (length, width, height), heading))
            assert found[-1] == row["num_lidar_pts"]
            instance = by_token["instance"][row["instance_token"]]
            assert by_token["category"][instance["category_token"]]["name"].startswith("vehicle.")
            assert row["visibility_token"] in by_token["visibility"]
    return found


READERS = {"npz": from_npz, "kitti": from_kitti, "nuscenes": from_nuscenes}


@pytest.mark.parametrize("layout", DATASET_LAYOUTS)
def test_an_independent_reader_counts_the_same_points_in_every_box(layout, made):
    total = 0
    for number in range(SCANS):
        message = [int(row["points"]) for row in boxes_of(made, number, seen=layout == "kitti")]
        assert READERS[layout](made, number) == message
        total += sum(message)
    assert total > 1000


def test_nuscenes_own_devkit_counts_the_same(made):
    python = os.environ.get("NUSCENES_PYTHON") or (sys.executable if find_spec("nuscenes") else None)
    if python is None:
        pytest.skip(
            "nuscenes-devkit, which wants an older NumPy, is not here: NUSCENES_PYTHON may name a Python with it"
        )
    script = Path(__file__).with_name("nuscenes_devkit_check.py")
    command = [python, script, made / "nuscenes"]
    said = subprocess.run(command, capture_output=True, text=True, timeout=WAIT_S, check=True).stdout
    counts = json.loads(said.splitlines()[-1])
    assert counts["found"] == counts["stated"]
    assert sum(counts["found"].values()) > 1000
    assert len(counts["scenes"]["site_train"]) + len(counts["scenes"]["site_val"]) == SCANS


# --- What it says of itself -------------------------------------------------------------------------------------------


def test_no_frame_and_no_vehicle_is_in_both_splits(made):
    splits = {}
    for name in ("train", "val"):
        splits[name] = set(map(int, (made / "kitti" / "ImageSets" / f"{name}.txt").read_text().split()))
    scenes = json.loads((made / "nuscenes" / "v1.0-trainval" / "splits.json").read_text())
    assert {name: {int(one.rpartition("-")[2]) for one in scenes[f"site_{name}"]} for name in splits} == splits
    assert splits["train"] | splits["val"] == set(range(SCANS))
    assert splits["train"]
    assert splits["val"]
    rows = scans_of(made)
    frames = {name: {rows[number]["frame"] for number in numbers} for name, numbers in splits.items()}
    ids = {name: {row["vehicle_id"] for k in numbers for row in boxes_of(made, k)} for name, numbers in splits.items()}
    for one in (frames, ids):
        assert one["train"]
        assert one["val"]
        assert not one["train"] & one["val"]
    assert {rows[number]["split"] for number in splits["val"]} == {"val"}


def test_dataset_json_sums_up_the_tables(made):
    result = json.loads((made / "dataset.json").read_text())
    rows = scans_of(made)
    for split in ("train", "val"):
        numbers = [int(row["scan"]) for row in rows if row["split"] == split]
        boxes = [row for number in numbers for row in boxes_of(made, number)]
        assert result[split]["scans"] == len(numbers)
        assert result[split]["labelled"] == len(boxes) == sum(int(rows[number]["labelled"]) for number in numbers)
        assert result[split]["with_return"] == sum(int(row["points"]) > 0 for row in boxes)
    assert len(result["mountings"]) == 4
    assert {row["mirrored"] for row in rows} == {"0", "1"}


def test_an_npz_cloud_is_read_as_one_of_scan(made):
    cloud, header = read_cloud(made / "npz" / "000003.npz")
    row = scans_of(made)[3]
    assert len(cloud) > 0
    assert header["frame"] == int(row["frame"])
    assert header["mounting"]["yaw_deg"] == float(row["yaw_deg"]) != 0.0
    assert header["scan"]["station_m"] == pytest.approx(float(row["station_m"]), abs=1e-6)


# --- The same bytes, however they came about --------------------------------------------------------------------------


def test_two_workers_write_the_same_bytes(made, tmp_path, capsys, monkeypatch):
    made_by = []
    start = Workers.__init__

    def ready(self, function, processes=1):
        start(self, function, processes)
        self.await_ready()  # so that all have a part in it
        made_by.append(self)

    monkeypatch.setattr(Workers, "__init__", ready)
    done(capsys, *words(made.parent / "scene.toml", tmp_path / "again"), "--workers", 2)
    assert made_by[0].count == 2
    assert digests(tmp_path / "again") == digests(made)


def test_clouds_tell_the_versions_of_the_plan_in_whichever_process_they_are_made(made, tmp_path):
    site = prepare(load_scenario(made.parent / "scene.toml"))
    plan = replace(plan_dataset(site, 1, 1), versions={"blender_lidar": "as planned"})
    (tmp_path / "npz").mkdir()
    dataset_files.DATASET_WRITERS["npz"][1](tmp_path, sample(plan, 0), plan)
    assert read_cloud(tmp_path / "npz" / "000000.npz")[1]["versions"] == plan.versions


def test_what_was_stopped_goes_on_and_has_the_same_bytes(made, tmp_path, capsys, monkeypatch):
    out, asked = tmp_path / "set", words(made.parent / "scene.toml", tmp_path / "set")

    class Stopping(verb.Progress):
        def advance(self, steps: int, note: str = "") -> None:
            super().advance(steps, note)
            if self._done == 9:
                raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(verb, "Progress", Stopping)
        code, _, err = cli(capsys, *asked)
    assert (code, err.splitlines()[-1]) == (1, "blender-lidar: stopped")
    assert not (out / "dataset.json").exists()
    assert (out / "unfinished.json").exists()
    (out / "npz" / "000011.npz").touch()  # of a process that was killed before it wrote the scan's boxes
    (out / "npz" / ".blender_lidar-123-abcdefgh.npz").touch()  # of a process that was killed
    drawn, sample = [], dataset_files.sample
    monkeypatch.setattr(dataset_files, "sample", lambda plan, number: drawn.append(number) or sample(plan, number))
    _, err = done(capsys, *asked)
    assert err.startswith("scans: 9 of 24 done before")
    assert drawn == list(range(9, SCANS))
    assert digests(out) == digests(made)
    said, err = done(capsys, *asked)
    assert (err, drawn[-1]) == ("", SCANS - 1)
    assert f"Data set in {out}: 4 mountings of the RS-16" in said


# --- A detector judged on it ------------------------------------------------------------------------------------------


def kitti_results(made: Path, path: Path) -> Path:
    path.mkdir()
    for labels in (made / "kitti" / "training" / "label_2").iterdir():
        (path / labels.name).write_text("".join(f"{line} 0.9\n" for line in labels.read_text().splitlines()))
    return path


def csv_results(made: Path, path: Path) -> Path:
    names = ("class", "x_m", "y_m", "z_m", "length_m", "width_m", "height_m", "heading_deg")
    rows = [
        [number, *(row[name] for name in names), 0.9]
        for number in range(SCANS)
        for row in boxes_of(made, number, seen=True)
    ]
    return write_table(path, rows, ("frame", *names, "confidence"))


RESULTS = {"label_2": kitti_results, "own.csv": csv_results}


@pytest.mark.parametrize("name", RESULTS)
def test_labels_as_detections_find_every_vehicle_with_a_return(name, made, tmp_path, capsys):
    """Each in the frame of its layout: the road slopes, and the mountings have yaws."""
    own = RESULTS[name](made, tmp_path / name)
    said, _ = done(capsys, "detect", made, "--detector", own, "--out", tmp_path / "judged")
    validating = [row for row in scans_of(made) if row["split"] == "val"]
    assert f"{len(validating)} scans of split val (8 frames), labelled vehicles within 12 m of x 0 m" in said
    result = json.loads((tmp_path / "judged" / "detection.json").read_text())
    given = result["mountings"]["given"]
    counts = [int(row["counted"]) for row in validating]
    assert (result["scan_ids"], given["vehicles"]) == ([int(row["scan"]) for row in validating], sum(counts))
    assert result["blocks"] == len({row["block"] for row in validating}) > 2
    of_all = [row for scan in validating for row in boxes_of(made, int(scan["scan"])) if row["counted"] == "1"]
    assert given["with_return"] == sum(int(row["points"]) > 0 for row in of_all) / sum(counts)
    assert 0.5 < given["with_return"] < 1.0
    for measure in MEASURES:
        assert given[measure] == pytest.approx(1.0 if "precision" in measure else given["with_return"])
        low, high = given["interval_90"][measure]
        assert 0.0 <= low <= given[measure] <= high <= 1.0
    assert {kind: one["recall_0.3"] > 0.5 for kind, one in given["by_kind"].items()} == dict.fromkeys(
        ("car", "truck or bus", "motorcycle"), True
    )
    again = "--detector", tmp_path / "judged" / "label_2", "--out", tmp_path / "again", "--json"
    assert json.loads(done(capsys, "detect", made, *again)[0])["mountings"] == result["mountings"]


def test_pillars_looks_at_the_clouds_from_each_mounting(made, tmp_path, capsys):
    said, _ = done(capsys, "detect", made, "--out", tmp_path / "judged")
    result = json.loads((tmp_path / "judged" / "detection.json").read_text())
    given = result["mountings"]["given"]
    assert given["recall_0.3"] > 0.7 * given["with_return"]
    assert given["precision_0.3"] > 0.7
    assert [note for note in result["notes"] if "too little ground" in note and "at 4 of 4 mountings" in note]
    assert said.count("too little ground") == 1
    assert len(list((tmp_path / "judged" / "label_2").iterdir())) == result["scans"]


def test_without_a_validating_scan_all_judge_and_it_is_said(tmp_path, capsys):
    scene = write_scene(tmp_path, {"traffic": {"holdout": 0.0}})
    done(capsys, "dataset", scene, "--mountings", 1, "--scans", 2, "--out", tmp_path / "set")
    said, _ = done(capsys, "detect", tmp_path / "set", "--out", tmp_path / "judged")
    assert "; 2 scans (2 frames), " in said
    assert "The data set has no validation scans: all are used, though the detector may have been" in said
    result = json.loads((tmp_path / "judged" / "detection.json").read_text())
    assert not result["held_out"]
    assert result["mountings"]["given"]["interval_90"]["recall_0.3"] is None  # of too few blocks


@pytest.fixture
def tables(made, tmp_path):
    """The data set without its clouds, to be damaged."""
    (tmp_path / "set").mkdir()
    for name in ("dataset.json", "scans.csv"):
        shutil.copy(made / name, tmp_path / "set" / name)
    shutil.copytree(made / "boxes", tmp_path / "set" / "boxes")
    return tmp_path / "set"


def edited(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_a_damaged_data_set_is_refused_in_a_line(made, tables, tmp_path, capsys):
    own = csv_results(made, tmp_path / "own.csv")
    asked = "detect", tables, "--detector", own, "--out", tmp_path / "judged"

    def message() -> str:
        return refused(capsys, tmp_path, *asked)

    whole = (tables / "dataset.json").read_text()
    (tables / "dataset.json").write_text(whole[:500])
    assert "dataset.json: is damaged" in message()
    (tables / "dataset.json").rename(tables / "unfinished.json")
    assert "is an unfinished data set; give the command that began it again" in message()
    (tables / "dataset.json").write_text(whole)
    number = next(int(row["scan"]) for row in scans_of(made) if row["split"] == "val")
    (tables / "boxes" / f"{number:06d}.csv").unlink()
    assert f"{number:06d}.csv: there is no such file" in message()


def test_detections_in_another_frame_stop_unless_that_is_accepted(made, tmp_path, capsys):
    own = csv_results(made, tmp_path / "own.csv")
    header, *rows = [line.split(",") for line in own.read_text().splitlines()]
    at = [header.index(name) for name in ("length_m", "width_m")]
    for row in rows:
        row[at[0]], row[at[1]] = row[at[1]], row[at[0]]
    own.write_text("\n".join(map(",".join, [header, *rows])) + "\n")
    words = "detect", made, "--detector", own, "--out", tmp_path / "judged"
    assert "length and width are swapped; if it is right as it is" in refused(capsys, tmp_path, *words)
    assert "Warning, accepted (frames): " in done(capsys, *words, "--accept", "frames")[0]


def test_detections_and_detectors_that_do_not_fit_are_refused(made, tables, tmp_path, capsys):
    def message(*more: object, of: Path = made) -> str:
        return refused(capsys, tmp_path, "detect", of, *more, "--out", tmp_path / "judged")

    own = kitti_results(made, tmp_path / "label_2")
    number = next(int(row["scan"]) for row in scans_of(made) if row["split"] == "val")
    (own / f"{number:06d}.txt").unlink()
    line = message("--detector", own)
    assert f"lacks 1 of the 13 scans of split val of the data set, such as {number}" in line
    (own / "000999.txt").touch()
    assert "has detections of number 999; allowed: scans 0 to 23" in message("--detector", own)
    (tmp_path / "own.csv").write_text((made / "boxes" / "000000.csv").read_text())
    assert "own.csv:1: no column confidence" in message("--detector", tmp_path / "own.csv")
    assert "learns the empty scene from clouds of one mounting" in message("--detector", "classical")
    assert "--height: is an option for scenes, but" in message("--height", 4)
    assert "no such file" in message("--detector", "pillar")
    assert "000001.npz: there is no such file" in message(of=tables)
    edited(tables / "dataset.json", '"npz",', "")
    assert "has no NPZ clouds but kitti, nuscenes; allowed" in message(of=tables)
    line = refused(capsys, tmp_path, "detect", made / "npz", "--detector", own, "--out", tmp_path / "judged")
    assert "to judge a file of detections give detect SCENE or DATASET --detector FILE" in line


# --- What is refused --------------------------------------------------------------------------------------------------


def test_another_plan_in_the_folder_is_refused_with_what_differs(made, capsys):
    scene = made.parent / "scene.toml"
    for more, what in {
        ("--mountings", 5): "--mountings = 4, not 5",
        ("--seed", 8): "[search] seed = 1, not 8",
        ("--layout", "kitti"): "--layout = ['npz', 'kitti', 'nuscenes'], not ['kitti']",
        ("--as-recorded",): "--as-recorded = False, not True",
    }.items():
        asked = [*words(scene, made)]
        if more[0] == "--layout":
            asked = [word for word in asked if word not in LAYOUTS]
        if more[0] in asked:
            asked[asked.index(more[0]) + 1] = more[1]
        else:
            asked += more
        line = refused(capsys, made.parent, *asked)
        assert f"--out: {made}: the data set there had {what}; give it the same settings, or another --out" in line


def test_a_folder_of_other_things_and_a_damaged_one_are_refused(tmp_path, capsys):
    scene = scene_in(tmp_path)
    (tmp_path / "set" / "kitti").mkdir(parents=True)
    line = refused(capsys, tmp_path, *words(scene, tmp_path / "set"))
    assert "holds a folder kitti that no data set has written" in line
    for content in ("{", "[]", '{"identity": 5}'):
        (tmp_path / "set" / "unfinished.json").write_text(content)
        line = refused(capsys, tmp_path, *words(scene, tmp_path / "set"))
        assert "is damaged" in line or "does not say with which settings" in line or "had" in line


@pytest.mark.parametrize(
    ("more", "what"),
    [
        (("--layout", "npz", "--layout", "npz"), "--layout: names a layout twice"),
        (("--mountings", 0), "--mountings: is 0; allowed: 1 to"),
        (("--scans", "some"), "--scans: is "),
        (("--height", 4), "unrecognized arguments"),
    ],
)
def test_wrong_words_are_refused(more, what, tmp_path, capsys):
    scene = scene_in(tmp_path)
    code, _, err = cli(capsys, "dataset", scene, *more, "--out", tmp_path / "set")
    assert code == 2
    assert what in err.splitlines()[-1]
    assert not (tmp_path / "set").exists()


def test_what_cannot_be_had_is_noted(tmp_path, capsys):
    scene = write_scene(tmp_path, {"traffic": {"holdout": 0.0}, "sensor": {"range_gate_m": 60.0}})
    said, _ = done(capsys, "dataset", scene, "--mountings", 1, "--scans", 2, "--out", tmp_path / "set", "--json")
    notes = json.loads(said)["notes"]
    assert "no frame is held out, so there are no validation scans" in notes
    assert any("is not moved along it" in note for note in notes)
