"""Whether views are so full that PE-VGOP falls where it should rise: beyond P = 1/e."""

from __future__ import annotations

import math

import numpy as np

from ..scenario import pose_at
from ..study.site import Site
from ..study.vehicle_table import vehicle_table
from .findings import FAILS, FRAGILE, MOST_FRAGILE_LOSS, MOST_STABLE_LOSS, STABLE, UNDECIDED, Finding, percent
from .variations import METRIC

PEAK = 1.0 / math.e
_VIEWS = ("p_top", "p_side", "p_front")


def views_beyond_the_peak(site: Site, mounting: dict[str, float]) -> dict:
    """Share of the views with any return whose occupancy exceeds 1/e, of all and of those nearer than 10 m."""
    table = vehicle_table(site.search, pose_at(mounting), site.observation, site.scoring, "search")
    shares = np.stack([table[view] for view in _VIEWS], axis=1)
    near = table["distance_m"] < 10.0
    return {"seen": int((shares > 0).sum()), "share": _beyond(shares), "share_within_10_m": _beyond(shares[near])}


def saturation_finding(found: dict) -> Finding:
    """How much of what is seen lies where a denser view scores less."""
    what, share = "views beyond P = 1/e", found["share"]
    if share is None:
        return Finding(METRIC, what, "", UNDECIDED, "no view of any vehicle has a return", found)
    verdict = STABLE if share <= MOST_STABLE_LOSS else FRAGILE if share <= MOST_FRAGILE_LOSS else FAILS
    near = found["share_within_10_m"]
    text = f"{percent(share)} of {found['seen']:,} seen views" + (
        "" if near is None else f", {percent(near)} of those nearer than 10 m: there a denser view scores less"
    )
    return Finding(METRIC, what, "", verdict, text, found)


def _beyond(shares: np.ndarray) -> float | None:
    seen = shares[shares > 0]
    return float((seen > PEAK).mean()) if len(seen) else None
