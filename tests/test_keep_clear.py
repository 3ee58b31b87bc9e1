"""A pole in a lane or inside a vehicle is refused by name; one beside them is not."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.errors import InputError
from blender_lidar.scene.mount_checks import check_mount_is_clear, footprints_meet
from blender_lidar.scene.scenario import load_scenario
from tests.sample_traffic import one_vehicle
from tests.small_scene import REGION, mounting, write_scene

LENGTHS = st.floats(0.2, 8.0)
PLACES = st.floats(-6.0, 6.0)


def boxes_meet_rectangle(vehicles, low, high):
    return footprints_meet(vehicles.centre_m, vehicles.size_m, vehicles.heading_rad, low, high)


def rectangle(low, high):
    return np.array(low, dtype=float), np.array(high, dtype=float)


def sampled_overlap(vehicle, low, high, points=70):
    """Whether a point of a dense grid over the footprint lies in the rectangle."""
    length, width, _ = vehicle.size_m[0]
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, points) * length, np.linspace(-0.5, 0.5, points) * width)
    cos, sin = math.cos(vehicle.heading_rad[0]), math.sin(vehicle.heading_rad[0])
    x = vehicle.centre_m[0, 0] + cos * u - sin * v
    y = vehicle.centre_m[0, 1] + sin * u + cos * v
    return bool(((x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])).any())


@settings(max_examples=300)
@given(
    centre=st.tuples(PLACES, PLACES),
    size=st.tuples(LENGTHS, LENGTHS),
    heading=st.floats(-math.pi, math.pi),
    sides=st.tuples(st.floats(0.1, 8.0), st.floats(0.1, 8.0)),
)
def test_overlap_is_what_dense_sampling_of_the_footprint_finds(centre, size, heading, sides):
    vehicle = one_vehicle("car", centre=centre, heading=heading, size=[*size, 1.5])
    low, high = -0.5 * np.array(sides), 0.5 * np.array(sides)
    spacing = max(size) / 69
    meets = bool(boxes_meet_rectangle(vehicle, low, high)[0])
    # Sampling misses slivers: what it finds is a meeting; what meets is found once the rectangle has grown a little.
    if sampled_overlap(vehicle, low, high):
        assert meets
    if meets:
        assert sampled_overlap(vehicle, low - spacing, high + spacing)


@pytest.fixture
def scene(tmp_path):
    def load(**deployment):
        baseline = deployment.pop("baseline", {})
        return load_scenario(write_scene(tmp_path, {"deployment": deployment, "baseline": baseline, **REGION}))

    return load


@pytest.mark.parametrize("y_m", [2.0, 0.0, -30.0, 9.0, 12.0, [-3.0, 2.0], [9.0, 10.0]])
def test_a_mount_beside_the_carriageway_is_let_pass(scene, y_m):
    check_mount_is_clear(scene(y_m=y_m), [one_vehicle("car", centre=(0.0, 4.0))])


@pytest.mark.parametrize(
    ("y_m", "named"), [(2.01, "y 2.01 m"), (8.9, "y 8.9 m"), ([0.0, 4.0], "y 0 to 4 m"), ([-5.0, 20.0], "y -5 to 20 m")]
)
def test_a_mount_that_could_stand_on_the_carriageway_is_refused(scene, y_m, named):
    scenario = scene(y_m=y_m, baseline={"y_m": 0.0})
    with pytest.raises(InputError) as refusal:
        check_mount_is_clear(scenario, [])
    assert str(refusal.value) == (
        f"{scenario.source}: [deployment] x_m, y_m: the mount at x 0 m, {named} stands on the carriageway; "
        'allowed: off the lanes, such as x 0, y 2 m or x 0, y 9 m, or [deployment] side = "gantry"'
    )


def test_a_baseline_on_the_carriageway_is_refused_by_its_own_name(scene):
    with pytest.raises(InputError, match=r"\[baseline\] x_m, y_m: the mount at x 0 m, y 3 m stands on the carriageway"):
        check_mount_is_clear(scene(baseline={"y_m": 3.0}), [])


def test_a_mount_inside_a_vehicle_is_refused_with_vehicle_and_frame(scene):
    stray = one_vehicle("car", centre=(1.0, 0.5))  # beside the carriageway, where a pole may stand
    elsewhere = one_vehicle("bus", centre=(30.0, 4.0))
    scenario = scene()
    with pytest.raises(InputError) as refusal:
        check_mount_is_clear(scenario, [elsewhere, dataclasses.replace(stray, frame=17)])
    assert str(refusal.value).startswith(
        f"{scenario.source}: [deployment] x_m, y_m: the mount at x 0 m, y 0 m stands inside vehicle 1 of frame 17"
    )
    assert "\n" not in str(refusal.value)


def test_every_place_of_a_searched_rectangle_must_be_clear(scene):
    stray = one_vehicle("motorcycle", centre=(6.0, -1.0))
    check_mount_is_clear(scene(x_m=[-4.0, 4.0], y_m=[-2.0, 0.0]), [stray])
    with pytest.raises(InputError, match="the mount at x -4 to 6 m, y -2 to 0 m stands inside vehicle 1"):
        check_mount_is_clear(scene(x_m=[-4.0, 6.0], y_m=[-2.0, 0.0]), [stray])


def test_a_mount_from_the_command_line_is_named_by_its_option(scene):
    scenario, lane = scene(), mounting({"y_m": 5.0, "height_m": 3.0})
    with pytest.raises(InputError, match=r"^--x, --y: the mount at x 0 m, y 5 m stands on the carriageway"):
        check_mount_is_clear(scenario, [], {"--x, --y": lane})
    check_mount_is_clear(scenario, [], {"--x, --y": mounting({"y_m": -5.0, "height_m": 3.0})})


def test_a_mount_among_vehicles_is_told_where_they_drive(scene):
    lane = [one_vehicle("car", centre=(x, y)) for x, y in ((0.5, 0.4), (10.0, -1.0), (200.0, -30.0))]
    with pytest.raises(InputError) as refusal:
        check_mount_is_clear(scene(), lane)
    half = 0.5 * lane[0].size_m[0, 1]
    assert f"vehicles drive there from {-1.0 - half:.1f} to {0.4 + half:.1f} m in front of the mast" in str(
        refusal.value
    )
    assert "frame_ids" not in str(refusal.value)
