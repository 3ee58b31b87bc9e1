"""A whole run: search the best mounting of a scene, or take one as given, judge it, and leave a folder of results."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..document import as_json
from ..errors import InputError
from ..metrics.catalogue import metric_named
from ..optimise.multi_fidelity import MultiFidelitySearch
from ..plugins import short_name
from ..scene.deployment import Pole
from ..scene.directions import pointing
from ..scene.mounting import Layout
from ..scene.provenance import versions
from ..scene.scenario import Scenario
from ..scene.site import Site
from ..scoring.evaluation import Evaluator, site_evaluator
from ..scoring.fidelity import Fidelity
from ..traffic.frames import NOTHING_HELD_OUT
from .answer import run_document
from .approach_files import write_approaches
from .as_hung import HungObjective, searching
from .assumptions import assumptions, site_name
from .folder import CHECKPOINT, HISTORY, HISTORY_CANDIDATES, RUN_SCHEMA, RunFolder
from .layouts import judge_layout
from .replay import Listener, Replay
from .searches import SearchOutcome, search_layout, search_place
from .vehicle_table import vehicle_tables
from .verdict import (
    BASELINE_NAME,
    figures_as_hung,
    judge,
    judge_cross_fitted,
    map_verdict,
    rank_places,
)
from .what_if import next_metre, other_traffic


def optimise_site(site: Site, folder: RunFolder, listener: Listener, *, resume: bool = False) -> dict:
    """Search the best mounting, storing the search as it goes, and write the results.

    Parameters
    ----------
    site : Site
        The scene made ready.
    folder : RunFolder
        Where the results go; locked by the caller.
    listener : Listener
        Called as the run goes on.
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
    pole = None
    replay = Replay(folder, site.identity, resume=resume)
    folder.write_scene(site.scenario)
    with site_evaluator(site, site.search, site.holdout) as evaluator:
        if site.scenario.is_layout:
            return _conclude(site, folder, evaluator, started, search_layout(site, evaluator, replay, listener))
        spaces = site.scenario.lidar.deployment.spaces
        every = [search_place(site, space, evaluator, replay, listener) for space in spaces]
        rows, best = None, 0
        if site.scenario.lidar.deployment.poles:
            rows, best = rank_places(site, evaluator, spaces, [found.layouts["optimised"] for found in every])
            pole = spaces[best].places[0].pole
        others = sum(found.evaluations for found in every if found is not every[best])
        return _conclude(site, folder, evaluator, started, every[best], rows, pole, others)


def ended_search(site: Site, folder: RunFolder, note: Callable[[str], object]) -> dict | None:
    """The result of the search that has ended in a folder that a run goes on in; None where there is more to search.

    `note` is called where nothing is stored there to go on with.

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


def evaluate_site(site: Site, folder: RunFolder, layout: Layout, pole: Pole | None = None) -> dict:
    """Score one layout; write and return the result.

    `pole` is the candidate pole that a single LiDAR hangs on, if it was named.
    """
    started = time.perf_counter()
    folder.write_scene(site.scenario)
    with site_evaluator(site, site.search, site.holdout) as evaluator:
        layouts, none = {"optimised": layout, BASELINE_NAME: site.scenario.baselines}, (None,) * len(layout)
        return _conclude(site, folder, evaluator, started, SearchOutcome(layouts, spaces=none, maps=none), pole=pole)


def stage_costs(site: Site, search: MultiFidelitySearch) -> list[dict[str, object]]:
    """What each stage has taken, for result.json: detail, stride, frames, candidates, casts of a frame, seconds."""
    stages = (search.fidelity, len(search.frames)), (Fidelity(site.observation.detail), len(site.search))
    return [
        {
            "detail": fidelity.detail,
            "stride": fidelity.stride,
            "frames": frames,
            "candidates": spent["candidates"],
            "frame_casts": spent["candidates"] * frames,
            "seconds": round(spent["seconds"], 3),
        }
        for (fidelity, frames), spent in zip(stages, search.spent, strict=True)
    ]


_BELOW_M = 0.05  # of the road: what stands there may reach so far into it


def scenery_counts(site: Site) -> dict[str, object] | None:
    """How much scenery stands within reach, and how high; None where there is none but the road's own surface.

    ``objects``, ``triangles``, ``z_m`` from where to where [m], and the share of corners ``below_road``.
    """
    standing = site.observation.scenery
    if standing is None:
        return None
    beside = standing.scenery.beside_road
    if not len(beside) and not site.scenario.road_map.surface.is_flat:
        return None
    z = beside.corners[..., 2]
    heights = {"z_m": [float(z.min()), float(z.max())], "below_road": float((z < -_BELOW_M).mean())} if len(z) else {}
    return {"objects": len(np.unique(beside.owner)), "triangles": len(beside), **heights}


def _conclude(
    site: Site,
    folder: RunFolder,
    evaluator: Evaluator,
    started: float,
    found: SearchOutcome,
    poles: Sequence[Mapping] | None = None,
    pole: Pole | None = None,
    others: int = 0,
) -> dict:
    """Judge the layouts and write all that a run leaves, last of all its result, which is returned.

    `poles` are all candidate places, ranked, of which `found` is the first, on its `pole`; `others` is how many
    evaluations were made on the others.
    """
    layouts, searches, without_block = found.layouts, found.searches, found.without_block
    scenario, metric, seed = site.scenario, metric_named(site.scoring.metric), site.scenario.search.seed
    for name, (history, variables) in zip((HISTORY, HISTORY_CANDIDATES), found.histories, strict=False):
        folder.write_history(name, history, variables)
    names = scenario.names
    of_maps = {best_of_map(name): one[1] for name, one in zip(names, found.maps, strict=True) if one is not None}
    for name, on_map in zip(names, found.maps, strict=True):
        if on_map is not None:
            folder.write_score_map(on_map[0], name)
    if poles is not None:
        folder.write_ranking(poles)
    splits = {"search": evaluator, "holdout": evaluator.held_out}
    tables = dict(zip(layouts, vehicle_tables(list(layouts.values()), **splits), strict=True))
    folder.write_vehicles(tables["optimised"], tables[BASELINE_NAME])
    (verdict, compared), crossed = judge(site, layouts, tables, evaluator, None if searches else seed), None
    boxes = compared["optimised"]
    hung, gains = figures_as_hung(site, evaluator, layouts, of_maps, boxes)
    for name, scores in verdict.items():
        (scores["holdout"] or scores)["as_hung"] = hung[name]
    if without_block is not None:
        crossed, boxes = judge_cross_fitted(site, evaluator, layouts, without_block, tables)
    groups, of_hung = boxes.groups(site), HungObjective(site, evaluator)
    objective = dict(zip((*layouts, *of_maps), of_hung([*layouts.values(), *of_maps.values()]).tolist(), strict=True))
    as_searched = searching(site, evaluator).totals(list(layouts.values())).per_vehicle()
    as_searched = dict(zip(layouts, as_searched.tolist(), strict=True))
    if scenario.baseline_hangs:
        objective[BASELINE_NAME] = verdict[BASELINE_NAME]["objective"]
        as_searched[BASELINE_NAME] = verdict[BASELINE_NAME]["objective_per_vehicle"]
    for name, scores in verdict.items():
        scores["objective_as_hung"] = objective[name]
        scores["objective_per_vehicle_as_searched"] = as_searched[name]
    held_out = verdict["optimised"]["holdout"] is not None
    lidars = _lidar_rows(site, evaluator, found, objective, as_searched, gains if held_out else None)
    rungs = [stage_costs(site, search) for search in searches if isinstance(search, MultiFidelitySearch)]
    result = {
        "schema": RUN_SCHEMA,
        "scene": Path(scenario.source).name,
        "site": site_name(scenario),
        "sensor": sensors_text(site),
        "range_gate_m": scenario.range_gate_m,
        "region": scenario.as_tables()["region"],
        "imperfections": scenario.lidars[0].sensor.imperfections_as_table(),
        "scenery": scenery_counts(site),
        "caster": site.observation.caster,
        "detail": site.observation.detail,
        "metric": site.scoring.metric,
        "metric_unit": metric.unit,
        "metric_higher_is_better": metric.higher_is_better,
        "reading": scenario.objective.reading,
        "search": short_name(scenario.search.method) if searches else None,
        "seed": seed,
        "evaluations": (found.evaluations or 1) + others,
        "fidelity": scenario.search.fidelity if searches else "full",
        "rungs": rungs[0] if rungs else None,
        "spread": found.spread,
        **({"pole": _pole_row(pole)} if len(lidars) == 1 else {}),
        "poles": None if poles is None else list(poles),
        "frames": len(site.search),
        "frame_ids": [int(frame) for frame in site.plan.search],
        "holdout_frame_ids": [int(frame) for frame in site.plan.holdout],
        "block_s": site.plan.block_s,
        "vehicles": int(evaluator.vehicles.sum()),
        **({key: value for key, value in lidars[0].items() if key != "name"} if len(lidars) == 1 else {}),
        "lidars": lidars,
        "layout": None
        if len(lidars) == 1
        else judge_layout(site, evaluator, layouts["optimised"], found.steps, searched=bool(searches)),
        **verdict["optimised"],
        "groups": groups,
        "baseline": {**_deployed(scenario, scenario.baselines), **verdict[BASELINE_NAME]},
        "cross_fitted": crossed,
        "other_traffic": other_traffic(site, layouts["optimised"]),
        "assumptions": assumptions(site, tables["optimised"]),
        "warnings": site.recording.report.warnings_as_dicts(),
        "notes": [note for note in site.plan.notes if crossed is None or NOTHING_HELD_OUT not in note],
        "traffic_report": site.recording.report.as_dict(),
        "identity": site.identity,
        "seconds": round(time.perf_counter() - started, 3),
        "versions": versions(site.observation.caster),
    }
    result["document"] = as_json(run_document(result))
    write_approaches(folder, site, result)
    return folder.finish(result)


def sensors_text(site: Site) -> str:
    """The sensors of a site, such as "RS-16", or "2 x RS-16 and RS-32"."""
    names = [lidar.lattice.model.name for lidar in site.observation.lidars]
    counts = [(name, names.count(name)) for name in dict.fromkeys(names)]
    return " and ".join(name if count == 1 else f"{count} x {name}" for name, count in counts)


def _pole_row(pole: Pole | None) -> dict[str, object] | None:
    return None if pole is None else {"name": pole.name, "foot_z_m": pole.foot_z_m}


def _deployed(scenario: Scenario, layout: Layout) -> dict[str, object]:
    """Where a layout hangs: the one mounting, or that of each LiDAR by its name."""
    if len(layout) == 1:
        return {"deployment": layout[0].as_table()}
    named = zip(scenario.lidars, layout, strict=True)
    return {"deployments": {lidar.name: mounting.as_table() for lidar, mounting in named}}


def _lidar_rows(
    site: Site,
    evaluator: Evaluator,
    found: SearchOutcome,
    objective: Mapping[str, float],
    searched: Mapping[str, float],
    gains: Mapping[str, float] | None,
) -> list[dict]:
    """Of each LiDAR its sensor, where it hangs and points, what was searched, and its score map in numbers.

    `objective` is as hung, of the mountings by name, `searched` per vehicle as the search sees it, and `gains` those on
    held-out frames.
    """
    layout, seed, rows = found.layouts["optimised"], site.scenario.search.seed, []
    weight = float(evaluator.weight.sum())
    scenario = site.scenario
    of_each = zip(scenario.lidars, scenario.names, site.models, layout, found.spaces, found.maps, strict=True)
    for number, (lidar, name, model, mounting, space, on_map) in enumerate(of_each):
        map_row = None
        if on_map is not None:
            called = {"optimised": "optimised", BASELINE_NAME: BASELINE_NAME, "best_of_map": best_of_map(name)}
            hung = {key: objective[own] / weight for key, own in called.items()}
            gained = gains and {key: gains[own] for key, own in called.items() if own in gains}
            map_row = map_verdict(on_map[0], hung, searched, gained, seed)
            map_row["polished"] = number in found.polished
        row = {
            "name": lidar.name,
            "sensor": model.name,
            "range_gate_m": lidar.sensor.range_gate_m,
            "imperfections": lidar.sensor.imperfections_as_table(),
            "price": lidar.sensor.price,
            "installer": lidar.deployment.installer.as_setting(),
            "leans": lidar.deployment.places[0].leans,
            "map": map_row,
            "bounds": None if space is None else {key: list(ends) for key, ends in space.places[0].bounds.items()},
            "deployment": mounting.as_table(),
            "pointing": pointing(site, mounting),
            "next_metre": None if space is None else next_metre(site, evaluator, space, layout),
        }
        if len(layout) > 1:
            row["pole"] = _pole_row(lidar.deployment.pole_at(mounting.xy))
            row["baseline"] = lidar.baseline.as_table()
        rows.append(row)
    return rows


def best_of_map(name: str) -> str:
    """What the best layout of a LiDAR's score map is called in a verdict."""
    return f"best_of_map {name}".rstrip()
