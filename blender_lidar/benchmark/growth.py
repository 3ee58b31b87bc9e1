"""How time and memory grow with frames, vehicles, rings and workers; each point in a process of its own."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..sensors.beams import beam_lattice
from ..sensors.model import LidarModel, load_model
from ..sensors.pose import Pose
from ..study.evaluation import Evaluator
from ..study.frame_scorer import Observation
from ..study.scoring import Scoring
from ..study.worker_pool import WorkerPool
from .dense import RADIUS_M, dense_frame
from .memory import forget_peak, peak_mib, resident_mib
from .power_law import PowerLaw, power_law
from .stages import swarm_about
from .timing import Quartiles, quartiles

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
    """Of one point.

    Attributes
    ----------
    seconds : float
        For the swarm, trees being ready.
    ready_s : float
        Until they are: the first mounting.
    peak_mib : float or None
        The most memory that was resident.
    above_mib : float or None
        Of that, what came on top of what the process held with its libraries loaded.
    """

    seconds: float
    ready_s: float
    peak_mib: float | None
    above_mib: float | None


@dataclass(frozen=True, slots=True)
class Series:
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
        return power_law(np.array(self.x), np.array([each.median for each in self.seconds]))

    @property
    def memory_law(self) -> PowerLaw | None:
        """How what is held on top grows."""
        if any(each is None for each in self.above_mib):
            return None
        return power_law(np.array(self.x), np.array(self.above_mib))


def processors() -> int:
    """That this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def steps(most_frames: int = 256, most_workers: int | None = None) -> dict[str, list[int]]:
    """What grows, from where to where."""
    workers = most_workers or processors()
    doubled = [1 << power for power in range(workers.bit_length()) if 1 << power <= workers]
    return {
        "frames": [1 << power for power in range(most_frames.bit_length())],
        "vehicles": [10, 30, 100, 300, 1000],
        "rings": [16, 32, 64, 128],
        "workers": sorted({*doubled, workers}),
    }


def points_of(over: str, values: Sequence[int], caster: str, detail: str, sensor: str) -> list[Point]:
    """The points of a series."""
    basis = Point(caster, detail, sensor, frames=FRAMES_FOR_WORKERS if over == "workers" else 1)
    return [replace(basis, **{over: value}) for value in values]


def grow(
    over: str,
    values: Sequence[int],
    rounds: int,
    *,
    caster: str,
    detail: str,
    sensor: str,
    told: Callable[[], None] = lambda: None,
    kept: Callable[[Series], None] = lambda series: None,
) -> Series:
    """Measure a series: in each round every point, in a fresh process; `kept` is given what there is after each."""
    points = points_of(over, values, caster, detail, sensor)
    found: list[list[Measured]] = [[] for _ in points]
    for _ in range(rounds):
        for row, point in enumerate(points):
            found[row].append(in_fresh_process(point))
            kept(_series(over, caster, values, found))
            told()
    return _series(over, caster, values, found)


def _series(over: str, caster: str, values: Sequence[int], found: Sequence[Sequence[Measured]]) -> Series:
    """Of the values that have been measured."""
    found = [row for row in found if row]
    return Series(
        over,
        caster,
        list(values[: len(found)]),
        [quartiles(np.array([each.seconds for each in row])) for row in found],
        [float(np.median([each.ready_s for each in row])) for row in found],
        [_median([each.peak_mib for each in row]) for row in found],
        [_median([each.above_mib for each in row]) for row in found],
    )


def in_fresh_process(point: Point) -> Measured:
    """Measure a point where no other one has left anything behind."""
    pool = WorkerPool(measure, 1)
    try:
        (found,) = pool.map([point])
    finally:
        pool.close()
    return found


def measure(point: Point) -> Measured:
    """Measure a point in this process: libraries are loaded and compiled code is ready before."""
    swarm = swarm_about(Pose(0.0, 0.0, 4.0))
    with _evaluator(replace(point, frames=1, vehicles=2, workers=1)) as small:
        small.totals(swarm)
    before = resident_mib()
    forget_peak()
    started = time.perf_counter()
    with _evaluator(point) as evaluator:
        evaluator.await_workers()
        evaluator.totals(swarm[:1])
        ready = time.perf_counter()
        evaluator.totals(swarm)
        done = time.perf_counter()
        peak = peak_mib()
    above = None if peak is None or before is None else peak - before
    return Measured(done - ready, ready - started, peak, above)


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


def _evaluator(point: Point) -> Evaluator:
    lattice = beam_lattice(with_rings(load_model(point.sensor), point.rings))
    observation = Observation(lattice, RADIUS_M, 0.0, point.caster, point.detail, 0.05)
    scoring = Scoring(threshold=0.005, view="mean", loss=1.0, reading="corrected")
    return Evaluator(list(_frames(point)), observation, scoring, point.workers)


def _frames(point: Point) -> Iterator:
    return (dense_frame(point.vehicles, frame) for frame in range(point.frames))


def _median(values: Sequence[float | None]) -> float | None:
    return None if None in values else float(np.median(values))
