"""Clouds of several LiDARs: the fused one in the site frame, and each LiDAR's own in the frame of its sensor."""

from __future__ import annotations

import json

import numpy as np
import pytest

import blender_lidar as bl
from blender_lidar.clouds.files import in_own_frame, levelled, read_cloud
from blender_lidar.clouds.points import read_points
from blender_lidar.clouds.scan import PointCloud, joined_clouds
from blender_lidar.clouds.snapshot import mounted_sensors
from blender_lidar.errors import InputError
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import frame_of, read_recording
from blender_lidar.sensors.pose import Pose
from tests.layout_scene import WEST, write_layout_scene
from tests.refusals import refused
from tests.small_scene import done, mounting, write_scene

FRAME = 30
TILTED = "west,height_m=4.2,tilt_x_deg=17,tilt_y_deg=-6,yaw_deg=25"
NAMES = ("west", "east")


@pytest.fixture
def scene(tmp_path):
    return write_layout_scene(tmp_path)


def header_of(path) -> dict:
    """The header of a cloud's file, or what is kept beside it."""
    if path.suffix == ".npz":
        return read_cloud(path)[1]
    if path.suffix == ".bin":
        return json.loads(path.with_suffix(".json").read_text())
    if path.suffix == ".las":
        laspy = pytest.importorskip("laspy", reason="laspy, of the extra formats, is not installed")
        (record,) = (one for one in laspy.read(path).vlrs if one.user_id == "blender_lidar")
        return json.loads(record.record_data)
    start = {".pcd": b"# {", ".ply": b"comment {"}[path.suffix]
    (line,) = (line for line in path.read_bytes().split(b"\n")[:5] if line.startswith(start))
    return json.loads(line[line.index(b"{") :])


def in_site(points: np.ndarray, header: dict) -> np.ndarray:
    matrix = np.array(header["to_site"])
    np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-12)
    return points @ matrix[:3, :3].T + matrix[:3, 3]


@pytest.mark.parametrize(
    ("suffix", "exact_m"), [("npz", 1e-9), ("pcd", 1e-5), ("ply", 1e-5), ("las", 2e-4), ("bin", 1e-5)]
)
def test_each_lidars_own_cloud_lies_where_the_fused_one_has_it(suffix, exact_m, scene, tmp_path, capsys):
    needed = {"las": "laspy", "ply": "plyfile"}
    if suffix in needed:
        pytest.importorskip(needed[suffix], reason="of the extra formats, is not installed")
    out, truth = tmp_path / f"cloud.{suffix}", tmp_path / "truth.npz"
    for path in (out, truth):
        told, _ = done(capsys, "scan", scene, "--frame", FRAME, "--lidar", TILTED, "--out", path)
    whole, header = read_cloud(truth)
    assert f"{len(whole)} points" in told
    fused = read_points(out)[0]
    if suffix == "bin":  # KITTI's frame is a sensor's: that of the first LiDAR, level
        fused = in_site(fused, header_of(out))
    np.testing.assert_allclose(fused, whole.xyz, atol=exact_m)
    for number, name in enumerate(NAMES):
        path = out.with_name(f"cloud_{name}.{suffix}")
        own = np.load(path)["xyz"] if suffix == "npz" else read_points(path)[0]
        np.testing.assert_allclose(in_site(own, header_of(path)), whole.xyz[whole.lidar == number], atol=exact_m)
        pose = Pose.from_table(header["lidars"][number]["pose"])
        assert header["lidars"][number]["name"] == name
        if suffix != "bin":
            np.testing.assert_allclose(pose.position + own @ pose.rotation, in_site(own, header_of(path)), atol=1e-9)


def test_own_clouds_are_in_the_frame_of_the_beams(scene, tmp_path, capsys):
    done(capsys, "scan", scene, "--frame", FRAME, "--lidar", TILTED, "--out", tmp_path / "cloud.npz")
    held = np.load(tmp_path / "cloud_west.npz")
    x, y, z = (held["xyz"] / held["range_m"][:, None]).T
    azimuth = np.radians(held["azimuth_deg"])
    elevation = np.radians(read_cloud(tmp_path / "cloud_west.npz")[1]["ring_elevation_deg"])[held["ring"]]
    np.testing.assert_allclose(z, np.sin(elevation), atol=1e-6)
    np.testing.assert_allclose(
        [x, y], [np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation)], atol=1e-6
    )


@pytest.mark.parametrize("suffix", ["npz", "pcd", "ply", "las"])
def test_the_column_lidar_counts_them_in_the_scenes_order(suffix, scene, tmp_path, capsys):
    path = tmp_path / f"cloud.{suffix}"
    done(capsys, "scan", scene, "--frame", FRAME, "--out", tmp_path / "truth.npz")
    done(capsys, "scan", scene, "--frame", FRAME, "--out", path)
    whole = read_cloud(tmp_path / "truth.npz")[0]
    if suffix == "npz":
        column = np.load(path)["lidar"]
    elif suffix == "pcd":
        pypcd4 = pytest.importorskip("pypcd4", reason="pypcd4 is not installed")
        column = pypcd4.PointCloud.from_path(path).pc_data["lidar"]
    elif suffix == "ply":
        plyfile = pytest.importorskip("plyfile", reason="plyfile is not installed")
        column = plyfile.PlyData.read(path)["vertex"]["lidar"]
    else:
        column = pytest.importorskip("laspy", reason="laspy is not installed").read(path)["lidar"]
    assert column.dtype == np.uint8
    assert set(np.unique(column)) == {0, 1}
    np.testing.assert_array_equal(column, whole.lidar)


def test_the_fused_cloud_is_what_each_lidar_measures_alone(scene):
    scenario = load_scenario(scene)
    vehicles = frame_of(read_recording(scenario), FRAME, "frame")
    sensors = mounted_sensors(scenario, scenario.baselines)
    fused = joined_clouds([sensor.scan(vehicles) for sensor in sensors])
    for number, one in enumerate(map(scenario.with_lidars, scenario.lidars)):
        alone = mounted_sensors(one, (one.lidar.baseline,))[0].scan(vehicles)
        np.testing.assert_array_equal(fused.xyz[fused.lidar == number], alone.xyz)
        np.testing.assert_array_equal(fused.ring[fused.lidar == number], alone.ring)
        assert not alone.lidar.any()


def test_lidars_of_a_layout_see_the_same_clutter(tmp_path):
    scenario = load_scenario(write_layout_scene(tmp_path, world={"clutter": 1.0}))
    one, other = mounted_sensors(scenario, scenario.baselines)
    assert one.scenery is other.scenery is not None


def test_imperfections_of_two_lidars_are_drawn_by_their_names(tmp_path):
    twins = [{**WEST, "name": name} for name in NAMES]
    scenario = load_scenario(write_layout_scene(tmp_path, *twins, sensor={"range_noise_m": 0.02}))
    vehicles = frame_of(read_recording(scenario), FRAME, "frame")
    one, other = (sensor.scan(vehicles) for sensor in mounted_sensors(scenario, scenario.baselines))
    assert len(one) == len(other)
    assert (one.range_m != other.range_m).mean() > 0.9


@pytest.mark.parametrize("form", ["npz", "sustechpoints", "bin"])
def test_many_frames_make_a_folder_for_each_lidar_and_can_be_made_again(form, scene, tmp_path, capsys):
    words = ("scan", scene, "--frame-ids", "20,30", "--format", form, "--out", tmp_path / "clouds")
    told, _ = done(capsys, *words)
    assert f"{tmp_path / 'clouds_west'}, {tmp_path / 'clouds_east'}" in told
    folders = [tmp_path / "clouds", *(tmp_path / f"clouds_{name}" for name in NAMES)]
    made = [{path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.*")} for folder in folders]
    assert len({frozenset(names) for names in made}) == 1
    done(capsys, *words)
    again = [{path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.*")} for folder in folders]
    assert form == "npz" or again == made  # an archive keeps the time of day


def test_labels_of_sustechpoints_lie_on_the_fused_points(scene, tmp_path, capsys):
    done(capsys, "scan", scene, "--frame-ids", "30", "--format", "sustechpoints", "--out", tmp_path / "set")
    done(capsys, "scan", scene, "--frame", 30, "--out", tmp_path / "cloud.npz")
    whole, header = read_cloud(tmp_path / "cloud.npz")
    boxes = json.loads((tmp_path / "set" / "label" / "000030.json").read_text())
    assert {int(one["obj_id"]) for one in boxes} == set(whole.vehicle_id[whole.vehicle_id >= 0].tolist())
    points, vehicle = read_points(tmp_path / "set" / "lidar" / "000030.pcd")
    pose = Pose.from_table(header["lidars"][0]["pose"])
    np.testing.assert_allclose(points, levelled(whole.xyz, pose), atol=1e-5)
    for one in boxes:
        centre = [one["psr"]["position"][axis] for axis in "xyz"]
        on_it = points[vehicle == int(one["obj_id"])]
        assert (np.linalg.norm(on_it - centre, axis=1) < 7.0).all()


def test_detect_takes_the_folder_of_one_lidar_and_refuses_that_of_all(scene, tmp_path, capsys):
    pytest.importorskip("sklearn", reason="scikit-learn, of the extra detect, is not installed")
    done(capsys, "scan", scene, "--frame-ids", "5:50:5", "--out", tmp_path / "clouds")
    words = ("--detector", "classical", "--out")
    done(capsys, "detect", tmp_path / "clouds_east", *words, tmp_path / "found")
    rows = np.genfromtxt(tmp_path / "found" / "detections.csv", delimiter=",", names=True, encoding=None, dtype=None)
    assert len(rows) > 3
    assert ((rows["y_m"] > 2.0) & (rows["y_m"] < 9.0)).mean() > 0.9  # on the two lanes, in the site frame
    told = refused(capsys, tmp_path, "detect", tmp_path / "clouds", *words, tmp_path / "no")
    assert "is of several LiDARs" in told


def test_a_fused_cloud_is_scored_as_it_was_scanned(scene, tmp_path, capsys):
    site = bl.load_scene(scene)
    scan = bl.scan_frame(site, FRAME, west={"height_m": 4.2}, east={"tilt_x_deg": 10.0})
    scan.write(tmp_path / "cloud.npz")
    from_file = bl.score_cloud(tmp_path / "cloud.npz", scan.vehicles)
    at_once = bl.score_cloud(scan)
    for name in ("points", "entropy_bits"):
        np.testing.assert_array_equal(np.asarray(from_file[name]), np.asarray(at_once[name]))
    alone = [
        bl.score_cloud(
            scan.cloud.xyz[scan.cloud.lidar == k], scan.vehicles, scan.cloud.vehicle_id[scan.cloud.lidar == k]
        )
        for k in (0, 1)
    ]
    np.testing.assert_array_equal(np.asarray(at_once["points"]), sum(np.asarray(one["points"]) for one in alone))
    assert set(np.unique(np.asarray(scan.points["lidar"]))) == {0, 1}
    assert [one["mounting"]["height_m"] for one in scan.header["lidars"]] == [4.2, 2.0]


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"height_m": 4.0}, "height_m: is 4.0; allowed: a mapping"),
        ({"north": {"height_m": 4.0}}, "unknown LiDAR 'north'"),
        ({"west": 4.0}, "west: is 4.0; allowed: a mapping"),
        ({"west": {"high_m": 4.0}}, "west: unknown coordinate 'high_m'"),
    ],
)
def test_mountings_that_are_not_of_the_layout_are_refused_by_name(given, told, scene):
    with pytest.raises(InputError, match=told):
        bl.scan_frame(bl.load_scene(scene), FRAME, **given)


def test_a_mount_in_the_traffic_is_refused_and_nothing_is_written(scene, tmp_path, capsys):
    for out in ("cloud.npz", "cloud.bin"):
        words = ("scan", scene, "--frame", FRAME, "--lidar", "east,y_m=5,height_m=4", "--out", tmp_path / out)
        assert "stands on the carriageway" in refused(capsys, tmp_path, *words)


def test_a_data_set_has_a_folder_for_each_lidar_whose_scans_show_the_same_traffic(scene, tmp_path, capsys):
    words = ("dataset", scene, "--mountings", 2, "--scans", 8, "--frames", 5, "--out", tmp_path / "set", "--workers", 1)
    told, _ = done(capsys, *words)
    assert "As with --as-recorded" in told
    found = {}
    for name in ("west", "east"):
        result = json.loads((tmp_path / "set" / name / "dataset.json").read_text(encoding="utf-8"))
        assert result["sensor"] == {"west": "RS-16", "east": "RS-32"}[name]
        files = sorted((tmp_path / "set" / name).rglob("*.npz"))
        assert len(files) == 8
        found[name] = [read_cloud(path) for path in files]
        assert {one["x_m"] for one in result["mountings"]} == {{"west": -8.0, "east": 8.0}[name]}
    seen_by_both = 0
    for (west, of_west), (east, of_east) in zip(found["west"], found["east"], strict=True):
        assert of_west["frame"] == of_east["frame"]
        both = set(west.vehicle_id[west.vehicle_id >= 0]) & set(east.vehicle_id[east.vehicle_id >= 0])
        seen_by_both += len(both)
        for number in both:  # it is in one place
            a, b = (np.median(one.xyz[one.vehicle_id == number], axis=0) for one in (west, east))
            assert np.hypot(*(a - b)[:2]) < 8.0
    assert seen_by_both


@pytest.mark.parametrize("suffix", ["npz", "pcd", "ply", "bin"])
def test_one_lidar_has_one_file_without_the_column_and_without_a_frame_of_its_own(suffix, tmp_path, capsys):
    files = []
    for folder, lidar in (("short", None), ("named", {"name": "only", "height_m": [2.0, 4.5], "tilt_x_deg": 15.0})):
        made = write_layout_scene(tmp_path / folder, lidar) if lidar else write_scene(tmp_path / folder)
        done(capsys, "scan", made, "--frame", FRAME, "--out", tmp_path / folder / f"cloud.{suffix}")
        names = {path.name for path in (tmp_path / folder).iterdir()} - {"scene.toml", "traffic.csv"}
        assert names == {f"cloud.{suffix}"} | ({"cloud.label"} if suffix == "bin" else set())
        files.append((tmp_path / folder / f"cloud.{suffix}").read_bytes())
    assert b"lidar" not in files[0].replace(b"blender_lidar", b"")
    assert suffix == "npz" or files[0] == files[1]


@pytest.mark.parametrize("level", [False, True])
def test_the_matrix_of_a_frame_is_the_inverse_of_going_there(level):
    pose = mounting({"height_m": 5.0, "x_m": 3.0, "tilt_x_deg": 20.0, "tilt_y_deg": 7.0, "yaw_deg": 40.0}).pose
    points = np.random.default_rng(1).normal(0.0, 30.0, (50, 3))
    cloud = PointCloud(points, *np.zeros((9, 50)))
    made, header = in_own_frame(cloud, {"pose": pose.as_table()}, level=level)
    there = levelled(made.xyz, pose) if level else made.xyz  # what the format's own writer makes of it
    np.testing.assert_allclose(in_site(there, header), points, atol=1e-9)


def test_headers_that_are_damaged_are_refused(scene, tmp_path, capsys):
    done(capsys, "scan", scene, "--frame", FRAME, "--out", tmp_path / "cloud.npz")
    for name, change in (("cloud.npz", {"lidars": [{}]}), ("cloud_west.npz", {"to_site": [1.0, 2.0]})):
        held = dict(np.load(tmp_path / name))
        held["header"] = json.dumps(json.loads(str(held["header"])) | change)
        np.savez(tmp_path / name, **held)
        with pytest.raises(InputError, match="is not an NPZ cloud of scan"):
            read_cloud(tmp_path / name)
