"""Clouds for other programs, read back by readers that are not ours."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.cli import main
from blender_lidar.clouds.files import WRITERS, levelled, write_cloud, write_sustechpoints
from blender_lidar.clouds.points import SEMANTIC_CLASSES, read_points
from blender_lidar.clouds.scan import PointCloud
from blender_lidar.errors import MissingExtraError, OutputError
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.traffic.vehicles import CLASSES
from blender_lidar.world.meshes import SURFACES
from tests.sample_traffic import dense_traffic, scan
from tests.small_scene import write_scene

pytestmark = pytest.mark.versions

HEADER = {"sensor": "RS-16", "pose": {"x_m": 1.0, "y_m": -0.5, "height_m": 4.1, "yaw_deg": 30.0}, "frame": 7}
OTHERS = sorted(set(WRITERS) - {".npz", ".pcd"})


def made(vehicles=20):
    return scan(
        dense_traffic(vehicles=vehicles, length_m=60.0),
        beam_lattice(load_model("RS-16"), stride=20),
        Pose(1.0, -0.5, 4.1, 0.3, 0.0, math.radians(30.0)),
        caster="exact",
        min_range_m=0.4,
        max_range_m=40.0,
    )


CLOUD, EMPTY = made(), made(0)


def with_ids(cloud: PointCloud, vehicle_id: int) -> PointCloud:
    ids = np.where(cloud.vehicle_id >= 0, vehicle_id, -1)
    return PointCloud(**{name: getattr(cloud, name) for name in PointCloud.__slots__} | {"vehicle_id": ids})


@pytest.mark.parametrize("cloud", [CLOUD, EMPTY], ids=["traffic", "empty road"])
def test_a_ply_file_is_what_plyfile_reads(tmp_path, cloud):
    plyfile = pytest.importorskip("plyfile")
    write_cloud(tmp_path / "cloud.ply", cloud, HEADER)
    content = plyfile.PlyData.read(str(tmp_path / "cloud.ply"))
    vertex = content["vertex"]
    np.testing.assert_array_equal(
        np.column_stack([vertex[name] for name in "xyz"]).reshape(-1, 3), cloud.xyz.astype(np.float32)
    )
    np.testing.assert_array_equal(vertex["intensity"], cloud.intensity.astype(np.float32))
    for name, column in (("ring", cloud.ring), ("time", cloud.time_s), ("vehicle_id", cloud.vehicle_id)):
        np.testing.assert_array_equal(vertex[name], column)
    np.testing.assert_array_equal(vertex["class"], cloud.class_index)
    np.testing.assert_array_equal(vertex["surface"], cloud.surface)
    assert json.loads(content.comments[0]) == HEADER


@pytest.mark.parametrize("cloud", [CLOUD, EMPTY], ids=["some", "none"])
def test_a_pcd_file_is_what_pypcd4_reads(tmp_path, cloud):
    pypcd4 = pytest.importorskip("pypcd4")
    write_cloud(tmp_path / "cloud.pcd", cloud, HEADER)
    content = pypcd4.PointCloud.from_path(tmp_path / "cloud.pcd")
    assert content.points == len(cloud)
    np.testing.assert_allclose(content.numpy(("x", "y", "z")).reshape(-1, 3), cloud.xyz, atol=1e-5)
    np.testing.assert_array_equal(content.numpy(("ring",)).ravel(), cloud.ring)
    for name, column in (("vehicle_id", cloud.vehicle_id), ("class", cloud.class_index), ("surface", cloud.surface)):
        np.testing.assert_array_equal(content.numpy((name,)).ravel(), column)
    comment = (tmp_path / "cloud.pcd").read_bytes().split(b"\n")[1]
    assert json.loads(comment.removeprefix(b"# ")) == HEADER
    np.testing.assert_allclose(content.numpy(("timestamp",)).ravel(), cloud.time_s)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
@pytest.mark.parametrize("cloud", [CLOUD, EMPTY], ids=["traffic", "empty road"])
def test_a_las_file_is_what_laspy_reads(tmp_path, cloud, suffix):
    laspy = pytest.importorskip("laspy")
    write_cloud(tmp_path / f"cloud{suffix}", cloud, HEADER)
    las = laspy.read(tmp_path / f"cloud{suffix}")
    np.testing.assert_allclose(las.xyz.reshape(-1, 3), cloud.xyz, atol=0.5e-4 + 1e-9)
    np.testing.assert_allclose(np.asarray(las.intensity) / 65535, cloud.intensity, atol=1e-5)
    np.testing.assert_array_equal(las.gps_time, cloud.time_s)
    for name in ("ring", "vehicle_id", "class_index"):
        np.testing.assert_array_equal(las[name], getattr(cloud, name))
    np.testing.assert_array_equal(np.asarray(las.classification) == 64, cloud.vehicle_id >= 0)
    assert json.loads(las.vlrs.get_by_id("blender_lidar")[0].record_data) == HEADER


def test_a_kitti_file_holds_the_levelled_sensors_frame_and_semantickittis_labels(tmp_path):
    write_cloud(tmp_path / "000007.bin", CLOUD, HEADER)
    rows = np.fromfile(tmp_path / "000007.bin", dtype=np.float32).reshape(-1, 4)
    label = np.fromfile(tmp_path / "000007.label", dtype=np.uint32)
    assert len(rows) == len(label) == len(CLOUD)
    np.testing.assert_allclose(np.linalg.norm(rows[:, :3], axis=1), CLOUD.range_m, rtol=1e-6)
    np.testing.assert_allclose(rows[:, 2], CLOUD.xyz[:, 2] - 4.1, atol=1e-5)
    np.testing.assert_array_equal(rows[:, 3], CLOUD.intensity.astype(np.float32))
    of_vehicle = CLOUD.vehicle_id >= 0
    assert of_vehicle.sum() > 100
    np.testing.assert_array_equal(label[of_vehicle] >> 16, CLOUD.vehicle_id[of_vehicle])
    np.testing.assert_array_equal(label[of_vehicle] & 0xFFFF, SEMANTIC_CLASSES[CLOUD.class_index[of_vehicle]])
    assert (label[~of_vehicle] == 40).all()  # road
    assert len(SEMANTIC_CLASSES) == len(CLASSES)


def test_the_levelled_frame_looks_along_the_lidars_y_axis_and_turns_with_its_yaw():
    pose = Pose(2.0, 0.0, 4.0)
    ahead, left = np.array([[2.0, 10.0, 4.0]]), np.array([[-8.0, 0.0, 4.0]])  # across the road, and back along it
    np.testing.assert_allclose(levelled(ahead, pose), [[10.0, 0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(levelled(left, pose), [[0.0, 10.0, 0.0]], atol=1e-12)
    turned = replace(pose, yaw=0.5 * np.pi)  # counter-clockwise: its +y now looks back along the road
    np.testing.assert_allclose(levelled(left, turned), [[10.0, 0.0, 0.0]], atol=1e-12)


@pytest.mark.parametrize(
    ("suffix", "largest"), [(".ply", 2**31 - 1), (".pcd", 2**31 - 1), (".las", 2**31 - 1), (".bin", 2**16 - 1)]
)
def test_an_id_that_a_format_cannot_hold_is_refused_and_nothing_is_left(tmp_path, suffix, largest):
    if suffix == ".las":
        pytest.importorskip("laspy")
    write_cloud(tmp_path / f"fits{suffix}", with_ids(CLOUD, largest), HEADER)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(OutputError, match=rf"wide\{suffix}: vehicle_id {largest + 1} does not fit into .*npz keeps it"):
        write_cloud(tmp_path / f"wide{suffix}", with_ids(CLOUD, largest + 1), HEADER)
    assert sorted(tmp_path.iterdir()) == before


def test_without_laspy_a_las_file_is_refused_with_the_extra_that_brings_it(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "laspy", None)
    with pytest.raises(MissingExtraError, match=r"blender_lidar\[formats\]"):
        write_cloud(tmp_path / "cloud.las", CLOUD, HEADER)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", OTHERS)
def test_scan_writes_every_format(tmp_path, capsys, suffix):
    if suffix in (".las", ".laz"):
        pytest.importorskip("laspy")
    words = ["scan", str(write_scene(tmp_path)), "--frame", "30", "--height", "4.1", "--caster", "exact"]
    assert main([*words, "--out", str(tmp_path / f"cloud{suffix}")]) == 0
    assert (tmp_path / f"cloud{suffix}").stat().st_size > 1000
    assert "points" in capsys.readouterr().out


def test_labels_of_sustechpoints_hold_the_points_of_their_vehicles(tmp_path):
    """Each point of a vehicle lies within the box that its label gives, in the frame of the cloud beside it."""
    vehicles = dense_traffic(vehicles=20, length_m=60.0)
    write_sustechpoints(tmp_path, CLOUD, vehicles, HEADER)
    name = f"{vehicles.frame:06d}"
    points, vehicle_id = read_points(tmp_path / "lidar" / f"{name}.pcd")
    labels = json.loads((tmp_path / "label" / f"{name}.json").read_text())
    assert {label["obj_id"] for label in labels} == {str(number) for number in set(vehicle_id.tolist()) - {-1}}
    assert len(labels) > 3
    for label in labels:
        position, rotation, scale = (
            np.array([label["psr"][part][axis] for axis in "xyz"]) for part in ("position", "rotation", "scale")
        )
        mine = points[vehicle_id == int(label["obj_id"])] - position
        cos, sin = math.cos(rotation[2]), math.sin(rotation[2])
        inside = np.column_stack([cos * mine[:, 0] + sin * mine[:, 1], cos * mine[:, 1] - sin * mine[:, 0], mine[:, 2]])
        assert (np.abs(inside) <= 0.5 * scale + 1e-4).all()
        assert np.abs(inside).max() > 0.3 * scale.min()
        assert rotation[:2].tolist() == [0.0, 0.0]
        row = np.flatnonzero(vehicles.vehicle_id == int(label["obj_id"]))[0]
        assert label["obj_type"].lower() == vehicles.class_name[row]


def test_scan_writes_a_cloud_for_each_of_many_frames(tmp_path, capsys):
    scene, mount = str(write_scene(tmp_path)), ["--height", "4.1", "--tilt-x", "10", "--caster", "exact"]
    assert main(["scan", scene, "--frame-ids", "20:40:10", *mount, "--out", str(tmp_path / "clouds")]) == 0
    printed = capsys.readouterr()
    assert sorted(path.name for path in (tmp_path / "clouds").iterdir()) == ["000020.npz", "000030.npz", "000040.npz"]
    assert "scan: 3 of 3" in printed.err
    assert main(["scan", scene, "--frame", "30", *mount, "--out", str(tmp_path / "alone.npz")]) == 0
    with np.load(tmp_path / "clouds" / "000030.npz") as one_of_many, np.load(tmp_path / "alone.npz") as alone:
        assert one_of_many.files == alone.files
        for name in alone.files:
            np.testing.assert_array_equal(one_of_many[name], alone[name])
        total = f"3 clouds with {sum(len(np.load(path)['xyz']) for path in (tmp_path / 'clouds').iterdir())} points"
    assert total in printed.out


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--frame", "30", "--format", "ply", "--out", "cloud.npz"], "--format: goes with --frame-ids"),
        (["--frame-ids", "20,20", "--out", "clouds"], "--frame-ids: names a frame twice"),
        (["--frame-ids", "20,999", "--out", "clouds"], "--frame-ids: .*999"),
        (["--frame-ids", "20", "--out", "scene.toml"], "is a file; allowed: a folder"),
        (["--frame-ids", "20", "--format", "xyz", "--out", "clouds"], "--format: invalid choice: 'xyz'"),
        (["--frame", "20", "--frame-ids", "20", "--out", "clouds"], "--frame: is given beside --frame-ids"),
        (["--out", "cloud.npz"], "--frame: is missing; allowed: --frame K, or --frame-ids"),
    ],
)
def test_bad_choices_of_frames_and_formats_are_one_line(tmp_path, monkeypatch, capsys, words, says):
    scene = write_scene(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert main(["scan", str(scene), "--caster", "exact", *words]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert re.search(says, err)
    assert not (tmp_path / "clouds").exists()


def test_scan_writes_a_folder_for_sustechpoints(tmp_path):
    words = ["scan", str(write_scene(tmp_path)), "--height", "4.1", "--caster", "exact", "--frame-ids", "20,30"]
    assert main([*words, "--format", "sustechpoints", "--out", str(tmp_path / "scene")]) == 0
    found = sorted(path.relative_to(tmp_path / "scene").as_posix() for path in (tmp_path / "scene").rglob("*.*"))
    assert found == ["label/000020.json", "label/000030.json", "lidar/000020.pcd", "lidar/000030.pcd"]


def test_scenery_is_labelled_by_what_it_is_and_never_road(tmp_path):
    surface = np.where(CLOUD.vehicle_id >= 0, CLOUD.surface, np.arange(len(CLOUD)) % len(SURFACES))
    cloud = replace(CLOUD, surface=surface.astype(np.uint8))
    write_cloud(tmp_path / "c.bin", cloud, HEADER)
    label = np.fromfile(tmp_path / "c.label", dtype=np.uint32) & 0xFFFF
    expected = {"road": 40, "building": 50, "vegetation": 70, "structure": 52, "person": 30, "cyclist": 31}
    for name, number in expected.items():
        rows = (cloud.vehicle_id < 0) & (surface == SURFACES.index(name))
        assert rows.any()
        assert (label[rows] == number).all(), name
    pytest.importorskip("laspy")
    import laspy

    write_cloud(tmp_path / "c.las", cloud, HEADER)
    classes = np.asarray(laspy.read(tmp_path / "c.las").classification)
    for name, number in {"road": 11, "building": 6, "vegetation": 5, "structure": 1, "person": 1}.items():
        assert (classes[(cloud.vehicle_id < 0) & (surface == SURFACES.index(name))] == number).all(), name
