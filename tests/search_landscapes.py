"""Functions to maximise in the tests of the searches: candidates (s, d) in, values (s,) out.

The box is the paper's, 2 to 4.5 m and 0 to 25 degrees: it is not centred on the optimum and does not hold the origin
inside, so that a search with a pull to either is caught.
"""

from __future__ import annotations

import numpy as np

LOWER, UPPER = np.array([2.0, 0.0]), np.array([4.5, 25.0])
OPTIMUM = np.array([3.1, 17.0])


def unit(x):
    """Candidates as shares of the box, seen from the optimum."""
    return (x - OPTIMUM) / (UPPER - LOWER)


def sphere(x):
    return -np.square(unit(x)).sum(axis=1)


def ackley(x):
    """Many local maxima; 0 at the optimum, below elsewhere."""
    u = 10.0 * unit(x)
    bowl = -20.0 * np.exp(-0.2 * np.sqrt(np.square(u).mean(axis=1)))
    ripples = -np.exp(np.cos(2.0 * np.pi * u).mean(axis=1))
    return -(bowl + ripples + 20.0 + np.e)


def terraces(x):
    """A sphere in steps, as the threshold of Eq. 11 makes the real objective."""
    return np.ceil(400.0 * sphere(x)) / 400.0


def feasible_high_up(x):
    return np.where(x[:, 0] > 4.2, sphere(x), -np.inf)


def points_of(history):
    """The candidates of a search's history, (n, d)."""
    return history[:, 3:-2]


def share_on_a_bound(history):
    """Of the candidates, those with a variable at `LOWER` or `UPPER`."""
    return ((points_of(history) == LOWER) | (points_of(history) == UPPER)).any(axis=1).mean()
