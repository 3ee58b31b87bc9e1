"""[sensor] and [[lidar]]: what hangs, where each LiDAR may hang, and each one's baseline."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from ..errors import InputError, MissingFileError, shown
from ..road.mapped import Road
from ..road.road_map import RoadMap
from ..sensors.model import LidarModel, load_model, unit_of, with_columns
from ..toml_table import TomlTable, checked, setting, settings_of
from ..traffic.vehicles import counted
from .deployment import DEPLOYMENT, HANGS, MOUNTING_OR_LEAN, STAND, Deployment, Place
from .mounting import Mounting
from .places import baseline_from, deployment_from
from .region import region_of
from .settings import DATASHEET, DECLARED, RegionSettings, SensorSettings, is_sensor_file

OF_ANY_MODEL = ("name", "unit", "noise_seed")  # keys of [sensor] that a single model's table within it has not
_MOST = 16
_OF_ONE_PLACE = ("x_m", "y_m", "facing_deg")  # keys of a baseline that cannot be those of several LiDARs


@dataclass(frozen=True, slots=True)
class HungLidar:
    """A LiDAR of a scene: its sensor, where it may hang, and what it is compared with.

    Attributes
    ----------
    name : str
        What tells it from the others, in the draws of its noise too; "" is the one of [sensor] and [deployment].
    sensor : SensorSettings
    deployment : Deployment
    baseline : Mounting
    """

    name: str
    sensor: SensorSettings
    deployment: Deployment
    baseline: Mounting

    @property
    def is_held(self) -> bool:
        """Whether it hangs already: it has one place and nothing to be searched."""
        return _held([self.deployment])[0]

    def as_table(self) -> dict[str, object]:
        """The entry of [[lidar]] that it is, spelt out."""
        poles = self.deployment.poles
        pole = poles[0].name if len(poles) == 1 else None
        return {"name": self.name, "sensor": self.sensor.name, "pole": pole, **self.deployment.as_table()}


# --- [sensor] ---------------------------------------------------------------------------------------------------------


def sensor_from(table: TomlTable, own: TomlTable | None = None) -> SensorSettings:
    """[sensor], and the table of the chosen model within it, whose keys count over the general ones.

    `own` is the [[lidar]] whose `sensor` is the model, where it says one and no option does.

    Raises
    ------
    MissingFileError, InputError
        Naming the key.
    """
    declared = DECLARED["sensor"]
    if own is not None and own.values.get("sensor") is not None and "name" not in table.origins:
        name = own.values["sensor"]
        name = own.path("sensor", name) if is_sensor_file(name) else name
        values, origins = {**table.values, "name": name}, {**table.origins, "name": own.where("sensor")}
        table = TomlTable(values, table.name, origins, table.folder, table.called)
    of_models = {key: table.table(key) for key, value in table.values.items() if isinstance(value, Mapping)}
    general = {key: value for key, value in table.values.items() if key not in of_models}
    table = TomlTable(general, table.name, table.origins, table.folder, table.called)
    name, model = _model_named(table, "name", table.read(declared)["name"])
    alike = []
    for key, one in of_models.items():
        one.read({key: setting for key, setting in declared.items() if key not in OF_ANY_MODEL})
        as_named, other = _model_named(table, key, key)
        if other.name == model.name:  # beside a model there may be a file of that name
            is_it = as_named == name if is_sensor_file(name) else not is_sensor_file(as_named)
            alike.append((not is_it, len(alike), one))
    for _, _, one in sorted(alike)[:1]:
        kept = {key: value for key, value in one.values.items() if key not in table.origins}
        origins = {key: one.where(key) for key in kept} | table.origins
        table = TomlTable({**general, **kept}, table.name, origins, table.folder, table.called)
    found = table.read(declared)
    for key in ("range_noise_m", "range_at_10_percent_m"):
        if found[key] == DATASHEET:
            found[key] = getattr(model, key)
            if found[key] is None:
                raise InputError(f"{table.where(key)}: no source gives that of {model.name}; allowed: a number")
            checked(found[key], declared[key], f"{table.where(key)}: {model.name}")
    found["range_gate_m"] = gate = found["range_gate_m"] or model.range_max_m
    if not model.range_min_m < gate <= model.range_max_m:
        allowed = f"more than {model.range_min_m:g}, at most {model.range_max_m:g}"
        raise InputError(f"{table.where('range_gate_m')}: is {gate}; allowed for {model.name}: {allowed}")
    key = "columns"
    try:
        model = with_columns(model, found[key])
        found[key], key = model.default_columns, "rotation_hz"
        found[key] = model.rotation_rate(found[key])
        key = "unit_spread_deg"
        unit_of(model, found[key], found["unit"])
    except InputError as error:
        raise InputError(f"{table.where(key)}: {error}") from error
    return SensorSettings(**found | {"name": name if is_sensor_file(name) else model.name})


def _model_named(table: TomlTable, key: str, name: str) -> tuple[str, LidarModel]:
    """The model that `key` names, by its name or the path of a beam table, and that name or path."""
    name = table.path(key, name) if is_sensor_file(name) else name
    try:
        return name, load_model(name)
    except (MissingFileError, InputError) as error:
        raise type(error)(f"{table.where(key)}: {error}") from error


# --- [[lidar]] --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class LidarSettings:
    """An entry of [[lidar]]: besides these it has the keys of [deployment], which say where it hangs.

    Attributes
    ----------
    name : str
        What it is called: letters, digits, _ and -. The draws of its noise depend on it, and not on its neighbours.
    sensor : str or None
        Sensor model, or path of a beam table; by default that of [sensor], whose other keys hold for all.
    pole : str or None
        The pole of the table of poles on which it hangs; without it one is chosen.
    baseline : mapping
        The mounting that it is compared with: keys as of [baseline], which hold for all that say nothing else.
    """

    name: str = setting(fits=lambda name: bool(re.fullmatch(r"[\w-]+", name)), form="letters, digits, _ and -")
    sensor: str | None = setting(None)
    pole: str | None = setting(None)
    baseline: Mapping[str, float] = setting(allowed=MOUNTING_OR_LEAN)


LIDAR = settings_of(LidarSettings)
DECLARED["lidar"] = LIDAR | DEPLOYMENT | STAND


def deployments_from(
    tables: Sequence[TomlTable], sensor: TomlTable, road: Road, road_map: RoadMap
) -> list[tuple[str, SensorSettings, Deployment]]:
    """Name, sensor and places of each [[lidar]].

    Raises
    ------
    MissingFileError, InputError
        Naming the entry: two of one name, two on one pole, or what `sensor_from` and `deployment_from` refuse.
    """
    if len(tables) > _MOST:
        raise InputError(f"{tables[-1].name}: is one of {len(tables)}; allowed: {_MOST} LiDARs at most")
    found: list[tuple[str, SensorSettings, Deployment]] = []
    for table in tables:
        said = table.read(DECLARED["lidar"])
        name, pole = said["name"], said["pole"]
        if name.casefold() in (other.casefold() for other, *_ in found):  # as files are named by it
            raise InputError(f"{table.where('name')}: is {shown(name)}, as of another LiDAR; allowed: a name for each")
        stand = {key: value for key, value in table.values.items() if key not in LIDAR}
        stand = TomlTable(stand, table.name, table.origins, table.folder, table.called)
        deployment = deployment_from(stand, road, road_map)
        if pole is not None:
            deployment = replace(deployment, poles=(deployment.pole_named(pole, table.where("pole")),))
        found.append((name, sensor_from(sensor, table), deployment))
    _check_places(tables, [deployment for *_, deployment in found])
    return found


def with_installers(of_file: Sequence[TomlTable], deployments: Sequence[Deployment]) -> list[Deployment]:
    """The same, of which those that hang already beside others that are searched have no installation errors.

    Unless their own [[lidar]] of the scene file says some: an option, which is of all, does not hang them anew.
    """
    held = _held(deployments)
    if all(held):
        return list(deployments)
    usual = {"installer": replace(STAND["installer"], default=HANGS)}
    return [
        replace(one, installer=table.some(usual)["installer"]) if is_held else one
        for one, is_held, table in zip(deployments, held, of_file, strict=True)
    ]


def check_aims(tables: Sequence[TomlTable], lidars: Sequence[HungLidar]) -> None:
    """Refuse LiDARs of a layout that aim at different things: it is searched as one."""
    aims = [one.deployment.installer.aim for one in lidars if not one.deployment.installer.is_exact]
    if len(set(aims)) > 1:
        raise InputError(f"{tables[0].where('installer')}: aims are {' and '.join(sorted(set(aims)))}; allowed: one")


def _held(deployments: Sequence[Deployment]) -> list[bool]:
    """Which LiDARs have one place and nothing to be searched."""
    return [len(one.places) == 1 and not one.places[0].bounds for one in deployments]


def _check_places(tables: Sequence[TomlTable], deployments: Sequence[Deployment]) -> None:
    """Refuse a LiDAR on a pole of another one, and fewer candidate poles than LiDARs that are to be put on them."""
    taken: dict[tuple[float, float], TomlTable] = {}
    for table, deployment in zip(tables, deployments, strict=True):
        pole, fixed = table.values.get("pole"), deployment.places[0].fixed
        if (deployment.poles and not pole) or not {"x_m", "y_m"} <= fixed.keys():
            continue
        xy = fixed["x_m"], fixed["y_m"]
        if xy in taken and (pole or taken[xy].values.get("pole")):
            asked = f"{table.where('pole')}: is {shown(pole)}" if pole else f"{table.where('x_m, y_m')}: is {list(xy)}"
            raise InputError(f"{asked}, as of {taken[xy].name}; allowed: a pole each")
        taken[xy] = table
    choosing = [row for row, one in enumerate(deployments) if one.poles and "pole" not in tables[row].values]
    choices = [[place.xy for place in deployments[row].places if place.xy not in taken] for row in choosing]
    if not each_has_one(choices):
        free = len({xy for one in choices for xy in one})
        raise InputError(
            f"{tables[choosing[0]].where('poles')}: {counted(len(choosing), 'LiDAR')} cannot each have a pole of their "
            f"own among the {free} that no other has; allowed: a pole for each"
        )


def each_has_one(choices: Sequence[Iterable[Hashable]]) -> bool:
    """Bipartite matching by augmenting paths (Kuhn): whether each can have one of its choices, none of them twice."""
    holder: dict[Hashable, int] = {}

    def has(number: int, seen: set[Hashable]) -> bool:
        for one in choices[number]:
            if one not in seen:
                seen.add(one)
                if one not in holder or has(holder[one], seen):
                    holder[one] = number
                    return True
        return False

    return all(has(number, set()) for number in range(len(choices)))


def free_places(lidars: Sequence[Deployment], number: int, hung: Mapping[int, tuple[float, float]]) -> list[Place]:
    """The places of a LiDAR that leave one to each of the others, of which some are `hung` at x, y already [m]."""
    single = {k: one.places[0].xy for k, one in enumerate(lidars) if len(one.places) == 1}
    taken = {xy for k, xy in {**single, **hung}.items() if k != number}
    rest = [one for k, one in enumerate(lidars) if k != number and k not in hung and len(one.places) > 1]
    choices = [{place.xy for place in one.places} - taken for one in rest]
    return [
        place
        for place in lidars[number].places
        if place.pole is None or (place.xy not in taken and each_has_one([choice - {place.xy} for choice in choices]))
    ]


def baselines_from(
    table: TomlTable, tables: Sequence[TomlTable], deployments: Sequence[Deployment], region: RegionSettings
) -> list[Mounting]:
    """The baseline of each [[lidar]]: its own keys, else those of [baseline], at its own place.

    That is in the middle between its bounds. LiDARs that choose among poles have theirs on different ones: each on the
    free pole nearest to the region's middle. One that hangs already, beside others that are searched, stays as it is.
    """
    if len(tables) > 1 and (place := next((key for key in _OF_ONE_PLACE if key in table.values), None)):
        raise InputError(
            f"{table.where(place)}: cannot be that of {len(tables)} LiDARs; allowed: in the baseline of a [[lidar]]"
        )
    middle, found = region_of(region, deployments[0].road_map).centre_xy, []
    held = _held(deployments)
    for number, (own, deployment) in enumerate(zip(tables, deployments, strict=True)):
        given = own.table("baseline")
        if held[number] and not all(held) and not given.values:
            found.append(deployment.places[0].mounting([]))
            continue
        rivals = {rival for key in given.values if key in MOUNTING_OR_LEAN for rival in MOUNTING_OR_LEAN[key].rivals}
        shared = {key: value for key, value in table.values.items() if key not in rivals}
        both = TomlTable({**shared, **given.values}, given.name, given.origins, given.folder)
        if deployment.poles:
            free = free_places(deployments, number, {k: one.xy for k, one in enumerate(found)})
            there = deployment.on_pole(min(free, key=lambda place: math.dist(place.xy, middle)).pole)
        else:
            place = dict(zip(("x_m", "y_m"), deployment.nominal_xy, strict=True))
            there = replace(deployment, fixed={**deployment.fixed, **place})
        found.append(baseline_from(both, there, region))
    return found


def lidar_where(where: Callable[[str, str], str], number: int, table: str, key: str) -> str:
    """How errors name a key of the one LiDAR that a scene is cut down to: its [[lidar]] in place of [deployment]."""
    return where(f"lidar {number}" if table == "deployment" else table, key)
