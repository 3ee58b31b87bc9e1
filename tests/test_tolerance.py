"""The objective over an installer's errors, on landscapes whose mean is known and on a real scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.optimise import make_search, run
from blender_lidar.run.tolerance import (
    JUDGED_BASE,
    SEARCHED_BASE,
    best_over_tolerance,
    installation_errors,
    installed,
    losses_over_tolerance,
    objective_over,
    orthogonal_array,
)
from blender_lidar.scene.deployment import COORDINATE_LIMITS
from blender_lidar.scene.mounting import COORDINATES, Mast, Mounting
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.settings import Tolerance
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Totals, site_evaluator
from blender_lidar.statistics import block_sums, ratio_interval_90, statistic_interval_90
from tests.small_scene import mounting, write_scene

PLAN = {"x_m": 1.0, "y_m": -0.5, "height_m": 3.0, "tilt_x_deg": 12.0, "tilt_y_deg": 0.0, "yaw_deg": 0.0}
TOLERANCE = Tolerance(height_m=0.05, tilt_deg=1.0, yaw_deg=0.0, aim="mean")
EVERY = Tolerance(height_m=0.1, tilt_deg=2.0, yaw_deg=3.0, aim="mean")
EXACT = Tolerance(height_m=0.0, tilt_deg=0.0, yaw_deg=0.0, aim="mean")


class Landscape:
    """In place of an evaluator: one frame of one vehicle, whose score is a function of the six coordinates."""

    def __init__(self, function):
        self.function = function
        self.vehicles = self.weight = np.array([1])
        self.lidars = ("",)

    def totals(self, layouts):
        poses = [one.pose for (one,) in layouts]
        table = np.array([[p.x_m, p.y_m, p.height_m, *np.degrees([p.tilt_x, p.tilt_y, p.yaw])] for p in poses])
        values = self.function(dict(zip(COORDINATES, table.T, strict=True)))
        return Totals(values[:, None], (values > 0)[:, None].astype(int), self.vehicles, self.vehicles)


def dense(function, plan, tolerance, points=31):
    """Values on a fine grid of errors, each cell's in its middle: an oracle by brute force."""
    widths = tolerance.half_widths
    axis = (np.arange(points) + 0.5) / points * 2.0 - 1.0
    grids = np.meshgrid(*[plan[key] + width * axis for key, width in widths.items()], indexing="ij")
    size = grids[0].size
    hung = {key: np.full(size, value) for key, value in plan.items()}
    return function(hung | {key: grid.ravel() for key, grid in zip(widths, grids, strict=True)})


def bumpy(at):
    """Smooth, with slopes, curvature and a product of errors in different coordinates."""
    height, tilt, along = at["height_m"] - 3.3, at["tilt_x_deg"] - 14.0, at["tilt_y_deg"]
    return 1.0 - height**2 - 0.02 * tilt**2 - 0.05 * along**2 + 0.3 * height * tilt + 0.2 * np.sin((tilt + along) / 3.0)


# --- the errors -------------------------------------------------------------------------------------------------------


BASES = [*SEARCHED_BASE.values(), JUDGED_BASE]


@pytest.mark.parametrize("base", BASES)
@pytest.mark.parametrize("dimensions", [1, 2, 3, 4])
def test_errors_are_spread_evenly_and_come_with_their_mirror_images(base, dimensions):
    errors = orthogonal_array(dimensions, base)
    middles = (2.0 * np.arange(base**2) + 1.0) / base**2 - 1.0
    for column in errors.T:
        np.testing.assert_allclose(np.sort(column), middles, atol=1e-12)
    assert {tuple(row) for row in np.round(errors, 9) + 0.0} == {tuple(row) for row in np.round(-errors, 9) + 0.0}


@pytest.mark.parametrize("base", BASES)
def test_each_pair_of_coordinates_falls_once_into_each_square_and_none_correlate(base):
    errors = orthogonal_array(4, base)
    square = np.floor((errors + 1.0) / 2.0 * base).astype(int)
    for one in range(4):
        for other in range(one):
            assert len({*zip(square[:, one].tolist(), square[:, other].tolist(), strict=True)}) == base**2
    np.testing.assert_allclose(np.cov(errors.T), np.diag(np.var(errors, axis=0, ddof=1)), atol=1e-12)


def test_the_verdict_meets_no_error_that_the_search_met_but_none_at_all():
    for base in SEARCHED_BASE.values():
        searched, judged = orthogonal_array(3, base), orthogonal_array(3, JUDGED_BASE)
        apart = np.abs(searched[:, None] - judged[None]).max(axis=2).min(axis=1)
        assert np.count_nonzero(apart < 1e-3) == 1
        assert not searched[np.argmin(apart)].any()


def test_an_error_stays_within_its_half_width_and_exact_coordinates_have_none():
    errors = dict(zip(COORDINATES[2:], installation_errors(TOLERANCE, SEARCHED_BASE[TOLERANCE.aim]).T, strict=True))
    for key, width in {"height_m": 0.05, "tilt_x_deg": 1.0, "tilt_y_deg": 1.0}.items():
        assert 0.8 * width < np.abs(errors[key]).max() < width
    assert not errors["yaw_deg"].any()


def test_a_mounting_hangs_where_the_error_puts_it_even_beyond_what_was_searched():
    low, high = installed(mounting(PLAN, height_m=4.5), np.array([[-0.05, 0, 0, 0], [0.05, 1, -1, 2]]))
    for hung, off in ((low, {"height_m": 4.45}), (high, {"height_m": 4.55, "tilt_x_deg": 13.0, "tilt_y_deg": -1.0})):
        assert hung.as_table() == pytest.approx(mounting(PLAN, **off, yaw_deg=2.0 * (hung is high)).as_table())


def test_only_what_a_coordinate_can_be_at_all_stops_an_error():
    (hung,) = installed(mounting(PLAN, height_m=0.12, tilt_x_deg=89.5), np.array([[-0.05, 1.0, 0, 0]]))
    assert hung == mounting(PLAN, height_m=COORDINATE_LIMITS["height_m"][0], tilt_x_deg=90.0)


# --- the objective over them ------------------------------------------------------------------------------------------


def test_without_errors_it_is_the_sharp_objective():
    landscape = Landscape(bumpy)
    plans = [(mounting(PLAN),), (mounting(PLAN, tilt_x_deg=3.0),)]
    sharp = landscape.totals(plans).objective.sum(axis=1)
    for aim in ("mean", "low"):
        exact = replace(EXACT, aim=aim)
        np.testing.assert_allclose(objective_over(landscape, plans, exact), sharp, rtol=1e-12)


@pytest.mark.parametrize(("base", "most"), [(3, 2e-3), (5, 3e-4), (11, 2e-4)])
@pytest.mark.parametrize("tolerance", [TOLERANCE, EVERY], ids=["tilts and height", "yaw too"])
def test_the_mean_is_that_of_a_dense_grid_of_errors(base, most, tolerance):
    reference = dense(bumpy, PLAN, tolerance, 31 if tolerance is TOLERANCE else 21)
    found = objective_over(Landscape(bumpy), [(mounting(PLAN),)], tolerance, base)[0]
    assert found == pytest.approx(reference.mean(), abs=most)
    assert abs(bumpy({key: np.array(value) for key, value in PLAN.items()}) - reference.mean()) > 2 * most


@pytest.mark.parametrize(("base", "most"), [(5, 0.05), (11, 0.03)])
def test_the_low_aim_is_what_nine_of_ten_errors_reach(base, most):
    low = replace(TOLERANCE, aim="low")
    values = dense(bumpy, PLAN, low)
    found = objective_over(Landscape(bumpy), [(mounting(PLAN),)], low, base)[0]
    assert (values < found).mean() == pytest.approx(0.1, abs=most)


@given(st.floats(0.0, 3.0), st.floats(0.0, 0.4))
def test_a_symmetric_landscape_keeps_its_optimum(tilt, height):
    def cone(at):
        return -np.abs(at["tilt_x_deg"] - 12.0) - np.abs(at["height_m"] - 3.0) - 0.1 * np.abs(at["tilt_y_deg"])

    off = [(mounting(PLAN, tilt_x_deg=12.0 + s * tilt, height_m=3.0 + s * height),) for s in (-1.0, 0.0, 1.0)]
    left, middle, right = objective_over(Landscape(cone), off, TOLERANCE)
    assert left == pytest.approx(right, abs=1e-9)
    assert middle >= left - 1e-9


def spike_and_hill(at):
    """A peak a fifth of a degree wide at 5 degrees, and beside it a broad hill, less high, at 18."""
    tilt = at["tilt_x_deg"]
    return 1.2 * np.exp(-(((tilt - 5.0) / 0.1) ** 2)) + np.exp(-(((tilt - 18.0) / 5.0) ** 2))


@pytest.mark.parametrize("aim", ["mean", "low"])
def test_the_sharp_search_takes_the_spike_and_the_robust_one_the_hill(aim):
    landscape = Landscape(spike_and_hill)
    tolerance = replace(TOLERANCE, aim=aim)

    def plan(tilt_x_deg):
        return (mounting(PLAN, tilt_x_deg=tilt_x_deg),)

    def sharp(x):
        return landscape.totals([plan(tilt) for (tilt,) in x]).objective.sum(axis=1)

    def robust(x):
        return objective_over(landscape, [plan(tilt) for (tilt,) in x], tolerance)

    found = {}
    for name, objective in (("sharp", sharp), ("robust", robust)):
        found[name] = run(make_search("grid", [0.0], [25.0], seed=1, evaluations=501), objective).x[0]
    assert found["sharp"] == pytest.approx(5.0, abs=0.1)
    assert found["robust"] == pytest.approx(18.0, abs=0.3)
    plans = [plan(found[name]) for name in ("sharp", "robust")]
    assert best_over_tolerance(landscape, plans, tolerance) is plans[1]


def test_all_errors_of_all_plans_are_scored_in_one_call():
    landscape = Landscape(bumpy)
    calls = []
    totals, landscape.totals = landscape.totals, lambda layouts: calls.append(len(layouts)) or totals(layouts)
    objective_over(landscape, [(mounting(PLAN),)] * 3, TOLERANCE)
    losses_over_tolerance(landscape, (mounting(PLAN),), TOLERANCE, [0])
    assert calls == [3 * 9, 1 + 121 + 6]


# --- on a scene -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    return prepare(load_scenario(write_scene(tmp_path_factory.mktemp("scene"))))


@pytest.fixture(scope="module")
def losses(site):
    with site_evaluator(site, site.search) as evaluator:
        plan = (mounting(PLAN, x_m=0.0, y_m=0.0),)
        return losses_over_tolerance(evaluator, plan, TOLERANCE, site.plan.search_block)


def test_each_error_has_the_score_that_its_mounting_has_alone(site, losses):
    plan, errors = PLAN | {"x_m": 0.0, "y_m": 0.0}, installation_errors(TOLERANCE, JUDGED_BASE)
    with site_evaluator(site, site.search) as evaluator:
        for row in (0, 17, 120):
            hung = {key: plan[key] + error for key, error in zip(COORDINATES[2:], errors[row], strict=True)}
            alone = evaluator.totals([(mounting(plan, **hung),)])
            np.testing.assert_allclose(alone.objective[0], losses.installed.totals.objective[row], rtol=1e-12)
        planned = evaluator.totals([(mounting(plan),)]).per_vehicle()[0]
        assert losses.planned.per_vehicle == planned
        assert set(losses.limit_losses) == {"height_m", "tilt_x_deg", "tilt_y_deg"}
        for key, ends in losses.limit_losses.items():
            for sign, loss in zip((-1.0, 1.0), ends, strict=True):
                off = evaluator.totals([(mounting(plan | {key: plan[key] + sign * TOLERANCE.half_widths[key]}),)])
                assert loss == pytest.approx(planned - off.per_vehicle()[0], abs=1e-12)
        objective = objective_over(evaluator, [(mounting(plan),)], TOLERANCE, JUDGED_BASE)[0]
    assert objective / losses.planned.totals.vehicles.sum() == pytest.approx(losses.installed.per_vehicle, rel=1e-12)
    assert losses.installed.totals.per_vehicle().std() > 0.0


def test_the_interval_of_a_mean_is_that_of_the_mean_mounting(losses):
    mean = block_sums(losses.installed.totals.objective, losses.installed.block).mean(axis=0)
    found = statistic_interval_90(losses.installed.per_vehicle_under, losses.installed.block_weight, 3)
    assert found == pytest.approx(ratio_interval_90(mean, losses.installed.block_weight, 3))


def test_what_is_kept_is_a_share_of_the_gain_and_needs_one(losses):
    base = losses.planned.per_vehicle - 0.5
    assert losses.kept(base) == pytest.approx(1.0 + (losses.installed.per_vehicle - losses.planned.per_vehicle) / 0.5)
    assert losses.kept(losses.planned.per_vehicle) is None
    assert losses.kept(losses.planned.per_vehicle + 0.1) is None


# --- the interval of any statistic ------------------------------------------------------------------------------------


def test_the_interval_of_a_ratio_is_the_same_either_way_empty_blocks_or_not():
    rng = np.random.default_rng(2)
    vehicles = np.array([5, 0, 7, 3, 0, 9, 4])
    values = rng.normal(size=7) * vehicles
    found = statistic_interval_90(lambda weights: weights @ values / (weights @ vehicles), vehicles, 5)
    assert found == pytest.approx(ratio_interval_90(values, vehicles, 5), rel=1e-12)
    assert statistic_interval_90(lambda weights: weights @ values, np.array([1, 0, 0, 2, 0, 0, 0]), 5) is None


def test_an_installed_lidar_hangs_on_the_very_mast_of_its_plan():
    mast = Mast((1.0, -0.5, 0.2), 0.7, (0.04, -0.03, 0.99875))
    plan = Mounting(mast, 3.0, 0.2)
    exact, other = installed(plan, np.array([[0.0, 0.0, 0.0, 0.0], [0.1, 1.0, -1.0, 2.0]]))
    np.testing.assert_allclose(exact.pose.rotation, plan.pose.rotation, atol=1e-12)
    assert exact.mast == other.mast == mast
