"""A scene file, read into a `Scenario` of frozen settings; `scene_tables` checks each of its tables.

Every table and key is described in docs/reference/scene_file.md. Options of the command line replace the file's values
before they are checked, so both pass the same checks.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path

from ..errors import InputError, MissingFileError, unknown_name
from ..road.mapped import MappedRoad, Road
from ..road.road_map import RoadMap
from ..road.straight import StraightRoad
from ..toml_table import read_toml
from ..traffic.presets import meta_files
from .deployment import BASELINE, Deployment, Installer, fixed_beside
from .lidars import (
    OF_ANY_MODEL,
    HungLidar,
    baselines_from,
    check_aims,
    deployments_from,
    lidar_where,
    sensor_from,
    with_installers,
)
from .mounting import MOUNTED, Layout, Mounting, mounting_from
from .places import baseline_from, deployment_from
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
    SensorSettings,
    TrafficSettings,
    WorldSettings,
)

_FILES = ("world", "blend"), ("world", "mesh")


@dataclass(frozen=True, slots=True)
class Scenario:
    """A whole scene, checked.

    Attributes
    ----------
    source : str
        The file, or what else it was read from.
    where : callable
        How errors name a table's key.
    traffic : TrafficSettings
        The recording, of several the first.
    further_traffic : tuple of TrafficSettings
        The others.
    sensor, deployment, baseline, lidar_name
        Of the LiDAR, of several the first.
    further_lidars : tuple of HungLidar
        The others.
    baseline_hangs : bool
        Whether the baseline hangs already, so that no installation error shakes it.
    """

    source: str
    traffic: TrafficSettings
    road: Road
    world: WorldSettings
    sensor: SensorSettings
    deployment: Deployment
    region: RegionSettings
    baseline: Mounting
    objective: ObjectiveSettings
    search: SearchSettings
    model: ModelSettings
    drawing: DrawingSettings
    where: Callable[[str, str], str] = field(repr=False, compare=False)
    further_traffic: tuple[TrafficSettings, ...] = ()
    lidar_name: str = ""
    further_lidars: tuple[HungLidar, ...] = ()
    baseline_hangs: bool = False

    @property
    def lidars(self) -> tuple[HungLidar, ...]:
        """All LiDARs of a layout, in their order."""
        return HungLidar(self.lidar_name, self.sensor, self.deployment, self.baseline), *self.further_lidars

    @property
    def each(self) -> tuple[Scenario, ...]:
        """The same scene with each of its LiDARs alone."""
        return tuple(self.alone(number) for number in range(len(self.lidars)))

    def alone(self, number: int) -> Scenario:
        """The same scene with one of its LiDARs alone, counted from 0."""
        if not self.further_lidars:
            return self
        lidar = self.lidars[number]
        kept = {key: getattr(lidar, key) for key in ("sensor", "deployment", "baseline")}
        where = partial(lidar_where, self.where, number + 1)
        return replace(self, **kept, lidar_name=lidar.name, further_lidars=(), where=where)

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
        if not self.further_lidars:
            return self.deployment.nominal_xy
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
    def recordings(self) -> tuple[TrafficSettings, ...]:
        """All recordings."""
        return self.traffic, *self.further_traffic

    @property
    def road_map(self) -> RoadMap:
        """Where the lanes and the surface are."""
        return self.deployment.road_map

    @property
    def plane_returns(self) -> bool:
        """Whether the plane z = 0 returns: the ground does, and no map's heights are there in its place."""
        return self.world.ground and (self.straight is not None or self.road_map.surface.is_flat)

    @property
    def straight(self) -> StraightRoad | None:
        """The straight road, where it is one and no map."""
        return self.road if isinstance(self.road, StraightRoad) else None

    def in_median(self, xy: Sequence[float]) -> bool:
        """Whether a place [m] lies in the median of a straight road."""
        return self.straight is not None and self.straight.side_of(xy) == "median"

    def mounting(self, table: Mapping[str, float | None], where: str = "mounting") -> Mounting:
        """The mounting that some coordinates give [m, degrees]: see `mounting_from`.

        Others are as [deployment] or [[lidar]] fixes them, at all its places alike, else the baseline's.
        """
        table = self._fixed(table) | table
        moved = any(table.get(key) is not None for key in ("x_m", "y_m"))
        if self.deployment.faces_road and moved and table.get("facing_deg") is None:
            pairs = zip(("x_m", "y_m"), self.baseline.xy, strict=True)
            xy = [own if table.get(key) is None else table[key] for key, own in pairs]
            table = {**table, "facing_deg": self.deployment.facing_at(xy)}
        return mounting_from(table, self.road_map, self.baseline, where)

    def _fixed(self, given: Mapping[str, float | None]) -> dict[str, float]:
        """What all places fix alike, without what would contradict coordinates that are given."""
        first, *others = self.deployment.places
        fixed = {key: value for key, value in first.fixed.items() if all(one.fixed.get(key) == value for one in others)}
        if self.deployment.faces_road:
            fixed.pop("facing_deg", None)
        return fixed_beside(fixed, [key for key, value in given.items() if value is not None])

    @property
    def files(self) -> dict[tuple[str, str], str]:
        """The files that it names, by table and key."""
        named = {(table, key): getattr(getattr(self, table), key) for table, key in _FILES}
        for table, recording in zip(self._traffic_tables, self.recordings, strict=True):
            named[table, "path"] = recording.path
            if found := meta_files(recording.path, recording.format):
                named |= {(table, f"meta {one.name}"): str(one) for one in found}
            for number, path in enumerate(recording.vehicle_types or (), start=1):
                named[table, "vehicle_types" if number == 1 else f"vehicle_types {number}"] = path
        if isinstance(self.road, MappedRoad) and self.road.path:
            named["road", "net" if self.road.net else "opendrive"] = self.road.path
        named |= {("world", f"vehicles {kind}"): file for kind, (file, _) in self.world.bodies.items()}
        named["drawing", "image"] = self.drawing.image
        if not self.lidar_name:
            named["deployment", "poles"] = self.deployment.poles_file
            named["sensor", "name"] = self.sensor.name if self.sensor.is_file else None
        for table, lidar in zip(self._lidar_tables, self.lidars if self.lidar_name else (), strict=False):
            named[table, "poles"] = lidar.deployment.poles_file
            named[table, "sensor"] = lidar.sensor.name if lidar.sensor.is_file else None
        return {place: path for place, path in named.items() if path is not None}

    @property
    def _traffic_tables(self) -> list[str]:
        return ["traffic", *(f"traffic {number}" for number in range(2, len(self.recordings) + 1))]

    @property
    def _lidar_tables(self) -> list[str]:
        return ["lidar", *(f"lidar {number}" for number in range(2, len(self.lidars) + 1))]

    def as_tables(self) -> dict[str, dict]:
        """The scene as used, in the layout of a scene file: reading it again gives this scene.

        Of several recordings the second table is called "traffic 2", and so of [[lidar]].
        """
        kinds = ("road", "world", "sensor", "region", "objective", "search", "model", "drawing")
        tables = dict(zip(self._traffic_tables, map(asdict, self.recordings), strict=True))
        tables |= {name: asdict(getattr(self, name)) for name in kinds}
        tables["baseline"] = {"installer": not self.baseline_hangs}
        if not self.lidar_name:
            tables["baseline"] |= {key: self.baseline.as_table()[key] for key in MOUNTED}
            return {**tables, "deployment": self.deployment.as_table()}
        sensors = {lidar.sensor.name: asdict(lidar.sensor) for lidar in self.lidars}
        own = {name: {key: of[key] for key in of if key not in OF_ANY_MODEL} for name, of in sensors.items()}
        tables["sensor"] = {key: tables["sensor"][key] for key in OF_ANY_MODEL} | own
        for name, lidar in zip(self._lidar_tables, self.lidars, strict=True):
            baseline = {key: lidar.baseline.as_table()[key] for key in MOUNTED}
            tables[name] = {**lidar.as_table(), "baseline": baseline}
        return tables

    def with_whole_paths(self) -> dict[str, dict]:
        """`as_tables` as a file has them, paths from the root on, so that they mean the same from any folder.

        Several recordings are a list.
        """
        tables = self.as_tables()
        for (table, key), path in self.files.items():
            key, _, number = key.partition(" ")
            if key == "meta":  # found beside the recording
                continue
            if key == "vehicles":
                tables[table][key][number] = str(Path(self.world.vehicles[number]).resolve())
                continue
            whole, before = str(Path(path).resolve()), tables[table][key] if number else []
            tables[table][key] = [*before, whole] if key == "vehicle_types" else whole
            if (table, key) == ("lidar", "sensor") or (table.startswith("lidar ") and key == "sensor"):
                tables["sensor"][whole] = tables["sensor"].pop(path, tables["sensor"].get(whole))
                if tables["sensor"]["name"] == path:
                    tables["sensor"]["name"] = whole
        traffic = [tables.pop(name) for name in self._traffic_tables]
        lidars = [tables.pop(name) for name in self._lidar_tables if name in tables]
        tables = {"traffic": traffic if len(traffic) > 1 else traffic[0], **tables}
        return {**tables, "lidar": lidars} if lidars else tables


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
    where, overrides, given = where or partial(_in_file, source), overrides or {}, "lidar" in tables
    of_file = scene_tables(tables, {}, where, folder)
    tables = scene_tables(tables, overrides, where, folder)
    traffic, *further = recordings_from([table for name, table in tables.items() if name.split()[0] == "traffic"])
    road, hung = road_from(tables["road"]), [table for name, table in tables.items() if name.split()[0] == "lidar"]
    road_map = road_map_from(tables["road"], road, [traffic, *further])
    if given:
        if tables["deployment"].values:
            raise InputError(
                f"{tables['deployment'].name}: is given beside [[lidar]]; allowed: its keys in each [[lidar]]"
            )
        names, sensors, deployments = zip(*deployments_from(hung, tables["sensor"], road, road_map), strict=True)
        deployments = with_installers([one for name, one in of_file.items() if name.split()[0] == "lidar"], deployments)
    else:
        names, sensors = [""], [sensor_from(tables["sensor"])]
        deployments = [deployment_from(tables["deployment"], road, road_map)]
    if len(names) > 1:
        check_region_of_several(tables["region"])
    region = region_from(tables["region"], sensors[0], of_file, overrides, road_map)
    if not isinstance(road, StraightRoad):
        middle_xy = region_of(region, road_map).centre_xy
        deployments = [replace(one, middle_xy=middle_xy) for one in deployments]
    objective = objective_from(tables["objective"])
    if given:
        baselines = baselines_from(tables["baseline"], hung, deployments, region)
    else:
        baselines = [baseline_from(tables["baseline"], deployments[0], region)]
    lidars = list(map(HungLidar, names, sensors, deployments, baselines))
    check_aims(hung, lidars)
    search = search_from(tables["search"], lidars)
    if given and len(lidars) == 1:
        where = partial(lidar_where, where, 1)
    return Scenario(
        source=source,
        where=where,
        traffic=traffic,
        road=road,
        world=world_from(tables["world"], road),
        sensor=lidars[0].sensor,
        deployment=lidars[0].deployment,
        region=region,
        baseline=lidars[0].baseline,
        objective=objective,
        search=search,
        model=model_from(tables["model"]),
        drawing=drawing_from(tables["drawing"]),
        further_traffic=tuple(further),
        lidar_name=lidars[0].name,
        further_lidars=tuple(lidars[1:]),
        baseline_hangs=not tables["baseline"].some(BASELINE)["installer"],
    )
