"""Some of a site's searched frames, spread evenly over them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .site import Site


def evenly_spread(of: int, kept: int) -> np.ndarray:
    """Which `kept` of so many rows lie in the middle of equal stretches of them, (kept,) int."""
    return ((np.arange(kept) + 0.5) * of / kept).astype(int)


def with_fewer_frames(site: Site, frames: int | None) -> Site:
    """The site with at most that many of its searched frames, spread evenly; all for None, or where those are empty."""
    if frames is None or frames >= len(site.search):
        return site
    kept = evenly_spread(len(site.search), frames)
    if not any(site.search[row].counted.any() for row in kept):
        return site
    plan = replace(site.plan, search=site.plan.search[kept], search_block=site.plan.search_block[kept])
    return replace(site, plan=plan, search=tuple(site.search[row] for row in kept))
