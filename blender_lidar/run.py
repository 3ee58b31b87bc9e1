"""A whole run: search the best mounting of a scene, or take one as given, judge it, and leave a folder of results."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from .metrics.catalogue import metric_named
from .optimise import DePsoSettings, Search, make_search, search_from_state
from .plots.binning import near_best_threshold
from .results import INSTALLATION, SCHEMA, VEHICLES, VEHICLES_BASELINE, RunFolder, versions
from .scenario import Scenario, pose_at
from .study.circumstances import scenery_counts
from .study.evaluation import Evaluator
from .study.installation import installation_text
from .study.score_map import ScoreMap, map_scores
from .study.site import Site
from .study.vehicle_table import join_tables, vehicle_table
from .study.verdict import judge

REGION_SHARE = 0.01  # mountings that lose at most this share of the gain are as good
_CHECKPOINT_EVERY_S = 2.0


class Listener(Protocol):
    """Told how a run comes along; every method may do nothing."""

    def searching(self, search: Search) -> None:
        """After each batch of evaluations, and once before the first."""

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
        Every evaluation, where there was a search.
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
    stored = folder.read_checkpoint(identity) if resume else None
    search = fresh_search(scenario) if stored is None else search_from_state(stored)
    folder.write_scene(scenario)
    with site.evaluator(site.search) as evaluator:
        _search(search, evaluator, scenario, folder, identity, listener)
        best = scenario.deployment.coordinates(search.best_x)
        score_map = map_scores(evaluator, scenario.deployment, best, site.plan.search_block, listener.mapping)
        mountings = {"optimised": pose_at(best), "baseline": scenario.baseline_pose}
        if score_map is not None:
            mountings["best_of_map"] = pose_at(score_map.best_coordinates(best))
        verdict = judge(site, mountings, evaluator, scenario.search.seed)
    searched = {
        "search": scenario.search.method,
        "seed": scenario.search.seed,
        "evaluations": search.evaluations,
        "map": None if score_map is None else _map_summary(score_map, scenario, verdict),
    }
    result = _result(site, identity, best, verdict, searched, time.perf_counter() - started)
    return _finish(site, folder, result, best, score_map, search.history)


def evaluate_site(site: Site, folder: RunFolder, coordinates: Mapping[str, float]) -> Outcome:
    """Score one mounting, its six `coordinates` in metres and degrees, and write the results."""
    started = time.perf_counter()
    scenario = site.scenario
    folder.write_scene(scenario)
    with site.evaluator(site.search) as evaluator:
        mountings = {"optimised": pose_at(coordinates), "baseline": scenario.baseline_pose}
        verdict = judge(site, mountings, evaluator, scenario.search.seed)
    searched = {"search": None, "seed": scenario.search.seed, "evaluations": 1, "map": None}
    identity = site.identity
    result = _result(site, identity, coordinates, verdict, searched, time.perf_counter() - started)
    return _finish(site, folder, result, coordinates, None, None)


def fresh_search(scenario: Scenario) -> Search:
    """The search that a scene asks for, before its first evaluation."""
    settings = scenario.search
    return make_search(
        settings.method,
        np.array(scenario.deployment.lower),
        np.array(scenario.deployment.upper),
        seed=settings.seed,
        settings=DePsoSettings(
            particles=settings.particles,
            iterations=settings.iterations,
            inertia=settings.inertia,
            differential_weight=settings.differential_weight,
            cognitive=settings.cognitive,
            social=settings.social,
            differential_threshold=settings.differential_threshold,
            reading=scenario.objective.reading,
        ),
    )


def _search(search, evaluator: Evaluator, scenario, folder, identity, listener):
    deployment = scenario.deployment
    listener.searching(search)
    stored_at = -np.inf
    while not search.done:
        poses = [deployment.pose(x) for x in search.ask()]
        search.tell(evaluator.totals(poses).objective.sum(axis=1))
        if time.monotonic() - stored_at >= _CHECKPOINT_EVERY_S or search.done:
            folder.write_checkpoint(identity, search.state())
            stored_at = time.monotonic()
        listener.searching(search)


def _map_summary(score_map: ScoreMap, scenario, verdict) -> dict:
    """The landscape in numbers; shares of the gain are None where nothing is better than the baseline."""
    height, tilt, value = score_map.best
    base = verdict["baseline"]["objective_per_vehicle"]
    found = verdict["optimised"]["objective_per_vehicle"]
    best = max(value, found)
    gains = best > base
    near_best = near_best_threshold(best, base, REGION_SHARE)
    intervals = score_map.optimum_intervals_90(scenario.search.seed)
    return {
        "points": list(score_map.per_vehicle.shape),
        "best": {"height_m": height, "tilt_x_deg": tilt, "objective_per_vehicle": value},
        "search_shortfall": (best - found) / (best - base) if gains else None,
        "holdout_regret": _regret(*(verdict[name]["holdout"] for name in ("best_of_map", "optimised"))),
        "optimum_interval_90": None if intervals is None else {key: list(pair) for key, pair in intervals.items()},
        "share_within_1_percent": float((score_map.per_vehicle >= near_best).mean()) if gains else None,
    }


def _regret(best, found):
    """Share of the gain of the map's best mounting that the found one lacks, on held-out frames; below 0 if better."""
    if best is None or not best["gain_over_baseline"] > 0.0:
        return None
    return 1.0 - found["gain_over_baseline"] / best["gain_over_baseline"]


def _result(site: Site, identity, best, verdict, searched, seconds) -> dict:
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
        "notes": list(site.plan.notes),
        "traffic_report": site.recording.report.as_dict(),
        "identity": identity,
        "seconds": round(seconds, 3),
        "versions": versions(site.observation.caster),
    }


def _finish(site: Site, folder: RunFolder, result, best, score_map, history) -> Outcome:
    tables = [_both_splits(site, pose_at(best)), _both_splits(site, site.scenario.baseline_pose)]
    if history is not None:
        folder.write_history(history, site.scenario.deployment.variables)
    if score_map is not None:
        folder.write_score_map(score_map)
    folder.write_vehicles(VEHICLES, tables[0])
    folder.write_vehicles(VEHICLES_BASELINE, tables[1])
    folder.write_text(INSTALLATION, installation_text(site, result))
    folder.finish(result)
    return Outcome(result, tables[0], tables[1], score_map, history)


def _both_splits(site: Site, pose):
    settings = (pose, site.observation, site.scoring)
    return join_tables(
        vehicle_table(site.search, *settings, "search"), vehicle_table(site.holdout, *settings, "holdout")
    )
