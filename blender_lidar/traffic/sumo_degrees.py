"""Telling longitude and latitude, ``sumo --fcd-output.geo``, from metres: no column says which they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .sumo_rows import FcdRows

_MOVED_SHARE = 1e-3  # a degree is 111 km: in degrees the share is 1e-5
_CLOSEST_M = 0.5


def refuse_degrees(rows: FcdRows, source: str) -> None:
    """Refuse longitude and latitude: numbers in their range, between which vehicles get nowhere near their speed.

    Raises
    ------
    InputError
        Saying what SUMO should write instead.
    """
    x, y = np.abs(rows.xy_m).max(axis=0)
    if x > 180 or y > 90:
        return
    if _moves_as_in_degrees(rows):
        raise InputError(
            f"{source}: x and y are longitude and latitude; metres are needed: run SUMO without --fcd-output.geo, "
            "or with --fcd-output.utm"
        )


@dataclass(frozen=True, slots=True)
class _Travel:
    """How far vehicles went by their places and by their speeds, summed."""

    by_places: float
    by_speeds: float


def _moves_as_in_degrees(rows: FcdRows) -> bool:
    travel = _travel(rows)
    if travel.by_speeds > 1.0:
        return 0 < travel.by_places < _MOVED_SHARE * travel.by_speeds
    # Nobody moves, or no speeds: of all vehicles at one moment, no two are then as far apart as cars must be.
    times, counts = np.unique(rows.time_ms, return_counts=True)
    fullest = rows.xy_m[rows.time_ms == times[counts.argmax()]]
    return len(fullest) > 1 and float(np.ptp(fullest, axis=0).max()) < _CLOSEST_M


def _travel(rows: FcdRows) -> _Travel:
    order = np.lexsort((rows.time_ms, rows.id_code))
    same = np.diff(rows.id_code[order]) == 0
    moved = np.hypot(*np.diff(rows.xy_m[order], axis=0).T)[same]
    lasted = np.diff(rows.time_ms[order])[same] / 1000
    by_speed = rows.speed_m_s[order][1:][same] * lasted
    known = np.isfinite(by_speed)
    return _Travel(float(moved[known].sum()), float(by_speed[known].sum()))
