"""What the ladder needs scored, as stages: every fidelity, and the reference where it judges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..study.fidelity import Fidelity
from ..study.landscape import Landscape
from ..study.landscape_stages import LandscapeStages
from ..study.landscapes import HELD_OUT, SEARCHED, Job
from ..study.site import Site
from .candidates import Candidates
from .effort import Effort
from .ladder import BEST_DETAIL, Rung, on_all_frames, variation

REFERENCE = Fidelity(BEST_DETAIL)


@dataclass(frozen=True, slots=True, eq=False)
class Scored:
    """Landscapes, by what they are of.

    Attributes
    ----------
    judged : Landscape
        The reference on the frames that judge.
    ladder : dict of Fidelity to landscapes
        Each detail and stride on all frames, a landscape for each phase.
    checked : dict of Fidelity to Landscape
        Rungs with a twin, on the first few mountings.
    """

    judged: Landscape
    ladder: dict[Fidelity, list[Landscape]]
    checked: dict[Fidelity, Landscape]

    @property
    def reference(self) -> Landscape:
        """The reference on the searched frames."""
        return self.ladder[REFERENCE][0]

    def by_stage(self, rows: list[int]) -> dict[str, Landscape]:
        """Some mountings of every fidelity at its first phase, by the stage of its variation."""
        return {variation(fidelity).stage: phases[0].select(rows) for fidelity, phases in self.ladder.items()}


def judging_split(site: Site) -> str:
    """The held-out frames, or the searched ones where nothing is held out."""
    return HELD_OUT if sum(int(frame.counted.sum()) for frame in site.holdout) else SEARCHED


def block_of(site: Site, split: str) -> np.ndarray:
    """Block of each frame."""
    return site.plan.holdout_block if split == HELD_OUT else site.plan.search_block


def score_ladder(
    stages: LandscapeStages,
    site: Site,
    every: Candidates,
    effort: Effort,
    rungs: Sequence[Rung],
) -> Scored:
    """Score what the folder does not hold."""
    judging = judging_split(site)
    fidelities = list(on_all_frames(rungs, effort.phases))
    twins = [rung.fidelity for rung in rungs if rung.twin is not None]
    few = every.poses[: 1 + effort.few_mountings]
    jobs = [
        *(Job(variation(fidelity), every.poses) for fidelity in fidelities),
        *(Job(variation(fidelity), few) for fidelity in twins),
        *([Job(variation(REFERENCE), every.poses, judging)] if judging == HELD_OUT else []),
    ]
    found = stages.landscapes(site, jobs, "mountings scored")
    by_stage = {job.variation.stage: one for job, one in zip(jobs, found, strict=True) if job.split == SEARCHED}
    ladder: dict[Fidelity, list[Landscape]] = {}
    for fidelity in fidelities:
        ladder.setdefault(replace(fidelity, phase=0), []).append(by_stage[variation(fidelity).stage])
    return Scored(
        judged=found[-1] if judging == HELD_OUT else ladder[REFERENCE][0],
        ladder=ladder,
        checked={fidelity: by_stage[variation(fidelity).stage] for fidelity in twins},
    )
