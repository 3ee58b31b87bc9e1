"""Installation errors: designs that stand for all, and scores under them beside a slow oracle."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.run.as_hung import HungObjective, hung_scores, searching
from blender_lidar.scene.deployment import COORDINATE_LIMITS, HANGS, Installer
from blender_lidar.scene.installation import (
    ERRORS,
    installed,
    installed_layout,
    latin_errors,
    limit_errors,
    orthogonal_errors,
    single_errors,
)
from blender_lidar.scene.mounting import Mast, Mounting
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Evaluator, Workplace, site_evaluator
from tests.small_scene import mounting, write_scene

WIDE = Installer(tilt_deg=4.0, height_m=0.3, yaw_deg=6.0)
PLAN = mounting({"height_m": 3.0, "tilt_x_deg": 12.0})
OTHER = mounting({"height_m": 4.0, "tilt_x_deg": 20.0, "tilt_y_deg": 3.0})


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    changes = {
        "deployment": {"installer": {"tilt_deg": 4.0, "height_m": 0.3, "yaw_deg": 6.0}},
        "traffic": {"frames": 4},
    }
    return prepare(load_scenario(write_scene(tmp_path_factory.mktemp("scene"), changes)))


# --- Designs of errors ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("base", [3, 5, 11])
@pytest.mark.parametrize("lidars", [1, 3])
def test_orthogonal_errors_are_evenly_spread_and_come_with_their_opposites(base, lidars):
    installers = [WIDE] * lidars
    errors = orthogonal_errors(installers, base) / np.array([one.half_widths for one in installers])
    assert errors.shape == (base**2, lidars, len(ERRORS))
    middles = (2.0 * np.arange(base**2) + 1.0) / base**2 - 1.0
    for lidar in np.moveaxis(errors, 1, 0):
        for column in lidar.T:
            np.testing.assert_allclose(np.sort(column), middles, atol=1e-12)
        np.testing.assert_allclose(np.corrcoef(lidar.T), np.eye(4), atol=1e-12)
        rows = {tuple(row) for row in lidar.round(9) + 0.0}
        assert all(tuple(-np.array(row) + 0.0) in rows for row in rows)


@pytest.mark.parametrize(("base", "lidars", "most"), [(3, 2, 0.7), (5, 2, 0.45), (5, 3, 0.45), (11, 3, 0.25)])
def test_errors_of_several_lidars_hardly_correlate_and_come_with_their_opposites(base, lidars, most):
    errors = orthogonal_errors([WIDE] * lidars, base).reshape(base**2, -1)
    assert np.abs(np.corrcoef(errors.T) - np.eye(4 * lidars)).max() <= most
    np.testing.assert_allclose(errors, -errors[::-1], atol=1e-12)


@pytest.mark.parametrize(("frames", "each"), [(30, 1), (6, 4), (7, 8), (1, 1), (2, 1)])
def test_latin_errors_have_one_value_in_each_slice_of_every_coordinate(frames, each):
    errors = latin_errors([WIDE, WIDE], frames, each, [1, 2])
    assert errors.shape == (frames, each, 2, len(ERRORS))
    shares = (errors / np.array(WIDE.half_widths) + 1.0).reshape(frames * each, -1) / 2.0
    slices = np.floor(shares * frames * each).astype(int)
    assert (np.sort(slices, axis=0) == np.arange(frames * each)[:, None]).all()


def test_latin_errors_hardly_correlate_and_do_not_go_with_time():
    errors = latin_errors([WIDE], 30, 1, [1, 1]).reshape(30, 4)
    with_time = np.column_stack([errors, np.arange(30)])
    off = np.abs(np.corrcoef(with_time.T) - np.eye(5))
    assert off[:4, :4].max() < 0.2
    assert off[4].max() < 0.5


def test_errors_are_the_same_for_a_seed_and_others_for_the_judge():
    np.testing.assert_array_equal(latin_errors([WIDE], 5, 2, [1, 1]), latin_errors([WIDE], 5, 2, [1, 1]))
    assert not np.allclose(latin_errors([WIDE], 5, 2, [1, 1]), latin_errors([WIDE], 5, 2, [1, 2]))


def test_what_hangs_already_has_no_errors():
    for errors in (orthogonal_errors([HANGS, WIDE], 3), latin_errors([HANGS, WIDE], 4, 2, [1, 1])):
        assert not errors[..., 0, :].any()
        assert errors[..., 1, :].any()
    degrees, heights = single_errors([HANGS, WIDE], 1.0, 0.1)
    assert (len(degrees), len(heights)) == (4, 2)
    assert single_errors([HANGS], 1.0, 0.1) == ([], [])


def test_single_errors_shake_one_coordinate_of_one_lidar():
    degrees, heights = single_errors([WIDE, WIDE], 1.0, 0.1)
    found = sorted(tuple(error.ravel().round(9)) for error in (*degrees, *heights))
    sizes = {1: math.radians(1.0), 2: math.radians(1.0), 0: 0.1}
    expected = [np.eye(8)[4 * lidar + key] * sign * sizes[key] for lidar in (0, 1) for key in sizes for sign in (-1, 1)]
    assert found == sorted(tuple(np.round(one, 9) + 0.0) for one in expected)


def test_limits_are_those_of_coordinates_that_have_errors():
    found = limit_errors([HANGS, Installer(tilt_deg=1.0, height_m=0.0, yaw_deg=2.0)])
    assert [(lidar, key) for lidar, key, _ in found] == [(1, "tilt_x_deg"), (1, "tilt_y_deg"), (1, "yaw_deg")]
    for _, key, (less, more) in found:
        np.testing.assert_array_equal(less, -more)
        assert np.degrees(more[1, ERRORS.index(key)]) == pytest.approx(2.0 if key == "yaw_deg" else 1.0)


# --- Where a LiDAR hangs ----------------------------------------------------------------------------------------------


def test_without_an_error_it_is_the_plan_to_the_last_bit():
    assert installed(PLAN, np.zeros(4)) is PLAN
    assert installed_layout((PLAN, None), np.zeros((2, 4))) == (PLAN, None)


def test_errors_add_to_height_tilts_and_yaw_and_stay_within_what_a_coordinate_can_be():
    hung = installed(PLAN, np.array([0.2, 0.1, -0.2, 0.3]))
    assert (hung.height_m, hung.tilt_y, hung.yaw) == (3.2, -0.2, 0.3)
    assert hung.tilt_x == PLAN.tilt_x + 0.1
    on_slope = replace(PLAN, mast=Mast((1.0, 2.0, 0.0), 0.3, (0.03, 0.0, math.sqrt(1.0 - 0.03**2))))
    assert installed(on_slope, np.full(4, 0.01)).mast == on_slope.mast
    low = COORDINATE_LIMITS["height_m"][0]
    assert installed(Mounting(height_m=low), np.array([-0.05, 0.0, 0.0, 0.0])).height_m == low


# --- Scores under errors, beside one frame, one error and one mounting at a time --------------------------------------


def slow(site, frame, layouts, errors):
    """The mean objective and number of detectable vehicles of a frame over errors, each mounting alone."""
    found = []
    for layout in layouts:
        values = []
        for error in errors:
            totals = Evaluator([frame], site.observation, site.scoring).totals([installed_layout(layout, error)])
            values.append((totals.objective[0, 0], totals.detectable[0, 0]))
        found.append(np.mean(values, axis=0))
    return np.array(found)


@pytest.mark.parametrize("workers", [1, 2])
def test_each_frame_is_scored_under_its_own_errors(site, workers):
    errors = latin_errors([WIDE], len(site.search), 3, [1, 1])
    layouts = [(PLAN,), (OTHER,)]
    with Evaluator(site.search, site.observation, site.scoring, Workplace(workers)) as evaluator:
        totals = evaluator.under(errors).totals(layouts)
        some = evaluator.under(errors).totals(layouts, frames=[3, 1])
        planned = evaluator.totals(layouts)
    expected = np.array(
        [slow(site, *one, errors=own) for *one, own in zip(site.search, [layouts] * 4, errors, strict=True)]
    )
    np.testing.assert_allclose(totals.objective, expected[..., 0].T, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(totals.detectable, expected[..., 1].T, rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(some.objective, totals.objective[:, [3, 1]])
    assert planned.detectable.dtype == np.int64
    assert not np.allclose(planned.objective, totals.objective)


def test_no_errors_are_the_scores_as_planned_to_the_last_bit(site):
    evaluator = site_evaluator(site, site.search)
    layouts, none = [(PLAN,), (OTHER,)], np.zeros((len(site.search), 1, 1, 4))
    planned, under = evaluator.totals(layouts), evaluator.under(none).totals(layouts)
    np.testing.assert_array_equal(planned.objective, under.objective)
    np.testing.assert_array_equal(planned.detectable, under.detectable)


def test_a_search_has_two_dozen_errors_however_few_frames_and_none_where_all_hangs(site, tmp_path):
    evaluator = site_evaluator(site, site.search)
    assert searching(site, evaluator)._errors.shape == (4, 6, 1, 4)
    exact = prepare(load_scenario(write_scene(tmp_path)))
    evaluator = site_evaluator(exact, exact.search)
    assert searching(exact, evaluator)._errors is None


def test_the_objective_as_hung_is_near_the_mean_over_many_errors(site):
    evaluator = site_evaluator(site, site.search)
    many = np.random.default_rng(0).uniform(-1.0, 1.0, (400, 1, 4)) * np.array(WIDE.half_widths)
    layouts = [(PLAN,), (OTHER,)]
    drawn = np.array(
        [evaluator.totals([installed_layout(plan, one) for one in many]).objective.sum(axis=1) for plan in layouts]
    )
    error = drawn.std(axis=1) / math.sqrt(len(many))
    found = HungObjective(site, evaluator)(layouts)
    spread = drawn.std(axis=1) / math.sqrt(32)  # of a plain draw of as many; a Latin hypercube is nearer
    assert (np.abs(found - drawn.mean(axis=1)) < 3.0 * np.hypot(error, spread)).all()
    assert (np.abs(found - evaluator.totals(layouts).objective.sum(axis=1)) > 1e-6).all()


def test_what_nine_of_ten_reach_is_below_the_mean(tmp_path):
    installer = {"tilt_deg": 4.0, "height_m": 0.3, "yaw_deg": 6.0, "aim": "low"}
    changes = {"deployment": {"installer": installer}, "traffic": {"frames": 4}}
    low = prepare(load_scenario(write_scene(tmp_path, changes)))
    evaluator = site_evaluator(low, low.search)
    (found,) = HungObjective(low, evaluator)([(PLAN,)])
    values = [
        evaluator.totals([installed_layout((PLAN,), error)]).objective.sum() for error in orthogonal_errors([WIDE], 7)
    ]
    assert found == pytest.approx(np.quantile(values, 0.1, method="hazen"))
    assert found < np.mean(values)


def test_scores_of_boxes_are_those_of_each_installation(site):
    evaluator = site_evaluator(site, site.search)
    first, second = hung_scores(site.scenario, evaluator, [(PLAN,), (OTHER,)])
    errors = orthogonal_errors([WIDE], 5)
    for plan, hung in (((PLAN,), first), ((OTHER,), second)):
        totals = evaluator.totals([installed_layout(plan, error) for error in errors])
        np.testing.assert_allclose(hung.objective.sum(axis=1), totals.objective.sum(axis=1))
        np.testing.assert_array_equal(hung.detectable.sum(axis=1), totals.detectable.sum(axis=1))
        degrees, heights = single_errors([WIDE], 1.0, 0.1)
        for rows, off in ((hung.degree_off, degrees), (hung.height_off, heights)):
            totals = evaluator.totals([installed_layout(plan, error) for error in off])
            np.testing.assert_array_equal(rows.sum(axis=1), totals.detectable.sum(axis=1))
    (alone,) = hung_scores(site.scenario, evaluator, [(PLAN,)], shaken=False)
    np.testing.assert_allclose(alone.objective.sum(axis=1), evaluator.totals([(PLAN,)]).objective.sum(axis=1))
