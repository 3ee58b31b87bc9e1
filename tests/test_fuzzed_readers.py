"""Readers, fed with files as a full disk, a broken download or an editor leaves them: a sound object, or one line."""

from __future__ import annotations

import gzip
import io
import random
import shutil
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.clouds.points import read_points
from blender_lidar.errors import BlenderLidarError
from blender_lidar.report.page import write_report
from blender_lidar.run.folder import RunFolder
from blender_lidar.run.replay import Replay
from blender_lidar.run.searches import fresh_search
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.traffic import Recording, plan_frames, read_traffic
from tests import sumo_samples, traffic_samples
from tests.small_scene import HEADER, MAPPED, traffic_rows, write_scene

EXAMPLES = 20
TOKENS = [
    one.encode() for one in ("", "0", "-1", "0.5", "nan", "1,234", "NULL", " ", "\r\n", "\t", "\0", '"', ",", ";")
]
TOKENS += [b"#", b"[", b"<", b"{", b"car", "\u00e9".encode(), b"\xff"]
_DELIMITERS = b' ,;\t\n"=<>/[]{}:'


def changed(content: bytes, rng: random.Random) -> bytes:
    """The bytes with one change: cut short, a line or a field lost, repeated or replaced."""
    at, token = rng.randrange(len(content) + 1), rng.choice(TOKENS)
    start = stop = at
    while start > 0 and content[start - 1] not in _DELIMITERS:
        start -= 1
    while stop < len(content) and content[stop] not in _DELIMITERS:
        stop += 1
    lines = content.split(b"\n")
    line = rng.randrange(len(lines))
    return rng.choice(
        [
            content[:at],
            content[:at] + content[at + rng.randrange(1, 40) :],
            content[:at] + token + content[at:],
            content[:start] + token + content[stop:],
            b"\n".join([*lines[:line], *[lines[line]] * rng.choice((0, 2)), *lines[line + 1 :]]),
        ]
    )


def fuzz(read: Callable[[Path], object], path: Path, sample: bytes, check=lambda found: None, packed=False) -> int:
    """Read a file that is whole, then `EXAMPLES` that are not, `packed` ones also as gzip; how many were refused."""
    path.write_bytes(sample)
    check(read(path))
    rng, refused = random.Random(1), []
    for number in range(EXAMPLES):
        content = gzip.compress(sample, mtime=0) if packed and number % 4 == 1 else sample
        for _ in range(1 + number % 3):
            content = changed(content, rng)
        path.write_bytes(content)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                warnings.filterwarnings("ignore", "[^\n]* points left out: [^\n]*", UserWarning)
                check(read(path))
        except BlenderLidarError as error:
            refused.append(str(error))
    assert [line for line in refused if not line.isprintable()] == []
    return len(refused)


# --- Traffic ----------------------------------------------------------------------------------------------------------

_COLUMNS = traffic_samples.columns(vehicles=4, frames=25)
_TABLE = [[*HEADER, "lane"], *([*row, 1] for row in traffic_rows(frames=12, vehicles=20))]
_TRAFFIC = {
    "native": traffic_samples.native(_COLUMNS),
    "portal": traffic_samples.portal(_COLUMNS),
    "api": traffic_samples.api(_COLUMNS),
    "table": "\n".join(",".join(map(str, row)) for row in _TABLE) + "\n",
    "sumo xml": sumo_samples.xml(sumo_samples.driving(4, 12)),
    "sumo csv": sumo_samples.csv(sumo_samples.driving(4, 12)),
}


def read_and_plan(path: Path) -> Recording:
    recording = read_traffic(path)
    plan_frames(recording, lambda vehicles: np.ones(len(vehicles), dtype=bool))
    return recording


def a_sound_recording(recording: Recording) -> None:
    """What everything behind the readers counts on."""
    rows = len(recording)
    assert rows > 0
    for name in ("frame", "vehicle_id", "class_index", "heading_rad", "lane"):
        assert getattr(recording, name).shape == (rows,), name
    assert recording.centre_m.shape == recording.size_m.shape == (rows, 3)
    for name in ("centre_m", "size_m", "heading_rad", "frame_time_s"):
        assert np.isfinite(getattr(recording, name)).all(), name
    assert (recording.size_m > 0).all()
    assert (np.diff(recording.frames) > 0).all()
    assert 0 < recording.time_step_s < np.inf


@pytest.mark.parametrize("sample", _TRAFFIC)
def test_damaged_traffic(tmp_path, sample):
    assert fuzz(read_and_plan, tmp_path / "traffic", _TRAFFIC[sample].encode(), a_sound_recording, packed=True)


# --- Scenes and clouds ------------------------------------------------------------------------------------------------


def test_damaged_scenes(tmp_path):
    changes = {**MAPPED, "world": {"boxes": [{"centre_m": [1, 2, 3], "size_m": [1, 1, 1]}]}}
    sample = write_scene(tmp_path, changes).read_bytes()

    def check(scenario):
        for low, high in scenario.lidar.deployment.places[0].bounds.values():
            assert -1e6 < low < high < 1e6

    assert fuzz(load_scenario, tmp_path / "scene.toml", sample, check)


def _clouds() -> dict[str, bytes]:
    xyz, packed = np.arange(60.0).reshape(20, 3), io.BytesIO()
    np.savez_compressed(packed, xyz=xyz.astype(np.float32), vehicle_id=np.arange(20))
    header = "VERSION 0.7\nFIELDS x y z vehicle_id\nSIZE 4 4 4 4\nTYPE F F F I\nCOUNT 1 1 1 1\nWIDTH 20\nHEIGHT 1\n"
    record = np.zeros(20, dtype=[("xyz", "<f4", 3), ("id", "<i4")])
    record["xyz"] = xyz
    text = "".join(f"{x} {y} {z} 3\n" for x, y, z in xyz)
    return {
        "packed.npz": packed.getvalue(),
        "binary.pcd": f"{header}POINTS 20\nDATA binary\n".encode() + record.tobytes(),
        "ascii.pcd": f"{header}POINTS 20\nDATA ascii\n{text}".encode(),
        "cloud.csv": b"x,y,z,vehicle_id\n" + text.replace(" ", ",").encode(),
        "cloud.xyz": text.encode(),
        "cloud.bin": np.arange(80.0, dtype="<f4").tobytes(),
        **_of_libraries(xyz),
    }


def _of_libraries(xyz) -> dict[str, bytes]:
    """Files of libraries that are installed."""
    made = {}
    if find_spec("plyfile"):
        head = "ply\nformat {} 1.0\nelement vertex 20\n" + "".join(f"property float {axis}\n" for axis in "xyz")
        body = "".join(f"{x} {y} {z}\n" for x, y, z in xyz).encode()
        made["ascii.ply"] = (head.format("ascii") + "end_header\n").encode() + body
        made["binary.ply"] = (head.format("binary_little_endian") + "end_header\n").encode() + xyz.astype(
            "<f4"
        ).tobytes()
    if find_spec("laspy"):
        import laspy

        las, packed = laspy.create(point_format=6, file_version="1.4"), io.BytesIO()
        las.x, las.y, las.z = xyz.T
        las.write(packed)
        made["cloud.las"] = packed.getvalue()
    if find_spec("lzf"):
        import lzf

        packed = lzf.compress(np.repeat(xyz.T, 4, axis=1).astype("<f4").tobytes())
        head = (
            "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 80\nHEIGHT 1\nPOINTS 80\nDATA binary_compressed\n"
        )
        made["compressed.pcd"] = head.encode() + np.array([len(packed), 960], "<u4").tobytes() + packed
    return made


@pytest.mark.parametrize("name", _clouds())
def test_damaged_clouds(tmp_path, name):
    def check(found):
        points, vehicle_id = found
        assert points.shape == (len(points), 3)
        assert np.isfinite(points).all()
        assert vehicle_id is None or (vehicle_id.shape == (len(points),) and vehicle_id.dtype == np.int64)

    assert fuzz(read_points, tmp_path / name, _clouds()[name], check)


# --- What runs have stored --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["result.json", "vehicles.csv", "scene.toml", "history.csv", "score_map.csv"])
def test_damaged_runs(tmp_path, stored_runs, name):
    shutil.copytree(stored_runs / "searched", tmp_path / "run")
    folder = RunFolder(tmp_path / "run")
    readers = {"history.csv": folder.read_columns, "score_map.csv": folder.read_score_map}
    readers["vehicles.csv"] = lambda: RunFolder(folder.path).optimised
    read = readers.get(name, lambda: write_report(RunFolder(folder.path)))
    assert fuzz(lambda _: read(), folder.file(name), folder.file(name).read_bytes())


class Stopped(Exception):
    """A run that was stopped."""


class StopsAfter:
    """A listener that stops a search after so many evaluations."""

    def __init__(self, evaluations):
        self.evaluations = evaluations

    def searching(self, search):
        if search.evaluations >= self.evaluations:
            raise Stopped


def test_damaged_checkpoints(tmp_path):
    scenario, folder = load_scenario(write_scene(tmp_path, MAPPED)), RunFolder(tmp_path)
    (space,) = scenario.lidar.deployment.spaces
    score = partial(np.sum, axis=1)
    with pytest.raises(Stopped):
        Replay(folder, {"seed": 1}, resume=False).carry_out(fresh_search(scenario, space), score, StopsAfter(8))

    def resumed(_):
        search = fresh_search(scenario, space)
        with suppress(Stopped):
            Replay(folder, {"seed": 1}, resume=True).carry_out(search, score, StopsAfter(8))
        return search

    def check(search):
        assert search.done or np.isfinite(search.ask()).all()

    assert fuzz(resumed, folder.file("checkpoint.json"), folder.file("checkpoint.json").read_bytes(), check)
