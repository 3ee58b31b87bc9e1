"""What an evaluation costs: one of a few mountings scored together, on every frame; in one process, warm, in turn."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..sensors.pose import Pose
from ..study.fidelity import Fidelity
from ..study.scoring import VehicleScores, mountings_of
from ..study.site import Site
from ..study.site_fidelity import site_at
from ..study.variation import frame_scorer

TOGETHER = 4  # mountings; a search asks for a swarm of them


@dataclass(frozen=True, slots=True, eq=False)
class Timed:
    """How long a fidelity takes on each frame.

    Attributes
    ----------
    evaluation_s : ndarray, (rounds, f)
        Of one mounting of those scored together [s].
    build_s : ndarray, (f,)
        To make triangles and tree [s].
    """

    evaluation_s: np.ndarray
    build_s: np.ndarray


def time_fidelities(
    site: Site,
    fidelities: Sequence[Fidelity],
    poses: Sequence[Pose],
    rounds: int,
    progress: Callable[[int], None] = lambda frames: None,
) -> list[Timed]:
    """Time fidelities frame by frame; all of them have every frame.

    On each frame they take turns, each round with other mountings, so that a moment in which the machine is busy with
    something else falls on all. The first round, in which caches fill, is not counted.

    Parameters
    ----------
    site : Site
    fidelities : sequence of Fidelity
    poses : sequence of Pose
    rounds : int
    progress : callable
        Told how many frames have been timed since it was last called.
    """
    sites = [site_at(site, fidelity) for fidelity in fidelities]
    scores = [VehicleScores(one.scoring, one.observation, site.search) for one in sites]
    evaluation, build = np.empty((len(sites), rounds, len(site.search))), np.empty((len(sites), len(site.search)))
    for column, frame in enumerate(site.search):
        scorers = []
        for row, one in enumerate(sites):
            start = time.perf_counter()
            scorers.append(frame_scorer(one, frame))
            build[row, column] = time.perf_counter() - start
        for turn in range(-1, rounds):
            some = [poses[(turn + number) % len(poses)] for number in range(TOGETHER)]
            for row in np.roll(np.arange(len(sites)), turn).tolist():
                start = time.perf_counter()
                scores[row].of(frame, scorers[row], some, mountings_of(some)).objective.sum(axis=1)
                if turn >= 0:
                    evaluation[row, turn, column] = (time.perf_counter() - start) / TOGETHER
        progress(1)
    return [Timed(*both) for both in zip(evaluation, build, strict=True)]
