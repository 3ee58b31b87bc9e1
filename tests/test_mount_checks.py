"""Mountings that look wrong: radians, tilts away from the road, heights; poles in a lane or inside a vehicle."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.errors import InputError
from blender_lidar.scene.angles import in_radians
from blender_lidar.scene.mount_checks import (
    check_mount_is_clear,
    check_places_are_clear,
    footprints_meet,
    mount_notes,
)
from blender_lidar.scene.scenario import load_scenario, shipped_scenes
from blender_lidar.world.scenery import box, join, structure
from tests.sample_traffic import one_vehicle
from tests.small_scene import REGION, mounting, write_scene

TURN = {"tilt_x_deg": 15.0}
FAR_SIDE = {"y_m": 12.0, "tilt_x_deg": [0.0, 25.0]}


def scene(folder, deployment=None, **tables):
    return load_scenario(write_scene(folder, {**REGION, "deployment": deployment or {}, **tables}))


@pytest.mark.parametrize(
    ("deployment", "message"),
    [
        ({"tilt_x_deg": [0.0, 0.44]}, r"tilt_x_deg: is \[0, 0.44\] degrees; probably radians: \[0, 25\] in degrees"),
        ({"tilt_x_deg": [0.0, 0.4363]}, r"probably radians: \[0, 25\].*give other bounds"),
        ({"tilt_x_deg": [0.0, 1.57]}, r"probably radians: \[0, 90\]"),
        ({**TURN, "yaw_deg": [-0.52, 0.52]}, r"yaw_deg: .* probably radians: \[-30, 30\]"),
        ({**TURN, "yaw_deg": [-3.14, 3.14]}, r"yaw_deg: .* probably radians: \[-180, 180\]"),
        ({"tilt_x_deg": None, "lean_deg": [0.0, 0.35], "lean_direction_deg": 0.0}, r"lean_deg: .* \[0, 20\]"),
    ],
)
def test_an_angle_that_is_searched_in_radians_is_refused(deployment, message, tmp_path):
    with pytest.raises(InputError, match=message):
        scene(tmp_path, deployment)


@pytest.mark.parametrize(
    ("key", "ends"),
    [
        ("tilt_x_deg", (0.0, 25.0)),
        ("tilt_x_deg", (14.8, 15.2)),
        ("tilt_x_deg", (0.0, 0.5)),
        ("tilt_x_deg", (0.0, 1.0)),
        ("tilt_x_deg", (-0.5, 0.5)),
        ("tilt_x_deg", (0.0, 0.45)),
        ("tilt_x_deg", (0.25, 0.75)),
        ("tilt_y_deg", (-2.0, 2.0)),
        ("yaw_deg", (-5.0, 5.0)),
        ("yaw_deg", (-180.0, 180.0)),
        ("lean_deg", (0.0, 0.0)),
        ("tilt_x_deg", (15.25,)),
        ("tilt_x_deg", (0.0,)),
    ],
)
def test_degrees_are_not_taken_for_radians(key, ends):
    assert in_radians(key, ends) is None


NOTES = {  # by name: [deployment], other tables, and what is said
    "a fixed tilt in radians": ({"tilt_x_deg": 0.26}, {}, "tilt_x_deg of [deployment] is 0.26 degrees; is that 15"),
    "a baseline in radians": ({}, {"baseline": {"tilt_x_deg": 0.35}}, "tilt_x_deg of [baseline] is 0.35 degrees"),
    "a mast of 60 m": ({"height_m": [20.0, 60.0]}, {}, "heights up to 60 m are searched"),
    "noise in centimetres": ({}, {"sensor": {"range_noise_m": 2.0}}, "range_noise_m is 2 m"),
    "a tilt away": ({"tilt_x_deg": [-25.0, 0.0]}, {}, "every mounting that is searched looks down away from the road"),
    "from the far side": (FAR_SIDE, {}, "as at x 0, y 12 m: a positive tilt_x_deg looks down to where the mast faces"),
    "a lean away": (
        {"tilt_x_deg": None, "lean_deg": [0.0, 25.0], "lean_direction_deg": 180.0},
        {},
        "every mounting that is searched looks down away",
    ),
}
RIGHT = {
    "the usual": ({}, {}),
    "both ways": ({"tilt_x_deg": [-25.0, 25.0]}, {}),
    "from the far side, turned": ({**FAR_SIDE, "yaw_deg": 180.0}, {}),
    "from the far side, negative": ({**FAR_SIDE, "tilt_x_deg": [-25.0, 0.0]}, {}),
    "a direction that is searched": (
        {"y_m": 12.0, "tilt_x_deg": None, "lean_deg": [0.0, 25.0], "lean_direction_deg": [-180.0, 180.0]},
        {},
    ),
    "a high lamp": ({"height_m": [5.0, 15.0]}, {}),
    "the data sheet's noise": ({}, {"sensor": {"range_noise_m": "datasheet"}}),
}


@pytest.mark.parametrize("case", NOTES)
def test_what_may_be_wrong_is_told(case, tmp_path):
    deployment, tables, message = NOTES[case]
    assert message in " | ".join(mount_notes(scene(tmp_path, deployment, **tables)))


@pytest.mark.parametrize("case", RIGHT)
def test_what_is_right_is_told_nothing_of(case, tmp_path):
    deployment, tables = RIGHT[case]
    assert list(mount_notes(scene(tmp_path, deployment, **tables))) == []


def test_shipped_scenes_and_a_mounting_by_hand(tmp_path):
    pytest.importorskip("sumolib", reason="sumolib is not installed")
    assert [list(mount_notes(load_scenario(path))) for path in shipped_scenes().values()] == [[]] * 4
    given = scene(tmp_path)
    mount = given.lidar.mounting({"tilt_x_deg": 0.26})
    assert [note.partition(" degrees")[0] for note in mount_notes(given, [mount])] == [
        "tilt_x_deg of the mounting is 0.26"
    ]
    (high,) = mount_notes(given, [given.lidar.mounting({"height_m": 45.0})])
    assert high.startswith("height_m of the mounting is 45 m (usual: 2 to 12")


def test_poles_that_look_away_are_counted(tmp_path):
    (tmp_path / "poles.csv").write_text("name,x_m,y_m\nright,0,0\nleft,0,12\n", encoding="utf-8")
    notes = list(mount_notes(scene(tmp_path, {"poles": "poles.csv", "tilt_x_deg": [0.0, 25.0]})))
    assert len(notes) == 1
    assert notes[0].startswith("on 1 of 2 poles every mounting that is searched looks down away")


@pytest.mark.parametrize(
    ("places", "refused"), [(("11.5001", "11.5004"), True), (("0", "0"), False), (("0", "1"), False)]
)
def test_poles_in_degrees_of_longitude_are_refused(places, refused, tmp_path):
    rows = "".join(f"{name},{x},-1.0\n" for name, x in zip("AB", places, strict=True))
    (tmp_path / "poles.csv").write_text("name,x_m,y_m\n" + rows, encoding="utf-8")
    if not refused:
        assert len(scene(tmp_path, {"poles": "poles.csv"}).lidar.deployment.poles) == 2
        return
    with pytest.raises(InputError, match=r"stand within 0.05 m, about x_m 11.5001.*longitude and latitude"):
        scene(tmp_path, {"poles": "poles.csv"})


# --- a pole in a lane or inside a vehicle -----------------------------------------------------------------------------


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
def clear_scene(tmp_path):
    def load(**deployment):
        baseline = deployment.pop("baseline", {})
        return load_scenario(write_scene(tmp_path, {"deployment": deployment, "baseline": baseline, **REGION}))

    return load


@pytest.mark.parametrize("y_m", [2.0, 0.0, -30.0, 9.0, 12.0, [-3.0, 2.0], [9.0, 10.0]])
def test_a_mount_beside_the_carriageway_is_let_pass(clear_scene, y_m):
    check_places_are_clear(clear_scene(y_m=y_m), [one_vehicle("car", centre=(0.0, 4.0))])


@pytest.mark.parametrize(
    ("y_m", "named"), [(2.01, "y 2.01 m"), (8.9, "y 8.9 m"), ([0.0, 4.0], "y 0 to 4 m"), ([-5.0, 20.0], "y -5 to 20 m")]
)
def test_a_mount_that_could_stand_on_the_carriageway_is_refused(clear_scene, y_m, named):
    scenario = clear_scene(y_m=y_m, baseline={"y_m": 0.0})
    with pytest.raises(InputError) as refusal:
        check_places_are_clear(scenario, [])
    assert str(refusal.value) == (
        f"{scenario.source}: [deployment] x_m, y_m: the mount at x 0 m, {named} stands on the carriageway; "
        'allowed: off the lanes, such as x 0, y 2 m or x 0, y 9 m, or [deployment] side = "gantry"'
    )


def test_a_baseline_on_the_carriageway_is_refused_by_its_own_name(clear_scene):
    with pytest.raises(InputError, match=r"\[baseline\] x_m, y_m: the mount at x 0 m, y 3 m stands on the carriageway"):
        check_places_are_clear(clear_scene(baseline={"y_m": 3.0}), [])


def test_a_mount_inside_a_vehicle_is_refused_with_vehicle_and_frame(clear_scene):
    stray = one_vehicle("car", centre=(1.0, 0.5))  # beside the carriageway, where a pole may stand
    elsewhere = one_vehicle("bus", centre=(30.0, 4.0))
    scenario = clear_scene()
    with pytest.raises(InputError) as refusal:
        check_places_are_clear(scenario, [elsewhere, dataclasses.replace(stray, frame=17)])
    assert str(refusal.value).startswith(
        f"{scenario.source}: [deployment] x_m, y_m: the mount at x 0 m, y 0 m stands inside vehicle 1 of frame 17"
    )
    assert "\n" not in str(refusal.value)


def test_every_place_of_a_searched_rectangle_must_be_clear(clear_scene):
    stray = one_vehicle("motorcycle", centre=(6.0, -1.0))
    check_places_are_clear(clear_scene(x_m=[-4.0, 4.0], y_m=[-2.0, 0.0]), [stray])
    with pytest.raises(InputError, match="the mount at x -4 to 6 m, y -2 to 0 m stands inside vehicle 1"):
        check_places_are_clear(clear_scene(x_m=[-4.0, 6.0], y_m=[-2.0, 0.0]), [stray])


def test_a_mount_from_the_command_line_is_named_by_its_option(clear_scene):
    scenario, lane = clear_scene(), mounting({"y_m": 5.0, "height_m": 3.0})
    with pytest.raises(InputError, match=r"^--x, --y: the mount at x 0 m, y 5 m stands on the carriageway"):
        check_mount_is_clear(scenario, scenario.lidar, [], {"--x, --y": lane})
    check_mount_is_clear(scenario, scenario.lidar, [], {"--x, --y": mounting({"y_m": -5.0, "height_m": 3.0})})


def test_a_mount_among_vehicles_is_told_where_they_drive(clear_scene):
    lane = [one_vehicle("car", centre=(x, y)) for x, y in ((0.5, 0.4), (10.0, -1.0), (200.0, -30.0))]
    with pytest.raises(InputError) as refusal:
        check_places_are_clear(clear_scene(), lane)
    half = 0.5 * lane[0].size_m[0, 1]
    assert f"vehicles drive there from {-1.0 - half:.1f} to {0.4 + half:.1f} m in front of the mast" in str(
        refusal.value
    )
    assert "frame_ids" not in str(refusal.value)


def meshes(*parts):
    """Triangles of some objects as one file's scenery."""
    return join([structure(f"object {number}", corners) for number, corners in enumerate(parts)])


HOUSE = box("house", (6.0, -6.0, 3.0), (3.0, 1.0, 2.0), 0.3).corners
TUNNEL = box("tunnel", (6.0, -6.0, 3.0), (400.0, 4.0, 6.0)).corners
TUNNEL = TUNNEL[np.ptp(TUNNEL[..., 0], axis=1) > 1.0]  # without its ends
SHEETS = np.array([[(-90.0, -90.0, z), (90.0, -90.0, z), (0.0, 180.0, z)] for z in (0.0, 6.0)])


@pytest.mark.parametrize(
    ("parts", "at", "inside"),
    [
        ([SHEETS, HOUSE], (6.0, -6.0, 3.0), True),
        ([SHEETS, HOUSE], (6.5, -5.9, 2.5), True),
        ([SHEETS, HOUSE], (6.0, -6.0, 4.1), False),
        ([SHEETS, HOUSE], (7.45, -6.55, 3.0), False),
        ([TUNNEL], (6.0, -6.0, 3.0), False),  # open at both ends
        ([box("sky", (0.0, 0.0, 0.0), (400.0, 400.0, 300.0)).corners], (6.0, -6.0, 3.0), False),  # about the road too
    ],
)
def test_a_lidar_inside_a_closed_mesh_is_refused(parts, at, inside, tmp_path):
    scenario = scene(tmp_path)
    mounts = {"here": scenario.lidar.mounting(dict(zip(("x_m", "y_m", "height_m"), at, strict=True)))}
    if inside:
        with pytest.raises(InputError, match=r"here: the LiDAR hangs inside 'object 1' of \[world\]"):
            check_mount_is_clear(scenario, scenario.lidar, [], mounts, meshes(*parts))
    else:
        check_mount_is_clear(scenario, scenario.lidar, [], mounts, meshes(*parts))


def test_every_place_that_may_be_is_looked_at(tmp_path):
    searched = scene(tmp_path / "a", {"x_m": 6.0, "y_m": -6.0, "height_m": [3.0, 5.0]})
    with pytest.raises(InputError, match=r"\[deployment\] x_m, y_m: the LiDAR hangs inside 'object 0'"):
        check_places_are_clear(searched, [], meshes(HOUSE))
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "poles.csv").write_text("name,x_m,y_m\nfirst,6,-6\nlast,-9,-1\n")
    fixed = {"poles": "poles.csv", "y_m": None, "height_m": 3.0, "tilt_x_deg": 10.0}
    on_poles = scene(tmp_path / "b", fixed)
    with pytest.raises(InputError, match="pole 'first': the LiDAR hangs inside 'object 0'"):
        check_places_are_clear(on_poles, [], meshes(HOUSE))
