"""A scene file, read into a `Scenario` of frozen settings: what one setting alone cannot say is checked here.

Every table and key is described in docs/reference/scene_file.md. Options of the command line replace the file's values
before they are checked, so both pass the same checks.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path

from ..errors import InputError, MissingFileError, shown, unknown_name
from ..metrics.catalogue import PE_VGOP, metric_named
from ..optimise import SEARCHES, DePso, DePsoSettings, GridSearch, search_named
from ..road.mapped import MappedRoad, Road
from ..road.road_map import RoadMap
from ..road.straight import StraightRoad
from ..toml_table import TomlTable, read_toml, settings_of
from ..traffic.frames import DEFAULT_COUNT
from ..traffic.presets import meta_files
from ..traffic.vehicles import counted
from .deployment import Deployment
from .lidars import OF_ANY_MODEL, HungLidar, baselines_from, deployments_from, lidar_where, sensor_from
from .mounting import MOUNTED, Layout, Mounting, mounting_from
from .places import baseline_from, deployment_from
from .region import check_mapped, check_polygon, region_of
from .roads import road_from, road_map_from
from .settings import (
    DECLARED,
    GATE,
    ModelSettings,
    ObjectiveSettings,
    PlanSettings,
    RegionSettings,
    SearchSettings,
    SensorSettings,
    Tolerance,
    TrafficSettings,
    WorldSettings,
)

LEAST_BUDGET = 30  # evaluations for each coordinate of a LiDAR among several
_FEW_COORDINATES, _SEEDS = 2, 3  # with more of them so many searches: one alone may end anywhere
_DE_PSO_ALONE = ("inertia", "differential_weight", "cognitive", "social", "differential_threshold")
_OF_ONE_RECORDING = ("name", "weight", "path", "vehicle_types", "period", "location", "frame_ids")
_FILES = ("world", "blend"), ("world", "mesh")
_PAPERS_LOSS = -1.0  # bit; with any other metric a vehicle below the threshold adds what the metric gives it


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
    plan: PlanSettings
    where: Callable[[str, str], str] = field(repr=False, compare=False)
    further_traffic: tuple[TrafficSettings, ...] = ()
    lidar_name: str = ""
    further_lidars: tuple[HungLidar, ...] = ()

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
        """The mounting that some coordinates give [m, degrees], with the baseline's others: see `mounting_from`."""
        if self.deployment.faces_road and table.get("y_m") is not None and table.get("facing_deg") is None:
            x_m = self.baseline.xy[0] if table.get("x_m") is None else table["x_m"]
            table = {**table, "facing_deg": self.deployment.facing_at((x_m, table["y_m"]))}
        return mounting_from(table, self.road_map, self.baseline, where)

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
        named["plan", "image"] = self.plan.image
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
        kinds = ("road", "world", "sensor", "region", "objective", "search", "model", "plan")
        tables = dict(zip(self._traffic_tables, map(asdict, self.recordings), strict=True))
        tables |= {name: asdict(getattr(self, name)) for name in kinds}
        if not self.lidar_name:
            tables["baseline"] = {key: self.baseline.as_table()[key] for key in MOUNTED}
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


Overrides = Mapping[tuple[str, str], tuple[object, str]]


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
    of_file = _tables(tables, {}, where, folder)
    tables = _tables(tables, overrides, where, folder)
    traffic, *further = _recordings([table for name, table in tables.items() if name.split()[0] == "traffic"])
    road, hung = road_from(tables["road"]), [table for name, table in tables.items() if name.split()[0] == "lidar"]
    road_map = road_map_from(tables["road"], road, [traffic, *further])
    if given:
        if tables["deployment"].values:
            raise InputError(
                f"{tables['deployment'].name}: is given beside [[lidar]]; allowed: its keys in each [[lidar]]"
            )
        names, sensors, deployments = zip(*deployments_from(hung, tables["sensor"], road, road_map), strict=True)
    else:
        names, sensors = [""], [sensor_from(tables["sensor"])]
        deployments = [deployment_from(tables["deployment"], road, road_map)]
    if len(names) > 1:
        _check_region_of_several(tables["region"])
    region = _region(tables["region"], sensors[0], of_file, overrides, road_map)
    if not isinstance(road, StraightRoad):
        middle_xy = region_of(region, road_map).centre_xy
        deployments = [replace(one, middle_xy=middle_xy) for one in deployments]
    objective = _objective(tables["objective"])
    if any(one.poles for one in deployments) and objective.tolerance is not None:
        where = tables["objective"].where("tolerance")
        raise InputError(f"{where}: is given beside [deployment] poles; allowed: candidate places that hang as planned")
    if given:
        baselines = baselines_from(tables["baseline"], hung, deployments, region)
    else:
        baselines = [baseline_from(tables["baseline"], deployments[0], region)]
    lidars = list(map(HungLidar, names, sensors, deployments, baselines))
    search = _search(tables["search"], lidars, several=objective.tolerance is None)
    if search.fidelity == "auto" and objective.tolerance is not None:
        raise InputError(
            f'{tables["search"].where("fidelity")}: "auto" searches mountings that hang as planned, but '
            f'{tables["objective"].where("tolerance")} is given; allowed: fidelity = "full", or no tolerance'
        )
    if given and len(lidars) == 1:
        where = partial(lidar_where, where, 1)
    return Scenario(
        source=source,
        where=where,
        traffic=traffic,
        road=road,
        world=_world(tables["world"], road),
        sensor=lidars[0].sensor,
        deployment=lidars[0].deployment,
        region=region,
        baseline=lidars[0].baseline,
        objective=objective,
        search=search,
        model=_model(tables["model"]),
        plan=_plan(tables["plan"]),
        further_traffic=tuple(further),
        lidar_name=lidars[0].name,
        further_lidars=tuple(lidars[1:]),
    )


def _tables(
    values: Mapping[str, object], overrides: Overrides, where: Callable[[str, str], str], folder: Path
) -> dict[str, TomlTable]:
    """The tables of a scene, options in place of the settings that they replace or put out of force.

    Of several recordings, [[traffic]], the second table is called "traffic 2", and so of [[lidar]].
    """
    tables = {}
    for name in DECLARED:
        given = {key: option for (table, key), option in overrides.items() if table == name}
        contents = values.get(name, {})
        several = name in ("traffic", "lidar") and isinstance(contents, list) and len(contents) > 0
        if name == "lidar" and name in values and not several:
            found = "a list without one" if contents == [] else shown(contents)
            raise InputError(f"{where(name, '')}: is {found}; allowed: [[lidar]], one or more tables")
        if several and len(contents) > 1 and name == "traffic":
            _check_for_all(given, len(contents))
        for number, content in enumerate(contents if several else [contents], start=1):
            called = partial(where, f"{name} {number}" if several else name)
            tables[name if number == 1 else f"{name} {number}"] = _table(name, content, called, given, folder)
    return tables


def _check_region_of_several(table: TomlTable) -> None:
    """Refuse a circle that a LiDAR would say, where there are several: none of them changes where vehicles count."""
    forms = ("polygon_m", "stretches", "junction", "approaches", "lanes")
    if any(table.values.get(key) for key in forms):
        return
    missing = [key for key in ("centre_m", "radius_m") if table.values.get(key) in (None, GATE)]
    if missing:
        raise InputError(
            f"{table.where(missing[0])}: must be given with several LiDARs, none of which may change where vehicles "
            "count; such as: [region] centre_m = [0, 20], radius_m = 50, or a junction of the map"
        )


def _check_for_all(given: Mapping[str, tuple[object, str]], recordings: int) -> None:
    """Refuse options that are about one recording where there are several."""
    for key, (_, option) in given.items():
        if key in _OF_ONE_RECORDING:
            raise InputError(
                f"{option}: is of one recording, but the scene has {recordings}; allowed: in their [[traffic]] tables"
            )


def _table(
    name: str,
    content: object,
    where: Callable[[str], str],
    given: Mapping[str, tuple[object, str]],
    folder: Path,
) -> TomlTable:
    """One table of a scene, with the options `given` in place of its settings; `where` names a key of it."""
    declared = DECLARED[name]
    rivals = {rival for key in given if key in declared for rival in declared[key].rivals}
    if name == "search" and given.get("method", (DePso.name,))[0] != DePso.name:
        rivals.update(_DE_PSO_ALONE)  # the file's settings of a search that the option replaces
    of_file = TomlTable(content, where("")).values
    values = {key: value for key, value in of_file.items() if key not in rivals and value is not None}
    values |= {key: value for key, (value, _) in given.items()}
    return TomlTable(values, where(""), {key: option for key, (_, option) in given.items()}, folder, where)


def _region(
    table: TomlTable,
    sensor: SensorSettings,
    of_file: Mapping[str, TomlTable],
    overrides: Overrides,
    road_map: RoadMap,
) -> RegionSettings:
    """[region], resolved: a circle has its middle and radius, which depend on nothing that an option may change.

    `of_file` are the scene file's tables without options: where it leaves something open its own mount and sensor say.
    """
    region = table.read_as(RegionSettings)
    mapped = [key for key in ("junction", "approaches", "lanes") if getattr(region, key)]
    forms = [*(key for key in ("polygon_m", "stretches") if getattr(region, key)), *mapped[:1]]
    if forms:
        both = [*forms, *(key for key in ("centre_m", "radius_m") if getattr(region, key) is not None)]
        if len(both) > 1:
            raise InputError(
                f"{table.name}: has {both[0]} and {both[1]}; allowed: a circle, a polygon, stretches of a straight "
                "road, or a junction, approaches and lanes of a map"
            )
    if mapped and not road_map.lanes:
        raise InputError(f"{table.where(mapped[0])}: is of a map; allowed: with [road] net or opendrive")
    if region.stretches and (road_map.lanes or not len(road_map)):
        raise InputError(f"{table.where('stretches')}: are of a straight road; allowed here: a circle or a polygon")
    check_mapped(region, road_map, table.where) if mapped else None
    for key, polygons in {"polygon_m": [region.polygon_m or ()], "keep_out": region.keep_out or ()}.items():
        for polygon in filter(None, polygons):
            check_polygon(polygon, table.where(key))
    if forms:
        return region
    centre, radius = region.centre_m, region.radius_m
    if centre is None:
        deployment = deployment_from(of_file["deployment"], road_from(of_file["road"]), road_map)
        searched = ["poles"] if deployment.poles else [key for key in ("x_m", "y_m") if key in deployment.bounds]
        if searched:
            middle = ", ".join(f"{place:g}" for place in deployment.nominal_xy)
            several = "has several places" if deployment.poles else "is searched"
            where = f"{of_file['deployment'].where(searched[0])}: {several}"
            raise InputError(
                f"{where}, so that [region] must say where vehicles count; such as: [region] "
                f"centre_m = [{middle}], radius_m = {sensor.range_gate_m:g}"
            )
        centre = deployment.nominal_xy
    if radius == GATE:
        radius = sensor.range_gate_m
    elif radius is None:
        changed = any(place[0] == "sensor" for place in overrides)
        radius = (sensor_from(of_file["sensor"]) if changed else sensor).range_gate_m
    return replace(region, centre_m=centre, radius_m=radius)


def _recordings(tables: Sequence[TomlTable]) -> list[TrafficSettings]:
    """[traffic], or each [[traffic]] with the name that it goes by."""
    found = [_traffic(table) for table in tables]
    if len(found) == 1:
        return found
    found = [replace(one, name=one.name or Path(one.path).stem) for one in found]
    names = [one.name for one in found]
    for number, (table, name) in enumerate(zip(tables, names, strict=True)):
        if name in names[:number]:
            raise InputError(
                f"{table.where('name')}: is {shown(name)}, as of another recording; allowed: a name for each"
            )
    return found


def _traffic(table: TomlTable) -> TrafficSettings:
    traffic = table.read_as(TrafficSettings)
    spread = next((key for key in ("frames", "spacing_s") if getattr(traffic, key) is not None), None)
    if traffic.frame_ids is not None and spread is not None:
        both = table.where("frame_ids"), table.where(spread)
        raise InputError("{}: lists the frames that {} spreads evenly; allowed: one of both".format(*both))
    return traffic if traffic.frame_ids or spread else replace(traffic, frames=DEFAULT_COUNT)


def _world(table: TomlTable, road: Road) -> WorldSettings:
    world = table.read_as(WorldSettings)
    along = next((key for key in ("barriers", "clutter") if getattr(world, key)), None)
    if along and not isinstance(road, StraightRoad):
        raise InputError(f"{table.where(along)}: lie along a straight road; allowed on a map: boxes, blend or mesh")
    file = next((key for key in ("blend", "mesh") if getattr(world, key)), None)
    if file and isinstance(road, StraightRoad) and not road.is_level:
        raise InputError(
            f"{table.where(file)}: is given beside a [road] with a grade or a cross-fall, and does not say whether it "
            "is plumb; allowed: boxes and barriers, which stand square on the road"
        )
    named = (replace(box, name=box.name or f"box {number}") for number, box in enumerate(world.boxes, start=1))
    return replace(world, boxes=tuple(named))


def _objective(table: TomlTable) -> ObjectiveSettings:
    objective = table.read_as(ObjectiveSettings)
    metric_named(objective.metric, table.where("metric"))
    scored = objective.scored_classes
    for name in objective.class_weights:
        if name not in scored:
            raise InputError(
                f"{table.where('class_weights')}: {name} is not scored; allowed: those of classes, {', '.join(scored)}"
            )
    if objective.tolerance is not None and not objective.tolerance.half_widths:
        keys = ", ".join(key for key in settings_of(Tolerance) if key != "aim")
        where = table.table("tolerance").name
        raise InputError(f"{where}: leaves every coordinate exact; allowed: at least one of {keys} above 0")
    for number, zone in enumerate(objective.zones, start=1):
        check_polygon(zone.polygon_m, f"{table.where('zones')} {number} polygon_m")
    if objective.loss is None and objective.metric == PE_VGOP.name:
        return replace(objective, loss=_PAPERS_LOSS)
    return objective


def _search(table: TomlTable, lidars: Sequence[HungLidar], *, several: bool) -> SearchSettings:
    """[search]; `several` says whether nothing else speaks against several searches with their own seeds."""
    search = table.read_as(SearchSettings)
    if len(lidars) > 1 and search.fidelity != "full":
        raise InputError(
            f"{table.where('fidelity')}: is {search.fidelity!r} with {len(lidars)} LiDARs; allowed: full, as a move of "
            "one LiDAR costs one cast already"
        )
    several &= search.fidelity == "full" and search.method != GridSearch.name and len(lidars) == 1
    if (search.seeds or 1) > 1 and not several:
        raise InputError(
            f"{table.where('seeds')}: is {search.seeds}; allowed: 1 with a tolerance, with fidelity = "
            '"auto", with several LiDARs, and with a grid, which draws nothing'
        )
    most = max(len(place.bounds) for lidar in lidars for place in lidar.deployment.places)
    usual = _SEEDS if several and most > _FEW_COORDINATES else 1
    search = replace(search, seeds=search.seeds or usual)
    if search.method not in SEARCHES:
        search_named(search.method, table.where("method"))
    given = [key for key in _DE_PSO_ALONE if getattr(search, key) is not None]
    if search.method == DePso.name:
        paper = DePsoSettings()
        search = replace(search, **{key: getattr(paper, key) for key in _DE_PSO_ALONE if key not in given})
    elif given:
        raise InputError(
            f"{table.where(given[0])}: a setting of {DePso.name} alone, but the method is {search.method}; "
            f'allowed: method = "{DePso.name}", or leave it out'
        )
    least = LEAST_BUDGET * most
    if len(lidars) > 1 and search.particles * search.iterations < least:
        raise InputError(
            f"{table.where('particles')}: {search.particles} x {search.iterations} iterations are too few evaluations "
            f"for each LiDAR of {counted(most, 'searched coordinate')}; allowed: {least} or more"
        )
    corners = 2**most
    if search.method == GridSearch.name and search.particles * search.iterations < corners:
        raise InputError(
            f"{table.where('particles')}: {search.particles} x {search.iterations} iterations are too few "
            f"evaluations for a grid over {most} coordinates; allowed: {corners} or more"
        )
    return search


def _plan(table: TomlTable) -> PlanSettings:
    plan = table.read_as(PlanSettings)
    if (plan.image is None) != (plan.image_points is None):
        key, other = ("image", "image_points") if plan.image_points is None else ("image_points", "image")
        raise InputError(f"{table.where(key)}: is given without {other}; allowed: both")
    points = plan.image_points
    if points is not None and (len(points) != 2 or points[0][:2] == points[1][:2] or points[0][2:] == points[1][2:]):
        raise InputError(
            f"{table.where('image_points')}: do not place the image; allowed: two different points, each [pixels from "
            "the left, from the top, x_m, y_m]"
        )
    return plan


def _model(table: TomlTable) -> ModelSettings:
    model = table.read_as(ModelSettings)
    if model.cluster is not None and (model.workers or "workers" in table.origins):
        raise InputError(
            f"{table.where('cluster')}: has its own workers, and {table.where('workers')} asks for {model.workers} "
            "processes here; allowed: one of both"
        )
    return model
