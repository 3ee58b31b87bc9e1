"""Random points in a box."""

from __future__ import annotations

import numpy as np


def generator(seed: int) -> np.random.Generator:
    """A random generator whose kind is fixed, so that its stored state can be read back."""
    return np.random.Generator(np.random.PCG64(seed))


def latin_hypercube(rng: np.random.Generator, points: int, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Points of which each of `points` equal slices of every variable holds exactly one, (points, d)."""
    slices = rng.permuted(np.tile(np.arange(points), (lower.size, 1)), axis=1).T
    return _in_box((slices + rng.random(slices.shape)) / points, lower, upper)


def uniform(rng: np.random.Generator, points: int, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Independent uniform points, (points, d)."""
    return _in_box(rng.random((points, lower.size)), lower, upper)


def _in_box(unit: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    # the clip catches a last digit that rounding carries over the upper bound
    return np.clip(lower + unit * (upper - lower), lower, upper)
