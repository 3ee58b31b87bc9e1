"""The objective's arithmetic, Eqs. 10 and 11."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from blender_lidar.errors import InputError
from blender_lidar.optimise import detectable, vehicle_score

OCCUPANCY = np.array(
    [
        [0.000, 0.000, 0.000],
        [0.005, 0.005, 0.005],
        [0.015, 0.000, 0.000],
        [0.014, 0.000, 0.000],
        [0.006, 0.007, 0.004],
    ]
)
SHARES = hnp.arrays(float, st.tuples(st.integers(0, 6), st.just(3)), elements=st.floats(0.0, 1.0))


@pytest.mark.parametrize(
    ("view", "expected"),
    [
        ("mean", [False, True, True, False, True]),
        ("max", [False, True, True, True, True]),
        ("min", [False, True, False, False, False]),
    ],
)
def test_a_vehicle_is_detectable_from_the_threshold_up(view, expected):
    assert detectable(OCCUPANCY, 0.005, view).tolist() == expected


@given(SHARES, st.floats(0.0, 1.0))
def test_min_implies_mean_implies_max(occupancy, threshold):
    by_min, by_mean, by_max = (detectable(occupancy, threshold, view) for view in ("min", "mean", "max"))
    mean_lost_to_rounding = np.isclose(occupancy.mean(axis=-1), threshold)
    assert (by_mean | ~by_min | mean_lost_to_rounding).all()
    assert (by_max | ~by_mean | mean_lost_to_rounding).all()


def test_the_corrected_reading_penalises_a_missed_vehicle_and_the_literal_one_rewards_it():
    entropy, seen = np.array([0.1, 0.1]), np.array([True, False])
    assert vehicle_score(entropy, seen, loss=-1.0).tolist() == [0.1, -1.0]
    assert vehicle_score(entropy, seen, loss=-1.0, reading="paper").tolist() == [0.1, 1.0]


@given(st.floats(-10.0, 10.0))
def test_the_sign_of_the_constant_matters_to_the_literal_reading_alone(loss):
    missed = np.zeros(1, bool)
    assert vehicle_score([0.3], missed, loss).tolist() == [-abs(loss)]
    assert vehicle_score([0.3], missed, loss, "paper").tolist() == [-loss]


@pytest.mark.parametrize(
    ("occupancy", "options", "message"),
    [
        (OCCUPANCY, {"view": "median"}, "unknown view 'median'; .*mean, max, min"),
        (OCCUPANCY, {"threshold": -0.1}, "threshold: -0.1; allowed"),
        (OCCUPANCY, {"threshold": np.nan}, "threshold: nan; allowed"),
        (OCCUPANCY, {"threshold": "low"}, "threshold: 'low'; allowed"),
        ([0.1, 0.2], {}, r"occupancy: shape \(2,\); allowed: \(\.\.\., 3\)"),
        ([0.1, 0.2, np.nan], {}, "occupancy: .*shares of 0 or more"),
    ],
)
def test_unusable_occupancy_is_refused_in_one_line(occupancy, options, message):
    with pytest.raises(InputError, match=message) as caught:
        detectable(occupancy, **options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("entropy", "seen", "options", "message"),
    [
        ([np.nan], [True], {}, "infinite or NaN"),
        ([0.1], [True], {"loss": np.inf}, "loss: inf"),
        ([0.1], [True], {"reading": "literal"}, "unknown reading 'literal'.*corrected, paper"),
    ],
)
def test_unusable_scores_are_refused(entropy, seen, options, message):
    with pytest.raises(InputError, match=message):
        vehicle_score(entropy, seen, **options)
