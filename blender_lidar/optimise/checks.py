"""Checks of what a search is given: bounds, whole numbers, objective values."""

from __future__ import annotations

import math
import operator

import numpy as np

from ..errors import InputError


def check_bounds(lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The search box as two float arrays, (d,).

    Raises
    ------
    InputError
        If the bounds are not two equally long lists of finite numbers, with every lower one below its upper one.
    """
    lower, upper = _numbers(lower, "lower bounds"), _numbers(upper, "upper bounds")
    if lower.ndim != 1 or lower.shape != upper.shape or lower.size == 0:
        raise InputError(
            f"bounds: shapes {lower.shape} and {upper.shape}; allowed: two lists of equal length, not empty"
        )
    for variable, (low, high) in enumerate(zip(lower.tolist(), upper.tolist(), strict=True)):
        where = f"bounds of variable {variable}: [{low:g}, {high:g}]"
        if not np.isfinite([low, high, high - low]).all():
            raise InputError(f"{where}; allowed: finite numbers, a finite distance apart")
        if low > high:
            raise InputError(f"{where} are upside down; allowed: low below high")
        if low == high:
            raise InputError(f"{where} leave nothing to search; fix it with a number instead")
    return lower, upper


def check_whole(value: int, least: int, what: str) -> int:
    """`value` as a plain int of at least `least`, or `InputError` naming `what`."""
    try:
        whole = operator.index(value)
    except TypeError:
        raise InputError(f"{what}: {value!r}; allowed: a whole number, {least} or more") from None
    if whole < least:
        raise InputError(f"{what}: {whole}; allowed: {least} or more")
    return whole


def check_number(value: float, least: float, most: float, what: str) -> float:
    """`value` as a plain finite float from `least` to `most`, or `InputError` naming `what`."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not (math.isfinite(number) and least <= number <= most):
        raise InputError(f"{what}: {value!r}; allowed: a finite number from {least:g} to {most:g}")
    return number


def check_values(values: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """The objective's values of `candidates` (s, d) as a float array, (s,).

    Raises
    ------
    InputError
        If there is not one number per candidate, or one is NaN or +inf. ``-inf`` marks a candidate as infeasible.
    """
    values = _numbers(values, "objective values")
    if values.shape != candidates.shape[:1]:
        raise InputError(f"objective values: shape {values.shape}; allowed: {candidates.shape[:1]}, one per candidate")
    unusable = np.isnan(values) | (values == np.inf)
    if unusable.any():
        first = int(np.argmax(unusable))
        raise InputError(
            f"objective: {values[first]} at candidate {candidates[first].tolist()}; allowed: finite or -inf"
        )
    return values


def _numbers(values: np.ndarray, what: str) -> np.ndarray:
    try:
        return np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{what}: {values!r}; allowed: numbers") from None
