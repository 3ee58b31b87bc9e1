"""The settings of a scene, each declared once: type, default, limits, option and help; frozen when read.

`scenario.load_scenario` reads them from a file, `commands.options` from the command line. Needs the standard library
alone, so that help opens at once.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..names import (
    BARRIERS,
    BOX_KINDS,
    CASTERS,
    CLASSES,
    DEFAULT_CELL_M,
    DETAILS,
    FRAMES,
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
    VEHICLE_CLASSES,
    VIEWS,
    WARNINGS,
)
from ..road.settings import RoadSettings
from ..toml_table import setting, settings_of
from .deployment import BASELINE, DEPLOYMENT, HEADING, STAND, MountingErrors

if TYPE_CHECKING:
    from ..sensors.imperfections import Imperfections

DATASHEET = "datasheet"  # in place of a number: the model's own
INSTALLER = "deployment", "installer"  # of every [[lidar]] where a scene has these
GATE = "gate"  # in place of a radius: the sensor's range gate
_LARGEST_ORIGIN_M = 1e9  # of a place in a net; sums and squares stay finite
_FARTHEST_M = 1e6  # rays are cast in single precision, which beyond has steps of decimetres
_REACH = {"low": -_FARTHEST_M, "high": _FARTHEST_M}
_LONGEST_BARRIER_M = 10_000.0
_LARGEST_WEIGHT = 1e6
_MOST_LOSS = 1e9  # in the metric's unit; sums over many vehicles stay finite
_COEFFICIENT = {"low": 0.0, "high": 10.0}  # of DE-PSO; the paper's are below 1, and huge ones overflow
_STATED_RANGE = dict(zip(("low", "high"), STATED_RANGE_LIMITS_M, strict=True))
_IN_BLEND = re.compile(r"(.*?\.blend)[/\\](.+)", re.IGNORECASE)
_ADDRESS = re.compile(r"(tcp|tls|ws|wss)://([\w.-]+|\[[0-9A-Fa-f:.%]+\]):(?P<port>[0-9]{1,5})", re.ASCII)


@dataclass(frozen=True, slots=True)
class TrafficSettings:
    """[traffic]: where the vehicles come from and which instants are looked at.

    Attributes
    ----------
    name : str or None
        Name of the recording where there are several; by default the file's name.
    weight : float
        Weight of the recording among several, independent of its number of frames: hours of the day, for instance.
    path : str
        Trajectory file, plain or packed with gzip.
    format : str
        Format of that file; auto finds it from the file's first lines.
    period : str or None
        Recording period of an NGSIM file: 1, 2 ... or 0400-0415.
    location : str or None
        Site to read from a file that holds several: i-80.
    origin_m, heading_deg
        Origin of the road frame in the file's frame [m], and direction of its x axis there, counter-clockwise from the
        file's +x; for SUMO and tables.
    time_step_s : float or None
        For tables: time from one frame number to the next [s]; from the column time_s, else 0.1.
    vehicle_types : tuple of str or None
        SUMO's route or additional file, whose <vType>s give the vehicles' sizes; several as a list.
    lanes : tuple of int or None
        Lanes whose vehicles are read, numbered as in the recording (SUMO's from 1, the rightmost); by default all.
    leave_out : tuple of int or None
        Vehicles that are left out, by their numbers in the recording: they are neither scanned nor counted.
    frames : int or None
        Number of searched frames, spread evenly; 30 unless frame_ids or spacing_s is given.
    frame_ids : tuple of int or None
        Numbers of the searched frames: 100,150 or 100:160:5 (its end included).
    spacing_s : float or None
        Time between the searched frames [s], in place of their number or with it.
    holdout : float
        Share of the recording, at its end, that the search does not use and on which the mounting is judged.
    block_s : float or None
        Length of the blocks of time that intervals resample [s]; by default as long as 95 % of the vehicles stay in the
        region, and at least one cycle of a signal that the traffic shows.
    height_m : mapping
        Heights by class [m], where the recording gives none, as NGSIM's; by default car 1.5, van 1.9, truck 3.0,
        long_truck 3.8 (from 9 m on), bus 3.2, motorcycle 1.4, bicycle and pedestrian 1.73.
    accept : tuple of str or None
        Go on in spite of a warning about the traffic, which is then printed with the results; may be repeated; NAME is
        the warning that stopped the run.
    """

    name: str | None = setting(None)
    weight: float = setting(1.0, above=0.0)
    path: str = setting(is_path=True, option="--traffic")
    format: str = setting("auto", allowed=TRAFFIC_FORMATS)
    period: str | None = setting(None, option="--period")
    location: str | None = setting(None, option="--location")
    origin_m: tuple[float, float] | None = setting(None, low=-_LARGEST_ORIGIN_M, high=_LARGEST_ORIGIN_M)
    heading_deg: float | None = setting(None, **HEADING)
    time_step_s: float | None = setting(None, above=0.0)
    vehicle_types: tuple[str, ...] | None = setting(None, is_path=True, option="--vehicle-types")
    lanes: tuple[int, ...] | None = setting(None)
    leave_out: tuple[int, ...] | None = setting(None)
    frames: int | None = setting(None, low=1, option="--frames", rivals=("frame_ids",))
    frame_ids: tuple[int, ...] | None = setting(
        None, option="--frame-ids", rivals=("frames", "spacing_s"), metavar="IDS"
    )
    spacing_s: float | None = setting(None, above=0.0)
    holdout: float = setting(0.4, low=0.0, high=0.9)
    block_s: float | None = setting(None, above=0.0)
    height_m: Mapping[str, float] = setting(allowed=(*CLASSES, "long_truck"), above=0.0, high=10.0)
    accept: tuple[str, ...] | None = setting(None, allowed=(*WARNINGS, FRAMES), option="--accept", metavar="NAME")


@dataclass(frozen=True, slots=True)
class SensorSettings:
    """[sensor]: the model, its rate, its range gate, and how imperfect it is.

    None stands for the model's own value, or for none, where the scene says nothing.

    Attributes
    ----------
    name : str
        Sensor model, or path of a beam table of your own; `blender-lidar sensors` lists the models.
    rotation_hz : float
        Turns per second; by default the model's.
    columns : int
        Columns per turn, for models that offer several, as Ouster's do: 512, 1024 (default) or 2048.
    range_gate_m : float
        Range within which vehicles are to be seen [m]; by default the model's range.
    range_noise_m : float
        Standard deviation of the range noise; datasheet takes the value of the sensor's table.
    dropout : float
        Probability that a return is lost.
    glass_dropout : float
        Additional probability that a return from glass is lost; at 1 windows return nothing.
    range_at_10_percent_m : float or None
        Range at which a target of 10 percent reflectivity is just seen; weaker returns are lost; datasheet takes the
        value of the sensor's table.
    unit_spread_deg : float
        Standard deviation of each ring's elevation and azimuth offset from one unit to the next.
    unit : int
        Number of the unit; where unit_spread_deg is not 0, each unit has slightly different beams.
    noise_seed : int
        Random seed of noise and lost returns.
    price : float or None
        What a sensor and its mounting cost, in any currency; told with the answer.
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
    price: float | None = setting(None, low=0.0)

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
class StretchSettings:
    """An entry of [[region.stretches]]: a stretch of the carriageway, or of some of the recording's lanes.

    `x_m` are stations along the road, as those of a barrier are.
    """

    x_m: tuple[float, float] = setting(
        **_REACH, fits=lambda x: x[0] < x[1], form="a pair [from, to], to more than from"
    )
    lanes: tuple[int, ...] | None = setting(None)


@dataclass(frozen=True, slots=True)
class RegionSettings:
    """[region]: where vehicles count, by their box centres: in a circle, a polygon, or on lanes.

    Attributes
    ----------
    centre_m : (float, float) or None
        Centre of the circle [m]; by default the place of the mount.
    radius_m : float
        Radius of the circle [m]; by default the range gate of the scene's own sensor. "gate" follows the sensor in use.
    polygon_m : polygon or None
        Corners of a polygon [m], in place of a circle.
    stretches : tuple
        Stretches of a straight road's carriageway, in place of a circle: x_m = [from, to], and lanes for some lanes
        only.
    junction : str or None
        Junction of the map, in place of a circle: its area counts, and unless approaches says which, all its
        approaches.
    approaches : tuple of str or None
        Roads of the map that lead to a stop line, in place of a circle or besides a junction: their last approach_m
        count.
    approach_m : float
        How far from the stop line approaches count [m]; at 0 the area of the junction alone.
    lanes : tuple of str or None
        Lanes of the map that count as a whole.
    keep_out : polygons or None
        Polygons [m] whose vehicles do not count.
    """

    centre_m: tuple[float, float] | None = setting(None, **_REACH)
    radius_m: float = setting(None, above=0.0, high=_FARTHEST_M, word=GATE)
    polygon_m: tuple[tuple[float, float], ...] | None = setting(None, **_REACH)
    stretches: tuple[StretchSettings, ...] = setting(())
    junction: str | None = setting(None)
    approaches: tuple[str, ...] | None = setting(None)
    approach_m: float = setting(50.0, low=0.0, high=1000.0)
    lanes: tuple[str, ...] | None = setting(None)
    keep_out: tuple[tuple[tuple[float, float], ...], ...] | None = setting(None, **_REACH)


@dataclass(frozen=True, slots=True)
class DrawingSettings:
    """[drawing]: the picture that the plan of the site is drawn on; it changes no result.

    Attributes
    ----------
    image : str or None
        Picture seen from above, such as an aerial one: PNG or JPEG.
    image_points : two of (float, float, float, float) or None
        Two points that place it: pixels from its left and from its top, and x and y in the site frame [m].
    """

    image: str | None = setting(None, is_path=True)
    image_points: tuple[tuple[float, float, float, float], ...] | None = setting(None, **_REACH)


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
        Metric that is maximised.
    reading : str
        Form of the paper's equations: corrected, or paper for those as printed.
    cell_m : float
        Side of an occupancy cell [m].
    threshold, view
        Least occupancy of a detectable vehicle, and whether the mean, the largest or the smallest of its three views
        must reach it.
    loss : float or None
        Score of a vehicle below the threshold, in the metric's unit; by default -1 with pe-vgop, and the vehicle's own
        value with any other metric.
    classes : tuple of str or None
        Classes that are scored, while other vehicles only hide them; by default all but pedestrian, who are left out
        unless they are named here or [world] pedestrians has them.
    class_weights : mapping
        Weight of each class in the objective; by default 1.
    zones : tuple
        Polygons with a weight for the vehicles in them, as name, polygon_m and weight; where zones overlap the first
        counts.
    """

    metric: str = setting(METRIC_NAMES[0], allowed=METRIC_NAMES, plugins=True, option="--metric", metavar="METRIC")
    reading: str = setting("corrected", allowed=READINGS, option="--reading")
    cell_m: float = setting(DEFAULT_CELL_M, low=0.005, high=1.0)
    threshold: float = setting(0.005, low=0.0, high=1.0)
    view: str = setting("mean", allowed=VIEWS)
    loss: float | None = setting(None, low=-_MOST_LOSS, high=_MOST_LOSS)
    classes: tuple[str, ...] | None = setting(None, allowed=CLASSES)
    class_weights: Mapping[str, float] = setting(allowed=CLASSES, low=0.0, high=_LARGEST_WEIGHT)
    zones: tuple[ZoneSettings, ...] = setting(())

    @property
    def scored_classes(self) -> tuple[str, ...]:
        """The classes that are scored."""
        return VEHICLE_CLASSES if self.classes is None else self.classes


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """[search]: how the best mounting is searched; settings of DE-PSO alone are None with any other method.

    Attributes
    ----------
    method : str
        Search method.
    fidelity : str
        Full: every mounting is scored on all frames with all beams; auto: most mountings are screened on fewer, and
        only the best are scored on all.
    seed : int
        Random seed of all but noise, clutter and variety, which have seeds of their own.
    particles : int
        Particles of the swarm, for hardened (at most a tenth of the evaluations) and de-pso.
    iterations : int
        Iterations; every method may score particles x iterations mountings.
    seeds : int
        Number of searches with different seeds, of which the best result is taken; by default 3 where more than two
        coordinates are searched, else 1.
    inertia, differential_weight, cognitive, social : float or None
        DE-PSO alone: w1, w2, a1 and a2 of the paper's Eqs. 12 and 14; 0.7, 0.5, 0.3 and 0.2.
    differential_threshold : float or None
        DE-PSO alone: gamma, the probability of a differential jump per particle and iteration; 0.1.
    """

    method: str = setting(SEARCHES[0], allowed=SEARCHES, plugins=True, option="--search", metavar="SEARCH")
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
    """An entry of [[world.boxes]]: something that stands still, in the road frame; `name` is a number unless said.

    `kind` says what labelled clouds call it.
    """

    name: str | None = setting(None)
    kind: str = setting("structure", allowed=BOX_KINDS)
    centre_m: tuple[float, float, float] = setting(**_REACH)
    size_m: tuple[float, float, float] = setting(above=0.0, high=_FARTHEST_M)
    heading_deg: float = setting(0.0, **HEADING)


@dataclass(frozen=True, slots=True)
class BarrierSettings:
    """An entry of [[world.barriers]]: a barrier along the road, `y_m` from its reference line, between two stations."""

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


def _is_in_blend(path: str) -> bool:
    return bool(_IN_BLEND.fullmatch(path))


@dataclass(frozen=True, slots=True)
class WorldSettings:
    """[world]: what there is, and how finely vehicles are modelled.

    Attributes
    ----------
    detail : str
        Level of detail of the vehicles: box; body, with hood, cabin and cargo box; detailed, a few hundred triangles.
    ground : bool
        Whether scans have returns from the road; false where a file of your own contains the ground.
    blend, mesh : str or None
        A site of your own: a .blend, or a mesh file that Blender reads.
    up : str or None
        Axis of an .obj, .ply or .stl file that points up, as these do not say it: by default y in .obj and z in others,
        as Blender writes them.
    origin_m, heading_deg
        Origin of the road frame in the frame of these files [m], z up, and direction of its x axis there.
    vehicles : mapping
        Bodies of your own by class, as car = "cars.blend/Sedan": an object with its children or a collection of a
        .blend file, fitted into each vehicle's box; one that is longer along y faces -y, else +x.
    boxes, barriers : tuple
        Fixed objects that hide vehicles; the how-to has the keys of an entry.
    pedestrians : bool
        Whether recorded pedestrians are there and hide vehicles where [objective] classes does not name them.
    clutter : float
        Density of random roadside clutter (signs, trees, pedestrians ...): 0 is none, 1 some 14 objects on 100 m of
        each side.
    clutter_seed : int
        Random seed of the clutter.
    variety : float
        How much vehicles of a class differ in height and body: 0 not at all, 1 as in a real fleet.
    variety_seed : int
        Random seed of heights and bodies.
    """

    detail: str = setting("body", allowed=DETAILS, option="--detail")
    ground: bool = setting(True)
    blend: str | None = setting(None, is_path=True, fits=_is_blend, form="a .blend file")
    mesh: str | None = setting(
        None, is_path=True, fits=lambda path: not _is_blend(path), form="a mesh file; .blend files go to blend"
    )
    up: str | None = setting(None, allowed=("y", "z"))
    origin_m: tuple[float, float, float] = setting((0.0, 0.0, 0.0), low=-_LARGEST_ORIGIN_M, high=_LARGEST_ORIGIN_M)
    heading_deg: float = setting(0.0, **HEADING)
    vehicles: Mapping[str, str] = setting(
        allowed=(*CLASSES, "long_truck"), is_path=True, fits=_is_in_blend, form='such as "cars.blend/Sedan"'
    )
    boxes: tuple[BoxSettings, ...] = setting(())
    barriers: tuple[BarrierSettings, ...] = setting(())
    pedestrians: bool = setting(False)
    clutter: float = setting(0.0, low=0.0, high=10.0, option="--clutter")
    clutter_seed: int = setting(1, low=0)
    variety: float = setting(0.0, low=0.0, high=1.0, option="--variety")
    variety_seed: int = setting(1, low=0)

    @property
    def bodies(self) -> dict[str, tuple[str, str]]:
        """The vehicles' bodies of the user's own by kind: the file, and the name of an object or collection in it."""
        return {kind: _IN_BLEND.fullmatch(place).groups() for kind, place in self.vehicles.items()}

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
        Ray caster; auto takes the first of raster, embree and bvh that is installed.
    workers : int
        Number of worker processes; 0 is one for each processor.
    cluster : str or None
        Address of a dask scheduler whose workers are used in place of processes: tcp://host:8786.
    pose_error : MountingErrors or None
        For detect, dataset and --detector: a LiDAR hangs elsewhere than its detector believes, by one draw within these
        half-widths, such as tilt_deg=1,height_m=0.05; none: it knows.
    """

    caster: str = setting("auto", allowed=("auto", *CASTERS), option="--caster")
    workers: int = setting(0, low=0, high=256, option="--workers", rivals=("cluster",))
    cluster: str | None = setting(
        None, option="--cluster", rivals=("workers",), fits=_is_address, form="such as tcp://host:8786"
    )
    pose_error: MountingErrors | None = setting(None, option="--pose-error")


DECLARED = {
    "traffic": settings_of(TrafficSettings),
    "road": settings_of(RoadSettings),
    "world": settings_of(WorldSettings),
    "sensor": settings_of(SensorSettings),
    "deployment": DEPLOYMENT | STAND,
    "drawing": settings_of(DrawingSettings),
    "region": settings_of(RegionSettings),
    "baseline": BASELINE,
    "objective": settings_of(ObjectiveSettings),
    "search": settings_of(SearchSettings),
    "model": settings_of(ModelSettings),
}
"""The settings of each table of a scene file."""


def is_sensor_file(name: str) -> bool:
    """Whether `name` is the path of a beam table, not the name of a model."""
    return name.lower().endswith(SENSOR_SUFFIXES)
