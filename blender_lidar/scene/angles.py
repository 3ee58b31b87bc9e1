"""Searched angles: in degrees and not in radians, and each orientation once."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ..errors import InputError
from ..toml_table import TomlTable
from . import usual
from .deployment import LEAN, TURNS
from .mounting import ANGLES


def check_angles(table: TomlTable, searched: Mapping[str, tuple[float, float]]) -> None:
    """Refuse to search angles that say the same orientation in more than one way."""
    for key in searched:
        if key in ANGLES or key in LEAN:
            check_degrees(table.where(key), key, searched[key])
    width = {key: high - low for key, (low, high) in searched.items()}
    for key in ("yaw_deg", *LEAN):
        if width.get(key, 0.0) > 360.0:
            raise InputError(f"{table.where(key)}: is {width[key]:g} degrees wide; allowed: at most 360, a full circle")
    both = [key for key in ANGLES if key in searched]
    instead = "search lean_deg and lean_direction_deg instead, which say each lean once"
    if len(both) == len(ANGLES):
        raise InputError(
            f"{table.name}: {', '.join(both)}: are searched together, but yaw turns one lean into another; {instead}"
        )
    for key in both:
        low, high = searched[key]
        if key != "yaw_deg" and low < 0.0 < high and width.get("yaw_deg", 0.0) > 180.0:
            raise InputError(
                f"{table.where(key)}: is searched on both sides of 0 with more than 180 degrees of yaw_deg, so that "
                f"each lean is there twice; {instead}, or one side of 0"
            )


def in_radians(key: str, ends: tuple[float, ...]) -> tuple[float, ...] | None:
    """The round degrees that an angle's numbers are in radians, None where they are none.

    All are multiples of 5 degrees within the digits that are given, of which one has two decimals or more: a number of
    two decimals is one of these by chance in one case of nine.
    """
    most = math.tau if key in TURNS else 0.5 * math.pi
    decimals = [len(f"{abs(end):.12g}".partition(".")[2]) for end in ends]
    if max(decimals) < usual.DECIMALS:
        return None
    degrees = tuple(usual.ROUND_DEG * round(math.degrees(end) / usual.ROUND_DEG) for end in ends)
    for end, rounded in zip(ends, degrees, strict=True):
        step = 10.0 ** -max(decimals)  # ends are rounded alike: 0.5 beside 0.25 is 0.50
        if abs(end) > most + step or abs(end - math.radians(rounded)) > 0.51 * step:
            return None
    return degrees if any(degrees) else None


def check_degrees(where: str, key: str, ends: tuple[float, float]) -> None:
    """Refuse to search an angle between bounds that are round in radians.

    Raises
    ------
    InputError
        Naming degrees, and how to search such a narrow interval all the same.
    """
    meant = in_radians(key, ends)
    if meant is None or (key in TURNS and ends[1] - ends[0] < math.radians(usual.ROUND_DEG)):
        return
    low, high = meant
    raise InputError(
        f"{where}: is [{ends[0]:g}, {ends[1]:g}] degrees; probably radians: [{low:g}, {high:g}] in degrees, the unit "
        "here; to search so narrow an interval give other bounds, such as a hundredth wider"
    )
