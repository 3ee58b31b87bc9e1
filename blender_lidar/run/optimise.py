"""A whole run: search the best mounting of a scene, or take one as given, judge it, and leave a folder of results."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..metrics.catalogue import metric_named
from ..optimise import DePso, DePsoSettings, Hardened, Search, make_search
from ..optimise.multi_fidelity import Asked, MultiFidelitySearch
from ..plugins import short_name
from ..scene.provenance import versions
from ..scene.scenario import Scenario, pose_at
from ..scene.settings import with_lean
from ..scene.site import Site
from ..scoring.evaluation import Evaluator, site_evaluator
from ..scoring.fidelity import Fidelity, make_rungs
from .folder import CHECKPOINT, HISTORY, HISTORY_NOMINAL, RUN_SCHEMA, VEHICLES, VEHICLES_BASELINE, RunFolder
from .replay import Listener, Replay
from .tolerance import JUDGED_BASE, SEARCHED_BASE, best_over_tolerance, objective_over
from .verdict import (
    BASELINE_NAME,
    NOMINAL,
    ROBUST,
    ScoreMap,
    judge,
    judge_over_tolerance,
    map_scores,
    map_verdict,
    vehicle_table,
)

AUTO = "auto"  # the [search] fidelity of a search over several fidelities


def optimise_site(site: Site, folder: RunFolder, listener: Listener, *, resume: bool = False) -> dict:
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

    Returns
    -------
    dict
        The content of result.json.

    Raises
    ------
    InputError
        When the folder holds a run with other settings.
    """
    started = time.perf_counter()
    scenario, deployment = site.scenario, site.scenario.deployment
    tolerance, score_map = scenario.objective.tolerance, None
    replay = Replay(folder, site.identity, resume=resume)
    folder.write_scene(scenario)
    with site_evaluator(site, site.search, site.holdout) as evaluator:
        searches = _searched(site, evaluator, replay, listener)
        found = {name: deployment.coordinates(search.best_x) for name, search in searches.items()}
        if scenario.search.fidelity != AUTO:  # it takes many times what such a search does
            score_map = map_scores(evaluator, deployment, found[NOMINAL], site.plan.search_block, listener.mapping)
        mountings = {"optimised": found[NOMINAL], BASELINE_NAME: scenario.baseline}
        if tolerance is not None:
            mountings["optimised"] = best_over_tolerance(evaluator, [found[ROBUST], found[NOMINAL]], tolerance)
            mountings[NOMINAL] = found[NOMINAL]
        return _conclude(site, folder, evaluator, started, mountings, searches, score_map)


def ended_search(site: Site, folder: RunFolder, note: Callable[[str], object]) -> dict | None:
    """The result of the search that has ended in a folder that a run goes on in; None where there is more to search.

    `note` is told where nothing is stored there to go on with.

    Raises
    ------
    InputError
        When the folder holds a run with other settings, or the evaluation of one mounting.
    """
    result = folder.read_result(site.identity)
    if result is not None and result.get("search") is None:
        raise InputError(f"--resume: {folder.path}: holds one mounting's evaluation, not a search; give another --out")
    if result is None and not folder.file(CHECKPOINT).exists():
        note(f"{folder.path}: nothing is stored there to go on with; the search starts from its beginning")
    return result


def evaluate_site(site: Site, folder: RunFolder, coordinates: Mapping[str, float]) -> dict:
    """Score one mounting, its six `coordinates` in metres and degrees; write and return the result."""
    started = time.perf_counter()
    folder.write_scene(site.scenario)
    with site_evaluator(site, site.search, site.holdout) as evaluator:
        mountings = {"optimised": coordinates, BASELINE_NAME: site.scenario.baseline}
        return _conclude(site, folder, evaluator, started, mountings, {}, None)


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
    return make_search(use.method, *box, seed=use.seed, evaluations=budget, periodic=deployment.periodic, **settings)


def fresh_auto_search(site: Site) -> MultiFidelitySearch:
    """The search of `[search] fidelity = "auto"`, before its first evaluation: the scene's own method screens."""
    use, deployment, block = site.scenario.search, site.scenario.deployment, site.plan.search_block
    variables = len(deployment.variables)
    screened = min(use.particles * use.iterations, max(screening(variables), use.particles, 2**variables))
    weight = [float(frame.counted_weight.sum()) for frame in site.search]
    rungs = make_rungs(site.observation, block, weight, variables)
    screen = fresh_search(site.scenario, screened)
    return MultiFidelitySearch(screen, rungs, block, seed=use.seed)


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


def scenery_counts(site: Site) -> dict[str, int] | None:
    """Objects and triangles of the scenery within reach; None where the scene has none."""
    standing = site.observation.scenery
    if standing is None:
        return None
    return {"objects": len(np.unique(standing.scenery.owner)), "triangles": len(standing.scenery)}


def _searched(
    site: Site, evaluator: Evaluator, replay: Replay, listener: Listener
) -> dict[str, Search | MultiFidelitySearch]:
    """The searches of a run, brought to their ends: of mountings as planned, and over the scene's tolerance."""
    scenario, deployment, tolerance = site.scenario, site.scenario.deployment, site.scenario.objective.tolerance

    def as_planned(asked: np.ndarray | Asked) -> np.ndarray:
        if isinstance(asked, Asked):
            return asked_objective(site, evaluator, asked)
        return evaluator.totals([deployment.pose(row) for row in asked]).objective.sum(axis=1)

    def over_tolerance(x: np.ndarray) -> np.ndarray:
        return objective_over(evaluator, [deployment.coordinates(row) for row in x], tolerance)

    searches = {}
    for name, score in {NOMINAL: as_planned, ROBUST: over_tolerance}.items():
        if name == NOMINAL or tolerance is not None:
            searches[name] = fresh_auto_search(site) if scenario.search.fidelity == AUTO else fresh_search(scenario)
            replay.carry_out(searches[name], score, listener)
    return searches


def _conclude(
    site: Site,
    folder: RunFolder,
    evaluator: Evaluator,
    started: float,
    mountings: Mapping[str, Mapping[str, float]],
    searches: Mapping[str, Search | MultiFidelitySearch],
    score_map: ScoreMap | None,
) -> dict:
    """Judge the mountings and write all that a run leaves, last of all its result, which is returned."""
    scenario, metric, seed = site.scenario, metric_named(site.scoring.metric), site.scenario.search.seed
    for name, search in zip((HISTORY, HISTORY_NOMINAL), reversed(searches.values()), strict=False):
        folder.write_history(name, search.history, scenario.deployment.variables)
    poses = {name: pose_at(coordinates) for name, coordinates in mountings.items()}
    planned = NOMINAL if NOMINAL in mountings else "optimised"
    if score_map is not None:
        folder.write_score_map(score_map)
        poses["best_of_map"] = pose_at(score_map.best_coordinates(mountings[planned]))
    for file, name in {VEHICLES: "optimised", VEHICLES_BASELINE: BASELINE_NAME}.items():
        folder.write_vehicles(file, vehicle_table(poses[name], search=evaluator, holdout=evaluator.held_out))
    verdict = judge(site, poses, evaluator, seed)
    evaluations = {name: len(search.history) for name, search in searches.items()}
    tolerance = scenario.objective.tolerance
    over_tolerance = (
        None
        if tolerance is None
        else {
            "settings": asdict(tolerance),
            "searched_errors": SEARCHED_BASE[tolerance.aim] ** 2 if searches else None,
            "judged_errors": JUDGED_BASE**2,
            "evaluations": evaluations or None,
            "robust": judge_over_tolerance(site, mountings, evaluator, seed),
            "sharp": {"deployment": with_lean(mountings[NOMINAL]), **verdict[NOMINAL]} if searches else None,
        }
    )
    rungs = [rung_costs(search) for search in searches.values() if isinstance(search, MultiFidelitySearch)]
    result = {
        "schema": RUN_SCHEMA,
        "scene": Path(scenario.source).name,
        "sensor": site.model.name,
        "range_gate_m": scenario.sensor.range_gate_m,
        "region": scenario.as_tables()["region"],
        "imperfections": scenario.sensor.imperfections_as_table(),
        "scenery": scenery_counts(site),
        "caster": site.observation.caster,
        "detail": site.observation.detail,
        "metric": site.scoring.metric,
        "metric_unit": metric.unit,
        "metric_higher_is_better": metric.higher_is_better,
        "reading": scenario.objective.reading,
        "search": short_name(scenario.search.method) if searches else None,
        "seed": seed,
        "evaluations": sum(evaluations.values()) or 1,
        "fidelity": scenario.search.fidelity if searches else "full",
        "rungs": rungs[0] if rungs else None,
        "map": None if score_map is None else map_verdict(score_map, verdict, planned, seed),
        "frames": len(site.search),
        "frame_ids": [int(frame) for frame in site.plan.search],
        "holdout_frame_ids": [int(frame) for frame in site.plan.holdout],
        "block_s": site.plan.block_s,
        "vehicles": int(evaluator.vehicles.sum()),
        "deployment": with_lean(mountings["optimised"]),
        **verdict["optimised"],
        "baseline": {"deployment": with_lean(scenario.baseline), **verdict[BASELINE_NAME]},
        "tolerance": over_tolerance,
        "warnings": site.recording.report.warnings_as_dicts(),
        "notes": list(site.plan.notes),
        "traffic_report": site.recording.report.as_dict(),
        "identity": site.identity,
        "seconds": round(time.perf_counter() - started, 3),
        "versions": versions(site.observation.caster),
    }
    folder.finish(result)
    return result
