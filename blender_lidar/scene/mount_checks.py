"""Checks of mountings and sensor: angles in radians, tilts away from the road, unusual heights and noise.

Nothing here stops a run but a searched angle that can hardly be degrees; the rest are notes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from ..errors import InputError
from . import usual

if TYPE_CHECKING:
    from .mounting import Deployment
    from .settings import Scenario

_ANGLES = ("tilt_x_deg", "tilt_y_deg", "yaw_deg", "lean_deg", "lean_direction_deg", "spin_deg")
_OF_A_CIRCLE = ("yaw_deg", "lean_direction_deg", "spin_deg")


def in_radians(key: str, ends: tuple[float, ...]) -> tuple[float, ...] | None:
    """The round degrees that an angle's numbers are in radians, None where they are none.

    All are multiples of 5 degrees within the digits that are given, of which one has two decimals or more: a number of
    two decimals is one of these by chance in one case of nine.
    """
    most = math.tau if key in _OF_A_CIRCLE else 0.5 * math.pi
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
    if meant is None or (key in _OF_A_CIRCLE and ends[1] - ends[0] < math.radians(usual.ROUND_DEG)):
        return
    low, high = meant
    raise InputError(
        f"{where}: is [{ends[0]:g}, {ends[1]:g}] degrees; probably radians: [{low:g}, {high:g}] in degrees, the unit "
        "here; to search so narrow an interval give other bounds, such as a hundredth wider"
    )


_USUAL_HEIGHTS = "(usual: 2 to 12, a gantry or a lamp): metres above the road?"


def mount_notes(scenario: Scenario, mount: Mapping[str, float] | None = None) -> Iterator[str]:
    """What is suspicious of mountings and sensor and may be right, as sentences; `mount` is one given by hand."""
    deployment = scenario.deployment
    asked = {"[deployment]": dict(deployment.fixed)} if mount is None else {"the mounting": mount}
    for name, coordinates in {**asked, "[baseline]": scenario.baseline}.items():
        for key in _ANGLES:
            meant = in_radians(key, (coordinates.get(key, 0.0),))
            if meant:
                yield f"{key} of {name} is {coordinates[key]:g} degrees; is that {meant[0]:g} degrees in radians?"
        if coordinates.get("height_m", 0.0) > usual.HIGHEST_M:
            yield f"height_m of {name} is {coordinates['height_m']:g} m {_USUAL_HEIGHTS}"
    places = deployment.places if mount is None else ()
    highest = max([place.bounds["height_m"][1] if "height_m" in place.bounds else 0.0 for place in places], default=0.0)
    if highest > usual.HIGHEST_M:
        yield f"heights up to {highest:g} m are searched {_USUAL_HEIGHTS}"
    noise = scenario.sensor.range_noise_m or 0.0
    if noise > usual.NOISE_M:
        yield f"[sensor] range_noise_m is {noise:g} m (data sheets: 0.01 to 0.05 m): centimetres?"
    away = [place for place in places if _leans_away(place, scenario.road.carriageway_y)]
    if away:
        some = f"on {len(away)} of {len(places)} poles every" if deployment.poles else "every"
        y_m = away[0].nominal_xy[1]
        yield (
            f"{some} searched {deployment.axes[1]} leans away from the carriageway, as at y {y_m:g} m: a positive "
            "tilt_x_deg looks down towards +y; from the left side give negative ones, or yaw_deg = 180"
        )


def _leans_away(place: Deployment, carriageway_y: tuple[float, float]) -> bool:
    """Whether all that is searched leans away from a carriageway on one side: its direction is fixed, its angle not."""
    key = place.axes[1]
    turn = place.fixed.get("yaw_deg" if key == "tilt_x_deg" else "lean_direction_deg")
    low, high = place.bounds.get(key, (0.0, 0.0))
    if turn is None or place.fixed.get("tilt_y_deg", 0.0) or not low * high >= 0.0 or low == high:
        return False
    towards_y = math.cos(math.radians(turn)) * (1.0 if high > 0.0 else -1.0)
    y = place.bounds.get("y_m") or (place.fixed["y_m"],) * 2
    right, left = carriageway_y
    return bool((y[1] <= right and towards_y < -usual.ACROSS) or (y[0] >= left and towards_y > usual.ACROSS))
