"""Random points in a box."""

from __future__ import annotations

import numpy as np

from ..errors import InputError


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


# Of each dimension after the first: coefficients of the primitive polynomial, its leading and last 1 left out, and the
# first direction numbers (Joe and Kuo 2008, new-joe-kuo-6).
_SOBOL = ((0, (1,)), (1, (1, 3)), (1, (1, 3, 1)), (2, (1, 1, 1)), (1, (1, 1, 3, 3)))
_SOBOL_BITS = 30
MOST_SOBOL_DIMENSIONS = len(_SOBOL) + 1


def sobol(rng: np.random.Generator, points: int, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """The first points of Sobol's sequence, all shifted alike (digit by digit) by a random amount, (points, d).

    Any 2^m of them that follow a multiple of 2^m fill the box evenly.

    Raises
    ------
    InputError
        For more than `MOST_SOBOL_DIMENSIONS` dimensions.
    """
    if lower.size > MOST_SOBOL_DIMENSIONS:
        raise InputError(f"Sobol's sequence in {lower.size} dimensions; allowed: at most {MOST_SOBOL_DIMENSIONS}")
    shift = rng.integers(1 << _SOBOL_BITS, size=lower.size)
    digits = np.stack([_sobol_digits(dimension, points) for dimension in range(lower.size)], axis=1) ^ shift
    return _in_box((digits + 0.5) / (1 << _SOBOL_BITS), lower, upper)


def _sobol_digits(dimension: int, points: int) -> np.ndarray:
    """Coordinates (points,) of the sequence as whole numbers of `_SOBOL_BITS` bits."""
    directions = _sobol_directions(dimension)
    gray = np.arange(points) ^ (np.arange(points) >> 1)  # the same sets of points, in the order that scipy has too
    digits = np.zeros(points, dtype=np.int64)
    for bit, direction in enumerate(directions):
        digits ^= np.where(gray >> bit & 1, direction, 0)
    return digits


def _sobol_directions(dimension: int) -> list[int]:
    if dimension == 0:
        return [1 << (_SOBOL_BITS - 1 - bit) for bit in range(_SOBOL_BITS)]
    polynomial, first = _SOBOL[dimension - 1]
    degree = len(first)
    numbers = [number << (_SOBOL_BITS - 1 - bit) for bit, number in enumerate(first)]
    for bit in range(degree, _SOBOL_BITS):
        number = numbers[bit - degree] ^ (numbers[bit - degree] >> degree)
        for step in range(1, degree):
            if polynomial >> (degree - 1 - step) & 1:
                number ^= numbers[bit - step]
        numbers.append(number)
    return numbers
