"""Classes, sizes and heights of NGSIM vehicles, which are measured from video blobs and have no height.

Ranges and defaults: percentiles of I-80's and US-101's vehicles.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..errors import InputError, unknown_name
from .vehicles import CLASSES

HEIGHTS_M = {"car": 1.5, "van": 1.9, "truck": 3.0, "long_truck": 3.8, "bus": 3.2, "motorcycle": 1.4}
"""Heights by kind [m]; a ``long_truck`` is one of `LONG_TRUCK_M` or more."""
VAN_LONGER_THAN_M = 4.9
LONG_TRUCK_M = 9.0
NGSIM_CLASSES = {1: "motorcycle", 2: "car", 3: "truck"}


@dataclass(frozen=True, slots=True)
class _Plausible:
    """Range and default of one class's length and width [m]."""

    length: tuple[float, float]
    width: tuple[float, float]
    default: tuple[float, float]


# Motorcycle blobs are inflated to about 1.55 m: anything wider than a motorcycle becomes the default.
_PLAUSIBLE = {
    1: _Plausible(length=(1.6, 2.8), width=(0.5, 1.0), default=(2.1, 0.8)),
    2: _Plausible(length=(2.5, 7.0), width=(1.3, 2.6), default=(4.5, 2.05)),
    3: _Plausible(length=(5.0, 25.0), width=(1.8, 2.6), default=(12.7, 2.59)),
}


def repaired_sizes(v_class: np.ndarray, size_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lengths and widths brought into their class's range; missing ones (0) become its default.

    Parameters
    ----------
    v_class : ndarray, (n,) int
        1 motorcycle, 2 auto, 3 truck.
    size_m : ndarray, (n, 2)
        Length and width [m].

    Returns
    -------
    size_m : ndarray, (n, 2)
    changed : ndarray, (n,) bool
    """
    repaired = size_m.copy()
    for number, plausible in _PLAUSIBLE.items():
        rows = v_class == number
        for column, (low, high) in enumerate((plausible.length, plausible.width)):
            given = size_m[rows, column]
            value = np.where(given > 0, np.clip(given, low, high), plausible.default[column])
            if number == 1 and column == 1:
                value = np.where(given > high, plausible.default[column], value)
            repaired[rows, column] = value
    return repaired, (repaired != size_m).any(axis=1)


def class_index(v_class: np.ndarray, length_m: np.ndarray) -> np.ndarray:
    """Index into `CLASSES`, (n,) int8, from NGSIM's three classes and the lengths [m]: long autos are vans."""
    to_index = np.zeros(max(NGSIM_CLASSES) + 1, dtype=np.int8)
    for number, name in NGSIM_CLASSES.items():
        to_index[number] = CLASSES.index(name)
    index = to_index[v_class]
    index[(v_class == 2) & (length_m > VAN_LONGER_THAN_M)] = CLASSES.index("van")
    return index


def heights(index: np.ndarray, length_m: np.ndarray, height_m: Mapping[str, float] | None = None) -> np.ndarray:
    """Heights [m], (n,).

    Parameters
    ----------
    index : ndarray, (n,) int
        Index into `CLASSES`.
    length_m : ndarray, (n,)
        Lengths [m]: trucks of `LONG_TRUCK_M` or more are higher.
    height_m : mapping, optional
        Heights [m] that replace those of `HEIGHTS_M`, by its keys.

    Raises
    ------
    InputError
        For an unknown key, or a height that is not a positive number.
    """
    table = {**HEIGHTS_M, **checked_heights(height_m or {})}
    by_index = np.array([table[name] for name in CLASSES])
    result = by_index[index]
    result[(index == CLASSES.index("truck")) & (length_m >= LONG_TRUCK_M)] = table["long_truck"]
    return result


def checked_heights(height_m: Mapping[str, float]) -> dict[str, float]:
    """The same mapping, if its keys are those of `HEIGHTS_M` and its values positive; else an `InputError`."""
    for name, value in height_m.items():
        if name not in HEIGHTS_M:
            raise unknown_name(name, HEIGHTS_M, "vehicle kind", "height_m")
        if isinstance(value, bool) or not isinstance(value, int | float) or not (0 < value < math.inf):
            raise InputError(f"height_m: {name} = {value!r}; a height in metres, more than 0, is needed")
    return dict(height_m)
