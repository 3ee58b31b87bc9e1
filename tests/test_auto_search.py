"""The search over two fidelities: what it finds, spends and refuses on made-up objectives; and its coarse fidelity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tests.research  # noqa: F401
from blender_lidar.errors import InputError
from blender_lidar.optimise import make_search
from blender_lidar.optimise.multi_fidelity import Asked, MultiFidelitySearch, far_apart_best, peaks
from blender_lidar.run.searches import screening
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Evaluator
from blender_lidar.scoring.fidelity import Fidelity, coarse_observation, screened_with
from rival_metrics import OPTIONS
from tests.small_scene import write_scene

FRAMES = 40
COARSE = Fidelity("body", 8)


def made_search(d=2, seed=1, frames=24, **given):
    lower, upper = np.full(d, -1.0), np.full(d, 3.0)
    screen = make_search("hardened", lower, upper, seed=seed, evaluations=screening(d), **given)
    return MultiFidelitySearch(screen, COARSE, tuple(range(frames)), seed=seed)


def of_frames(asked):
    """Points, how thin beams are, and what the frames are worth together."""
    x, frames, stride = (asked.x, asked.frames, asked.fidelity.stride) if isinstance(asked, Asked) else (asked, None, 1)
    return x, stride, (1.0 + 0.3 * np.sin(np.arange(FRAMES) if frames is None else np.array(frames))).sum()


def objective(asked, bias=0.0):
    """A peak at 1 in every variable, frames that are worth more or less, and a ripple that thin beams see more of."""
    x, stride, worth = of_frames(asked)
    return -worth * np.square(x - 1.0).sum(axis=1) + bias * stride * np.cos(40.0 * x.sum(axis=1))


def run(search, bias=0.0):
    while not search.done:
        search.tell(objective(search.ask(), bias))
    return search


@pytest.mark.parametrize("d", [1, 2, 3, 5])
def test_the_peak_is_found_in_any_number_of_variables(d):
    search = run(made_search(d))
    assert np.abs(search.best_x - 1.0).max() < 0.12 * d
    assert search.best_value == pytest.approx(search.history[:, -2].max())


def two_peaks(asked):
    """Two hills 0.6 of the box apart; with all beams the one at 2.2 is the higher, with few that at -0.2."""
    x, stride, worth = of_frames(asked)
    lead = -1.0 if stride > 1 else 1.0
    hills = [10.0 * np.exp(-np.square((x - at) / 0.6).sum(axis=1)) for at in (-0.2, 2.2)]
    return np.maximum(hills[0] * (1.0 - 0.05 * lead), hills[1] * (1.0 + 0.05 * lead)) * worth


@pytest.mark.parametrize("d", [1, 2])
def test_of_two_peaks_far_apart_the_higher_is_found_though_few_beams_prefer_the_other(d):
    found = []
    for seed in range(1, 11):
        search = made_search(d, seed=seed)
        while not search.done:
            search.tell(two_peaks(search.ask()))
        found.append(np.abs(search.best_x - 2.2).max() < 0.12 * d)
    assert sum(found) >= 8  # the screen itself may not come near it


def test_before_the_climb_the_best_is_of_the_screening_and_nothing_is_recorded():
    search = made_search(frames=1)
    while search.spent[1]["candidates"] == 0 and isinstance(asked := search.ask(), Asked):
        assert asked.frames == (0,)
        search.tell(objective(asked))
        assert search.best_x.shape == (2,)
        assert search.history.shape == (0, 7)
        assert search.best_value == -np.inf
    screened = search.best_x
    climbed = run(search)
    assert objective(climbed.best_x[None])[0] >= objective(screened[None])[0]
    assert climbed.history.shape == (climbed.spent[1]["candidates"], 7)


def test_what_is_recorded_has_met_every_frame_with_all_beams():
    history = run(made_search(), bias=0.2).history
    np.testing.assert_allclose(history[:, -2], objective(history[:, 3:-2], 0.2), rtol=1e-12)
    np.testing.assert_array_equal(history[:, -1], np.maximum.accumulate(history[:, -2]))
    assert history[:, 0].tolist() == list(range(1, len(history) + 1))


def test_it_spends_a_small_share_of_what_a_search_at_the_full_fidelity_does():
    search = run(made_search())
    screened, climbed = (row["candidates"] for row in search.spent)
    assert screening(2) < screened < 2 * screening(2)
    assert climbed == len(search.history) < 2000 / 30
    assert screened + climbed == search.evaluations <= search.budget


def test_made_anew_and_told_the_same_it_asks_for_the_same():
    first, again = made_search(), made_search()
    while not first.done:
        asked, other = first.ask(), again.ask()
        assert type(asked) is type(other)
        assert all(np.array_equal(*pair) for pair in zip(asked, other, strict=True))
        first.tell(objective(asked, 0.2), 0.5)
        again.tell(objective(asked, 0.2).tolist(), 0.5)
    np.testing.assert_array_equal(first.history, again.history)
    assert first.spent == again.spent
    assert {row["seconds"] > 0.0 for row in first.spent} == {True}


def test_a_flat_objective_ends():
    search = made_search()
    while not search.done:
        asked = search.ask()
        search.tell(np.zeros(len(asked.x if isinstance(asked, Asked) else asked)))
    assert search.best_value == 0.0


@pytest.mark.parametrize("wrong", [np.zeros(3), np.zeros((2, 8)), np.zeros(())])
def test_what_is_not_one_number_for_each_candidate_is_refused(wrong):
    search = made_search()
    with pytest.raises(InputError, match="objective values: shape"):
        search.tell(wrong)
    assert search.evaluations == 0


def test_on_a_circle_two_points_beside_its_seam_are_near():
    x, values = np.array([[0.001], [0.999], [0.5]]), np.array([3.0, 2.9, 1.0])
    assert far_apart_best(x, values, 0.15, 3) == [0, 1, 2]
    assert far_apart_best(x, values, 0.15, 3, np.array([True])) == [0, 2]
    assert peaks(x, values) == [0, 1, 2]
    assert peaks(x, values, np.array([True])) == [0, 2]


@pytest.mark.parametrize("d", [1, 2, 4])
def test_a_peak_is_the_best_of_all_within_its_reach(d):
    rng = np.random.default_rng(d)
    x, values = rng.random((120, d)), rng.normal(size=120)
    found = peaks(x, values)
    near = np.abs(x[:, None] - x).max(axis=2) <= 0.15
    assert found == sorted(found, key=lambda row: -values[row])
    assert set(found) == {row for row in range(120) if values[row] == values[near[row]].max()}


# --- the coarse fidelity: which frames it looks at, and how it thins beams --------------------------------------------


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    return prepare(load_scenario(write_scene(tmp_path_factory.mktemp("coarse"))))


@pytest.mark.parametrize("frames", [1, 2, 9, 24, 33, 60])
def test_frames_are_spread_evenly_over_those_in_which_something_counts(site, frames):
    vehicles = np.arange(frames) % 3 if frames > 1 else np.ones(1)
    fidelity, chosen = screened_with(site.observation, vehicles)
    assert fidelity.detail == "body"
    assert len(set(chosen)) == len(chosen) == min(24, np.count_nonzero(vehicles))
    assert all(vehicles[frame] > 0 for frame in chosen)
    assert np.diff(chosen).max(initial=0) <= 1.5 * frames / len(chosen) + 1
    assert screened_with(site.observation, np.zeros(3))[1] == (0, 1, 2)


def test_cells_grow_with_the_stride_and_the_reference_stays_as_it_is(site):
    seen = site.observation
    assert coarse_observation(seen, Fidelity(seen.detail)).cell_m == seen.cell_m
    assert coarse_observation(seen, Fidelity(seen.detail)).lattice is seen.lattice
    coarse = coarse_observation(seen, Fidelity(seen.detail, stride=4))
    assert coarse.cell_m == pytest.approx(2.0 * seen.cell_m)
    assert coarse.lattice.columns == round(seen.lattice.columns / 4)


def test_the_best_that_lie_apart_begin_with_the_best():
    rng = np.random.default_rng(1)
    x = rng.random((200, 2))
    values = -np.square(x - 0.5).sum(axis=1)
    rows = far_apart_best(x, values, 0.1, 10)
    assert rows[0] == np.argmax(values)
    assert np.all(np.diff(values[rows]) <= 0.0)
    apart = np.abs(x[rows][:, None] - x[rows]).max(axis=2) + np.eye(10)
    assert apart.min() >= 0.1
    assert far_apart_best(np.repeat([[0.2], [0.7]], 3, axis=0), np.arange(6.0), 0.1, 5) == [5, 2]


@pytest.mark.parametrize("metric", ["view-coverage", OPTIONS["voxel_entropy_10_cm"]])
def test_cells_of_a_metrics_own_grow_with_thinned_beams(metric, tmp_path):
    site = prepare(load_scenario(write_scene(tmp_path), {("objective", "metric"): (metric, "here")}))
    layouts = [
        (site.scenario.lidar.mounting({"height_m": h, "tilt_x_deg": t}),) for h in (2.5, 4.4) for t in (2.0, 10.0, 20.0)
    ]
    with Evaluator(site.search, site.observation, site.scoring) as evaluator:
        full = evaluator.totals(layouts).per_vehicle()
        thinned = evaluator.totals(layouts, fidelity=Fidelity("body", 4)).per_vehicle()
        fixed = replace(coarse_observation(site.observation, Fidelity("body", 4)), cell_growth=1.0)
    with Evaluator(site.search, fixed, site.scoring) as evaluator:
        as_they_are = evaluator.totals(layouts).per_vehicle()
    assert np.corrcoef(full, thinned)[0, 1] > np.corrcoef(full, as_they_are)[0, 1]
