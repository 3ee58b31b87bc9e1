"""Evaluation of many mountings over many frames, spread over processes, of one machine or several.

A frame's result does not depend on which process computed it nor on what else was asked: casters decide hits in
float64, though they may search in another type. So the number of workers changes the time that a run takes and nothing
else.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from copy import copy
from dataclasses import dataclass
from itertools import accumulate, chain, pairwise
from typing import NamedTuple

import numpy as np

from ..compiled import within_blender
from ..errors import InputError, shown
from ..scene.installation import installed_layout
from ..scene.mounting import Layout, poses_of
from ..scene.observation import Observation, Scoring
from ..scene.settings import ModelSettings
from ..scene.site import Site
from ..sensors.pose import Pose
from ..traffic.boxes import Boxes
from .cluster import ClusterWorkers
from .fidelity import Fidelity, coarse_observation
from .frame_scorer import FrameScorer, FrameShapes
from .scores import Scored, VehicleScores
from .workers import MappedWorkers, Workers

_GOLDEN = (5.0**0.5 - 1.0) / 2.0  # multiples of it are spread evenly, any run of them


@dataclass(frozen=True, slots=True)
class Workplace:
    """Processes of this machine, or workers of others; they change the time that a run takes and nothing else.

    Attributes
    ----------
    processes : int
        How many, this one among them.
    cluster : str or None
        Address of a dask scheduler, whose workers are used instead.
    mapping : callable or None
        A `map` that is used instead of either.
    """

    processes: int = 1
    cluster: str | None = None
    mapping: Callable[[Callable, list], Iterable] | None = None

    def __str__(self) -> str:
        if self.mapping is not None:
            return "workers of a map"
        if self.cluster is not None:
            return f"cluster {self.cluster}"
        return f"{self.processes} worker{'s' * (self.processes != 1)}"

    def employ(self, function: Callable, most: int) -> Workers | ClusterWorkers | MappedWorkers:
        """Workers who call a function, up to so many; to be closed.

        Raises
        ------
        WorkerError, MissingExtraError
            When they cannot be had.
        """
        if self.mapping is not None:
            return MappedWorkers(function, self.mapping)
        if self.cluster is not None and most:
            return ClusterWorkers(function, self.cluster)
        return Workers(function, max(1, min(self.processes, most)))


_mapping: ContextVar[Callable | None] = ContextVar("mapping", default=None)


@contextmanager
def mapped_by(mapping: Callable[[Callable, list], Iterable]) -> Iterator[None]:
    """While it lasts, score with a `map` in place of own processes, as SciPy's `workers`: `multiprocessing.Pool().map`.

    Parameters
    ----------
    mapping : callable
        Called with a function, which can be pickled, and a list of what to call it with; gives the results in order.
    """
    if not callable(mapping):
        raise InputError(f"mapped_by: is {shown(mapping)}; allowed: a function such as multiprocessing.Pool().map")
    token = _mapping.set(mapping)
    try:
        yield
    finally:
        _mapping.reset(token)


def workplace_of(settings: ModelSettings) -> Workplace:
    """Where a scene is evaluated: `mapped_by`, workers as set, else one for each processor that this process may use.

    Within a real Blender it is one, which cannot start Python processes that have bpy too.
    """
    if within_blender():
        return Workplace(1, settings.cluster, _mapping.get())
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return Workplace(settings.workers or processors, settings.cluster, _mapping.get())


class Totals(NamedTuple):
    """Sums over the counted vehicles of each frame, for each mounting.

    Attributes
    ----------
    objective : ndarray, (s, f)
        Eq. 10, in the metric's unit.
    detectable : ndarray, (s, f)
        Vehicles at or above the threshold: whole numbers, or their mean over installation errors.
    vehicles : ndarray of int64, (f,)
        Vehicles that count.
    weight : ndarray, (f,)
        Sum of their weights.
    """

    objective: np.ndarray
    detectable: np.ndarray
    vehicles: np.ndarray
    weight: np.ndarray

    def per_vehicle(self) -> np.ndarray:
        """Objective per counted vehicle over all frames, a weighted mean, (s,), in the metric's unit."""
        return self.objective.sum(axis=1) / self.weight.sum()

    def detectable_share(self) -> np.ndarray:
        """Share of counted vehicles at or above the threshold over all frames, without their weights, (s,)."""
        return self.detectable.sum(axis=1) / self.vehicles.sum()


class Evaluator:
    """Scores layouts over a fixed list of frames.

    Use it as a context manager: leaving it ends the processes, or leaves the cluster.

    Parameters
    ----------
    frames : sequence of Boxes
        The frames; their trees are built once, in each process that needs them, and kept.
    observation : Observation
        Sensor, range, caster and detail.
    scoring : Scoring
        The metric and the settings of Eqs. 10 and 11.
    place : Workplace
        Where the work is done: in this process alone unless said.
    held_out : sequence of Boxes
        Further frames for the same processes, scored apart: by `held_out`.

    Attributes
    ----------
    frames : tuple of Boxes, (f,)
    metric : str
    lidars : tuple of str
        Names of the LiDARs of a layout.
    workers : Workers, ClusterWorkers or MappedWorkers
        Who do the work, this process among them or not.
    """

    def __init__(
        self,
        frames: Sequence[Boxes],
        observation: Observation,
        scoring: Scoring,
        place: Workplace = Workplace(),
        held_out: Sequence[Boxes] = (),
    ) -> None:
        self.frames, self._held_out, self.metric = tuple(frames), tuple(held_out), scoring.metric
        self.lidars = tuple(lidar.name for lidar in observation.lidars)
        self._first = 0  # place of the first of them among all frames
        self._errors: np.ndarray | None = None
        self._turn = np.arange(len(self.frames) + len(self._held_out)) * _GOLDEN % 1.0  # of each, wherever asked for
        self._work = _Work(self.frames, self._held_out, observation, scoring)
        self._workplace = place
        self.workers: Workers | ClusterWorkers | MappedWorkers = Workers(self._work)

    def __enter__(self) -> Evaluator:
        self.workers = self._workplace.employ(self._work, len(self._turn))
        return self

    def __exit__(self, *exception) -> None:
        ended, self.workers = self.workers, Workers(self._work)
        ended.close()

    @property
    def vehicles(self) -> np.ndarray:
        """Vehicles that count in each frame, (f,) int64."""
        return np.array([frame.counts.sum() for frame in self.frames], dtype=np.int64)

    @property
    def weight(self) -> np.ndarray:
        """Sum of their weights, (f,): their number where all weigh one."""
        return np.array([frame.counted_weight.sum() for frame in self.frames])

    @property
    def held_out(self) -> Evaluator:
        """Scores the held-out frames in the same processes; a metric with a memory learns from those alone."""
        other = copy(self)
        other.frames, other._held_out, other._first, other._errors = self._held_out, (), len(self.frames), None
        return other

    @property
    def judging(self) -> tuple[str, Evaluator]:
        """Which frames judge, "holdout", or "search" where no vehicle counts in these, and what scores them."""
        held_out = self.held_out
        return ("holdout", held_out) if held_out.weight.sum() else ("search", self)

    def under(self, errors: np.ndarray | None) -> Evaluator:
        """Scores the same frames in the same processes, each frame under installation errors of its own.

        `errors` (f, e, l, 4) are as of `scene.installation`; `totals` are then means over the e of each frame. None
        are those of LiDARs that hang as planned.
        """
        other = copy(self)
        other._errors = errors
        return other

    def totals(
        self, layouts: Sequence[Layout], frames: Sequence[int] | None = None, fidelity: Fidelity | None = None
    ) -> Totals:
        """Score s layouts.

        Parameters
        ----------
        layouts : sequence of Layout, (s,)
        frames : sequence of int, (f,), optional
            Places of the frames that are scored, in that order; all of them when left out.
        fidelity : Fidelity, optional
            What the frames are seen through, by `coarse_observation`; the observation itself when left out.
        """
        chosen = np.arange(len(self.frames)) if frames is None else np.array(frames, dtype=int)
        found = self._carried_out(_sums, chosen, layouts, fidelity)
        sums = np.reshape(found, (len(chosen), self._each, 2, len(layouts))).mean(axis=1)
        objective, detectable = np.moveaxis(sums, 0, -1).copy()
        if self._errors is None:
            detectable = detectable.astype(np.int64)
        return Totals(objective, detectable, self.vehicles[chosen], self.weight[chosen])

    def by_vehicle(self, layouts: Sequence[Layout]) -> list[Scored]:
        """What s layouts make of each counted vehicle, for each frame, as planned; without the returns themselves."""
        found = self.under(None)._carried_out(_without_returns, np.arange(len(self.frames)), layouts, None)
        return [of_frame for (of_frame,) in found]

    def by_box(self, layouts: Sequence[Layout]) -> tuple[np.ndarray, np.ndarray]:
        """What s layouts add to the objective by each box, and whether it is detectable, (s, n) each.

        Boxes are in the order of their frames. Under installation errors both are means over those of the frame.
        """
        found = self._carried_out(_of_boxes, np.arange(len(self.frames)), layouts, None)
        if self._errors is None:
            every = [of_frame for (of_frame,) in found]
        else:
            every = [[np.mean(one, axis=0) for one in zip(*of_frame, strict=True)] for of_frame in found]
        return tuple(np.concatenate(one, axis=1) for one in zip(*every, strict=True))

    @property
    def _each(self) -> int:
        """Installation errors of each frame."""
        return 1 if self._errors is None else self._errors.shape[1]

    def _carried_out(self, what: Callable, chosen: np.ndarray, layouts: Sequence[Layout], fidelity: Fidelity | None):
        """What a function makes of the scores of each frame, under each of its installation errors.

        The frames go out in as many parts as there are calls.
        """
        order = np.argsort(self._turn[self._first + chosen], kind="stable")
        frames = (self._first + chosen[order]).tolist()
        if self._errors is None:
            poses = ((tuple(map(poses_of, layouts)),),) * len(frames)
        else:
            poses = Installed(tuple(layouts), self._errors[chosen[order]])
        ends = accumulate(self.workers.sizes(len(frames), len(layouts) * self._each), initial=0)
        tasks = [(what, frames[start:stop], poses[start:stop], fidelity) for start, stop in pairwise(ends)]
        found = list(chain.from_iterable(self.workers.map(*zip(*tasks, strict=True))))
        return [found[place] for place in np.argsort(order)]


@dataclass(frozen=True, slots=True, eq=False)
class Installed:
    """Layouts under the installation errors of some frames, (f, e, l, 4): poses by frame, error and layout."""

    layouts: tuple[Layout, ...]
    errors: np.ndarray

    def __getitem__(self, frames: slice) -> Installed:
        return Installed(self.layouts, self.errors[frames])

    def __iter__(self) -> Iterator[list[list[tuple[Pose | None, ...]]]]:
        for errors in self.errors:
            yield [[poses_of(installed_layout(layout, error)) for layout in self.layouts] for error in errors]


def _sums(scored: Scored) -> np.ndarray:
    """Objective and number of detectable vehicles of a frame, (2, s)."""
    return np.stack([scored.objective.sum(axis=1), scored.detectable.sum(axis=1)])  # Eq. 10


def _of_boxes(scored: Scored) -> tuple[np.ndarray, np.ndarray]:
    """Objective and whether it is detectable of each box of a frame, (s, n) each."""
    return scored.objective, scored.detectable


def _without_returns(scored: Scored) -> Scored:
    """Scores of a frame; its returns, which may be many, stay where they are."""
    return scored._replace(seen=scored.seen._replace(returns=None))


def site_evaluator(site: Site, frames: Sequence[Boxes], held_out: Sequence[Boxes] = ()) -> Evaluator:
    """An evaluator of mountings on frames of a site, as its scene asks for workers."""
    return Evaluator(frames, site.observation, site.scoring, workplace_of(site.scenario.model), held_out)


class _Work:
    """Frames and settings, with the scorers built so far; called with what to make of the scores of each frame."""

    def __init__(self, frames, held_out, observation, scoring) -> None:
        self._groups, self._frames = (frames, held_out), (*frames, *held_out)
        self._observation, self._scoring = observation, scoring
        self._scorers: dict[tuple[Fidelity | None, int], FrameScorer] = {}
        self._shapes: dict[tuple[int, str, str], FrameShapes] = {}  # coarser fidelities share them
        self._seen: dict[tuple[Fidelity | None, bool], tuple[Observation, VehicleScores]] = {}

    def __getstate__(self):
        return {**vars(self), "_scorers": {}, "_shapes": {}, "_seen": {}}

    def __call__(self, what, frames, poses, fidelity):
        """Of each frame a list: what is made of the scores of layouts under each of its installation errors."""
        found = []
        for frame, of_errors in zip(frames, poses, strict=True):
            observation, scores = self._through(fidelity, frame >= len(self._groups[0]))
            scorer = self._scorer(frame, fidelity, observation)
            found.append([what(scores.of(self._frames[frame], scorer, layouts)) for layouts in of_errors])
        return found

    def _through(self, fidelity, held_out):
        """How vehicles are seen through a fidelity, and what scores them; None is the observation as it is."""
        if (fidelity, held_out) not in self._seen:
            observation = self._observation if fidelity is None else coarse_observation(self._observation, fidelity)
            scores = VehicleScores(self._scoring, observation, self._groups[held_out])
            self._seen[fidelity, held_out] = observation, scores
        return self._seen[fidelity, held_out]

    def _scorer(self, frame, fidelity, observation) -> FrameScorer:
        if (fidelity, frame) not in self._scorers:
            chosen, place = self._frames[frame], (frame, observation.detail, observation.caster)
            scorer = FrameScorer(chosen, observation, self._shapes.get(place))
            self._scorers[fidelity, frame], self._shapes[place] = scorer, scorer.shapes
        return self._scorers[fidelity, frame]
