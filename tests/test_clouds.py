"""Clouds as files: what is written is read back, PCD files of others, and a file is written whole or not at all."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.cli import main
from blender_lidar.clouds.files import WRITERS, levelled, write_cloud
from blender_lidar.clouds.points import check_cloud_name, read_points
from blender_lidar.errors import InputError, MissingExtraError, MissingFileError, OutputError
from blender_lidar.files import whole_file, write_bytes, write_text
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.traffic.vehicles import CLASSES
from blender_lidar.world.meshes import SURFACES
from tests.sample_traffic import dense_traffic, scan

pytestmark = pytest.mark.versions

HEADER = {
    "sensor": "RS-16",
    "pose": {"x_m": 0.0, "y_m": 0.0, "height_m": 4.1, "yaw_deg": 0.0},
    "frame": 7,
    "note": "größer, \u2265 5 m",
}
SUFFIXES = sorted(WRITERS)


def made(vehicles=20, gate=40.0):
    return scan(
        dense_traffic(vehicles=vehicles, length_m=60.0),
        beam_lattice(load_model("RS-16"), stride=20),
        Pose(height_m=4.1, tilt_x=0.3),
        caster="exact",
        min_range_m=0.4,
        max_range_m=gate,
    )


CLOUD, EMPTY = made(), made(0, 1.0)


def files(folder):
    return sorted(path.name for path in folder.iterdir())


def test_npz_holds_the_columns_and_units_of_the_contract(tmp_path):
    write_cloud(tmp_path / "cloud.npz", CLOUD, HEADER)
    with np.load(tmp_path / "cloud.npz", allow_pickle=False) as content:
        assert set(content.files) == {
            *("xyz", "range_m", "ring", "azimuth_deg", "time_s", "vehicle_id", "class", "incidence_deg"),
            *("intensity", "surface", "header"),
        }
        np.testing.assert_array_equal(content["xyz"], CLOUD.xyz)
        for name in ("range_m", "ring", "time_s", "vehicle_id", "intensity"):
            np.testing.assert_array_equal(content[name], getattr(CLOUD, name))
            assert content[name].dtype == getattr(CLOUD, name).dtype
        np.testing.assert_allclose(np.radians(content["azimuth_deg"]), CLOUD.azimuth_rad)
        np.testing.assert_allclose(np.radians(content["incidence_deg"]), CLOUD.incidence_rad)
        names = ["" if index < 0 else CLASSES[index] for index in CLOUD.class_index]
        assert content["class"].tolist() == names
        assert content["surface"].tolist() == [SURFACES[number] for number in CLOUD.surface]
        assert json.loads(str(content["header"])) == HEADER


@pytest.mark.parametrize("suffix", [*SUFFIXES, *map(str.upper, SUFFIXES)])
@pytest.mark.parametrize("cloud", [CLOUD, EMPTY], ids=["filled", "empty"])
def test_points_and_vehicles_are_read_back(tmp_path, suffix, cloud):
    if needed := {".las": "laspy", ".laz": "laspy", ".ply": "plyfile"}.get(suffix.lower()):
        pytest.importorskip(needed)
    path = tmp_path / f"cloud{suffix}"
    write_cloud(path, cloud, HEADER)
    of_kitti, of_las = suffix.lower() == ".bin", suffix.lower() in (".las", ".laz")
    assert files(tmp_path) == sorted([path.name, *(["cloud.label"] if of_kitti else [])])
    points, vehicle = read_points(path)
    assert points.dtype == np.float64
    xyz = levelled(cloud.xyz, Pose.from_table(HEADER["pose"])) if of_kitti else cloud.xyz
    np.testing.assert_allclose(points, xyz, rtol=1e-6, atol=1e-4 if of_las else 2e-6)
    assert points.shape == cloud.xyz.shape
    np.testing.assert_array_equal(vehicle, cloud.vehicle_id)
    assert vehicle.dtype == np.int64


def test_score_notes_once_how_many_points_were_left_out(tmp_path, capsys):
    np.savez(tmp_path / "cloud.npz", xyz=np.array([[0.0, 4.0, 0.7], [np.nan, 4.0, 0.7]]))
    boxes = tmp_path / "boxes.csv"
    boxes.write_text("frame,vehicle_id,class,x_m,y_m,length_m,width_m,height_m,heading_deg\n0,7,car,0,5,4,2,1.5,0\n")
    words = ["--points", str(tmp_path / "cloud.npz"), "--boxes", str(boxes), "--assign", "box", "--json"]
    assert main(["score", *words]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["points"] == json.loads(out)["vehicles"][0]["points"] == 1
    assert err == f"blender-lidar: note: {tmp_path / 'cloud.npz'}: 1 of 2 points left out: not finite\n"


def refusal(path):
    """The one line with which a file is refused; it begins with the file's name."""
    with pytest.raises(InputError) as error:
        read_points(path)
    text = str(error.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    return text.removeprefix(f"{path}: ")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("arrays", "says"),
    [
        ({"cloud": np.zeros((2, 3))}, "has no array 'xyz' or 'points'; it has cloud"),
        ({"xyz": np.zeros((2, 2))}, "xyz has shape (2, 2); allowed: (n, 3)"),
        ({"xyz": np.zeros(3)}, "xyz has shape (3,); allowed: (n, 3)"),
        ({"xyz": np.zeros((2, 3)), "vehicle_id": np.zeros(3)}, "vehicle_id has shape (3,); allowed: (2,)"),
        ({"xyz": np.zeros((2, 3)), "vehicle_id": np.array([1, np.nan])}, "vehicle_id is nan; allowed: whole numbers"),
        ({"xyz": np.zeros((1, 3)), "vehicle_id": np.array(["7"])}, "vehicle_id is of type <U1; allowed: whole numbers"),
        ({"xyz": np.array([["a", "b", "c"]])}, "xyz is of type <U1; allowed: numbers"),
        ({"xyz": np.array([[None, 1, 2]], dtype=object)}, "is not a readable NPZ file"),
    ],
)
def test_an_npz_file_with_other_content_is_refused_in_one_line(tmp_path, arrays, says):
    path = tmp_path / "cloud.npz"
    np.savez(path, **arrays)
    assert refusal(path).startswith(says)


def test_a_damaged_npz_file_is_refused_in_one_line(tmp_path):
    path = tmp_path / "cloud.npz"
    write_cloud(path, CLOUD, HEADER)
    whole = path.read_bytes()
    contents = [b"", b"\0" * 100, whole[: len(whole) // 2]]
    for content in contents:
        path.write_bytes(content)
        assert refusal(path)


def test_a_file_that_is_missing_a_folder_or_of_another_kind_is_refused(tmp_path):
    with pytest.raises(MissingFileError, match="there is no such file"):
        read_points(tmp_path / "cloud.npz")
    (tmp_path / "folder.pcd").mkdir()
    assert refusal(tmp_path / "folder.pcd").startswith("is a folder; allowed: a point cloud, .npz, .pcd, .ply")
    (tmp_path / "cloud.e57").write_text("1 2 3\n")
    with pytest.raises(InputError, match=r"unknown cloud format '\.e57'; allowed: \.npz, \.pcd"):
        read_points(tmp_path / "cloud.e57")
    for name in ("cloud", "cloud.e57", ".npz"):
        with pytest.raises(InputError, match=r"^--out: .*unknown cloud format"):
            check_cloud_name(tmp_path / name, "--out")


@pytest.mark.parametrize("failure", [ValueError("no"), KeyboardInterrupt(), OSError(5, "Input/output error")])
def test_a_writer_that_fails_half_way_leaves_the_old_file_and_nothing_else(tmp_path, failure):
    path = tmp_path / "table.csv"
    path.write_text("old")

    def write():
        with whole_file(path) as temporary:
            temporary.write_text("half")
            assert temporary.suffix == ".csv"
            assert temporary.parent == tmp_path
            raise failure

    with pytest.raises(OutputError if isinstance(failure, OSError) else type(failure)):
        write()
    assert path.read_text() == "old"
    assert files(tmp_path) == ["table.csv"]


def test_a_new_file_takes_the_place_of_the_old_with_the_rights_of_any_new_file(tmp_path):
    for path, written in ((tmp_path / "a.txt", "größer\n"), (tmp_path / "a.txt", "second")):
        write_text(path, written)
        assert path.read_text(encoding="utf-8") == written
    (tmp_path / "plain").touch()
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "plain").stat().st_mode
    write_bytes(tmp_path / "b.bin", b"\x00\xff")
    assert (tmp_path / "b.bin").read_bytes() == b"\x00\xff"
    assert files(tmp_path) == ["a.txt", "b.bin", "plain"]


def test_a_place_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "folder.npz").mkdir()
    for path in (tmp_path / "missing" / "a.npz", tmp_path / "file" / "a.npz", tmp_path / "folder.npz"):
        with pytest.raises(OutputError) as error:
            write_cloud(path, EMPTY, HEADER)
        assert str(error.value).startswith(f"{path}: cannot be written: ")
        assert "\n" not in str(error.value)
    assert files(tmp_path) == ["file", "folder.npz"]


@pytest.mark.skipif(sys.platform == "win32", reason="there are no limits on the size of files")
def test_a_full_disk_is_one_line_and_nothing_more_when_python_ends(tmp_path):
    """A limit on the size of files stands in for the full disk."""
    names = [f"cloud{suffix}" for suffix in (".npz", ".pcd")]
    for name in names:
        write_cloud(tmp_path / name, CLOUD, HEADER)
    sizes = [(tmp_path / name).stat().st_size - 1 for name in names]
    program = (
        "import resource\n"
        "from tests.test_clouds import CLOUD, HEADER, OutputError, write_cloud\n"
        f"for name, size in zip({names!r}, {sizes!r}):\n"
        "    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))\n"
        f"    try: write_cloud({str(tmp_path / 'new_')!r} + name, CLOUD, HEADER)\n"
        "    except OutputError as error: print(error)"
    )
    root, environment = Path(__file__).parents[1], {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    assert [line.partition("cannot be written: ")[2] for line in lines] == ["File too large"] * len(names)
    assert done.stderr == ""
    assert files(tmp_path) == sorted(names)


# --- PCD files as others write them, and damaged ----------------------------------------------------------------------


def pcd(body=b"", **changes):
    """A PCD file of two points x, y, z, in ascii unless changed; a change to None leaves a line out."""
    lines = {
        "VERSION": "0.7",
        "FIELDS": "x y z",
        "SIZE": "4 4 4",
        "TYPE": "F F F",
        "COUNT": "1 1 1",
        "WIDTH": "2",
        "HEIGHT": "1",
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": "2",
        "DATA": "ascii",
    } | changes
    return "".join(f"{key} {value}\n" for key, value in lines.items() if value is not None).encode() + body


ROWS = b"1 2 3\n4 5 6\n"
LABELLED = {"FIELDS": "x y z vehicle_id", "SIZE": "4 4 4 4", "TYPE": "F F F F", "COUNT": "1 1 1 1"}


@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
@pytest.mark.parametrize("count", ["1 1 1", None])
def test_an_ascii_pcd_file_is_read(tmp_path, line_end, count):
    path = tmp_path / "cloud.pcd"
    path.write_bytes((b"# a comment\n" + pcd(ROWS, COUNT=count)).replace(b"\n", line_end.encode()))
    points, vehicle = read_points(path)
    assert points.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert vehicle is None


def test_fields_in_another_order_and_of_other_kinds_are_read(tmp_path):
    path = tmp_path / "cloud.pcd"
    layout = [("vehicle_id", "<u2"), ("normal", "<f4", 3), ("z", "<f8"), ("y", "<i2"), ("x", "<f4")]
    record = np.array([(5, (9, 9, 9), 3.5, 2, 1.25), (6, (9, 9, 9), -3.5, -2, -1.25)], dtype=layout)
    fields = {"FIELDS": "vehicle_id normal z y x", "SIZE": "2 4 8 2 4", "TYPE": "U F F I F", "COUNT": "1 3 1 1 1"}
    path.write_bytes(pcd(record.tobytes(), DATA="binary", **fields))
    points, vehicle = read_points(path)
    assert points.tolist() == [[1.25, 2.0, 3.5], [-1.25, -2.0, -3.5]]
    assert vehicle.tolist() == [5, 6]


def test_an_ascii_field_of_several_numbers_does_not_shift_the_others(tmp_path):
    path = tmp_path / "cloud.pcd"
    fields = {"FIELDS": "normal x y z vehicle_id", "SIZE": "4 4 4 4 4", "TYPE": "F F F F I", "COUNT": "3 1 1 1 1"}
    path.write_bytes(pcd(b"9 9 9 1 2 3 7\n9 9 9 4 5 6 8\n", **fields))
    points, vehicle = read_points(path)
    assert points.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert vehicle.tolist() == [7, 8]


def test_the_padding_that_pcl_writes_is_passed_over(tmp_path):
    path = tmp_path / "cloud.pcd"
    record = np.array([(1, 2, 3, b"", 4, b"")], dtype="<f4,<f4,<f4,V4,<f4,V12")
    fields = {"FIELDS": "x y z _ rgb _", "SIZE": "4 4 4 1 4 1", "TYPE": "F F F U F U", "COUNT": "1 1 1 4 1 12"}
    path.write_bytes(pcd(record.tobytes(), DATA="binary", POINTS="1", WIDTH="1", **fields))
    assert read_points(path)[0].tolist() == [[1.0, 2.0, 3.0]]


@pytest.mark.filterwarnings("error")
def test_an_ascii_file_without_points_is_an_empty_cloud(tmp_path):
    path = tmp_path / "cloud.pcd"
    path.write_bytes(pcd(b"\n", POINTS="0", WIDTH="0"))
    assert read_points(path)[0].shape == (0, 3)


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".pcd", ".xyz"])
def test_points_that_are_not_finite_are_left_out_with_their_ids_and_counted(tmp_path, suffix):
    path = tmp_path / f"cloud{suffix}"
    rows = np.array([[1, 2, 3, 7], [np.nan, np.nan, np.nan, np.nan], [4, 5, 6, 8], [0, -np.inf, 0, 9]])
    if suffix == ".npz":
        np.savez(path, xyz=rows[:, :3], vehicle_id=rows[:, 3])
    elif suffix != ".pcd":
        path.write_text("x,y,z,vehicle_id\n" + "".join(",".join(map(str, row)) + "\n" for row in rows.tolist()))
    else:
        path.write_bytes(
            pcd(rows.astype("<f4").tobytes(), DATA="binary", WIDTH="2", HEIGHT="2", POINTS="4", **LABELLED)
        )
    with pytest.warns(UserWarning, match="left out") as caught:
        points, vehicle = read_points(path)
    assert [str(warning.message) for warning in caught] == [f"{path}: 2 of 4 points left out: not finite"]
    assert points.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert vehicle.tolist() == [7, 8]


DAMAGED_PCD = {
    "empty": b"",
    "garbage": bytes(range(256)) * 8,
    "compressed": pcd(ROWS, DATA="binary_compressed"),
    "no POINTS": pcd(ROWS, POINTS=None),
    "no z": pcd(b"1 2\n3 4\n", FIELDS="x y", SIZE="4 4", TYPE="F F", COUNT="1 1"),
    "z twice over": pcd(bytes(32), DATA="binary", COUNT="1 1 2"),
    "truncated": pcd(bytes(23), DATA="binary"),
    "said to be huge": pcd(bytes(24), DATA="binary", POINTS=str(10**15), WIDTH=str(10**15)),
    "text in a number": pcd(b"1 2 3\n4 five 6\n"),
    "ragged rows": pcd(b"1 2 3\n4 5\n"),
    "columns that no field names": pcd(b"1 2 3 4\n5 6 7 8\n"),
    "not ascii": pcd("1 2 ³\n4 5 6\n".encode()),
    "too few rows": pcd(b"1 2 3\n"),
    "too many rows": pcd(ROWS + b"7 8 9\n"),
    "an id that is a fraction": pcd(b"1 2 3 0.5\n4 5 6 1\n", **LABELLED),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", DAMAGED_PCD)
def test_a_damaged_pcd_file_is_refused_in_one_line(tmp_path, name):
    if name == "compressed":
        pytest.importorskip("lzf")
    path = tmp_path / "cloud.pcd"
    path.write_bytes(DAMAGED_PCD[name])
    assert refusal(path)


# --- Clouds of others -------------------------------------------------------------------------------------------------

XYZ = np.array([[1.25, -2.0, 3.5], [4.0, 5.5, -6.0], [553_217.25, 5_260_412.125, 0.5]])


@pytest.mark.parametrize(
    "text",
    [
        "1.25 -2 3.5\n4 5.5 -6\n553217.25 5260412.125 .5\n",
        "//X Y Z Intensity\n1.25 -2 3.5 9\n4 5.5 -6 9\n553217.25 5260412.125 .5 9\n",
        "\ufeff1.25,-2,3.5\r\n4,5.5,-6\r\n\r\n553217.25,5260412.125,.5\r\n",
        "# made by hand\n1.25;-2;3.5\n4;5.5;-6\n553217.25;5260412.125;.5\n",
        "class,z_m,y_m,x_m\ncar,3.5,-2,1.25\nroad,-6,5.5,4\nvan,.5,5260412.125,553217.25\n",
        '"X"\t"Y"\t"Z"\n1.25\t-2\t3.5\n4\t5.5\t-6\n553217.25\t5260412.125\t.5\n',
    ],
)
@pytest.mark.parametrize("suffix", [".csv", ".xyz"])
def test_text_is_read_in_float64_whatever_separates_and_names_its_columns(tmp_path, text, suffix):
    path = tmp_path / f"cloud{suffix}"
    path.write_text(text, encoding="utf-8", newline="")
    points, vehicle = read_points(path)
    np.testing.assert_array_equal(points, XYZ)
    assert vehicle is None


@pytest.mark.parametrize(
    "text", ["frame,lat,lon\n1,2,3\n", "1 2\n3 4\n", "1 2 3\n4 five 6\n", "1,5;2,5;3,5\n", "x,y,z\n1,2\n"]
)
def test_text_without_three_coordinates_is_refused_in_one_line(tmp_path, text):
    (tmp_path / "cloud.csv").write_text(text)
    assert refusal(tmp_path / "cloud.csv").startswith("is not a readable CSV file")


def test_an_empty_text_holds_no_points(tmp_path):
    (tmp_path / "cloud.csv").write_text("x,y,z\n")
    with pytest.warns(UserWarning, match="left out"):
        assert read_points(tmp_path / "cloud.csv")[0].shape == (0, 3)


def test_a_compressed_pcd_file_is_read_field_after_field(tmp_path):
    lzf = pytest.importorskip("lzf", reason="python-neo-lzf, of the extra formats, is not installed")
    points, path = 500, tmp_path / "cloud.pcd"
    xyz, ids = np.random.default_rng(3).integers(0, 9, (points, 3)).astype("<f4"), np.arange(points, dtype="<i4") % 7
    body = b"".join([np.ones((points, 4), "<f4").tobytes(), *(column.tobytes() for column in xyz.T), ids.tobytes()])
    packed = lzf.compress(body)
    fields = {"FIELDS": "normal x y z vehicle_id", "SIZE": "4 4 4 4 4", "TYPE": "F F F F I", "COUNT": "4 1 1 1 1"}
    head = pcd(DATA="binary_compressed", POINTS=str(points), WIDTH=str(points), **fields)
    sizes = np.array([len(packed), len(body)], "<u4").tobytes()
    path.write_bytes(head + sizes + packed)
    read, vehicle = read_points(path)
    np.testing.assert_array_equal(read, xyz)
    np.testing.assert_array_equal(vehicle, ids)
    for damaged in (sizes + packed[:-9], sizes[:6], sizes[:4] + b"\xff" * 4 + packed, sizes + b"\xff" * len(packed)):
        path.write_bytes(head + damaged)
        assert refusal(path).startswith("is not a readable PCD file")


@pytest.mark.parametrize(("text", "order"), [(True, "="), (False, "<"), (False, ">")])
def test_a_ply_file_of_doubles_is_read_to_the_last_digit(tmp_path, text, order):
    plyfile = pytest.importorskip("plyfile", reason="plyfile, of the extra formats, is not installed")
    vertex = np.zeros(3, dtype=[(name, "f8") for name in "zyx"])
    for name, column in zip("xyz", XYZ.T, strict=True):
        vertex[name] = column
    element = plyfile.PlyElement.describe(vertex, "vertex")
    plyfile.PlyData([element], text=text, byte_order=order).write(str(tmp_path / "cloud.ply"))
    np.testing.assert_array_equal(read_points(tmp_path / "cloud.ply")[0], XYZ)


def test_a_las_file_with_a_far_origin_is_read_in_float64(tmp_path):
    laspy = pytest.importorskip("laspy", reason="laspy, of the extra formats, is not installed")
    las = laspy.create(point_format=3, file_version="1.2")
    las.header.offsets, las.header.scales = [553_000.0, 5_260_000.0, 0.0], [0.001] * 3
    las.x, las.y, las.z = XYZ[2:].T
    las.write(tmp_path / "cloud.las")
    points, vehicle = read_points(tmp_path / "cloud.las")
    np.testing.assert_allclose(points, XYZ[2:], atol=1e-9)
    assert vehicle is None


def test_files_of_kitti_and_nuscenes_are_read_and_wrong_sizes_refused(tmp_path):
    rows = np.arange(20.0, dtype="<f4")
    rows.tofile(tmp_path / "000001.bin")
    rows.tofile(tmp_path / "sweep.pcd.bin")
    np.testing.assert_array_equal(read_points(tmp_path / "000001.bin")[0], rows.reshape(-1, 4)[:, :3])
    np.testing.assert_array_equal(read_points(tmp_path / "sweep.pcd.bin")[0], rows.reshape(-1, 5)[:, :3])
    label = np.array([10 | 7 << 16, 40, 252 | 8 << 16, 81 | 9 << 16, 18], "<u4")  # a traffic sign is no road user
    label.tofile(tmp_path / "000001.label")
    assert read_points(tmp_path / "000001.bin")[1].tolist() == [7, -1, 8, -1, 0]
    label[:4].tofile(tmp_path / "000001.label")
    assert "its 5 points have 4 labels" in refusal(tmp_path / "000001.bin")
    rows[:7].tofile(tmp_path / "000002.bin")
    assert "28 bytes" in refusal(tmp_path / "000002.bin")


def test_an_organised_array_and_further_columns_are_read(tmp_path):
    organised = np.arange(24.0).reshape(2, 3, 4)
    np.savez(tmp_path / "cloud.npz", points=organised, vehicle_id=np.arange(6).reshape(2, 3))
    points, vehicle = read_points(tmp_path / "cloud.npz")
    np.testing.assert_array_equal(points, organised.reshape(-1, 4)[:, :3])
    assert vehicle.tolist() == list(range(6))


@pytest.mark.parametrize(("suffix", "library"), [(".ply", "plyfile"), (".las", "laspy"), (".pcd", "lzf")])
def test_without_its_library_a_file_is_refused_with_the_extra_that_brings_it(tmp_path, monkeypatch, suffix, library):
    path = tmp_path / f"cloud{suffix}"
    path.write_bytes(pcd(b"", DATA="binary_compressed"))
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(MissingExtraError, match=rf"needs {library}: .*blender_lidar\[formats\]"):
        read_points(path)
