"""The settings of a scene, frozen: what `scenario.load_scenario` makes of a scene file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass

from .sensors.files import SUFFIXES
from .sensors.imperfections import Imperfections
from .sensors.pose import Pose
from .traffic import RoadFrame

COORDINATES = ("x_m", "y_m", "height_m", "tilt_x_deg", "tilt_y_deg", "yaw_deg")


@dataclass(frozen=True, slots=True)
class TrafficSettings:
    """[traffic]: where the vehicles come from and which instants are looked at.

    `frames` is None where `frame_ids` lists them, or `spacing_s` alone spreads them. `vehicle_types` is the path of the
    file with the sizes of SUMO's vehicles.
    """

    path: str
    format: str
    period: str | None
    location: str | None
    origin_m: tuple[float, float] | None
    heading_deg: float | None
    time_step_s: float | None
    vehicle_types: str | None
    lanes: tuple[int, ...] | None
    frames: int | None
    frame_ids: tuple[int, ...] | None
    spacing_s: float | None
    holdout: float
    block_s: float | None
    height_m: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class SensorSettings:
    """[sensor]: the model, its rate, the range within which it is asked to see, and how imperfect it is.

    `name` is that of a model, or the path of a user's own beam table.
    """

    name: str
    rotation_hz: float
    range_gate_m: float
    range_noise_m: float
    dropout: float
    glass_dropout: float
    range_at_10_percent_m: float | None
    unit_spread_deg: float
    unit: int
    noise_seed: int

    @property
    def is_file(self) -> bool:
        """Whether the sensor is a user's own."""
        return is_sensor_file(self.name)

    @property
    def imperfections(self) -> Imperfections:
        """How its returns differ from the truth."""
        return Imperfections(
            self.range_noise_m,
            self.dropout,
            glass_dropout=self.glass_dropout,
            range_at_10_percent_m=self.range_at_10_percent_m,
            seed=self.noise_seed,
        )

    def imperfections_as_table(self) -> dict[str, float | int | None]:
        """The keys of [sensor] that make it imperfect."""
        keys = ("range_noise_m", "dropout", "glass_dropout", "range_at_10_percent_m")
        return {key: getattr(self, key) for key in (*keys, "unit_spread_deg", "unit", "noise_seed")}


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
class Tolerance:
    """[objective] tolerance: how far off its plan a mounting may end up, as half-widths.

    Each error is uniform between minus and plus its half-width and independent of the others.

    Attributes
    ----------
    height_m : float
        Of the height [m].
    tilt_deg : float
        Of both tilts, across the road and along it [degrees]: the inclinometer that sets the one sets the other too.
    yaw_deg : float
        Of the yaw [degrees].
    aim : {"mean", "low"}
        What is maximised of the objective over these errors: its mean, or what it reaches in nine cases of ten.
    """

    height_m: float
    tilt_deg: float
    yaw_deg: float
    aim: str

    @property
    def half_widths(self) -> dict[str, float]:
        """Of each of `COORDINATES` that is not exact, in their order [m, degrees]."""
        widths = {
            "height_m": self.height_m,
            "tilt_x_deg": self.tilt_deg,
            "tilt_y_deg": self.tilt_deg,
            "yaw_deg": self.yaw_deg,
        }
        return {key: width for key, width in widths.items() if width > 0.0}


@dataclass(frozen=True, slots=True)
class ObjectiveSettings:
    """[objective]: what is maximised.

    `loss` is None where a vehicle below the threshold adds what the metric gives it, as others do; `tolerance` is None
    where mountings are taken to hang as planned.
    """

    metric: str
    reading: str
    cell_m: float
    threshold: float
    view: str
    loss: float | None
    tolerance: Tolerance | None = None


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """[search]: how the best mounting is looked for; what is DE-PSO's alone is None with any other method.

    `fidelity` is "full" where every mounting is scored on all searched frames with all beams, "auto" where most are
    screened on less.
    """

    method: str
    fidelity: str
    seed: int
    particles: int
    iterations: int
    inertia: float | None
    differential_weight: float | None
    cognitive: float | None
    social: float | None
    differential_threshold: float | None


@dataclass(frozen=True, slots=True)
class BoxSettings:
    """An entry of [[world.boxes]]: something that stands still, in the road frame."""

    name: str
    centre_m: tuple[float, float, float]
    size_m: tuple[float, float, float]
    heading_deg: float


@dataclass(frozen=True, slots=True)
class BarrierSettings:
    """An entry of [[world.barriers]]: a barrier along the line y = `y_m` between two x."""

    kind: str
    y_m: float
    x_m: tuple[float, float]


@dataclass(frozen=True, slots=True)
class WorldSettings:
    """[world]: what there is besides vehicles.

    `ground` is whether the plane z = 0 returns. `blend` and `mesh` are files of scenery in a frame of their own, in
    which the road frame's origin lies at `origin_m` and its x axis points along `heading_deg`.
    """

    ground: bool
    blend: str | None
    mesh: str | None
    origin_m: tuple[float, float, float]
    heading_deg: float
    boxes: tuple[BoxSettings, ...]
    barriers: tuple[BarrierSettings, ...]

    @property
    def has_scenery(self) -> bool:
        """Whether anything stands still and hides vehicles."""
        return bool(self.blend or self.mesh or self.boxes or self.barriers)


@dataclass(frozen=True, slots=True)
class ModelSettings:
    """[world] detail and [model]: how finely vehicles are modelled, and what carries it out."""

    detail: str
    caster: str
    workers: int
    cluster: str | None


@dataclass(frozen=True, slots=True)
class Scenario:
    """A whole scene, checked."""

    source: str
    traffic: TrafficSettings
    road: RoadFrame
    world: WorldSettings
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
        world = asdict(self.world)
        deployment = {
            key: self.deployment.fixed.get(key, list(self.deployment.bounds.get(key, ()))) for key in COORDINATES
        }
        return {
            "traffic": traffic,
            "road": asdict(self.road),
            "world": {"detail": self.model.detail, **world},
            "sensor": asdict(self.sensor),
            "deployment": deployment,
            "baseline": dict(self.baseline),
            "objective": asdict(self.objective),
            "search": asdict(self.search),
            "model": {"caster": self.model.caster, "workers": self.model.workers, "cluster": self.model.cluster},
        }


def is_sensor_file(name: str) -> bool:
    """Whether `name` is the path of a beam table, not the name of a model."""
    return name.lower().endswith(SUFFIXES)


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
