"""A whole run: search the best mounting of a scene, or take one as given, judge it, and leave a folder of results."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np

from .metrics.catalogue import metric_named
from .optimise import DePsoSettings, Search, make_search, search_from_state
from .results import (
    HISTORY,
    HISTORY_SHARP,
    INSTALLATION,
    ROBUST,
    SCHEMA,
    SHARP,
    VEHICLES,
    VEHICLES_BASELINE,
    RunFolder,
    versions,
)
from .scenario import Scenario, pose_at
from .study.auto_scores import asked_objective, auto_search, screened
from .study.auto_search import NAME as AUTO
from .study.auto_search import AutoSearch
from .study.circumstances import scenery_counts
from .study.evaluation import Evaluator
from .study.installation import installation_text
from .study.score_map import ScoreMap, map_scores
from .study.site import Site
from .study.tolerance import best_over_tolerance, objective_over
from .study.tolerance_verdict import judge_over_tolerance, tolerance_result
from .study.vehicle_table import join_tables, vehicle_table
from .study.verdict import judge, map_verdict

_CHECKPOINT_EVERY_S = 2.0


class Listener(Protocol):
    """Told how a run comes along; every method may do nothing."""

    def searching(self, search: Search | AutoSearch) -> None:
        """After each batch of evaluations, and once before the first; where there is a tolerance, of both searches."""

    def mapping(self, points: int) -> None:
        """After `points` more of the score map's grid points."""


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What a run came to.

    Attributes
    ----------
    result : dict
        The content of result.json.
    optimised, baseline : dict of str to ndarray
        Vehicle tables of both mountings, searched and held-out frames.
    score_map : ScoreMap or None
        The landscape over height and tilt, where both were searched.
    history : ndarray or None
        Every evaluation of the search that found the mounting, where there was one; those at the reference where it
        went from cheap to dear.
    """

    result: dict
    optimised: dict[str, np.ndarray]
    baseline: dict[str, np.ndarray]
    score_map: ScoreMap | None
    history: np.ndarray | None


def optimise_site(site: Site, folder: RunFolder, listener: Listener, *, resume: bool = False) -> Outcome:
    """Search the best mounting, storing the search as it goes, and write the results.

    Parameters
    ----------
    site : Site
        The scene made ready.
    folder : RunFolder
        Where the results go; locked by the caller.
    listener : Listener
        Is told of progress.
    resume : bool
        Go on from what the folder holds. The result is the same as that of a run that was never stopped.

    Raises
    ------
    InputError
        When the folder holds a run with other settings.
    """
    started = time.perf_counter()
    scenario = site.scenario
    identity = site.identity
    searches = _searches(site, folder.read_checkpoint(identity) if resume else {})
    folder.write_scene(scenario)
    with site.evaluator(site.search) as evaluator:
        for name, search in searches.items():
            step = partial(_STEPS[AUTO if isinstance(search, AutoSearch) else name], search, evaluator, site)
            _search(search, step, listener, lambda: folder.write_checkpoint(identity, _states(searches)))
        found = [scenario.deployment.coordinates(search.best_x) for search in searches.values()]
        sharp, best = found[0], best_over_tolerance(evaluator, found[::-1], scenario.objective.tolerance)
        score_map = None
        if scenario.search.fidelity != AUTO:  # it takes many times what such a search does
            score_map = map_scores(evaluator, scenario.deployment, sharp, site.plan.search_block, listener.mapping)
        mountings = {"optimised": best, "baseline": scenario.baseline}
        if ROBUST in searches:
            mountings["sharp"] = sharp
        over_tolerance = judge_over_tolerance(site, mountings, evaluator, scenario.search.seed)
        if score_map is not None:
            mountings["best_of_map"] = score_map.best_coordinates(sharp)
        verdict = _judge(site, mountings, evaluator)
    evaluations = {name: len(search.history) for name, search in searches.items()}
    rungs = [search.spent for search in searches.values() if isinstance(search, AutoSearch)]
    mapped = "sharp" if ROBUST in searches else "optimised"
    searched = {
        "search": scenario.search.method,
        "seed": scenario.search.seed,
        "evaluations": sum(evaluations.values()),
        "fidelity": scenario.search.fidelity,
        "rungs": rungs[0] if rungs else None,
        "map": None if score_map is None else map_verdict(score_map, verdict, mapped, scenario.search.seed),
    }
    tolerance = tolerance_result(scenario.objective.tolerance, over_tolerance, sharp, verdict, evaluations)
    result = _result(site, identity, best, verdict, searched, tolerance, time.perf_counter() - started)
    return _finish(site, folder, result, score_map, [search.history for search in searches.values()])


def evaluate_site(site: Site, folder: RunFolder, coordinates: Mapping[str, float]) -> Outcome:
    """Score one mounting, its six `coordinates` in metres and degrees, and write the results."""
    started = time.perf_counter()
    scenario = site.scenario
    folder.write_scene(scenario)
    with site.evaluator(site.search) as evaluator:
        mountings = {"optimised": coordinates, "baseline": scenario.baseline}
        over_tolerance = judge_over_tolerance(site, mountings, evaluator, scenario.search.seed)
        verdict = _judge(site, mountings, evaluator)
    searched = {"search": None, "seed": scenario.search.seed, "evaluations": 1, "fidelity": "full", "rungs": None}
    searched["map"] = None
    identity = site.identity
    tolerance = tolerance_result(scenario.objective.tolerance, over_tolerance)
    result = _result(site, identity, coordinates, verdict, searched, tolerance, time.perf_counter() - started)
    return _finish(site, folder, result, None, [])


def fresh_search(scenario: Scenario, evaluations: int | None = None) -> Search:
    """The search that a scene asks for, before its first evaluation; with another budget where one is given."""
    settings = scenario.search
    names = {field.name for field in fields(DePsoSettings)} - {"reading"}
    given = {name: value for name, value in asdict(settings).items() if name in names and value is not None}
    return make_search(
        settings.method,
        np.array(scenario.deployment.lower),
        np.array(scenario.deployment.upper),
        seed=settings.seed,
        evaluations=evaluations,
        settings=DePsoSettings(**given, reading=scenario.objective.reading),
    )


def fresh_auto_search(site: Site) -> AutoSearch:
    """The search of `[search] fidelity = "auto"`, before its first evaluation: the scene's own method screens."""
    settings, variables = site.scenario.search, len(site.scenario.deployment.variables)
    budget = settings.particles * settings.iterations
    screening = min(budget, max(screened(variables), settings.particles, 2**variables))
    return auto_search(site, fresh_search(site.scenario, screening))


def _searches(site: Site, states: Mapping[str, dict]) -> dict[str, Search | AutoSearch]:
    """The searches of a run in their order, each from its stored state where there is one."""
    scenario = site.scenario
    if scenario.search.fidelity == AUTO:
        search = fresh_auto_search(site)
        if SHARP in states:
            search.restore(states[SHARP])
        return {SHARP: search}
    names = (SHARP,) if scenario.objective.tolerance is None else (SHARP, ROBUST)
    return {name: search_from_state(states[name]) if name in states else fresh_search(scenario) for name in names}


def _states(searches: Mapping[str, Search]) -> dict[str, dict]:
    """How far each search that has begun has come."""
    return {name: search.state() for name, search in searches.items() if search.evaluations}


def _step(search: Search, evaluator: Evaluator, site: Site) -> None:
    """One batch of mountings that hang as planned."""
    totals = evaluator.totals([site.scenario.deployment.pose(row) for row in search.ask()])
    search.tell(totals.objective.sum(axis=1))


def _step_over_tolerance(search: Search, evaluator: Evaluator, site: Site) -> None:
    """The same over the scene's tolerance."""
    plans = [site.scenario.deployment.coordinates(row) for row in search.ask()]
    search.tell(objective_over(evaluator, plans, site.scenario.objective.tolerance))


def _step_on_rungs(search: AutoSearch, evaluator: Evaluator, site: Site) -> None:
    """The same on as many frames and beams as the search asks for."""
    started = time.perf_counter()
    objective = asked_objective(site, evaluator, search.ask())
    search.tell(objective, time.perf_counter() - started)


_STEPS = {SHARP: _step, ROBUST: _step_over_tolerance, AUTO: _step_on_rungs}


def _search(search: Search | AutoSearch, step: Callable, listener: Listener, store: Callable[[], None]) -> None:
    listener.searching(search)
    stored_at = -np.inf
    while not search.done:
        step()
        if time.monotonic() - stored_at >= _CHECKPOINT_EVERY_S or search.done:
            store()
            stored_at = time.monotonic()
        listener.searching(search)


def _judge(site: Site, mountings: Mapping[str, Mapping[str, float]], evaluator: Evaluator) -> dict:
    poses = {name: pose_at(coordinates) for name, coordinates in mountings.items()}
    return judge(site, poses, evaluator, site.scenario.search.seed)


def _result(site: Site, identity, best, verdict, searched, tolerance, seconds) -> dict:
    scenario, metric = site.scenario, metric_named(site.scoring.metric)
    return {
        "schema": SCHEMA,
        "scene": Path(scenario.source).name,
        "sensor": site.model.name,
        "range_gate_m": scenario.sensor.range_gate_m,
        "imperfections": scenario.sensor.imperfections_as_table(),
        "scenery": scenery_counts(site.observation.scenery),
        "caster": site.observation.caster,
        "detail": site.observation.detail,
        "metric": metric.name,
        "metric_unit": metric.unit,
        "metric_higher_is_better": metric.higher_is_better,
        "reading": scenario.objective.reading,
        **searched,
        "frames": len(site.search),
        "frame_ids": [int(frame) for frame in site.plan.search],
        "holdout_frame_ids": [int(frame) for frame in site.plan.holdout],
        "block_s": site.plan.block_s,
        "vehicles": sum(int(frame.counted.sum()) for frame in site.search),
        "deployment": dict(best),
        **verdict["optimised"],
        "baseline": {"deployment": dict(scenario.baseline), **verdict["baseline"]},
        "tolerance": tolerance,
        "notes": list(site.plan.notes),
        "traffic_report": site.recording.report.as_dict(),
        "identity": identity,
        "seconds": round(seconds, 3),
        "versions": versions(site.observation.caster),
    }


def _finish(site: Site, folder: RunFolder, result, score_map, histories) -> Outcome:
    """Write all that a run leaves; of the histories the last is that of the search that found the mounting."""
    tables = [_both_splits(site, pose_at(mount)) for mount in (result["deployment"], site.scenario.baseline)]
    for name, history in zip((HISTORY, HISTORY_SHARP), histories[::-1], strict=False):
        folder.write_history(name, history, site.scenario.deployment.variables)
    if score_map is not None:
        folder.write_score_map(score_map)
    folder.write_vehicles(VEHICLES, tables[0])
    folder.write_vehicles(VEHICLES_BASELINE, tables[1])
    folder.write_text(INSTALLATION, installation_text(site, result))
    folder.finish(result)
    return Outcome(result, tables[0], tables[1], score_map, histories[-1] if histories else None)


def _both_splits(site: Site, pose):
    settings = (pose, site.observation, site.scoring)
    return join_tables(
        vehicle_table(site.search, *settings, "search"), vehicle_table(site.holdout, *settings, "holdout")
    )
