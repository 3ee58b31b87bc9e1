"""Reading a scene file into frozen settings: what one setting alone cannot say is checked here.

Every table and key is described in docs/reference/scene_file.md. Options of the command line replace the file's values
before they are checked, so both pass the same checks.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from ..errors import InputError, MissingFileError, shown
from ..metrics.catalogue import PE_VGOP
from ..optimise import DePso, GridSearch
from ..sensors.imperfections import MOST_RANGE_NOISE_M
from ..sensors.model import LidarModel, load_model, unit_of
from ..toml_table import TomlTable, read_toml, settings_of
from ..traffic import RoadFrame
from ..traffic.frames import DEFAULT_COUNT
from .settings import (
    COORDINATE_LIMITS,
    COORDINATES,
    DATASHEET,
    DE_PSO,
    HEIGHTS,
    MOUNTING,
    ROAD,
    SEARCHED,
    Deployment,
    ModelSettings,
    ObjectiveSettings,
    Scenario,
    SearchSettings,
    SensorSettings,
    Tolerance,
    TrafficSettings,
    WorldSettings,
    is_sensor_file,
    pose_at,
)

__all__ = ["COORDINATES", "COORDINATE_LIMITS", "Deployment", "Scenario", "load_scenario", "pose_at"]

DECLARED = {
    "traffic": settings_of(TrafficSettings),
    "road": ROAD,
    "world": settings_of(WorldSettings),
    "sensor": settings_of(SensorSettings),
    "deployment": {
        key: replace(declared, kind=float | tuple[float, float], default=SEARCHED.get(key, 0.0))
        for key, declared in MOUNTING.items()
    },
    "baseline": MOUNTING,
    "objective": settings_of(ObjectiveSettings),
    "search": settings_of(SearchSettings),
    "model": settings_of(ModelSettings),
}
"""The settings of each table of a scene file."""
_DE_PSO_ALONE = ("inertia", "differential_weight", "cognitive", "social", "differential_threshold")
_OF_ANY_MODEL = ("name", "unit", "noise_seed")  # keys of [sensor] that a single model's table within it has not
_PAPERS_LOSS = -1.0  # bit; with any other metric a vehicle below the threshold adds what the metric gives it
_LONGEST_BARRIER_M = 10_000.0
_ADDRESS = re.compile(r"(tcp|tls|ws|wss)://([\w.-]+|\[[0-9A-Fa-f:.%]+\]):(?P<port>[0-9]{1,5})", re.ASCII)

Overrides = Mapping[tuple[str, str], tuple[object, str]]


def load_scenario(path: str | Path, overrides: Overrides | None = None) -> Scenario:
    """Read a scene file.

    Parameters
    ----------
    path : path
        The TOML file. Relative paths in it start from its folder.
    overrides : mapping of (table, key) to (value, origin), optional
        Values that replace the file's, and where each came from: ``{("sensor", "name"): ("RS-80", "--sensor")}``.
        A path among them starts from the working folder.

    Raises
    ------
    MissingFileError, InputError
        Naming the file, the table and the key.
    """
    path = Path(path)
    values = read_toml(path)
    root = TomlTable(values, str(path))
    tables = {}
    for name, declared in DECLARED.items():
        root.table(name)  # refuses what is no table
        options = {key: given for (table, key), given in (overrides or {}).items() if table == name}
        rivals = {rival for key in options if key in declared for rival in declared[key].rivals}
        if name == "search" and options.get("method", (DePso.name,))[0] != DePso.name:
            rivals.update(_DE_PSO_ALONE)  # the file's settings of a search that the option replaces
        content = {key: value for key, value in values.get(name, {}).items() if key not in rivals}
        content |= {key: value for key, (value, _) in options.items()}
        origins = {key: origin for key, (_, origin) in options.items()}
        tables[name] = TomlTable(content, f"{path}: [{name}]", origins, path.parent)
    root.finish("table")

    bounds = tables["deployment"].read(DECLARED["deployment"])
    deployment = Deployment(
        {key: value for key, value in bounds.items() if not isinstance(value, tuple)},
        {key: value for key, value in bounds.items() if isinstance(value, tuple)},
    )
    nominal = dict(zip(("x_m", "y_m"), deployment.nominal_xy, strict=True))
    objective, search = _objective(tables["objective"]), _search(tables["search"], deployment)
    if search.fidelity == "auto" and objective.tolerance is not None:
        raise InputError(
            f'{tables["search"].where("fidelity")}: "auto" searches mountings that hang as planned, but '
            f'{tables["objective"].where("tolerance")} is given; allowed: fidelity = "full", or no tolerance'
        )
    scenario = Scenario(
        source=str(path),
        traffic=_traffic(tables["traffic"]),
        road=RoadFrame(**tables["road"].read(ROAD)),
        world=_world(tables["world"]),
        sensor=_sensor(tables["sensor"]),
        deployment=deployment,
        baseline=tables["baseline"].read(
            {key: replace(one, default=nominal.get(key, one.default)) for key, one in MOUNTING.items()}
        ),
        objective=objective,
        search=search,
        model=_model(tables["model"]),
    )
    for table in tables.values():
        table.finish()
    return scenario


def _traffic(table: TomlTable) -> TrafficSettings:
    found = table.read(DECLARED["traffic"])
    if found["frame_ids"] is not None and (found["frames"] is not None or found["spacing_s"] is not None):
        spread = table.where("frames" if found["frames"] is not None else "spacing_s")
        raise InputError(
            f"{table.where('frame_ids')}: lists the frames that {spread} spreads evenly; allowed: one of both"
        )
    if found["frames"] is None and found["frame_ids"] is None and found["spacing_s"] is None:
        found["frames"] = DEFAULT_COUNT
    heights = table.table("height_m")
    height_m = heights.read(HEIGHTS)
    heights.finish()
    return TrafficSettings(**found, height_m={key: value for key, value in height_m.items() if value is not None})


def _world(table: TomlTable) -> WorldSettings:
    found = table.read(DECLARED["world"])
    for key, allowed in (
        ("blend", "a .blend file"),
        ("mesh", "a mesh file that Blender reads; .blend files go to blend"),
    ):
        if found[key] is not None and (Path(found[key]).suffix.lower() == ".blend") != (key == "blend"):
            raise InputError(f"{table.where(key)}: is {found[key]!r}; allowed: {allowed}")
    for number, box in enumerate(found["boxes"], start=1):
        if not all(length > 0.0 for length in box.size_m):
            where = f"{table.where('boxes')} {number} size_m"
            raise InputError(f"{where}: is {list(box.size_m)}; allowed: a length, width and height above 0")
    for number, barrier in enumerate(found["barriers"], start=1):
        where = f"{table.where('barriers')} {number} x_m"
        if not isinstance(barrier.x_m, tuple):
            raise InputError(f"{where}: is {barrier.x_m}; allowed: a pair [from, to]")
        if barrier.x_m[1] - barrier.x_m[0] > _LONGEST_BARRIER_M:
            raise InputError(f"{where}: is {list(barrier.x_m)}; allowed: at most {_LONGEST_BARRIER_M:g} m apart")
    named = (replace(box, name=box.name or f"box {number}") for number, box in enumerate(found["boxes"], start=1))
    return WorldSettings(**found | {"boxes": tuple(named)})


def _sensor(table: TomlTable) -> SensorSettings:
    """[sensor], and the table of the chosen model within it, whose keys count over the general ones."""
    found = table.read(DECLARED["sensor"])
    name = _sensor_name(found["name"], table.folder_of("name"))
    model = _model_named(name, table.where("name"))
    where = {key: table.where(key) for key in found}
    of_one = {key: declared for key, declared in DECLARED["sensor"].items() if key not in _OF_ANY_MODEL}
    for sensor, own in table.tables().items():
        own_found = own.read(of_one)
        own.finish()
        if _model_named(_sensor_name(sensor, own.folder_of("")), table.where(sensor)).name != model.name:
            continue
        for key, value in own_found.items():
            if value is not None and not table.overridden(key):
                found[key], where[key] = value, own.where(key)
    try:
        rate = model.rotation_rate(found["rotation_hz"])
    except InputError as error:
        raise InputError(f"{where['rotation_hz']}: {error}") from error
    gate = found["range_gate_m"] or model.range_max_m
    if not model.range_min_m < gate <= model.range_max_m:
        raise InputError(
            f"{where['range_gate_m']}: is {gate}; allowed for {model.name}: more than {model.range_min_m:g}, "
            f"at most {model.range_max_m:g}"
        )
    if found["range_noise_m"] == DATASHEET:
        found["range_noise_m"] = model.range_noise_m
        if model.range_noise_m > MOST_RANGE_NOISE_M:
            told = f"{model.name} has {model.range_noise_m:g}; allowed: at most {MOST_RANGE_NOISE_M:g}"
            raise InputError(f"{where['range_noise_m']}: {told}")
    if found["range_at_10_percent_m"] == DATASHEET:
        found["range_at_10_percent_m"] = model.range_at_10_percent_m
        if model.range_at_10_percent_m is None:
            told = f"no source gives that of {model.name}; allowed: a number"
            raise InputError(f"{where['range_at_10_percent_m']}: {told}")
    for key in ("range_noise_m", "dropout", "glass_dropout", "unit_spread_deg"):
        found[key] = found[key] or 0.0
    try:
        unit_of(model, found["unit_spread_deg"], found["unit"])
    except InputError as error:
        raise InputError(f"{where['unit_spread_deg']}: {error}") from error
    known = name if is_sensor_file(name) else model.name
    return SensorSettings(**found | {"name": known, "rotation_hz": rate, "range_gate_m": gate})


def _sensor_name(name: str, folder: Path) -> str:
    """A sensor's name as it is, the path of a beam table from `folder` on."""
    return str(folder / name) if is_sensor_file(name) else name


def _model_named(name: str, where: str) -> LidarModel:
    try:
        return load_model(name)
    except (MissingFileError, InputError) as error:
        raise type(error)(f"{where}: {error}") from error


def _objective(table: TomlTable) -> ObjectiveSettings:
    found = table.read(DECLARED["objective"])
    if found["loss"] is None and found["metric"] == PE_VGOP.name:
        found["loss"] = _PAPERS_LOSS
    if found["tolerance"] is not None and not found["tolerance"].half_widths:
        keys = ", ".join(key for key in settings_of(Tolerance) if key != "aim")
        where = table.nested("tolerance")
        raise InputError(f"{where}: leaves every coordinate exact; allowed: at least one of {keys} above 0")
    return ObjectiveSettings(**found)


def _search(table: TomlTable, deployment: Deployment) -> SearchSettings:
    search = SearchSettings(**table.read(DECLARED["search"]))
    given = [key for key in _DE_PSO_ALONE if getattr(search, key) is not None]
    if search.method == DePso.name:
        search = replace(search, **{key: getattr(DE_PSO, key) for key in _DE_PSO_ALONE if key not in given})
    elif given:
        raise InputError(
            f"{table.where(given[0])}: a setting of {DePso.name} alone, but the method is {search.method}; "
            f'allowed: method = "{DePso.name}", or leave it out'
        )
    corners = 2 ** len(deployment.bounds)
    if search.method == GridSearch.name and search.particles * search.iterations < corners:
        raise InputError(
            f"{table.where('particles')}: {search.particles} x {search.iterations} iterations are too few "
            f"evaluations for a grid over {len(deployment.bounds)} coordinates; allowed: {corners} or more"
        )
    return search


def _model(table: TomlTable) -> ModelSettings:
    model = ModelSettings(**table.read(DECLARED["model"]))
    address = model.cluster and _ADDRESS.fullmatch(model.cluster)
    if model.cluster is not None and not (address and 0 < int(address["port"]) < 2**16):
        raise InputError(f"{table.where('cluster')}: is {shown(model.cluster)}; allowed: such as tcp://host:8786")
    if model.cluster is not None and (model.workers or table.overridden("workers")):
        raise InputError(
            f"{table.where('cluster')}: has its own workers, and {table.where('workers')} asks for {model.workers} "
            "processes here; allowed: one of both"
        )
    return model
