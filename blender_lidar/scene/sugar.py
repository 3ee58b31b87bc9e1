"""Short forms of a scene, resolved: one LiDAR's [sensor] and [deployment], sides of a road, poles, leans, baselines.

There are many ways to say where LiDARs may hang, and one for it to be: a list of `LidarSpec`. Behind this file nobody
asks how it was said.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from ..errors import InputError, shown
from ..names import THE_LIDAR
from ..road.road_map import RoadMap
from ..road.settings import RoadSettings
from ..toml_table import TomlTable
from ..traffic.vehicles import counted
from .angles import check_angles
from .deployment import (
    BASELINE,
    COORDINATE_LIMITS,
    DEPLOYMENT,
    HANGS,
    LEAN,
    MOUNTING,
    MOUNTING_OR_LEAN,
    STAND,
    Deployment,
    Facing,
    Place,
    Pole,
)
from .lidars import LIDAR, LidarSpec, sensor_from
from .mounting import ANGLES, Mounting, has_lean, mast_at, mounting_from
from .poles import each_has_one, free_places, read_poles
from .settings import DECLARED

_MOST = 16
_OF_ONE_PLACE = ("x_m", "y_m", "facing_deg")  # keys of a baseline that cannot be those of several LiDARs
_GANTRY_M, _GANTRY_SPAN_M = 8.0, 3.0  # up to which a gantry is searched unless said, and at least so far
_LIE = {
    "right": "to the right of the road",
    "left": "to the left of the road",
    "median": "in the median",
    "gantry": "over the lanes",
}


@dataclass(frozen=True, slots=True)
class Roadside:
    """What masts stand on: [road] as it is said, its map, and the middle of the region, where that is known [m]."""

    road: RoadSettings
    map: RoadMap
    middle_xy: tuple[float, float] | None = None


def lidars_from(
    tables: Mapping[str, list[TomlTable]],
    of_file: Mapping[str, list[TomlTable]],
    roadside: Roadside,
) -> tuple[LidarSpec, ...]:
    """The LiDARs of a scene: each [[lidar]], or the one of [sensor] and [deployment].

    Parameters
    ----------
    tables, of_file : mapping of str to list of TomlTable
        The scene's tables, and as its file alone has them.
    roadside : Roadside
        What masts stand on.

    Raises
    ------
    MissingFileError, InputError
        Naming the key: two of one name, two on one pole, or what `sensor_from` and `deployment_from` refuse.
    """
    sensor, short, baseline = (tables[name][0] for name in ("sensor", "deployment", "baseline"))
    entries = tables["lidar"]
    if not entries:
        deployment = deployment_from(short, roadside)
        hung = upright_from(baseline, deployment, roadside)
        return (LidarSpec(THE_LIDAR, sensor_from(sensor), deployment, hung, "deployment"),)
    if short.values:
        raise InputError(f"{short.name}: is given beside [[lidar]]; allowed: its keys in each [[lidar]]")
    if len(entries) > _MOST:
        raise InputError(f"{entries[-1].name}: is one of {len(entries)}; allowed: {_MOST} LiDARs at most")
    names, deployments = [], []
    for entry in entries:
        said = entry.read(DECLARED["lidar"])
        if said["name"].casefold() in map(str.casefold, names):  # as files are named by it
            raise InputError(
                f"{entry.where('name')}: is {shown(said['name'])}, as of another LiDAR; allowed: a name for each"
            )
        names.append(said["name"])
        deployments.append(_entry_deployment(entry, said["pole"], roadside))
    sensors = [sensor_from(sensor, entry) for entry in entries]
    _check_places(entries, deployments)
    deployments = _with_installers(of_file["lidar"], deployments)
    _check_aims(entries, deployments)
    baselines = _baselines_from(baseline, entries, deployments, roadside)
    each = enumerate(zip(names, sensors, deployments, baselines, strict=True), start=1)
    return tuple(LidarSpec(*one, f"lidar {number}") for number, one in each)


def deployment_of(tables: Mapping[str, list[TomlTable]], roadside: Roadside) -> Deployment:
    """Where the first LiDAR of a scene may hang, by the scene's tables: its [[lidar]], or [deployment]."""
    if not tables["lidar"]:
        return deployment_from(tables["deployment"][0], roadside)
    entry = tables["lidar"][0]
    return _entry_deployment(entry, entry.read(DECLARED["lidar"])["pole"], roadside)


# --- [deployment]: sides, leans and poles -----------------------------------------------------------------------------


def deployment_from(table: TomlTable, roadside: Roadside) -> Deployment:
    """[deployment]: which coordinates are fixed and which are searched, on one place or on a table of poles.

    Raises
    ------
    MissingFileError, InputError
        Naming the key, or the file of poles.
    """
    found = table.read(DEPLOYMENT | STAND)
    poles, side, clearance_m, installer = (found.pop(key) for key in ("poles", "side", "clearance_m", "installer"))
    given = {key: found[key] for key in DEPLOYMENT if key in table.values}
    if poles is not None and (places := [key for key in ("x_m", "y_m") if key in given]):
        raise InputError(f"{table.name}: has poles and {places[0]}; allowed: a table of places, or one place")
    if roadside.map.facing_of:
        side = _beside_road(table, roadside.road, roadside.map, side, found, given, on_poles=poles is not None)
    elif side not in (None, "gantry"):
        raise InputError(f"{table.where('side')}: is {side!r}, a side of a straight road; allowed on a map: gantry")
    elif poles is None and not {"x_m", "y_m"} <= given.keys():
        raise InputError(f"{table.name}: does not say where the mast stands; allowed on a map: x_m and y_m, or poles")
    facing = _facing(found.pop("facing_deg"), side, roadside)
    if has_lean(given, table.name):
        kept = {key: found[key] for key in DEPLOYMENT if key in found and key not in ANGLES}
        found = kept | dict.fromkeys(LEAN, 0.0) | {key: value for key, value in given.items() if key in found}
    else:
        found = {key: found[key] for key in MOUNTING if key in found}
    least = clearance_m if side == "gantry" else 0.0
    if "height_m" not in given and least:
        found["height_m"] = (least, max(least + _GANTRY_SPAN_M, _GANTRY_M))
    searched = {key: found[key] for key in DEPLOYMENT if isinstance(found.get(key), tuple)}
    check_angles(table, searched)
    fixed = {key: value for key, value in found.items() if key not in searched}
    place = Place(fixed, searched, facing, roadside.map)
    deployment = Deployment((place,), facing, installer, side, clearance_m)
    if poles is None:
        return deployment
    stands = read_poles(poles)
    for pole in stands:
        _check_pole(pole, f"{poles}: pole {pole.name!r}", deployment, table.where("height_m"))
    shared = {key: value for key, value in {**fixed, **searched}.items() if key not in ("x_m", "y_m")}
    return replace(deployment, places=tuple(on_pole(place, pole) for pole in stands), poles_file=poles, shared=shared)


def _beside_road(
    table: TomlTable,
    road: RoadSettings,
    road_map: RoadMap,
    side: str | None,
    found: dict[str, object],
    given: Mapping[str, object],
    *,
    on_poles: bool,
) -> str | None:
    """The side of a road with sides on which the mast stands, where it is said or follows; its y goes into `found`."""
    if side == "median" and not road.median_m:
        raise InputError(
            f"{table.where('side')}: is a median, but [road] has none; allowed: with [road] carriageways = 2 and "
            "median_m above 0"
        )
    if on_poles:
        return side
    if "y_m" in given:
        ends = (found[key] if isinstance(found[key], tuple) else (found[key],) for key in ("x_m", "y_m"))
        there = sorted(set(map(road_map.side_of, itertools.product(*ends))))
        if side is None and road.faced_from_any_side and len(there) == 1 and there[0] != "gantry":
            side = there[0]
        _check_side(table.where("y_m"), there, side)
        return side
    if side is None and road.faced_from_any_side:
        side = road.drives_on
    found["y_m"] = round(road.place(side or road.drives_on)[0], 6)
    return side


def _facing(angle_deg: float | None, side: str | None, roadside: Roadside) -> Facing:
    """Which way masts face: as said; on a map towards the middle of the region; else the road from where they stand.

    Beside one carriageway on which vehicles drive on the right all face +y, or as on the side that is said.
    """
    if angle_deg is not None:
        return Facing(angle_deg)
    if not roadside.map.facing_of:
        return Facing(towards_m=roadside.middle_xy)
    if roadside.road.faced_from_any_side:
        return Facing()
    return Facing(math.degrees(roadside.road.place(side or roadside.road.drives_on)[1]))


def _check_side(where: str, there: Sequence[str], side: str | None) -> None:
    """Refuse places that do not lie on the side of the road that a scene names; beside a gantry they may."""
    if side not in (None, "gantry") and set(there) != {side}:
        lie = " and ".join(_LIE[one] for one in there)
        raise InputError(f"{where}: lies {lie}; allowed: {_LIE[side]}, as side says")


def on_pole(place: Place, pole: Pole) -> Place:
    """The same on a pole: where that stands, and at heights above its foot, its own or those of [deployment]."""
    own = pole.height_min_m, pole.height_max_m
    low, high = (
        pole.foot_z_m + (usual if end is None else end) for usual, end in zip(place.span("height_m"), own, strict=True)
    )
    fixed = {**place.fixed, "x_m": pole.x_m, "y_m": pole.y_m, "height_m": low}
    bounds = {**place.bounds, "height_m": (low, high)}
    (bounds if low == high else fixed).pop("height_m")
    bounds = {key: bounds[key] for key in MOUNTING_OR_LEAN if key in bounds}
    facing = place.facing if pole.facing_deg is None else Facing(pole.facing_deg)
    return Place(fixed, bounds, facing, place.road, pole)


def _check_pole(pole: Pole, named: str, deployment: Deployment, where: str) -> None:
    """Refuse a pole on another side than a scene names, and heights that no LiDAR hangs at; `where` is height_m."""
    (place,) = deployment.places
    if place.road.facing_of:
        _check_side(named, [place.road.side_of((pole.x_m, pole.y_m))], deployment.side)
    if "height_m" in place.fixed and (pole.height_min_m is None) != (pole.height_max_m is None):
        raise InputError(f"{named}: has one end of its heights, and {where} none")
    (low, high), limits = on_pole(place, pole).span("height_m"), COORDINATE_LIMITS["height_m"]
    if not limits[0] <= low <= high <= limits[1]:
        raise InputError(
            f"{named}: its heights are {low:g} to {high:g} m above the road; allowed: {limits[0]:g} to "
            f"{limits[1]:g} m, the lower first"
        )


# --- [baseline] -------------------------------------------------------------------------------------------------------


def upright_from(table: TomlTable, deployment: Deployment, roadside: Roadside) -> Mounting:
    """[baseline], upright unless said: at the mount's own place where that is fixed; else where nothing moves it.

    On a map that is the pole nearest to the region's middle, or the middle between the bounds.
    """
    first, middle = deployment.places[0], roadside.middle_xy
    if roadside.map.facing_of:
        fixed = {} if deployment.poles_file else first.fixed
        xy = fixed.get("x_m", middle[0]), fixed.get("y_m")
        if xy[1] is None:
            xy = xy[0], roadside.road.place(deployment.side or roadside.road.drives_on)[0]
    elif deployment.poles:
        xy = min((place.xy for place in deployment.places), key=lambda place: math.dist(place, middle))
    else:
        xy = deployment.nominal_xy
    return _baseline_at(table, xy, deployment, roadside)


def _baseline_at(
    table: TomlTable, xy: tuple[float, float], deployment: Deployment, roadside: Roadside, facing: Facing | None = None
) -> Mounting:
    """The mounting of a table [baseline] at a place [m] unless it says another."""
    given = {key: value for key, value in table.read(BASELINE).items() if key in table.values}
    given.pop("installer", None)
    there = given.get("x_m", xy[0]), given.get("y_m", xy[1])
    turn = math.radians((facing or deployment.facing).at(there, roadside.map))
    height_m = max(MOUNTING["height_m"].default, deployment.clearance_m if deployment.is_gantry else 0.0)
    return mounting_from(given, roadside.map, Mounting(mast_at(roadside.map, *xy, turn), height_m), table.name)


def _baselines_from(
    table: TomlTable, entries: Sequence[TomlTable], deployments: Sequence[Deployment], roadside: Roadside
) -> list[Mounting]:
    """The baseline of each [[lidar]]: its own keys, else those of [baseline], at its own place.

    That is in the middle between its bounds. LiDARs that choose among poles have theirs on different ones: each on the
    free pole nearest to the region's middle. One that hangs already, beside others that are searched, stays as it is.
    """
    if len(entries) > 1 and (place := next((key for key in _OF_ONE_PLACE if key in table.values), None)):
        raise InputError(
            f"{table.where(place)}: cannot be that of {len(entries)} LiDARs; allowed: in the baseline of a [[lidar]]"
        )
    all_held, found = all(one.is_held for one in deployments), []
    for number, (entry, deployment) in enumerate(zip(entries, deployments, strict=True)):
        given = entry.table("baseline")
        if deployment.is_held and not all_held and not given.values:
            found.append(deployment.places[0].mounting([]))
            continue
        rivals = {rival for key in given.values if key in MOUNTING_OR_LEAN for rival in MOUNTING_OR_LEAN[key].rivals}
        shared = {key: value for key, value in table.values.items() if key not in rivals}
        both = TomlTable({**shared, **given.values}, given.name, given.origins, given.folder)
        xy, facing = deployment.nominal_xy, None
        if deployment.poles:
            free = free_places(deployments, number, {k: one.xy for k, one in enumerate(found)})
            nearest = min(free, key=lambda place: math.dist(place.xy, roadside.middle_xy))
            xy, facing = nearest.xy, nearest.facing
        found.append(_baseline_at(both, xy, deployment, roadside, facing))
    return found


# --- [[lidar]] --------------------------------------------------------------------------------------------------------


def _entry_deployment(entry: TomlTable, pole: str | None, roadside: Roadside) -> Deployment:
    """Where a [[lidar]] may hang: what [deployment] would say, on the one pole that it names."""
    stand = {key: value for key, value in entry.values.items() if key not in LIDAR}
    deployment = deployment_from(TomlTable(stand, entry.name, entry.origins, entry.folder, entry.called), roadside)
    if pole is None:
        return deployment
    return replace(deployment, places=(deployment.on_pole(pole, entry.where("pole")),))


def _with_installers(of_file: Sequence[TomlTable], deployments: Sequence[Deployment]) -> list[Deployment]:
    """The same, of which those that hang already beside others that are searched have no installation errors.

    Unless their own [[lidar]] of the scene file says some: an option, which is of all, does not hang them anew.
    """
    if all(one.is_held for one in deployments):
        return list(deployments)
    usual = {"installer": replace(STAND["installer"], default=HANGS)}
    return [
        replace(one, installer=table.some(usual)["installer"]) if one.is_held else one
        for one, table in zip(deployments, of_file, strict=True)
    ]


def _check_aims(entries: Sequence[TomlTable], deployments: Sequence[Deployment]) -> None:
    """Refuse LiDARs of a layout that aim at different things: it is searched as one."""
    aims = {one.installer.aim for one in deployments if not one.installer.is_exact}
    if len(aims) > 1:
        raise InputError(f"{entries[0].where('installer')}: aims are {' and '.join(sorted(aims))}; allowed: one")


def _check_places(entries: Sequence[TomlTable], deployments: Sequence[Deployment]) -> None:
    """Refuse a LiDAR on a pole of another one, and fewer candidate poles than LiDARs that are to be put on them."""
    taken: dict[tuple[float, float], TomlTable] = {}
    for table, deployment in zip(entries, deployments, strict=True):
        pole, xy = table.values.get("pole"), deployment.places[0].xy
        if (deployment.poles and not pole) or xy is None:
            continue
        if xy in taken and (pole or taken[xy].values.get("pole")):
            asked = f"{table.where('pole')}: is {shown(pole)}" if pole else f"{table.where('x_m, y_m')}: is {list(xy)}"
            raise InputError(f"{asked}, as of {taken[xy].name}; allowed: a pole each")
        taken[xy] = table
    choosing = [row for row, one in enumerate(deployments) if one.poles and "pole" not in entries[row].values]
    choices = [[place.xy for place in deployments[row].places if place.xy not in taken] for row in choosing]
    if not each_has_one(choices):
        free = len({xy for one in choices for xy in one})
        raise InputError(
            f"{entries[choosing[0]].where('poles')}: {counted(len(choosing), 'LiDAR')} cannot each have a pole of "
            f"their own among the {free} that no other has; allowed: a pole for each"
        )
