"""A whole run: search the best mounting of a scene, or take one as given, judge it, and leave a folder of results."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from ..metrics.catalogue import metric_named
from ..optimise import DePso, DePsoSettings, Hardened, Search, make_search
from ..optimise.multi_fidelity import Asked, MultiFidelitySearch
from ..scene.provenance import versions
from ..scene.scenario import Scenario, pose_at
from ..scene.site import Site
from ..scoring.evaluation import Evaluator, site_evaluator
from ..scoring.fidelity import Fidelity, make_rungs
from .folder import HISTORY, HISTORY_NOMINAL, INSTALLATION, SCHEMA, VEHICLES, VEHICLES_BASELINE, RunFolder
from .installation import installation_text, scenery_counts
from .replay import Listener, Replay
from .tolerance import NOMINAL, ROBUST, best_over_tolerance, judge_over_tolerance, objective_over, tolerance_result
from .verdict import ScoreMap, judge, map_scores, map_verdict, vehicle_table

AUTO = "auto"  # the [search] fidelity of a search over several fidelities


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
    scenario, deployment = site.scenario, site.scenario.deployment
    tolerance, seed = scenario.objective.tolerance, scenario.search.seed
    replay = Replay(folder, site.identity, resume=resume)
    folder.write_scene(scenario)
    with site_evaluator(site, site.search, site.holdout) as evaluator:
        searches = _searched(site, evaluator, replay, listener)
        found = {name: deployment.coordinates(search.best_x) for name, search in searches.items()}
        nominal, score_map = found[NOMINAL], None
        if scenario.search.fidelity != AUTO:  # it takes many times what such a search does
            score_map = map_scores(evaluator, deployment, nominal, site.plan.search_block, listener.mapping)
        mountings = {"optimised": nominal, "baseline": scenario.baseline}
        if tolerance is not None:
            mountings["optimised"] = best_over_tolerance(evaluator, [found[ROBUST], nominal], tolerance)
            mountings[NOMINAL] = nominal
        on_map = {} if score_map is None else {"best_of_map": score_map.best_coordinates(nominal)}
        over_tolerance, verdict, tables = _judged(site, evaluator, mountings, on_map)
    evaluations = {name: len(search.history) for name, search in searches.items()}
    mapped = "optimised" if tolerance is None else NOMINAL
    searched = {
        "search": scenario.search.method,
        "seed": seed,
        "evaluations": sum(evaluations.values()),
        "fidelity": scenario.search.fidelity,
        "rungs": rung_costs(searches[NOMINAL]) if scenario.search.fidelity == AUTO else None,
        "map": None if score_map is None else map_verdict(score_map, verdict, mapped, seed),
    }
    told = tolerance_result(tolerance, over_tolerance, nominal, verdict, evaluations)
    result = _result(site, mountings["optimised"], verdict, searched, told, time.perf_counter() - started)
    histories = {HISTORY: searches[NOMINAL].history}
    if tolerance is not None:
        histories = {HISTORY: searches[ROBUST].history, HISTORY_NOMINAL: searches[NOMINAL].history}
    return _finish(site, folder, Outcome(result, *tables, score_map, histories[HISTORY]), histories)


def evaluate_site(site: Site, folder: RunFolder, coordinates: Mapping[str, float]) -> Outcome:
    """Score one mounting, its six `coordinates` in metres and degrees, and write the results."""
    started = time.perf_counter()
    scenario = site.scenario
    folder.write_scene(scenario)
    with site_evaluator(site, site.search, site.holdout) as evaluator:
        mountings = {"optimised": coordinates, "baseline": scenario.baseline}
        over_tolerance, verdict, tables = _judged(site, evaluator, mountings, {})
    searched = {"search": None, "seed": scenario.search.seed, "evaluations": 1, "fidelity": "full"}
    searched |= {"rungs": None, "map": None}
    tolerance = tolerance_result(scenario.objective.tolerance, over_tolerance)
    result = _result(site, coordinates, verdict, searched, tolerance, time.perf_counter() - started)
    return _finish(site, folder, Outcome(result, *tables, None, None), {})


def fresh_search(scenario: Scenario, evaluations: int | None = None) -> Search:
    """The search that a scene asks for, before its first evaluation; with another budget where one is given."""
    use, deployment = scenario.search, scenario.deployment
    settings: dict[str, object] = {}
    if use.method == DePso.name:
        own = {field.name for field in fields(DePsoSettings)} - {"iterations", "reading"}
        settings = {key: getattr(use, key) for key in own} | {"reading": scenario.objective.reading}
    elif use.method == Hardened.name:
        settings = {"particles": use.particles}
    box = np.array(deployment.lower), np.array(deployment.upper)
    budget = evaluations or use.particles * use.iterations
    return make_search(use.method, *box, seed=use.seed, evaluations=budget, **settings)


def fresh_auto_search(site: Site) -> MultiFidelitySearch:
    """The search of `[search] fidelity = "auto"`, before its first evaluation: the scene's own method screens."""
    use, deployment, block = site.scenario.search, site.scenario.deployment, site.plan.search_block
    variables = len(deployment.variables)
    screened = min(use.particles * use.iterations, max(screening(variables), use.particles, 2**variables))
    vehicles = [int(frame.counted.sum()) for frame in site.search]
    rungs = make_rungs(site.observation, block, vehicles, variables)
    screen = fresh_search(site.scenario, screened)
    return MultiFidelitySearch(screen, rungs, block, deployment.lower, deployment.upper, seed=use.seed)


def screening(variables: int) -> int:
    """Evaluations on the cheapest rung before halving begins."""
    return 20 + 40 * variables


def asked_objective(site: Site, evaluator: Evaluator, asked: Asked) -> np.ndarray:
    """Objective of each candidate on each frame that a search over several fidelities asks for, (s, frames)."""
    poses = [site.scenario.deployment.pose(row) for row in asked.x]
    fidelity = None if asked.fidelity == Fidelity(site.observation.detail) else asked.fidelity
    return evaluator.totals(poses, asked.frames, fidelity).objective


def rung_costs(search: MultiFidelitySearch) -> list[dict[str, object]]:
    """What each rung has taken, for result.json: detail, stride, frames, candidates, casts of a frame, seconds."""
    fidelities = (rung.fidelity for rung in search.rungs)
    return [
        {"detail": fidelity.detail, "stride": fidelity.stride, **spent}
        for fidelity, spent in zip(fidelities, search.spent, strict=True)
    ]


def _searched(
    site: Site, evaluator: Evaluator, replay: Replay, listener: Listener
) -> dict[str, Search | MultiFidelitySearch]:
    """The searches of a run, brought to their ends: of mountings as planned, and over the scene's tolerance."""
    scenario, deployment, tolerance = site.scenario, site.scenario.deployment, site.scenario.objective.tolerance

    def as_planned(x: np.ndarray) -> np.ndarray:
        return evaluator.totals([deployment.pose(row) for row in x]).objective.sum(axis=1)

    def over_tolerance(x: np.ndarray) -> np.ndarray:
        return objective_over(evaluator, [deployment.coordinates(row) for row in x], tolerance)

    if scenario.search.fidelity == AUTO:
        search = fresh_auto_search(site)
        replay.carry_out(search, lambda asked: asked_objective(site, evaluator, asked), listener)
        return {NOMINAL: search}
    searches = {}
    for name, score in {NOMINAL: as_planned, ROBUST: over_tolerance}.items():
        if name == NOMINAL or tolerance is not None:
            searches[name] = fresh_search(scenario)
            replay.carry_out(searches[name], score, listener)
    return searches


def _judged(site: Site, evaluator: Evaluator, mountings: Mapping[str, Mapping[str, float]], on_map: Mapping):
    """Scores over the tolerance, the verdict (of the map's best mounting too) and both mountings' vehicle tables."""
    seed = site.scenario.search.seed
    poses = {name: pose_at(coordinates) for name, coordinates in {**mountings, **on_map}.items()}
    splits = {"search": evaluator, "holdout": evaluator.held_out}
    tables = [vehicle_table(poses[name], **splits) for name in ("optimised", "baseline")]
    return judge_over_tolerance(site, mountings, evaluator, seed), judge(site, poses, evaluator, seed), tables


def _result(site: Site, best, verdict, searched, tolerance, seconds) -> dict:
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
        "identity": site.identity,
        "seconds": round(seconds, 3),
        "versions": versions(site.observation.caster),
    }


def _finish(site: Site, folder: RunFolder, outcome: Outcome, histories: Mapping[str, np.ndarray]) -> Outcome:
    """Write all that a run leaves."""
    for name, history in histories.items():
        folder.write_history(name, history, site.scenario.deployment.variables)
    if outcome.score_map is not None:
        folder.write_score_map(outcome.score_map)
    folder.write_vehicles(VEHICLES, outcome.optimised)
    folder.write_vehicles(VEHICLES_BASELINE, outcome.baseline)
    folder.write_text(INSTALLATION, installation_text(site, outcome.result))
    folder.finish(outcome.result)
    return outcome
