"""Points in a box: the last digit, and how evenly they lie."""

from __future__ import annotations

import numpy as np
import pytest

from blender_lidar.errors import InputError
from blender_lidar.optimise.sampling import MOST_SOBOL_DIMENSIONS, generator, latin_hypercube, sobol, uniform


class TopOfTheRange:
    """A generator whose every draw is the largest float below 1 and that leaves the slices in order."""

    def permuted(self, slices, axis):
        return slices

    def random(self, shape):
        return np.full(shape, np.nextafter(1.0, 0.0))


def test_rounding_never_carries_a_point_over_the_upper_bound():
    lower, upper = np.array([-4.7]), np.array([3.6])
    assert lower + (upper - lower) > upper, "bounds that rounding does carry over"
    for sample in (latin_hypercube, uniform):
        points = sample(TopOfTheRange(), 20, lower, upper)
        assert (points >= lower).all()
        assert (points <= upper).all()


@pytest.mark.parametrize("dimensions", range(1, MOST_SOBOL_DIMENSIONS + 1))
def test_sobols_sequence_is_scipys_but_for_a_shift_of_the_digits(dimensions):
    qmc = pytest.importorskip("scipy.stats.qmc")
    expected = qmc.Sobol(dimensions, scramble=False).random(128)
    found = sobol(np.random.default_rng(5), 128, np.zeros(dimensions), np.ones(dimensions))
    ours, theirs = (np.floor(points * 2**30).astype(np.int64) for points in (found, expected))
    shift = ours ^ theirs
    assert (shift == shift[0]).all()
    assert shift.any()


@pytest.mark.parametrize("first", [0, 64])
def test_each_half_of_sobols_points_fills_the_box_evenly(first):
    """Of 64 points every eighth of the one side times every eighth of the other holds exactly one."""
    points = sobol(generator(3), 128, np.array([2.0, -10.0]), np.array([4.5, 25.0]))[first : first + 64]
    cell = np.floor((points - [2.0, -10.0]) / [2.5, 35.0] * 8.0).astype(int)
    assert len(np.unique(cell @ [8, 1])) == 64


def test_sobols_points_depend_on_the_seed_alone():
    box = np.zeros(3), np.ones(3)
    np.testing.assert_array_equal(sobol(generator(1), 16, *box), sobol(generator(1), 32, *box)[:16])
    assert not np.allclose(sobol(generator(1), 16, *box), sobol(generator(2), 16, *box))


def test_more_dimensions_than_directions_are_known_for_are_refused():
    with pytest.raises(InputError, match="7 dimensions; allowed: at most 6"):
        sobol(generator(1), 4, np.zeros(7), np.ones(7))
