"""DE-PSO against a plain-loop Algorithm 1, the properties that tell its two readings apart, and what it refuses."""

from __future__ import annotations

import inspect
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.errors import InputError
from blender_lidar.optimise import READINGS, DePso, DePsoSettings, de_pso, run
from tests.search_landscapes import (
    LOWER,
    OPTIMUM,
    UPPER,
    ackley,
    points_of,
    share_on_a_bound,
    sphere,
    terraces,
)

pytestmark = pytest.mark.versions

SHORT = {"particles": 6, "iterations": 9}


def algorithm_1(objective, seed, use):
    """The paper's Algorithm 1 in plain Python floats: every x and value, in order of evaluation.

    Shares with the search only the initial positions and the stream of uniform numbers, five to a particle and move.
    """
    n, d = use.particles, len(LOWER)
    lower, upper = LOWER.tolist(), UPPER.tolist()
    search = DePso(LOWER, UPPER, seed=seed, settings=use)
    p = [x.tolist() for x in search._position]
    rng = np.random.Generator(np.random.PCG64(seed))
    rng.permuted(np.zeros((d, n)), axis=1)
    rng.random((n, d))
    v = [[0.0] * d for _ in range(n)]
    p_best, p_value = [list(x) for x in p], [float("-inf")] * n
    g_best, g_value = None, float("-inf")
    trace = []

    def evaluate(i):
        nonlocal g_best, g_value
        value = float(objective(np.array([p[i]]))[0])
        trace.append((list(p[i]), value))
        if value > p_value[i]:
            p_best[i], p_value[i] = list(p[i]), value
        if value > g_value:
            g_best, g_value = list(p[i]), value

    for i in range(n):
        evaluate(i)
    for _ in range(1, use.iterations):
        before, guide = [list(x) for x in p], g_best
        for i in range(n):
            r1, r2, r3, u_j, u_k = (rng.random() for _ in range(5))
            if use.reading == "paper":
                before, guide = [list(x) for x in p], g_best
                j = list(range(n))[int(u_j * n)]
                k = [other for other in range(n) if other != j][int(u_k * (n - 1))]
            else:
                j = [other for other in range(n) if other != i][int(u_j * (n - 1))]
                k = [other for other in range(n) if other not in (i, j)][int(u_k * (n - 2))]
            for a in range(d):
                own = before[i][a]
                drawn = use.cognitive * r1 * (p_best[i][a] - own), use.social * r2 * (guide[a] - own)
                v[i][a] = use.inertia * v[i][a] + drawn[0] + drawn[1]
                if r3 < use.differential_threshold:
                    v[i][a] = use.differential_weight * (before[j][a] - before[k][a])
                    if use.reading == "paper":
                        v[i][a] = own + v[i][a]
                p[i][a] = min(max(own + v[i][a], lower[a]), upper[a])
            if use.reading == "paper":
                evaluate(i)
        if use.reading == "corrected":
            for i in range(n):
                evaluate(i)
    return trace


@pytest.mark.parametrize("reading", READINGS)
@pytest.mark.parametrize("objective", [sphere, ackley, terraces])
@pytest.mark.parametrize("differential_threshold", [0.0, 0.1, 1.0])
def test_the_trace_is_algorithm_1_to_the_last_bit(reading, objective, differential_threshold):
    use = DePsoSettings(particles=5, iterations=12, differential_threshold=differential_threshold, reading=reading)
    history = run(DePso(LOWER, UPPER, seed=3, settings=use), objective).history
    trace = algorithm_1(objective, 3, use)
    assert points_of(history).tolist() == [x for x, _ in trace]
    assert history[:, -2].tolist() == [value for _, value in trace]


@given(st.integers(3, 12), st.integers(0, 2**32))
def test_partners_are_distinct_and_in_the_corrected_reading_never_the_particle_itself(particles, seed):
    u_j, u_k = np.random.default_rng(seed).random((2, particles))
    i = np.arange(particles)
    search = DePso([0.0], [1.0], seed=0, settings=DePsoSettings(particles=particles))
    j, k = search._partners(i, u_j, u_k)
    assert (i != j).all()
    assert (i != k).all()
    assert (j != k).all()
    literal = DePso([0.0], [1.0], seed=0, settings=DePsoSettings(particles=particles, reading="paper"))
    j_literal, k_literal = literal._partners(i, u_j, u_k)
    assert (j_literal != k_literal).all()
    for partner in (j, k, j_literal, k_literal):
        assert partner.min() >= 0
        assert partner.max() < particles


def test_every_pair_of_partners_is_drawn_equally_often():
    draws = np.random.default_rng(0).random((2, 60_000))
    search = DePso([0.0], [1.0], seed=0, settings=DePsoSettings(particles=4))
    j, k = search._partners(np.full(60_000, 1), *draws)
    pairs, counts = np.unique(4 * j + k, return_counts=True)
    assert pairs.size == 6
    assert counts == pytest.approx(10_000, rel=0.05)


def test_a_search_that_finds_nothing_feasible_says_so():
    result = de_pso(lambda x: np.full(len(x), -np.inf), LOWER, UPPER, seed=0, **SHORT)
    assert result.value == -np.inf
    assert np.array_equal(result.x, points_of(result.history)[0])


@settings(max_examples=25)
@given(st.integers(0, 2**32), st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=2))
def test_moving_the_origin_moves_the_corrected_trace_along(seed, shift):
    def moved(x):
        return sphere(x - shift)

    here = de_pso(sphere, LOWER, UPPER, seed=seed, **SHORT)
    there = de_pso(moved, LOWER + shift, UPPER + shift, seed=seed, **SHORT)
    np.testing.assert_allclose(points_of(there.history) - shift, points_of(here.history), rtol=0.0, atol=1e-9)


def test_moving_the_origin_changes_the_literal_trace():
    shift = np.array([-3.0, -12.0])
    here = de_pso(sphere, LOWER, UPPER, seed=0, reading="paper")
    there = de_pso(lambda x: sphere(x - shift), LOWER + shift, UPPER + shift, seed=0, reading="paper")
    assert np.abs(points_of(there.history) - shift - points_of(here.history)).max() > 1.0


@pytest.mark.parametrize("reading", READINGS)
def test_history_numbers_every_evaluation(reading):
    result = de_pso(ackley, LOWER, UPPER, seed=1, reading=reading, **SHORT)
    evaluation, iteration, particle, *_, value, best = result.history.T
    assert evaluation.tolist() == list(range(1, 55))
    assert iteration.tolist() == [t for t in range(1, 10) for _ in range(6)]
    assert particle.tolist() == list(range(1, 7)) * 9
    assert np.array_equal(value, ackley(points_of(result.history)))
    assert np.array_equal(best, np.maximum.accumulate(value))
    row = int(np.argmax(value))
    assert np.array_equal(result.x, points_of(result.history)[row])
    assert result.value == value[row]


@pytest.mark.parametrize(("reading", "batch"), [("corrected", 20), ("paper", 1)])
def test_the_papers_settings_make_2000_evaluations_in_batches_that_fit_the_reading(reading, batch):
    shapes = []

    def objective(x):
        shapes.append(x.shape)
        return sphere(x)

    result = de_pso(objective, LOWER, UPPER, seed=0, reading=reading)
    assert result.evaluations == len(result.history) == 2000
    assert set(shapes) == {(batch, 2)}


@pytest.mark.parametrize("reading", READINGS)
def test_the_first_iteration_is_a_latin_hypercube(reading):
    history = de_pso(sphere, LOWER, UPPER, seed=0, reading=reading, particles=20, iterations=1).history
    slices = np.floor(20 * (points_of(history) - LOWER) / (UPPER - LOWER)).astype(int)
    for variable in slices.T:
        assert sorted(variable) == list(range(20))


def test_progress_is_reported_after_every_batch():
    seen = []
    de_pso(sphere, LOWER, UPPER, seed=0, callback=lambda s: seen.append((s.iteration, s.evaluations)), **SHORT)
    assert seen == [(t, 6 * t) for t in range(1, 10)]


@pytest.mark.parametrize(("objective", "regret"), [(sphere, 1e-5), (ackley, 0.02), (terraces, 1e-9)])
def test_the_corrected_reading_finds_an_off_centre_optimum(objective, regret):
    results = [de_pso(objective, LOWER, UPPER, seed=seed) for seed in range(11)]
    best = objective(OPTIMUM[None])[0]
    assert np.median([best - result.value for result in results]) <= regret


def test_the_literal_reading_spends_far_more_on_the_bounds():
    shares = {}
    for reading in READINGS:
        found = [de_pso(sphere, LOWER, UPPER, seed=seed, reading=reading) for seed in range(5)]
        shares[reading] = np.median([share_on_a_bound(one.history) for one in found])
    assert shares["corrected"] < 0.05
    assert shares["paper"] > 0.3


def test_the_defaults_of_the_function_are_those_of_the_settings():
    parameters = inspect.signature(de_pso).parameters
    for field in fields(DePsoSettings):
        assert parameters[field.name].default == field.default


# --- what is refused, in one line that names it -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lower", "upper", "message"),
    [
        ([2.0, 0.0], [4.5], r"shapes \(2,\) and \(1,\)"),
        (2.0, 4.5, r"shapes \(\) and \(\)"),
        ([2.0, 25.0], [4.5, 0.0], r"variable 1: \[25, 0\] are upside down"),
        ([2.0, 3.0], [4.5, 3.0], r"variable 1: \[3, 3\] .*fix it with a number instead"),
        ([np.nan], [4.5], r"variable 0: \[nan, 4.5\]; allowed: finite"),
        ([0.0], [np.inf], r"variable 0: \[0, inf\]; allowed: finite"),
    ],
)
def test_unusable_bounds_are_refused_in_one_line(lower, upper, message):
    with pytest.raises(InputError, match=message) as caught:
        de_pso(sphere, lower, upper, seed=0)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"particles": 2}, "particles: 2; allowed: 3 or more"),
        ({"particles": 20.0}, "particles: 20.0; allowed: a whole number"),
        ({"iterations": 0}, "iterations: 0; allowed: 1 or more"),
        ({"inertia": -0.1}, "inertia: -0.1; allowed"),
        ({"differential_threshold": 1.1}, "differential_threshold: 1.1; allowed: a finite number from 0 to 1"),
        ({"reading": "literal"}, "unknown reading 'literal'.*corrected, paper"),
        ({"seed": -1}, "seed: -1; allowed: 0 or more"),
    ],
)
def test_unusable_settings_are_refused_by_name(setting, message):
    with pytest.raises(InputError, match=message):
        de_pso(sphere, LOWER, UPPER, **{"seed": 0, **setting})


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_value_that_is_no_number_is_refused_and_names_the_candidate(bad):
    search = DePso(LOWER, UPPER, seed=0, settings=DePsoSettings(**SHORT))
    values = np.zeros(6)
    values[4] = bad
    candidates = search.ask()
    with pytest.raises(InputError) as caught:
        search.tell(values)
    assert str(candidates[4].tolist()) in str(caught.value)
    assert search.evaluations == 0
    assert np.array_equal(search.ask(), candidates)


@pytest.mark.parametrize("values", [np.zeros((20, 1)), np.zeros(19), ["a"] * 20])
def test_values_of_the_wrong_shape_or_kind_are_refused(values):
    with pytest.raises(InputError, match="objective values"):
        de_pso(lambda x: values, LOWER, UPPER, seed=0)


def test_a_finished_search_asks_and_takes_nothing_more():
    search = DePso(LOWER, UPPER, seed=0, settings=DePsoSettings(**SHORT))
    run(search, sphere)
    with pytest.raises(InputError, match="all 54 evaluations are made"):
        search.ask()
    with pytest.raises(InputError, match="all 54 evaluations are made"):
        search.tell(np.zeros(6))
