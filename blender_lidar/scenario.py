"""A scene file, read and checked once: frozen settings from here on.

Every table and key is described in the README. Options of the command line replace the file's values before they are
checked, so both pass the same checks.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from .casting import CASTERS
from .errors import InputError, shown
from .metrics.catalogue import METRICS
from .metrics.views import PE_VGOP
from .optimise import READINGS, SEARCHES, VIEWS, DePso, DePsoSettings, GridSearch, Hardened
from .sensor_table import sensor_settings
from .settings import (
    COORDINATES,
    Deployment,
    ModelSettings,
    ObjectiveSettings,
    Scenario,
    SearchSettings,
    TrafficSettings,
    pose_at,
)
from .tolerance_table import tolerance_settings
from .toml_table import TomlTable, read_toml
from .traffic import FORMATS, RoadFrame
from .traffic.frames import DEFAULT_COUNT
from .world.shapes import DETAILS
from .world_table import world_settings

__all__ = ["COORDINATES", "COORDINATE_LIMITS", "Deployment", "Scenario", "load_scenario", "pose_at"]

TABLES = ("traffic", "road", "world", "sensor", "deployment", "baseline", "objective", "search", "model")
FIDELITIES = ("full", "auto")
HEIGHT_KEYS = ("car", "van", "truck", "long_truck", "bus", "motorcycle")
COORDINATE_LIMITS = {
    "x_m": (-1e5, 1e5),
    "y_m": (-1e5, 1e5),
    "height_m": (0.1, 100.0),
    "tilt_x_deg": (-90.0, 90.0),
    "tilt_y_deg": (-90.0, 90.0),
    "yaw_deg": (-360.0, 360.0),
}
# What an option of the key's name puts out of force in the file: frames are listed or spread evenly, and so on.
_RIVALS = {
    ("traffic", "frame_ids"): ("frames", "spacing_s"),
    ("traffic", "frames"): ("frame_ids",),
    ("model", "workers"): ("cluster",),
    ("model", "cluster"): ("workers",),
}
_DE_PSO_ALONE = ("inertia", "differential_weight", "cognitive", "social", "differential_threshold")
_LARGEST_M, _LARGEST_ORIGIN_M = 1e6, 1e9  # of the road, and of a place in a net; sums and squares stay finite
_PAPERS_LOSS = -1.0  # bit; with any other metric a vehicle below the threshold adds what the metric gives it
_MOST_LOSS = 1e9  # in the metric's unit; sums over many vehicles stay finite
_COEFFICIENT_LIMIT = 10.0  # of DE-PSO's coefficients; the paper's are below 1, and huge ones overflow
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
    overrides = overrides or {}
    root = TomlTable(values, str(path))
    tables = {}
    for name in TABLES:
        root.table(name)  # refuses what is no table
        options = {key: given for (table, key), given in overrides.items() if table == name}
        rivals = {rival for key in options for rival in _RIVALS.get((name, key), ())}
        if name == "search" and options.get("method", (DePso.name,))[0] != DePso.name:
            rivals.update(_DE_PSO_ALONE)  # the file's settings of a search that the option replaces
        content = {key: value for key, value in values.get(name, {}).items() if key not in rivals}
        content |= {key: value for key, (value, _) in options.items()}
        origins = {key: origin for key, (_, origin) in options.items()}
        tables[name] = TomlTable(content, f"{path}: [{name}]", origins)
    root.finish("table")

    deployment = _deployment(tables["deployment"])
    objective, search = _objective(tables["objective"]), _search(tables["search"], deployment)
    if search.fidelity == "auto" and objective.tolerance is not None:
        raise InputError(
            f'{tables["search"].where("fidelity")}: "auto" searches mountings that hang as planned, but '
            f'{tables["objective"].where("tolerance")} is given; allowed: fidelity = "full", or no tolerance'
        )
    scenario = Scenario(
        source=str(path),
        traffic=_traffic(tables["traffic"], path.parent),
        road=_road(tables["road"]),
        world=world_settings(tables["world"], path.parent),
        sensor=sensor_settings(tables["sensor"], path.parent),
        deployment=deployment,
        baseline=_baseline(tables["baseline"], deployment),
        objective=objective,
        search=search,
        model=_model(tables["world"], tables["model"]),
    )
    for table in tables.values():
        table.finish()
    return scenario


def _traffic(table: TomlTable, folder: Path) -> TrafficSettings:
    vehicle_types = table.text("vehicle_types", None)
    frames, spacing_s = table.whole("frames", None, low=1), table.number("spacing_s", None, above=0.0)
    frame_ids = table.whole_numbers("frame_ids", None)
    if frame_ids is not None and (frames is not None or spacing_s is not None):
        spread = table.where("frames" if frames is not None else "spacing_s")
        raise InputError(
            f"{table.where('frame_ids')}: lists the frames that {spread} spreads evenly; allowed: one of both"
        )
    heights = table.table("height_m")
    height_m = {key: heights.number(key, None, above=0.0, high=10.0) for key in HEIGHT_KEYS}
    heights.finish()
    return TrafficSettings(
        path=_path(table, "path", folder, table.text("path")),
        format=table.text("format", "auto", allowed=FORMATS),
        period=table.text("period", None),
        location=table.text("location", None),
        origin_m=table.numbers("origin_m", None, count=2, largest=_LARGEST_ORIGIN_M),
        heading_deg=table.number("heading_deg", None, low=-360.0, high=360.0),
        lanes=table.whole_numbers("lanes", None),
        frames=DEFAULT_COUNT if frames is None and frame_ids is None and spacing_s is None else frames,
        time_step_s=table.number("time_step_s", None, above=0.0),
        vehicle_types=None if vehicle_types is None else _path(table, "vehicle_types", folder, vehicle_types),
        frame_ids=frame_ids,
        spacing_s=spacing_s,
        holdout=table.number("holdout", 0.4, low=0.0, high=0.9),
        block_s=table.number("block_s", None, above=0.0),
        height_m={key: value for key, value in height_m.items() if value is not None},
    )


def _path(table: TomlTable, key: str, folder: Path, path: str) -> str:
    """A path that the scene gives, from its own folder on, or an option."""
    return str((Path() if table.overridden(key) else folder) / path)


def _road(table: TomlTable) -> RoadFrame:
    default = RoadFrame()
    return RoadFrame(
        station_m=table.number("station_m", default.station_m, low=-_LARGEST_M, high=_LARGEST_M),
        right_edge_m=table.number("right_edge_m", default.right_edge_m, low=-_LARGEST_M, high=_LARGEST_M),
        setback_m=table.number("setback_m", default.setback_m, low=0.0, high=_LARGEST_M),
        lanes=table.whole("lanes", default.lanes, low=1, high=50),
        lane_width_m=table.number("lane_width_m", default.lane_width_m, above=0.0, high=10.0),
    )


def _deployment(table: TomlTable) -> Deployment:
    defaults = {"height_m": (2.0, 4.5), "tilt_x_deg": (0.0, 25.0)}  # the paper's ranges, section V.A
    fixed, bounds = {}, {}
    for key in COORDINATES:
        low, high = COORDINATE_LIMITS[key]
        value = table.number_or_pair(key, defaults.get(key, 0.0), low=low, high=high)
        (bounds if isinstance(value, tuple) else fixed)[key] = value
    return Deployment(fixed, bounds)


def _baseline(table: TomlTable, deployment: Deployment) -> dict[str, float]:
    x_m, y_m = deployment.nominal_xy
    defaults = {"x_m": x_m, "y_m": y_m, "height_m": 2.0}  # height: section V.A of the paper
    baseline = {}
    for key in COORDINATES:
        low, high = COORDINATE_LIMITS[key]
        baseline[key] = table.number(key, defaults.get(key, 0.0), low=low, high=high)
    return baseline


def _objective(table: TomlTable) -> ObjectiveSettings:
    metric = table.text("metric", PE_VGOP.name, allowed=METRICS)
    return ObjectiveSettings(
        metric=metric,
        reading=table.text("reading", "corrected", allowed=READINGS),
        cell_m=table.number("cell_m", 0.05, low=0.005, high=1.0),
        threshold=table.number("threshold", 0.005, low=0.0, high=1.0),
        view=table.text("view", "mean", allowed=VIEWS),
        loss=table.number("loss", _PAPERS_LOSS if metric == PE_VGOP.name else None, low=-_MOST_LOSS, high=_MOST_LOSS),
        tolerance=tolerance_settings(table.optional_table("tolerance")),
    )


def _search(table: TomlTable, deployment: Deployment) -> SearchSettings:
    paper = DePsoSettings()
    settings = SearchSettings(
        method=table.text("method", Hardened.name, allowed=SEARCHES),
        fidelity=table.text("fidelity", "full", allowed=FIDELITIES),
        seed=table.whole("seed", 1, low=0),
        particles=table.whole("particles", paper.particles, low=3, high=10_000),
        iterations=table.whole("iterations", paper.iterations, low=1, high=1_000_000),
        **{key: table.number(key, None, low=0.0, high=_COEFFICIENT_LIMIT) for key in _DE_PSO_ALONE[:-1]},
        differential_threshold=table.number("differential_threshold", None, low=0.0, high=1.0),
    )
    given = [key for key in _DE_PSO_ALONE if getattr(settings, key) is not None]
    if settings.method == DePso.name:
        settings = replace(settings, **{key: getattr(paper, key) for key in _DE_PSO_ALONE if key not in given})
    elif given:
        raise InputError(
            f"{table.where(given[0])}: a setting of {DePso.name} alone, but the method is {settings.method}; "
            f'allowed: method = "{DePso.name}", or leave it out'
        )
    corners = 2 ** len(deployment.bounds)
    if settings.method == GridSearch.name and settings.particles * settings.iterations < corners:
        raise InputError(
            f"{table.where('particles')}: {settings.particles} x {settings.iterations} iterations are too few "
            f"evaluations for a grid over {len(deployment.bounds)} coordinates; allowed: {corners} or more"
        )
    return settings


def _model(world: TomlTable, model: TomlTable) -> ModelSettings:
    workers, cluster = model.whole("workers", 0, low=0, high=256), model.text("cluster", None)
    if cluster is not None and not _is_address(cluster):
        raise InputError(f"{model.where('cluster')}: is {shown(cluster)}; allowed: such as tcp://host:8786")
    if cluster is not None and (workers or model.overridden("workers")):
        raise InputError(
            f"{model.where('cluster')}: has its own workers, and {model.where('workers')} asks for {workers} processes "
            "here; allowed: one of both"
        )
    return ModelSettings(
        detail=world.text("detail", "body", allowed=DETAILS),
        caster=model.text("caster", "auto", allowed=("auto", *CASTERS)),
        workers=workers,
        cluster=cluster,
    )


def _is_address(text: str) -> bool:
    """Whether a text is the address of a dask scheduler."""
    found = _ADDRESS.fullmatch(text)
    return found is not None and 0 < int(found["port"]) < 2**16
