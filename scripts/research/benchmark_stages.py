"""What is timed of ours: one frame under one mounting by stage, without Numba too, and whole optimisations.

Everything is timed in rounds, one entry after another, so that a busy moment of the machine falls on all of them.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from blender_lidar.casting import EXACT, RASTER
from blender_lidar.casting.culling import cut_vehicles, ray_directions, reachable_beams, revolutions
from blender_lidar.casting.protocol import Revolution, StandingScenery
from blender_lidar.compiled import numba_works
from blender_lidar.errors import InputError
from blender_lidar.metrics.vgop import entropy, pe_vgop
from blender_lidar.optimise.solve import SearchResult
from blender_lidar.optimise.solve import run as run_search
from blender_lidar.run.searches import fresh_search
from blender_lidar.scene.observation import Observation
from blender_lidar.scene.region import Region
from blender_lidar.scene.scenario import Scenario, load_scenario
from blender_lidar.scene.site import Site, lattice_of, prepare, read_recording
from blender_lidar.scoring.evaluation import Evaluator, site_evaluator
from blender_lidar.scoring.frame_scorer import FrameScorer, singles
from blender_lidar.scoring.workers import Workers
from blender_lidar.sensors.beams import BeamLattice
from blender_lidar.sensors.imperfections import PERFECT, Imperfections
from blender_lidar.sensors.lidar import Lidar
from blender_lidar.sensors.pose import Pose
from blender_lidar.traffic import plan_frames
from blender_lidar.traffic.boxes import Boxes
from blender_lidar.world.scenery import barrier
from blender_lidar.world.triangles import vehicle_triangles

OURS, METRIC = "ours", "metric"  # groups of entries
SWARM = 20  # mountings that a search of the paper's size scores at a time
KITTI_CARS, POINTS_EACH = 14_357, 400  # the paper's section IV: 18 s for its cars, from file to score

# --- timing -----------------------------------------------------------------------------------------------------------


class Entry(NamedTuple):
    """Something to time: its name, what does it once, its group in a table, what a measured time is multiplied by
    (beams that it stands for over beams that it casts, say), and what one has to know beside the number."""

    name: str
    act: Callable[[], object]
    group: str
    scale: float = 1.0
    note: str = ""


class Quartiles(NamedTuple):
    """Least, median and quartiles over rounds."""

    least: float
    low: float
    median: float
    high: float


def quartiles(values: np.ndarray) -> Quartiles:
    """Least, median and quartiles of (n,) values, straight lines between neighbours."""
    return Quartiles(*np.quantile(values, (0.0, 0.25, 0.5, 0.75)).tolist())


class Timing(NamedTuple):
    """What came of an entry: seconds (rounds, columns), scaled."""

    name: str
    group: str
    note: str
    seconds: np.ndarray

    @property
    def quartiles(self) -> Quartiles:
        """Over the rounds, of the median column of each [s]."""
        return quartiles(np.median(self.seconds, axis=1))

    def ratio(self, rival: Timing) -> Quartiles:
        """Over the rounds, of the median of the ratios of pairs measured within the same round in the same column."""
        return quartiles(np.median(self.seconds / rival.seconds, axis=1))


def in_rounds(
    columns: Sequence[Sequence[Entry]],
    rounds: int,
    into: dict[str, Timing],
    *,
    warm: bool = True,
    on_done: Callable[[], None] = lambda: None,
    clock: Callable[[], float] = time.perf_counter,
) -> None:
    """Time every entry of every column once in each round, one entry after another.

    Parameters
    ----------
    columns : sequence of sequence of Entry
        The same entries for each of several frames, say.
    rounds : int
        How often.
    into : dict
        Takes the timings by name, round by round, so that whoever is interrupted keeps the rounds before.
    warm : bool
        Whether each is done once just before it is timed: a search scores one frame for a whole swarm in a row, so that
        caches are warm.
    on_done, clock : callable
        The former is called after each round; the latter gives seconds from any zero.
    """
    first = columns[0] if columns else ()
    seconds = np.empty((len(first), rounds, len(columns)))
    for turn in range(rounds):
        for at, column in enumerate(columns):
            for row, entry in enumerate(column):
                if warm:
                    entry.act()
                start = clock()
                entry.act()
                seconds[row, turn, at] = (clock() - start) * entry.scale
        for entry, times in zip(first, seconds, strict=True):
            into[entry.name] = Timing(entry.name, entry.group, entry.note, times[: turn + 1])
        on_done()


# --- a frame ----------------------------------------------------------------------------------------------------------

# The paper's Table II: height [m] and tilt [deg].
MOUNTINGS = {"RS-16": (4.1, 19.0), "RS-32": (4.2, 13.0), "RS-80": (4.4, 9.0)}


@dataclass(frozen=True, eq=False)
class FrameCase:
    """A frame's vehicles, which of them are scored, and the mounting that sees them: beams, place, range gate [m],
    level of detail, side of an occupancy cell [m], imperfections."""

    vehicles: Boxes
    lattice: BeamLattice
    pose: Pose
    gate_m: float
    detail: str
    cell_m: float
    imperfections: Imperfections = PERFECT

    @cached_property
    def triangles(self):
        """Of all vehicles."""
        return vehicle_triangles(self.vehicles, self.detail)

    @cached_property
    def directions(self) -> np.ndarray:
        """Of all beams, (b, 3) in the road frame."""
        return np.ascontiguousarray(self.pose.to_world(self.lattice.directions.reshape(-1, 3)))

    @cached_property
    def pieces(self):
        """The counted vehicles, cut for culling."""
        return cut_vehicles(self.vehicles.select(self.vehicles.counted), self.detail)

    @cached_property
    def survivors(self) -> np.ndarray:
        """Beams that can reach a counted vehicle, (k,) flat indices."""
        return self.cull()

    def cull(self) -> np.ndarray:
        """The same, found again."""
        return reachable_beams(self.lattice, self.pieces, self.pose, self.gate_m)

    def turn_survivors(self) -> np.ndarray:
        """Directions of the survivors in the road frame, (3, k)."""
        return ray_directions(self.lattice, self.survivors, self.pose)

    def scorer(self, caster: str, lidars: int = 1, **changed) -> FrameScorer:
        """The frame, made ready for a caster and so many equal LiDARs; `changed` are attributes of `Observation`."""
        lidar = Lidar(self.lattice, self.gate_m, imperfections=changed.pop("imperfections", self.imperfections))
        observation = Observation((lidar,) * lidars, caster, self.detail, self.cell_m, **changed)
        return FrameScorer(self.vehicles, observation)


def cases_of(scenario: Scenario, frames: int) -> list[FrameCase]:
    """Searched frames of a scene, under the paper's mounting for its sensor."""
    recording, gate = read_recording(scenario), scenario.lidar.sensor.range_gate_m
    region = Region(scenario.lidar.deployment.nominal_xy, gate)
    height, tilt = MOUNTINGS[scenario.lidar.sensor.name]
    pose = scenario.lidar.mounting({"height_m": height, "tilt_x_deg": tilt}).pose
    seen = (lattice_of(scenario.lidar.sensor), pose, gate, scenario.world.detail, scenario.objective.cell_m)
    chosen = plan_frames(recording, region.holds, count=frames).search.tolist()
    every = (recording.at(frame) for frame in chosen)
    frames = [replace(frame, counted=region.holds(frame)) for frame in every]
    return [FrameCase(frame, *seen, scenario.lidar.sensor.imperfections) for frame in frames]


def summary_of(cases: Sequence[FrameCase]) -> dict[str, object]:
    """What is timed, as JSON holds it: least, median and most of the frames."""
    rows = {
        "vehicles": [len(case.vehicles) for case in cases],
        "vehicles_counted": [int(case.vehicles.counted.sum()) for case in cases],
        "triangles": [len(case.triangles) for case in cases],
        "survivors": [len(case.survivors) for case in cases],
    }
    first = cases[0]
    return {
        "sensor": first.lattice.model.name,
        "beams": len(first.directions),
        "frames": [case.vehicles.frame for case in cases],
        "detail": first.detail,
        "range_gate_m": first.gate_m,
        **{name: np.quantile(row, (0.0, 0.5, 1.0), method="nearest").tolist() for name, row in rows.items()},
    }


# --- ours by stage ----------------------------------------------------------------------------------------------------


def whole_of(caster: str) -> str:
    """Name of the entry of a whole frame."""
    return f"{caster}: the whole"


def swarm_of(caster: str) -> str:
    """Name of the entry of one mounting among many scored in one go."""
    return f"{caster}: a mounting of a swarm of {SWARM}"


def casting_of(caster: str) -> str:
    """Name of the entry of casting alone."""
    return f"{caster}: drawing a turn" if caster == RASTER else f"{caster}: casting the survivors"


def stage_entries(case: FrameCase, casters: Sequence[str]) -> list[Entry]:
    """Every stage of one frame with each caster: the whole, culling, casting, scoring."""
    swarm = swarm_about(case.pose)
    entries = [Entry(whole_of(name), partial(score_whole, case.scorer(name), [case.pose]), OURS) for name in casters]
    entries += [
        Entry(swarm_of(name), partial(score_whole, case.scorer(name), swarm), OURS, 1.0 / SWARM) for name in casters
    ]
    entries += [entry for name in casters[:1] for entry in _swarms_of_other_kinds(case, name, swarm)]
    if set(casters) - {RASTER}:
        entries += [Entry("culling", case.cull, OURS), Entry("directions of the survivors", case.turn_survivors, OURS)]
    return entries + [entry for name in casters for entry in _casting_and_scoring(case, name)]


KINDS = {
    "drop-out 0.1": Imperfections(dropout=0.1),
    "range noise 0.02 m": Imperfections(range_noise_m=0.02),
    "glass drop-out 0.5": Imperfections(glass_dropout=0.5),
    "10 % seen to 60 m": Imperfections(range_at_10_percent_m=60.0),
}


def _swarms_of_other_kinds(case: FrameCase, caster: str, swarm: Sequence[Pose]) -> list[Entry]:
    """A swarm of imperfect sensors, behind a barrier, and of two LiDARs under one mark: beside `swarm_of`."""
    barred = StandingScenery(barrier("concrete", 13.0, (-case.gate_m, case.gate_m)), caster)
    scorers = {kind: case.scorer(caster, imperfections=effects) for kind, effects in KINDS.items()}
    scorers |= {"concrete barrier": case.scorer(caster, scenery=barred)}
    acts = {kind: partial(score_whole, scorer, swarm) for kind, scorer in scorers.items()}
    two, layouts = case.scorer(caster, lidars=2), list(zip(swarm, swarm[::-1], strict=True))
    acts["two LiDARs"] = partial(two.see, layouts)
    return [Entry(f"{swarm_of(caster)}, {kind}", act, OURS, 1.0 / SWARM) for kind, act in acts.items()]


def metric_entry() -> Entry:
    """The metric alone, on as many cars as the paper's KITTI split has."""
    rng = np.random.default_rng(0)
    size = rng.uniform(0.9, 1.1, (KITTI_CARS, 3)) * [4.5, 1.8, 1.5]
    vehicle = np.repeat(np.arange(KITTI_CARS), POINTS_EACH)
    points = rng.uniform(-0.5, 0.5, (len(vehicle), 3)) * size[vehicle]
    name = f"the metric alone: {KITTI_CARS:,} vehicles x {POINTS_EACH} points"
    return Entry(name, partial(pe_vgop, points, vehicle, size), METRIC)


def swarm_about(pose: Pose) -> list[Pose]:
    """Mountings at the place of another, within the heights and tilts that are searched."""
    rng = np.random.default_rng(1)
    heights, tilts = rng.uniform(2.0, 4.5, SWARM), np.radians(rng.uniform(0.0, 25.0, SWARM))
    return [Pose(pose.x_m, pose.y_m, z, tilt) for z, tilt in zip(heights.tolist(), tilts.tolist(), strict=True)]


def score_whole(scorer: FrameScorer, poses: Sequence[Pose]) -> np.ndarray:
    """Bits of every vehicle and mounting."""
    return entropy(scorer.see(singles(poses)).occupancy).sum(axis=2)


def _casting_and_scoring(case: FrameCase, name: str) -> list[Entry]:
    scorer = case.scorer(name)
    tree = scorer.shapes.tree
    (hits,) = revolutions(tree, case.lattice, [case.pose], case.gate_m, case.pieces)
    if name == RASTER:
        cast = partial(tree.revolution, case.lattice, case.pose, case.gate_m)
    else:
        cast = partial(tree.meet, case.pose.position, case.turn_survivors().T, case.gate_m)
    return [
        Entry(casting_of(name), cast, OURS),
        Entry(f"{name}: scoring", partial(_score, case, scorer, hits), OURS),
    ]


def _score(case: FrameCase, scorer: FrameScorer, hits: Revolution) -> np.ndarray:
    """Bits of every counted vehicle, from what the beams met."""
    if scorer.compiled is None:
        return entropy(scorer.grids.occupancy(*scorer.returns_of(case.pose, hits))).sum(axis=1)
    from blender_lidar.metrics.compiled_marks import count_cells  # not where Numba is missing

    points, cells = np.zeros(len(scorer), dtype=np.int64), np.zeros((len(scorer), 3), dtype=np.int64)
    bits = scorer.grids.no_bits(1)[0]
    scorer.compiled.mark(scorer.compiled.lidars[0], case.pose, *hits[:3], points, bits)
    count_cells(bits, scorer.grids.start, scorer.grids.words, cells)
    return entropy(scorer.grids.shares(cells)).sum(axis=1)


class NumPyProcess:
    """A process without Numba, as in a Blender that has NumPy alone, that scores frames when it is asked.

    What a question costs besides is some 0.3 ms.
    """

    def __init__(self, cases: Sequence[FrameCase], casters: Sequence[str]) -> None:
        self._casters = [name for name in casters if name not in (RASTER, EXACT)]
        self._workers = Workers(_WithoutNumba(cases, self._casters), 2)
        self._workers.await_ready()

    def entries(self, row: int) -> list[Entry]:
        """The whole and a mounting of a swarm, of the frame in a row of `cases`, with each caster that can do so."""
        return [
            Entry(named(f"{name} without Numba"), partial(self._ask, row, name, swarm), OURS, scale)
            for named, swarm, scale in ((whole_of, False, 1.0), (swarm_of, True, 1.0 / SWARM))
            for name in self._casters
        ]

    def close(self) -> None:
        """Let it end."""
        self._workers.close()

    def _ask(self, row: int, name: str, swarm: bool) -> np.ndarray:
        return self._workers.submit(row, name, swarm).result()


class _WithoutNumba:
    """What the process does."""

    def __init__(self, cases: Sequence[FrameCase], casters: Sequence[str]) -> None:
        self._cases, self._casters = cases, casters

    def __call__(self, row: int, name: str, swarm: bool) -> np.ndarray:
        pose = self._cases[row].pose
        return score_whole(self._scorers[row, name], swarm_about(pose) if swarm else [pose])

    @cached_property
    def _scorers(self):
        sys.modules["numba"] = None  # as if it were not installed
        if numba_works():
            raise RuntimeError("Numba was asked for before it was taken away")
        return {(row, name): case.scorer(name) for row, case in enumerate(self._cases) for name in self._casters}


# --- whole optimisations ----------------------------------------------------------------------------------------------

FEW = {("traffic", "frames"): 5, ("search", "particles"): 20, ("search", "iterations"): 5, ("model", "workers"): 1}


def optimisations(scene: str, overrides: dict, casters: Sequence[str]) -> list[Entry]:
    """The search of a scene from its first mounting to its last, with each caster: `FEW` evaluations, one process."""
    given = {key: (value, "benchmark") for key, value in FEW.items()}
    scenario = load_scenario(scene, {**overrides, **given, ("model", "caster"): (casters[0], "--caster")})
    if not scenario.lidar.deployment.places[0].bounds:
        raise InputError(f"{scene}: [deployment] fixes every coordinate; a search needs a pair [low, high]")
    site, space = prepare(scenario), scenario.lidar.deployment.spaces[0]
    note = f"{fresh_search(scenario, space).budget:,} evaluations, {len(site.search)} frames, 1 process"
    entries = []
    for caster in casters:
        each = replace(site, observation=replace(site.observation, caster=caster))
        with Evaluator(
            each.search[:1], each.observation, each.scoring
        ) as evaluator:  # libraries and compiled code load
            evaluator.totals([space.layout(space.lower)])
        name = f"optimisation, {scenario.lidar.sensor.name}, {caster}"
        entries.append(Entry(name, partial(optimise, each), "whole", note=note))
    return entries


def optimise(site: Site) -> SearchResult:
    """Search a site's mountings; what follows in a run, hold-out and map, is left out."""
    space = site.scenario.lidar.deployment.spaces[0]
    search = fresh_search(site.scenario, space)
    with site_evaluator(site, site.search) as evaluator:

        def objective(x: np.ndarray) -> np.ndarray:
            return evaluator.totals([space.layout(row) for row in x]).objective.sum(axis=1)

        return run_search(search, objective)
