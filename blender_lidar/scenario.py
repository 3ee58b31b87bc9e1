"""A scene file, read and checked once: frozen settings from here on.

Every table and key is described in the README. Options of the command line replace the file's values before they are checked, so both
pass the same checks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from .errors import InputError, MissingFileError
from .optimise import READINGS, SEARCHES, VIEWS, DePsoSettings
from .sensors.model import LidarModel, load_model
from .sensors.pose import Pose
from .toml_table import TomlTable, read_toml
from .traffic import FORMATS, RoadFrame
from .world.shapes import DETAILS

COORDINATES = ("x_m", "y_m", "height_m", "tilt_x_deg", "tilt_y_deg", "yaw_deg")
TABLES = ("traffic", "road", "world", "sensor", "deployment", "baseline", "objective", "search", "model")
METRICS = ("pe-vgop",)
HEIGHT_KEYS = ("car", "van", "truck", "long_truck", "bus", "motorcycle")
_TILT_LIMIT_DEG = 90.0

Overrides = Mapping[tuple[str, str], tuple[object, str]]


@dataclass(frozen=True, slots=True)
class TrafficSettings:
    """[traffic]: where the vehicles come from and which instants are looked at."""

    path: str
    format: str
    period: str | None
    location: str | None
    origin_m: tuple[float, float] | None
    heading_deg: float | None
    lanes: tuple[int, ...] | None
    frames: int
    frame_ids: tuple[int, ...] | None
    spacing_s: float | None
    holdout: float
    block_s: float | None
    height_m: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class SensorSettings:
    """[sensor]: the model, its rate and the range within which it is asked to see."""

    name: str
    rotation_hz: float
    range_gate_m: float


@dataclass(frozen=True, slots=True)
class Deployment:
    """[deployment]: which coordinates of the mounting are fixed, and between what bounds the others are searched.

    Attributes
    ----------
    fixed : mapping of str to float
        Coordinates of `COORDINATES` that stay.
    bounds : mapping of str to (float, float)
        The others, in the order of `COORDINATES`; metres and degrees.
    """

    fixed: Mapping[str, float]
    bounds: Mapping[str, tuple[float, float]]

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of the searched coordinates."""
        return tuple(self.bounds)

    @property
    def lower(self) -> tuple[float, ...]:
        return tuple(low for low, _ in self.bounds.values())

    @property
    def upper(self) -> tuple[float, ...]:
        return tuple(high for _, high in self.bounds.values())

    @property
    def nominal_xy(self) -> tuple[float, float]:
        """Where the region of interest is centred [m]: the mount's place, or the middle of where it may be."""
        return tuple(0.5 * sum(self.bounds[key]) if key in self.bounds else self.fixed[key] for key in ("x_m", "y_m"))

    def coordinates(self, x) -> dict[str, float]:
        """All six coordinates (metres, degrees) at the point `x` (d,) of the search space."""
        free = dict(zip(self.variables, map(float, x), strict=True))
        return {key: free[key] if key in free else self.fixed[key] for key in COORDINATES}

    def pose(self, x) -> Pose:
        """The mounting at the point `x` (d,) of the search space."""
        return pose_at(self.coordinates(x))


@dataclass(frozen=True, slots=True)
class ObjectiveSettings:
    """[objective]: what is maximised."""

    metric: str
    reading: str
    cell_m: float
    threshold: float
    view: str
    loss: float


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """[search]: how the best mounting is looked for."""

    method: str
    seed: int
    particles: int
    iterations: int
    inertia: float
    differential_weight: float
    cognitive: float
    social: float
    differential_threshold: float


@dataclass(frozen=True, slots=True)
class ModelSettings:
    """[world] and [model]: how much of the world is modelled, and what carries it out."""

    detail: str
    caster: str
    workers: int


@dataclass(frozen=True, slots=True)
class Scenario:
    """A whole scene, checked."""

    source: str
    traffic: TrafficSettings
    road: RoadFrame
    sensor: SensorSettings
    deployment: Deployment
    baseline: Mapping[str, float]
    objective: ObjectiveSettings
    search: SearchSettings
    model: ModelSettings

    @property
    def baseline_pose(self) -> Pose:
        return pose_at(self.baseline)

    def as_tables(self) -> dict[str, dict]:
        """The scene as used, in the layout of a scene file: reading it again gives this scene."""
        traffic = asdict(self.traffic)
        for key in ("frame_ids", "lanes", "origin_m"):
            traffic[key] = None if traffic[key] is None else list(traffic[key])
        deployment = {
            key: self.deployment.fixed.get(key, list(self.deployment.bounds.get(key, ()))) for key in COORDINATES
        }
        return {
            "traffic": traffic,
            "road": asdict(self.road),
            "world": {"detail": self.model.detail},
            "sensor": asdict(self.sensor),
            "deployment": deployment,
            "baseline": dict(self.baseline),
            "objective": asdict(self.objective),
            "search": asdict(self.search),
            "model": {"caster": self.model.caster, "workers": self.model.workers},
        }


def pose_at(coordinates: Mapping[str, float]) -> Pose:
    """The mounting at the six coordinates of `COORDINATES`, degrees becoming radians."""
    return Pose(
        x_m=coordinates["x_m"],
        y_m=coordinates["y_m"],
        height_m=coordinates["height_m"],
        tilt_x=math.radians(coordinates["tilt_x_deg"]),
        tilt_y=math.radians(coordinates["tilt_y_deg"]),
        yaw=math.radians(coordinates["yaw_deg"]),
    )


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
        content = dict(values.get(name, {}))
        origins = {}
        for (table, key), (value, origin) in overrides.items():
            if table == name:
                content[key], origins[key] = value, origin
        tables[name] = TomlTable(content, f"{path}: [{name}]", origins)
    root.finish()

    from_options = {key for table, key in overrides if table == "traffic"}
    deployment = _deployment(tables["deployment"])
    scenario = Scenario(
        source=str(path),
        traffic=_traffic(tables["traffic"], path.parent if "path" not in from_options else Path()),
        road=_road(tables["road"]),
        sensor=_sensor(tables["sensor"], path.parent),
        deployment=deployment,
        baseline=_baseline(tables["baseline"], deployment),
        objective=_objective(tables["objective"]),
        search=_search(tables["search"]),
        model=_model(tables["world"], tables["model"]),
    )
    for table in tables.values():
        table.finish()
    return scenario


def _traffic(table: TomlTable, folder: Path) -> TrafficSettings:
    path = folder / table.text("path")
    heights = table.table("height_m")
    height_m = {key: heights.number(key, None, above=0.0, high=10.0) for key in HEIGHT_KEYS}
    heights.finish()
    return TrafficSettings(
        path=str(path),
        format=table.text("format", "auto", allowed=FORMATS),
        period=table.text("period", None),
        location=table.text("location", None),
        origin_m=table.numbers("origin_m", None, count=2),
        heading_deg=table.number("heading_deg", None, low=-360.0, high=360.0),
        lanes=table.whole_numbers("lanes", None),
        frames=table.whole("frames", 36, low=1),
        frame_ids=table.whole_numbers("frame_ids", None),
        spacing_s=table.number("spacing_s", None, above=0.0),
        holdout=table.number("holdout", 0.4, low=0.0, high=0.9),
        block_s=table.number("block_s", None, above=0.0),
        height_m={key: value for key, value in height_m.items() if value is not None},
    )


def _road(table: TomlTable) -> RoadFrame:
    default = RoadFrame()
    return RoadFrame(
        station_m=table.number("station_m", default.station_m),
        right_edge_m=table.number("right_edge_m", default.right_edge_m),
        setback_m=table.number("setback_m", default.setback_m, low=0.0),
        lanes=table.whole("lanes", default.lanes, low=1, high=50),
        lane_width_m=table.number("lane_width_m", default.lane_width_m, above=0.0, high=10.0),
    )


def _sensor(table: TomlTable, folder: Path) -> SensorSettings:
    name = table.text("name", "RS-16")
    if name.endswith((".toml", ".csv")) and (folder / name).is_file():
        name = str(folder / name)
    model = _model_named(name, table.where("name"))
    keys = ("rotation_hz", "range_gate_m")
    settings = {key: table.number(key, None, above=0.0) for key in keys}
    where = {key: table.where(key) for key in keys}
    for sensor, own in table.tables().items():
        found = {key: own.number(key, None, above=0.0) for key in keys}
        own.finish()
        if sensor == name or _model_named(sensor, f"{table.where(sensor)}").name == model.name:
            for key in keys:
                if found[key] is not None and not table.overridden(key):
                    settings[key], where[key] = found[key], own.where(key)
    rate, gate = settings["rotation_hz"], settings["range_gate_m"]
    try:
        rate = model.rotation_rate(rate)
    except InputError as error:
        raise InputError(f"{where['rotation_hz']}: {error}") from error
    gate = model.range_max_m if gate is None else gate
    if not model.range_min_m < gate <= model.range_max_m:
        raise InputError(
            f"{where['range_gate_m']}: is {gate:g}; allowed for {model.name}: more than {model.range_min_m:g}, "
            f"at most {model.range_max_m:g}"
        )
    return SensorSettings(name=name if Path(name).is_file() else model.name, rotation_hz=rate, range_gate_m=gate)


def _model_named(name: str, where: str) -> LidarModel:
    try:
        return load_model(name)
    except MissingFileError as error:
        raise MissingFileError(f"{where}: {error}") from error
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _deployment(table: TomlTable) -> Deployment:
    limits = {
        "height_m": {"low": 0.1, "high": 100.0},
        "tilt_x_deg": {"low": -_TILT_LIMIT_DEG, "high": _TILT_LIMIT_DEG},
        "tilt_y_deg": {"low": -_TILT_LIMIT_DEG, "high": _TILT_LIMIT_DEG},
        "yaw_deg": {"low": -360.0, "high": 360.0},
    }
    defaults = {"height_m": (2.0, 4.5), "tilt_x_deg": (0.0, 25.0)}  # the paper's ranges, section V.A
    fixed, bounds = {}, {}
    for key in COORDINATES:
        value = table.number_or_pair(key, defaults.get(key, 0.0), **limits.get(key, {}))
        (bounds if isinstance(value, tuple) else fixed)[key] = value
    return Deployment(fixed, bounds)


def _baseline(table: TomlTable, deployment: Deployment) -> dict[str, float]:
    x_m, y_m = deployment.nominal_xy
    defaults = {"x_m": x_m, "y_m": y_m, "height_m": 2.0}  # height: section V.A of the paper
    baseline = {key: table.number(key, defaults.get(key, 0.0)) for key in COORDINATES}
    if not baseline["height_m"] > 0.0:
        raise InputError(f"{table.where('height_m')}: is {baseline['height_m']:g}; allowed: more than 0")
    return baseline


def _objective(table: TomlTable) -> ObjectiveSettings:
    return ObjectiveSettings(
        metric=table.text("metric", "pe-vgop", allowed=METRICS),
        reading=table.text("reading", "corrected", allowed=READINGS),
        cell_m=table.number("cell_m", 0.05, low=0.005, high=1.0),
        threshold=table.number("threshold", 0.005, low=0.0, high=1.0),
        view=table.text("view", "mean", allowed=VIEWS),
        loss=table.number("loss", -1.0),
    )


def _search(table: TomlTable) -> SearchSettings:
    paper = DePsoSettings()
    return SearchSettings(
        method=table.text("method", "de-pso", allowed=SEARCHES),
        seed=table.whole("seed", 1, low=0),
        particles=table.whole("particles", paper.particles, low=3, high=10_000),
        iterations=table.whole("iterations", paper.iterations, low=1, high=1_000_000),
        inertia=table.number("inertia", paper.inertia, low=0.0),
        differential_weight=table.number("differential_weight", paper.differential_weight, low=0.0),
        cognitive=table.number("cognitive", paper.cognitive, low=0.0),
        social=table.number("social", paper.social, low=0.0),
        differential_threshold=table.number("differential_threshold", paper.differential_threshold, low=0.0, high=1.0),
    )


def _model(world: TomlTable, model: TomlTable) -> ModelSettings:
    return ModelSettings(
        detail=world.text("detail", "body", allowed=DETAILS),
        caster=model.text("caster", "auto", allowed=("auto", "bvh", "embree", "exact")),
        workers=model.whole("workers", 0, low=0, high=256),
    )
