"""Arrays and counts of a stored search: to JSON and back, with a clear line for what is damaged."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from ..errors import InputError


def read_array(state: dict[str, Any], key: str, shape: tuple[int, ...]) -> np.ndarray:
    """``state[key]`` as a finite float array of `shape`, or `InputError` naming the key."""
    array = np.array(state[key], dtype=float)
    if array.size == 0 and 0 in shape:
        return np.empty(shape)
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(f"{key}: shape {array.shape}; allowed: finite numbers, {shape}")
    return array


def read_count(state: dict[str, Any], key: str, most: int | None = None) -> int:
    """``state[key]`` as a whole number from 0 to `most`, or `InputError` naming the key."""
    count = state[key]
    if type(count) is not int or count < 0 or (most is not None and count > most):
        raise InputError(f"{key}: {count!r}; allowed: a whole number from 0{'' if most is None else f' to {most}'}")
    return count


def write_values(values: Iterable[float]) -> list[float | None]:
    """Values of the objective for JSON, which has no ``-inf``."""
    return [None if value == -math.inf else value for value in values]


def read_values(state: dict[str, Any], key: str, count: int) -> np.ndarray:
    """``state[key]`` as `count` values, finite or ``-inf``, or `InputError` naming the key."""
    values = np.array([-math.inf if value is None else value for value in state[key]], dtype=float)
    if values.shape != (count,) or np.isnan(values).any() or (values == math.inf).any():
        raise InputError(f"{key}: shape {values.shape}; allowed: {count} numbers or null")
    return values
