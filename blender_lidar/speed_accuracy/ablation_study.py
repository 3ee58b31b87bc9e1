"""Every ablation scored and judged, stage by stage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from ..study.landscape import Landscape
from ..study.landscape_stages import LandscapeStages
from ..study.landscapes import HELD_OUT, Job
from ..study.site import Site
from ..study.variation import Variation
from .ablated import Sides, ablation_row, filled_up, kept_candidates
from .ablations import Ablation
from .accuracy import Reference
from .candidates import BASELINE, FIRST, Candidates
from .noise import Noise, noise_ceiling
from .scored import judging_split


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """What ablations of a site are compared on.

    Attributes
    ----------
    site : Site
    every : Candidates
    reference : Reference
        Of these candidates.
    floor : Noise or None
        Of the same.
    """

    site: Site
    every: Candidates
    reference: Reference
    floor: Noise | None

    @classmethod
    def of(cls, site: Site, every: Candidates, reference: Reference) -> Compared:
        """With its floor."""
        return cls(site, every, reference, noise_ceiling(reference))


def ablation_rows(
    stages: LandscapeStages, on: Compared, changes: Sequence[Ablation], known: Mapping[str, Landscape], what: str = ""
) -> list[dict]:
    """A row for every ablation; what either side would choose is judged where the scene has the thing.

    Parameters
    ----------
    stages : LandscapeStages
    on : Compared
    changes : sequence of Ablation
    known : mapping of str to Landscape
        By a variation's stage, what has been scored already.
    what : str
        Tells the stages of another site from the scene's own.
    """
    variations = {one.stage: one for change in changes for pair in change.pairs for one in pair}
    missing = [one for stage, one in variations.items() if stage not in known]
    jobs = [Job(_named(one, what), on.every.poses) for one in missing]
    found = stages.landscapes(on.site, jobs, f"ablations scored{what and ', '}{what}")
    scored = {**known, **dict(zip((one.stage for one in missing), found, strict=True))}
    sides = [[Sides(*(scored[one.stage] for one in pair)) for pair in change.pairs] for change in changes]
    judged = _judged(stages, on, changes, sides, what)
    return [
        ablation_row(change, both, seen, on.every, on.reference, on.floor)
        for change, both, seen in zip(changes, sides, judged, strict=True)
    ]


def _judged(stages, on, changes, sides, what) -> list[list[Landscape]]:
    """What has the thing, for the candidates that either side would choose, on the frames that judge."""
    if judging_split(on.site) != HELD_OUT:
        return [[one.having for one in both] for both in sides]
    asked, jobs = [], []
    for change, both in zip(changes, sides, strict=True):
        for pair, one in zip(change.pairs, both, strict=True):
            if one.refused:
                continue
            kept = kept_candidates(one, on.reference)
            poses = tuple(on.every.poses[row] for row in (BASELINE, *(FIRST + kept)))
            named = replace(
                pair[1], section="judged", what=change.what, value=change.value, draw=pair[0].draw or pair[1].draw
            )
            asked.append(kept)
            jobs.append(Job(_named(named, what), poses, HELD_OUT))
    found = stages.landscapes(on.site, jobs, f"ablations judged{what and ', '}{what}")
    whole = iter(filled_up(one, kept, len(on.every.poses)) for one, kept in zip(found, asked, strict=True))
    return [[next(whole) for one in both if not one.refused] for both in sides]


def _named(variation: Variation, what: str) -> Variation:
    return replace(variation, section=f"{what} {variation.section}".strip())
