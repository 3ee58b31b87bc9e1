"""A LiDAR of a scene: what hangs, where it may hang, and what it is compared with; and [sensor], read."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from ..errors import InputError, MissingFileError
from ..sensors.model import LidarModel, load_model, unit_of, with_columns
from ..toml_table import TomlTable, checked, setting, settings_of
from .deployment import DEPLOYMENT, MOUNTING_OR_LEAN, STAND, Deployment, Facing, fixed_beside
from .mounting import MOUNTED, Mounting, mounting_from
from .settings import DATASHEET, DECLARED, SensorSettings, is_sensor_file

OF_ANY_MODEL = ("name", "unit", "noise_seed")  # keys of [sensor] that a single model's table within it has not


@dataclass(frozen=True, slots=True)
class LidarSpec:
    """A LiDAR of a scene: its sensor, where it may hang, and what it is compared with.

    Attributes
    ----------
    name : str
        What tells it from the others, in the draws of its noise too.
    sensor : SensorSettings
    deployment : Deployment
    baseline : Mounting
    table : str
        The table of the scene that says where it may hang, as `Scenario.where` knows it.
    """

    name: str
    sensor: SensorSettings
    deployment: Deployment
    baseline: Mounting
    table: str = field(default="lidar 1", compare=False)

    @property
    def is_held(self) -> bool:
        """Whether it hangs already: it has one place and nothing to be searched."""
        return self.deployment.is_held

    def mounting(self, table: Mapping[str, float | None], where: str = "mounting") -> Mounting:
        """The mounting that some coordinates give [m, degrees]: see `mounting_from`.

        Others are as all its places fix them alike, else the baseline's; a mast that is moved faces as a scene says
        that masts face.
        """
        given, places = {key: value for key, value in table.items() if value is not None}, self.deployment.places
        alike = {
            key: value
            for key, value in places[0].fixed.items()
            if all(one.fixed.get(key) == value for one in places[1:])
        }
        found = fixed_beside(alike, given) | given
        moved, placed = (not of.keys().isdisjoint(("x_m", "y_m")) for of in (given, found))
        facing = self._facing(moved=moved, placed=placed)
        if "facing_deg" not in given and facing is not None:
            xy = [found.get(key, own) for key, own in zip(("x_m", "y_m"), self.baseline.xy, strict=True)]
            found["facing_deg"] = facing.at(xy, places[0].road)
        return mounting_from(found, places[0].road, self.baseline, where)

    def _facing(self, *, moved: bool, placed: bool) -> Facing | None:
        """Which way a mast faces that coordinates move, or that they or its places put; None: as the baseline's."""
        rule, own = self.deployment.facing, {place.facing for place in self.deployment.places}
        if moved and rule.angle_deg is None:
            return rule
        if len(own) > 1:  # poles face each its own way
            return None
        (facing,) = own
        return facing if placed or facing.angle_deg is not None else None

    def as_table(self) -> dict[str, object]:
        """The entry of [[lidar]] that it is, spelt out."""
        poles = self.deployment.poles
        pole = poles[0].name if len(poles) == 1 else None
        baseline = {key: value for key, value in self.baseline.as_table().items() if key in MOUNTED}
        own = {"name": self.name, "sensor": self.sensor.name, "pole": pole, **self.deployment.as_table()}
        return {**own, "baseline": baseline}


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
    if own is not None and "name" not in table.origins and (name := own.some({"sensor": LIDAR["sensor"]})["sensor"]):
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
