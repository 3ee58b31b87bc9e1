"""How time and memory grow with frames, vehicles, rings and workers; each point in a process of its own.

Memory is what Linux says is resident of the process itself: `tracemalloc` sees what Python and NumPy allocate, and none
of what Embree and Blender do, and the peak that `getrusage` tells of a process that was started by a larger one is the
larger one's.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmark_stages import Quartiles, quartiles, swarm_about
from blender_lidar.errors import InputError
from blender_lidar.scene.observation import CountedFrame, Observation, Scoring
from blender_lidar.scoring.evaluation import Evaluator
from blender_lidar.scoring.workers import Workers
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import LidarModel, load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.traffic.vehicles import CLASSES, Vehicles

VEHICLES = 130  # where another number grows: as many as a frame of dense I-80 has
FRAMES_FOR_WORKERS = 32


@dataclass(frozen=True, slots=True)
class Point:
    """What is scored: a swarm of mountings over so many frames of so many vehicles."""

    caster: str
    detail: str
    sensor: str
    frames: int = 1
    vehicles: int = VEHICLES
    rings: int | None = None
    workers: int = 1


class Measured(NamedTuple):
    """Of one point: seconds for the swarm, trees being ready; seconds until they are; the most memory that was
    resident, and what of that came on top of what the process held with its libraries loaded [MiB]."""

    seconds: float
    ready_s: float
    peak_mib: float | None
    above_mib: float | None


class PowerLaw(NamedTuple):
    """y = factor x^exponent; the exponent's standard error is None for two points, which any law fits."""

    exponent: float
    standard_error: float | None
    factor: float


def power_law(x: Sequence[float], y: Sequence[float]) -> PowerLaw | None:
    """Least squares of the logarithms of points (n,); None where two different x are lacking or a y is not above 0."""
    if len(set(x)) < 2 or None in y or min(y) <= 0.0:
        return None
    points = np.log(x), np.log(y)
    slope, level = np.polyfit(*points, 1)
    error = float(np.sqrt(np.polyfit(*points, 1, cov=True)[1][0, 0])) if len(x) > 2 else None
    return PowerLaw(float(slope), error, float(np.exp(level)))


class Series(NamedTuple):
    """One thing that grew, with one caster; lists are of its points."""

    over: str
    caster: str
    x: list[int]
    seconds: list[Quartiles]
    ready_s: list[float]
    peak_mib: list[float | None]
    above_mib: list[float | None]

    @property
    def time_law(self) -> PowerLaw | None:
        """How the seconds grow."""
        return power_law(self.x, [each.median for each in self.seconds])

    @property
    def memory_law(self) -> PowerLaw | None:
        """How what is held on top grows."""
        return power_law(self.x, self.above_mib)


def processors() -> int:
    """That this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def steps(most_frames: int = 256, most_workers: int | None = None) -> dict[str, list[int]]:
    """What grows, from where to where."""
    workers = most_workers or processors()
    return {
        "frames": [1 << power for power in range(most_frames.bit_length())],
        "vehicles": [10, 30, 100, 300, 1000],
        "rings": [16, 32, 64, 128],
        "workers": sorted({*(1 << power for power in range(workers.bit_length())), workers}),
    }


def points_of(over: str, values: Sequence[int], caster: str, detail: str, sensor: str) -> list[Point]:
    """The points of a series: one thing changes at a time."""
    basis = Point(caster, detail, sensor, frames=FRAMES_FOR_WORKERS if over == "workers" else 1)
    return [replace(basis, **{over: value}) for value in values]


def grow(
    over: str,
    values: Sequence[int],
    rounds: int,
    basis: tuple[str, str, str],
    kept: Callable[[Series], None] = lambda series: None,
) -> Series:
    """Measure a series of a `basis`, caster, detail and sensor: in each round every point, in a fresh process.

    `kept` is given what there is after each.
    """
    points = points_of(over, values, *basis)
    found: list[list[Measured]] = [[] for _ in points]
    for _ in range(rounds):
        for row, point in enumerate(points):
            found[row].append(in_fresh_process(point))
            kept(series := _series(over, basis[0], values, found))
    return series


def _series(over: str, caster: str, values: Sequence[int], found: Sequence[Sequence[Measured]]) -> Series:
    """Of the values that have been measured."""
    columns = [list(zip(*row, strict=True)) for row in found if row]
    seconds = [quartiles(np.array(column[0])) for column in columns]
    medians = [[None if None in values else float(np.median(values)) for values in column[1:]] for column in columns]
    return Series(over, caster, list(values[: len(columns)]), seconds, *map(list, zip(*medians, strict=True)))


def in_fresh_process(point: Point) -> Measured:
    """Measure a point where no other one has left anything behind."""
    workers = Workers(measure, 2)
    try:
        workers.await_ready()
        return workers.submit(point).result()
    finally:
        workers.close()


def measure(point: Point) -> Measured:
    """Measure a point in this process: libraries are loaded and compiled code is ready before."""
    swarm = swarm_about(Pose(0.0, 0.0, 4.0))
    with _evaluator(replace(point, frames=1, vehicles=2, workers=1)) as small:
        small.totals(swarm)
    before = resident_mib()
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # let the peak begin anew from what is resident now
    started = time.perf_counter()
    with _evaluator(point) as evaluator:
        evaluator.workers.await_ready()
        evaluator.totals(swarm[:1])
        ready = time.perf_counter()
        evaluator.totals(swarm)
        done = time.perf_counter()
        peak = peak_mib()
    above = None if peak is None or before is None else peak - before
    return Measured(done - ready, ready - started, peak, above)


def _evaluator(point: Point) -> Evaluator:
    lattice = beam_lattice(with_rings(load_model(point.sensor), point.rings))
    observation = Observation(lattice, RADIUS_M, 0.0, point.caster, point.detail, 0.05)
    scoring = Scoring(threshold=0.005, view="mean", loss=1.0, reading="corrected")
    frames = [dense_frame(point.vehicles, frame) for frame in range(point.frames)]
    return Evaluator(frames, observation, scoring, point.workers)


def with_rings(model: LidarModel, rings: int | None) -> LidarModel:
    """A sensor with another number of rings, evenly between its lowest beam and its highest; as it is for None."""
    if rings is None:
        return model
    elevation = np.linspace(model.elevation_rad[0], model.elevation_rad[-1], rings)
    none, unknown = np.zeros(rings), np.full(rings, np.nan)
    for array in (elevation, none, unknown):
        array.setflags(write=False)
    name = f"{model.name} with {rings} rings"
    return replace(model, name=name, elevation_rad=elevation, azimuth_offset_rad=none, fire_time_s=unknown)


# --- memory -----------------------------------------------------------------------------------------------------------


def resident_mib() -> float | None:
    """What is resident now [MiB]; None where that cannot be told, as anywhere but on Linux."""
    return _status("VmRSS", os.getpid())


def peak_mib() -> float | None:
    """The most that was resident at a time [MiB], added up over this process and its children that still run."""
    every = [os.getpid(), *(child.pid for child in multiprocessing.active_children())]
    peaks = [_status("VmHWM", pid) for pid in every]
    return None if peaks[0] is None else sum(peak for peak in peaks if peak is not None)


def _status(field: str, pid: int | None) -> float | None:
    with suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines():
            if line.startswith(f"{field}:"):
                return int(line.split()[1]) / 1024.0  # kB
    return None


# --- made-up traffic: any number of cars within a half-disc about the sensor, the more the denser ---------------------

RADIUS_M = 150.0
_SETBACK_M, _LANE_M, _SPACING_M = 2.0, 3.66, 7.5
_SIZES = {"car": (4.5, 1.85, 1.5), "van": (5.2, 2.0, 1.9)}
_VANS = 0.25


def dense_frame(vehicles: int, frame: int = 0) -> CountedFrame:
    """Cars and vans in lanes from y = 2 m on, all within `RADIUS_M` of the origin, apart from each other.

    They stand in places drawn at random for each frame; those of fewer vehicles are among those of more.
    """
    x = np.arange(-RADIUS_M, RADIUS_M, _SPACING_M) + _SPACING_M / 2.0
    y = np.arange(_SETBACK_M, RADIUS_M, _LANE_M) + _LANE_M / 2.0
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    places = places[np.hypot(*places.T) < RADIUS_M - 1.0]
    if not 1 <= vehicles <= len(places):
        raise InputError(f"{vehicles} vehicles within {RADIUS_M:g} m; allowed: 1 to {len(places)}")
    rng = np.random.default_rng(frame)
    chosen = rng.permutation(len(places))[:vehicles]
    is_van = rng.random(len(places))[chosen] < _VANS
    size = np.where(is_van[:, None], _SIZES["van"], _SIZES["car"])
    x, y = (places[chosen] + rng.uniform(-0.4, 0.4, places.shape)[chosen]).T
    heading = rng.normal(0.0, 0.01, len(places))[chosen]
    table = Vehicles(
        frame=frame,
        time_s=float(frame),
        vehicle_id=chosen.astype(np.int64),
        class_index=np.where(is_van, CLASSES.index("van"), CLASSES.index("car")).astype(np.int8),
        centre_m=np.column_stack([x, y, size[:, 2] / 2.0]),
        size_m=size,
        heading_rad=heading,
        lane=np.zeros(vehicles, dtype=np.int16),
    )
    return CountedFrame(table, np.ones(vehicles, dtype=bool))
