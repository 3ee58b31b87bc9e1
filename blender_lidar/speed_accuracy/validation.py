"""Does the recommendation hold on a scene it has not seen: on other blocks, and with another sensor?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..study.fewer_frames import evenly_spread, with_fewer_frames
from ..study.fidelity import Fidelity
from ..study.landscape import Landscape
from ..study.landscape_stages import LandscapeStages
from ..study.landscapes import HELD_OUT, SEARCHED, Job
from ..study.site import Site
from ..study.variation import Variation
from .accuracy import Reference, accuracy
from .candidates import Candidates, candidates
from .effort import Effort
from .ladder import phased, variation
from .scored import REFERENCE, Scored, block_of, judging_split

HOLDS, LIKELY, FAILS, UNTOLD = "holds", "likely", "fails", "cannot be told"


def _validated(
    where: str, reference: Reference, phases: Sequence[Landscape], tolerance: float, frames: np.ndarray | None
) -> dict:
    """What the recommended fidelity loses where it was not chosen, as JSON holds it."""
    found = accuracy(reference, phases, frames)
    lost, gain = found.regret, reference.gain
    return {
        "where": where,
        "verdict": verdict(None if lost is None else lost.share, None if lost is None else lost.interval_90, tolerance),
        "regret": None if lost is None else lost.share,
        "regret_interval_90": None if lost is None or lost.interval_90 is None else list(lost.interval_90),
        "error_share": found.error / gain if gain > 0.0 else None,
        "tau": found.tau if np.isfinite(found.tau) else None,
    }


def verdict(share: float | None, interval: tuple[float, float] | None, tolerance: float) -> str:
    """Whether a loss is within the tolerance: by its whole 90 % interval, or likely; or surely is not."""
    if share is None or (share > tolerance and (interval is None or interval[0] <= tolerance)):
        return UNTOLD
    if share > tolerance:
        return FAILS
    return HOLDS if interval is not None and interval[1] <= tolerance else LIKELY


def on_other_blocks(
    stages: LandscapeStages,
    site: Site,
    chosen: Fidelity,
    found: Scored,
    every: Candidates,
    effort: Effort,
    tolerance: float,
) -> list[dict]:
    """The held-out blocks choose and the searched ones judge; nothing where nothing is held out."""
    if judging_split(site) != HELD_OUT:
        return []
    fidelities = phased(replace(chosen, frames=None), effort.phases)
    jobs = [Job(_named(fidelity, "other blocks"), every.poses, HELD_OUT) for fidelity in fidelities]
    phases = stages.landscapes(site, jobs, "recommendation on other blocks")
    swapped = Reference.of(
        found.judged,
        site.plan.holdout_block,
        found.reference,
        site.plan.search_block,
        site.scenario.search.seed + 1,
    )
    frames = _as_many_of(chosen, len(site.search), len(site.holdout))
    return [
        _validated(
            "other blocks: the held-out ones choose, the searched ones judge", swapped, phases, tolerance, frames
        )
    ]


def other_reference(stages: LandscapeStages, other: Site, effort: Effort) -> tuple[Site, Candidates, Reference]:
    """The reference of the same scene with another sensor: on which site, and of which candidates."""
    site = with_fewer_frames(other, effort.frames)
    every, judging = candidates(site.scenario, effort.other_mountings), judging_split(site)
    splits = (SEARCHED, HELD_OUT) if judging == HELD_OUT else (SEARCHED,)
    jobs = [Job(_named(REFERENCE, "other sensor reference"), every.poses, split) for split in splits]
    scored = stages.landscapes(site, jobs, f"reference with {site.model.name}")
    searched, judged = scored[0], scored[-1]
    return (
        site,
        every,
        Reference.of(searched, site.plan.search_block, judged, block_of(site, judging), site.scenario.search.seed),
    )


def on_other_sensor(
    stages: LandscapeStages,
    beside: tuple[Site, Candidates, Reference],
    chosen: Fidelity,
    effort: Effort,
    tolerance: float,
) -> dict:
    """What the recommendation loses with the sensor of `other_reference`."""
    site, every, reference = beside
    fidelities = phased(replace(chosen, frames=None), effort.phases)
    jobs = [Job(_named(fidelity, "other sensor"), every.poses) for fidelity in fidelities]
    phases = stages.landscapes(site, jobs, f"recommendation with {site.model.name}")
    where = f"{site.model.name}, range gate {site.observation.max_range_m:g} m"
    frames = _as_many_of(chosen, len(site.search), len(site.search))
    return _validated(where, reference, phases, tolerance, frames)


def _named(fidelity: Fidelity, section: str) -> Variation:
    return replace(variation(fidelity), section=section)


def _as_many_of(fidelity: Fidelity, searched: int, frames: int) -> np.ndarray | None:
    """Rows of other frames, in the share that the fidelity takes of the searched ones."""
    if fidelity.frames is None:
        return None
    return evenly_spread(frames, max(round(fidelity.frames * frames / searched), 1))
