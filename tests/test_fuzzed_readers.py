"""Every reader, fed with damaged files: an object that keeps its promises, or one line; never a traceback or a hang."""

from __future__ import annotations

import io
import shutil
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.clouds.files import read_points
from blender_lidar.report.page import write_report
from blender_lidar.run.folder import RunFolder
from blender_lidar.run.optimise import fresh_search
from blender_lidar.run.replay import Replay
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.sensors.model import DATA_FOLDER, load_model
from blender_lidar.traffic import Recording, plan_frames, read_traffic
from blender_lidar.traffic.sumo import read_types
from tests import sumo_samples, traffic_samples
from tests.fuzzing import fuzz
from tests.small_scene import HEADER, MAPPED, SETTINGS, traffic_rows, write_scene


def table_text(rows) -> str:
    return "\n".join(",".join(map(str, row)) for row in ((*HEADER, "lane"), *((*row, 1) for row in rows))) + "\n"


_COLUMNS = traffic_samples.columns(vehicles=4, frames=25)
_TRAFFIC = {
    "native": traffic_samples.native(_COLUMNS),
    "arterial": traffic_samples.native(_COLUMNS, arterial=True, separator="\t"),
    "portal": traffic_samples.portal(_COLUMNS),
    "api": traffic_samples.api(_COLUMNS),
    "table": table_text(traffic_rows(frames=12, vehicles=20)),
    "sumo xml": sumo_samples.xml(sumo_samples.driving(4, 12)),
    "sumo csv": sumo_samples.csv(sumo_samples.driving(4, 12)),
    "xml2csv": sumo_samples.xml2csv(sumo_samples.driving(3, 6)),
}
_TYPES = (
    '<additional>\n  <vType id="car" vClass="passenger" length="4.5" width="1.8" height="1.5"/>\n'
    '  <vTypeDistribution id="mix">\n    <vType id="lorry" vClass="truck" guiShape="truck/trailer"/>\n'
    '    <vType id="van" vClass="delivery" length="5.4"/>\n  </vTypeDistribution>\n</additional>\n'
)


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
    assert (recording.class_index >= 0).all()
    assert 0 < recording.time_step_s < np.inf


def read_and_plan(path: Path) -> Recording:
    recording = read_traffic(path)
    plan_frames(recording, lambda vehicles: np.ones(len(vehicles), dtype=bool))
    return recording


@pytest.mark.parametrize("sample", _TRAFFIC)
def test_damaged_traffic(tmp_path, sample):
    assert fuzz(read_and_plan, tmp_path / "traffic", _TRAFFIC[sample].encode(), a_sound_recording, packed=True)


def test_damaged_parquet(tmp_path):
    sumo_samples.need_pyarrow()
    path = sumo_samples.write_parquet(tmp_path / "sample", sumo_samples.driving(4, 12))

    assert fuzz(read_and_plan, tmp_path / "traffic", path.read_bytes(), a_sound_recording)


def test_damaged_vehicle_types(tmp_path):
    assert fuzz(read_types, tmp_path / "types.xml", _TYPES.encode(), packed=True)


_SCENES = sorted((Path(__file__).parent.parent / "scenes").glob("*.toml"))


def test_damaged_scenes(tmp_path):
    samples = [path.read_bytes() for path in _SCENES]
    changes = {**MAPPED, "world": {"boxes": [{"centre_m": [1, 2, 3], "size_m": [1, 1, 1]}]}}
    samples.append(write_scene(tmp_path, changes).read_bytes())

    def check(scenario):
        for low, high in scenario.deployment.bounds.values():
            assert -1e6 < low < high < 1e6

    assert fuzz(load_scenario, tmp_path / "scene.toml", samples, check)


_SENSOR_CSV = b"ring,elevation_deg,azimuth_offset_deg,fire_offset_us\n" + b"".join(
    b"%d,%d,0.5,%d\n" % (ring, ring - 8, ring) for ring in range(16)
)


@pytest.mark.parametrize("suffix", [".csv", ".toml"])
def test_damaged_sensor_files(tmp_path, suffix):
    sample = _SENSOR_CSV if suffix == ".csv" else (DATA_FOLDER / "rs_16.toml").read_bytes()

    def check(model):
        assert np.isfinite(model.elevation_rad).all()
        assert np.isfinite(model.azimuth_offset_rad).all()
        assert 1 <= model.rings * model.columns() <= 10_000_000
        assert 0 <= model.range_min_m < model.range_max_m

    assert fuzz(load_model, tmp_path / f"sensor{suffix}", sample, check)


# --- clouds -----------------------------------------------------------------------------------------------------------


def npz(save=np.savez, **arrays) -> bytes:
    stream = io.BytesIO()
    save(stream, **arrays)
    return stream.getvalue()


def _clouds() -> dict[str, bytes]:
    xyz = np.arange(60.0).reshape(20, 3)
    header = "VERSION 0.7\nFIELDS x y z vehicle_id\nSIZE 4 4 4 4\nTYPE F F F I\nCOUNT 1 1 1 1\nWIDTH 20\nHEIGHT 1\n"
    record = np.zeros(20, dtype=[("xyz", "<f4", 3), ("id", "<i4")])
    record["xyz"] = xyz
    text = "".join(f"{x} {y} {z} 3\n" for x, y, z in xyz)
    return {
        "plain.npz": npz(xyz=xyz, vehicle_id=np.arange(20)),
        "packed.npz": npz(np.savez_compressed, xyz=xyz.astype(np.float32), vehicle_id=np.arange(20)),
        "binary.pcd": f"{header}POINTS 20\nDATA binary\n".encode() + record.tobytes(),
        "ascii.pcd": f"{header}POINTS 20\nDATA ascii\n{text}".encode(),
    }


def a_sound_cloud(found) -> None:
    points, vehicle_id = found
    assert points.shape == (len(points), 3)
    assert points.dtype == float
    assert np.isfinite(points).all()
    assert vehicle_id is None or (vehicle_id.shape == (len(points),) and vehicle_id.dtype == np.int64)


@pytest.mark.parametrize("name", _clouds())
def test_damaged_clouds(tmp_path, name):
    assert fuzz(read_points, tmp_path / name, _clouds()[name], a_sound_cloud)


# --- what runs have stored --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", ["result.json", "vehicles.csv", "vehicles_baseline.csv", "scene.toml", "installation.txt"]
)
def test_damaged_runs(tmp_path, stored_runs, name):
    shutil.copytree(stored_runs / "searched", tmp_path / "run")
    folder = RunFolder(tmp_path / "run")

    refused = fuzz(lambda _: write_report(folder.read_outcome()), folder.file(name), folder.file(name).read_bytes())
    assert refused or name == "installation.txt"  # which is shown as it stands


@pytest.mark.parametrize("name", ["history.csv", "score_map.csv"])
def test_damaged_records_of_a_search(tmp_path, stored_runs, name):
    shutil.copytree(stored_runs / "searched", tmp_path / "run")
    folder = RunFolder(tmp_path / "run")

    read = folder.read_history if name == "history.csv" else folder.read_score_map
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


@pytest.mark.parametrize("method", ["de-pso", "hardened", "grid", "random"])
def test_damaged_checkpoints(tmp_path, method):
    scenario = load_scenario(write_scene(tmp_path, {**MAPPED, "search": {**SETTINGS["search"], "method": method}}))
    folder = RunFolder(tmp_path)
    score = partial(np.sum, axis=1)
    with pytest.raises(Stopped):
        Replay(folder, {"seed": 1}, resume=False).carry_out(fresh_search(scenario), score, StopsAfter(8))

    def resumed(_):
        with suppress(Stopped):
            Replay(folder, {"seed": 1}, resume=True).carry_out(search := fresh_search(scenario), score, StopsAfter(8))
        return search

    def check(search):
        assert search.done or np.isfinite(search.ask()).all()

    assert fuzz(resumed, folder.file("checkpoint.json"), folder.file("checkpoint.json").read_bytes(), check)
