"""Many mountings over many frames, spread over processes, of one machine or several.

A frame's result does not depend on which process computed it nor on what else was asked: casters decide hits in
float64, whatever they look for them in. So the number of workers changes the time that a run takes and nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np

from ..sensors.pose import Pose
from .fidelity import Fidelity
from .frame_scorer import FrameScorer, Observation
from .frame_shapes import FrameShapes
from .rungs import coarse_observation
from .scoring import CountedFrame, Scoring, VehicleScores, mountings_of
from .workers import Alone, Workers
from .workplace import Workplace

_GOLDEN = (5.0**0.5 - 1.0) / 2.0  # multiples of it are spread evenly, any run of them


class Totals(NamedTuple):
    """Sums over the counted vehicles of each frame, for each mounting.

    Attributes
    ----------
    objective : ndarray, (s, f)
        Eq. 10, in the metric's unit.
    detectable : ndarray of int64, (s, f)
        Vehicles at or above the threshold.
    vehicles : ndarray of int64, (f,)
        Vehicles that count.
    """

    objective: np.ndarray
    detectable: np.ndarray
    vehicles: np.ndarray

    def per_vehicle(self, frames: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Objective per counted vehicle over the chosen frames, (s,), in the metric's unit."""
        return self.objective[:, frames].sum(axis=1) / self.vehicles[frames].sum()

    def detectable_share(self, frames: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Share of counted vehicles at or above the threshold over the chosen frames, (s,)."""
        return self.detectable[:, frames].sum(axis=1) / self.vehicles[frames].sum()


class Evaluator:
    """Scores mountings over a fixed list of frames.

    Parameters
    ----------
    frames : sequence of CountedFrame
        The frames; their trees are built once, in each process that needs them, and kept.
    observation : Observation
        Sensor, range, caster and detail.
    scoring : Scoring
        The metric and the settings of Eqs. 10 and 11.
    workers : int
        Processes, this one among them.
    cluster : str, optional
        Address of a dask scheduler, whose workers are used instead.

    Use it as a context manager: leaving it ends the processes, or leaves the cluster.
    """

    def __init__(
        self,
        frames: Sequence[CountedFrame],
        observation: Observation,
        scoring: Scoring,
        workers: int = 1,
        cluster: str | None = None,
    ) -> None:
        self._work = _Work(tuple(frames), observation, scoring)
        self.vehicles = np.array([int(frame.counted.sum()) for frame in frames], dtype=np.int64)
        self._turn = np.arange(len(frames)) * _GOLDEN % 1.0  # of each frame, wherever it is asked for
        self._workplace = Workplace(workers, cluster)
        self._pool: Workers = Alone(self._work.totals)

    def __enter__(self) -> Evaluator:
        self._pool = self._workplace.employ(self._work.totals, len(self.vehicles))
        return self

    def __exit__(self, *exception) -> None:
        pool, self._pool = self._pool, Alone(self._work.totals)
        pool.close()

    def totals(
        self, poses: Sequence[Pose], frames: Sequence[int] | None = None, fidelity: Fidelity | None = None
    ) -> Totals:
        """Score s mountings.

        Parameters
        ----------
        poses : sequence of Pose, (s,)
        frames : sequence of int, (f,), optional
            Places of the frames that are scored, in that order; all of them when left out.
        fidelity : Fidelity, optional
            What the frames are seen through, as `rungs.coarse_observation` does; the observation itself when left out.
        """
        chosen = np.arange(len(self.vehicles)) if frames is None else np.array(frames, dtype=int)
        order = np.argsort(self._turn[chosen], kind="stable")
        tasks = self._tasks(chosen[order].tolist(), len(poses))
        parts = self._pool.map(tasks, [tuple(poses)] * len(tasks), [fidelity] * len(tasks))
        back = np.argsort(order)
        objective, found = (np.concatenate(column, axis=1)[:, back] for column in zip(*parts, strict=True))
        return Totals(np.ascontiguousarray(objective), np.ascontiguousarray(found), self.vehicles[chosen])

    def await_workers(self) -> None:
        """Until all processes have started, which they do in the background; raises `WorkerError` if one cannot."""
        self._pool.await_ready()

    def _tasks(self, frames: list[int], mountings: int) -> list[list[int]]:
        """The frames in as many parts as there are calls."""
        ends = accumulate(self._pool.sizes(len(frames), mountings), initial=0)
        return [frames[start:stop] for start, stop in pairwise(ends)]


class _Work:
    """Frames and settings, with the scorers built so far."""

    def __init__(self, frames, observation, scoring) -> None:
        self._frames, self._observation, self._scoring = frames, observation, scoring
        self._scorers: dict[tuple[Fidelity | None, int], FrameScorer] = {}
        self._shapes: dict[tuple[int, str, str], FrameShapes] = {}  # coarser fidelities share them
        self._seen: dict[Fidelity | None, tuple[Observation, VehicleScores]] = {}

    def __getstate__(self):
        return {**vars(self), "_scorers": {}, "_shapes": {}, "_seen": {}}

    def totals(self, frames, poses, fidelity):
        """Objective and number of detectable vehicles, (s, frames) each."""
        objective = np.empty((len(poses), len(frames)))
        found = np.empty((len(poses), len(frames)), dtype=np.int64)
        observation, scores = self._through(fidelity)
        mountings = mountings_of(poses)
        for column, frame in enumerate(frames):
            scorer = self._scorer(frame, fidelity, observation)
            scored = scores.of(self._frames[frame], scorer, poses, mountings)
            objective[:, column] = scored.objective.sum(axis=1)  # Eq. 10
            found[:, column] = scored.detectable.sum(axis=1)
        return objective, found

    def _through(self, fidelity):
        """How vehicles are seen through a fidelity, and what scores them; None is the observation as it is."""
        if fidelity not in self._seen:
            observation = self._observation
            if fidelity is not None:
                observation = coarse_observation(observation, fidelity)
            self._seen[fidelity] = observation, VehicleScores(self._scoring, observation, self._frames)
        return self._seen[fidelity]

    def _scorer(self, frame, fidelity, observation) -> FrameScorer:
        if (fidelity, frame) not in self._scorers:
            chosen, place = self._frames[frame], (frame, observation.detail, observation.caster)
            scorer = FrameScorer(chosen.vehicles, chosen.counted, observation, self._shapes.get(place))
            self._scorers[fidelity, frame], self._shapes[place] = scorer, scorer.shapes
        return self._scorers[fidelity, frame]
