"""The auto search of a site, and the scores that it asks for."""

from __future__ import annotations

import numpy as np

from ..optimise import Search
from .auto_search import Asked, AutoSearch
from .evaluation import Evaluator
from .fidelity import Fidelity
from .rungs import make_rungs
from .site import Site


def auto_search(site: Site, screen: Search) -> AutoSearch:
    """The search of a scene's `[search] fidelity = "auto"`, before its first evaluation.

    Parameters
    ----------
    site : Site
        The scene made ready.
    screen : Search
        What searches on the cheapest rung, with `screened` evaluations.
    """
    deployment, block = site.scenario.deployment, site.plan.search_block
    vehicles = [int(frame.counted.sum()) for frame in site.search]
    rungs = make_rungs(site.observation, block, vehicles, len(deployment.variables))
    seed = site.scenario.search.seed
    return AutoSearch(screen, rungs, block, deployment.lower, deployment.upper, seed=seed)


def screened(variables: int) -> int:
    """Evaluations of the screening."""
    return 20 + 40 * variables


def asked_objective(site: Site, evaluator: Evaluator, asked: Asked) -> np.ndarray:
    """Objective of each candidate on each frame that an auto search asks for, (s, frames).

    Parameters
    ----------
    site : Site
        The scene made ready.
    evaluator : Evaluator
        Of all its searched frames.
    asked : Asked
        What `AutoSearch.ask` gave.
    """
    poses = [site.scenario.deployment.pose(row) for row in asked.x]
    fidelity = None if asked.fidelity == Fidelity(site.observation.detail) else asked.fidelity
    return evaluator.totals(poses, asked.frames, fidelity).objective
