"""scripts/research/make_crossing.py: fresh traffic at a signal, the same for the same seed, and its cycle is found."""

from __future__ import annotations

import gzip

import pytest

pytest.importorskip("pandas")

import tests.research  # noqa: F401
import make_crossing as script
from blender_lidar.road.straight import StraightRoad
from blender_lidar.traffic import plan_frames, read_traffic
from tests.test_make_traffic import needs_sumo


def rows_of(path):
    """The file but for its head, which has the time of day."""
    return gzip.decompress(path.read_bytes()).partition(b"<fcd-export")[2]


@needs_sumo
def test_a_generated_crossing_shows_the_cycle_of_its_signal(tmp_path):
    first, second = script.cached_recordings(tmp_path, 2, 60, minutes=5.0)
    assert first.read_bytes() != second.read_bytes()
    west = {"origin_m": (-20.0, -9.0), "heading_deg": 0.0, "vehicle_types": str(tmp_path / script.VEHICLE_TYPES)}
    road = StraightRoad(lanes=script.LANES, lane_width_m=script.LANE_M)
    recording = read_traffic(str(first), format="sumo", road=road, **west)
    plan = plan_frames(recording, lambda vehicles: abs(vehicles.centre_m[:, 0]) < 50.0)
    assert any("a signal's cycle (60 s" in note for note in plan.notes)
    (again,) = script.cached_recordings(tmp_path / "again", 1, 60, minutes=5.0)
    assert rows_of(again) == rows_of(first)
