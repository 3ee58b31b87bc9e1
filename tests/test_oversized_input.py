"""Files of sizes that no machine holds, named pipes, devices and links: refused in one line, soon, within memory."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.clouds.files import read_points
from blender_lidar.commands.options import parse_frames
from blender_lidar.errors import BlenderLidarError, InputError
from blender_lidar.run.folder import RunFolder
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.sensors.model import load_model
from blender_lidar.studies.driver import StudyFolder
from blender_lidar.traffic import plan_frames, read_traffic
from blender_lidar.traffic.sumo import read_types
from tests.fuzzing import kept_promise, watchdog
from tests.small_scene import write_scene, write_table

MEGABYTE = 2**20


def refused(read, path: Path) -> str:
    """The line that a file is refused with, in time and within memory."""
    line = kept_promise(read, path)
    assert line is not None, "the file was read"
    return line.replace(str(path), "FILE")


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


# --- settings ---------------------------------------------------------------------------------------------------------

DEEP_TOML = {
    "lists": b"a = " + b"[" * 100_000,
    "tables": b"a = " + b"{a = " * 100_000,
}


@pytest.mark.parametrize("case", DEEP_TOML)
@pytest.mark.parametrize(("name", "read"), [("scene.toml", load_scenario), ("sensor.toml", load_model)])
def test_toml_that_nests_without_end(tmp_path, case, name, read):
    assert "TOML: " in refused(read, written(tmp_path / name, DEEP_TOML[case]))


def test_toml_with_a_key_of_megabytes(tmp_path):
    assert "is larger than " in refused(load_scenario, written(tmp_path / "scene.toml", b"x" * 10 * MEGABYTE + b" = 1"))
    line = refused(load_scenario, written(tmp_path / "scene.toml", b"x" * 900_000 + b" = 1"))
    assert "unknown table 'xxxxxx" in line
    assert len(line) < 600


def test_a_sensor_file_of_very_many_rings(tmp_path):
    rows = b"".join(b"%d,0\n" % ring for ring in range(100_000))
    line = refused(load_model, written(tmp_path / "sensor.csv", b"ring,elevation_deg\n" + rows))
    assert line == "FILE:beams: 100000 rings; allowed: 1 to 4096"


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
    with pytest.raises(InputError, match=r"--frame-ids: .* not more than 1,000,000 frames"):
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
    assert re.search(r"allowed: .*\b(to|at most) 1e\+0", refused(load_scenario, path))


# --- clouds ---------------------------------------------------------------------------------------------------------

PCD = "VERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {kinds}\nCOUNT {counts}\nPOINTS {points}\nDATA {data}\n"


@pytest.mark.parametrize("data", ["binary", "ascii"])
@pytest.mark.parametrize(("points", "count"), [(10**12, 1), (10**400, 1), (1, 10**9), (1, 10**30), (0, 2**31 - 1)])
def test_a_pcd_header_that_promises_more_than_there_is(tmp_path, data, points, count):
    said = {"counts": f"1 1 1 {count}", "points": points, "data": data}
    text = PCD.format(fields="x y z w", sizes="4 4 4 4", kinds="F F F F", **said)
    line = refused(read_points, written(tmp_path / "cloud.pcd", text.encode() + b"1 2 3 4\n"))
    assert line.startswith("FILE: ")


# --- tables and JSON --------------------------------------------------------------------------------------------------


DEEP_JSON = [b"[" * 100_000, b'{"a":' * 100_000, b"[" * 900 + b"]" * 900, b"1" * 100_000, b'"\\ud800"']


@pytest.mark.parametrize("content", DEEP_JSON)
def test_json_that_nests_without_end_or_holds_what_no_number_does(tmp_path, content):
    folder, study = RunFolder(tmp_path), StudyFolder(tmp_path, {"seed": 1})
    for name in ("result.json", "checkpoint.json"):
        written(tmp_path / name, b'{"identity": ' + content + b', "batches": ' + content + b"}")
        read = folder.read_result if name == "result.json" else folder.read_checkpoint
        assert refused(lambda _, read=read: read({"seed": 1}), tmp_path / name)
        written(tmp_path / name, b'{"identity": {"seed": ' + content + b'}, "batches": []}')
        assert refused(lambda _, read=read: read({"seed": 1}), tmp_path / name)
    written(tmp_path / "study.json", b'{"seed": ' + content + b"}")
    assert refused(lambda _: study.check(resume=True), tmp_path / "study.json")


# --- what is no file --------------------------------------------------------------------------------------------------

READERS = {
    "traffic.csv": read_traffic,
    "types.xml": read_types,
    "scene.toml": load_scenario,
    "sensor.toml": load_model,
    "sensor.csv": load_model,
    "cloud.npz": read_points,
    "cloud.pcd": read_points,
    "result.json": lambda path: RunFolder(path.parent).read_outcome(),
    "vehicles.csv": lambda path: RunFolder(path.parent).read_vehicles(path.name),
}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
@pytest.mark.parametrize("name", READERS)
def test_a_named_pipe_is_not_waited_for(tmp_path, name):
    os.mkfifo(tmp_path / name)
    with watchdog(5), pytest.raises(InputError, match="is a named pipe or a device; a regular"):
        READERS[name](tmp_path / name)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="the system has no such device")
@pytest.mark.parametrize("name", READERS)
def test_a_device_is_not_read_without_end(tmp_path, name):
    (tmp_path / name).symlink_to("/dev/zero")
    with watchdog(5), pytest.raises(InputError, match="is a named pipe or a device; a regular"):
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
