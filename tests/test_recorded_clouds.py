"""Clouds of a recording: their beams, the place of their sensor, labels of tools, and detectors judged by these."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest

import tests.research  # noqa: F401
from blender_lidar.clouds.commissioned import Hung, read_commission
from blender_lidar.clouds.files import in_own_frame, read_cloud, write_cloud
from blender_lidar.clouds.rings import beam_phase, on_beams
from blender_lidar.detection.classical import ClassicalDetector
from blender_lidar.detection.files import kitti_labels
from blender_lidar.detection.fitted_boxes import fit_boxes
from blender_lidar.detection.labels import read_labels
from blender_lidar.detection.stored import AS_RECORDED, RecordedClouds
from blender_lidar.errors import InputError
from blender_lidar.files import write_columns
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.imperfections import Imperfections
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.traffic.boxes import Boxes
from blender_lidar.traffic.vehicles import CLASSES
from roadside_detection import main as tables
from tests.recorded_samples import CASTER, SENSOR, scanned, street
from tests.refusals import refused
from tests.small_scene import REGION, cli, done, write_scene

CHENGDU = Path(__file__).parents[2] / "shared" / "data" / "chengdu"
needs_chengdu = pytest.mark.skipif(not CHENGDU.is_dir(), reason=f"no roadside recording at {CHENGDU}")
LATTICE = beam_lattice(load_model("RS-Ruby-Lite-V2R"))
MOUNT = ("--height", 4.5, "--tilt-x", 15)
CLASSICAL = ("--detector", "classical")
FOUND = {
    "sensor": "RS-Ruby-Lite-V2R",
    "axes": "flu",
    "pose": {"x_m": 0, "y_m": 0, "height_m": 3.49, "tilt_x_deg": 0.075, "tilt_y_deg": 0.385, "yaw_deg": -89.72},
    "carriageways": [{"y_m": [-16.5, -2.6], "cross_fall": 0.029}, {"y_m": [2.6, 16.5]}],
    "versions": {},
}


FOUND_CARRIAGEWAYS = [tuple(one["y_m"]) for one in FOUND["carriageways"]]


def needs_scikit_learn():
    pytest.importorskip("sklearn", reason="scikit-learn, of the extra detect, is not installed")


def commission(folder, **changes):
    folder.mkdir(exist_ok=True)
    (folder / "commission.json").write_text(json.dumps({**FOUND, **changes}))
    return folder


# --- Beams ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.float16])
def test_a_beam_is_the_same_in_each_frame_though_columns_lie_off_the_lattice(kind):
    rng, rings = np.random.default_rng(3), LATTICE.rings
    late = LATTICE.step_rad * rng.uniform(-0.5, 0.5, rings)  # half a step off, the nearest column is a matter of chance
    ring, slot = (rng.integers(0, most, 20_000) for most in (rings, LATTICE.columns))
    at, up = LATTICE.azimuth_rad(ring, slot) + late[ring], LATTICE.elevation_rad[ring]
    beams, clouds = [], []
    for _ in range(3):
        away = rng.uniform(5.0, 60.0, len(ring))
        ways = np.column_stack([np.sin(at) * np.cos(up), np.cos(at) * np.cos(up), np.sin(up)])
        clouds.append((away[:, None] * ways).astype(kind).astype(float))
    phase = beam_phase(clouds, LATTICE)
    for points in clouds:
        cloud = on_beams(points, points, LATTICE, phase, "here")
        beams.append(
            (cloud.ring, np.rint((cloud.azimuth_rad - LATTICE.slot_azimuth0_rad[cloud.ring]) / LATTICE.step_rad))
        )
        np.testing.assert_allclose(cloud.range_m, np.linalg.norm(points, axis=1))
    off = np.angle(np.exp(2j * np.pi * (phase - late) / LATTICE.step_rad))
    assert np.abs(off).max() < 0.3
    for found, slots in beams:
        assert (found == ring).mean() > 0.999
        same = (slots == beams[0][1]) | (np.abs(slots - beams[0][1]) == LATTICE.columns)
        assert same.mean() > (0.97 if kind is np.float16 else 0.9999)


def test_another_sensor_or_a_cloud_upside_down_is_refused():
    points = np.random.default_rng(1).normal(size=(500, 3))
    with pytest.raises(InputError, match=r"here: .* are near the rings of RS-Ruby-Lite-V2R, .* or other axes"):
        on_beams(points, points, LATTICE, np.zeros(LATTICE.rings), "here")


# --- commission.json --------------------------------------------------------------------------------------------------


def test_a_commission_is_read_from_its_folder_or_file_and_may_hold_more(tmp_path):
    found = read_commission(commission(tmp_path))
    assert found == read_commission(tmp_path / "commission.json")
    assert found.sensor == "RS-Ruby-Lite-V2R"
    assert found.carriageways == [(-16.5, -2.6), (2.6, 16.5)]
    ahead, left = found.placed(np.array([[10.0, 0.0, 0.0], [0.0, 10.0, 0.0]])) - [0.0, 0.0, 3.49]
    np.testing.assert_allclose([ahead[0], left[1]], 10.0, atol=0.01)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"sensor": "RS-79"}, "commission.json: unknown"),
        ({"sensor": None}, "commission.json sensor: is missing"),
        ({"axes": "xyz"}, "commission.json: --axes: is 'xyz'; allowed: three letters"),
        ({"pose": {"x_m": 0}}, "[pose] y_m: is missing"),
        ({"pose": {**FOUND["pose"], "height_m": -1}}, "[pose] height_m: is -1; allowed: "),
        ({"pose": [0, 0, 3]}, "allowed: a table"),
        ({"carriageways": []}, "carriageways: is []; allowed: a list of tables"),
        ({"carriageways": [{"y_m": [4, 2]}]}, "carriageways 1 y_m: "),
        ({"carriageways": [{}]}, "carriageways 1 y_m: is missing"),
    ],
)
def test_a_commission_that_says_nothing_usable_is_refused(changes, text, tmp_path, capsys):
    folder = commission(tmp_path / "found", **changes)
    (tmp_path / "clouds").mkdir()
    assert text in refused(capsys, tmp_path, "detect", tmp_path / "clouds", "--commission", folder)


def test_a_commission_says_all_and_must_be_there(tmp_path, capsys):
    folder, clouds = commission(tmp_path / "found"), tmp_path / "clouds"
    clouds.mkdir()
    beside = ("--commission", folder, "--sensor", "RS-80", "--axes", "flu")
    assert "--axes, --sensor: beside --commission" in refused(capsys, tmp_path, "detect", clouds, *beside)
    assert "there is no such file" in refused(capsys, tmp_path, "detect", clouds, "--commission", tmp_path / "none")
    (folder / "commission.json").write_text("{")
    assert "is not JSON" in refused(capsys, tmp_path, "detect", clouds, "--commission", folder)
    placed = ("detect", clouds, "--commission", commission(folder), "--region")
    assert "allowed: two corners, the lower x and y first" in refused(capsys, tmp_path, *placed, 5, 5, 1, 9)
    assert "--region: is given without --pose" in refused(capsys, tmp_path, "detect", clouds, "--region", 0, 0, 1, 1)


# --- Detectors --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    """Clouds of scan as NPZ, and as a recording has them: PCD in the frame of the tilted sensor, in any order."""
    from blender_lidar.cli import main

    folder = tmp_path_factory.mktemp("scans")
    scene = write_scene(folder, REGION)
    words = ("scan", scene, "--frame-ids", "5:40:5", *MOUNT, "--out", folder / "npz")
    assert main([str(word) for word in words]) == 0
    (folder / "pcd").mkdir()
    rng = np.random.default_rng(1)
    for path in (folder / "npz").glob("*.npz"):
        cloud, header = read_cloud(path)
        own, header = in_own_frame(cloud.select(rng.permutation(len(cloud))), header, level=False)
        write_cloud(folder / "pcd" / f"sweep_{header['frame']:06d}.pcd", own, header)
    return folder


PLACED = ("--pose", 0, 0, 4.5, 15, 0, 0, "--sensor", "RS-16")


def boxes_in(folder):
    return np.genfromtxt(folder / "detections.csv", delimiter=",", skip_header=1, usecols=(0, 2, 3, 5, 6, 9))


def test_a_recording_gives_the_boxes_that_its_scan_does(scans, tmp_path, capsys):
    needs_scikit_learn()
    done(capsys, "detect", scans / "npz", *CLASSICAL, "--out", tmp_path / "of_npz")
    turns = ("--pose", 0, 0, 4.5, 15, 0, 0, "--sensor", "rs16")
    done(capsys, "detect", scans / "pcd", *turns, *CLASSICAL, "--out", tmp_path / "of_pcd")
    given, found = boxes_in(tmp_path / "of_npz"), boxes_in(tmp_path / "of_pcd")
    assert given.shape == found.shape
    assert len(given) > 10
    np.testing.assert_allclose(given, found, atol=0.01)


def test_no_cloud_teaches_its_own_background(scans, tmp_path, capsys, monkeypatch):
    needs_scikit_learn()
    learnt = []
    monkeypatch.setattr(ClassicalDetector, "learn", lambda self, images: learnt.append(np.array(images)))
    done(capsys, "detect", scans / "npz", *CLASSICAL, "--workers", 1, "--out", tmp_path / "found")
    assert len(learnt) == 8
    whole = {image.tobytes() for images in learnt for image in images}
    for images in learnt:
        assert len(whole - {image.tobytes() for image in images}) == 1


def test_detections_are_judged_by_boxes_within_the_rectangle(scans, tmp_path, capsys):
    needs_scikit_learn()
    words = (scans / "pcd", *PLACED, *CLASSICAL, "--boxes", scans / "traffic.csv", "--region", -15, 0, 15, 12)
    out, _ = done(capsys, "detect", *words, "--out", tmp_path / "found")
    result = json.loads((tmp_path / "found" / "detection.json").read_text())
    given = result["mountings"]["given"]
    assert result["frame_ids"] == [*range(5, 45, 5)]
    assert given["vehicles"] >= 8
    assert given["recall_0.1"] > 0.8
    assert given["interval_90"]["recall_0.3"][0] <= given["recall_0.3"] <= given["interval_90"]["recall_0.3"][1]
    assert "not labelled counts as a false alarm" in " ".join(out.split())
    assert np.abs(boxes_in(tmp_path / "found")[:, 1]).max() <= 15.0
    rows = (scans / "traffic.csv").read_text().splitlines()
    (tmp_path / "some.csv").write_text("\n".join([rows[0], *(row for row in rows[1:] if row.startswith("10,"))][:2]))
    words = (*words[:-7], "--boxes", tmp_path / "some.csv", "--out", tmp_path / "few", "--json")
    fewer = json.loads(done(capsys, "detect", *words)[0])
    assert fewer["frame_ids"] == [10]
    assert "7 of the 8 clouds have no boxes" in " ".join(fewer["notes"])
    words = (scans / "npz", *CLASSICAL, "--boxes", scans / "traffic.csv", "--out", tmp_path / "npz", "--json")
    assert json.loads(done(capsys, "detect", *words)[0])["mountings"]["given"]["recall_0.3"] > 0.7


def test_boxes_of_other_frames_are_refused(scans, tmp_path, capsys):
    (tmp_path / "boxes.csv").write_text(
        "frame,vehicle_id,class,x_m,y_m,length_m,width_m,heading_deg\n900,1,car,0,5,4,2,0\n901,1,car,0,5,4,2,0\n"
    )
    words = (
        scans / "pcd",
        *PLACED,
        "--region",
        -9,
        0,
        9,
        9,
        "--boxes",
        tmp_path / "boxes.csv",
        "--out",
        tmp_path / "x",
    )
    _, _, err = cli(capsys, "detect", *words)
    line = err.splitlines()[-1]
    assert not (tmp_path / "x").exists()
    assert "has the frames 900 to 901, and the clouds 5 to 40" in line


def test_a_cloud_of_another_sensor_is_refused(scans, tmp_path, capsys):
    needs_scikit_learn()
    words = ("--pose", 0, 0, 4.5, 15, 0, 0, "--sensor", "RS-80", *CLASSICAL)
    assert "near the rings of RS-80" in refused(capsys, tmp_path, "detect", scans / "pcd", *words, begun=True)


# --- Labels of tools --------------------------------------------------------------------------------------------------

LEVEL = Hung("flu", (3.0, -2.0, 4.5, 0.0, 0.0, 20.0), "RS-16")


def test_labels_of_sustechpoints_are_the_boxes_that_were_scanned(scans, tmp_path, capsys):
    words = ("scan", scans / "scene.toml", "--frame-ids", "10,20", *MOUNT, "--yaw", 20, "--format", "sustechpoints")
    done(capsys, *words, "--out", tmp_path / "tool")
    found = read_labels(tmp_path / "tool" / "label", Hung("flu", (0.0, 0.0, 4.5, 0.0, 0.0, 20.0)))
    rows = list(csv.DictReader((scans / "traffic.csv").open()))
    assert found.frames.tolist() == [10, 20]
    for row in range(len(found)):
        frame, number = found.frame[row], found.vehicle_id[row]
        (one,) = (r for r in rows if int(r["frame"]) == frame and int(r["vehicle_id"]) == number)
        place = [float(one["x_m"]), float(one["y_m"]), 0.5 * float(one["height_m"])]
        np.testing.assert_allclose(found.centre_m[row], place, atol=1e-3)
        np.testing.assert_allclose(found.size_m[row], [float(one[f"{key}_m"]) for key in ("length", "width", "height")])
        assert abs(math.remainder(found.heading_rad[row], math.tau)) < 1e-4


@pytest.mark.parametrize("score", ["", " 0.9"])
def test_label_texts_of_kitti_are_the_boxes_that_were_written(score, tmp_path):
    vehicles = street(2)
    heads = [f"{name} 0 0 0" for name in ("Car", "Van", "Truck", "Cyclist", "Car", "Tram", "Car")]
    text = kitti_labels(heads, vehicles, LEVEL.pose, [score] * len(vehicles))
    (tmp_path / "000007.txt").write_text(text + "DontCare" + " -1" * 14 + "\n")
    found = read_labels(tmp_path / "000007.txt", LEVEL).at(7)
    np.testing.assert_allclose(found.centre_m, vehicles.centre_m, atol=2e-3)
    np.testing.assert_allclose(found.size_m, vehicles.size_m, atol=1e-3)
    turn = np.angle(np.exp(1j * (found.heading_rad - vehicles.heading_rad)))
    np.testing.assert_allclose(turn, 0.0, atol=1e-3)
    assert found.class_name.tolist() == ["car", "van", "truck", "bicycle", "car", "bus", "car"]


PSR = {key: {"x": 1, "y": 2, "z": 3} for key in ("position", "rotation", "scale")}
BOX = {"obj_id": "1", "obj_type": "Car", "psr": PSR}


@pytest.mark.parametrize(
    ("name", "content", "text"),
    [
        ("1.json", "[", "is not JSON"),
        ("1.json", "{}", "is no list of boxes"),
        ("1.json", "[3]", "entry 1 is no box"),
        ("1.json", json.dumps([BOX, {**BOX, "psr": {}}]), "entry 2 is no box"),
        ("1.json", json.dumps([{**BOX, "psr": {**PSR, "scale": {"x": 0, "y": 1, "z": 1}}}]), "length_m is 0"),
        ("1.json", json.dumps([{**BOX, "obj_type": "Spaceship"}]), "Spaceship"),
        ("1.json", "[]", "has no vehicle"),
        ("1.txt", "Car 0 0\n", "1.txt:1: 3 fields; allowed: 15 or 16"),
        ("1.txt", "Car 0 0 0 0 0 0 0 1.5 1.8 x 0 0 0 0\n", "1.txt:1: 'x' is no number"),
    ],
)
def test_labels_that_are_none_are_refused(name, content, text, tmp_path):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=text):
        read_labels(tmp_path / name)


def test_files_of_labels_bear_the_numbers_of_their_frames(tmp_path):
    for name in ("a.json", "b.json"):
        (tmp_path / name).write_text(json.dumps([BOX]))
    with pytest.raises(InputError, match=r"a.json: its name does not end with the number of a frame"):
        read_labels(tmp_path)
    with pytest.raises(FileNotFoundError, match="has no labels"):
        read_labels(tmp_path.parent)


# --- compare ----------------------------------------------------------------------------------------------------------


def test_compare_takes_commission_and_labels_and_several_losses_at_once(tmp_path, capsys):
    """One cloud in the road frame with a table, and in its sensor's with a tool's labels and a commission."""
    vehicles, pose = street(3), Pose(height_m=4.0, tilt_x=0.1, yaw=0.2)
    cloud = scanned(vehicles, pose)
    np.savez(tmp_path / "road.npz", xyz=cloud.xyz)
    own = pose.to_sensor(cloud.xyz) @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # x ahead, y left
    np.savez(tmp_path / "own_000003.npz", xyz=own)
    keys = ("x_m", "y_m", "z_m", "length_m", "width_m", "height_m")
    table = dict(zip(keys, np.column_stack([vehicles.centre_m, vehicles.size_m]).T.tolist(), strict=True))
    table |= {"vehicle_id": vehicles.vehicle_id.tolist(), "heading_deg": np.degrees(vehicles.heading_rad).tolist()}
    table |= {"frame": [3] * len(vehicles), "class": ["car"] * len(vehicles)}
    with (tmp_path / "boxes.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows([[*table], *zip(*table.values(), strict=True)])
    at = {
        "x_m": 0,
        "y_m": 0,
        "height_m": 4.0,
        "tilt_x_deg": math.degrees(0.1),
        "tilt_y_deg": 0,
        "yaw_deg": math.degrees(0.2),
    }
    found = commission(tmp_path / "found", sensor=SENSOR, pose=at)
    angles = ("--tilt-x", math.degrees(0.1), "--yaw", math.degrees(0.2), "--sensor", SENSOR, "--height", 4.0)
    shared = ("--boxes", tmp_path / "boxes.csv", "--caster", CASTER, "--json")
    weak, both = ("--losses", "range_at_10_percent_m=40"), ("--losses", "none", "--losses", "range_at_10_percent_m=40")
    results = [
        json.loads(done(capsys, "compare", "--points", tmp_path / name, *shared, *words, "--out", tmp_path / out)[0])
        for name, words, out in (
            ("road.npz", angles, "plain"),
            ("road.npz", (*angles, *weak), "weak"),
            ("own_000003.npz", ("--commission", found, *both), "both"),
        )
    ]
    plain, lossy, of_both = results
    assert of_both["losses"] == ["none", "range_at_10_percent_m=40"]
    assert [one["losses"] for one in of_both["variants"]] == of_both["losses"]
    for alone, beside in zip((plain, lossy), of_both["variants"], strict=True):
        assert alone["variants"][0]["points"] == beside["points"]
        mine, other = (one["absolute_error_bits"]["median"] for one in (alone["variants"][0], beside))
        assert mine == pytest.approx(other, abs=1e-6)
    assert of_both["variants"][0]["points"]["simulated"] > of_both["variants"][1]["points"]["simulated"]
    rows = list(csv.DictReader((tmp_path / "both" / "compare.csv").open()))
    assert {row["losses"] for row in rows} == set(of_both["losses"])
    words = ("compare", "--points", tmp_path / "road.npz", *shared[:2], "--commission", found, "--height", 4.0)
    assert "--height: beside --commission" in refused(capsys, tmp_path, *words)
    assert "--sensor: is missing" in refused(capsys, tmp_path, *words[:5])


# --- Boxes of our own -------------------------------------------------------------------------------------------------


def passing(frame):
    """Vehicles on the left carriageway, which head towards -x, at other places in each frame."""
    rng = np.random.default_rng(frame)
    kinds = [("car", 4.3, 1.8, 1.5), ("van", 5.4, 2.0, 2.2), ("truck", 8.0, 2.5, 3.1), ("car", 4.0, 1.7, 1.45)]
    x = np.array([-24.0, 9.0, 30.0, -48.0]) + rng.uniform(-6.0, 6.0, 4)
    size = np.array([kind[1:] for kind in kinds])
    return Boxes(
        frame=frame,
        time_s=0.0,
        vehicle_id=np.arange(4),
        class_index=np.array([CLASSES.index(kind[0]) for kind in kinds], dtype=np.int8),
        centre_m=np.column_stack([x, [8.0, 4.5, 11.5, 4.5], 0.5 * size[:, 2]]),
        size_m=size,
        heading_rad=np.full(4, np.pi),
        lane=np.ones(4, dtype=np.int16),
    )


def test_boxes_are_fitted_to_what_was_scanned(tmp_path):
    needs_scikit_learn()
    pose = Pose(height_m=3.5, tilt_x=0.01, yaw=-0.5 * math.pi)
    frames = [passing(frame) for frame in range(7)]
    clouds = [scanned(vehicles, pose, sensor="RS-Ruby-Lite-V2R", detail="box") for vehicles in frames]
    table = fit_boxes(clouds, ClassicalDetector(LATTICE, (0.0, 0.0)), [(-14.0, -2.5), (2.5, 14.0)])
    assert len(table["frame"]) == 4 * len(frames)
    write_columns(tmp_path / "boxes.csv", table)
    found = read_labels(tmp_path / "boxes.csv")
    for vehicles in frames:
        boxes, of = found.at(vehicles.frame), table["frame"] == vehicles.frame
        away = np.linalg.norm(boxes.centre_m[:, None, :2] - vehicles.centre_m[None, :, :2], axis=-1)
        assert sorted(away.argmin(axis=1).tolist()) == [0, 1, 2, 3]
        truth = vehicles.select(away.argmin(axis=1))
        assert boxes.class_name.tolist() == truth.class_name.tolist()
        assert np.abs(np.sin(boxes.heading_rad)).max() < 0.05
        assert (np.cos(boxes.heading_rad) < 0.0).all()  # right-hand traffic
        for at, key in enumerate("LWH"):
            known = np.array([key in one for one in table["measured"][of]])
            np.testing.assert_allclose(boxes.size_m[known, at], truth.size_m[known, at], atol=0.25)
        sure = np.isin(table["confidence"][of], ("A", "B"))
        assert sure.sum() >= 3
        np.testing.assert_allclose(boxes.centre_m[sure], truth.centre_m[sure], atol=0.4)


def test_an_empty_road_has_no_boxes():
    needs_scikit_learn()
    pose = Pose(height_m=3.5, yaw=-0.5 * math.pi)
    far = passing(1).select(np.zeros(4, dtype=bool))
    clouds = [scanned(far, pose, sensor="RS-16")] * 3
    detector = ClassicalDetector(beam_lattice(load_model("RS-16")), (0.0, 0.0))
    assert {len(column) for column in fit_boxes(clouds, detector, [(2.5, 14.0)]).values()} == {0}


# --- A real motorway --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def motorway(tmp_path_factory):
    """Ten frames of Chengdu as files, the sensor's place, and the boxes of confidence A to C within 75 m."""
    folder = commission(tmp_path_factory.mktemp("motorway"))
    rows = list(csv.DictReader((CHENGDU / "vehicles_fitted.csv").open()))
    held = np.load(CHENGDU / "frames_float16.npz")
    (folder / "clouds").mkdir()
    for number, name in {int(row["frame"]): row["file"] for row in rows if row["file"] != "raw"}.items():
        np.savez(folder / "clouds" / f"f_{number:04d}.npz", xyz=held[f"s{name}000"])
    kept = [row for row in rows if row["file"] != "raw" and row["confidence"] in "ABC" and float(row["range_m"]) < 75.0]
    with (folder / "boxes.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows([[*kept[0]], *(list(row.values()) for row in kept)])
    return folder


@needs_chengdu
@pytest.mark.parametrize("detector", ["pillars", "classical"])
def test_nine_in_ten_real_vehicles_are_found(detector, motorway, tmp_path, capsys):
    needs_scikit_learn()
    words = (motorway / "clouds", "--commission", motorway, "--detector", detector, "--boxes", motorway / "boxes.csv")
    done(capsys, "detect", *words, "--out", tmp_path / "found")
    given = json.loads((tmp_path / "found" / "detection.json").read_text())["mountings"]["given"]
    assert given["vehicles"] > 60
    assert given["recall_0.3"] > 0.9
    assert given["false_alarms_0.3"] < (40 if detector == "classical" else 10)


@needs_chengdu
def test_boxes_fitted_to_a_real_motorway_are_those_fitted_before(motorway):
    """Nine in ten of the sure ones within 75 m, as high, wide and long to a few centimetres."""
    needs_scikit_learn()
    paths = sorted((motorway / "clouds").iterdir())
    read = RecordedClouds.of(paths, read_commission(motorway), (-100.0, -20.0, 100.0, 20.0), beams=True)
    detector = ClassicalDetector(read.lattice, (0.0, 0.0), Imperfections(dropout=0.1))
    table = fit_boxes(list(map(read, paths)), detector, FOUND_CARRIAGEWAYS)
    frame = np.array([int(path.stem[2:]) for path in paths])[table["frame"]]
    errors, sure = [], [row for row in csv.DictReader((motorway / "boxes.csv").open()) if row["confidence"] in "AB"]
    for row in sure:
        away = np.hypot(table["x_m"] - float(row["x_m"]), table["y_m"] - float(row["y_m"])) + 1e3 * (
            frame != int(row["frame"])
        )
        at = away.argmin()
        if away[at] < 1.5:
            errors.append([table[key][at] - float(row[key]) for key in ("length_m", "width_m", "height_m")])
    assert len(errors) > 0.9 * len(sure)
    assert (np.abs(np.median(errors, axis=0)) < [0.2, 0.1, 0.05]).all()


@needs_chengdu
def test_the_script_of_the_roadside_tables_finds_what_the_verb_finds(capsys):
    needs_scikit_learn()
    assert tables(["--roadside", str(CHENGDU)]) == 0
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    whole = {row[0]: row for row in rows if row[1] == "0 to 100"}
    assert set(whole) == {"pillars", "pillars, levelled", "classical"}
    assert min(int(row[3].split()[0]) for row in whole.values()) > 90
    assert {row[0] for row in rows} >= {"A", "B", "C"}


def test_what_commission_writes_of_a_full_turn_from_another_origin_is_read_by_detect_and_compare(tmp_path, capsys):
    """No blind sector, and clouds whose frame is shifted: the boxes are found where commission fitted them."""
    pytest.importorskip("sklearn", reason="scikit-learn is not installed")
    from tests.test_commission import hung

    folder = tmp_path / "clouds"
    folder.mkdir()
    for frame in range(6):
        points, _ = hung("OS1-64", frame, traffic__frames=6)
        np.savez(folder / f"turn_{frame:06d}.npz", xyz=np.add(points, [10.0, 20.0, 6.0]))
    clouds = sorted(folder.iterdir())
    found = tmp_path / "found"
    assert cli(capsys, "commission", *clouds, "--origin", 10, 20, 6, "--out", found)[0] == 0
    words = "--commission", found, "--boxes", found / "boxes.csv"
    assert cli(capsys, "detect", folder, *words, "--detector", "classical", "--out", tmp_path / "detected")[0] == 0
    result = json.loads((tmp_path / "detected" / "detection.json").read_text())
    assert result["mountings"]["given"]["recall_0.1"] > 0.8
    points = [word for cloud in clouds for word in ("--points", cloud)]  # their names tell the frames
    assert cli(capsys, "compare", *points, *words, "--out", tmp_path / "compared")[0] == 0
    compared = json.loads((tmp_path / "compared" / "compare.json").read_text())
    assert compared["variants"][0]["points"]["real"] > 1000
    assert compared["left_out"]["of a guessed size"] > 0


def test_headings_turn_only_beyond_a_median():
    """One carriageway is two planes where it has a crown."""
    pytest.importorskip("sklearn", reason="scikit-learn is not installed")
    from blender_lidar.clouds.rings import beam_phase, on_beams
    from tests.test_commission import hung

    lattice, clouds = beam_lattice(load_model("OS1-64")), []
    for frame in range(4):
        points, mounting = hung("OS1-64", frame)
        xyz = mounting.pose.to_world(points) + mounting.pose.position
        clouds.append(on_beams(points, xyz, lattice, beam_phase([points], lattice), "here"))
    detector = ClassicalDetector(lattice, (0.0, 0.0), AS_RECORDED)
    one, apart = (
        fit_boxes(clouds, detector, spans) for spans in ([(2.0, 13.0), (13.0, 24.0)], [(2.0, 12.0), (14.0, 24.0)])
    )
    assert np.abs(one["heading_deg"]).max() < 10.0
    assert (np.abs(apart["heading_deg"]) > 90.0).any()
