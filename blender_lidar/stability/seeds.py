"""The scene's search under several seeds: how far its answers lie apart, and what they leave to the best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..optimise import Search
from ..run import fresh_search
from ..study.evaluation import Evaluator
from ..study.site import Site


def answer_of_seed(
    site: Site,
    evaluator: Evaluator,
    seed: int,
    budget: float,
    progress: Callable[[int], None] = lambda evaluations: None,
) -> dict:
    """What the scene's search finds with a seed: the six coordinates, their value per vehicle, evaluations.

    Parameters
    ----------
    site : Site
    evaluator : Evaluator
        Scores the searched frames.
    seed : int
    budget : float
        Share of the scene's evaluations.
    progress : callable
        Told how many evaluations were made since it was last called.
    """
    deployment = site.scenario.deployment
    search = _search(site, seed, budget)
    while not search.done:
        candidates = search.ask()
        search.tell(evaluator.totals([deployment.pose(x) for x in candidates]).per_vehicle())
        progress(len(candidates))
    return {
        "seed": seed,
        "mounting": deployment.coordinates(search.best_x),
        "per_vehicle": search.best_value,
        "evaluations": search.evaluations,
    }


def evaluations_of(site: Site, budget: float) -> int:
    """Evaluations that a search makes with a share of the scene's budget."""
    return _search(site, 0, budget).budget


def regrets(answers: list[dict], best: float, baseline: float) -> np.ndarray | None:
    """Share of the gain that each answer leaves to the best of all, (seeds,); None where nothing is gained."""
    values = np.array([answer["per_vehicle"] for answer in answers])
    best = max(best, float(values.max()))
    return (best - values) / (best - baseline) if best > baseline else None


def _search(site: Site, seed: int, budget: float) -> Search:
    settings = site.scenario.search
    iterations = max(1, round(budget * settings.iterations))
    return fresh_search(replace(site.scenario, search=replace(settings, seed=seed, iterations=iterations)))
