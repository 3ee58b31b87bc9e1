"""The grid, the random search, and the doors to all searches."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.errors import InputError
from blender_lidar.optimise import (
    SEARCHES,
    DePsoSettings,
    GridSearch,
    Hardened,
    RandomSearch,
    de_pso,
    make_search,
    maximise,
    run,
    search_from_state,
)
from blender_lidar.optimise.rivals import grid_points
from blender_lidar.optimise.sampling import generator, uniform
from tests.search_landscapes import LOWER, UPPER, ackley, sphere, terraces


def points_of(history):
    return history[:, 3:-2]


@pytest.mark.parametrize("objective", [sphere, ackley, terraces])
def test_the_grid_finds_what_brute_force_finds(objective):
    result = run(GridSearch(LOWER, UPPER, points=(26, 26)), objective)
    nodes = [(2.0 + 0.1 * i, 1.0 * j) for i, j in itertools.product(range(26), range(26))]
    np.testing.assert_allclose(points_of(result.history), nodes, rtol=0.0, atol=1e-12)
    values = objective(points_of(result.history))
    assert result.evaluations == 676
    assert result.value == values.max()
    assert np.array_equal(result.x, points_of(result.history)[np.argmax(values)])


def test_the_grid_includes_both_bounds_exactly():
    points = points_of(run(GridSearch([0.1, -0.3], [0.7, 0.9], points=(3, 4)), lambda x: x[:, 0]).history)
    assert points.min(axis=0).tolist() == [0.1, -0.3]
    assert points.max(axis=0).tolist() == [0.7, 0.9]


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
    assert grid_points(676, 2) == (26, 26)
    assert grid_points(2000, 2) == (45, 44)


def test_the_random_search_returns_the_best_of_its_points():
    result = run(RandomSearch(LOWER, UPPER, seed=3, evaluations=333), ackley)
    values = ackley(points_of(result.history))
    assert result.evaluations == 333
    assert result.value == values.max()
    assert np.array_equal(result.x, points_of(result.history)[np.argmax(values)])


def test_random_points_fill_the_box_evenly():
    points = points_of(run(RandomSearch(LOWER, UPPER, seed=0, evaluations=4000), sphere).history)
    assert (points >= LOWER).all()
    assert (points <= UPPER).all()
    np.testing.assert_allclose(points.mean(axis=0), (LOWER + UPPER) / 2, rtol=0.03)
    np.testing.assert_allclose(points.std(axis=0), (UPPER - LOWER) / np.sqrt(12.0), rtol=0.03)


@pytest.mark.parametrize("chunk", [1, 7, 1000])
def test_the_chunk_changes_nothing_but_the_batches(chunk):
    for make in (
        lambda **size: GridSearch(LOWER, UPPER, points=(9, 11), **size),
        lambda **size: RandomSearch(LOWER, UPPER, seed=1, evaluations=99, **size),
    ):
        result, usual = run(make(chunk=chunk), ackley), run(make(), ackley)
        assert np.array_equal(points_of(result.history), points_of(usual.history))
        assert np.array_equal(result.history[:, 1], np.arange(99) // chunk + 1)


def small(name):
    return make_search(name, LOWER, UPPER, seed=4, evaluations=130, settings=DePsoSettings(particles=10))


@pytest.mark.parametrize("name", SEARCHES)
def test_every_search_resumes_from_any_batch_to_the_same_answer(name):
    whole = run(small(name), terraces)
    search = small(name)
    while not search.done:
        search = search_from_state(json.loads(json.dumps(search.state(), allow_nan=False)))
        assert search.name == name
        search.tell(terraces(search.ask()))
    search = search_from_state(json.loads(json.dumps(search.state())))
    assert search.done
    assert np.array_equal(search.history, whole.history)
    assert np.array_equal(search.best_x, whole.x)


@pytest.mark.parametrize("name", SEARCHES)
def test_no_search_exceeds_its_budget(name):
    result = maximise(sphere, LOWER, UPPER, seed=0, evaluations=135, search=name)
    assert (
        result.evaluations == len(result.history) == {"hardened": 135, "de-pso": 120, "grid": 132, "random": 135}[name]
    )
    assert small(name).budget <= 130


def test_the_product_s_door_is_the_hardened_search_and_de_pso_is_there_with_the_papers_settings():
    result, same = maximise(ackley, LOWER, UPPER, seed=8), run(Hardened(LOWER, UPPER, seed=8), ackley)
    assert np.array_equal(result.history, same.history)
    result, same = maximise(ackley, LOWER, UPPER, seed=8, search="de-pso"), de_pso(ackley, LOWER, UPPER, seed=8)
    assert np.array_equal(result.history, same.history)


def test_settings_set_the_rivals_budget_too():
    use = DePsoSettings(particles=10, iterations=7)
    assert {name: make_search(name, LOWER, UPPER, seed=0, settings=use).budget for name in SEARCHES} == {
        "hardened": 70,
        "de-pso": 70,
        "grid": 64,
        "random": 70,
    }


def test_grid_points_can_be_given_outright():
    assert make_search("grid", LOWER, UPPER, seed=0, points=np.array([26, 26])).budget == 676


@pytest.mark.parametrize("name", ["hardened", "de-pso"])
def test_a_swarm_comes_within_a_percent_of_the_exhaustive_grid(name):
    """Regret as a share of the landscape's range, median of 11 seeds, on the paper's two variables."""
    for objective in (sphere, ackley, terraces):
        grid = run(GridSearch(LOWER, UPPER, points=(26, 26)), objective)
        spread = grid.value - grid.history[:, -2].min()
        regret = [grid.value - maximise(objective, LOWER, UPPER, seed=seed, search=name).value for seed in range(11)]
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
        ("grid", {"points": (26,)}, "one whole number for each of the 2 variables"),
        ("grid", {"points": (26, 1)}, "grid points: 1; allowed: 2 or more"),
        ("grid", {"points": (26, 2.5)}, "grid points: 2.5; allowed: a whole number"),
        ("random", {"evaluations": 0}, "evaluations: 0; allowed: 1 or more"),
        ("random", {"evaluations": "all"}, "evaluations: 'all'; allowed: a whole number"),
        ("random", {"seed": 1.5}, "seed: 1.5; allowed: a whole number"),
    ],
)
def test_unusable_budgets_are_refused(name, options, message):
    with pytest.raises(InputError, match=message):
        make_search(name, LOWER, UPPER, **{"seed": 0, **options})


def test_a_budget_larger_than_memory_costs_nothing_before_it_is_spent():
    """Ten thousand particles for a million iterations, the most that a scene may ask for."""
    for method in ("grid", "random"):
        search = make_search(method, LOWER[:1], UPPER[:1], seed=1, settings=DePsoSettings(10_000, 1_000_000))
        assert search.budget == 10**10
        assert search.ask().shape == (20, 1)


def test_candidates_made_when_they_are_asked_for_are_those_of_a_list_made_at_once():
    points, size = (7, 5), 23
    grid = run(GridSearch(LOWER, UPPER, points=points, chunk=4), sphere)
    axes = [np.linspace(*axis) for axis in zip(LOWER, UPPER, points, strict=True)]
    assert np.array_equal(points_of(grid.history), np.array(list(itertools.product(*axes))))
    found = run(RandomSearch(LOWER, UPPER, seed=3, evaluations=size, chunk=4), sphere)
    assert np.array_equal(points_of(found.history), uniform(generator(3), size, np.array(LOWER), np.array(UPPER)))


@pytest.mark.parametrize("variables", range(1, 7))
def test_the_finest_grid_is_that_of_counting_up(variables):
    for evaluations in (2**variables, 2**variables + 1, 999, 1000, 4095, 4096, 46656, 117_649):
        even = 2
        while (even + 1) ** variables <= evaluations:
            even += 1
        assert set(grid_points(max(evaluations, 2**variables), variables)) <= {even, even + 1}


@pytest.mark.parametrize("search", [GridSearch, RandomSearch])
def test_a_chunk_holds_at_least_one_candidate(search):
    options = {"points": (3, 3)} if search is GridSearch else {"seed": 0}
    with pytest.raises(InputError, match="chunk: 0; allowed: 1 or more"):
        search(LOWER, UPPER, chunk=0, **options)


@pytest.mark.parametrize("name", SEARCHES)
@pytest.mark.parametrize("bounds", [([2.0, 25.0], [4.5, 0.0]), ([2.0], [4.5, 25.0]), ([np.nan, 0.0], [4.5, 25.0])])
def test_every_search_refuses_unusable_bounds(name, bounds):
    with pytest.raises(InputError, match="bounds"):
        make_search(name, *bounds, seed=0)


def broken(name, **changes):
    search = small(name)
    search.tell(sphere(search.ask()))
    return {**search.state(), **changes}


@pytest.mark.parametrize(
    "state",
    [
        None,
        {},
        {"search": "hardned"},
        {"search": "hardened"},
        broken("hardened", batches=[1, 2]),
        broken("hardened", batches=None),
        broken("hardened", swarm={}),
        broken("hardened", swarm={**small("hardened").state()["swarm"], "value": [float("nan")] * 10}),
        broken("hardened", swarm={**small("hardened").state()["swarm"], "oldest": 99}),
        broken("hardened", swarm={**small("hardened").state()["swarm"], "position": [[0.5, 0.5]]}),
        broken("hardened", climbed=[[0.5]]),
        broken("hardened", climb={"mean": [0.5, 0.5]}),
        broken("hardened", began=-1),
        broken("hardened", followed=True),
        broken("hardened", random=None),
        {"search": "grid"},
        broken("random", values=[0.0]),
        broken("random", values=["a"] * 20),
        broken("random", values=7),
        broken("grid", arguments={"lower": [0.0], "upper": [1.0]}),
        broken("grid", arguments=None),
        broken("de-pso", x=[[0.0]] * 10),
        broken("de-pso", x=[[3.0, 1.0]] * 7, values=[0.0] * 7),
        broken("de-pso", x=[[3.0, 1.0]] * 140, values=[0.0] * 140),
        broken("de-pso", position=[[3.0, 1.0]]),
        broken("de-pso", velocity=[[float("nan"), 1.0]] * 10),
        broken("de-pso", random={"bit_generator": "MT19937"}),
        broken("de-pso", random={**small("de-pso").state()["random"], "state": {"state": "x", "inc": 1}}),
        broken("de-pso", random=None),
    ],
)
def test_a_damaged_state_is_refused_in_one_line(state):
    with pytest.raises(InputError, match="stored") as caught:
        search_from_state(state)
    assert "\n" not in str(caught.value)
