"""Whole optimisations, casters side by side: the search of a scene from its first mounting to its last."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ..errors import InputError
from ..optimise.solve import SearchResult
from ..optimise.solve import run as run_search
from ..run import fresh_search
from ..scenario import load_scenario
from ..study.evaluation import Evaluator
from ..study.site import Site, prepare
from .timing import Entry

GROUP = "whole"
FEW = {("traffic", "frames"): 5, ("search", "particles"): 20, ("search", "iterations"): 5, ("model", "workers"): 1}
PAPER = {
    ("search", "method"): "de-pso",
    ("traffic", "frames"): 60,
    ("search", "particles"): 20,
    ("search", "iterations"): 100,
}
PAPER_SENSORS = ("RS-16", "RS-80")
PAPER_EVALUATIONS = PAPER["search", "particles"] * PAPER["search", "iterations"]


def few_evaluations(scene: str, overrides: dict, casters: Sequence[str]) -> list[Entry]:
    """A hundred evaluations over five frames in one process, with each caster."""
    return _entries(scene, {**overrides, **_given(FEW)}, casters)


def paper_evaluations(
    scene: str, overrides: dict, casters: Sequence[str], told: Callable[[], None] = lambda: None
) -> list[Entry]:
    """The paper's 2,000 evaluations over 60 frames, for its smallest sensor and its largest; each is `told`."""
    entries = []
    for sensor in PAPER_SENSORS:
        given = {**overrides, **_given(PAPER), ("sensor", "name"): (sensor, "--whole")}
        entries += _entries(scene, given, casters, told)
    return entries


def optimise(site: Site, told: Callable[[], None] = lambda: None) -> SearchResult:
    """Search a site's mountings; what follows in a run, hold-out and map, is left out."""
    deployment, search = site.scenario.deployment, fresh_search(site.scenario)
    with site.evaluator(site.search) as evaluator:

        def objective(x: np.ndarray) -> np.ndarray:
            found = evaluator.totals([deployment.pose(row) for row in x]).objective.sum(axis=1)
            for _ in x:
                told()
            return found

        return run_search(search, objective)


def _given(settings: dict) -> dict:
    return {key: (value, "benchmark") for key, value in settings.items()}


def _entries(
    scene: str, overrides: dict, casters: Sequence[str], told: Callable[[], None] = lambda: None
) -> list[Entry]:
    if not casters:
        return []
    scenario = load_scenario(scene, {**overrides, ("model", "caster"): (casters[0], "--caster")})
    if not scenario.deployment.bounds:
        raise InputError(f"{scene}: [deployment] fixes every coordinate; a search needs a pair [low, high]")
    site = prepare(scenario)
    evaluations = fresh_search(scenario).budget
    workers = f"{site.workers} process{'es' if site.workers > 1 else ''}"
    note = f"{evaluations:,} evaluations, {len(site.search)} frames, {workers}"
    name = f"optimisation, {scenario.sensor.name}"
    sites = {caster: _with(site, caster) for caster in casters}
    for each in sites.values():
        _make_ready(each)
    return [
        Entry(f"{name}, {caster}", partial(optimise, each, told), GROUP, note=note) for caster, each in sites.items()
    ]


def _make_ready(site: Site) -> None:
    """Score one mounting on one frame, so that no caster's time has its library or its compiled code loaded."""
    with Evaluator(site.search[:1], site.observation, site.scoring) as evaluator:
        evaluator.totals([site.scenario.deployment.pose(site.scenario.deployment.lower)])


def _with(site: Site, caster: str) -> Site:
    return replace(site, observation=replace(site.observation, caster=caster))
