"""PointPillars: the ground, pillars, the network in NumPy, boxes, and what is unlike its training."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from blender_lidar.detection import pillar_network as network
from blender_lidar.detection.ground import Ground, fit_ground
from blender_lidar.detection.judge import sensor_at, watched
from blender_lidar.detection.pillars import (
    GROUND_M,
    PILLAR_M,
    SHIPPED,
    Area,
    PillarsDetector,
    boxes_of,
    load_weights,
    pillars_of,
)
from blender_lidar.errors import InputError, MissingFileError
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from tests.refusals import refused
from tests.small_scene import CASTER, REGION, done, write_scene

pytestmark = [pytest.mark.usefixtures("quick"), pytest.mark.versions]

AREA = Area((-12.8, -6.4), 64, 32)
LIDAR_M = 4.5


def scattered(count=400, seed=1):
    """Points above and on the ground within `AREA`, and some beyond it."""
    rng = np.random.default_rng(seed)
    return rng.uniform((-20.0, -10.0, -0.05), (20.0, 10.0, 3.0), (count, 3))


# --- The ground -------------------------------------------------------------------------------------------------------


def street(slope_x, slope_y, level, seed=3):
    """A noisy plane within 45 m, with boxes of vehicles, bushes and a wall on it."""
    rng = np.random.default_rng(seed)
    away, turn = 4.0 + 41.0 * rng.random(4000) ** 2, rng.uniform(0.0, 2.0 * math.pi, 4000)
    xy = np.column_stack([away * np.cos(turn), away * np.sin(turn)])
    above = rng.normal(0.0, 0.02, 4000)
    things = rng.random(4000) < 0.4
    above[things] = rng.uniform(0.2, 3.0, things.sum())
    return np.column_stack([xy, level + xy @ [slope_x, slope_y] + above])


@pytest.mark.parametrize(("slope_deg", "level"), [((0.0, 0.0), 0.0), ((1.0, -0.7), 0.05), ((-1.2, 1.2), -0.1)])
def test_the_ground_of_a_mounting_that_is_off_is_found_among_vehicles(slope_deg, level):
    slopes = np.tan(np.radians(slope_deg))
    ground = fit_ground(street(*slopes, level))
    assert ground.level == pytest.approx(level, abs=0.02)
    assert (ground.slope_x, ground.slope_y) == pytest.approx(tuple(slopes), abs=4e-4)  # 2 cm at 50 m
    assert ground.residual_m < 0.05


def test_too_little_ground_leaves_the_plane_as_it_is_believed():
    for points in (np.empty((0, 3)), street(0.0, 0.0, 0.0)[:20], np.full((200, 3), 0.01)):
        ground = fit_ground(points)
        assert ground[:3] == (0.0, 0.0, 0.0)
        assert math.isnan(ground.residual_m)


# --- Pillars ----------------------------------------------------------------------------------------------------------


def test_pillars_hold_every_raised_point_of_the_area_in_its_cell_and_count_the_rest():
    points = scattered()
    ground = fit_ground(np.empty((0, 3)))
    pillars = pillars_of(points, ground, LIDAR_M, AREA)
    size = PILLAR_M * np.array([AREA.along, AREA.across])
    inside = ((points[:, :2] >= AREA.first_m) & (points[:, :2] < AREA.first_m + size)).all(axis=1)
    raised = points[inside & (points[:, 2] > GROUND_M)]
    assert len(pillars.cell) == len(raised)
    assert (np.diff(pillars.cell) >= 0).all()
    x, y = np.divmod(pillars.cell, AREA.across)
    middle = np.array(AREA.first_m) + PILLAR_M * (np.column_stack([x, y]) + 0.5)
    again = np.column_stack([middle + PILLAR_M * pillars.points[:, :2], pillars.points[:, 2]])
    order = [np.lexsort(array.round(3).T) for array in (again, raised)]
    np.testing.assert_allclose(again[order[0]], raised[order[1]], atol=1e-5)
    counted = np.expm1(3.0 * pillars.cells[0, ..., :2].sum(axis=(0, 1), dtype=float))
    assert counted.shape == (2,)
    on_ground, above = np.rint(np.expm1(3.0 * pillars.cells[0, ..., :2])).sum(axis=(0, 1))
    assert (on_ground, above) == (inside.sum() - len(raised), len(raised))


def test_bare_ground_is_counted_nearby_alone_and_farther_out_where_something_rises_from_it():
    near, far = 49.0, 51.0
    points = np.array([[near, 0.1, 0.0], [-far, 0.1, 0.0], [far, 0.1, 0.0], [far, 0.1, 1.0]])
    area = Area.around((-60.0, 0.0), (60.0, 1.0))
    cells = pillars_of(points, fit_ground(np.empty((0, 3))), LIDAR_M, area, 50.0).cells[0]
    column = np.floor((points[:, :2] - area.first_m) / PILLAR_M).astype(int)
    on_ground = np.rint(np.expm1(3.0 * cells[..., 0]))
    assert [on_ground[tuple(place)] for place in column[:3]] == [1.0, 0.0, 1.0]
    assert on_ground.sum() == 2.0


def test_an_area_covers_what_it_is_asked_for_in_whole_coarse_cells():
    area = Area.around(np.array([-50.3, 1.0]), np.array([50.0, 24.7]))
    assert (area.along % network.COARSEST, area.across % network.COARSEST) == (0, 0)
    assert area.first_m[0] <= -50.3
    assert area.first_m[1] <= 1.0
    assert area.first_m[0] + PILLAR_M * area.along >= 50.0
    assert area.first_m[1] + PILLAR_M * area.across >= 24.7


# --- The network ------------------------------------------------------------------------------------------------------


def test_a_convolution_is_the_sum_over_nine_neighbours():
    rng = np.random.default_rng(5)
    image, kernel = rng.normal(size=(1, 5, 4, 3)), rng.normal(size=(3, 3, 3, 2))
    slow = np.zeros((5, 4, 2))
    for x in range(5):
        for y in range(4):
            for i in (-1, 0, 1):
                for j in (-1, 0, 1):
                    if 0 <= x + i < 5 and 0 <= y + j < 4:
                        slow[x, y] += image[0, x + i, y + j] @ kernel[1 + i, 1 + j]
    np.testing.assert_allclose(network.NumPyOperations.convolve(image, kernel)[0], slow, atol=1e-12)


def test_the_maxima_of_cells_are_those_of_their_points_and_never_below_0():
    rng = np.random.default_rng(6)
    cell, values = np.sort(rng.integers(0, 12, 40)), rng.normal(size=(40, 3))
    found = network.NumPyOperations.maxima(values, cell, 14)
    slow = [np.max([np.zeros(3), *values[cell == number]], axis=0) for number in range(14)]
    np.testing.assert_array_equal(found, slow)
    assert not network.NumPyOperations.maxima(values[:0], cell[:0], 3).any()


def test_cells_that_are_joined_come_apart_again():
    image = np.random.default_rng(7).normal(size=(2, 8, 4, 3))
    np.testing.assert_array_equal(network._unpatched(network._patches(image)), image)


# --- The weights ------------------------------------------------------------------------------------------------------


def test_the_weights_that_ship_are_small_and_say_what_they_were_trained_on():
    weights, trained = load_weights(SHIPPED)
    assert SHIPPED.stat().st_size < 1_000_000
    assert {name: array.shape for name, array in weights.items()} == network.shapes()
    assert {"sensors", "height_m", "lean_deg", "residual_m", "density"} == set(trained)


def damaged(path, **changed):
    """A file of weights like those that ship, with something changed or, where it is None, left out."""
    with np.load(SHIPPED) as file:
        arrays = {name: file[name] for name in file.files}
    np.savez(path, **{name: array for name, array in (arrays | changed).items() if array is not None})
    return path


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"head.w": np.zeros((3, 3, 4, 4))}, "another network; needed: head.w (3, 3, 32, 32)"),
        ({"out.b": None}, "needed: out.b (11,)"),
        ({"out.b": np.full(11, np.nan)}, "weights that are not finite numbers"),
        ({"card": None}, "weights.npz: its card: is None; allowed: a table"),
        ({"card": "{}"}, "[trained_on] sensors: is missing"),
        ({"card": json.dumps({"trained_on": {"sensors": ["RS-16"]}})}, "[trained_on] height_m: is missing"),
        ({"card": "{"}, "is no file of weights"),
    ],
)
def test_weights_of_another_network_are_refused(tmp_path, changed, message):
    with pytest.raises(InputError, match="weights") as raised:
        load_weights(damaged(tmp_path / "weights.npz", **changed))
    assert message in str(raised.value)


def test_files_that_hold_no_weights_are_refused_in_one_line(tmp_path, capsys):
    scene = write_scene(tmp_path, REGION)
    (tmp_path / "text.npz").write_text("not a zip")
    assert "is no file of weights" in refused(capsys, tmp_path, "detect", scene, "--detector", tmp_path / "text.npz")
    np.save(tmp_path / "array.npy", np.zeros(3))
    (tmp_path / "array.npy").rename(tmp_path / "array.npz")
    assert "is no file of weights" in refused(capsys, tmp_path, "detect", scene, "--detector", tmp_path / "array.npz")
    assert "there is no such file" in refused(capsys, tmp_path, "detect", scene, "--detector", tmp_path / "none.npz")
    with pytest.raises(MissingFileError):
        load_weights(tmp_path / "none.npz")


# --- The detector -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def i80():
    """The shipped scene's site, a mounting, and a function that gives clouds of it."""
    options = {("traffic", "frames"): 4, ("model", "caster"): CASTER, ("world", "clutter"): 0.5}
    site = prepare(load_scenario("i80", {place: (value, place[1]) for place, value in options.items()}))
    mount = site.scenario.lidar.mounting({"height_m": 4.5, "tilt_x_deg": 22.0})
    return site, mount, cache(lambda at: sensor_at(site, mount).scan(site.search[at]))


def detector(site, mount, **changed):
    pose = replace(mount.pose, **changed)
    return PillarsDetector(site.model.name, pose, (-50.0, -6.0), (50.0, 32.0))


def found_share(site, at, boxes):
    """Share of a frame's counted vehicles that a box's centre is within 2 m of, and of boxes that meet a vehicle."""
    frame = site.search[at]
    every = frame.centre_m[:, None, :2] - boxes.centre_m[:, :2]
    near = np.hypot(*np.moveaxis(every, -1, 0)) < 2.0
    return near[frame.counted].any(axis=1).mean(), near.any(axis=0).mean()


def test_most_vehicles_are_found_and_most_boxes_are_vehicles(i80):
    site, mount, cloud = i80
    shares = []
    for at in range(4):
        boxes = detector(site, mount).detect(cloud(at))[0]
        shares.append(found_share(site, at, boxes.select(boxes.confidence >= 0.3)))
        assert (boxes.size_m > 0.3).all()
        assert ((boxes.confidence > 0.0) & (boxes.confidence <= 1.0)).all()
    recall, precision = np.mean(shares, axis=0)
    assert recall > 0.65
    assert precision > 0.8


@pytest.mark.parametrize(("shift", "within"), [((6.4, 3.2), 1e-3), ((1.3, 0.7), 0.5)])
def test_boxes_move_with_the_lidar_and_its_cloud(i80, shift, within):
    """By whole coarse cells exactly, else as well as cells in another place tell."""
    _, mount, cloud = i80
    pose = mount.pose
    corners = np.array([(-50.0, -6.0), (50.0, 32.0)])
    here = PillarsDetector("RS-16", pose, *corners).detect(cloud(0))[0]
    moved = replace(cloud(0), xyz=cloud(0).xyz + np.array([*shift, 0.0]))
    pose = replace(pose, x_m=pose.x_m + shift[0], y_m=pose.y_m + shift[1])
    there = PillarsDetector("RS-16", pose, *(corners + shift)).detect(moved)[0]
    sure = here.select(here.confidence >= 0.5)
    assert len(sure) > 8
    away = there.centre_m[:, None] - (sure.centre_m + np.array([*shift, 0.0]))
    assert np.linalg.norm(away, axis=-1).min(axis=0).max() < within


def test_a_tilt_that_is_off_by_a_degree_is_repaired_by_the_fitted_ground(i80, monkeypatch):
    """Without it the road itself rises to where vehicles are."""
    site, mount, cloud = i80
    pose = mount.pose
    off = replace(pose, tilt_x=pose.tilt_x - math.radians(1.0))

    def precision():
        shares = []
        for at in range(4):
            measured = (cloud(at).xyz - pose.position) @ pose.rotation.T
            boxes = detector(site, mount).detect(replace(cloud(at), xyz=off.position + measured @ off.rotation))[0]
            shares.append(found_share(site, at, boxes.select(boxes.confidence >= 0.3))[1])
        return np.mean(shares)

    assert precision() > 0.8
    monkeypatch.setattr("blender_lidar.detection.pillars.fit_ground", lambda points: Ground(0.0, 0.0, 0.0, 0.0))
    assert precision() < 0.8


def test_a_cloud_without_points_has_no_vehicles_and_one_with_nan_is_refused(i80):
    site, mount, cloud = i80
    one = cloud(0)
    nothing = replace(one, **{name: getattr(one, name)[:0] for name in ("xyz", "range_m")})
    assert len(detector(site, mount).detect(nothing)[0]) == 0
    xyz = one.xyz.copy()
    xyz[7, 1] = np.nan
    with pytest.raises(InputError, match=r"point 7 of the cloud is .*nan.*; allowed: finite coordinates"):
        detector(site, mount).detect(replace(one, xyz=xyz))


def test_what_is_unlike_the_training_is_told_and_what_is_like_it_is_not(i80):
    site, mount, cloud = i80
    usual = detector(site, mount)

    def message(xyz) -> str:
        return " ".join(usual.notes([usual.detect(replace(cloud(0), xyz=xyz))[1]]))

    assert message(cloud(0).xyz) == ""
    high = detector(site, mount, height_m=9.0)
    assert "hangs 9 m high, but from " in " ".join(high.notes())
    other = PillarsDetector("OS1-128", mount.pose, (-50.0, -6.0), (50.0, 32.0))
    assert "was trained on RS-16, RS-32, RS-80, not on OS1-128" in " ".join(other.notes())
    off = np.random.default_rng(1).normal(0.0, 0.15, (len(cloud(0)), 1)) * [0.0, 0.0, 1.0]
    assert "m uneven in the median" in message(cloud(0).xyz + off)
    assert "too little ground" in message(cloud(0).xyz + np.array([0.0, 0.0, 3.0]))


def test_traffic_off_the_road_is_told_to_be_unlike_the_training(i80):
    site, mount, _ = i80
    one = detector(site, mount)
    one.check_headings(np.radians([0.0, 180.0, 3.0, -176.0]))
    assert list(one.notes()) == []
    one.check_headings(np.radians([0.0, 180.0, 90.0]))
    assert "33 % of the vehicles stand more than 15 degrees off x" in one.notes()[0]


def test_ours_look_at_the_whole_region_though_few_vehicles_are_searched(i80):
    site, _, _ = i80
    low, high = watched(replace(site, search=site.search[:1]))
    ((right, left),) = site.scenario.road.carriageways_y
    assert (low.tolist(), high.tolist()) == ([-50.0, right - 8.0], [50.0, left + 8.0])
    beside = site.search[0]
    far = replace(beside, centre_m=beside.centre_m + np.array([0.0, 30.0, 0.0]))
    low, high = watched(replace(site, search=(far,)))
    assert (low.tolist(), high.tolist()) == ([-50.0, -50.0], [50.0, 50.0])


def test_nothing_is_found_where_the_network_sees_nothing():
    quiet = np.full((8, 8, network.OUTPUTS), -9.0)
    assert len(boxes_of(quiet, Area((0.0, 0.0), 16, 16))) == 0


def test_the_verb_judges_it_and_a_scene_without_ground_is_told_of(tmp_path, capsys):
    scene, mount = write_scene(tmp_path, REGION), ("--height", 4.5, "--tilt-x", 15)
    out, _ = done(capsys, "detect", scene, *mount, "--out", tmp_path / "found")
    result = json.loads((tmp_path / "found" / "detection.json").read_text())
    assert result["detector"] == "pillars"
    assert result["mountings"]["given"]["recall_0.3"] > 0.5
    assert "no ground" not in out
    scene = write_scene(tmp_path, {**REGION, "world": {"ground": False}})
    out, _ = done(capsys, "detect", scene, *mount, "--out", tmp_path / "bare")
    assert "The scene has no ground" in out
