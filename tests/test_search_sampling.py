"""Random points in a box: the last digit."""

from __future__ import annotations

import numpy as np

from blender_lidar.optimise.sampling import latin_hypercube, uniform


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
