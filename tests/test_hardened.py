"""The hardened search: what must not change its answer, what must not stop it, and what it must find."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.optimise import Hardened, make_search, maximise, run
from blender_lidar.optimise.hardened import Polish
from blender_lidar.optimise.search import joined_history
from tests.search_landscapes import (
    LOWER,
    OPTIMUM,
    UPPER,
    ackley,
    feasible_high_up,
    points_of,
    share_on_a_bound,
    sphere,
    terraces,
)

pytestmark = pytest.mark.versions

SHORT = {"particles": 8, "evaluations": 400}


def searched(objective, seed, lower=LOWER, upper=UPPER, use=SHORT):
    return run(Hardened(lower, upper, seed=seed, **use), objective)


# --- what must not change the answer ----------------------------------------------------------------------------------


@settings(max_examples=10)
@given(st.tuples(*[st.integers(-1000, 1000)] * 2), st.integers(0, 1000))
def test_moving_the_domain_moves_every_candidate_and_changes_nothing_else(shift, seed):
    shift = np.array(shift, dtype=float)
    here = searched(sphere, seed)
    there = searched(lambda x: sphere(x - shift), seed, LOWER + shift, UPPER + shift)
    np.testing.assert_allclose(points_of(there.history) - shift, points_of(here.history), rtol=0.0, atol=1e-6)


@settings(max_examples=10)
@given(st.tuples(*[st.sampled_from([2.0**-20, 0.25, 2.0, 1024.0])] * 2), st.integers(0, 1000))
def test_the_unit_of_a_variable_plays_no_part(scale, seed):
    scale = np.array(scale)
    here = searched(ackley, seed)
    there = searched(lambda x: ackley(x / scale), seed, LOWER * scale, UPPER * scale)
    assert np.array_equal(points_of(there.history), points_of(here.history) * scale)


@pytest.mark.parametrize("rising", [lambda v: 1e6 + 1e3 * v, np.exp, lambda v: v**3], ids=["line", "exp", "cube"])
@pytest.mark.parametrize("objective", [sphere, terraces, feasible_high_up])
def test_only_the_order_of_values_counts(objective, rising):
    def raised(x):
        values = objective(x)
        return np.where(values == -np.inf, -np.inf, rising(values))

    assert np.array_equal(points_of(searched(raised, 11).history), points_of(searched(objective, 11).history))


# --- budget and bounds ------------------------------------------------------------------------------------------------


@settings(max_examples=20)
@given(st.integers(1, 8), st.integers(1, 400), st.integers(3, 40), st.integers(0, 2**32))
def test_the_budget_is_spent_to_the_last_and_no_candidate_leaves_the_box(variables, budget, particles, seed):
    lower, upper = np.full(variables, -3.0), np.linspace(1.0, 1e4, variables)
    target = upper + 1.0  # the best lies on every bound

    def objective(x):
        assert (x >= lower).all()
        assert (x <= upper).all()
        return -np.square((x - target) / (upper - lower)).sum(axis=1)

    result = searched(objective, seed, lower, upper, {"particles": particles, "evaluations": budget})
    assert result.evaluations == len(result.history) == budget
    assert result.value == result.history[:, -2].max()


# --- what it must find ------------------------------------------------------------------------------------------------


def turned(values, d, seed):
    """`values` of offsets from an optimum somewhere in a box of width 10, turned at random; and the box."""
    rng = np.random.default_rng([seed, d])
    axes, _ = np.linalg.qr(rng.standard_normal((d, d)))
    lower = 10.0 + 90.0 * rng.random(d)
    optimum = lower + 10.0 * (0.15 + 0.7 * rng.random(d))
    return (lambda x: -values((x - optimum) @ axes)), lower, lower + 10.0


def ellipsoid(z):
    return (10.0 ** (4.0 * np.arange(z.shape[1]) / (z.shape[1] - 1)) * z * z).sum(axis=1)


def rosenbrock(z):
    z = z + 1.0
    return (100.0 * (z[:, 1:] - z[:, :-1] ** 2) ** 2 + (z[:, :-1] - 1.0) ** 2).sum(axis=1)


def steps(z):
    return np.floor(20.0 * np.sqrt(np.square(z).sum(axis=1))) / 20.0


@pytest.mark.parametrize("d", [2, 6])
@pytest.mark.parametrize("values", [ellipsoid, rosenbrock, steps])
def test_ill_conditioned_turned_curved_and_stepped_landscapes_are_solved_with_every_seed(values, d):
    for seed in range(2):
        objective, lower, upper = turned(values, d, seed)
        assert maximise(objective, lower, upper, seed=seed, evaluations=1000 * d).value >= -1e-2


def test_many_local_maxima_are_left_behind_with_every_seed():
    for seed in range(3):
        found = maximise(ackley, LOWER, UPPER, seed=seed)
        np.testing.assert_allclose(found.x, OPTIMUM, rtol=1e-3)


def swarms_and_ended_climbs(objective, use, lower=LOWER, upper=UPPER, seed=0):
    """All swarms of a search; and for each climb that ended: its width then, what it reached, the best known."""
    search, swarms, climbs = Hardened(lower, upper, seed=seed, **use), [], []
    while not search.done:
        climb = search._climb
        search.tell(objective(search.ask()))
        if climb is not None and search._climb is not climb:
            climbs.append((np.ptp(climb.candidates, axis=0).max(), climb.reached, search.best_value))
        if not swarms or search._swarm is not swarms[-1]:
            swarms.append(search._swarm)
    return swarms, climbs


def ripples(x):
    """A hill with a top every twentieth of the box, 0.02 above the hollows between."""
    away = (x - OPTIMUM) / (UPPER - LOWER)
    return -np.square(away).sum(axis=1) - 0.01 * (1.0 - np.cos(40.0 * np.pi * away)).sum(axis=1)


def test_climbs_after_the_first_go_to_other_tops_and_end_before_they_are_through_with_a_lower_one():
    """Climbs used to start at the best point of the same swarm again, and to climb the same top to the end."""
    for seed in range(3):
        _, climbs = swarms_and_ended_climbs(ripples, {}, seed=seed)
        lower = [(width, reached) for width, reached, best in climbs if reached < best - 1e-3]
        assert min(width for width, _ in lower) > 1e-4
        assert len({round(reached, 3) for _, reached in lower}) >= 3


def test_a_large_budget_begins_anew_and_finds_a_hill_that_one_swarm_misses():
    def hidden(x):
        away = (x - LOWER) / (UPPER - LOWER)
        distance = np.linalg.norm(away - 0.8, axis=1)
        return np.where(distance < 0.08, 1.0 - distance, -np.square(away - 0.3).sum(axis=1))

    small, large = (
        [maximise(hidden, LOWER, UPPER, seed=seed, evaluations=budget).value > 0.0 for seed in range(3)]
        for budget in (2000, 5000)
    )
    assert not any(small)
    assert all(large)


@pytest.mark.parametrize("objective", [sphere, lambda x: x[:, 0] - x[:, 1]], ids=["inside", "in a corner"])
def test_no_round_is_longer_than_a_thousand_evaluations_for_each_variable_and_a_climb(objective):
    """All the rest of a budget went to climbs about the best point; in a corner all of these were one point."""
    swarms, _ = swarms_and_ended_climbs(objective, {"evaluations": 5000})
    assert len(swarms) >= 2


def test_a_swarm_without_a_feasible_point_is_replaced_at_once():
    search = Hardened(LOWER, UPPER, seed=0, evaluations=6000)
    first = search._swarm
    while search._swarm is first:
        search.tell(sphere(search.ask()))
    second = search._swarm
    search.tell(np.full(len(search.ask()), -np.inf))
    assert search._swarm is not second
    assert search._climb is None


def test_an_optimum_in_a_corner_is_reached():
    for seed in range(5):
        found = maximise(lambda x: x[:, 0] - x[:, 1], LOWER, UPPER, seed=seed, evaluations=1000)
        np.testing.assert_allclose(found.x, [4.5, 0.0], atol=1e-3)


def test_where_nothing_is_feasible_it_keeps_looking_everywhere():
    history = searched(lambda x: np.full(len(x), -np.inf), 0).history
    shares = (points_of(history)[-50:] - LOWER) / (UPPER - LOWER)
    assert np.ptp(shares, axis=0).min() > 0.8
    assert (history[:, -1] == -np.inf).all()


def test_few_candidates_lie_on_the_bounds_where_the_best_is_inside():
    """Velocities clipped at the walls put nine candidates of ten there."""
    found = [maximise(sphere, LOWER, UPPER, seed=seed) for seed in range(3)]
    assert max(share_on_a_bound(one.history) for one in found) < 0.1


@pytest.mark.parametrize("name", ["hardened", "de-pso", "grid", "random"])
def test_on_a_circle_the_bounds_are_one_place(name):
    """The top lies just beyond the bound at which a climb comes up, and no candidate leaves the box."""

    def objective(x):
        return np.cos(np.radians(x[:, 0] + 3.0)) - 0.1 * np.square(x[:, 1] - 0.4)

    for seed in range(5):
        search = make_search(name, [0.0, 0.0], [360.0, 1.0], seed=seed, evaluations=400, periodic=[True, False])
        found = run(search, objective)
        assert (found.history[:, 3] >= 0.0).all()
        assert (found.history[:, 3] <= 360.0).all()
        off = abs((found.x[0] - 357.0 + 180.0) % 360.0 - 180.0)
        assert off < {"hardened": 0.01, "de-pso": 3.0, "grid": 10.0, "random": 30.0}[name]


@pytest.mark.parametrize("turned", [0.25, 0.5, 0.9])
def test_a_search_on_a_circle_finds_as_much_wherever_the_circle_is_cut(turned):
    def objective(x):
        u = x[:, 0] + turned
        return np.cos(2.0 * np.pi * u) + 0.5 * np.cos(6.0 * np.pi * u) - np.square(x[:, 1] - 0.5)

    reached = [
        run(make_search("hardened", [0.0, 0.0], [1.0, 1.0], seed=s, evaluations=300, periodic=[True, False]), objective)
        for s in range(5)
    ]
    assert min(found.value for found in reached) > 1.5 - 1e-6


def test_polishing_begins_with_its_point_and_comes_to_the_top_beside_it_within_its_budget():
    top = np.array([0.31, 0.62])
    objective = lambda x: -np.square(x - top).sum(axis=1)  # noqa: E731
    search = Polish([0.0, 0.0], [1.0, 1.0], start=top + 0.02, seed=1, evaluations=120)
    found = run(search, objective)
    np.testing.assert_allclose(found.history[0, 3:5], top + 0.02)
    np.testing.assert_allclose(found.x, top, atol=1e-3)
    assert found.evaluations <= 120
    ended = run(Polish([0.0], [1.0], start=[0.5], seed=1, evaluations=10**5), lambda x: -np.abs(x[:, 0] - 0.5))
    assert ended.evaluations < 10**4  # it ends where it has arrived


def test_histories_of_searches_one_after_the_other_are_numbered_through():
    parts = [run(make_search("random", [0.0], [1.0], seed=seed, evaluations=30), sphere).history for seed in (1, 2)]
    joined = joined_history(parts)
    assert joined[:, 0].tolist() == list(range(1, 61))
    assert (np.diff(joined[:, 1]) >= 0).all()
    assert joined[30, 1] == joined[29, 1] + 1
    assert joined[:, -1].tolist() == np.maximum.accumulate(np.concatenate([part[:, -2] for part in parts])).tolist()
