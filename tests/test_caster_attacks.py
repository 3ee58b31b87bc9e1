"""Casters under attack: what was tried, what broke once, and how the oracle that judges them is judged itself.

Then scans, scores and scenery: many mountings at once, within vehicles, far away, and what is not finite.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math

import numpy as np
import pytest

import tests.research  # noqa: F401
from attack_scenes import (
    ATTACKS,
    attacks,
    cuboid,
    floor,
    lens,
    points_on_edges,
    street,
    unit,
    vertices_of,
)
from blender_lidar.casting import CASTERS, caster_class, is_available
from blender_lidar.casting.exact import ExactCaster
from blender_lidar.casting.protocol import StandingScenery
from blender_lidar.casting.tree import fences, grown
from blender_lidar.errors import InputError
from blender_lidar.scene.observation import Observation
from blender_lidar.scoring.frame_scorer import FrameScorer, singles
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.lidar import Lidar
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose, rotation_matrix
from blender_lidar.world.scenery import box, join
from caster_attacks import TOLERANCE_M, AttackCount, count_attack, differences, main, verdict
from tests.rational_oracle import first_distances
from tests.sample_traffic import dense_traffic, joined, one_vehicle, scan

MISSING = {name: pytest.mark.skipif(not is_available(name), reason=f"{name} is not installed") for name in CASTERS}
FAST = [pytest.param(name, marks=MISSING[name]) for name in ("raster", "bvh", "embree")]
EVERY = [*FAST, "exact"]
MAST = np.array([0.0, 0.0, 4.1])


@pytest.mark.parametrize("attack", ATTACKS)
@pytest.mark.parametrize("caster", FAST)
def test_under_attack_no_ray_misses_hits_nothing_or_is_measured_wrongly(caster, attack):
    count = count_attack(caster, attack)
    assert count.hits >= 24
    assert (count.silent_misses, count.false_hits, count.wrong_distances) == (0, 0, 0)
    assert count.knife_edges <= 0.004 * count.rays
    assert count.largest_error_m <= 1e-7


@pytest.mark.parametrize("attack", ATTACKS)
def test_the_oracle_misses_no_ray_that_hits_in_exact_arithmetic(attack):
    rng = np.random.default_rng(2)
    every = list(itertools.islice(attacks(attack), 200))
    hits, hairs = 0, 0
    for number in rng.permutation(len(every))[:2]:
        one = every[number]
        rows = rng.permutation(len(one.directions))[: 6 if len(one.triangles) < 1000 else 2]
        origins = one.origins if one.origins.ndim == 1 else one.origins[rows]
        rays = one.directions[rows]
        gate = one.max_range_m * (1.0 + 1e-12)
        oracle = ExactCaster(one.triangles)
        found, met = oracle.cast(origins, rays, gate)
        true = first_distances(one.triangles, origins, rays, one.max_range_m)
        hits += np.isfinite(true).sum()
        assert (found <= true + TOLERANCE_M).all()
        for row in np.flatnonzero(found < true - TOLERANCE_M)[:1]:  # met in excess: by a hair's breadth
            hairs += 1
            start = np.broadcast_to(origins, rays.shape)[row]
            beside = unit(
                rays[row] + 1e-10 * unit(rng.normal(size=(1000, 3)))
            )  # of a sharp corner one in a hundred meets
            along_its_plane = abs(oracle.normals(met[row : row + 1])[0] @ rays[row]) < 1e-9
            assert along_its_plane or np.isfinite(first_distances(one.triangles[[met[row]]], start, beside)).any()
    assert hits + hairs > 0


def test_the_rational_oracle_agrees_with_numbers_that_need_no_rounding():
    """Halves and quarters alone: a ray into a floor, along it, past it, and through a corner and a side."""
    ground = floor(np.array([0.0, 4.0]), np.array([0.0, 4.0]))
    origins = np.array([[1.0, 2.0, 3.0], [1.0, 2.0, 0.0], [5.0, 1.0, 3.0], [0.0, 0.0, 2.0], [2.0, 2.0, 8.0]])
    rays = np.array([[0.0, 0, -1], [1, 0, 0], [0, 0, -1], [0, 0, -1], [0, 0, -1]])
    assert first_distances(ground, origins, rays).tolist() == [3.0, np.inf, np.inf, 2.0, 8.0]
    assert first_distances(ground, origins, rays, 2.5).tolist() == [np.inf, np.inf, np.inf, 2.0, np.inf]


@pytest.mark.parametrize("caster", FAST[1:])
def test_the_attacks_find_a_caster_that_leaks(caster, monkeypatch):
    monkeypatch.setattr("blender_lidar.casting.tree._MARGIN_OPEN", 0.0)
    monkeypatch.setattr("blender_lidar.casting.tree._MARGIN", 0.0)
    monkeypatch.setattr("blender_lidar.casting.tree.fences", lambda corners, normal, height: [])
    assert count_attack(caster, "grazing a box around another").failures >= 20


def test_a_wrong_distance_to_the_right_triangle_is_no_knife_edge():
    """It was taken for one, as a ray beside meets that triangle too."""
    attack = next(attacks("vertices"))
    oracle = ExactCaster(attack.triangles)
    truth = oracle.cast(attack.origins, attack.directions, attack.max_range_m)
    hits = int(np.isfinite(truth.distance).sum())
    counts, error = differences(attack, truth._replace(distance=truth.distance + 0.5), truth, oracle)
    assert counts.tolist()[2:] == [0, 0, hits, 0]
    assert hits > 0
    assert error == pytest.approx(0.5)


def test_attacks_are_the_same_for_the_same_seed_and_the_oracle_does_not_judge_itself():
    first, second = (list(attacks("needles", seed=seed)) for seed in (3, 3))
    other = next(attacks("needles", seed=4))
    for one, two in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.directions, two.directions)
    assert not np.array_equal(first[0].triangles, other.triangles)
    with pytest.raises(InputError, match=r"unknown caster .* 'exact'; .*allowed: raster, embree, bvh"):
        count_attack("exact", "needles")


@pytest.mark.parametrize(
    ("differing", "expected"),
    [
        ({"knife_edges": 3}, "stable"),
        ({"wrong_distances": 1}, "fragile"),
        ({"silent_misses": 1}, "fails"),
    ],
)
def test_a_silent_miss_of_any_caster_fails_and_a_knife_edge_does_not(differing, expected, capsys, monkeypatch):
    same = AttackCount("needles", "embree", 9, 8, 0, 0, 0, 0, 0.0)
    other = dataclasses.replace(same, caster="bvh", **differing)
    assert verdict([same, other]) == expected
    for name, value in {"ATTACKS": {"needles": None}, "JUDGED": ("embree", "bvh")}.items():
        monkeypatch.setitem(main.__globals__, name, value)
    monkeypatch.setitem(main.__globals__, "is_available", lambda caster: True)
    monkeypatch.setitem(main.__globals__, "count_attack", lambda name, *_, **__: {"embree": same, "bvh": other}[name])
    assert main(["--quick"]) == (expected == "fails")
    assert f"  {expected:<10}needles  9 rays, 8 hit; embree the same; bvh " in capsys.readouterr().out


# --- what was found, each by its name ---------------------------------------------------------------------------------


@pytest.mark.parametrize("caster", EVERY)
@pytest.mark.parametrize("gap", [0.0, 1e-9, 1e-7, 1e-5, 1e-3])
def test_a_ray_that_starts_at_a_surface_meets_it_however_near(caster, gap):
    """Trees in float32 lost such rays: they could not tell on which side they start."""
    lines = np.arange(-20.0, 21.0, 2.5)
    tree = caster_class(caster)(floor(lines, lines))
    rays = unit(np.random.default_rng(7).normal(size=(200, 3)) * [1.0, 1.0, 0.3])
    down = rays[:, 2] < 0.0
    for x, y in ((0.3, 0.7), (2.5, 5.0), (0.0, 1.1)):  # within a triangle, on a corner, on a line
        found = tree.cast(np.array([x, y, gap]), rays).distance
        assert (found[~down] == (0.0 if gap == 0.0 else np.inf)).all()
        np.testing.assert_allclose(found[down], gap / -rays[down, 2], atol=1e-12)


@pytest.mark.parametrize("caster", EVERY)
def test_a_triangle_a_thousandth_wide_is_met_in_a_scene_ten_thousand_kilometres_wide(caster):
    """How flat a triangle may be was measured by the largest coordinate of all, not by its own."""
    strip = np.array([[[-5.0, 10.0, 0.0], [5.0, 10.0, 0.0], [5.0, 10.0, 1e-5]]]) @ rotation_matrix(0.0, 0.0, 0.1)
    far = cuboid([1e7, 0.0, 0.0], [1e7 + 1.0, 1.0, 1.0])
    ray = unit(strip.mean(axis=1) - MAST)
    assert caster_class(caster)(np.concatenate([far, strip])).cast(MAST, ray).triangle.tolist() == [12]


@pytest.mark.parametrize("caster", EVERY)
@pytest.mark.parametrize(("worst", "says"), [(np.nan, "is not finite"), (-np.inf, "is not finite"), (1e200, "lies 1e")])
def test_what_is_not_finite_or_beyond_reason_is_named_by_its_row(caster, worst, says):
    triangles = street("box")
    broken = triangles.copy()
    broken[17, 1, 2] = worst
    with pytest.raises(InputError, match=rf"triangle 17 {says}"):
        caster_class(caster)(broken)
    tree = caster_class(caster)(triangles)
    origins, rays = np.tile(MAST, (9, 1)), np.tile([[0.0, 1.0, 0.0]], (9, 1))
    origins[5, 0] = worst
    with pytest.raises(InputError, match=rf"origin 5 {says}"):
        tree.cast(origins, rays)
    rays[3, 1] = worst
    with pytest.raises(InputError, match=r"direction 3 is \[0.0, .*, 0.0\]; allowed: finite and of unit length"):
        tree.cast(MAST, rays)
    for gate in (np.nan, -1.0):
        with pytest.raises(InputError, match="max_range is"):
            tree.cast(MAST, rays[:2], gate)


@pytest.mark.parametrize("tip_rad", [3e-3, 1e-5, 1e-9])
def test_what_a_needle_grows_to_holds_it_with_a_margin_on_all_sides(tip_rad):
    margin = 1e-3
    needle = lens(tip_rad)[:1] @ rotation_matrix(0.3, 0.2, 0.1)
    normal = np.array([[0.0, 0.0, 1.0]]) @ rotation_matrix(0.3, 0.2, 0.1)
    larger = grown(needle, normal, margin)
    side = np.roll(larger, -1, axis=1) - larger
    outward = np.cross(side / np.linalg.norm(side, axis=2, keepdims=True), normal[:, None])
    within = np.einsum("tki,tkci->tkc", outward, larger[:, :, None] - needle[:, None])
    assert within.min() >= 0.99 * margin
    np.testing.assert_allclose((larger - needle[:, :1]) @ normal[0], 0.0, atol=1e-9)


@pytest.mark.parametrize("caster", FAST)
def test_small_triangles_seen_edge_on_are_met_however_little_they_show(caster):
    """Two of 18,900 rays missed without a word: what float32 could not see, neither of two casts met."""
    rng = np.random.default_rng(12)
    away = unit(rng.normal(size=(600, 3)))
    across = unit(np.cross(away, rng.normal(size=(600, 3))))
    cosine = 10.0 ** rng.uniform(-4.0, -1.0, (600, 1))
    normal = unit(across + cosine * away)
    plane = np.stack([unit(np.cross(normal, away)), unit(np.cross(normal, across + 0.3))], axis=1)
    far, size = np.repeat([10.0, 100.0, 1000.0], 200)[:, None], 10.0 ** rng.uniform(-3.0, -1.0, (600, 1))
    middle = far * away
    weights = rng.dirichlet([2.0, 2.0, 2.0], 600)
    flat = rng.normal(size=(600, 3, 2)) @ plane
    triangles = middle[:, None] + size[:, None] * (flat - np.einsum("tc,tci->ti", weights, flat)[:, None])
    found = caster_class(caster)(triangles).cast(np.zeros(3), away)
    assert np.isfinite(first_distances(triangles, np.zeros((1, 3)), away)).sum() >= 500
    expected = ExactCaster(triangles).cast(np.zeros(3), away)
    np.testing.assert_allclose(found.distance, expected.distance, atol=1e-6)


def test_fences_hold_a_strip_along_each_side():
    rng = np.random.default_rng(13)
    corners, height = rng.normal(size=(200, 3, 3)), 10.0 ** rng.uniform(-6.0, 0.0, 200)
    normal = unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    for number, fence in enumerate(fences(corners, normal, height)):
        square = unit(np.cross(fence[:, 1] - fence[:, 0], fence[:, 2] - fence[:, 0]))
        np.testing.assert_allclose(np.einsum("ti,ti->t", square, normal), 0.0, atol=1e-6)
        ends = corners[:, number], corners[:, (number + 1) % 3]
        along = height[:, None] * unit(ends[1] - ends[0])
        for end, beyond in zip(ends, (-along, along), strict=True):
            for rise in (-1.0, 1.0):
                point = end + beyond + rise * height[:, None] * normal - fence[:, 0]
                assert np.abs(np.einsum("ti,ti->t", point, square)).max() < 1e-9
                first, second = fence[:, 1] - fence[:, 0], fence[:, 2] - fence[:, 0]
                double_area = np.einsum("ti,ti->t", np.cross(first, second), square)
                weights = [np.einsum("ti,ti->t", np.cross(point, second), square) / double_area]
                weights.append(np.einsum("ti,ti->t", np.cross(first, point), square) / double_area)
                assert min(weights[0].min(), weights[1].min()) >= -1e-9
                assert (weights[0] + weights[1]).max() <= 1.0 + 1e-9


# --- scans, scores and scenery ----------------------------------------------------------------------------------------

LATTICE = beam_lattice(load_model("RS-16"), stride=12)
TRAFFIC = dense_traffic(vehicles=25, length_m=60.0)
SCENERY = join([box("wall", (0.0, 1.0, 1.0), (60.0, 0.2, 2.0)), box("gantry", (4.0, 8.0, 5.0), (0.5, 16.0, 0.6), 0.3)])
EVERYONE = np.ones(len(TRAFFIC), dtype=bool)


def seen(caster, **changes):
    return Observation((Lidar(LATTICE, 60.0),), caster, "body", 0.05, **changes)


def moved(vehicles, away):
    return dataclasses.replace(vehicles, centre_m=vehicles.centre_m + away)


def awkward_mountings():
    """Within a vehicle, on its roof, above its corner, in the plane of its roof, on the road, and at the roadside."""
    x, y, z = TRAFFIC.centre_m[0].tolist()
    half = 0.5 * TRAFFIC.size_m[0]
    return [
        Pose(x, y, z),
        Pose(x, y, 2.0 * z, 0.2),
        Pose(x + half[0], y + half[1], 5.0, 0.3),
        Pose(x + 40.0, y - 12.0, 2.0 * z),
        Pose(0.0, 0.0, 0.0, -0.1),
        Pose(0.0, 0.0, 4.1, 0.3),
        Pose(-35.0, 0.0, 4.1, 0.0, 0.2),
    ]


@functools.cache
def seen_awkwardly(caster, behind_scenery):
    """What is seen from all awkward mountings together."""
    scenery = StandingScenery(SCENERY, caster) if behind_scenery else None
    return FrameScorer(TRAFFIC, seen(caster, scenery=scenery)).see(singles(awkward_mountings()))


@pytest.mark.parametrize("behind_scenery", [False, True])
@pytest.mark.parametrize("caster", FAST)
def test_awkward_mountings_seen_together_see_what_the_oracle_sees(caster, behind_scenery):
    found, expected = seen_awkwardly(caster, behind_scenery), seen_awkwardly("exact", behind_scenery)
    assert (expected.points.sum(axis=1) > 0).sum() >= 6  # the wall hides all from the road
    np.testing.assert_array_equal(found.points, expected.points)
    np.testing.assert_array_equal(found.occupancy, expected.occupancy)


@pytest.mark.parametrize("caster", EVERY)
def test_a_lidar_inside_a_vehicle_sees_that_vehicle_alone(caster):
    inside = awkward_mountings()[0]
    points = FrameScorer(TRAFFIC, seen(caster)).see(singles([inside])).points[0]
    assert points[0] == LATTICE.rings * LATTICE.columns
    assert points[1:].sum() == 0


@pytest.mark.parametrize("caster", FAST)
def test_scenery_hides_at_its_corners_and_edges_what_the_oracle_says_it_hides(caster):
    rng = np.random.default_rng(3)
    targets = np.concatenate([vertices_of(SCENERY.corners), *(points_on_edges(rng, SCENERY.corners) for _ in range(8))])
    for origin in ([0.0, 0.0, 4.1], [0.0, 0.0, 2.0], [30.0, 0.9, 1.0], [0.0, 1.0, 1.0]):  # the last one within the wall
        rays, distance = unit(targets - origin), np.linalg.norm(targets - origin, axis=1)
        for share in (0.5, 0.999, 1.001, 2.0):
            found, expected = (
                StandingScenery(SCENERY, name).hides(np.array(origin), rays, share * distance)
                for name in (caster, "exact")
            )
            np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("caster", EVERY)
@pytest.mark.parametrize("shift", [1e3, 1e5, 1e7])
def test_a_road_frame_far_from_its_origin_is_scanned_and_scored_as_one_at_it(caster, shift):
    away = np.array([shift, -0.7 * shift, 0.0])
    pose = Pose(0.3, -0.4, 4.1, 0.3)
    there = Pose(pose.x_m + away[0], pose.y_m + away[1], pose.height_m, pose.tilt_x)
    near, far = (
        scan(vehicles, LATTICE, mount, caster=caster, max_range_m=60.0)
        for vehicles, mount in ((TRAFFIC, pose), (moved(TRAFFIC, away), there))
    )
    assert (near.vehicle_id >= 0).sum() > 100
    np.testing.assert_array_equal(far.vehicle_id, near.vehicle_id)
    np.testing.assert_allclose(far.range_m, near.range_m, atol=1e-6)
    np.testing.assert_allclose(far.xyz - away, near.xyz, atol=1e-6)
    points = [
        FrameScorer(vehicles, seen(caster)).see(singles([mount])).points
        for vehicles, mount in ((TRAFFIC, pose), (moved(TRAFFIC, away), there))
    ]
    np.testing.assert_array_equal(*points)


@pytest.mark.parametrize("caster", EVERY)
@pytest.mark.parametrize("away", [1e6, 1e12])
def test_one_vehicle_whose_place_is_a_mistake_empties_no_scan(caster, away):
    """With x_m = 1e12 in one row of a table a scan lost two points of three on all other vehicles, without a word."""
    both = joined(TRAFFIC, one_vehicle("car", centre=(away, 8.0)))
    alone, found = (
        scan(vehicles, LATTICE, Pose(height_m=4.1, tilt_x=0.3), caster=caster, max_range_m=60.0)
        for vehicles in (TRAFFIC, both)
    )
    np.testing.assert_array_equal(found.vehicle_id, alone.vehicle_id)
    np.testing.assert_allclose(found.range_m, alone.range_m, atol=1e-9)


@pytest.mark.parametrize(("field", "value"), [("x_m", math.nan), ("height_m", math.inf), ("yaw", math.nan)])
def test_a_mounting_that_is_not_finite_is_refused_before_it_sees_nothing(field, value):
    with pytest.raises(InputError, match=rf"the mounting's {field} is {value}; allowed: a finite number"):
        Pose(**{field: value})


@pytest.mark.parametrize(
    ("column", "value", "says"),
    [
        ("centre_m", math.nan, r"vehicle 102 of frame 0: its centre is \[.*nan.*\] m.*; allowed: finite"),
        ("centre_m", 1e200, r"vehicle 102 of frame 0: its centre is .*less than 1e\+15 m"),
        ("heading_rad", math.inf, "vehicle 102 of frame 0: .*its heading inf rad"),
        ("size_m", 0.0, r"vehicle 102 of frame 0: its size is \[.*0.0.*\] m; allowed: lengths above 0 m"),
        ("size_m", math.nan, "vehicle 102 of frame 0: its size is"),
    ],
)
def test_a_vehicle_that_no_ray_could_meet_is_named(column, value, says):
    broken = dataclasses.replace(TRAFFIC, **{column: getattr(TRAFFIC, column).copy()})
    getattr(broken, column)[2] = value
    with pytest.raises(InputError, match=says):
        FrameScorer(broken, seen("exact"))
    with pytest.raises(InputError, match=says):
        scan(broken, LATTICE, Pose(height_m=3.0), caster="exact", max_range_m=50.0)
