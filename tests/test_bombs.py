"""Small files that claim, or unpack to, more than any machine holds: one line, soon, and within memory."""

from __future__ import annotations

import gzip
import io
import json
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

from blender_lidar import input_file
from blender_lidar.commands.options import parse_frames
from blender_lidar.errors import BlenderLidarError, InputError
from blender_lidar.formats.clouds import read_points
from blender_lidar.reality.kitti_layout import read_velodyne
from blender_lidar.reality.sustech_layout import read_labels
from blender_lidar.reality.text_table import TextTable
from blender_lidar.results import RunFolder
from blender_lidar.scenario import load_scenario
from blender_lidar.sensors.model import load_model
from blender_lidar.study.stages import StudyFolder
from blender_lidar.toml_table import read_toml
from blender_lidar.traffic import plan_frames, read_traffic
from blender_lidar.traffic.sumo_types import read_types
from tests import sumo_samples, traffic_samples
from tests.fuzzing import kept_promise, watchdog
from tests.small_scene import HEADER, write_scene, write_table

MEGABYTE = 2**20


def refused(read, path: Path) -> str:
    """The line that a file is refused with, in time and within memory."""
    line: list[str] = []

    def told(place: Path) -> object:
        try:
            return read(place)
        except BlenderLidarError as error:
            line.append(str(error))
            raise

    assert not kept_promise(told, path), "the file was read"
    return line[0].replace(str(path), "FILE")


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def packed(unit: bytes, times: int) -> bytes:
    """A gzip file of the same bytes over and over, made without holding them."""
    stream = io.BytesIO()
    with gzip.GzipFile(fileobj=stream, mode="wb", mtime=0) as file:
        block = unit * max(MEGABYTE // len(unit), 1)
        for _ in range(times * len(unit) // len(block)):
            file.write(block)
    return stream.getvalue()


# --- traffic ----------------------------------------------------------------------------------------------------------

ROW = b"1,1,car,0,0,4,2,1.5,0,0\n"
TABLE = ",".join(HEADER).encode() + b"\n"


def test_a_gzip_file_of_zeros(tmp_path):
    path = written(tmp_path / "traffic.csv.gz", packed(b"\0", 64 * MEGABYTE))
    assert "a line longer than 65,536 characters" in refused(read_traffic, path)


@pytest.fixture
def little_for_nothing(monkeypatch):
    """What any packed file may hold, however small, made less than what these tests pack."""
    monkeypatch.setattr(input_file, "FREELY_UNPACKED_BYTES", 2**16)
    monkeypatch.setattr(input_file, "FREE_RECORDS", 2**10)


@pytest.mark.parametrize("unit", [b"\n", ROW])
def test_a_gzip_file_of_one_line_over_and_over(tmp_path, unit, little_for_nothing):
    path = written(tmp_path / "traffic.csv.gz", gzip.compress(TABLE) + packed(unit, MEGABYTE // len(unit)))
    assert refused(read_traffic, path).endswith("; if it is a recording all the same, unpack it first")


def test_a_gzip_file_of_one_element_over_and_over(tmp_path, little_for_nothing):
    path = written(
        tmp_path / "run.xml.gz", gzip.compress(b"<fcd-export>\n") + packed(b'<timestep time="0"/>\n', 50_000)
    )
    assert refused(read_traffic, path).endswith("; if it is a recording all the same, unpack it first")


def test_a_jam_that_packs_as_well_as_any_traffic_can_is_read(tmp_path, little_for_nothing):
    rows = [sumo_samples.row(0.1 * frame, id=f"v{n}", x=8.5 * n, speed=0.0) for frame in range(60) for n in range(100)]
    path = written(tmp_path / "run.xml.gz", gzip.compress(sumo_samples.xml(rows).encode(), 9))
    assert len(rows) > 2**12
    assert kept_promise(read_traffic, path)


def test_a_header_of_very_many_columns(tmp_path):
    path = written(tmp_path / "traffic.csv", TABLE.strip() + b",x" * 20_000 + b"\n" + ROW)
    assert refused(read_traffic, path) == "FILE:1: 20,010 columns; allowed: at most 1,000"


def test_a_row_of_very_many_fields_among_short_ones(tmp_path):
    path = written(tmp_path / "traffic.csv", TABLE + ROW + b"," * 60_000 + b"\n" + ROW * 10)
    assert refused(read_traffic, path) == "FILE:3: 60001 fields; the header has 10"


def test_a_table_whose_frames_are_numbered_up_to_a_billion_is_read_as_the_few_it_has(tmp_path):
    rows = [[frame, 1, "car", 0, 0, 4, 2, 1.5, 0, 0.1 * frame] for frame in (0, 1, 10**9)]
    path = write_table(tmp_path / "traffic.csv", rows)

    def planned(place):
        return plan_frames(read_traffic(place), lambda vehicles: np.ones(len(vehicles), dtype=bool), spacing_s=0.001)

    found = []
    assert kept_promise(lambda place: found.append(planned(place)), path)
    assert found[0].search.tolist()[0] == 0


@pytest.mark.parametrize("step_ms", [1e-6, 1e-3, 1e5])
def test_an_ngsim_clock_that_hardly_moves_or_leaps(tmp_path, step_ms):
    pytest.importorskip("pandas")
    columns = traffic_samples.columns(vehicles=3, frames=4)
    columns["Frame_ID"] = np.tile([1, 2, 3, 10**9], 3)
    columns["Global_Time"] = step_ms * columns["Frame_ID"]
    path = written(tmp_path / "recording.txt", traffic_samples.native(columns).encode())
    assert "Global_Time grows by " in refused(read_traffic, path)


def test_very_many_vehicles_in_one_place(tmp_path):
    rows = b"".join(b"0,%d,car,0,0,4,2,1.5,0,0\n" % number for number in range(5_000))
    path = written(tmp_path / "traffic.csv", TABLE + rows)
    assert refused(read_traffic, path) == "FILE: frame 0: 5,000 vehicles so close to one another are no traffic"


def test_very_many_vehicles_of_one_frame_that_stand_apart_are_read(tmp_path):
    rows = b"".join(b"0,%d,car,%d,0,4,2,1.5,0,0\n" % (number, 6 * number) for number in range(20_000))
    assert kept_promise(read_traffic, written(tmp_path / "traffic.csv", TABLE + rows))


def test_a_parquet_file_of_one_row_over_and_over(tmp_path, little_for_nothing):
    sumo_samples.need_pyarrow()
    import pyarrow
    import pyarrow.parquet

    path = tmp_path / "run.parquet"
    content = {f"vehicle_{name}": [1.0] for name in ("x", "y", "angle")} | {"vehicle_id": ["a"], "timestep_time": [0.0]}
    table = pyarrow.table(content)
    pyarrow.parquet.write_table(pyarrow.concat_tables([table] * 100_000).combine_chunks(), path)
    assert "rows in a file of " in refused(read_traffic, path)


def test_xml_whose_one_tag_never_ends(tmp_path):
    text = b"<fcd-export>\n<timestep time='0'>\n<vehicle\n" + b"".join(b"a%d='1'\n" % n for n in range(300_000))
    assert "a tag or comment of more than " in refused(read_traffic, written(tmp_path / "run.xml", text))
    text = b"<additional>\n<!--\n" + b"x\n" * 1_000_000
    assert "a tag or comment of more than " in refused(read_types, written(tmp_path / "types.xml", text))


# --- settings ---------------------------------------------------------------------------------------------------------

DEEP_TOML = {
    "lists": b"a = " + b"[" * 100_000,
    "tables": b"a = " + b"{a = " * 100_000,
    "a dotted key": b"a." * 100_000 + b"a = 1",
    "a dotted key of quoted parts": b'"a". ' * 50_000 + b"a = 1",
    "a dotted table": b"[" + b"a." * 100_000 + b"a]",
    "a dotted key in a table": b"b = {" + b"a . " * 50_000 + b"a = 1}",
}


@pytest.mark.parametrize("case", DEEP_TOML)
@pytest.mark.parametrize(("name", "read"), [("scene.toml", load_scenario), ("sensor.toml", load_model)])
def test_toml_that_nests_without_end(tmp_path, case, name, read):
    assert "TOML: " in refused(read, written(tmp_path / name, DEEP_TOML[case]))


def test_long_texts_and_words_in_toml_are_no_long_keys(tmp_path):
    text = "a" * 200_000
    assert read_toml(written(tmp_path / "a.toml", f'{text} = "{text}"\nb = "1.2.3. {"... " * 1000}"\n'.encode()))[text]


def test_toml_with_a_key_of_megabytes(tmp_path):
    assert "is larger than " in refused(load_scenario, written(tmp_path / "scene.toml", b"x" * 10 * MEGABYTE + b" = 1"))
    line = refused(load_scenario, written(tmp_path / "scene.toml", b"x" * 900_000 + b" = 1"))
    assert "unknown table 'xxxxxx" in line
    assert len(line) < 600


def test_a_sensor_file_of_very_many_rings(tmp_path):
    rows = b"".join(b"%d,0\n" % ring for ring in range(400_000))
    line = refused(load_model, written(tmp_path / "sensor.csv", b"ring,elevation_deg\n" + rows))
    assert line == "FILE:beams: 400000 rings; allowed: 1 to 4096"


def test_a_sensor_file_whose_column_has_an_endless_name(tmp_path):
    line = refused(load_model, written(tmp_path / "sensor.csv", b"ring," + b"elevation" * 10_000 + b"\n0,1\n"))
    assert "unknown column 'elevation" in line


@pytest.mark.parametrize("key", ["spacing_s", "block_s"])
@pytest.mark.parametrize("value", [1e-12, 5e-324])
def test_frames_that_lie_next_to_no_time_apart(tmp_path, key, value):
    rows = [[frame, 1, "car", 0, 0, 4, 2, 1.5, 0, 600.0 * frame] for frame in range(3)]
    recording = read_traffic(write_table(tmp_path / "traffic.csv", rows))
    with pytest.raises(InputError, match=rf"is {value} s; at least 0\.001 is needed"):
        plan_frames(recording, lambda vehicles: np.ones(len(vehicles), dtype=bool), **{key: value})


def test_ranges_of_frames_that_are_many_together():
    with pytest.raises(InputError, match="--frame-ids: names more than 1,000,000 frames"):
        parse_frames(",".join(["0:999998"] * 1000), "--frame-ids")


@pytest.mark.parametrize(
    ("table", "key", "value"),
    [
        ("road", "station_m", 1e300),
        ("road", "right_edge_m", -1e300),
        ("road", "setback_m", 1e300),
        ("traffic", "origin_m", [1e300, 0.0]),
        ("world", "origin_m", [0.0, 1e300, 0.0]),
        ("world", "boxes", [{"centre_m": [1e300, 0.0, 0.0], "size_m": [1.0, 1.0, 1.0]}]),
        ("world", "boxes", [{"centre_m": [0.0, 0.0, 0.0], "size_m": [1.0, 1e300, 1.0]}]),
        ("world", "barriers", [{"kind": "concrete", "y_m": 1e300}]),
        ("world", "barriers", [{"kind": "concrete", "y_m": 1.0, "x_m": [1e300, 1.0000001e300]}]),
    ],
)
def test_lengths_whose_squares_no_number_holds(tmp_path, table, key, value):
    path = write_scene(tmp_path, {table: {key: value}})
    assert "at most 1e+0" in refused(load_scenario, path)


# --- clouds -----------------------------------------------------------------------------------------------------------


def npz(path: Path, shape: object, kind: str = "<f8", body: bytes = b"", times: int = 1, version: int = 1) -> Path:
    """An NPZ file with an array `xyz` of that header, and a body over and over."""
    text = f"{{'descr': {kind!r}, 'fortran_order': False, 'shape': {shape!r}, }}\n".encode()
    head = b"\x93NUMPY" + bytes([version, 0]) + len(text).to_bytes(2 if version == 1 else 4, "little") + text
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("xyz.npy", "w") as stream:
        stream.write(head)
        for _ in range(times):
            stream.write(body)
    return path


@pytest.mark.parametrize("version", [1, 2, 3])
@pytest.mark.parametrize("kind", ["<f8", "<f4", "|i1", "<U1000000"])
def test_an_npz_array_of_a_shape_that_the_file_does_not_hold(tmp_path, kind, version):
    line = refused(read_points, npz(tmp_path / "cloud.npz", (10**12, 3), kind, bytes(100), version=version))
    assert "xyz takes " in line or "is not a readable NPZ file" in line


@pytest.mark.parametrize("kind", ["<f8", "|i1"])
def test_an_npz_array_of_zeros_without_end(tmp_path, kind):
    rows = 64 * MEGABYTE // (3 * np.dtype(kind).itemsize)
    body = bytes(3 * np.dtype(kind).itemsize * (rows // 64))
    path = npz(tmp_path / "cloud.npz", (rows // 64 * 64, 3), kind, body, 64)
    assert refused(read_points, path) == "FILE: xyz unpacks to more than 250 times the file's size"


PCD = "VERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {kinds}\nCOUNT {counts}\nPOINTS {points}\nDATA {data}\n"


@pytest.mark.parametrize("data", ["binary", "ascii"])
@pytest.mark.parametrize(("points", "count"), [(10**12, 1), (10**400, 1), (1, 10**9), (1, 10**30), (0, 2**31 - 1)])
def test_a_pcd_header_that_promises_more_than_there_is(tmp_path, data, points, count):
    said = {"counts": f"1 1 1 {count}", "points": points, "data": data}
    text = PCD.format(fields="x y z w", sizes="4 4 4 4", kinds="F F F F", **said)
    line = refused(read_points, written(tmp_path / "cloud.pcd", text.encode() + b"1 2 3 4\n"))
    assert line.startswith("FILE: ")


def test_a_pcd_header_without_end(tmp_path):
    line = refused(read_points, written(tmp_path / "cloud.pcd", b"VERSION 0.7\n" + b"\n" * 100_000))
    assert "no header with a DATA line" in line


def test_a_kitti_cloud_of_half_a_point(tmp_path):
    assert refused(read_velodyne, written(tmp_path / "000000.bin", bytes(17))).startswith("FILE: 17 bytes; allowed: 16")


# --- tables and JSON --------------------------------------------------------------------------------------------------


def test_a_table_of_very_many_columns(tmp_path):
    path = written(tmp_path / "cars.csv", b",".join(b"c%d" % number for number in range(50_000)) + b"\n")
    assert refused(TextTable, path) == "FILE: has 50,000 columns; allowed: at most 1,000"


def test_a_vehicle_table_with_one_endless_text(tmp_path):
    folder = RunFolder(tmp_path)
    content = b"class,split\n" + b"car,search\n" * 20_000 + b"x" * 100_000 + b",search\n"
    line = refused(lambda _: folder.read_vehicles("vehicles.csv"), written(tmp_path / "vehicles.csv", content))
    assert line == "FILE: is damaged: a text of more than 100 characters"


DEEP_JSON = [b"[" * 100_000, b'{"a":' * 100_000, b"[" * 900 + b"]" * 900, b"1" * 100_000, b'"\\ud800"']


@pytest.mark.parametrize("content", DEEP_JSON)
def test_json_that_nests_without_end_or_holds_what_no_number_does(tmp_path, content):
    folder, study = RunFolder(tmp_path), StudyFolder(tmp_path, {"seed": 1})
    for name in ("result.json", "checkpoint.json"):
        written(tmp_path / name, b'{"identity": ' + content + b', "search": ' + content + b"}")
        read = folder.read_result if name == "result.json" else folder.read_checkpoint
        assert refused(lambda _, read=read: read({"seed": 1}), tmp_path / name)
        written(tmp_path / name, b'{"identity": {"seed": ' + content + b'}, "search": 1}')
        assert refused(lambda _, read=read: read({"seed": 1}), tmp_path / name)
    written(tmp_path / "study.json", b'{"seed": ' + content + b"}")
    assert refused(lambda _: study.check(resume=True), tmp_path / "study.json")
    whole = {part: dict.fromkeys("xyz", 1.0) for part in ("position", "scale", "rotation")}
    label = json.dumps([{"obj_type": "?", "psr": whole}]).replace('"?"', content.decode())
    if content != DEEP_JSON[-1]:
        assert refused(read_labels, written(tmp_path / "000000.json", label.encode()))


# --- what is no file --------------------------------------------------------------------------------------------------

READERS = {
    "traffic.csv": read_traffic,
    "types.xml": read_types,
    "scene.toml": load_scenario,
    "sensor.toml": load_model,
    "sensor.csv": load_model,
    "cloud.npz": read_points,
    "cloud.pcd": read_points,
    "000000.bin": read_velodyne,
    "000000.json": read_labels,
    "cars.csv": TextTable,
    "result.json": lambda path: RunFolder(path.parent).ended_result(),
    "vehicles.csv": lambda path: RunFolder(path.parent).read_vehicles(path.name),
}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
@pytest.mark.parametrize("name", READERS)
def test_a_named_pipe_is_not_waited_for(tmp_path, name):
    os.mkfifo(tmp_path / name)
    with watchdog(5), pytest.raises(InputError, match="is a named pipe; a regular file is needed"):
        READERS[name](tmp_path / name)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="the system has no such device")
@pytest.mark.parametrize("name", READERS)
def test_a_device_is_not_read_without_end(tmp_path, name):
    (tmp_path / name).symlink_to("/dev/zero")
    with watchdog(5), pytest.raises(InputError, match="is a device; a regular file is needed"):
        READERS[name](tmp_path / name)


@pytest.mark.parametrize("name", READERS)
def test_a_link_to_itself_and_a_folder_are_one_line(tmp_path, name):
    (tmp_path / name).symlink_to(tmp_path / name)
    with pytest.raises(BlenderLidarError) as caught:
        READERS[name](tmp_path / name)
    assert len(str(caught.value).splitlines()) == 1
    (tmp_path / name).unlink()
    (tmp_path / name).mkdir()
    with pytest.raises(InputError):
        READERS[name](tmp_path / name)


@pytest.mark.parametrize("name", READERS)
def test_the_name_of_a_file_may_hold_anything_and_the_line_stays_one(tmp_path, name):
    folder = tmp_path / "a\nb\x1b[31m\udcff"
    folder.mkdir()
    (folder / name).write_bytes(b"\xff")
    with pytest.raises(BlenderLidarError) as caught:
        READERS[name](folder / name)
    assert str(caught.value).isprintable()
    assert "\\udcff" in str(caught.value)
