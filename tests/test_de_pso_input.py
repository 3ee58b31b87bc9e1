"""What DE-PSO refuses: bounds, settings and values that cannot be used, each in one line that names them."""

from __future__ import annotations

import numpy as np
import pytest

from blender_lidar.errors import InputError
from blender_lidar.optimise import DePso, DePsoSettings, de_pso, run
from tests.search_landscapes import LOWER, UPPER, sphere

SHORT = {"particles": 6, "iterations": 9}


@pytest.mark.parametrize(
    ("lower", "upper", "message"),
    [
        ([2.0, 0.0], [4.5], r"shapes \(2,\) and \(1,\)"),
        ([], [], r"shapes \(0,\) and \(0,\)"),
        ([[2.0]], [[4.5]], r"shapes \(1, 1\)"),
        (2.0, 4.5, r"shapes \(\) and \(\)"),
        ([2.0, 25.0], [4.5, 0.0], r"variable 1: \[25, 0\] are upside down"),
        ([2.0, 3.0], [4.5, 3.0], r"variable 1: \[3, 3\] .*fix it with a number instead"),
        ([np.nan], [4.5], r"variable 0: \[nan, 4.5\]; allowed: finite"),
        ([0.0], [np.inf], r"variable 0: \[0, inf\]; allowed: finite"),
        ([-1.7e308], [1.7e308], "a finite distance apart"),
        (["low"], ["high"], "lower bounds: .*allowed: numbers"),
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
        ({"cognitive": np.nan}, "cognitive: nan; allowed"),
        ({"social": "much"}, "social: 'much'; allowed"),
        ({"differential_weight": np.inf}, "differential_weight: inf; allowed"),
        ({"differential_threshold": 1.1}, "differential_threshold: 1.1; allowed: a finite number from 0 to 1"),
        ({"reading": "literal"}, "unknown reading 'literal'.*corrected, paper"),
        ({"seed": -1}, "seed: -1; allowed: 0 or more"),
        ({"seed": None}, "seed: None; allowed: a whole number"),
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
    candidate = search.ask()[4].tolist()
    before = search.state()
    with pytest.raises(InputError) as caught:
        search.tell(values)
    assert str(candidate) in str(caught.value)
    assert search.state() == before


@pytest.mark.parametrize("values", [np.zeros((20, 1)), np.zeros(19), 0.0, ["a"] * 20, [1j] * 20])
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


def test_before_the_first_evaluation_there_is_no_best():
    search = DePso(LOWER, UPPER, seed=0)
    assert (search.evaluations, search.iteration, search.best_value) == (0, 0, -np.inf)
    assert search.history.shape == (0, 7)
    with pytest.raises(InputError, match="nothing has been evaluated"):
        _ = search.best_x
