"""Cells counted by words, and returns scored straight from directions and distances, against the plain way."""

from __future__ import annotations

import numpy as np
import pytest

from blender_lidar.errors import InputError
from blender_lidar.metrics import cell_marks, view_grids
from blender_lidar.metrics.cell_marks import CellMarks, fastest_marks
from blender_lidar.metrics.vgop import occupancy, to_vehicle_frame
from blender_lidar.metrics.view_grids import PlacedGrids, ViewGrids


def scene(rng, vehicles=9, points=6000):
    """Boxes that stand somewhere, and two clouds of points on and about them, from two origins."""
    size = rng.uniform([3.5, 1.6, 1.3], [14.0, 2.6, 3.9], (vehicles, 3))
    centre = np.column_stack([rng.uniform(-40, 40, vehicles), rng.uniform(4, 25, vehicles), 0.5 * size[:, 2]])
    heading = rng.uniform(-np.pi, np.pi, vehicles)
    vehicle = rng.integers(0, vehicles, points)
    local = rng.uniform(-0.5, 0.5, (points, 3)) * size[vehicle]
    cos, sin = np.cos(heading[vehicle]), np.sin(heading[vehicle])
    world = centre[vehicle] + np.column_stack(
        [cos * local[:, 0] - sin * local[:, 1], sin * local[:, 0] + cos * local[:, 1], local[:, 2]]
    )
    return size, centre, heading, vehicle, world


@pytest.mark.parametrize("reading", ["corrected", "paper"])
def test_returns_score_as_their_points_do_in_their_vehicles_frames(reading):
    rng = np.random.default_rng(1)
    size, centre, heading, vehicle, world = scene(rng)
    origins, cloud = np.array([[0.0, 0.0, 4.1], [5.0, -1.0, 2.5]]), np.sort(rng.integers(0, 2, len(vehicle)))
    away = world - origins[cloud]
    distance = np.linalg.norm(away, axis=1)
    grids = PlacedGrids(centre, size, heading, 0.05, reading)
    found = grids.returns_occupancy(origins, cloud, (away / distance[:, None]).T, distance, vehicle)
    assert found.shape == (2, 9, 3)
    for number in (0, 1):
        mine = cloud == number
        local = to_vehicle_frame(world[mine], centre, heading, vehicle[mine])
        expected = occupancy(local, vehicle[mine], size, 0.05, reading)
        assert expected.min() > 0.005
        np.testing.assert_allclose(found[number], expected, rtol=1e-12)
        alone = grids.returns_occupancy(
            origins[[number]], None, (away[mine] / distance[mine, None]).T, distance[mine], vehicle[mine]
        )
        np.testing.assert_array_equal(alone[0], found[number])


@pytest.mark.parametrize("clouds", [1, 2])
def test_noisy_returns_score_as_their_points_do_wherever_they_lie(clouds):
    """Points inside, on and up to two metres beside their boxes; of the last most are dropped."""
    rng = np.random.default_rng(5)
    size, centre, heading, vehicle, world = scene(rng)
    world += rng.normal(0.0, rng.choice([0.0, 0.02, 0.1, 1.0], (len(world), 1)), world.shape)
    origins = np.array([[0.0, 0.0, 4.1], [5.0, -1.0, 2.5]])[:clouds]
    cloud = np.sort(rng.integers(0, clouds, len(vehicle)))
    away = world - origins[cloud]
    distance = np.linalg.norm(away, axis=1)
    returns = (origins, cloud if clouds > 1 else None, (away / distance[:, None]).T, distance, vehicle)
    grids = PlacedGrids(centre, size, heading)
    found = grids.returns_occupancy(*returns, noisy=True)
    for number in range(clouds):
        mine = cloud == number
        local = to_vehicle_frame(world[mine], centre, heading, vehicle[mine])
        beside = (abs(local) > 0.5 * size[vehicle[mine]] + 0.05).any(axis=1)
        assert 0.1 < beside.mean() < 0.5
        np.testing.assert_allclose(found[number], occupancy(local, vehicle[mine], size), rtol=1e-12)
    assert (grids.returns_occupancy(*returns) > found).any()  # unless dropped they fall into the rim's cells


def test_grids_forget_one_cloud_before_the_next():
    rng = np.random.default_rng(2)
    size, _, _, vehicle, _ = scene(rng)
    local = rng.uniform(-0.5, 0.5, (len(vehicle), 3)) * size[vehicle]
    grids = ViewGrids(size)
    first = grids.occupancy(local, vehicle)
    grids.occupancy(local[:10], vehicle[:10])
    np.testing.assert_array_equal(grids.occupancy(local, vehicle), first)
    assert (grids.occupancy(local[:0], vehicle[:0]) == 0.0).all()


@pytest.mark.parametrize("cells", [(1, 1, 1), (7, 1, 1), (8, 1, 1), (9, 8, 1), (255, 8, 8), (256, 8, 8), (400, 60, 80)])
def test_every_cell_is_counted_once_however_many_words_a_grid_takes(cells):
    """A byte that overflowed, or a word that belonged to two grids, would show as a share other than 1."""
    size = np.array([cells, (90, 36, 30), cells]) * 0.05
    grid = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in cells), indexing="ij"), axis=-1).reshape(-1, 3)
    shell = grid[((grid < 1) | (grid > np.array(cells) - 1)).any(axis=1)] * 0.05 - 0.5 * size[0]
    rows = np.concatenate([np.zeros(len(shell), dtype=np.int64), np.full(len(shell), 2)])
    p = ViewGrids(size).occupancy(np.tile(shell, (2, 1)), rows)
    assert p.tolist() == [[1.0] * 3, [0.0] * 3, [1.0] * 3]


def test_a_return_beside_its_vehicle_marks_no_other_vehicles_grids():
    size, centre = (
        np.array([[4.5, 1.8, 1.5]] * 3),
        np.array([[0.0, 10.0, 0.75], [20.0, 10.0, 0.75], [40.0, 10.0, 0.75]]),
    )
    grids = PlacedGrids(centre, size, np.zeros(3))
    for off in ([-0.3, 0, -0.3], [0.3, 0.3, 0.3], [-9.0, -9.0, -9.0], [9.0, 9.0, 9.0]):
        point = centre[1] + np.sign(off) * 0.5 * size[1] + off
        distance = np.linalg.norm(point)
        p = grids.returns_occupancy(
            np.zeros((1, 3)), None, point[:, None] / distance, np.array([distance]), np.array([1])
        )
        assert (p[0, [0, 2]] == 0.0).all()
        assert (p[0, 1] > 0.0).all()


def test_large_grids_are_not_kept_and_score_one_cloud_at_a_time(monkeypatch):
    rng = np.random.default_rng(3)
    size, _, _, vehicle, _ = scene(rng)
    local = rng.uniform(-0.5, 0.5, (len(vehicle), 3)) * size[vehicle]
    monkeypatch.setattr(view_grids, "fastest_marks", lambda: CellMarks)
    kept = ViewGrids(size)
    expected = kept.occupancy(local, vehicle)
    assert kept.clouds_at_a_time > 10
    monkeypatch.setattr(cell_marks, "KEPT_WORDS", 100)
    assert kept.clouds_at_a_time == 1
    for _ in range(2):
        np.testing.assert_array_equal(kept.occupancy(local, vehicle), expected)
        assert kept.marks._words.nbytes == 0


def test_a_box_without_extent_and_an_unknown_reading_are_refused():
    with pytest.raises(InputError, match="positive"):
        ViewGrids(np.array([[4.5, 0.0, 1.5]]))
    with pytest.raises(InputError, match=r"shapes \(3, 3\) and \(2,\)"):
        PlacedGrids(np.zeros((3, 3)), np.ones((2, 3)), np.zeros(2))
    with pytest.raises(InputError, match="corrected, paper"):
        PlacedGrids(np.zeros((1, 3)), np.ones((1, 3)), np.zeros(1), 0.05, "literal")


@pytest.mark.skipif(fastest_marks() is CellMarks, reason="Numba is not installed")
@pytest.mark.parametrize("drops", [False, True])
@pytest.mark.parametrize("clouds", [1, 3, 300])
def test_compiled_marks_count_what_numpys_count(clouds, drops, monkeypatch):
    """Many calls in a row: marks of one call must not be taken for those of the next."""
    rng = np.random.default_rng(4)
    n, k = 6, 400
    size, heading = rng.uniform(0.4, 5.0, (n, 3)), rng.uniform(-4.0, 4.0, n)
    centre, origins = rng.uniform(-9.0, 9.0, (n, 3)), rng.uniform(-1.0, 1.0, (clouds, 3))
    fast = PlacedGrids(centre, size, heading)
    monkeypatch.setattr(view_grids, "fastest_marks", lambda: CellMarks)
    slow = PlacedGrids(centre, size, heading)
    assert type(fast.marks) is not type(slow.marks)
    for _ in range(4):
        vehicle, cloud = rng.integers(0, n, k), np.sort(rng.integers(0, clouds, k))
        away = centre[vehicle] + rng.uniform(-0.6, 0.6, (k, 3)) * size[vehicle] - origins[cloud]
        distance = np.linalg.norm(away, axis=1)
        found = [
            grids.returns_occupancy(origins, cloud, away.T / distance, distance, vehicle, drops)
            for grids in (fast, slow)
        ]
        np.testing.assert_array_equal(*found)
        points = rng.uniform(-0.6, 0.6, (k, 3)) * size[vehicle]
        np.testing.assert_array_equal(fast.occupancy(points, vehicle), slow.occupancy(points, vehicle))
