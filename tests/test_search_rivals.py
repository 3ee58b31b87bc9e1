"""The grid, the random search, and the doors to all searches."""

from __future__ import annotations

import itertools
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.errors import InputError
from blender_lidar.optimise import (
    SEARCHES,
    GridSearch,
    Hardened,
    RandomSearch,
    de_pso,
    make_search,
    maximise,
    run,
)
from blender_lidar.optimise.baselines import grid_points
from blender_lidar.optimise.search import generator, uniform
from tests.search_landscapes import (
    LOWER,
    UPPER,
    ackley,
    feasible_high_up,
    points_of,
    sphere,
    terraces,
)


@pytest.mark.parametrize("objective", [sphere, ackley, terraces])
def test_the_grid_finds_what_brute_force_finds(objective):
    result = run(GridSearch(LOWER, UPPER, points=(26, 26)), objective)
    nodes = [(2.0 + 0.1 * i, 1.0 * j) for i, j in itertools.product(range(26), range(26))]
    np.testing.assert_allclose(points_of(result.history), nodes, rtol=0.0, atol=1e-12)
    values = objective(points_of(result.history))
    assert result.evaluations == 676
    assert result.value == values.max()
    assert np.array_equal(result.x, points_of(result.history)[np.argmax(values)])


@given(st.integers(1, 6), st.integers(64, 5000))
def test_a_grid_is_as_fine_as_its_budget_allows_and_no_finer(variables, evaluations):
    points = grid_points(evaluations, variables)
    assert len(points) == variables
    assert max(points) - min(points) <= 1
    assert np.prod(points) <= evaluations
    coarsest = int(np.argmin(points))
    finer = [count + (variable == coarsest) for variable, count in enumerate(points)]
    assert np.prod(finer) > evaluations


def test_the_papers_budget_makes_a_finer_grid_than_its_own_resolution():
    assert (grid_points(676, 2), grid_points(2000, 2)) == ((26, 26), (45, 44))


def test_the_random_search_returns_the_best_of_its_points():
    result = run(RandomSearch(LOWER, UPPER, seed=3, evaluations=333), ackley)
    values = ackley(points_of(result.history))
    assert result.evaluations == 333
    assert result.value == values.max()
    assert np.array_equal(result.x, points_of(result.history)[np.argmax(values)])
    assert np.array_equal(points_of(result.history), uniform(generator(3), 333, np.array(LOWER), np.array(UPPER)))


def small(name):
    own = {"particles": 10} if name in ("hardened", "de-pso") else {}
    return make_search(name, LOWER, UPPER, seed=4, evaluations=130, **own)


@pytest.mark.parametrize("objective", [terraces, feasible_high_up, lambda x: np.zeros(len(x))])
@pytest.mark.parametrize("name", SEARCHES)
def test_a_search_made_anew_and_told_the_same_asks_for_the_same_however_often_it_is_asked(name, objective):
    first, again = small(name), small(name)
    while not first.done:
        candidates, values = first.ask(), objective(first.ask())
        again.ask()[:] = np.nan
        assert np.array_equal(again.ask(), candidates)
        for wrong in (np.full(len(values), np.nan), np.full(len(values), np.inf), values[1:]):
            with pytest.raises(InputError, match="objective"):
                again.tell(wrong)
        first.tell(values)
        again.tell(values.tolist())
    assert np.array_equal(first.history, again.history)
    assert np.array_equal(first.best_x, again.best_x)


DOORS = {name: partial(maximise, search=name, evaluations=400) for name in SEARCHES}
DOORS["de-pso as printed"] = partial(de_pso, particles=6, iterations=9, reading="paper")


@pytest.mark.parametrize("door", DOORS)
def test_the_same_seed_gives_the_same_trace_and_another_seed_another_but_on_a_grid(door):
    first, again, other = (DOORS[door](ackley, LOWER, UPPER, seed=seed) for seed in (5, 5, 6))
    assert np.array_equal(first.history, again.history)
    assert np.array_equal(first.history, other.history) == (door == "grid")


@pytest.mark.parametrize("name", SEARCHES)
def test_no_search_exceeds_its_budget(name):
    result = maximise(sphere, LOWER, UPPER, seed=0, evaluations=135, search=name)
    spent = {"hardened": 135, "de-pso": 120, "grid": 132, "random": 135}[name]
    assert result.evaluations == len(result.history) == spent
    assert small(name).budget <= 130


def test_the_product_s_door_is_the_hardened_search_and_de_pso_is_there_with_the_papers_settings():
    result, same = maximise(ackley, LOWER, UPPER, seed=8), run(Hardened(LOWER, UPPER, seed=8), ackley)
    assert np.array_equal(result.history, same.history)
    result, same = maximise(ackley, LOWER, UPPER, seed=8, search="de-pso"), de_pso(ackley, LOWER, UPPER, seed=8)
    assert np.array_equal(result.history, same.history)


@pytest.mark.parametrize("name", ["hardened", "de-pso"])
def test_a_swarm_comes_within_a_percent_of_the_exhaustive_grid(name):
    """Regret as a share of the landscape's range, median of 5 seeds, on the paper's two variables."""
    for objective in (sphere, ackley, terraces):
        grid = run(GridSearch(LOWER, UPPER, points=(26, 26)), objective)
        spread = grid.value - grid.history[:, -2].min()
        regret = [grid.value - maximise(objective, LOWER, UPPER, seed=seed, search=name).value for seed in range(5)]
        assert np.median(regret) <= 0.01 * spread


@pytest.mark.parametrize("name", ["hardned", "de_pso", "", None])
def test_an_unknown_search_is_refused_with_the_known_ones(name):
    with pytest.raises(InputError, match=r"unknown search .*allowed: hardened, de-pso, grid, random"):
        maximise(sphere, LOWER, UPPER, seed=0, search=name)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("de-pso", {"evaluations": 19}, "evaluations with 20 particles: 19; allowed: 20 or more"),
        ("grid", {"evaluations": 3}, "evaluations of a grid over 2 variables: 3; allowed: 4 or more"),
        ("random", {"evaluations": 0}, "evaluations: 0; allowed: 1 or more"),
        ("random", {"evaluations": "all"}, "evaluations: 'all'; allowed: a whole number"),
        ("random", {"seed": 1.5}, "seed: 1.5; allowed: a whole number"),
    ],
)
def test_unusable_budgets_are_refused(name, options, message):
    with pytest.raises(InputError, match=message):
        make_search(name, LOWER, UPPER, **{"seed": 0, **options})


def test_points_of_a_grid_are_those_of_a_product_both_bounds_included():
    lower, upper, points = [0.1, -0.3], [0.7, 0.9], (7, 5)
    grid = run(GridSearch(lower, upper, points=points), sphere)
    axes = [np.linspace(*axis) for axis in zip(lower, upper, points, strict=True)]
    assert np.array_equal(points_of(grid.history), np.array(list(itertools.product(*axes))))
