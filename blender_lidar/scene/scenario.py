"""A scene file, read into a `Scenario` of frozen settings; `scene_tables` checks each of its tables.

Every table and key is described in docs/reference/scene_file.md. Options of the command line replace the file's values
before they are checked, so both pass the same checks.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path

from ..errors import MissingFileError, unknown_name
from ..names import THE_LIDAR
from ..road.road_map import RoadMap
from ..road.settings import RoadSettings
from ..toml_table import TomlTable, read_toml
from ..traffic.presets import meta_files
from .deployment import BASELINE, Deployment, Installer
from .lidars import OF_ANY_MODEL, LidarSpec, sensor_from
from .mounting import Layout
from .region import region_of
from .roads import road_from, road_map_from
from .scene_tables import (
    Overrides,
    check_region_of_several,
    drawing_from,
    model_from,
    objective_from,
    recordings_from,
    region_from,
    scene_tables,
    search_from,
    world_from,
)
from .settings import (
    DECLARED,
    DrawingSettings,
    ModelSettings,
    ObjectiveSettings,
    RegionSettings,
    SearchSettings,
    TrafficSettings,
    WorldSettings,
    is_sensor_file,
)
from .sugar import Roadside, deployment_of, lidars_from


@dataclass(frozen=True, slots=True)
class Scenario:
    """A whole scene, checked, in its normal form: however it was said, it has a list of recordings and one of LiDARs.

    Attributes
    ----------
    source : str
        The file, or what else it was read from.
    where : callable
        How errors name a table's key.
    recordings : tuple of TrafficSettings
        The traffic.
    road : RoadSettings
        The road as the scene says it.
    road_map : RoadMap
        Where its lanes and its surface are.
    lidars : tuple of LidarSpec
        What hangs, in the order of a layout's mountings.
    baseline_hangs : bool
        Whether the baseline hangs already, so that no installation error shakes it.
    """

    source: str
    recordings: tuple[TrafficSettings, ...]
    road: RoadSettings
    road_map: RoadMap = field(repr=False, compare=False)
    world: WorldSettings
    lidars: tuple[LidarSpec, ...]
    region: RegionSettings
    objective: ObjectiveSettings
    search: SearchSettings
    model: ModelSettings
    drawing: DrawingSettings
    where: Callable[[str, str], str] = field(repr=False, compare=False)
    baseline_hangs: bool = False

    @property
    def lidar(self) -> LidarSpec:
        """The LiDAR of a scene of one."""
        (lidar,) = self.lidars
        return lidar

    @property
    def is_layout(self) -> bool:
        """Whether several LiDARs hang, told apart by their names."""
        return len(self.lidars) > 1

    @property
    def has_names(self) -> bool:
        """Whether its LiDARs have names of their own: several, or one that is not called as a scene's one is."""
        return self.is_layout or self.lidars[0].name != THE_LIDAR

    @property
    def names(self) -> list[str]:
        """Names by which several LiDARs are told apart; that of a single one is nothing."""
        return [lidar.name for lidar in self.lidars] if self.is_layout else [""]

    def with_lidars(self, *lidars: LidarSpec) -> Scenario:
        """The same scene with some LiDARs in place of its own."""
        return replace(self, lidars=lidars)

    @property
    def baselines(self) -> Layout:
        """The baseline of every LiDAR."""
        return tuple(lidar.baseline for lidar in self.lidars)

    @property
    def installers(self) -> tuple[Installer, ...]:
        """How far off its plan each LiDAR may end up."""
        return tuple(lidar.deployment.installer for lidar in self.lidars)

    @property
    def is_exact(self) -> bool:
        """Whether no installation error shakes any LiDAR."""
        return all(one.is_exact for one in self.installers)

    @property
    def studied_installers(self) -> tuple[Installer, ...]:
        """Whose errors a study shakes mountings by: the scene's, or the usual ones where all hang already."""
        return tuple(Installer() for _ in self.lidars) if self.is_exact else self.installers

    @property
    def aim(self) -> str:
        """What of the objective over installation errors is maximised: see `Installer`."""
        return next((one.aim for one in self.installers if not one.is_exact), Installer().aim)

    @property
    def nominal_xy(self) -> tuple[float, float]:
        """The mount's place [m], or the middle of where LiDARs may be."""
        ends = [
            [end for lidar in self.lidars for place in lidar.deployment.places for end in place.span(key)]
            for key in ("x_m", "y_m")
        ]
        return tuple(0.5 * (min(one) + max(one)) for one in ends)

    @property
    def range_gate_m(self) -> float:
        """The range gate, of several LiDARs the largest [m]."""
        return max(lidar.sensor.range_gate_m for lidar in self.lidars)

    @property
    def plane_returns(self) -> bool:
        """Whether the plane z = 0 returns: the ground does, and no map's heights are there in its place."""
        return self.world.ground and not self.road_map.surface.is_ground

    @property
    def files(self) -> dict[tuple[str, str], str]:
        """The files that it names, by table and key; tables of several are numbered as by `numbered_tables`."""
        named = {("world", key): getattr(self.world, key) for key in ("blend", "mesh")}
        for at, recording in enumerate(self.recordings, start=1):
            table = _numbered("traffic", at)
            named[table, "path"] = recording.path
            if found := meta_files(recording.path, recording.format):
                named |= {(table, f"meta {one.name}"): str(one) for one in found}
            for number, path in enumerate(recording.vehicle_types or (), start=1):
                named[table, "vehicle_types" if number == 1 else f"vehicle_types {number}"] = path
        named |= {("road", key): getattr(self.road, key) for key in ("net", "opendrive")}
        named |= {("world", f"vehicles {kind}"): file for kind, (file, _) in self.world.bodies.items()}
        named["drawing", "image"] = self.drawing.image
        for number, lidar in enumerate(self.lidars, start=1):
            table = _numbered("lidar", number)
            named[table, "poles"] = lidar.deployment.poles_file
            named[table, "sensor"] = lidar.sensor.name if is_sensor_file(lidar.sensor.name) else None
        return {place: path for place, path in named.items() if path is not None}

    def as_tables(self) -> dict[str, dict | list[dict]]:
        """The scene as used, in the layout of a scene file, in the long form: reading it again gives this scene."""
        kinds = ("world", "region", "objective", "search", "model", "drawing")
        sensors = {lidar.sensor.name: asdict(lidar.sensor) for lidar in self.lidars}
        shared = {key: next(iter(sensors.values()))[key] for key in OF_ANY_MODEL}
        own = {name: {key: of[key] for key in of if key not in OF_ANY_MODEL} for name, of in sensors.items()}
        traffic = [asdict(one) for one in self.recordings]
        return {
            "traffic": traffic if len(traffic) > 1 else traffic[0],
            "road": self.road.as_table(),
            **{name: asdict(getattr(self, name)) for name in kinds},
            "sensor": shared | (own if len(own) > 1 else next(iter(own.values()))),
            "baseline": {"installer": not self.baseline_hangs},
            "lidar": [lidar.as_table() for lidar in self.lidars],
        }

    def with_whole_paths(self) -> dict[str, dict | list[dict]]:
        """`as_tables` with paths from the root on, so that they mean the same from any folder."""
        tables = self.as_tables()
        for name, listed in tables.items():
            paths = [key for key, declared in DECLARED[name].items() if declared.is_path]
            for table in listed if isinstance(listed, list) else [listed]:
                table |= {key: _whole(table[key]) for key in paths if table.get(key)}
        tables["sensor"] = {_whole(key) if is_sensor_file(key) else key: of for key, of in tables["sensor"].items()}
        for table, key in ((tables["sensor"], "name"), *((lidar, "sensor") for lidar in tables["lidar"])):
            table[key] = _whole(table[key]) if is_sensor_file(table[key]) else table[key]
        return tables


def numbered_tables(tables: Mapping[str, dict | list[dict]]) -> dict[str, dict]:
    """Tables by names that tell lists of them apart: the second of [[traffic]] is "traffic 2"."""
    return {
        _numbered(name, number): table
        for name, listed in tables.items()
        for number, table in enumerate(listed if isinstance(listed, list) else [listed], start=1)
    }


def _numbered(name: str, number: int) -> str:
    return name if number == 1 else f"{name} {number}"


def _whole(path):
    """A path, or a tuple or mapping of them, from the root on."""
    if isinstance(path, Mapping):
        return {key: _whole(one) for key, one in path.items()}
    return tuple(map(_whole, path)) if isinstance(path, tuple) else str(Path(path).resolve())


def shipped_scenes() -> dict[str, Path]:
    """The scene files that come with the package, by name: inside it, or beside it in a checkout."""
    package = Path(__file__).parents[1]
    folder = next((place for place in (package / "scenes", package.parent / "scenes") if place.is_dir()), None)
    return {} if folder is None else {path.stem: path for path in sorted(folder.glob("*.toml"))}


def load_scenario(path: str | Path, overrides: Overrides | None = None) -> Scenario:
    """Read a scene file.

    Parameters
    ----------
    path : path
        The TOML file, or the name of one that ships with the package, as in `shipped_scenes`. Relative paths in it
        start from its folder.
    overrides : mapping of (table, key) to (value, origin), optional
        Values that replace the file's, and where each came from: ``{("sensor", "name"): ("RS-80", "--sensor")}``.
        A path among them starts from the working folder.

    Raises
    ------
    MissingFileError, InputError
        Naming the file, the table and the key.
    """
    shipped = shipped_scenes()
    is_file = os.path.isfile(path)  # noqa: PTH113 - of any length
    path = Path(path) if is_file else shipped.get(str(path), Path(path))
    try:
        values = read_toml(path)
    except MissingFileError as error:
        raise MissingFileError(f"{error}; scenes that ship with the package: {', '.join(shipped)}") from error
    where = partial(_in_file, str(path))
    return scenario_of(values, where=where, source=str(path), folder=path.parent, overrides=overrides)


def _in_file(path: str, table: str, key: str) -> str:
    name, _, number = table.partition(" ")
    return f"{path}: [[{name}]] {number} {key}".rstrip() if number else f"{path}: [{name}] {key}".rstrip()


def scenario_of(
    tables: Mapping[str, Mapping[str, object]],
    *,
    where: Callable[[str, str], str] | None = None,
    source: str = "settings",
    folder: Path = Path(),
    overrides: Overrides | None = None,
) -> Scenario:
    """Settings from values, as a scene file holds them: tables of numbers, texts, lists and tables of those.

    Parameters
    ----------
    tables : mapping of str to mappings
        The values by table and key, ``{"sensor": {"name": "RS-80"}}``; None leaves one out.
    where : callable, optional
        What errors call the value of a table's key, such as a panel's field; and the table itself, for an empty key.
    source : str
        What the settings are called as a whole: the scene file.
    folder : path
        Where relative paths among them start from.
    overrides : mapping of (table, key) to (value, origin), optional
        As for `load_scenario`.

    Raises
    ------
    MissingFileError, InputError
        Naming what `where` says.
    """
    for name in tables:
        if name not in DECLARED:
            raise unknown_name(name, DECLARED, "table", source)
    where, overrides = where or partial(_in_file, source), overrides or {}
    of_file, tables = scene_tables(tables, {}, where, folder), scene_tables(tables, overrides, where, folder)
    recordings, road = recordings_from(tables["traffic"]), road_from(tables["road"][0])
    roadside = Roadside(road, road_map_from(tables["road"][0], road, recordings))
    region = _region(tables, of_file, overrides, roadside)
    roadside = replace(roadside, middle_xy=region_of(region, roadside.map).centre_xy)
    lidars = lidars_from(tables, of_file, roadside)
    table_of = {name: listed[0] for name, listed in tables.items() if listed}
    return Scenario(
        source=source,
        where=where,
        recordings=tuple(recordings),
        road=road,
        road_map=roadside.map,
        world=world_from(table_of["world"], road),
        lidars=lidars,
        region=region,
        objective=objective_from(table_of["objective"]),
        search=search_from(table_of["search"], lidars),
        model=model_from(table_of["model"]),
        drawing=drawing_from(table_of["drawing"]),
        baseline_hangs=not table_of["baseline"].some(BASELINE)["installer"],
    )


def _region(
    tables: Mapping[str, list[TomlTable]],
    of_file: Mapping[str, list[TomlTable]],
    overrides: Overrides,
    roadside: Roadside,
) -> RegionSettings:
    """[region], resolved by what the first LiDAR of the scene file says, where there is one."""
    if len(tables["lidar"]) > 1:
        check_region_of_several(tables["region"][0])

    def mount_of_file() -> tuple[Deployment, TomlTable]:
        own = Roadside(road_from(of_file["road"][0]), roadside.map)
        return deployment_of(of_file, own), (*of_file["lidar"], *of_file["deployment"])[0]

    def gate(of: Mapping[str, list[TomlTable]]) -> float:
        return sensor_from(of["sensor"][0], *of["lidar"][:1]).range_gate_m

    gate_m, changed = gate(tables), any(place[0] == "sensor" for place in overrides)
    own_gate = partial(gate, of_file if changed else tables)
    return region_from(tables["region"][0], roadside.map, gate_m, mount_of_file, own_gate)
