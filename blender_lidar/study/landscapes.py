"""Mountings scored on many variations of a site, frame by frame over several processes, of one machine or many."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..sensors.pose import Pose
from .landscape import Landscape
from .scoring import CountedFrame, VehicleScores, mountings_of
from .site import Site
from .variation import Variation

SEARCHED, HELD_OUT = "searched", "held out"
_MOUNTINGS_AT_A_TIME = 32  # so that all points of a frame that a metric looks at fit into memory


@dataclass(frozen=True, slots=True)
class Job:
    """Mountings to score on one variation's frames, `SEARCHED` or `HELD_OUT`."""

    variation: Variation
    poses: tuple[Pose, ...]
    split: str = SEARCHED


def landscapes(
    site: Site, jobs: Sequence[Job], progress: Callable[[int], None] = lambda frames: None
) -> Iterator[Landscape | str]:
    """What the mountings of each job come to, in the order of the jobs; a text where the site cannot be changed so.

    Parameters
    ----------
    site : Site
    jobs : sequence of Job
    progress : callable
        Told how many frames have been scored since it was last called.
    """
    columns = _Columns(site, tuple(jobs))
    frames = [len(_split(site, job.split)) for job in jobs]
    tasks = [(number, frame) for number, count in enumerate(frames) for frame in range(count)]
    workers = site.workplace.employ(columns.of, len(tasks))
    try:
        found = workers.each([number for number, _ in tasks], [frame for _, frame in tasks])
        for count in frames:
            scored = []
            for _ in range(count):
                scored.append(next(found))
                progress(1)
            yield _joined(scored)
    finally:
        workers.close()


def _split(site: Site, split: str) -> tuple[CountedFrame, ...]:
    return site.search if split == SEARCHED else site.holdout


def _joined(scored) -> Landscape | str:
    refused = [column for column in scored if isinstance(column, str)]
    if refused:
        return refused[0]
    landscape = Landscape(
        np.stack([objective for objective, _ in scored], axis=1),
        np.array([vehicles for _, vehicles in scored], dtype=np.int64),
    )
    return landscape if landscape.vehicles.sum() else "no vehicle is left in the region"


class _Columns:
    """Scores one frame of one job; what belongs to the job is kept until another one is asked for."""

    def __init__(self, site: Site, jobs: tuple[Job, ...]) -> None:
        self._site, self._jobs = site, jobs
        self._number: int | None = None
        self._changed: tuple[Site, VehicleScores] | str = ""

    def of(self, number: int, frame: int) -> tuple[np.ndarray, int] | str:
        """Objective of each mounting, (m,), and the vehicles that count; or why the site cannot be changed so."""
        job = self._jobs[number]
        if number != self._number:
            self._number, self._changed = number, self._change(job)
        if isinstance(self._changed, str):
            return self._changed
        site, scores = self._changed
        chosen = _split(site, job.split)[frame]
        scorer = job.variation.scorer(site, chosen)
        objective = []
        for start in range(0, len(job.poses), _MOUNTINGS_AT_A_TIME):
            poses = job.poses[start : start + _MOUNTINGS_AT_A_TIME]
            objective.append(scores.of(chosen, scorer, poses, mountings_of(poses)).objective.sum(axis=1))
        return np.concatenate(objective), int(chosen.counted.sum())

    def _change(self, job: Job) -> tuple[Site, VehicleScores] | str:
        try:
            site = job.variation.changed(self._site)
        except InputError as error:
            return str(error)
        return site, VehicleScores(site.scoring, site.observation, _split(site, job.split))
