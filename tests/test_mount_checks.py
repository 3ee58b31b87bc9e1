"""Mountings that look wrong: angles in radians, tilts away from the road, heights and noise; right ones are silent."""

from __future__ import annotations

import pytest

from blender_lidar.errors import InputError
from blender_lidar.scene.mount_checks import mount_notes
from blender_lidar.scene.places import in_radians
from blender_lidar.scene.scenario import load_scenario, shipped_scenes
from tests.small_scene import REGION, write_scene

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
    assert [list(mount_notes(load_scenario(path))) for path in shipped_scenes().values()] == [[], []]
    given = scene(tmp_path)
    mount = given.mounting({"tilt_x_deg": 0.26})
    assert [note.partition(" degrees")[0] for note in mount_notes(given, [mount])] == [
        "tilt_x_deg of the mounting is 0.26"
    ]
    (high,) = mount_notes(given, [given.mounting({"height_m": 45.0})])
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
        assert len(scene(tmp_path, {"poles": "poles.csv"}).deployment.poles) == 2
        return
    with pytest.raises(InputError, match=r"stand within 0.05 m, about x_m 11.5001.*longitude and latitude"):
        scene(tmp_path, {"poles": "poles.csv"})
