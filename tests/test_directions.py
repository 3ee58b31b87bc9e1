"""Where a mast stands in its recording's frame, and words for which way a sensor leans, beside its pose."""

from __future__ import annotations

import math

import numpy as np
import pytest

from blender_lidar.scene.directions import pointing, towards
from blender_lidar.scene.scenario import load_scenario, scenario_of
from blender_lidar.scene.site import prepare
from tests.small_scene import traffic_rows, write_scene, write_table


def site_of(folder, origin=(0.0, 0.0), heading=0.0, changes=None):
    """The small scene, whose table has other coordinates."""
    turn, rows = math.radians(heading), traffic_rows()
    for row in rows:
        x, y = row[3], row[4]
        row[3] = origin[0] + x * math.cos(turn) - y * math.sin(turn)
        row[4] = origin[1] + x * math.sin(turn) + y * math.cos(turn)
        row[8] = heading
    folder.mkdir(exist_ok=True)
    write_table(folder / "traffic.csv", rows)
    placed = {"traffic": {"origin_m": list(origin), "heading_deg": heading}}
    return prepare(load_scenario(write_scene(folder, placed | (changes or {}))))


@pytest.mark.parametrize("heading", [0.0, 37.0, 90.0, -140.0])
def test_place_and_bearings_are_those_of_the_recording(tmp_path, heading):
    origin = (512_345.25, 5_403_112.5)
    site = site_of(tmp_path, origin, heading)
    at = pointing(site, site.scenario.lidar.mounting({"x_m": 3.0, "y_m": -1.0, "tilt_x_deg": 10.0}))
    turn = complex(math.cos(math.radians(heading)), math.sin(math.radians(heading)))
    place = complex(*origin) + complex(3.0, -1.0) * turn
    assert (at["x_m"], at["y_m"]) == pytest.approx((place.real, place.imag), abs=1e-6)
    ahead = 1j * turn  # across the road, in the file's frame
    bearing = math.degrees(math.atan2(ahead.real, ahead.imag)) % 360.0
    assert (at["facing_bearing_deg"], at["lean_bearing_deg"]) == pytest.approx((bearing, bearing))
    assert (at["lean_deg"], at["leans"]) == (pytest.approx(10.0), "towards the road")
    assert at["frame"] == "x and y of the table"


def test_an_upright_sensor_leans_nowhere(tmp_path):
    site = site_of(tmp_path)
    at = pointing(site, site.scenario.lidar.mounting({"tilt_x_deg": 0.0}))
    assert (at["leans"], at["lean_bearing_deg"]) == (None, None)


@pytest.mark.parametrize("y_m", [0.0, -4.0, 11.0, 14.0])
@pytest.mark.parametrize("facing", [90.0, -90.0, 20.0])
def test_words_agree_with_the_pose_on_either_side_of_the_road(tmp_path, y_m, facing):
    site = site_of(tmp_path)
    to_road = np.sign(5.5 - y_m)  # the road's middle
    for tilt_x in (-20.0, -5.0, 5.0, 20.0):
        for tilt_y in (-15.0, 0.0, 15.0):
            place = {"x_m": 30.0, "y_m": y_m, "facing_deg": facing, "tilt_x_deg": tilt_x, "tilt_y_deg": tilt_y}
            mounting = site.scenario.lidar.mounting(place)
            axis = mounting.pose.to_world(np.array([[0.0, 0.0, 1.0]]))[0]
            across, words = to_road * axis[1], pointing(site, mounting)["leans"]
            to_middle = np.subtract(site.region.centre_xy, mounting.xy)
            if words == "towards the middle of the region":
                assert axis[:2] @ to_middle > 0.98 * math.hypot(*axis[:2]) * math.hypot(*to_middle)
            elif words in ("towards the road", "away from the road"):
                assert (words == "towards the road") == (across > 0.0)
            else:
                assert abs(axis[0]) > abs(axis[1])
                assert ("with its traffic" in words) == (axis[0] > 0.0)


def test_in_a_median_the_side_is_that_of_the_nearest_lanes_traffic(tmp_path):
    two_way = {"road": {"lanes": 1, "carriageways": 2, "median_m": 4.0}, "deployment": {"y_m": 7.0, "side": "median"}}
    rows = [row for row in traffic_rows() if row[4] < 5.5]
    write_table(tmp_path / "traffic.csv", rows)
    site = prepare(load_scenario(write_scene(tmp_path, two_way)))
    assert towards(site, (0.0, 7.0), np.array([0.0, -1.0])) == "to the right of the nearest lane's traffic"
    assert towards(site, (0.0, 7.0), np.array([0.0, 1.0])) == "to the left of the nearest lane's traffic"


def driven(folder, **traffic):
    """A queue that drives along x and a row that crosses it, on a driven area."""
    rows = [["frame", "vehicle_id", "class", "x_m", "y_m", "length_m", "width_m", "height_m", "heading_deg", "time_s"]]
    for frame in range(40):
        for number in range(6):
            rows.append(
                [frame, number, "car", -60.0 + 2.0 * frame + 14.0 * number, -2.0, 4.5, 1.8, 1.5, 0.0, 0.2 * frame]
            )
            rows.append(
                [frame, 9 + number, "car", 12.0, -70.0 + 2.0 * frame + 14.0 * number, 4.5, 1.8, 1.5, 90.0, 0.2 * frame]
            )
    turn, (x0, y0) = math.radians(traffic.get("heading_deg", 0.0)), traffic.get("origin_m", (0.0, 0.0))
    for row in rows[1:]:
        x, y = row[3:5]
        row[3:5] = x0 + x * math.cos(turn) - y * math.sin(turn), y0 + x * math.sin(turn) + y * math.cos(turn)
        row[8] += traffic.get("heading_deg", 0.0)
    write_table(folder / "t.csv", rows[1:], rows[0])
    settings = {
        "traffic": {"path": str(folder / "t.csv"), "frames": 3, "holdout": 0.0, "accept": ["overlaps"], **traffic},
        "road": {"driven": True},
        "region": {"centre_m": [0.0, 0.0], "radius_m": 30.0},
        "sensor": {"name": "RS-16", "range_gate_m": 50.0},
        "deployment": {"x_m": 24.1, "y_m": 6.5},
        "model": {"workers": 1},
    }
    return prepare(scenario_of(settings))


def test_on_a_driven_area_place_and_bearings_are_those_of_the_recording(tmp_path):
    site = driven(tmp_path, origin_m=[1000.0, 500.0], heading_deg=30.0)
    at = pointing(site, site.scenario.lidar.baseline)
    assert (at["x_m"], at["y_m"]) == pytest.approx((1017.62, 517.68), abs=0.01)
    to_middle = math.degrees(math.atan2(1000.0 - at["x_m"], 500.0 - at["y_m"])) % 360.0  # clockwise from +y
    assert at["facing_bearing_deg"] == pytest.approx(to_middle, abs=1e-6)


def test_a_driven_area_has_no_lane_to_lean_along(tmp_path):
    site = driven(tmp_path)
    words = {towards(site, (24.1, 6.5), np.array([math.cos(a), math.sin(a)])) for a in np.radians(np.arange(0, 360, 5))}
    assert words == {
        "towards the middle of the region",
        "towards the road",
        "away from the road",
        "along the edge of the road",
    }


def test_x_alone_faces_the_middle_from_where_the_mast_then_stands(tmp_path):
    scenario = driven(tmp_path).scenario
    for given in ({"x_m": 30.0}, {"y_m": 9.0}, {"x_m": 30.0, "y_m": 9.0}):
        mounting = scenario.lidar.mounting(given)
        x, y = mounting.xy
        assert math.remainder(mounting.mast.facing_rad - math.atan2(-y, -x), math.tau) == pytest.approx(0.0, abs=1e-9)
