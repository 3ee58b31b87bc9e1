"""The settings of a scene, each declared once: type, default, limits, option and help; frozen when read.

`scenario.load_scenario` reads them from a file, `commands.options` from the command line. Needs the standard library
alone, so that help opens at once.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, get_type_hints

from ..errors import InputError
from ..names import (
    BARRIERS,
    CASTERS,
    DEFAULT_CELL_M,
    DETAILS,
    ITERATIONS,
    METRIC_NAMES,
    MOST_RANGE_NOISE_M,
    MOST_SPREAD_DEG,
    PARTICLES,
    READINGS,
    SEARCHES,
    SENSOR_SUFFIXES,
    STATED_RANGE_LIMITS_M,
    TRAFFIC_FORMATS,
    VIEWS,
    WARNINGS,
)
from ..plugins import METRICS_OF_OTHERS, SEARCHES_OF_OTHERS
from ..road import RoadFrame
from ..toml_table import Setting, setting, settings_of

if TYPE_CHECKING:
    from ..sensors.imperfections import Imperfections
    from ..sensors.pose import Pose

DATASHEET = "datasheet"  # in place of a number: the model's own
GATE = "gate"  # in place of a radius: the sensor's range gate
_NO_LEAN_DEG = 1e-6
_SAME_ROTATION = 1e-6
_LARGEST_ORIGIN_M = 1e9  # of a place in a net; sums and squares stay finite
_FARTHEST_M = 1e6  # rays are cast in single precision, which beyond has steps of decimetres
_REACH = {"low": -_FARTHEST_M, "high": _FARTHEST_M}
_LONGEST_BARRIER_M = 10_000.0
_LARGEST_WEIGHT = 1e6
_MOST_LOSS = 1e9  # in the metric's unit; sums over many vehicles stay finite
_COEFFICIENT = {"low": 0.0, "high": 10.0}  # of DE-PSO; the paper's are below 1, and huge ones overflow
_HEADING = {"low": -360.0, "high": 360.0}
_STATED_RANGE = dict(zip(("low", "high"), STATED_RANGE_LIMITS_M, strict=True))
ANGLES = ("tilt_x_deg", "tilt_y_deg", "yaw_deg")
LEANS = ("lean_deg", "lean_direction_deg", "spin_deg")
_TURNS = ("yaw_deg", "lean_direction_deg", "spin_deg")  # of which 360 degrees are a full circle
_FILES, _TRAFFIC_FILES = (("world", "blend"), ("world", "mesh")), ("path", "vehicle_types")
_ADDRESS = re.compile(r"(tcp|tls|ws|wss)://([\w.-]+|\[[0-9A-Fa-f:.%]+\]):(?P<port>[0-9]{1,5})", re.ASCII)


@dataclass(frozen=True, slots=True)
class MountingSettings:
    """[baseline], and a mounting given by options: the height is that of the paper's section V.A.

    Attributes
    ----------
    x_m : float
        Along the road, in the direction of travel.
    y_m : float
        Across the road, to the left.
    height_m : float
        Above the road.
    tilt_x_deg : float
        Across the road, positive looks down towards +y.
    tilt_y_deg : float
        Along the road, positive raises the side ahead.
    yaw_deg : float
        Counter-clockwise seen from above.
    """

    x_m: float = setting(0.0, low=-1e5, high=1e5, option="--x")
    y_m: float = setting(0.0, low=-1e5, high=1e5, option="--y")
    height_m: float = setting(2.0, low=0.1, high=100.0, option="--height")
    tilt_x_deg: float = setting(0.0, low=-90.0, high=90.0, option="--tilt-x", rivals=LEANS)
    tilt_y_deg: float = setting(0.0, low=-90.0, high=90.0, option="--tilt-y", rivals=LEANS)
    yaw_deg: float = setting(0.0, option="--yaw", rivals=LEANS, **_HEADING)


@dataclass(frozen=True, slots=True)
class LeanSettings:
    """The same orientation as both tilts and yaw, and in their place: see `sensors.pose.lean_matrix`.

    Attributes
    ----------
    lean_deg : float or None
        How far it leans from upright.
    lean_direction_deg : float
        Which way it leans and looks down, counter-clockwise seen from above, 0 towards +y.
    spin_deg : float
        Turn about its own axis, counter-clockwise; it matters to a sensor whose columns are uneven.
    """

    lean_deg: float | None = setting(None, low=0.0, high=90.0, option="--lean", rivals=ANGLES)
    lean_direction_deg: float | None = setting(None, option="--lean-direction", rivals=ANGLES, **_HEADING)
    spin_deg: float | None = setting(None, option="--spin", rivals=ANGLES, **_HEADING)


MOUNTING = settings_of(MountingSettings)
LEAN = settings_of(LeanSettings)
MOUNTING_OR_LEAN = MOUNTING | LEAN
"""All coordinates by which a mounting can be given."""
COORDINATES = tuple(MOUNTING)
COORDINATE_LIMITS = {key: (declared.low, declared.high) for key, declared in MOUNTING.items()}
SEARCHED = {"height_m": (2.0, 4.5), "tilt_x_deg": (0.0, 25.0)}
"""What [deployment] searches unless said: the paper's ranges, section V.A."""
DEPLOYMENT = {
    key: replace(declared, kind=float | tuple[float, float], default=SEARCHED.get(key, declared.default))
    for key, declared in MOUNTING_OR_LEAN.items()
}
"""[deployment]: a number fixes a coordinate, a pair [low, high] has it searched."""
for _key in ("x_m", "y_m"):
    DEPLOYMENT[_key] = replace(DEPLOYMENT[_key], form='several places are a table of poles: poles = "poles.csv"')


@dataclass(frozen=True, slots=True)
class TrafficSettings:
    """[traffic]: where the vehicles come from and which instants are looked at.

    Attributes
    ----------
    name : str or None
        What it is called among several recordings; the file's unless said.
    weight : float
        How much it counts among several recordings, whatever their frames: hours of the day, for instance.
    path : str
        Trajectory file in place of the scene's.
    format : str
        Of that file; auto looks at its beginning.
    period : str or None
        Recording period of an NGSIM file: 1, 2 ... or 0400-0415.
    location : str or None
        Site of a file that mixes several: i-80.
    origin_m, heading_deg
        Where the road frame's origin lies in the file's frame [m], and the direction of its x axis there.
    time_step_s : float or None
        Time between frame numbers [s].
    vehicle_types : str or None
        Route or additional file of SUMO with the <vType>s.
    lanes : tuple of int or None
        Lanes whose vehicles are read; all unless said.
    frames : int or None
        Number of searched frames, spread evenly; 30 unless they are said in another way.
    frame_ids : tuple of int or None
        The searched frames: 100,150 or 100:160:5, its end included.
    spacing_s : float or None
        Time between the searched frames [s], instead of their number or besides.
    holdout : float
        Share of the blocks of time that is held out.
    block_s : float or None
        Length of these blocks [s]; longer than a transit of the site unless said.
    height_m : mapping
        Heights by class [m], of vehicles in recordings that give none.
    accept : tuple of str or None
        What seems impossible of the traffic and is true all the same; again for more.
    """

    name: str | None = setting(None)
    weight: float = setting(1.0, above=0.0)
    path: str = setting(is_path=True, option="--traffic")
    format: str = setting("auto", allowed=TRAFFIC_FORMATS)
    period: str | None = setting(None, option="--period")
    location: str | None = setting(None, option="--location")
    origin_m: tuple[float, float] | None = setting(None, low=-_LARGEST_ORIGIN_M, high=_LARGEST_ORIGIN_M)
    heading_deg: float | None = setting(None, **_HEADING)
    time_step_s: float | None = setting(None, above=0.0)
    vehicle_types: str | None = setting(None, is_path=True, option="--vehicle-types")
    lanes: tuple[int, ...] | None = setting(None)
    frames: int | None = setting(None, low=1, option="--frames", rivals=("frame_ids",))
    frame_ids: tuple[int, ...] | None = setting(
        None, option="--frame-ids", rivals=("frames", "spacing_s"), metavar="IDS"
    )
    spacing_s: float | None = setting(None, above=0.0)
    holdout: float = setting(0.4, low=0.0, high=0.9)
    block_s: float | None = setting(None, above=0.0)
    height_m: Mapping[str, float] = setting(
        allowed=("car", "van", "truck", "long_truck", "bus", "motorcycle"), above=0.0, high=10.0
    )
    accept: tuple[str, ...] | None = setting(None, allowed=WARNINGS, option="--accept", metavar="NAME")


@dataclass(frozen=True, slots=True)
class SensorSettings:
    """[sensor]: the model, its rate, the range within which it is asked to see, and how imperfect it is.

    What is None where the scene says nothing is the model's own, or none.

    Attributes
    ----------
    name : str
        Sensor model or the path of a beam table; see `blender-lidar sensors`.
    rotation_hz : float
        Turns per second; the model's own unless said.
    columns : int
        Columns a turn, of a model whose number is chosen, as an Ouster's; the model's own unless said.
    range_gate_m : float
        Range within which it is asked to see [m]; the model's own unless said.
    range_noise_m : float
        Standard deviation of the range noise, or datasheet for the model's own.
    dropout : float
        Probability that a return is lost.
    glass_dropout : float
        Probability that a return from glass is lost besides; 1: windows return nothing.
    range_at_10_percent_m : float or None
        Range to which a target of 10 percent reflectivity is seen, or datasheet; weaker returns are lost.
    unit_spread_deg : float
        Standard deviation between units' beams.
    unit : int
        Which of the units it is.
    noise_seed : int
        Seed of its noise and of what is lost.
    """

    name: str = setting("RS-16", option="--sensor")
    rotation_hz: float = setting(None, above=0.0)
    columns: int | None = setting(None, low=1, option="--columns")
    range_gate_m: float = setting(None, above=0.0)
    range_noise_m: float = setting(0.0, low=0.0, high=MOST_RANGE_NOISE_M, word=DATASHEET, option="--range-noise")
    dropout: float = setting(0.0, low=0.0, below=1.0, option="--dropout")
    glass_dropout: float = setting(0.0, low=0.0, high=1.0, option="--glass-dropout")
    range_at_10_percent_m: float | None = setting(None, **_STATED_RANGE, word=DATASHEET, option="--range-at-10-percent")
    unit_spread_deg: float = setting(0.0, low=0.0, high=MOST_SPREAD_DEG, option="--unit-spread")
    unit: int = setting(1, low=0)
    noise_seed: int = setting(1, low=0)

    @property
    def is_file(self) -> bool:
        """Whether the sensor is a user's own."""
        return is_sensor_file(self.name)

    @property
    def imperfections(self) -> Imperfections:
        """How its returns differ from the truth."""
        from ..sensors.imperfections import Imperfections

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
class Pole:
    """A candidate place: a row of the table of [deployment] poles.

    Attributes
    ----------
    name : str
    x_m, y_m : float
        Where it stands [m, road frame].
    foot_z_m : float
        Its foot above the road plane [m].
    height_min_m, height_max_m : float or None
        Between what heights above its foot a LiDAR can hang [m]; those of [deployment] unless said.
    cost : float or None
    existing : bool or None
        Whether it stands already.
    """

    name: str
    x_m: float
    y_m: float
    foot_z_m: float = 0.0
    height_min_m: float | None = None
    height_max_m: float | None = None
    cost: float | None = None
    existing: bool | None = None


@dataclass(frozen=True, slots=True)
class Deployment:
    """[deployment]: which coordinates of the mounting are fixed, and between what bounds the others are searched.

    Attributes
    ----------
    fixed : mapping of str to float
        Coordinates that stay; those of the orientation are tilts and yaw, or lean, direction and spin.
    bounds : mapping of str to (float, float)
        The others, in the order of `MOUNTING_OR_LEAN`; metres and degrees.
    poles : tuple of Pole
        Candidate places, each searched by itself; none where x and y say the place.
    poles_file : str or None
        The table that they come from.
    road : RoadFrame
        Whose slopes `pose` knows.
    """

    fixed: Mapping[str, float]
    bounds: Mapping[str, tuple[float, float]]
    poles: tuple[Pole, ...] = ()
    poles_file: str | None = None
    road: RoadFrame = field(default=RoadFrame(), repr=False)

    def at(self, pole: Pole) -> Deployment:
        """The same search on one pole: its place, and its heights where it has its own, above the road plane."""
        height = self.bounds.get("height_m") or (self.fixed["height_m"],) * 2
        own = pole.height_min_m, pole.height_max_m
        low, high = (usual if end is None else pole.foot_z_m + end for usual, end in zip(height, own, strict=True))
        fixed = {**self.fixed, "x_m": pole.x_m, "y_m": pole.y_m, "height_m": low}
        bounds = {**self.bounds, "height_m": (low, high)}
        (bounds if low == high else fixed).pop("height_m")
        return Deployment(fixed, {key: bounds[key] for key in MOUNTING_OR_LEAN if key in bounds}, road=self.road)

    @property
    def places(self) -> tuple[Deployment, ...]:
        """What is searched, place by place: on each pole, or itself."""
        return tuple(map(self.at, self.poles)) or (self,)

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
    def periodic(self) -> tuple[bool, ...]:
        """Which searched coordinates are full circles, on which neither bound is an end."""
        return tuple(key in _TURNS and high - low == 360.0 for key, (low, high) in self.bounds.items())

    @property
    def axes(self) -> tuple[str, str]:
        """The height, and what the sensor looks down by: its lean, or the tilt across the road."""
        leans = "lean_deg" in self.fixed or "lean_deg" in self.bounds
        return "height_m", "lean_deg" if leans else "tilt_x_deg"

    @property
    def nominal_xy(self) -> tuple[float, float]:
        """The mount's place [m], or the middle of where it may be."""
        if self.poles:
            places = [[pole.x_m for pole in self.poles], [pole.y_m for pole in self.poles]]
            return tuple(0.5 * (min(one) + max(one)) for one in places)
        return tuple(0.5 * sum(self.bounds[key]) if key in self.bounds else self.fixed[key] for key in ("x_m", "y_m"))

    def coordinates(self, x) -> dict[str, float]:
        """All six coordinates (metres, degrees) at the point `x` (d,) of the search space."""
        return six_coordinates(self.given(x))

    def given(self, x) -> dict[str, float]:
        """The same by the coordinates that are fixed or searched: a lean of 0 keeps its direction."""
        return {**self.fixed, **dict(zip(self.variables, map(float, x), strict=True))}

    def pose(self, x) -> Pose:
        """The mounting at the point `x` (d,) of the search space."""
        return pose_at(self.coordinates(x), self.road)


@dataclass(frozen=True, slots=True)
class StretchSettings:
    """An entry of [[region.stretches]]: a stretch of the carriageway, or of some of the recording's lanes."""

    x_m: tuple[float, float] = setting(
        **_REACH, fits=lambda x: x[0] < x[1], form="a pair [from, to], to more than from"
    )
    lanes: tuple[int, ...] | None = setting(None)


@dataclass(frozen=True, slots=True)
class RegionSettings:
    """[region]: where vehicles count, by their box centres: in a circle, a polygon, or on stretches of lanes.

    Attributes
    ----------
    centre_m : (float, float) or None
        Middle of the circle [m]; the mount's place unless said.
    radius_m : float
        Its radius [m]; the range gate of the scene's sensor unless said, which another sensor does not change. "gate"
        is that of the sensor in use.
    polygon_m : polygon or None
        Corners of the outline [m], instead of a circle.
    stretches : tuple
        Stretches of the carriageway or of lanes, instead of a circle.
    keep_out : polygons or None
        Vehicles within do not count [m].
    """

    centre_m: tuple[float, float] | None = setting(None, **_REACH)
    radius_m: float = setting(None, above=0.0, high=_FARTHEST_M, word=GATE)
    polygon_m: tuple[tuple[float, float], ...] | None = setting(None, **_REACH)
    stretches: tuple[StretchSettings, ...] = setting(())
    keep_out: tuple[tuple[tuple[float, float], ...], ...] | None = setting(None, **_REACH)


@dataclass(frozen=True, slots=True)
class Tolerance:
    """[objective] tolerance: how far off its plan a mounting may end up, as half-widths.

    Each error is uniform between minus and plus its half-width and independent of the others. Beyond the limits it is
    another mounting and not an error. `tilt_deg` is of both tilts: the inclinometer that sets the one sets the other
    too. `aim` says what is maximised of the objective over these errors: its mean, or what it reaches in nine cases of
    ten.
    """

    height_m: float = setting(0.0, low=0.0, high=1.0)
    tilt_deg: float = setting(0.0, low=0.0, high=10.0)
    yaw_deg: float = setting(0.0, low=0.0, high=10.0)
    aim: str = setting("mean", allowed=("mean", "low"))

    @property
    def half_widths(self) -> dict[str, float]:
        """Of each of `COORDINATES` that is not exact, in their order [m, degrees]."""
        widths = (0.0, 0.0, self.height_m, self.tilt_deg, self.tilt_deg, self.yaw_deg)
        return {key: width for key, width in zip(COORDINATES, widths, strict=True) if width > 0.0}


@dataclass(frozen=True, slots=True)
class ZoneSettings:
    """An entry of [[objective.zones]]: vehicles whose box centres lie in a polygon [m, road frame] have its weight."""

    name: str = setting()
    polygon_m: tuple[tuple[float, float], ...] = setting(**_REACH)
    weight: float = setting(low=0.0, high=_LARGEST_WEIGHT)


@dataclass(frozen=True, slots=True)
class ObjectiveSettings:
    """[objective]: what is maximised.

    Attributes
    ----------
    metric : str
        What is maximised.
    reading : str
        The paper's equations as corrected, or as printed.
    cell_m : float
        Side of an occupancy cell [m].
    threshold, view
        Least occupancy that counts as detectable, and of which of the three views.
    loss : float or None
        What a vehicle below the threshold adds, in the metric's unit; unless said -1 with the paper's metric, and with
        any other what the metric gives it.
    tolerance : Tolerance or None
        How far off its plan the mounting may end up, as half-widths: tilt_deg=1,height_m=0.05; also yaw_deg, and
        aim=mean or aim=low; none: it hangs as planned.
    class_weights : mapping
        How much a vehicle of a class counts in the objective; 1 unless said.
    zones : tuple
        Places where vehicles count more or less in the objective; the first that holds a vehicle has it.
    """

    metric: str = setting(
        METRIC_NAMES[0], allowed=METRIC_NAMES, plugins=METRICS_OF_OTHERS, option="--metric", metavar="METRIC"
    )
    reading: str = setting("corrected", allowed=READINGS, option="--reading")
    cell_m: float = setting(DEFAULT_CELL_M, low=0.005, high=1.0)
    threshold: float = setting(0.005, low=0.0, high=1.0)
    view: str = setting("mean", allowed=VIEWS)
    loss: float | None = setting(None, low=-_MOST_LOSS, high=_MOST_LOSS)
    tolerance: Tolerance | None = setting(None, option="--tolerance")
    class_weights: Mapping[str, float] = setting(
        allowed=("car", "van", "truck", "bus", "motorcycle"), low=0.0, high=_LARGEST_WEIGHT
    )
    zones: tuple[ZoneSettings, ...] = setting(())


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """[search]: how the best mounting is looked for; what is DE-PSO's alone is None with any other method.

    Attributes
    ----------
    method : str
        How the best mounting is looked for.
    fidelity : str
        Full: every mounting is scored on all frames with all beams; auto: most are screened on less, and what is
        reported is scored on all of it.
    seed : int
        Seed of everything random.
    particles : int
        Particles of the swarm, hardened or DE-PSO's.
    iterations : int
        Every search gets particles x iterations evaluations.
    seeds : int
        Searches, one after the other, each with its own seed, of which the best answers; 3 where more than two
        coordinates are searched, else 1.
    inertia, differential_weight, cognitive, social : float or None
        DE-PSO's weights w1, w2, a1 and a2 of the paper's Eqs. 12 and 14.
    differential_threshold : float or None
        DE-PSO's gamma, the chance per particle and iteration of a differential jump; not the threshold delta.
    """

    method: str = setting(
        SEARCHES[0], allowed=SEARCHES, plugins=SEARCHES_OF_OTHERS, option="--search", metavar="SEARCH"
    )
    fidelity: str = setting("full", allowed=("full", "auto"), option="--fidelity")
    seed: int = setting(1, low=0, option="--seed")
    particles: int = setting(PARTICLES, low=3, high=10_000, option="--particles")
    iterations: int = setting(ITERATIONS, low=1, high=1_000_000, option="--iterations")
    seeds: int | None = setting(None, low=1, high=20, option="--seeds")
    inertia: float | None = setting(None, **_COEFFICIENT)
    differential_weight: float | None = setting(None, **_COEFFICIENT)
    cognitive: float | None = setting(None, **_COEFFICIENT)
    social: float | None = setting(None, **_COEFFICIENT)
    differential_threshold: float | None = setting(None, low=0.0, high=1.0)


@dataclass(frozen=True, slots=True)
class BoxSettings:
    """An entry of [[world.boxes]]: something that stands still, in the road frame; `name` is a number unless said."""

    name: str | None = setting(None)
    centre_m: tuple[float, float, float] = setting(**_REACH)
    size_m: tuple[float, float, float] = setting(above=0.0, high=_FARTHEST_M)
    heading_deg: float = setting(0.0, **_HEADING)


@dataclass(frozen=True, slots=True)
class BarrierSettings:
    """An entry of [[world.barriers]]: a barrier along the line y = `y_m` between two x."""

    kind: str = setting(allowed=BARRIERS)
    y_m: float = setting(**_REACH)
    x_m: tuple[float, float] = setting(
        (-200.0, 200.0),
        **_REACH,
        fits=lambda x: 0.0 < x[1] - x[0] <= _LONGEST_BARRIER_M,
        form=f"a pair [from, to], to after from and at most {_LONGEST_BARRIER_M:g} m from it",
    )


def _is_blend(path: str) -> bool:
    return Path(path).suffix.lower() == ".blend"


@dataclass(frozen=True, slots=True)
class WorldSettings:
    """[world]: what there is, and how finely vehicles are modelled.

    Attributes
    ----------
    detail : str
        Level of detail of the vehicles.
    ground : bool
        Whether the plane z = 0 returns.
    blend, mesh : str or None
        Files of scenery in a frame of their own.
    origin_m, heading_deg
        Where the road frame's origin lies in the frame of these files [m], and the direction of its x axis there.
    boxes, barriers : tuple
        What else stands still.
    clutter : float
        How much stands or walks along the roadsides at random and is no vehicle; 1 is some, 0 nothing.
    clutter_seed : int
        What else that depends on.
    variety : float
        How much vehicles of a class differ in height and body: 0, all are alike, to 1, as those of a real fleet.
    variety_seed : int
        What else that depends on.
    """

    detail: str = setting("body", allowed=DETAILS, option="--detail")
    ground: bool = setting(True)
    blend: str | None = setting(None, is_path=True, fits=_is_blend, form="a .blend file")
    mesh: str | None = setting(
        None, is_path=True, fits=lambda path: not _is_blend(path), form="a mesh file; .blend files go to blend"
    )
    origin_m: tuple[float, float, float] = setting((0.0, 0.0, 0.0), low=-_LARGEST_ORIGIN_M, high=_LARGEST_ORIGIN_M)
    heading_deg: float = setting(0.0, **_HEADING)
    boxes: tuple[BoxSettings, ...] = setting(())
    barriers: tuple[BarrierSettings, ...] = setting(())
    clutter: float = setting(0.0, low=0.0, high=10.0, option="--clutter")
    clutter_seed: int = setting(1, low=0)
    variety: float = setting(0.0, low=0.0, high=1.0, option="--variety")
    variety_seed: int = setting(1, low=0)

    @property
    def has_scenery(self) -> bool:
        """Whether anything stands still and hides vehicles."""
        return bool(self.blend or self.mesh or self.boxes or self.barriers or self.clutter)


def _is_address(address: str) -> bool:
    found = _ADDRESS.fullmatch(address)
    return bool(found) and 0 < int(found["port"]) < 2**16


@dataclass(frozen=True, slots=True)
class ModelSettings:
    """[model]: what casts the rays, and in how many processes, or on which dask scheduler's workers.

    Attributes
    ----------
    caster : str
        What casts the rays.
    workers : int
        Processes; 0 takes one for each processor.
    cluster : str or None
        Dask scheduler whose workers are used instead: tcp://host:8786.
    """

    caster: str = setting("auto", allowed=("auto", *CASTERS), option="--caster")
    workers: int = setting(0, low=0, high=256, option="--workers", rivals=("cluster",))
    cluster: str | None = setting(
        None, option="--cluster", rivals=("workers",), fits=_is_address, form="such as tcp://host:8786"
    )


@dataclass(frozen=True, slots=True)
class Scenario:
    """A whole scene, checked.

    Attributes
    ----------
    source : str
        What it came from.
    where : callable
        What errors call a table's key in it.
    traffic : TrafficSettings
        The recording, of several the first.
    further_traffic : tuple of TrafficSettings
        The others.
    """

    source: str
    traffic: TrafficSettings
    road: RoadFrame
    world: WorldSettings
    sensor: SensorSettings
    deployment: Deployment
    region: RegionSettings
    baseline: Mapping[str, float]
    objective: ObjectiveSettings
    search: SearchSettings
    model: ModelSettings
    where: Callable[[str, str], str] = field(repr=False, compare=False)
    further_traffic: tuple[TrafficSettings, ...] = ()

    @property
    def recordings(self) -> tuple[TrafficSettings, ...]:
        """All recordings."""
        return self.traffic, *self.further_traffic

    @property
    def baseline_pose(self) -> Pose:
        return self.pose(self.baseline)

    def pose(self, coordinates: Mapping[str, float]) -> Pose:
        """The mounting at the six coordinates of `COORDINATES`, beside this road."""
        return pose_at(coordinates, self.road)

    def in_road(self, coordinates: Mapping[str, float]) -> dict[str, float]:
        """The same in the frame of this road: what `pose_at` makes the same pose of beside a level one."""
        if self.road.is_level:
            return dict(coordinates)
        return plumb(self.pose(coordinates), RoadFrame())

    @property
    def files(self) -> dict[tuple[str, str], str]:
        """The files that it names, by table and key."""
        named = {(table, key): getattr(getattr(self, table), key) for table, key in _FILES}
        for table, recording in zip(self._traffic_tables, self.recordings, strict=True):
            named |= {(table, key): getattr(recording, key) for key in _TRAFFIC_FILES}
        named["deployment", "poles"] = self.deployment.poles_file
        if self.sensor.is_file:
            named["sensor", "name"] = self.sensor.name
        return {place: path for place, path in named.items() if path is not None}

    @property
    def _traffic_tables(self) -> list[str]:
        return ["traffic", *(f"traffic {number}" for number in range(2, len(self.recordings) + 1))]

    def as_tables(self) -> dict[str, dict]:
        """The scene as used, in the layout of a scene file: reading it again gives this scene.

        Of several recordings the second table is called "traffic 2".
        """
        tables = asdict(self)
        further = zip(self._traffic_tables[1:], tables.pop("further_traffic"), strict=True)
        tables = {"traffic": tables["traffic"], **dict(further), **tables}
        del tables["source"], tables["where"]
        tables["deployment"] = {**self.deployment.fixed, **self.deployment.bounds}
        if self.deployment.poles:
            for key in ("x_m", "y_m"):
                del tables["deployment"][key]
            tables["deployment"]["poles"] = self.deployment.poles_file
        return tables

    def with_whole_paths(self) -> dict[str, dict]:
        """`as_tables`, its paths from the root on, so that they mean the same from any folder."""
        tables = self.as_tables()
        for (table, key), path in self.files.items():
            tables[table][key] = str(Path(path).resolve())
        return tables


DECLARED = {name: settings_of(kind) for name, kind in get_type_hints(Scenario).items() if is_dataclass(kind)}
POLES = {
    "poles": Setting(kind=str, default=None, is_path=True, help="table of candidate places, in place of x_m and y_m")
}
DECLARED |= {"deployment": DEPLOYMENT | POLES, "baseline": MOUNTING_OR_LEAN}
"""The settings of each table of a scene file."""


def is_sensor_file(name: str) -> bool:
    """Whether `name` is the path of a beam table, not the name of a model."""
    return name.lower().endswith(SENSOR_SUFFIXES)


def has_lean(given: Mapping[str, object], where: str) -> bool:
    """Whether an orientation is given by its lean; not by tilts or yaw too, nor without saying how far it leans."""
    leans, angles = ([key for key in keys if key in given] for keys in (LEANS, ANGLES))
    if leans and angles:
        raise InputError(f"{where}: has {leans[0]} and {angles[0]}; allowed: a lean, or tilts and yaw")
    if leans and "lean_deg" not in leans:
        raise InputError(f"{where}: has {leans[0]} without lean_deg, which says how far it leans")
    return bool(leans)


def six_coordinates(
    given: Mapping[str, float], others: Mapping[str, float] | None = None, where: str = "mounting"
) -> dict[str, float]:
    """The coordinates of `COORDINATES` of a mounting that is given by them, or by its lean [m, degrees].

    Parameters
    ----------
    given : mapping of str to float
        Some of `MOUNTING_OR_LEAN`; lean direction and spin are 0 where they are left out. Both forms of one
        orientation, as result.json has them, are one.
    others : mapping of str to float, optional
        The six coordinates in place of those that are left out.
    where : str
        Where it was given, for errors.

    Raises
    ------
    InputError
        When it has tilts or yaw and a lean, or a direction or spin without a lean.
    """
    if "lean_deg" in given and all(key in given for key in ANGLES):
        by_lean = six_coordinates({key: value for key, value in given.items() if key not in ANGLES}, others, where)
        given = {key: value for key, value in given.items() if key in MOUNTING}
        if abs(pose_at(by_lean).rotation - pose_at({**by_lean, **given}).rotation).max() > _SAME_ROTATION:
            raise InputError(f"{where}: its lean is not that of its tilts and yaw; allowed: one of both")
    leans = has_lean(given, where)
    six = {key: given[key] if key in given else (others or {})[key] for key in COORDINATES if key in given or others}
    if not leans:
        return six
    from ..sensors.pose import lean_matrix, tilts_of

    tilts = tilts_of(lean_matrix(*(math.radians(given.get(key, 0.0)) for key in LEANS)))
    six |= dict(zip(ANGLES, map(math.degrees, tilts), strict=True))
    return {key: six[key] for key in COORDINATES}


def with_lean(coordinates: Mapping[str, float]) -> dict[str, float | None]:
    """The six coordinates, and the same orientation as lean, its direction and spin [m, degrees].

    What leans by less than a millionth of a degree has no direction: None.
    """
    from ..sensors.pose import lean_of

    lean, *turns = (round(math.degrees(angle), 12) + 0.0 for angle in lean_of(pose_at(coordinates).rotation))
    if lean < _NO_LEAN_DEG:
        lean, turns = 0.0, [None, coordinates["yaw_deg"]]
    return {**coordinates, **dict(zip(LEANS, (lean, *turns), strict=True))}


def leaning(coordinates: Mapping[str, float], **changes: float) -> dict[str, float]:
    """The six coordinates of a mounting with some of `MOUNTING_OR_LEAN` changed; a lean keeps direction and spin.

    `coordinates` are the six, or those that `Deployment.given` has.
    """
    if "lean_deg" in coordinates:
        return six_coordinates({**coordinates, **changes})
    if not changes.keys() & set(LEANS):
        return {**coordinates, **changes}
    kept = {key: value for key, value in with_lean(coordinates).items() if key in LEANS and value is not None}
    return six_coordinates({**kept, **changes}, coordinates)


def pose_at(coordinates: Mapping[str, float], road: RoadFrame | None = None) -> Pose:
    """The mounting at the six coordinates of `COORDINATES`, in the frame of a road; of a level one unless said.

    Coordinates are what an installer sets: x and y of the mast's foot, on the road's plane; the height above it along
    the mast, which is plumb; tilts against the vertical, and yaw about it from the level direction of the road's x.
    """
    from ..sensors.pose import Pose

    x_m, y_m, height_m, *angles = (coordinates[key] for key in COORDINATES)
    pose = Pose(x_m, y_m, height_m, *map(math.radians, angles))
    if road is None or road.is_level:
        return pose
    from ..sensors.pose import tilts_of, turned

    axes = _axes(road)
    x, y, z = (pose.height_m * axes[:, 2]).tolist()  # along the mast
    return Pose(x_m + x, y_m + y, z, *tilts_of(turned(pose.rotation, axes.T)))


def plumb(pose: Pose, road: RoadFrame) -> dict[str, float]:
    """The six coordinates [m, degrees] by which `pose_at` gives a pose in the frame of a road."""
    from ..sensors.pose import tilts_of, turned

    place, angles = (pose.x_m, pose.y_m, pose.height_m), (pose.tilt_x, pose.tilt_y, pose.yaw)
    if not road.is_level:
        axes = _axes(road)
        x, y, z = axes[:, 2].tolist()
        height = pose.height_m / z
        place, angles = (pose.x_m - height * x, pose.y_m - height * y, height), tilts_of(turned(pose.rotation, axes))
    return dict(zip(COORDINATES, (*place, *map(math.degrees, angles)), strict=True))


def _axes(road: RoadFrame):
    from ..sensors.pose import road_axes

    return road_axes(0.01 * road.grade_percent, 0.01 * road.cross_fall_percent)
