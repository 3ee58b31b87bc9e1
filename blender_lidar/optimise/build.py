"""Searches by name, and from their stored state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import InputError, unknown_name
from .checks import check_whole
from .hardened import Hardened, HardenedSettings
from .protocol import Search
from .rivals import GridSearch, RandomSearch, grid_points
from .swarm import DePso, DePsoSettings

_CLASSES: dict[str, type[Search]] = {search.name: search for search in (Hardened, DePso, GridSearch, RandomSearch)}
SEARCHES = tuple(_CLASSES)


def make_search(
    name: str,
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    seed: int,
    evaluations: int | None = None,
    settings: DePsoSettings | None = None,
    points: Sequence[int] | None = None,
) -> Search:
    """A fresh search.

    Parameters
    ----------
    name : str
        One of `SEARCHES`.
    lower, upper : array_like, (d,)
        Bounds of each variable.
    seed : int
        Same seed, same candidates; a grid has no use for it.
    evaluations : int, optional
        The budget, never exceeded: DE-PSO makes as many whole iterations as fit, a grid is as fine as fits. Left out,
        every search gets what `settings` comes to.
    settings : DePsoSettings, optional
        Settings of DE-PSO, the paper's when left out; of them the hardened search takes the number of particles.
    points : sequence of int, (d,), optional
        The grid's points along each variable, in place of a budget.

    Raises
    ------
    InputError
        If the name is unknown or an argument cannot be used.
    """
    if name not in SEARCHES:
        raise unknown_name(name, SEARCHES, "search")
    settings = settings or DePsoSettings()
    if evaluations is None:
        evaluations = settings.evaluations
    if name == GridSearch.name:
        if points is None:
            points = grid_points(evaluations, np.size(lower))
        return GridSearch(lower, upper, points=points)
    if name == RandomSearch.name:
        return RandomSearch(lower, upper, seed=seed, evaluations=evaluations)
    if name == Hardened.name:
        use = HardenedSettings(particles=settings.particles, evaluations=evaluations)
        return Hardened(lower, upper, seed=seed, settings=use)
    evaluations = check_whole(evaluations, settings.particles, f"evaluations with {settings.particles} particles")
    return DePso(lower, upper, seed=seed, settings=replace(settings, iterations=evaluations // settings.particles))


def search_from_state(state: dict[str, Any]) -> Search:
    """The search whose `state` was stored, ready to go on.

    Raises
    ------
    InputError
        If the state names no known search, is incomplete or contradicts itself.
    """
    try:
        name = state["search"]
    except (KeyError, TypeError):
        raise InputError("stored search: no 'search' entry; allowed: what state() returned") from None
    if name not in SEARCHES:
        raise unknown_name(name, SEARCHES, "stored search")
    return _CLASSES[name].from_state(state)
