"""Places where LiDARs may hang: reading [deployment], the table of candidate poles and [baseline]."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..csv_tables import Column, laid_out, read_whole
from ..errors import InputError, shown
from ..road.mapped import Road
from ..road.road_map import RoadMap
from ..road.straight import StraightRoad
from ..toml_table import TomlTable
from . import usual
from .deployment import (
    BASELINE,
    COORDINATE_LIMITS,
    DEPLOYMENT,
    LEAN,
    MOUNTING,
    STAND,
    TURNS,
    Deployment,
    Pole,
)
from .mounting import ANGLES, Mounting, has_lean, mast_at, mounting_from
from .region import region_of
from .settings import RegionSettings

_GANTRY_M, _GANTRY_SPAN_M = 8.0, 3.0  # up to which a gantry is searched unless said, and at least so far
_LIE = {
    "right": "to the right of the road",
    "left": "to the left of the road",
    "median": "in the median",
    "gantry": "over the lanes",
}


def _stand(table: TomlTable, road: StraightRoad, found: dict[str, object], given: Mapping[str, object]) -> str | None:
    """The side of the road that the mast stands on, where it is said or follows; place and facing go into `found`."""
    side, poles = found.pop("side"), found.pop("poles")
    if side == "median" and not road.median_m:
        raise InputError(
            f"{table.where('side')}: is a median, but [road] has none; allowed: with [road] carriageways = 2 and "
            "median_m above 0"
        )
    if "y_m" in given and not poles:
        ends = (found[key] if isinstance(found[key], tuple) else (found[key],) for key in ("x_m", "y_m"))
        there = sorted(set(map(road.side_of, itertools.product(*ends))))
        if side is None and road.faced_from_any_side and len(there) == 1 and there[0] != "gantry":
            side = there[0]
        _check_side(table.where("y_m"), there, side)
    elif side is None and not poles and road.faced_from_any_side:
        side = road.drives_on
    y_m, facing = road.place(side or road.drives_on)
    if "y_m" not in given and not poles:
        found["y_m"] = round(y_m, 6)
    if found["facing_deg"] is None:
        found["facing_deg"] = math.degrees(facing)
    return side


def _stand_on_map(table: TomlTable, found: dict[str, object], given: Mapping[str, object]) -> str | None:
    """The same on a map, which has no sides: the place is said, and masts face the region's middle unless said."""
    side, poles = found.pop("side"), found.pop("poles")
    if side not in (None, "gantry"):
        raise InputError(f"{table.where('side')}: is {side!r}, a side of a straight road; allowed on a map: gantry")
    if not poles and not {"x_m", "y_m"} <= given.keys():
        raise InputError(f"{table.name}: does not say where the mast stands; allowed on a map: x_m and y_m, or poles")
    if found["facing_deg"] is None:
        del found["facing_deg"]
    return side


def _check_side(where: str, there: Sequence[str], side: str | None) -> None:
    """Refuse places that do not lie on the side of the road that a scene names; beside a gantry they may."""
    if side not in (None, "gantry") and set(there) != {side}:
        lie = " and ".join(_LIE[one] for one in there)
        raise InputError(f"{where}: lies {lie}; allowed: {_LIE[side]}, as side says")


def deployment_from(table: TomlTable, road: Road, road_map: RoadMap) -> Deployment:
    """[deployment]: which coordinates are fixed and which are searched, on one place or on a table of poles.

    `road_map` is that of the road.

    Raises
    ------
    MissingFileError, InputError
        Naming the key, or the file of poles.
    """
    found = table.read(DEPLOYMENT | STAND)
    poles, clearance_m, installer = found["poles"], found.pop("clearance_m"), found.pop("installer")
    given = {key: found[key] for key in DEPLOYMENT if key in table.values}
    straight = isinstance(road, StraightRoad)
    side = _stand(table, road, found, given) if straight else _stand_on_map(table, found, given)
    if has_lean(given, table.name):
        found = (
            {key: found[key] for key in DEPLOYMENT if key in found and key not in ANGLES}
            | dict.fromkeys(LEAN, 0.0)
            | given
        )
    else:
        found = {key: found[key] for key in MOUNTING if key in found}
    least = clearance_m if side == "gantry" else 0.0
    if "height_m" not in given and least:
        found["height_m"] = (least, max(least + _GANTRY_SPAN_M, _GANTRY_M))
    searched = {key: found[key] for key in DEPLOYMENT if isinstance(found.get(key), tuple)}
    _check_angles(table, searched)
    fixed = {key: value for key, value in found.items() if key not in searched}
    faces_road = "facing_deg" not in given and (not straight or road.faced_from_any_side)
    deployment = Deployment(fixed, searched, (), None, road, side, clearance_m, faces_road, road_map, None, installer)
    if poles is None:
        return deployment
    if places := [key for key in ("x_m", "y_m") if key in given]:
        raise InputError(f"{table.name}: has poles and {places[0]}; allowed: a table of places, or one place")
    deployment = replace(deployment, poles=read_poles(poles), poles_file=poles)
    _check_poles(deployment, table.where("height_m"))
    return deployment


def _check_poles(deployment: Deployment, where: str) -> None:
    """Refuse poles on another side than a scene names, and heights that no LiDAR hangs at; `where` is height_m."""
    for pole in deployment.poles:
        named = f"{deployment.poles_file}: pole {pole.name!r}"
        if isinstance(deployment.road, StraightRoad):
            _check_side(named, [deployment.road.side_of((pole.x_m, pole.y_m))], deployment.side)
        if "height_m" in deployment.fixed and (pole.height_min_m is None) != (pole.height_max_m is None):
            raise InputError(f"{named}: has one end of its heights, and {where} none")
        (low, high), limits = deployment.at(pole).span("height_m"), COORDINATE_LIMITS["height_m"]
        if not limits[0] <= low <= high <= limits[1]:
            raise InputError(
                f"{named}: its heights are {low:g} to {high:g} m above the road; allowed: {limits[0]:g} to "
                f"{limits[1]:g} m, the lower first"
            )


def baseline_from(table: TomlTable, deployment: Deployment, region: RegionSettings) -> Mounting:
    """[baseline]: at the mount's own place where that is fixed; else where no bound and no pole moves it.

    On a map that is the pole nearest to the region's middle, or the middle between the bounds.
    """
    road, place = deployment.road_map, {} if deployment.poles else deployment.fixed
    x_m, middle = place.get("x_m"), region_of(region, road).centre_xy
    if isinstance(deployment.road, StraightRoad):
        x_m = middle[0] if x_m is None else x_m
        y_m = place.get("y_m", deployment.road.place(deployment.side or deployment.road.drives_on)[0])
    elif deployment.poles:
        nearest = min(deployment.poles, key=lambda pole: math.dist((pole.x_m, pole.y_m), middle))
        x_m, y_m = nearest.x_m, nearest.y_m
    else:
        x_m, y_m = deployment.nominal_xy
    given = {key: value for key, value in table.read(BASELINE).items() if key in table.values}
    given.pop("installer", None)
    facing_deg = deployment.facing_at((given.get("x_m", x_m), given.get("y_m", y_m)))
    mast = mast_at(road, x_m, y_m, math.radians(facing_deg))
    upright = Mounting(mast, max(MOUNTING["height_m"].default, deployment.least_height_m))
    return mounting_from(given, road, upright, table.name)


# --- Angles: in degrees, and each orientation once --------------------------------------------------------------------


def _check_angles(table: TomlTable, searched: Mapping[str, tuple[float, float]]) -> None:
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


# --- The table of candidate poles -------------------------------------------------------------------------------------

_NEEDED = ("name", "x_m", "y_m")
_OPTIONAL = ("foot_z_m", "height_min_m", "height_max_m", "cost", "existing", "facing_deg")
_PLACE = Column("a number, -100000 to 100000", *COORDINATE_LIMITS["x_m"])
_HEIGHT = Column("0 to 100", 0.0, 100.0, optional=True)
_NUMBERS = {
    "x_m": _PLACE,
    "y_m": _PLACE,
    "foot_z_m": Column("-100 to 100", -100.0, 100.0, optional=True),
    "height_min_m": _HEIGHT,
    "height_max_m": _HEIGHT,
    "cost": Column("a number", optional=True),
    "facing_deg": Column("-360 to 360", -360.0, 360.0, optional=True),
}
_EXISTS = {"yes": True, "true": True, "1": True, "no": False, "false": False, "0": False, "": None}
_MOST = 1000
_NEAREST_M = 0.05


def read_poles(path: str | Path) -> tuple[Pole, ...]:
    """Read a table of candidate poles, with a header: name, x_m and y_m, and further columns as far as there are any.

    Raises
    ------
    MissingFileError, InputError
        When the file cannot be used; the text names the line and the column.
    """
    layout = laid_out(path, _NEEDED, _OPTIONAL)
    poles: dict[str, Pole] = {}
    rows = read_whole(path, layout, _NUMBERS, ["name", "existing"])
    for row in range(len(rows)):
        where, cells = rows.where(row), {key: column[row] for key, column in rows.columns.items()}
        values = {key: None if np.isnan(cells[key]) else float(cells[key]) for key in cells if key in _NUMBERS}
        pole = _pole(where, values, {key: cells[key].strip() for key in cells if key not in _NUMBERS})
        if pole.name in poles:
            raise InputError(f"{where}: name is {shown(pole.name)}, as in a line before; allowed: each pole once")
        poles[pole.name] = pole
    if not poles or len(poles) > _MOST:
        raise InputError(f"{path}: has {len(poles)} poles; allowed: 1 to {_MOST}")
    places = np.array([(pole.x_m, pole.y_m) for pole in poles.values()])
    if 0.0 < np.hypot(*np.ptp(places, axis=0)) < _NEAREST_M:
        raise InputError(
            f"{path}: all {len(poles)} poles stand within {_NEAREST_M:g} m, about x_m {places[0, 0]:g} and y_m "
            f"{places[0, 1]:g}; probably degrees of longitude and latitude; allowed: metres in the road frame"
        )
    return tuple(poles.values())


def _pole(where: str, values: Mapping[str, float | None], texts: Mapping[str, str]) -> Pole:
    existing = texts.get("existing", "").lower()
    if not texts["name"]:
        raise InputError(f"{where}: name is nothing; allowed: what the pole is called")
    if existing not in _EXISTS:
        raise InputError(f"{where}: existing is {shown(existing)}; allowed: yes, no or nothing")
    low, high = values.get("height_min_m"), values.get("height_max_m")
    if low is not None and high is not None and low > high:
        raise InputError(
            f"{where}: height_min_m is {low:g}, height_max_m {high:g}; allowed: the first at most the second"
        )
    values = {key: value for key, value in values.items() if value is not None}
    return Pole(texts["name"], existing=_EXISTS[existing], **values)
