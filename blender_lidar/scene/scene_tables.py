"""The tables of a scene file, each read and checked: what one setting alone cannot say.

Options of the command line replace the file's values before they are checked, so both pass the same checks.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from ..errors import InputError, shown
from ..metrics.catalogue import PE_VGOP, metric_named
from ..optimise import SEARCHES, DePso, DePsoSettings, GridSearch, search_named
from ..road.road_map import RoadMap
from ..road.settings import RoadSettings
from ..toml_table import TomlTable
from ..traffic.frames import DEFAULT_COUNT
from ..traffic.vehicles import counted
from .deployment import Deployment
from .lidars import LidarSpec
from .region import check_mapped, check_polygon
from .settings import (
    DECLARED,
    GATE,
    INSTALLER,
    DrawingSettings,
    ModelSettings,
    ObjectiveSettings,
    RegionSettings,
    SearchSettings,
    TrafficSettings,
    WorldSettings,
)

Overrides = Mapping[tuple[str, str], tuple[object, str]]

LEAST_BUDGET = 30  # evaluations for each coordinate of a LiDAR among several
_FEW_COORDINATES, _SEEDS = 2, 3  # with more of them so many searches: one alone may end anywhere
_DE_PSO_ALONE = ("inertia", "differential_weight", "cognitive", "social", "differential_threshold")
_OF_ONE_RECORDING = ("name", "weight", "path", "vehicle_types", "period", "location", "frame_ids")
_PAPERS_LOSS = -1.0  # bit; with any other metric a vehicle below the threshold adds what the metric gives it


def scene_tables(
    values: Mapping[str, object], overrides: Overrides, where: Callable[[str, str], str], folder: Path
) -> dict[str, list[TomlTable]]:
    """The tables of a scene by name, options in place of the settings that they replace or put out of force.

    Of [[traffic]] and [[lidar]] there may be several, and of [[lidar]] none; of all others there is one. The second of
    several is called "traffic 2" where errors name it.
    """
    tables = {}
    if "lidar" in values and INSTALLER in overrides:
        overrides = {("lidar", place[1]) if place == INSTALLER else place: one for place, one in overrides.items()}
    for name in DECLARED:
        given = {key: option for (table, key), option in overrides.items() if table == name}
        contents = values.get(name, {})
        several = name in ("traffic", "lidar") and isinstance(contents, list) and len(contents) > 0
        if name == "lidar" and name in values and not several:
            found = "a list without one" if contents == [] else shown(contents)
            raise InputError(f"{where(name, '')}: is {found}; allowed: [[lidar]], one or more tables")
        if several and len(contents) > 1 and name == "traffic":
            _check_for_all(given, len(contents))
        listed = contents if several else [] if name == "lidar" else [contents]
        called = (partial(where, f"{name} {number}" if several else name) for number in itertools.count(1))
        tables[name] = [_table(name, content, of, given, folder) for content, of in zip(listed, called, strict=False)]
    return tables


def check_region_of_several(table: TomlTable) -> None:
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


def region_from(
    table: TomlTable,
    road_map: RoadMap,
    gate_m: float,
    mount_of_file: Callable[[], tuple[Deployment, TomlTable]],
    gate_of_file: Callable[[], float],
) -> RegionSettings:
    """[region], resolved: a circle has its middle and radius, which depend on nothing that an option may change.

    Where the scene file leaves them open its own mount and range gate say them, without options: `mount_of_file` gives
    where its LiDAR may hang and the table that says so, `gate_of_file` its range gate [m]; `gate_m` is the one in use.
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
        deployment, of_file = mount_of_file()
        bounds = deployment.places[0].bounds
        searched = ["poles"] if deployment.poles else [key for key in ("x_m", "y_m") if key in bounds]
        if searched:
            middle = ", ".join(f"{place:g}" for place in deployment.nominal_xy)
            several = "has several places" if deployment.poles else "is searched"
            raise InputError(
                f"{of_file.where(searched[0])}: {several}, so that [region] must say where vehicles count; such as: "
                f"[region] centre_m = [{middle}], radius_m = {gate_m:g}"
            )
        centre = deployment.nominal_xy
    if radius is None:
        radius = gate_of_file()
    elif radius == GATE:
        radius = gate_m
    return replace(region, centre_m=centre, radius_m=radius)


def recordings_from(tables: Sequence[TomlTable]) -> list[TrafficSettings]:
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


def world_from(table: TomlTable, road: RoadSettings) -> WorldSettings:
    world = table.read_as(WorldSettings)
    along = next((key for key in ("barriers", "clutter") if getattr(world, key)), None)
    if along and road.is_map:
        raise InputError(f"{table.where(along)}: lie along a straight road; allowed on a map: boxes, blend or mesh")
    file = next((key for key in ("blend", "mesh") if getattr(world, key)), None)
    if file and not road.is_level:
        raise InputError(
            f"{table.where(file)}: is given beside a [road] with a grade or a cross-fall, and does not say whether it "
            "is plumb; allowed: boxes and barriers, which stand square on the road"
        )
    named = (replace(box, name=box.name or f"box {number}") for number, box in enumerate(world.boxes, start=1))
    return replace(world, boxes=tuple(named))


def objective_from(table: TomlTable) -> ObjectiveSettings:
    if "tolerance" in table.values:
        raise InputError(
            f"{table.where('tolerance')}: is called installer now; allowed: in [deployment] or a [[lidar]], such as "
            "installer = { tilt_deg = 1.0, height_m = 0.05 }, or false for a LiDAR that hangs already"
        )
    objective = table.read_as(ObjectiveSettings)
    metric_named(objective.metric, table.where("metric"))
    scored = objective.scored_classes
    for name in objective.class_weights:
        if name not in scored:
            raise InputError(
                f"{table.where('class_weights')}: {name} is not scored; allowed: those of classes, {', '.join(scored)}"
            )
    for number, zone in enumerate(objective.zones, start=1):
        check_polygon(zone.polygon_m, f"{table.where('zones')} {number} polygon_m")
    if objective.loss is None and objective.metric == PE_VGOP.name:
        return replace(objective, loss=_PAPERS_LOSS)
    return objective


def search_from(table: TomlTable, lidars: Sequence[LidarSpec]) -> SearchSettings:
    """[search]."""
    search = table.read_as(SearchSettings)
    if len(lidars) > 1 and search.fidelity != "full":
        raise InputError(
            f"{table.where('fidelity')}: is {search.fidelity!r} with {len(lidars)} LiDARs; allowed: full, as a move of "
            "one LiDAR costs one cast already"
        )
    several = search.fidelity == "full" and search.method != GridSearch.name and len(lidars) == 1
    if (search.seeds or 1) > 1 and not several:
        raise InputError(
            f"{table.where('seeds')}: is {search.seeds}; allowed: 1 with fidelity = "
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


def drawing_from(table: TomlTable) -> DrawingSettings:
    drawing = table.read_as(DrawingSettings)
    if (drawing.image is None) != (drawing.image_points is None):
        key, other = ("image", "image_points") if drawing.image_points is None else ("image_points", "image")
        raise InputError(f"{table.where(key)}: is given without {other}; allowed: both")
    points = drawing.image_points
    if points is not None and (len(points) != 2 or points[0][:2] == points[1][:2] or points[0][2:] == points[1][2:]):
        raise InputError(
            f"{table.where('image_points')}: do not place the image; allowed: two different points, each [pixels from "
            "the left, from the top, x_m, y_m]"
        )
    return drawing


def model_from(table: TomlTable) -> ModelSettings:
    model = table.read_as(ModelSettings)
    if model.cluster is not None and (model.workers or "workers" in table.origins):
        raise InputError(
            f"{table.where('cluster')}: has its own workers, and {table.where('workers')} asks for {model.workers} "
            "processes here; allowed: one of both"
        )
    return model
