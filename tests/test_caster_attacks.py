"""Casters under attack: what was tried, what broke once, and how the oracle that judges them is judged itself."""

from __future__ import annotations

import dataclasses
import itertools
import json

import numpy as np
import pytest

from blender_lidar.casting import CASTERS, caster_class, is_available
from blender_lidar.casting.exact import ExactCaster
from blender_lidar.casting.tree import grown
from blender_lidar.errors import InputError
from blender_lidar.sensors.pose import rotation_matrix
from blender_lidar.stability.attack_scenes import (
    cuboid,
    floor,
    lens,
    points_inside,
    points_on_edges,
    soup,
    street,
    unit,
    vehicle,
    vertices_of,
)
from blender_lidar.stability.attacks import ATTACKS, attacks
from blender_lidar.stability.caster_attacks import TOLERANCE_M, attack_counts, count_attack, differences
from tests.rational_oracle import first_distances

FAST = [
    pytest.param(
        name, marks=pytest.mark.skipif(not is_available(name), reason=f"the library of {name} is not installed")
    )
    for name in ("bvh", "embree")
]
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
    for number in rng.permutation(len(every))[:4]:
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
            beside = unit(rays[row] + 1e-10 * unit(rng.normal(size=(100, 3))))
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


@pytest.mark.parametrize("caster", FAST)
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


def test_counts_are_plain_data_and_the_same_for_the_same_seed():
    first, second = (list(attacks("triangle soup", seed=seed)) for seed in (3, 3))
    other = next(attacks("triangle soup", seed=4))
    for one, two in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.directions, two.directions)
    assert not np.array_equal(first[0].triangles, other.triangles)
    with pytest.raises(InputError, match=r"unknown caster .* 'exact'; .*allowed: bvh, embree"):
        attack_counts("exact")
    here = [name for name in ("embree", "bvh") if is_available(name)]
    for name in here[:1]:
        count = count_attack(name, "triangle soup")
        assert json.loads(json.dumps(dataclasses.asdict(count)))["attack"] == "triangle soup"


# --- what was found, each by its name ---------------------------------------------------------------------------------


@pytest.mark.parametrize("caster", EVERY)
@pytest.mark.parametrize("away", [1e9, 1e12, 1e14])
def test_a_triangle_at_a_place_that_is_a_mistake_takes_no_hit_from_the_others(caster, away):
    """Re-centred on the middle of the bounding box, all others became flat, were left out, and missed silently."""
    near = street("detailed", 0.13)
    rays = unit(points_inside(np.random.default_rng(5), near)[::17] - MAST)
    alone = caster_class(caster)(near, closed=True).cast(MAST, rays)
    both = caster_class(caster)(np.concatenate([near, vehicle("car", "body", (away, 6.0))]), closed=True).cast(
        MAST, rays
    )
    assert np.isfinite(alone.distance).all()
    np.testing.assert_allclose(both.distance, alone.distance, atol=1e-9)


def test_the_oracle_meets_small_and_distant_triangles_at_their_edges():
    """Its tolerance at edges was a share of the triangle, which rounding at a distance exceeds."""
    rng = np.random.default_rng(6)
    small = unit(rng.normal(size=(200, 3)))[:, None] * 1000.0 + soup(rng, 200, 1e-3, 0.0)
    targets = np.concatenate([vertices_of(small), points_on_edges(rng, small)])
    assert np.isfinite(ExactCaster(small).cast(np.zeros(3), unit(targets)).distance).all()


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
def test_starts_at_surfaces_and_elsewhere_in_one_cast_agree_with_one_by_one(caster):
    triangles = street("body", 0.13)
    rng = np.random.default_rng(8)
    starts = np.concatenate([points_on_edges(rng, triangles)[::40], rng.uniform([-20, -3, 1], [20, 0, 5], (30, 3))])
    origins, rays = np.repeat(starts, 5, axis=0), unit(rng.normal(size=(5 * len(starts), 3)))
    tree = caster_class(caster)(triangles, closed=True)
    together = tree.cast(origins, rays, 60.0).distance
    alone = np.concatenate([tree.cast(at, rays[5 * row : 5 * row + 5], 60.0).distance for row, at in enumerate(starts)])
    np.testing.assert_allclose(together, alone, atol=1e-9)
    assert (together < 1e-9).sum() >= 5


@pytest.mark.parametrize("caster", CASTERS)
def test_all_casters_find_the_same_hits_at_a_gate_that_equals_the_range(caster):
    """They measured by different formulas, and at the last digit of a range one met what another missed."""
    if not is_available(caster):
        pytest.skip(f"the library of {caster} is not installed")
    triangles = street("body", 0.13)
    rays = unit(points_inside(np.random.default_rng(9), triangles)[::4] - MAST)
    far = ExactCaster(triangles).cast(MAST, rays).distance
    tree = caster_class(caster)(triangles, closed=True)
    for ray, distance in zip(rays[np.isfinite(far)], far[np.isfinite(far)].tolist(), strict=True):
        assert tree.cast(MAST, ray[None], distance).distance[0] == distance


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


@pytest.mark.parametrize("caster", FAST)
@pytest.mark.parametrize("tip_rad", [1e-3, 1e-5, 1e-7])
def test_needles_too_sharp_to_grow_by_their_tips_do_not_leak_where_they_meet(caster, tip_rad):
    """A bound on how far tips move left their long side where it was: Embree lost rays along it."""
    needles = lens(tip_rad) @ rotation_matrix(0.4, -0.7, 0.9) + [0.0, 60.0, 0.0]
    along = np.linspace(0.0, 1.0, 500)[:, None]
    rays = unit(needles[0, 0] + along * (needles[0, 1] - needles[0, 0]))
    expected = ExactCaster(needles).cast(np.zeros(3), rays).distance
    assert np.isfinite(expected).all()
    np.testing.assert_allclose(caster_class(caster)(needles).cast(np.zeros(3), rays).distance, expected, atol=1e-6)


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
def test_an_open_mesh_seen_almost_edge_on_does_not_leak_at_its_inner_edges(caster):
    """Where margins do not show and no inside tells of a leak: what stood behind was met in place of it."""
    box_in_a_box = np.concatenate([cuboid([-7.7, 6.3, 0.3], [7.7, 8.7, 2.7]), cuboid([-8, 6, 0], [8, 9, 3])])
    across = np.linspace(0.02, 0.98, 300)[:, None]
    roof = box_in_a_box[12:][(box_in_a_box[12:, :, 2] == 3.0).all(axis=1)][0]
    tree, oracle = caster_class(caster)(box_in_a_box), ExactCaster(box_in_a_box)
    for height in (1e-1, 1e-2, 3e-3, 1e-3):
        origin = np.array([-60.0, 3.0, 3.0 + height])
        for corner in range(3):
            rays = unit(roof[corner] + across * (roof[(corner + 1) % 3] - roof[corner]) - origin)
            expected = oracle.cast(origin, rays).distance
            np.testing.assert_allclose(tree.cast(origin, rays).distance, expected, atol=1e-5)
