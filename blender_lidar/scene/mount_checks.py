"""Checks of mountings and sensor: angles in radians, tilts away from the road, unusual heights and noise.

Nothing here stops a run but a searched angle that can hardly be degrees; the rest are notes.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from ..errors import InputError
from . import usual
from .deployment import Place
from .mounting import Mounting
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


_LEVEL = 1e-6  # sine of a lean
_USUAL_HEIGHTS = "(usual: 2 to 12, a gantry or a lamp): metres above the road?"


def mount_notes(scenario: Scenario, given: Sequence[Mounting] = ()) -> Iterator[str]:
    """What is suspicious of mountings and sensor and may be right, as sentences; `given` are those given by hand."""
    deployment = scenario.deployment
    asked = [("the mounting", one.as_table()) for one in given] or [("[deployment]", deployment.fixed)]
    for name, table in (*asked, ("[baseline]", scenario.baseline.as_table())):
        for key in _ANGLES[:3] if "tilt_x_deg" in table else _ANGLES[3:]:
            meant = in_radians(key, (table.get(key) or 0.0,))
            if meant:
                yield f"{key} of {name} is {table[key]:g} degrees; is that {meant[0]:g} degrees in radians?"
        if table.get("height_m", 0.0) > usual.HIGHEST_M:
            yield f"height_m of {name} is {table['height_m']:g} m {_USUAL_HEIGHTS}"
    places = () if given else deployment.places
    highest = max([place.span("height_m")[1] for place in places if "height_m" in place.bounds], default=0.0)
    if highest > usual.HIGHEST_M:
        yield f"heights up to {highest:g} m are searched {_USUAL_HEIGHTS}"
    noise = scenario.sensor.range_noise_m or 0.0
    if noise > usual.NOISE_M:
        yield f"[sensor] range_noise_m is {noise:g} m (data sheets: 0.01 to 0.05 m): centimetres?"
    away = [place for place in places if _looks_away(place, scenario)]
    if away:
        some = f"on {len(away)} of {len(places)} poles every" if deployment.poles else "every"
        x_m, y_m = away[0].mounting([low for low, _ in away[0].bounds.values()]).xy
        yield (
            f"{some} mounting that is searched looks down away from the road, as at x {x_m:g}, y {y_m:g} m: a "
            "positive tilt_x_deg looks down to where the mast faces, a negative one behind it"
        )


def _looks_away(place: Place, scenario: Scenario) -> bool:
    """Whether all that is searched looks down on the side of the mast on which there is no lane."""
    road, leans = scenario.road_map, []
    for mounting in map(place.mounting, itertools.product(*place.bounds.values())):
        down = mounting.pose.rotation[2, :2]  # the sensor looks down to where its upright axis leans
        towards = road.nearest(mounting.xy) - mounting.xy
        length = np.hypot(*down) * np.hypot(*towards.T)
        if np.hypot(*down) > _LEVEL and length.all():
            leans.append((towards @ down / length).max())
    return bool(leans) and max(leans) < -usual.AWAY
