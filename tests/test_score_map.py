"""The objective over height and tilt, on landscapes whose top is known."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.run.verdict import POINTS, ScoreMap, map_scores, near_best_threshold
from blender_lidar.scene.deployment import SearchSpace
from blender_lidar.scoring.evaluation import Totals
from blender_lidar.statistics import FEWEST_BLOCKS, interval_90, resampled_weights
from tests.small_scene import place_of

HEIGHT, TILT = (2.0, 4.5), (0.0, 25.0)
FIXED = {"x_m": 1.0, "y_m": -0.5, "tilt_y_deg": 3.0, "yaw_deg": -7.0}
SPACE = SearchSpace((place_of(FIXED, {"height_m": HEIGHT, "tilt_x_deg": TILT}),))
OPTIMUM = (4.0, 19.0)


class Hill:
    """In place of an evaluator: each frame has a parabolic hill with its own top."""

    def __init__(self, tops, vehicles=None):
        self.tops = np.asarray(tops, dtype=float)  # (f, 2): height [m], tilt [deg]
        self.vehicles = np.full(len(tops), 100) if vehicles is None else np.asarray(vehicles)
        self.asked = []

    def value(self, height, tilt):
        """Objective per vehicle of each frame, (f,)."""
        return 1.0 - (height - self.tops[:, 0]) ** 2 - ((tilt - self.tops[:, 1]) / 10.0) ** 2

    def totals(self, layouts):
        self.asked += layouts
        poses = [one.pose for (one,) in layouts]
        values = np.array([self.value(pose.height_m, np.degrees(pose.tilt_x)) for pose in poses])
        found = np.round(self.vehicles * np.clip(values, 0.0, 1.0)).astype(int)
        return Totals(values * self.vehicles, found, self.vehicles, self.vehicles)


def tops_about(height, tilt, spread, frames, seed=0):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.normal(height, spread, frames), rng.normal(tilt, 10.0 * spread, frames)])


def mapped(hill, block=None, grid=POINTS) -> ScoreMap:
    block = np.arange(len(hill.vehicles)) if block is None else np.asarray(block)
    return map_scores(hill, SPACE, OPTIMUM, block, grid=grid)


def test_the_grid_reaches_from_bound_to_bound_through_the_optimums_other_coordinates():
    hill = Hill([(3.0, 10.0)])
    score_map = mapped(hill)
    for axis, bounds, points in zip((score_map.height_m, score_map.tilt_deg), (HEIGHT, TILT), POINTS, strict=True):
        assert len(axis) == points
        assert (axis[0], axis[-1]) == bounds
        np.testing.assert_allclose(np.diff(axis), (bounds[1] - bounds[0]) / (points - 1))
    expected = [SPACE.layout((h, t)) for h in score_map.height_m for t in score_map.tilt_deg]
    assert hill.asked == expected


def test_every_point_of_the_grid_has_its_own_value():
    tops, vehicles = tops_about(3.4, 12.0, 0.3, 5), [10, 30, 20, 5, 7]
    hill = Hill(tops, vehicles)
    score_map = mapped(hill, [4, 4, 1, 1, 0])
    assert score_map.block_objective.shape == (*POINTS, 3)
    for row, height in enumerate(score_map.height_m):
        for column, tilt in enumerate(score_map.tilt_deg):
            objective = hill.value(height, tilt) * hill.vehicles
            assert score_map.per_vehicle[row, column] == pytest.approx(objective.sum() / 72)
            found = hill.totals([SPACE.layout((height, tilt))]).detectable.sum()
            assert score_map.detectable_share[row, column] == pytest.approx(found / 72)
            blocks = [objective[4], objective[2] + objective[3], objective[0] + objective[1]]
            np.testing.assert_allclose(score_map.block_objective[row, column], blocks)
    assert score_map.block_vehicles.tolist() == [7, 25, 40]


def test_progress_counts_every_point_once():
    message = []
    map_scores(Hill([(3.0, 10.0)]), SPACE, OPTIMUM, np.zeros(1, dtype=int), message.append)
    assert sum(message) == POINTS[0] * POINTS[1]
    assert len(message) > 5


@pytest.mark.parametrize("searched", [{}, {"height_m": HEIGHT}, {"tilt_x_deg": TILT}, {"x_m": (-1.0, 1.0)}])
def test_there_is_no_map_unless_height_and_tilt_are_both_searched(searched):
    every = {**FIXED, "height_m": 4.0, "tilt_x_deg": 19.0}
    fixed = {key: value for key, value in every.items() if key not in searched}
    hill, space = Hill([(3.0, 10.0)]), SearchSpace((place_of(fixed, searched),))
    assert map_scores(hill, space, space.lower, np.zeros(1, dtype=int)) is None
    assert hill.asked == []


def test_a_third_searched_coordinate_stays_at_its_optimum():
    fixed = {key: value for key, value in FIXED.items() if key != "x_m"}
    hill = Hill([(3.0, 10.0)])
    space = SearchSpace((place_of(fixed, {"x_m": (-9.0, 9.0), "height_m": HEIGHT, "tilt_x_deg": TILT}),))
    map_scores(hill, space, (4.5, *OPTIMUM), np.zeros(1, dtype=int))
    assert {mounting.xy[0] for (mounting,) in hill.asked} == {4.5}


def test_a_landscape_that_is_certain_has_an_interval_without_width():
    intervals = mapped(Hill([(3.5, 15.0)] * 6)).optimum_intervals_90(1)
    np.testing.assert_allclose(intervals["height_m"], (3.5, 3.5))
    np.testing.assert_allclose(intervals["tilt_x_deg"], (15.0, 15.0))


def test_the_interval_holds_the_optimum_and_widens_with_the_spread_of_the_blocks():
    widths = []
    for spread in (0.2, 0.5):
        score_map = mapped(Hill(tops_about(3.2, 12.0, spread, 12)), grid=(26, 26))
        height, tilt, _ = score_map.best
        intervals = score_map.optimum_intervals_90(1)
        for axis, best in (("height_m", height), ("tilt_x_deg", tilt)):
            assert intervals[axis][0] <= best <= intervals[axis][1]
        widths.append(intervals["height_m"][1] - intervals["height_m"][0])
    assert 0.05 < widths[0] < widths[1] < 1.5


def test_resampled_optima_are_grid_points_that_brute_force_finds_too():
    score_map = mapped(Hill(tops_about(3.2, 12.0, 0.4, 5), [10, 30, 20, 5, 7]))
    height, tilt = score_map.best_under(resampled_weights(5, np.random.default_rng(3)))
    assert set(height) <= set(score_map.height_m)
    assert set(tilt) <= set(score_map.tilt_deg)
    intervals = score_map.optimum_intervals_90(3)
    assert intervals == {"height_m": interval_90(height), "tilt_x_deg": interval_90(tilt)}
    other, _ = score_map.best_under(resampled_weights(5, np.random.default_rng(4)))
    assert (other != height).any()
    rng = np.random.default_rng(3)
    for number, drawn in enumerate(rng.integers(5, size=(2000, 4))[:50]):
        objective = score_map.block_objective[..., drawn].sum(axis=-1) / score_map.block_vehicles[drawn].sum()
        row, column = np.unravel_index(np.argmax(objective), objective.shape)
        assert (height[number], tilt[number]) == (score_map.height_m[row], score_map.tilt_deg[column])


@pytest.mark.parametrize("blocks", range(1, FEWEST_BLOCKS))
def test_too_few_blocks_give_no_interval(blocks):
    score_map = mapped(Hill(tops_about(3.2, 12.0, 0.4, 6)), np.arange(6) % blocks)
    assert score_map.optimum_intervals_90(1) is None


def test_a_block_without_vehicles_does_not_move_the_optimum():
    score_map = mapped(Hill([(3.5, 15.0)] * 5, [100, 100, 100, 0, 0]), grid=(26, 26))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        intervals = score_map.optimum_intervals_90(1)
    np.testing.assert_allclose(intervals["height_m"], 3.5)
    np.testing.assert_allclose(intervals["tilt_x_deg"], 15.0)


@given(best=st.floats(-1, 2), baseline=st.floats(-1, 2), share=st.floats(0, 1))
def test_the_near_best_threshold_gives_up_that_share_of_the_gain_and_never_more(best, baseline, share):
    threshold = near_best_threshold(best, baseline, share)
    assert threshold <= best
    if baseline >= best:
        assert threshold == best
    else:
        assert best - threshold == pytest.approx(share * (best - baseline), abs=1e-12)
